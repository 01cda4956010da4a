//! The truth to judge by: a path tracer over the same structure, the same lights, materials and optics.
//!
//! Transport matches the hybrid picture's: pixel centres, lights as discs that face the shaded point, `bounces` diffuse
//! reflections before the last one to the camera path, no caustics (a path that has left a matte surface ends at mirror and
//! glass but for their matte share), Lambertian indirect light. Sample i of pixel p is a function of (scene, options, p, i).
//! Source: Kajiya, "The Rendering Equation", SIGGRAPH 1986; next-event estimation after Shirley et al. 1996.

use catoptra_engine::{Look, RenderScene};
use glam::Vec3;
use rayon::prelude::*;
use std::f32::consts::PI;

use super::{
    camera_rays::camera_ray,
    media::MediumStack,
    optics::{mirrored, split},
    sampling,
    shade::{reflected_from_light, shadow_ray},
    surface::{NormalMatrices, Surface, surface_at},
};
use crate::{
    accel::{Accel, Hit, Ray},
    output::Image,
    settings::{GlassShadows, RenderSettings},
    twin::shading::beer_lambert,
};

/// What to integrate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceOptions {
    /// Picture width in pixels.
    pub width: u32,
    /// Picture height in pixels.
    pub height: u32,
    /// Diffuse reflections before the last one to the camera path; 0: direct light of the lights only, none of emissive
    /// surfaces (which in the hybrid picture are a source of VPLs).
    pub bounces: u32,
    /// Most interfaces of mirror and glass on a path.
    pub max_depth: u32,
    /// Whether glass throws shadows.
    pub glass_shadows: GlassShadows,
    /// Seed of the sample patterns.
    pub seed: u32,
}

impl ReferenceOptions {
    /// Options whose transport matches the hybrid picture of `settings`.
    pub fn matching(settings: &RenderSettings) -> Self {
        Self {
            width: settings.width,
            height: settings.height,
            bounces: settings.vpl.map_or(0, |v| v.bounces),
            max_depth: settings.max_depth,
            glass_shadows: settings.glass_shadows,
            seed: settings.seed,
        }
    }
}

/// Most samples of a pixel in a pass.
const LONGEST_PASS: u32 = 256;

/// A pass is one Sobol' set over the whole picture, cut into pixels along a Z curve: neighbours share its samples out among them,
/// so that their errors are unlike and, seen from a little afar, cancel. Passes have nothing in common with each other; they come in
/// pairs, one for each half of the samples, and grow as samples do.
///
/// Source: Ahmed & Wonka, "Screen-Space Blue-Noise Diffusion of Monte Carlo Sampling Error via Hierarchical Ordering of
/// Pixels", SIGGRAPH Asia 2020.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Pass {
    /// Its first sample of a pixel, and how many.
    first: u32,
    len: u32,
    /// Half of the samples that it counts for.
    half: usize,
}

impl Pass {
    /// The pass of sample `index`: of [0, 2), [2, 4), [4, 8), [8, 16) .. the first or the second half.
    fn of(index: u32) -> Self {
        let pair = if index < 2 { 2 } else { (1 << index.ilog2()).min(2 * LONGEST_PASS) };
        let len = pair / 2;
        let first = index - index % len;
        Self { first, len, half: usize::from(index % pair >= len) }
    }

    /// Samples of a half among the first `spp`.
    fn samples(spp: u32, half: usize) -> u32 {
        let (mut at, mut sum) = (0, 0);
        while at < spp {
            let pass = Self::of(at);
            sum += if pass.half == half { pass.len.min(spp - at) } else { 0 };
            at += pass.len;
        }
        sum
    }
}

/// Sums of samples, in two halves whose difference tells the noise.
#[derive(Clone, Debug, PartialEq)]
pub struct ReferenceAccumulator {
    width: u32,
    height: u32,
    /// Of passes that have nothing in common.
    sums: [Vec<[f64; 3]>; 2],
    spp: u32,
}

