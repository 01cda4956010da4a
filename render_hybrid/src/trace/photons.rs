//! Light paths from the sources; each diffuse reflection becomes a VPL.
//!
//! Path i of a source is the same function of (scene, settings) in every frame: its start is a point of a Hammersley set in
//! the light's own frame, its bounces are Halton dimensions. So VPLs move smoothly with the light, and slot i stays slot i.
//! Source: Keller, "Instant Radiosity", SIGGRAPH 1997 (the quasi-random walk), with a fixed number of bounces.

use catoptra_engine::RenderScene;
use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::{
    choice::{Choice, View},
    emission::{self, EmissiveTriangle, PathShares, SourceFrame},
    reuse::Reuse,
    sampling,
    surface::{NormalMatrices, Surface, surface_at},
    surfels::{LANDINGS_A_SURFEL, Landing, Surfels},
};
use crate::{
    accel::{Accel, Hit, Ray},
    settings::{VplOptions, VplPlacement, VplShadows},
    twin::vpl::Vpl,
};

const PRIMES: [u32; 16] = [3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53, 59];

/// Two Halton coordinates for bounce `bounce` of path `path`; past the primes, hashed ones.
fn bounce_sample(path: u32, bounce: u32, seed: u32) -> Vec2 {
    let d = 2 * bounce as usize;
    let rotation = |dimension: u32| sampling::unit_f32(sampling::hash_combine(seed, 0x5eed ^ dimension));
    if d + 1 < PRIMES.len() {
        let x = sampling::radical_inverse(PRIMES[d], path + 1) + rotation(d as u32);
        let y = sampling::radical_inverse(PRIMES[d + 1], path + 1) + rotation(d as u32 + 1);
        Vec2::new(x.fract(), y.fract())
    } else {
        let h = sampling::hash_combine(sampling::hash_combine(path, bounce), seed);
        Vec2::new(sampling::unit_f32(h), sampling::unit_f32(sampling::hash_u32(h)))
    }
}

/// Memory of the photon stage, kept between frames.
#[derive(Clone, Debug, Default)]
pub struct Photons {
    emissive: Vec<EmissiveTriangle>,
    shares: PathShares,
    paths: Vec<Path>,
    slots: Vec<Vpl>,
    landings: Vec<Landing>,
    surfels: Surfels,
    /// The VPLs lie on surfels.
    pub on_surfels: bool,
    choice: Choice,
    reuse: Reuse,
    /// VPLs with flux, in the order of paths.
    pub vpls: Vec<Vpl>,
    /// Rays traced.
    pub rays: u64,
}

/// Where light paths begin and which way they turn: all that a tracer of them needs beside the scene.
#[derive(Clone, Debug, Default)]
pub struct LightPaths {
    /// One a light, and the world's for what emissive surfaces start.
    pub frames: Vec<SourceFrame>,
    /// One a path, in the frame of its source.
    pub starts: Vec<PathStart>,
    /// Points of the unit disc, for [`sampling::cosine_direction`]: bounce b of paths with number i at i · bounces + b.
    pub samples: Vec<[f32; 2]>,
    /// Most diffuse reflections of a path.
    pub bounces: u32,
    /// Most VPLs of a path.
    pub slots_a_path: u32,
}

/// The start of one path.
#[derive(Clone, Copy, Debug)]
pub struct PathStart {
    /// Its first ray.
    pub ray: Ray,
    /// What the path carries.
    pub flux: Vec3,
    /// The VPL of an emissive surface.
    pub vpl: Option<Vpl>,
    /// Number within its source.
    pub index: u32,
    /// Light, or the number of lights for emissive surfaces.
    pub source: u32,
}

/// One light path to trace.
#[derive(Clone, Copy, Debug)]
pub(super) struct Path {
    /// Light, or `lights.len()` for the emissive triangles.
    pub source: u32,
    /// Number within its source, and how many that source has.
    pub index: u32,
    pub of: u32,
}

