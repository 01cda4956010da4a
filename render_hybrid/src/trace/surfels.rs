//! VPLs that stay on their surfaces: a fixed pattern of places on every instance, lit by many light paths.
//!
//! Where each landing of a light path is a VPL, a path that leaves a moving body takes its VPL along, and all of its light jumps. Here
//! VPLs lie where the surfaces are, in a pattern of object space, and move as their instances do; sixteen landings for each share
//! their flux out among those around them. A landing that jumps then moves a small part of the light from some VPLs to others,
//! and VPLs on what stands still keep their shadow maps however the lights move.
//!
//! A landing gives to surfel j of its instance in proportion to cos³θ / (1 + (d² + 15 h²)/2s²)⁴: θ between their normals, d their distance,
//! h that off the landing's plane, s the spacing of the surfels, less a thousandth of the greatest; the shares add
//! up to one, so no flux is lost.
//!
//! Sources: Keller, "Instant Radiosity", SIGGRAPH 1997 (the light paths); Dong et al., "Real-time Indirect Illumination with
//! Clustered Visibility", VMV 2009 (many landings for one VPL).

use catoptra_engine::{Mesh, RenderScene};
use glam::{Affine3, Vec3};
use rayon::prelude::*;

use super::{
    photons::vpl_at,
    points::{LANES, Lane, make_room},
    sampling,
    surface::{NormalMatrices, Surface, surface_at},
};
use crate::{
    accel::{Hit, Ray},
    settings::SimdLevel,
    simd::dispatch,
    still::SameAssets,
    twin::vpl::Vpl,
};

/// Landings traced for each surfel. Higher: less flicker and noise, so many more light paths.
pub const LANDINGS_A_SURFEL: u32 = 16;

/// Surfels of the smallest instance: four a face of a box. Bodies that move are small, and what they throw back changes most.
const LEAST_OF_INSTANCE: u32 = 24;

/// Square of the reach of a landing in spacings. Higher: steadier light, blurred further.
const REACH_SQUARED: f32 = 2.0;

/// Most area of surfaces as a share of the squared bounding radius of the greatest instance: that of a ball around it. Where more is folded into
/// it, as into arcades and roofs of two sides, much is never lit, and neighbours may lie in different rooms.
const MOST_AREA: f32 = 4.0 * std::f32::consts::PI;

/// Most spacing of surfels as a share of the greatest instance's bounding radius: where they would lie further apart they would not
/// show where light falls.
const MOST_SPACING: f32 = 0.15;

/// Weight of the distance off the landing's plane.
const OFF_PLANE: f32 = 15.0;
/// Part of the weight that does not go by the normals, so that the shares of every landing add up.
const ANY_NORMAL: f32 = 1e-4;
/// Weights are less by this share of a landing's greatest, down to none: what lies far off, or is the far side of a wall, stays dark
/// and costs nothing.
const NO_SHARE: f32 = 1e-3;

/// Sixteen surfels of one instance, world space; their front sides.
#[derive(Clone, Copy, Debug, Default)]
struct Block {
    position: [Lane; 3],
    /// Zero: no surfel.
    normal: [Lane; 3],
    real: Lane,
}

/// Balls around sixteen blocks, and cones around their normals.
#[derive(Clone, Copy, Debug, Default)]
struct Bounds {
    center: [Lane; 3],
    radius: Lane,
    normal: [Lane; 3],
    /// Most difference of a normal from that one; below zero: no block.
    spread: Lane,
}

/// Flux of the front and back sides of sixteen surfels, per channel.
type BlockFlux = [[Lane; 3]; 2];

/// Tasks that the landings are shared out to: a fixed number, since the order of sums must not depend on threads.
const TASKS: usize = 16;

/// A landing of a light path: what its VPL would be, and the instance that it lies on.
pub type Landing = (Vpl, u32);

