//! For tests: shared WGSL functions evaluated over a table of inputs on the GPU.

use super::{
    device::{Gpu, GrowBuffer},
    pipeline::{Slot, compute_pipeline, group, group_layout, linear_dispatch, pipeline_layout},
    readback::Readback,
    shader,
    tracer::{
        PhotonInputs,
        probe::{HeldScene, TEXTURE_SLOTS},
    },
};
use crate::{
    error::RenderError,
    trace::{
        explain::local_light,
        facet::Facet,
        near::NearLights,
        photons::LightPaths,
        points::Emitter,
        shade::FrameContext,
        surface::{NormalMatrices, Surface},
    },
    twin::{grid::IrradianceGrid, shadow::ShadowMaps, vpl::Vpl, vpl_maps::VplMaps},
};

pub use super::{
    compact::ListOrder,
    shader::{PASSES, SHARED, stitch},
};

/// What [`super::GpuRaster::inject_fault`] does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InjectedFault {
    /// The device is destroyed: every further call on it fails.
    DeviceLost,
    /// The device reports that its memory is full.
    OutOfMemory,
}

/// How the compute tracer goes by waves ([`super::GpuRaster::trace_by_waves`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Waves {
    /// Waves that are recorded.
    pub most: u32,
    /// What is left behind them is followed to its end by the one kernel's loop, a ray an invocation; else it counts as having
    /// met a cap.
    pub finish: bool,
    /// Rays are walked and shaded by a kernel each.
    pub two_kernels: bool,
}

/// Hits of a list of rays from the compute tracer.
pub struct TracedHits {
    /// One a ray.
    pub hits: Vec<crate::accel::Hit>,
    /// Rays whose walk met its cap.
    pub capped: usize,
    /// Milliseconds of the dispatch.
    pub milliseconds: f64,
}

/// A device for evaluating shader functions.
pub struct ShaderProbe {
    gpu: Gpu,
}

impl ShaderProbe {
    /// On the best adapter.
    ///
    /// # Errors
    /// As [`super::GpuRaster::new`].
    pub fn new() -> Result<Self, RenderError> {
        Ok(Self { gpu: Gpu::open()? })
    }

    /// The compute tracer's closest hits of `rays` in `scene`, which `accel` follows.
    ///
    /// # Errors
    /// [`RenderError::Unavailable`] where the scene is beyond the adapter; [`RenderError::Gpu`].
    pub fn closest_hits(
        &self,
        scene: &catoptra_engine::RenderScene,
        accel: &crate::accel::Accel,
        rays: &[crate::accel::Ray],
    ) -> Result<TracedHits, RenderError> {
        let q = super::tracer::query::closest_hits(&self.gpu, scene, accel, rays)?;
        Ok(TracedHits { hits: q.hits, capped: q.capped, milliseconds: q.milliseconds })
    }

    /// Evaluates WGSL statements once for each row of `inputs`.
    ///
    /// `imports` are names such as `shared/shadow`. In `body`, `x[i]` is the row's i-th input and `y[i]` its i-th output.
    /// * `inputs`: rows of `N` numbers
    ///
    /// Returns rows of `M` numbers.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] where the text does not compile or the device fails.
    pub fn evaluate<const N: usize, const M: usize>(
        &self,
        imports: &[&str],
        body: &str,
        inputs: &[[f32; N]],
    ) -> Result<Vec<[f32; M]>, RenderError> {
        let mut source: String = imports.iter().map(|i| format!("#import {i}\n")).collect();
        source.push_str(&kernel::<N, M>(body, inputs.len()));
        run(&self.gpu, &shader::stitch_source("probe", &source), None, inputs)
    }

    /// A scene in the compute tracer's heaps, whose functions can then be evaluated.
    ///
    /// # Errors
    /// As [`Self::closest_hits`].
    pub fn hold(
        &self,
        scene: &catoptra_engine::RenderScene,
        accel: &crate::accel::Accel,
    ) -> Result<SceneProbe<'_>, RenderError> {
        let plan = crate::twin::shadow::ShadowPlan::new(&scene.lights, scene.bounds_world(), &Default::default());
        let maps = ShadowMaps { plan, ..ShadowMaps::default() };
        let (vpls, vpl_maps) = (&[], &VplMaps::default());
        self.hold_lit(scene, accel, &LitBy { maps: &maps, vpls, vpl_maps, traced_shadows: false, traced_vpls: false })
    }

    /// [`Self::hold`] with all that hits are shaded by.
    ///
    /// # Errors
    /// As [`Self::closest_hits`].
    pub fn hold_lit(
        &self,
        scene: &catoptra_engine::RenderScene,
        accel: &crate::accel::Accel,
        lit: &LitBy,
    ) -> Result<SceneProbe<'_>, RenderError> {
        Ok(SceneProbe { gpu: &self.gpu, held: HeldScene::new(&self.gpu, scene, accel, lit)? })
    }
}

