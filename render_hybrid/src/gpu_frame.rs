//! The frame of the GPU lane, top to bottom: light on the GPU, mirrors and glass on the CPU at the same time, or all of it on
//! the GPU.
//!
//! ```text
//! GPU  moments, G-buffer, mask, compaction | direct, indirect              | compose
//! CPU  structure, photons                  | Whitted on the masked pixels  |
//! ```
//!
//! A bar is what one side waits for: light wants the VPLs, tracing the mask's list and the moments, which come back with the
//! passes that make them, composition wants both. Each of the three parts is one submission. Double buffered, the CPU traces a
//! frame while the GPU already makes the mask of the next ([`Doubled`]).

use catoptra_engine::RenderScene;
use rayon::prelude::*;
use std::time::Instant;

use crate::{
    error::RenderError,
    frame::{
        context, geometry_term_max, light_grid, merge_non_finite, milliseconds, moments, shadow_plan, structures,
        virtual_lights,
    },
    output::{Frame, FrameStats, Image, Layer, RayCounts, StageInterval, StageTimes},
    raster::{GpuRaster, Indirect, PhotonInputs, RasterInputs, TracedCounts},
    renderer::FrameState,
    settings::{NearField, RasterLane, RenderSettings, Shadows, SimdLevel, Tracer, VplShadows},
    trace::{
        budget,
        camera_rays::{self, TracedLight},
        photons::LightPaths,
        whitted::{self, MaskedPixel},
    },
    twin::{
        grid::{IrradianceGrid, near_field_of},
        shadow::ShadowPlan,
        vpl_maps::VplMaps,
    },
};

/// A frame that is lit on the GPU and not traced yet.
struct Late {
    scene: RenderScene,
    settings: RenderSettings,
    plan: ShadowPlan,
    serial: u64,
    stats: FrameStats,
}

/// What two frames at once leave for the next call.
#[derive(Default)]
pub(crate) struct Doubled {
    late: Option<Late>,
    /// Size of the finished picture that the GPU holds.
    finished: Option<(u32, u32)>,
}

/// Notes when the CPU's stages ran.
struct Clock {
    on: bool,
    list: Vec<StageInterval>,
}

impl Clock {
    /// Runs a stage and adds its milliseconds to `into`.
    fn run<T>(&mut self, name: &'static str, into: &mut f64, stage: impl FnOnce() -> T) -> T {
        let begin = Instant::now();
        let out = stage();
        *into += milliseconds(begin);
        if self.on {
            self.list.push(StageInterval { on_gpu: false, name, begin, end: Instant::now() });
        }
        out
    }
}

/// Where stages are timed apart: waits for what was submitted.
fn settle(gpu: &mut GpuRaster, clock: &mut Clock) -> Result<(), RenderError> {
    if gpu.is_one_by_one() {
        clock.run("wait apart", &mut 0.0, || gpu.settle())?;
    }
    Ok(())
}

/// What a frame is made of.
#[derive(Clone, Copy)]
struct Wanted<'a> {
    level: SimdLevel,
    scene: &'a RenderScene,
    settings: &'a RenderSettings,
    read_back: bool,
}

