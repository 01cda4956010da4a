//! The options that change the picture, or how it is made: shared by `render`, `bench`, `judge` and `play`.

use super::{failure::Failure, target::Target};
use crate::scenes::SceneOptions;
use catoptra_render_hybrid as hybrid;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Width and height in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size(pub u32, pub u32);

impl std::fmt::Display for Size {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.0, self.1)
    }
}

/// Reads `WxH`.
pub fn parse_size(text: &str) -> Result<Size, String> {
    let parts = text.split_once(['x', 'X']).and_then(|(w, h)| Some((w.parse::<u64>().ok()?, h.parse::<u64>().ok()?)));
    let Some((w, h)) = parts else {
        return Err("a size is written as WIDTHxHEIGHT, such as 1024x1024".into());
    };
    if !(1..=16384).contains(&w) || !(1..=16384).contains(&h) {
        return Err("a size lies between 1x1 and 16384x16384".into());
    }
    Ok(Size(w as u32, h as u32))
}

/// Who makes direct and indirect light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Raster {
    /// wgpu on a real GPU, else the CPU
    #[default]
    Auto,
    /// The CPU alone
    Cpu,
    /// wgpu, or an error
    Gpu,
}

/// Who traces mirrors and glass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Tracer {
    /// The fastest on this adapter, measured on first use and remembered; the CPU without a GPU
    #[default]
    Auto,
    /// All cores
    Cpu,
    /// A compute pass on the GPU
    Gpu,
    /// A fragment pass on the GPU
    GpuFragment,
    /// The GPU's ray tracing hardware
    Rayquery,
}

/// Bundle of settings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum PresetArg {
    /// 16 VPLs without shadows, depth 4: editing
    Draft,
    /// 256 VPLs with shadow maps on a grid of the picture, depth 8: play
    #[default]
    Interactive,
    /// 4,096 VPLs with shadow maps, shadows by rays where they matter: stills
    High,
}

/// Shadows of lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[allow(missing_docs)]
pub enum ShadowsArg {
    Moments,
    Certified,
    Traced,
    Off,
}

/// Filter of shadow maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[allow(missing_docs)]
pub enum ShadowFilter {
    Vsm,
    Evsm4,
}

/// Shadows of glass.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[allow(missing_docs)]
pub enum GlassShadowsArg {
    Opaque,
    Clear,
}

/// Where virtual point lights lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum VplPlacementArg {
    /// Where light paths land.
    Paths,
    /// On a fixed pattern of every surface, where so many cover it.
    Surfels,
}

/// What rays from the places of the grid bring of what stands close to them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum NearFieldArg {
    /// Nothing.
    Off,
    /// The light that the bound of virtual point lights cuts off.
    Light,
    /// That, and occluders that their maps miss, by four times as many rays.
    #[value(alias = "on")]
    Full,
}

/// Shadows of virtual point lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[allow(missing_docs)]
pub enum VplShadowsArg {
    Off,
    Maps,
    Traced,
}

/// Tree of each mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
#[allow(missing_docs)]
pub enum Blas {
    #[default]
    Bvh,
    Kdtree,
}

/// SIMD level.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
#[allow(missing_docs)]
pub enum Simd {
    #[default]
    Auto,
    Portable,
    Avx2,
    Avx512,
}

/// What may stand in for the scenes' own statue and atrium, and what a file plays.
#[derive(Clone, Debug, Default, Args)]
pub struct SceneArgs {
    /// glTF or GLB file instead of the statue of rolling-box-venus
    #[arg(long, value_name = "F")]
    pub statue: Option<PathBuf>,
    /// glTF or GLB file instead of the atrium of rolling-box-sponza
    #[arg(long, value_name = "F")]
    pub atrium: Option<PathBuf>,
    /// Animation of a glTF or GLB file, by its number from 0 or its name [default: 0]
    #[arg(long, value_name = "N|NAME")]
    pub animation: Option<String>,
}

impl SceneArgs {
    /// For opening `targets`.
    ///
    /// # Errors
    /// Wrong use: an animation is chosen, and none of them is a file.
    pub fn options_for(&self, targets: &[Target]) -> Result<SceneOptions, Failure> {
        match (&self.animation, targets) {
            (Some(_), [Target::Scene(name), ..]) => {
                Err(Failure::usage(format!("--animation chooses among a file's animations; {name} is no file")))
            }
            _ => Ok(self.options()),
        }
    }

