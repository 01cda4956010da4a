//! The files of `../shared/analytic` through the command line: `render FILE.glb --shadows traced --format exr`, and the
//! closed sphere by `reference`. tests/analytic.rs holds the same cases by the library, and proves their tolerances.
//! Where that folder is absent (a fresh clone) this skips loudly.

use catoptra_engine::gltf::{ImportLimits, load_gltf};
use catoptra_render_hybrid::{Image, image_io};
use serde_json::Value;
use std::{
    io::Write,
    path::{Path, PathBuf},
    process::Command,
};

fn folder() -> Option<PathBuf> {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/analytic"));
    if path.join("cases.json").is_file() {
        return Some(path);
    }
    // Past the test runner's capture.
    let _ = writeln!(std::io::stderr(), "SKIPPED analytic cases by the command line: there is no ../shared/analytic");
    None
}

fn cases(folder: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(folder.join("cases.json")).unwrap();
    serde_json::from_str::<Value>(&text).unwrap().as_array().unwrap().clone()
}

fn case<'a>(cases: &'a [Value], id: &str) -> &'a Value {
    cases.iter().find(|c| c["id"] == id).unwrap_or_else(|| panic!("no case {id}"))
}

/// Runs the command; panics with its own words where it fails.
fn catoptra(args: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_catoptra")).args(args).output().expect("the binary runs");
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
}

/// Whether the machine has any adapter. With `CI` set it must.
fn has_adapter() -> bool {
    let folder = out("adapter");
    let arguments = ["render", "rolling-box", "--size", "8x8", "--raster", "gpu", "--out", folder.to_str().unwrap()];
    let found = Command::new(env!("CARGO_BIN_EXE_catoptra")).args(arguments).output().unwrap().status.success();
    if !found {
        assert!(std::env::var_os("CI").is_none(), "CI without an adapter");
        let _ = writeln!(std::io::stderr(), "SKIPPED the GPU lane: there is no adapter");
    }
    found
}

fn out(name: &str) -> PathBuf {
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("analytic-{name}"));
    let _ = std::fs::remove_dir_all(&dir);
    std::fs::create_dir_all(&dir).unwrap();
    dir
}

/// The linear picture that `render` writes of a file. The one EXR in the folder is it.
fn render(file: &Path, name: &str, more: &[&str]) -> Image {
    let dir = out(name);
    let base = ["render", file.to_str().unwrap(), "--shadows", "traced", "--format", "exr"];
    catoptra(&[&base[..], &["--out", dir.to_str().unwrap()], more].concat());
    let exr: Vec<PathBuf> = std::fs::read_dir(&dir)
        .unwrap()
        .map(|e| e.unwrap().path())
        .filter(|p| p.extension().is_some_and(|e| e == "exr"))
        .collect();
    assert_eq!(exr.len(), 1, "{exr:?}");
    image_io::read_image(&exr[0]).unwrap().linear
}

#[test]
fn files_render_to_their_formulas() {
    let Some(folder) = folder() else { return };
    let cases = cases(&folder);
    for id in ["lambert_point_plane", "gltf_spot_falloff", "mirror_reflection_radiance"] {
        let case = case(&cases, id);
        let file = folder.join(case["glb"].as_str().unwrap());
        let expected =
            ["pixels_x,y_128x96", "pixels"].iter().find_map(|k| case["expected"].get(k)).unwrap_or(&case["expected"]);
        let worst = |image: &Image| {
            assert_eq!((image.width, image.height), (128, 96));
            let mut worst = 0.0f64;
            for (pixel, radiance) in expected.as_object().unwrap() {
                let (x, y) = pixel.split_once(',').unwrap();
                let value = image.at(x.parse().unwrap(), y.parse().unwrap());
                let radiance: Vec<f64> = radiance.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
                for (c, v) in value.iter().enumerate() {
                    let e = *radiance.get(c).unwrap_or(&radiance[0]);
                    let error = if e == 0.0 { f64::from(*v).abs() } else { (f64::from(*v) / e - 1.0).abs() };
                    worst = worst.max(error);
                }
            }
            worst
        };
        let tolerance = case["tolerance"].as_f64().unwrap();
        // Direct light alone is what the formulas are about.
        let error = worst(&render(&file, id, &["--size", "128x96", "--no-indirect"]));
        println!("{id}: worst relative error {error:.2e}");
        assert!(error <= tolerance, "{id}: {error:e}");
        // In these open scenes no photon comes back to where a pixel looks: the same with indirect light.
        let error = worst(&render(&file, &format!("{id}-all"), &["--size", "128x96"]));
        println!("{id} with indirect light: worst relative error {error:.2e}");
        assert!(error <= tolerance, "{id} with indirect light: {error:e}");
    }
}

#[test]
fn reference_of_the_closed_sphere() {
    let Some(folder) = folder() else { return };
    let cases = cases(&folder);
    let case = case(&cases, "sphere_indirect_uniform");
    let file = folder.join(case["glb"].as_str().unwrap());
    let mean = |image: &Image| image.pixels.iter().map(|p| f64::from(p[0])).sum::<f64>() / image.pixels.len() as f64;
    let direct = mean(&render(&file, "sphere-direct", &["--size", "48x36", "--no-indirect"]));
    for bounces in 1..=3 {
        let exr = out(&format!("sphere-{bounces}")).join("reference.exr");
        let bounces = bounces.to_string();
        catoptra(&[
            "reference",
            file.to_str().unwrap(),
            "--spp",
            "96",
            "--bounces",
            &bounces,
            "--size",
            "48x36",
            "--out",
            exr.to_str().unwrap(),
        ]);
        let value = mean(&image_io::read_image(&exr).unwrap().linear) - direct;
        let expected = case["expected"][format!("N={bounces}")].as_f64().unwrap();
        println!("N = {bounces}: {value:.6} for {expected:.6}");
        assert!((value / expected - 1.0).abs() <= case["tolerance"].as_f64().unwrap(), "N = {bounces}: {value}");
    }
}

