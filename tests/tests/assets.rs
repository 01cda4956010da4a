//! Files made by others, read where they lie (`../shared/assets`): all of them load or are refused with one clear line, and
//! the originals of statue and atrium give the thesis's triangle counts and are seen. Skipped loudly where that folder is
//! absent.

use catoptra_demos::scenes::{SceneOptions, build};
use catoptra_engine::{
    Extracted, RenderScene,
    gltf::{ImportLimits, load_gltf},
};
use catoptra_render_hybrid::{Layer, RenderSettings, Shadows, metrics};
use catoptra_tests::{
    fixtures::{cpu, small},
    shared_or_skip,
};
use std::path::{Path, PathBuf};

fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            files(&path, found);
        } else if path.extension().is_some_and(|e| e == "gltf" || e == "glb") {
            found.push(path);
        }
    }
}

/// A quick picture of anything: a fitted camera stands in where the file has none.
fn draw(scene: &RenderScene) -> catoptra_render_hybrid::Frame {
    let settings = RenderSettings { shadows: Shadows::Off, max_depth: 2, ..small(24, 18, 16) };
    cpu().render(scene, &settings).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn every_file_loads_or_is_refused_in_one_line() {
    let Some(folder) = shared_or_skip("every_file_loads_or_is_refused_in_one_line", "assets") else { return };
    let mut found = Vec::new();
    files(&folder, &mut found);
    assert!(found.len() > 100, "only {} files", found.len());
    let (mut loaded, mut refused) = (0, 0);
    for path in &found {
        let name = path.strip_prefix(&folder).unwrap().display();
        match load_gltf(path, &ImportLimits::default()) {
            Err(e) => {
                let line = e.to_string();
                assert!(!line.is_empty() && line.lines().count() == 1, "{name}: {line:?}");
                refused += 1;
            }
            Ok(imported) => {
                let mut scene = imported.to_render_scene(0);
                if imported.camera().is_none() {
                    scene.camera = catoptra_engine::fit::fit_camera(scene.bounds_world());
                }
                scene.validate().unwrap_or_else(|e| panic!("{name} was loaded, but: {e}"));
                // Large models are drawn by the tests below; here every kind of file is.
                if scene.triangle_count() < 50_000 {
                    let frame = draw(&scene);
                    assert!(frame.image.pixels.iter().flatten().all(|v| v.is_finite()), "{name}");
                    assert_eq!(frame.stats.non_finite.0, 0, "{name}");
                }
                loaded += 1;
            }
        }
    }
    println!("{loaded} files loaded and drawn, {refused} refused");
    assert!(loaded > 50 && refused > 20, "{loaded} loaded, {refused} refused");
}

#[test]
fn khronos_samples_are_not_refused_for_what_is_supported() {
    let Some(folder) = shared_or_skip("khronos_samples", "assets/gltf-samples") else { return };
    let mut found = Vec::new();
    files(&folder, &mut found);
    let errors: Vec<String> = found
        .iter()
        .filter_map(|p| {
            let e = load_gltf(p, &ImportLimits::default()).err()?;
            Some(format!("{}: {e}", p.file_name().unwrap().display()))
        })
        .collect();
    println!("{} of {} samples refused:\n{}", errors.len(), found.len(), errors.join("\n"));
    // A required extension that is not supported is the only good reason.
    for e in &errors {
        assert!(e.contains("KHR_") || e.contains("EXT_"), "{e}");
    }
    assert!(errors.len() * 4 < found.len(), "{} of {} refused", errors.len(), found.len());
}

fn with_originals(name: &str, options: &SceneOptions) -> RenderScene {
    let app = build(name, options).unwrap_or_else(|e| panic!("{name}: {e}"));
    app.world().resource::<Extracted>().0.clone()
}

#[test]
fn the_originals_have_the_thesis_counts_and_are_seen() {
    let test = "the_originals_have_the_thesis_counts_and_are_seen";
    let Some(venus) = shared_or_skip(test, "assets/venus/venus_31402.glb") else { return };
    let Some(sponza) = shared_or_skip(test, "assets/sponza/sponza_dabrovic_66454.glb") else { return };
    let statue = SceneOptions { statue: Some(venus), ..SceneOptions::default() };
    let atrium = SceneOptions { atrium: Some(sponza), ..SceneOptions::default() };
    let cases = [("rolling-box-venus", statue, 31_424), ("rolling-box-sponza", atrium, 66_466)];
    for (name, options, triangles) in cases {
        let scene = with_originals(name, &options);
        assert_eq!(scene.triangle_count(), triangles, "{name}");
        let settings = RenderSettings { keep_layers: true, ..small(96, 96, 128) };
        let frame = cpu().render(&scene, &settings).unwrap();
        let share = frame.stats.masked_pixels as f64 / (96.0 * 96.0);
        println!("{name} with the original: masked share {share:.3}");
        assert!(share > 0.05, "{name}: mirrors cover {share} of the picture");
        // It stands where the camera looks: most rays meet something, and the picture is not that of our own model.
        let met = frame.layer(Layer::Depth).unwrap().pixels.iter().filter(|p| p[0] > 0.0).count();
        assert!(met * 2 > 96 * 96, "{name}: the camera sees {met} pixels of anything");
        let own = with_originals(name, &SceneOptions::default());
        let other = cpu().render(&own, &settings).unwrap();
        let flip = metrics::compare(&frame.image, &other.image).unwrap().flip.mean();
        assert!(flip > 0.02, "{name}: the file changes the picture by FLIP {flip} only");
        let lit = frame.image.pixels.iter().filter(|p| p[0] > 0.01).count();
        assert!(lit * 3 > 96 * 96, "{name}: {lit} pixels are lit");
    }
}
