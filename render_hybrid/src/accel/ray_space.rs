//! A ray made ready for one space (the world, or one instance's object space).

/// Padding of every box plane as a fraction of (greatest coordinate of the origin + greatest coordinate of the boxes).
///
/// A computed hit lies within 6·2⁻²⁴ of that sum of a point on the triangle for the rounding of translated and sheared
/// vertices, within 64·2⁻²⁴ for the rounding of barycentrics (beyond that bound they are computed in double precision, see
/// `triangle`), and the slab arithmetic adds 4·2⁻²⁴: 2⁻¹⁷ = 128·2⁻²⁴ holds them all. So a box that holds a triangle, or a
/// piece of it, is never culled before a hit on it: hits do not depend on the tree.
pub(crate) const PAD: f32 = 1.0 / 131_072.0;

/// Direction components below this fraction of the greatest are raised to it for box tests.
pub(crate) const LEAST_SLOPE: f32 = 1.0 / ((1u64 << 40) as f32);

/// Ray with everything that nodes and triangles of one space need.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct RaySpace {
    pub origin: [f32; 3],
    /// Shear (sx, sy) and 1/d of the main axis: Woop, Benthin & Wald, "Watertight Ray/Triangle Intersection", JCGT 2013.
    pub shear: [f32; 3],
    /// Axes (kx, ky, kz); kz is where the direction is greatest.
    pub k: [usize; 3],
    /// Reciprocal of the direction, finite.
    pub inv: [f32; 3],
    /// t of a near plane p on axis a is at least `p · inv[a] - near[a]`, of a far plane at most `p · inv[a] - far[a]`.
    pub near: [f32; 3],
    pub far: [f32; 3],
    /// Which of `Node8::planes` is near, per axis.
    pub near_plane: [usize; 3],
    /// Greatest coordinate of origin + greatest coordinate in the space; scales all error bounds.
    pub reach: f32,
}

impl RaySpace {
    /// No ray.
    pub const VACANT: Self = Self {
        origin: [0.0; 3],
        shear: [0.0; 3],
        k: [0, 1, 2],
        inv: [0.0; 3],
        near: [0.0; 3],
        far: [0.0; 3],
        near_plane: [0, 2, 4],
        reach: 0.0,
    };

    /// `extent`: greatest absolute coordinate of the boxes; `slack` ≥ 1 multiplies the padding.
    #[inline(always)]
    pub fn new(origin: [f32; 3], direction: [f32; 3], extent: f32, slack: f32) -> Self {
        let [ax, ay, az] = direction.map(f32::abs);
        let kz = if ax >= ay {
            if ax >= az { 0 } else { 2 }
        } else if ay >= az {
            1
        } else {
            2
        };
        const NEXT: [[usize; 3]; 3] = [[1, 2, 0], [2, 0, 1], [0, 1, 2]];
        let k = NEXT[kz];
        let least = direction[kz].abs() * LEAST_SLOPE;
        let inv = [0, 1, 2].map(|a| {
            let d = direction[a];
            1.0 / if d.abs() < least { least.copysign(d) } else { d }
        });
        let reach = max(max(origin[0].abs(), origin[1].abs()), origin[2].abs()) + extent;
        let pad = reach * PAD * slack;
        Self {
            origin,
            shear: [direction[k[0]] * inv[kz], direction[k[1]] * inv[kz], inv[kz]],
            k,
            inv,
            near: [0, 1, 2].map(|a| (origin[a] + pad.copysign(inv[a])) * inv[a]),
            far: [0, 1, 2].map(|a| (origin[a] - pad.copysign(inv[a])) * inv[a]),
            near_plane: [0, 1, 2].map(|a| 2 * a + usize::from(inv[a] < 0.0)),
            reach,
        }
    }
}

#[inline(always)]
fn max(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}