/// The pattern, where it was brought to in the last frame, and memory to light it.
#[derive(Clone, Debug, Default)]
pub struct Surfels {
    made_for: MadeFor,
    /// Metres between neighbours.
    spacing: f32,
    /// The surfels are close enough to each other.
    covers: bool,
    /// The places, by instance.
    hits: Vec<Hit>,
    /// First block of each instance, and the end.
    first_blocks: Vec<u32>,
    /// Transforms that they were brought to.
    placed: Vec<Affine3>,
    blocks: Vec<Block>,
    /// Sixteen blocks of an instance each, and the first of each instance, and the end.
    bounds: Vec<Bounds>,
    first_bounds: Vec<u32>,
    /// Front and back of each lane of each block; no flux.
    sides: Vec<[Vpl; 2]>,
    flux: Vec<BlockFlux>,
    tasks: Vec<Task>,
    /// Those with flux, by instance.
    pub lit: Vec<Vpl>,
}

/// What the pattern is a function of: rigid motion does not change it.
#[derive(Clone, Debug, Default)]
struct MadeFor {
    count: u32,
    /// Mesh, material and scale of each instance.
    instances: Vec<(u32, u32, u32)>,
    assets: SameAssets,
}

/// What a part of the landings gives.
#[derive(Clone, Debug, Default)]
struct Task {
    flux: Vec<BlockFlux>,
    near: Near,
    /// On instances without surfels.
    alone: Vec<Vpl>,
}

/// The blocks around a landing.
#[derive(Clone, Debug, Default)]
struct Near {
    /// What each of all could have at most, sixteen together.
    most: Vec<Lane>,
    found: Vec<(u32, Lane)>,
}

impl Surfels {
    /// Brings the pattern to where the instances are. False where `count` surfels would not cover the scene's surfaces:
    /// there is no pattern then.
    pub fn place(&mut self, scene: &RenderScene, normals: &NormalMatrices, count: u32) -> bool {
        if self.made_for.update(scene, count) {
            self.make(scene, normals, count);
        }
        if !self.covers {
            return false;
        }
        let all = self.placed.len() != scene.instances.len();
        for (i, instance) in scene.instances.iter().enumerate() {
            if all || self.placed[i] != instance.world_from_object {
                self.place_instance(scene, normals, i);
            }
        }
        self.placed.clear();
        self.placed.extend(scene.instances.iter().map(|i| i.world_from_object));
        true
    }

    /// Chooses the places: each instance that can be lit gets [`LEAST_OF_INSTANCE`], and the rest by its area.
    fn make(&mut self, scene: &RenderScene, normals: &NormalMatrices, count: u32) {
        self.hits.clear();
        self.first_blocks.clear();
        self.first_bounds.clear();
        self.placed.clear();
        self.covers = false;
        let areas = matte_areas(scene, normals);
        let total: f64 = areas.iter().map(|a| a.0).sum();
        let matte = areas.iter().filter(|a| a.0 > 0.0).count() as u32;
        let by_area = count.saturating_sub(matte * LEAST_OF_INSTANCE);
        // Otherwise bodies have all surfels, and what they stand on has none.
        if !(total > 0.0 && total.is_finite() && by_area >= count / 2) {
            return;
        }
        self.spacing = (total / f64::from(count)).sqrt() as f32;
        let radius = greatest_radius(scene);
        self.covers = self.spacing <= MOST_SPACING * radius && total <= f64::from(MOST_AREA * radius * radius);
        if !self.covers {
            return;
        }
        let (mut blocks, mut bounds) = (0, 0);
        for (instance_id, (area, sums)) in areas.iter().enumerate() {
            self.first_blocks.push(blocks as u32);
            self.first_bounds.push(bounds as u32);
            if *area > 0.0 {
                let n = LEAST_OF_INSTANCE + (area / total * f64::from(by_area)) as u32;
                let mut places: Vec<_> = (0..n).map(|i| place_on_mesh(sums, instance_id as u32, i, n)).collect();
                let mesh = &scene.meshes[scene.instances[instance_id].mesh as usize];
                places.sort_by_cached_key(|hit| neighbourhood(mesh, hit));
                self.hits.extend(places);
                // Whole blocks; what fills the last one has no triangle.
                self.hits.resize(self.hits.len().next_multiple_of(LANES), Hit::MISS);
                bounds += (self.hits.len() / LANES - blocks).div_ceil(LANES);
                blocks = self.hits.len() / LANES;
            }
        }
        self.first_blocks.push(blocks as u32);
        self.first_bounds.push(bounds as u32);
        self.blocks.clear();
        self.blocks.resize(blocks, Block::default());
        self.bounds.clear();
        self.bounds.resize(bounds, Bounds::default());
        self.sides.clear();
        self.sides.resize(self.hits.len(), [Vpl::default(); 2]);
    }

