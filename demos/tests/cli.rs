//! The command line's contract: what scripts may rely on.
//!
//! Bad input gets one clear line on stderr, the right exit status, no panic and no half-written file. Everything runs on the
//! CPU lane with small pictures, so that it passes on any machine.

use catoptra_render_hybrid::image_io;
use std::{
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

const FAST: [&str; 8] = ["--size", "24x16", "--raster", "cpu", "--preset", "draft", "--shadows", "off"];
/// A triangle with neither camera nor light; `TRANSLATION` is put in.
const TRIANGLE: &str = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],
"nodes":[{"mesh":0,"translation":TRANSLATION}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}],
"bufferViews":[{"buffer":0,"byteLength":36}],"buffers":[{"byteLength":36,
"uri":"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]}"#;

fn catoptra(args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    // Without a display, wherever the tests run.
    command.args(args).env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
    command.output().expect("the binary runs")
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).expect("stdout is UTF-8")
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).expect("stderr is UTF-8")
}

/// An empty folder of this test's own.
fn folder(name: &str) -> PathBuf {
    let dir = std::env::temp_dir().join(format!("catoptra-cli-{}-{name}", std::process::id()));
    let _ = std::fs::remove_dir_all(&dir);
    std::fs::create_dir_all(&dir).expect("a temporary folder");
    dir
}

fn text(path: &Path) -> &str {
    path.to_str().expect("temporary paths are UTF-8")
}

