//! Sources of light paths: lights and emissive triangles, and how many paths each gets.

use catoptra_engine::{Aabb, Light, LightKind, RenderScene, math};
use glam::{Vec2, Vec3};
use std::f32::consts::{PI, TAU};

use super::sampling;
use crate::accel::Ray;

/// The start of a light path.
#[derive(Clone, Copy, Debug)]
pub struct EmittedRay {
    /// Where and whither.
    pub ray: Ray,
    /// Flux that the path carries if it were the source's only one; divide by the source's number of paths.
    pub flux: Vec3,
}

/// Emits from a light in its own frame, so that the paths move smoothly with its pose.
/// * `xi`: in [0, 1)²
///
/// Flux: point 4π·I; spot Ω·I(θ), uniform in the outer cone; directional π R² E over the disc that covers the scene.
pub fn emit_from_light(light: &Light, bounds: Aabb, xi: Vec2) -> EmittedRay {
    let z = light.direction_world;
    let x = light.up_world.cross(z).normalize_or(math::orthonormal_basis(z).0);
    let y = z.cross(x);
    let to_world = |d: Vec3| x * d.x + y * d.y + z * d.z;
    match light.kind {
        LightKind::Point => {
            let d = sampling::sphere_direction(xi);
            EmittedRay { ray: Ray::new(light.position_world, to_world(d)), flux: light.intensity * (4.0 * PI) }
        }
        LightKind::Spot { cos_inner, cos_outer } => {
            let cos_theta = 1.0 - xi.x * (1.0 - cos_outer);
            let sin_theta = (1.0 - cos_theta * cos_theta).max(0.0).sqrt();
            let (s, c) = math::sin_cos(TAU * xi.y);
            let d = Vec3::new(sin_theta * c, sin_theta * s, cos_theta);
            let falloff = catoptra_engine::light::spot_falloff(cos_theta, cos_inner, cos_outer);
            let solid_angle = TAU * (1.0 - cos_outer);
            EmittedRay {
                ray: Ray::new(light.position_world, to_world(d)),
                flux: light.intensity * (solid_angle * falloff),
            }
        }
        LightKind::Directional => {
            let radius = bounds.radius();
            let disc = sampling::concentric_disc(xi) * radius;
            let origin = bounds.center() + x * disc.x + y * disc.y - z * (radius * 2.0);
            EmittedRay { ray: Ray::new(origin, z), flux: light.intensity * (PI * radius * radius) }
        }
    }
}

/// Where a source's own frame lies: what a path starts with there stays the same however the source moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SourceFrame {
    /// Of the source's frame, world space.
    pub origin: Vec3,
    /// World metres to one unit of the source's frame.
    pub scale: f32,
    /// Its unit axes, world space.
    pub axes: [Vec3; 3],
    /// Factor of the flux.
    pub flux: Vec3,
}

impl SourceFrame {
    /// The world's own.
    pub const WORLD: Self = Self { origin: Vec3::ZERO, scale: 1.0, axes: [Vec3::X, Vec3::Y, Vec3::Z], flux: Vec3::ONE };

    /// That of a light: [`emit_from_light`] is [`emit_in_frame`] placed by it, but for rounding.
    pub fn of(light: &Light, bounds: Aabb) -> Self {
        let z = light.direction_world;
        let x = light.up_world.cross(z).normalize_or(math::orthonormal_basis(z).0);
        let axes = [x, z.cross(x), z];
        match light.kind {
            LightKind::Point | LightKind::Spot { .. } => {
                Self { origin: light.position_world, scale: 1.0, axes, flux: light.intensity }
            }
            LightKind::Directional => {
                let radius = bounds.radius();
                Self { origin: bounds.center(), scale: radius, axes, flux: light.intensity * (radius * radius) }
            }
        }
    }

    /// An emission in this frame, in the world.
    pub fn place(&self, e: EmittedRay) -> EmittedRay {
        let [x, y, z] = self.axes;
        let to_world = |d: Vec3| x * d.x + y * d.y + z * d.z;
        let origin = self.origin + to_world(e.ray.origin) * self.scale;
        EmittedRay { ray: Ray { origin, direction: to_world(e.ray.direction), ..e.ray }, flux: e.flux * self.flux }
    }
}

/// [`emit_from_light`] of a light of unit intensity in its own frame, in a scene of unit radius.
pub fn emit_in_frame(kind: LightKind, xi: Vec2) -> EmittedRay {
    let light = Light {
        kind,
        direction_world: Vec3::Z,
        up_world: Vec3::Y,
        intensity: Vec3::ONE,
        ..Light::point(0, Vec3::ZERO)
    };
    emit_from_light(&light, Aabb { min: Vec3::NEG_X, max: Vec3::X }, xi)
}

