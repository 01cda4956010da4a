// Variance shadow maps. Twins: twin/shadow.rs.

struct ShadowView {
    origin_world: vec3f,
    far: f32,
    right_scaled: vec3f,
    perspective: f32,
    up_scaled: vec3f,
    size: u32,
    forward: vec3f,
    light: u32,
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

// Moments at `uv`, clamped at the rim. By hand: filtering of 32-bit floats is optional in wgpu. Twin: ShadowMaps::sample.
fn sample_moments(maps: texture_2d_array<f32>, layer: u32, size: u32, uv: vec2f) -> vec4f {
    let p = clamp(uv * f32(size) - 0.5, vec2f(0.0), vec2f(f32(size) - 1.0));
    let low = vec2u(p);
    let high = min(low + 1u, vec2u(size - 1u));
    let f = p - vec2f(low);
    let m00 = textureLoad(maps, low, layer, 0);
    let m10 = textureLoad(maps, vec2u(high.x, low.y), layer, 0);
    let m01 = textureLoad(maps, vec2u(low.x, high.y), layer, 0);
    let m11 = textureLoad(maps, high, layer, 0);
    let a = m00 + (m10 - m00) * f.x;
    let b = m01 + (m11 - m01) * f.x;
    return a + (b - a) * f.y;
}

// Fraction of light that a view's moments let through to a point; 1 outside of the view.
// * options: min_variance, light_bleed_reduction, and whether the map holds exponential warps
fn view_visibility(maps: texture_2d_array<f32>, layer: u32, view: ShadowView, point_world: vec3f, options: vec3f) -> f32 {
    let c = shadow_project(view, point_world);
    if !(c.in_front && all(c.uv >= vec2f(0.0)) && all(c.uv <= vec2f(1.0))) {
        return 1.0;
    }
    let moments = sample_moments(maps, layer, view.size, c.uv);
    if options.z != 0.0 {
        return evsm_visibility(moments, c.depth, options.x, options.y);
    }
    return chebyshev_upper_bound(moments.xy, c.depth, options.x, options.y);
}
