//! Light at a surface: visibility of lights, and indirect light by VPLs. The same code shades what the camera sees directly and
//! what it sees in mirrors and through glass.

use catoptra_engine::{LightKind, RenderScene, math};
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

use super::{
    near::NearLights,
    points::{Emitter, PointBatch, accumulate_shadowed_vpls, accumulate_vpls},
    surface::{NormalMatrices, RayStart, Surface},
};
use crate::{
    accel::{Accel, Ray},
    output::RayCounts,
    settings::{RenderSettings, Shadows, SimdLevel, VplShadows},
    twin::{
        grid::IrradianceGrid,
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
    /// The same as the kernels read them.
    pub emitters: &'a [Emitter],
    /// Their shadow maps; empty unless their visibility comes from maps.
    pub vpl_maps: &'a VplMaps,
    /// What lights that which stands close to a place of the grid.
    pub(crate) near_lights: &'a NearLights,
    /// What lights the hits of mirrors and glass where that is a set of its own.
    pub mirrored: Option<&'a [Emitter]>,
    /// Indirect light on a grid of the picture; not built where pixels are lit one by one.
    pub grid: &'a IrradianceGrid,
    /// Bound of the geometry term, 1/m²; +infinity: none.
    pub geometry_term_max: f32,
    /// The frame's settings.
    pub settings: &'a RenderSettings,
    /// Resolved SIMD level.
    pub level: SimdLevel,
    /// Number of the frame: what a thread keeps belongs to one frame.
    pub serial: u64,
}

/// True where rays start from every pixel's surface.
pub fn wants_ray_starts(ctx: &FrameContext) -> bool {
    let traced_vpls = ctx.settings.vpl.is_some_and(|v| v.shadows == VplShadows::Traced);
    traced_vpls || matches!(ctx.settings.shadows, Shadows::Traced | Shadows::Certified)
}

/// Ray from the surface to the point `disc` (in the unit disc) of the light's disc, which faces the surface. `None` where
/// that point lies below the surface's plane.
pub fn shadow_ray(scene: &RenderScene, light: u32, s: &RayStart, disc: glam::Vec2) -> Option<Ray> {
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

/// Sets the irradiance of every point of the batch (which must be padded) by a run of the frame's VPLs. Where visibility is
/// traced, the batch has ray starts.
pub fn indirect_light(
    ctx: &FrameContext,
    run: std::ops::Range<usize>,
    points: &mut PointBatch,
    scratch: &mut VplRays,
    rays: &mut RayCounts,
) {
    let shadows = ctx.settings.vpl.map_or(VplShadows::Off, |v| v.shadows);
    let vpls = &ctx.vpls[run.clone()];
    if vpls.is_empty() || points.is_empty() {
        return points.darken();
    }
    match shadows {
        VplShadows::Off => {
            return accumulate_vpls(ctx.level, points, &ctx.emitters[run], ctx.geometry_term_max);
        }
        VplShadows::Maps => {
            let (size, area) = (ctx.vpl_maps.size, (ctx.vpl_maps.size * ctx.vpl_maps.size) as usize);
            let maps = &ctx.vpl_maps.texels[run.start * area..run.end * area];
            return accumulate_shadowed_vpls(ctx.level, points, vpls, size, maps, ctx.geometry_term_max);
        }
        VplShadows::Traced => points.darken(),
    }
    for vpl in vpls {
        scratch.clear();
        for i in 0..points.len() {
            // Points without a matte share receive nothing.
            if points.albedo(i) == Vec3::ZERO {
                continue;
            }
            let s = points.ray_start(i);
            let irradiance = vpl_irradiance(vpl, s.position_world, points.normal(i), ctx.geometry_term_max);
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

/// Sets the irradiance of every hit of a mirror's or a glass's rays (a padded batch), as [`indirect_light`] does.
pub fn indirect_light_of_hits(
    ctx: &FrameContext,
    points: &mut PointBatch,
    scratch: &mut VplRays,
    rays: &mut RayCounts,
) {
    match ctx.mirrored {
        Some(emitters) => accumulate_vpls(ctx.level, points, emitters, ctx.geometry_term_max),
        None => indirect_light(ctx, 0..ctx.vpls.len(), points, scratch, rays),
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
