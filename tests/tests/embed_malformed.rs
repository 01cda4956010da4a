//! Broken files of others, read where they lie: each is refused or drawn in less than 5 s, and the process that takes them
//! all stays under 1 GiB. Alone in its process, so that the memory is theirs.

use catoptra_engine::{ImportLimits, fit_camera, load_gltf};
use catoptra_render_hybrid::{RenderError, RenderSettings, Shadows};
use catoptra_tests::{fixtures, shared_or_skip};
use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

const LONGEST: Duration = Duration::from_secs(5);
const MOST_MIB: u64 = 1024;

fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files(&path, found);
        } else if path.extension().is_some_and(|e| e == "gltf" || e == "glb") {
            found.push(path);
        }
    }
}

/// Greatest resident memory so far, MiB.
fn most_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    line.split_whitespace().next()?.parse::<u64>().ok().map(|kib| kib / 1024)
}

#[test]
fn all_of_them_are_harmless() {
    let Some(folder) = shared_or_skip("all_of_them_are_harmless", "assets/gltf-malformed") else { return };
    let mut found = Vec::new();
    files(&folder, &mut found);
    found.sort();
    assert_eq!(found.len(), 296);
    let settings = RenderSettings { shadows: Shadows::Off, max_depth: 2, ..fixtures::small(16, 12, 16) };
    let mut renderer = fixtures::cpu();
    let (mut drawn, mut refused, mut slowest) = (0, 0, (Duration::ZERO, PathBuf::new()));
    for path in &found {
        let start = Instant::now();
        match load_gltf(path, &ImportLimits::default()) {
            Err(e) => {
                let line = e.to_string();
                assert!(!line.is_empty() && line.lines().count() == 1, "{}: {line:?}", path.display());
                refused += 1;
            }
            Ok(file) => {
                let mut scene = file.to_render_scene(0);
                if !file.report.has_camera {
                    scene.camera = fit_camera(file.bounds_world());
                }
                match renderer.render(&scene, &settings) {
                    Ok(frame) => {
                        assert!(frame.image.pixels.iter().flatten().all(|v| v.is_finite()), "{}", path.display())
                    }
                    Err(e @ RenderError::Scene(_)) => println!("{}: not drawn: {e}", path.display()),
                    Err(e) => panic!("{}: {e}", path.display()),
                }
                drawn += 1;
            }
        }
        let took = start.elapsed();
        assert!(took < LONGEST, "{} took {took:?}", path.display());
        if took > slowest.0 {
            slowest = (took, path.clone());
        }
    }
    let memory = most_memory();
    println!(
        "{drawn} drawn, {refused} refused; slowest {:?} ({}); at most {memory:?} MiB",
        slowest.0,
        slowest.1.display()
    );
    assert!(drawn > 100 && refused > 50, "{drawn} drawn, {refused} refused");
    assert!(memory.is_none_or(|m| m < MOST_MIB), "{memory:?} MiB");
}
