// One triangle that covers the picture.
fn fullscreen_position(vertex_index: u32) -> vec4f {
    let corner = vec2f(f32((vertex_index << 1u) & 2u), f32(vertex_index & 2u));
    return vec4f(corner * 2.0 - 1.0, 0.0, 1.0);
}
