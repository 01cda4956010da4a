// Linear radiance to the picture on screen: exposure, clamp, sRGB curve.
#import shared/fullscreen

struct PresentUniform {
    exposure: f32,
    // 1 where the target does not apply the sRGB curve by itself.
    encode_srgb: u32,
    unused0: u32,
    unused1: u32,
}
@group(1) @binding(0) var<uniform> pass_uniform: PresentUniform;
@group(1) @binding(1) var picture: texture_2d<f32>;

fn srgb_from_linear(x: vec3f) -> vec3f {
    return select(1.055 * pow(max(x, vec3f(1e-8)), vec3f(1.0 / 2.4)) - 0.055, 12.92 * x, x <= vec3f(0.0031308));
}

struct Varyings {
    @builtin(position) position_clip: vec4f,
    @location(0) uv: vec2f,
}

@vertex
fn vertex(@builtin(vertex_index) vertex_index: u32) -> Varyings {
    let position_clip = fullscreen_position(vertex_index);
    return Varyings(position_clip, vec2f(0.5 + 0.5 * position_clip.x, 0.5 - 0.5 * position_clip.y));
}

@fragment
fn fragment(in: Varyings) -> @location(0) vec4f {
    // The window may have another size than the picture: nearest pixel, no filtering of 32-bit floats needed.
    let size = textureDimensions(picture);
    let pixel = min(vec2u(in.uv * vec2f(size)), size - 1u);
    let exposed = clamp(textureLoad(picture, pixel, 0).xyz * pass_uniform.exposure, vec3f(0.0), vec3f(1.0));
    if pass_uniform.encode_srgb != 0u {
        return vec4f(srgb_from_linear(exposed), 1.0);
    }
    return vec4f(exposed, 1.0);
}
