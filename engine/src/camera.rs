//! The camera as renderers see it.

use crate::math;
use glam::{Affine3, Vec3};

/// How view space maps to the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Vertical field of view in radians; the horizontal one follows from the picture's aspect.
    Perspective {
        /// Full vertical angle, radians, in (0, π).
        fov_y: f32,
    },
    /// Half of the visible height in metres.
    Orthographic {
        /// Half height, metres, over 0.
        half_height: f32,
    },
}

/// A posed camera that looks along -Z of its own space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// View space to world space, rigid (scale is removed at extraction).
    pub world_from_view: Affine3,
    /// Lens.
    pub projection: Projection,
    /// Nearest visible distance along -Z, metres, over 0.
    pub near: f32,
}

impl Default for Camera {
    fn default() -> Self {
        Self {
            world_from_view: Affine3::IDENTITY,
            projection: Projection::Perspective { fov_y: std::f32::consts::FRAC_PI_4 },
            near: 0.01,
        }
    }
}

impl Camera {
    /// Camera at `eye` looking at `target` with +Y up.
    pub fn looking_at(eye: Vec3, target: Vec3, fov_y: f32) -> Self {
        Self {
            world_from_view: world_from_view_looking_at(eye, target),
            projection: Projection::Perspective { fov_y },
            ..Self::default()
        }
    }

    /// Ray through the continuous picture position (`x`, `y`), pixels, (0, 0) = top left corner, pixel centres at +0.5:
    /// (origin, unit direction), world space. Starts at the eye (perspective) or on the view plane (orthographic).
    pub fn ray(&self, x: f32, y: f32, width: u32, height: u32) -> (Vec3, Vec3) {
        let (half_w, half_h) = self.half_extent(width, height);
        let sx = (2.0 * x / width as f32 - 1.0) * half_w;
        let sy = (1.0 - 2.0 * y / height as f32) * half_h;
        let m = &self.world_from_view;
        match self.projection {
            Projection::Perspective { .. } => {
                let d = m.matrix3.x_axis * sx + m.matrix3.y_axis * sy - m.matrix3.z_axis;
                (m.translation, d / d.length())
            }
            Projection::Orthographic { .. } => {
                (m.translation + m.matrix3.x_axis * sx + m.matrix3.y_axis * sy, -m.matrix3.z_axis)
            }
        }
    }

    /// Half width and half height of the picture: on the plane one metre ahead (perspective), or in metres.
    pub fn half_extent(&self, width: u32, height: u32) -> (f32, f32) {
        let aspect = width as f32 / height as f32;
        let half_h = match self.projection {
            Projection::Perspective { fov_y } => math::tan(fov_y * 0.5),
            Projection::Orthographic { half_height } => half_height,
        };
        (half_h * aspect, half_h)
    }
}

/// Rigid pose at `eye`, -Z towards `target`, +Y as far up as possible (+Z where the view is vertical).
pub fn world_from_view_looking_at(eye: Vec3, target: Vec3) -> Affine3 {
    let z = (eye - target).normalize_or(Vec3::Z);
    let up = if z.x == 0.0 && z.z == 0.0 { Vec3::Z } else { Vec3::Y };
    let x = up.cross(z).normalize_or(Vec3::X);
    let y = z.cross(x);
    Affine3 { matrix3: glam::Mat3::from_cols(x, y, z), translation: eye }
}
