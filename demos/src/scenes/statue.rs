//! The statue: a draped female torso on a plinth, as a surface that is star-shaped around its upright axis.
//!
//! Each ring of the torso lies in a horizontal plane around a gently swaying axis point; its outline is an ellipse-like
//! curve with different depths in front and behind, to which breasts, shoulders, face, hair, knee and the folds of the
//! robe are added as smooth bumps. 129 bands of 121 segments make 31,218 triangles; the plinth, a lathed square with 23
//! rings, takes up the 180 that are missing to 31,398.

use catoptra_engine::{Mesh, MeshData, math, shapes::ShapeBuilder};
use glam::{Vec2, Vec3};
use std::f32::consts::TAU;

/// Outlines between the two poles.
const RINGS: usize = 129;
const SEGMENTS: usize = 121;
/// Height of the figure alone in its own units (a person's metres), and of the plinth below it.
const FIGURE: f32 = 1.76;
const PLINTH: f32 = 0.42;
/// The figure's first pole lies this deep in the plinth, so that no gap shows.
const SUNK: f32 = 0.012;

/// The two parts, standing on y = 0 around the Y axis, facing +Z.
pub struct StatueMeshes {
    /// Draped torso: 31,218 triangles, closed.
    pub torso: Mesh,
    /// Plinth: 180 triangles, closed.
    pub plinth: Mesh,
}

/// The statue at the given height in metres, plinth included.
pub fn statue_meshes(height: f32) -> StatueMeshes {
    let scale = height / (FIGURE + PLINTH);
    StatueMeshes { torso: torso(scale), plinth: plinth(scale) }
}

/// A ring of the figure before bumps: height, half width, depth in front and behind, axis point (x, z); metres.
type Key = [f32; 6];

/// Keys: parameter along the body (rings are spaced evenly in it), then the outline.
#[rustfmt::skip]
const KEYS: [(f32, Key); 30] = [
    //  u       y      width  front  back   x       z
    (0.000, [0.000, 0.000, 0.000, 0.000,  0.000,  0.000]),
    (0.030, [0.000, 0.235, 0.215, 0.215,  0.000,  0.000]),
    (0.050, [0.030, 0.248, 0.228, 0.225,  0.000,  0.000]),
    (0.100, [0.110, 0.222, 0.205, 0.200,  0.000,  0.000]),
    (0.200, [0.300, 0.192, 0.176, 0.172,  0.004,  0.000]),
    (0.300, [0.500, 0.186, 0.168, 0.158,  0.010,  0.004]),
    (0.400, [0.700, 0.200, 0.164, 0.166,  0.020,  0.000]),
    (0.460, [0.820, 0.208, 0.150, 0.180,  0.028, -0.004]),
    (0.510, [0.910, 0.200, 0.138, 0.172,  0.030, -0.006]),
    (0.550, [0.985, 0.172, 0.122, 0.136,  0.024, -0.002]),
    (0.590, [1.055, 0.146, 0.108, 0.106,  0.014,  0.004]),
    (0.630, [1.130, 0.148, 0.108, 0.104,  0.004,  0.004]),
    (0.670, [1.205, 0.160, 0.112, 0.108, -0.004,  0.000]),
    (0.710, [1.280, 0.180, 0.110, 0.112, -0.008, -0.004]),
    (0.740, [1.335, 0.200, 0.100, 0.110, -0.010, -0.008]),
    (0.765, [1.378, 0.204, 0.084, 0.098, -0.010, -0.012]),
    (0.785, [1.410, 0.176, 0.070, 0.082, -0.008, -0.014]),
    (0.800, [1.432, 0.124, 0.060, 0.072, -0.006, -0.012]),
    (0.815, [1.455, 0.078, 0.054, 0.064, -0.004, -0.008]),
    (0.835, [1.485, 0.060, 0.052, 0.060, -0.002, -0.002]),
    (0.852, [1.512, 0.057, 0.056, 0.062,  0.000,  0.004]),
    (0.866, [1.534, 0.058, 0.074, 0.070,  0.002,  0.010]),
    (0.880, [1.556, 0.064, 0.086, 0.080,  0.003,  0.012]),
    (0.905, [1.598, 0.072, 0.092, 0.092,  0.004,  0.012]),
    (0.930, [1.642, 0.078, 0.092, 0.100,  0.005,  0.010]),
    (0.950, [1.678, 0.078, 0.086, 0.100,  0.005,  0.006]),
    (0.968, [1.712, 0.070, 0.072, 0.088,  0.005,  0.002]),
    (0.982, [1.738, 0.052, 0.050, 0.064,  0.005, -0.002]),
    (0.992, [1.753, 0.029, 0.027, 0.036,  0.005, -0.006]),
    (1.000, [1.760, 0.000, 0.000, 0.000,  0.005, -0.008]),
];

