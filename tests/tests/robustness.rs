//! Bad input gives one clear error and no panic; odd but legal input gives a picture without NaN. After an error a renderer
//! draws on as if nothing had been.

use catoptra_engine::{
    Camera, LightKind, Material, Mesh, MeshData, Projection, RenderScene, TextureRef,
    shapes::{cuboid, open_room, sphere, torus},
};
use catoptra_render_hybrid::{
    Frame, MomentOptions, RenderError, RenderSettings, Shadows, VplOptions, metrics,
    trace::reference::{ReferenceAccumulator, ReferenceOptions},
};
use catoptra_tests::{
    HandScene, at,
    fixtures::{cpu, fresh, full_vpls, small},
};
use glam::{Affine3, Mat3, Vec3};

/// A room with a mirror torus, a glass ball and a matte box under a spot and a point light.
fn room(scale: f32) -> RenderScene {
    let mut scene = HandScene::new(Camera {
        near: 0.01 * scale,
        ..Camera::looking_at(Vec3::new(0.2, 0.3, 2.4) * scale, Vec3::new(0.0, -0.2, 0.0) * scale, 0.9)
    });
    let pose = |p: Vec3| Affine3 { matrix3: Mat3::from_diagonal(Vec3::splat(scale)), translation: p * scale };
    let colors = [Vec3::X, Vec3::Y, Vec3::ONE, Vec3::ONE, Vec3::splat(0.6), Vec3::ONE].map(|c| c * 0.6 + 0.1);
    scene.add(open_room(Vec3::splat(1.5), colors), Material::lambert(Vec3::ONE), pose(Vec3::ZERO));
    scene.add(torus(0.5, 0.2, 24, 12), Material::mirror(Vec3::splat(0.9), 0.8), pose(Vec3::new(0.6, -0.9, 0.0)));
    let tinted = Material {
        attenuation_color: Vec3::new(0.9, 0.6, 0.7),
        attenuation_distance: 0.8 * scale,
        ..Material::glass(Vec3::ONE, 1.5)
    };
    scene.add(sphere(0.45, 16, 24), tinted, pose(Vec3::new(-0.6, -0.6, 0.3)));
    let matte = Material { specular: Vec3::splat(0.2), ..Material::lambert(Vec3::splat(0.5)) };
    scene.add(cuboid(Vec3::splat(0.25), [Vec3::ONE; 6]), matte, pose(Vec3::new(0.1, -1.25, 0.7)));
    let strength = Vec3::splat(6.0 * scale * scale);
    let spot = LightKind::Spot { cos_inner: 0.9, cos_outer: 0.75 };
    scene.light(spot, Vec3::new(0.3, 1.4, 0.2) * scale, strength).radius = 0.05 * scale;
    scene.light(LightKind::Point, Vec3::new(-0.7, 0.9, 0.8) * scale, strength * 0.2).radius = 0.05 * scale;
    scene.0
}

fn settings() -> RenderSettings {
    small(48, 40, 64)
}

/// The error's line, after a check that it is one line, and that the renderer then draws a good scene rightly.
fn refused(what: &str, scene: &RenderScene, settings: &RenderSettings) -> String {
    let mut renderer = cpu();
    let error: RenderError = match renderer.render(scene, settings) {
        Err(e) => e,
        Ok(_) => panic!("{what} was accepted"),
    };
    let line = error.to_string();
    assert!(!line.is_empty() && line.lines().count() == 1, "{what}: {line:?}");
    let good = room(1.0);
    let after = renderer.render(&good, &self::settings()).unwrap();
    assert_eq!(after.image.hash(), fresh(&good, &self::settings()).image.hash(), "after {what}");
    println!("{what}: {line}");
    line
}

/// The picture, all finite.
fn drawn(what: &str, scene: &RenderScene, settings: &RenderSettings) -> Frame {
    let frame = cpu().render(scene, settings).unwrap_or_else(|e| panic!("{what}: {e}"));
    assert!(frame.image.pixels.iter().flatten().all(|v| v.is_finite()), "{what}");
    assert_eq!(frame.stats.non_finite, (0, None), "{what}");
    frame
}

