//! The renderer: threads, structures and memory that live from frame to frame. The frame itself is in `frame.rs`.

use catoptra_engine::{Mesh, RenderScene, SceneError};
use std::sync::{Arc, Mutex};

use crate::{
    accel::{Accel, AccelOptions},
    error::RenderError,
    frame,
    gpu_frame::Doubled,
    output::{Frame, FrameStats, Image},
    query::SceneQuery,
    raster::{GpuRaster, HostView, list_adapters},
    settings::{BlasKind, GlassShadows, RasterLane, RenderSettings, RendererOptions, SimdLevel, Tracer},
    simd,
    still::LitBy,
    trace::{
        explain::RayTree,
        near::NearLights,
        photons::Photons,
        points::Emitter,
        reference::{ReferenceAccumulator, ReferenceOptions},
        surface::NormalMatrices,
    },
    tracer_choice::{self, Memory, TracerChoice},
    twin::{
        gbuffer::CameraScan,
        grid::IrradianceGrid,
        interleave::Guide,
        moments::MomentsScratch,
        shadow::{ShadowMaps, ShadowPlan},
        tile::TileScratch,
        vpl::Vpl,
        vpl_maps::VplMaps,
    },
};

/// Makes pictures of scenes. Nothing is global: any number of renderers live side by side. `Send`.
pub struct Renderer {
    pub(crate) pool: Arc<rayon::ThreadPool>,
    pub(crate) level: SimdLevel,
    pub(crate) state: FrameState,
    /// A fault of the GPU is answered by the CPU lane.
    automatic: bool,
    tracer: TracerChoice,
    /// Why the GPU lane was given up.
    fault: Option<String>,
    /// The host's device, where one was lent.
    host: Option<(wgpu::Device, wgpu::Queue)>,
    host_view: Option<HostView>,
}

/// Makes one picture with a renderer of its own, on the best lane: no window, right at once, usable from a test.
///
/// Setting up costs up to a second where there is a GPU; keep a [`Renderer`] for more than one picture, and choose
/// [`RasterLane::Cpu`] for the same bits on every machine.
///
/// # Errors
/// As [`Renderer::render`].
pub fn render_to_image(scene: &RenderScene, settings: &RenderSettings) -> Result<Image, RenderError> {
    Ok(Renderer::new(RendererOptions::default())?.render(scene, settings)?.image)
}

/// What a frame works on and leaves for the next one. It speeds the next frame up and never changes it, but for kept light
/// paths where [`crate::VplOptions::reuse`] asks for them.
pub(crate) struct FrameState {
    /// Counts frames.
    pub serial: u64,
    pub accel: Accel,
    pub normals: NormalMatrices,
    /// World, revision and meshes that the structure was last brought up to.
    pub followed: Option<(Arc<()>, u64, Vec<Arc<Mesh>>)>,
    pub maps: ShadowMaps,
    pub moments: MomentsScratch,
    pub spare_plan: ShadowPlan,
    /// What the VPLs were made of.
    pub lit_by: LitBy,
    /// What those on the GPU were made of.
    pub lit_on_gpu: LitBy,
    pub photons: Photons,
    pub emitters: Vec<Emitter>,
    /// A smaller set for mirrors and glass.
    pub mirrored: Photons,
    /// What lights that which stands close to a place of the grid.
    pub near_lights: NearLights,
    pub mirrored_emitters: Vec<Emitter>,
    pub grid: IrradianceGrid,
    pub vpl_maps: VplMaps,
    /// The picture's guides where VPLs are interleaved.
    pub guides: Vec<Guide>,
    /// The camera's triangles.
    pub camera: CameraScan,
    /// One a thread.
    pub tiles: Vec<Mutex<TileScratch>>,
    /// `None` on the CPU lane.
    pub gpu: Option<GpuRaster>,
    /// A scene that the GPU's tracer cannot hold is traced by the CPU.
    pub automatic_tracer: bool,
    /// Why that happened.
    pub tracer_fallback: Option<String>,
    /// The frame that is on its way while the next one is made.
    pub doubled: Doubled,
}

impl Renderer {
    /// Chooses lane and SIMD level and starts the worker threads.
    ///
    /// # Errors
    /// [`RenderError::Unavailable`] where an explicit lane or level is not there; `Auto` never fails for that reason.
    pub fn new(options: RendererOptions) -> Result<Self, RenderError> {
        let gpu = match options.raster {
            RasterLane::Cpu => None,
            RasterLane::Gpu => Some(GpuRaster::new()?),
            // A software adapter is dearer than the CPU twin on the same cores.
            RasterLane::Auto if list_adapters().iter().any(|a| !a.software) => GpuRaster::new().ok(),
            // An explicit tracer on the GPU wants its lane, whatever it runs on.
            RasterLane::Auto if !matches!(options.tracer, Tracer::Auto | Tracer::Cpu) => Some(GpuRaster::new()?),
            RasterLane::Auto => None,
        };
        Self::with_gpu(options, gpu)
    }

