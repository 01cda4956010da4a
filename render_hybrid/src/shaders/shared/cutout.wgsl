// Holes of a surface. Whoever imports this has texel_at(i: u32) -> u32, an RGBA8 texel of the heap.
// Twin: accel/cutout.rs, Cutouts::is_hole.
#import shared/texture

// Alpha of the image itself, filtered.
fn sample_alpha(r: TextureRef, uv: vec2f) -> f32 {
    let f = texture_footprint(r, uv);
    let t = f.texels + r.first_texel;
    return filtered_alpha(vec4u(texel_at(t.x), texel_at(t.y), texel_at(t.z), texel_at(t.w)), f.fraction);
}

// Where a vertex' texture coordinates lie in the attribute heap.
fn cutout_uv(material: Material, vertex: u32) -> u32 {
    let second = (material.base_color_texture.flags & TEXTURE_UV1) != 0u;
    return vertex * ATTRIBUTE_STRIDE + select(ATTRIBUTE_UV0, ATTRIBUTE_UV1, second);
}

fn is_cut(material: Material, uv: vec2f, vertex_alpha: f32) -> bool {
    var alpha = material.alpha * vertex_alpha;
    if material.base_color_texture.first_texel != NO_TEXTURE {
        alpha *= sample_alpha(material.base_color_texture, uv);
    }
    return alpha < material.alpha_cutoff;
}
