//! Transcendental functions with the same bits on every machine.
//!
//! The platform's own `sinf`, `powf` and the like differ between systems in the last bit, so all of Catoptra calls these
//! (pure Rust, from the `libm` crate, error below 1 ulp unless said). `clippy.toml` forbids the std ones.

use glam::Vec3;

/// Sine of `x` radians.
#[inline]
pub fn sin(x: f32) -> f32 {
    libm::sinf(x)
}
/// Cosine of `x` radians.
#[inline]
pub fn cos(x: f32) -> f32 {
    libm::cosf(x)
}
/// (sin x, cos x) of `x` radians.
#[inline]
pub fn sin_cos(x: f32) -> (f32, f32) {
    libm::sincosf(x)
}
/// Tangent of `x` radians.
#[inline]
pub fn tan(x: f32) -> f32 {
    libm::tanf(x)
}
/// Arc cosine in radians; `x` is clamped to [-1, 1].
#[inline]
pub fn acos(x: f32) -> f32 {
    libm::acosf(x.clamp(-1.0, 1.0))
}
/// Arc sine in radians; `x` is clamped to [-1, 1].
#[inline]
pub fn asin(x: f32) -> f32 {
    libm::asinf(x.clamp(-1.0, 1.0))
}
/// Angle of the point (x, y) in radians, in [-π, π].
#[inline]
pub fn atan2(y: f32, x: f32) -> f32 {
    libm::atan2f(y, x)
}
/// e to the power `x`.
#[inline]
pub fn exp(x: f32) -> f32 {
    libm::expf(x)
}
/// 2 to the power `x`.
#[inline]
pub fn exp2(x: f32) -> f32 {
    libm::exp2f(x)
}
/// Natural logarithm.
#[inline]
pub fn ln(x: f32) -> f32 {
    libm::logf(x)
}
/// `x` to the power `y`.
#[inline]
pub fn pow(x: f32, y: f32) -> f32 {
    libm::powf(x, y)
}
/// Sine of `x` radians, double precision.
#[inline]
pub fn sin_f64(x: f64) -> f64 {
    libm::sin(x)
}
/// Cosine of `x` radians, double precision.
#[inline]
pub fn cos_f64(x: f64) -> f64 {
    libm::cos(x)
}

/// Two unit vectors that make a right-handed orthonormal basis (t, b, n) with the unit vector `n`.
///
/// Source: Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 2017.
#[inline]
pub fn orthonormal_basis(n: Vec3) -> (Vec3, Vec3) {
    let sign = if n.z >= 0.0 { 1.0 } else { -1.0 };
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    (Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), Vec3::new(b, sign + n.y * n.y * a, -n.y))
}

/// Transfer from linear light in [0, 1] to sRGB in [0, 1] (IEC 61966-2-1). Values outside are clamped; NaN becomes 0.
#[inline]
pub fn srgb_from_linear(x: f32) -> f32 {
    let x = if x > 0.0 { x.min(1.0) } else { 0.0 };
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * pow(x, 1.0 / 2.4) - 0.055 }
}

/// Transfer from sRGB in [0, 1] to linear light in [0, 1] (IEC 61966-2-1).
#[inline]
pub fn linear_from_srgb(x: f32) -> f32 {
    if x <= 0.040_45 { x / 12.92 } else { pow((x + 0.055) / 1.055, 2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_round_trip() {
        for i in 0..=255u32 {
            let s = i as f32 / 255.0;
            let back = srgb_from_linear(linear_from_srgb(s));
            assert!((back - s).abs() < 1e-5, "{s} came back as {back}");
        }
        assert_eq!(srgb_from_linear(f32::NAN), 0.0);
        assert!((srgb_from_linear(7.0) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn basis_is_orthonormal_and_right_handed() {
        for n in [Vec3::X, Vec3::NEG_Z, Vec3::Z, Vec3::new(0.6, -0.48, 0.64)] {
            let (t, b) = orthonormal_basis(n);
            assert!(t.dot(b).abs() < 1e-6 && t.dot(n).abs() < 1e-6 && b.dot(n).abs() < 1e-6);
            assert!((t.cross(b) - n).length() < 1e-6);
        }
    }
}