    fn place_instance(&mut self, scene: &RenderScene, normals: &NormalMatrices, instance: usize) {
        let places = self.first_blocks[instance] as usize * LANES..self.first_blocks[instance + 1] as usize * LANES;
        for k in places {
            let (block, lane) = (&mut self.blocks[k / LANES], k % LANES);
            if !self.hits[k].is_hit() {
                continue;
            }
            let [front, back] = sides_of(scene, normals, &self.hits[k]);
            for axis in 0..3 {
                block.position[axis][lane] = front.position_world[axis];
                block.normal[axis][lane] = front.n_shading[axis];
            }
            block.real[lane] = 1.0;
            self.sides[k] = [vpl_at(&front, Vec3::ZERO), vpl_at(&back, Vec3::ZERO)];
        }
        let blocks = &self.blocks[self.first_blocks[instance] as usize..self.first_blocks[instance + 1] as usize];
        for (bounds, blocks) in self.bounds[self.first_bounds[instance] as usize..].iter_mut().zip(blocks.chunks(LANES))
        {
            bounds.spread = [-1.0; LANES];
            for (i, block) in blocks.iter().enumerate() {
                bounds.set(i, block);
            }
        }
    }

    /// Shares out the flux of landings; afterwards `lit` holds the VPLs: at most two a surfel, for its sides.
    pub fn light(&mut self, level: SimdLevel, landings: &[Landing]) {
        let Self { blocks, first_blocks, bounds, first_bounds, spacing, tasks, flux, .. } = self;
        tasks.resize_with(TASKS, Task::default);
        let each = landings.len().div_ceil(TASKS).max(1);
        let inverse_square = 1.0 / (REACH_SQUARED * *spacing * *spacing);
        tasks.par_iter_mut().enumerate().for_each(|(i, task)| {
            task.flux.clear();
            task.flux.resize(blocks.len(), BlockFlux::default());
            task.alone.clear();
            let own = (i * each).min(landings.len())..((i + 1) * each).min(landings.len());
            for (landing, instance) in landings[own].iter().filter(|l| l.0.flux != Vec3::ZERO) {
                let range = |first: &[u32]| first[*instance as usize] as usize..first[*instance as usize + 1] as usize;
                let (own_blocks, own_bounds) = (range(first_blocks), range(first_bounds));
                if own_blocks.is_empty() {
                    task.alone.push(*landing);
                    continue;
                }
                let near = &mut task.near;
                near.most.resize(own_bounds.len(), [0.0; LANES]);
                make_room(&mut near.found, own_blocks.len());
                let (blocks, flux) = (&blocks[own_blocks.clone()], &mut task.flux[own_blocks]);
                share_out(level, blocks, &bounds[own_bounds], landing, inverse_square, near, flux);
            }
        });
        flux.clear();
        flux.resize(blocks.len(), BlockFlux::default());
        self.lit.clear();
        for task in tasks.iter() {
            for (sum, part) in flux.iter_mut().zip(&task.flux) {
                for (sum, part) in sum.as_flattened_mut().iter_mut().zip(part.as_flattened()) {
                    for lane in 0..LANES {
                        sum[lane] += part[lane];
                    }
                }
            }
        }
        for (k, sides) in self.sides.iter().enumerate() {
            for (side, vpl) in sides.iter().enumerate() {
                let [r, g, b] = &flux[k / LANES][side];
                let flux = Vec3::new(r[k % LANES], g[k % LANES], b[k % LANES]);
                if flux != Vec3::ZERO {
                    self.lit.push(Vpl { flux, ..*vpl });
                }
            }
        }
        self.lit.extend(tasks.iter().flat_map(|t| &t.alone));
    }
}

