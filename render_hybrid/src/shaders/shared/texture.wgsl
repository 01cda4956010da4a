#import shared/scene

// Texel number after the wrap rule, always in 0..size. Twin: engine/src/texture.rs, wrap_texel.
fn wrap_texel(i: i32, size: u32, wrap: u32) -> u32 {
    let n = i32(size);
    if wrap == WRAP_CLAMP {
        return u32(clamp(i, 0, n - 1));
    }
    let period = select(n, 2 * n, wrap == WRAP_MIRROR);
    let m = ((i % period) + period) % period;
    return u32(select(2 * n - 1 - m, m, m < n));
}

// Keeps the count of repeats small before it becomes an integer.
fn fold_uv(v: f32, wrap: u32) -> f32 {
    if wrap == WRAP_CLAMP {
        return clamp(v, -1.0, 2.0);
    }
    return v - 2.0 * floor(v * 0.5);
}

// The four texels of a bilinear lookup and their weights; all the same texel for nearest.
struct Footprint {
    // Texel numbers relative to the texture's first: (0,0), (1,0), (0,1), (1,1).
    texels: vec4u,
    // Weights of the right column and of the lower row.
    fraction: vec2f,
}

// Twin: engine/src/texture.rs, Texture::sample.
fn texture_footprint(r: TextureRef, uv: vec2f) -> Footprint {
    let transformed = vec2f(dot(r.uv_row0, vec3f(uv, 1.0)), dot(r.uv_row1, vec3f(uv, 1.0)));
    let usable = all(abs(transformed) <= vec2f(3e38));
    let uv1 = select(vec2f(0.0), transformed, usable);
    var p = vec2f(fold_uv(uv1.x, r.wrap_u) * f32(r.width), fold_uv(uv1.y, r.wrap_v) * f32(r.height));
    let nearest = (r.flags & TEXTURE_NEAREST) != 0u;
    if !nearest {
        p -= vec2f(0.5);
    }
    let low = floor(p);
    let x0 = wrap_texel(i32(low.x), r.width, r.wrap_u);
    let y0 = wrap_texel(i32(low.y), r.height, r.wrap_v);
    if nearest {
        return Footprint(vec4u(y0 * r.width + x0), vec2f(0.0));
    }
    let x1 = wrap_texel(i32(low.x) + 1, r.width, r.wrap_u);
    let y1 = wrap_texel(i32(low.y) + 1, r.height, r.wrap_v);
    return Footprint(
        vec4u(y0 * r.width + x0, y0 * r.width + x1, y1 * r.width + x0, y1 * r.width + x1),
        p - low,
    );
}

// A level of a texture as a texture of its own, read as one that is smaller than a pixel is. Twin: Texture::sample_level.
fn texture_level(r: TextureRef, level: u32) -> TextureRef {
    var out = r;
    for (var l = 0u; l < level; l += 1u) {
        out.first_texel += max(r.width >> l, 1u) * max(r.height >> l, 1u);
    }
    out.width = max(r.width >> level, 1u);
    out.height = max(r.height >> level, 1u);
    out.flags = r.flags & ~TEXTURE_NEAREST;
    if (r.flags & TEXTURE_NEAREST_MIN) != 0u {
        out.flags |= TEXTURE_NEAREST;
    }
    return out;
}

// Number of a texture's levels less one. Twin: Texture::level_count.
fn texture_last_level(r: TextureRef) -> u32 {
    return firstLeadingBit(max(r.width, r.height));
}

// Twin: trace/surface.rs, texture_lod.
fn texture_lod(r: TextureRef, per_area: f32, footprint: f32) -> f32 {
    let determinant = abs(r.uv_row0.x * r.uv_row1.y - r.uv_row0.y * r.uv_row1.x);
    let texels = determinant * per_area * footprint * (f32(r.width) * f32(r.height));
    if texels > 1.0 && texels < FAR_AWAY {
        return 0.5 * log2(texels);
    }
    return 0.0;
}

// Alpha of four RGBA8 texels of a footprint, filtered.
fn filtered_alpha(texels: vec4u, fraction: vec2f) -> f32 {
    let a = vec4f(texels >> vec4u(24u)) / 255.0;
    let top = a.x * (1.0 - fraction.x) + a.y * fraction.x;
    let bottom = a.z * (1.0 - fraction.x) + a.w * fraction.x;
    return top * (1.0 - fraction.y) + bottom * fraction.y;
}