impl Photons {
    /// Traces all light paths; afterwards `vpls` holds at most `options.count` · `options.candidates` VPLs (a source beyond
    /// that number still gets one path). With `options.reuse`, paths of the frame before are followed on (`trace/reuse.rs`).
    /// On surfels there are as many as are lit, mostly fewer than `options.count`.
    pub fn trace(
        &mut self,
        scene: &RenderScene,
        normals: &NormalMatrices,
        accel: &Accel,
        options: &VplOptions,
        seed: u32,
    ) {
        self.vpls.clear();
        self.slots.clear();
        self.rays = 0;
        self.on_surfels = wants_surfels(options) && self.surfels.place(scene, normals, options.count);
        let wanted = options.count * if self.on_surfels { LANDINGS_A_SURFEL } else { options.candidates };
        let Some((bounds, slots_a_path)) = self.share(scene, options.bounces, wanted) else {
            return self.reuse.forget();
        };
        let bounces = options.bounces;
        if options.reuse > 0 {
            list_paths(self.reuse.begin(scene, options, seed, &self.shares.shares), &mut self.paths);
        } else {
            self.reuse.forget();
        }
        let paths = &self.paths;
        self.landings.clear();
        self.landings.resize(paths.len() * slots_a_path, Landing::default());
        let emissive = &self.emissive;
        let tracer = PathTracer { scene, normals, accel: Some(accel), emissive, bounds, bounces, seed };
        let landings = &mut self.landings;
        self.rays = if options.reuse > 0 {
            let most = (options.reuse as usize / slots_a_path).max(1);
            self.reuse.trace(&tracer, paths, most, landings)
        } else {
            let all = landings.par_chunks_mut(slots_a_path).with_min_len(16).zip(paths);
            all.map(|(landings, path)| tracer.trace(*path, landings)).sum()
        };
        if self.on_surfels {
            self.surfels.light(accel.simd_level(), &self.landings);
            self.slots.extend_from_slice(&self.surfels.lit);
        } else {
            self.slots.extend(self.landings.iter().map(|l| l.0));
        }
        self.vpls.extend(self.slots.iter().filter(|v| v.flux != Vec3::ZERO));
    }

    /// Keeps the `wanted` VPLs of those just traced that give most to the picture.
    pub(crate) fn choose(&mut self, wanted: u32, view: &View) {
        self.rays += self.choice.keep(&mut self.slots, wanted as usize, view);
        self.vpls.clear();
        self.vpls.extend(self.slots.iter().filter(|v| v.flux != Vec3::ZERO));
    }

    /// The kept paths are gone.
    pub(crate) fn forget(&mut self) {
        self.reuse.forget();
    }

    /// True where fewer paths were begun anew than were wanted: the next frame goes on with it though nothing move.
    pub(crate) fn is_unsettled(&self) -> bool {
        self.reuse.is_unsettled()
    }

    /// How many of the VPLs with flux belong to paths kept from the frame before.
    pub(crate) fn reused(&self) -> u32 {
        self.reuse.count(&self.slots)
    }

    /// What [`Self::trace`] would follow, for a tracer on the GPU.
    pub fn paths(
        &mut self,
        scene: &RenderScene,
        normals: &NormalMatrices,
        options: &VplOptions,
        seed: u32,
    ) -> LightPaths {
        let bounces = options.bounces;
        self.reuse.forget();
        let wanted = options.count * options.candidates;
        let Some((bounds, slots_a_path)) = self.share(scene, bounces, wanted) else { return LightPaths::default() };
        let emissive = &self.emissive;
        let tracer = PathTracer { scene, normals, accel: None, emissive, bounds, bounces, seed };
        let numbers = self.paths.iter().map(|p| p.index + 1).max().unwrap_or(0);
        let point = |index, bounce| sampling::concentric_disc(bounce_sample(index, bounce, seed)).to_array();
        let of_lights = scene.lights.iter().map(|l| SourceFrame::of(l, bounds));
        LightPaths {
            frames: of_lights.chain([SourceFrame::WORLD]).collect(),
            starts: self.paths.iter().map(|&p| tracer.start_in_frame(p)).collect(),
            samples: (0..numbers).flat_map(|i| (0..bounces).map(move |b| point(i, b))).collect(),
            bounces,
            slots_a_path: slots_a_path as u32,
        }
    }

