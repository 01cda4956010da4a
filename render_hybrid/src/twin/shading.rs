//! Reflection models and optics. Directions point away from the surface; `n` is unit and on the viewer's side.

use catoptra_engine::math;
use glam::Vec3;
use std::f32::consts::PI;

/// Normalisation of the Blinn-Phong lobe, (α+8)/(8π), 1/sr.
///
/// Source: Akenine-Möller et al., "Real-Time Rendering", 3rd ed., 2008, section 7.6.
#[inline]
pub fn blinn_phong_normalization(shininess: f32) -> f32 {
    (shininess + 8.0) / (8.0 * PI)
}

/// Blinn-Phong lobe (α+8)/(8π) · max(0, N·H)^α, 1/sr, without k_s and N·L.
///
/// Twin: `shaders/shared/shading.wgsl` (tests/twins.rs). Source: Blinn, "Models of Light Reflection", SIGGRAPH 1977.
#[inline]
pub fn blinn_phong_lobe(n: Vec3, wi: Vec3, wo: Vec3, shininess: f32) -> f32 {
    let h = wi + wo;
    let length_squared = h.dot(h);
    if length_squared <= 0.0 {
        return 0.0; // Light exactly behind the surface: no half vector.
    }
    let n_dot_h = n.dot(h) / length_squared.sqrt();
    if n_dot_h <= 0.0 {
        return 0.0;
    }
    blinn_phong_normalization(shininess) * math::pow(n_dot_h.min(1.0), shininess)
}

/// Mirror direction of `wo` about `n`: 2(N·V)N − V.
#[inline(always)]
pub fn reflect(wo: Vec3, n: Vec3) -> Vec3 {
    n * (2.0 * n.dot(wo)) - wo
}

/// Snell's refraction of the direction of travel `d` (unit, towards the surface) at `n` (against `d`), with
/// `eta` = n_from / n_to. `None` at total internal reflection.
#[inline]
pub fn refract(d: Vec3, n: Vec3, eta: f32) -> Option<Vec3> {
    let (t, passes) = refract_or_total(d, n, eta);
    passes.then_some(t)
}

/// As [`refract`] without a branch: the direction, and false at total internal reflection.
#[inline(always)]
pub(crate) fn refract_or_total(d: Vec3, n: Vec3, eta: f32) -> (Vec3, bool) {
    let cos_i = -n.dot(d);
    let sin2_i = 1.0 - cos_i * cos_i;
    let sin2_t = eta * eta * if sin2_i > 0.0 { sin2_i } else { 0.0 };
    let passes = sin2_t < 1.0;
    let cos_t = (if passes { 1.0 - sin2_t } else { 0.0 }).sqrt();
    let t = d * eta + n * (eta * cos_i - cos_t);
    (t / t.dot(t).sqrt(), passes)
}

/// Exact unpolarised Fresnel reflectance of a dielectric, in [0, 1]; 1 at total internal reflection.
///
/// F = (R_s + R_p)/2. * `cos_i`: cosine on the incident side, in [0, 1]; * `eta`: n_from / n_to.
/// Computed in double precision: near the critical angle f32 loses the sine's complement.
///
/// Twin: `shaders/shared/shading.wgsl` (f32, tests/twins.rs).
#[inline(always)]
pub fn fresnel_dielectric(cos_i: f32, eta: f32) -> f32 {
    let cos_i = if cos_i > 0.0 { cos_i } else { 0.0 };
    let (c1, eta) = (f64::from(if cos_i < 1.0 { cos_i } else { 1.0 }), f64::from(eta));
    let sin2_t = eta * eta * (1.0 - c1 * c1);
    let total = sin2_t >= 1.0;
    let c2 = (if total { 0.0 } else { 1.0 - sin2_t }).sqrt();
    let rs = (eta * c1 - c2) / (eta * c1 + c2);
    let rp = (eta * c2 - c1) / (eta * c2 + c1);
    if total { 1.0 } else { (0.5 * (rs * rs + rp * rp)) as f32 }
}