fn files(dir: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(dir).expect("the folder is there");
    let mut names: Vec<_> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

fn fails(args: &[&str], status: i32, part: &str) {
    let output = catoptra(args);
    let told = stderr(&output);
    assert_eq!(output.status.code(), Some(status), "{args:?}: {told}");
    assert_eq!(told.lines().count(), 1, "{args:?}: {told}");
    assert!(told.starts_with("catoptra: ") && told.contains(part), "{args:?}: {told}");
    assert!(!told.contains("panicked"), "{args:?}: {told}");
    assert_eq!(stdout(&output), "", "{args:?}");
}

/// Renders, and gives (frame, scene, hash, ms, file) of each line.
fn render(args: &[&str]) -> Vec<(u64, String, String, f64, PathBuf)> {
    let output = catoptra(&[&["render"], args].concat());
    assert_eq!(output.status.code(), Some(0), "{args:?}: {}", stderr(&output));
    let parse = |line: &str| {
        let fields: Vec<(&str, &str)> = line.split(' ').map(|f| f.split_once('=').expect("key=value")).collect();
        let keys: Vec<&str> = fields.iter().map(|f| f.0).collect();
        assert_eq!(keys, ["frame", "scene", "hash", "ms", "file"], "{line}");
        let hash = fields[2].1;
        assert!(hash.len() == 16 && hash.chars().all(|c| c.is_ascii_hexdigit()), "{line}");
        let (frame, ms) = (fields[0].1.parse().expect("a number"), fields[3].1.parse().expect("a number"));
        (frame, fields[1].1.to_string(), hash.to_string(), ms, PathBuf::from(fields[4].1))
    };
    stdout(&output).lines().map(parse).collect()
}

#[test]
fn wrong_use_is_status_2() {
    let cases: &[(&[&str], &str)] = &[
        (&["rendr"], "rendr"),
        (&["render"], "required"),
        (&["render", "rolling-bx"], "did you mean `rolling-box`?"),
        (&["render", "cornell"], "two-spheres"),
        (&["bench", "cornell"], "two-spheres"),
        (&["judge", "two-sphere"], "`two-spheres`"),
        (&["play", "two-sphere"], "`two-spheres`"),
        (&["reference", "all", "--out", "x.exr"], "one scene"),
        (&["reference", "rolling-box", "--out", "x.png"], ".exr"),
        (&["reference", "rolling-box", "--out", "x.exr", "--spp", "1", "--seconds", "1"], "cannot be used"),
        (&["export", "rolling-box", "x.obj"], ".glb"),
        (&["render", "rolling-box", "--size", "0x0"], "1x1"),
        (&["render", "rolling-box", "--size", "0x64"], "1x1"),
        (&["render", "rolling-box", "--size", "1000000x1000000"], "16384x16384"),
        (&["render", "rolling-box", "--size", "64"], "WIDTHxHEIGHT"),
        (&["render", "rolling-box", "--frames", "0"], "--frames"),
        (&["render", "rolling-box", "--frame", "1", "--frames", "2"], "cannot be used"),
        (&["render", "rolling-box", "--layer", "nothing"], "nothing"),
        (&["render", "rolling-box", "--tile", "3"], "tile"),
        (&["render", "rolling-box", "--depth", "0"], "--depth"),
        (&["render", "rolling-box", "--threads", "0"], "--threads"),
        (&["render", "rolling-box", "--exposure", "nan"], "--exposure"),
        (&["render", "rolling-box", "--bounces", "9", "--vpls", "4"], "VPLs"),
        (&["render", "rolling-box", "--no-such-option"], "--no-such-option"),
        (&["render", "rolling-box", "--animation", "1"], "rolling-box is no file"),
        (&["play", "two-spheres", "--animation", "1"], "name a glTF or GLB file"),
    ];
    for (args, part) in cases {
        fails(args, 2, part);
    }
}

#[test]
fn what_this_version_lacks_is_said_and_never_replaced() {
    // A tracer on the GPU without the GPU's lane.
    for choice in [
        &["--tracer", "gpu", "--raster", "cpu"][..],
        &["--tracer", "gpu-fragment", "--raster", "cpu"],
        &["--tracer", "rayquery", "--raster", "cpu"],
    ] {
        let out = folder("lacks");
        let o = ["--out", text(&out)];
        let name = choice[..2].join(" ");
        fails(&[&["render", "rolling-box"], choice, &o].concat(), 1, &name);
        fails(&[&["bench", "rolling-box"], choice].concat(), 1, choice[0]);
        assert!(files(&out).is_empty());
    }
    fails(&["replay", "no-such-game.replay"], 1, "cannot be read");
}

#[test]
fn the_tracer_that_runs_is_said() {
    // `auto` follows what is remembered of the adapter, an explicit choice does not, and a broken memory does no harm.
    let cache = folder("tracer-cache");
    let run = |args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
        command.args(args).env("CATOPTRA_CACHE_DIR", &cache).env("XDG_RUNTIME_DIR", &cache).env_remove("DISPLAY");
        command.output().expect("the binary runs")
    };
    std::fs::write(cache.join("tracer.txt"), [0xffu8, 0, 9, 9]).unwrap();
    let told = stdout(&run(&["info"]));
    let line = told.lines().find(|l| l.starts_with("tracer auto: ")).expect("info says the tracer");
    assert!(line.contains("cpu (") || line.contains("gpu (") || line.contains("rayquery ("), "{line}");
    if told.lines().any(|l| l.starts_with("adapter: none")) {
        assert!(std::env::var_os("CI").is_none(), "CI without an adapter");
        eprintln!("SKIPPED the_tracer_that_runs_is_said: no adapter");
        return;
    }
    let small = ["--size", "24x16", "--preset", "draft", "--shadows", "off"];
    let tracer = |choice: &[&str]| {
        let out = folder("tracer-out");
        let output = run(&[&["render", "two-spheres", "--out", text(&out)], &small[..], choice].concat());
        assert!(output.status.success(), "{choice:?}: {}", stderr(&output));
        let stats: serde_json::Value = serde_json::from_slice(&std::fs::read(out.join("stats.json")).unwrap()).unwrap();
        assert_eq!(stats["tracer"], stats["scenes"][0]["tracer"]);
        assert!(stats["scenes"][0]["uploaded_bytes"].is_u64());
        stats["tracer"].as_str().unwrap().to_string()
    };
    assert_eq!(tracer(&["--tracer", "gpu"]), "gpu");
    assert_eq!(tracer(&["--tracer", "gpu-fragment"]), "gpu-fragment");
    assert_eq!(tracer(&["--tracer", "cpu"]), "cpu");
    assert_eq!(tracer(&["--raster", "cpu"]), "cpu");
}

