//! What every scene promises: exact counts, motion of everything that moves, coverage by mirror or glass, a viewer that
//! sees nothing from outside.

use super::*;
use catoptra_engine::{Aabb, Extracted, RenderScene, app};
use catoptra_render_hybrid::accel::{Accel, AccelOptions, Ray};

const FRAMES: [u64; 3] = [0, 30, 90];

/// The scene at the frames of the contract.
fn frames(name: &str, options: &SceneOptions) -> Vec<RenderScene> {
    let mut app = build(name, options).unwrap();
    let mut at = 0;
    FRAMES
        .iter()
        .map(|&k| {
            app::advance(&mut app, k - at);
            at = k;
            let scene = app.world().resource::<Extracted>().0.clone();
            scene.validate().unwrap();
            scene
        })
        .collect()
}

/// (share of pixels whose nearest surface is mirror or glass, share that sees none) of a square picture.
fn coverage(scene: &RenderScene, side: u32) -> (f32, f32) {
    let mut accel = Accel::new(AccelOptions::default()).unwrap();
    accel.update(scene);
    let (mut traced, mut sky) = (0u32, 0u32);
    for i in 0..side * side {
        let (origin, direction) = scene.camera.ray((i % side) as f32 + 0.5, (i / side) as f32 + 0.5, side, side);
        let hit = accel.closest_hit(&Ray::new(origin, direction));
        if !hit.is_hit() {
            sky += 1;
        } else {
            let material = scene.instances[hit.instance_id as usize].material;
            traced += u32::from(scene.materials[material as usize].is_traced());
        }
    }
    let n = (side * side) as f32;
    (traced as f32 / n, sky as f32 / n)
}

#[test]
fn counts_are_the_methods() {
    let expected = [22, 598, 1_066, 31_420, 66_466];
    for (info, count) in SCENES.iter().zip(expected) {
        let scene = &frames(info.name, &SceneOptions::default())[0];
        assert_eq!((scene.triangle_count(), info.triangles), (count, count), "{}", info.name);
    }
}

#[test]
fn camera_lights_and_bodies_move_between_the_frames() {
    for info in SCENES {
        let f = frames(info.name, &SceneOptions::default());
        for (a, b) in [(0, 1), (1, 2), (0, 2)] {
            let (a, b) = (&f[a], &f[b]);
            let eye = |s: &RenderScene| s.camera.world_from_view.translation;
            assert!((eye(a) - eye(b)).length() > 5e-3, "{}: the camera rests", info.name);
            assert!(!a.lights.is_empty());
            for (l, m) in a.lights.iter().zip(&b.lights) {
                let moved = (l.position_world - m.position_world).length();
                assert!(moved > 5e-3 && l.radius > 0.0, "{}: light {} rests", info.name, l.stable_id);
            }
            let moved = a
                .instances
                .iter()
                .zip(&b.instances)
                .filter(|(i, j)| i.world_from_object != j.world_from_object)
                .count();
            let expected = if info.name == "rolling-box-donut" { 2 } else { 1 };
            assert_eq!(moved, expected, "{}: bodies that moved", info.name);
        }
    }
}

#[test]
fn motion_is_smooth() {
    for info in SCENES {
        let mut app = build(info.name, &SceneOptions::default()).unwrap();
        let mut before = app.world().resource::<Extracted>().0.clone();
        for _ in 0..240 {
            app::advance(&mut app, 1);
            let now = app.world().resource::<Extracted>().0.clone();
            let eye = |s: &RenderScene| s.camera.world_from_view;
            // Half a metre a second for the viewer, ten for anything else: no jumps.
            assert!((eye(&now).translation - eye(&before).translation).length() < 0.5 / 60.0, "{}", info.name);
            assert!((eye(&now).matrix3.z_axis - eye(&before).matrix3.z_axis).length() < 0.5 / 60.0);
            for (i, j) in now.instances.iter().zip(&before.instances) {
                let d = (i.world_from_object.translation - j.world_from_object.translation).length();
                assert!(d < 10.0 / 60.0, "{}: instance {} jumps by {d}", info.name, i.stable_id);
            }
            for (l, m) in now.lights.iter().zip(&before.lights) {
                assert!((l.position_world - m.position_world).length() < 2.0 / 60.0);
            }
            before = now;
        }
    }
}

