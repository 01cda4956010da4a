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
/// e to the power `x` for |x| <= 80: without branches, so that loops over flat arrays become wide instructions, and with one
/// order of operations at every width. Error below 2 ulp; NaN and numbers out of range give some finite or infinite number.
///
/// 2^k · e^r with k whole and |r| <= ln 2 / 2, e^r by its series to the seventh power.
#[inline(always)]
pub fn exp_moderate(x: f32) -> f32 {
    // Adding 1.5 · 2^23 rounds to a whole number, which then stands in the low bits.
    const ROUND: f32 = 12_582_912.0;
    const LN_2_HIGH: f32 = 0.693_359_375;
    const LN_2_LOW: f32 = -2.121_944_4e-4;
    let shifted = x * std::f32::consts::LOG2_E + ROUND;
    let k = shifted - ROUND;
    let r = (x - k * LN_2_HIGH) - k * LN_2_LOW;
    let mut p = r * (1.0 / 5040.0) + 1.0 / 720.0;
    p = p * r + 1.0 / 120.0;
    p = p * r + 1.0 / 24.0;
    p = p * r + 1.0 / 6.0;
    p = p * r + 0.5;
    let p = (p * (r * r) + r) + 1.0;
    let exponent = shifted.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127);
    p * f32::from_bits(exponent << 23)
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
    fn the_moderate_exponential_is_within_two_ulps() {
        let (mut x, mut worst) = (-80.0f32, 0.0f64);
        while x <= 80.0 {
            let exact = libm::exp(f64::from(x));
            let error = (f64::from(exp_moderate(x)) - exact).abs() / (exact * f64::from(f32::EPSILON));
            worst = worst.max(error);
            x += 0.001_37;
        }
        assert!(worst < 2.0, "{worst} ulps");
        assert_eq!(exp_moderate(0.0), 1.0);
    }

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
