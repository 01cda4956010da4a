//! Which of many candidate VPLs light a frame: those that give most to what the camera sees.
//!
//! Light that falls on a roof lights nothing within. Candidates are scored by what they would give, without shadows, to a fixed
//! pattern of places in the picture, as a share of what all candidates give there, so that dark corners count as much as
//! bright floors. Priority sampling then keeps exactly as many as are wanted: each has a number ξ of its own that never
//! changes, its priority is score/ξ, and with the threshold τ, the priority of the first that is left out, a kept one stands
//! for max(1, τ/score) of its kind. Near the threshold it fades, so that light does not jump where a camera moves.
//!
//! Sources: Georgiev & Slusallek, "Simple and Robust Iterative Importance Sampling of Virtual Point Lights", Eurographics 2010
//! (resampling by the contribution to the picture); Duffield, Lund & Thorup, "Priority Sampling for Estimation of Arbitrary
//! Subset Sums", JACM 2007.

use catoptra_engine::RenderScene;
use glam::Vec3;
use rayon::prelude::*;

use super::{
    camera_rays::camera_ray,
    points::{LANES, Lane, make_room},
    sampling,
    surface::{NormalMatrices, surface_at},
};
use crate::{
    accel::{Accel, Hit, Ray},
    settings::SimdLevel,
    simd::dispatch,
    twin::vpl::{Vpl, geometry_term},
};

/// Places a side of the picture's pattern. Higher: scores closer to the picture, quadratic cost.
const PLACES_A_SIDE: u32 = 16;

/// Part of the score that goes by flux alone: what no place of the pattern sees may be seen between them, or in mirrors.
const BLIND_PART: f32 = 0.1;

/// Part of a place's light that is the mean of all places': where nothing arrives nothing counts much.
const MEAN_PART: f32 = 0.05;

/// Part of the way to the threshold along which a VPL fades. Higher: smoother changes, more noise.
const FADE: f32 = 0.3;

/// Memory of the choice, kept between frames.
#[derive(Clone, Debug, Default)]
pub(crate) struct Choice {
    rays: Vec<Ray>,
    hits: Vec<Hit>,
    places: Vec<Places>,
    scores: Vec<f32>,
    priorities: Vec<f32>,
    order: Vec<f32>,
}

/// What is looked at.
pub(crate) struct View<'a> {
    pub scene: &'a RenderScene,
    pub normals: &'a NormalMatrices,
    pub accel: &'a Accel,
    /// Of the picture, pixels.
    pub size: [u32; 2],
    /// Bound that VPLs are evaluated with, 1/m².
    pub geometry_term_max: f32,
    pub level: SimdLevel,
}

/// Sixteen places of the picture.
#[derive(Clone, Copy, Debug)]
struct Places {
    position: [Lane; 3],
    /// Zero where nothing matte is seen.
    normal: [Lane; 3],
    /// 1 / what all candidates give.
    inverse_total: Lane,
}

impl Choice {
    /// Scales the flux of the slots so that at most `wanted` are left with any. Returns the number of rays.
    pub fn keep(&mut self, slots: &mut [Vpl], wanted: usize, view: &View) -> u64 {
        let View { geometry_term_max, level, .. } = *view;
        self.look(view);
        self.places.par_iter_mut().for_each(|p| total_light(level, p, slots, geometry_term_max));
        let shares = invert_totals(&mut self.places);
        let places = &self.places;
        let flux: f32 = slots.iter().map(luminance).sum();
        make_room(&mut self.scores, slots.len());
        self.scores.clear();
        self.scores.resize(slots.len(), 0.0);
        let blind = if flux > 0.0 { BLIND_PART * shares / flux } else { 0.0 };
        self.scores.par_chunks_mut(LANES).zip(slots.par_chunks(LANES)).with_min_len(4).for_each(|(scores, slots)| {
            score(level, scores, slots, places, geometry_term_max);
            for (score, slot) in scores.iter_mut().zip(slots) {
                *score += blind * luminance(slot);
            }
        });
        self.sample(slots, wanted);
        self.rays.len() as u64
    }

