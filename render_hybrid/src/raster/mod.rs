//! The wgpu lane: shadow moments, G-buffer with material mask, direct and indirect light, composition.
//!
//! **Architecture invariant:** this module sees a [`RenderScene`], settings and a [`ShadowPlan`], never the ECS and never the
//! tracer. Each pass has a file here and a shader of the same name; group 0 is the frame, group 1 the pass. Buffers and
//! textures live from frame to frame and are replaced only when sizes change; what the GPU already holds is not sent again.
//!
//! No call panics because of the device: lost devices, full memory and validation errors come back as
//! [`RenderError::Gpu`].

mod blur;
mod compact;
mod compose;
mod device;
mod direct;
mod gbuffer;
mod host_view;
mod indirect;
mod layouts;
mod moments;
mod pipeline;
mod present;
mod readback;
mod scene_buffers;
mod shader;
mod targets;
#[doc(hidden)]
pub mod testing;
mod timer;
mod traced;
mod tracer;

use catoptra_engine::RenderScene;

pub use device::{AdapterSummary, list_adapters};
pub(crate) use host_view::HostView;

use crate::{
    error::RenderError,
    output::{Image, Layer},
    settings::{GlassShadows, RenderSettings, Shadows},
    twin::{shadow::ShadowPlan, vpl::Vpl, vpl_maps::VplMaps},
};
use device::Gpu;
use layouts::PackedLayer;
use readback::Readback;
use scene_buffers::SceneBuffers;
use targets::{PictureTargets, ShadowTargets};
use timer::StageTimer;
pub use tracer::TracedRays;
use tracer::{GpuTracer, TraceInputs};

/// Surfaces of all pixels, row by row from the top. Where nothing was met everything is 0 and `material` `u32::MAX`.
#[derive(Clone, Debug, Default)]
pub struct GBufferReadback {
    /// World space, metres.
    pub positions_world: Vec<[f32; 3]>,
    /// Unit normal of the triangle, on the viewer's side, world space.
    pub n_geometric: Vec<[f32; 3]>,
    /// Unit interpolated normal, on the viewer's side, world space.
    pub n_shading: Vec<[f32; 3]>,
    /// factor x texture x vertex colour, linear.
    pub base_color: Vec<[f32; 3]>,
    /// Index into the scene's materials.
    pub material: Vec<u32>,
}

/// Bindings that last as long as the textures and buffers behind them.
struct Bindings {
    blur: [blur::BlurGroups; 2],
    gbuffer: wgpu::BindGroup,
    compact: wgpu::BindGroup,
    direct: wgpu::BindGroup,
    indirect: indirect::IndirectGroups,
    compose: compose::ComposeGroups,
    present: wgpu::BindGroup,
}

/// What the tracer needs of a frame.
#[derive(Clone, Copy)]
pub(crate) struct RasterInputs<'a> {
    pub scene: &'a RenderScene,
    /// Up to the scene.
    pub accel: &'a crate::accel::Accel,
    pub settings: &'a RenderSettings,
    /// In the order of their maps.
    pub vpls: &'a [Vpl],
    /// 1/m²; +infinity: none.
    pub geometry_term_max: f32,
}

/// What one frame's passes need to know of each other.
#[derive(Clone, Copy)]
struct FrameState {
    settings: RenderSettings,
    /// Moments were made in this frame.
    moments: bool,
}

/// The GPU lane. Calls of one frame, in order: [`begin`](Self::begin), [`light`](Self::light),
/// [`compose`](Self::compose); what is read back lies between them.
///
/// All work is submitted and none is waited for, except by the `read_` functions.
pub struct GpuRaster {
    gpu: Gpu,
    scene: SceneBuffers,
    moments: moments::MomentsPass,
    blur: blur::BlurPass,
    gbuffer: gbuffer::GbufferPass,
    compact: compact::CompactPass,
    direct: direct::DirectPass,
    indirect: indirect::IndirectPass,
    compose: compose::ComposePass,
    present: present::PresentPass,
    layers: present::LayerPass,
    readback: Readback,
    timer: StageTimer,
    picture: PictureTargets,
    shadows: ShadowTargets,
    bindings: Option<Bindings>,
    plan: ShadowPlan,
    frame: Option<FrameState>,
    tracer: Option<GpuTracer>,
}

impl GpuRaster {
    /// The lane on the best adapter: a GPU before software.
    ///
    /// # Errors
    /// [`RenderError::Unavailable`] where no adapter can serve, with what is missing; [`RenderError::Gpu`] where the device
    /// fails.
    pub fn new() -> Result<Self, RenderError> {
        Self::build(Gpu::open()?)
    }

