// Indirect light of interleaved VPLs: the mean of the n x n pixels around each that lie on its surface, so that the light of all
// subsets comes together. Twin: twin/interleave.rs, filter.
#import shared/scene
#import shared/look
#import shared/octahedral
#import shared/interleave
#import shared/fullscreen

@group(0) @binding(2) var<storage, read> materials: array<Material>;

struct InterleaveUniform {
    // Side of the blocks of pixels.
    n: u32,
    unused0: u32,
    unused1: u32,
    unused2: u32,
}
@group(1) @binding(0) var<uniform> pass_uniform: InterleaveUniform;
@group(1) @binding(1) var position: texture_2d<f32>;
@group(1) @binding(2) var normals: texture_2d<f32>;
@group(1) @binding(3) var base_color: texture_2d<f32>;
// Irradiance by each pixel's subset times their number, at split_place; w: 1 where there is nothing to filter.
@group(1) @binding(4) var of_subsets: texture_2d<f32>;

@vertex
fn vertex(@builtin(vertex_index) vertex_index: u32) -> @builtin(position) vec4f {
    return fullscreen_position(vertex_index);
}

@fragment
fn fragment(@builtin(position) position_pixel: vec4f) -> @location(0) vec4f {
    let pixel = vec2u(position_pixel.xy);
    let size = textureDimensions(position);
    let n = pass_uniform.n;
    if textureLoad(of_subsets, split_place(pixel, size, n), 0).w > 0.5 {
        return vec4f(0.0, 0.0, 0.0, 1.0);
    }
    let place = textureLoad(position, pixel, 0);
    let normal = octahedral_decode(textureLoad(normals, pixel, 0).zw);
    let span = filter_span(pixel, size, n);
    var sum = vec3f(0.0);
    var count = 0.0;
    for (var v = span.y; v < span.w; v += 1u) {
        for (var u = span.x; u < span.z; u += 1u) {
            let other = vec2u(u, v);
            let irradiance = textureLoad(of_subsets, split_place(other, size, n), 0);
            let at = textureLoad(position, other, 0).xyz;
            let normal_other = octahedral_decode(textureLoad(normals, other, 0).zw);
            if irradiance.w < 0.5 && same_surface(place.xyz, normal, at, normal_other) {
                sum += irradiance.xyz;
                count += 1.0;
            }
        }
    }
    let albedo = matte_albedo(materials[u32(place.w) - 1u], textureLoad(base_color, pixel, 0));
    // The pixel itself always counts.
    return vec4f(albedo * (sum / max(count, 1.0)), 1.0);
}
