//! The subcommands and their arguments.

use super::options::{PictureArgs, SceneArgs, Size, parse_size};
use crate::play::WindowArg;
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;

/// Hybrid rendering: rasterised light, ray-traced mirrors and glass, on any machine.
///
/// Without a subcommand: plays rolling-box, or, without a display, renders the five scenes to ./out.
#[derive(Clone, Debug, Parser)]
#[command(name = "catoptra", version, propagate_version = true)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Option<Command>,
}

/// The subcommands.
#[derive(Clone, Debug, Subcommand)]
pub enum Command {
    /// Lists the scenes with their triangle counts
    List(SceneArgs),
    /// Shows version, adapters, SIMD level and threads
    Info,
    /// Plays a scene in a window
    Play(PlayArgs),
    /// Renders frames to files
    Render(RenderArgs),
    /// Measures frame times
    Bench(BenchArgs),
    /// Path-traces the truth of a frame
    Reference(ReferenceArgs),
    /// Compares the hybrid picture with the reference
    Judge(JudgeArgs),
    /// Compares two pictures: FLIP, relMSE, PSNR
    Compare(CompareArgs),
    /// Writes a posed frame as GLB for other renderers
    Export(ExportArgs),
    /// Plays a recorded game
    Replay(ReplayArgs),
}

/// Arguments of `play`.
#[derive(Clone, Debug, Default, Args)]
pub struct PlayArgs {
    /// Scene; a picker is shown when none is named
    pub scene: Option<String>,
    /// Records the first game that is played, for `replay`
    #[arg(long, value_name = "FILE")]
    pub record: Option<PathBuf>,
    /// Watches the scene instead of playing its game
    #[arg(long)]
    pub watch: bool,
    /// Closes the window after S seconds and writes the frame times to out/NAME-times.svg
    #[arg(long, value_name = "S", value_parser = positive_seconds)]
    pub seconds: Option<f64>,
    /// How pictures come into the window
    #[arg(long, value_enum, default_value_t)]
    pub window: WindowArg,
    /// Takes the window's graphics device away after N pictures: what follows is tested with it
    #[arg(long, value_name = "N", hide = true)]
    pub lose_device: Option<u64>,
    /// How the picture is made
    #[command(flatten)]
    pub picture: PictureArgs,
}

/// Which stage of the picture is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
#[allow(missing_docs)]
pub enum LayerArg {
    #[default]
    Final,
    Direct,
    Indirect,
    Traced,
    Mask,
    Depth,
    Normal,
    Albedo,
    Moments,
}

/// File format of pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// 8 bits, exposure and sRGB curve
    #[default]
    Png,
    /// 32-bit float, linear radiance, unclamped
    Exr,
}

impl Format {
    /// Ending of a file's name.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Exr => "exr",
        }
    }
}

/// Arguments of `render`.
#[derive(Clone, Debug, Args)]
pub struct RenderArgs {
    /// Scene, `all`, or a glTF or GLB file
    #[arg(value_name = "SCENE|all|FILE.glb")]
    pub target: String,
    /// Renders the state after K steps of 1/60 s [default: 0]
    #[arg(long, value_name = "K", conflicts_with = "frames")]
    pub frame: Option<u64>,
    /// Renders frames 0 to N-1
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub frames: Option<u64>,
    /// Writes one layer instead of the final picture
    #[arg(long, value_enum, default_value_t)]
    pub layer: LayerArg,
    /// File format
    #[arg(long, value_enum, default_value_t)]
    pub format: Format,
    /// Folder of the files, made where it is missing
    #[arg(long, value_name = "DIR", default_value = "out")]
    pub out: PathBuf,
    /// How the picture is made
    #[command(flatten)]
    pub picture: PictureArgs,
}

/// Arguments of `bench`.
#[derive(Clone, Debug, Args)]
pub struct BenchArgs {
    /// Scene, `all`, or a glTF or GLB file
    #[arg(value_name = "SCENE|all")]
    pub target: String,
    /// Frames that are measured, after two that are not
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub frames: u64,
    /// CPU and GPU work on two frames at once (GPU lane): faster, and each picture comes one frame later
    #[arg(long)]
    pub double_buffer: bool,
    /// Times the GPU's passes one by one, which slows frames a little (`--trace` does it, too)
    #[arg(long)]
    pub stages: bool,
    /// Writes the figures as JSON, to stdout where no file is named
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-")]
    pub json: Option<PathBuf>,
    /// How the picture is made
    #[command(flatten)]
    pub picture: PictureArgs,
}

