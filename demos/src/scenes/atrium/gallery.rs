//! Behind the arches: cross vaults, outer walls with doors below and shuttered windows above, the upper floor.

use super::{BAY, Bay, COURT, DEPTH, Storey, bays, colors};
use catoptra_engine::{math, shapes::ShapeBuilder};
use glam::Vec3;
use std::f32::consts::PI;

/// Cells a side of a vault's grid.
const CELLS: usize = 10;
/// Segments of a door's arch.
const ARC: usize = 12;

/// Everything of one storey's gallery.
pub fn build(b: &mut ShapeBuilder, storey: &Storey) {
    for bay in bays() {
        let middle = bay.at(0.0, 0.0, DEPTH / 2.0);
        vault(b, middle, bay.along * (BAY / 2.0), bay.out * (DEPTH / 2.0), storey);
        wall(b, &bay, storey);
    }
    for (sx, sz) in [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)] {
        let half = DEPTH / 2.0;
        let middle = Vec3::new(sx * (COURT[0] + half), 0.0, sz * (COURT[1] + half));
        vault(b, middle, Vec3::X * half, Vec3::Z * half, storey);
        corner(b, sx, sz, storey);
    }
    upper_floor(b, storey);
}

/// Cross vault over the rectangle middle ± a ± c: the higher of two elliptic barrels. 2 · CELLS² triangles.
fn vault(b: &mut ShapeBuilder, middle: Vec3, a: Vec3, c: Vec3, storey: &Storey) {
    let rise = storey.top - storey.spring - 0.28;
    // Cosine spacing: equal angles along both barrels, and the groins run through the grid's diagonals.
    let node = |i: usize| if i == CELLS / 2 { 0.0 } else { -math::cos(PI * i as f32 / CELLS as f32) };
    let bow = |t: f32| (1.0 - t * t).max(0.0).sqrt();
    let point = |i: usize, j: usize| {
        let (u, v) = (node(i), node(j));
        middle + a * u + c * v + Vec3::Y * (storey.spring + rise * bow(u).max(bow(v)))
    };
    // Downward normal of the barrel that curves across `t` (direction `axis`, half width its length).
    let normal = |t: f32, axis: Vec3| {
        let up = bow(t);
        let half = axis.length();
        -(axis / half * (t / half) + Vec3::Y * (up / rise)).normalize_or(Vec3::Y)
    };
    for i in 0..CELLS {
        for j in 0..CELLS {
            // In each quarter the diagonal follows the groin.
            let groin = (i < CELLS / 2) == (j < CELLS / 2);
            let quad = [(i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j)];
            let halves = if groin { [[0, 1, 2], [0, 2, 3]] } else { [[0, 1, 3], [1, 2, 3]] };
            for half in halves {
                let nodes = half.map(|k| quad[k]);
                let mean = |f: fn(&(usize, usize)) -> usize| nodes.iter().map(|n| node(f(n))).sum::<f32>() / 3.0;
                let (u, v) = (mean(|n| n.0), mean(|n| n.1));
                let corners = nodes.map(|(i, j)| {
                    let n = if u.abs() < v.abs() { normal(node(i), a) } else { normal(node(j), c) };
                    (point(i, j), n)
                });
                let [p, q, r] = corners.map(|x| x.0);
                let first = b.vertices(corners, colors::VAULT);
                let seen_from_below = (q - p).cross(r - p).y < 0.0;
                b.triangles([if seen_from_below {
                    [first, first + 1, first + 2]
                } else {
                    [first, first + 2, first + 1]
                }]);
            }
        }
    }
}

