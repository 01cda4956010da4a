//! What stands close to a place, by rays over its hemisphere: light that the bound of the VPLs' geometry term cuts off, and
//! occluders that are too close for the VPLs' maps to see between them and the place.
//!
//! * Light: a bounded VPL gives min(G, b) of its light. The rest, where G > b, comes from surfaces within 1/√b, so a ray that
//!   meets such a surface brings (1 − b/G) of what it reflects: light of the lights, and of VPLs of one bounce less.
//! * Occluders: a texel of a VPL's map (of 32 texels) covers a twelfth of the distance to the place. What a ray from the place meets within
//!   [`NEAR`] of that distance blocks the VPLs in the ray's cell, unless it lies on the VPL's own plane.
//!
//! [`NearField::Light`] is the first alone, by fewer and shorter rays.
//!
//! Cells are those of a hemispherical octahedral map around the shading normal, turned from place to place.
//!
//! Sources: Kollig & Keller, "Illumination in the Presence of Weak Singularities", MCQMC 2004 (the light that a bound cuts
//! off, by rays); Cigolle et al., "A Survey of Efficient Representations for Independent Unit Vectors", JCGT 2014 (the map).

use catoptra_engine::{RenderScene, math};
use glam::Vec3;
use std::f32::consts::{PI, TAU};

use super::{
    photons::Photons,
    points::{LANES, Lane, PointBatch, accumulate_shadowed_vpls, make_room},
    sampling,
    shade::{FrameContext, reflected_from_light},
    surface::{NormalMatrices, RayStart, Surface, surface_at},
    visibility::{Askers, Towards},
};
use crate::{
    accel::{Accel, Hit, Ray},
    output::RayCounts,
    settings::{NearField, RenderSettings, VplOptions},
    twin::{gbuffer::point_of, grid::near_field_of, vpl::Vpl, vpl_maps::VplMaps},
};

/// Cells a side of a place's map where occluders are looked for.
const SIDE: usize = 8;
/// Rays of a place, at most.
const CELLS: usize = SIDE * SIDE;
/// Cells a side, and VPLs that light what the rays meet.
fn extent(near_field: NearField) -> (usize, u32) {
    if near_field == NearField::Full { (SIDE, 256) } else { (3, 64) }
}
/// Share of a VPL's distance within which a ray of the place knows better what stands between than the VPL's map.
/// Higher: more of what the maps leave out, but twice the darkness where both see the same occluder's edge.
const NEAR: f32 = 0.08;
/// Share of its distance that an occluder must stand before the VPL's own plane.
const BEFORE_PLANE: f32 = 0.1;

/// What the rays of sixteen places met.
#[derive(Clone, Debug)]
pub(crate) struct NearRun {
    tangent: [Lane; 3],
    bitangent: [Lane; 3],
    /// From the place to what the ray of a cell met; far away where nothing.
    offsets: Vec<[[f32; 3]; LANES]>,
}

impl Default for NearRun {
    fn default() -> Self {
        Self { tangent: [[0.0; LANES]; 3], bitangent: [[0.0; LANES]; 3], offsets: vec![[FAR; LANES]; CELLS] }
    }
}

const FAR: [f32; 3] = [1e18; 3];

/// A place whose surroundings are asked for.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct NearPlace {
    pub start: RayStart,
    /// Unit shading normal; zero: nothing lights it.
    pub normal: Vec3,
    /// Of all places of the picture.
    pub number: u32,
    /// Which of a square of four it is.
    pub quarter: u32,
}

/// What lights the surfaces that those rays meet: VPLs of one bounce less, as the surface itself is one.
#[derive(Debug, Default)]
pub(crate) struct NearLights {
    photons: Photons,
    pub maps: VplMaps,
}

impl NearLights {
    pub fn vpls(&self) -> &[Vpl] {
        &self.photons.vpls
    }

    /// As [`Photons::is_unsettled`].
    pub fn is_unsettled(&self) -> bool {
        self.photons.is_unsettled()
    }

