#import shared/scene

// Where a line meets a triangle: weights of the second and third vertex, kept inside the triangle.
//
// The rasteriser has already decided that the pixel belongs to the triangle; a centre that lies a rounding error outside
// is drawn to its rim. Source: Möller & Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection", 1997.
fn plane_barycentrics(origin: vec3f, direction: vec3f, p0: vec3f, p1: vec3f, p2: vec3f) -> vec2f {
    // Edges of any size in, edges of about 1 through the products, so that tiny scenes stay in range.
    let largest = max(abs(p1 - p0), abs(p2 - p0));
    let scale = 1.0 / max(max(largest.x, max(largest.y, largest.z)), 1e-30);
    let e1 = (p1 - p0) * scale;
    let e2 = (p2 - p0) * scale;
    let from_p0 = (origin - p0) * scale;
    let p = cross(direction, e2);
    let determinant = dot(e1, p);
    if determinant == 0.0 {
        return vec2f(1.0 / 3.0);
    }
    let u = max(dot(from_p0, p) / determinant, 0.0);
    let v = max(dot(direction, cross(from_p0, e1)) / determinant, 0.0);
    return vec2f(u, v) / max(u + v, 1.0);
}

// Directions of growing u and of growing v, up to a common positive factor. Twin: trace/surface.rs, tangents.
struct Tangents {
    along_u: vec3f,
    along_v: vec3f,
}

fn tangents(e1: vec3f, e2: vec3f, duv1: vec2f, duv2: vec2f) -> Tangents {
    let det = duv1.x * duv2.y - duv2.x * duv1.y;
    if det == 0.0 {
        return Tangents(vec3f(0.0), vec3f(0.0));
    }
    let s = select(1.0, -1.0, det < 0.0);
    return Tangents((e1 * duv2.y - e2 * duv1.y) * s, (e2 * duv1.x - e1 * duv2.x) * s);
}

// Twin: trace/surface.rs, perturbed_normal.
fn perturbed_normal(n: vec3f, along_u: vec3f, along_v: vec3f, texel: vec3f, normal_scale: f32) -> vec3f {
    let m = max(abs(along_u), abs(along_v));
    let size = max(m.x, max(m.y, m.z));
    if !(size > 0.0 && size < 3e38) {
        return n;
    }
    let u = along_u * (1.0 / size);
    let v = along_v * (1.0 / size);
    let t0 = u - n * dot(n, u);
    let l = length(t0);
    if l <= 1e-6 {
        return n;
    }
    let t = t0 * (1.0 / l);
    let across = cross(n, t);
    let b = select(across, -across, dot(across, v) > 0.0);
    let c = texel * 2.0 - 1.0;
    return normalize_or(t * (c.x * normal_scale) + b * (c.y * normal_scale) + n * c.z, n);
}