    /// The lane on a device of the host's; the handles are cheap clones. The host keeps its own error callbacks.
    ///
    /// # Errors
    /// As [`Self::new`]: the device must have been requested with 8 storage buffers and 4 storage textures a stage.
    pub fn from_device(device: wgpu::Device, queue: wgpu::Queue) -> Result<Self, RenderError> {
        Self::build(Gpu::borrow(device, queue)?)
    }

    fn build(gpu: Gpu) -> Result<Self, RenderError> {
        let parts = gpu.scoped(|| {
            let scene = SceneBuffers::new(&gpu);
            let frame = &scene.layout;
            Ok((
                moments::MomentsPass::new(&gpu, frame),
                blur::BlurPass::new(&gpu),
                gbuffer::GbufferPass::new(&gpu, frame),
                compact::CompactPass::new(&gpu),
                direct::DirectPass::new(&gpu, frame)?,
                indirect::IndirectPass::new(&gpu, frame)?,
                compose::ComposePass::new(&gpu),
                present::PresentPass::new(&gpu),
                present::LayerPass::new(&gpu, frame),
                PictureTargets::new(&gpu, 1, 1)?,
                ShadowTargets::new(&gpu, [(1, 1), (1, 1)])?,
                scene,
            ))
        })?;
        let (moments, blur, gbuffer, compact, direct, indirect, compose, present, layers, picture, shadows, scene) =
            parts;
        Ok(Self {
            readback: Readback::new(&gpu),
            timer: StageTimer::new(&gpu),
            gpu,
            scene,
            moments,
            blur,
            gbuffer,
            compact,
            direct,
            indirect,
            compose,
            present,
            layers,
            picture,
            shadows,
            bindings: None,
            plan: ShadowPlan::default(),
            frame: None,
            tracer: None,
        })
    }

    /// The adapter that runs.
    pub fn adapter(&self) -> &AdapterSummary {
        &self.gpu.summary
    }

    /// The device, for embedders who draw beside this lane.
    pub fn device(&self) -> (&wgpu::Device, &wgpu::Queue) {
        (&self.gpu.device, &self.gpu.queue)
    }

    /// For tests: breaks the device as a driver would.
    #[doc(hidden)]
    pub fn inject_fault(&mut self, fault: testing::InjectedFault) {
        match fault {
            testing::InjectedFault::DeviceLost => self.gpu.device.destroy(),
            testing::InjectedFault::OutOfMemory => self.gpu.report_fault("out of memory"),
        }
    }

    /// Runs a step with all device errors caught.
    fn step<T>(&mut self, work: impl FnOnce(&mut Self) -> Result<T, RenderError>) -> Result<T, RenderError> {
        // The scope needs the device while `self` is lent to the work: handles are cheap to clone.
        let guard = self.gpu.handles();
        guard.scoped(|| work(self))
    }

    /// Sends what changed and submits shadow moments, G-buffer, material mask and the compaction of masked pixels.
    ///
    /// `scene` and `settings` are valid ([`RenderScene::validate`], [`RenderSettings::invalid`]).
    ///
    /// # Errors
    /// [`RenderError::Gpu`] where the device fails or the scene is beyond its limits.
    pub fn begin(
        &mut self,
        scene: &RenderScene,
        settings: &RenderSettings,
        plan: &ShadowPlan,
    ) -> Result<(), RenderError> {
        self.frame = None;
        self.gpu.reset_counters();
        self.step(|s| s.begin_inner(scene, settings, plan))
    }

