//! Recursive ray tracing of mirrors and glass, wave by wave: all rays of a tile at one depth are traced and shaded together.
//!
//! Per pixel, radiance is summed in the order in which its own rays were spawned, which no other pixel influences: the
//! result does not depend on tiles or threads. Shadows of hits come from the same maps (or rays) as those of directly seen
//! surfaces, indirect light from the same VPLs.
//! Source: Whitted, "An Improved Illumination Model for Shaded Display", CACM 1980.

use catoptra_engine::Material;
use glam::Vec3;

use super::{
    direct,
    facet::Facets,
    media::{self, MediumStack},
    points::{Glossy, PointBatch, make_room},
    shade::{self, FrameContext, VplRays},
    surface::{PixelCone, Surface},
};
use crate::{
    accel::{Hit, Ray},
    output::RayCounts,
    twin::{
        gbuffer,
        shading::{beer_lambert_of_ln, fresnel_dielectric, ln_color, reflect, refract, schlick},
    },
};

/// A ray on its way, and what it will be worth.
#[derive(Clone, Copy, Debug)]
struct Branch {
    ray: Ray,
    weight: Vec3,
    inside: MediumStack,
    /// Slot of the pixel in the tile's list.
    slot: u32,
    /// Interfaces behind it.
    depth: u32,
    /// Surfaces behind it, hidden interfaces included: bounds the walk through coincident glass.
    crossed: u32,
    refraction: bool,
    /// Metres from the camera to the ray's start, along the path.
    way: f32,
}

/// A pixel whose surface reflects or refracts.
#[derive(Clone, Copy, Debug)]
pub struct MaskedPixel {
    /// Number of the picture's pixel.
    pub pixel: u32,
    /// What the camera sees there.
    pub surface: Surface,
    /// Unit direction of the camera ray.
    pub direction: Vec3,
}

/// Memory of the tracer, kept between tiles.
#[derive(Clone, Debug, Default)]
pub struct WhittedScratch {
    wave: Vec<Branch>,
    next: Vec<Branch>,
    /// Rays of the wave, alike ones together, and their hits.
    rays: Vec<Ray>,
    hits: Vec<Hit>,
    /// Where among them each branch's are.
    place_of: Vec<u32>,
    /// Slot and weight of each point.
    shaded: Vec<(u32, Vec3)>,
    surfaces: Vec<Surface>,
    points: PointBatch,
    vpl_rays: VplRays,
    absorption: Absorption,
    facets: Facets,
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
        make_room(&mut self.place_of, wave);
        make_room(&mut self.shaded, points);
        make_room(&mut self.surfaces, points);
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
        self.wave.iter().map(|b| (b.slot as usize, b.weight.max_element()))
    }

    /// Ends the rays of the wave that `keep` refuses by pixel and weight.
    pub(super) fn keep(&mut self, keep: impl Fn(usize, f32) -> bool) {
        self.wave.retain(|b| keep(b.slot as usize, b.weight.max_element()));
    }
}

/// Beer-Lambert with the logarithms of the glass that was met last.
#[derive(Clone, Debug, Default)]
struct Absorption {
    color: Vec3,
    ln: Vec3,
}