    /// Makes the VPLs and their maps, where the settings want any. Returns the numbers of rays of both.
    pub fn make(
        &mut self,
        scene: &RenderScene,
        normals: &NormalMatrices,
        accel: &Accel,
        settings: &RenderSettings,
    ) -> [u64; 2] {
        let near_field = near_field_of(settings);
        let Some(vpl) = settings.vpl.filter(|v| near_field != NearField::Off && v.bounces > 1) else {
            self.photons.forget();
            self.photons.vpls.clear();
            self.maps.clear();
            return [0; 2];
        };
        let few =
            VplOptions { count: vpl.count.min(extent(near_field).1), candidates: 1, bounces: vpl.bounces - 1, ..vpl };
        self.photons.trace(scene, normals, accel, &few, settings.seed);
        let rays = self.maps.render(&self.photons.vpls, vpl.map_size, scene, accel, settings.glass_shadows);
        [self.photons.rays, rays]
    }
}

/// Memory of a thread.
#[derive(Clone, Debug, Default)]
pub(crate) struct NearScratch {
    rays: Vec<Ray>,
    hits: Vec<Hit>,
    /// Place and cell of each ray.
    cells: Vec<(u32, u32)>,
    points: PointBatch,
    asked: Asked,
    /// Place, what a unit of radiance gives there as a vector, and radiance that the lights cause, of each point.
    gathered: Vec<(u32, Vec3, Vec3)>,
    pub runs: Vec<NearRun>,
    pub counts: RayCounts,
}

/// What the lights would give the surfaces that rays met.
#[derive(Clone, Debug, Default)]
struct Asked {
    lit: Vec<Lit>,
    askers: Askers,
}

#[derive(Clone, Copy, Debug)]
struct Lit {
    light: u32,
    /// Of the surface.
    number: u32,
    pixel: u32,
    start: RayStart,
    /// Radiance, unless something stands before the light.
    unshadowed: Vec3,
}

impl Asked {
    /// Notes what each light would give surface `number`, seen from `wo`.
    fn ask(&mut self, ctx: &FrameContext, [number, pixel]: [u32; 2], s: &Surface, wo: Vec3) {
        let start = s.ray_start();
        for light in 0..ctx.scene.lights.len() as u32 {
            let unshadowed = reflected_from_light(ctx.scene, light, s, wo);
            if unshadowed != Vec3::ZERO {
                self.lit.push(Lit { light, number, pixel, start, unshadowed });
            }
        }
    }

    /// Calls `add` with surface and radiance for all light that arrives.
    fn answer(&mut self, ctx: &FrameContext, towards: Towards, counts: &mut RayCounts, mut add: impl FnMut(u32, Vec3)) {
        let Self { lit, askers } = self;
        for light in 0..ctx.scene.lights.len() as u32 {
            askers.clear();
            let of_light = || lit.iter().filter(|l| l.light == light);
            of_light().for_each(|l| askers.push(l.start, l.pixel));
            askers.look(ctx, light, towards, counts);
            for (l, seen) in of_light().zip(&askers.seen) {
                add(l.number, l.unshadowed * *seen);
            }
        }
        lit.clear();
    }
}

/// Unit direction of a cell, z along the normal, and what unit radiance from all of it gives: ∫ cos dω, unnormalised.
/// * `side`: cells a side
fn cell_direction(cell: usize, side: usize) -> (Vec3, f32) {
    let at = |i: usize| (i as f32 + 0.5) * (2.0 / side as f32) - 1.0;
    let (u, v) = (at(cell % side), at(cell / side));
    let (x, y) = (0.5 * (u + v), 0.5 * (u - v));
    let p = Vec3::new(x, y, 1.0 - x.abs() - y.abs());
    let l2 = p.dot(p);
    (p / l2.sqrt(), p.z / (l2 * l2))
}

/// The cell of a direction of any length with z > 0.
#[inline(always)]
fn cell_of(x: f32, y: f32, z: f32) -> usize {
    let inverse = (0.5 * SIDE as f32) / (x.abs() + y.abs() + z);
    let half = 0.5 * SIDE as f32;
    let (u, v) = ((x + y) * inverse + half, (x - y) * inverse + half);
    // Non-finite coordinates become 0.
    let (u, v) = ((u as i32).clamp(0, SIDE as i32 - 1), (v as i32).clamp(0, SIDE as i32 - 1));
    v as usize * SIDE + u as usize
}

