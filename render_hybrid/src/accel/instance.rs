//! Instances as the kernels see them.

use catoptra_engine::render_scene::Instance;
use glam::Affine3;

/// What a ray needs to enter an instance: o' = M⁻¹(o − translation), d' = M⁻¹ d. t is shared, d' is not normalised.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct InstanceRecord {
    /// Rows of M⁻¹.
    pub inverse: [[f32; 3]; 3],
    pub translation: [f32; 3],
    /// Index into the trees.
    pub blas: u32,
    /// Index into `RenderScene::instances`.
    pub instance_id: u32,
    /// M is the identity without translation.
    pub identity: bool,
    /// Occlusion rays see it.
    pub casts_shadow: bool,
}

/// Determinant below this fraction of Hadamard's bound: the transform flattens space, the instance is never hit.
const SINGULAR: f64 = 1.0 / ((1u64 << 44) as f64);

/// Inverse rows, and κ ≥ ‖M‖·‖M⁻¹‖ that scales rounding errors of object space to world space. `None`: singular.
pub(crate) fn invert(m: &Affine3) -> Option<([[f32; 3]; 3], f32)> {
    let c = [m.matrix3.x_axis, m.matrix3.y_axis, m.matrix3.z_axis].map(|c| c.as_dvec3());
    let cross = [c[1].cross(c[2]), c[2].cross(c[0]), c[0].cross(c[1])];
    let det = c[0].dot(cross[0]);
    let bound = c[0].length() * c[1].length() * c[2].length();
    if !(det.abs() > bound * SINGULAR) {
        return None;
    }
    let rows = cross.map(|r| (r / det).to_array());
    let norm = |rows: [[f64; 3]; 3]| rows.iter().map(|r| r.iter().map(|x| x.abs()).sum::<f64>()).fold(0.0, f64::max);
    let m_rows = [0, 1, 2].map(|i| [c[0][i], c[1][i], c[2][i]]);
    let kappa = (norm(m_rows) * norm(rows)) as f32;
    let inverse = rows.map(|r| r.map(|x| x as f32));
    (inverse.iter().flatten().all(|x| x.is_finite()) && kappa.is_finite()).then_some((inverse, kappa.max(1.0)))
}

impl InstanceRecord {
    /// A slot without an instance.
    pub const VACANT: Self = Self {
        inverse: [[0.0; 3]; 3],
        translation: [0.0; 3],
        blas: 0,
        instance_id: u32::MAX,
        identity: false,
        casts_shadow: true,
    };

    /// The record and κ. `None` where the transform is singular.
    pub fn new(instance: &Instance, instance_id: u32, blas: u32, casts_shadow: bool) -> Option<(Self, f32)> {
        let (inverse, kappa) = invert(&instance.world_from_object)?;
        let record = Self {
            inverse,
            translation: instance.world_from_object.translation.to_array(),
            blas,
            instance_id,
            identity: instance.world_from_object == Affine3::IDENTITY,
            casts_shadow,
        };
        Some((record, kappa))
    }

    /// The ray's origin and direction in object space: one order of operations at every width.
    #[inline(always)]
    pub fn object_ray(&self, origin: [f32; 3], direction: [f32; 3]) -> ([f32; 3], [f32; 3]) {
        if self.identity {
            return (origin, direction);
        }
        let r = [0, 1, 2].map(|a| origin[a] - self.translation[a]);
        let apply = |v: [f32; 3]| self.inverse.map(|m| (m[0] * v[0] + m[1] * v[1]) + m[2] * v[2]);
        (apply(r), apply(direction))
    }
}