/// What the tracer shades hits by, beside the scene.
#[derive(Clone, Copy)]
pub struct LitBy<'a> {
    /// Plan of the lights' views, and filtered moments of each; without maps where none are read.
    pub maps: &'a ShadowMaps,
    /// VPLs.
    pub vpls: &'a [Vpl],
    /// Their shadow maps; of size 0: none.
    pub vpl_maps: &'a VplMaps,
    /// Rays to lights decide.
    pub traced_shadows: bool,
    /// Rays to VPLs decide.
    pub traced_vpls: bool,
}

/// VPLs that the tracer's kernels made.
#[derive(Clone, Debug, Default)]
pub struct TracedPhotons {
    /// Those with flux, in their order.
    pub vpls: Vec<Vpl>,
    /// Rays followed.
    pub rays: u64,
    /// Paths whose walk met its cap.
    pub capped: u64,
    /// What the indirect pass reads, a chunk each: count of its VPLs, of those before it, the bound of the geometry term as
    /// bits and 0; count of all VPLs, side of the interleaved blocks, 0 and 0; then three words a VPL.
    pub chunks: Vec<Vec<[u32; 4]>>,
}

/// A scene as the compute tracer holds it: see [`ShaderProbe::hold`].
pub struct SceneProbe<'a> {
    gpu: &'a Gpu,
    held: HeldScene,
}

impl SceneProbe<'_> {
    /// [`ShaderProbe::evaluate`] with everything that `shaders/tracer` has in reach: heaps, walks, surfaces, media, optics.
    /// * `edits`: pieces of the WGSL, each of which stands there once, and what takes their places: faults that a test must
    ///   notice, counters
    ///
    /// # Errors
    /// As [`ShaderProbe::evaluate`].
    ///
    /// # Panics
    /// Where a piece does not stand there once.
    pub fn evaluate<const N: usize, const M: usize>(
        &self,
        edits: &[(&str, &str)],
        body: &str,
        inputs: &[[f32; N]],
    ) -> Result<Vec<[f32; M]>, RenderError> {
        let mut text = self.held.text(&kernel::<N, M>(body, inputs.len()));
        for (from, to) in edits {
            assert_eq!(text.matches(from).count(), 1, "{from:?} stands once in the text");
            text = text.replace(from, to);
        }
        run(self.gpu, &text, Some(&self.held), inputs)
    }

    /// VPLs of `paths` by the kernels `photons` and `photons_pack`.
    /// * `edits`: as in [`Self::evaluate`], in either text
    /// * `interleave`: side of the blocks of pixels over which they are interleaved; 1: none
    ///
    /// # Errors
    /// As [`ShaderProbe::closest_hits`].
    ///
    /// # Panics
    /// Where a piece does not stand once in one of both texts.
    pub fn photons(
        &mut self,
        edits: &[(&str, &str)],
        paths: &LightPaths,
        interleave: u32,
        geometry_term_max: f32,
    ) -> Result<TracedPhotons, RenderError> {
        let met = std::cell::Cell::new(0);
        let edit = |_: &str, text: String| {
            edits.iter().fold(text, |text, (from, to)| {
                met.set(met.get() + text.matches(from).count());
                text.replace(from, to)
            })
        };
        let inputs = PhotonInputs { paths, interleave, same: false };
        let (read, words, stride) = self.held.photons(self.gpu, &inputs, geometry_term_max, &edit)?;
        assert_eq!(met.get(), edits.len(), "each of {edits:?} stands once in both texts together");
        let chunks = words.chunks_exact(stride).map(<[_]>::to_vec).collect();
        Ok(TracedPhotons { vpls: read.vpls, rays: read.rays, capped: read.capped, chunks })
    }
}

/// What the CPU's tracer shades hits by, for [`light_at`].
#[derive(Clone, Copy)]
pub struct ShadedBy<'a> {
    /// The scene.
    pub scene: &'a catoptra_engine::RenderScene,
    /// Normal matrices of its instances.
    pub normals: &'a NormalMatrices,
    /// Its structure, up to date.
    pub accel: &'a crate::accel::Accel,
    /// Lights' moments, VPLs, their maps.
    pub lit: LitBy<'a>,
    /// The frame's settings.
    pub settings: &'a crate::settings::RenderSettings,
    /// Bound of the geometry term, 1/m².
    pub geometry_term_max: f32,
}

