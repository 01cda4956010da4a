#import shared/scene

// How one place of a surface splits light. Twin: engine/src/material.rs, Look.
struct Look {
    specular: vec3f,
    shininess: f32,
    diffuse: f32,
    mirror: f32,
    transmission: f32,
}

// Factors of a physical material at one place, each in [0, 1]. Twin: PhysicalPlace.
struct PhysicalPlace {
    metallic: f32,
    roughness: f32,
    transmission: f32,
    coverage: f32,
}

// Twin: shininess_from_roughness.
fn shininess_from_roughness(r: f32) -> f32 {
    let alpha = r * r;
    return clamp(2.0 / max(alpha * alpha, 1e-12) - 2.0, 0.0, MAX_SHININESS);
}

// Twin: Physical::look.
fn physical_look(reflectance: vec3f, base_color: vec3f, at: PhysicalPlace) -> Look {
    var out: Look;
    if at.roughness <= POLISHED {
        out = Look(vec3f(0.0), 32.0, 1.0, at.metallic, at.transmission);
    } else {
        let polish = max((NOT_POLISHED - at.roughness) / (NOT_POLISHED - POLISHED), 0.0);
        let mirror = at.metallic * polish;
        let rest = 1.0 - mirror;
        var t = 0.0;
        if rest > 0.0 {
            t = min(at.transmission * (1.0 - at.metallic) / rest, 1.0);
        }
        let matte = rest * (1.0 - t);
        var diffuse = 0.0;
        if matte > 0.0 {
            diffuse = clamp((1.0 - at.metallic) * (1.0 - at.transmission) / matte, 0.0, 1.0);
        }
        let dielectric = reflectance * (1.0 - at.roughness);
        let specular = (dielectric + (base_color - dielectric) * at.metallic) * (1.0 - polish);
        out = Look(specular, shininess_from_roughness(at.roughness), diffuse, mirror, t);
    }
    if at.coverage < 1.0 {
        out.specular *= at.coverage;
        out.mirror *= at.coverage;
        out.transmission = min((1.0 - at.coverage) / max(1.0 - out.mirror, MIN_POSITIVE), 1.0);
    }
    return out;
}

// Colour and share of metal (w) of a surface told by diffuse colour and reflectance. Twin: metal_of_reflectance.
fn metal_of_reflectance(diffuse_color: vec3f, reflectance: vec3f) -> vec4f {
    let strongest = max(reflectance.x, max(reflectance.y, reflectance.z));
    let metallic = clamp((strongest - DIELECTRIC_REFLECTANCE) / (1.0 - DIELECTRIC_REFLECTANCE), 0.0, 1.0);
    if metallic == 0.0 {
        return vec4f(diffuse_color, 0.0);
    }
    return vec4f(diffuse_color + (reflectance / strongest - diffuse_color) * metallic, metallic);
}

// Reflectance of a place, and what it makes of colour, metal and roughness. * `flags`: the material's PHYSICAL bits
// * `texel`: rgb: factor of reflectance, w: of glossiness
fn reflectance_at(
    flags: u32,
    factor: vec3f,
    texel: vec4f,
    base_color: ptr<function, vec3f>,
    place: ptr<function, PhysicalPlace>,
) -> vec3f {
    var reflectance = factor;
    if (flags & PHYSICAL_REFLECTANCE) != 0u {
        reflectance *= texel.xyz;
        if (flags & PHYSICAL_BY_REFLECTANCE) != 0u {
            (*place).roughness = 1.0 - (1.0 - (*place).roughness) * texel.w;
        }
    }
    if (flags & PHYSICAL_BY_REFLECTANCE) != 0u {
        let metal_color = metal_of_reflectance(*base_color, reflectance);
        *base_color = metal_color.xyz;
        (*place).metallic = metal_color.w;
    }
    return reflectance;
}

// A colour in [0, 1] in one normal float: nine bits a channel, of their square roots.
fn pack_reflectance(reflectance: vec3f) -> f32 {
    let code = vec3u(sqrt(clamp(reflectance, vec3f(0.0), vec3f(1.0))) * 511.0 + 0.5);
    return bitcast<f32>(0x40000000u | (code.x << 18u) | (code.y << 9u) | code.z);
}

fn unpack_reflectance(packed: f32) -> vec3f {
    let bits = bitcast<u32>(packed);
    let root = vec3f(vec3u(bits >> 18u, bits >> 9u, bits) & vec3u(511u)) / 511.0;
    return root * root;
}

// A place's factors and whether the tracer has work there, in one normal float: over 0.5 where it has, else below -0.5.
// Seven bits each, eight for roughness; what decides between kinds of surface stays on its side of the decision.
fn pack_place(at: PhysicalPlace, traced: bool) -> f32 {
    let m = max(u32(at.metallic * 127.0 + 0.5), select(0u, 1u, at.metallic > 0.0));
    let t = max(u32(at.transmission * 127.0 + 0.5), select(0u, 1u, at.transmission > 0.0));
    let a = min(u32(at.coverage * 127.0 + 0.5), select(127u, 126u, at.coverage < 1.0));
    let polished = u32(POLISHED * 255.0);
    let code = u32(at.roughness * 255.0 + 0.5);
    let r = select(max(code, polished + 1u), min(code, polished), at.roughness <= POLISHED);
    let bits = 0x40000000u | (m << 22u) | (r << 14u) | (t << 7u) | a;
    return bitcast<f32>(select(0x80000000u, 0u, traced) | bits);
}

fn unpack_place(packed: f32) -> PhysicalPlace {
    let bits = bitcast<u32>(packed);
    return PhysicalPlace(
        f32((bits >> 22u) & 127u) / 127.0,
        f32((bits >> 14u) & 255u) / 255.0,
        f32((bits >> 7u) & 127u) / 127.0,
        f32(bits & 127u) / 127.0,
    );
}

// The look of a pixel. * `packed`, `packed_reflectance`: the fourth channels of the G-buffer's base colour and emission
fn look_of(material: Material, base_color: vec3f, packed: f32, packed_reflectance: f32) -> Look {
    if (material.physical & PHYSICAL) != 0u {
        var reflectance = material.reflectance;
        if (material.physical & PHYSICAL_REFLECTANCE) != 0u {
            reflectance = unpack_reflectance(packed_reflectance);
        }
        return physical_look(reflectance, base_color, unpack_place(packed));
    }
    return Look(
        material.specular, material.shininess, material.diffuse, material.mirror, material.transmission);
}

// Share of the matte and ambient terms: (1 - mirror)(1 - transmission).
fn matte_weight(look: Look) -> f32 {
    return (1.0 - look.mirror) * (1.0 - look.transmission);
}

// What turns irradiance at a pixel into radiance; zero where it has no matte share. Twin: PointBatch::albedo.
// * `color`: the G-buffer's base colour
fn matte_albedo(material: Material, color: vec4f) -> vec3f {
    if material.unlit != 0u {
        return vec3f(0.0);
    }
    // The highlight, which reflectance makes, is not asked for.
    let look = look_of(material, color.xyz, color.w, 0.0);
    return color.xyz * (matte_weight(look) * look.diffuse / PI);
}