    /// The pattern of places.
    fn look(&mut self, view: &View) {
        let View { scene, normals, accel, size: [width, height], .. } = *view;
        let at = |i: u32, n: u32| ((2 * i + 1) * n / (2 * PLACES_A_SIDE)) as f32;
        self.rays.clear();
        for y in 0..PLACES_A_SIDE {
            let row = at(y, height);
            self.rays.extend((0..PLACES_A_SIDE).map(|x| camera_ray(&scene.camera, at(x, width), row, width, height)));
        }
        self.hits.clear();
        self.hits.resize(self.rays.len(), Hit::MISS);
        accel.closest_hits(&self.rays, &mut self.hits);
        self.places.clear();
        for (rays, hits) in self.rays.chunks(LANES).zip(self.hits.chunks(LANES)) {
            let zero = [[0.0; LANES]; 3];
            let mut group = Places { position: zero, normal: zero, inverse_total: [0.0; LANES] };
            for (lane, (ray, hit)) in rays.iter().zip(hits).enumerate().filter(|(_, (_, hit))| hit.is_hit()) {
                let s = surface_at(scene, normals, ray, hit);
                let lit = !scene.materials[s.material as usize].unlit && s.look.matte_weight() > 0.0;
                for axis in 0..3 {
                    group.position[axis][lane] = s.position_world[axis];
                    group.normal[axis][lane] = if lit { s.n_shading[axis] } else { 0.0 };
                }
            }
            self.places.push(group);
        }
    }

    /// Priority sampling by `scores`.
    fn sample(&mut self, slots: &mut [Vpl], wanted: usize) {
        self.priorities.clear();
        // A golden sequence: slots that follow each other, and so light alike, have thresholds far apart.
        let own = |i: usize| sampling::unit_f32((i as u32).wrapping_mul(0x9e37_79b9)) + 0.5 / 16_777_216.0;
        self.priorities.extend(self.scores.iter().enumerate().map(|(i, score)| score / own(i)));
        let threshold = if wanted < slots.len() {
            self.order.clear();
            self.order.extend_from_slice(&self.priorities);
            *self.order.select_nth_unstable_by(wanted, |a, b| b.total_cmp(a)).1
        } else {
            0.0
        };
        for ((slot, &score), &priority) in slots.iter_mut().zip(&self.scores).zip(&self.priorities) {
            slot.flux *= if priority > threshold { weight(score, priority, threshold) } else { 0.0 };
        }
    }
}

/// How many of its kind a kept candidate stands for: the fading max(1, τ/score), 1 on average over all ξ.
fn weight(score: f32, priority: f32, threshold: f32) -> f32 {
    if threshold <= 0.0 {
        return 1.0;
    }
    // u = ξ τ/score goes from 0 (certain) to 1 (at the threshold); g falls from 1 to 0 over the last part of it.
    let chance = score / threshold;
    let u = threshold / priority;
    let fade = |u: f32| ((1.0 - u) * (1.0 / FADE)).min(1.0);
    let sum = |u: f32| {
        let beyond = (u - (1.0 - FADE)).max(0.0);
        u - beyond * beyond * (0.5 / FADE)
    };
    let (most, kept) = if chance > 1.0 { (1.0 / chance, chance) } else { (1.0, chance) };
    fade(u) / (kept * sum(most))
}

#[inline(always)]
fn luminance(v: &Vpl) -> f32 {
    0.2126 * v.flux.x + 0.7152 * v.flux.y + 0.0722 * v.flux.z
}

#[inline(always)]
fn given(slot: &Vpl, light: f32, p: &Places, geometry_term_max: f32, out: &mut Lane) {
    let (y, m) = (slot.position_world, slot.normal_world);
    for lane in 0..LANES {
        let [px, py, pz] = p.position;
        let [nx, ny, nz] = p.normal;
        let to_vpl = Vec3::new(y.x - px[lane], y.y - py[lane], y.z - pz[lane]);
        let n = Vec3::new(nx[lane], ny[lane], nz[lane]);
        out[lane] = light * geometry_term(to_vpl, n, m, geometry_term_max);
    }
}

#[inline(always)]
fn total_light_body(p: &mut Places, slots: &[Vpl], geometry_term_max: f32) {
    let mut sum = [0.0f32; LANES];
    for slot in slots {
        let light = luminance(slot);
        if light > 0.0 {
            let mut part = [0.0; LANES];
            given(slot, light, p, geometry_term_max, &mut part);
            for lane in 0..LANES {
                sum[lane] += part[lane];
            }
        }
    }
    p.inverse_total = sum;
}

