//! The whole frame, top to bottom.
//!
//! ```text
//! scene -> two-level structure -> shadow moments -> VPLs -> per pixel: G-buffer + mask, direct, indirect, traced -> compose
//! ```
//!
//! [`cpu_frame`] makes every stage on the CPU; `gpu_frame.rs` leaves the per-pixel light to wgpu and traces the masked pixels
//! on the CPU meanwhile. Both read the same scene, views, VPLs and structure.

use catoptra_engine::RenderScene;
use glam::Vec3;
use rayon::prelude::*;
use std::time::Instant;

use crate::{
    error::RenderError,
    gpu_frame,
    output::{Frame, FrameStats, Image, Layer, RayCounts, StageTimes},
    renderer::{FrameState, device_name, update_structures},
    settings::{RasterLane, RenderSettings, Shadows, SimdLevel, Tracer, VplOptions, VplShadows},
    trace::{
        budget,
        choice::View,
        explain::{self, RayTree},
        points::Emitter,
        shade::FrameContext,
        whitted::MaskedPixel,
    },
    twin::{
        gbuffer::{CameraScan, Eye},
        grid::IrradianceGrid,
        interleave::{self, Guide},
        moments::render_moments,
        shadow::ShadowPlan,
        tile::{TileRect, TileScratch, TileStats, render_tile},
    },
};

/// Makes one frame on the current rayon pool, into `frame`, whose memory is used again.
/// * `read_back`: a picture that the GPU made is wanted in memory; else it stays on the GPU and the frame's image is empty
pub(crate) fn render_frame(
    state: &mut FrameState,
    level: SimdLevel,
    scene: &RenderScene,
    settings: &RenderSettings,
    read_back: bool,
    frame: &mut Frame,
) -> Result<(), RenderError> {
    if let Some(what) = settings.invalid() {
        return Err(RenderError::Settings(what));
    }
    scene.validate()?;
    let settings = &budget::within_budget(settings);
    let start = Instant::now();
    state.serial += 1;
    // Memory of the frame before is used again.
    let mut device = std::mem::take(&mut frame.stats.device);
    device.clear();
    device.push_str(device_name(state, level));
    frame.stats = FrameStats { device, ..FrameStats::default() };
    frame.layers.clear();
    match state.gpu.take() {
        None => {
            frame.image.resize(settings.width, settings.height);
            cpu_frame(state, level, scene, settings, frame);
        }
        Some(mut gpu) => {
            if !read_back {
                frame.image = Image::default();
            }
            let made = gpu_frame::make(state, &mut gpu, level, scene, settings, read_back, frame);
            state.gpu = Some(gpu);
            made?;
        }
    }
    frame.stats.stages_ms.total = milliseconds(start);
    Ok(())
}

/// Every stage on the CPU.
fn cpu_frame(
    state: &mut FrameState,
    level: SimdLevel,
    scene: &RenderScene,
    settings: &RenderSettings,
    frame: &mut Frame,
) {
    (frame.stats.raster, frame.stats.tracer) = (RasterLane::Cpu, Tracer::Cpu);
    structures(state, scene, settings, &mut frame.stats);
    moments(state, level, scene, settings, &mut frame.stats);
    virtual_lights(state, level, scene, settings, &mut frame.stats);
    pixels(state, level, scene, settings, frame);
}

/// The tree of rays behind a pixel, as the CPU lane makes it.
pub(crate) fn explain_pixel(
    state: &mut FrameState,
    level: SimdLevel,
    scene: &RenderScene,
    settings: &RenderSettings,
    (x, y): (u32, u32),
) -> Result<RayTree, RenderError> {
    if let Some(what) = settings.invalid() {
        return Err(RenderError::Settings(what));
    }
    if x >= settings.width || y >= settings.height {
        return Err(RenderError::Settings(format!(
            "pixel ({x}, {y}) lies outside {}x{}",
            settings.width, settings.height
        )));
    }
    scene.validate()?;
    let settings = &budget::within_budget(settings);
    state.serial += 1;
    let mut stats = FrameStats::default();
    structures(state, scene, settings, &mut stats);
    moments(state, level, scene, settings, &mut stats);
    virtual_lights(state, level, scene, settings, &mut stats);
    if settings.vpl.is_some_and(|v| v.interleave == 1) {
        light_grid(state, level, scene, settings, IrradianceGrid::build);
    }
    Ok(explain::explain(&context(state, level, scene, settings), x, y))
}

