//! Batches of shaded points in flat arrays, and the wide kernels that light them by all VPLs.

use glam::{Vec2, Vec3};

use super::{
    meet::SurfaceLanes,
    near::{NearRun, near_visibility},
    surface::RayStart,
    visibility::Askers,
};
use crate::{
    accel::Ray,
    simd::dispatch,
    twin::{
        vpl::{Vpl, geometry_term},
        vpl_maps::{
            inverse_plane_height, l1_length, map_center, octahedron_coordinates, octahedron_point, texel_center,
            texel_coordinate, texel_occlusion,
        },
    },
};
use std::f32::consts::FRAC_1_PI;

/// Points handled together; a multiple of every SIMD width. The result of a point does not depend on it.
pub const LANES: usize = 16;

/// One value of [`LANES`] points.
pub type Lane = [f32; LANES];

/// What the kernels need to know of a place that is lit.
#[derive(Clone, Copy, Debug, Default)]
pub struct PointSurface {
    /// The place, world space.
    pub position_world: Vec3,
    /// Unit shading normal on the viewer's side; zero: nothing lights it.
    pub normal: Vec3,
    /// factor x texture x vertex colour.
    pub base_color: Vec3,
    /// k_d · matte weight / π: turns base colour into what reflects irradiance.
    pub matte: f32,
    /// Radiance that no light causes: emitted and ambient.
    pub own: Vec3,
}

/// A point with a highlight.
#[derive(Clone, Copy, Debug)]
pub struct Glossy {
    /// Number of the point.
    pub point: u32,
    /// k_s and exponent of the lobe.
    pub specular: Vec3,
    /// See `specular`.
    pub shininess: f32,
    /// Unit direction towards the viewer.
    pub wo: Vec3,
}

/// Points with normals, what they reflect, and the light that they receive. Arrays are padded to a multiple of the lane
/// count.
#[derive(Clone, Debug, Default)]
pub struct PointBatch {
    len: usize,
    /// Positions, world space: x, y, z planes.
    pub(crate) position: [Vec<f32>; 3],
    /// Unit normals: x, y, z planes.
    pub(crate) normal: [Vec<f32>; 3],
    /// Base colours: r, g, b planes.
    pub(crate) base_color: [Vec<f32>; 3],
    /// See [`PointSurface::matte`].
    pub(crate) matte: Vec<f32>,
    /// Irradiance by VPLs: r, g, b planes.
    pub(crate) irradiance: [Vec<f32>; 3],
    /// Direct and own radiance: r, g, b planes.
    pub(crate) radiance: [Vec<f32>; 3],
    /// Radiance that one light would cause unshadowed.
    pub(crate) unshadowed: [Vec<f32>; 3],
    /// Normals of the triangles: x, y, z planes; empty unless ray starts are kept.
    pub(crate) n_geometric: [Vec<f32>; 3],
    /// Bounds on the errors of the places, metres; empty unless ray starts are kept.
    pub(crate) error: Vec<f32>,
    ray_starts: bool,
    /// Points whose material has a highlight.
    pub glossy: Vec<Glossy>,
    /// Memory for shadow rays.
    pub(crate) shadows: ShadowRays,
    /// Memory for what asks how much of a light it sees.
    pub(crate) askers: Askers,
}

/// Shadow rays of a batch towards one light.
#[derive(Clone, Debug, Default)]
pub(crate) struct ShadowRays {
    pub rays: Vec<Ray>,
    /// The point of each.
    pub of: Vec<u32>,
    pub occluded: Vec<bool>,
}

impl ShadowRays {
    pub fn clear(&mut self) {
        self.rays.clear();
        self.of.clear();
        self.occluded.clear();
    }
}

impl PointBatch {
    fn planes(&mut self) -> impl Iterator<Item = &mut Vec<f32>> {
        let groups =
            [&mut self.position, &mut self.normal, &mut self.base_color, &mut self.irradiance, &mut self.radiance];
        groups.into_iter().flatten().chain(&mut self.unshadowed).chain([&mut self.matte])
    }

    fn start_planes(&mut self) -> impl Iterator<Item = &mut Vec<f32>> {
        self.n_geometric.iter_mut().chain([&mut self.error])
    }

