//! The per-pixel stages of the CPU lane, tile by tile while the data is hot: G-buffer and mask, direct, indirect, traced,
//! composition.

use glam::Vec3;
use std::time::Instant;

use super::{
    gbuffer::{CameraScan, Eye, GBuffer},
    interleave::{self, Guide},
};
use crate::{
    output::RayCounts,
    settings::SimdLevel,
    simd::dispatch,
    trace::{
        direct,
        points::{LANES, PointBatch, make_room},
        shade::{self, FrameContext, VplRays},
        whitted::{self, MaskedPixel, WhittedScratch},
    },
};

/// Pixels of a rectangle of the picture.
#[derive(Clone, Copy, Debug)]
pub struct TileRect {
    /// Left column.
    pub x: u32,
    /// Top row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Thread time per stage in nanoseconds, and counters.
#[derive(Clone, Copy, Debug, Default)]
pub struct TileStats {
    /// gbuffer, direct, indirect, traced, compose.
    pub nanos: [u64; 5],
    /// Rays by kind.
    pub rays: RayCounts,
    /// Pixels with a mirror or glass share.
    pub masked: u64,
}

impl TileStats {
    /// Sum of both.
    pub fn merged(mut self, o: Self) -> Self {
        for (a, b) in self.nanos.iter_mut().zip(o.nanos) {
            *a += b;
        }
        self.rays = self.rays.merged(o.rays);
        self.masked += o.masked;
        self
    }
}

/// Memory of one worker, kept between tiles and frames, and the finished tile: points of its G-buffer are in the order of
/// [`GBuffer::index`].
#[derive(Clone, Debug, Default)]
pub struct TileScratch {
    /// What is seen, and its direct light.
    pub gbuffer: GBuffer,
    /// Numbers of the triangles that the band may see.
    pub band: Vec<u32>,
    points: PointBatch,
    point_of: Vec<u32>,
    missing: Vec<u32>,
    vpl_rays: VplRays,
    /// The tile's pixels with a mirror or glass share; empty where they are not traced.
    pub masked: Vec<MaskedPixel>,
    masked_of: Vec<u32>,
    whitted: WhittedScratch,
    traced_list: Vec<Vec3>,
    /// What the filter needs where VPLs are interleaved.
    pub guides: Vec<Guide>,
    /// Radiance of mirrors and glass; empty where there are none.
    pub traced: Vec<Vec3>,
}

/// Makes all stages of a tile; results stay in `s`, whose `band` is that of the tile's rows.
pub fn render_tile(ctx: &FrameContext, scan: &CameraScan, rect: TileRect, s: &mut TileScratch) -> TileStats {
    let mut stats = TileStats::default();
    let mut start = Instant::now();
    let mut lap = |stage: usize, stats: &mut TileStats| {
        let now = Instant::now();
        stats.nanos[stage] += (now - start).as_nanos() as u64;
        start = now;
    };
    let band = std::mem::take(&mut s.band);
    s.gbuffer.fill(ctx, scan, &band, rect, shade::wants_ray_starts(ctx));
    s.band = band;
    stats.rays.camera += u64::from(rect.width) * u64::from(rect.height);
    lap(0, &mut stats);
    fill_direct(ctx, s, &mut stats.rays);
    lap(1, &mut stats);
    fill_indirect(ctx, s, &mut stats.rays);
    lap(2, &mut stats);
    fill_traced(ctx, scan, s, &mut stats);
    lap(3, &mut stats);
    stats
}

fn fill_direct(ctx: &FrameContext, s: &mut TileScratch, rays: &mut RayCounts) {
    let g = &mut s.gbuffer;
    // Runs may reach beyond the tile; what they have too much must cast no rays.
    if shade::wants_ray_starts(ctx) {
        g.blacken_outside();
    }
    let (x, y, runs, width) = (g.visible.x, g.visible.y, g.visible.runs, ctx.settings.width);
    let row = (runs * LANES) as u32;
    let pixel = |i: usize| (y + i as u32 / row) * width + x + i as u32 % row;
    direct::direct_light(ctx, &mut g.points, pixel, rays);
}

/// Irradiance of the tile's pixels by all VPLs; where those are interleaved, what the filter over the whole picture needs.
pub fn fill_indirect(ctx: &FrameContext, s: &mut TileScratch, rays: &mut RayCounts) {
    let interleave = ctx.settings.vpl.map_or(1, |v| v.interleave);
    if interleave > 1 {
        return fill_guides(ctx, interleave, s, rays);
    }
    if ctx.grid.is_built() {
        return fill_from_grid(ctx, s, rays);
    }
    let g = &mut s.gbuffer;
    shade::indirect_light(ctx, 0..ctx.vpls.len(), &mut g.points, &mut s.vpl_rays, rays);
}

/// Irradiance of the tile's pixels from the picture's grid, and as hits in mirrors are lit where that cannot tell.
fn fill_from_grid(ctx: &FrameContext, s: &mut TileScratch, rays: &mut RayCounts) {
    let g = &mut s.gbuffer;
    let (first, runs) = ([g.visible.x, g.visible.y], g.visible.runs);
    ctx.grid.light(ctx.level, &mut g.points, first, runs, &mut s.missing);
    // Few at a time, so that the memory is the same for every tile.
    s.points.reserve([AT_A_TIME, 0]);
    for missing in s.missing.chunks(AT_A_TIME) {
        s.points.clear();
        s.points.keep_ray_starts(g.points.has_ray_starts());
        for &i in missing {
            s.points.push_from(&g.points, i as usize);
        }
        s.points.pad();
        shade::indirect_light_of_hits(ctx, &mut s.points, &mut s.vpl_rays, rays);
        for (p, &i) in missing.iter().enumerate() {
            g.points.set_irradiance(i as usize, s.points.irradiance(p));
        }
    }
}

/// Pixels that are lit together where the grid cannot tell.
const AT_A_TIME: usize = 256;

/// Irradiance of the tile's pixels, each by its own subset of the VPLs, into `guides`; that of the points is left black, the
/// filter over the whole picture makes it.
fn fill_guides(ctx: &FrameContext, n: u32, s: &mut TileScratch, rays: &mut RayCounts) {
    s.gbuffer.points.darken();
    s.guides.clear();
    s.guides.resize(s.gbuffer.points.len(), Guide::default());
    for k in 0..n * n {
        let run = interleave::subset_range(ctx.vpls.len(), k, n * n);
        s.points.clear();
        s.points.keep_ray_starts(s.gbuffer.points.has_ray_starts());
        s.point_of.clear();
        for i in 0..s.gbuffer.points.len() {
            let (x, y) = s.gbuffer.place(i);
            let points = &s.gbuffer.points;
            if interleave::subset_of(x, y, n) != k || points.albedo(i) == Vec3::ZERO {
                continue;
            }
            s.points.push_from(points, i);
            s.point_of.push(i as u32);
        }
        s.points.pad();
        shade::indirect_light(ctx, run, &mut s.points, &mut s.vpl_rays, rays);
        for (p, &i) in s.point_of.iter().enumerate() {
            s.guides[i as usize] = Guide {
                position_world: s.points.position_world(p),
                normal: s.points.normal(p),
                irradiance: s.points.irradiance(p) * (n * n) as f32,
                albedo: s.points.albedo(p),
            };
        }
    }
}

fn fill_traced(ctx: &FrameContext, scan: &CameraScan, s: &mut TileScratch, stats: &mut TileStats) {
    s.traced.clear();
    // Compaction: only masked pixels are traced.
    s.gbuffer.traced_pixels(&mut s.masked_of);
    stats.masked += s.masked_of.len() as u64;
    s.masked.clear();
    if !ctx.settings.traced || s.masked_of.is_empty() {
        return;
    }
    let width = ctx.settings.width;
    let eye = Eye::of(&ctx.scene.camera, width, ctx.settings.height);
    for &i in &s.masked_of {
        let (direction, hit) = s.gbuffer.hit(scan, &eye, i as usize).expect("a traced pixel shows a surface");
        let (x, y) = s.gbuffer.place(i as usize);
        s.masked.push(MaskedPixel { pixel: y * width + x, direction, hit });
    }
    if ctx.settings.ray_budget.is_some() {
        return; // The whole picture's are traced together.
    }
    whitted::trace(ctx, &s.masked, &mut s.whitted, &mut s.traced_list, &mut stats.rays);
    s.traced.resize(s.gbuffer.points.len(), Vec3::ZERO);
    for (radiance, &i) in s.traced_list.iter().zip(&s.masked_of) {
        s.traced[i as usize] = *radiance;
    }
}

impl TileScratch {
    /// What fits without another allocation: triangles of a band and of a tile, highlights, traced pixels and their waves.
    pub fn capacity(&self) -> [usize; 7] {
        let [wave, points, glossy] = self.whitted.capacity();
        let masked = self.masked_of.capacity().max(self.masked.capacity()).max(self.traced_list.capacity());
        let own = self.gbuffer.points.capacity()[1];
        [self.band.capacity(), self.gbuffer.candidates(), own, masked, wave, points, glossy]
    }

