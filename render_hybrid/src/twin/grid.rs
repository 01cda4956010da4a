//! Indirect light on a coarse grid of the picture, carried from there to the pixels along surfaces.
//!
//! All VPLs are evaluated at what every `spacing`-th pixel of every `spacing`-th row shows; places beyond the picture are at its
//! last pixel. A grid point keeps, per channel, the vector sum of what arrives, so that a pixel's own normal can be put in: n·V
//! is the exact irradiance wherever the same VPLs lie above both horizons. A pixel takes the mean of the four points around it,
//! weighed by nearness and by how far it lies on their surface; where none does, of the sixteen around it; where none of those
//! does, it is lit as hits in mirrors are, by a smaller set where there is one. So far-off edges are never blurred across, and
//! the cost is that of 1/`spacing`² of the pixels.
//!
//! Twins: `shaders/light_grid.wgsl`, `shaders/shared/light_grid.wgsl` (tests/twins_light.rs).
//!
//! Sources: Ward & Heckbert, "Irradiance Gradients", EGWR 1992 (indirect light is smooth along surfaces); Segovia et al.,
//! "Non-interleaved Deferred Shading of Interleaved Sample Patterns", Graphics Hardware 2006 (the geometry-aware filter).

use glam::Vec3;
use rayon::prelude::*;
use std::sync::Mutex;

use super::gbuffer::point_of;
use crate::{
    accel::{Hit, Ray},
    output::RayCounts,
    settings::{NearField, RenderSettings, SimdLevel, VplOptions, VplShadows},
    simd::dispatch,
    trace::{
        camera_rays::camera_ray,
        near::{NearPlace, NearScratch},
        points::{LANES, Lane, PointBatch, PointSurface, accumulate_directional, lane, lanes, make_room, store},
        shade::FrameContext,
        surface::{PixelCone, RayStart, surface_seen},
    },
};

/// Cosine between two normals from which on their light is alike, and what is added until it counts fully.
pub(crate) const LEAST_COSINE: f32 = 0.7;
/// See [`LEAST_COSINE`].
pub(crate) const COSINE_SPAN: f32 = 0.2;
/// Squared share of a neighbour's distance that it may lie off the plane and count fully, and what is added until it counts
/// nothing.
pub(crate) const OFF_PLANE: f32 = 0.02;
/// See [`OFF_PLANE`].
pub(crate) const OFF_PLANE_SPAN: f32 = 0.07;
/// Weights of the neighbours that add up to less are no surface's.
pub(crate) const LEAST_WEIGHT: f32 = 0.02;
/// Square of the share of its coordinates by which a place is uncertain: two lanes, or a ray and a pixel, that see the same
/// place may be so far apart, and the direction between them is none.
pub(crate) const ROUNDING: f32 = 1e-10;

/// A place of the grid.
#[derive(Clone, Copy, Debug, Default)]
pub struct GridPoint {
    /// The place, world space.
    pub position_world: Vec3,
    /// Unit shading normal; zero: nothing matte is seen here.
    pub normal: Vec3,
    /// Per channel the sum of flux/π · G/cos · direction, W/m².
    pub arriving: [Vec3; 3],
}

/// Rows that are filled together: sixteen points are evaluated at once, and a row of 65 alone would waste a fifth of them.
const ROWS: usize = 4;

/// Memory of a thread.
#[derive(Clone, Debug, Default)]
struct RowsScratch {
    rays: Vec<Ray>,
    hits: Vec<Hit>,
    points: PointBatch,
    arriving: Vec<[Lane; 9]>,
    places: Vec<NearPlace>,
    near: NearScratch,
}

/// What the grid's points are to hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    /// Light of the VPLs, and what their bound cuts off where that is wanted.
    All,
    /// What their bound cuts off.
    Close,
}