    /// Shares the paths of `wanted` landings out among the sources. Bounds of the scene and landings of a path; `None` for an empty scene.
    fn share(&mut self, scene: &RenderScene, bounces: u32, wanted: u32) -> Option<(catoptra_engine::Aabb, usize)> {
        self.paths.clear();
        emission::emissive_triangles(scene, &mut self.emissive);
        let bounds = scene.bounds_world();
        if bounds.is_empty() {
            return None;
        }
        // A path of a light makes up to `bounces` VPLs, one of an emissive surface one more, for its start.
        let slots_a_path = if self.emissive.is_empty() { bounces } else { bounces + 1 } as usize;
        let paths = (wanted / slots_a_path as u32).max(1);
        self.shares.update(scene, &self.emissive, bounds, paths);
        list_paths(&self.shares.shares, &mut self.paths);
        Some((bounds, slots_a_path))
    }
}

/// All paths, source after source.
fn list_paths(shares: &[u32], paths: &mut Vec<Path>) {
    paths.clear();
    for (source, &of) in shares.iter().enumerate() {
        paths.extend((0..of).map(|index| Path { source: source as u32, index, of }));
    }
}

pub(super) struct PathTracer<'a> {
    pub scene: &'a RenderScene,
    pub normals: &'a NormalMatrices,
    /// Not needed for starts.
    pub accel: Option<&'a Accel>,
    emissive: &'a [EmissiveTriangle],
    pub bounds: catoptra_engine::Aabb,
    pub bounces: u32,
    seed: u32,
}

