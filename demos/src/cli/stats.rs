//! Figures of rendered frames: what stands in stats.json and in the bench's JSON.

use catoptra_render_hybrid::{FrameStats, RasterLane, RayCounts, Renderer, SimdLevel, StageTimes};
use serde_json::{Map, Value, json};

/// One frame as it was made and measured.
#[derive(Clone, Debug)]
pub struct FrameRecord {
    /// Number of the frame.
    pub frame: u64,
    /// Hash of the linear picture or layer.
    pub hash: u64,
    /// From physics to tone-mapped pixels in memory, milliseconds.
    pub frame_ms: f64,
    /// Physics and extraction of the step before the frame, milliseconds.
    pub physics_ms: f64,
    /// Exposure and sRGB curve, milliseconds.
    pub tone_map_ms: f64,
    /// The renderer's own figures.
    pub stats: FrameStats,
}

/// Middle value; mean of the two middle ones for an even number; 0 for none.
pub fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut v: Vec<f64> = values.into_iter().collect();
    v.sort_unstable_by(f64::total_cmp);
    match v.len() {
        0 => 0.0,
        n if n % 2 == 1 => v[n / 2],
        n => 0.5 * (v[n / 2 - 1] + v[n / 2]),
    }
}

/// Least value that at least 95 in 100 do not exceed; 0 for none.
pub fn p95(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut v: Vec<f64> = values.into_iter().collect();
    v.sort_unstable_by(f64::total_cmp);
    let rank = (0.95 * v.len() as f64).ceil() as usize;
    v.get(rank.saturating_sub(1)).copied().unwrap_or(0.0)
}

/// Name of a lane in files.
pub fn lane_name(lane: RasterLane) -> &'static str {
    match lane {
        RasterLane::Auto => "auto",
        RasterLane::Cpu => "cpu",
        RasterLane::Gpu => "gpu",
    }
}

/// Name of a SIMD level in files.
pub fn simd_name(level: SimdLevel) -> &'static str {
    match level {
        SimdLevel::Auto => "auto",
        SimdLevel::Portable => "portable",
        SimdLevel::Avx2 => "avx2",
        SimdLevel::Avx512 => "avx512",
    }
}

