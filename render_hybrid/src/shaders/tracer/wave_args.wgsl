// From one wave to the next: the rays that were begun are now to be followed.

struct Waves {
    count: u32,
    begun: u32,
    half: u32,
    lost: u32,
}
struct WaveUniform {
    unused: u32,
    capacity: u32,
    unused0: u32,
    unused1: u32,
}
@group(1) @binding(0) var<uniform> masked: WaveUniform;
@group(1) @binding(1) var<storage, read_write> waves: Waves;
@group(1) @binding(2) var<storage, read_write> dispatch: vec4u;

@compute @workgroup_size(1)
fn next_wave() {
    let count = min(waves.begun, masked.capacity);
    waves.count = count;
    waves.begun = 0u;
    waves.half = 1u - waves.half;
    let groups = (count + TRACE_GROUP - 1u) / TRACE_GROUP;
    let x = clamp(groups, 1u, 32768u);
    dispatch = vec4u(x, (groups + x - 1u) / x, 1u, 0u);
}
