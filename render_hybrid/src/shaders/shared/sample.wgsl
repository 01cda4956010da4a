// Texels of a surface, for passes that hold scenes in different ways. Whoever imports this has four functions:
//   texel_at(i: u32) -> u32, an RGBA8 texel of the heap
//   srgb_value(byte: u32) -> f32, linear light of an sRGB byte by the CPU's own table: both lanes decode to the same bits
//   material_texture(material: u32, slot: u32) -> TextureRef, of TEXTURE_SLOTS
//   corner_uv(r: TextureRef, vertex: u32) -> vec2f, of the set that the texture asks for
#import shared/texture

fn decode_channel(byte: u32, srgb: bool) -> f32 {
    if srgb {
        return srgb_value(byte);
    }
    return f32(byte) / 255.0;
}

// Linear RGB and alpha.
fn texel_linear(i: u32, srgb: bool) -> vec4f {
    let t = texel_at(i);
    return vec4f(
        decode_channel(t & 255u, srgb),
        decode_channel((t >> 8u) & 255u, srgb),
        decode_channel((t >> 16u) & 255u, srgb),
        f32(t >> 24u) / 255.0,
    );
}

fn sample_level(r: TextureRef, uv: vec2f) -> vec4f {
    let srgb = (r.flags & TEXTURE_SRGB) != 0u;
    let f = texture_footprint(r, uv);
    let t = f.texels + r.first_texel;
    let top = texel_linear(t.x, srgb) * (1.0 - f.fraction.x) + texel_linear(t.y, srgb) * f.fraction.x;
    let bottom = texel_linear(t.z, srgb) * (1.0 - f.fraction.x) + texel_linear(t.w, srgb) * f.fraction.x;
    return top * (1.0 - f.fraction.y) + bottom * f.fraction.y;
}

// A place of a triangle, as far as textures need it.
struct Textured {
    vertices: vec3u,
    weights: vec3f,
    // Square metres of surface that the pixel covers; 0: full detail.
    footprint: f32,
    area_world: f32,
}

// White where there is no texture.
struct SurfaceTexels {
    base_color: vec4f,
    emissive: vec3f,
    normal: vec3f,
    // Roughness and metallic in y and z.
    metallic_roughness: vec3f,
    transmission: f32,
    // Glossiness in w.
    reflectance: vec4f,
    reflectance_strength: f32,
    // Edges of the triangle on the normal map.
    normal_duv1: vec2f,
    normal_duv2: vec2f,
}

// All textures of a material at once; `slots`: which of them it has. One level of one texture a turn, so that a surface pays
// for those it has alone, and the code stands once: not each branch is skipped where no invocation takes it.
// Twin: trace/surface.rs and engine/src/texture.rs, Texture::sample_lod.
fn surface_texels(material: u32, slots: u32, seen: Textured) -> SurfaceTexels {
    var out = SurfaceTexels(
        vec4f(1.0), vec3f(1.0), vec3f(1.0), vec3f(1.0), 1.0, vec4f(1.0), 1.0, vec2f(0.0), vec2f(0.0));
    var left = slots;
    var finer = vec4f(0.0);
    var second = false;
    for (var turn = 0u; turn < 2u * TEXTURE_SLOTS && left != 0u; turn += 1u) {
        let slot = firstTrailingBit(left);
        let r = material_texture(material, slot);
        let uv0 = corner_uv(r, seen.vertices.x);
        let uv1 = corner_uv(r, seen.vertices.y);
        let uv2 = corner_uv(r, seen.vertices.z);
        let d1 = uv1 - uv0;
        let d2 = uv2 - uv0;
        let per_area = abs(d1.x * d2.y - d1.y * d2.x) / max(seen.area_world, MIN_POSITIVE);
        let wanted = texture_lod(r, per_area, seen.footprint);
        var level = r;
        var blend = 0.0;
        if wanted > 0.0 {
            let lod = min(wanted, f32(texture_last_level(r)));
            var low = select(0.0, floor(lod + 0.5), (r.flags & TEXTURE_MIP_NEAREST) != 0u);
            if (r.flags & TEXTURE_MIP_LINEAR) != 0u {
                low = floor(lod);
                blend = lod - low;
            }
            level = texture_level(r, u32(low) + u32(second));
        }
        var value = sample_level(level, uv0 * seen.weights.x + uv1 * seen.weights.y + uv2 * seen.weights.z);
        if blend > 0.0 && !second {
            finer = value;
            second = true;
            continue;
        }
        if second {
            value = finer * (1.0 - blend) + value * blend;
        }
        second = false;
        left &= left - 1u;
        switch slot {
            case SLOT_BASE_COLOR: {
                out.base_color = value;
            }
            case SLOT_EMISSIVE: {
                out.emissive = value.xyz;
            }
            case SLOT_NORMAL: {
                out.normal = value.xyz;
                out.normal_duv1 = d1;
                out.normal_duv2 = d2;
            }
            case SLOT_METALLIC_ROUGHNESS: {
                out.metallic_roughness = value.xyz;
            }
            case SLOT_TRANSMISSION: {
                out.transmission = value.x;
            }
            case SLOT_REFLECTANCE: {
                out.reflectance = value;
            }
            default: {
                out.reflectance_strength = value.w;
            }
        }
    }
    return out;
}