    /// Planes of `len` points; those of ray starts only where they are kept.
    fn resize(&mut self, len: usize) {
        self.planes().for_each(|p| p.resize(len, 0.0));
        let starts = if self.ray_starts { len } else { 0 };
        self.start_planes().for_each(|p| p.resize(starts, 0.0));
    }

    /// Says of an empty batch whether its points are places that rays start from.
    pub fn keep_ray_starts(&mut self, keep: bool) {
        self.ray_starts = keep;
    }

    /// True where the points are places that rays start from.
    pub fn has_ray_starts(&self) -> bool {
        self.ray_starts
    }

    /// Where rays from point `i` start; nowhere unless the batch keeps that.
    pub fn ray_start(&self, i: usize) -> RayStart {
        if !self.ray_starts {
            return RayStart::default();
        }
        RayStart {
            position_world: self.position_world(i),
            n_geometric: of_planes(&self.n_geometric, i),
            error: self.error[i],
        }
    }

    /// Forgets all points, keeps the memory.
    pub fn clear(&mut self) {
        self.len = 0;
        self.planes().for_each(Vec::clear);
        self.start_planes().for_each(Vec::clear);
        self.glossy.clear();
    }

    /// Makes room for `len` points (a multiple of the lane count), each of which must then be written.
    pub fn reset(&mut self, len: usize) {
        debug_assert_eq!(len % LANES, 0);
        self.len = len;
        self.resize(len);
        self.glossy.clear();
    }

    /// Points that fit without another allocation, and highlights.
    pub fn capacity(&self) -> [usize; 2] {
        [self.matte.capacity(), self.glossy.capacity()]
    }

    /// Makes room for as many.
    pub fn reserve(&mut self, [points, glossy]: [usize; 2]) {
        self.planes().for_each(|p| make_room(p, points));
        if self.ray_starts {
            self.start_planes().for_each(|p| make_room(p, points));
        }
        make_room(&mut self.glossy, glossy);
    }

    /// Makes all irradiance zero.
    pub fn darken(&mut self) {
        self.irradiance.iter_mut().for_each(|p| p.fill(0.0));
    }

    /// Adds a point; where rays from it start counts only in a batch that keeps that.
    pub fn push(&mut self, s: &PointSurface, start: &RayStart) {
        for axis in 0..3 {
            self.position[axis].push(s.position_world[axis]);
            self.normal[axis].push(s.normal[axis]);
            self.base_color[axis].push(s.base_color[axis]);
            self.radiance[axis].push(s.own[axis]);
        }
        self.matte.push(s.matte);
        if self.ray_starts {
            for axis in 0..3 {
                self.n_geometric[axis].push(start.n_geometric[axis]);
            }
            self.error.push(start.error);
        }
        self.len += 1;
    }

    /// Adds point `i` of another batch, without radiance of its own, to be lit anew.
    pub fn push_from(&mut self, from: &PointBatch, i: usize) {
        let surface = PointSurface {
            position_world: from.position_world(i),
            normal: from.normal(i),
            base_color: from.base_color(i),
            matte: from.matte[i],
            own: Vec3::ZERO,
        };
        self.push(&surface, &from.ray_start(i));
    }

    /// Adds the places of `mask`'s lanes, in their order.
    pub(crate) fn push_lanes(&mut self, from: &SurfaceLanes, mask: u16) {
        let first = self.len;
        self.len += mask.count_ones() as usize;
        let padded = self.len.next_multiple_of(LANES);
        if padded > self.matte.len() {
            self.resize(padded);
        }
        let copy = |to: &mut [f32], from: &Lane| {
            let (mut i, mut lanes) = (first, mask);
            while lanes != 0 {
                to[i] = from[lanes.trailing_zeros() as usize];
                lanes &= lanes - 1;
                i += 1;
            }
        };
        for axis in 0..3 {
            copy(&mut self.position[axis], &from.position[axis]);
            copy(&mut self.normal[axis], &from.n_shading[axis]);
            copy(&mut self.base_color[axis], &from.base_color[axis]);
            copy(&mut self.radiance[axis], &from.own[axis]);
        }
        copy(&mut self.matte, &from.matte);
        if self.ray_starts {
            for axis in 0..3 {
                copy(&mut self.n_geometric[axis], &from.n_geometric[axis]);
            }
            copy(&mut self.error, &from.error);
        }
    }