/// The stages of one frame by name, milliseconds.
pub fn stages(record: &FrameRecord) -> [(&'static str, f64); 12] {
    let StageTimes { accel, moments, vpls, gbuffer, direct, indirect, traced, compose, transfer, total } =
        record.stats.stages_ms;
    [
        ("physics", record.physics_ms),
        ("accel", accel),
        ("moments", moments),
        ("vpls", vpls),
        ("gbuffer", gbuffer),
        ("direct", direct),
        ("indirect", indirect),
        ("traced", traced),
        ("compose", compose),
        ("transfer", transfer),
        ("tone_map", record.tone_map_ms),
        ("render_total", total),
    ]
}

/// Medians of the stages over frames, milliseconds rounded to the microsecond.
pub fn stage_medians(records: &[FrameRecord]) -> Value {
    stages_by(records, |times| median(times.iter().copied()))
}

/// Shortest times of the stages, as [`stage_medians`]: what other work on the machine disturbed least.
pub fn stage_leasts(records: &[FrameRecord]) -> Value {
    stages_by(records, least)
}

fn stages_by(records: &[FrameRecord], one: impl Fn(&[f64]) -> f64) -> Value {
    let Some(first) = records.first() else { return json!({}) };
    let each = stages(first).into_iter().enumerate().map(|(i, (name, _))| {
        let times: Vec<f64> = records.iter().map(|r| stages(r)[i].1).collect();
        (name.to_string(), json!(ms(one(&times))))
    });
    Value::Object(each.collect::<Map<_, _>>())
}

fn least(values: &[f64]) -> f64 {
    values.iter().copied().min_by(f64::total_cmp).unwrap_or(0.0)
}

/// Median, 95th percentile and least of the frames' times.
pub fn frame_times(records: &[FrameRecord]) -> Value {
    let times: Vec<f64> = records.iter().map(|r| r.frame_ms).collect();
    let all = || times.iter().copied();
    json!({ "median": ms(median(all())), "p95": ms(p95(all())), "least": ms(least(&times)) })
}

/// Rays by kind.
pub fn rays(rays: &RayCounts) -> [(&'static str, u64); 8] {
    let RayCounts { camera, moments, reflection, refraction, shadow, photon, vpl_maps, vpl } = *rays;
    [
        ("camera", camera),
        ("moments", moments),
        ("reflection", reflection),
        ("refraction", refraction),
        ("shadow", shadow),
        ("photon", photon),
        ("vpl_maps", vpl_maps),
        ("vpl", vpl),
    ]
}

/// Median rays a frame, by kind, and `total`.
pub fn ray_medians(records: &[FrameRecord]) -> Value {
    let Some(first) = records.first() else { return json!({}) };
    let mut map = Map::new();
    for (i, (name, _)) in rays(&first.stats.rays).iter().enumerate() {
        let value = median(records.iter().map(|r| rays(&r.stats.rays)[i].1 as f64));
        map.insert((*name).to_string(), json!(value.round() as u64));
    }
    let total = median(records.iter().map(|r| rays(&r.stats.rays).iter().map(|k| k.1).sum::<u64>() as f64));
    map.insert("total".into(), json!(total.round() as u64));
    Value::Object(map)
}

/// Median millions of rays a second, over the whole time of a frame: pixels and texels, which are scan-converted, are none.
pub fn mrays(records: &[FrameRecord]) -> f64 {
    let rate = |r: &FrameRecord| r.stats.rays.total() as f64 * 1e-3 / r.frame_ms.max(1e-6);
    ms(median(records.iter().map(rate)))
}

/// Median millions of rays a second by kind, over the stages that trace them: reflection and refraction over `traced`, photons and
/// VPLs' maps over `vpls`, rays to lights over `direct` and `traced`, rays to VPLs over `indirect` and `traced`. Kinds without
/// rays, and those whose stages were not timed, are left out; so are the camera's and the moments', which are scan-converted.
pub fn mrays_by_kind(records: &[FrameRecord]) -> Value {
    let rates = |kind: &str, r: &FrameRecord| {
        let s = r.stats.stages_ms;
        let stages = match kind {
            "reflection" | "refraction" => s.traced,
            "photon" | "vpl_maps" => s.vpls,
            "shadow" => s.direct + s.traced,
            "vpl" => s.indirect + s.traced,
            _ => 0.0,
        };
        let count = rays(&r.stats.rays).iter().find(|k| k.0 == kind).map_or(0, |k| k.1);
        (count > 0 && stages > 0.0).then(|| count as f64 * 1e-3 / stages)
    };
    let mut map = Map::new();
    for (kind, _) in rays(&RayCounts::default()) {
        let each: Vec<f64> = records.iter().filter_map(|r| rates(kind, r)).collect();
        if !each.is_empty() {
            map.insert(kind.to_string(), json!(ms(median(each))));
        }
    }
    Value::Object(map)
}

/// Milliseconds that processors have spent on this process so far, in steps of 10; `None` where the system does not tell.
pub fn processor_ms() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The name in brackets may hold anything; after it, utime and stime are the 12th and 13th.
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
    let mut ticks = || fields.next()?.parse::<f64>().ok();
    // USER_HZ is 100 on every Linux.
    Some(10.0 * (ticks()? + ticks()?))
}

/// One scene's entry in stats.json.
pub fn scene_entry(scene: &str, layer: &str, size: (u32, u32), triangles: usize, records: &[FrameRecord]) -> Value {
    let pixels = f64::from(size.0) * f64::from(size.1);
    let share = |s: &FrameStats| s.masked_pixels as f64 / pixels;
    let last = records.last().map(|r| &r.stats);
    let later = records.iter().skip(1);
    json!({
        "scene": scene,
        "layer": layer,
        "size": [size.0, size.1],
        "frames": records.len(),
        "triangles": triangles,
        "raster": last.map(|s| lane_name(s.raster)),
        "device": last.map(|s| s.device.clone()),
        "tracer": last.map(|s| s.tracer.name()),
        // What `auto` had chosen and the adapter could not hold.
        "tracer_fallback": last.and_then(|s| s.tracer_fallback.clone()),
        "frame_ms": frame_times(records),
        "stages_ms": stage_medians(records),
        "rays": ray_medians(records),
        "mray_per_s": mrays(records),
        "mray_per_s_by_kind": mrays_by_kind(records),
        "masked_share": median(records.iter().map(|r| share(&r.stats))),
        "vpls": last.map(|s| s.vpls),
        "vpls_reused": last.map(|s| s.vpls_reused),
        "tlas_nodes_touched": median(records.iter().map(|r| f64::from(r.stats.tlas_nodes_touched))),
        "blas_builds": {
            "first_frame": records.first().map(|r| r.stats.blas_builds),
            "later_frames": later.map(|r| u64::from(r.stats.blas_builds)).sum::<u64>(),
        },
        "uploaded_bytes": median(records.iter().map(|r| r.stats.bytes_up as f64)).round() as u64,
        "bytes_up": median(records.iter().map(|r| r.stats.bytes_up as f64)).round() as u64,
        "bytes_down": median(records.iter().map(|r| r.stats.bytes_down as f64)).round() as u64,
        "non_finite_pixels": records.iter().map(|r| r.stats.non_finite.0).sum::<u64>(),
        "per_frame": records.iter().map(|r| json!({
            "frame": r.frame,
            "hash": hex(r.hash),
            "ms": ms(r.frame_ms),
            "masked_share": share(&r.stats),
            "tlas_nodes_touched": r.stats.tlas_nodes_touched,
            "blas_builds": r.stats.blas_builds,
            "uploaded_bytes": r.stats.bytes_up,
            "pipelines_made": r.stats.pipelines_made,
            "bytes_up": r.stats.bytes_up,
            "bytes_down": r.stats.bytes_down,
        })).collect::<Vec<_>>(),
    })
}

/// Hash as it is printed: 16 hexadecimal digits.
pub fn hex(hash: u64) -> String {
    format!("{hash:016x}")
}

/// Milliseconds rounded to the microsecond.
pub fn ms(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0
}

/// The machine and how the renderer uses it.
pub fn machine(renderer: &Renderer) -> Value {
    json!({
        "cpu": cpu_name(),
        "cores": cores(),
        "threads": renderer.threads(),
        "simd": simd_name(renderer.simd_level()),
        // Which adapter rasterises; none on the CPU lane.
        "adapter": (renderer.lane() == RasterLane::Gpu).then(|| renderer.device()),
        "os": std::env::consts::OS,
        "arch": std::env::consts::ARCH,
        "version": env!("CARGO_PKG_VERSION"),
        "profile": if cfg!(debug_assertions) { "dev" } else { "release" },
    })
}

/// Processors that this process may use.
pub fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// The processor's own name, as far as the system tells it.
pub fn cpu_name() -> String {
    let from_linux = || {
        let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
        let value = |key: &str| {
            let line = text.lines().find(|l| l.split(':').next().is_some_and(|k| k.trim() == key))?;
            Some(line.split_once(':')?.1.trim().to_string()).filter(|v| !v.is_empty())
        };
        value("model name").or_else(|| value("Model")).or_else(|| value("Hardware"))
    };
    let from_mac = || {
        let command = std::process::Command::new("sysctl").args(["-n", "machdep.cpu.brand_string"]).output().ok()?;
        Some(String::from_utf8_lossy(&command.stdout).trim().to_string()).filter(|v| !v.is_empty())
    };
    let from_windows = || std::env::var("PROCESSOR_IDENTIFIER").ok();
    let found = match std::env::consts::OS {
        "linux" | "android" => from_linux(),
        "macos" => from_mac(),
        "windows" => from_windows(),
        _ => None,
    };
    found.unwrap_or_else(|| format!("unknown {}", std::env::consts::ARCH))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_and_percentiles() {
        assert_eq!(median([]), 0.0);
        assert_eq!(median([3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median([4.0, 1.0, 2.0, 3.0]), 2.5);
        assert_eq!(p95([]), 0.0);
        assert_eq!(p95([5.0]), 5.0);
        assert_eq!(p95((1..=100).map(f64::from)), 95.0);
        assert_eq!(p95((1..=20).map(f64::from)), 19.0);
    }

    #[test]
    fn rates_are_over_the_stages_that_trace() {
        let stages_ms = StageTimes { traced: 4.0, vpls: 2.0, ..StageTimes::default() };
        let counts = RayCounts {
            camera: 9,
            reflection: 8000,
            refraction: 0,
            shadow: 2000,
            photon: 1000,
            ..RayCounts::default()
        };
        let stats = FrameStats { stages_ms, rays: counts, ..FrameStats::default() };
        let record = FrameRecord { frame: 0, hash: 0, frame_ms: 10.0, physics_ms: 0.0, tone_map_ms: 0.0, stats };
        let untimed = FrameRecord {
            stats: FrameStats { stages_ms: StageTimes::default(), ..record.stats.clone() },
            ..record.clone()
        };
        assert_eq!(
            mrays_by_kind(std::slice::from_ref(&record)),
            json!({ "reflection": 2.0, "shadow": 0.5, "photon": 0.5 })
        );
        assert_eq!(mrays_by_kind(&[untimed]), json!({}));
        assert_eq!(stage_leasts(&[record])["traced"], json!(4.0));
    }

    #[test]
    fn processor_time_goes_on() {
        let Some(before) = processor_ms() else { return };
        let start = std::time::Instant::now();
        let mut x = 1u64;
        // Until it shows, within reason.
        while processor_ms().unwrap() < before + 30.0 && start.elapsed().as_secs() < 60 {
            (0..100_000).for_each(|_| x = std::hint::black_box(x.wrapping_mul(3)));
        }
        let spent = processor_ms().unwrap() - before;
        assert!(spent >= 30.0, "{spent}");
    }

    #[test]
    fn builds_after_the_first_frame_are_told_apart() {
        let record = |frame, blas_builds| FrameRecord {
            frame,
            hash: 7,
            frame_ms: 2.0,
            physics_ms: 0.5,
            tone_map_ms: 0.25,
            stats: FrameStats { blas_builds, masked_pixels: 8, ..FrameStats::default() },
        };
        let entry = scene_entry("s", "final", (4, 4), 22, &[record(0, 3), record(1, 0), record(2, 1)]);
        assert_eq!(entry["blas_builds"], json!({ "first_frame": 3, "later_frames": 1 }));
        assert_eq!(entry["masked_share"], json!(0.5));
        assert_eq!(entry["per_frame"][1]["hash"], json!("0000000000000007"));
        assert_eq!(entry["stages_ms"]["physics"], json!(0.5));
    }
}
