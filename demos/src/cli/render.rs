//! `render`: frames to files.

use super::{
    args::{Format, LayerArg, RenderArgs},
    failure::{Failure, line, note},
    options::{PictureArgs, Size},
    progress::Progress,
    stats::{self, FrameRecord},
    target::Target,
    trace_file,
    world::World,
};
use catoptra_render_hybrid::{Frame, Image, Layer, RenderSettings, Renderer, image_io};
use serde_json::json;
use std::{
    path::{Path, PathBuf},
    time::Instant,
};

/// Side of a picture where no size is given.
pub const DEFAULT_SIZE: Size = Size(1024, 1024);

impl LayerArg {
    /// The renderer's layer, and its name.
    pub fn layer(self) -> (Layer, &'static str) {
        Layer::ALL[self as usize]
    }
}

/// What `render` does, also for the bare command.
pub struct RenderJob<'a> {
    /// Scenes and files.
    pub targets: Vec<Target>,
    /// First frame.
    pub first: u64,
    /// Number of frames.
    pub frames: u64,
    /// Which layer is written.
    pub layer: LayerArg,
    /// In which format.
    pub format: Format,
    /// Into which folder.
    pub out: &'a Path,
    /// How.
    pub picture: &'a PictureArgs,
}

/// Runs `render`.
pub fn run(args: &RenderArgs) -> Result<(), Failure> {
    let (first, frames) = match (args.frame, args.frames) {
        (_, Some(n)) => (0, n),
        (k, None) => (k.unwrap_or(0), 1),
    };
    let (layer, format, out) = (args.layer, args.format, args.out.as_path());
    render(&RenderJob {
        targets: Target::parse(&args.target)?,
        first,
        frames,
        layer,
        format,
        out,
        picture: &args.picture,
    })
}

/// Renders and writes all frames of all targets, then stats.json.
pub fn render(job: &RenderJob<'_>) -> Result<(), Failure> {
    let mut settings = job.picture.settings(DEFAULT_SIZE)?;
    settings.keep_layers = job.layer != LayerArg::Final;
    settings.time_passes = job.picture.trace.is_some();
    refuse_more_than_memory(&settings)?;
    let options = job.picture.scene.options_for(&job.targets)?;
    let recording = trace_file::start(job.picture.trace.as_deref())?;
    let mut renderer = None;
    let mut entries = Vec::new();
    for target in &job.targets {
        let mut world = World::open(target, &options)?;
        let renderer = match &mut renderer {
            Some(renderer) => renderer,
            // Folder and machine are asked once something can be drawn, and before it is.
            none => {
                prepare_folder(job.out)?;
                let made = none.insert(job.picture.renderer()?);
                made.prepare(&settings)?;
                made
            }
        };
        entries.push(render_target(job, &mut world, renderer, &settings, recording.as_ref())?);
    }
    trace_file::finish(recording)?;
    let Some(renderer) = renderer else { return Ok(()) };
    let file = json!({
        "machine": stats::machine(&renderer),
        "raster": stats::lane_name(renderer.lane()),
        "device": renderer.device(),
        "tracer": renderer.tracer().tracer.name(),
        "tracer_why": renderer.tracer().why,
        "scenes": entries,
    });
    image_io::write_atomically(&job.out.join("stats.json"), format!("{file:#}\n").as_bytes())?;
    Ok(())
}

fn render_target(
    job: &RenderJob<'_>,
    world: &mut World,
    renderer: &mut Renderer,
    settings: &RenderSettings,
    recording: Option<&trace_file::Recording>,
) -> Result<serde_json::Value, Failure> {
    let (layer, layer_name) = job.layer.layer();
    // All but the last step before the first frame; that one belongs to the frame's own time.
    world.advance_to(job.first.saturating_sub(1));
    let mut progress = Progress::new(&world.name, job.frames);
    let mut records = Vec::new();
    let mut size = (settings.width, settings.height);
    let mut canvas = Canvas::default();
    for k in job.first..job.first + job.frames {
        let record = make_frame(world, renderer, settings, k, layer, job.picture.exposure, &mut canvas)?;
        let picture = canvas.picture(layer)?;
        trace_file::add(recording, &record.stats.timeline);
        if k == job.first && record.stats.non_finite.0 > 0 {
            let (count, at) = record.stats.non_finite;
            note(format!("{}: {count} pixels were not finite and are black, the first at {at:?}", world.name));
        }
        size = (picture.width, picture.height);
        let path = picture_path(job.out, &world.name, job.layer, k, job.format);
        match job.format {
            Format::Png => image_io::write_png(&path, size.0, size.1, &canvas.srgb8)?,
            Format::Exr => image_io::write_exr(&path, picture)?,
        }
        let text = format!(
            "frame={k} scene={} hash={} ms={:.3} file={}",
            world.name,
            stats::hex(record.hash),
            record.frame_ms,
            path.display()
        );
        progress.suspend(|| line(text))?;
        records.push(record);
        progress.set(k + 1 - job.first);
    }
    Ok(stats::scene_entry(&world.name, layer_name, size, world.scene().triangle_count(), &records))
}