    /// For [`crate::scenes::build`].
    pub fn options(&self) -> SceneOptions {
        SceneOptions { statue: self.statue.clone(), atrium: self.atrium.clone(), animation: self.animation.clone() }
    }
}

/// The options.
#[derive(Clone, Debug, Default, Args)]
pub struct PictureArgs {
    /// Width and height in pixels [default: 1024x1024]
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<Size>,
    /// Who makes direct and indirect light
    #[arg(long, value_enum, default_value_t)]
    pub raster: Raster,
    /// Who traces mirrors and glass
    #[arg(long, value_enum, default_value_t)]
    pub tracer: Tracer,
    /// Bundle of settings that the other options change
    #[arg(long, value_enum, default_value_t)]
    pub preset: PresetArg,
    /// Leaves indirect light out
    #[arg(long)]
    pub no_indirect: bool,
    /// Diffuse reflections before the last one to the camera path; 0 leaves indirect light out
    #[arg(long, value_name = "B", value_parser = clap::value_parser!(u32).range(0..=64))]
    pub bounces: Option<u32>,
    /// Shadows of lights
    #[arg(long, value_enum)]
    pub shadows: Option<ShadowsArg>,
    /// Filter of shadow maps
    #[arg(long, value_enum)]
    pub shadow_filter: Option<ShadowFilter>,
    /// Penumbrae of shadow maps widen with the distance from occluder to receiver
    #[arg(long, value_name = "on|off", value_parser = parse_switch)]
    pub soft_shadows: Option<bool>,
    /// Rays per soft light where shadows are traced
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub shadow_samples: Option<u32>,
    /// Whether glass throws shadows
    #[arg(long, value_enum)]
    pub glass_shadows: Option<GlassShadowsArg>,
    /// Virtual point lights, of all bounces together; 0 leaves indirect light out
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1 << 20))]
    pub vpls: Option<u32>,
    /// Shadows of virtual point lights
    #[arg(long, value_enum)]
    pub vpl_shadows: Option<VplShadowsArg>,
    /// Texels a side of a virtual point light's shadow map: 16, 32 or 64
    #[arg(long, value_name = "N")]
    pub vpl_map_size: Option<u32>,
    /// Candidates for each virtual point light on light paths: those that give most to the picture are kept; 1: all
    #[arg(long, value_name = "N")]
    pub vpl_candidates: Option<u32>,
    /// Where virtual point lights lie: where light paths land, or on a fixed pattern of all surfaces
    #[arg(long, value_enum)]
    pub vpl_placement: Option<VplPlacementArg>,
    /// Side of the blocks of pixels over which virtual point lights are interleaved: 1 (none), 2 or 4
    #[arg(long, value_name = "N")]
    pub vpl_interleave: Option<u32>,
    /// Pixels between the places where virtual point lights are evaluated: 1 (each pixel), 2, 4, 8 or 16
    #[arg(long, value_name = "N")]
    pub vpl_spacing: Option<u32>,
    /// What rays from the places where virtual point lights are evaluated find close by
    #[arg(long, value_enum)]
    pub vpl_near_field: Option<NearFieldArg>,
    /// Virtual point lights, without shadows, that light what mirrors and glass show; 0: the same as elsewhere
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1 << 20))]
    pub mirror_vpls: Option<u32>,
    /// Virtual point lights made anew in a frame at most, the others are kept from frame to frame; 0: all are made anew
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1 << 20))]
    pub vpl_reuse: Option<u32>,
    /// Bound of the VPLs' geometry term in units of 1/(bounding radius)^2, or `off` for none (no bias, bright spots)
    #[arg(long, value_name = "X|off", value_parser = parse_bound)]
    pub vpl_bound: Option<Bound>,
    /// Most mirrors and glass interfaces on a path
    #[arg(long, value_name = "D", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub depth: Option<u32>,
    /// Least part of a pixel that a ray must carry to be traced, from 0 up
    #[arg(long, value_name = "W")]
    pub min_weight: Option<f32>,
    /// Tree of each mesh
    #[arg(long, value_enum, default_value_t)]
    pub blas: Blas,
    /// Most rays a frame: where they do not suffice, the mirrors' and glasses' rays of least weight end first
    #[arg(long, value_name = "RAYS")]
    pub budget: Option<u64>,
    /// Worker threads [default: one a processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub threads: Option<u32>,
    /// SIMD level of the CPU's kernels
    #[arg(long, value_enum, default_value_t)]
    pub simd: Simd,
    /// Tile side of the CPU's work in pixels, a power of two from 4 to 256
    #[arg(long, value_name = "T")]
    pub tile: Option<u32>,
    /// Seed of sampling patterns
    #[arg(long, value_name = "S")]
    pub seed: Option<u32>,
    /// Exposure of PNGs in stops
    #[arg(long, value_name = "EV", default_value_t = 0.0, allow_negative_numbers = true, value_parser = parse_exposure)]
    pub exposure: f32,
    /// Writes when each stage ran on which thread, as a chrome trace (render and bench)
    #[arg(long, value_name = "FILE")]
    pub trace: Option<PathBuf>,
    /// What stands in for parts of the scenes
    #[command(flatten)]
    pub scene: SceneArgs,
}

