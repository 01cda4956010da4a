//! A glTF or GLB file as a world.

use super::failure::{Failure, note};
use catoptra_engine::{
    CameraProjection, RenderScene, StableId, app,
    bevy_app::App,
    bevy_transform::components::Transform,
    fit,
    gltf::{ImportLimits, ImportedScene, load_gltf},
};
use std::path::Path;

/// Stable id of what a file lacked and was given; the file's own count up from 1.
const ADDED: u64 = u64::MAX - 2;

/// Number of the animation that `text` names: a number from 0, a name, or a name in other capitals.
///
/// # Errors
/// What there is.
fn animation(scene: &ImportedScene, text: &str) -> Result<usize, String> {
    let by_number = text.parse().ok().filter(|n| *n < scene.animations.len());
    let alike = |name: &str| name.to_lowercase() == text.to_lowercase();
    let by_likeness = || scene.animations.iter().position(|a| a.name.as_deref().is_some_and(alike));
    if let Some(found) = by_number.or_else(|| scene.animation_named(text)).or_else(by_likeness) {
        return Ok(found);
    }
    let each = scene.animations.iter().enumerate().map(|(i, a)| match &a.name {
        Some(name) => format!("{i} {name:?} ({:.2} s)", a.duration),
        None => format!("{i} ({:.2} s)", a.duration),
    });
    Err(match each.collect::<Vec<_>>() {
        none if none.is_empty() => format!("there is no animation {text:?}: it has none"),
        all => format!("there is no animation {text:?}; there are {}", all.join(", ")),
    })
}

/// The file at frame 0; a fitted camera and a headlight where it has none, told on stderr.
/// * `plays`: number or name of the animation; `None`: the first, where there is one
pub fn open(path: &Path, plays: Option<&str>) -> Result<App, Failure> {
    let failed = |e: &dyn std::fmt::Display| {
        let (name, text) = (path.display().to_string(), e.to_string());
        // Errors of the file system name the file already.
        Failure::other(if text.starts_with(&name) { text } else { format!("{name}: {text}") })
    };
    let imported = load_gltf(path, &ImportLimits::default()).map_err(|e| failed(&e))?;
    let report = &imported.report;
    if !report.ignored.is_empty() {
        note(format!("{}: left out: {}", path.display(), report.ignored.join(", ")));
    }
    if report.instances == 0 {
        return Err(failed(&"there is nothing to draw in it"));
    }
    let plays = plays.map(|text| animation(&imported, text)).transpose();
    let plays = plays.map_err(|e| Failure::usage(format!("{}: {e}", path.display())))?;
    let mut world = app::new_app();
    let spawned = imported.spawn(world.world_mut(), 1);
    if plays.is_some() {
        imported.play(world.world_mut(), &spawned, plays);
    }
    let bounds = imported.bounds_world();
    if !report.has_camera {
        let camera = fit::fit_camera(bounds);
        let pose = Transform::from_matrix(camera.world_from_view.into());
        let lens = CameraProjection { projection: camera.projection, near: camera.near };
        world.world_mut().spawn((StableId(ADDED), lens, pose));
    }
    if !report.has_light {
        // The camera is posed by now, wherever it came from.
        let camera = imported.camera().unwrap_or_else(|| fit::fit_camera(bounds));
        let pose = Transform::from_matrix(camera.world_from_view.into());
        world.world_mut().spawn((StableId(ADDED + 1), fit::headlight(&camera, bounds), pose));
    }
    app::settle(&mut world);
    note_missing(path, !report.has_camera, !report.has_light);
    Ok(world)
}

fn note_missing(path: &Path, camera: bool, light: bool) {
    let what = match (camera, light) {
        (true, true) => "no camera and no light; it gets a fitted camera and a headlight",
        (true, false) => "no camera; it gets a fitted one",
        (false, true) => "no light; it gets a headlight at the camera",
        (false, false) => return,
    };
    note(format!("{} has {what}", path.display()));
}

/// A number that tells scenes apart (FNV-1a over what they hold), for files that go on with earlier work.
pub fn fingerprint(scene: &RenderScene) -> u64 {
    use std::fmt::Write;
    struct Fnv(u64);
    impl Write for Fnv {
        fn write_str(&mut self, s: &str) -> std::fmt::Result {
            for b in s.bytes() {
                self.0 = (self.0 ^ u64::from(b)).wrapping_mul(0x100_0000_01b3);
            }
            Ok(())
        }
    }
    let mut hash = Fnv(0xcbf2_9ce4_8422_2325);
    let RenderScene { meshes, materials, instances, lights, camera, environment, .. } = scene;
    // Writing into a number cannot fail.
    let _ = write!(hash, "{materials:?}{instances:?}{lights:?}{camera:?}{environment:?}");
    for mesh in meshes {
        let _ = write!(hash, "{}{:?}", mesh.triangles().len(), mesh.bounds_object());
    }
    hash.0
}
