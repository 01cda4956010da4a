//! Mirrors and glass on the GPU: the trees of [`crate::accel`] in six heaps of words, one WGSL source for a compute pass over
//! the compacted list of masked pixels, a fragment pass whose heaps are textures, and hardware ray queries.
//!
//! Nothing is read back to make the traced layer. What a frame sends grows with what moved alone.

mod heap;
mod layout;
mod photons;
pub(crate) mod probe;
pub(crate) mod query;
mod rayquery;
mod scene;
mod shaders;
mod waves;

use catoptra_engine::RenderScene;
use std::collections::HashMap;

use super::{
    device::Gpu,
    pipeline::{Slot, compute_pipeline, group, group_layout, pipeline_layout, uniform},
    readback::Mailbox,
    targets::{PictureTargets, RADIANCE_FORMAT, ShadowTargets, draw_pass},
};
use crate::{
    accel::Accel,
    error::RenderError,
    settings::{RenderSettings, ShadowFilter, Shadows, Tracer, VplShadows},
    twin::{shadow::ShadowPlan, vpl::Vpl},
};
use layout::TraceUniform;
use photons::GpuPhotons;
pub(crate) use photons::{PhotonInputs, ReadPhotons};
use rayquery::HardwareTrees;
use scene::TracerScene;
use shaders::{COUNTERS, HeapKind, Variant};
use waves::WaveTracer;

/// What a frame's tracer reads beside the scene.
pub(crate) struct TraceInputs<'a> {
    pub scene: &'a RenderScene,
    pub accel: &'a Accel,
    pub settings: &'a RenderSettings,
    pub plan: &'a ShadowPlan,
    /// Shadow moments were made in this frame.
    pub moments: bool,
    pub vpls: &'a [Vpl],
    pub geometry_term_max: f32,
    /// Texels a side of the VPLs' shadow maps on the GPU; 0: none.
    pub map_size: u32,
    /// VPLs are made here, in place of `vpls`.
    pub photons: Option<PhotonInputs<'a>>,
    /// Bytes from one chunk of the indirect pass to the next.
    pub chunk_stride: u64,
}

/// What the tracers counted of a frame. Zero where a tracer cannot count: the fragment pass knows the masked pixels alone.
#[derive(Clone, Debug, Default)]
pub(crate) struct TracedCounts {
    pub masked: u64,
    /// Mirror and Fresnel reflection.
    pub reflection: u64,
    pub refraction: u64,
    /// Towards lights.
    pub shadow: u64,
    /// Towards VPLs.
    pub vpl: u64,
    /// Pixels that met a cap: 0, or the trees are broken or paths deeper than 2²⁴ rays.
    pub capped: u64,
    /// VPLs that were made there.
    pub photons: Option<ReadPhotons>,
}

impl TracedCounts {
    /// * `words`: masked pixels, then the counters, as far as there are any, then VPLs, where they were made
    pub fn of(words: &[u32]) -> Self {
        let [masked, reflection, refraction, shadow, vpl, capped] =
            std::array::from_fn(|i| words.get(i).map_or(0, |w| u64::from(*w)));
        let photons = words.get(1 + COUNTERS as usize..).filter(|w| !w.is_empty()).map(ReadPhotons::of);
        Self { masked, reflection, refraction, shadow, vpl, capped, photons }
    }
}

enum Pipeline {
    Compute(wgpu::ComputePipeline),
    Fragment(wgpu::RenderPipeline),
}

/// One of the tracers on one device.
pub(crate) struct GpuTracer {
    pub kind: Tracer,
    pub scene: TracerScene,
    /// None for the fragment pass, which has no storage to write to.
    photons: Option<GpuPhotons>,
    /// The frame's VPLs are made here.
    makes_photons: bool,
    hardware: Option<HardwareTrees>,
    layout: wgpu::BindGroupLayout,
    group: Option<wgpu::BindGroup>,
    pipelines: HashMap<Variant, Pipeline>,
    variant: Variant,
    uniform: wgpu::Buffer,
    written: Option<TraceUniform>,
    masked: wgpu::Buffer,
    args: wgpu::Buffer,
    args_pipeline: wgpu::ComputePipeline,
    args_layout: wgpu::BindGroupLayout,
    args_group: Option<wgpu::BindGroup>,
    counters: wgpu::Buffer,
    /// In place of the one kernel, for measurements.
    waves: Option<WaveTracer>,
}

/// What keeps a device from running a tracer, in words; `None`: nothing.
pub(crate) fn missing(kind: Tracer, device: &wgpu::Device) -> Option<String> {
    let limits = device.limits();
    match kind {
        Tracer::RayQuery if !device.features().contains(wgpu::Features::EXPERIMENTAL_RAY_QUERY) => {
            Some(format!("{} has no ray queries (EXPERIMENTAL_RAY_QUERY)", device.adapter_info().name))
        }
        Tracer::GpuFragment if limits.max_sampled_textures_per_shader_stage < 11 => {
            Some(format!("{} reads fewer than 11 textures a stage", device.adapter_info().name))
        }
        _ => None,
    }
}

