//! Mirrors and glass under a cap on rays.
//!
//! Where the cap allows fewer than [`RAYS_A_PIXEL`] rays for each mirror and glass pixel, only every n-th pixel of every n-th
//! row is traced, and the others take over what their traced neighbours on the same thing see. All traced pixels then go wave
//! by wave, one interface deeper each time; where a wave has more rays than are left, those of the least weight end, in all
//! of the picture alike: depth goes first where it shows least, in dim reflections of reflections. Rays are counted, never
//! time, and every choice depends on the picture alone: a budgeted frame has the same bits on every machine.
//!
//! Source of the guided up-sampling: Kopf et al., "Joint Bilateral Upsampling", SIGGRAPH 2007.

use glam::Vec3;
use rayon::prelude::*;

use super::{
    sampling,
    shade::FrameContext,
    surface::surface_at,
    whitted::{self, MaskedPixel, WhittedScratch},
};
use crate::{
    accel::Ray,
    output::RayCounts,
    settings::{NearField, RenderSettings, VplOptions, VplPlacement, VplShadows},
};

/// Pixels that one task traces. It never shows.
const CHUNK: usize = 1024;

/// Rays that a traced pixel should have on the whole. Higher: fewer pixels are traced, more deeply.
pub const RAYS_A_PIXEL: u64 = 4;

/// The cap's part that making VPLs and their maps may take is one in so many.
const VPL_PART: u64 = 4;
/// Fewer VPLs are no light to play by: they are made under any cap.
const LEAST_VPLS: u32 = 16;

/// Normals whose cosine is less see something else.
const LEAST_COSINE: f32 = 0.9;

/// The settings with as many VPLs as the cap allows, and without the rays around the grid's places. It depends on the settings alone, so that light does not jump from frame
/// to frame.
pub fn within_budget(settings: &RenderSettings) -> RenderSettings {
    let fewer = |budget, vpl: VplOptions| VplOptions {
        count: vpls_within(budget, &vpl),
        placement: VplPlacement::Paths,
        near_field: NearField::Off,
        ..vpl
    };
    let vpl = settings.ray_budget.map_or(settings.vpl, |budget| settings.vpl.map(|v| fewer(budget, v)));
    RenderSettings { vpl, ..*settings }
}

fn vpls_within(budget: u64, vpl: &VplOptions) -> u32 {
    let map = if vpl.shadows == VplShadows::Maps { u64::from(vpl.map_size).pow(2) } else { 0 };
    let each = (u64::from(vpl.bounces) + 1) * u64::from(vpl.candidates) + map;
    let affordable = (budget / VPL_PART / each).min(u64::from(vpl.count)) as u32;
    // Whole subsets, where they are interleaved.
    let subset = vpl.interleave.max(1).pow(2);
    (affordable / subset * subset).max(LEAST_VPLS).min(vpl.count)
}

/// Radiance that mirrors and glass add to each pixel of the list, by at most `budget` rays (those that hits send to lights
/// and VPLs count, too, but end nothing until the next wave).
pub fn trace(ctx: &FrameContext, pixels: &[MaskedPixel], budget: u64, counts: &mut RayCounts) -> Vec<Vec3> {
    let wanted = RAYS_A_PIXEL * pixels.len() as u64;
    let step = (1..64).find(|n| wanted <= budget.saturating_mul(n * n)).unwrap_or(64) as u32;
    if step == 1 {
        return trace_all(ctx, pixels, budget, counts);
    }
    let width = ctx.settings.width;
    let place = |p: &MaskedPixel| (p.pixel % width, p.pixel / width);
    let chosen: Vec<MaskedPixel> = pixels
        .iter()
        .filter(|p| {
            let (x, y) = place(p);
            x % step == 0 && y % step == 0
        })
        .copied()
        .collect();
    let traced = trace_all(ctx, &chosen, budget, counts);
    let normal = |p: &MaskedPixel| {
        let ray = Ray::new(Vec3::ZERO, p.direction);
        surface_at(ctx.scene, ctx.normals, &ray, &p.hit).n_shading
    };
    let chosen: Vec<(MaskedPixel, Vec3)> = chosen.into_iter().map(|p| (p, normal(&p))).collect();
    // Where on the grid of traced pixels each of them is.
    let columns = width.div_ceil(step);
    let mut grid = vec![u32::MAX; (columns * ctx.settings.height.div_ceil(step)) as usize];
    for (i, (p, _)) in chosen.iter().enumerate() {
        let (x, y) = place(p);
        grid[(y / step * columns + x / step) as usize] = i as u32;
    }
    pixels
        .par_iter()
        .map(|p| {
            let ((x, y), n) = (place(p), normal(p));
            let (mut sum, mut weights) = (Vec3::ZERO, 0.0f32);
            for row in (y / step).saturating_sub(1)..=(y / step + 2) {
                for column in (x / step).saturating_sub(1)..=(x / step + 2).min(columns - 1) {
                    let Some(&i) = grid.get((row * columns + column) as usize).filter(|&&i| i != u32::MAX) else {
                        continue;
                    };
                    let (other, n_other) = &chosen[i as usize];
                    let alike = other.hit.instance_id == p.hit.instance_id && n_other.dot(n) >= LEAST_COSINE;
                    if alike {
                        let dx = (column * step) as f32 - x as f32;
                        let dy = (row * step) as f32 - y as f32;
                        // A traced pixel is itself, its neighbours fall off quickly.
                        let distance = (dx * dx + dy * dy) / (step * step) as f32;
                        let weight = 1.0 / (1e-4 + distance * distance);
                        sum += traced[i as usize] * weight;
                        weights += weight;
                    }
                }
            }
            if weights > 0.0 { sum / weights } else { Vec3::ZERO }
        })
        .collect()
}

