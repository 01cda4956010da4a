//! `reference`: the path-traced truth of a frame, in as many sittings as it takes.

use super::{
    args::ReferenceArgs,
    failure::{Failure, line, note},
    file,
    options::{self, PictureArgs},
    progress::Progress,
    stats,
    target::Target,
    world::World,
};
use catoptra_engine::RenderScene;
use catoptra_render_hybrid::{
    GlassShadows, RasterLane, Renderer, RendererOptions, image_io, metrics,
    trace::reference::{ReferenceAccumulator, ReferenceOptions},
};
use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

/// Samples a pixel where neither `--spp` nor `--seconds` is given.
const DEFAULT_SPP: u32 = 64;
/// The state is saved this often, so that a long run that is cut off loses little.
const SAVE_EVERY: Duration = Duration::from_secs(60);
/// A pass of samples should take about this long: fine enough for `--seconds`, coarse enough to keep all cores busy.
const PASS: Duration = Duration::from_millis(500);

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Until {
    /// So many samples a pixel in all.
    Spp(u32),
    /// So many seconds of this run, and at least one sample.
    Seconds(f64),
}

/// Runs `reference`.
pub fn run(args: &ReferenceArgs) -> Result<(), Failure> {
    if args.out.extension().is_none_or(|e| !e.eq_ignore_ascii_case("exr")) {
        return Err(Failure::usage(format!("{}: --out takes a file that ends in .exr", args.out.display())));
    }
    let target = Target::parse_one(&args.target)?;
    let options = ReferenceOptions {
        width: args.size.0,
        height: args.size.1,
        bounces: args.bounces,
        max_depth: args.depth,
        glass_shadows: GlassShadows::Opaque,
        seed: args.seed,
    };
    let mut world = World::open(&target, &args.scene.options_for(std::slice::from_ref(&target))?)?;
    let mut renderer = renderer(args.threads)?;
    world.advance_to(args.frame);
    let scene = world.scene();

    let state = State::beside(&args.out, scene, &options);
    let mut accumulator = if args.resume { state.load()? } else { None }
        .unwrap_or_else(|| ReferenceAccumulator::new(options.width, options.height));
    // An unwritable place is told before the work, not after hours of it.
    state.save(&accumulator)?;

    let until = match (args.spp, args.seconds) {
        (_, Some(s)) => Until::Seconds(s),
        (spp, None) => Until::Spp(spp.unwrap_or(DEFAULT_SPP)),
    };
    let start = Instant::now();
    let mut saved = Instant::now();
    let mut failure = None;
    let rays = integrate(&mut renderer, scene, &options, &mut accumulator, until, |accumulator| {
        if saved.elapsed() > SAVE_EVERY {
            saved = Instant::now();
            failure = state.save(accumulator).err();
        }
        failure.is_none()
    })?;
    if let Some(failure) = failure {
        return Err(failure);
    }
    let ms = start.elapsed().as_secs_f64() * 1e3;

    state.save(&accumulator)?;
    let image = accumulator.image();
    image_io::write_exr(&args.out, &image)?;
    line(format!(
        "frame={} scene={} hash={} spp={} rays={rays} halves_flip={} ms={ms:.3} file={}",
        args.frame,
        world.name,
        stats::hex(image.hash()),
        accumulator.spp(),
        halves_flip(&accumulator).map_or_else(|| "none".into(), |f| format!("{f:.6}")),
        args.out.display()
    ))
}

/// A renderer for references: they need no raster lane.
fn renderer(threads: Option<u32>) -> Result<Renderer, Failure> {
    options::limit_threads(threads);
    let threads = threads.unwrap_or(0) as usize;
    Ok(Renderer::new(RendererOptions { raster: RasterLane::Cpu, threads, ..RendererOptions::default() })?)
}

/// Adds samples until it is time to stop, or `go_on` says no. Returns the rays of this call.
pub fn integrate(
    renderer: &mut Renderer,
    scene: &RenderScene,
    options: &ReferenceOptions,
    accumulator: &mut ReferenceAccumulator,
    until: Until,
    mut go_on: impl FnMut(&ReferenceAccumulator) -> bool,
) -> Result<u64, Failure> {
    let start = Instant::now();
    let total = match until {
        Until::Spp(n) => u64::from(n),
        Until::Seconds(s) => s.ceil() as u64,
    };
    let mut progress = Progress::new("reference", total);
    let mut rays = 0;
    let mut pass = 1;
    loop {
        let left = match until {
            Until::Spp(n) => n.saturating_sub(accumulator.spp()),
            Until::Seconds(s) if accumulator.spp() > 0 && start.elapsed().as_secs_f64() >= s => 0,
            Until::Seconds(_) => u32::MAX,
        };
        if left == 0 || !go_on(accumulator) {
            return Ok(rays);
        }
        let began = Instant::now();
        let samples = pass.min(left);
        rays += renderer.add_reference(accumulator, scene, options, samples)?;
        let took = began.elapsed();
        progress.set(match until {
            Until::Spp(_) => u64::from(accumulator.spp()),
            Until::Seconds(_) => (start.elapsed().as_secs()).min(total),
        });
        if took < PASS / 2 {
            pass = (pass * 2).min(256);
        } else if took > PASS * 2 {
            pass = (pass / 2).max(1);
        }
    }
}

/// FLIP between the two halves of the samples: at most 0.02 makes a picture that can be judged by. `None` below two samples.
pub fn halves_flip(accumulator: &ReferenceAccumulator) -> Option<f64> {
    if accumulator.spp() < 2 {
        return None;
    }
    let comparison = metrics::compare(&accumulator.half(0), &accumulator.half(1)).ok()?;
    Some(comparison.flip.mean())
}

/// A reference that matches the hybrid picture of `picture`, for `judge`.
pub fn matching(picture: &PictureArgs, settings: &catoptra_render_hybrid::RenderSettings) -> ReferenceOptions {
    let mut options = ReferenceOptions::matching(settings);
    // A reference is not the place to save rays: only an explicit depth limits it.
    options.max_depth = picture.depth.unwrap_or(options.max_depth.max(16));
    options
}

/// The samples so far, in a file beside the picture.
struct State {
    path: PathBuf,
    header: String,
}

impl State {
    fn beside(out: &Path, scene: &RenderScene, options: &ReferenceOptions) -> Self {
        let mut path = out.as_os_str().to_owned();
        path.push(".state");
        // Samples may only be added to samples of the same scene and integral.
        let header = format!("catoptra-reference {:016x} {options:?}\n", file::fingerprint(scene));
        Self { path: path.into(), header }
    }

    fn load(&self) -> Result<Option<ReferenceAccumulator>, Failure> {
        let path = self.path.display();
        let bytes = match std::fs::read(&self.path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
                note(format!("{path} is not there; starting with the first sample"));
                return Ok(None);
            }
            Err(e) => return Err(Failure::other(format!("cannot read {path}: {e}"))),
        };
        let Some(body) = bytes.strip_prefix(self.header.as_bytes()) else {
            let what = "holds another scene, frame, size or option; leave --resume out to start anew";
            return Err(Failure::other(format!("{path} {what}")));
        };
        match ReferenceAccumulator::from_bytes(body) {
            Some(accumulator) => Ok(Some(accumulator)),
            None => Err(Failure::other(format!("{path} is damaged; leave --resume out to start anew"))),
        }
    }

    fn save(&self, accumulator: &ReferenceAccumulator) -> Result<(), Failure> {
        let mut bytes = self.header.clone().into_bytes();
        bytes.extend(accumulator.to_bytes());
        Ok(image_io::write_atomically(&self.path, &bytes)?)
    }
}