/// The grid of a frame.
#[derive(Debug, Default)]
pub struct IrradianceGrid {
    /// Pixels from point to point; 0: no grid.
    spacing: u32,
    columns: usize,
    points: Vec<GridPoint>,
    /// What few rays found close to each point: per channel a vector sum as in [`GridPoint::arriving`].
    close: Vec<[Vec3; 3]>,
    means: Vec<[Vec3; 3]>,
    scratch: Vec<Mutex<RowsScratch>>,
}

impl IrradianceGrid {
    /// Evaluates all VPLs at the grid's points; no grid where the settings want none. Returns the numbers of rays.
    pub fn build(&mut self, ctx: &FrameContext) -> RayCounts {
        self.build_part(ctx, Part::All)
    }

    /// [`Self::build`] with nothing but the light that the VPLs' bound cuts off, for a GPU that adds the VPLs'.
    pub fn build_close(&mut self, ctx: &FrameContext) -> RayCounts {
        self.build_part(ctx, Part::Close)
    }

    fn build_part(&mut self, ctx: &FrameContext, part: Part) -> RayCounts {
        let spacing = spacing_of(ctx.settings);
        self.spacing = 0;
        if spacing <= 1 || ctx.vpls.is_empty() {
            return RayCounts::default();
        }
        let [columns, rows] = grid_size([ctx.settings.width, ctx.settings.height], spacing).map(|n| n as usize);
        self.columns = columns;
        self.points.resize(self.columns * rows, GridPoint::default());
        self.close.resize(self.columns * rows, [Vec3::ZERO; 3]);
        self.scratch.resize_with(rayon::current_num_threads(), Mutex::default);
        let (scratch, columns) = (&self.scratch, self.columns);
        // Which thread gets which row is chance, memory for it must not be.
        for s in scratch {
            let mut s = s.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            let places = columns * ROWS;
            make_room(&mut s.rays, places);
            make_room(&mut s.hits, places);
            make_room(&mut s.arriving, places.div_ceil(LANES));
            s.points.reserve([places.next_multiple_of(LANES), 0]);
            make_room(&mut s.places, places);
            s.near.reserve(near_field_of(ctx.settings), places, ctx.scene.lights.len());
        }
        let rows_of = self.points.par_chunks_mut(columns * ROWS).zip(self.close.par_chunks_mut(columns * ROWS));
        let counts = rows_of.enumerate().with_max_len(1).map(|(i, (points, close))| {
            let own = rayon::current_thread_index().unwrap_or(0) % scratch.len();
            let mut s = scratch[own].lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            fill_rows(ctx, part, spacing, [columns, i * ROWS], points, close, &mut s);
            s.near.counts
        });
        let counts = counts.reduce(RayCounts::default, RayCounts::merged);
        if near_field_of(ctx.settings) == NearField::Light {
            self.add_close();
        }
        self.spacing = spacing;
        RayCounts { camera: counts.camera + (self.columns * rows) as u64, ..counts }
    }

    /// Adds what few rays found, as a mean over each point and the eight around it, as far as they are on its surface: the four
    /// ways that rays of neighbours go weigh the same in it.
    fn add_close(&mut self) {
        let (columns, rows) = (self.columns, self.points.len() / self.columns);
        let (points, close) = (&self.points, &self.close);
        let mean = |at: usize| {
            let (x, y, own) = (at % columns, at / columns, &points[at]);
            let (mut sum, mut weight) = ([Vec3::ZERO; 3], 0.0f32);
            for row in y.saturating_sub(1)..(y + 2).min(rows) {
                for column in x.saturating_sub(1)..(x + 2).min(columns) {
                    let i = row * columns + column;
                    let near = if row == y { 2.0 } else { 1.0 } * if column == x { 2.0 } else { 1.0 };
                    // The point itself counts, whatever rounding says of it.
                    let alike = if i == at { 1.0 } else { likeness(&points[i], own.position_world, own.normal) };
                    let w = near * alike;
                    for (sum, light) in sum.iter_mut().zip(close[i]) {
                        *sum += light * w;
                    }
                    weight += w;
                }
            }
            sum.map(|s| s / weight)
        };
        let means = &mut self.means;
        means.resize(points.len(), [Vec3::ZERO; 3]);
        means.par_chunks_mut(columns).enumerate().for_each(|(y, means)| {
            for (x, out) in means.iter_mut().enumerate().filter(|(x, _)| points[y * columns + x].normal != Vec3::ZERO) {
                *out = mean(y * columns + x);
            }
        });
        for (point, mean) in self.points.iter_mut().zip(&self.means) {
            if point.normal != Vec3::ZERO {
                for (arriving, light) in point.arriving.iter_mut().zip(mean) {
                    *arriving += *light;
                }
            }
        }
    }