/// Light of a surface towards `wo` by the CPU's own way for what mirrors and glass show.
/// * `pixel`: number of the picture's pixel
pub fn light_at(by: &ShadedBy, s: &Surface, wo: glam::Vec3, pixel: u32) -> glam::Vec3 {
    let emitters: Vec<Emitter> = by.lit.vpls.iter().map(Emitter::from).collect();
    let ctx = FrameContext {
        scene: by.scene,
        normals: by.normals,
        accel: by.accel,
        maps: by.lit.maps,
        vpls: by.lit.vpls,
        emitters: &emitters,
        vpl_maps: by.lit.vpl_maps,
        near_lights: &NearLights::default(),
        mirrored: None,
        grid: &IrradianceGrid::default(),
        geometry_term_max: by.geometry_term_max,
        settings: by.settings,
        level: crate::settings::SimdLevel::Portable,
        serial: 1,
    };
    let (direct, indirect) = local_light(&ctx, s, wo, pixel, false);
    direct + indirect
}

/// True where the hit falls into a hole, by the CPU's own way.
pub fn is_hole(accel: &crate::accel::Accel, hit: &crate::accel::Hit) -> bool {
    accel.is_hole(hit)
}

/// The surface that `hit` met by the tracer's own way to it: a kept triangle for plain materials, else
/// [`crate::trace::surface::surface_seen`].
pub fn surface_by_facet(
    scene: &catoptra_engine::RenderScene,
    normals: &NormalMatrices,
    ray: &crate::accel::Ray,
    hit: &crate::accel::Hit,
    pixel_width: f32,
) -> Surface {
    let facet = Facet::new(scene, normals, hit.instance_id, hit.primitive_id);
    facet.surface_seen(scene, normals, ray, hit, pixel_width)
}

/// Mirror direction of the direction of travel `d`, above the triangle's horizon: the tracer's own.
pub fn mirrored(d: glam::Vec3, n_shading: glam::Vec3, n_geometric: glam::Vec3) -> glam::Vec3 {
    crate::trace::optics::mirrored(d, n_shading, n_geometric)
}

/// Bindings and entry point around statements from `x` to `y`.
fn kernel<const N: usize, const M: usize>(body: &str, rows: usize) -> String {
    format!(
        "@group(1) @binding(0) var<storage, read> inputs: array<f32>;
@group(1) @binding(1) var<storage, read_write> outputs: array<f32>;
@compute @workgroup_size(64)
fn evaluate(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {{
    let row = (group.y * groups.x + group.x) * 64u + lane;
    if row >= {rows}u {{
        return;
    }}
    var x: array<f32, {N}>;
    for (var i = 0u; i < {N}u; i += 1u) {{
        x[i] = inputs[row * {N}u + i];
    }}
    var y: array<f32, {M}>;
    {body}
    for (var i = 0u; i < {M}u; i += 1u) {{
        outputs[row * {M}u + i] = y[i];
    }}
}}
"
    )
}

fn run<const N: usize, const M: usize>(
    gpu: &Gpu,
    text: &str,
    scene: Option<&HeldScene>,
    inputs: &[[f32; N]],
) -> Result<Vec<[f32; M]>, RenderError> {
    let rows = inputs.len();
    gpu.scoped(|| {
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC;
        let buffer = |label, numbers: usize| GrowBuffer::new(gpu, label, usage, numbers as u64 * 4);
        let (from, to) = (buffer("probe.inputs", rows * N), buffer("probe.outputs", rows * M));
        gpu.upload(&from.buffer, 0, bytemuck::cast_slice(inputs.as_flattened()));
        let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("probe"),
            source: wgpu::ShaderSource::Wgsl(text.into()),
        });
        let mut slots = vec![Slot::Storage(true), Slot::Storage(false)];
        let mut resources = vec![from.buffer.as_entire_binding(), to.buffer.as_entire_binding()];
        if let Some(scene) = scene {
            slots.extend(TEXTURE_SLOTS);
            resources.extend(scene.textures());
        }
        let layout = group_layout(gpu, "probe.group", wgpu::ShaderStages::COMPUTE, &slots);
        let pipeline_layout = pipeline_layout(gpu, "probe", scene.map(|s| s.group().0), Some(&layout));
        let pipeline = compute_pipeline(gpu, &module, &pipeline_layout, "evaluate");
        let own = group(gpu, "probe.group", &layout, &resources);
        let mut encoder = gpu.encoder("probe");
        {
            let mut pass = encoder
                .begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some("probe"), timestamp_writes: None });
            pass.set_pipeline(&pipeline);
            if let Some(scene) = scene {
                pass.set_bind_group(0, scene.group().1, &[]);
            }
            pass.set_bind_group(1, &own, &[]);
            let (x, y) = linear_dispatch(rows.div_ceil(64) as u64);
            pass.dispatch_workgroups(x, y, 1);
        }
        gpu.queue.submit([encoder.finish()]);
        let flat: Vec<f32> = Readback::new(gpu).buffer(gpu, &to.buffer, 0, (rows * M) as u64 * 4)?;
        Ok(flat.as_chunks::<M>().0.to_vec())
    })
}