    /// As [`Self::new`] with a raster lane made before, for example on a borrowed device; `None`: CPU lane.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_gpu(options: RendererOptions, gpu: Option<GpuRaster>) -> Result<Self, RenderError> {
        let level = simd::resolve(options.simd)?;
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(options.threads)
            .thread_name(|i| format!("catoptra-{i}"))
            .build()
            .map_err(|e| RenderError::Unavailable {
                choice: format!("--threads {}", options.threads),
                missing: e.to_string(),
            })?;
        let threads = pool.current_num_threads();
        let accel = Accel::new(AccelOptions { blas: options.blas, simd: level, ..Default::default() })?;
        let state = FrameState {
            serial: 0,
            accel,
            normals: NormalMatrices::default(),
            followed: None,
            maps: ShadowMaps::default(),
            moments: MomentsScratch::default(),
            spare_plan: ShadowPlan::default(),
            lit_by: LitBy::default(),
            lit_on_gpu: LitBy::default(),
            photons: Photons::default(),
            emitters: Vec::new(),
            mirrored: Photons::default(),
            near_lights: NearLights::default(),
            mirrored_emitters: Vec::new(),
            grid: IrradianceGrid::default(),
            vpl_maps: VplMaps::default(),
            guides: Vec::new(),
            camera: CameraScan::default(),
            tiles: (0..threads).map(|_| Mutex::default()).collect(),
            gpu,
            automatic_tracer: options.tracer == Tracer::Auto,
            tracer_fallback: None,
            doubled: Doubled::default(),
        };
        // What was asked for by name does not fall back.
        let automatic = options.raster == RasterLane::Auto && matches!(options.tracer, Tracer::Auto | Tracer::Cpu);
        let tracer = TracerChoice::new(Tracer::Cpu, "chosen");
        let mut renderer =
            Self { pool: Arc::new(pool), level, state, automatic, tracer, fault: None, host: None, host_view: None };
        renderer.choose_tracer(options)?;
        Ok(renderer)
    }

    fn choose_tracer(&mut self, options: RendererOptions) -> Result<(), RenderError> {
        let kd = options.blas == BlasKind::KdTree;
        let Some(gpu) = &mut self.state.gpu else {
            return match options.tracer {
                Tracer::Cpu => Ok(()),
                Tracer::Auto => {
                    self.tracer.why = "the CPU makes every stage".into();
                    Ok(())
                }
                other => Err(RenderError::Unavailable {
                    choice: format!("--tracer {}", other.name()),
                    missing: "it traces the pixels of the GPU's raster lane, and that is not the one that runs".into(),
                }),
            };
        };
        if options.tracer != Tracer::Auto {
            gpu.set_tracer(options.tracer, kd)?;
            self.tracer = TracerChoice::new(options.tracer, "chosen");
            return Ok(());
        }
        let memory = Memory::of_user();
        let (adapter, threads) = (gpu.adapter().clone(), self.pool.current_num_threads());
        let key = Memory::key(&adapter, threads);
        if let Some(known) = memory.recall(&key)
            && self.take_tracer(known, kd)
        {
            self.tracer = TracerChoice::new(known, format!("measured before, kept in {}", memory.place()));
            return Ok(());
        }
        if adapter.software {
            self.tracer.why = "a software adapter is slower than all cores at this".into();
            return Ok(());
        }
        match tracer_choice::fastest(self.measure_tracers(options.blas)) {
            Some((tracer, figures)) => {
                self.take_tracer(tracer, kd);
                memory.remember(&key, tracer, &figures);
                self.tracer = TracerChoice::new(tracer, format!("measured: {figures}"));
            }
            None => self.tracer.why = "nothing could be measured".into(),
        }
        Ok(())
    }

    /// False where this device has not got it.
    fn take_tracer(&mut self, tracer: Tracer, kd: bool) -> bool {
        self.state.gpu.as_mut().is_some_and(|gpu| gpu.set_tracer(tracer, kd).is_ok())
    }

    /// Milliseconds a frame of a small scene with each tracer that this machine has, on the lane that runs; the fastest of a
    /// few frames. What [`Tracer::Auto`] does on an adapter's first use. Empty on the CPU lane.
    pub fn measure_tracers(&mut self, blas: BlasKind) -> Vec<(Tracer, f64)> {
        let (scene, settings) = (tracer_choice::measured_scene(), tracer_choice::measured_settings());
        let before = self.state.gpu.as_ref().map_or(Tracer::Cpu, GpuRaster::tracer);
        let kd = blas == BlasKind::KdTree;
        let (mut measured, mut made) = (Vec::new(), Frame::default());
        for tracer in Tracer::ALL {
            if !self.take_tracer(tracer, kd) {
                continue;
            }
            let mut best = f64::INFINITY;
            for frame in 0..tracer_choice::MEASURED_FRAMES {
                let (level, state) = (self.level, &mut self.state);
                match self.pool.install(|| frame::render_frame(state, level, &scene, &settings, true, &mut made)) {
                    // The first frame sends the scene.
                    Ok(()) if frame == 0 => {}
                    Ok(()) => best = best.min(made.stats.stages_ms.total),
                    Err(_) => break,
                }
            }
            if best.is_finite() {
                measured.push((tracer, best));
            }
        }
        self.take_tracer(before, kd);
        measured
    }

    /// For tests: takes a tracer as if `Auto` had measured it.
    ///
    /// # Errors
    /// As [`GpuRaster::set_tracer`].
    #[doc(hidden)]
    pub fn assume_tracer(&mut self, tracer: Tracer) -> Result<(), RenderError> {
        let Some(gpu) = &mut self.state.gpu else { return Ok(()) };
        gpu.set_tracer(tracer, false)?;
        self.tracer = TracerChoice::new(tracer, "assumed");
        Ok(())
    }

    /// The tracer that was chosen, and why.
    pub fn tracer(&self) -> &TracerChoice {
        &self.tracer
    }

    /// A renderer on a device of the host's, whose handles are cheap clones: its views can be drawn into with
    /// [`Self::render_to_view`]. Nothing of the host's is changed: no callback is set, all work is in command buffers of its
    /// own, and errors are caught by scopes.
    ///
    /// `Auto` takes the GPU lane where the device can serve it and is no software; otherwise the CPU makes the picture and
    /// the device only shows it.
    ///
    /// # Errors
    /// As [`Self::new`]: `Gpu` on a device that lacks something names what is missing.
    pub fn with_device(
        device: wgpu::Device,
        queue: wgpu::Queue,
        options: RendererOptions,
    ) -> Result<Self, RenderError> {
        let lane = |device: &wgpu::Device, queue: &wgpu::Queue| GpuRaster::from_device(device.clone(), queue.clone());
        let gpu = match options.raster {
            RasterLane::Cpu => None,
            RasterLane::Gpu => Some(lane(&device, &queue)?),
            RasterLane::Auto
                if device.adapter_info().device_type == wgpu::DeviceType::Cpu
                    && matches!(options.tracer, Tracer::Auto | Tracer::Cpu) =>
            {
                None
            }
            RasterLane::Auto => lane(&device, &queue).map_err(|e| tracing::warn!("the CPU lane is used: {e}")).ok(),
        };
        Ok(Self { host: Some((device, queue)), ..Self::with_gpu(options, gpu)? })
    }

    /// Makes ready what a frame with these settings needs (GPU lane): kernels that they ask for are compiled, by wgpu and, since
    /// a small picture is drawn with them, by the driver, so that no later frame waits for a compiler.
    ///
    /// # Errors
    /// As [`Self::render`].
    pub fn prepare(&mut self, settings: &RenderSettings) -> Result<(), RenderError> {
        if self.state.gpu.is_none() {
            return Ok(());
        }
        let settings = RenderSettings { width: 16, height: 16, double_buffered: false, ..*settings };
        self.render(&tracer_choice::measured_scene(), &settings).map(|_| ())
    }

    /// Makes one picture. Right on the first call; the same scene and settings give the same picture ever after (with
    /// [`crate::VplOptions::reuse`]: the same frames one after the other do).
    ///
    /// Where the lane was `Auto` and the GPU fails (lost, out of memory, a scene beyond its limits), the CPU lane makes this
    /// picture and all later ones; [`Self::fault`] says why.
    ///
    /// # Errors
    /// [`RenderError::Settings`] and [`RenderError::Scene`] for what cannot be drawn; [`RenderError::Gpu`] where the GPU lane
    /// was chosen explicitly and failed.
    pub fn render(&mut self, scene: &RenderScene, settings: &RenderSettings) -> Result<Frame, RenderError> {
        let mut frame = Frame::default();
        self.frame(scene, settings, true, &mut frame)?;
        Ok(frame)
    }

    /// As [`Self::render`] into a frame made before, whose memory is used again: on the CPU lane frame after frame of one size
    /// then allocates nothing ([`Self::run`]). After an error the frame's content is undefined.
    ///
    /// # Errors
    /// As [`Self::render`].
    pub fn render_into(
        &mut self,
        scene: &RenderScene,
        settings: &RenderSettings,
        frame: &mut Frame,
    ) -> Result<(), RenderError> {
        self.frame(scene, settings, true, frame)
    }

    /// Calls `f` on one of the renderer's own threads, where frames need no hand-over between threads.
    pub fn run<R: Send>(&mut self, f: impl FnOnce(&mut Self) -> R + Send) -> R {
        let pool = self.pool.clone();
        pool.install(|| f(self))
    }

    fn frame(
        &mut self,
        scene: &RenderScene,
        settings: &RenderSettings,
        read_back: bool,
        frame: &mut Frame,
    ) -> Result<(), RenderError> {
        let (level, state) = (self.level, &mut self.state);
        match self.pool.install(|| frame::render_frame(state, level, scene, settings, read_back, frame)) {
            Err(RenderError::Gpu(why)) if self.automatic => {
                self.give_up_gpu(why);
                let state = &mut self.state;
                self.pool.install(|| frame::render_frame(state, level, scene, settings, read_back, frame))
            }
            // A tracer that was asked for by name is named.
            Err(RenderError::Gpu(why)) if !self.state.automatic_tracer && self.tracer.tracer != Tracer::Cpu => {
                Err(RenderError::Gpu(format!("--tracer {}: {why}", self.tracer.tracer.name())))
            }
            made => made,
        }
    }

    fn give_up_gpu(&mut self, why: String) {
        tracing::warn!("the GPU failed ({why}); the CPU lane takes over");
        if self.host.is_none() {
            self.host = self.state.gpu.as_ref().map(|g| (g.device().0.clone(), g.device().1.clone()));
        }
        self.state.gpu = None;
        self.state.doubled = Doubled::default();
        self.tracer = TracerChoice::new(Tracer::Cpu, format!("the GPU failed: {why}"));
        self.fault = Some(why);
    }

    /// Why the GPU lane was given up for the CPU lane; `None` where it was not.
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    /// Makes one picture and draws it over all of `view`: radiance x 2^`exposure_ev`, clamped to [0, 1], sRGB curve (by the
    /// target where its `format` has it). Sizes may differ; the nearest pixel is taken. On the GPU lane nothing is read
    /// back. The work is submitted; the queue's order does the rest.
    /// * `view`: of the device lent to [`Self::with_device`], or of this renderer's own ([`Self::gpu_mut`]); usage
    ///   `RENDER_ATTACHMENT`
    ///
    /// # Errors
    /// As [`Self::render`]; [`RenderError::Unavailable`] where the renderer has no device; [`RenderError::View`] where the view
    /// is not fit to be drawn into (its surface is lost, say): the lane stays, and the next view may do.
    pub fn render_to_view(
        &mut self,
        scene: &RenderScene,
        settings: &RenderSettings,
        view: &wgpu::TextureView,
        format: wgpu::TextureFormat,
        exposure_ev: f32,
    ) -> Result<FrameStats, RenderError> {
        if self.state.gpu.is_none() && self.host.is_none() {
            return Err(RenderError::Unavailable {
                choice: "drawing into a view".into(),
                missing: "a device: make the renderer with Renderer::with_device".into(),
            });
        }
        let mut frame = Frame::default();
        self.frame(scene, settings, false, &mut frame)?;
        if let Some(gpu) = &mut self.state.gpu {
            match gpu.present(view, format, exposure_ev) {
                Err(RenderError::Gpu(why)) if self.automatic => {
                    self.give_up_gpu(why);
                    self.frame(scene, settings, false, &mut frame)?;
                }
                presented => return presented.map(|()| frame.stats),
            }
        }
        let (device, queue) = self.host.as_ref().expect("checked above, and kept when the lane was given up");
        if self.host_view.is_none() {
            self.host_view = Some(HostView::new(device.clone(), queue.clone())?);
        }
        let host_view = self.host_view.as_mut().expect("made above");
        frame.stats.bytes_up += host_view.draw(&frame.image, view, format, exposure_ev)?;
        Ok(frame.stats)
    }

    /// Questions about `scene`: picking, occlusion. Brings the structure up to the scene, which costs what moved.
    ///
    /// # Errors
    /// [`SceneError`] where the scene cannot be drawn.
    pub fn query<'a>(&'a mut self, scene: &'a RenderScene) -> Result<SceneQuery<'a>, SceneError> {
        scene.validate()?;
        let state = &mut self.state;
        self.pool.install(|| update_structures(state, scene, GlassShadows::Opaque));
        Ok(SceneQuery { scene, accel: &self.state.accel, normals: &self.state.normals, pool: &self.pool })
    }

    /// Why the pixel in column `x` and row `y` of the picture that [`Self::render`] would make has its colour: all rays behind
    /// it, as the CPU lane traces them. Costs shadow moments and VPLs of a frame, and no pixels.
    ///
    /// # Errors
    /// As [`Self::render`], and [`RenderError::Settings`] for a pixel outside the picture.
    pub fn explain(
        &mut self,
        scene: &RenderScene,
        settings: &RenderSettings,
        x: u32,
        y: u32,
    ) -> Result<RayTree, RenderError> {
        let (level, state) = (self.level, &mut self.state);
        self.pool.install(|| frame::explain_pixel(state, level, scene, settings, (x, y)))
    }

    /// The virtual point lights of the last frame, world space.
    pub fn vpls(&self) -> &[Vpl] {
        &self.state.photons.vpls
    }

    /// Adds `samples` samples per pixel of the path-traced truth to `accumulator`. Returns the number of rays.
    ///
    /// # Errors
    /// As [`Self::render`].
    pub fn add_reference(
        &mut self,
        accumulator: &mut ReferenceAccumulator,
        scene: &RenderScene,
        options: &ReferenceOptions,
        samples: u32,
    ) -> Result<u64, RenderError> {
        scene.validate()?;
        let state = &mut self.state;
        Ok(self.pool.install(|| {
            update_structures(state, scene, options.glass_shadows);
            accumulator.add(scene, &state.normals, &state.accel, options, samples)
        }))
    }

    /// The lane that runs.
    pub fn lane(&self) -> RasterLane {
        if self.state.gpu.is_some() { RasterLane::Gpu } else { RasterLane::Cpu }
    }
    /// Adapter (GPU lane) or SIMD level (CPU lane).
    pub fn device(&self) -> String {
        device_name(&self.state, self.level).to_string()
    }
    /// The SIMD level that runs; never `Auto`.
    pub fn simd_level(&self) -> SimdLevel {
        self.level
    }
    /// Worker threads.
    pub fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }
    /// The two-level structure as of the last frame: for picking and queries.
    pub fn accel(&self) -> &Accel {
        &self.state.accel
    }
    /// The raster lane's GPU side, for presenting without a read-back; `None` on the CPU lane.
    pub fn gpu_mut(&mut self) -> Option<&mut GpuRaster> {
        self.state.gpu.as_mut()
    }
}