    /// Forgets the grid, keeps the memory.
    pub fn clear(&mut self) {
        self.spacing = 0;
    }

    /// The grid's points, row by row.
    pub fn points(&self) -> &[GridPoint] {
        &self.points
    }

    /// False where nothing was evaluated: pixels are lit one by one.
    pub fn is_built(&self) -> bool {
        self.spacing > 1
    }

    /// Sets the irradiance of a tile's pixels, and collects those that no point of the grid can tell about.
    /// * `first`: column (a multiple of sixteen) and row of the first pixel; `runs`: runs of sixteen pixels a row
    pub fn light(
        &self,
        level: SimdLevel,
        points: &mut PointBatch,
        first: [u32; 2],
        runs: usize,
        missing: &mut Vec<u32>,
    ) {
        missing.clear();
        make_room(missing, points.len());
        light_tile(level, self, points, first, runs, missing);
        missing.retain(|&i| {
            let row = i as usize / (runs * LANES);
            let column = i as usize % (runs * LANES);
            let pixel = [first[0] + column as u32, first[1] + row as u32];
            let found = self.wider(pixel, points.position_world(i as usize), points.normal(i as usize));
            if let Some(irradiance) = found {
                points.set_irradiance(i as usize, irradiance);
            }
            found.is_none()
        });
    }

    /// Irradiance of pixel (x, y), which shows `position` with unit normal `n`, as [`Self::light`] has it up to rounding; `None`
    /// where no point of the grid can tell.
    pub fn at(&self, [x, y]: [u32; 2], position: Vec3, n: Vec3) -> Option<Vec3> {
        let s = self.spacing;
        let (fx, fy) = ((x % s) as f32 / s as f32, (y % s) as f32 / s as f32);
        let corner = (y / s) as usize * self.columns + (x / s) as usize;
        let (mut sum, mut weight) = (Vec3::ZERO, 0.0f32);
        for k in 0..4 {
            let g = &self.points[corner + k % 2 + k / 2 * self.columns];
            let w = near_of_four(fx, fy, k) * likeness(g, position, n);
            sum += Vec3::from(g.arriving.map(|v| w * positive(n.dot(v))));
            weight += w;
        }
        if weight > LEAST_WEIGHT { Some(sum / weight) } else { self.wider([x, y], position, n) }
    }

    /// Irradiance of a pixel from the sixteen points around it.
    fn wider(&self, [x, y]: [u32; 2], position: Vec3, n: Vec3) -> Option<Vec3> {
        let s = self.spacing;
        let rows = self.points.len() / self.columns;
        let span = |c: u32, len: usize| (c / s).saturating_sub(1) as usize..((c / s + 3) as usize).min(len);
        let (mut sum, mut weight) = (Vec3::ZERO, 0.0f32);
        for gy in span(y, rows) {
            for gx in span(x, self.columns) {
                let g = &self.points[gy * self.columns + gx];
                // Most are told off by this.
                if g.normal.dot(n) <= LEAST_COSINE - 1e-3 {
                    continue;
                }
                let (dx, dy) = (gx as f32 * s as f32 - x as f32, gy as f32 * s as f32 - y as f32);
                let w = near_of_sixteen(dx / s as f32, dy / s as f32) * likeness(g, position, n);
                sum += Vec3::from(g.arriving.map(|v| w * positive(n.x * v.x + n.y * v.y + n.z * v.z)));
                weight += w;
            }
        }
        (weight > LEAST_WEIGHT).then(|| sum / weight)
    }
}