/// Makes one frame into `frame`.
pub(crate) fn make(
    state: &mut FrameState,
    gpu: &mut GpuRaster,
    level: SimdLevel,
    scene: &RenderScene,
    settings: &RenderSettings,
    read_back: bool,
    frame: &mut Frame,
) -> Result<(), RenderError> {
    frame.stats.raster = RasterLane::Gpu;
    let made_before = gpu.pipelines();
    let wanted = Wanted { level, scene, settings, read_back };
    let size = (settings.width, settings.height);
    let on_gpu = settings.traced && gpu.tracer() != Tracer::Cpu;
    // Layers of the frame before are overwritten; a GPU that does everything is never waited for unless read.
    let doubled = settings.double_buffered && !settings.keep_layers && (read_back || !on_gpu);
    let Doubled { late, finished } = std::mem::take(&mut state.doubled);
    let shows_last = doubled && finished == Some(size);
    let late = late.filter(|l| shows_last && !on_gpu && (l.settings.width, l.settings.height) == size);
    gpu.set_timing(settings.time_passes);
    gpu.begin_timing(shows_last)?;
    let mut clock = Clock { on: settings.time_passes, list: Vec::new() };
    if !shows_last {
        at_once(state, gpu, wanted, frame, &mut clock)?;
    } else if on_gpu {
        last_of_gpu(state, gpu, wanted, frame, &mut clock)?;
    } else {
        beside_the_last(state, gpu, wanted, late, frame, &mut clock)?;
    }
    if doubled {
        state.doubled.finished = Some(size);
    }
    frame.stats.timeline = clock.list;
    blacken_non_finite(&mut frame.image, &mut frame.stats);
    (frame.stats.bytes_up, frame.stats.bytes_down) = gpu.counters();
    frame.stats.pipelines_made = gpu.pipelines() - made_before;
    if settings.time_passes {
        gpu.read_times(&mut frame.stats.timeline)?;
        let FrameStats { timeline, stages_ms, .. } = &mut frame.stats;
        for stage in timeline.iter().filter(|s| s.on_gpu) {
            *match stage.name {
                "moments" => &mut stages_ms.moments,
                "gbuffer" | "compact" => &mut stages_ms.gbuffer,
                "direct" => &mut stages_ms.direct,
                "indirect" => &mut stages_ms.indirect,
                "photons" => &mut stages_ms.vpls,
                "send back" | "send picture" => &mut stages_ms.transfer,
                "traced" => &mut stages_ms.traced,
                _ => &mut stages_ms.compose,
            } += stage.milliseconds();
        }
    }
    Ok(())
}

/// A frame on its own.
fn at_once(
    state: &mut FrameState,
    gpu: &mut GpuRaster,
    wanted: Wanted,
    frame: &mut Frame,
    clock: &mut Clock,
) -> Result<(), RenderError> {
    let Wanted { scene, settings, read_back, .. } = wanted;
    let mut ms = StageTimes::default();
    let slot = gpu.timing_slots().0;
    let plan = shadow_plan(scene, settings);
    begin(gpu, wanted, &plan, &mut ms, clock)?;
    let traced_on_gpu = light(state, gpu, wanted, &mut frame.stats, &mut ms, clock)?;
    if !traced_on_gpu {
        // Light is on its way; the list is there as soon as the passes before it are done.
        trace_here(state, gpu, wanted, &plan, &mut frame.stats, &mut ms, clock)?;
    }
    clock.run("submit", &mut ms.transfer, || gpu.finish(read_back, slot))?;
    settle(gpu, clock)?;
    deliver(state, gpu, read_back, traced_on_gpu, frame, &mut ms, clock)?;
    if settings.keep_layers {
        let start = Instant::now();
        for (layer, _) in Layer::ALL.iter().filter(|(l, _)| *l != Layer::Final) {
            frame.layers.push((*layer, gpu.read_layer(*layer)?));
        }
        ms.transfer += milliseconds(start);
    }
    add_times(&mut frame.stats.stages_ms, &ms);
    Ok(())
}

/// The CPU traces the frame's masked pixels; composition is recorded.
fn trace_here(
    state: &mut FrameState,
    gpu: &mut GpuRaster,
    wanted: Wanted,
    plan: &ShadowPlan,
    stats: &mut FrameStats,
    ms: &mut StageTimes,
    clock: &mut Clock,
) -> Result<(), RenderError> {
    let masked = fetch(state, gpu, wanted.level, wanted.settings, plan, ms, clock)?;
    stats.masked_pixels = masked.len() as u64;
    let traced = clock.run("trace", &mut ms.traced, || trace_masked(state, wanted, state.serial, &masked, stats));
    clock.run("send traced", &mut ms.transfer, || gpu.record_compose(&traced))
}

