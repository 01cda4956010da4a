//! Recursive ray tracing of mirrors and glass, wave by wave: all rays of a tile at one depth are traced and shaded together.
//!
//! Per pixel, radiance is summed in the order in which its own rays were spawned, which no other pixel influences: the
//! result does not depend on tiles or threads. Shadows of hits come from the same maps (or rays) as those of directly seen
//! surfaces, indirect light from the same VPLs.
//! Source: Whitted, "An Improved Illumination Model for Shaded Display", CACM 1980.

use glam::Vec3;

use super::{
    direct,
    facet::Facets,
    media::Media,
    meet::Meeting,
    optics::{LeavingLanes, part},
    points::{Glossy, LANES, PointBatch, make_room},
    shade::{self, FrameContext, VplRays},
    surface::PixelCone,
};
use crate::{
    accel::{Hit, Ray},
    output::RayCounts,
};

/// A ray on its way, and what it will be worth.
#[derive(Clone, Copy, Debug)]
struct Branch {
    ray: Ray,
    weight: Vec3,
    path: Path,
    refraction: bool,
}

/// What a ray and those that it spawns have in common.
#[derive(Clone, Copy, Debug, Default)]
struct Path {
    /// Slot of the pixel in the tile's list.
    slot: u32,
    /// Number of the stack of media that the ray is in.
    stack: u32,
    /// Metres from the camera to the ray's start, along the path.
    way: f32,
    /// Interfaces behind it.
    depth: u16,
    /// Surfaces behind it, hidden interfaces included: bounds the walk through coincident glass.
    crossed: u16,
}

/// A pixel whose surface reflects or refracts.
#[derive(Clone, Copy, Debug)]
pub struct MaskedPixel {
    /// Number of the picture's pixel.
    pub pixel: u32,
    /// Unit direction of the camera ray.
    pub direction: Vec3,
    /// What it met; `t` in metres.
    pub hit: Hit,
}

/// Memory of the tracer, kept between tiles.
#[derive(Clone, Debug, Default)]
pub struct WhittedScratch {
    wave: Vec<Branch>,
    next: Vec<Branch>,
    /// Rays of the wave, alike ones together, and their hits.
    rays: Vec<Ray>,
    hits: Vec<Hit>,
    /// Whose they are.
    branch_of: Vec<u32>,
    kinds: Vec<u8>,
    /// Slot and weight of each point.
    shaded: Vec<(u32, Vec3)>,
    points: PointBatch,
    vpl_rays: VplRays,
    facets: Facets,
    media: Media,
    meeting: Meeting,
    reflected: LeavingLanes,
    transmitted: LeavingLanes,
}

impl WhittedScratch {
    /// Rays of a wave that fit without another allocation, and what the shaded points have room for.
    pub fn capacity(&self) -> [usize; 3] {
        let [points, glossy] = self.points.capacity();
        [self.wave.capacity().max(self.next.capacity()), points.max(self.shaded.capacity()), glossy]
    }

    /// Makes room for as many.
    pub fn reserve(&mut self, [wave, points, glossy]: [usize; 3]) {
        make_room(&mut self.wave, wave);
        make_room(&mut self.next, wave);
        make_room(&mut self.rays, wave);
        make_room(&mut self.hits, wave);
        make_room(&mut self.branch_of, wave);
        make_room(&mut self.kinds, wave);
        make_room(&mut self.shaded, points);
        self.points.reserve([points, glossy]);
    }
}

impl WhittedScratch {
    /// Rays of the wave.
    pub(super) fn wave_len(&self) -> usize {
        self.wave.len()
    }

    /// Pixel (its number in the list) and weight in the greatest channel of each ray of the wave.
    pub(super) fn weights(&self) -> impl Iterator<Item = (usize, f32)> {
        self.wave.iter().map(|b| (b.path.slot as usize, b.weight.max_element()))
    }

    /// Ends the rays of the wave that `keep` refuses by pixel and weight.
    pub(super) fn keep(&mut self, keep: impl Fn(usize, f32) -> bool) {
        self.wave.retain(|b| keep(b.path.slot as usize, b.weight.max_element()));
    }
}

