// The tracer as a fragment pass; its data lie in textures, it needs no storage buffer.
#import tracer/scene
#import tracer/hits
#import tracer/pixels
#import shared/fullscreen

// w: 1 where the tracer has work.
@group(1) @binding(5) var base_color: texture_2d<f32>;

fn count_ray(kind: u32) {
}

@vertex
fn vertex(@builtin(vertex_index) vertex_index: u32) -> @builtin(position) vec4f {
    return fullscreen_position(vertex_index);
}

@fragment
fn fragment(@builtin(position) position_pixel: vec4f) -> @location(0) vec4f {
    let pixel = vec2u(position_pixel.xy);
    if textureLoad(base_color, pixel, 0).w < 0.5 {
        return vec4f(0.0);
    }
    return vec4f(trace_pixel(pixel), 1.0);
}
