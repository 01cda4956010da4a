//! How much of a light surfaces see: from its shadow maps, or by rays to its disc. The rays of all surfaces to one part of the
//! disc go together, so that neighbours walk the structure side by side.

use std::f32::consts::TAU;

use super::{
    points::make_room,
    sampling,
    shade::{FrameContext, shadow_ray},
    surface::RayStart,
};
use crate::{
    accel::Ray,
    output::RayCounts,
    settings::Shadows,
    twin::certified::{Certainty, certify},
};

/// Rays of a light's disc that may speak for all where shadows are certified.
const PROBES: u32 = 6;

/// Where rays go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Towards {
    /// As the settings' shadows have it.
    Disc,
    /// To the middle of the disc alone, unless there are no shadows. No map is asked.
    Middle,
}

/// Surfaces that ask for a light, and memory for their rays.
#[derive(Clone, Debug, Default)]
pub(crate) struct Askers {
    asking: Vec<Asking>,
    /// Numbers of those that rays go from.
    by_rays: Vec<u32>,
    rays: Vec<Ray>,
    /// Who sent each.
    of: Vec<u32>,
    occluded: Vec<bool>,
    /// Fraction of the light that reaches each, in [0, 1], in the order in which they were added.
    pub seen: Vec<f32>,
}

#[derive(Clone, Copy, Debug)]
struct Asking {
    start: RayStart,
    pixel: u32,
    /// Turns the pattern on the light's disc, radians.
    rotation: f32,
    /// Rays that met nothing.
    lit: u32,
}

impl Askers {
    /// Makes room for so many.
    pub fn reserve(&mut self, surfaces: usize) {
        make_room(&mut self.asking, surfaces);
        make_room(&mut self.by_rays, surfaces);
        make_room(&mut self.rays, surfaces);
        make_room(&mut self.of, surfaces);
        make_room(&mut self.occluded, surfaces);
        make_room(&mut self.seen, surfaces);
    }

    pub fn clear(&mut self) {
        self.asking.clear();
        self.seen.clear();
    }

    /// * `pixel`: number of the picture's pixel; turns the pattern on the light's disc
    pub fn push(&mut self, start: RayStart, pixel: u32) {
        self.asking.push(Asking { start, pixel, rotation: 0.0, lit: 0 });
    }

    /// Finds out how much of light number `light` each of them sees.
    pub fn look(&mut self, ctx: &FrameContext, light: u32, towards: Towards, counts: &mut RayCounts) {
        self.seen.clear();
        match (ctx.settings.shadows, towards) {
            (Shadows::Off, _) => self.seen.resize(self.asking.len(), 1.0),
            (Shadows::Moments, Towards::Disc) => {
                let position = ctx.scene.lights[light as usize].position_world;
                let of =
                    |a: &Asking| ctx.maps.visibility(light, position, a.start.position_world, &ctx.settings.moments);
                self.seen.extend(self.asking.iter().map(of));
            }
            (Shadows::Traced | Shadows::Certified, _) | (_, Towards::Middle) => {
                self.look_by_rays(ctx, light, towards, counts);
            }
        }
    }

    fn look_by_rays(&mut self, ctx: &FrameContext, light: u32, towards: Towards, counts: &mut RayCounts) {
        let source = &ctx.scene.lights[light as usize];
        let certified = ctx.settings.shadows == Shadows::Certified && towards == Towards::Disc;
        let one = towards == Towards::Middle || source.radius <= 0.0;
        let samples = if one { 1 } else { ctx.settings.shadow_samples };
        self.seen.resize(self.asking.len(), 0.0);
        self.by_rays.clear();
        for (i, asking) in self.asking.iter_mut().enumerate() {
            let certainty =
                if certified { certify(ctx.maps, light, source, &asking.start) } else { Certainty::Unknown };
            match certainty {
                Certainty::Lit => self.seen[i] = 1.0,
                Certainty::Dark => {}
                Certainty::Unknown => {
                    let turn = sampling::hash_combine(sampling::hash_combine(ctx.settings.seed, asking.pixel), light);
                    asking.rotation = TAU * sampling::unit_f32(turn);
                    self.by_rays.push(i as u32);
                }
            }
        }
        // Those on the rim first: where they and the middle agree, so do (nearly always) those between.
        let probes = PROBES.min(samples);
        for i in (samples - probes + 1..samples).chain([0]) {
            self.cast(ctx, light, [i, samples], counts);
        }
        if certified && samples > probes {
            let (asking, seen) = (&self.asking, &mut self.seen);
            self.by_rays.retain(|&i| {
                let lit = asking[i as usize].lit;
                seen[i as usize] = if lit == 0 { 0.0 } else { 1.0 };
                lit != 0 && lit != probes
            });
        }
        for i in 1..samples - probes + 1 {
            self.cast(ctx, light, [i, samples], counts);
        }
        for &i in &self.by_rays {
            self.seen[i as usize] = self.asking[i as usize].lit as f32 / samples as f32;
        }
    }

    /// Sends a ray of each to sample `i` of `samples`.
    fn cast(&mut self, ctx: &FrameContext, light: u32, [i, samples]: [u32; 2], counts: &mut RayCounts) {
        self.rays.clear();
        self.of.clear();
        for &k in &self.by_rays {
            let asking = &self.asking[k as usize];
            let disc = if samples == 1 { glam::Vec2::ZERO } else { sampling::vogel_disc(i, samples, asking.rotation) };
            if let Some(ray) = shadow_ray(ctx.scene, light, &asking.start, disc) {
                self.rays.push(ray);
                self.of.push(k);
            }
        }
        counts.shadow += self.rays.len() as u64;
        self.occluded.clear();
        self.occluded.resize(self.rays.len(), false);
        ctx.accel.occluded_many(&self.rays, &mut self.occluded);
        for (&k, occluded) in self.of.iter().zip(&self.occluded) {
            self.asking[k as usize].lit += u32::from(!occluded);
        }
    }
}
