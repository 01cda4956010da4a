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
