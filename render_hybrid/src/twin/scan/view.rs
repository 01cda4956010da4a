//! What is looked through: a camera's picture or a shadow map.

use catoptra_engine::{Camera, Projection};
use glam::{Affine3, DAffine3, DVec3};

use crate::twin::shadow::ShadowView;

/// Surfaces nearer to a light than this share of its view's depth throw no shadow: triangles are cut off there.
const NEAREST_CASTER: f64 = 1e-5;

/// Maps world points to homogeneous pixel coordinates (X, Y, W), pixel centres on whole numbers, and to distance t along the
/// axis; W = t in perspective views, 1 in parallel ones.
#[derive(Clone, Copy, Debug)]
pub struct ScanView {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Rays meet in a point.
    pub perspective: bool,
    /// Surfaces count at `near < t < far`.
    pub near: f64,
    /// See `near`.
    pub far: f64,
    /// X, Y and t as rows over (x, y, z, 1).
    rows: [[f64; 4]; 3],
}

impl ScanView {
    /// The camera's pixels.
    pub fn of_camera(camera: &Camera, width: u32, height: u32) -> Self {
        let view_from_world = DAffine3 {
            matrix3: camera.world_from_view.matrix3.as_dmat3(),
            translation: camera.world_from_view.translation.as_dvec3(),
        }
        .inverse();
        let m = view_from_world.matrix3.transpose();
        let row = |axis: DVec3, offset: f64| [axis.x, axis.y, axis.z, offset];
        let (x, y) = (row(m.x_axis, view_from_world.translation.x), row(m.y_axis, view_from_world.translation.y));
        let t = row(-m.z_axis, -view_from_world.translation.z);
        let (half_w, half_h) = camera.half_extent(width, height);
        let perspective = matches!(camera.projection, Projection::Perspective { .. });
        let rows = pixel_rows(x, y, t, [f64::from(half_w), f64::from(half_h)], [width, height], perspective);
        Self { width, height, perspective, near: f64::from(camera.near), far: f64::INFINITY, rows }
    }

    /// The map's texels.
    pub fn of_shadow(view: &ShadowView) -> Self {
        let origin = view.origin_world.as_dvec3();
        let row = |axis: glam::Vec3| {
            let axis = axis.as_dvec3();
            [axis.x, axis.y, axis.z, -axis.dot(origin)]
        };
        let perspective = view.perspective > 0.5;
        let (x, y, t) = (row(view.right_scaled), row(view.up_scaled), row(view.forward));
        let rows = pixel_rows(x, y, t, [1.0; 2], [view.size; 2], perspective);
        let far = f64::from(view.far);
        // What is so near to a light would lie in its bulb.
        let near = if perspective { far * NEAREST_CASTER } else { 0.0 };
        Self { width: view.size, height: view.size, perspective, near, far, rows }
    }

    /// The rows for points of an object's own space.
    pub(super) fn rows_from_object(&self, world_from_object: &Affine3) -> [[f64; 4]; 3] {
        let m = world_from_object.matrix3.as_dmat3();
        let o = world_from_object.translation.as_dvec3();
        self.rows.map(|r| {
            let axis = DVec3::new(r[0], r[1], r[2]);
            [axis.dot(m.x_axis), axis.dot(m.y_axis), axis.dot(m.z_axis), axis.dot(o) + r[3]]
        })
    }

    /// Range that the stored nearness lies in, exclusive: 1/t, or −t in parallel views. Greater is nearer.
    pub fn nearness_range(&self) -> (f32, f32) {
        if self.perspective {
            ((1.0 / self.far) as f32, (1.0 / self.near) as f32)
        } else {
            (-self.far as f32, -self.near as f32)
        }
    }

    /// Distance t along the axis of a stored nearness.
    #[inline(always)]
    pub fn distance(perspective: bool, nearness: f32) -> f32 {
        if perspective { 1.0 / nearness } else { -nearness }
    }
}

/// Rows (X, Y, t) from those of the offsets to the right, upwards and along the axis.
fn pixel_rows(
    x: [f64; 4],
    y: [f64; 4],
    t: [f64; 4],
    half: [f64; 2],
    size: [u32; 2],
    perspective: bool,
) -> [[f64; 4]; 3] {
    let w = if perspective { t } else { [0.0, 0.0, 0.0, 1.0] };
    let [width, height] = size.map(f64::from);
    let column = |i: usize| (x[i] / half[0] + w[i]) * (width * 0.5) - 0.5 * w[i];
    let line = |i: usize| (w[i] - y[i] / half[1]) * (height * 0.5) - 0.5 * w[i];
    [std::array::from_fn(column), std::array::from_fn(line), t]
}