/// Turns the totals of all places into what a share of them is measured by; returns the sum of the shares of all light.
fn invert_totals(places: &mut [Places]) -> f32 {
    let totals = || places.iter().flat_map(|p| p.inverse_total).filter(|t| *t > 0.0);
    let lit = totals().count();
    if lit == 0 {
        return 0.0;
    }
    let little = MEAN_PART * totals().sum::<f32>() / lit as f32;
    let mut shares = 0.0;
    for total in places.iter_mut().flat_map(|p| &mut p.inverse_total) {
        let inverse = if *total > 0.0 { 1.0 / (*total + little) } else { 0.0 };
        shares += *total * inverse;
        *total = inverse;
    }
    shares
}

#[inline(always)]
fn score_body(scores: &mut [f32], slots: &[Vpl], places: &[Places], geometry_term_max: f32) {
    for (score, slot) in scores.iter_mut().zip(slots) {
        let light = luminance(slot);
        if light > 0.0 {
            let mut sum = [0.0f32; LANES];
            for p in places {
                let mut part = [0.0; LANES];
                given(slot, light, p, geometry_term_max, &mut part);
                for lane in 0..LANES {
                    sum[lane] += part[lane] * p.inverse_total[lane];
                }
            }
            *score = sum.iter().sum();
        }
    }
}

dispatch! {
    /// Fills in what all VPLs give to each place.
    fn total_light => total_light_body(place: &mut Places, slots: &[Vpl], geometry_term_max: f32)
}

dispatch! {
    /// The sum over all places of the share that each VPL gives.
    fn score => score_body(scores: &mut [f32], slots: &[Vpl], places: &[Places], geometry_term_max: f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of_scores(scores: &[f32]) -> Choice {
        Choice { scores: scores.to_vec(), ..Choice::default() }
    }

    fn unit_slots(n: usize) -> Vec<Vpl> {
        vec![Vpl { flux: Vec3::ONE, ..Vpl::default() }; n]
    }

    #[test]
    fn weights_add_up_and_as_many_are_kept_as_wanted() {
        let n = 20_000;
        let scores: Vec<f32> = (0..n).map(|i| 0.05 + 3.0 * sampling::unit_f32(sampling::hash_u32(i as u32))).collect();
        for wanted in [500, 4000, 15_000] {
            let mut slots = unit_slots(n);
            of_scores(&scores).sample(&mut slots, wanted);
            let kept = slots.iter().filter(|s| s.flux != Vec3::ZERO).count();
            assert!(kept <= wanted && kept + 1 >= wanted, "{kept} of {wanted}");
            // Any subset's sum is right but for chance.
            for (from, to) in [(0.0, 4.0), (0.0, 1.0), (2.0, 4.0)] {
                let of =
                    || slots.iter().zip(&scores).filter(|(_, s)| (from..to).contains(*s)).map(|(slot, _)| slot.flux.x);
                let mean = of().map(f64::from).sum::<f64>() / of().count() as f64;
                let allowed = 3.0 / (of().filter(|w| *w > 0.0).count() as f64).sqrt();
                assert!(
                    (mean - 1.0).abs() < allowed,
                    "{wanted}, scores from {from} to {to}: {mean}, allowed {allowed}"
                );
            }
        }
    }

    #[test]
    fn all_are_kept_where_there_is_room() {
        let mut slots = unit_slots(5);
        of_scores(&[1.0, 0.0, 2.0, 3.0, 1e-9]).sample(&mut slots, 5);
        let kept: Vec<f32> = slots.iter().map(|s| s.flux.x).collect();
        assert_eq!(kept, [1.0, 0.0, 1.0, 1.0, 1.0], "no score, no light to lose");
    }

    #[test]
    fn nothing_jumps_at_the_threshold() {
        // One score goes up little by little; what any slot gives changes by little of what each is meant to give.
        let scores = |x: f32| -> Vec<f32> {
            (0..400).map(|i| if i == 123 { x } else { 0.2 + sampling::unit_f32(sampling::hash_u32(i)) }).collect()
        };
        let given = |x: f32| {
            let (mut slots, scores) = (unit_slots(400), scores(x));
            of_scores(&scores).sample(&mut slots, 100);
            slots.iter().zip(&scores).map(|(slot, score)| slot.flux.x * score).collect::<Vec<f32>>()
        };
        let meant = scores(1.0).iter().sum::<f32>() / 100.0;
        let mut before = given(0.01);
        let mut entered = false;
        for step in 1..2000 {
            let now = given(0.01 + step as f32 * 1e-3);
            for (a, b) in before.iter().zip(&now) {
                assert!((a - b).abs() < 0.15 * meant, "from {a} to {b} at step {step}, {meant} is meant");
            }
            entered |= before[123] == 0.0 && now[123] > 0.0;
            before = now;
        }
        assert!(entered);
    }
}