#[inline(always)]
fn positive(x: f32) -> f32 {
    if x > 0.0 { x } else { 0.0 }
}

#[inline(always)]
fn unit(x: f32) -> f32 {
    let x = positive(x);
    if x < 1.0 { x } else { 1.0 }
}

/// Weight of corner `k` (upper left, upper right, lower left, lower right) of a cell at (fx, fy) in it.
///
/// Twin: `shaders/shared/light_grid.wgsl`.
#[inline(always)]
pub fn near_of_four(fx: f32, fy: f32, k: usize) -> f32 {
    let x = if k % 2 == 0 { 1.0 - fx } else { fx };
    let y = if k < 2 { 1.0 - fy } else { fy };
    x * y
}

/// Weight of a point that lies (dx, dy) cells away, where sixteen are asked.
///
/// Twin: `shaders/shared/light_grid.wgsl`.
#[inline(always)]
pub fn near_of_sixteen(dx: f32, dy: f32) -> f32 {
    1.0 / (dx * dx + dy * dy + 0.25)
}

/// How far a place lies on the surface of a grid point, in [0, 1].
///
/// Twin: `shaders/shared/light_grid.wgsl`.
#[inline(always)]
pub fn likeness(g: &GridPoint, position: Vec3, n: Vec3) -> f32 {
    let m = g.normal;
    let cos = n.x * m.x + n.y * m.y + n.z * m.z;
    let (x, y, z) = (position.x - g.position_world.x, position.y - g.position_world.y, position.z - g.position_world.z);
    let off = m.x * x + m.y * y + m.z * z;
    let off_own = n.x * x + n.y * y + n.z * z;
    let off2 = off * off;
    let own2 = off_own * off_own;
    let off2 = if off2 < own2 { off2 } else { own2 };
    let d2 = (x * x + y * y) + z * z;
    let q = g.position_world;
    let share = off2 / (d2 + (1e-12 + ROUNDING * (q.x * q.x + q.y * q.y + q.z * q.z)));
    let plane = unit(1.0 - (share - OFF_PLANE) * (1.0 / OFF_PLANE_SPAN));
    unit((cos - LEAST_COSINE) * (1.0 / COSINE_SPAN)) * plane
}

/// Places along the shorter side of a picture: where fewer would be left, they move closer together.
const LEAST_PLACES: u32 = 64;

/// Pixels from one place to the next: a power of two; 1: there is no grid, as where visibility is traced or VPLs are
/// interleaved.
pub fn spacing_of(settings: &RenderSettings) -> u32 {
    let has_grid = |v: &VplOptions| v.shadows != VplShadows::Traced && v.interleave == 1;
    let wanted = settings.vpl.filter(has_grid).map_or(1, |v| v.spacing);
    let most = (settings.width.min(settings.height) / LEAST_PLACES).max(1);
    wanted.min(1 << most.ilog2())
}

/// What rays from the grid's places bring: what the settings want, where there is a grid.
pub fn near_field_of(settings: &RenderSettings) -> NearField {
    settings.vpl.filter(|_| spacing_of(settings) > 1).map_or(NearField::Off, |v| v.near_field)
}

/// Columns and rows of the grid of a picture: one more than its runs of sixteen pixels cover, so that every pixel lies between
/// four.
pub fn grid_size([width, height]: [u32; 2], spacing: u32) -> [u32; 2] {
    [width.next_multiple_of(LANES as u32) / spacing + 1, height.div_ceil(spacing) + 1]
}

