//! The per-pixel stages of the CPU lane, tile by tile while the data is hot: G-buffer and mask, direct, indirect, traced,
//! composition.

use glam::Vec3;
use std::time::Instant;

use super::interleave::{self, Guide};
use crate::{
    accel::{Hit, Ray},
    output::RayCounts,
    trace::{
        camera_rays::camera_ray,
        points::PointBatch,
        shade::{self, FrameContext, VplRays},
        surface::{PixelCone, Surface, surface_seen},
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

/// What the G-buffer holds of one pixel.
#[derive(Clone, Copy, Debug)]
pub struct GBufferPixel {
    /// Number of the picture's pixel.
    pub pixel: u32,
    /// Unit direction of the camera ray.
    pub direction: Vec3,
    /// Distance along the viewing direction, metres; 0 on a miss.
    pub depth: f32,
    /// The surface; `None` where the camera ray left the scene.
    pub surface: Option<Surface>,
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

/// Memory of one worker, kept between tiles and frames, and the finished tile.
#[derive(Clone, Debug, Default)]
pub struct TileScratch {
    rays: Vec<Ray>,
    hits: Vec<Hit>,
    /// One entry a pixel of the tile, in 4x4 blocks.
    pub gbuffer: Vec<GBufferPixel>,
    points: PointBatch,
    point_of: Vec<u32>,
    vpl_rays: VplRays,
    masked: Vec<MaskedPixel>,
    masked_of: Vec<u32>,
    whitted: WhittedScratch,
    traced_list: Vec<Vec3>,
    /// Direct radiance per pixel, in the order of `gbuffer`.
    pub direct: Vec<Vec3>,
    /// Indirect radiance; black where VPLs are interleaved.
    pub indirect: Vec<Vec3>,
    /// What the filter needs where VPLs are interleaved.
    pub guides: Vec<Guide>,
    /// Radiance of mirrors and glass.
    pub traced: Vec<Vec3>,
}

/// Makes all stages of a tile; results stay in `s`.
pub fn render_tile(ctx: &FrameContext, rect: TileRect, s: &mut TileScratch) -> TileStats {
    let mut stats = TileStats::default();
    let mut start = Instant::now();
    let mut lap = |stage: usize, stats: &mut TileStats| {
        let now = Instant::now();
        stats.nanos[stage] += (now - start).as_nanos() as u64;
        start = now;
    };
    fill_gbuffer(ctx, rect, s);
    stats.rays.camera += s.gbuffer.len() as u64;
    lap(0, &mut stats);
    fill_direct(ctx, s, &mut stats.rays);
    lap(1, &mut stats);
    match ctx.settings.vpl.map_or(1, |v| v.interleave) {
        n if n > 1 => fill_guides(ctx, n, s, &mut stats.rays),
        _ => fill_indirect(ctx, s, &mut stats.rays),
    }
    lap(2, &mut stats);
    fill_traced(ctx, s, &mut stats);
    lap(3, &mut stats);
    stats
}

/// Casts the camera rays of the tile, 4x4 blocks in a row.
///
/// Twin: `shaders/gbuffer.wgsl`.
pub fn fill_gbuffer(ctx: &FrameContext, rect: TileRect, s: &mut TileScratch) {
    let (width, height) = (ctx.settings.width, ctx.settings.height);
    let camera = &ctx.scene.camera;
    let forward = -camera.world_from_view.matrix3.z_axis;
    s.rays.clear();
    s.gbuffer.clear();
    for by in (rect.y..rect.y + rect.height).step_by(4) {
        for bx in (rect.x..rect.x + rect.width).step_by(4) {
            for y in by..(by + 4).min(rect.y + rect.height) {
                for x in bx..(bx + 4).min(rect.x + rect.width) {
                    let ray = camera_ray(camera, x as f32, y as f32, width, height);
                    s.rays.push(ray);
                    s.gbuffer.push(GBufferPixel {
                        pixel: y * width + x,
                        direction: ray.direction,
                        depth: 0.0,
                        surface: None,
                    });
                }
            }
        }
    }
    s.hits.clear();
    s.hits.resize(s.rays.len(), Hit::MISS);
    ctx.accel.closest_hits(&s.rays, &mut s.hits);
    let cone = PixelCone::of(camera, height);
    for ((ray, hit), g) in s.rays.iter().zip(&s.hits).zip(&mut s.gbuffer) {
        if hit.is_hit() {
            g.depth = hit.t * forward.dot(ray.direction);
            g.surface = Some(surface_seen(ctx.scene, ctx.normals, ray, hit, cone.at(hit.t)));
        }
    }
}

fn fill_direct(ctx: &FrameContext, s: &mut TileScratch, rays: &mut RayCounts) {
    s.direct.clear();
    for g in &s.gbuffer {
        s.direct.push(match &g.surface {
            Some(surface) => shade::direct_light(ctx, surface, -g.direction, g.pixel, rays),
            None => ctx.scene.environment.background,
        });
    }
}

/// Indirect radiance of the tile's pixels, by all VPLs.
pub fn fill_indirect(ctx: &FrameContext, s: &mut TileScratch, rays: &mut RayCounts) {
    s.indirect.clear();
    s.indirect.resize(s.gbuffer.len(), Vec3::ZERO);
    light_points(ctx, s, 0..ctx.vpls.len(), |_| true, rays);
    for (p, &i) in s.point_of.iter().enumerate() {
        s.indirect[i as usize] = albedo(ctx, &s.gbuffer[i as usize]) * s.points.irradiance(p);
    }
}

/// Irradiance of the tile's pixels, each by its own subset of the VPLs, into `guides`; `indirect` is left black, the filter
/// over the whole picture makes it.
fn fill_guides(ctx: &FrameContext, n: u32, s: &mut TileScratch, rays: &mut RayCounts) {
    s.indirect.clear();
    s.indirect.resize(s.gbuffer.len(), Vec3::ZERO);
    s.guides.clear();
    s.guides.resize(s.gbuffer.len(), Guide::default());
    let width = ctx.settings.width;
    for k in 0..n * n {
        let run = interleave::subset_range(ctx.vpls.len(), k, n * n);
        light_points(ctx, s, run.clone(), |pixel| interleave::subset_of(pixel % width, pixel / width, n) == k, rays);
        for (p, &i) in s.point_of.iter().enumerate() {
            let g = &s.gbuffer[i as usize];
            let Some(surface) = &g.surface else { continue };
            // A subset without VPLs leaves no light behind.
            let irradiance = if run.is_empty() { Vec3::ZERO } else { s.points.irradiance(p) };
            s.guides[i as usize] = Guide {
                position_world: surface.position_world,
                normal: surface.n_shading,
                irradiance: irradiance * (n * n) as f32,
                albedo: albedo(ctx, g),
            };
        }
    }
}

/// What turns a pixel's irradiance into radiance; zero where it has no matte share.
fn albedo(ctx: &FrameContext, g: &GBufferPixel) -> Vec3 {
    match &g.surface {
        Some(s) => shade::indirect_albedo(&ctx.scene.materials[s.material as usize], s),
        None => Vec3::ZERO,
    }
}

/// Lights the matte pixels that `take` chooses by a run of the VPLs: `points` and `point_of` hold them.
fn light_points(
    ctx: &FrameContext,
    s: &mut TileScratch,
    run: std::ops::Range<usize>,
    take: impl Fn(u32) -> bool,
    rays: &mut RayCounts,
) {
    s.points.clear();
    s.point_of.clear();
    if ctx.vpls.is_empty() {
        return;
    }
    for (i, g) in s.gbuffer.iter().enumerate() {
        let Some(surface) = &g.surface else { continue };
        // Pixels without a matte share receive nothing.
        if take(g.pixel) && albedo(ctx, g) != Vec3::ZERO {
            s.points.push(surface.position_world, surface.n_shading);
            s.point_of.push(i as u32);
        }
    }
    s.points.pad();
    let gbuffer = &s.gbuffer;
    let surfaces = s.point_of.iter().map(|&i| gbuffer[i as usize].surface.as_ref().expect("a point has a surface"));
    shade::indirect_light(ctx, run, &mut s.points, surfaces, &mut s.vpl_rays, rays);
}

fn fill_traced(ctx: &FrameContext, s: &mut TileScratch, stats: &mut TileStats) {
    s.traced.clear();
    s.traced.resize(s.gbuffer.len(), Vec3::ZERO);
    // Compaction: only masked pixels are traced.
    s.masked.clear();
    s.masked_of.clear();
    for (i, g) in s.gbuffer.iter().enumerate() {
        let Some(surface) = g.surface else { continue };
        if surface.look.is_traced() {
            s.masked.push(MaskedPixel { pixel: g.pixel, surface, direction: g.direction });
            s.masked_of.push(i as u32);
        }
    }
    stats.masked += s.masked.len() as u64;
    if !ctx.settings.traced || s.masked.is_empty() {
        return;
    }
    whitted::trace(ctx, &s.masked, &mut s.whitted, &mut s.traced_list, &mut stats.rays);
    for (radiance, &i) in s.traced_list.iter().zip(&s.masked_of) {
        s.traced[i as usize] = *radiance;
    }
}