/// Two-level structure and normal matrices.
pub(crate) fn structures(
    state: &mut FrameState,
    scene: &RenderScene,
    settings: &RenderSettings,
    stats: &mut FrameStats,
) {
    let _span = tracing::info_span!("structures").entered();
    let start = Instant::now();
    let update = update_structures(state, scene, settings.glass_shadows);
    stats.blas_builds = update.blas_builds;
    stats.tlas_nodes_touched = update.tlas_nodes_touched;
    stats.stages_ms.accel = milliseconds(start);
}

/// Which views the lights need; none unless shadows come from maps.
pub(crate) fn shadow_plan(scene: &RenderScene, settings: &RenderSettings) -> ShadowPlan {
    match settings.shadows {
        Shadows::Moments | Shadows::Certified => {
            ShadowPlan::new(&scene.lights, scene.bounds_world(), &settings.moments)
        }
        Shadows::Traced | Shadows::Off => ShadowPlan::default(),
    }
}

/// Shadow moments and their blur.
pub(crate) fn moments(
    state: &mut FrameState,
    level: SimdLevel,
    scene: &RenderScene,
    settings: &RenderSettings,
    stats: &mut FrameStats,
) {
    let _span = tracing::info_span!("moments").entered();
    let start = Instant::now();
    if settings.shadows != Shadows::Moments && settings.shadows != Shadows::Certified {
        state.maps.plan = ShadowPlan::default();
        return;
    }
    let mut plan = std::mem::take(&mut state.spare_plan);
    plan.update(&scene.lights, scene.bounds_world(), &settings.moments);
    let (maps, scratch) = (&mut state.maps, &mut state.moments);
    stats.rays.moments = render_moments(maps, scratch, &mut plan, scene, &state.accel, settings, level);
    state.spare_plan = plan;
    stats.stages_ms.moments = milliseconds(start);
}

/// Photons from the lights become VPLs; then the VPLs' shadow maps.
pub(crate) fn virtual_lights(
    state: &mut FrameState,
    level: SimdLevel,
    scene: &RenderScene,
    settings: &RenderSettings,
    stats: &mut FrameStats,
) {
    let _span = tracing::info_span!("virtual lights").entered();
    let start = Instant::now();
    if let Some(vpl) = &settings.vpl {
        // Light that nothing has touched since is the same light.
        let same = state.lit_by.update(scene, settings, state.photons.on_surfels);
        if !same || state.photons.is_unsettled() || state.near_lights.is_unsettled() {
            state.photons.trace(scene, &state.normals, &state.accel, vpl, settings.seed);
            if vpl.candidates > 1 && !state.photons.on_surfels {
                let (normals, accel, size) = (&state.normals, &state.accel, [settings.width, settings.height]);
                let geometry_term_max = geometry_term_max(scene, settings);
                state.photons.choose(vpl.count, &View { scene, normals, accel, size, geometry_term_max, level });
            }
            stats.rays.photon = state.photons.rays;
            // In runs of subsets; full evaluation then merely sums in another order.
            interleave::group_subsets(&mut state.photons.vpls, vpl.interleave * vpl.interleave);
            state.emitters.clear();
            state.emitters.extend(state.photons.vpls.iter().map(Emitter::from));
            state.mirrored_emitters.clear();
            if vpl.mirrored > 0 {
                let few = VplOptions { count: vpl.mirrored, candidates: 1, reuse: 0, ..*vpl };
                state.mirrored.trace(scene, &state.normals, &state.accel, &few, settings.seed);
                stats.rays.photon += state.mirrored.rays;
                state.mirrored_emitters.extend(state.mirrored.vpls.iter().map(Emitter::from));
            }
            let size = if vpl.shadows == VplShadows::Maps { vpl.map_size } else { 0 };
            let (maps, accel) = (&mut state.vpl_maps, &state.accel);
            stats.rays.vpl_maps = maps.render(&state.photons.vpls, size, scene, accel, settings.glass_shadows);
            let near = state.near_lights.make(scene, &state.normals, &state.accel, settings);
            stats.rays.photon += near[0];
            stats.rays.vpl_maps += near[1];
            stats.vpls_reused = state.photons.reused();
        } else if vpl.reuse > 0 {
            stats.vpls_reused = state.photons.vpls.len() as u32;
        }
    } else {
        state.lit_by.forget();
        state.photons.forget();
        state.photons.vpls.clear();
        state.emitters.clear();
        state.mirrored_emitters.clear();
        state.vpl_maps.clear();
    }
    state.grid.clear();
    stats.vpls = state.photons.vpls.len() as u32;
    stats.stages_ms.vpls = milliseconds(start);
}

