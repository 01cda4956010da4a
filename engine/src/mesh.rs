//! Triangle meshes in flat arrays.

use glam::{Affine3, Vec2, Vec3, Vec4};
use std::collections::HashMap;
use std::sync::OnceLock;

/// Axis-aligned box, `min` and `max` inclusive. Empty when `min > max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Least corner.
    pub min: Vec3,
    /// Greatest corner.
    pub max: Vec3,
}

impl Aabb {
    /// The box that holds nothing.
    pub const EMPTY: Self = Self { min: Vec3::splat(f32::INFINITY), max: Vec3::splat(f32::NEG_INFINITY) };

    /// Smallest box around the points.
    pub fn from_points(points: impl IntoIterator<Item = Vec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, |b, p| b.union_point(p))
    }
    /// This box grown to hold `p`.
    pub fn union_point(self, p: Vec3) -> Self {
        Self { min: self.min.min(p), max: self.max.max(p) }
    }
    /// Smallest box that holds both.
    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }
    /// True where the box holds no point.
    pub fn is_empty(&self) -> bool {
        !(self.min.x <= self.max.x && self.min.y <= self.max.y && self.min.z <= self.max.z)
    }
    /// The eight corners.
    pub fn corners(&self) -> [Vec3; 8] {
        let (a, b) = (self.min, self.max);
        std::array::from_fn(|i| {
            Vec3::new(
                if i & 1 == 0 { a.x } else { b.x },
                if i & 2 == 0 { a.y } else { b.y },
                if i & 4 == 0 { a.z } else { b.z },
            )
        })
    }
    /// Box around the eight transformed corners (the thesis's bound of a moved object).
    pub fn transformed(&self, world_from_object: &Affine3) -> Self {
        if self.is_empty() {
            return Self::EMPTY;
        }
        Self::from_points(self.corners().map(|c| world_from_object.transform_point3(c)))
    }
    /// Middle of the box.
    pub fn center(&self) -> Vec3 {
        self.min * 0.5 + self.max * 0.5
    }
    /// Half of the diagonal's length: radius of the box's bounding sphere.
    pub fn radius(&self) -> f32 {
        if self.is_empty() { 0.0 } else { (self.max - self.min).length() * 0.5 }
    }
}

/// What a mesh is made from. Optional arrays are empty or as long as `positions`.
#[derive(Clone, Debug, Default)]
pub struct MeshData {
    /// Vertex positions, object space, metres.
    pub positions: Vec<Vec3>,
    /// Unit vertex normals, object space. Empty: flat normals are computed and vertices are split per triangle.
    pub normals: Vec<Vec3>,
    /// First texture coordinate set, (0, 0) = first texel of row 0. May be empty.
    pub uvs: Vec<Vec2>,
    /// Second texture coordinate set. May be empty.
    pub uvs1: Vec<Vec2>,
    /// Linear RGBA that multiplies the material's base color. May be empty.
    pub colors: Vec<Vec4>,
    /// Directions (xyz, unit, object space) along the normal map's x; its y points along cross(normal, xyz) · w, w being 1 or
    /// −1. May be empty: each triangle's texture coordinates then span the frame.
    pub tangents: Vec<Vec4>,
    /// Three vertex numbers a triangle, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// Why a mesh was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MeshError {
    /// An attribute array is neither empty nor as long as the positions.
    #[error("{attribute} has {len} entries for {positions} positions")]
    Length {
        /// Which array.
        attribute: &'static str,
        /// Its length.
        len: usize,
        /// Length that was wanted.
        positions: usize,
    },
    /// A triangle names a vertex that does not exist.
    #[error("triangle {triangle} names vertex {vertex}, but there are {positions}")]
    Index {
        /// Number of the triangle.
        triangle: usize,
        /// Vertex number.
        vertex: u32,
        /// Vertices there are.
        positions: usize,
    },
    /// A position is NaN or infinite.
    #[error("position of vertex {vertex} is not finite")]
    NotFinite {
        /// Vertex number.
        vertex: usize,
    },
}

/// An immutable triangle mesh; identity is its `Arc`'s address, so share it to share acceleration structures.
#[derive(Clone, Debug)]
pub struct Mesh {
    data: MeshData,
    bounds_object: Aabb,
    /// Found when it is first asked for: welding costs as much as half a tree.
    closed: OnceLock<bool>,
}

impl Mesh {
    /// Checks the data and derives bounds. Missing normals become flat ones.
    ///
    /// # Errors
    /// [`MeshError`] where arrays disagree in length, an index is out of range or a position is not finite.
    pub fn new(mut data: MeshData) -> Result<Self, MeshError> {
        let n = data.positions.len();
        for (attribute, len) in [
            ("normals", data.normals.len()),
            ("uvs", data.uvs.len()),
            ("uvs1", data.uvs1.len()),
            ("colors", data.colors.len()),
            ("tangents", data.tangents.len()),
        ] {
            if len != 0 && len != n {
                return Err(MeshError::Length { attribute, len, positions: n });
            }
        }
        if let Some(vertex) = data.positions.iter().position(|p| !p.is_finite()) {
            return Err(MeshError::NotFinite { vertex });
        }
        for (triangle, t) in data.triangles.iter().enumerate() {
            if let Some(&vertex) = t.iter().find(|&&v| v as usize >= n) {
                return Err(MeshError::Index { triangle, vertex, positions: n });
            }
        }
        if data.normals.is_empty() && !data.triangles.is_empty() {
            data = with_flat_normals(data);
        }
        let used = data.triangles.iter().flatten().map(|&v| data.positions[v as usize]);
        let bounds_object = Aabb::from_points(used);
        Ok(Self { data, bounds_object, closed: OnceLock::new() })
    }

