//! Direct light of a batch of points: Lambert under each light, sixteen points at a time, times visibility.
//!
//! Highlights and traced visibility, which few points need, are computed one by one.

use catoptra_engine::{Light, LightKind};
use glam::Vec3;

use super::{
    filtered::add_filtered,
    points::{LANES, Lane, PointBatch, lanes, store},
    shade::FrameContext,
    visibility::Towards,
};
use crate::{accel::Ray, output::RayCounts, settings::Shadows, simd::dispatch, twin::shading::blinn_phong_lobe};

/// Adds the light of all lights to the radiance of every point of the batch, which must be padded, and have ray starts where
/// shadows are traced or certified.
/// * `pixel`: number of the picture's pixel that a point belongs to; turns the pattern on a light's disc
pub fn direct_light(ctx: &FrameContext, points: &mut PointBatch, pixel: impl Fn(usize) -> u32, rays: &mut RayCounts) {
    for (index, light) in ctx.scene.lights.iter().enumerate() {
        let index = index as u32;
        unshadowed(ctx.level, points, light);
        highlights(points, light);
        match ctx.settings.shadows {
            Shadows::Off => add(ctx.level, points),
            Shadows::Moments => add_filtered(ctx.level, points, ctx.maps, index, light, &ctx.settings.moments),
            // One ray a light: all points' rays go together.
            Shadows::Traced if light.radius <= 0.0 || ctx.settings.shadow_samples == 1 => {
                add_by_rays(ctx, points, index, rays);
            }
            Shadows::Traced | Shadows::Certified => {
                let mut askers = std::mem::take(&mut points.askers);
                askers.clear();
                let lit = |points: &PointBatch, i: &usize| unshadowed_at(points, *i) != Vec3::ZERO;
                for i in (0..points.len()).filter(|i| lit(points, i)) {
                    askers.push(points.ray_start(i), pixel(i));
                }
                askers.look(ctx, index, Towards::Disc, rays);
                let mut seen = askers.seen.iter();
                for i in 0..points.len() {
                    if lit(points, &i) {
                        let share = seen.next().copied().unwrap_or(0.0);
                        add_at(points, i, unshadowed_at(points, i) * share);
                    }
                }
                points.askers = askers;
            }
        }
    }
}

fn unshadowed_at(points: &PointBatch, i: usize) -> Vec3 {
    Vec3::from_array([0, 1, 2].map(|axis| points.unshadowed[axis][i]))
}

fn add_at(points: &mut PointBatch, i: usize, radiance: Vec3) {
    for axis in 0..3 {
        points.radiance[axis][i] += radiance[axis];
    }
}

/// Adds the unshadowed light of the points that a ray to the middle of the light's disc does not find occluded.
fn add_by_rays(ctx: &FrameContext, points: &mut PointBatch, index: u32, counts: &mut RayCounts) {
    let mut shadows = std::mem::take(&mut points.shadows);
    shadows.clear();
    let light = &ctx.scene.lights[index as usize];
    let t_max = if matches!(light.kind, LightKind::Directional) { f32::INFINITY } else { 1.0 };
    let mut lanes = ShadowLanes::default();
    for at in (0..points.len()).step_by(LANES) {
        shadow_lanes(ctx.level, points, at, light, &mut lanes);
        for lane in 0..LANES.min(points.len() - at) {
            if lanes.casts[lane] != 0 {
                let vec = |v: &[Lane; 3]| Vec3::new(v[0][lane], v[1][lane], v[2][lane]);
                let (origin, direction) = (vec(&lanes.origin), vec(&lanes.direction));
                shadows.rays.push(Ray { origin, direction, t_min: 0.0, t_max });
                shadows.of.push((at + lane) as u32);
            }
        }
    }
    counts.shadow += shadows.rays.len() as u64;
    shadows.occluded.resize(shadows.rays.len(), false);
    ctx.accel.occluded_many(&shadows.rays, &mut shadows.occluded);
    for (&i, occluded) in shadows.of.iter().zip(&shadows.occluded) {
        if !occluded {
            let seen = unshadowed_at(points, i as usize);
            add_at(points, i as usize, seen);
        }
    }
    points.shadows = shadows;
}

/// Sixteen rays towards a light.
#[derive(Default)]
struct ShadowLanes {
    origin: [Lane; 3],
    direction: [Lane; 3],
    /// Not 0: the point would be lit, so that its ray is worth casting.
    casts: [u32; LANES],
}