/// Traces all masked pixels; `radiance[i]` is set to what mirror and glass add to pixel i of the list.
pub fn trace(
    ctx: &FrameContext,
    pixels: &[MaskedPixel],
    scratch: &mut WhittedScratch,
    radiance: &mut Vec<Vec3>,
    counts: &mut RayCounts,
) {
    begin(ctx, pixels, scratch, radiance);
    while !scratch.wave.is_empty() {
        trace_wave(ctx, pixels, scratch, radiance, counts);
    }
}

/// Starts the first wave of all masked pixels.
pub(super) fn begin(ctx: &FrameContext, pixels: &[MaskedPixel], s: &mut WhittedScratch, radiance: &mut Vec<Vec3>) {
    radiance.clear();
    radiance.resize(pixels.len(), Vec3::ZERO);
    s.facets.begin(ctx);
    s.media.begin(ctx.scene, ctx.serial);
    let eye = ctx.scene.camera.world_from_view.translation;
    let cone = PixelCone::of(&ctx.scene.camera, ctx.settings.height);
    s.next.clear();
    for (chunk, pixels) in pixels.chunks(LANES).enumerate() {
        let mut hits = [Hit::MISS; LANES];
        let mut paths = [Path::default(); LANES];
        for (lane, p) in pixels.iter().enumerate() {
            hits[lane] = p.hit;
            paths[lane].slot = (chunk * LANES + lane) as u32;
            s.meeting.put(lane, p.direction, Vec3::ONE, &p.hit, Media::AIR, &s.media);
        }
        let hits = &hits[..pixels.len()];
        s.meeting.meet(ctx, &mut s.facets, &mut s.media, hits, |lane| cone.at(pixels[lane].hit.t), |_, _| ());
        for (lane, path) in paths.iter_mut().enumerate().take(pixels.len()) {
            path.way = (s.meeting.surface.position(lane) - eye).length();
        }
        spawn(ctx, s, &paths);
    }
    std::mem::swap(&mut s.wave, &mut s.next);
}

/// Traces and shades the rays of the wave; those that they spawn are the next one.
pub(super) fn trace_wave(
    ctx: &FrameContext,
    pixels: &[MaskedPixel],
    s: &mut WhittedScratch,
    radiance: &mut [Vec3],
    counts: &mut RayCounts,
) {
    let cone = PixelCone::of(&ctx.scene.camera, ctx.settings.height);
    trace_sorted(ctx, s);
    s.next.clear();
    s.shaded.clear();
    s.points.clear();
    s.points.keep_ray_starts(shade::wants_ray_starts(ctx));
    for first in (0..s.wave.len()).step_by(LANES) {
        let count = LANES.min(s.wave.len() - first);
        let mut paths = [Path::default(); LANES];
        let mut met = 0u16;
        for lane in 0..count {
            let branch = &s.wave[s.branch_of[first + lane] as usize];
            let hit = &s.hits[first + lane];
            paths[lane] = branch.path;
            paths[lane].way += hit.t;
            if branch.refraction {
                counts.refraction += 1
            } else {
                counts.reflection += 1
            }
            met |= u16::from(hit.is_hit()) << lane;
            s.meeting.put(lane, branch.ray.direction, branch.weight, hit, branch.path.stack, &s.media);
        }
        let (hits, before, points) = (&s.hits[first..first + count], s.points.glossy.len(), &mut s.points);
        s.meeting.meet(
            ctx,
            &mut s.facets,
            &mut s.media,
            hits,
            |lane| cone.at(paths[lane].way),
            |lane, glossy| {
                points.glossy.push(Glossy { point: lane as u32, ..glossy });
            },
        );
        // What shows light of its own; pure mirror and glass do not.
        let mut shown = 0u16;
        for lane in 0..count {
            shown |= u16::from(s.meeting.surface.shows[lane] != 0) << lane;
        }
        for glossy in &s.points.glossy[before..] {
            shown |= 1 << glossy.point;
        }
        shown &= met;
        for glossy in &mut s.points.glossy[before..] {
            let earlier = shown & ((1 << glossy.point) - 1);
            glossy.point = s.shaded.len() as u32 + earlier.count_ones();
        }
        s.points.push_lanes(&s.meeting.surface, shown);
        for lane in 0..count {
            if shown >> lane & 1 != 0 {
                s.shaded.push((paths[lane].slot, s.meeting.weight(lane)));
            } else if met >> lane & 1 == 0 {
                radiance[paths[lane].slot as usize] += s.meeting.weight(lane) * ctx.scene.environment.background;
            }
        }
        spawn(ctx, s, &paths);
    }
    shade_wave(ctx, pixels, s, radiance, counts);
    std::mem::swap(&mut s.wave, &mut s.next);
}

