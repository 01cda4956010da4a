//! The atrium: a two-storey arcaded courtyard under the open sky, 66,454 triangles.
//!
//! A court of 5 x 3 bays is surrounded by vaulted galleries. Sixteen columns a storey carry arches of two-coloured stone;
//! above them run cornices with dentils, on the upper floor a balustrade, on top a tiled eave; banners hang in the upper
//! arches. Every part counts its triangles from its own numbers, and the paving takes up what is left to the exact sum.

mod arcade;
mod gallery;
mod lathe;
mod paving;
mod roof;

use catoptra_engine::{Mesh, shapes::ShapeBuilder};
use glam::Vec3;

/// Triangles of all meshes together.
pub const TRIANGLES: usize = 66_454;

/// Width of a bay, metres.
const BAY: f32 = 2.6;
/// Bays along x and z.
const BAYS: [usize; 2] = [5, 3];
/// Half extents of the court between the columns' centres.
pub const COURT: [f32; 2] = [BAY * BAYS[0] as f32 / 2.0, BAY * BAYS[1] as f32 / 2.0];
/// Depth of the galleries behind the columns' centres.
const DEPTH: f32 = 3.0;
/// Thickness of arcade walls.
const THICK: f32 = 0.5;

/// Heights of a storey: floor, springing of the arches, top of the wall.
#[derive(Clone, Copy, Debug)]
struct Storey {
    floor: f32,
    spring: f32,
    top: f32,
    upper: bool,
}

const STOREYS: [Storey; 2] = [
    Storey { floor: 0.0, spring: 2.7, top: 4.5, upper: false },
    Storey { floor: 4.5, spring: 6.75, top: 8.4, upper: true },
];

/// Albedos.
mod colors {
    use glam::Vec3;
    pub const PLASTER: Vec3 = Vec3::new(0.74, 0.66, 0.53);
    pub const PLASTER_UPPER: Vec3 = Vec3::new(0.76, 0.60, 0.44);
    pub const MARBLE: Vec3 = Vec3::new(0.78, 0.75, 0.70);
    pub const SHAFT_LOWER: Vec3 = Vec3::new(0.70, 0.66, 0.60);
    pub const SHAFT_UPPER: Vec3 = Vec3::new(0.66, 0.46, 0.38);
    pub const VOUSSOIR: [Vec3; 2] = [Vec3::new(0.80, 0.75, 0.66), Vec3::new(0.58, 0.26, 0.18)];
    pub const VAULT: Vec3 = Vec3::new(0.74, 0.71, 0.66);
    pub const DOOR: Vec3 = Vec3::new(0.30, 0.16, 0.08);
    pub const SHUTTER: Vec3 = Vec3::new(0.12, 0.28, 0.26);
    pub const TILE: Vec3 = Vec3::new(0.62, 0.28, 0.16);
    pub const PAVING: [Vec3; 3] =
        [Vec3::new(0.62, 0.57, 0.50), Vec3::new(0.50, 0.44, 0.37), Vec3::new(0.56, 0.30, 0.22)];
    pub const BANNER: [Vec3; 3] =
        [Vec3::new(0.62, 0.05, 0.06), Vec3::new(0.07, 0.16, 0.50), Vec3::new(0.07, 0.36, 0.14)];
}

/// A bay of the arcade: a frame whose origin is the middle between two columns on the floor, `along` running to the
/// right seen from the court, `out` pointing away from the court.
#[derive(Clone, Copy, Debug)]
struct Bay {
    middle: Vec3,
    along: Vec3,
    out: Vec3,
    /// Number around the court.
    number: usize,
    /// Half of the bay's width.
    half: f32,
}

impl Bay {
    /// World point from (along, height, out).
    fn at(&self, along: f32, y: f32, out: f32) -> Vec3 {
        self.middle + self.along * along + Vec3::Y * y + self.out * out
    }
}

/// All bays around the court, in order.
fn bays() -> Vec<Bay> {
    let mut all = Vec::new();
    // Seen from the middle: each side's outward direction, and its right hand.
    let sides = [(Vec3::NEG_Z, 0), (Vec3::X, 1), (Vec3::Z, 0), (Vec3::NEG_X, 1)];
    for (out, axis) in sides {
        let along = out.cross(Vec3::Y);
        let (n, distance) = (BAYS[axis], COURT[1 - axis]);
        for i in 0..n {
            let s = (i as f32 - (n as f32 - 1.0) / 2.0) * BAY;
            all.push(Bay { middle: along * s + out * distance, along, out, number: all.len(), half: BAY / 2.0 });
        }
    }
    all
}