    /// Writes point `i`.
    pub fn set(&mut self, i: usize, s: &PointSurface, start: &RayStart) {
        for axis in 0..3 {
            self.position[axis][i] = s.position_world[axis];
            self.normal[axis][i] = s.normal[axis];
            self.base_color[axis][i] = s.base_color[axis];
            self.radiance[axis][i] = s.own[axis];
        }
        self.matte[i] = s.matte;
        if self.ray_starts {
            for axis in 0..3 {
                self.n_geometric[axis][i] = start.n_geometric[axis];
            }
            self.error[i] = start.error;
        }
    }

    /// Points in the batch.
    pub fn len(&self) -> usize {
        self.len
    }

    /// True where no point was added.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The place of point `i`, world space.
    pub fn position_world(&self, i: usize) -> Vec3 {
        of_planes(&self.position, i)
    }

    /// Shading normal of point `i`.
    pub fn normal(&self, i: usize) -> Vec3 {
        of_planes(&self.normal, i)
    }

    /// Base colour of point `i`.
    pub fn base_color(&self, i: usize) -> Vec3 {
        of_planes(&self.base_color, i)
    }

    /// What turns the irradiance of point `i` into radiance; zero where it has no matte share.
    pub fn albedo(&self, i: usize) -> Vec3 {
        self.base_color(i) * self.matte[i]
    }

    /// Irradiance of point `i` by VPLs, W/m².
    pub fn irradiance(&self, i: usize) -> Vec3 {
        of_planes(&self.irradiance, i)
    }

    /// Sets the irradiance of point `i`.
    pub fn set_irradiance(&mut self, i: usize, irradiance: Vec3) {
        for axis in 0..3 {
            self.irradiance[axis][i] = irradiance[axis];
        }
    }

    /// Direct and own radiance of point `i`.
    pub fn radiance(&self, i: usize) -> Vec3 {
        of_planes(&self.radiance, i)
    }

    /// Adds to the irradiance of point `i`.
    pub fn add(&mut self, i: usize, irradiance: Vec3) {
        for axis in 0..3 {
            self.irradiance[axis][i] += irradiance[axis];
        }
    }

    /// Pads with points whose normal is zero: nothing lights them. Call once after the last `push`.
    pub fn pad(&mut self) {
        self.resize(self.len.next_multiple_of(LANES));
    }
}

/// Lets a list grow to `capacity` without another allocation.
pub(crate) fn make_room<T>(list: &mut Vec<T>, capacity: usize) {
    if list.capacity() < capacity {
        list.reserve_exact(capacity - list.len());
    }
}

fn of_planes(planes: &[Vec<f32>; 3], i: usize) -> Vec3 {
    Vec3::new(planes[0][i], planes[1][i], planes[2][i])
}

/// The lanes from `at` on of a padded plane.
#[inline(always)]
pub(crate) fn lane(plane: &[f32], at: usize) -> Lane {
    plane[at..at + LANES].try_into().expect("padded")
}

/// The lanes from `at` on of three padded planes.
#[inline(always)]
pub(crate) fn lanes(planes: &[Vec<f32>; 3], at: usize) -> [Lane; 3] {
    [lane(&planes[0], at), lane(&planes[1], at), lane(&planes[2], at)]
}

/// Writes lanes from `at` on.
#[inline(always)]
pub(crate) fn store(planes: &mut [Vec<f32>; 3], at: usize, values: &[Lane; 3]) {
    for (plane, v) in planes.iter_mut().zip(values) {
        plane[at..at + LANES].copy_from_slice(v);
    }
}

/// False where nothing of the lanes from `at` on can show irradiance.
#[inline(always)]
fn any_matte(points: &PointBatch, at: usize) -> bool {
    lane(&points.matte, at).iter().fold(0, |bits, m| bits | m.to_bits()) != 0
}