#[test]
fn a_budget_caps_rays_and_a_trace_tells_the_stages() {
    let out = folder("budget");
    let trace = out.join("trace.json");
    let render_with = |budget: &str, threads: &str, more: &[&str]| {
        let args =
            ["render", "rolling-box-donut", "--frame", "30", "--size", "96x96", "--raster", "cpu", "--budget", budget];
        let o = catoptra(
            &[&args[..], &["--threads", threads, "--out", text(&out), "--trace", text(&trace)], more].concat(),
        );
        assert!(o.status.success(), "{}", String::from_utf8_lossy(&o.stderr));
        let stats: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(out.join("stats.json")).unwrap()).unwrap();
        let rays = &stats["scenes"][0]["rays"];
        let traced = ["reflection", "refraction", "shadow", "photon", "vpl_maps", "vpl"];
        let sum: u64 = traced.iter().map(|k| rays[k].as_u64().unwrap()).sum();
        (stats["scenes"][0]["per_frame"][0]["hash"].as_str().unwrap().to_string(), sum)
    };
    // The least number of VPLs' maps would take more than the cap of so small a picture.
    let render = |budget: &str, threads: &str| render_with(budget, threads, &["--vpl-shadows", "off"]);
    let (free, all) = render("1000000000", "2");
    let (capped, few) = render("2000", "2");
    assert!(all > 4000 && few <= 2000 && few > 500, "{all} and {few} rays");
    assert_ne!(free, capped);
    assert_eq!(render("2000", "1").0, capped, "a budget counts rays, not threads");
    let maps = ["--vpls", "256", "--vpl-shadows", "maps", "--vpl-map-size", "32"];
    let (all, few) = (render_with("1000000000", "2", &maps).1, render_with("100000", "2", &maps).1);
    assert!(all > 105_000 && few <= 50_000 && few > 10_000, "{all} and {few} rays with maps");
    let text = std::fs::read_to_string(&trace).unwrap();
    let file: serde_json::Value = serde_json::from_str(&text).unwrap();
    let names: Vec<&str> =
        file["traceEvents"].as_array().unwrap().iter().map(|e| e["name"].as_str().unwrap()).collect();
    for name in ["structures", "moments", "virtual lights", "band", "budgeted tracing"] {
        assert!(names.contains(&name), "{name} is not in {names:?}");
    }
}

#[test]
fn bad_files_leave_nothing_behind() {
    let dir = folder("bad-files");
    let write = |name: &str, bytes: &[u8]| {
        std::fs::write(dir.join(name), bytes).unwrap();
        text(&dir.join(name)).to_string()
    };
    let exported = dir.join("whole.glb");
    assert!(catoptra(&["export", "rolling-box", text(&exported)]).status.success());
    let whole = std::fs::read(&exported).unwrap();
    let cases = [
        (text(&dir.join("missing.glb")).to_string(), "missing.glb"),
        (write("cut.glb", &whole[..whole.len() / 2]), "cut.glb"),
        (write("stub.glb", &whole[..10]), "stub.glb"),
        (write("text.glb", b"not a model"), "text.glb"),
        (write("empty.gltf", b""), "empty.gltf"),
        (write("infinite.gltf", TRIANGLE.replace("TRANSLATION", "[1e39,0,0]").as_bytes()), "infinite.gltf"),
        (write("nan.gltf", TRIANGLE.replace("TRANSLATION", "[NaN,0,0]").as_bytes()), "nan.gltf"),
    ];
    for (file, part) in &cases {
        let out = dir.join("out");
        fails(&[&["render", file.as_str(), "--out", text(&out)], &FAST[..]].concat(), 1, part);
        assert!(!out.exists(), "{file}");
        fails(&["reference", file, "--spp", "1", "--size", "8x8", "--out", text(&dir.join("r.exr"))], 1, part);
        assert!(!dir.join("r.exr").exists() && !dir.join("r.exr.state").exists(), "{file}");
    }
    let statue = cases[1].0.as_str();
    let out = dir.join("out");
    fails(
        &[&["render", "rolling-box-venus", "--statue", statue, "--out", text(&out)], &FAST[..]].concat(),
        1,
        "cut.glb",
    );
}

