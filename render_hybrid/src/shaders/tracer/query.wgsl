// Rays of a list, for tests and measurements of the traversal alone.
#import tracer/scene
#import tracer/hits

@group(1) @binding(0) var<storage, read> list: array<vec4u>;
// t, u, v as bits; instance, primitive; whether the walk met its cap.
@group(1) @binding(1) var<storage, read_write> answers: array<vec4u>;

@compute @workgroup_size(TRACE_GROUP)
fn query(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = (group.y * groups.x + group.x) * TRACE_GROUP + lane;
    if 2u * i >= arrayLength(&list) {
        return;
    }
    let a = bitcast<vec4f>(list[2u * i]);
    let b = bitcast<vec4f>(list[2u * i + 1u]);
    let hit = closest_hit(Ray(a.xyz, a.w, b.xyz, b.w));
    answers[2u * i] = vec4u(bitcast<vec3u>(vec3f(hit.t, hit.u, hit.v)), hit.instance);
    answers[2u * i + 1u] = vec4u(hit.primitive, u32(capped), 0u, 0u);
}