/// A VPL as the kernels read it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Emitter {
    position_world: Vec3,
    normal_world: Vec3,
    /// Flux / π.
    intensity: Vec3,
}

impl From<&Vpl> for Emitter {
    fn from(v: &Vpl) -> Self {
        Self { position_world: v.position_world, normal_world: v.normal_world, intensity: v.flux * FRAC_1_PI }
    }
}

#[inline(always)]
fn accumulate_body(points: &mut PointBatch, vpls: &[Emitter], geometry_term_max: f32) {
    for at in (0..points.len).step_by(LANES) {
        if !any_matte(points, at) {
            store(&mut points.irradiance, at, &[[0.0; LANES]; 3]);
            continue;
        }
        let (p, n) = (lanes(&points.position, at), lanes(&points.normal, at));
        let mut sum = [[0.0f32; LANES]; 3];
        for vpl in vpls {
            let y = vpl.position_world;
            let flux = vpl.intensity;
            for lane in 0..LANES {
                let to_vpl = Vec3::new(y.x - p[0][lane], y.y - p[1][lane], y.z - p[2][lane]);
                let normal = Vec3::new(n[0][lane], n[1][lane], n[2][lane]);
                let g = geometry_term(to_vpl, normal, vpl.normal_world, geometry_term_max);
                sum[0][lane] += flux.x * g;
                sum[1][lane] += flux.y * g;
                sum[2][lane] += flux.z * g;
            }
        }
        store(&mut points.irradiance, at, &sum);
    }
}

dispatch! {
    /// Sets each point's irradiance to the sum over all VPLs, without visibility, in the order of the VPLs.
    ///
    /// Twin: `shaders/indirect.wgsl`.
    pub fn accumulate_vpls => accumulate_body(points: &mut PointBatch, vpls: &[Emitter], geometry_term_max: f32)
}

/// [`crate::twin::vpl_maps::vpl_visibility`] of sixteen points, in phases: map coordinates, loads, comparison. The sizes are
/// constants so that no load needs a bounds check.
#[inline(always)]
fn seen_through_map<const SIZE: usize, const AREA: usize>(
    map: &[f32; AREA],
    center: Vec3,
    p: &[Lane; 3],
    n: &[Lane; 3],
) -> Lane {
    let size = SIZE as u32;
    let (mut own, mut l1, mut inverse_height) = ([0.0f32; LANES], [0.0f32; LANES], [0.0f32; LANES]);
    let (mut x0, mut y0) = ([0i32; LANES], [0i32; LANES]);
    let (mut fx, mut fy) = ([0.0f32; LANES], [0.0f32; LANES]);
    for lane in 0..LANES {
        let v = Vec3::new(p[0][lane] - center.x, p[1][lane] - center.y, p[2][lane] - center.z);
        l1[lane] = l1_length(v);
        own[lane] = 1.0 / l1[lane];
        inverse_height[lane] = inverse_plane_height(Vec3::new(n[0][lane], n[1][lane], n[2][lane]), v);
        let e = octahedron_coordinates(v, own[lane]);
        let (x, y) = (texel_coordinate(e.x, size), texel_coordinate(e.y, size));
        (x0[lane], y0[lane]) = (x as i32, y as i32);
        (fx[lane], fy[lane]) = (x - x0[lane] as f32, y - y0[lane] as f32);
    }
    let mut stored = [[0.0f32; LANES]; 4];
    for lane in 0..LANES {
        // Coordinates end below the last texel: nothing wraps.
        let first = (y0[lane] as usize).wrapping_mul(SIZE).wrapping_add(x0[lane] as usize);
        stored[0][lane] = map[first & (AREA - 1)];
        stored[1][lane] = map[first.wrapping_add(1) & (AREA - 1)];
        stored[2][lane] = map[first.wrapping_add(SIZE) & (AREA - 1)];
        stored[3][lane] = map[first.wrapping_add(SIZE + 1) & (AREA - 1)];
    }
    let mut seen = [0.0f32; LANES];
    for lane in 0..LANES {
        let (left, upper) = (x0[lane] as f32, y0[lane] as f32);
        let tap = |x: f32, y: f32, stored: f32| {
            let q = octahedron_point(Vec2::new(texel_center(x, size), texel_center(y, size)));
            let expected = (n[0][lane] * q.x + n[1][lane] * q.y + n[2][lane] * q.z) * inverse_height[lane];
            texel_occlusion(stored, expected, own[lane], l1[lane])
        };
        let (t00, t10) = (tap(left, upper, stored[0][lane]), tap(left + 1.0, upper, stored[1][lane]));
        let (t01, t11) = (tap(left, upper + 1.0, stored[2][lane]), tap(left + 1.0, upper + 1.0, stored[3][lane]));
        let a = t00 + (t10 - t00) * fx[lane];
        let b = t01 + (t11 - t01) * fx[lane];
        seen[lane] = 1.0 - (a + (b - a) * fy[lane]);
    }
    seen
}

