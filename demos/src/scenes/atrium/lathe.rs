//! Turned and sawn pieces.

use catoptra_engine::{math, shapes::ShapeBuilder};
use glam::{Vec2, Vec3};
use std::f32::consts::TAU;

/// Surface of revolution about the upright through `base`: profile of (radius, height above the base) from the bottom up,
/// open at both ends, smooth normals. 2 · segments · (points − 1) triangles.
pub fn lathe(b: &mut ShapeBuilder, base: Vec3, profile: &[(f32, f32)], segments: u32, color: Vec3) {
    let last = profile.len() - 1;
    let point = |i: usize| Vec2::new(profile[i].0, profile[i].1);
    let mut first = 0;
    for (i, &(radius, height)) in profile.iter().enumerate() {
        let tangent = point((i + 1).min(last)) - point(i.saturating_sub(1));
        let n = Vec2::new(tangent.y, -tangent.x).normalize_or(Vec2::X);
        let ring = (0..segments).map(|s| {
            let (sin, cos) = math::sin_cos(TAU * s as f32 / segments as f32);
            let around = |radius: f32, y: f32| Vec3::new(radius * cos, y, -radius * sin);
            (base + around(radius, height), around(n.x, n.y))
        });
        let at = b.vertices(ring, color);
        if i == 0 {
            first = at;
        }
    }
    let at = |i: u32, s: u32| first + i * segments + s % segments;
    for i in 0..last as u32 {
        for s in 0..segments {
            let (p, q, r, t) = (at(i, s), at(i, s + 1), at(i + 1, s + 1), at(i + 1, s));
            b.triangles([[p, q, r], [p, r, t]]);
        }
    }
}

/// Box between two corners in a frame (origin, three unit axes, right-handed): 12 triangles.
pub fn block(b: &mut ShapeBuilder, origin: Vec3, axes: [Vec3; 3], min: Vec3, max: Vec3, color: Vec3) {
    let at = |x: f32, y: f32, z: f32| origin + axes[0] * x + axes[1] * y + axes[2] * z;
    let (l, h) = (min, max);
    for q in [
        [at(l.x, l.y, l.z), at(l.x, l.y, h.z), at(l.x, h.y, h.z), at(l.x, h.y, l.z)],
        [at(h.x, l.y, h.z), at(h.x, l.y, l.z), at(h.x, h.y, l.z), at(h.x, h.y, h.z)],
        [at(l.x, l.y, l.z), at(h.x, l.y, l.z), at(h.x, l.y, h.z), at(l.x, l.y, h.z)],
        [at(l.x, h.y, h.z), at(h.x, h.y, h.z), at(h.x, h.y, l.z), at(l.x, h.y, l.z)],
        [at(h.x, l.y, l.z), at(l.x, l.y, l.z), at(l.x, h.y, l.z), at(h.x, h.y, l.z)],
        [at(l.x, l.y, h.z), at(h.x, l.y, h.z), at(h.x, h.y, h.z), at(l.x, h.y, h.z)],
    ] {
        b.quad(q, color);
    }
}

/// World axes, for [`block`].
pub const WORLD: [Vec3; 3] = [Vec3::X, Vec3::Y, Vec3::Z];