/// Cubic Hermite through the keys with finite-difference slopes, as in a non-uniform Catmull-Rom spline.
fn outline(u: f32) -> Key {
    let last = KEYS.len() - 1;
    let i = (1..last).find(|&i| u < KEYS[i].0).unwrap_or(last) - 1;
    let slope = |k: usize, c: usize| {
        let (a, b) = (KEYS[k.saturating_sub(1)], KEYS[(k + 1).min(last)]);
        (b.1[c] - a.1[c]) / (b.0 - a.0)
    };
    let (u0, u1) = (KEYS[i].0, KEYS[i + 1].0);
    let h = u1 - u0;
    let t = ((u - u0) / h).clamp(0.0, 1.0);
    let (t2, t3) = (t * t, t * t * t);
    std::array::from_fn(|c| {
        KEYS[i].1[c] * (2.0 * t3 - 3.0 * t2 + 1.0)
            + slope(i, c) * h * (t3 - 2.0 * t2 + t)
            + KEYS[i + 1].1[c] * (3.0 * t2 - 2.0 * t3)
            + slope(i + 1, c) * h * (t3 - t2)
    })
}

fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// exp(-(dx/sx)² - (dy/sy)²).
fn bump(dx: f32, sx: f32, dy: f32, sy: f32) -> f32 {
    let (a, b) = (dx / sx, dy / sy);
    math::exp(-a * a - b * b)
}