impl Absorption {
    fn transmittance(&mut self, m: &Material, distance: f32) -> Vec3 {
        if self.color != m.attenuation_color {
            (self.color, self.ln) = (m.attenuation_color, ln_color(m.attenuation_color));
        }
        beer_lambert_of_ln(self.ln, m.attenuation_distance, distance)
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
    let eye = ctx.scene.camera.world_from_view.translation;
    s.wave.clear();
    for (slot, p) in pixels.iter().enumerate() {
        let arriving = Branch {
            ray: Ray::new(p.surface.position_world, p.direction),
            weight: Vec3::ONE,
            inside: MediumStack::default(),
            slot: slot as u32,
            depth: 0,
            crossed: 0,
            refraction: false,
            way: (p.surface.position_world - eye).length(),
        };
        spawn(ctx, &arriving, &p.surface, &mut s.wave);
    }
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
    s.surfaces.clear();
    s.points.clear();
    for (branch, &place) in s.wave.iter().zip(&s.place_of) {
        let hit = &s.hits[place as usize];
        if branch.refraction {
            counts.refraction += 1
        } else {
            counts.reflection += 1
        }
        let mut branch = *branch;
        if let Some(medium) = branch.inside.current(ctx.scene) {
            let m = &ctx.scene.materials[ctx.scene.instances[medium as usize].material as usize];
            branch.weight *= s.absorption.transmittance(m, hit.t);
        }
        if !hit.is_hit() {
            radiance[branch.slot as usize] += branch.weight * ctx.scene.environment.background;
            continue;
        }
        branch.way += hit.t;
        let surface = s.facets.surface(ctx, &branch.ray, hit, cone.at(branch.way));
        let point = gbuffer::point_of(ctx, &surface);
        let m = &ctx.scene.materials[surface.material as usize];
        let look = &surface.look;
        let glossy = look.specular != Vec3::ZERO && !m.unlit;
        // Pure mirror and glass show no light of their own.
        if glossy || point.matte * point.base_color != Vec3::ZERO || point.own != Vec3::ZERO {
            if glossy {
                let (point, wo) = (s.shaded.len() as u32, -branch.ray.direction);
                s.points.glossy.push(Glossy { point, specular: look.specular, shininess: look.shininess, wo });
            }
            s.points.push(&point);
            s.shaded.push((branch.slot, branch.weight));
            s.surfaces.push(surface);
        }
        spawn(ctx, &branch, &surface, &mut s.next);
    }
    shade_wave(ctx, pixels, s, radiance, counts);
    std::mem::swap(&mut s.wave, &mut s.next);
}

/// Kinds of rays that are worth tracing in one packet: by the signs and the main axis of their direction, and how they came
/// about.
const KINDS: usize = 48;

fn kind(b: &Branch) -> usize {
    let d = b.ray.direction;
    let a = d.abs();
    let axis = if a.x >= a.y && a.x >= a.z { 0 } else { 1 + usize::from(a.y < a.z) };
    let signs = usize::from(d.x < 0.0) + 2 * usize::from(d.y < 0.0) + 4 * usize::from(d.z < 0.0);
    24 * usize::from(b.refraction) + 8 * axis + signs
}

/// Traces the wave's rays in an order in which neighbours are alike (a counting sort). A ray's hit does not depend on it.
fn trace_sorted(ctx: &FrameContext, s: &mut WhittedScratch) {
    let mut first = [0u32; KINDS + 1];
    s.place_of.clear();
    for b in &s.wave {
        let kind = kind(b);
        s.place_of.push(kind as u32);
        first[kind + 1] += 1;
    }
    for k in 0..KINDS {
        first[k + 1] += first[k];
    }
    s.rays.resize(s.wave.len(), Ray::new(Vec3::ZERO, Vec3::ZERO));
    s.hits.resize(s.wave.len(), Hit::MISS);
    for (b, place) in s.wave.iter().zip(&mut s.place_of) {
        let next = &mut first[*place as usize];
        *place = *next;
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
    shade::indirect_light(ctx, 0..ctx.vpls.len(), &mut s.points, &s.surfaces, &mut s.vpl_rays, counts);
    let shaded = &s.shaded;
    direct::direct_light(ctx, &mut s.points, &s.surfaces, |i| pixels[shaded[i].0 as usize].pixel, counts);
    for (i, (slot, weight)) in s.shaded.iter().enumerate() {
        let light = s.points.radiance(i) + s.points.albedo(i) * s.points.irradiance(i);
        radiance[*slot as usize] += *weight * light;
    }
}

/// Continues `arriving`, which met `surface`, by a reflected and a refracted ray where the material says so.
fn spawn(ctx: &FrameContext, arriving: &Branch, surface: &Surface, out: &mut Vec<Branch>) {
    let m = &ctx.scene.materials[surface.material as usize];
    if !surface.look.is_traced() || arriving.depth >= ctx.settings.max_depth {
        return;
    }
    let d = arriving.ray.direction;
    let optics = interface(ctx, arriving, surface, m);
    let child = Branch { depth: arriving.depth + 1, crossed: arriving.crossed + 1, ..*arriving };
    let mut push = |branch: Branch| {
        if branch.weight.max_element() >= ctx.settings.min_weight {
            out.push(branch);
        }
    };
    if optics.hidden {
        if arriving.crossed < 4 * ctx.settings.max_depth {
            let ray = surface.leaving_ray(d);
            push(Branch { ray, inside: optics.behind, depth: arriving.depth, refraction: true, ..child });
        }
        return;
    }
    if optics.reflected != Vec3::ZERO {
        let r = above_horizon(reflect(-d, surface.n_shading), surface.n_geometric);
        let ray = surface.leaving_ray(r);
        push(Branch { ray, weight: arriving.weight * optics.reflected, refraction: false, ..child });
    }
    if let Some(t) = optics.transmitted_direction {
        let ray = surface.leaving_ray(t);
        let weight = arriving.weight * optics.transmitted;
        push(Branch { ray, weight, inside: optics.behind, refraction: true, ..child });
    }
}

/// How an interface splits light.
#[derive(Clone, Copy, Debug)]
pub struct Interface {
    /// Weight of the mirrored ray.
    pub reflected: Vec3,
    /// Weight of the transmitted ray.
    pub transmitted: Vec3,
    /// Its direction; `None` at total internal reflection or without glass.
    pub transmitted_direction: Option<Vec3>,
    /// Media behind the surface.
    pub behind: MediumStack,
    /// A surface inside a volume of higher priority: nothing happens there.
    pub hidden: bool,
}

fn interface(ctx: &FrameContext, arriving: &Branch, s: &Surface, m: &Material) -> Interface {
    split(ctx.scene, m, s, arriving.ray.direction, arriving.inside)
}

/// Splits light that travels along unit `d` inside `inside` at a surface: mirror share, Fresnel-weighted glass share.
///
/// Shared by the Whitted tracer and the reference path tracer.
pub fn split(
    scene: &catoptra_engine::RenderScene,
    m: &Material,
    s: &Surface,
    d: Vec3,
    inside: MediumStack,
) -> Interface {
    let cos_i = s.n_shading.dot(-d).clamp(0.0, 1.0);
    let tint = if m.schlick { schlick(s.base_color, cos_i) } else { s.base_color };
    let mut out = Interface {
        reflected: tint * s.look.mirror,
        transmitted: Vec3::ZERO,
        transmitted_direction: None,
        behind: inside,
        hidden: false,
    };
    let glass = (1.0 - s.look.mirror) * s.look.transmission;
    if glass <= 0.0 {
        return out;
    }
    if m.thin {
        out.transmitted = Vec3::splat(glass);
        out.transmitted_direction = Some(d);
        return out;
    }
    let mesh = &scene.meshes[scene.instances[s.instance_id as usize].mesh as usize];
    if !mesh.closed() {
        // A thin pane: both faces at once, with the light that bounces between them, 2F/(1+F); no bend.
        let f = fresnel_dielectric(cos_i, 1.0 / m.ior);
        let r = 2.0 * f / (1.0 + f);
        out.reflected += Vec3::splat(glass * r);
        out.transmitted = s.base_color * (glass * (1.0 - r));
        out.transmitted_direction = Some(d);
        return out;
    }
    let c = media::crossing(scene, inside, s.instance_id, s.front);
    out.behind = c.behind;
    if c.from == c.to {
        out.hidden = true;
        return out;
    }
    let eta = media::ior_of(scene, c.from) / media::ior_of(scene, c.to);
    let f = fresnel_dielectric(cos_i, eta);
    out.reflected += Vec3::splat(glass * f);
    if f < 1.0 {
        out.transmitted = s.base_color * (glass * (1.0 - f));
        out.transmitted_direction = refract(d, s.n_shading, eta).map(|t| -above_horizon(-t, s.n_geometric));
    }
    out
}

/// Keeps a direction that interpolated normals sent below the true surface just above it.
#[inline]
pub(crate) fn above_horizon(r: Vec3, n_geometric: Vec3) -> Vec3 {
    const LEAST_COSINE: f32 = 1e-3;
    let cos = r.dot(n_geometric);
    if cos >= LEAST_COSINE { r } else { (r + n_geometric * (LEAST_COSINE - cos)).normalize_or(n_geometric) }
}
