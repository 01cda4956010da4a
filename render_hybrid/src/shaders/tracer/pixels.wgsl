// What the tracer of pixels reads beside the scene, and all its stages.
#import shared/shading
#import shared/shadow
#import shared/light
#import shared/vpl
#import shared/vpl_maps
#import shared/sampling
#import tracer/shade
#import tracer/media
#import tracer/whitted

struct TraceUniform {
    max_depth: u32,
    min_weight: f32,
    // Most rays a pixel can have: 2^depth of them, within reason.
    ray_cap: u32,
    vpl_count: u32,
    geometry_term_max: f32,
    // Texels a side of the VPLs' shadow maps; 0: they throw none.
    map_size: u32,
    // VISIBILITY_NONE or VISIBILITY_MOMENTS
    visibility: u32,
    min_variance: f32,
    light_bleed_reduction: f32,
    evsm: u32,
    shadow_samples: u32,
    seed: u32,
}
@group(1) @binding(0) var<uniform> trace: TraceUniform;
@group(1) @binding(1) var visibility: texture_2d<u32>;
@group(1) @binding(2) var moment_maps: texture_2d_array<f32>;
@group(1) @binding(3) var moment_faces: texture_2d_array<f32>;
// One row a map.
@group(1) @binding(4) var vpl_maps: texture_2d<f32>;
