//! What a frame gives back.

use crate::settings::{RasterLane, Tracer};

/// Linear RGB picture, `[height][width][3]`, row 0 on top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Radiance (or what the layer holds) per pixel.
    pub pixels: Vec<[f32; 3]>,
}

impl Image {
    /// A black picture.
    pub fn new(width: u32, height: u32) -> Self {
        Self { width, height, pixels: vec![[0.0; 3]; width as usize * height as usize] }
    }

    /// Gives the picture another size; what it shows then is undefined. Memory is kept.
    pub fn resize(&mut self, width: u32, height: u32) {
        (self.width, self.height) = (width, height);
        self.pixels.resize(width as usize * height as usize, [0.0; 3]);
    }

    /// Pixel at column `x` of row `y`.
    pub fn at(&self, x: u32, y: u32) -> [f32; 3] {
        self.pixels[(y * self.width + x) as usize]
    }

    /// xxh3-64 over the pixels as little-endian f32, row 0 first, −0 written as +0.
    pub fn hash(&self) -> u64 {
        let mut hasher = xxhash_rust::xxh3::Xxh3::new();
        let mut bytes = Vec::with_capacity(12 * 1024);
        for chunk in self.pixels.chunks(1024) {
            bytes.clear();
            for v in chunk.iter().flatten() {
                bytes.extend_from_slice(&(v + 0.0).to_le_bytes());
            }
            hasher.update(&bytes);
        }
        hasher.digest()
    }
}

/// A stage of the picture that can be looked at alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Layer {
    /// direct + indirect + traced, linear radiance.
    #[default]
    Final,
    /// Blinn-Phong under shadowed lights, ambient and emitted radiance.
    Direct,
    /// Light of the VPLs.
    Indirect,
    /// Mirrors and glass.
    Traced,
    /// The material mask: (mirror, transmission, 0).
    Mask,
    /// Distance along the viewing direction in metres, all channels; 0 where nothing was met.
    Depth,
    /// World-space shading normal, (n + 1)/2.
    Normal,
    /// base_color.
    Albedo,
    /// First shadow map at its own size: (E(z), E(z²), 0), or the first two moments of the positive warp (`evsm4`).
    Moments,
}

impl Layer {
    /// All layers with their names on the command line.
    pub const ALL: [(Self, &'static str); 9] = [
        (Self::Final, "final"),
        (Self::Direct, "direct"),
        (Self::Indirect, "indirect"),
        (Self::Traced, "traced"),
        (Self::Mask, "mask"),
        (Self::Depth, "depth"),
        (Self::Normal, "normal"),
        (Self::Albedo, "albedo"),
        (Self::Moments, "moments"),
    ];
}

/// One finished frame.
#[derive(Clone, Debug, Default)]
pub struct Frame {
    /// The composed picture, linear radiance.
    pub image: Image,
    /// All layers, where [`crate::RenderSettings::keep_layers`] asked for them.
    pub layers: Vec<(Layer, Image)>,
    /// How it was made.
    pub stats: FrameStats,
}

impl Frame {
    /// A layer; `None` where layers were not kept. `Final` is always there.
    pub fn layer(&self, layer: Layer) -> Option<&Image> {
        if layer == Layer::Final {
            return Some(&self.image);
        }
        self.layers.iter().find(|(l, _)| *l == layer).map(|(_, i)| i)
    }
}

/// Rays by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RayCounts {
    /// Pixels whose surface was found: by scan conversion on the CPU lane, by rays where the GPU lane's mask is traced.
    pub camera: u64,
    /// Texels of the lights' shadow maps that were made (CPU lane); 0 where those of the frame before still hold.
    pub moments: u64,
    /// Mirror and Fresnel reflection.
    pub reflection: u64,
    /// Refraction.
    pub refraction: u64,
    /// Towards lights.
    pub shadow: u64,
    /// Light paths that make VPLs.
    pub photon: u64,
    /// From VPLs for their shadow maps.
    pub vpl_maps: u64,
    /// Towards VPLs.
    pub vpl: u64,
}

