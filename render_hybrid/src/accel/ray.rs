//! Rays and hits, world space.

use glam::Vec3;

/// A half-open piece of a line: points `origin + t · direction` with `t_min < t < t_max`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Ray {
    /// Start, world space.
    pub origin: Vec3,
    /// Least t, ≥ 0.
    pub t_min: f32,
    /// Direction, any finite non-zero length; t is in units of it.
    pub direction: Vec3,
    /// Greatest t; +infinity is a normal value.
    pub t_max: f32,
}

impl Ray {
    /// The whole half line from `origin`.
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, t_min: 0.0, direction, t_max: f32::INFINITY }
    }
    /// Point at `t`.
    pub fn at(&self, t: f32) -> Vec3 {
        self.origin + self.direction * t
    }
}

/// What a ray met first. `instance_id == Hit::NONE` is a miss.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Hit {
    /// Distance in units of the direction's length; +infinity on a miss.
    pub t: f32,
    /// Barycentric weight of the triangle's second vertex.
    pub u: f32,
    /// Barycentric weight of the triangle's third vertex.
    pub v: f32,
    /// Index into `RenderScene::instances`.
    pub instance_id: u32,
    /// Triangle number in the mesh.
    pub primitive_id: u32,
}

impl Hit {
    /// The `instance_id` of a miss.
    pub const NONE: u32 = u32::MAX;
    /// A miss.
    pub const MISS: Self = Self { t: f32::INFINITY, u: 0.0, v: 0.0, instance_id: Self::NONE, primitive_id: Self::NONE };

    /// True where something was met.
    #[inline]
    pub fn is_hit(&self) -> bool {
        self.instance_id != Self::NONE
    }
}