impl MadeFor {
    /// True where something has changed; remembers the scene.
    fn update(&mut self, scene: &RenderScene, count: u32) -> bool {
        let instances = || scene.instances.iter().map(|i| (i.mesh, i.material, rounded_scale(i.world_from_object)));
        let same =
            self.count == count && self.instances.iter().copied().eq(instances()) && self.assets.are_those_of(scene);
        if !same {
            self.count = count;
            self.instances.clear();
            self.instances.extend(instances());
            self.assets.remember(scene);
        }
        !same
    }
}

/// Bits of the mean squared length of the transform's columns to eight digits of its mantissa: a body that turns keeps it.
fn rounded_scale(m: Affine3) -> u32 {
    let square =
        m.matrix3.x_axis.length_squared() + m.matrix3.y_axis.length_squared() + m.matrix3.z_axis.length_squared();
    (square * (1.0 / 3.0)).to_bits().saturating_add(1 << 14) & !((1 << 15) - 1)
}

/// Of the instances' bounds, metres; the same however they lie.
fn greatest_radius(scene: &RenderScene) -> f32 {
    let radius = |i: &catoptra_engine::Instance| {
        let scale = f32::from_bits(rounded_scale(i.world_from_object)).sqrt();
        scene.meshes[i.mesh as usize].bounds_object().radius() * scale
    };
    scene.instances.iter().map(radius).fold(0.0, f32::max)
}

/// World area of each instance as far as it can be lit, and the sums of its triangles' areas in object space.
fn matte_areas(scene: &RenderScene, normals: &NormalMatrices) -> Vec<(f64, Vec<f64>)> {
    const TESTED: u32 = 16;
    let of = |(instance_id, instance): (usize, &catoptra_engine::Instance)| {
        let mesh = &scene.meshes[instance.mesh as usize];
        let mut sum = 0.0;
        let sums: Vec<f64> = (0..mesh.triangles().len() as u32)
            .map(|t| {
                let [a, b, c] = mesh.corners(t).map(|p| p.as_dvec3());
                let area = (b - a).cross(c - a).length_squared().sqrt() * 0.5;
                sum += if area.is_finite() { area } else { 0.0 };
                sum
            })
            .collect();
        if !(sum > 0.0) {
            return (0.0, sums);
        }
        let matte = (0..TESTED)
            .filter(|&i| {
                let hit = place_on_mesh(&sums, instance_id as u32, i, TESTED);
                let [s, _] = sides_of(scene, normals, &hit);
                let lit = s.base_color * (s.look.diffuse * s.look.matte_weight());
                (lit != Vec3::ZERO && !scene.materials[s.material as usize].unlit) || s.emission != Vec3::ZERO
            })
            .count();
        let scale = f64::from(f32::from_bits(rounded_scale(instance.world_from_object)));
        (sum * scale * matte as f64 / f64::from(TESTED), sums)
    };
    scene.instances.iter().enumerate().map(of).collect()
}

/// Place `i` of `n` on a mesh, even over its area (of object space).
fn place_on_mesh(sums: &[f64], instance_id: u32, i: u32, n: u32) -> Hit {
    let target = (f64::from(i) + 0.5) / f64::from(n) * sums[sums.len() - 1];
    let at = sums.partition_point(|sum| *sum <= target).min(sums.len() - 1);
    let before = if at == 0 { 0.0 } else { sums[at - 1] };
    let left = ((target - before) / (sums[at] - before)).clamp(0.0, 1.0) as f32;
    let (root, y) = (left.sqrt(), sampling::radical_inverse(2, i + 1));
    Hit { t: 0.0, u: root * (1.0 - y), v: root * y, instance_id, primitive_id: at as u32 }
}