/// All on the GPU: sends the picture of the frame before, then everything of this one, and waits for the former alone.
fn last_of_gpu(
    state: &mut FrameState,
    gpu: &mut GpuRaster,
    wanted: Wanted,
    frame: &mut Frame,
    clock: &mut Clock,
) -> Result<(), RenderError> {
    let Wanted { scene, settings, .. } = wanted;
    let mut ms = StageTimes::default();
    let (slot, other) = gpu.timing_slots();
    clock.run("submit", &mut ms.transfer, || gpu.finish(true, other))?;
    let plan = shadow_plan(scene, settings);
    begin(gpu, wanted, &plan, &mut ms, clock)?;
    let traced_on_gpu = light(state, gpu, wanted, &mut frame.stats, &mut ms, clock)?;
    if traced_on_gpu {
        clock.run("submit", &mut ms.transfer, || gpu.submit_recorded())?;
        frame.stats.latency_frames = 1;
    } else {
        // The scene has become too large for the GPU's tracer: this frame is made here, and shown.
        trace_here(state, gpu, wanted, &plan, &mut frame.stats, &mut ms, clock)?;
        clock.run("submit", &mut ms.transfer, || gpu.finish(true, slot))?;
    }
    deliver(state, gpu, true, traced_on_gpu, frame, &mut ms, clock)?;
    add_times(&mut frame.stats.stages_ms, &ms);
    Ok(())
}

/// Begins a frame and, while the GPU works on it, traces and shows the one before.
fn beside_the_last(
    state: &mut FrameState,
    gpu: &mut GpuRaster,
    wanted: Wanted,
    late: Option<Late>,
    frame: &mut Frame,
    clock: &mut Clock,
) -> Result<(), RenderError> {
    let Wanted { level, scene, settings, read_back } = wanted;
    let mut ms = StageTimes::default();
    let (_, other) = gpu.timing_slots();
    let masked = match &late {
        Some(late) => fetch(state, gpu, level, &late.settings, &late.plan, &mut ms, clock)?,
        None => Vec::new(),
    };
    let plan = shadow_plan(scene, settings);
    begin(gpu, wanted, &plan, &mut ms, clock)?;
    // The structure is still that of the frame before.
    let mut shown = FrameStats::default();
    if let Some(Late { scene, settings, serial, stats, .. }) = &late {
        shown.clone_from(stats);
        shown.masked_pixels = masked.len() as u64;
        let before = Wanted { level, scene, settings, read_back };
        let traced = clock.run("trace", &mut ms.traced, || trace_masked(state, before, *serial, &masked, &mut shown));
        clock.run("send traced", &mut ms.transfer, || gpu.record_compose(&traced))?;
    }
    clock.run("submit", &mut ms.transfer, || gpu.finish(read_back, other))?;

    light(state, gpu, wanted, &mut frame.stats, &mut ms, clock)?;
    // The lists of the scene; what is shared of it stays shared.
    let kept = clock.run("keep", &mut ms.transfer, || scene.clone());
    let begun = Late { scene: kept, settings: *settings, plan, serial: state.serial, stats: frame.stats.clone() };
    if late.is_some() {
        let own = std::mem::replace(&mut frame.stats, shown);
        // Times are of this call, counts of what it shows.
        frame.stats.stages_ms = own.stages_ms;
    }
    state.doubled.late = Some(begun);
    frame.stats.latency_frames = 1;
    deliver(state, gpu, read_back, false, frame, &mut ms, clock)?;
    add_times(&mut frame.stats.stages_ms, &ms);
    Ok(())
}

/// Submits the passes up to the mask's list.
fn begin(
    gpu: &mut GpuRaster,
    wanted: Wanted,
    plan: &ShadowPlan,
    ms: &mut StageTimes,
    clock: &mut Clock,
) -> Result<(), RenderError> {
    let Wanted { scene, settings, .. } = wanted;
    let on_cpu = gpu.tracer() == Tracer::Cpu;
    let traced = settings.traced && on_cpu;
    gpu.expect(on_cpu, traced && settings.shadows == Shadows::Moments);
    clock.run("send scene", &mut ms.transfer, || gpu.begin(scene, settings, plan))?;
    settle(gpu, clock)
}