/// [`super::shade::shadow_ray`] to the middle of the light's disc, of the points from `at` on.
#[inline(always)]
fn shadow_lanes_body(points: &PointBatch, at: usize, light: &Light, out: &mut ShadowLanes) {
    let parallel = matches!(light.kind, LightKind::Directional);
    let (target, towards) = (light.position_world, -light.direction_world);
    let unshadowed = lanes(&points.unshadowed, at);
    let (p, n) = (lanes(&points.position, at), lanes(&points.n_geometric, at));
    let error = super::points::lane(&points.error, at);
    for lane in 0..LANES {
        let lit = (unshadowed[0][lane] != 0.0) | (unshadowed[1][lane] != 0.0) | (unshadowed[2][lane] != 0.0);
        let to = |axis: usize, from: f32| if parallel { towards[axis] } else { target[axis] - from };
        let to_target = [0, 1, 2].map(|axis| to(axis, p[axis][lane]));
        let above = (n[0][lane] * to_target[0] + n[1][lane] * to_target[1]) + n[2][lane] * to_target[2];
        out.casts[lane] = u32::from(lit & (above > 0.0));
        for axis in 0..3 {
            let origin = p[axis][lane] + n[axis][lane] * error[lane];
            out.origin[axis][lane] = origin;
            out.direction[axis][lane] = to(axis, origin);
        }
    }
}

dispatch! {
    fn shadow_lanes => shadow_lanes_body(points: &PointBatch, at: usize, light: &Light, out: &mut ShadowLanes)
}

/// Adds Blinn-Phong lobes to the unshadowed light of the points that have one.
fn highlights(points: &mut PointBatch, light: &Light) {
    for k in 0..points.glossy.len() {
        let glossy = points.glossy[k];
        let i = glossy.point as usize;
        let n = points.normal(i);
        let (wi, _, incident) = light.incident(points.position_world(i));
        let n_dot_l = n.dot(wi);
        if n_dot_l > 0.0 {
            let lobe = glossy.specular * blinn_phong_lobe(n, wi, glossy.wo, glossy.shininess) * incident * n_dot_l;
            for axis in 0..3 {
                points.unshadowed[axis][i] += lobe[axis];
            }
        }
    }
}

#[inline(always)]
fn unshadowed_body(points: &mut PointBatch, light: &Light) {
    let (position, towards, intensity) = (light.position_world, light.direction_world, light.intensity);
    let (parallel, spot, cos_outer, per_range) = match light.kind {
        LightKind::Directional => (true, false, 0.0, 1.0),
        LightKind::Point => (false, false, 0.0, 1.0),
        LightKind::Spot { cos_inner, cos_outer } => (false, true, cos_outer, 1.0 / (cos_inner - cos_outer).max(0.001)),
    };
    for at in (0..points.len()).step_by(LANES) {
        let (p, n) = (lanes(&points.position, at), lanes(&points.normal, at));
        let base = lanes(&points.base_color, at);
        let matte = super::points::lane(&points.matte, at);
        let mut out = [[0.0f32; LANES]; 3];
        for lane in 0..LANES {
            let (x, y, z) = (position.x - p[0][lane], position.y - p[1][lane], position.z - p[2][lane]);
            let d2 = (x * x + y * y) + z * z;
            let inverse = 1.0 / d2.sqrt();
            let (wx, wy, wz) = (x * inverse, y * inverse, z * inverse);
            let cos = -((wx * towards.x + wy * towards.y) + wz * towards.z);
            let x = (cos - cos_outer) * per_range;
            let x = if x > 0.0 { x } else { 0.0 };
            let x = if x < 1.0 { x } else { 1.0 };
            let falloff = if spot { x * x } else { 1.0 };
            let falloff = falloff * (inverse * inverse);
            // At the light's own place there is no light.
            let falloff = if d2 > 0.0 { falloff } else { 0.0 };
            let (wx, wy, wz) = if parallel { (-towards.x, -towards.y, -towards.z) } else { (wx, wy, wz) };
            let falloff = if parallel { 1.0 } else { falloff };
            let n_dot_l = (n[0][lane] * wx + n[1][lane] * wy) + n[2][lane] * wz;
            let received = if n_dot_l > 0.0 { n_dot_l * falloff } else { 0.0 };
            let reflected = received * matte[lane];
            out[0][lane] = base[0][lane] * (intensity.x * reflected);
            out[1][lane] = base[1][lane] * (intensity.y * reflected);
            out[2][lane] = base[2][lane] * (intensity.z * reflected);
        }
        store(&mut points.unshadowed, at, &out);
    }
}

dispatch! {
    /// Sets the radiance that one light would cause by the matte share: base · matte · N·L · incident.
    fn unshadowed => unshadowed_body(points: &mut PointBatch, light: &Light)
}

#[inline(always)]
fn add_body(points: &mut PointBatch) {
    for axis in 0..3 {
        for (r, u) in points.radiance[axis].iter_mut().zip(&points.unshadowed[axis]) {
            *r += u;
        }
    }
}

dispatch! { fn add => add_body(points: &mut PointBatch) }