#[test]
fn transforms_that_are_no_numbers_are_refused() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for place in 0..2 {
            let mut scene = room(1.0);
            let m = &mut scene.instances[2].world_from_object;
            *(if place == 0 { &mut m.matrix3.y_axis.x } else { &mut m.translation.z }) = bad;
            let line = refused(&format!("a transform with {bad}"), &scene, &settings());
            assert!(line.contains("instance 2"), "it says which: {line}");
        }
        let mut scene = room(1.0);
        scene.lights[1].position_world.x = bad;
        assert!(refused(&format!("a light at {bad}"), &scene, &settings()).contains("light 1"));
        let mut scene = room(1.0);
        scene.lights[0].intensity.y = bad;
        refused(&format!("a light of {bad}"), &scene, &settings());
        let mut scene = room(1.0);
        scene.lights[0].up_world.y = bad;
        refused(&format!("a light whose up is {bad}"), &scene, &settings());
        let mut scene = room(1.0);
        scene.camera.world_from_view.translation.y = bad;
        assert!(refused(&format!("a camera at {bad}"), &scene, &settings()).contains("camera"));
        let mut scene = room(1.0);
        scene.materials[0].base_color.x = bad;
        refused(&format!("a colour of {bad}"), &scene, &settings());
        let mut scene = room(1.0);
        scene.environment.background.x = bad;
        refused(&format!("a background of {bad}"), &scene, &settings());
    }
}

#[test]
fn numbers_out_of_range_are_refused() {
    type Change = fn(&mut RenderScene);
    let changes: [(&str, Change); 17] = [
        ("a mesh that is not there", |s| s.instances[0].mesh = 99),
        ("a material that is not there", |s| s.instances[0].material = 99),
        ("a texture that is not there", |s| s.materials[0].base_color_texture = Some(TextureRef::default())),
        ("negative light", |s| s.lights[0].intensity.x = -1.0),
        ("a negative radius", |s| s.lights[0].radius = -1.0),
        ("mirror over 1", |s| s.materials[1].mirror = 1.5),
        ("negative transmission", |s| s.materials[1].transmission = -0.1),
        ("an index of refraction below 1", |s| s.materials[2].ior = 0.5),
        ("an index of refraction of NaN", |s| s.materials[2].ior = f32::NAN),
        ("an attenuation distance of 0", |s| s.materials[2].attenuation_distance = 0.0),
        ("negative shininess", |s| s.materials[3].shininess = -1.0),
        ("negative emission", |s| s.materials[0].emissive.z = -1.0),
        ("an opening angle of 0", |s| s.camera.projection = Projection::Perspective { fov_y: 0.0 }),
        ("an opening angle of 180 degrees", |s| {
            s.camera.projection = Projection::Perspective { fov_y: std::f32::consts::PI }
        }),
        ("a parallel camera of no height", |s| s.camera.projection = Projection::Orthographic { half_height: 0.0 }),
        ("a near distance below 0", |s| s.camera.near = -1.0),
        ("a near distance of NaN", |s| s.camera.near = f32::NAN),
    ];
    for (what, change) in changes {
        let mut scene = room(1.0);
        change(&mut scene);
        refused(what, &scene, &settings());
    }
}

#[test]
fn settings_out_of_range_are_refused() {
    let base = settings();
    let vpl = VplOptions::default();
    let moments = base.moments;
    let bad = [
        ("width 0", RenderSettings { width: 0, ..base }),
        ("height 0", RenderSettings { height: 0, ..base }),
        ("a huge width", RenderSettings { width: 1 << 20, ..base }),
        ("a huge height", RenderSettings { height: u32::MAX, ..base }),
        ("depth 0", RenderSettings { max_depth: 0, ..base }),
        ("depth 1000", RenderSettings { max_depth: 1000, ..base }),
        ("tile 0", RenderSettings { tile: 0, ..base }),
        ("tile 7", RenderSettings { tile: 7, ..base }),
        ("tile 4096", RenderSettings { tile: 4096, ..base }),
        ("no shadow samples", RenderSettings { shadow_samples: 0, ..base }),
        ("no VPLs", RenderSettings { vpl: Some(VplOptions { count: 0, ..vpl }), ..base }),
        ("no bounces", RenderSettings { vpl: Some(VplOptions { bounces: 0, ..vpl }), ..base }),
        (
            "a bound of NaN",
            RenderSettings { vpl: Some(VplOptions { geometry_term_max: Some(f32::NAN), ..vpl }), ..base },
        ),
        ("a bound below 0", RenderSettings { vpl: Some(VplOptions { geometry_term_max: Some(-1.0), ..vpl }), ..base }),
        ("a weight of NaN", RenderSettings { min_weight: f32::NAN, ..base }),
        ("maps of 0", RenderSettings { moments: MomentOptions { size: 0, ..moments }, ..base }),
        ("huge maps", RenderSettings { moments: MomentOptions { face_size: 1 << 20, ..moments }, ..base }),
        ("no variance", RenderSettings { moments: MomentOptions { min_variance: 0.0, ..moments }, ..base }),
        ("variance of NaN", RenderSettings { moments: MomentOptions { min_variance: f32::NAN, ..moments }, ..base }),
        (
            "all light bleeding",
            RenderSettings { moments: MomentOptions { light_bleed_reduction: 1.0, ..moments }, ..base },
        ),
    ];
    for (what, settings) in bad {
        refused(what, &room(1.0), &settings);
    }
}