/// Structure and photons, then the submission of light; where the GPU traces that is recorded, too, and left open: true.
fn light(
    state: &mut FrameState,
    gpu: &mut GpuRaster,
    wanted: Wanted,
    stats: &mut FrameStats,
    ms: &mut StageTimes,
    clock: &mut Clock,
) -> Result<bool, RenderError> {
    let Wanted { level, scene, settings, .. } = wanted;
    // These two tell their times themselves.
    let mut told = 0.0;
    clock.run("structures", &mut told, || structures(state, scene, settings, stats));
    let photons = photons_on_gpu(gpu, settings);
    let mut paths = None;
    if photons {
        let begin = Instant::now();
        paths = clock.run("light paths", &mut told, || light_paths(state, scene, settings));
        stats.stages_ms.vpls = milliseconds(begin);
    } else {
        state.lit_on_gpu.forget();
        clock.run("virtual lights", &mut told, || virtual_lights(state, level, scene, settings, stats));
    }

    // Where visibility is traced, the CPU finds it.
    let trace_lights = matches!(settings.shadows, Shadows::Traced | Shadows::Certified);
    let near_field = near_field_of(settings);
    if settings.shadows == Shadows::Certified || near_field == NearField::Full {
        clock.run("moments", &mut told, || moments(state, level, scene, settings, stats));
    }
    let too_many = state.photons.vpls.len() > gpu.most_vpl_maps() as usize;
    let trace_vpls = settings.vpl.is_some_and(|v| match v.shadows {
        VplShadows::Off => false,
        VplShadows::Maps => too_many,
        VplShadows::Traced => true,
    });
    let none = VplMaps::default();
    gpu.set_vpl_maps(if too_many { &none } else { &state.vpl_maps })?;
    let few = settings.vpl.is_some_and(|v| v.mirrored > 0);
    gpu.set_mirrored_vpls(few.then_some(state.mirrored.vpls.as_slice()));
    let mut traced = TracedLight::default();
    if trace_lights || trace_vpls {
        traced = clock.run("visibility", &mut ms.direct, || {
            let ctx = context(state, level, scene, settings);
            camera_rays::trace_light(&ctx, trace_lights, trace_vpls, &mut stats.rays)
        });
    }
    let visibility = trace_lights.then_some(traced.visibility.as_slice());
    if near_field != NearField::Off && !trace_vpls {
        let rays = clock.run("light grid", &mut told, || match near_field {
            NearField::Full => light_grid(state, level, scene, settings, IrradianceGrid::build),
            _ => light_grid(state, level, scene, settings, IrradianceGrid::build_close),
        });
        stats.rays = stats.rays.merged(rays);
    }
    let bound = geometry_term_max(scene, settings);
    let on_gpu = clock.run("send to tracer", &mut ms.transfer, || traces_on_gpu(state, gpu, wanted, bound, &paths))?;
    stats.tracer = if on_gpu { gpu.tracer() } else { Tracer::Cpu };
    if !on_gpu {
        if photons {
            state.lit_on_gpu.forget();
            clock.run("virtual lights", &mut told, || virtual_lights(state, level, scene, settings, stats));
        }
        stats.tracer_fallback.clone_from(&state.tracer_fallback);
    }
    // Without VPLs there is no grid either.
    let indirect = match near_field {
        _ if trace_vpls => Indirect::Layer(&traced.indirect),
        NearField::Light if state.grid.is_built() => Indirect::VplsAnd(state.grid.points()),
        NearField::Full if state.grid.is_built() => Indirect::Grid(state.grid.points()),
        _ => Indirect::Vpls,
    };
    if !on_gpu {
        clock.run("submit light", &mut ms.transfer, || gpu.light(&state.photons.vpls, bound, visibility, indirect))?;
        settle(gpu, clock)?;
        return Ok(false);
    }
    clock.run("record light", &mut ms.transfer, || {
        gpu.record_light(&state.photons.vpls, bound, visibility, indirect)?;
        gpu.trace()?;
        gpu.compose_traced()
    })?;
    Ok(true)
}