impl GpuTracer {
    /// Makes the tracer and compiles its usual kernel, so that no frame waits for it.
    ///
    /// # Errors
    /// [`RenderError::Unavailable`] with what is missing.
    pub fn new(gpu: &Gpu, kind: Tracer, kd: bool) -> Result<Self, RenderError> {
        if let Some(missing) = missing(kind, &gpu.device) {
            return Err(RenderError::Unavailable { choice: format!("--tracer {}", kind.name()), missing });
        }
        let heaps = if kind == Tracer::GpuFragment { HeapKind::Texture } else { HeapKind::Storage };
        let rayquery = kind == Tracer::RayQuery;
        let scene = TracerScene::new(gpu, heaps, rayquery);
        let mut slots = vec![Slot::Uniform, Slot::TextureUint, Slot::TextureArray, Slot::TextureArray, Slot::Texture];
        let visibility = match heaps {
            HeapKind::Storage => {
                let own = [Slot::Storage(true), Slot::Storage(false), Slot::Write(RADIANCE_FORMAT), Slot::Uniform];
                slots.extend(own);
                wgpu::ShaderStages::COMPUTE
            }
            HeapKind::Texture => {
                slots.push(Slot::Texture);
                wgpu::ShaderStages::FRAGMENT
            }
        };
        let layout = group_layout(gpu, "tracer.group", visibility, &slots);
        let args_slots = [Slot::Storage(true), Slot::Storage(false)];
        let args_layout = group_layout(gpu, "tracer.args", wgpu::ShaderStages::COMPUTE, &args_slots);
        let variant = Variant { kd: kd && !rayquery, rayquery, ..Variant::new(heaps) };
        let module = module(gpu, "args", &variant);
        let args_pipeline_layout = pipeline_layout(gpu, "tracer.args", None, Some(&args_layout));
        let storage = |label, size, usage| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage,
                mapped_at_creation: false,
            })
        };
        use wgpu::BufferUsages as U;
        let photons = (heaps == HeapKind::Storage).then(|| GpuPhotons::new(gpu, &scene, variant));
        let mut tracer = Self {
            kind,
            scene,
            photons,
            makes_photons: false,
            hardware: rayquery.then(HardwareTrees::default),
            layout,
            group: None,
            pipelines: HashMap::new(),
            variant,
            uniform: uniform(gpu, "tracer.uniform", size_of::<TraceUniform>() as u64),
            written: None,
            masked: uniform(gpu, "tracer.masked", 16),
            args: storage("tracer.dispatch", 16, U::STORAGE | U::INDIRECT | U::COPY_SRC),
            args_pipeline: compute_pipeline(gpu, &module, &args_pipeline_layout, "prepare"),
            args_layout,
            args_group: None,
            counters: storage("tracer.counters", u64::from(COUNTERS) * 4, U::STORAGE | U::COPY_SRC | U::COPY_DST),
            waves: None,
        };
        tracer.compile(gpu, variant);
        Ok(tracer)
    }

    fn compile(&mut self, gpu: &Gpu, variant: Variant) {
        if self.pipelines.contains_key(&variant) {
            return;
        }
        let layout = pipeline_layout(gpu, "tracer", Some(&self.scene.layout), Some(&self.layout));
        let pipeline = match variant.heaps {
            HeapKind::Storage => {
                let module = module(gpu, "trace", &variant);
                Pipeline::Compute(compute_pipeline(gpu, &module, &layout, "trace_masked"))
            }
            HeapKind::Texture => {
                let module = module(gpu, "trace_fragment", &variant);
                Pipeline::Fragment(fragment_pipeline(gpu, &module, &layout))
            }
        };
        self.pipelines.insert(variant, pipeline);
    }

    /// From the next frame on the layer holds, in place of light, each pixel's rays and the steps of their walks; compute pass
    /// over the project's own trees alone.
    pub fn show_work(&mut self, on: bool) {
        self.variant.work = on && self.variant.heaps == HeapKind::Storage;
    }

    /// Textures of the picture or of the shadows were replaced.
    pub fn unbind(&mut self) {
        self.group = None;
        self.args_group = None;
        if let Some(waves) = &mut self.waves {
            waves.unbind();
        }
    }

    /// Sends what changed.
    ///
    /// # Errors
    /// [`RenderError::Unavailable`]: the scene is beyond what this adapter binds, with figures.
    pub fn prepare(
        &mut self,
        gpu: &Gpu,
        inputs: &TraceInputs,
        [frame, srgb_table]: [&wgpu::Buffer; 2],
    ) -> Result<(), RenderError> {
        let choice = || format!("--tracer {}", self.kind.name());
        let refused = |missing: String, choice: String| RenderError::Unavailable { choice, missing };
        let (settings, rayquery) = (inputs.settings, self.hardware.is_some());
        let mut replaced = self
            .scene
            .update(gpu, inputs.scene, inputs.accel, inputs.plan, rayquery)
            .map_err(|missing| refused(missing, choice()))?;
        self.makes_photons = false;
        let mut vpl_count = inputs.vpls.len() as u32;
        replaced |= match (&inputs.photons, &mut self.photons) {
            (Some(own), Some(photons)) => {
                self.makes_photons = true;
                let made = photons.prepare(gpu, own, &mut self.scene, inputs.geometry_term_max, inputs.chunk_stride);
                vpl_count = photons.most();
                made
            }
            _ => self.scene.update_vpls(gpu, inputs.vpls),
        }
        .map_err(|missing| refused(missing, choice()))?;
        if let Some(hardware) = &mut self.hardware {
            replaced |= hardware
                .update(gpu, inputs.scene, inputs.accel)
                .map_err(|missing| refused(missing, format!("--tracer {}", Tracer::RayQuery.name())))?;
        }
        if replaced || self.scene.group.is_none() {
            self.scene.bind(gpu, frame, srgb_table, self.hardware.as_ref().and_then(|h| h.tlas.as_ref()));
        }
        self.variant = Variant {
            traced_shadows: matches!(settings.shadows, Shadows::Traced | Shadows::Certified),
            traced_vpls: settings.vpl.is_some_and(|v| v.shadows == VplShadows::Traced && v.mirrored == 0),
            rays: match layout::waiting_rays(settings.max_depth, settings.min_weight) {
                few if few <= Variant::FEW_RAYS => Variant::FEW_RAYS,
                _ => 64,
            },
            levels: if self.scene.levels <= Variant::FEW_LEVELS { Variant::FEW_LEVELS } else { Variant::ALL_LEVELS },
            kd: inputs.accel.flat_is_kd() && !rayquery,
            ..self.variant
        };
        self.compile(gpu, self.variant);
        if let Some(waves) = &mut self.waves {
            waves.compile(gpu, &self.scene.layout, self.variant);
        }
        if let Some(photons) = &mut self.photons {
            photons.compile(gpu, &self.scene, self.variant);
            photons.valid &= self.makes_photons;
        }
        let data = TraceUniform {
            max_depth: settings.max_depth,
            min_weight: settings.min_weight,
            ray_cap: layout::ray_cap(settings.max_depth),
            vpl_count,
            // Infinity is no number for a shader.
            geometry_term_max: inputs.geometry_term_max.min(f32::MAX),
            map_size: inputs.map_size,
            visibility: if inputs.moments {
                super::layouts::VISIBILITY_MOMENTS
            } else {
                super::layouts::VISIBILITY_NONE
            },
            min_variance: settings.moments.min_variance,
            light_bleed_reduction: settings.moments.light_bleed_reduction,
            evsm: u32::from(settings.moments.filter == ShadowFilter::Evsm4),
            shadow_samples: settings.shadow_samples,
            seed: settings.seed,
        };
        if self.written != Some(data) {
            gpu.upload(&self.uniform, 0, bytemuck::bytes_of(&data));
            self.written = Some(data);
        }
        Ok(())
    }

    fn bind(&mut self, gpu: &Gpu, t: &PictureTargets, shadows: &ShadowTargets, vpl_maps: &wgpu::TextureView) {
        let view = |v| wgpu::BindingResource::TextureView(v);
        let mut resources = vec![
            self.uniform.as_entire_binding(),
            view(&t.visibility.view),
            view(&shadows.maps.moments.view),
            view(&shadows.faces.moments.view),
            view(vpl_maps),
        ];
        match self.variant.heaps {
            HeapKind::Storage => resources.extend([
                t.pixels.as_entire_binding(),
                self.counters.as_entire_binding(),
                view(&t.traced.view),
                self.masked.as_entire_binding(),
            ]),
            HeapKind::Texture => resources.push(view(&t.base_color.view)),
        }
        self.group = Some(group(gpu, "tracer.group", &self.layout, &resources));
        let args = [t.blocks.as_entire_binding(), self.args.as_entire_binding()];
        self.args_group = Some(group(gpu, "tracer.args", &self.args_layout, &args));
    }

    /// True where this tracer can make VPLs.
    pub fn has_photons(&self) -> bool {
        self.photons.is_some()
    }

    /// Most VPLs of the frame that [`Self::prepare`] saw, where they are made here.
    pub fn made_vpls(&self) -> Option<u32> {
        self.photons.as_ref().filter(|_| self.makes_photons).map(GpuPhotons::most)
    }

    /// Fills the indirect pass's chunks and the tracer's own list with VPLs.
    /// * `emptied`: the chunks' buffer is new
    pub fn record_photons(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        chunks: &wgpu::Buffer,
        stride: u64,
        emptied: bool,
    ) {
        let (Some(photons), Some(scene)) = (&mut self.photons, &self.scene.group) else {
            unreachable!("prepare comes first");
        };
        if let Some(hardware) = &mut self.hardware {
            hardware.build(encoder);
        }
        photons.record(encoder, scene, self.variant, (chunks, stride), emptied);
    }

    /// Writes the traced layer of the frame that [`Self::prepare`] saw.
    /// * `vpl_maps`: a row a map
    pub fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        targets: &PictureTargets,
        shadows: &ShadowTargets,
        vpl_maps: &wgpu::TextureView,
    ) {
        if self.group.is_none() {
            self.bind(gpu, targets, shadows, vpl_maps);
        }
        let (Some(own), Some(args), Some(scene)) = (&self.group, &self.args_group, &self.scene.group) else {
            unreachable!("prepare and bind come first");
        };
        if let Some(hardware) = &mut self.hardware {
            hardware.build(encoder);
        }
        match &self.pipelines[&self.variant] {
            Pipeline::Compute(pipeline) => {
                draw_pass(encoder, "traced.clear", &targets.traced.view, wgpu::Color::BLACK, None);
                encoder.clear_buffer(&self.counters, 0, None);
                {
                    let mut pass = compute_pass(encoder, "tracer.args");
                    pass.set_pipeline(&self.args_pipeline);
                    pass.set_bind_group(1, args, &[]);
                    pass.dispatch_workgroups(1, 1, 1);
                }
                encoder.copy_buffer_to_buffer(&self.args, 12, &self.masked, 0, 4);
                if self.waves.is_some() {
                    self.record_waves(gpu, encoder, (targets, shadows), vpl_maps);
                    return;
                }
                let mut pass = compute_pass(encoder, "tracer");
                pass.set_pipeline(pipeline);
                pass.set_bind_group(0, scene, &[]);
                pass.set_bind_group(1, own, &[]);
                pass.dispatch_workgroups_indirect(&self.args, 0);
            }
            Pipeline::Fragment(pipeline) => {
                let mut pass = draw_pass(encoder, "tracer", &targets.traced.view, wgpu::Color::BLACK, None);
                pass.set_pipeline(pipeline);
                pass.set_bind_group(0, scene, &[]);
                pass.set_bind_group(1, own, &[]);
                pass.draw(0..3, 0..1);
            }
        }
    }

    /// Bytes of [`Self::record_read`].
    pub fn read_bytes(&self) -> u64 {
        let counters = if self.variant.heaps == HeapKind::Storage { u64::from(COUNTERS) * 4 } else { 0 };
        counters + self.photons.as_ref().filter(|_| self.makes_photons).map_or(0, GpuPhotons::read_bytes)
    }

    /// Where VPLs are made here: whether those of the frame before were kept.
    pub fn kept_photons(&self) -> bool {
        self.photons.as_ref().is_some_and(GpuPhotons::kept)
    }

    /// Records that the counters come back; the fragment pass has none.
    pub fn record_read(&self, encoder: &mut wgpu::CommandEncoder, mailbox: &mut Mailbox) {
        if self.variant.heaps == HeapKind::Storage {
            mailbox.buffer(encoder, &self.counters, 0, u64::from(COUNTERS) * 4);
        }
        if let Some(photons) = self.photons.as_ref().filter(|_| self.makes_photons) {
            photons.record_read(encoder, mailbox, &self.scene);
        }
    }
}

fn compute_pass<'e>(encoder: &'e mut wgpu::CommandEncoder, label: &str) -> wgpu::ComputePass<'e> {
    encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some(label), timestamp_writes: None })
}

fn module(gpu: &Gpu, kernel: &str, variant: &Variant) -> wgpu::ShaderModule {
    gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(kernel),
        source: wgpu::ShaderSource::Wgsl(shaders::text(kernel, variant).into()),
    })
}

fn fragment_pipeline(gpu: &Gpu, module: &wgpu::ShaderModule, layout: &wgpu::PipelineLayout) -> wgpu::RenderPipeline {
    gpu.count_pipeline();
    gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("tracer.fragment"),
        layout: Some(layout),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("vertex"),
            compilation_options: Default::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: None,
        multisample: Default::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some("fragment"),
            compilation_options: Default::default(),
            targets: &[Some(RADIANCE_FORMAT.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