impl RayCounts {
    /// Rays that were traced: all but pixels and texels, which are scan-converted.
    pub fn total(self) -> u64 {
        self.reflection + self.refraction + self.shadow + self.photon + self.vpl_maps + self.vpl
    }

    /// Sum of both.
    pub fn merged(self, o: Self) -> Self {
        Self {
            camera: self.camera + o.camera,
            moments: self.moments + o.moments,
            reflection: self.reflection + o.reflection,
            refraction: self.refraction + o.refraction,
            shadow: self.shadow + o.shadow,
            photon: self.photon + o.photon,
            vpl_maps: self.vpl_maps + o.vpl_maps,
            vpl: self.vpl + o.vpl,
        }
    }
}

/// Wall-clock milliseconds per stage. Stages that run tile by tile share the tiles' wall time in proportion to the thread
/// time that each took; with several threads the sum stays the frame's own time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StageTimes {
    /// Two-level structure.
    pub accel: f64,
    /// Shadow moments and their blur.
    pub moments: f64,
    /// Photons to VPLs.
    pub vpls: f64,
    /// G-buffer and material mask.
    pub gbuffer: f64,
    /// Direct light.
    pub direct: f64,
    /// Indirect light.
    pub indirect: f64,
    /// Whitted tracing.
    pub traced: f64,
    /// Composition.
    pub compose: f64,
    /// Copies between CPU and GPU and waiting for them (GPU lane).
    pub transfer: f64,
    /// The whole call.
    pub total: f64,
}

/// When a stage ran.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StageInterval {
    /// On the GPU, else on the thread that makes the frame (with its pool's threads, where the stage has work for them).
    pub on_gpu: bool,
    /// Name of the stage; what begins with `wait` is a stall.
    pub name: &'static str,
    /// By this process's clock. GPU clocks are set by it once, to within half the time of an empty submission.
    pub begin: std::time::Instant,
    /// As `begin`.
    pub end: std::time::Instant,
}

impl StageInterval {
    /// Length in milliseconds.
    pub fn milliseconds(&self) -> f64 {
        self.end.duration_since(self.begin).as_secs_f64() * 1e3
    }
}

/// Counters of one frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameStats {
    /// The lane that ran.
    pub raster: RasterLane,
    /// The tracer that ran.
    pub tracer: Tracer,
    /// Why it is not the one that `Auto` had chosen: what was too large for the adapter, with figures.
    pub tracer_fallback: Option<String>,
    /// Adapter name (GPU lane) or SIMD level (CPU lane).
    pub device: String,
    /// Milliseconds per stage.
    pub stages_ms: StageTimes,
    /// Rays by kind.
    pub rays: RayCounts,
    /// Pixels with a mirror or glass share.
    pub masked_pixels: u64,
    /// Meshes whose own tree was built in this frame.
    pub blas_builds: u32,
    /// Top-level nodes whose bounds were computed anew.
    pub tlas_nodes_touched: u32,
    /// VPLs with flux.
    pub vpls: u32,
    /// Those of them whose light paths were kept from the frame before ([`crate::VplOptions::reuse`]).
    pub vpls_reused: u32,
    /// Bytes sent to the GPU.
    pub bytes_up: u64,
    /// Bytes read back from the GPU.
    pub bytes_down: u64,
    /// Pipelines that were compiled within the frame: 0 but where settings ask for a kernel for the first time
    /// ([`crate::Renderer::prepare`] makes them before).
    pub pipelines_made: u64,
    /// Frames by which the picture is late: 1 where [`crate::RenderSettings::double_buffered`] has come into effect.
    pub latency_frames: u32,
    /// When the stages ran (GPU lane, where [`crate::RenderSettings::time_passes`] asks for it).
    pub timeline: Vec<StageInterval>,
    /// Pixels whose radiance was not finite and was made black, and the first of them.
    pub non_finite: (u64, Option<(u32, u32)>),
}