/// Kinds of rays that are worth tracing in one packet: by the signs and the main axis of their direction, and how they came
/// about.
const KINDS: usize = 48;

fn kind(b: &Branch) -> u8 {
    let d = b.ray.direction;
    let a = d.abs();
    let axis = if a.x >= a.y && a.x >= a.z { 0 } else { 1 + u32::from(a.y < a.z) };
    let signs = d.x.to_bits() >> 31 | d.y.to_bits() >> 31 << 1 | d.z.to_bits() >> 31 << 2;
    (24 * u32::from(b.refraction) + 8 * axis + signs) as u8
}

/// Traces the wave's rays in an order in which neighbours are alike (a counting sort, which keeps the order of rays of a
/// kind: a pixel's rays are always in the same order, whatever other pixels the tile has).
fn trace_sorted(ctx: &FrameContext, s: &mut WhittedScratch) {
    let mut first = [0u32; KINDS + 1];
    s.branch_of.resize(s.wave.len(), 0);
    s.kinds.clear();
    for b in &s.wave {
        let kind = kind(b);
        s.kinds.push(kind);
        first[usize::from(kind) + 1] += 1;
    }
    for k in 0..KINDS {
        first[k + 1] += first[k];
    }
    s.rays.resize(s.wave.len(), Ray::new(Vec3::ZERO, Vec3::ZERO));
    s.hits.resize(s.wave.len(), Hit::MISS);
    for (i, (b, kind)) in s.wave.iter().zip(&s.kinds).enumerate() {
        let next = &mut first[usize::from(*kind)];
        s.branch_of[*next as usize] = i as u32;
        s.rays[*next as usize] = b.ray;
        *next += 1;
    }
    ctx.accel.closest_hits(&s.rays, &mut s.hits);
}

/// Adds local light of all hits of a wave: matte, highlight, emitted.
fn shade_wave(
    ctx: &FrameContext,
    pixels: &[MaskedPixel],
    s: &mut WhittedScratch,
    radiance: &mut [Vec3],
    counts: &mut RayCounts,
) {
    s.points.pad();
    shade::indirect_light_of_hits(ctx, &mut s.points, &mut s.vpl_rays, counts);
    let shaded = &s.shaded;
    direct::direct_light(ctx, &mut s.points, |i| pixels[shaded[i].0 as usize].pixel, counts);
    for (i, (slot, weight)) in s.shaded.iter().enumerate() {
        let light = s.points.radiance(i) + s.points.albedo(i) * s.points.irradiance(i);
        radiance[*slot as usize] += *weight * light;
    }
}

/// Continues the rays of the meeting by reflected and refracted rays where materials say so.
fn spawn(ctx: &FrameContext, s: &mut WhittedScratch, paths: &[Path; LANES]) {
    let (m, settings) = (&s.meeting, ctx.settings);
    let mut open = m.traced;
    if open == 0 {
        return;
    }
    part(ctx.level, &m.optics, &m.surface, &mut s.reflected, &mut s.transmitted);
    while open != 0 {
        let lane = open.trailing_zeros() as usize;
        open &= open - 1;
        let path = paths[lane];
        if u32::from(path.depth) >= settings.max_depth {
            continue;
        }
        let stack = m.stack[lane];
        if m.hidden >> lane & 1 != 0 {
            let (ray, weight) = (m.straight_on(lane), m.weight(lane));
            if u32::from(path.crossed) < 4 * settings.max_depth && weight.max_element() >= settings.min_weight {
                let path = Path { crossed: path.crossed + 1, stack, ..path };
                s.next.push(Branch { ray, weight, path, refraction: true });
            }
            continue;
        }
        let path = Path { depth: path.depth + 1, crossed: path.crossed + 1, ..path };
        for (leaving, refraction) in [(&s.reflected, false), (&s.transmitted, true)] {
            let most = leaving.most[lane];
            if most > 0.0 && most >= settings.min_weight {
                let path = if refraction { Path { stack, ..path } } else { path };
                let (ray, weight) = leaving.ray(lane);
                s.next.push(Branch { ray, weight, path, refraction });
            }
        }
    }
}