#[test]
fn unwritable_places_are_told() {
    let dir = folder("unwritable");
    std::fs::write(dir.join("file"), "x").unwrap();
    let inside = dir.join("file/inside");
    fails(&[&["render", "rolling-box", "--out", text(&inside)], &FAST[..]].concat(), 1, "file/inside");
    let exr = dir.join("file/r.exr");
    fails(&["reference", "rolling-box", "--spp", "1", "--size", "8x8", "--out", text(&exr)], 1, "r.exr");
    fails(&["export", "rolling-box", text(&dir.join("file/x.glb"))], 1, "x.glb");
    // A picture's place is taken by a folder: the picture fails, and its temporary file goes.
    let out = dir.join("out");
    std::fs::create_dir_all(out.join("rolling-box-0000.png/taken")).unwrap();
    fails(&[&["render", "rolling-box", "--out", text(&out)], &FAST[..]].concat(), 1, "rolling-box-0000.png");
    assert_eq!(files(&out), ["rolling-box-0000.png"]);
    assert_eq!(std::fs::read(dir.join("file")).unwrap(), b"x");
}

#[test]
fn play_without_a_display_names_render() {
    fails(&["play", "two-spheres", "--raster", "cpu"], 1, "catoptra render two-spheres");
    fails(&["play", "--raster", "cpu"], 1, "catoptra render all");
    fails(&["play", "two-spheres", "--record", "game.replay"], 1, "catoptra render two-spheres");
    fails(&["play", "two-spheres", "--watch", "--record", "game.replay"], 2, "only games are recorded");
    assert!(!Path::new("game.replay").exists());
}