fn trace_all(ctx: &FrameContext, pixels: &[MaskedPixel], budget: u64, counts: &mut RayCounts) -> Vec<Vec3> {
    struct Part<'a> {
        pixels: &'a [MaskedPixel],
        scratch: WhittedScratch,
        radiance: Vec<Vec3>,
        counts: RayCounts,
    }
    let mut parts: Vec<Part> = pixels
        .par_chunks(CHUNK)
        .map(|pixels| {
            let (mut scratch, mut radiance) = (WhittedScratch::default(), Vec::new());
            whitted::begin(ctx, pixels, &mut scratch, &mut radiance);
            Part { pixels, scratch, radiance, counts: RayCounts::default() }
        })
        .collect();
    let mut left = budget;
    loop {
        let wave: u64 = parts.iter().map(|p| p.scratch.wave_len() as u64).sum();
        if wave > left {
            let ranks = parts.iter().flat_map(|p| p.scratch.weights().map(|(slot, w)| rank(p.pixels[slot].pixel, w)));
            let least = least_rank(left, ranks);
            parts.par_iter_mut().for_each(|p| {
                let pixels = p.pixels;
                p.scratch.keep(|slot, w| rank(pixels[slot].pixel, w) >= least);
            });
        }
        if parts.iter().all(|p| p.scratch.wave_len() == 0) {
            break;
        }
        parts.par_iter_mut().for_each(|p| {
            whitted::trace_wave(ctx, p.pixels, &mut p.scratch, &mut p.radiance, &mut p.counts);
        });
        let spent: u64 = parts.iter().map(|p| p.counts.total()).sum();
        left = budget.saturating_sub(spent);
    }
    *counts = parts.iter().fold(*counts, |c, p| c.merged(p.counts));
    parts.into_iter().flat_map(|p| p.radiance).collect()
}

/// Which rays stay first: by weight in classes of 32 to the octave, within a class by a hash of the pixel, so that a class
/// that does not fit as a whole is thinned out evenly.
fn rank(pixel: u32, weight: f32) -> u32 {
    // Positive floats are ordered as their bits are.
    let class = weight.max(0.0).to_bits() >> 18;
    class << 8 | sampling::hash_u32(pixel) >> 24
}

/// A rank that at most `most` of the ranks reach.
fn least_rank(most: u64, ranks: impl Iterator<Item = u32>) -> u32 {
    let mut classes = vec![0u32; 1 << 21];
    for r in ranks {
        classes[r as usize] += 1;
    }
    let mut sum = 0;
    for rank in (0..classes.len()).rev() {
        sum += u64::from(classes[rank]);
        if sum > most {
            return rank as u32 + 1;
        }
    }
    0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vpls_are_as_many_as_a_quarter_of_the_cap_pays_for() {
        let vpl =
            VplOptions { count: 256, bounces: 2, shadows: VplShadows::Maps, map_size: 32, ..VplOptions::default() };
        assert_eq!(vpls_within(400_000, &vpl), 97);
        assert_eq!(vpls_within(400_000, &VplOptions { interleave: 4, ..vpl }), 96);
        assert_eq!(vpls_within(400_000, &VplOptions { shadows: VplShadows::Off, ..vpl }), 256);
        assert_eq!((vpls_within(0, &vpl), vpls_within(u64::MAX, &vpl)), (LEAST_VPLS, 256));
        assert_eq!(vpls_within(0, &VplOptions { count: 3, ..vpl }), 3);
        let free = RenderSettings { vpl: Some(vpl), ..RenderSettings::default() };
        assert_eq!(within_budget(&free), free);
        let capped = RenderSettings { ray_budget: Some(400_000), ..free };
        assert_eq!(within_budget(&capped).vpl.map(|v| v.count), Some(97));
    }

    #[test]
    fn the_least_rank_keeps_no_more_than_it_may_and_little_less() {
        // Half of the rays have one weight.
        let ray = |i: u32| (i, if i % 2 == 0 { 0.92 } else { ((i * 37) % 1000) as f32 / 1000.0 });
        for most in [0u64, 1, 10, 500, 999, 1000, 5000] {
            let least = least_rank(most, (0..1000).map(ray).map(|(p, w)| rank(p, w)));
            let kept = (0..1000).map(ray).filter(|&(p, w)| rank(p, w) >= least).count() as u64;
            assert!(kept <= most && kept + 12 >= most.min(1000), "{kept} for {most}");
        }
        assert!(rank(7, 0.5) > rank(8, 0.4) && rank(7, 0.5) < rank(7, 0.6));
    }
}