/// Bound of the VPLs' geometry term; `None`: no bound.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bound(pub Option<f32>);

fn parse_bound(text: &str) -> Result<Bound, String> {
    if text == "off" {
        return Ok(Bound(None));
    }
    match text.parse::<f32>() {
        Ok(x) if x > 0.0 && x.is_finite() => Ok(Bound(Some(x))),
        _ => Err("it must be `off` or a number over 0".into()),
    }
}

fn parse_switch(text: &str) -> Result<bool, String> {
    match text {
        "on" => Ok(true),
        "off" => Ok(false),
        _ => Err("it must be `on` or `off`".into()),
    }
}

fn parse_exposure(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(ev) if (-64.0..=64.0).contains(&ev) => Ok(ev),
        _ => Err("it must be a number of stops between -64 and 64".into()),
    }
}

impl PictureArgs {
    /// Settings of a frame; `default_size` where no size was given.
    ///
    /// # Errors
    /// Options that do not go together or lie out of range (wrong use).
    pub fn settings(&self, default_size: Size) -> Result<hybrid::RenderSettings, Failure> {
        let preset = match self.preset {
            PresetArg::Draft => hybrid::Preset::Draft,
            PresetArg::Interactive => hybrid::Preset::Interactive,
            PresetArg::High => hybrid::Preset::High,
        };
        let mut s = hybrid::RenderSettings::preset(preset);
        let size = self.size.unwrap_or(default_size);
        (s.width, s.height) = (size.0, size.1);
        if let Some(shadows) = self.shadows {
            s.shadows = match shadows {
                ShadowsArg::Moments => hybrid::Shadows::Moments,
                ShadowsArg::Certified => hybrid::Shadows::Certified,
                ShadowsArg::Traced => hybrid::Shadows::Traced,
                ShadowsArg::Off => hybrid::Shadows::Off,
            };
        }
        if let Some(filter) = self.shadow_filter {
            s.moments.filter = match filter {
                ShadowFilter::Vsm => hybrid::ShadowFilter::Vsm,
                ShadowFilter::Evsm4 => hybrid::ShadowFilter::Evsm4,
            };
        }
        s.moments.soft = self.soft_shadows.unwrap_or(s.moments.soft);
        if let Some(glass) = self.glass_shadows {
            s.glass_shadows = match glass {
                GlassShadowsArg::Opaque => hybrid::GlassShadows::Opaque,
                GlassShadowsArg::Clear => hybrid::GlassShadows::Clear,
            };
        }
        s.shadow_samples = self.shadow_samples.unwrap_or(s.shadow_samples);
        s.max_depth = self.depth.unwrap_or(s.max_depth);
        s.ray_budget = self.budget;
        s.min_weight = self.min_weight.unwrap_or(s.min_weight);
        s.tile = self.tile.unwrap_or(s.tile);
        s.seed = self.seed.unwrap_or(s.seed);
        s.vpl = self.vpl_options(s.vpl);
        match s.invalid() {
            Some(why) => Err(Failure::usage(why)),
            None => Ok(s),
        }
    }