/// Brings the GPU's tracer up to the scene; false where the CPU traces: by choice, or because the scene is too large for the
/// adapter and `Auto` may fall back.
fn traces_on_gpu(
    state: &mut FrameState,
    gpu: &mut GpuRaster,
    wanted: Wanted,
    geometry_term_max: f32,
    paths: &Option<(LightPaths, bool)>,
) -> Result<bool, RenderError> {
    let Wanted { scene, settings, .. } = wanted;
    if !settings.traced || gpu.tracer() == Tracer::Cpu {
        return Ok(false);
    }
    let few = settings.vpl.is_some_and(|v| v.mirrored > 0);
    let (accel, vpls) = (&state.accel, if few { &state.mirrored.vpls } else { &state.photons.vpls }.as_slice());
    let maps = !few && settings.vpl.is_some_and(|v| v.shadows == VplShadows::Maps);
    let prepared = if maps && vpls.len() > gpu.most_vpl_maps() as usize {
        let (wanted, most) = (vpls.len(), gpu.most_vpl_maps());
        Err(RenderError::Unavailable {
            choice: format!("--tracer {}", gpu.tracer().name()),
            missing: format!("{wanted} VPL maps, but this adapter holds {most}"),
        })
    } else {
        let interleave = settings.vpl.map_or(1, |v| v.interleave);
        let photons = paths.as_ref().map(|(paths, same)| PhotonInputs { paths, interleave, same: *same });
        gpu.prepare_trace(&RasterInputs { scene, accel, settings, vpls, geometry_term_max, photons })
    };
    match prepared {
        Ok(()) => Ok(true),
        Err(RenderError::Unavailable { choice, missing }) if state.automatic_tracer => {
            tracing::warn!("{choice}: {missing}; the CPU traces");
            state.tracer_fallback = Some(format!("{choice}: {missing}"));
            gpu.set_tracer(Tracer::Cpu, false)?;
            Ok(false)
        }
        Err(error) => Err(error),
    }
}

/// True where VPLs are made on the GPU: where nothing on the CPU looks at them, as their shadow maps and rays to them do, and
/// mirrors are lit by the same ones; VPLs that are kept from frame to frame are the CPU's.
fn photons_on_gpu(gpu: &GpuRaster, settings: &RenderSettings) -> bool {
    let alone = settings.vpl.is_some_and(|v| {
        v.shadows == VplShadows::Off
            && v.mirrored == 0
            && v.candidates == 1
            && v.near_field == NearField::Off
            && v.reuse == 0
    });
    settings.traced && gpu.has_photons() && alone
}

/// The paths that the GPU follows, and whether they and the scene are those of the frame before.
fn light_paths(state: &mut FrameState, scene: &RenderScene, settings: &RenderSettings) -> Option<(LightPaths, bool)> {
    let vpl = settings.vpl.as_ref()?;
    // The CPU's own are out of date from here on.
    state.lit_by.forget();
    state.photons.vpls.clear();
    state.emitters.clear();
    state.vpl_maps.clear();
    let same = state.lit_on_gpu.update(scene, settings, false);
    Some((state.photons.paths(scene, &state.normals, vpl, settings.seed), same))
}

/// What the CPU needs of the GPU's first passes: the list of masked pixels and, for the shading of hits, the moments.
fn fetch(
    state: &mut FrameState,
    gpu: &mut GpuRaster,
    level: SimdLevel,
    settings: &RenderSettings,
    plan: &ShadowPlan,
    ms: &mut StageTimes,
    clock: &mut Clock,
) -> Result<Vec<u32>, RenderError> {
    let masked = clock.run("wait for mask", &mut ms.transfer, || gpu.read_masked_pixels())?;
    if settings.traced && !masked.is_empty() && settings.shadows == Shadows::Moments {
        state.maps.plan.clone_from(plan);
        clock.run("read moments", &mut ms.transfer, || gpu.read_moments_into(&mut state.maps.maps))?;
        state.maps.make_levels(level);
        state.moments.forget();
    }
    Ok(masked)
}