/// The surface at a place, seen from its front and from its back.
fn sides_of(scene: &RenderScene, normals: &NormalMatrices, hit: &Hit) -> [Surface; 2] {
    let instance = &scene.instances[hit.instance_id as usize];
    let corners = scene.meshes[instance.mesh as usize].corners(hit.primitive_id);
    let n = super::surface::outward(&normals.of(hit.instance_id), corners).normalize_or(Vec3::Y);
    [n, -n].map(|n| surface_at(scene, normals, &Ray::new(n, -n), hit))
}

/// Sorts the places of an instance so that sixteen in a row are close to each other and face one way: the side that they face most,
/// then a Z curve through the mesh's bounds.
fn neighbourhood(mesh: &Mesh, hit: &Hit) -> (u32, u32) {
    let [a, b, c] = mesh.corners(hit.primitive_id);
    let (p, n) = (a + (b - a) * hit.u + (c - a) * hit.v, (b - a).cross(c - a));
    let axis = n.abs().max_position() as u32;
    let bounds = mesh.bounds_object();
    let cell = ((p - bounds.min) / (bounds.max - bounds.min).max(Vec3::splat(f32::MIN_POSITIVE)) * 1023.0).as_uvec3();
    let spread = |v: u32| (0..10).fold(0, |sum, bit| sum | (((v >> bit) & 1) << (3 * bit)));
    (axis * 2 + u32::from(n[axis as usize] < 0.0), spread(cell.x) | spread(cell.y) << 1 | spread(cell.z) << 2)
}

impl Bounds {
    fn set(&mut self, at: usize, block: &Block) {
        let lanes = || (0..LANES).filter(|lane| block.real[*lane] > 0.0);
        let of = |v: &[Lane; 3], lane: usize| Vec3::new(v[0][lane], v[1][lane], v[2][lane]);
        let inverse_count = 1.0 / (lanes().count().max(1) as f32);
        let mean = |v: &[Lane; 3]| lanes().map(|lane| of(v, lane)).sum::<Vec3>() * inverse_count;
        let most = |v: &[Lane; 3], from: Vec3| lanes().map(|lane| of(v, lane).distance(from)).fold(0.0, f32::max);
        let (center, normal) = (mean(&block.position), mean(&block.normal));
        for axis in 0..3 {
            self.center[axis][at] = center[axis];
            self.normal[axis][at] = normal[axis];
        }
        // A little more, for roundings.
        self.radius[at] = most(&block.position, center) * 1.0001;
        self.spread[at] = most(&block.normal, normal) + 1e-4;
    }
}

/// What a surfel gets, before shares add up to one; its sign tells the side.
/// * `d2`, `off`: squared distance, and distance off the landing's plane; `cos`: between the normals
#[inline(always)]
fn weight(d2: f32, off: f32, cos: f32, inverse_square: f32) -> f32 {
    let near = 1.0 / (1.0 + (d2 + OFF_PLANE * off * off) * inverse_square);
    let near = near * near;
    near * near * (cos.abs() * cos * cos + ANY_NORMAL)
}

/// At least the weight of any surfel of each block.
#[inline(always)]
fn most_weight(bounds: &Bounds, p: Vec3, n: Vec3, inverse_square: f32) -> Lane {
    let ([x, y, z], [nx, ny, nz]) = (&bounds.center, &bounds.normal);
    let mut most = [0.0f32; LANES];
    for lane in 0..LANES {
        let to = Vec3::new(x[lane] - p.x, y[lane] - p.y, z[lane] - p.z);
        let (radius, spread) = (bounds.radius[lane], bounds.spread[lane]);
        let cos = (nx[lane] * n.x + ny[lane] * n.y + nz[lane] * n.z).abs() + spread;
        let off = (to.x * n.x + to.y * n.y + to.z * n.z).abs() - radius;
        let off = if off > 0.0 { off } else { 0.0 };
        let d = (to.x * to.x + to.y * to.y + to.z * to.z).sqrt() * 0.9999 - radius;
        let d = if d > 0.0 { d } else { 0.0 };
        let weight = weight(d * d, off, cos, inverse_square);
        most[lane] = if spread < 0.0 { 0.0 } else { weight };
    }
    most
}