/// Absolute bound of the VPLs' geometry term in 1/m²: the option is in units of 1/(scene radius)².
pub(crate) fn geometry_term_max(scene: &RenderScene, settings: &RenderSettings) -> f32 {
    let radius = scene.bounds_world().radius();
    let bound = settings.vpl.and_then(|v| v.geometry_term_max).map_or(f32::INFINITY, |b| b / (radius * radius));
    if bound.is_nan() { f32::INFINITY } else { bound }
}

pub(crate) fn context<'a>(
    state: &'a FrameState,
    level: SimdLevel,
    scene: &'a RenderScene,
    settings: &'a RenderSettings,
) -> FrameContext<'a> {
    FrameContext {
        scene,
        normals: &state.normals,
        accel: &state.accel,
        maps: &state.maps,
        vpls: &state.photons.vpls,
        emitters: &state.emitters,
        vpl_maps: &state.vpl_maps,
        near_lights: &state.near_lights,
        mirrored: settings.vpl.is_some_and(|v| v.mirrored > 0).then_some(&state.mirrored_emitters),
        grid: &state.grid,
        geometry_term_max: geometry_term_max(scene, settings),
        settings,
        level,
        serial: state.serial,
    }
}

/// All per-pixel stages of the CPU lane: bands of tiles in parallel, each tile through all its stages.
fn pixels(state: &mut FrameState, level: SimdLevel, scene: &RenderScene, settings: &RenderSettings, frame: &mut Frame) {
    let start = Instant::now();
    let interleaved = settings.vpl.map_or(1, |v| v.interleave);
    let _span = tracing::info_span!("pixels").entered();
    state.camera.build(level, scene, &state.accel, [settings.width, settings.height]);
    let setup = milliseconds(start);
    let start = Instant::now();
    let rays = light_grid(state, level, scene, settings, IrradianceGrid::build);
    frame.stats.rays = frame.stats.rays.merged(rays);
    frame.stats.stages_ms.vpls += milliseconds(start);
    let start = Instant::now();
    let mut guides = std::mem::take(&mut state.guides);
    guides.resize(if interleaved > 1 { frame.image.pixels.len() } else { 0 }, Guide::default());
    let ctx = context(state, level, scene, settings);
    let (width, tile) = (settings.width, settings.tile);
    let mut layers: Vec<Image> = if settings.keep_layers {
        KEPT.iter().map(|_| Image::new(settings.width, settings.height)).collect()
    } else {
        Vec::new()
    };
    let band_pixels = (width * tile) as usize;
    let merge = |a: (TileStats, NonFinite), b: (TileStats, NonFinite)| (a.0.merged(b.0), merge_non_finite(a.1, b.1));
    // Pixels that are traced together in the end, in the order that threads found them: it does not show.
    let later = std::sync::Mutex::new(Vec::new());
    let make = |band: Band| render_band(&ctx, &state.camera, &state.tiles, &later, band);
    let bands = frame.image.pixels.par_chunks_mut(band_pixels).enumerate().with_max_len(1);
    let (mut stats, mut non_finite) = if layers.is_empty() && guides.is_empty() {
        bands
            .map(|(i, image)| make(Band { y: i as u32 * tile, image, guides: &mut [], layers: Vec::new() }))
            .reduce(Default::default, merge)
    } else {
        // One list of row bands a picture, regrouped so that each task owns the same band of all of them.
        let mut bands: Vec<Band> =
            bands.map(|(i, image)| Band { y: i as u32 * tile, image, guides: &mut [], layers: Vec::new() }).collect();
        for layer in &mut layers {
            for (band, pixels) in bands.iter_mut().zip(layer.pixels.chunks_mut(band_pixels)) {
                band.layers.push(pixels);
            }
        }
        for (band, guides) in bands.iter_mut().zip(guides.chunks_mut(band_pixels)) {
            band.guides = guides;
        }
        bands.into_par_iter().with_max_len(1).map(make).reduce(Default::default, merge)
    };
    if interleaved > 1 {
        let indirect = layers.get_mut(INDIRECT).map(|l| &mut l.pixels);
        let filtered = filter_indirect(&guides, interleaved, &mut frame.image, indirect);
        stats.nanos[2] += filtered.0;
        non_finite = merge_non_finite(non_finite, filtered.1);
    }
    if let Some(budget) = settings.ray_budget {
        let _span = tracing::info_span!("budgeted tracing").entered();
        let start = Instant::now();
        let pixels = later.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
        let left = budget.saturating_sub(frame.stats.rays.total() + stats.rays.total());
        let radiance = budget::trace(&ctx, &pixels, left, &mut stats.rays);
        for (p, traced) in pixels.iter().zip(radiance) {
            let at = p.pixel as usize;
            let sum = Vec3::from(frame.image.pixels[at]) + traced;
            if sum.is_finite() {
                frame.image.pixels[at] = sum.to_array();
            } else {
                frame.image.pixels[at] = [0.0; 3];
                non_finite = merge_non_finite(non_finite, (1, Some((p.pixel % width, p.pixel / width))));
            }
            if let Some(layer) = layers.get_mut(TRACED) {
                layer.pixels[at] = traced.to_array();
            }
        }
        // All threads work on it.
        stats.nanos[3] += start.elapsed().as_nanos() as u64 * state.tiles.len() as u64;
    }
    share_memory(&state.tiles);
    let wall = milliseconds(start);
    let total: u64 = stats.nanos.iter().sum();
    let share = |stage: usize| wall * stats.nanos[stage] as f64 / total.max(1) as f64;
    let s = &mut frame.stats;
    s.stages_ms = StageTimes {
        gbuffer: setup + share(0),
        direct: share(1),
        indirect: share(2),
        traced: share(3),
        compose: share(4),
        ..s.stages_ms
    };
    s.rays = s.rays.merged(stats.rays);
    s.masked_pixels = stats.masked;
    s.non_finite = non_finite;
    frame.layers.extend(KEPT.into_iter().zip(layers));
    state.guides = guides;
    if settings.keep_layers {
        frame.layers.push((Layer::Moments, moments_image(state)));
    }
}