    fn begin_inner(
        &mut self,
        scene: &RenderScene,
        settings: &RenderSettings,
        plan: &ShadowPlan,
    ) -> Result<(), RenderError> {
        if (self.picture.width, self.picture.height) != (settings.width, settings.height) {
            self.unbind();
            let gpu = &self.gpu;
            self.picture = PictureTargets::new(gpu, settings.width, settings.height)?;
        }
        let moments = settings.shadows == Shadows::Moments && !plan.views.is_empty();
        let wanted = ShadowTargets::wanted(plan);
        if moments && !self.shadows.fits(wanted) {
            self.unbind();
            let gpu = &self.gpu;
            self.shadows = ShadowTargets::new(gpu, wanted)?;
        }
        self.scene.update(&self.gpu, scene, plan, settings.width, settings.height)?;
        if self.plan != *plan {
            self.plan.clone_from(plan);
        }
        self.bind();

        let Self { gpu, scene, moments: moments_pass, blur, gbuffer, compact, shadows, picture, timer, .. } = self;
        let Some(bindings) = &self.bindings else { unreachable!("bind comes first") };
        if moments {
            let mut stage = timer.begin(gpu, "moments");
            let clear_glass = settings.glass_shadows == GlassShadows::Clear;
            moments_pass.record(gpu, &mut stage.encoder, scene, plan, shadows, settings.moments.filter, clear_glass);
            for (kind, groups, used) in [
                (&shadows.maps, &bindings.blur[0], plan.lights.iter().any(|l| l.count == 1)),
                (&shadows.faces, &bindings.blur[1], plan.lights.iter().any(|l| l.count == 6)),
            ] {
                if used {
                    blur.record(&mut stage.encoder, groups, kind);
                }
            }
            timer.end(gpu, "moments", stage)?;
        }
        let mut stage = timer.begin(gpu, "gbuffer");
        gbuffer.record(&mut stage.encoder, scene, &bindings.gbuffer, picture);
        timer.end(gpu, "gbuffer", stage)?;
        let mut stage = timer.begin(gpu, "compact");
        compact.record(&mut stage.encoder, &bindings.compact, picture);
        timer.end(gpu, "compact", stage)?;
        self.frame = Some(FrameState { settings: *settings, moments });
        Ok(())
    }

    /// Textures are about to be replaced.
    fn unbind(&mut self) {
        self.bindings = None;
        if let Some(tracer) = &mut self.tracer {
            tracer.unbind();
        }
    }

    fn bind(&mut self) {
        if self.bindings.is_some() {
            return;
        }
        let (gpu, picture, shadows) = (&self.gpu, &self.picture, &self.shadows);
        self.bindings = Some(Bindings {
            blur: [self.blur.bind(gpu, &shadows.maps), self.blur.bind(gpu, &shadows.faces)],
            gbuffer: self.gbuffer.bind(gpu, picture),
            compact: self.compact.bind(gpu, picture),
            direct: self.direct.bind(gpu, picture, shadows),
            indirect: self.indirect.bind(gpu, picture),
            compose: self.compose.bind(gpu, picture),
            present: self.present.bind(gpu, &picture.last.view),
        });
    }

    fn begun(&self) -> Result<FrameState, RenderError> {
        self.frame.ok_or_else(|| RenderError::Gpu("no frame was begun, or its begin failed".into()))
    }

    /// Numbers y · width + x of the pixels that show mirror or glass, ascending. Waits for the G-buffer.
    ///
    /// # Errors
    /// [`RenderError::Gpu`]
    pub fn read_masked_pixels(&mut self) -> Result<Vec<u32>, RenderError> {
        self.begun()?;
        self.step(|s| s.compact.read(&s.gpu, &mut s.readback, &s.picture))
    }

    /// Blurred moments of every view of the plan, row 0 on top; empty where [`Shadows::Moments`] is not chosen.
    ///
    /// # Errors
    /// [`RenderError::Gpu`]
    pub fn read_moments(&mut self) -> Result<Vec<Vec<[f32; 4]>>, RenderError> {
        if !self.begun()?.moments {
            return Ok(Vec::new());
        }
        self.step(|s| {
            let mut out = Vec::with_capacity(s.plan.views.len());
            for (light, first) in s.plan.lights.iter().zip(scene_buffers::first_layers(&s.plan)) {
                let array = if light.count == 6 { &s.shadows.faces } else { &s.shadows.maps };
                for face in 0..light.count {
                    out.push(s.readback.texture(&s.gpu, &array.moments.texture, first + face)?);
                }
            }
            Ok(out)
        })
    }

    fn packed(&mut self, layer: PackedLayer) -> Result<Vec<[f32; 4]>, RenderError> {
        self.layers.read(&self.gpu, &mut self.readback, &self.scene, &self.picture, layer)
    }

    /// The surfaces of all pixels, for work that the CPU does on them (traced shadows, traced VPL visibility).
    ///
    /// # Errors
    /// [`RenderError::Gpu`]
    pub fn read_gbuffer(&mut self) -> Result<GBufferReadback, RenderError> {
        self.begun()?;
        let rgb = |pixels: Vec<[f32; 4]>| pixels.into_iter().map(|[r, g, b, _]| [r, g, b]).collect::<Vec<_>>();
        self.step(|s| {
            let places: Vec<[f32; 4]> = s.readback.texture(&s.gpu, &s.picture.position.texture, 0)?;
            let material = places.iter().map(|p| (p[3] as u32).wrapping_sub(1)).collect();
            Ok(GBufferReadback {
                positions_world: rgb(places),
                n_geometric: rgb(s.packed(PackedLayer::NormalGeometric)?),
                n_shading: rgb(s.packed(PackedLayer::NormalShading)?),
                base_color: rgb(s.packed(PackedLayer::Albedo)?),
                material,
            })
        })
    }