#[test]
fn empty_worlds_are_drawn() {
    for shadows in [Shadows::Moments, Shadows::Traced, Shadows::Off] {
        let settings = RenderSettings { shadows, vpl: Some(full_vpls(16, 2)), keep_layers: true, ..settings() };
        let nothing = drawn("nothing", &RenderScene::default(), &settings);
        assert!(nothing.image.pixels.iter().all(|p| *p == [0.0; 3]));
        let sky = HandScene::default().background(Vec3::new(0.1, 0.2, 0.3));
        assert!(drawn("sky", &sky.0, &settings).image.pixels.iter().all(|p| *p == [0.1, 0.2, 0.3]));

        let mut dark = room(1.0);
        dark.lights.clear();
        assert!(drawn("no light", &dark, &settings).image.pixels.iter().all(|p| *p == [0.0; 3]));
        let mut lights_only = room(1.0);
        lights_only.instances.clear();
        drawn("lights alone", &lights_only, &settings);
        let mut no_triangles = room(1.0);
        no_triangles.meshes[0] = Mesh::new(MeshData::default()).unwrap().into();
        drawn("a mesh without triangles", &no_triangles, &settings);
        let mut away = room(1.0);
        away.camera = Camera::looking_at(Vec3::new(0.0, 0.0, 50.0), Vec3::new(0.0, 0.0, 60.0), 0.5);
        drawn("a camera that sees nothing", &away, &settings);
    }
}

#[test]
fn degenerate_shapes_are_drawn() {
    let flat = |axis: usize| {
        let mut d = Vec3::ONE;
        d[axis] = 0.0;
        Mat3::from_diagonal(d)
    };
    let sheared = Mat3::from_cols(Vec3::X, Vec3::new(3.0, 1.0, 0.0), Vec3::new(0.0, 2.0, 1.0));
    let poses = [
        ("scale 0", Mat3::ZERO),
        ("flat in x", flat(0)),
        ("flat in y", flat(1)),
        ("flat in z", flat(2)),
        ("mirrored", Mat3::from_diagonal(Vec3::new(-1.0, 1.0, 1.0))),
        ("sheared", sheared),
        ("1e-30 of the size", Mat3::from_diagonal(Vec3::splat(1e-30))),
        ("long and thin", Mat3::from_diagonal(Vec3::new(1e4, 1e-4, 1.0))),
    ];
    for shadows in [Shadows::Moments, Shadows::Traced] {
        let settings = RenderSettings { shadows, ..settings() };
        for (what, matrix3) in poses {
            for instance in 1..4 {
                let mut scene = room(1.0);
                scene.instances[instance].world_from_object.matrix3 = matrix3;
                drawn(what, &scene, &settings);
            }
        }
        // Triangles of no area, a hundred times the same triangle, and normals of zero length.
        let p = vec![Vec3::ZERO, Vec3::X, Vec3::X * 2.0, Vec3::Y];
        let triangles = vec![[0, 0, 0], [0, 1, 2], [1, 1, 3], [0, 1, 3]];
        let degenerate = MeshData { positions: p.clone(), triangles, ..MeshData::default() };
        let many = MeshData { positions: p.clone(), triangles: vec![[0, 1, 3]; 100], ..MeshData::default() };
        let normals = vec![Vec3::ZERO; 4];
        let no_normals = MeshData { positions: p, normals, triangles: vec![[0, 1, 3]], ..MeshData::default() };
        for (what, data) in [("no area", degenerate), ("duplicates", many), ("no normals", no_normals)] {
            for material in [Material::default(), Material::mirror(Vec3::ONE, 0.5), Material::glass(Vec3::ONE, 1.5)] {
                let mut scene = HandScene(room(1.0));
                scene.add(Mesh::new(data.clone()).unwrap(), material, at(Vec3::new(-0.5, -0.5, 1.0)));
                drawn(what, &scene.0, &settings);
            }
        }
    }
}

