// Separable 3x3 binomial over all layers of a moment array, clamped at the rim, and the further levels of its pyramid. Twins:
// twin/shadow.rs (weights), twin/moments.rs; twin/penumbra.rs, halve_row.

@group(1) @binding(0) var source: texture_2d_array<f32>;
@group(1) @binding(1) var destination: texture_storage_2d_array<rgba32float, write>;

fn blur(texel: vec2u, layer: u32, axis: vec2i) {
    let size = vec2i(textureDimensions(source));
    let at = vec2i(texel);
    if any(at >= size) {
        return;
    }
    // The outer pair first, as on the CPU.
    let before = textureLoad(source, clamp(at - axis, vec2i(0), size - 1), layer, 0);
    let after = textureLoad(source, clamp(at + axis, vec2i(0), size - 1), layer, 0);
    let sum = (before + after) * BLUR_BESIDE + textureLoad(source, at, layer, 0) * BLUR_CENTER;
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

fn fine_column(x: i32, rows: vec4i, layer: u32) -> vec4f {
    let last = i32(textureDimensions(source).x) - 1;
    let column = clamp(x, 0, last);
    let outer = textureLoad(source, vec2i(column, rows.x), layer, 0) + textureLoad(source, vec2i(column, rows.w), layer, 0);
    let inner = textureLoad(source, vec2i(column, rows.y), layer, 0) + textureLoad(source, vec2i(column, rows.z), layer, 0);
    return outer + inner * 3.0;
}

// The next level: four by four texels around each, weighed 1, 3, 3, 1 each way.
@compute @workgroup_size(8, 8)
fn halve(@builtin(global_invocation_id) id: vec3u) {
    if any(id.xy >= textureDimensions(destination)) {
        return;
    }
    let first = vec2i(id.xy) * 2 - 1;
    let rows = clamp(first.y + vec4i(0, 1, 2, 3), vec4i(0), vec4i(i32(textureDimensions(source).y) - 1));
    let outer = fine_column(first.x, rows, id.z) + fine_column(first.x + 3, rows, id.z);
    let inner = fine_column(first.x + 1, rows, id.z) + fine_column(first.x + 2, rows, id.z);
    textureStore(destination, vec2i(id.xy), id.z, (outer + inner * 3.0) * (1.0 / 64.0));
}