impl ReferenceAccumulator {
    /// Nothing integrated yet.
    pub fn new(width: u32, height: u32) -> Self {
        let zero = vec![[0.0; 3]; width as usize * height as usize];
        Self { width, height, sums: [zero.clone(), zero], spp: 0 }
    }

    /// Samples per pixel so far.
    pub fn spp(&self) -> u32 {
        self.spp
    }

    /// The mean of all samples.
    pub fn image(&self) -> Image {
        self.mean(&|i| std::array::from_fn(|c| self.sums[0][i][c] + self.sums[1][i][c]), self.spp)
    }

    /// The mean of one half of the samples, 0 or 1: when the halves agree the picture can be judged by. Black where there are no
    /// samples of it yet.
    pub fn half(&self, which: usize) -> Image {
        self.mean(&|i| self.sums[which][i], Pass::samples(self.spp, which))
    }

    fn mean(&self, sum: &dyn Fn(usize) -> [f64; 3], n: u32) -> Image {
        let scale = 1.0 / f64::from(n.max(1));
        let pixels = (0..self.sums[0].len()).map(|i| sum(i).map(|v| (v * scale) as f32)).collect();
        Image { width: self.width, height: self.height, pixels }
    }

    /// State for resuming, little-endian.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(20 + self.sums[0].len() * 48);
        out.extend_from_slice(b"CATREF2\0");
        for v in [self.width, self.height, self.spp] {
            out.extend_from_slice(&v.to_le_bytes());
        }
        for v in self.sums.iter().flatten().flatten() {
            out.extend_from_slice(&v.to_le_bytes());
        }
        out
    }

    /// Reads [`Self::to_bytes`]; `None` where the bytes are not such a state.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let rest = bytes.strip_prefix(b"CATREF2\0")?;
        let word = |i: usize| Some(u32::from_le_bytes(rest.get(4 * i..4 * i + 4)?.try_into().ok()?));
        let (width, height, spp) = (word(0)?, word(1)?, word(2)?);
        let n = width as usize * height as usize;
        let data = rest.get(12..)?;
        if data.len() != n.checked_mul(48)? {
            return None;
        }
        let value = |i: usize| f64::from_le_bytes(data[8 * i..8 * i + 8].try_into().expect("eight bytes"));
        let half = |h: usize| (0..n).map(|i| std::array::from_fn(|c| value((h * n + i) * 3 + c))).collect();
        Some(Self { width, height, sums: [half(0), half(1)], spp })
    }

    /// Adds `samples` samples to every pixel, on the caller's rayon pool. Returns the number of rays.
    pub(crate) fn add(
        &mut self,
        scene: &RenderScene,
        normals: &NormalMatrices,
        accel: &Accel,
        options: &ReferenceOptions,
        samples: u32,
    ) -> u64 {
        let width = self.width as usize;
        let first = self.spp;
        let emissive = scene.materials.iter().any(|m| m.emissive != Vec3::ZERO && !m.unlit);
        let [a, b] = &mut self.sums;
        let rays = a
            .par_chunks_mut(width)
            .zip(b.par_chunks_mut(width))
            .enumerate()
            .map(|(y, (a, b))| {
                let mut rays = 0;
                for x in 0..width {
                    // All samples of a pixel begin with one ray, through its centre.
                    let ray = camera_ray(&scene.camera, x as f32, y as f32, options.width, options.height);
                    let seen = meet(scene, normals, accel, &ray);
                    rays += u64::from(first == 0);
                    let place = sampling::morton(x as u32, y as u32);
                    for index in first..first + samples {
                        let pass = Pass::of(index);
                        // Far apart, pixels of huge pictures may have the same.
                        let number = place.wrapping_mul(pass.len) + (index - pass.first);
                        let seed = sampling::hash_combine(options.seed, pass.first);
                        let mut path =
                            Path { scene, normals, accel, options, emissive, number, seed, dimension: 0, rays: 0 };
                        let radiance = path.radiance(ray, seen);
                        rays += path.rays;
                        let sum = if pass.half == 0 { &mut a[x] } else { &mut b[x] };
                        if radiance.is_finite() {
                            for c in 0..3 {
                                sum[c] += f64::from(radiance[c]);
                            }
                        }
                    }
                }
                rays
            })
            .sum();
        self.spp += samples;
        rays
    }
}