/// A triangle that emits, for area sampling.
#[derive(Clone, Copy, Debug)]
pub struct EmissiveTriangle {
    /// Instance in the scene.
    pub instance_id: u32,
    /// Triangle of the mesh.
    pub primitive_id: u32,
    /// World area in m².
    pub area: f32,
    /// Sum of area · mean emitted radiance over this and all earlier triangles.
    pub cumulative: f32,
}

/// All emissive triangles in the order of (instance, primitive). `unlit` surfaces show light but do not give any.
pub fn emissive_triangles(scene: &RenderScene, out: &mut Vec<EmissiveTriangle>) {
    out.clear();
    let mut cumulative = 0.0;
    for (instance_id, instance) in scene.instances.iter().enumerate() {
        let m = &scene.materials[instance.material as usize];
        let radiance = m.emissive.element_sum() / 3.0;
        if radiance <= 0.0 {
            continue;
        }
        let mesh = &scene.meshes[instance.mesh as usize];
        for primitive_id in 0..mesh.triangles().len() as u32 {
            let [a, b, c] = mesh.corners(primitive_id).map(|p| instance.world_from_object.transform_point3(p));
            let area = 0.5 * (b - a).cross(c - a).length();
            if area > 0.0 && area.is_finite() {
                cumulative += area * radiance;
                out.push(EmissiveTriangle { instance_id: instance_id as u32, primitive_id, area, cumulative });
            }
        }
    }
}

/// Mean over channels of the flux that a light sends into the scene; what path numbers are shared out by.
fn power(light: &Light, bounds: Aabb) -> f32 {
    let intensity = light.intensity.element_sum() / 3.0;
    match light.kind {
        LightKind::Point => 4.0 * PI * intensity,
        LightKind::Spot { cos_inner, cos_outer } => TAU * intensity * (1.0 - 0.5 * (cos_inner + cos_outer)),
        LightKind::Directional => PI * bounds.radius() * bounds.radius() * intensity,
    }
}

/// How many light paths each source gets, and memory to find out.
#[derive(Clone, Debug, Default)]
pub struct PathShares {
    /// One a light, and as the last entry the emissive triangles together.
    pub shares: Vec<u32>,
    powers: Vec<f32>,
    order: Vec<usize>,
}

impl PathShares {
    /// Shares `paths` out in proportion to power by largest remainders, at least one for each source that emits.
    pub fn update(&mut self, scene: &RenderScene, emissive: &[EmissiveTriangle], bounds: Aabb, paths: u32) {
        let Self { shares, powers, order } = self;
        powers.clear();
        powers.extend(scene.lights.iter().map(|l| power(l, bounds)));
        // Both sides of an emissive surface radiate: 2π per area and radiance.
        powers.push(emissive.last().map_or(0.0, |t| TAU * t.cumulative));
        shares.clear();
        let total: f32 = powers.iter().sum();
        if total <= 0.0 || !total.is_finite() {
            shares.resize(powers.len(), 0);
            return;
        }
        let exact = |p: f32| p / total * paths as f32;
        shares.extend(powers.iter().map(|&p| if p > 0.0 { (exact(p).floor() as u32).max(1) } else { 0 }));
        order.clear();
        order.extend((0..powers.len()).filter(|&i| powers[i] > 0.0));
        order.sort_unstable_by(|&a, &b| {
            let fraction = |i: usize| exact(powers[i]).fract();
            fraction(b).total_cmp(&fraction(a)).then(a.cmp(&b))
        });
        let given: u32 = shares.iter().sum();
        for &i in order.iter().cycle().take(paths.saturating_sub(given) as usize) {
            shares[i] += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn starts_in_the_lights_own_frame_are_those_in_the_world() {
        let bounds = Aabb { min: Vec3::new(-3.0, 0.0, -1.0), max: Vec3::new(2.0, 4.0, 7.0) };
        let kinds = [LightKind::Point, LightKind::Spot { cos_inner: 0.9, cos_outer: 0.6 }, LightKind::Directional];
        for (k, kind) in kinds.into_iter().enumerate() {
            let direction_world = Vec3::new(0.3, -0.8, 0.1 * k as f32).normalize();
            let light = Light {
                kind,
                direction_world,
                up_world: math::orthonormal_basis(direction_world).1,
                intensity: Vec3::new(3.0, 2.0, 0.5),
                ..Light::point(1, Vec3::new(0.5, 3.0, -2.0))
            };
            for i in 0..64u32 {
                let xi = Vec2::new((i as f32 + 0.5) / 64.0, sampling::radical_inverse(2, i));
                let own = emit_from_light(&light, bounds, xi);
                let placed = SourceFrame::of(&light, bounds).place(emit_in_frame(kind, xi));
                assert!((own.ray.origin - placed.ray.origin).length() <= 1e-5 * bounds.radius(), "{kind:?} {xi}");
                assert!((own.ray.direction - placed.ray.direction).length() <= 1e-6, "{kind:?} {xi}");
                assert!((own.flux - placed.flux).abs().max_element() <= 1e-5 * own.flux.max_element(), "{kind:?} {xi}");
            }
        }
    }
}
