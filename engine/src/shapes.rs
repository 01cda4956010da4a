//! Procedural meshes with exact triangle counts.

use crate::{math, mesh::Mesh, mesh::MeshData};
use glam::{Vec3, Vec4};
use std::f32::consts::{PI, TAU};

/// Collects quads and triangles with flat or given normals and one colour a face.
#[derive(Default)]
pub struct ShapeBuilder {
    data: MeshData,
}

impl ShapeBuilder {
    /// Adds a planar quad of two triangles, corners counter-clockwise seen from its front, flat normal.
    pub fn quad(&mut self, corners: [Vec3; 4], color: Vec3) -> &mut Self {
        let n = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or(Vec3::Y);
        let base = self.vertices(corners.map(|p| (p, n)), color);
        self.data.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        self
    }
    /// Adds a triangle with a flat normal.
    pub fn triangle(&mut self, corners: [Vec3; 3], color: Vec3) -> &mut Self {
        let n = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or(Vec3::Y);
        let base = self.vertices(corners.map(|p| (p, n)), color);
        self.data.triangles.push([base, base + 1, base + 2]);
        self
    }
    /// Adds vertices with normals of their own and returns the first one's number.
    pub fn vertices(&mut self, vertices: impl IntoIterator<Item = (Vec3, Vec3)>, color: Vec3) -> u32 {
        let base = self.data.positions.len() as u32;
        for (p, n) in vertices {
            self.data.positions.push(p);
            self.data.normals.push(n);
            self.data.colors.push(color.extend(1.0));
        }
        base
    }
    /// Adds triangles over vertices added before.
    pub fn triangles(&mut self, triangles: impl IntoIterator<Item = [u32; 3]>) -> &mut Self {
        self.data.triangles.extend(triangles);
        self
    }
    /// The finished mesh.
    ///
    /// # Panics
    /// Where a triangle names a vertex that was never added.
    pub fn build(&mut self) -> Mesh {
        if self.data.colors.iter().all(|&c| c == Vec4::ONE) {
            self.data.colors.clear();
        }
        Mesh::new(std::mem::take(&mut self.data)).expect("shape builders make valid meshes")
    }
}

/// Colours of the six faces of a box: -X, +X, -Y, +Y, -Z, +Z.
pub type FaceColors = [Vec3; 6];

const BOX_FACES: [[usize; 4]; 6] = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

fn box_corners(half: Vec3) -> [Vec3; 8] {
    std::array::from_fn(|i| {
        let s = |bit: usize| if i & bit == 0 { -1.0 } else { 1.0 };
        half * Vec3::new(s(1), s(2), s(4))
    })
}

/// Axis-aligned box around the origin, 12 triangles, outward faces.
pub fn cuboid(half: Vec3, colors: FaceColors) -> Mesh {
    let c = box_corners(half);
    let mut b = ShapeBuilder::default();
    for (face, color) in BOX_FACES.iter().zip(colors) {
        b.quad(face.map(|i| c[i]), color);
    }
    b.build()
}

/// Inside of a box around the origin without its +Z face (towards the viewer): 10 triangles. `colors[5]` is unused.
pub fn open_room(half: Vec3, colors: FaceColors) -> Mesh {
    let c = box_corners(half);
    let mut b = ShapeBuilder::default();
    for (face, color) in BOX_FACES.iter().zip(colors).take(5) {
        let mut q = face.map(|i| c[i]);
        q.reverse();
        b.quad(q, color);
    }
    b.build()
}

/// Sphere around the origin of `rings` latitude bands and `segments` longitudes: 2 · segments · (rings − 1) triangles,
/// closed, smooth normals.
pub fn sphere(radius: f32, rings: u32, segments: u32) -> Mesh {
    assert!(rings >= 2 && segments >= 3, "a sphere needs at least 2 rings and 3 segments");
    let point = |ring: u32, segment: u32| {
        let (st, ct) = math::sin_cos(PI * ring as f32 / rings as f32);
        // The last longitude is the first one: equal numbers, so that the mesh closes.
        let (sp, cp) = math::sin_cos(TAU * (segment % segments) as f32 / segments as f32);
        Vec3::new(st * cp, ct, -st * sp)
    };
    let mut b = ShapeBuilder::default();
    let top = b.vertices([(Vec3::Y * radius, Vec3::Y)], Vec3::ONE);
    for ring in 1..rings {
        b.vertices((0..segments).map(|s| (point(ring, s) * radius, point(ring, s))), Vec3::ONE);
    }
    let bottom = b.vertices([(Vec3::NEG_Y * radius, Vec3::NEG_Y)], Vec3::ONE);
    let at = |ring: u32, s: u32| 1 + (ring - 1) * segments + s % segments;
    for s in 0..segments {
        b.triangles([[top, at(1, s), at(1, s + 1)]]);
        for ring in 1..rings - 1 {
            let (a, c, d, e) = (at(ring, s), at(ring + 1, s), at(ring + 1, s + 1), at(ring, s + 1));
            b.triangles([[a, c, d], [a, d, e]]);
        }
        b.triangles([[at(rings - 1, s), bottom, at(rings - 1, s + 1)]]);
    }
    b.build()
}

/// Torus around the Y axis: `major` radius to the tube's centre, `minor` radius of the tube; 2 · segments · sides
/// triangles, closed, smooth normals.
pub fn torus(major: f32, minor: f32, segments: u32, sides: u32) -> Mesh {
    assert!(segments >= 3 && sides >= 3, "a torus needs at least 3 segments and 3 sides");
    let mut b = ShapeBuilder::default();
    for i in 0..segments {
        let (sp, cp) = math::sin_cos(TAU * i as f32 / segments as f32);
        b.vertices(
            (0..sides).map(|j| {
                let (st, ct) = math::sin_cos(TAU * j as f32 / sides as f32);
                let n = Vec3::new(cp * ct, st, -sp * ct);
                (Vec3::new(cp, 0.0, -sp) * major + n * minor, n)
            }),
            Vec3::ONE,
        );
    }
    let at = |i: u32, j: u32| (i % segments) * sides + j % sides;
    for i in 0..segments {
        for j in 0..sides {
            let (a, c, d, e) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
            b.triangles([[a, c, d], [a, d, e]]);
        }
    }
    b.build()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outward(mesh: &Mesh) -> bool {
        mesh.triangles().iter().all(|t| {
            let [a, b, c] = t.map(|v| mesh.positions()[v as usize]);
            (b - a).cross(c - a).dot(mesh.normals()[t[0] as usize]) > 0.0
        })
    }

    #[test]
    fn counts_closedness_and_winding() {
        let cube = cuboid(Vec3::ONE, [Vec3::X; 6]);
        assert!(cube.triangles().len() == 12 && cube.closed() && outward(&cube));
        let room = open_room(Vec3::ONE, [Vec3::X; 6]);
        assert!(room.triangles().len() == 10 && !room.closed() && outward(&room));
        let ball = sphere(1.0, 12, 24);
        assert!(ball.triangles().len() == 528 && ball.closed() && outward(&ball));
        let donut = torus(1.0, 0.3, 24, 12);
        assert!(donut.triangles().len() == 576 && donut.closed() && outward(&donut));
        // A room's faces look inwards: from the centre every one shows its front.
        assert!(room.triangles().iter().all(|t| {
            let p = room.positions()[t[0] as usize];
            room.normals()[t[0] as usize].dot(p) < 0.0
        }));
    }
}