#[test]
fn odd_places_are_drawn() {
    let settings = RenderSettings { vpl: Some(full_vpls(24, 2)), ..settings() };
    let mut inside = room(1.0);
    inside.camera = Camera::looking_at(Vec3::new(-0.6, -0.6, 0.3), Vec3::ZERO, 1.5);
    drawn("a camera inside of glass", &inside, &settings);
    let mut on_wall = room(1.0);
    on_wall.camera = Camera::looking_at(Vec3::new(0.0, -1.5, 0.0), Vec3::new(0.0, 0.0, -1.0), 0.9);
    drawn("a camera in the floor", &on_wall, &settings);
    let mut down = room(1.0);
    down.camera = Camera::looking_at(Vec3::new(0.0, 1.0, 0.0), Vec3::ZERO, 0.9);
    drawn("a camera that looks straight down", &down, &settings);
    for shadows in [Shadows::Moments, Shadows::Traced] {
        let settings = RenderSettings { shadows, ..settings };
        let mut scene = room(1.0);
        scene.lights[0].position_world = Vec3::new(0.2, -1.5, 0.1);
        scene.lights[1].position_world = scene.camera.world_from_view.translation;
        drawn("a light in the floor and one in the camera", &scene, &settings);
        let mut scene = room(1.0);
        scene.lights[0].kind = LightKind::Spot { cos_inner: 1.0, cos_outer: 1.0 };
        scene.lights[1].kind = LightKind::Spot { cos_inner: 0.5, cos_outer: -1.0 };
        drawn("a spot of no width and one of all directions", &scene, &settings);
        let mut scene = room(1.0);
        scene.lights[0].kind = LightKind::Directional;
        scene.lights[0].up_world = scene.lights[0].direction_world;
        drawn("a light whose up is its direction", &scene, &settings);
        let mut scene = room(1.0);
        scene.lights = vec![scene.lights[0]; 40];
        drawn("forty lights", &scene, &settings);
        let mut scene = room(1.0);
        scene.materials[3].shininess = 1e6;
        scene.materials[3].specular = Vec3::ONE;
        drawn("a shininess of a million", &scene, &settings);
    }
    for (width, height) in [(1, 1), (1, 37), (37, 1), (16384, 1)] {
        drawn("a thin picture", &room(1.0), &RenderSettings { width, height, ..settings });
    }
}

#[test]
fn the_path_tracer_takes_odd_worlds_too() {
    let options = ReferenceOptions::matching(&RenderSettings { vpl: Some(full_vpls(1, 1)), ..small(16, 12, 16) });
    let add = |scene: &RenderScene| {
        let mut sums = ReferenceAccumulator::new(16, 12);
        cpu().add_reference(&mut sums, scene, &options, 4).map(|_| sums.image())
    };
    assert!(add(&RenderScene::default()).unwrap().pixels.iter().all(|p| *p == [0.0; 3]));
    let mut flat = room(1.0);
    flat.instances[1].world_from_object.matrix3 = Mat3::ZERO;
    assert!(add(&flat).unwrap().pixels.iter().flatten().all(|v| v.is_finite()));
    flat.instances[1].world_from_object.translation.x = f32::NAN;
    assert!(add(&flat).is_err());
}

/// FLIP between the pictures of a scaled world and of the world itself. Mean, in [0, 1].
fn flip_of_scale(scale: f32, shadows: Shadows) -> f64 {
    let settings = RenderSettings { shadows, vpl: Some(VplOptions::default()), ..small(64, 56, 128) };
    let image = |s: f32| drawn(&format!("scale {s}"), &room(s), &settings).image;
    metrics::compare(&image(scale), &image(1.0)).unwrap().flip.mean()
}

#[test]
fn worlds_of_any_size_look_alike() {
    for shadows in [Shadows::Moments, Shadows::Traced] {
        for scale in [1e-6f32, 1e-3, 1e3, 1e6] {
            let flip = flip_of_scale(scale, shadows);
            println!("scale {scale:e}, {shadows:?}: FLIP mean {flip:.5}");
            // Rounding moves a few pixels of an edge; an absolute epsilon anywhere blackens or bleaches the picture.
            assert!(flip < 0.002, "scale {scale:e}, {shadows:?}: FLIP mean {flip}");
        }
        // The mismatch: the same world under light that was not scaled along.
        let mut wrong = room(1e3);
        wrong.lights[0].intensity *= 1.1;
        let settings = RenderSettings { shadows, ..small(64, 56, 128) };
        let (a, b) = (drawn("wrong", &wrong, &settings).image, drawn("right", &room(1.0), &settings).image);
        assert!(metrics::compare(&a, &b).unwrap().flip.mean() > 0.002);
    }
}

#[test]
fn powers_of_two_change_no_bit() {
    // Scaling by 2ⁿ is exact in floating point, so a picture that differs has an absolute length in it.
    let settings = |shadows| RenderSettings { shadows, vpl: Some(full_vpls(24, 2)), ..small(48, 40, 64) };
    for shadows in [Shadows::Moments, Shadows::Traced] {
        let expected = fresh(&room(1.0), &settings(shadows)).image.hash();
        for scale in [1.0 / 1_048_576.0f32, 1.0 / 1024.0, 4.0, 1024.0, 1_048_576.0] {
            let hash = fresh(&room(scale), &settings(shadows)).image.hash();
            assert_eq!(hash, expected, "scale {scale:e}, {shadows:?}");
        }
    }
}