/// Arguments of `reference`.
#[derive(Clone, Debug, Args)]
pub struct ReferenceArgs {
    /// Scene, or a glTF or GLB file
    #[arg(value_name = "SCENE|FILE.glb")]
    pub target: String,
    /// State after K steps of 1/60 s
    #[arg(long, value_name = "K", default_value_t = 0)]
    pub frame: u64,
    /// Samples a pixel [default: 64]
    #[arg(long, value_name = "N", conflicts_with = "seconds", value_parser = clap::value_parser!(u32).range(1..=1 << 24))]
    pub spp: Option<u32>,
    /// Goes on for this long
    #[arg(long, value_name = "S", value_parser = positive_seconds)]
    pub seconds: Option<f64>,
    /// Diffuse reflections before the last one to the camera path; 0: direct light only
    #[arg(long, value_name = "B", default_value_t = 2, value_parser = clap::value_parser!(u32).range(0..=64))]
    pub bounces: u32,
    /// Goes on with the samples that an earlier run left beside the file, as FILE.exr.state
    #[arg(long)]
    pub resume: bool,
    /// The picture, linear 32-bit EXR
    #[arg(long, value_name = "FILE.exr")]
    pub out: PathBuf,
    /// Width and height in pixels
    #[arg(long, value_name = "WxH", value_parser = parse_size, default_value = "1024x1024")]
    pub size: Size,
    /// Most mirrors and glass interfaces in a row on a path
    #[arg(long, value_name = "D", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub depth: u32,
    /// Seed of the samples
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u32,
    /// Worker threads [default: one a processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub threads: Option<u32>,
    /// What stands in for parts of the scenes
    #[command(flatten)]
    pub scene: SceneArgs,
}

/// Arguments of `judge`.
#[derive(Clone, Debug, Args)]
pub struct JudgeArgs {
    /// Scene or `all`
    #[arg(value_name = "SCENE|all")]
    pub target: String,
    /// State after K steps of 1/60 s
    #[arg(long, value_name = "K", default_value_t = 0)]
    pub frame: u64,
    /// Samples a pixel of the reference
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(2..=1 << 24))]
    pub spp: u32,
    /// How the picture is made
    #[command(flatten)]
    pub picture: PictureArgs,
}

/// Arguments of `compare`.
#[derive(Clone, Debug, Args)]
pub struct CompareArgs {
    /// Picture under test, PNG or EXR
    pub a: PathBuf,
    /// Reference, PNG or EXR
    pub b: PathBuf,
    /// Writes the FLIP error of each pixel as a PNG in colours
    #[arg(long, value_name = "FILE")]
    pub heat: Option<PathBuf>,
}

/// Arguments of `export`.
#[derive(Clone, Debug, Args)]
pub struct ExportArgs {
    /// Scene, or a glTF or GLB file
    #[arg(value_name = "SCENE")]
    pub target: String,
    /// State after K steps of 1/60 s
    #[arg(long, value_name = "K", default_value_t = 0)]
    pub frame: u64,
    /// The file
    #[arg(value_name = "FILE.glb")]
    pub file: PathBuf,
    /// What stands in for parts of the scenes
    #[command(flatten)]
    pub scene: SceneArgs,
}

/// Arguments of `replay`.
#[derive(Clone, Debug, Args)]
pub struct ReplayArgs {
    /// The recording
    pub file: PathBuf,
    /// Worker threads; they change nothing but the time it takes [default: one a processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub threads: Option<u32>,
    /// Writes the last frame as a PNG, too
    #[arg(long, value_name = "FILE.png")]
    pub picture: Option<PathBuf>,
    /// Size of that picture; the hashes are of the size in the recording
    #[arg(long, value_name = "WxH", value_parser = parse_size, default_value = "1280x720", requires = "picture")]
    pub size: Size,
}

fn positive_seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(s) if s > 0.0 && s.is_finite() => Ok(s),
        _ => Err("it must be a number of seconds over 0".into()),
    }
}
