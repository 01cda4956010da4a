// Separable 7x7 Gaussian over all layers of a moment array, clamped at the rim. Twin of the weights: twin/shadow.rs.

@group(1) @binding(0) var source: texture_2d_array<f32>;
@group(1) @binding(1) var destination: texture_storage_2d_array<rgba32float, write>;

fn blur(texel: vec2u, layer: u32, axis: vec2i) {
    let size = vec2i(textureDimensions(source));
    let at = vec2i(texel);
    if any(at >= size) {
        return;
    }
    // Outermost pair first, as on the CPU.
    var sum = vec4f(0.0);
    for (var i = 3; i >= 1; i -= 1) {
        let before = textureLoad(source, clamp(at - axis * i, vec2i(0), size - 1), layer, 0);
        let after = textureLoad(source, clamp(at + axis * i, vec2i(0), size - 1), layer, 0);
        sum += (before + after) * GAUSSIAN_7[3 - i];
    }
    sum += textureLoad(source, at, layer, 0) * GAUSSIAN_7[3];
    textureStore(destination, at, layer, sum);
}

@compute @workgroup_size(8, 8)
fn horizontal(@builtin(global_invocation_id) id: vec3u) {
    blur(id.xy, id.z, vec2i(1, 0));
}

@compute @workgroup_size(8, 8)
fn vertical(@builtin(global_invocation_id) id: vec3u) {
    blur(id.xy, id.z, vec2i(0, 1));
}
