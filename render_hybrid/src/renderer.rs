//! The renderer: threads, structures and memory that live from frame to frame. The frame itself is in `frame.rs`.

use catoptra_engine::RenderScene;
use std::sync::Mutex;

use crate::{
    accel::{Accel, AccelOptions},
    error::RenderError,
    frame,
    output::Frame,
    raster::{GpuRaster, list_adapters},
    settings::{GlassShadows, RasterLane, RenderSettings, RendererOptions, SimdLevel},
    simd,
    trace::{
        photons::Photons,
        reference::{ReferenceAccumulator, ReferenceOptions},
        surface::NormalMatrices,
    },
    twin::{shadow::ShadowMaps, tile::TileScratch, vpl_maps::VplMaps},
};

/// Makes pictures of scenes. Nothing is global: any number of renderers live side by side. `Send`.
pub struct Renderer {
    pub(crate) pool: rayon::ThreadPool,
    pub(crate) level: SimdLevel,
    pub(crate) state: FrameState,
}

/// What a frame works on and leaves for the next one. It speeds the next frame up and never changes it.
pub(crate) struct FrameState {
    pub accel: Accel,
    pub normals: NormalMatrices,
    pub maps: ShadowMaps,
    pub blur_scratch: Vec<[f32; 4]>,
    pub photons: Photons,
    pub vpl_maps: VplMaps,
    /// One a thread.
    pub tiles: Vec<Mutex<TileScratch>>,
    /// `None` on the CPU lane.
    pub gpu: Option<GpuRaster>,
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
        let accel = Accel::new(AccelOptions { blas: options.blas, simd: level })?;
        let state = FrameState {
            accel,
            normals: NormalMatrices::default(),
            maps: ShadowMaps::default(),
            blur_scratch: Vec::new(),
            photons: Photons::default(),
            vpl_maps: VplMaps::default(),
            tiles: (0..threads).map(|_| Mutex::default()).collect(),
            gpu,
        };
        Ok(Self { pool, level, state })
    }

    /// Makes one picture. Right on the first call; the same scene and settings give the same picture ever after.
    ///
    /// # Errors
    /// [`RenderError::Settings`] and [`RenderError::Scene`] for what cannot be drawn, [`RenderError::Gpu`] for a lost device.
    pub fn render(&mut self, scene: &RenderScene, settings: &RenderSettings) -> Result<Frame, RenderError> {
        let (level, state) = (self.level, &mut self.state);
        self.pool.install(|| frame::render_frame(state, level, scene, settings))
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
        device_name(&self.state, self.level)
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

pub(crate) fn device_name(state: &FrameState, level: SimdLevel) -> String {
    match &state.gpu {
        Some(gpu) => gpu.adapter().name.clone(),
        None => simd::level_name(level).to_string(),
    }
}

/// Brings the two-level structure and the normal matrices up to the scene.
pub(crate) fn update_structures(
    state: &mut FrameState,
    scene: &RenderScene,
    glass_shadows: GlassShadows,
) -> crate::accel::UpdateStats {
    let stats = state.accel.update(scene);
    state.accel.set_shadow_casters(|i| {
        let m = &scene.materials[scene.instances[i as usize].material as usize];
        glass_shadows == GlassShadows::Opaque || m.transmission <= 0.0
    });
    state.normals.update(scene);
    stats
}