/// Light on a grid of the picture, where the settings want it.
/// * `build`: [`IrradianceGrid::build`] or [`IrradianceGrid::build_close`]
pub(crate) fn light_grid(
    state: &mut FrameState,
    level: SimdLevel,
    scene: &RenderScene,
    settings: &RenderSettings,
    build: impl FnOnce(&mut IrradianceGrid, &FrameContext) -> RayCounts,
) -> RayCounts {
    let mut grid = std::mem::take(&mut state.grid);
    let rays = build(&mut grid, &context(state, level, scene, settings));
    state.grid = grid;
    rays
}

/// Gives every thread the room that one of them needed: which gets which tile is chance, memory for it must not be.
fn share_memory(scratches: &[std::sync::Mutex<TileScratch>]) {
    let all = || scratches.iter().map(|s| s.lock().unwrap_or_else(std::sync::PoisonError::into_inner));
    let most = all().fold([0; 7], |m, s| {
        let own = s.capacity();
        std::array::from_fn(|i| m[i].max(own[i]))
    });
    all().for_each(|mut s| s.reserve(most));
}

/// Layers that the CPU lane writes tile by tile.
const KEPT: [Layer; 7] =
    [Layer::Direct, Layer::Indirect, Layer::Traced, Layer::Mask, Layer::Depth, Layer::Normal, Layer::Albedo];

/// Place of the indirect layer among them.
const INDIRECT: usize = 1;
/// Place of the traced layer.
const TRACED: usize = 2;

/// Adds the filtered indirect light of interleaved VPLs to the picture and its layer. Returns thread time in nanoseconds and
/// the pixels that are not finite.
fn filter_indirect(guides: &[Guide], n: u32, image: &mut Image, layer: Option<&mut Vec<[f32; 3]>>) -> (u64, NonFinite) {
    let (width, height) = (image.width, image.height);
    let mut none = Vec::new();
    let layer = layer.unwrap_or(&mut none);
    layer.resize(image.pixels.len(), [0.0; 3]);
    let row = width as usize;
    image
        .pixels
        .par_chunks_mut(row)
        .zip(layer.par_chunks_mut(row))
        .enumerate()
        .map(|(y, (pixels, layer))| {
            let start = Instant::now();
            let mut non_finite = NonFinite::default();
            for x in 0..width {
                let radiance = interleave::filter(guides, width, height, x, y as u32, n);
                let sum = Vec3::from(pixels[x as usize]) + radiance;
                layer[x as usize] = radiance.to_array();
                if sum.is_finite() {
                    pixels[x as usize] = sum.to_array();
                } else {
                    pixels[x as usize] = [0.0; 3];
                    non_finite = merge_non_finite(non_finite, (1, Some((x, y as u32))));
                }
            }
            (start.elapsed().as_nanos() as u64, non_finite)
        })
        .reduce(Default::default, |a, b| (a.0 + b.0, merge_non_finite(a.1, b.1)))
}

struct Band<'a> {
    y: u32,
    image: &'a mut [[f32; 3]],
    guides: &'a mut [Guide],
    layers: Vec<&'a mut [[f32; 3]]>,
}

pub(crate) type NonFinite = (u64, Option<(u32, u32)>);