/// As [`accumulate_body`] with each VPL's light weighed by its visibility.
#[inline(always)]
fn accumulate_shadowed_body<const SIZE: usize, const AREA: usize>(
    points: &mut PointBatch,
    vpls: &[Vpl],
    maps: &[f32],
    geometry_term_max: f32,
) {
    let (maps, rest) = maps.as_chunks::<AREA>();
    assert!(maps.len() == vpls.len() && rest.is_empty() && SIZE * SIZE == AREA && AREA.is_power_of_two());
    for at in (0..points.len).step_by(LANES) {
        if !any_matte(points, at) {
            store(&mut points.irradiance, at, &[[0.0; LANES]; 3]);
            continue;
        }
        let (p, n) = (lanes(&points.position, at), lanes(&points.normal, at));
        let mut sum = [[0.0f32; LANES]; 3];
        for (vpl, map) in vpls.iter().zip(maps) {
            let y = vpl.position_world;
            let mut g = [0.0f32; LANES];
            let mut lit = 0u32;
            for lane in 0..LANES {
                let to_vpl = Vec3::new(y.x - p[0][lane], y.y - p[1][lane], y.z - p[2][lane]);
                let normal = Vec3::new(n[0][lane], n[1][lane], n[2][lane]);
                g[lane] = geometry_term(to_vpl, normal, vpl.normal_world, geometry_term_max);
                lit |= g[lane].to_bits();
            }
            // None of these points is before the VPL.
            if lit == 0 {
                continue;
            }
            let seen = seen_through_map::<SIZE, AREA>(map, map_center(vpl), &p, &n);
            let flux = vpl.flux * FRAC_1_PI;
            for lane in 0..LANES {
                let visible = g[lane] * seen[lane];
                sum[0][lane] += flux.x * visible;
                sum[1][lane] += flux.y * visible;
                sum[2][lane] += flux.z * visible;
            }
        }
        store(&mut points.irradiance, at, &sum);
    }
}

#[inline(always)]
fn shadowed_body(points: &mut PointBatch, vpls: &[Vpl], size: u32, maps: &[f32], geometry_term_max: f32) {
    match size {
        16 => accumulate_shadowed_body::<16, 256>(points, vpls, maps, geometry_term_max),
        32 => accumulate_shadowed_body::<32, 1024>(points, vpls, maps, geometry_term_max),
        64 => accumulate_shadowed_body::<64, 4096>(points, vpls, maps, geometry_term_max),
        other => unreachable!("settings allow no VPL maps of {other} texels"),
    }
}

dispatch! {
    /// Sets each point's irradiance to the sum over all VPLs, each seen through its map, in the order of the VPLs.
    /// * `size`: texels a side of a map; `maps`: those of `vpls`, in their order
    ///
    /// Twin: `shaders/indirect.wgsl`.
    pub fn accumulate_shadowed_vpls => shadowed_body(
        points: &mut PointBatch,
        vpls: &[Vpl],
        size: u32,
        maps: &[f32],
        geometry_term_max: f32,
    )
}