#[test]
fn mirror_and_glass_cover_a_tenth_and_the_room_fills_the_picture() {
    for info in SCENES {
        for (scene, frame) in frames(info.name, &SceneOptions::default()).iter().zip(FRAMES) {
            let (traced, sky) = coverage(scene, 128);
            if info.traced {
                assert!(traced > 0.105, "{} frame {frame}: {traced}", info.name);
            } else {
                assert_eq!(traced, 0.0, "{} frame {frame}", info.name);
            }
            let open = if info.name == "rolling-box-sponza" { 0.25 } else { 0.0 };
            assert!(sky <= open, "{} frame {frame}: {sky} of the picture sees nothing", info.name);
        }
    }
}

#[test]
fn bodies_stay_clear_of_the_viewer_and_each_other_for_a_minute() {
    for info in SCENES {
        let mut app = build(info.name, &SceneOptions::default()).unwrap();
        for _ in 0..120 {
            app::advance(&mut app, 30);
            let scene = &app.world().resource::<Extracted>().0;
            let eye = scene.camera.world_from_view.translation;
            for i in scene.instances.iter().filter(|i| i.world_from_object != glam::Affine3::IDENTITY) {
                // Bounds of the vertices themselves: the box around a turned box would reach too far.
                let vertices = scene.meshes[i.mesh as usize].positions();
                let b = Aabb::from_points(vertices.iter().map(|&p| i.world_from_object.transform_point3(p)));
                let near = (eye - eye.clamp(b.min, b.max)).length();
                assert!(near > 0.1, "{}: instance {} comes within {near} m of the viewer", info.name, i.stable_id);
                assert!(b.min.y > -1e-4, "{}: instance {} is in the floor", info.name, i.stable_id);
            }
        }
    }
}

#[test]
fn frames_do_not_depend_on_the_way_there() {
    for info in SCENES.iter().take(3) {
        let pose = |steps: &[u64]| {
            let mut app = build(info.name, &SceneOptions::default()).unwrap();
            for &n in steps {
                app::advance(&mut app, n);
            }
            let s = &app.world().resource::<Extracted>().0;
            (s.instances.clone(), s.lights.clone(), s.camera)
        };
        assert_eq!(pose(&[90]), pose(&[30, 1, 59]), "{}", info.name);
    }
}

#[test]
fn wrong_names_and_files_are_refused_in_one_line() {
    let refused = |name: &str, options: SceneOptions| match build(name, &options) {
        Ok(_) => panic!("{name} was built"),
        Err(e) => e.to_string(),
    };
    let text = refused("rolling-bx", SceneOptions::default());
    assert!(text.contains("rolling-box-donut") && !text.contains('\n'), "{text}");
    let missing = PathBuf::from("no/such/file.glb");
    let text = refused("rolling-box-venus", SceneOptions { statue: Some(missing.clone()), ..Default::default() });
    assert!(text.contains("no/such/file.glb") && !text.contains('\n'), "{text}");
    let text = refused("rolling-box-sponza", SceneOptions { atrium: Some(missing), ..Default::default() });
    assert!(text.contains("no/such/file.glb") && !text.contains('\n'), "{text}");
}

/// Test data that is not part of the project: `../shared/assets` from the workspace root.
fn asset(path: &str) -> Option<PathBuf> {
    let full = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/assets").join(path);
    if !full.is_file() {
        eprintln!("SKIPPED: {} is not there", full.display());
        return None;
    }
    Some(full)
}

#[test]
fn the_real_venus_and_sponza_take_their_places() {
    if let Some(statue) = asset("venus/venus_31402.glb") {
        for scene in frames("rolling-box-venus", &SceneOptions { statue: Some(statue), ..Default::default() }) {
            assert_eq!(scene.triangle_count(), 31_424);
            let (traced, _) = coverage(&scene, 128);
            assert!(traced > 0.1, "she is seen: {traced}");
        }
    }
    if let Some(atrium) = asset("sponza/sponza_dabrovic_66454.glb") {
        for scene in frames("rolling-box-sponza", &SceneOptions { atrium: Some(atrium), ..Default::default() }) {
            assert_eq!(scene.triangle_count(), 66_466);
            let (traced, sky) = coverage(&scene, 128);
            assert!(traced > 0.1 && sky < 0.3, "the box is seen: {traced}, sky {sky}");
            // The box stands on the court's floor, which is not the lowest surface of the file.
            let b = scene.instances.last().unwrap();
            let low = scene.meshes[b.mesh as usize].bounds_object().transformed(&b.world_from_object).min.y;
            assert!((low - 0.09).abs() < 0.02, "{low}");
        }
    }
}