/// Schlick's raise of a mirror's tint at grazing angles: F0 + (1 − F0)(1 − cos)^5.
///
/// Source: Schlick, "An Inexpensive BRDF Model", Eurographics 1994.
#[inline(always)]
pub fn schlick(f0: Vec3, cos_i: f32) -> Vec3 {
    let x = 1.0 - cos_i;
    let x = if x > 0.0 { x } else { 0.0 };
    let x = if x < 1.0 { x } else { 1.0 };
    let x2 = x * x;
    f0 + (Vec3::ONE - f0) * (x2 * x2 * x)
}

/// Beer-Lambert transmittance per channel after `distance` metres: color^(distance / attenuation_distance).
#[inline]
pub fn beer_lambert(attenuation_color: Vec3, attenuation_distance: f32, distance: f32) -> Vec3 {
    if attenuation_distance == f32::INFINITY || attenuation_color == Vec3::ONE || distance <= 0.0 {
        return Vec3::ONE;
    }
    beer_lambert_of_ln(ln_color(attenuation_color), attenuation_distance, distance)
}

/// Logarithm of each channel, at most 0.
#[inline]
pub fn ln_color(color: Vec3) -> Vec3 {
    let ln = |c: f32| if c < 1.0 { math::ln(c) } else { 0.0 };
    Vec3::new(ln(color.x), ln(color.y), ln(color.z))
}

/// [`beer_lambert`] where [`ln_color`] is known: e^(distance/attenuation_distance · ln c), whose smallest value is nothing to
/// see.
#[inline]
pub fn beer_lambert_of_ln(ln: Vec3, attenuation_distance: f32, distance: f32) -> Vec3 {
    if attenuation_distance == f32::INFINITY || ln == Vec3::ZERO || distance <= 0.0 {
        return Vec3::ONE;
    }
    let x = distance / attenuation_distance;
    let channel = |ln: f32| if ln < 0.0 { math::exp_moderate((ln * x).max(-80.0)) } else { 1.0 };
    Vec3::new(channel(ln.x), channel(ln.y), channel(ln.z))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fresnel_matches_the_paper_values() {
        // ../shared/analytic fresnel_dielectric, ior 1.5.
        let deg = |d: f32| math::cos(d.to_radians());
        for (angle, expected) in
            [(0.0, 0.04), (45.0, 0.050_239_91), (60.0, 0.089_186_71), (75.0, 0.253_060_56), (85.0, 0.612_799_6)]
        {
            assert!((fresnel_dielectric(deg(angle), 1.0 / 1.5) - expected).abs() < 2e-6, "{angle} degrees from air");
        }
        for (angle, expected) in [(0.0, 0.04), (30.0, 0.055_190_17), (41.0, 0.379_751_26), (45.0, 1.0)] {
            let f = fresnel_dielectric(deg(angle), 1.5);
            assert!((f - expected).abs() < 2e-6 * 4.0, "{angle} degrees from inside: {f}");
        }
    }

    #[test]
    fn refraction_obeys_snell() {
        let d = Vec3::new(0.6, -0.8, 0.0);
        let t = refract(d, Vec3::Y, 1.0 / 1.5).unwrap();
        assert!((t.x - 0.4).abs() < 1e-6 && t.y < 0.0);
        assert!(refract(Vec3::new(0.8, -0.6, 0.0), Vec3::Y, 1.5).is_none());
    }

    #[test]
    fn blinn_phong_albedo_is_near_one() {
        // Albedo of the lobe at normal incidence by quadrature. The common normalisation is an approximation: it passes 1 by up
        // to 7.5% (at α = 10) and tends to 1 for sharp lobes.
        for (shininess, most) in [(1.0f32, 1.03), (10.0, 1.08), (100.0, 1.02), (1000.0, 1.003)] {
            let (steps, mut sum) = (20_000, 0.0f64);
            for i in 0..steps {
                let cos_o = (i as f32 + 0.5) / steps as f32;
                let wo = Vec3::new((1.0 - cos_o * cos_o).sqrt(), 0.0, cos_o);
                sum += f64::from(blinn_phong_lobe(Vec3::Z, Vec3::Z, wo, shininess) * cos_o) * std::f64::consts::TAU
                    / f64::from(steps);
            }
            assert!(sum > 0.5 && sum < most, "albedo {sum} at shininess {shininess}");
        }
    }
}
