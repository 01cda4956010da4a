//! Light at a surface: direct (Blinn-Phong under shadowed lights) and indirect (VPLs). The same code shades what the camera
//! sees directly and what it sees in mirrors and through glass.

use catoptra_engine::{LightKind, Material, RenderScene, math};
use glam::Vec3;
use std::f32::consts::{FRAC_1_PI, TAU};

use super::{
    points::{PointBatch, accumulate_shadowed_vpls, accumulate_vpls},
    sampling,
    surface::{NormalMatrices, Surface},
};
use crate::{
    accel::{Accel, Ray},
    output::RayCounts,
    settings::{RenderSettings, Shadows, SimdLevel, VplShadows},
    twin::{
        certified::{Certainty, certify},
        shading::blinn_phong_lobe,
        shadow::ShadowMaps,
        vpl::{Vpl, vpl_irradiance},
        vpl_maps::VplMaps,
    },
};

/// Everything that is fixed while a frame's pixels are made.
#[derive(Clone, Copy)]
pub struct FrameContext<'a> {
    /// The scene.
    pub scene: &'a RenderScene,
    /// Normal matrices of its instances.
    pub normals: &'a NormalMatrices,
    /// Its two-level structure, up to date.
    pub accel: &'a Accel,
    /// Shadow maps; empty unless shadows are moments.
    pub maps: &'a ShadowMaps,
    /// VPLs with flux; empty where indirect light is off.
    pub vpls: &'a [Vpl],
    /// Their shadow maps; empty unless their visibility comes from maps.
    pub vpl_maps: &'a VplMaps,
    /// Bound of the geometry term, 1/m²; +infinity: none.
    pub geometry_term_max: f32,
    /// The frame's settings.
    pub settings: &'a RenderSettings,
    /// Resolved SIMD level.
    pub level: SimdLevel,
}

/// Fraction of light `light` that reaches the surface, in [0, 1].
/// * `pixel`: number of the picture's pixel; turns the pattern on the light's disc
pub fn light_visibility(ctx: &FrameContext, light: u32, s: &Surface, pixel: u32, rays: &mut RayCounts) -> f32 {
    match ctx.settings.shadows {
        Shadows::Off => 1.0,
        Shadows::Moments => {
            let position = ctx.scene.lights[light as usize].position_world;
            ctx.maps.visibility(light, position, s.position_world, &ctx.settings.moments)
        }
        Shadows::Traced | Shadows::Certified => {
            if ctx.settings.shadows == Shadows::Certified {
                match certify(ctx.maps, light, &ctx.scene.lights[light as usize], s) {
                    Certainty::Lit => return 1.0,
                    Certainty::Dark => return 0.0,
                    Certainty::Unknown => {}
                }
            }
            let samples = if ctx.scene.lights[light as usize].radius > 0.0 { ctx.settings.shadow_samples } else { 1 };
            let turn = sampling::hash_combine(sampling::hash_combine(ctx.settings.seed, pixel), light);
            let rotation = TAU * sampling::unit_f32(turn);
            let mut lit = 0;
            for i in 0..samples {
                let disc = sampling::vogel_disc(i, samples, rotation);
                if let Some(ray) = shadow_ray(ctx.scene, light, s, if samples == 1 { glam::Vec2::ZERO } else { disc }) {
                    rays.shadow += 1;
                    lit += u32::from(!ctx.accel.occluded(&ray));
                }
            }
            lit as f32 / samples as f32
        }
    }
}

/// Ray from the surface to the point `disc` (in the unit disc) of the light's disc, which faces the surface. `None` where
/// that point lies below the surface's plane.
pub fn shadow_ray(scene: &RenderScene, light: u32, s: &Surface, disc: glam::Vec2) -> Option<Ray> {
    let light = &scene.lights[light as usize];
    let (wi, _, _) = light.incident(s.position_world);
    let (t, b) = math::orthonormal_basis(wi);
    let across = (t * disc.x + b * disc.y) * light.radius;
    let (to_target, t_max) = match light.kind {
        LightKind::Directional => (wi + across, f32::INFINITY),
        _ => (light.position_world + across - s.position_world, 1.0),
    };
    if s.n_geometric.dot(to_target) <= 0.0 {
        return None;
    }
    let origin = s.offset_origin(to_target);
    let direction = if t_max == 1.0 { light.position_world + across - origin } else { to_target };
    Some(Ray { origin, direction, t_min: 0.0, t_max })
}