/// Sixteen points' sums as vectors: what each VPL would give a surface that faces it, times the direction to it.
#[inline(always)]
fn directional_run<const SIZE: usize, const AREA: usize>(
    p: &[Lane; 3],
    n: &[Lane; 3],
    vpls: &[Vpl],
    maps: &[[f32; AREA]],
    geometry_term_max: f32,
    near: Option<&NearRun>,
) -> [Lane; 9] {
    let mut sum = [[0.0f32; LANES]; 9];
    for (i, vpl) in vpls.iter().enumerate() {
        let y = vpl.position_world;
        let mut weight = [0.0f32; LANES];
        let mut lit = 0u32;
        for lane in 0..LANES {
            let to_vpl = Vec3::new(y.x - p[0][lane], y.y - p[1][lane], y.z - p[2][lane]);
            let normal = Vec3::new(n[0][lane], n[1][lane], n[2][lane]);
            let g = geometry_term(to_vpl, normal, vpl.normal_world, geometry_term_max);
            let cos = normal.x * to_vpl.x + normal.y * to_vpl.y + normal.z * to_vpl.z;
            // Where the geometry term is not zero, neither is the cosine.
            weight[lane] = g / if cos > 1e-30 { cos } else { 1e-30 };
            lit |= g.to_bits();
        }
        if lit == 0 {
            continue;
        }
        if SIZE > 0 {
            let seen = seen_through_map::<SIZE, AREA>(&maps[i], map_center(vpl), p, n);
            for lane in 0..LANES {
                weight[lane] *= seen[lane];
            }
        }
        if let Some(near) = near {
            let to: [Lane; 3] = [0, 1, 2].map(|axis| p[axis].map(|x| y[axis] - x));
            let seen = near_visibility(near, n, &to, vpl.normal_world);
            for lane in 0..LANES {
                weight[lane] *= seen[lane];
            }
        }
        let flux = vpl.flux * FRAC_1_PI;
        for lane in 0..LANES {
            let (x, y, z) = (y.x - p[0][lane], y.y - p[1][lane], y.z - p[2][lane]);
            let (x, y, z) = (x * weight[lane], y * weight[lane], z * weight[lane]);
            for c in 0..3 {
                sum[3 * c][lane] += flux[c] * x;
                sum[3 * c + 1][lane] += flux[c] * y;
                sum[3 * c + 2][lane] += flux[c] * z;
            }
        }
    }
    sum
}

#[inline(always)]
fn directional<const SIZE: usize, const AREA: usize>(
    points: &PointBatch,
    vpls: &[Vpl],
    maps: &[f32],
    geometry_term_max: f32,
    near: &[NearRun],
    out: &mut [[Lane; 9]],
) {
    let (maps, _) = maps.as_chunks::<AREA>();
    assert!(SIZE == 0 || maps.len() == vpls.len() && SIZE * SIZE == AREA && AREA.is_power_of_two());
    for (run, out) in out.iter_mut().enumerate() {
        let at = run * LANES;
        if any_matte(points, at) {
            let (p, n) = (lanes(&points.position, at), lanes(&points.normal, at));
            *out = directional_run::<SIZE, AREA>(&p, &n, vpls, maps, geometry_term_max, near.get(run));
        }
    }
}

#[inline(always)]
fn directional_body(
    points: &PointBatch,
    vpls: &[Vpl],
    size: u32,
    maps: &[f32],
    geometry_term_max: f32,
    near: &[NearRun],
    out: &mut [[Lane; 9]],
) {
    match size {
        0 => directional::<0, 1>(points, vpls, &[], geometry_term_max, near, out),
        16 => directional::<16, 256>(points, vpls, maps, geometry_term_max, near, out),
        32 => directional::<32, 1024>(points, vpls, maps, geometry_term_max, near, out),
        64 => directional::<64, 4096>(points, vpls, maps, geometry_term_max, near, out),
        other => unreachable!("settings allow no VPL maps of {other} texels"),
    }
}

