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
mod interleave;
mod layouts;
mod light_grid;
mod moments;
mod pipeline;
mod present;
mod readback;
mod reads;
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
pub use reads::GBufferReadback;

use crate::{
    error::RenderError,
    output::StageInterval,
    settings::{GlassShadows, RenderSettings, Shadows},
    twin::{
        grid::{self, GridPoint},
        shadow::ShadowPlan,
        vpl::Vpl,
        vpl_maps::VplMaps,
    },
};
use device::Gpu;
use readback::{Mailbox, Readback};
use scene_buffers::SceneBuffers;
use targets::{PictureTargets, ShadowTargets};
use timer::StageTimer;
use tracer::{GpuTracer, TraceInputs};
pub(crate) use tracer::{PhotonInputs, TracedCounts};

/// Where indirect light comes from.
#[derive(Clone, Copy, Debug)]
pub enum Indirect<'a> {
    /// The VPLs: on the grid where the settings want one, else at each pixel.
    Vpls,
    /// The VPLs on the grid, and what the CPU found close to its places, row by row.
    VplsAnd(&'a [GridPoint]),
    /// The VPLs, with the grid's points made by the CPU, row by row ([`grid::grid_size`]).
    Grid(&'a [GridPoint]),
    /// A ready layer of linear radiance, one a pixel.
    Layer(&'a [[f32; 3]]),
}

/// Bindings that last as long as the textures and buffers behind them.
struct Bindings {
    blur: [blur::BlurGroups; 2],
    gbuffer: wgpu::BindGroup,
    compact: wgpu::BindGroup,
    direct: wgpu::BindGroup,
    light_grid: light_grid::GridGroups,
    indirect: indirect::IndirectGroups,
    /// Where VPLs were interleaved.
    interleave: Option<wgpu::BindGroup>,
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
    /// The tracer makes the VPLs, in place of `vpls`.
    pub photons: Option<PhotonInputs<'a>>,
}

/// What one frame's passes need to know of each other.
#[derive(Clone, Copy)]
struct FrameState {
    settings: RenderSettings,
    /// Moments were made in this frame.
    moments: bool,
}

/// What comes back with the passes of a frame.
struct Mail {
    /// Which of the two below [`GpuRaster::begin`] records.
    wanted: (bool, bool),
    /// Number of masked pixels, and as many of them as are likely.
    masked: Mailbox,
    likely: u64,
    moments: Mailbox,
    picture: Mailbox,
    /// Number of masked pixels and the tracer's counters.
    counts: Mailbox,
    /// The timer's slot that comes with the picture.
    slot: usize,
}

/// The GPU lane. Calls of one frame, in order: [`begin`](Self::begin), [`light`](Self::light),
/// [`compose`](Self::compose); what is read back lies between them.
///
/// All work is submitted and none is waited for, except by the `read_` functions.
pub struct GpuRaster {
    gpu: Gpu,
    /// Recorded and not submitted.
    open: Option<wgpu::CommandEncoder>,
    mail: Mail,
    /// Every submission is waited for, so that stages can be timed apart.
    one_by_one: bool,
    scene: SceneBuffers,
    moments: moments::MomentsPass,
    blur: blur::BlurPass,
    gbuffer: gbuffer::GbufferPass,
    compact: compact::CompactPass,
    /// Other than the tracer's own, for measurements.
    list_order: Option<compact::ListOrder>,
    direct: direct::DirectPass,
    light_grid: light_grid::GridPass,
    indirect: indirect::IndirectPass,
    /// Where VPLs were interleaved.
    interleave: Option<interleave::InterleavePass>,
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
                light_grid::GridPass::new(&gpu, frame)?,
                indirect::IndirectPass::new(&gpu, frame)?,
                compose::ComposePass::new(&gpu),
                present::PresentPass::new(&gpu),
                present::LayerPass::new(&gpu, frame),
                PictureTargets::new(&gpu, 1, 1)?,
                ShadowTargets::new(&gpu, [(1, 1), (1, 1)])?,
                scene,
            ))
        })?;
        let (
            moments,
            blur,
            gbuffer,
            compact,
            direct,
            light_grid,
            indirect,
            compose,
            present,
            layers,
            picture,
            shadows,
            scene,
        ) = parts;
        Ok(Self {
            open: None,
            mail: Mail {
                wanted: (false, false),
                masked: Mailbox::new(&gpu, "compact.staging"),
                likely: 0,
                moments: Mailbox::new(&gpu, "moments.staging"),
                picture: Mailbox::new(&gpu, "compose.staging"),
                counts: Mailbox::new(&gpu, "tracer.staging"),
                slot: 0,
            },
            list_order: None,
            one_by_one: false,
            readback: Readback::new(&gpu),
            timer: StageTimer::new(&gpu),
            gpu,
            scene,
            moments,
            blur,
            gbuffer,
            compact,
            direct,
            light_grid,
            indirect,
            interleave: None,
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

    /// For measurements: the compute tracer's layer holds each pixel's rays, the steps of their walks, and 1, in place of light.
    #[doc(hidden)]
    pub fn show_work(&mut self, on: bool) {
        if let Some(tracer) = &mut self.tracer {
            tracer.show_work(on);
        }
    }

    /// For measurements: the order of the list of masked pixels; `None`: what suits the tracer.
    #[doc(hidden)]
    pub fn list_pixels_by(&mut self, order: Option<testing::ListOrder>) {
        self.list_order = order;
    }

    /// For measurements: the compute tracer's layer is made by queues, a wave a bounce; `None`: by its one kernel.
    #[doc(hidden)]
    pub fn trace_by_waves(&mut self, how: Option<testing::Waves>) {
        if let Some(tracer) = &mut self.tracer {
            tracer.trace_by_waves(&self.gpu, how);
        }
    }

    /// Runs a step with all device errors caught.
    fn step<T>(&mut self, work: impl FnOnce(&mut Self) -> Result<T, RenderError>) -> Result<T, RenderError> {
        // The scope needs the device while `self` is lent to the work: handles are cheap to clone.
        let guard = self.gpu.handles();
        guard.scoped(|| work(self))
    }

    /// Submits what was recorded; the answer tells when it is done.
    fn submit(&mut self) -> Result<wgpu::SubmissionIndex, RenderError> {
        let encoder = self.open.take().unwrap_or_else(|| self.gpu.encoder("frame"));
        Ok(self.gpu.queue.submit([encoder.finish()]))
    }

    /// For measurements: the CPU waits for every submission, so that nothing runs at the same time as anything else.
    #[doc(hidden)]
    pub fn set_one_by_one(&mut self, on: bool) {
        self.one_by_one = on;
    }

    /// True where [`Self::settle`] is asked for after every submission.
    pub(crate) fn is_one_by_one(&self) -> bool {
        self.one_by_one
    }

    /// Waits for all that was submitted.
    pub(crate) fn settle(&mut self) -> Result<(), RenderError> {
        self.step(|s| s.gpu.wait())
    }

    /// Which of list of masked pixels and shadow moments shall come back with the next [`Self::begin`]'s passes: reading them
    /// then waits for nothing that was submitted later.
    pub(crate) fn expect(&mut self, masked: bool, moments: bool) {
        self.mail.wanted = (masked, moments);
    }

    /// Times of the passes from the next [`Self::begin`] on belong to a frame of their own, while the one before is still on
    /// its way.
    /// * `beside`: it is
    pub(crate) fn begin_timing(&mut self, beside: bool) -> Result<(), RenderError> {
        self.step(|s| s.timer.begin_frame(&s.gpu, beside))
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
        self.open = None;
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

        let order = self.list_order();
        let Self {
            gpu, open, scene, moments: moments_pass, blur, gbuffer, compact, shadows, picture, timer, mail, ..
        } = self;
        let Some(bindings) = &self.bindings else { unreachable!("bind comes first") };
        let encoder = open.get_or_insert_with(|| gpu.encoder("frame"));
        if moments {
            timer.stage(gpu, encoder, "moments", |encoder| {
                let clear_glass = settings.glass_shadows == GlassShadows::Clear;
                moments_pass.record(gpu, encoder, scene, plan, shadows, settings.moments.filter, clear_glass);
                for (kind, groups, count) in
                    [(&shadows.maps, &bindings.blur[0], 1), (&shadows.faces, &bindings.blur[1], 6)]
                {
                    let mut lights = plan.lights.iter().filter(|l| l.count == count).peekable();
                    if lights.peek().is_some() {
                        let soft = lights.any(|l| plan.views[l.first as usize].softness > 0.0);
                        blur.record(encoder, groups, kind, soft);
                    }
                }
            })?;
        }
        timer.stage(gpu, encoder, "gbuffer", |encoder| gbuffer.record(encoder, scene, &bindings.gbuffer, picture))?;
        timer.stage(gpu, encoder, "compact", |encoder| compact.record(encoder, &bindings.compact, picture, order))?;
        // What the CPU waits for goes with the passes that make it; what nobody fetched is gone.
        mail.masked.open(gpu, 0);
        mail.moments.open(gpu, 0);
        let wanted = (mail.wanted.0, mail.wanted.1 && moments);
        if wanted.0 || wanted.1 {
            timer.stage(gpu, encoder, "send back", |encoder| {
                if wanted.0 {
                    let pixels = u64::from(settings.width) * u64::from(settings.height);
                    mail.likely = (mail.likely + mail.likely / 4 + 4096).min(pixels);
                    mail.masked.open(gpu, 4 + 4 * mail.likely);
                    compact.record_read(encoder, &mut mail.masked, picture, mail.likely);
                }
                if wanted.1 {
                    let maps = moment_maps(plan, shadows);
                    mail.moments.open(gpu, maps.iter().map(|(texture, _)| Mailbox::texture_bytes(texture)).sum());
                    for (texture, layer) in maps {
                        mail.moments.texture(encoder, texture, layer);
                    }
                }
            })?;
        }
        let submission = self.submit()?;
        if wanted.0 {
            self.mail.masked.sent(&submission);
        }
        if wanted.1 {
            self.mail.moments.sent(&submission);
        }
        self.frame = Some(FrameState { settings: *settings, moments });
        Ok(())
    }

    /// Order of the list of masked pixels: the CPU takes them ascending.
    fn list_order(&self) -> compact::ListOrder {
        let own = if self.tracer.is_some() { compact::ListOrder::Squares } else { compact::ListOrder::Rows };
        self.list_order.unwrap_or(own)
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
            light_grid: self.light_grid.bind(gpu, picture, &self.indirect),
            indirect: self.indirect.bind(gpu, picture, &self.light_grid),
            interleave: None,
            compose: self.compose.bind(gpu, picture),
            present: self.present.bind(gpu, &picture.last.view),
        });
    }

    /// Makes ready the filter of VPLs that are interleaved over blocks of `n` x `n` pixels.
    fn prepare_interleave(&mut self, n: u32) {
        let (gpu, frame) = (&self.gpu, &self.scene.layout);
        let pass = self.interleave.get_or_insert_with(|| interleave::InterleavePass::new(gpu, frame));
        pass.set(gpu, n);
        if let Some(bindings) = &mut self.bindings {
            bindings.interleave.get_or_insert_with(|| pass.bind(gpu, &self.picture));
        }
    }

    /// What the passes of indirect light share was replaced.
    fn bind_indirect(&mut self) {
        if let Some(bindings) = &mut self.bindings {
            bindings.light_grid = self.light_grid.bind(&self.gpu, &self.picture, &self.indirect);
            bindings.indirect = self.indirect.bind(&self.gpu, &self.picture, &self.light_grid);
        }
    }

    fn begun(&self) -> Result<FrameState, RenderError> {
        self.frame.ok_or_else(|| RenderError::Gpu("no frame was begun, or its begin failed".into()))
    }

    /// Submits what is left of the frame. With `read_back` the final picture comes with it, to be read by
    /// [`Self::read_picture`].
    /// * `slot`: whose times come, too ([`StageTimer`])
    pub(crate) fn finish(&mut self, read_back: bool, slot: usize) -> Result<(), RenderError> {
        self.step(|s| {
            let Self { gpu, open, mail, timer, picture, tracer, compact, .. } = s;
            let encoder = open.get_or_insert_with(|| gpu.encoder("frame"));
            if read_back {
                timer.stage(gpu, encoder, "send picture", |encoder| {
                    mail.picture.open(gpu, Mailbox::texture_bytes(&picture.last.texture));
                    mail.picture.texture(encoder, &picture.last.texture, 0);
                })?;
            }
            timer.resolve(gpu, encoder, slot);
            let counted = tracer.as_ref().filter(|_| read_back);
            if let Some(tracer) = counted {
                mail.counts.open(gpu, 4 + tracer.read_bytes());
                compact.record_read(encoder, &mut mail.counts, picture, 0);
                tracer.record_read(encoder, &mut mail.counts);
            }
            let counted = counted.is_some();
            let submission = s.submit()?;
            s.timer.sent(slot, &submission);
            s.mail.slot = slot;
            if read_back {
                s.mail.picture.sent(&submission);
            }
            if counted {
                s.mail.counts.sent(&submission);
            }
            Ok(())
        })
    }

    /// Submits what was recorded.
    pub(crate) fn submit_recorded(&mut self) -> Result<(), RenderError> {
        self.step(|s| s.submit().map(|_| ()))
    }

    /// The timer's slot of the frame that was begun, and of the other.
    pub(crate) fn timing_slots(&self) -> (usize, usize) {
        (self.timer.slot(), self.timer.slot() ^ 1)
    }

    /// Intervals of the stages whose times [`Self::finish`] sent.
    pub(crate) fn read_times(&mut self, out: &mut Vec<StageInterval>) -> Result<(), RenderError> {
        self.step(|s| s.timer.take(&s.gpu, s.mail.slot, out))
    }

    /// Shadow maps for the VPLs of the next [`Self::light`], in the order of VPLs; of size 0: none. Sends those that the GPU
    /// does not hold.
    ///
    /// # Errors
    /// [`RenderError::Gpu`], also where there are more maps than a texture has rows: see [`Self::most_vpl_maps`].
    pub fn set_vpl_maps(&mut self, maps: &VplMaps) -> Result<(), RenderError> {
        self.begun()?;
        self.step(|s| {
            let replaced = s.indirect.upload_maps(&s.gpu, maps)?;
            if replaced {
                s.bind_indirect();
            }
            if let (true, Some(tracer)) = (replaced, &mut s.tracer) {
                tracer.unbind();
            }
            Ok(())
        })
    }

    /// VPLs without shadows that light, from the next [`Self::light`] on, pixels of which the grid of light cannot tell
    /// ([`crate::VplOptions::spacing`]); `None`: all VPLs do.
    pub fn set_mirrored_vpls(&mut self, vpls: Option<&[Vpl]>) {
        self.indirect.set_few(vpls);
    }

    /// Most VPLs whose maps this adapter holds.
    pub fn most_vpl_maps(&self) -> u32 {
        self.gpu.device.limits().max_texture_dimension_2d
    }

    /// Submits direct and indirect light.
    /// * `vpls`: where the settings interleave them, in runs of subsets ([`crate::twin::interleave::group_subsets`])
    /// * `geometry_term_max`: bound of cos·cos/d² in 1/m²; +infinity: none
    /// * `light_visibility`: one value a pixel for each light, in [0, 1], in place of moments
    /// * `indirect`: what is there beside the VPLs
    ///
    /// # Errors
    /// [`RenderError::Settings`] where a given layer has not the picture's size; [`RenderError::Gpu`].
    pub fn light(
        &mut self,
        vpls: &[Vpl],
        geometry_term_max: f32,
        light_visibility: Option<&[Vec<f32>]>,
        indirect: Indirect,
    ) -> Result<(), RenderError> {
        self.record_light(vpls, geometry_term_max, light_visibility, indirect)?;
        self.step(|s| s.submit().map(|_| ()))
    }

    /// [`Self::light`], to be submitted with what follows.
    pub(crate) fn record_light(
        &mut self,
        vpls: &[Vpl],
        geometry_term_max: f32,
        light_visibility: Option<&[Vec<f32>]>,
        indirect: Indirect,
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
        indirect: Indirect,
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
        let (mut chunks, mut emptied) = (indirect::VplChunks::default(), false);
        let ready = matches!(indirect, Indirect::Layer(_));
        match indirect {
            Indirect::Layer(layer) => self.indirect.upload_layer(gpu, &self.picture, layer)?,
            Indirect::Vpls | Indirect::VplsAnd(_) | Indirect::Grid(_) => {
                let spacing = grid::spacing_of(&frame.settings);
                let adds = matches!(indirect, Indirect::VplsAnd(_));
                let remade = self.light_grid.set(gpu, &self.picture, spacing, adds)?;
                let interleave = frame.settings.vpl.map_or(1, |v| v.interleave);
                let made = self.tracer.as_ref().filter(|_| vpls.is_empty()).and_then(GpuTracer::made_vpls);
                let (count, replaced) = match made {
                    Some(most) => self.indirect.reserve(gpu, most, interleave),
                    None => self.indirect.upload(gpu, vpls, geometry_term_max, self.light_grid.is_on(), interleave),
                };
                (chunks, emptied) = (count, replaced);
                if remade || replaced {
                    self.bind_indirect();
                }
                if chunks.of_subsets() {
                    self.prepare_interleave(interleave);
                }
                match indirect {
                    Indirect::Grid(points) if self.light_grid.is_on() => self.light_grid.load(&self.gpu, points)?,
                    Indirect::VplsAnd(points) => self.light_grid.begin_with(&self.gpu, points, chunks.all)?,
                    _ => {}
                }
            }
        }

        let Self {
            gpu,
            open,
            scene,
            direct,
            light_grid,
            indirect: indirect_pass,
            interleave,
            picture,
            timer,
            tracer,
            ..
        } = self;
        let Some(bindings) = &self.bindings else { unreachable!("a frame was begun") };
        let encoder = open.get_or_insert_with(|| gpu.encoder("frame"));
        if let Some(tracer) = tracer.as_mut().filter(|t| !ready && vpls.is_empty() && t.made_vpls().is_some()) {
            let (chunks, stride) = indirect_pass.chunks();
            timer.stage(gpu, encoder, "photons", |encoder| tracer.record_photons(encoder, chunks, stride, emptied))?;
        }
        timer.stage(gpu, encoder, "direct", |encoder| direct.record(encoder, scene, &bindings.direct, picture))?;
        if !ready {
            timer.stage(gpu, encoder, "indirect", |encoder| {
                if light_grid.is_on() {
                    let stride = indirect_pass.chunks().1;
                    light_grid.record(encoder, scene, &bindings.light_grid, chunks.all, stride);
                }
                indirect_pass.record(encoder, scene, &bindings.indirect, picture, chunks);
                if let (true, Some(filter), Some(group)) = (chunks.of_subsets(), interleave, &bindings.interleave) {
                    filter.record(encoder, scene, group, picture);
                }
            })?;
        }
        Ok(())
    }

    /// Submits final = direct + indirect + traced.
    /// * `traced`: pixel number y · width + x and linear radiance
    ///
    /// # Errors
    /// [`RenderError::Settings`] where a pixel lies outside the picture; [`RenderError::Gpu`].
    pub fn compose(&mut self, traced: &[(u32, [f32; 3])]) -> Result<(), RenderError> {
        self.record_compose(traced)?;
        self.step(|s| s.submit().map(|_| ()))
    }

    /// [`Self::compose`], to be submitted with what follows.
    pub(crate) fn record_compose(&mut self, traced: &[(u32, [f32; 3])]) -> Result<(), RenderError> {
        self.begun()?;
        self.step(|s| {
            let replaced = s.compose.reserve(&s.gpu, traced.len());
            if let (true, Some(bindings)) = (replaced, &mut s.bindings) {
                bindings.compose = s.compose.bind(&s.gpu, &s.picture);
            }
            let Self { gpu, open, compose, bindings, picture, timer, .. } = s;
            let Some(bindings) = bindings else { unreachable!("a frame was begun") };
            let encoder = open.get_or_insert_with(|| gpu.encoder("frame"));
            timer.stage(gpu, encoder, "compose", |encoder| {
                compose.record(gpu, encoder, &bindings.compose, picture, traced)
            })?
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

    /// Milliseconds of `moments`, `gbuffer`, `compact`, `direct`, `indirect` and `compose` since the last call or
    /// [`Self::begin`]; empty where [`Self::set_timing`] is off. Waits for the GPU.
    ///
    /// # Errors
    /// [`RenderError::Gpu`]
    pub fn take_pass_times(&mut self) -> Result<Vec<(&'static str, f64)>, RenderError> {
        let slot = self.timer.slot();
        let mut stages = Vec::new();
        self.step(|s| {
            let encoder = s.open.get_or_insert_with(|| s.gpu.encoder("timer"));
            s.timer.resolve(&s.gpu, encoder, slot);
            let submission = s.submit()?;
            s.timer.sent(slot, &submission);
            s.timer.take(&s.gpu, slot, &mut stages)
        })?;
        let mut out: Vec<(&'static str, f64)> = Vec::new();
        for stage in stages {
            match out.iter_mut().find(|(name, _)| *name == stage.name) {
                Some(entry) => entry.1 += stage.milliseconds(),
                None => out.push((stage.name, stage.milliseconds())),
            }
        }
        Ok(out)
    }

    /// Pipelines made so far.
    pub(crate) fn pipelines(&self) -> u64 {
        self.gpu.pipelines()
    }
}

/// Texture and layer of each view of a plan.
fn moment_maps<'a>(plan: &ShadowPlan, shadows: &'a ShadowTargets) -> Vec<(&'a wgpu::Texture, u32)> {
    let mut out = Vec::with_capacity(plan.views.len());
    for (light, first) in plan.lights.iter().zip(scene_buffers::first_layers(plan)) {
        let array = if light.count == 6 { &shadows.faces } else { &shadows.maps };
        out.extend((0..light.count).map(|face| (&array.moments.texture, first + face)));
    }
    out
}
