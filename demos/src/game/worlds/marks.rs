//! Marks for those who cannot tell the colours apart: each colour has a number of pips, on the box, the tiles and the lamps,
//! and gates that are shut are crossed out.

use super::hall::SIX;
use catoptra_engine::{Mesh, math, shapes::ShapeBuilder};
use glam::{Vec2, Vec3};

/// Pips of each colour: those of opposite sides of the box make seven, as on a die.
pub const PIPS: [usize; 6] = [1, 6, 2, 5, 3, 4];
/// How far pips stand out, metres: less than the gap under a box, enough for any depth buffer.
const LIFT: f32 = 6e-4;
/// What a pip leaves of the colour that it lies on.
const DARK: f32 = 0.13;
/// Corners of a pip.
const CORNERS: u32 = 12;

/// Places of the pips in [-1, 1]².
fn places(count: usize) -> Vec<Vec2> {
    let diagonal = [Vec2::new(-1.0, 1.0), Vec2::new(1.0, -1.0)];
    let other = [Vec2::ONE, Vec2::NEG_ONE];
    let sides = [Vec2::NEG_X, Vec2::X];
    let mut places = Vec::new();
    if count % 2 == 1 {
        places.push(Vec2::ZERO);
    }
    for (least, pair) in [(2, diagonal), (4, other), (6, sides)] {
        if count >= least {
            places.extend(pair);
        }
    }
    places
}

/// Adds the pips of `hue` to a rectangle whose half sides are `right` and `up`; they look along right x up. `size`: of a pip, as a
/// share of the shorter half side.
fn pips(b: &mut ShapeBuilder, hue: usize, center: Vec3, right: Vec3, up: Vec3, size: f32, color: Vec3) {
    let radius = right.length().min(up.length()) * size;
    let (x, y) = (right.normalize(), up.normalize());
    let center = center + x.cross(y) * LIFT;
    for place in places(PIPS[hue]) {
        let middle = center + right * (0.52 * place.x) + up * (0.52 * place.y);
        let corner = |i: u32| {
            let (s, c) = math::sin_cos(std::f32::consts::TAU * (i % CORNERS) as f32 / CORNERS as f32);
            middle + (x * c + y * s) * radius
        };
        for i in 0..CORNERS {
            b.triangle([middle, corner(i), corner(i + 1)], color);
        }
    }
}

/// Corners of a rectangle by its half sides, seen from where right x up points to.
fn face(center: Vec3, right: Vec3, up: Vec3) -> [Vec3; 4] {
    [center - right - up, center + right - up, center + right + up, center - right + up]
}

/// Half sides of the six sides of a box, right x up outwards, in the order of the colours.
fn sides(half: Vec3) -> [(Vec3, Vec3, Vec3); 6] {
    let (x, y, z) = (Vec3::X * half.x, Vec3::Y * half.y, Vec3::Z * half.z);
    [(-x, z, y), (x, y, z), (-y, x, z), (y, z, x), (-z, y, x), (z, x, y)]
}

/// The six-coloured box with its pips.
pub fn six_box(half: f32) -> Mesh {
    let mut b = ShapeBuilder::default();
    for (hue, (center, right, up)) in sides(Vec3::splat(half)).into_iter().enumerate() {
        b.quad(face(center, right, up), SIX[hue]);
        pips(&mut b, hue, center, right, up, 0.15, SIX[hue] * DARK);
    }
    b.build()
}

/// A white slab with the pips of a colour on top, turned to the viewer at +Z.
pub fn slab(half: Vec3, hue: usize) -> Mesh {
    let mut b = ShapeBuilder::default();
    for (center, right, up) in sides(half) {
        b.quad(face(center, right, up), Vec3::ONE);
    }
    let top = Vec3::Y * half.y;
    pips(&mut b, hue, top, Vec3::X * half.x, Vec3::NEG_Z * half.z, 0.15, Vec3::splat(DARK));
    b.build()
}

/// An upright pane of 2 `half` metres whose front looks along `normal`.
pub fn pane(center: Vec3, normal: Vec3, half: [f32; 2]) -> Mesh {
    ShapeBuilder::default().quad(face(center, Vec3::Y.cross(normal) * half[0], Vec3::Y * half[1]), Vec3::ONE).build()
}

/// As [`pane`], with the pips of a colour.
pub fn pane_of(hue: usize, center: Vec3, normal: Vec3, half: [f32; 2]) -> Mesh {
    let (right, up) = (Vec3::Y.cross(normal) * half[0], Vec3::Y * half[1]);
    let mut b = ShapeBuilder::default();
    b.quad(face(center, right, up), Vec3::ONE);
    pips(&mut b, hue, center, right, up, 0.23, Vec3::splat(DARK));
    b.build()
}

/// As [`pane`], crossed out.
pub fn crossed_pane(center: Vec3, normal: Vec3, half: [f32; 2]) -> Mesh {
    let (right, up) = (Vec3::Y.cross(normal) * half[0], Vec3::Y * half[1]);
    let mut b = ShapeBuilder::default();
    b.quad(face(center, right, up), Vec3::ONE);
    for slope in [1.0, -1.0] {
        // A bar almost from corner to corner, in front of the pane.
        let along = right * 0.9 + up * (0.9 * slope);
        let across = normal.cross(along).normalize() * (0.13 * half[0].min(half[1]));
        b.quad(face(center + normal * 0.01, along, across), Vec3::splat(0.02));
    }
    b.build()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_have_different_pips_and_opposite_sides_make_seven() {
        for hue in 0..6 {
            assert_eq!(PIPS[hue] + PIPS[hue ^ 1], 7);
            let places = places(PIPS[hue]);
            assert_eq!(places.len(), PIPS[hue]);
            assert!(places.iter().enumerate().all(|(i, p)| !places[..i].contains(p)));
        }
        let mut all = PIPS;
        all.sort_unstable();
        assert_eq!(all, [1, 2, 3, 4, 5, 6]);
    }

    #[test]
    fn everything_looks_outwards() {
        let mesh = six_box(0.25);
        assert_eq!(mesh.triangles().len(), 12 + 21 * CORNERS as usize);
        for t in mesh.triangles() {
            let [a, b, c] = t.map(|i| mesh.positions()[i as usize]);
            let normal = (b - a).cross(c - a);
            assert!(normal.dot(a + b + c) > 0.0);
            // Nothing stands out further than the gap under a box allows.
            assert!((a.abs().max_element() - 0.25) <= LIFT + 1e-6);
        }
        for mesh in [pane_of(2, Vec3::ZERO, Vec3::NEG_X, [0.5, 0.3]), crossed_pane(Vec3::ZERO, Vec3::NEG_X, [0.5, 0.3])]
        {
            for t in mesh.triangles() {
                let [a, b, c] = t.map(|i| mesh.positions()[i as usize]);
                assert!((b - a).cross(c - a).normalize().dot(Vec3::NEG_X) > 0.999);
            }
        }
    }
}
