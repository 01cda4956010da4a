//! Virtual point lights: instant radiosity.

use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// A diffuse reflection of light (or a piece of an emissive surface) that lights others.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vpl {
    /// On a surface, world space.
    pub position_world: Vec3,
    /// Unit shading normal on the side that was lit.
    pub normal_world: Vec3,
    /// Reflected radiant flux Φ per channel in W: incident flux times albedo. Zero: an empty slot.
    pub flux: Vec3,
    /// Bound on the error of `position_world`, metres: visibility rays end this far off the surface.
    pub error: f32,
}

/// Bounded geometry term min(cos_x · cos_y / d², bound), 1/m².
///
/// * `to_vpl`: from the lit point to the VPL, world space
///
/// Zero where either faces away or the distance is 0. Twin: `shaders/shared/vpl.wgsl` (tests/twins.rs).
/// Source: Keller, "Instant Radiosity", SIGGRAPH 1997.
#[inline(always)]
pub fn geometry_term(to_vpl: Vec3, n: Vec3, normal_vpl: Vec3, geometry_term_max: f32) -> f32 {
    // Comparisons rather than f32::max: they are single instructions in the wide kernels, which share this function.
    let positive = |x: f32| if x > 0.0 { x } else { 0.0 };
    let d2 = to_vpl.x * to_vpl.x + to_vpl.y * to_vpl.y + to_vpl.z * to_vpl.z;
    let cos_x = positive(n.x * to_vpl.x + n.y * to_vpl.y + n.z * to_vpl.z);
    let cos_y = positive(-(normal_vpl.x * to_vpl.x + normal_vpl.y * to_vpl.y + normal_vpl.z * to_vpl.z));
    // The two unnormalised cosines carry d each: (cos_x d)(cos_y d)/d⁴.
    let d4 = d2 * d2;
    let g = cos_x * cos_y / if d4 > f32::MIN_POSITIVE { d4 } else { f32::MIN_POSITIVE };
    if g < geometry_term_max { g } else { geometry_term_max }
}

/// Irradiance of one VPL at a point, (Φ/π) · G in W/m², so that radiance = base_color/π · this.
///
/// Twin: `shaders/shared/vpl.wgsl` (tests/twins.rs).
#[inline]
pub fn vpl_irradiance(vpl: &Vpl, point_world: Vec3, n: Vec3, geometry_term_max: f32) -> Vec3 {
    vpl.flux * FRAC_1_PI * geometry_term(vpl.position_world - point_world, n, vpl.normal_world, geometry_term_max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_vpl_matches_the_paper_value() {
        // ../shared/analytic vpl_contribution: rho 0.5, flux 2, distance 2, both cosines 1.
        let vpl = Vpl {
            position_world: Vec3::new(0.0, 2.0, 0.0),
            normal_world: Vec3::NEG_Y,
            flux: Vec3::splat(2.0),
            ..Vpl::default()
        };
        let radiance = vpl_irradiance(&vpl, Vec3::ZERO, Vec3::Y, f32::INFINITY) * (0.5 * FRAC_1_PI);
        assert!((radiance.x - 0.025_330_296).abs() < 1e-8);
        assert_eq!(vpl_irradiance(&vpl, Vec3::ZERO, Vec3::NEG_Y, f32::INFINITY), Vec3::ZERO);
        assert_eq!(vpl_irradiance(&vpl, vpl.position_world, Vec3::Y, 10.0), Vec3::ZERO);
        assert!((vpl_irradiance(&vpl, Vec3::ZERO, Vec3::Y, 0.1).x - 2.0 * 0.1 * FRAC_1_PI).abs() < 1e-7);
    }
}
