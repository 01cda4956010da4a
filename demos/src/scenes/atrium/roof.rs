//! Cornices with dentils, the tiled eave, the roof that keeps the sun out of the galleries, and banners.

use super::{Bay, COURT, DEPTH, STOREYS, THICK, colors, lathe};
use catoptra_engine::{math, shapes::ShapeBuilder};
use glam::Vec3;
use std::f32::consts::PI;

/// Dentils and tiles stand this far apart.
const PITCH: f32 = 0.26;

/// Cornices, dentils, eave and roof.
pub fn build(b: &mut ShapeBuilder) {
    for storey in STOREYS {
        let reach = if storey.upper { 0.30 } else { 0.16 };
        cornice(b, storey.top, reach);
        dentils(b, storey.top - 0.34, reach * 0.55);
    }
    eave(b, STOREYS[1].top + 0.06);
}

/// Corner `k` of the rectangle that lies `inside` metres within the arcade walls' court faces.
fn loop_corner(k: usize, inside: f32, y: f32) -> Vec3 {
    let (x, z) = (COURT[0] - THICK / 2.0 - inside, COURT[1] - THICK / 2.0 - inside);
    let s = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)][k % 4];
    Vec3::new(x * s.0, y, z * s.1)
}

/// Moulding around the court, mitred at the corners. 8 · 9 = 72 triangles.
fn cornice(b: &mut ShapeBuilder, top: f32, reach: f32) {
    // (towards the court, height): from under the wall's face out, up and back onto the top.
    let r = reach;
    let profile = [
        (-0.02, -0.22),
        (r * 0.25, -0.22),
        (r * 0.30, -0.17),
        (r * 0.55, -0.15),
        (r * 0.62, -0.10),
        (r * 0.85, -0.06),
        (r, -0.04),
        (r, 0.02),
        (r * 0.9, 0.05),
        (-THICK - 0.1, 0.05),
    ];
    for k in 0..4 {
        for p in profile.windows(2) {
            let at = |corner: usize, (inside, y): (f32, f32)| loop_corner(corner, inside, top + y);
            b.quad([at(k, p[0]), at(k + 1, p[0]), at(k + 1, p[1]), at(k, p[1])], colors::MARBLE);
        }
    }
}

/// Places along the four sides: (point on the wall's face, direction along, direction into the court).
fn along_sides(mut f: impl FnMut(Vec3, Vec3, Vec3)) {
    for k in 0..4 {
        let (p, q) = (loop_corner(k, 0.0, 0.0), loop_corner(k + 1, 0.0, 0.0));
        let length = (q - p).length();
        let along = (q - p) / length;
        let inwards = Vec3::Y.cross(-along);
        let n = (length / PITCH) as usize;
        for i in 0..n {
            let s = (i as f32 + 0.5) * length / n as f32;
            f(p + along * s, along, inwards);
        }
    }
}

/// Row of small blocks under a cornice: 12 triangles each.
fn dentils(b: &mut ShapeBuilder, y: f32, reach: f32) {
    along_sides(|p, along, inwards| {
        let axes = [along, Vec3::Y, along.cross(Vec3::Y)];
        // The third axis points along or against the way into the court.
        let side = axes[2].dot(inwards);
        let (low, high) = if side > 0.0 { (-0.02, reach) } else { (-reach, 0.02) };
        lathe::block(b, p + Vec3::Y * y, axes, Vec3::new(-0.07, 0.0, low), Vec3::new(0.07, 0.12, high), colors::MARBLE);
    });
}