impl PathTracer<'_> {
    fn xi(&self, path: Path) -> Vec2 {
        let shift = sampling::unit_f32(sampling::hash_combine(self.seed, 0xca70));
        Vec2::new(
            (path.index as f32 + 0.5) / path.of as f32,
            (sampling::radical_inverse(2, path.index) + shift).fract(),
        )
    }

    /// [`Self::start`] in the frame of its source.
    fn start_in_frame(&self, path: Path) -> PathStart {
        let Some(light) = self.scene.lights.get(path.source as usize) else { return self.start(path) };
        let e = emission::emit_in_frame(light.kind, self.xi(path));
        let share = 1.0 / path.of as f32;
        PathStart { ray: e.ray, flux: e.flux * share, vpl: None, index: path.index, source: path.source }
    }

    pub fn start(&self, path: Path) -> PathStart {
        let xi = self.xi(path);
        let share = 1.0 / path.of as f32;
        if (path.source as usize) < self.scene.lights.len() {
            let e = emission::emit_from_light(&self.scene.lights[path.source as usize], self.bounds, xi);
            let flux = e.flux * share;
            return PathStart { ray: e.ray, flux, vpl: None, index: path.index, source: path.source };
        }
        let vpl = self.emissive_start(path, xi, share);
        let d = sampling::cosine_direction(vpl.normal_world, bounce_sample(path.index, self.bounces, self.seed));
        let ray = Ray::new(vpl.position_world + vpl.normal_world * vpl.error, d);
        PathStart { ray, flux: vpl.flux, vpl: Some(vpl), index: path.index, source: path.source }
    }

    /// Fills in a path's landings; returns the number of rays.
    pub fn trace(&self, path: Path, landings: &mut [Landing]) -> u64 {
        let PathStart { ray, flux, vpl, .. } = self.start(path);
        let mut used = 0;
        if let Some(vpl) = vpl {
            landings[0] = (vpl, self.emissive[self.emissive_at(path).0].instance_id);
            used = 1;
        }
        self.follow(path.index, 0, ray, flux, &mut landings[used..])
    }

    /// Follows path number `index` from its reflection `first` on, along `ray`; returns the number of rays.
    pub fn follow(&self, index: u32, first: u32, mut ray: Ray, mut flux: Vec3, landings: &mut [Landing]) -> u64 {
        let Some(accel) = self.accel else { return 0 };
        let (mut used, mut rays) = (0, 0);
        for bounce in first..self.bounces {
            if flux == Vec3::ZERO {
                break;
            }
            rays += 1;
            let hit = accel.closest_hit(&ray);
            if !hit.is_hit() {
                break;
            }
            let s = surface_at(self.scene, self.normals, &ray, &hit);
            flux *= self.albedo(&s);
            landings[used] = (vpl_at(&s, flux), s.instance_id);
            used += 1;
            let Some(next) = self.leave(index, bounce, &s) else { break };
            ray = next;
        }
        rays
    }

    /// The triangle that a path starts on, where it lies in the sum of all, and that sum.
    fn emissive_at(&self, path: Path) -> (usize, f32, f32) {
        let total = self.emissive.last().map_or(0.0, |t| t.cumulative);
        let target = self.xi(path).x * total;
        let at = self.emissive.partition_point(|t| t.cumulative <= target).min(self.emissive.len() - 1);
        (at, target, total)
    }

    /// Mirror and glass end the photon; a mixed material reflects its matte share diffusely.
    pub fn albedo(&self, s: &Surface) -> Vec3 {
        let m = &self.scene.materials[s.material as usize];
        if m.unlit { Vec3::ZERO } else { s.base_color * (s.look.diffuse * s.look.matte_weight()) }
    }

    /// The ray on which path number `index` goes on after its reflection `bounce`; `None`: into the surface.
    pub fn leave(&self, index: u32, bounce: u32, s: &Surface) -> Option<Ray> {
        let d = sampling::cosine_direction(s.n_shading, bounce_sample(index, bounce, self.seed));
        (s.n_geometric.dot(d) > 0.0).then(|| s.leaving_ray(d))
    }

    /// A VPL on an emissive surface: both sides radiate, the path takes one.
    fn emissive_start(&self, path: Path, xi: Vec2, share: f32) -> Vpl {
        let (at, target, total) = self.emissive_at(path);
        let t = &self.emissive[at];
        let before = if at == 0 { 0.0 } else { self.emissive[at - 1].cumulative };
        let probability = (t.cumulative - before) / total;
        // The position within the triangle re-uses what is left of xi.x.
        let left = ((target - before) / (t.cumulative - before)).clamp(0.0, 1.0);
        let root = left.sqrt();
        let hit = Hit {
            t: 0.0,
            u: root * (1.0 - xi.y),
            v: root * xi.y,
            instance_id: t.instance_id,
            primitive_id: t.primitive_id,
        };
        let instance = &self.scene.instances[t.instance_id as usize];
        let corners = self.scene.meshes[instance.mesh as usize]
            .corners(t.primitive_id)
            .map(|p| instance.world_from_object.transform_point3(p));
        let n = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or(Vec3::Y);
        let side = if path.index.is_multiple_of(2) { n } else { -n };
        let s = surface_at(self.scene, self.normals, &Ray::new(corners[0] + side, -side), &hit);
        let flux = s.emission * (std::f32::consts::TAU * t.area / probability * share);
        vpl_at(&s, flux)
    }
}

/// Surfels are for VPLs with visibility: those without are so few, and the GPU's tracer makes them, too. What history keeps
/// are paths.
fn wants_surfels(options: &VplOptions) -> bool {
    options.placement == VplPlacement::Surfels && options.shadows != VplShadows::Off && options.reuse == 0
}

pub(super) fn vpl_at(s: &Surface, flux: Vec3) -> Vpl {
    Vpl { position_world: s.position_world, normal_world: s.n_shading, flux, error: s.error }
}
