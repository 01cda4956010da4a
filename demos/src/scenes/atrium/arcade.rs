//! Columns, arches and the balustrade between them.

use super::{BAY, Bay, Storey, THICK, colors, lathe};
use catoptra_engine::{math, shapes::ShapeBuilder};
use glam::Vec3;
use std::f32::consts::PI;

/// Half side of a column's plinth and abacus.
const ABACUS: f32 = 0.30;
/// Radius of the arches: what the abaci leave free.
const RADIUS: f32 = BAY / 2.0 - ABACUS;
/// Voussoirs of an arch.
const VOUSSOIRS: usize = 24;
/// Segments of a shaft.
const SEGMENTS: u32 = 16;

/// A column: square plinth, attic base, shaft with entasis, bell capital with a ring, abacus. 536 triangles.
pub fn column(b: &mut ShapeBuilder, place: Vec3, storey: &Storey) {
    let base = place + Vec3::Y * storey.floor;
    let h = storey.spring - storey.floor;
    let shaft = if storey.upper { colors::SHAFT_UPPER } else { colors::SHAFT_LOWER };
    let slab = |b: &mut ShapeBuilder, low: f32, high: f32, half: f32| {
        lathe::block(b, base, lathe::WORLD, Vec3::new(-half, low, -half), Vec3::new(half, high, half), colors::MARBLE);
    };
    slab(b, 0.0, 0.16, ABACUS);
    // Base 5 points, shaft 5, capital 9; neighbours share their end points' places.
    let foot = [(0.28, 0.16), (0.285, 0.21), (0.25, 0.25), (0.262, 0.29), (0.215, 0.33)];
    lathe::lathe(b, base, &foot, SEGMENTS, colors::MARBLE);
    let s = |t: f32| 0.33 + (h - 0.78 - 0.33) * t;
    let body = [(0.208, s(0.0)), (0.206, s(0.3)), (0.200, s(0.6)), (0.188, s(0.85)), (0.178, s(1.0))];
    lathe::lathe(b, base, &body, SEGMENTS, shaft);
    let c = |y: f32| h - 0.78 + y;
    let capital = [
        (0.205, c(0.00)),
        (0.215, c(0.03)),
        (0.195, c(0.06)),
        (0.185, c(0.14)),
        (0.200, c(0.28)),
        (0.225, c(0.42)),
        (0.260, c(0.54)),
        (0.285, c(0.60)),
        (0.270, c(0.64)),
    ];
    lathe::lathe(b, base, &capital, SEGMENTS, colors::MARBLE);
    slab(b, h - 0.14, h, ABACUS);
}

/// Wall above two columns with a round arch in it, a raised ring of voussoirs on the court's side. 300 triangles.
pub fn arch(b: &mut ShapeBuilder, bay: &Bay, storey: &Storey) {
    let plaster = if storey.upper { colors::PLASTER_UPPER } else { colors::PLASTER };
    let (spring, top) = (storey.spring, storey.top);
    let arc = |k: usize, radius: f32| {
        let (s, c) = math::sin_cos(PI * k as f32 / VOUSSOIRS as f32);
        // Equal ends on both sides, to the bit.
        let c = if k == 0 {
            1.0
        } else if k == VOUSSOIRS {
            -1.0
        } else {
            c
        };
        let s = if k == 0 || k == VOUSSOIRS { 0.0 } else { s };
        (-radius * c, spring + radius * s)
    };
    let front = -THICK / 2.0;
    let back = THICK / 2.0;
    for out in [front, back] {
        // Seen from its own side the face runs counter-clockwise.
        let mut face = |q: [(f32, f32); 4]| {
            let mut p = q.map(|(x, y)| bay.at(x, y, out));
            if out > 0.0 {
                p.reverse();
            }
            b.quad(p, plaster);
        };
        for k in 0..VOUSSOIRS {
            let (p, q) = (arc(k, RADIUS), arc(k + 1, RADIUS));
            face([p, q, (q.0, top), (p.0, top)]);
        }
        face([(-bay.half, spring), (-RADIUS, spring), (-RADIUS, top), (-bay.half, top)]);
        face([(RADIUS, spring), (bay.half, spring), (bay.half, top), (RADIUS, top)]);
    }
    // Undersides of the two ends, on the abaci.
    for (l, r) in [(-bay.half, -RADIUS), (RADIUS, bay.half)] {
        b.quad(
            [bay.at(l, spring, back), bay.at(r, spring, back), bay.at(r, spring, front), bay.at(l, spring, front)],
            plaster,
        );
    }
    // Soffit, then the raised ring: front, outer rim, inner rim.
    let (ring, raised) = (RADIUS + 0.2, front - 0.06);
    for k in 0..VOUSSOIRS {
        let stone = colors::VOUSSOIR[k % 2];
        let [(ax, ay), (bx, by)] = [arc(k, RADIUS), arc(k + 1, RADIUS)];
        let [(cx, cy), (dx, dy)] = [arc(k, ring), arc(k + 1, ring)];
        let mut strip = |q: [Vec3; 4]| {
            b.quad(q, stone);
        };
        strip([bay.at(ax, ay, front), bay.at(ax, ay, back), bay.at(bx, by, back), bay.at(bx, by, front)]);
        strip([bay.at(ax, ay, raised), bay.at(bx, by, raised), bay.at(dx, dy, raised), bay.at(cx, cy, raised)]);
        strip([bay.at(cx, cy, raised), bay.at(dx, dy, raised), bay.at(dx, dy, front), bay.at(cx, cy, front)]);
        strip([bay.at(ax, ay, raised), bay.at(ax, ay, front), bay.at(bx, by, front), bay.at(bx, by, raised)]);
    }
}

/// Seven balusters between a foot and a rail. 7 · 128 + 24 = 920 triangles.
pub fn balustrade(b: &mut ShapeBuilder, bay: &Bay, storey: &Storey) {
    let origin = bay.at(0.0, storey.floor, 0.0);
    let axes = [bay.along, Vec3::Y, bay.along.cross(Vec3::Y)];
    let reach = bay.half - 0.2;
    let mut beam = |low: f32, high: f32, deep: f32| {
        lathe::block(b, origin, axes, Vec3::new(-reach, low, -deep), Vec3::new(reach, high, deep), colors::MARBLE);
    };
    beam(0.0, 0.14, 0.12);
    beam(0.86, 0.98, 0.14);
    for k in 0..7 {
        let base = bay.at((k as f32 - 3.0) * 0.29, storey.floor + 0.14, 0.0);
        let profile = [
            (0.075, 0.00),
            (0.075, 0.06),
            (0.045, 0.10),
            (0.080, 0.20),
            (0.088, 0.28),
            (0.060, 0.42),
            (0.038, 0.56),
            (0.065, 0.64),
            (0.070, 0.72),
        ];
        lathe::lathe(b, base, &profile, 8, colors::MARBLE);
    }
}