/// * `first`: columns of the grid, and the first of the rows
fn fill_rows(
    ctx: &FrameContext,
    part: Part,
    spacing: u32,
    first: [usize; 2],
    points: &mut [GridPoint],
    close: &mut [[Vec3; 3]],
    s: &mut RowsScratch,
) {
    let (width, height) = (ctx.settings.width, ctx.settings.height);
    let camera = &ctx.scene.camera;
    let [columns, first_row] = first;
    let y = |i: usize| ((first_row + i / columns) as u32 * spacing).min(height - 1) as f32;
    let x = |i: usize| ((i % columns) as u32 * spacing).min(width - 1) as f32;
    s.rays.clear();
    s.rays.extend((0..points.len()).map(|i| camera_ray(camera, x(i), y(i), width, height)));
    s.hits.clear();
    s.hits.resize(s.rays.len(), Hit::MISS);
    ctx.accel.closest_hits(&s.rays, &mut s.hits);
    let cone = PixelCone::of(camera, height);
    s.points.clear();
    s.places.clear();
    for ((ray, hit), point) in s.rays.iter().zip(&s.hits).zip(points.iter_mut()) {
        let mut seen = PointSurface::default();
        let mut start = RayStart::default();
        if hit.is_hit() {
            let surface = surface_seen(ctx.scene, ctx.normals, ray, hit, cone.at(hit.t));
            (seen, start) = (point_of(ctx, &surface), surface.ray_start());
        }
        let normal = if seen.matte > 0.0 { seen.normal } else { Vec3::ZERO };
        *point = GridPoint { position_world: seen.position_world, normal, ..GridPoint::default() };
        s.points.push(&seen, &RayStart::default());
        let number = (first_row * columns + s.places.len()) as u32;
        let (column, row) = (number as usize % columns, number as usize / columns);
        let quarter = (column % 2 + row % 2 * 2) as u32;
        s.places.push(NearPlace { start, normal, number, quarter });
    }
    s.points.pad();
    s.arriving.clear();
    s.arriving.resize(points.len().div_ceil(LANES), [[0.0; LANES]; 9]);
    close.fill([Vec3::ZERO; 3]);
    s.near.counts = RayCounts::default();
    let near_field = near_field_of(ctx.settings);
    if near_field != NearField::Off {
        s.near.look(ctx, near_field, &s.places, close);
    }
    if part == Part::All {
        let near = if near_field == NearField::Full { s.near.runs.as_slice() } else { &[] };
        let (size, maps) = (ctx.vpl_maps.size, &ctx.vpl_maps.texels);
        let bound = ctx.geometry_term_max;
        accumulate_directional(ctx.level, &s.points, ctx.vpls, size, maps, bound, near, &mut s.arriving);
    }
    for (i, point) in points.iter_mut().enumerate() {
        let of = |k: usize| s.arriving[i / LANES][k][i % LANES];
        let far = [0, 3, 6].map(|k| Vec3::new(of(k), of(k + 1), of(k + 2)));
        point.arriving = far;
        if near_field == NearField::Full {
            point.arriving.iter_mut().zip(close[i]).for_each(|(arriving, light)| *arriving += light);
        }
    }
}