pub(crate) fn merge_non_finite(a: NonFinite, b: NonFinite) -> NonFinite {
    let first = match (a.1, b.1) {
        (Some(p), Some(q)) => Some(if (p.1, p.0) <= (q.1, q.0) { p } else { q }),
        (p, q) => p.or(q),
    };
    (a.0 + b.0, first)
}

fn render_band(
    ctx: &FrameContext,
    scan: &CameraScan,
    scratches: &[std::sync::Mutex<TileScratch>],
    later: &std::sync::Mutex<Vec<MaskedPixel>>,
    mut band: Band,
) -> (TileStats, NonFinite) {
    let _span = tracing::info_span!("band").entered();
    let (width, tile) = (ctx.settings.width, ctx.settings.tile);
    let rows = band.image.len() as u32 / width;
    // Each worker has its own scratch, so the lock is free but for threads outside the pool, which share the first.
    let own = rayon::current_thread_index().unwrap_or(0) % scratches.len();
    let mut scratch = scratches[own].lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let mut stats = TileStats::default();
    let mut non_finite = NonFinite::default();
    let eye = Eye::of(&ctx.scene.camera, width, ctx.settings.height);
    let start = Instant::now();
    scan.list.of_rows(band.y, band.y + rows - 1, &mut scratch.band);
    stats.nanos[0] += start.elapsed().as_nanos() as u64;
    for x in (0..width).step_by(tile as usize) {
        let rect = TileRect { x, y: band.y, width: tile.min(width - x), height: rows };
        stats = stats.merged(render_tile(ctx, scan, rect, &mut scratch));
        if ctx.settings.ray_budget.is_some() {
            later.lock().unwrap_or_else(std::sync::PoisonError::into_inner).extend_from_slice(&scratch.masked);
        }
        let start = Instant::now();
        for y in 0..rows {
            let first = scratch.gbuffer.index(rect.x, rect.y + y);
            let at = (y * width + x) as usize;
            let pixels = &mut band.image[at..at + rect.width as usize];
            if !scratch.compose(ctx.level, first, pixels) {
                for (dx, p) in pixels.iter_mut().enumerate().filter(|(_, p)| !p.iter().all(|v| v.is_finite())) {
                    *p = [0.0; 3];
                    non_finite = merge_non_finite(non_finite, (1, Some((x + dx as u32, rect.y + y))));
                }
            }
            if !band.guides.is_empty() {
                band.guides[at..at + rect.width as usize]
                    .copy_from_slice(&scratch.guides[first..first + rect.width as usize]);
            }
            for (layer, out) in KEPT.iter().zip(&mut band.layers) {
                for (dx, out) in out[at..at + rect.width as usize].iter_mut().enumerate() {
                    *out = layer_value(ctx, scan, &eye, *layer, &mut scratch, first + dx).to_array();
                }
            }
        }
        stats.nanos[4] += start.elapsed().as_nanos() as u64;
    }
    (stats, non_finite)
}

fn layer_value(
    ctx: &FrameContext,
    scan: &CameraScan,
    eye: &Eye,
    layer: Layer,
    scratch: &mut TileScratch,
    i: usize,
) -> Vec3 {
    let (g, points) = (&mut scratch.gbuffer, |s: &TileScratch| s.gbuffer.points.radiance(i));
    if g.instance(ctx, scan, i).is_none() {
        return if layer == Layer::Direct { points(scratch) } else { Vec3::ZERO };
    }
    match layer {
        Layer::Direct => points(scratch),
        Layer::Indirect => g.points.albedo(i) * g.points.irradiance(i),
        Layer::Traced => scratch.traced.get(i).copied().unwrap_or(Vec3::ZERO),
        Layer::Mask => g
            .surface(ctx, scan, eye, i)
            .map_or(Vec3::ZERO, |(s, _)| Vec3::new(s.look.mirror, (1.0 - s.look.mirror) * s.look.transmission, 0.0)),
        Layer::Depth => Vec3::splat(g.depth(scan, i)),
        Layer::Normal => g.points.normal(i) * 0.5 + 0.5,
        Layer::Albedo => g.points.base_color(i),
        Layer::Final | Layer::Moments => Vec3::ZERO,
    }
}

fn moments_image(state: &FrameState) -> Image {
    match (state.maps.plan.views.first(), state.maps.maps.first()) {
        (Some(view), Some(map)) => {
            Image { width: view.size, height: view.size, pixels: map.iter().map(|m| [m[0], m[1], 0.0]).collect() }
        }
        _ => Image::new(1, 1),
    }
}

pub(crate) fn milliseconds(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}