/// What a ray meets, and the surface there.
fn meet(scene: &RenderScene, normals: &NormalMatrices, accel: &Accel, ray: &Ray) -> (Hit, Option<Surface>) {
    let hit = accel.closest_hit(ray);
    (hit, hit.is_hit().then(|| surface_at(scene, normals, ray, &hit)))
}

struct Path<'a> {
    scene: &'a RenderScene,
    normals: &'a NormalMatrices,
    accel: &'a Accel,
    options: &'a ReferenceOptions,
    /// Some surface emits.
    emissive: bool,
    /// Of the sample among all of its pass.
    number: u32,
    /// Of its pass.
    seed: u32,
    dimension: u32,
    rays: u64,
}

impl Path<'_> {
    /// The next two coordinates of this sample.
    fn next_2d(&mut self) -> glam::Vec2 {
        self.dimension += 1;
        sampling::sobol_2d(self.number, sampling::hash_combine(self.seed, self.dimension))
    }

    /// Radiance along `ray`, which meets `seen`.
    fn radiance(&mut self, mut ray: Ray, mut seen: (Hit, Option<Surface>)) -> Vec3 {
        let scene = self.scene;
        let (mut radiance, mut throughput) = (Vec3::ZERO, Vec3::ONE);
        let mut inside = MediumStack::default();
        // Light from a surface arrives with no next-event step: it takes one diffuse reflection more to see the same bounces.
        let last =
            if self.emissive && self.options.bounces > 0 { self.options.bounces + 1 } else { self.options.bounces };
        let (mut diffuse_bounces, mut interfaces, mut crossed) = (0, 0, 0);
        loop {
            let (hit, s) = seen;
            if let Some(medium) = inside.current(scene) {
                let m = &scene.materials[scene.instances[medium as usize].material as usize];
                throughput *= beer_lambert(m.attenuation_color, m.attenuation_distance, hit.t);
            }
            let Some(s) = s else {
                // The background is seen, directly and in mirrors, but lights nothing.
                if diffuse_bounces == 0 {
                    radiance += throughput * scene.environment.background;
                }
                return radiance;
            };
            let m = &scene.materials[s.material as usize];
            if diffuse_bounces == 0 || !m.unlit {
                radiance += throughput * s.emission;
            }
            if m.unlit || diffuse_bounces > self.options.bounces {
                return radiance;
            }
            radiance += throughput * self.next_event(&s, -ray.direction, diffuse_bounces == 0);
            if diffuse_bounces == 0 {
                let ambient = s.base_color * scene.environment.ambient * (m.ambient * s.look.matte_weight());
                radiance += throughput * ambient;
            }

            // Choose one continuation in proportion to its weight: matte, reflected, transmitted.
            let matte = s.base_color * (s.look.diffuse * s.look.matte_weight());
            let mut matte_weight = if diffuse_bounces < last { matte.element_sum() } else { 0.0 };
            let traced = s.look.is_traced() && diffuse_bounces == 0 && interfaces < self.options.max_depth;
            let mut reflected_weight = 0.0;
            let mut transmitted_weight = 0.0;
            let mut optics = None;
            if traced {
                let o = split(scene, m, &s, ray.direction, inside);
                if o.hidden {
                    crossed += 1;
                    if crossed > 4 * self.options.max_depth {
                        return radiance;
                    }
                    inside = o.behind;
                    ray = s.leaving_ray(ray.direction);
                    seen = self.meet(&ray);
                    continue;
                }
                reflected_weight = o.reflected.element_sum();
                transmitted_weight = if o.transmitted_direction.is_some() { o.transmitted.element_sum() } else { 0.0 };
                optics = Some(o);
            }
            let total = matte_weight + reflected_weight + transmitted_weight;
            if total <= 0.0 {
                return radiance;
            }
            matte_weight /= total;
            reflected_weight /= total;
            transmitted_weight /= total;
            let choice = self.next_2d().x;
            if choice < matte_weight {
                throughput *= matte / matte_weight;
                let xi = self.next_2d();
                let d = sampling::cosine_direction(s.n_shading, xi);
                if s.n_geometric.dot(d) <= 0.0 {
                    return radiance;
                }
                ray = s.leaving_ray(d);
                seen = self.meet(&ray);
                diffuse_bounces += 1;
                inside = MediumStack::default();
                continue;
            }
            let optics = optics.expect("a weight over zero came from it");
            if choice < matte_weight + reflected_weight || transmitted_weight <= 0.0 {
                throughput *= optics.reflected / reflected_weight;
                let r = mirrored(ray.direction, s.n_shading, s.n_geometric);
                ray = s.leaving_ray(r);
            } else {
                throughput *= optics.transmitted / transmitted_weight;
                let t = optics.transmitted_direction.expect("a weight over zero came with it");
                inside = optics.behind;
                ray = s.leaving_ray(t);
            }
            interfaces += 1;
            if throughput.max_element() < 1e-5 {
                return radiance;
            }
            seen = self.meet(&ray);
        }
    }

    fn meet(&mut self, ray: &Ray) -> (Hit, Option<Surface>) {
        self.rays += 1;
        meet(self.scene, self.normals, self.accel, ray)
    }

    /// Next-event estimation: one point on the disc of every light.
    /// * `highlight`: with the specular lobe (camera paths); without it the light is Lambertian, as VPLs are
    fn next_event(&mut self, s: &Surface, wo: Vec3, highlight: bool) -> Vec3 {
        let lambert = Surface { look: Look { specular: Vec3::ZERO, ..s.look }, ..*s };
        let s = if highlight { s } else { &lambert };
        let mut sum = Vec3::ZERO;
        for light in 0..self.scene.lights.len() as u32 {
            let xi = self.next_2d();
            let unshadowed = reflected_from_light(self.scene, light, s, wo);
            if unshadowed == Vec3::ZERO {
                continue;
            }
            if let Some(ray) = shadow_ray(self.scene, light, &s.ray_start(), sampling::concentric_disc(xi)) {
                self.rays += 1;
                if !self.accel.occluded(&ray) {
                    sum += unshadowed;
                }
            }
        }
        sum
    }
}