/// Pixels of a row between two columns of the grid.
/// * `corners`: upper left, upper right, lower left, lower right; `fy`: how far down from the upper two, in [0, 1)
#[inline(always)]
fn light_cell<const S: usize>(
    corners: [&GridPoint; 4],
    fy: f32,
    p: [&[f32; S]; 3],
    n: [&[f32; S]; 3],
    out: [&mut [f32; S]; 3],
    weights: &mut [f32; S],
) {
    let [red, green, blue] = out;
    // One corner after the other, so that the inner loop is wide.
    for (k, corner) in corners.into_iter().enumerate() {
        let corner = *corner;
        let [r, g, b] = corner.arriving;
        for i in 0..S {
            let near = near_of_four(i as f32 * (1.0 / S as f32), fy, k);
            let normal = Vec3::new(n[0][i], n[1][i], n[2][i]);
            let w = near * likeness(&corner, Vec3::new(p[0][i], p[1][i], p[2][i]), normal);
            let toward = |v: Vec3| w * positive(normal.x * v.x + normal.y * v.y + normal.z * v.z);
            red[i] += toward(r);
            green[i] += toward(g);
            blue[i] += toward(b);
            weights[i] += w;
        }
    }
    for i in 0..S {
        let weight = weights[i];
        let inverse = if weight > LEAST_WEIGHT { 1.0 / weight } else { 0.0 };
        red[i] *= inverse;
        green[i] *= inverse;
        blue[i] *= inverse;
    }
}

#[inline(always)]
fn light_body<const S: usize>(
    grid: &IrradianceGrid,
    points: &mut PointBatch,
    first: [u32; 2],
    runs: usize,
    missing: &mut Vec<u32>,
) {
    for at in (0..points.len()).step_by(LANES) {
        let mut sum = [[0.0f32; LANES]; 3];
        let matte = lane(&points.matte, at);
        if matte.iter().fold(0, |bits, m| bits | m.to_bits()) != 0 {
            let run = at / LANES;
            let x = first[0] as usize + run % runs * LANES;
            let y = first[1] as usize + run / runs;
            let fy = (y % S) as f32 * (1.0 / S as f32);
            let corner = y / S * grid.columns + x / S;
            let (p, n) = (lanes(&points.position, at), lanes(&points.normal, at));
            let mut weights = [0.0f32; LANES];
            for cell in 0..LANES / S {
                let upper = &grid.points[corner + cell..corner + cell + 2];
                let lower = &grid.points[corner + grid.columns + cell..corner + grid.columns + cell + 2];
                let part =
                    |l: &Lane| -> [f32; S] { l[cell * S..(cell + 1) * S].try_into().expect("S divides sixteen") };
                let (px, py, pz) = (part(&p[0]), part(&p[1]), part(&p[2]));
                let (nx, ny, nz) = (part(&n[0]), part(&n[1]), part(&n[2]));
                let (mut r, mut g, mut b, mut w) = ([0.0; S], [0.0; S], [0.0; S], [0.0; S]);
                light_cell::<S>(
                    [&upper[0], &upper[1], &lower[0], &lower[1]],
                    fy,
                    [&px, &py, &pz],
                    [&nx, &ny, &nz],
                    [&mut r, &mut g, &mut b],
                    &mut w,
                );
                let range = cell * S..(cell + 1) * S;
                sum[0][range.clone()].copy_from_slice(&r);
                sum[1][range.clone()].copy_from_slice(&g);
                sum[2][range.clone()].copy_from_slice(&b);
                weights[range].copy_from_slice(&w);
            }
            for lane in 0..LANES {
                if matte[lane] > 0.0 && !(weights[lane] > LEAST_WEIGHT) {
                    missing.push((at + lane) as u32);
                }
            }
        }
        store(&mut points.irradiance, at, &sum);
    }
}

#[inline(always)]
fn light_tile_body(
    grid: &IrradianceGrid,
    points: &mut PointBatch,
    first: [u32; 2],
    runs: usize,
    missing: &mut Vec<u32>,
) {
    match grid.spacing {
        2 => light_body::<2>(grid, points, first, runs, missing),
        4 => light_body::<4>(grid, points, first, runs, missing),
        8 => light_body::<8>(grid, points, first, runs, missing),
        16 => light_body::<16>(grid, points, first, runs, missing),
        other => unreachable!("settings allow no spacing of {other}"),
    }
}

dispatch! {
    fn light_tile => light_tile_body(
        grid: &IrradianceGrid,
        points: &mut PointBatch,
        first: [u32; 2],
        runs: usize,
        missing: &mut Vec<u32>,
    )
}