/// Half-round tiles at the roof's edge, 12 triangles each, and the roof behind them, 16 triangles.
fn eave(b: &mut ShapeBuilder, y: f32) {
    let (edge, radius) = (0.42, PITCH * 0.46);
    let slope = 0.32;
    let mut number = 0usize;
    along_sides(|p, along, inwards| {
        let shade = [1.0, 0.86, 0.94, 0.78, 0.9][number * 7 % 5];
        number += 1;
        let ring = |k: usize, inside: f32| {
            let (s, c) = math::sin_cos(PI * k as f32 / 6.0);
            let rise = y + 0.02 + (edge - inside) * slope + radius * s;
            let n = along * -c + Vec3::Y * s;
            (p + along * (-radius * c) + inwards * inside + Vec3::Y * rise, n)
        };
        let front = b.vertices((0..7).map(|k| ring(k, edge)), colors::TILE * shade);
        let back = b.vertices((0..7).map(|k| ring(k, -0.9)), colors::TILE * shade);
        for k in 0..6 {
            b.triangles([[front + k, back + k + 1, front + k + 1], [front + k, back + k, back + k + 1]]);
        }
    });
    // Roof: rises from the edge to the outer walls, with a board under the overhang.
    let (far_x, far_z) = (COURT[0] + DEPTH + 0.4, COURT[1] + DEPTH + 0.4);
    let far = |k: usize, y: f32| {
        let s = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)][k % 4];
        Vec3::new(far_x * s.0, y, far_z * s.1)
    };
    for k in 0..4 {
        let inner = |k: usize| loop_corner(k, edge - 0.03, y);
        let high = y + (DEPTH + 0.8) * slope;
        b.quad([inner(k), inner(k + 1), far(k + 1, high), far(k, high)], colors::TILE * 0.8);
        let under = |k: usize| loop_corner(k, -THICK - 0.2, y - 0.02);
        let lip = |k: usize| loop_corner(k, edge - 0.03, y - 0.02);
        b.quad([under(k), under(k + 1), lip(k + 1), lip(k)], colors::DOOR * 1.4);
        b.quad([lip(k), lip(k + 1), inner(k + 1), inner(k)], colors::DOOR * 1.4);
        // A curtain at the outer end closes what lies between the walls' tops and the roof.
        b.quad(
            [far(k, STOREYS[1].top - 0.5), far(k + 1, STOREYS[1].top - 0.5), far(k + 1, high), far(k, high)],
            colors::TILE,
        );
    }
}

/// Cells of a banner across and down.
const BANNER: [usize; 2] = [16, 24];

/// A banner that hangs over the balustrade of every second bay of the long sides. 768 triangles.
pub fn banner(b: &mut ShapeBuilder, bay: &Bay) {
    let long_side = bay.out.z != 0.0;
    if !long_side || !bay.number.is_multiple_of(2) {
        return;
    }
    let color = colors::BANNER[bay.number / 2 % 3];
    let (half, top, length) = (0.78, STOREYS[1].floor + 0.99, 2.3);
    let phase = bay.number as f32 * 1.7;
    let point = |i: f32, j: f32| {
        let (u, v) = (i / BANNER[0] as f32 * 2.0 - 1.0, j / BANNER[1] as f32);
        // It lies over the rail for a hand's breadth, then hangs free with folds that open downwards.
        let fold = 0.055 * v * math::sin(9.0 * u + phase + 1.5 * v) + 0.025 * v * math::sin(17.0 * u - phase);
        let narrow = half * (1.0 - 0.06 * v);
        let swing = 0.10 * math::sin(2.2 * v + phase);
        let lip = (-v / 0.03).max(-1.0);
        bay.at(narrow * u, top - length * v, lip * 0.42 - fold + swing * v * 0.5 - 0.02)
    };
    let color_at = |j: usize| {
        let v = j as f32 / BANNER[1] as f32;
        if (0.80..0.86).contains(&v) { Vec3::new(0.75, 0.56, 0.16) } else { color }
    };
    for j in 0..=BANNER[1] {
        let row = (0..=BANNER[0]).map(|i| {
            let (i, y) = (i as f32, j as f32);
            let across = point(i + 0.3, y) - point(i - 0.3, y);
            let down = point(i, y + 0.3) - point(i, (y - 0.3).max(0.0));
            (point(i, y), down.cross(across).normalize_or(-bay.out))
        });
        let first = b.vertices(row, color_at(j));
        if j > 0 {
            let width = BANNER[0] as u32 + 1;
            for i in 0..BANNER[0] as u32 {
                let (above, here) = (first - width + i, first + i);
                b.triangles([[above, here, here + 1], [above, here + 1, above + 1]]);
            }
        }
    }
}