pub(crate) fn device_name(state: &FrameState, level: SimdLevel) -> &str {
    match &state.gpu {
        Some(gpu) => &gpu.adapter().name,
        None => simd::level_name(level),
    }
}

/// Lets the tree of a mesh whose slot in the scene holds the same triangles at other places follow them, which is cheaper
/// than a build and gives the same hits.
fn refit_deformed(state: &mut FrameState, scene: &RenderScene) {
    match &mut state.followed {
        Some((origin, revision, meshes)) if Arc::ptr_eq(origin, &scene.origin) => {
            if *revision == scene.revision {
                return;
            }
            *revision = scene.revision;
            let mut same = meshes.len() == scene.meshes.len();
            for (i, (old, new)) in meshes.iter().zip(&scene.meshes).enumerate() {
                if Arc::ptr_eq(old, new) {
                    continue;
                }
                same = false;
                // A mesh that has a tree already, or gets one from an earlier slot, keeps that.
                let known = |list: &[Arc<Mesh>]| list.iter().any(|m| Arc::ptr_eq(m, new));
                if !known(meshes) && !known(&scene.meshes[..i]) {
                    state.accel.refit_mesh(old, new);
                }
            }
            if !same {
                meshes.clone_from(&scene.meshes);
            }
        }
        other => *other = Some((scene.origin.clone(), scene.revision, scene.meshes.clone())),
    }
}

/// Brings the two-level structure and the normal matrices up to the scene.
pub(crate) fn update_structures(
    state: &mut FrameState,
    scene: &RenderScene,
    glass_shadows: GlassShadows,
) -> crate::accel::UpdateStats {
    refit_deformed(state, scene);
    let stats = state.accel.update(scene);
    state.accel.set_shadow_casters(|i| {
        let m = &scene.materials[scene.instances[i as usize].material as usize];
        glass_shadows == GlassShadows::Opaque || m.transmission <= 0.0
    });
    state.normals.update(scene);
    stats
}
