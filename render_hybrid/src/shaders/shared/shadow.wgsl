// Variance shadow maps. Twins: twin/shadow.rs, twin/penumbra.rs.

struct ShadowView {
    origin_world: vec3f,
    far: f32,
    right_scaled: vec3f,
    perspective: f32,
    up_scaled: vec3f,
    size: u32,
    forward: vec3f,
    softness: f32,
}

struct ShadowCoord {
    uv: vec2f,
    depth: f32,
    in_front: bool,
}

fn shadow_project(view: ShadowView, point_world: vec3f) -> ShadowCoord {
    let v = point_world - view.origin_world;
    let z = dot(view.forward, v);
    let w = select(1.0, z, view.perspective > 0.5);
    let in_front = w > 0.0;
    let divisor = select(1.0, w, in_front);
    let x = dot(view.right_scaled, v) / divisor;
    let y = dot(view.up_scaled, v) / divisor;
    return ShadowCoord(vec2f(0.5 + 0.5 * x, 0.5 - 0.5 * y), z / view.far, in_front);
}

// Upper bound on the fraction of light that reaches depth `t`.
// Source: Donnelly & Lauritzen, "Variance Shadow Maps", I3D 2006.
fn chebyshev_upper_bound(moments: vec2f, t: f32, min_variance: f32, light_bleed_reduction: f32) -> f32 {
    if t <= moments.x {
        return 1.0;
    }
    let variance = max(moments.y - moments.x * moments.x, min_variance);
    let d = t - moments.x;
    let p = variance / (variance + d * d);
    return clamp((p - light_bleed_reduction) / (1.0 - light_bleed_reduction), 0.0, 1.0);
}

// Both warps of a depth clamped to [0, 1] first.
// Source: Lauritzen & McCool, "Layered Variance Shadow Maps", GI 2008.
fn evsm_warp(z: f32) -> vec2f {
    let t = clamp(z, 0.0, 1.0) * 2.0 - 1.0;
    return vec2f(exp(EVSM_POSITIVE * t), -exp(-EVSM_NEGATIVE * t));
}

// What a texel holds of depth `z`.
fn moments_of(evsm: u32, z: f32) -> vec4f {
    if evsm != 0u {
        let w = evsm_warp(z);
        return vec4f(w.x, w.x * w.x, w.y, w.y * w.y);
    }
    let depth = clamp(z, 0.0, 1.0);
    return vec4f(depth, depth * depth, 0.0, 0.0);
}

// Fraction of light that reaches depth `t`: the lesser of the two warps' bounds.
fn evsm_visibility(moments: vec4f, t: f32, min_variance: f32, light_bleed_reduction: f32) -> f32 {
    let w = evsm_warp(t);
    let slope = 2.0 * vec2f(EVSM_POSITIVE, EVSM_NEGATIVE) * w;
    let floors = min_variance * slope * slope;
    let near = chebyshev_upper_bound(moments.xy, w.x, floors.x, light_bleed_reduction);
    let far = chebyshev_upper_bound(moments.zw, w.y, floors.y, light_bleed_reduction);
    return min(near, far);
}

// Which of six faces (+X, -X, +Y, -Y, +Z, -Z) a direction falls on.
fn cube_face(v: vec3f) -> u32 {
    let a = abs(v);
    if a.x >= a.y && a.x >= a.z {
        return u32(v.x < 0.0);
    }
    if a.y >= a.z {
        return 2u + u32(v.y < 0.0);
    }
    return 4u + u32(v.z < 0.0);
}

// Levels of the pyramid of a map of `size` texels a side.
fn level_count(size: u32) -> u32 {
    return firstLeadingBit(max(size / PENUMBRA_COARSEST, 1u)) + 1u;
}

struct SoftLevel {
    level: u32,
    // To the next one, in [0, 1).
    fraction: f32,
}

// Level whose blur is `sigma` texels, from level to level in proportion to it.
fn level_of(sigma: f32, levels: u32) -> SoftLevel {
    let bits = bitcast<u32>(clamp(sigma * (1.0 / PENUMBRA_LEVEL_SIGMA), 1.0, 65536.0));
    let level = (bits >> 23u) - 127u;
    if level + 1u < levels {
        return SoftLevel(level, f32(bits & 0x007fffffu) * (1.0 / 8388608.0));
    }
    return SoftLevel(levels - 1u, 0.0);
}

// Blur in texels of the image of the light's disc on the map, past an occluder at depth `occluder`.
fn penumbra_sigma(softness: f32, perspective: bool, slant: f32, occluder: f32, receiver: f32) -> f32 {
    let near = max(occluder, 1e-6);
    let spread = select(receiver - near, (receiver - near) / (near * receiver) * slant, perspective);
    return softness * max(spread, 0.0);
}