/// Point of the figure at `u` along the body and angle `phi` (0 = +X, a quarter turn = +Z = front), own units.
fn figure(u: f32, phi: f32) -> Vec3 {
    let [y, width, front, back, cx, cz] = outline(u);
    let (s, c) = math::sin_cos(phi);
    // Depth goes smoothly from back to front, so that no crease runs down the flanks.
    let depth = back + (front - back) * smoothstep(-1.0, 1.0, s);
    let facing_front = smoothstep(0.0, 0.8, s);
    let facing_back = smoothstep(0.0, 0.8, -s);
    let mut p = Vec2::new(width * c, depth * s);

    // Robe: from the hips down, folds that deepen and widen towards the hem and lean with the body.
    let robe = 1.0 - smoothstep(0.84, 0.93, y + 0.035 * c);
    let lean = phi + 0.55 * (y - 0.4) + 0.25 * math::sin(3.1 * y + 1.0);
    let folds = 0.5 * math::sin(13.0 * lean)
        + 0.35 * math::sin(19.0 * lean + 4.0 * y + 1.3)
        + 0.3 * math::sin(7.0 * lean - 3.0 * y + 0.4);
    let calm = 1.0 - 0.75 * bump(p.x - 0.07, 0.07, y - 0.56, 0.22) * facing_front;
    let deep = 0.05 + 0.085 * smoothstep(0.85, 0.05, y);
    p *= 1.0 + robe * calm * deep * folds;

    // The rolled cloth around the hips hangs lower on one side.
    let roll = y - (0.895 - 0.045 * c + 0.012 * math::sin(9.0 * phi + 2.0));
    p *= 1.0 + 0.10 * bump(roll, 0.026, 0.0, 1.0) + 0.03 * bump(roll + 0.05, 0.016, 0.0, 1.0);

    // Bent knee, breasts, navel, collar, spine, shoulder blades.
    let (x, z) = (p.x, p.y);
    let front_add = 0.050 * bump(x - 0.075, 0.07, y - 0.58, 0.17) * (1.0 - 0.2 * robe)
        + 0.060 * bump(x - 0.076 + cx, 0.062, y - 1.232, 0.060)
        + 0.060 * bump(x + 0.080 + cx, 0.062, y - 1.235, 0.060)
        + 0.012 * bump(x, 0.06, y - 0.99, 0.07)
        - 0.010 * bump(x, 0.013, y - 1.035, 0.014)
        - 0.008 * bump(x, 0.020, y - 1.14, 0.07)
        + 0.006 * bump(x - 0.06, 0.05, y - 1.405, 0.012)
        + 0.006 * bump(x + 0.06, 0.05, y - 1.405, 0.012);
    let back_add = -0.014 * bump(x, 0.022, y - 1.15, 0.16)
        + 0.012 * bump(x - 0.08, 0.045, y - 1.27, 0.06)
        + 0.012 * bump(x + 0.08, 0.045, y - 1.27, 0.06)
        + 0.022 * bump(x - 0.075, 0.07, y - 0.84, 0.08)
        + 0.022 * bump(x + 0.075, 0.07, y - 0.84, 0.08);
    // Face: nose, brow, eyes, lips, chin; hair drawn back into a knot.
    let face = 0.017 * bump(x, 0.011, y - 1.598, 0.020) + 0.010 * bump(x, 0.012, y - 1.585, 0.010)
        - 0.008 * bump(x - 0.030, 0.014, y - 1.618, 0.011)
        - 0.008 * bump(x + 0.030, 0.014, y - 1.618, 0.011)
        + 0.006 * bump(x, 0.020, y - 1.561, 0.008)
        + 0.007 * bump(x, 0.018, y - 1.540, 0.010);
    let hair = smoothstep(1.55, 1.60, y) * (1.0 - facing_front * smoothstep(1.69, 1.655, y));
    let waves = 0.05 * hair * (1.0 + 0.35 * math::sin(26.0 * phi + 30.0 * y)) * smoothstep(1.76, 1.72, y);
    p *= 1.0 + waves;
    p.y += facing_front * (front_add + face)
        - facing_back * (back_add + 0.052 * bump(x, 0.038, y - 1.635, 0.036) * smoothstep(0.0, 0.02, -z));

    // Stumps of the arms: the right one hangs, the left one is raised a little.
    let side =
        |towards: f32, reach: f32, at: f32| reach * bump(y - at, 0.062, p.y, 0.075) * smoothstep(0.35, 0.95, towards);
    p.x += side(c, 0.072, 1.345) - side(-c, 0.060, 1.325);

    // Contrapposto: the axis sways with the outline.
    Vec3::new(p.x + cx, y, p.y + cz)
}

fn torso(scale: f32) -> Mesh {
    let raise = PLINTH - SUNK;
    let place = |p: Vec3| (p + Vec3::Y * raise) * scale;
    let u = |ring: f32| ring / (RINGS as f32 + 1.0);
    // Equal numbers for the first and the last longitude: the mesh closes.
    let phi = |segment: f32| TAU * segment / SEGMENTS as f32;
    let mut data = MeshData::default();
    data.positions.push(place(figure(0.0, 0.0)));
    data.normals.push(Vec3::NEG_Y);
    for ring in 1..=RINGS {
        for segment in 0..SEGMENTS {
            let (r, s) = (ring as f32, segment as f32);
            data.positions.push(place(figure(u(r), phi(s))));
            // Normal from central differences of the surface itself: smoother than from its facets.
            let along = figure(u(r + 0.35), phi(s)) - figure(u(r - 0.35), phi(s));
            let around = figure(u(r), phi(s + 0.35)) - figure(u(r), phi(s - 0.35));
            data.normals.push(along.cross(around).normalize_or(Vec3::Y));
        }
    }
    data.positions.push(place(figure(1.0, 0.0)));
    data.normals.push(Vec3::Y);

    let at = |ring: usize, segment: usize| (1 + (ring - 1) * SEGMENTS + segment % SEGMENTS) as u32;
    let top = (1 + RINGS * SEGMENTS) as u32;
    for s in 0..SEGMENTS {
        data.triangles.push([0, at(1, s), at(1, s + 1)]);
        for ring in 1..RINGS {
            let (a, b, c, d) = (at(ring, s), at(ring, s + 1), at(ring + 1, s + 1), at(ring + 1, s));
            data.triangles.extend([[a, c, b], [a, d, c]]);
        }
        data.triangles.push([at(RINGS, s), top, at(RINGS, s + 1)]);
    }
    Mesh::new(data).expect("the figure's formula gives finite points")
}