/// Radiance towards `wo` under all lights: Lambert and Blinn-Phong, ambient, emitted. Without indirect light.
///
/// Twin: `shaders/direct.wgsl`.
pub fn direct_light(ctx: &FrameContext, s: &Surface, wo: Vec3, pixel: u32, rays: &mut RayCounts) -> Vec3 {
    let m = &ctx.scene.materials[s.material as usize];
    if m.unlit {
        return s.emission;
    }
    let ambient = s.base_color * ctx.scene.environment.ambient * (m.ambient * s.look.matte_weight());
    let mut radiance = s.emission + ambient;
    for light in 0..ctx.scene.lights.len() as u32 {
        let unshadowed = reflected_from_light(ctx.scene, light, s, wo);
        if unshadowed != Vec3::ZERO {
            radiance += unshadowed * light_visibility(ctx, light, s, pixel, rays);
        }
    }
    radiance
}

/// Radiance towards `wo` that an unshadowed light causes: (k_d · base_color/π · matte + k_s · lobe) · N·L · incident.
#[inline]
pub fn reflected_from_light(scene: &RenderScene, light: u32, s: &Surface, wo: Vec3) -> Vec3 {
    let (wi, _, incident) = scene.lights[light as usize].incident(s.position_world);
    let n_dot_l = s.n_shading.dot(wi);
    if n_dot_l <= 0.0 || incident == Vec3::ZERO {
        return Vec3::ZERO;
    }
    let mut brdf = s.base_color * (s.look.diffuse * s.look.matte_weight() * FRAC_1_PI);
    if s.look.specular != Vec3::ZERO {
        brdf += s.look.specular * blinn_phong_lobe(s.n_shading, wi, wo, s.look.shininess);
    }
    brdf * incident * n_dot_l
}

/// Albedo that turns VPL irradiance into radiance: base_color/π · k_d · matte weight.
#[inline]
pub fn indirect_albedo(m: &Material, s: &Surface) -> Vec3 {
    if m.unlit { Vec3::ZERO } else { s.base_color * (s.look.diffuse * s.look.matte_weight() * FRAC_1_PI) }
}

/// Sets the irradiance of every point of the batch (which must be padded) by a run of the frame's VPLs.
/// * `surfaces`: the surfaces behind the points, in the same order; used where visibility is traced
pub fn indirect_light<'s>(
    ctx: &FrameContext,
    run: std::ops::Range<usize>,
    points: &mut PointBatch,
    surfaces: impl Iterator<Item = &'s Surface> + Clone,
    scratch: &mut VplRays,
    rays: &mut RayCounts,
) {
    let shadows = ctx.settings.vpl.map_or(VplShadows::Off, |v| v.shadows);
    let vpls = &ctx.vpls[run.clone()];
    if vpls.is_empty() || points.is_empty() {
        return;
    }
    match shadows {
        VplShadows::Off => return accumulate_vpls(ctx.level, points, vpls, ctx.geometry_term_max),
        VplShadows::Maps => {
            let (size, area) = (ctx.vpl_maps.size, (ctx.vpl_maps.size * ctx.vpl_maps.size) as usize);
            let maps = &ctx.vpl_maps.texels[run.start * area..run.end * area];
            return accumulate_shadowed_vpls(ctx.level, points, vpls, size, maps, ctx.geometry_term_max);
        }
        VplShadows::Traced => {}
    }
    for vpl in vpls {
        scratch.clear();
        for (i, s) in surfaces.clone().enumerate() {
            let irradiance = vpl_irradiance(vpl, s.position_world, s.n_shading, ctx.geometry_term_max);
            let target = vpl.position_world + vpl.normal_world * vpl.error;
            let to_vpl = target - s.position_world;
            if irradiance != Vec3::ZERO && s.n_geometric.dot(to_vpl) > 0.0 {
                let origin = s.offset_origin(to_vpl);
                scratch.rays.push(Ray { origin, direction: target - origin, t_min: 0.0, t_max: 1.0 });
                scratch.lit.push((i as u32, irradiance));
            }
        }
        scratch.occluded.resize(scratch.rays.len(), false);
        ctx.accel.occluded_many(&scratch.rays, &mut scratch.occluded);
        rays.vpl += scratch.rays.len() as u64;
        for ((i, irradiance), occluded) in scratch.lit.iter().zip(&scratch.occluded) {
            if !occluded {
                points.add(*i as usize, *irradiance);
            }
        }
    }
}

/// Memory for visibility rays towards one VPL, kept between calls.
#[derive(Clone, Debug, Default)]
pub struct VplRays {
    rays: Vec<Ray>,
    lit: Vec<(u32, Vec3)>,
    occluded: Vec<bool>,
}

impl VplRays {
    fn clear(&mut self) {
        self.rays.clear();
        self.lit.clear();
        self.occluded.clear();
    }
}
