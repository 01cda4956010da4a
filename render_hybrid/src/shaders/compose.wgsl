// final = direct + indirect + traced.
#import shared/fullscreen

@group(1) @binding(0) var direct: texture_2d<f32>;
@group(1) @binding(1) var indirect: texture_2d<f32>;
@group(1) @binding(2) var traced: texture_2d<f32>;

@vertex
fn vertex(@builtin(vertex_index) vertex_index: u32) -> @builtin(position) vec4f {
    return fullscreen_position(vertex_index);
}

@fragment
fn fragment(@builtin(position) position_pixel: vec4f) -> @location(0) vec4f {
    let pixel = vec2u(position_pixel.xy);
    let sum = textureLoad(direct, pixel, 0).xyz + textureLoad(indirect, pixel, 0).xyz + textureLoad(traced, pixel, 0).xyz;
    return vec4f(sum, 1.0);
}
