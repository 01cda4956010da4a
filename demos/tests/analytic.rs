//! The files of `../shared/analytic` through the command line: `render FILE.glb --shadows traced --format exr`, and the
//! closed sphere by `reference`. tests/analytic.rs holds the same cases by the library, and proves their tolerances.
//! Where that folder is absent (a fresh clone) this skips loudly.

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

fn out(name: &str) -> PathBuf {
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("analytic-{name}"));
    let _ = std::fs::remove_dir_all(&dir);
    std::fs::create_dir_all(&dir).unwrap();
    dir
}

/// The linear picture that `render` writes of a file. The one EXR in the folder is it.
fn render(file: &Path, name: &str, more: &[&str]) -> Image {
    let dir = out(name);
    let base = ["render", file.to_str().unwrap(), "--shadows", "traced", "--format", "exr", "--raster", "cpu"];
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