    /// Makes room for as much, so that it does not matter which thread gets which tile.
    pub fn reserve(&mut self, [band, candidates, own, masked, wave, points, glossy]: [usize; 7]) {
        make_room(&mut self.band, band);
        self.gbuffer.reserve(candidates);
        self.gbuffer.points.reserve([0, own]);
        make_room(&mut self.masked_of, masked);
        make_room(&mut self.masked, masked);
        make_room(&mut self.traced_list, masked);
        self.whitted.reserve([wave, points, glossy]);
    }

    /// Writes direct + indirect + traced radiance of the pixels from number `first` on, which lie in one row. False where a
    /// number is not finite.
    pub fn compose(&self, level: SimdLevel, first: usize, pixels: &mut [[f32; 3]]) -> bool {
        let mut finite = true;
        let traced = self.traced.get(first..first + pixels.len()).unwrap_or(&[]);
        compose(level, &self.gbuffer.points, first, traced, pixels, &mut finite);
        finite
    }
}

#[inline(always)]
fn compose_body<'a>(points: &'a PointBatch, first: usize, traced: &[Vec3], pixels: &mut [[f32; 3]], finite: &mut bool) {
    let n = pixels.len();
    let row = |plane: &'a [f32]| &plane[first..first + n];
    let matte = row(&points.matte);
    let [b0, b1, b2] = [row(&points.base_color[0]), row(&points.base_color[1]), row(&points.base_color[2])];
    let [e0, e1, e2] = [row(&points.irradiance[0]), row(&points.irradiance[1]), row(&points.irradiance[2])];
    let [r0, r1, r2] = [row(&points.radiance[0]), row(&points.radiance[1]), row(&points.radiance[2])];
    let mut check = 0.0f32;
    for i in 0..n {
        pixels[i] =
            [r0[i] + b0[i] * matte[i] * e0[i], r1[i] + b1[i] * matte[i] * e1[i], r2[i] + b2[i] * matte[i] * e2[i]];
    }
    if !traced.is_empty() {
        for (pixel, traced) in pixels.iter_mut().zip(traced) {
            for axis in 0..3 {
                pixel[axis] += traced[axis];
            }
        }
    }
    for v in pixels.as_flattened() {
        check = if v.is_finite() { check } else { 1.0 };
    }
    *finite = check == 0.0;
}

dispatch! {
    fn compose => compose_body(
        points: &PointBatch,
        first: usize,
        traced: &[Vec3],
        pixels: &mut [[f32; 3]],
        finite: &mut bool,
    )
}
