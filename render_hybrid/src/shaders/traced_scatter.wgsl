// Puts the tracer's list of pixels in their places.

struct TracedPixel {
    radiance: vec3f,
    pixel: u32,
}
struct ScatterUniform {
    count: u32,
    unused0: u32,
    unused1: u32,
    unused2: u32,
}
@group(1) @binding(0) var<uniform> pass_uniform: ScatterUniform;
@group(1) @binding(1) var<storage, read> pixels: array<TracedPixel>;
@group(1) @binding(2) var traced: texture_storage_2d<rgba32float, write>;

@compute @workgroup_size(256)
fn scatter(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = (group.y * groups.x + group.x) * 256u + lane;
    if i >= pass_uniform.count {
        return;
    }
    let width = textureDimensions(traced).x;
    let p = pixels[i];
    textureStore(traced, vec2u(p.pixel % width, p.pixel / width), vec4f(p.radiance, 1.0));
}
