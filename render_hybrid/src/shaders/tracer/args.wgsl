// From the compaction's count to the tracer's dispatch: workgroups in two dimensions, and the count itself.

@group(1) @binding(0) var<storage, read> blocks: array<u32>;
@group(1) @binding(1) var<storage, read_write> dispatch: vec4u;

@compute @workgroup_size(1)
fn prepare() {
    let count = blocks[arrayLength(&blocks) - 1u];
    let groups = (count + TRACE_GROUP - 1u) / TRACE_GROUP;
    let x = clamp(groups, 1u, 32768u);
    dispatch = vec4u(x, (groups + x - 1u) / x, 1u, count);
}