/// Half side and height of each ring of the plinth, own units: steps, base moulding, die, cap moulding.
#[rustfmt::skip]
const PLINTH_PROFILE: [(f32, f32); 23] = [
    (0.360, 0.000), (0.360, 0.060), (0.352, 0.068), (0.335, 0.068), (0.335, 0.098), (0.330, 0.106), (0.322, 0.112),
    (0.308, 0.118), (0.300, 0.128), (0.297, 0.140), (0.295, 0.155), (0.290, 0.250), (0.288, 0.330), (0.290, 0.338),
    (0.297, 0.344), (0.308, 0.350), (0.316, 0.358), (0.324, 0.368), (0.326, 0.378), (0.335, 0.380), (0.335, 0.408),
    (0.330, 0.417), (0.322, 0.420),
];

fn plinth(scale: f32) -> Mesh {
    let corner = |(half, y): (f32, f32), k: usize| {
        let sign = [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)][k % 4];
        Vec3::new(half * sign.0, y, half * sign.1) * scale
    };
    let mut b = ShapeBuilder::default();
    for pair in PLINTH_PROFILE.windows(2) {
        for k in 0..4 {
            let quad = [corner(pair[0], k), corner(pair[0], k + 1), corner(pair[1], k + 1), corner(pair[1], k)];
            b.quad(quad, Vec3::ONE);
        }
    }
    let last = PLINTH_PROFILE[PLINTH_PROFILE.len() - 1];
    b.quad([3, 0, 1, 2].map(|k| corner(last, k)), Vec3::ONE);
    b.quad([2, 1, 0, 3].map(|k| corner(PLINTH_PROFILE[0], k)), Vec3::ONE);
    b.build()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fronts_out(mesh: &Mesh) -> usize {
        mesh.triangles()
            .iter()
            .filter(|t| {
                let [a, b, c] = t.map(|v| mesh.positions()[v as usize]);
                let n = t.iter().map(|&v| mesh.normals()[v as usize]).sum::<Vec3>();
                (b - a).cross(c - a).dot(n) < 0.0
            })
            .count()
    }

    #[test]
    fn counts_are_exact_and_both_parts_bound_a_volume() {
        let m = statue_meshes(2.2);
        assert_eq!((m.torso.triangles().len(), m.plinth.triangles().len()), (31_218, 180));
        assert!(m.torso.closed() && m.plinth.closed());
        assert_eq!(fronts_out(&m.torso), 0, "winding and normals agree");
        assert_eq!(fronts_out(&m.plinth), 0);
        assert!((m.torso.bounds_object().max.y - 2.2 * (1.0 - SUNK / (FIGURE + PLINTH))).abs() < 1e-3);
        assert_eq!(m.plinth.bounds_object().min.y, 0.0);
    }

    #[test]
    fn every_ring_is_star_shaped_around_its_axis() {
        for ring in 1..=RINGS {
            let u = ring as f32 / (RINGS as f32 + 1.0);
            let [_, _, _, _, cx, cz] = outline(u);
            let p = |s: usize| {
                let q = figure(u, TAU * (s % SEGMENTS) as f32 / SEGMENTS as f32);
                Vec2::new(q.x - cx, q.z - cz)
            };
            for s in 0..SEGMENTS {
                assert!(p(s).perp_dot(p(s + 1)) > 0.0, "ring {ring}, segment {s}");
            }
        }
    }
}
