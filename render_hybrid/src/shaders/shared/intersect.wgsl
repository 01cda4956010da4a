// Rays against boxes and triangles. Twins: accel/ray_space.rs, accel/triangle.rs.
//
// An edge function a·b − c·d is trusted where f32 surely has its sign; elsewhere it is computed in whole numbers, exactly.
// So its sign is right whatever a driver makes of a multiplication and a subtraction, and closed meshes have no gaps.

struct Ray {
    origin: vec3f,
    t_min: f32,
    direction: vec3f,
    // FAR_AWAY: no end.
    t_max: f32,
}

struct Hit {
    t: f32,
    u: f32,
    v: f32,
    // NONE: nothing was met.
    instance: u32,
    primitive: u32,
}

struct RaySpace {
    // The origin with its axes in the order (kx, ky, kz), kz the direction's main axis.
    origin_k: vec3f,
    main_axis: u32,
    // Woop, Benthin & Wald, "Watertight Ray/Triangle Intersection", JCGT 2013.
    shear: vec3f,
    reach: f32,
    inverse: vec3f,
    near: vec3f,
    far: vec3f,
}

const TRIANGLE_MISS: f32 = 0.0;
const TRIANGLE_HIT: f32 = 1.0;
// f32 cannot tell.
const TRIANGLE_HARD: f32 = 2.0;

// Axes in the order (kx, ky, kz).
fn permuted(p: vec3f, main_axis: u32) -> vec3f {
    return select(select(p, p.zxy, main_axis == 1u), p.yzx, main_axis == 0u);
}

fn with_sign(magnitude: f32, like: vec3f) -> vec3f {
    return select(vec3f(magnitude), vec3f(-magnitude), like < vec3f(0.0));
}

// * extent: greatest absolute coordinate of the boxes; slack: multiplies their padding
fn ray_space(origin: vec3f, direction: vec3f, extent: f32, slack: f32) -> RaySpace {
    let a = abs(direction);
    var main_axis = 2u;
    if a.x >= a.y {
        main_axis = select(2u, 0u, a.x >= a.z);
    } else {
        main_axis = select(2u, 1u, a.y >= a.z);
    }
    let least = max(a.x, max(a.y, a.z)) * RAY_LEAST_SLOPE;
    let steep = select(direction, with_sign(least, direction), a < vec3f(least));
    let inverse = vec3f(1.0) / steep;
    let o = abs(origin);
    let reach = max(o.x, max(o.y, o.z)) + extent;
    let pad = with_sign(reach * RAY_PAD * slack, inverse);
    let d = permuted(direction, main_axis);
    let along = permuted(inverse, main_axis).z;
    return RaySpace(
        permuted(origin, main_axis),
        main_axis,
        vec3f(d.x * along, d.y * along, along),
        reach,
        inverse,
        (origin + pad) * inverse,
        (origin - pad) * inverse,
    );
}

// t at which the ray enters a padded box, or -1 where it passes it between t_min and `limit`.
fn box_entry(low_bits: vec3u, high_bits: vec3u, s: RaySpace, t_min: f32, limit: f32) -> f32 {
    let low = bitcast<vec3f>(low_bits);
    let high = bitcast<vec3f>(high_bits);
    let backwards = s.inverse < vec3f(0.0);
    let e = select(low, high, backwards) * s.inverse - s.near;
    let l = select(high, low, backwards) * s.inverse - s.far;
    let enter = max(max(e.x, e.y), max(e.z, t_min));
    let leave = min(min(l.x, l.y), min(l.z, limit));
    return select(-1.0, enter, enter <= leave);
}

// Vertex across the ray, and its distance along the main axis.
fn sheared(s: RaySpace, p: vec3f) -> vec3f {
    let q = permuted(p, s.main_axis) - s.origin_k;
    return vec3f(fma(-s.shear.x, q.z, q.x), fma(-s.shear.y, q.z, q.y), q.z);
}

// Which of three edge functions surely have their sign.
fn surely(edges: vec3f, sizes: vec3f) -> vec3<bool> {
    return abs(edges) > sizes * EDGE_DOUBT;
}

// xyz: t and the weights of the second and third vertex; w: TRIANGLE_MISS, _HIT or _HARD.
fn intersect_fast(s: RaySpace, p0: vec3f, p1: vec3f, p2: vec3f) -> vec4f {
    let a = sheared(s, p0);
    let b = sheared(s, p1);
    let c = sheared(s, p2);
    let plus = vec3f(c.x * b.y, a.x * c.y, b.x * a.y);
    let minus = vec3f(c.y * b.x, a.y * c.x, b.y * a.x);
    let edges = plus - minus;
    let sure = surely(edges, abs(plus) + abs(minus));
    if any(sure & (edges > vec3f(0.0))) && any(sure & (edges < vec3f(0.0))) {
        return vec4f(0.0, 0.0, 0.0, TRIANGLE_MISS);
    }
    let det = edges.x + edges.y + edges.z;
    let m2 = max(max(abs(a.xy), abs(b.xy)), abs(c.xy));
    let m = max(m2.x, m2.y);
    let size = abs(det);
    let sound = m * m * m * TRIANGLE_CONDITION <= size * s.reach && size >= TRIANGLE_DET_MIN && size <= TRIANGLE_DET_MAX;
    if !(all(sure) && sound) {
        return vec4f(0.0, 0.0, 0.0, TRIANGLE_HARD);
    }
    let r = 1.0 / det;
    let t = (edges.x * a.z + edges.y * b.z + edges.z * c.z) * r * s.shear.z;
    return vec4f(t, edges.y * r, edges.z * r, TRIANGLE_HIT);
}

