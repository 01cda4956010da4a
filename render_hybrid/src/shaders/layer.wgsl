// Layers that the G-buffer holds in packed form, as pictures.
#import shared/camera
#import shared/octahedral
#import shared/look
#import shared/fullscreen

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(2) var<storage, read> materials: array<Material>;

struct LayerUniform {
    // One of LAYER_*.
    layer: u32,
    unused0: u32,
    unused1: u32,
    unused2: u32,
}
@group(1) @binding(0) var<uniform> pass_uniform: LayerUniform;
@group(1) @binding(1) var position: texture_2d<f32>;
@group(1) @binding(2) var normals: texture_2d<f32>;
@group(1) @binding(3) var base_color: texture_2d<f32>;

@vertex
fn vertex(@builtin(vertex_index) vertex_index: u32) -> @builtin(position) vec4f {
    return fullscreen_position(vertex_index);
}

@fragment
fn fragment(@builtin(position) position_pixel: vec4f) -> @location(0) vec4f {
    let pixel = vec2u(position_pixel.xy);
    let place = textureLoad(position, pixel, 0);
    if place.w < 0.5 {
        return vec4f(0.0);
    }
    let n = textureLoad(normals, pixel, 0);
    switch pass_uniform.layer {
        case LAYER_MASK: {
            let material = materials[u32(place.w) - 1u];
            let color = textureLoad(base_color, pixel, 0);
            let look = look_of(material, color.xyz, color.w, 0.0);
            return vec4f(look.mirror, (1.0 - look.mirror) * look.transmission, 0.0, place.w);
        }
        case LAYER_DEPTH: {
            return vec4f(vec3f(dot(frame.forward_world, place.xyz - frame.eye_world)), place.w);
        }
        case LAYER_NORMAL: {
            return vec4f(octahedral_decode(n.zw) * 0.5 + 0.5, place.w);
        }
        case LAYER_NORMAL_GEOMETRIC: {
            return vec4f(octahedral_decode(n.xy), place.w);
        }
        case LAYER_NORMAL_SHADING: {
            return vec4f(octahedral_decode(n.zw), place.w);
        }
        default: {
            return vec4f(textureLoad(base_color, pixel, 0).xyz, place.w);
        }
    }
}
