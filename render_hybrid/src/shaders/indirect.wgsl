// Indirect light: from the grid where its points can tell, elsewhere the contribution of up to VPL_CHUNK virtual point lights,
// added to that of earlier chunks. Interleaved, each pixel is lit by its subset of them and `interleave.wgsl` makes light of
// what is left here. Twin: twin/tile.rs, fill_guides.
#import shared/scene
#import shared/look
#import shared/octahedral
#import shared/vpl_chunk
#import shared/vpl_maps
#import shared/light_grid
#import shared/interleave
#import shared/fullscreen

@group(0) @binding(2) var<storage, read> materials: array<Material>;

@group(1) @binding(0) var<uniform> pass_uniform: IndirectUniform;
@group(1) @binding(1) var position: texture_2d<f32>;
@group(1) @binding(2) var normals: texture_2d<f32>;
@group(1) @binding(3) var base_color: texture_2d<f32>;
@group(1) @binding(4) var previous: texture_2d<f32>;
// One row a map.
@group(1) @binding(5) var vpl_maps: texture_2d<f32>;
@group(1) @binding(6) var<uniform> shape: GridUniform;
@group(1) @binding(7) var grid: texture_2d_array<f32>;
@group(1) @binding(8) var<uniform> subset: SubsetUniform;

@vertex
fn vertex(@builtin(vertex_index) vertex_index: u32) -> @builtin(position) vec4f {
    return fullscreen_position(vertex_index);
}

// One draw a subset, over the places of its pixels, so that all invocations of a draw read the same VPLs in step.
// Radiance; interleaved, irradiance by the pixel's subset times their number, at split_place.
// w: 0 where the grid cannot tell, so that later chunks add to it.
@fragment
fn fragment(@builtin(position) position_pixel: vec4f) -> @location(0) vec4f {
    let at = vec2u(position_pixel.xy);
    let side = pass_uniform.interleave;
    let pixel = pixel_of_split(at, textureDimensions(position), side);
    let place = textureLoad(position, pixel, 0);
    if place.w < 0.5 {
        return vec4f(0.0, 0.0, 0.0, 1.0);
    }
    let material = materials[u32(place.w) - 1u];
    let color = textureLoad(base_color, pixel, 0);
    let albedo = matte_albedo(material, color);
    if all(albedo <= vec3f(0.0)) {
        return vec4f(0.0, 0.0, 0.0, 1.0);
    }
    var before = vec4f(0.0);
    if pass_uniform.first != 0u {
        before = textureLoad(previous, at, 0);
        if before.w > 0.5 {
            return before;
        }
    }
    let n = octahedral_decode(textureLoad(normals, pixel, 0).zw);
    if shape.spacing > 1u && pass_uniform.first == 0u {
        let told = grid_irradiance(grid, shape, pixel, place.xyz, n);
        if told.w > 0.5 {
            return vec4f(albedo * told.xyz, 1.0);
        }
    }
    let subsets = side * side;
    let own = subset_range(pass_uniform.all, subset.k, subsets);
    let end = min(max(own.y, pass_uniform.first) - pass_uniform.first, pass_uniform.count);
    var sum = vec3f(0.0);
    for (var i = max(own.x, pass_uniform.first) - pass_uniform.first; i < end; i += 1u) {
        let irradiance = vpl_irradiance(pass_uniform.vpls[i], place.xyz, n, pass_uniform.geometry_term_max);
        if pass_uniform.map_size == 0u {
            sum += irradiance;
        } else if any(irradiance > vec3f(0.0)) {
            let vpl = pass_uniform.vpls[i];
            let center = vpl.position_world + vpl.normal_world * vpl.error;
            sum += irradiance * vpl_visibility(vpl_maps, vpl.map, pass_uniform.map_size, place.xyz - center, n);
        }
    }
    let scale = select(albedo, vec3f(f32(subsets)), side > 1u);
    return vec4f(before.xyz + scale * sum, 0.0);
}