/// What the wall behind the slab sends to a pixel of glass_slab.glb, red channel, were its ray shifted sideways by
/// `displacement` metres on its way through the slab (1 m thick, front at z = 0): the sum over all odd numbers of crossings.
/// `o` and `d`: the camera's ray; `light`: place and intensity of the lamp that lights that wall (z = -6, albedo 0.8).
fn seen_through_slab(o: [f64; 3], d: [f64; 3], light: ([f64; 3], f64), displacement: f64) -> f64 {
    let (across, cos) = ((d[0] * d[0] + d[1] * d[1]).sqrt(), -d[2]);
    let cos_inside = (1.0 - across * across / 2.25).sqrt();
    let rs = (cos - 1.5 * cos_inside) / (cos + 1.5 * cos_inside);
    let rp = (cos_inside - 1.5 * cos) / (cos_inside + 1.5 * cos);
    let reflected = 0.5 * (rs * rs + rp * rp);
    let slope = across / cos;
    // A displacement is measured across the ray; along the face it is longer by 1 / cos.
    let crossing = slope - displacement / cos;
    let mut weight = (1.0 - reflected) * (1.0 - reflected);
    let mut sum = 0.0;
    for crossings in (1..40).step_by(2) {
        let sideways = (o[2] + 5.0) * slope + crossing * f64::from(crossings);
        let at = |i: usize| o[i] + d[i] / across * sideways;
        let (place, height) = (light.0, light.0[2] + 6.0);
        let squared =
            (at(0) - place[0]) * (at(0) - place[0]) + (at(1) - place[1]) * (at(1) - place[1]) + height * height;
        sum += weight * 0.8 / std::f64::consts::PI * light.1 * height / (squared * squared.sqrt());
        weight *= reflected * reflected;
    }
    sum
}

/// The displacement of the slab's own case, read off the picture: the walls' lamps have different colours, so that a weighted
/// difference of two channels leaves what came through the slab, and the wall's falloff tells where it was seen.
#[test]
fn displacement_of_the_glass_slab() {
    let Some(folder) = folder() else { return };
    let cases = cases(&folder);
    let case = case(&cases, "slab_displacement");
    let file = folder.join(case["glb"].as_str().unwrap());
    let tolerance = case["tolerance"].as_f64().unwrap();
    let scene = load_gltf(&file, &ImportLimits::default()).unwrap().to_render_scene(0);
    let lamp = &scene.lights[0];
    let light = (lamp.position_world.to_array().map(f64::from), f64::from(lamp.intensity.x));
    let formula = |sin: f64| sin * (1.0 - (1.0 - sin * sin).sqrt() / (2.25 - sin * sin).sqrt());
    for lane in ["cpu", "gpu"] {
        if lane == "gpu" && !has_adapter() {
            continue;
        }
        let more = ["--size", "128x96", "--no-indirect", "--depth", "16", "--min-weight", "1e-7", "--raster", lane];
        let image = render(&file, &format!("slab-{lane}"), &more);
        let mut worst = 0.0f64;
        let mut seen = [0; 5]; // Pixels of each 15 degrees that were read.
        for (x, y) in (0..96).step_by(3).flat_map(|y| (0..128).step_by(3).map(move |x| (x, y))) {
            let (o, d) = scene.camera.ray(x as f32 + 0.5, y as f32 + 0.5, 128, 96);
            let (o, d) = (o.to_array().map(f64::from), d.to_array().map(f64::from));
            let sin = (d[0] * d[0] + d[1] * d[1]).sqrt();
            if sin < 0.01 {
                continue;
            }
            let expected = formula(sin);
            let value = |displacement: f64| seen_through_slab(o, d, light, displacement);
            // Red of the second lamp is four times its blue; the first is white.
            let [red, _, blue] = image.at(x, y).map(f64::from);
            let measured = (4.0 * blue - red) / 3.0;
            // Where the falloff is steep a relative error of 1e-5 is one of less than half the tolerance.
            let slope = (value(expected + 1e-4) - value(expected - 1e-4)) / (2e-4 * value(expected));
            if slope.abs() < 0.25 {
                continue;
            }
            // Newton's method towards what the picture holds.
            let mut found = expected;
            for _ in 0..8 {
                let derivative = (value(found + 1e-6) - value(found - 1e-6)) / 2e-6;
                found -= (value(found) - measured) / derivative;
            }
            worst = worst.max((found - expected).abs());
            seen[(sin.asin().to_degrees() / 15.0) as usize] += 1;
        }
        println!("{lane}: displacement within {worst:.1e} m, pixels by 15 degrees: {seen:?}");
        assert!(seen.iter().filter(|n| **n >= 10).count() >= 4, "{lane}: {seen:?}");
        assert!(worst <= tolerance, "{lane}: {worst:e} m");
    }
}