    /// Vertex positions, object space.
    #[inline]
    pub fn positions(&self) -> &[Vec3] {
        &self.data.positions
    }
    /// Vertex normals, object space, one a position.
    pub fn normals(&self) -> &[Vec3] {
        &self.data.normals
    }
    /// First texture coordinate set; empty or one a position.
    pub fn uvs(&self) -> &[Vec2] {
        &self.data.uvs
    }
    /// Second texture coordinate set; empty or one a position.
    pub fn uvs1(&self) -> &[Vec2] {
        &self.data.uvs1
    }
    /// Linear vertex colours; empty or one a position.
    pub fn colors(&self) -> &[Vec4] {
        &self.data.colors
    }
    /// Frames of the normal map, [`MeshData::tangents`]; empty or one a position.
    pub fn tangents(&self) -> &[Vec4] {
        &self.data.tangents
    }
    /// Triangles as vertex numbers.
    #[inline]
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.data.triangles
    }
    /// Bounds of all vertices that a triangle uses.
    pub fn bounds_object(&self) -> Aabb {
        self.bounds_object
    }
    /// True where every edge is shared by exactly two triangles of opposite direction, with vertices welded by exact
    /// position: the mesh bounds a volume. False for open or inconsistently wound meshes. Found at the first call.
    pub fn closed(&self) -> bool {
        *self.closed.get_or_init(|| is_closed(&self.data))
    }
    /// Positions of the three corners of a triangle.
    #[inline]
    pub fn corners(&self, primitive_id: u32) -> [Vec3; 3] {
        self.data.triangles[primitive_id as usize].map(|v| self.data.positions[v as usize])
    }
}

fn is_closed(data: &MeshData) -> bool {
    let mut welded: HashMap<[u32; 3], u32> = HashMap::new();
    let ids: Vec<u32> = data
        .positions
        .iter()
        .map(|p| {
            let next = welded.len() as u32;
            // -0 and +0 are one place.
            *welded.entry((*p + Vec3::ZERO).to_array().map(f32::to_bits)).or_insert(next)
        })
        .collect();
    let mut balance: HashMap<(u32, u32), (i32, i32)> = HashMap::new();
    for t in &data.triangles {
        let w = t.map(|v| ids[v as usize]);
        if w[0] == w[1] || w[1] == w[2] || w[2] == w[0] {
            continue; // A degenerate triangle bounds nothing.
        }
        for (a, b) in [(w[0], w[1]), (w[1], w[2]), (w[2], w[0])] {
            let e = balance.entry((a.min(b), a.max(b))).or_default();
            if a < b { e.0 += 1 } else { e.1 += 1 }
        }
    }
    !balance.is_empty() && balance.values().all(|&(f, b)| f == 1 && b == 1)
}

fn with_flat_normals(data: MeshData) -> MeshData {
    let pick = |t: &[u32; 3]| t.map(|v| v as usize);
    let mut out = MeshData::default();
    for t in &data.triangles {
        let v = pick(t);
        let [a, b, c] = v.map(|i| data.positions[i]);
        let n = (b - a).cross(c - a).normalize_or(Vec3::Y);
        let base = out.positions.len() as u32;
        for i in v {
            out.positions.push(data.positions[i]);
            out.normals.push(n);
            if !data.uvs.is_empty() {
                out.uvs.push(data.uvs[i]);
            }
            if !data.uvs1.is_empty() {
                out.uvs1.push(data.uvs1[i]);
            }
            if !data.colors.is_empty() {
                out.colors.push(data.colors[i]);
            }
            if !data.tangents.is_empty() {
                out.tangents.push(data.tangents[i]);
            }
        }
        out.triangles.push([base, base + 1, base + 2]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron() -> MeshData {
        MeshData {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z],
            triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
            ..Default::default()
        }
    }

    #[test]
    fn closedness_sees_holes_and_flips() {
        assert!(Mesh::new(tetrahedron()).unwrap().closed());
        let mut open = tetrahedron();
        open.triangles.pop();
        assert!(!Mesh::new(open).unwrap().closed());
        let mut flipped = tetrahedron();
        flipped.triangles[0].swap(0, 1);
        assert!(!Mesh::new(flipped).unwrap().closed());
    }

    #[test]
    fn bad_data_is_refused_with_its_place() {
        let mut m = tetrahedron();
        m.triangles.push([0, 1, 9]);
        assert_eq!(Mesh::new(m).unwrap_err(), MeshError::Index { triangle: 4, vertex: 9, positions: 4 });
        let mut m = tetrahedron();
        m.positions[2].y = f32::NAN;
        assert_eq!(Mesh::new(m).unwrap_err(), MeshError::NotFinite { vertex: 2 });
        let mut m = tetrahedron();
        m.normals = vec![Vec3::Y];
        assert!(matches!(Mesh::new(m), Err(MeshError::Length { attribute: "normals", .. })));
    }

    #[test]
    fn flat_normals_point_outwards() {
        let m = Mesh::new(tetrahedron()).unwrap();
        for t in m.triangles() {
            let c = t.iter().map(|&v| m.positions()[v as usize]).sum::<Vec3>() / 3.0;
            assert!(m.normals()[t[0] as usize].dot(c - Vec3::splat(0.2)) > 0.0);
        }
    }
}