dispatch! {
    /// The irradiance of each run of points by all VPLs as vectors (red x, y, z, green .., blue ..), W/m²: its dot product with
    /// the normal is what [`accumulate_vpls`] or [`accumulate_shadowed_vpls`] sums. Points without a matte share are left out.
    /// * `size`: texels a side of a map, 0: no maps; `near`: what stands close, one a run, or none; `out`: one a run of sixteen
    ///   points, zero at first
    pub(crate) fn accumulate_directional => directional_body(
        points: &PointBatch,
        vpls: &[Vpl],
        size: u32,
        maps: &[f32],
        geometry_term_max: f32,
        near: &[NearRun],
        out: &mut [[Lane; 9]],
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        settings::SimdLevel,
        simd,
        twin::{
            vpl::vpl_irradiance,
            vpl_maps::{VplMaps, vpl_visibility},
        },
    };

    #[test]
    fn every_level_gives_the_bits_of_the_plain_sum() {
        let vpls: Vec<Vpl> = (0..37)
            .map(|i| {
                let a = i as f32;
                Vpl {
                    position_world: Vec3::new(a.rem_euclid(5.0) - 2.0, 1.5, a.rem_euclid(7.0) - 3.0),
                    normal_world: Vec3::new(0.1 * a - 1.8, -1.0, 0.2).normalize(),
                    flux: Vec3::new(1.0, 0.5 + a, 2.0),
                    error: 0.0,
                }
            })
            .collect();
        let points: Vec<(Vec3, Vec3)> = (0..101)
            .map(|i| {
                let b = i as f32 * 0.07;
                (Vec3::new(b - 3.0, -1.0 + 0.1 * b, 0.5 * b), Vec3::new(b - 3.0, 1.0, 0.3).normalize())
            })
            .collect();
        for choice in [SimdLevel::Portable, SimdLevel::Avx2, SimdLevel::Avx512] {
            let Ok(level) = simd::resolve(choice) else { continue };
            let mut batch = PointBatch::default();
            for (p, n) in &points {
                let at = PointSurface { position_world: *p, normal: *n, matte: 1.0, ..PointSurface::default() };
                batch.push(&at, &RayStart::default());
            }
            batch.pad();
            let emitters: Vec<Emitter> = vpls.iter().map(Emitter::from).collect();
            accumulate_vpls(level, &mut batch, &emitters, 3.0);
            for (i, (p, n)) in points.iter().enumerate() {
                let sum = vpls.iter().map(|v| vpl_irradiance(v, *p, *n, 3.0)).fold(Vec3::ZERO, |a, b| a + b);
                assert_eq!(batch.irradiance(i), sum, "point {i} at {choice:?}");
            }
            for size in [16u32, 32, 64] {
                // Any numbers will do for depths.
                let texels =
                    (0..vpls.len() as u32 * size * size).map(|i| (i % 23) as f32 * 0.04 * (i % 7) as f32).collect();
                let maps = VplMaps::of_texels(size, texels);
                accumulate_shadowed_vpls(level, &mut batch, &vpls, maps.size, &maps.texels, 3.0);
                let mut arriving = vec![[[0.0; LANES]; 9]; points.len().div_ceil(LANES)];
                accumulate_directional(level, &batch, &vpls, maps.size, &maps.texels, 3.0, &[], &mut arriving);
                for (i, (_, n)) in points.iter().enumerate() {
                    let of = |k: usize| arriving[i / LANES][k][i % LANES];
                    let toward = [0, 3, 6].map(|k| n.dot(Vec3::new(of(k), of(k + 1), of(k + 2))));
                    let (a, b) = (Vec3::from(toward), batch.irradiance(i));
                    // Relative; two orders of the same products.
                    assert!((a - b).abs().max_element() <= 1e-4 * (b.max_element() + 1.0), "point {i}: {a} for {b}");
                }
                let mut shadowed = 0;
                for (i, (p, n)) in points.iter().enumerate() {
                    let mut sum = Vec3::ZERO;
                    for (v, vpl) in vpls.iter().enumerate() {
                        let g = geometry_term(vpl.position_world - *p, *n, vpl.normal_world, 3.0);
                        if g != 0.0 {
                            let visible = vpl_visibility(maps.map(v), size, *p - map_center(vpl), *n);
                            shadowed += u32::from(visible > 0.0 && visible < 1.0);
                            sum += vpl.flux * FRAC_1_PI * (g * visible);
                        }
                    }
                    assert_eq!(batch.irradiance(i), sum, "point {i} at {choice:?} with maps of {size}");
                }
                assert!(shadowed > 20, "the table must reach partial shadow");
            }
        }
    }
}