/// A frame and its picture, whose memory serves the next one.
#[derive(Default)]
pub struct Canvas {
    frame: Frame,
    /// sRGB bytes of the layer.
    pub srgb8: Vec<u8>,
}

impl Canvas {
    /// The layer as linear light.
    ///
    /// # Errors
    /// Where the frame has no such layer.
    pub fn picture(&self, layer: Layer) -> Result<&Image, Failure> {
        self.frame.layer(layer).ok_or_else(|| Failure::other(format!("the scene has no {layer:?} layer")))
    }
}

/// Steps the world to frame `k`, draws it and tone-maps it: what `frame_ms` measures. Returns the figures.
pub fn make_frame(
    world: &mut World,
    renderer: &mut Renderer,
    settings: &RenderSettings,
    k: u64,
    layer: Layer,
    exposure_ev: f32,
    canvas: &mut Canvas,
) -> Result<FrameRecord, Failure> {
    let start = Instant::now();
    world.advance(k - world.frame());
    let physics_ms = millis(start);
    renderer.render_into(world.scene(), settings, &mut canvas.frame)?;
    let tone_map = Instant::now();
    let mut srgb8 = std::mem::take(&mut canvas.srgb8);
    match layer {
        Layer::Final => image_io::srgb8_into(canvas.picture(layer)?, exposure_ev, &mut srgb8),
        _ => srgb8 = image_io::srgb8_from_layer(layer, canvas.picture(layer)?, exposure_ev),
    }
    canvas.srgb8 = srgb8;
    let (tone_map_ms, frame_ms) = (millis(tone_map), millis(start));
    let (hash, stats) = (canvas.picture(layer)?.hash(), canvas.frame.stats.clone());
    Ok(FrameRecord { frame: k, hash, frame_ms, physics_ms, tone_map_ms, stats })
}

/// Milliseconds since `start`.
pub fn millis(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

fn picture_path(out: &Path, name: &str, layer: LayerArg, frame: u64, format: Format) -> PathBuf {
    let ending = format.extension();
    match layer {
        LayerArg::Final => out.join(format!("{name}-{frame:04}.{ending}")),
        _ => out.join(format!("{name}-{}-{frame:04}.{ending}", layer.layer().1)),
    }
}

/// Refuses pictures that would exhaust the machine: what the system does then is no clear line.
///
/// # Errors
/// With both figures in words. Where the system does not tell its memory nothing is refused.
pub fn refuse_more_than_memory(settings: &RenderSettings) -> Result<(), Failure> {
    // Linear picture, sRGB bytes and encoded file, with a margin; a layer each where they are kept.
    let bytes_per_pixel = if settings.keep_layers { 40 + 9 * 12 } else { 40 };
    let need = u64::from(settings.width) * u64::from(settings.height) * bytes_per_pixel;
    match available_memory() {
        Some(there) if need > there => Err(Failure::other(format!(
            "a picture of {}x{} takes about {:.1} GiB of memory and {:.1} GiB are free; choose a smaller --size",
            settings.width,
            settings.height,
            gib(need),
            gib(there)
        ))),
        _ => Ok(()),
    }
}

fn gib(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 30)
}

/// Free memory in bytes, as Linux tells it.
fn available_memory() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix("MemAvailable:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? * 1024)
}

/// Makes the folder and tries to write into it, so that an unwritable one is told before the work.
fn prepare_folder(out: &Path) -> Result<(), Failure> {
    let failed = |e: std::io::Error| Failure::other(format!("cannot write into {}: {e}", out.display()));
    std::fs::create_dir_all(out).map_err(failed)?;
    let probe = out.join(format!(".catoptra-{}", std::process::id()));
    std::fs::write(&probe, []).and_then(|()| std::fs::remove_file(&probe)).map_err(failed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layers_and_names_agree() {
        use clap::ValueEnum;
        for layer in LayerArg::value_variants() {
            let name = layer.to_possible_value().unwrap().get_name().to_string();
            assert_eq!(layer.layer().1, name);
        }
    }

    #[test]
    fn file_names_follow_the_contract() {
        let name = |layer, frame, format| picture_path(Path::new("o"), "s", layer, frame, format);
        assert_eq!(name(LayerArg::Final, 7, Format::Png), Path::new("o/s-0007.png"));
        assert_eq!(name(LayerArg::Indirect, 90, Format::Exr), Path::new("o/s-indirect-0090.exr"));
        assert_eq!(name(LayerArg::Final, 12345, Format::Exr), Path::new("o/s-12345.exr"));
    }
}
