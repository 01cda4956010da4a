//! Point, spot and directional lights, with the photometry of `KHR_lights_punctual`.

use glam::Vec3;

/// Shape of a light's emission.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub enum LightKind {
    /// Equal in all directions.
    #[default]
    Point,
    /// A cone around the direction; smooth between the inner and the outer angle.
    Spot {
        /// Cosine of the angle up to which intensity is full.
        cos_inner: f32,
        /// Cosine of the angle beyond which intensity is zero; less than `cos_inner`.
        cos_outer: f32,
    },
    /// Parallel light from infinitely far.
    Directional,
}

/// A light in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Orders lights in the scene.
    pub stable_id: u64,
    /// Shape of emission.
    pub kind: LightKind,
    /// Position, metres. Unused by directional lights.
    pub position_world: Vec3,
    /// Unit direction in which it shines.
    pub direction_world: Vec3,
    /// Unit vector across the direction: with it the light has a frame of its own, in which emission is sampled.
    pub up_world: Vec3,
    /// Radiant intensity per channel (point, spot: W/sr or candela as the file says) or irradiance at normal incidence
    /// (directional: W/m² or lux).
    pub intensity: Vec3,
    /// Radius in metres of the disc that faces the shaded point (point, spot), or the tangent of the angular radius
    /// (directional). 0 gives hard shadows.
    pub radius: f32,
}

impl Light {
    /// A hard point light of 1 W/sr per channel at `position_world`.
    pub fn point(stable_id: u64, position_world: Vec3) -> Self {
        Self {
            stable_id,
            kind: LightKind::Point,
            position_world,
            direction_world: Vec3::NEG_Z,
            up_world: Vec3::Y,
            intensity: Vec3::ONE,
            radius: 0.0,
        }
    }

    /// Light towards a point: (unit direction from `point_world` to the light, distance, radiant intensity / distance² per
    /// channel before the receiver's cosine). Directional: distance is +infinity. Zero light at the light's own position.
    ///
    /// Twin: `shaders/shared/light.wgsl` (tests/twins.rs).
    #[inline]
    pub fn incident(&self, point_world: Vec3) -> (Vec3, f32, Vec3) {
        if let LightKind::Directional = self.kind {
            return (-self.direction_world, f32::INFINITY, self.intensity);
        }
        let to_light = self.position_world - point_world;
        let distance_squared = to_light.dot(to_light);
        if distance_squared <= 0.0 {
            return (Vec3::Y, 0.0, Vec3::ZERO);
        }
        let distance = distance_squared.sqrt();
        let wi = to_light / distance;
        let falloff = match self.kind {
            LightKind::Spot { cos_inner, cos_outer } => {
                spot_falloff(-wi.dot(self.direction_world), cos_inner, cos_outer)
            }
            _ => 1.0,
        };
        (wi, distance, self.intensity * (falloff / distance_squared))
    }
}

/// glTF's recommended spot falloff: clamp((cos θ − cos outer)/max(0.001, cos inner − cos outer), 0, 1)².
///
/// Twin: `shaders/shared/light.wgsl` (tests/twins.rs).
#[inline]
pub fn spot_falloff(cos_theta: f32, cos_inner: f32, cos_outer: f32) -> f32 {
    let x = ((cos_theta - cos_outer) / (cos_inner - cos_outer).max(0.001)).clamp(0.0, 1.0);
    x * x
}
