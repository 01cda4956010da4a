//! Stone floor of court and galleries: the part that makes the count exact.

use super::{COURT, DEPTH, colors};
use catoptra_engine::shapes::ShapeBuilder;
use glam::Vec3;

/// Side of a slab, metres.
const SLAB: f32 = 0.65;

/// Lays slabs over the whole ground with exactly `triangles` triangles: each is a fan around its middle over at least
/// four points of its rim; those left over go to the first slabs' rims, one each, round and round.
///
/// # Panics
/// Where there are fewer than four triangles a slab.
pub fn build(b: &mut ShapeBuilder, triangles: usize) {
    let nx = ((COURT[0] + DEPTH + 0.25) / SLAB).ceil() as i32;
    let nz = ((COURT[1] + DEPTH + 0.25) / SLAB).ceil() as i32;
    let slabs = (4 * nx * nz) as usize;
    let (each, extra) = (triangles / slabs, triangles % slabs);
    assert!(each >= 4, "{triangles} triangles are too few for {slabs} slabs");
    let mut number = 0;
    for j in -nz..nz {
        for i in -nx..nx {
            let rim = each + usize::from(number < extra);
            number += 1;
            slab(b, i, j, rim);
        }
    }
}

fn slab(b: &mut ShapeBuilder, i: i32, j: i32, rim: usize) {
    let (x0, z0) = (i as f32 * SLAB, j as f32 * SLAB);
    let (x1, z1) = ((i + 1) as f32 * SLAB, (j + 1) as f32 * SLAB);
    let corners = [[x0, z0], [x0, z1], [x1, z1], [x1, z0]];
    let mut points = Vec::with_capacity(rim);
    for k in 0..4 {
        // Side k gets its share of the rim's points.
        let n = rim / 4 + usize::from(k < rim % 4);
        let (p, q) = (corners[k], corners[(k + 1) % 4]);
        points.extend((0..n).map(|s| {
            let t = s as f32 / n as f32;
            Vec3::new(p[0] + (q[0] - p[0]) * t, 0.0, p[1] + (q[1] - p[1]) * t)
        }));
    }
    let middle = Vec3::new((x0 + x1) * 0.5, 0.0, (z0 + z1) * 0.5);
    let color = color(i, j);
    let center = b.vertices([(middle, Vec3::Y)], color);
    let first = b.vertices(points.iter().map(|&p| (p, Vec3::Y)), color);
    let n = points.len() as u32;
    b.triangles((0..n).map(|s| [center, first + s, first + (s + 1) % n]));
}

/// A border of red stone around the court, a chequer within it, plain slabs in the galleries; each a little different.
fn color(i: i32, j: i32) -> Vec3 {
    let (x, z) = ((i as f32 + 0.5) * SLAB, (j as f32 + 0.5) * SLAB);
    let from_edge = (COURT[0] - x.abs()).min(COURT[1] - z.abs());
    let kind = if from_edge < 0.0 {
        0
    } else if (0.65..1.3).contains(&from_edge) {
        2
    } else {
        ((i + j) & 1) as usize
    };
    // A fixed scramble of the slab's number: stone is never one shade.
    let mut h = (i as u32).wrapping_mul(0x9e37_79b9) ^ (j as u32).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    let shade = 0.88 + 0.20 * ((h >> 8) & 0xff) as f32 / 255.0;
    colors::PAVING[kind] * shade
}