/// Weights of a block's surfels for a landing, and the greatest.
#[inline(always)]
fn weights_of(block: &Block, p: Vec3, n: Vec3, inverse_square: f32) -> (Lane, f32) {
    let ([x, y, z], [nx, ny, nz]) = (&block.position, &block.normal);
    let (mut signed, mut most) = ([0.0f32; LANES], 0.0f32);
    for lane in 0..LANES {
        let to = Vec3::new(x[lane] - p.x, y[lane] - p.y, z[lane] - p.z);
        let cos = nx[lane] * n.x + ny[lane] * n.y + nz[lane] * n.z;
        let off = to.x * n.x + to.y * n.y + to.z * n.z;
        let d2 = to.x * to.x + to.y * to.y + to.z * to.z;
        let weight = block.real[lane] * weight(d2, off, cos, inverse_square);
        signed[lane] = if cos < 0.0 { -weight } else { weight };
    }
    for weight in signed {
        most = if weight.abs() > most { weight.abs() } else { most };
    }
    (signed, most)
}

#[inline(always)]
fn share_out_body(
    blocks: &[Block],
    bounds: &[Bounds],
    landing: &Vpl,
    inverse_square: f32,
    near: &mut Near,
    flux: &mut [BlockFlux],
) {
    let (p, n) = (landing.position_world, landing.normal_world);
    let (mut first, mut greatest) = (0, -1.0f32);
    for (i, (bounds, most)) in bounds.iter().zip(near.most.iter_mut()).enumerate() {
        *most = most_weight(bounds, p, n, inverse_square);
        for (lane, most) in most.iter().enumerate() {
            if *most > greatest {
                (first, greatest) = (i * LANES + lane, *most);
            }
        }
    }
    // The most promising block first: most others can then be left out, since none of theirs is above the least that counts.
    let (weights, mut most) = weights_of(&blocks[first], p, n, inverse_square);
    near.found.clear();
    near.found.push((first as u32, weights));
    for i in (0..blocks.len()).filter(|i| *i != first) {
        if near.most[i / LANES][i % LANES] > NO_SHARE * most {
            let (weights, of_block) = weights_of(&blocks[i], p, n, inverse_square);
            most = if of_block > most { of_block } else { most };
            near.found.push((i as u32, weights));
        }
    }
    let least = NO_SHARE * most;
    let mut sums = [0.0f32; LANES];
    for (_, weights) in near.found.iter_mut() {
        for lane in 0..LANES {
            let signed = weights[lane];
            let weight = signed.abs() - least;
            let weight = if weight > 0.0 { weight } else { 0.0 };
            sums[lane] += weight;
            weights[lane] = if signed < 0.0 { -weight } else { weight };
        }
    }
    let sum: f32 = sums.iter().sum();
    let scale = 1.0 / if sum > f32::MIN_POSITIVE { sum } else { f32::MIN_POSITIVE };
    let light = [landing.flux.x * scale, landing.flux.y * scale, landing.flux.z * scale];
    for (block, weights) in &near.found {
        for (channel, light) in light.iter().enumerate() {
            let [front, back] = &mut flux[*block as usize];
            for lane in 0..LANES {
                let weight = weights[lane];
                front[channel][lane] += light * if weight > 0.0 { weight } else { 0.0 };
                back[channel][lane] += light * if weight < 0.0 { -weight } else { 0.0 };
            }
        }
    }
}

dispatch! {
    /// Adds a landing's flux to the surfels around it.
    fn share_out => share_out_body(
        blocks: &[Block],
        bounds: &[Bounds],
        landing: &Vpl,
        inverse_square: f32,
        near: &mut Near,
        flux: &mut [BlockFlux],
    )
}