impl NearScratch {
    /// Makes room for so many places, whatever their rays meet.
    pub fn reserve(&mut self, near_field: NearField, places: usize, lights: usize) {
        let rays = if near_field == NearField::Off { 0 } else { extent(near_field).0.pow(2) * places };
        make_room(&mut self.rays, rays);
        make_room(&mut self.hits, rays);
        make_room(&mut self.cells, rays);
        make_room(&mut self.gathered, rays);
        self.points.reserve([rays.next_multiple_of(LANES), 0]);
        make_room(&mut self.asked.lit, rays * lights);
        self.asked.askers.reserve(rays);
    }

    /// Sends the rays of all places and adds to `arriving` (per place and channel the vector sum of what arrives, W/m²) the light
    /// that the bound cuts off.
    pub fn look(
        &mut self,
        ctx: &FrameContext,
        near_field: NearField,
        places: &[NearPlace],
        arriving: &mut [[Vec3; 3]],
    ) {
        self.counts = RayCounts::default();
        let full = near_field == NearField::Full;
        let side = extent(near_field).0;
        let mut all = [(Vec3::Z, 0.0); CELLS];
        let directions = &mut all[..side * side];
        for (cell, direction) in directions.iter_mut().enumerate() {
            *direction = cell_direction(cell, side);
        }
        let directions = &*directions;
        let unit = PI / directions.iter().map(|d| d.1).sum::<f32>();
        self.rays.clear();
        self.cells.clear();
        self.runs.resize_with(places.len().div_ceil(LANES), NearRun::default);
        for (i, place) in places.iter().enumerate() {
            let (run, lane) = (&mut self.runs[i / LANES], i % LANES);
            if full {
                run.offsets.iter_mut().for_each(|o| o[lane] = FAR);
            }
            if place.normal == Vec3::ZERO {
                continue;
            }
            let (t, b) = math::orthonormal_basis(place.normal);
            let turn = if full {
                sampling::unit_f32(sampling::hash_u32(place.number))
            } else {
                // The few rays of four places go four ways: cells come round after a quarter of a turn.
                [0.0, 2.0, 3.0, 1.0][place.quarter as usize % 4] * (1.0 / 16.0)
            };
            let (sin, cos) = math::sin_cos(TAU * turn);
            let (t, b) = (t * cos + b * sin, b * cos - t * sin);
            for axis in 0..3 {
                run.tangent[axis][lane] = t[axis];
                run.bitangent[axis][lane] = b[axis];
            }
            for (cell, (d, _)) in directions.iter().enumerate() {
                let d = t * d.x + b * d.y + place.normal * d.z;
                if place.start.n_geometric.dot(d) > 0.0 {
                    let origin = place.start.offset_origin(d);
                    // Beyond, not even a surface that faces the place is cut off.
                    let reach = (place.normal.dot(d).max(0.0) / ctx.geometry_term_max).sqrt();
                    let t_max = if full { f32::INFINITY } else { reach };
                    self.rays.push(Ray { origin, direction: d, t_min: 0.0, t_max });
                    self.cells.push((i as u32, cell as u32));
                }
            }
        }
        self.hits.clear();
        self.hits.resize(self.rays.len(), Hit::MISS);
        ctx.accel.closest_hits(&self.rays, &mut self.hits);
        self.counts.vpl += self.rays.len() as u64;
        self.points.clear();
        self.gathered.clear();
        for ((ray, hit), &(place, cell)) in self.rays.iter().zip(&self.hits).zip(&self.cells) {
            if !hit.is_hit() {
                continue;
            }
            if full {
                let (run, lane) = (&mut self.runs[place as usize / LANES], place as usize % LANES);
                run.offsets[cell as usize][lane] = (ray.direction * hit.t).to_array();
            }
            // Even two surfaces that face each other are beyond the bound's reach.
            if !(hit.t * hit.t * ctx.geometry_term_max < 1.0) {
                continue;
            }
            let s = surface_at(ctx.scene, ctx.normals, ray, hit);
            let cos_x = places[place as usize].normal.dot(ray.direction).max(0.0);
            let g = cos_x * s.n_shading.dot(-ray.direction).max(0.0) / (hit.t * hit.t);
            if g > ctx.geometry_term_max {
                let solid_angle = directions[cell as usize].1 * unit / cos_x.max(1e-6);
                let share = ray.direction * (solid_angle * (1.0 - ctx.geometry_term_max / g));
                let mut own = Vec3::ZERO;
                if let Some(lambert) = lambert(ctx, &s) {
                    own = s.emission;
                    let number = [self.gathered.len() as u32, places[place as usize].number];
                    self.asked.ask(ctx, number, &lambert, -ray.direction);
                }
                self.points.push(&point_of(ctx, &s), &s.ray_start());
                self.gathered.push((place, share, own));
            }
        }
        // A GPU may hold the shadow maps; so few rays do without.
        let towards = if full { Towards::Disc } else { Towards::Middle };
        let gathered = &mut self.gathered;
        self.asked.answer(ctx, towards, &mut self.counts, |i, radiance| gathered[i as usize].2 += radiance);
        self.points.pad();
        let maps = &ctx.near_lights.maps;
        if self.gathered.is_empty() || maps.size == 0 {
            self.points.darken();
        } else {
            let (size, texels, bound) = (maps.size, &maps.texels, ctx.geometry_term_max);
            accumulate_shadowed_vpls(ctx.level, &mut self.points, ctx.near_lights.vpls(), size, texels, bound);
        }
        for (i, (place, share, lit)) in self.gathered.iter().enumerate() {
            let radiance = *lit + self.points.albedo(i) * self.points.irradiance(i);
            for (channel, sum) in arriving[*place as usize].iter_mut().enumerate() {
                *sum += *share * radiance[channel];
            }
        }
    }
}