    /// Shadow maps for the VPLs of the next [`Self::light`], in the order of VPLs; of size 0: none. Sends them.
    ///
    /// # Errors
    /// [`RenderError::Gpu`], also where there are more maps than a texture has rows: see [`Self::most_vpl_maps`].
    pub fn set_vpl_maps(&mut self, maps: &VplMaps) -> Result<(), RenderError> {
        self.begun()?;
        self.step(|s| {
            let replaced = s.indirect.upload_maps(&s.gpu, maps)?;
            if let (true, Some(bindings)) = (replaced, &mut s.bindings) {
                bindings.indirect = s.indirect.bind(&s.gpu, &s.picture);
            }
            if let (true, Some(tracer)) = (replaced, &mut s.tracer) {
                tracer.unbind();
            }
            Ok(())
        })
    }

    /// Most VPLs whose maps this adapter holds.
    pub fn most_vpl_maps(&self) -> u32 {
        self.gpu.device.limits().max_texture_dimension_2d
    }

    /// Submits direct and indirect light.
    /// * `geometry_term_max`: bound of cos·cos/d² in 1/m²; +infinity: none
    /// * `light_visibility`: one value a pixel for each light, in [0, 1], in place of moments
    /// * `indirect`: a ready layer of linear radiance in place of the VPLs
    ///
    /// # Errors
    /// [`RenderError::Settings`] where a given layer has not the picture's size; [`RenderError::Gpu`].
    pub fn light(
        &mut self,
        vpls: &[Vpl],
        geometry_term_max: f32,
        light_visibility: Option<&[Vec<f32>]>,
        indirect: Option<&[[f32; 3]]>,
    ) -> Result<(), RenderError> {
        let frame = self.begun()?;
        self.step(|s| s.light_inner(frame, vpls, geometry_term_max, light_visibility, indirect))
    }

    fn light_inner(
        &mut self,
        frame: FrameState,
        vpls: &[Vpl],
        geometry_term_max: f32,
        light_visibility: Option<&[Vec<f32>]>,
        indirect: Option<&[[f32; 3]]>,
    ) -> Result<(), RenderError> {
        let gpu = &self.gpu;
        if let Some(planes) = light_visibility {
            let replaced = self.direct.upload_planes(gpu, planes, self.picture.width, self.picture.height)?;
            if let (true, Some(bindings)) = (replaced, &mut self.bindings) {
                bindings.direct = self.direct.bind(gpu, &self.picture, &self.shadows);
            }
        }
        let shadows = if frame.moments { Shadows::Moments } else { Shadows::Off };
        self.direct.set_options(gpu, shadows, light_visibility.is_some(), &frame.settings.moments);
        let mut chunks = 0;
        match indirect {
            Some(layer) => self.indirect.upload_layer(gpu, &self.picture, layer)?,
            None => {
                let (count, replaced) = self.indirect.upload(gpu, vpls, geometry_term_max);
                chunks = count;
                if let (true, Some(bindings)) = (replaced, &mut self.bindings) {
                    bindings.indirect = self.indirect.bind(gpu, &self.picture);
                }
            }
        }

        let Self { gpu, scene, direct, indirect: indirect_pass, picture, timer, .. } = self;
        let Some(bindings) = &self.bindings else { unreachable!("a frame was begun") };
        let mut stage = timer.begin(gpu, "direct");
        direct.record(&mut stage.encoder, scene, &bindings.direct, picture);
        timer.end(gpu, "direct", stage)?;
        if indirect.is_none() {
            let mut stage = timer.begin(gpu, "indirect");
            indirect_pass.record(&mut stage.encoder, scene, &bindings.indirect, picture, chunks);
            timer.end(gpu, "indirect", stage)?;
        }
        Ok(())
    }