// A whole number of 64 bits: low and high word.
fn add_64(a: vec2u, b: vec2u) -> vec2u {
    let low = a.x + b.x;
    return vec2u(low, a.y + b.y + select(0u, 1u, low < a.x));
}

fn subtract_64(a: vec2u, b: vec2u) -> vec2u {
    return vec2u(a.x - b.x, a.y - b.y - select(0u, 1u, a.x < b.x));
}

fn shift_left_64(a: vec2u, n: u32) -> vec2u {
    if n == 0u {
        return a;
    }
    return vec2u(a.x << n, (a.y << n) | (a.x >> (32u - n)));
}

// The product of two significands of 24 bits.
fn multiply_24(a: u32, b: u32) -> vec2u {
    let low = (a & 0xfffu) * (b & 0xfffu);
    let middle = (a & 0xfffu) * (b >> 12u) + (a >> 12u) * (b & 0xfffu);
    let high = (a >> 12u) * (b >> 12u);
    return add_64(add_64(vec2u(low, 0u), vec2u(middle << 12u, middle >> 20u)), vec2u(high << 24u, high >> 8u));
}

fn significand(bits: u32) -> u32 {
    return select((bits & 0x7fffffu) | 0x800000u, 0u, (bits & 0x7f800000u) == 0u);
}

fn exponent_of(bits: u32) -> i32 {
    return i32((bits >> 23u) & 255u);
}

// a·b − c·d, rounded once: right sign, and 0 only where it is 0. For numbers of at most about 1.
fn exact_difference(a: f32, b: f32, c: f32, d: f32) -> f32 {
    let bits = bitcast<vec4u>(vec4f(a, b, c, d));
    let p = multiply_24(significand(bits.x), significand(bits.y));
    let q = multiply_24(significand(bits.z), significand(bits.w));
    let p_zero = (p.x | p.y) == 0u;
    let q_zero = (q.x | q.y) == 0u;
    let ahead = (exponent_of(bits.x) + exponent_of(bits.y)) - (exponent_of(bits.z) + exponent_of(bits.w));
    if p_zero || q_zero || abs(ahead) > 14 {
        // Nothing cancels.
        return select(a * b, 0.0, p_zero) - select(c * d, 0.0, q_zero);
    }
    let p_aligned = shift_left_64(p, u32(max(ahead, 0)));
    let q_aligned = shift_left_64(q, u32(max(-ahead, 0)));
    let p_negative = ((bits.x ^ bits.y) >> 31u) != 0u;
    let q_negative = ((bits.z ^ bits.w) >> 31u) != 0u;
    var magnitude: vec2u;
    var negative = p_negative;
    if p_negative != q_negative {
        magnitude = add_64(p_aligned, q_aligned);
    } else if p_aligned.y > q_aligned.y || (p_aligned.y == q_aligned.y && p_aligned.x >= q_aligned.x) {
        magnitude = subtract_64(p_aligned, q_aligned);
    } else {
        magnitude = subtract_64(q_aligned, p_aligned);
        negative = !negative;
    }
    // 2 x (127 + 23) of bias; in two steps, each within the range of exponents.
    let exponent = exponent_of(bits.x) + exponent_of(bits.y) - max(ahead, 0) - 300;
    let value = (f32(magnitude.y) * 4294967296.0 + f32(magnitude.x)) * 5.9604645e-8;
    let half_way = (exponent + 24) / 2;
    let scaled = scaled_by(scaled_by(value, half_way), exponent + 24 - half_way);
    return select(scaled, -scaled, negative);
}

// value · 2^exponent; far too small becomes 0.
fn scaled_by(value: f32, exponent: i32) -> f32 {
    return value * bitcast<f32>(u32(clamp(exponent + 127, 1, 254)) << 23u);
}

// intersect_fast with exact edge functions; never TRIANGLE_HARD.
fn intersect_exact(s: RaySpace, p0: vec3f, p1: vec3f, p2: vec3f) -> vec4f {
    let a0 = sheared(s, p0);
    let b0 = sheared(s, p1);
    let c0 = sheared(s, p2);
    let m2 = max(max(abs(a0.xy), abs(b0.xy)), abs(c0.xy));
    // A power of two that brings the greatest coordinate to about 1, so that no product leaves the range.
    let scale = bitcast<f32>(u32(clamp(254 - exponent_of(bitcast<u32>(max(m2.x, m2.y))), 1, 254)) << 23u);
    let a = a0.xy * scale;
    let b = b0.xy * scale;
    let c = c0.xy * scale;
    let u = exact_difference(c.x, b.y, c.y, b.x);
    let v = exact_difference(a.x, c.y, a.y, c.x);
    let w = exact_difference(b.x, a.y, b.y, a.x);
    let outside = (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0);
    let det = u + v + w;
    if outside || det == 0.0 {
        return vec4f(0.0, 0.0, 0.0, TRIANGLE_MISS);
    }
    // Weights of one sign, none lost to cancellation: the place is a mean of the vertices.
    let r = 1.0 / det;
    return vec4f((u * r) * a0.z + (v * r) * b0.z + (w * r) * c0.z, v * r, w * r, TRIANGLE_HIT)
        * vec4f(s.shear.z, 1.0, 1.0, 1.0);
}
