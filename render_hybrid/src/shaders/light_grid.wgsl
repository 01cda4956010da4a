// Light of up to VPL_CHUNK virtual point lights at the places of the grid, added to that of earlier chunks, or to what the CPU
// has found close to the places.
// Twin: twin/grid.rs, fill_rows, and trace/points.rs, accumulate_directional.
#import shared/scene
#import shared/look
#import shared/octahedral
#import shared/vpl_chunk
#import shared/vpl_maps
#import shared/light_grid

@group(0) @binding(2) var<storage, read> materials: array<Material>;

@group(1) @binding(0) var<uniform> pass_uniform: IndirectUniform;
@group(1) @binding(1) var<uniform> shape: GridUniform;
@group(1) @binding(2) var position: texture_2d<f32>;
@group(1) @binding(3) var normals: texture_2d<f32>;
@group(1) @binding(4) var base_color: texture_2d<f32>;
@group(1) @binding(5) var previous: texture_2d_array<f32>;
// One row a map.
@group(1) @binding(6) var vpl_maps: texture_2d<f32>;
@group(1) @binding(7) var out_grid: texture_storage_2d_array<rgba32float, write>;

@compute @workgroup_size(8, 8)
fn light_grid(@builtin(global_invocation_id) id: vec3u) {
    if any(id.xy >= shape.size) {
        return;
    }
    let pixel = grid_pixel(id.xy, shape.spacing, textureDimensions(position));
    let place = textureLoad(position, pixel, 0);
    var n = vec3f(0.0);
    if place.w >= 0.5 {
        let material = materials[u32(place.w) - 1u];
        let color = textureLoad(base_color, pixel, 0);
        let look = look_of(material, color.xyz, color.w, 0.0);
        if material.unlit == 0u && matte_weight(look) * look.diffuse > 0.0 {
            n = octahedral_decode(textureLoad(normals, pixel, 0).zw);
        }
    }
    var red = vec3f(0.0);
    var green = vec3f(0.0);
    var blue = vec3f(0.0);
    if any(n != vec3f(0.0)) {
        for (var i = 0u; i < pass_uniform.count; i += 1u) {
            let y = pass_uniform.vpls[i].position_world;
            let normal_vpl = pass_uniform.vpls[i].normal_world;
            let to_vpl = y - place.xyz;
            let g = geometry_term(to_vpl, n, normal_vpl, pass_uniform.geometry_term_max);
            if g <= 0.0 {
                continue;
            }
            var weight = g / (max(dot(n, to_vpl), 1e-30) * PI);
            if pass_uniform.map_size != 0u {
                let center = y + normal_vpl * pass_uniform.vpls[i].error;
                let map = pass_uniform.vpls[i].map;
                weight *= vpl_visibility(vpl_maps, map, pass_uniform.map_size, place.xyz - center, n);
            }
            let flux = pass_uniform.vpls[i].flux;
            let arriving = to_vpl * weight;
            red += flux.x * arriving;
            green += flux.y * arriving;
            blue += flux.z * arriving;
        }
    }
    if pass_uniform.first != 0u || shape.adds != 0u {
        red += textureLoad(previous, id.xy, 0u, 0).xyz;
        green += textureLoad(previous, id.xy, 1u, 0).xyz;
        blue += textureLoad(previous, id.xy, 2u, 0).xyz;
    }
    textureStore(out_grid, id.xy, 0u, vec4f(red, n.x));
    textureStore(out_grid, id.xy, 1u, vec4f(green, n.y));
    textureStore(out_grid, id.xy, 2u, vec4f(blue, n.z));
    textureStore(out_grid, id.xy, GRID_POSITION, vec4f(place.xyz, 0.0));
}