/// Outer wall of a bay with an arched opening: face, reveal and leaf. 76 triangles.
fn wall(b: &mut ShapeBuilder, bay: &Bay, storey: &Storey) {
    let plaster = if storey.upper { colors::PLASTER_UPPER } else { colors::PLASTER };
    let leaf = if storey.upper { colors::SHUTTER } else { colors::DOOR };
    let half = if storey.upper { 0.5 } else { 0.62 };
    let sill = storey.floor + if storey.upper { 0.95 } else { 0.0 };
    let spring = storey.floor + if storey.upper { 1.9 } else { 2.05 };
    let (face, back) = (DEPTH, DEPTH + 0.25);
    let arc = |k: usize| {
        let (s, c) = math::sin_cos(PI * k as f32 / ARC as f32);
        let (s, c) = if k == 0 {
            (0.0, 1.0)
        } else if k == ARC {
            (0.0, -1.0)
        } else {
            (s, c)
        };
        (-half * c, spring + half * s)
    };
    let (floor, top) = (storey.floor, storey.top);
    let mut quad = |q: [(f32, f32); 4], out: f32, color: Vec3| {
        b.quad(q.map(|(x, y)| bay.at(x, y, out)), color);
    };
    quad([(-bay.half, floor), (-half, floor), (-half, top), (-bay.half, top)], face, plaster);
    quad([(half, floor), (bay.half, floor), (bay.half, top), (half, top)], face, plaster);
    if sill > floor {
        quad([(-half, floor), (half, floor), (half, sill), (-half, sill)], face, plaster);
    }
    for k in 0..ARC {
        let (p, q) = (arc(k), arc(k + 1));
        quad([p, q, (q.0, top), (p.0, top)], face, plaster);
    }
    quad([(-half, sill), (half, sill), (half, spring), (-half, spring)], back, leaf);
    let mut reveal = |p: (f32, f32), q: (f32, f32)| {
        let corners = [bay.at(p.0, p.1, face), bay.at(p.0, p.1, back), bay.at(q.0, q.1, back), bay.at(q.0, q.1, face)];
        b.quad(corners, colors::MARBLE);
    };
    reveal((-half, sill), (-half, spring));
    reveal((half, spring), (half, sill));
    reveal((half, sill), (-half, sill));
    for k in 0..ARC {
        reveal(arc(k), arc(k + 1));
    }
    // The leaf's round top: a fan over the arc.
    for k in 1..ARC {
        let [p, q, r] = [arc(0), arc(k), arc(k + 1)].map(|(x, y)| bay.at(x, y, back));
        b.triangle([p, r, q], leaf);
    }
}

/// The two plain walls of a corner. 4 triangles.
fn corner(b: &mut ShapeBuilder, sx: f32, sz: f32, storey: &Storey) {
    let plaster = if storey.upper { colors::PLASTER_UPPER } else { colors::PLASTER };
    let far = [sx * (COURT[0] + DEPTH), sz * (COURT[1] + DEPTH)];
    let near = [sx * COURT[0], sz * COURT[1]];
    let (low, high) = (storey.floor, storey.top);
    let mut quad = |p: [f32; 2], q: [f32; 2]| {
        let at = |p: [f32; 2], y: f32| Vec3::new(p[0], y, p[1]);
        let corners = [at(p, low), at(q, low), at(q, high), at(p, high)];
        let n = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let inwards = n.dot(-at(p, 0.0)) > 0.0;
        b.quad(if inwards { corners } else { [corners[1], corners[0], corners[3], corners[2]] }, plaster);
    };
    quad([far[0], near[1]], far);
    quad([near[0], far[1]], far);
}

/// Floor of the upper gallery: four strips. 8 triangles; nothing for the lower storey.
fn upper_floor(b: &mut ShapeBuilder, storey: &Storey) {
    if !storey.upper {
        return;
    }
    let y = storey.floor;
    let (ix, iz) = (COURT[0] - 0.35, COURT[1] - 0.35);
    let (ox, oz) = (COURT[0] + DEPTH + 0.3, COURT[1] + DEPTH + 0.3);
    let mut strip = |x: [f32; 2], z: [f32; 2]| {
        let at = |x: f32, z: f32| Vec3::new(x, y, z);
        b.quad([at(x[0], z[1]), at(x[1], z[1]), at(x[1], z[0]), at(x[0], z[0])], colors::PAVING[0]);
    };
    strip([-ox, ox], [-oz, -iz]);
    strip([-ox, ox], [iz, oz]);
    strip([-ox, -ix], [-iz, iz]);
    strip([ix, ox], [-iz, iz]);
}