/// The picture that was sent, and the counters that came with it.
fn deliver(
    state: &mut FrameState,
    gpu: &mut GpuRaster,
    read_back: bool,
    traced_on_gpu: bool,
    frame: &mut Frame,
    ms: &mut StageTimes,
    clock: &mut Clock,
) -> Result<(), RenderError> {
    if !read_back {
        return Ok(());
    }
    clock.run("wait for picture", &mut ms.transfer, || gpu.wait_for_picture())?;
    clock.run("read picture", &mut ms.transfer, || gpu.read_picture(&mut frame.image))?;
    if traced_on_gpu {
        let kept = gpu.kept_photons();
        let mut counts = gpu.read_trace_counts()?;
        if let Some(photons) = counts.photons.take() {
            if photons.capped > 0 {
                tracing::warn!("{} light paths met a cap of the GPU's tracer", photons.capped);
            }
            frame.stats.rays.photon += if kept { 0 } else { photons.rays };
            frame.stats.vpls = photons.vpls.len() as u32;
            state.photons.vpls = photons.vpls;
        }
        count_traced(&mut frame.stats, &counts);
    }
    Ok(())
}

fn count_traced(stats: &mut FrameStats, counts: &TracedCounts) {
    stats.masked_pixels = counts.masked;
    stats.rays.reflection += counts.reflection;
    stats.rays.refraction += counts.refraction;
    stats.rays.shadow += counts.shadow;
    stats.rays.vpl += counts.vpl;
    if counts.capped > 0 {
        tracing::warn!("{} pixels met a cap of the GPU's tracer", counts.capped);
    }
}

fn add_times(to: &mut StageTimes, more: &StageTimes) {
    to.direct += more.direct;
    to.traced += more.traced;
    to.transfer += more.transfer;
}

/// Whitted tracing of a list of masked pixels, in chunks over all threads.
fn trace_masked(
    state: &FrameState,
    wanted: Wanted,
    serial: u64,
    masked: &[u32],
    stats: &mut FrameStats,
) -> Vec<(u32, [f32; 3])> {
    let Wanted { level, scene, settings, .. } = wanted;
    if !settings.traced || masked.is_empty() {
        return Vec::new();
    }
    let mut ctx = context(state, level, scene, settings);
    ctx.serial = serial;
    if let Some(budget) = settings.ray_budget {
        let pixels = camera_rays::masked_pixels(&ctx, masked, &mut stats.rays);
        let left = budget.saturating_sub(stats.rays.total());
        let radiance = budget::trace(&ctx, &pixels, left, &mut stats.rays);
        return pixels.iter().zip(radiance).map(|(p, r)| (p.pixel, r.to_array())).collect();
    }
    let chunk = (settings.tile * settings.tile) as usize;
    let (lists, counts): (Vec<Vec<(u32, [f32; 3])>>, Vec<_>) = masked
        .par_chunks(chunk)
        .map(|list| {
            let mut counts = RayCounts::default();
            let (mut scratch, mut radiance) = (whitted::WhittedScratch::default(), Vec::new());
            let pixels: Vec<MaskedPixel> = camera_rays::masked_pixels(&ctx, list, &mut counts);
            whitted::trace(&ctx, &pixels, &mut scratch, &mut radiance, &mut counts);
            let traced = pixels.iter().zip(&radiance).map(|(p, r)| (p.pixel, r.to_array())).collect();
            (traced, counts)
        })
        .unzip();
    stats.rays = counts.into_iter().fold(stats.rays, RayCounts::merged);
    lists.concat()
}

fn blacken_non_finite(image: &mut Image, stats: &mut FrameStats) {
    let width = image.width as usize;
    for (i, p) in image.pixels.iter_mut().enumerate() {
        if !p.iter().all(|v| v.is_finite()) {
            *p = [0.0; 3];
            let place = ((i % width) as u32, (i / width) as u32);
            stats.non_finite = merge_non_finite(stats.non_finite, (1, Some(place)));
        }
    }
}