    fn vpl_options(&self, preset: Option<hybrid::VplOptions>) -> Option<hybrid::VplOptions> {
        if self.no_indirect || self.bounces == Some(0) || self.vpls == Some(0) {
            return None;
        }
        let mut v = preset.unwrap_or_default();
        v.count = self.vpls.unwrap_or(v.count);
        // The preset's bounces fit any count; only an explicit number of them can be too many.
        v.bounces = self.bounces.unwrap_or(v.bounces.min(v.count));
        if let Some(Bound(bound)) = self.vpl_bound {
            v.geometry_term_max = bound;
        }
        if let Some(near_field) = self.vpl_near_field {
            v.near_field = match near_field {
                NearFieldArg::Off => hybrid::NearField::Off,
                NearFieldArg::Light => hybrid::NearField::Light,
                NearFieldArg::Full => hybrid::NearField::Full,
            };
        }
        v.candidates = self.vpl_candidates.unwrap_or(v.candidates);
        v.interleave = self.vpl_interleave.unwrap_or(v.interleave);
        v.spacing = self.vpl_spacing.unwrap_or(v.spacing);
        v.mirrored = self.mirror_vpls.unwrap_or(v.mirrored);
        v.reuse = self.vpl_reuse.unwrap_or(v.reuse);
        v.map_size = self.vpl_map_size.unwrap_or(v.map_size);
        if let Some(placement) = self.vpl_placement {
            v.placement = match placement {
                VplPlacementArg::Paths => hybrid::VplPlacement::Paths,
                VplPlacementArg::Surfels => hybrid::VplPlacement::Surfels,
            };
        }
        if let Some(shadows) = self.vpl_shadows {
            v.shadows = match shadows {
                VplShadowsArg::Off => hybrid::VplShadows::Off,
                VplShadowsArg::Maps => hybrid::VplShadows::Maps,
                VplShadowsArg::Traced => hybrid::VplShadows::Traced,
            };
        }
        Some(v)
    }

    /// What the renderer is made with.
    pub fn renderer_options(&self) -> hybrid::RendererOptions {
        hybrid::RendererOptions {
            raster: match self.raster {
                Raster::Auto => hybrid::RasterLane::Auto,
                Raster::Cpu => hybrid::RasterLane::Cpu,
                Raster::Gpu => hybrid::RasterLane::Gpu,
            },
            tracer: match self.tracer {
                Tracer::Auto => hybrid::Tracer::Auto,
                Tracer::Cpu => hybrid::Tracer::Cpu,
                Tracer::Gpu => hybrid::Tracer::Gpu,
                Tracer::GpuFragment => hybrid::Tracer::GpuFragment,
                Tracer::Rayquery => hybrid::Tracer::RayQuery,
            },
            threads: self.threads.unwrap_or(0) as usize,
            simd: match self.simd {
                Simd::Auto => hybrid::SimdLevel::Auto,
                Simd::Portable => hybrid::SimdLevel::Portable,
                Simd::Avx2 => hybrid::SimdLevel::Avx2,
                Simd::Avx512 => hybrid::SimdLevel::Avx512,
            },
            blas: match self.blas {
                Blas::Bvh => hybrid::BlasKind::Bvh,
                Blas::Kdtree => hybrid::BlasKind::KdTree,
            },
        }
    }

    /// Makes the renderer, and the process's own worker threads as many as were asked for.
    ///
    /// # Errors
    /// An explicit lane or SIMD level that this machine has not.
    pub fn renderer(&self) -> Result<hybrid::Renderer, Failure> {
        limit_threads(self.threads);
        Ok(hybrid::Renderer::new(self.renderer_options())?)
    }
}

/// Sets the size of the pool that tone mapping and encoding use.
pub fn limit_threads(threads: Option<u32>) {
    if let Some(n) = threads {
        // Fails only where the pool is there already; then its size is no matter of correctness.
        let _ = rayon::ThreadPoolBuilder::new().num_threads(n as usize).build_global();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes() {
        assert_eq!(parse_size("640x480"), Ok(Size(640, 480)));
        for bad in ["", "x", "640", "0x0", "640x0", "0x480", "-1x5", "16385x1", "99999999999999999999x1", "1x1x1", "a4"]
        {
            assert!(parse_size(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn options_change_the_preset() {
        let args = PictureArgs { vpls: Some(1), preset: PresetArg::High, ..PictureArgs::default() };
        let v = args.settings(Size(8, 8)).unwrap().vpl.unwrap();
        assert_eq!((v.count, v.bounces, v.shadows), (1, 1, hybrid::VplShadows::Maps));
        let none = PictureArgs { bounces: Some(0), ..PictureArgs::default() };
        assert_eq!(none.settings(Size(8, 8)).unwrap().vpl, None);
        let tile = PictureArgs { tile: Some(3), ..PictureArgs::default() };
        assert!(matches!(tile.settings(Size(8, 8)), Err(Failure::Usage(_))));
    }
}