#[test]
fn replay_prints_hashes_and_refuses_what_is_no_recording() {
    let shipped = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("replays/two-spheres-1.replay");
    let recorded = std::fs::read_to_string(&shipped).unwrap();
    let mut told = Vec::new();
    for threads in ["1", "2"] {
        let output = catoptra(&["replay", text(&shipped), "--threads", threads]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        told.push(stdout(&output));
    }
    assert_eq!(told[0], told[1]);
    let hashes: Vec<&str> = told[0].lines().filter_map(|l| l.split_once("hash=").map(|h| h.1)).collect();
    let lines: Vec<&str> = recorded.lines().collect();
    let ends = [format!("state {}", hashes[0]), format!("frame {}", hashes[1])];
    assert!(hashes.len() == 2 && ends.iter().all(|e| lines.contains(&e.as_str())), "{}", told[0]);
    assert!(told[0].starts_with("replay game=two-spheres level=1 ") && told[0].contains(" result=won\n"));

    let out = folder("replay");
    let picture = out.join("last.png");
    let output = catoptra(&["replay", text(&shipped), "--picture", text(&picture), "--size", "32x18"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert_eq!(image_io::read_image(&picture).unwrap().linear.width, 32);
    let broken = out.join("broken.replay");
    for (bytes, part) in [
        (recorded.replace(hashes[0], "0123456789abcdef").into_bytes(), "its state was 0123456789abcdef"),
        (recorded.replace(hashes[1], "0123456789abcdef").into_bytes(), "its last frame was 0123456789abcdef"),
        (recorded.replace("putt", "pat").into_bytes(), "there is no such action"),
        (recorded.as_bytes()[..recorded.len() / 2].to_vec(), "this is no recording"),
        (b"\x89PNG\r\n".to_vec(), "this is no recording"),
        (Vec::new(), "this is no recording"),
    ] {
        std::fs::write(&broken, bytes).unwrap();
        let output = catoptra(&["replay", text(&broken)]);
        let line = stderr(&output);
        assert_eq!((output.status.code(), line.lines().count()), (Some(1), 1), "{line}");
        assert!(line.contains(part) && !line.contains("panicked"), "{line}");
    }
    fails(&["replay", text(&shipped), "--threads", "0"], 2, "--threads");
}

#[test]
fn render_prints_one_line_a_frame_and_writes_stats() {
    let out = folder("contract");
    let lines = render(&[&["two-spheres", "--frames", "3", "--out", text(&out)], &FAST[..]].concat());
    for (k, (frame, scene, _, ms, file)) in lines.iter().enumerate() {
        assert_eq!((*frame, scene.as_str()), (k as u64, "two-spheres"));
        assert!(*ms > 0.0);
        assert_eq!(*file, out.join(format!("two-spheres-{k:04}.png")));
        let image = image_io::read_image(file).unwrap().linear;
        assert_eq!((image.width, image.height), (24, 16));
    }
    assert_eq!(lines.len(), 3);
    assert_ne!(lines[0].2, lines[1].2, "the scene moves");
    let names = ["stats.json", "two-spheres-0000.png", "two-spheres-0001.png", "two-spheres-0002.png"];
    assert_eq!(files(&out), names);

    let stats: serde_json::Value = serde_json::from_slice(&std::fs::read(out.join("stats.json")).unwrap()).unwrap();
    assert_eq!((&stats["raster"], &stats["tracer"]), (&"cpu".into(), &"cpu".into()));
    let scene = &stats["scenes"][0];
    assert_eq!(scene["scene"], "two-spheres");
    assert_eq!(scene["triangles"], 1066);
    assert!(scene["blas_builds"]["first_frame"].as_u64().unwrap() > 0);
    assert_eq!(scene["blas_builds"]["later_frames"], 0);
    assert!(scene["tlas_nodes_touched"].as_f64().unwrap() > 0.0);
    assert!(scene["masked_share"].as_f64().unwrap() > 0.05);
    assert!(scene["rays"]["camera"].as_u64().unwrap() >= 24 * 16);
    assert!(scene["rays"]["reflection"].as_u64().unwrap() > 0);
    assert!(scene["stages_ms"]["traced"].as_f64().unwrap() > 0.0);
    assert_eq!(scene["per_frame"].as_array().unwrap().len(), 3);
    for (line, frame) in lines.iter().zip(scene["per_frame"].as_array().unwrap()) {
        assert_eq!(frame["hash"], line.2.as_str());
    }
}

#[test]
fn one_hash_for_every_way_of_getting_there() {
    let out = folder("hash");
    let o = ["--out", text(&out)];
    let base = render(&[&["rolling-box-donut", "--frames", "4"], &FAST[..], &o].concat());
    let alone = render(&[&["rolling-box-donut", "--frame", "3"], &FAST[..], &o].concat());
    assert_eq!(alone[0].2, base[3].2, "frame 3 alone is frame 3 of the sequence");
    for change in [
        &["--threads", "1"][..],
        &["--threads", "3"],
        &["--tile", "8"],
        &["--simd", "portable"],
        &["--format", "exr"],
        &["--exposure", "-2"],
    ] {
        let other = render(&[&["rolling-box-donut", "--frame", "3"], change, &FAST[..], &o].concat());
        assert_eq!(other[0].2, alone[0].2, "{change:?}");
    }
    for change in [&["--no-indirect"][..], &["--vpls", "3"], &["--depth", "1"], &["--layer", "direct"]] {
        let other = render(&[&["rolling-box-donut", "--frame", "3"], change, &FAST[..], &o].concat());
        assert_ne!(other[0].2, alone[0].2, "{change:?}");
    }
}

#[test]
fn exr_holds_what_was_hashed_and_layers_name_their_files() {
    let out = folder("exr");
    let layers = ["final", "direct", "indirect", "traced", "mask", "depth", "normal", "albedo"];
    let mut hashes = Vec::new();
    for layer in layers {
        let args = ["two-spheres", "--frame", "5", "--layer", layer, "--format", "exr", "--out", text(&out)];
        let line = render(&[&args, &FAST[..]].concat()).remove(0);
        let name = if layer == "final" { String::new() } else { format!("-{layer}") };
        assert_eq!(line.4, out.join(format!("two-spheres{name}-0005.exr")));
        let image = image_io::read_image(&line.4).unwrap().linear;
        assert_eq!(format!("{:016x}", image.hash()), line.2, "{layer}");
        hashes.push(line.2);
    }
    hashes.sort();
    hashes.dedup();
    assert_eq!(hashes.len(), layers.len(), "no two layers are the same");
}

#[test]
fn compare_tells_equal_from_different() {
    let out = folder("compare");
    let lines = render(&[&["two-spheres", "--frames", "2", "--out", text(&out)], &FAST[..]].concat());
    let (a, b) = (text(&lines[0].4), text(&lines[1].4));
    let figures = |a: &str, b: &str, more: &[&str]| -> Vec<f64> {
        let output = catoptra(&[&["compare", a, b], more].concat());
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let line = stdout(&output);
        let fields: Vec<_> = line.trim_end().split(' ').map(|f| f.split_once('=').unwrap()).collect();
        let names = ["flip_mean", "flip_p99", "relmse", "psnr", "mean_ratio"];
        assert_eq!(fields.iter().map(|f| f.0).collect::<Vec<_>>(), names);
        assert_eq!(fields[4].1.split(',').count(), 3, "one ratio a channel");
        fields[..4].iter().map(|f| f.1.parse().unwrap()).collect()
    };
    let heat = out.join("heat.png");
    assert_eq!(figures(a, a, &[]), [0.0, 0.0, 0.0, f64::INFINITY]);
    let apart = figures(a, b, &["--heat", text(&heat)]);
    assert!(apart[0] > 0.0 && apart[1] > 0.0 && apart[2] > 0.0 && apart[3].is_finite(), "{apart:?}");
    assert_eq!(image_io::read_image(&heat).unwrap().linear.width, 24);

    let small = out.join("small.png");
    image_io::write_png(&small, 2, 2, &[9; 12]).unwrap();
    fails(&["compare", a, text(&small)], 1, "differ in size");
    fails(&["compare", a, text(&out.join("none.png"))], 1, "none.png");
    fails(&["compare", a, text(&out.join("stats.json"))], 1, "neither a PNG nor an EXR");
}

#[test]
fn reference_goes_on_where_it_stopped() {
    let dir = folder("reference");
    let run = |name: &str, more: &[&str]| {
        let out = dir.join(name);
        let output = catoptra(&[&["reference", "rolling-box", "--size", "16x12", "--out", text(&out)], more].concat());
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let line = stdout(&output);
        let hash = line.split("hash=").nth(1).unwrap()[..16].to_string();
        assert_eq!(format!("{:016x}", image_io::read_image(&out).unwrap().linear.hash()), hash);
        (hash, line)
    };
    let at_once = run("once.exr", &["--spp", "6"]).0;
    let first = run("twice.exr", &["--spp", "2"]).0;
    let second = run("twice.exr", &["--spp", "6", "--resume", "--threads", "1"]);
    assert_eq!(at_once, second.0);
    assert_ne!(at_once, first);
    assert!(second.1.contains(" spp=6 "), "{}", second.1);
    assert!(run("timed.exr", &["--seconds", "0.2"]).1.contains(" spp="));
    // Samples of another integral are refused.
    let out = dir.join("twice.exr");
    let other = ["--spp", "8", "--resume", "--bounces", "1"];
    fails(&[&["reference", "rolling-box", "--size", "16x12", "--out", text(&out)], &other[..]].concat(), 1, "--resume");
}

#[test]
fn an_exported_frame_looks_like_the_scene() {
    let dir = folder("export");
    let glb = dir.join("posed.glb");
    let output = catoptra(&["export", "rolling-box-donut", "--frame", "20", text(&glb)]);
    assert!(output.status.success(), "{}", stderr(&output));
    let o = ["--out", text(&dir)];
    let scene = render(&[&["rolling-box-donut", "--frame", "20"], &FAST[..], &o].concat()).remove(0);
    let file = render(&[&[text(&glb)], &FAST[..], &o].concat()).remove(0);
    assert_eq!(file.4, dir.join("posed-0000.png"));
    assert_eq!(file.1, "posed");
    let output = catoptra(&["compare", text(&file.4), text(&scene.4)]);
    let flip: f64 = stdout(&output)["flip_mean=".len()..].split(' ').next().unwrap().parse().unwrap();
    assert!(flip < 0.01, "FLIP {flip}");
}

#[test]
fn a_file_without_camera_and_light_is_seen_and_it_says_so() {
    let dir = folder("fitted");
    let file = dir.join("triangle.gltf");
    std::fs::write(&file, TRIANGLE.replace("TRANSLATION", "[0,0,0]")).unwrap();
    let output = catoptra(&[&["render", text(&file), "--out", text(&dir)], &FAST[..]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let told = stderr(&output);
    assert!(told.lines().count() == 1 && told.contains("fitted camera") && told.contains("headlight"), "{told}");
    let image = image_io::read_image(&dir.join("triangle-0000.png")).unwrap().linear;
    let lit = image.pixels.iter().filter(|p| p[0] > 0.1).count();
    assert!(lit > 20, "{lit} pixels are lit");
}

/// The triangle, moved 0.8 m to the right by its first animation and upwards by its second, in a second.
fn animated_triangle() -> String {
    let values = [0.0_f32, 1.0, 0.0, 0.0, 0.0, 0.8, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.8, 0.0];
    let bytes: String = values.iter().flat_map(|v| v.to_le_bytes()).map(|b| format!("%{b:02x}")).collect();
    let clip = |name: &str, output: u32| {
        let channel = r#""channels":[{"sampler":0,"target":{"node":0,"path":"translation"}}]"#;
        format!(r#"{{"name":"{name}",{channel},"samplers":[{{"input":1,"output":{output}}}]}}"#)
    };
    let accessor = |offset: u32, kind: &str| {
        format!(r#"{{"bufferView":1,"byteOffset":{offset},"componentType":5126,"count":2,"type":"{kind}"}}"#)
    };
    let more = [
        (r#""meshes""#, format!(r#""animations":[{},{}],"meshes""#, clip("Aside", 2), clip("Rise", 3))),
        (
            r#""max":[1,1,0]}"#,
            format!(r#""max":[1,1,0]}},{},{},{}"#, accessor(0, "SCALAR"), accessor(8, "VEC3"), accessor(32, "VEC3")),
        ),
        (r#""byteLength":36}],"#, r#""byteLength":36},{"buffer":1,"byteLength":56}],"#.into()),
        (
            r#"gD8AAAAA"}]"#,
            format!(r#"gD8AAAAA"}},{{"byteLength":56,"uri":"data:application/octet-stream,{bytes}"}}]"#),
        ),
    ];
    more.iter().fold(TRIANGLE.replace("TRANSLATION", "[0,0,0]"), |text, (from, to)| {
        assert_eq!(text.matches(from).count(), 1, "{from}");
        text.replace(from, to)
    })
}

#[test]
fn an_animation_is_chosen_by_number_or_name() {
    let dir = folder("animation");
    let file = dir.join("moving.gltf");
    std::fs::write(&file, animated_triangle()).unwrap();
    // Where the lit pixels are, right and down.
    let middle = |options: &[&str]| {
        let out = ["--out", text(&dir)];
        let lines = render(&[&[text(&file), "--frame", "30"], options, &FAST[..], &out].concat());
        let image = image_io::read_image(&lines[0].4).unwrap().linear;
        let lit = |i: &usize| image.pixels[*i][0] > 0.1;
        let at: Vec<usize> = (0..image.pixels.len()).filter(lit).collect();
        assert!(at.len() > 10, "{options:?}: {} pixels are lit", at.len());
        let mean = |f: &dyn Fn(usize) -> usize| at.iter().map(|i| f(*i) as f64).sum::<f64>() / at.len() as f64;
        let width = image.width as usize;
        (mean(&|i| i % width), mean(&|i| i / width))
    };
    let first = middle(&[]);
    assert_eq!(middle(&["--animation", "0"]), first);
    assert_eq!(middle(&["--animation", "Aside"]), first);
    let second = middle(&["--animation", "1"]);
    assert_eq!(middle(&["--animation", "rise"]), second);
    assert!(second.0 < first.0 - 1.0 && second.1 < first.1 - 1.0, "{first:?} aside, {second:?} up");
    let list = r#"there is no animation "Dance"; there are 0 "Aside" (1.00 s), 1 "Rise" (1.00 s)"#;
    fails(&["render", text(&file), "--animation", "Dance"], 2, list);
    fails(&["render", text(&file), "--animation", "2"], 2, "1 \"Rise\"");
    let still = dir.join("still.gltf");
    std::fs::write(&still, TRIANGLE.replace("TRANSLATION", "[0,0,0]")).unwrap();
    fails(&["export", text(&still), text(&dir.join("x.glb")), "--animation", "0"], 2, "it has none");
}

#[test]
fn bench_writes_the_agreed_json() {
    let dir = folder("bench");
    let json = dir.join("bench.json");
    let output = catoptra(&[&["bench", "two-spheres", "--frames", "2", "--json", text(&json)], &FAST[..]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let file: serde_json::Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    for key in ["cpu", "cores", "threads", "simd", "adapter", "os", "version"] {
        assert!(file["machine"].get(key).is_some(), "{key}");
    }
    let scene = &file["scenes"][0];
    assert_eq!(
        (&scene["scene"], &scene["lane"], &scene["tracer"]),
        (&"two-spheres".into(), &"cpu".into(), &"cpu".into())
    );
    assert_eq!(scene["size"], serde_json::json!([24, 16]));
    assert_eq!((&scene["frames"], &scene["triangles"]), (&2.into(), &1066.into()));
    let (median, p95) = (scene["frame_ms"]["median"].as_f64().unwrap(), scene["frame_ms"]["p95"].as_f64().unwrap());
    assert!(median > 0.0 && p95 >= median);
    let stages = scene["stages_ms"].as_object().unwrap();
    let sum: f64 = stages.iter().filter(|(k, _)| *k != "render_total").map(|(_, v)| v.as_f64().unwrap()).sum();
    assert!(sum > 0.0 && sum < 3.0 * median + 5.0, "stages {sum} ms of {median} ms");
    assert!(scene["rays"]["camera"].as_u64().unwrap() > 0);

    // Without a file the JSON, and nothing else, goes to stdout.
    let output = catoptra(&[&["bench", "rolling-box", "--frames", "1"], &FAST[..], &["--json"]].concat());
    assert_eq!(serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap()["scenes"][0]["frames"], 1);
}

#[test]
fn judge_is_a_table() {
    let output = catoptra(&[&["judge", "rolling-box", "--spp", "8"], &FAST[..]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let table = stdout(&output);
    let rows: Vec<Vec<&str>> = table.lines().map(|l| l.split_whitespace().collect()).collect();
    assert_eq!(rows.len(), 2);
    assert_eq!(rows[0].len(), rows[1].len());
    assert_eq!(rows[1][0], "rolling-box");
    let flip: f64 = rows[1][rows[0].iter().position(|c| *c == "flip_mean").unwrap()].parse().unwrap();
    assert!(flip > 0.0 && flip < 1.0);
}

#[test]
fn list_counts_and_info_tells() {
    let output = catoptra(&["list"]);
    let text = stdout(&output);
    let rows: Vec<Vec<&str>> = text.lines().map(|l| l.split_whitespace().collect()).collect();
    let counts: Vec<(&str, &str)> = rows.iter().map(|r| (r[0], r[1])).collect();
    let expected = [
        ("rolling-box", "22"),
        ("rolling-box-donut", "598"),
        ("two-spheres", "1066"),
        ("rolling-box-venus", "31420"),
        ("rolling-box-sponza", "66466"),
    ];
    assert_eq!(counts, expected);
    let info = stdout(&catoptra(&["info"]));
    for part in [env!("CARGO_PKG_VERSION"), "simd: ", "threads: ", "adapter: "] {
        assert!(info.contains(part), "{part} in {info}");
    }
    assert!(catoptra(&["--version"]).status.success() && catoptra(&["render", "--help"]).status.success());
}

#[test]
fn a_reader_that_goes_away_is_no_failure() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_catoptra"))
        .arg("list")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary runs");
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!((output.status.code(), stderr(&output).as_str()), (Some(0), ""));
}