// Natural logarithm of a positive normal number, to 2e-5.
fn ln_rough(x: f32) -> f32 {
    let bits = bitcast<u32>(x);
    let exponent = f32(i32(bits >> 23u) - 127);
    let m = bitcast<f32>((bits & 0x007fffffu) | 0x3f800000u);
    let s = (m - 1.0) / (m + 1.0);
    let s2 = s * s;
    return exponent * 0.6931472 + 2.0 * s * (1.0 + s2 * (1.0 / 3.0 + s2 * (1.0 / 5.0 + s2 * (1.0 / 7.0))));
}

// Mean depth of what lies before depth `t` within the footprint of `moments`; `t` where nothing does.
// Source: Yang et al., "Variance Soft Shadow Mapping", Pacific Graphics 2010.
fn occluder_depth(evsm: bool, moments: vec4f, t: f32, min_variance: f32) -> f32 {
    var mean = moments.x;
    var square = moments.y;
    var receiver = t;
    var slope = 1.0;
    if evsm {
        mean = moments.z;
        square = moments.w;
        receiver = evsm_warp(t).y;
        slope = 2.0 * EVSM_NEGATIVE * receiver;
    }
    let variance = max(square - mean * mean, min_variance * slope * slope);
    let d = receiver - mean;
    let lit = variance / (variance + d * d);
    let occluded = 1.0 - lit;
    if d <= 0.0 || occluded <= PENUMBRA_LEAST_OCCLUDED {
        return t;
    }
    var depth = mean - d * lit / occluded;
    if evsm {
        depth = 0.5 - ln_rough(max(-depth, 1e-30)) * (0.5 / EVSM_NEGATIVE);
    }
    return min(max(depth, 0.0), t);
}

// Moments of a level of the pyramid at `uv`, clamped at the rim. By hand: filtering of 32-bit floats is optional in wgpu.
// Twin: ShadowMaps::sample.
// * size: texels a side of the map
fn sample_moments(maps: texture_2d_array<f32>, layer: u32, size: u32, uv: vec2f, level: u32) -> vec4f {
    let own = size >> level;
    let p = clamp(uv * f32(size) * (1.0 / f32(1u << level)) - 0.5, vec2f(0.0), vec2f(f32(own) - 1.0));
    let low = vec2u(p);
    let high = min(low + 1u, vec2u(own - 1u));
    let f = p - vec2f(low);
    let m00 = textureLoad(maps, low, layer, level);
    let m10 = textureLoad(maps, vec2u(high.x, low.y), layer, level);
    let m01 = textureLoad(maps, vec2u(low.x, high.y), layer, level);
    let m11 = textureLoad(maps, high, layer, level);
    let a = m00 + (m10 - m00) * f.x;
    let b = m01 + (m11 - m01) * f.x;
    return a + (b - a) * f.y;
}

// Moments at a receiver, filtered as widely as the light's disc spreads what shadows it. Twin: ShadowMaps::soft_moments.
fn soft_moments(
    maps: texture_2d_array<f32>,
    layer: u32,
    view: ShadowView,
    point_world: vec3f,
    c: ShadowCoord,
    options: vec3f,
) -> vec4f {
    if !(view.softness > 0.0) {
        return sample_moments(maps, layer, view.size, c.uv, 0u);
    }
    let levels = level_count(view.size);
    let perspective = view.perspective > 0.5;
    let slant = select(1.0, length(point_world - view.origin_world) / (c.depth * view.far), perspective);
    let wide = level_of(penumbra_sigma(view.softness, perspective, slant, 0.5 * c.depth, c.depth), levels);
    let search = sample_moments(maps, layer, view.size, c.uv, wide.level + u32(wide.fraction >= 0.5));
    let occluder = occluder_depth(options.z != 0.0, search, c.depth, options.x);
    let own = level_of(penumbra_sigma(view.softness, perspective, slant, occluder, c.depth), levels);
    let fine = sample_moments(maps, layer, view.size, c.uv, own.level);
    if own.fraction > 0.0 {
        return fine + (sample_moments(maps, layer, view.size, c.uv, own.level + 1u) - fine) * own.fraction;
    }
    return fine;
}

// Fraction of light that a view's moments let through to a point; 1 outside of the view.
// * options: min_variance, light_bleed_reduction, and whether the map holds exponential warps
fn view_visibility(maps: texture_2d_array<f32>, layer: u32, view: ShadowView, point_world: vec3f, options: vec3f) -> f32 {
    let c = shadow_project(view, point_world);
    if !(c.in_front && all(c.uv >= vec2f(0.0)) && all(c.uv <= vec2f(1.0))) {
        return 1.0;
    }
    let moments = soft_moments(maps, layer, view, point_world, c, options);
    if options.z != 0.0 {
        return evsm_visibility(moments, c.depth, options.x, options.y);
    }
    return chebyshev_upper_bound(moments.xy, c.depth, options.x, options.y);
}
