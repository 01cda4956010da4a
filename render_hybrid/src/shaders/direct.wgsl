// Direct light: emitted and ambient radiance, and Blinn-Phong under shadowed lights.
#import shared/camera
#import shared/octahedral
#import shared/light
#import shared/shading
#import shared/look
#import shared/shadow
#import shared/fullscreen

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(2) var<storage, read> materials: array<Material>;
@group(0) @binding(7) var<storage, read> lights: array<Light>;
@group(0) @binding(8) var<storage, read> views: array<ShadowView>;

struct DirectUniform {
    // VISIBILITY_NONE, VISIBILITY_MOMENTS or VISIBILITY_PLANES
    visibility: u32,
    min_variance: f32,
    light_bleed_reduction: f32,
    // The maps hold exponential warps.
    evsm: u32,
}
@group(1) @binding(0) var<uniform> pass_uniform: DirectUniform;
@group(1) @binding(1) var position: texture_2d<f32>;
@group(1) @binding(2) var normals: texture_2d<f32>;
@group(1) @binding(3) var base_color: texture_2d<f32>;
@group(1) @binding(4) var emission: texture_2d<f32>;
@group(1) @binding(5) var moment_maps: texture_2d_array<f32>;
@group(1) @binding(6) var moment_faces: texture_2d_array<f32>;
// One layer a light: visibility that the CPU has traced.
@group(1) @binding(7) var visibility_planes: texture_2d_array<f32>;

// Twin: ShadowMaps::visibility.
fn moments_visibility(light: Light, point_world: vec3f) -> f32 {
    var face = 0u;
    if light.view_count == 6u {
        face = cube_face(point_world - light.position_world);
    }
    let view = views[light.first_view + face];
    let options =
        vec3f(pass_uniform.min_variance, pass_uniform.light_bleed_reduction, f32(pass_uniform.evsm));
    if light.view_count == 6u {
        return view_visibility(moment_faces, light.first_layer + face, view, point_world, options);
    }
    return view_visibility(moment_maps, light.first_layer, view, point_world, options);
}

@vertex
fn vertex(@builtin(vertex_index) vertex_index: u32) -> @builtin(position) vec4f {
    return fullscreen_position(vertex_index);
}

@fragment
fn fragment(@builtin(position) position_pixel: vec4f) -> @location(0) vec4f {
    let pixel = vec2u(position_pixel.xy);
    let own = textureLoad(emission, pixel, 0);
    var radiance = own.xyz;
    let place = textureLoad(position, pixel, 0);
    if place.w < 0.5 {
        return vec4f(radiance, 1.0);
    }
    let material = materials[u32(place.w) - 1u];
    if material.unlit != 0u {
        return vec4f(radiance, 1.0);
    }
    let color = textureLoad(base_color, pixel, 0);
    let albedo = color.xyz;
    let look = look_of(material, albedo, color.w, own.w);
    let matte = matte_weight(look);
    radiance += matte * material.ambient * albedo * frame.ambient;
    let diffuse = albedo * (matte * look.diffuse / PI);
    let n = octahedral_decode(textureLoad(normals, pixel, 0).zw);
    let wo = direction_to_viewer(frame, place.xyz);
    let shiny = any(look.specular > vec3f(0.0));
    // No place is below 0.25. Said so because lavapipe 22.3 makes constants of uniforms that bound loops and here compiled this
    // shader anew, and kept it, for every picture (tests/embed_memory.rs).
    let count = select(frame.light_count, 0u, place.w < 0.25);
    for (var i = 0u; i < count; i += 1u) {
        let light = lights[i];
        let arriving = incident(light, place.xyz);
        let cos_i = dot(n, arriving.wi);
        if cos_i <= 0.0 || !any(arriving.irradiance > vec3f(0.0)) {
            continue;
        }
        var visible = 1.0;
        if pass_uniform.visibility == VISIBILITY_MOMENTS {
            visible = moments_visibility(light, place.xyz);
        } else if pass_uniform.visibility == VISIBILITY_PLANES {
            visible = textureLoad(visibility_planes, pixel, i, 0).x;
        }
        var reflected = diffuse;
        if shiny {
            reflected += look.specular * blinn_phong_lobe(n, arriving.wi, wo, look.shininess);
        }
        radiance += reflected * arriving.irradiance * (cos_i * visible);
    }
    return vec4f(radiance, 1.0);
}