    /// Submits final = direct + indirect + traced.
    /// * `traced`: pixel number y · width + x and linear radiance
    ///
    /// # Errors
    /// [`RenderError::Settings`] where a pixel lies outside the picture; [`RenderError::Gpu`].
    pub fn compose(&mut self, traced: &[(u32, [f32; 3])]) -> Result<(), RenderError> {
        self.begun()?;
        self.step(|s| {
            let replaced = s.compose.reserve(&s.gpu, traced.len());
            if let (true, Some(bindings)) = (replaced, &mut s.bindings) {
                bindings.compose = s.compose.bind(&s.gpu, &s.picture);
            }
            let Some(bindings) = &s.bindings else { unreachable!("a frame was begun") };
            let mut stage = s.timer.begin(&s.gpu, "compose");
            s.compose.record(&s.gpu, &mut stage.encoder, &bindings.compose, &s.picture, traced)?;
            s.timer.end(&s.gpu, "compose", stage)
        })
    }

    /// One layer of the frame, as [`Layer`] says. Waits for it.
    ///
    /// # Errors
    /// [`RenderError::Gpu`]
    pub fn read_layer(&mut self, layer: Layer) -> Result<Image, RenderError> {
        let frame = self.begun()?;
        self.step(|s| {
            let (width, height) = (s.picture.width, s.picture.height);
            let image = |pixels: Vec<[f32; 4]>| Image {
                width,
                height,
                pixels: pixels.into_iter().map(|[r, g, b, _]| [r, g, b]).collect(),
            };
            let texture = match layer {
                Layer::Final => &s.picture.last,
                Layer::Direct => &s.picture.direct,
                Layer::Indirect => &s.picture.indirect[0],
                Layer::Traced => &s.picture.traced,
                Layer::Mask => return Ok(image(s.packed(PackedLayer::Mask)?)),
                Layer::Depth => return Ok(image(s.packed(PackedLayer::Depth)?)),
                Layer::Normal => return Ok(image(s.packed(PackedLayer::Normal)?)),
                Layer::Albedo => return Ok(image(s.packed(PackedLayer::Albedo)?)),
                Layer::Moments => {
                    let Some(view) = s.plan.views.first().filter(|_| frame.moments) else {
                        return Ok(Image::new(1, 1));
                    };
                    let array =
                        if s.plan.lights[view.light as usize].count == 6 { &s.shadows.faces } else { &s.shadows.maps };
                    let map: Vec<[f32; 4]> = s.readback.texture(&s.gpu, &array.moments.texture, 0)?;
                    let pixels = map.into_iter().map(|[a, b, ..]| [a, b, 0.0]).collect();
                    return Ok(Image { width: view.size, height: view.size, pixels });
                }
            };
            Ok(image(s.readback.texture(&s.gpu, &texture.texture, 0)?))
        })
    }

    /// The final picture, linear radiance, `Rgba32Float`; replaced when the picture's size changes.
    pub fn final_view(&self) -> &wgpu::TextureView {
        &self.picture.last.view
    }

    /// Draws the final picture over all of `target`: radiance x 2^`exposure_ev`, clamped to [0, 1], sRGB curve (by the
    /// target where its format has it). Sizes may differ; the nearest pixel is taken.
    ///
    /// # Errors
    /// [`RenderError::View`] where the view is not fit, [`RenderError::Gpu`]
    pub fn present(
        &mut self,
        target: &wgpu::TextureView,
        format: wgpu::TextureFormat,
        exposure_ev: f32,
    ) -> Result<(), RenderError> {
        self.begun()?;
        let guard = self.gpu.handles();
        guard.scoped_view(|| {
            let s = self;
            s.present.prepare(&s.gpu, format, exposure_ev);
            let Some(bindings) = &s.bindings else { unreachable!("a frame was begun") };
            let mut encoder = s.gpu.encoder("present");
            s.present.record(&mut encoder, &bindings.present, target, format);
            s.gpu.queue.submit([encoder.finish()]);
            Ok(())
        })
    }

    /// (bytes sent to the GPU, bytes read back) since [`Self::begin`].
    pub fn counters(&self) -> (u64, u64) {
        self.gpu.counters()
    }

    /// Measures the passes from now on: by timestamps where the adapter has them, else by waiting after each stage, which
    /// keeps CPU and GPU from working at the same time.
    pub fn set_timing(&mut self, enabled: bool) {
        self.timer.enabled = enabled;
    }

    /// Milliseconds of `moments`, `gbuffer`, `compact`, `direct`, `indirect` and `compose` since the last call; empty where
    /// [`Self::set_timing`] is off. Waits for the GPU.
    ///
    /// # Errors
    /// [`RenderError::Gpu`]
    pub fn take_pass_times(&mut self) -> Result<Vec<(&'static str, f64)>, RenderError> {
        self.step(|s| s.timer.take(&s.gpu, &mut s.readback))
    }
}
