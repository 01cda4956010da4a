//! The five scenes are what the design says: exact triangle counts, mirror or glass on at least a tenth of the picture where
//! there is any, and camera, light and objects in motion.

use catoptra_engine::{Light, RenderScene};
use catoptra_render_hybrid::{RenderSettings, Shadows};
use catoptra_tests::fixtures::{FRAMES, SCENE_NAMES, app_at, cpu, extracted, scene_at, small};

#[test]
fn triangle_counts_are_exact() {
    let counts = SCENE_NAMES.map(|name| {
        let scene = scene_at(name, 0);
        let listed = catoptra_demos::scenes::info(name).expect("a listed scene").triangles;
        assert_eq!(scene.triangle_count(), listed as usize, "{name}: what the list says");
        scene.triangle_count()
    });
    assert_eq!(counts, [22, 598, 1_066, 31_420, 66_466]);
    assert_eq!(catoptra_demos::scenes::SCENES.map(|s| s.name), SCENE_NAMES);
}

#[test]
fn every_scene_is_valid_at_every_frame() {
    for name in SCENE_NAMES {
        let mut app = app_at(name, 0);
        for frame in 0..=120 {
            extracted(&app).validate().unwrap_or_else(|e| panic!("{name} frame {frame}: {e}"));
            catoptra_engine::app::advance(&mut app, 1);
        }
    }
}

/// Share of the pixels with a mirror or glass share.
fn masked_share(scene: &RenderScene, settings: &RenderSettings) -> f64 {
    let frame = cpu().render(scene, settings).unwrap();
    frame.stats.masked_pixels as f64 / f64::from(settings.width * settings.height)
}

#[test]
fn a_tenth_of_the_picture_is_traced() {
    // Nothing but the G-buffer matters here.
    let settings = RenderSettings { shadows: Shadows::Off, vpl: None, traced: false, ..small(256, 256, 16) };
    for name in SCENE_NAMES {
        for frame in FRAMES {
            let share = masked_share(&scene_at(name, frame), &settings);
            println!("{name} frame {frame}: masked share {share:.3}");
            if name == "rolling-box" {
                assert_eq!(share, 0.0, "the first scene is all matte");
            } else {
                assert!((0.10..0.9).contains(&share), "{name} frame {frame}: masked share {share}");
            }
        }
    }
}

#[test]
fn camera_lights_and_objects_move() {
    let pose = |l: &Light| (l.position_world, l.direction_world);
    for name in SCENE_NAMES {
        let scenes = FRAMES.map(|f| scene_at(name, f));
        for (was, now) in [(&scenes[0], &scenes[1]), (&scenes[1], &scenes[2])] {
            assert_ne!(was.camera.world_from_view, now.camera.world_from_view, "{name}: the camera stands still");
            assert!(
                was.lights.iter().zip(&now.lights).all(|(a, b)| pose(a) != pose(b)),
                "{name}: a light stands still"
            );
            let moved =
                was.instances.iter().zip(&now.instances).filter(|(a, b)| a.world_from_object != b.world_from_object);
            assert!(moved.count() > 0, "{name}: no object moves");
            assert_eq!(was.instances.len(), now.instances.len());
            // Lights have a radius: the shadows are soft.
            assert!(now.lights.iter().all(|l| l.radius > 0.0), "{name}: a light without a radius");
        }
        // Nothing is baked: the same frame of another app is the same scene.
        let again = scene_at(name, 90);
        assert_eq!(again.instances, scenes[2].instances, "{name}");
        assert_eq!(again.lights, scenes[2].lights, "{name}");
        assert_eq!(again.camera, scenes[2].camera, "{name}");
    }
}

#[test]
fn ambient_light_is_off() {
    for name in SCENE_NAMES {
        assert!(scene_at(name, 0).materials.iter().all(|m| m.ambient == 0.0), "{name}: k_a is 0 in the five scenes");
    }
}
