//! A camera and a light for files that bring none.

use crate::{
    camera::{Camera, Projection},
    components::LightSource,
    light::LightKind,
    math,
    mesh::Aabb,
};
use glam::Vec3;

/// Full vertical angle of the fitted camera, radians.
const FOV_Y: f32 = std::f32::consts::FRAC_PI_4;

/// Camera that sees all of `bounds` in any picture at least as wide as high: three-quarter view from the front right and
/// a little above, the bounding sphere touching the picture's top and bottom, with a margin of 5%.
///
/// Bounds without a size are treated as a sphere of one metre radius. Portrait pictures cut the sides.
pub fn fit_camera(bounds: Aabb) -> Camera {
    let (center, radius) = sphere(&bounds);
    let distance = 1.05 * radius / math::sin(FOV_Y * 0.5);
    let eye = center + Vec3::new(0.45, 0.3, 1.0).normalize() * distance;
    let near = (distance - radius) * 0.5;
    Camera { near, ..Camera::looking_at(eye, center, FOV_Y) }
}

/// Light at the eye, shining where `camera` looks: it has the camera's pose. No shadow of it can be seen from there.
///
/// Its intensity makes a white Lambert surface that faces it at the middle of `bounds` have radiance 1: π d². Seen from
/// outside it is a spot whose cone holds the bounding sphere; from inside, or with a camera that looks elsewhere, a
/// point light whose d is at least a quarter of the sphere's radius.
pub fn headlight(camera: &Camera, bounds: Aabb) -> LightSource {
    let (center, radius) = sphere(&bounds);
    let to_center = center - camera.world_from_view.translation;
    let distance = to_center.length();
    let lit = distance.max(0.25 * radius);
    let intensity = Vec3::splat(std::f32::consts::PI * lit * lit);
    let point = LightSource { kind: LightKind::Point, intensity, radius: 0.0 };
    let outside = distance > 1.01 * radius;
    if !outside || matches!(camera.projection, Projection::Orthographic { .. }) {
        return point;
    }
    // Angle between the view axis and the far side of the sphere.
    let axis = -camera.world_from_view.matrix3.z_axis;
    let inner = math::acos(axis.dot(to_center) / distance) + math::asin(radius / distance);
    if inner > 1.3 {
        return point;
    }
    let kind = LightKind::Spot { cos_inner: math::cos(inner), cos_outer: math::cos(inner + 0.1) };
    LightSource { kind, ..point }
}

fn sphere(bounds: &Aabb) -> (Vec3, f32) {
    let (center, radius) = (bounds.center(), bounds.radius());
    if radius > 0.0 && radius.is_finite() && center.is_finite() {
        (center, radius)
    } else {
        (if center.is_finite() { center } else { Vec3::ZERO }, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Picture position of a world point, both in [-1, 1] where it is seen.
    fn project(camera: &Camera, p: Vec3) -> (f32, f32) {
        let v = camera.world_from_view.inverse().transform_point3(p);
        let (half_w, half_h) = camera.half_extent(100, 100);
        (v.x / -v.z / half_w, v.y / -v.z / half_h)
    }

    #[test]
    fn every_corner_is_seen_and_lit() {
        for (min, max) in
            [([-1.0; 3], [1.0; 3]), ([100.0, 0.0, -3.0], [101.0, 9.0, -2.0]), ([0.0; 3], [1e-6, 2e-6, 1e-7])]
        {
            let bounds = Aabb { min: Vec3::from(min), max: Vec3::from(max) };
            let camera = fit_camera(bounds);
            let light = headlight(&camera, bounds);
            let LightKind::Spot { cos_inner, .. } = light.kind else { panic!("seen from outside it is a spot") };
            for corner in bounds.corners() {
                let (x, y) = project(&camera, corner);
                assert!(x.abs() <= 1.0 && y.abs() <= 1.0, "{corner} falls at {x}, {y}");
                let v = camera.world_from_view.inverse().transform_point3(corner);
                assert!(-v.z > camera.near);
                assert!(-v.z / v.length() >= cos_inner - 1e-5);
            }
            let d = (bounds.center() - camera.world_from_view.translation).length();
            assert!((light.intensity.x / (d * d) / std::f32::consts::PI - 1.0).abs() < 1e-5);
        }
    }

    #[test]
    fn nothing_to_see_is_harmless() {
        let camera = fit_camera(Aabb::EMPTY);
        assert!(camera.world_from_view.is_finite() && camera.near > 0.0);
        assert!(headlight(&camera, Aabb::EMPTY).intensity.is_finite());
        let inside = headlight(&Camera::default(), Aabb { min: Vec3::splat(-5.0), max: Vec3::splat(5.0) });
        assert_eq!(inside.kind, LightKind::Point);
    }
}