/// Radiance of uniform indirect light inside a closed Lambertian sphere (../shared/analytic sphere_indirect_uniform):
/// (ρ/π)(I/R²) ρ (1 − ρᴺ)/(1 − ρ). What tests and docs hold the path tracer and the VPLs against.
pub fn sphere_indirect_radiance(albedo: f32, intensity: f32, radius: f32, bounces: u32) -> f32 {
    let rho_n = (0..bounces).fold(1.0, |p, _| p * albedo);
    albedo / PI * intensity / (radius * radius) * albedo * (1.0 - rho_n) / (1.0 - albedo)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passes_are_halves_of_growing_pairs() {
        let mut at = 0;
        let mut count = [0, 0];
        while at < 4096 {
            let pass = Pass::of(at);
            assert_eq!((pass.first, pass.len.is_power_of_two()), (at, true));
            assert!(pass.len <= LONGEST_PASS && at % pass.len == 0);
            for index in at..at + pass.len {
                assert_eq!(Pass::of(index), pass);
                count[pass.half] += 1;
                assert_eq!([0, 1].map(|half| Pass::samples(index + 1, half)), count);
            }
            at += pass.len;
            if at.is_power_of_two() && at > 1 {
                assert_eq!(count[0], count[1], "after {at}");
            }
        }
        assert_eq!(Pass::of(4095).len, LONGEST_PASS);
    }
}