/// The surface as VPLs see it; `None` where it neither reflects nor counts as a light.
fn lambert(ctx: &FrameContext, s: &Surface) -> Option<Surface> {
    let look = catoptra_engine::Look { specular: Vec3::ZERO, ..s.look };
    (!ctx.scene.materials[s.material as usize].unlit).then_some(Surface { look, ..*s })
}

/// 0 where something close to the place stands before a VPL, else 1, for sixteen places.
/// * `n`: normals; `to`: towards the VPL; `normal_vpl`: its unit normal
#[inline(always)]
pub(crate) fn near_visibility(run: &NearRun, n: &[Lane; 3], to: &[Lane; 3], normal_vpl: Vec3) -> Lane {
    let mut cell = [0usize; LANES];
    for lane in 0..LANES {
        let along =
            |axis: &[Lane; 3]| axis[0][lane] * to[0][lane] + axis[1][lane] * to[1][lane] + axis[2][lane] * to[2][lane];
        cell[lane] = cell_of(along(&run.tangent), along(&run.bitangent), along(n));
    }
    let mut seen = [1.0f32; LANES];
    for lane in 0..LANES {
        let [x, y, z] = run.offsets[cell[lane]][lane];
        let d2 = to[0][lane] * to[0][lane] + to[1][lane] * to[1][lane] + to[2][lane] * to[2][lane];
        let before =
            normal_vpl.x * (x - to[0][lane]) + normal_vpl.y * (y - to[1][lane]) + normal_vpl.z * (z - to[2][lane]);
        let blocks = x * x + y * y + z * z < (NEAR * NEAR) * d2
            && before > 0.0
            && before * before > (BEFORE_PLANE * BEFORE_PLANE) * d2;
        if blocks {
            seen[lane] = 0.0;
        }
    }
    seen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_find_their_own_directions_and_weigh_as_cosines() {
        let all: Vec<(Vec3, f32)> = (0..CELLS).map(|cell| cell_direction(cell, SIDE)).collect();
        for (cell, (d, _)) in all.iter().enumerate() {
            assert!((d.length() - 1.0).abs() < 1e-6 && d.z > 0.0);
            assert_eq!(cell_of(d.x * 7.0, d.y * 7.0, d.z * 7.0), cell);
        }
        // Weights are ∫ cos dω over cells of equal area of the map: its share of the mean cosine.
        let sum: f32 = all.iter().map(|d| d.1).sum();
        let mean_cos = all.iter().map(|(d, w)| d.z * w).sum::<f32>() / sum;
        assert!((mean_cos - 2.0 / 3.0).abs() < 0.01, "{mean_cos}");
        assert!((sum * 2.0 / (SIDE * SIDE) as f32 - PI).abs() < 0.1, "{sum}");
        assert_eq!(cell_of(f32::NAN, 0.0, 1.0), 0);
    }
}