/// Places of the columns, corners included.
fn columns() -> Vec<Vec3> {
    // Each bay owns the column at its left end, so that every corner is met once.
    bays().iter().map(|b| b.at(-BAY / 2.0, 0.0, 0.0)).collect()
}

/// The atrium's meshes, in world space: arcades of the lower and the upper storey, galleries, roof and cornices,
/// banners, paving. Floor at y = 0, court around the origin.
pub fn atrium_meshes() -> Vec<Mesh> {
    let mut meshes = Vec::new();
    for storey in STOREYS {
        let mut b = ShapeBuilder::default();
        for place in columns() {
            arcade::column(&mut b, place, &storey);
        }
        for bay in bays() {
            arcade::arch(&mut b, &bay, &storey);
            if storey.upper {
                arcade::balustrade(&mut b, &bay, &storey);
            }
        }
        meshes.push(b.build());
    }
    let mut b = ShapeBuilder::default();
    for storey in STOREYS {
        gallery::build(&mut b, &storey);
    }
    meshes.push(b.build());
    let mut b = ShapeBuilder::default();
    roof::build(&mut b);
    meshes.push(b.build());
    let mut b = ShapeBuilder::default();
    for bay in bays() {
        roof::banner(&mut b, &bay);
    }
    meshes.push(b.build());

    let so_far: usize = meshes.iter().map(|m| m.triangles().len()).sum();
    let mut b = ShapeBuilder::default();
    paving::build(&mut b, TRIANGLES - so_far);
    meshes.push(b.build());
    meshes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_count_is_exact() {
        let meshes = atrium_meshes();
        let counts: Vec<usize> = meshes.iter().map(|m| m.triangles().len()).collect();
        assert_eq!(counts.iter().sum::<usize>(), TRIANGLES, "{counts:?}");
    }

    #[test]
    fn no_triangle_is_degenerate_and_normals_are_unit() {
        for (k, mesh) in atrium_meshes().iter().enumerate() {
            for i in 0..mesh.triangles().len() as u32 {
                let [a, b, c] = mesh.corners(i);
                assert!((b - a).cross(c - a).length() > 1e-9, "mesh {k}, triangle {i}: {a} {b} {c}");
            }
            assert!(mesh.normals().iter().all(|n| (n.length() - 1.0).abs() < 1e-4));
        }
    }

    /// Rays from points in the court and the galleries: down and sideways every one must end on stone, and upwards only
    /// those may leave that pass the court's open sky.
    #[test]
    fn nothing_leaks_but_the_sky() {
        let meshes = atrium_meshes();
        let triangles: Vec<[Vec3; 3]> =
            meshes.iter().flat_map(|m| (0..m.triangles().len() as u32).map(|i| m.corners(i))).collect();
        let hit = |o: Vec3, d: Vec3| {
            triangles.iter().any(|[a, b, c]| {
                let (e1, e2) = (*b - *a, *c - *a);
                let p = d.cross(e2);
                let det = e1.dot(p);
                if det.abs() < 1e-12 {
                    return false;
                }
                let s = (o - *a) / det;
                let u = s.dot(p);
                let q = s.cross(e1);
                let v = d.dot(q);
                u >= -1e-4 && v >= -1e-4 && u + v <= 1.0001 && e2.dot(q) > 0.0
            })
        };
        let mut n = 0u32;
        for from in [Vec3::new(0.3, 1.5, 0.2), Vec3::new(-8.1, 1.7, 5.3), Vec3::new(7.9, 6.2, -5.5)] {
            for i in 0..160 {
                // Points of a golden spiral on the sphere.
                let y = 1.0 - 2.0 * (i as f32 + 0.5) / 160.0;
                let (s, c) = catoptra_engine::math::sin_cos(2.399_963_2 * i as f32);
                let r = (1.0 - y * y).sqrt();
                let d = Vec3::new(r * c, y, r * s);
                if !hit(from, d) {
                    n += 1;
                    let at = from + d * ((8.4 - from.y) / d.y);
                    let open = d.y > 0.0 && at.x.abs() < COURT[0] && at.z.abs() < COURT[1];
                    assert!(open, "from {from} towards {d} the ray leaves at {at}");
                }
            }
        }
        assert!(n > 10, "the sky is open");
    }
}
