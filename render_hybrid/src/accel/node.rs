//! The plain data that every kernel reads: wide nodes and triangle blocks, structure of arrays.

/// Set in a child reference that names a leaf; the other bits are the leaf's number (triangle block or instance slot).
pub(crate) const LEAF: u32 = 1 << 31;
/// In a mesh tree's leaf reference: the block's number below, triangles in it less one above.
pub(crate) const BLOCK: u32 = (1 << LEN_SHIFT) - 1;
/// See [`BLOCK`].
pub(crate) const LEN_SHIFT: u32 = 28;
/// Child reference of an empty slot, and the root of an empty tree. Its box is inverted, so no ray enters it.
pub(crate) const EMPTY: u32 = u32::MAX;
/// Children a node and triangles a block.
pub(crate) const WIDTH: usize = 8;
/// Deepest wide tree that a traversal stack of [`STACK`] entries serves (at most seven wait at each level).
pub(crate) const MAX_DEPTH: usize = 34;
/// Entries of a traversal stack.
pub(crate) const STACK: usize = 7 * MAX_DEPTH + 10;

/// Eight children: planes `[min x, max x, min y, max y, min z, max z]` in full precision, then their references.
///
/// The near plane of axis a for a ray is `planes[2a + (direction < 0)]`, the far plane its neighbour.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(crate) struct Node8 {
    pub planes: [[f32; WIDTH]; 6],
    pub child: [u32; WIDTH],
}

impl Node8 {
    pub const VACANT: Self = Self {
        planes: [
            [f32::INFINITY; 8],
            [f32::NEG_INFINITY; 8],
            [f32::INFINITY; 8],
            [f32::NEG_INFINITY; 8],
            [f32::INFINITY; 8],
            [f32::NEG_INFINITY; 8],
        ],
        child: [EMPTY; WIDTH],
    };

    pub fn set(&mut self, slot: usize, b: &Bounds, child: u32) {
        self.set_box(slot, b);
        self.child[slot] = child;
    }
    pub fn set_box(&mut self, slot: usize, b: &Bounds) {
        for a in 0..3 {
            self.planes[2 * a][slot] = b.min[a];
            self.planes[2 * a + 1][slot] = b.max[a];
        }
    }
    pub fn slot_box(&self, slot: usize) -> Bounds {
        Bounds {
            min: [0, 1, 2].map(|a| self.planes[2 * a][slot]),
            max: [0, 1, 2].map(|a| self.planes[2 * a + 1][slot]),
        }
    }
    /// Box around all children. Empty slots add nothing.
    pub fn bounds(&self) -> Bounds {
        Bounds {
            min: [0, 1, 2].map(|a| self.planes[2 * a].iter().fold(f32::INFINITY, |m, &x| m.min(x))),
            max: [0, 1, 2].map(|a| self.planes[2 * a + 1].iter().fold(f32::NEG_INFINITY, |m, &x| m.max(x))),
        }
    }
}

/// Axis-aligned box in the order of the kernels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bounds {
    pub min: [f32; 3],
    pub max: [f32; 3],
}

impl Bounds {
    pub const EMPTY: Self = Self { min: [f32::INFINITY; 3], max: [f32::NEG_INFINITY; 3] };

    pub fn union(self, o: Self) -> Self {
        Self { min: [0, 1, 2].map(|a| self.min[a].min(o.min[a])), max: [0, 1, 2].map(|a| self.max[a].max(o.max[a])) }
    }
    pub fn contains(&self, o: &Self) -> bool {
        (0..3).all(|a| self.min[a] <= o.min[a] && self.max[a] >= o.max[a])
    }
    pub fn is_empty(&self) -> bool {
        !(0..3).all(|a| self.min[a] <= self.max[a])
    }
    /// Half of the surface, 0 for an empty box. Double precision: finite for every finite box within 1e154.
    pub fn half_area(&self) -> f64 {
        if self.is_empty() {
            return 0.0;
        }
        let [x, y, z] = [0, 1, 2].map(|a| f64::from(self.max[a]) - f64::from(self.min[a]));
        x * y + y * z + z * x
    }
    /// Greatest absolute coordinate, 0 for an empty box.
    pub fn extent(&self) -> f32 {
        if self.is_empty() {
            return 0.0;
        }
        (0..3).fold(0.0, |m: f32, a| m.max(self.min[a].abs()).max(self.max[a].abs()))
    }
}

impl From<catoptra_engine::mesh::Aabb> for Bounds {
    fn from(b: catoptra_engine::mesh::Aabb) -> Self {
        Self { min: b.min.to_array(), max: b.max.to_array() }
    }
}

impl From<super::binary::Box4> for Bounds {
    fn from(b: super::binary::Box4) -> Self {
        Self { min: [b.lo.x, b.lo.y, b.lo.z], max: [b.hi.x, b.hi.y, b.hi.z] }
    }
}

/// Up to eight triangles: `v[vertex][axis][lane]`. Unused lanes hold NaN, which no comparison accepts, and
/// `prim == u32::MAX`.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(crate) struct Tri8 {
    pub v: [[[f32; WIDTH]; 3]; 3],
    pub prim: [u32; WIDTH],
}

impl Tri8 {
    pub const VACANT: Self = Self { v: [[[f32::NAN; WIDTH]; 3]; 3], prim: [u32::MAX; WIDTH] };

    pub fn set(&mut self, lane: usize, corners: [glam::Vec3; 3], prim: u32) {
        for (vertex, p) in corners.iter().enumerate() {
            for axis in 0..3 {
                self.v[vertex][axis][lane] = p[axis];
            }
        }
        self.prim[lane] = prim;
    }
    pub fn len(&self) -> usize {
        self.prim.iter().take_while(|&&p| p != u32::MAX).count()
    }
    pub fn corner(&self, vertex: usize, lane: usize) -> [f32; 3] {
        [0, 1, 2].map(|axis| self.v[vertex][axis][lane])
    }
}
