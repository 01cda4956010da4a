//! The ray-triangle test: one arithmetic, written here for one triangle and lane-wise in `simd`.
//!
//! Contract: the answer is a function of ray and triangle alone. Vertices are translated to the ray's origin and sheared
//! so that the ray is the main axis (Woop, Benthin & Wald 2013); each vertex's two numbers depend on the ray and that
//! vertex only, so triangles that share a vertex agree on where it is. The edge function a·b − c·d in f32 without FMA is
//! exactly antisymmetric, and because rounding is monotone its sign is never wrong, only possibly zero. A zero is decided
//! in double precision, where products of f32 are exact. So a closed mesh has no gaps, and an open edge is not fattened.
//!
//! Barycentrics come from the same edge functions where they are well conditioned, else from the double-precision ones.

#[cfg(test)]
use super::ray_space::RaySpace;

/// |det| outside of `DET_MIN..=DET_MAX`: double precision, so that nothing under- or overflows.
pub(crate) const DET_MIN: f32 = 1e-18;
/// See [`DET_MIN`].
pub(crate) const DET_MAX: f32 = 1e18;
/// f32 barycentrics are used where |det|·reach ≥ m³·`CONDITION`, m the greatest sheared coordinate: their error, at most
/// 12·2⁻²⁴·m²/|det|, then moves the hit by at most 48·2⁻²⁴·reach, which the padding of boxes holds.
pub(crate) const CONDITION: f32 = 0.25;

/// Distance and barycentric weights of the second and third vertex.
pub(crate) type Tuv = (f32, f32, f32);

#[cfg(test)]
/// Sheared (x, y) and unsheared main-axis distance of a vertex.
#[inline(always)]
pub(crate) fn sheared(ray: &RaySpace, p: [f32; 3]) -> [f32; 3] {
    let [kx, ky, kz] = ray.k;
    let z = p[kz] - ray.origin[kz];
    [(p[kx] - ray.origin[kx]) - ray.shear[0] * z, (p[ky] - ray.origin[ky]) - ray.shear[1] * z, z]
}

/// Line-triangle test of sheared vertices in double precision from exact edge functions. `None`: outside, or degenerate.
#[cold]
#[inline(never)]
pub(crate) fn exact(a: [f32; 3], b: [f32; 3], c: [f32; 3], sz: f32) -> Option<Tuv> {
    let [a, b, c] = [a, b, c].map(|p| p.map(f64::from));
    let u = c[0] * b[1] - c[1] * b[0];
    let v = a[0] * c[1] - a[1] * c[0];
    let w = b[0] * a[1] - b[1] * a[0];
    if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
        return None;
    }
    let det = u + v + w;
    if det == 0.0 || !det.is_finite() {
        return None;
    }
    let t = (u * a[2] + v * b[2] + w * c[2]) / det * f64::from(sz);
    Some((t as f32, (v / det) as f32, (w / det) as f32))
}

#[cfg(test)]
/// The whole test for one triangle, lane-free: what the kernels must equal bit for bit; `None` where the line misses. The range of t is the caller's.
#[inline(always)]
pub(crate) fn intersect(ray: &RaySpace, corners: [[f32; 3]; 3]) -> Option<Tuv> {
    let [a, b, c] = corners.map(|p| sheared(ray, p));
    let u = c[0] * b[1] - c[1] * b[0];
    let v = a[0] * c[1] - a[1] * c[0];
    let w = b[0] * a[1] - b[1] * a[0];
    let outside = (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0);
    if outside || u.is_nan() || v.is_nan() || w.is_nan() {
        return None;
    }
    let det = (u + v) + w;
    let m = [a, b, c].iter().fold(0.0f32, |m, p| m.max(p[0].abs()).max(p[1].abs()));
    let well = det.abs() * ray.reach >= ((m * m) * m) * CONDITION;
    let in_range = det.abs() >= DET_MIN && det.abs() <= DET_MAX;
    if u == 0.0 || v == 0.0 || w == 0.0 || !well || !in_range {
        return exact(a, b, c, ray.shear[2]);
    }
    let r = 1.0 / det;
    let t = (((u * a[2] + v * b[2]) + w * c[2]) * r) * ray.shear[2];
    Some((t, v * r, w * r))
}
