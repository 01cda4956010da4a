//! `bench`: frame times, per stage.

use super::{
    args::BenchArgs,
    failure::{Failure, line},
    progress::Progress,
    render::{Canvas, DEFAULT_SIZE, make_frame, refuse_more_than_memory},
    stats::{self, FrameRecord},
    target::Target,
    trace_file,
    world::World,
};
use catoptra_render_hybrid::{Layer, image_io};
use serde_json::{Value, json};
use std::path::Path;

/// Frames before the measured ones: they build trees, compile shaders and warm caches.
const WARM_UP: u64 = 2;

/// Runs `bench`.
pub fn run(args: &BenchArgs) -> Result<(), Failure> {
    let mut settings = args.picture.settings(DEFAULT_SIZE)?;
    settings.double_buffered = args.double_buffer;
    settings.time_passes = args.stages || args.picture.trace.is_some();
    let targets = Target::parse(&args.target)?;
    refuse_more_than_memory(&settings)?;
    let options = args.picture.scene.options_for(&targets)?;
    let mut renderer = args.picture.renderer()?;
    let recording = trace_file::start(args.picture.trace.as_deref())?;
    let json_alone = args.json.as_deref() == Some(Path::new("-"));
    let mut scenes = Vec::new();
    let mut canvas = Canvas::default();
    renderer.prepare(&settings)?;
    for target in &targets {
        let mut world = World::open(target, &options)?;
        let mut progress = Progress::new(&world.name, WARM_UP + args.frames);
        let mut records: Vec<FrameRecord> = Vec::new();
        let mut before = None;
        for k in 0..WARM_UP + args.frames {
            if k == WARM_UP {
                before = stats::processor_ms();
            }
            let exposure = args.picture.exposure;
            let record = make_frame(&mut world, &mut renderer, &settings, k, Layer::Final, exposure, &mut canvas)?;
            if k >= WARM_UP {
                trace_file::add(recording.as_ref(), &record.stats.timeline);
                records.push(record);
            }
            progress.set(k + 1);
        }
        drop(progress);
        let size = (settings.width, settings.height);
        // Rounded to hundredths of a second at both ends.
        let spent = before.zip(stats::processor_ms()).map(|(a, b)| (b - a) / args.frames as f64);
        let mut entry = entry(&world, size, &records);
        entry["processor_ms"] = json!(spent.map(stats::ms));
        if !json_alone {
            print(&entry)?;
        }
        scenes.push(entry);
    }
    trace_file::finish(recording)?;
    let file = json!({ "machine": stats::machine(&renderer), "scenes": scenes });
    match &args.json {
        None => Ok(()),
        Some(_) if json_alone => line(format!("{file:#}")),
        Some(path) => Ok(image_io::write_atomically(path, format!("{file:#}\n").as_bytes())?),
    }
}

fn entry(world: &World, size: (u32, u32), records: &[FrameRecord]) -> Value {
    let last = records.last().map(|r| &r.stats);
    json!({
        "scene": world.name,
        "lane": last.map(|s| stats::lane_name(s.raster)),
        "device": last.map(|s| s.device.clone()),
        "tracer": last.map(|s| s.tracer.name()),
        "size": [size.0, size.1],
        "frames": records.len(),
        "triangles": world.scene().triangle_count(),
        "frame_ms": stats::frame_times(records),
        "stages_ms": stats::stage_medians(records),
        "stages_least_ms": stats::stage_leasts(records),
        "rays": stats::ray_medians(records),
        "mray_per_s": stats::mrays(records),
        "mray_per_s_by_kind": stats::mrays_by_kind(records),
        // Frames by which pictures are late, and pipelines that frames waited for.
        "latency_frames": last.map(|s| s.latency_frames),
        "pipelines_made": records.iter().map(|r| r.stats.pipelines_made).sum::<u64>(),
    })
}

fn print(entry: &Value) -> Result<(), Failure> {
    let number = |v: &Value| v.as_f64().unwrap_or(0.0);
    let text = |v: &Value| v.as_str().unwrap_or("").to_string();
    let median = number(&entry["frame_ms"]["median"]);
    line(format!(
        "{}: {:.2} ms a frame (95%: {:.2}), {:.1} frames/s, {} {}, {}x{}, {} triangles",
        text(&entry["scene"]),
        median,
        number(&entry["frame_ms"]["p95"]),
        1e3 / median.max(1e-6),
        text(&entry["lane"]),
        text(&entry["device"]),
        entry["size"][0],
        entry["size"][1],
        entry["triangles"],
    ))?;
    let list = |key: &str, digits: usize| {
        let parts = entry[key].as_object().into_iter().flatten().filter(|(_, v)| number(v) > 0.0);
        parts.map(|(k, v)| format!("{k} {:.digits$}", number(v))).collect::<Vec<_>>().join(", ")
    };
    line(format!("  ms: {}", list("stages_ms", 2)))?;
    line(format!("  rays: {}; {:.2} Mray/s", list("rays", 0), number(&entry["mray_per_s"])))?;
    let by_kind = list("mray_per_s_by_kind", 2);
    if by_kind.is_empty() { Ok(()) } else { line(format!("  Mray/s of the stages that trace: {by_kind}")) }
}
