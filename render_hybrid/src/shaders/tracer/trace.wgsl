// The tracer as a compute pass over the compacted list of masked pixels.
#import tracer/scene
#import tracer/hits
#import tracer/pixels

struct MaskedUniform {
    count: u32,
    unused0: u32,
    unused1: u32,
    unused2: u32,
}
@group(1) @binding(5) var<storage, read> pixels: array<u32>;
@group(1) @binding(6) var<storage, read_write> counters: array<atomic<u32>, TRACE_COUNTERS>;
@group(1) @binding(7) var traced: texture_storage_2d<rgba32float, write>;
@group(1) @binding(8) var<uniform> masked: MaskedUniform;

var<private> rays: array<u32, TRACE_COUNTERS>;

fn count_ray(kind: u32) {
    rays[kind] += 1u;
}

@compute @workgroup_size(TRACE_GROUP)
fn trace_masked(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = (group.y * groups.x + group.x) * TRACE_GROUP + lane;
    if i >= masked.count {
        return;
    }
    let pixel = vec2u(pixels[i] % frame.size.x, pixels[i] / frame.size.x);
    var shown = trace_pixel(pixel);
    if SHOWS_WORK {
        shown = vec3f(f32(rays[RAYS_REFLECTION] + rays[RAYS_REFRACTION]), f32(walked), 1.0);
    }
    textureStore(traced, pixel, vec4f(shown, 1.0));
    // Sums of whole numbers: the order in which invocations add them does not show.
    for (var kind = 0u; kind < RAYS_CAPPED; kind += 1u) {
        if rays[kind] != 0u {
            atomicAdd(&counters[kind], rays[kind]);
        }
    }
    if capped {
        atomicAdd(&counters[RAYS_CAPPED], 1u);
    }
}
