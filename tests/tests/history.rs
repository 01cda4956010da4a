//! History never shows: a world edited in any way gives the picture of a freshly built one, moving costs refits and never a
//! mesh tree, and what a renderer touches grows with what moved.

use bevy_app::App;
use bevy_ecs::prelude::*;
use bevy_transform::components::Transform;
use catoptra_engine::{
    Assets, CameraProjection, LightKind, LightSource, Material, MaterialId, MeshId, MeshInstance, Projection, StableId,
    app::{new_app, settle},
    components::Hidden,
    extract::SceneEnvironment,
    math,
    render_scene::Environment,
    shapes::{cuboid, sphere, torus},
};
use catoptra_render_hybrid::{RenderSettings, Renderer};
use catoptra_tests::{
    HandScene, at,
    ecs::{extract_now, fresh_copy},
    fixtures::{SCENE_NAMES, app_at, cpu, extracted, fresh, small},
};
use glam::{Affine3, Quat, Vec3};

/// Numbers from a seed, the same everywhere.
struct Dice(u32);

impl Dice {
    fn next(&mut self) -> u32 {
        // xorshift32; Marsaglia, "Xorshift RNGs", 2003.
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        self.0
    }
    fn below(&mut self, n: usize) -> usize {
        (self.next() >> 8) as usize % n
    }
    fn unit(&mut self) -> f32 {
        (self.next() >> 8) as f32 / 16_777_216.0
    }
    fn within(&mut self, half: Vec3) -> Vec3 {
        Vec3::new(self.unit() - 0.5, self.unit() - 0.5, self.unit() - 0.5) * (half * 2.0)
    }
    fn rotation(&mut self) -> Quat {
        let axis = self.within(Vec3::ONE).normalize_or(Vec3::Y);
        let (s, c) = math::sin_cos(self.unit() * 3.0);
        Quat::from_xyzw(axis.x * s, axis.y * s, axis.z * s, c)
    }
}

#[test]
fn everything_teleports_at_once() {
    let settings = small(64, 56, 64);
    for name in SCENE_NAMES {
        let mut app = app_at(name, 30);
        let mut renderer = cpu();
        let before = renderer.render(&extracted(&app), &settings).unwrap();

        // All of the world turns and shifts, and every body, light and camera moves a little on its own beside.
        let world = app.world_mut();
        let turn = Quat::from_xyzw(0.0, 0.6, 0.0, 0.8);
        let mut poses = world.query_filtered::<&mut Transform, With<StableId>>();
        let mut dice = Dice(7);
        let mut moved = 0;
        for mut t in poses.iter_mut(world) {
            let own = dice.within(Vec3::splat(0.15));
            t.translation = turn * t.translation + Vec3::new(30.0, -2.0, 11.0) + own;
            t.rotation = turn * t.rotation;
            moved += 1;
        }
        let scene = extract_now(&mut app);
        assert_eq!(scene.moved.len(), scene.instances.len(), "{name}: every instance is known to have moved");
        assert_eq!(moved, scene.instances.len() + scene.lights.len() + 1);
        let after = renderer.render(&scene, &settings).unwrap();
        assert_eq!(after.stats.blas_builds, 0, "{name}: a move builds no mesh tree");
        assert_ne!(after.image.hash(), before.image.hash(), "{name}: the teleport shows");

        let copy = fresh_copy(&mut app);
        let expected = fresh(&extracted(&copy), &settings);
        assert_eq!(after.image.hash(), expected.image.hash(), "{name}: the picture of a fresh world");
        assert!(after.image.pixels.iter().any(|p| p[0] > 0.0), "{name}: there is something to see");
    }
}

/// An app with a few kinds of bodies, two lights and a camera.
fn playground() -> App {
    let mut app = new_app();
    app.insert_resource(SceneEnvironment(Environment { background: Vec3::new(0.1, 0.2, 0.3), ambient: Vec3::ZERO }));
    let mut assets = Assets::default();
    assets.add_mesh(cuboid(Vec3::splat(0.4), [Vec3::ONE; 6]));
    assets.add_mesh(sphere(0.5, 8, 12));
    assets.add_mesh(torus(0.5, 0.2, 12, 8));
    assets.add_material(Material::lambert(Vec3::new(0.7, 0.5, 0.3)));
    assets.add_material(Material::mirror(Vec3::splat(0.9), 0.7));
    assets.add_material(Material::glass(Vec3::splat(0.95), 1.4));
    app.insert_resource(assets);
    let world = app.world_mut();
    let lens = CameraProjection { projection: Projection::Perspective { fov_y: 0.9 }, near: 0.01 };
    world.spawn((StableId(1), lens, Transform::from_xyz(0.0, 0.5, 9.0)));
    for i in 0..2u64 {
        let light = LightSource { kind: LightKind::Point, intensity: Vec3::splat(20.0), radius: 0.05 };
        world.spawn((StableId(i), light, Transform::from_xyz(3.0 * i as f32 - 1.5, 4.0, 2.0)));
    }
    for i in 0..12u64 {
        let t = Transform::from_xyz(i as f32 * 0.6 - 3.3, (i % 3) as f32 - 1.0, -((i % 4) as f32));
        let body = MeshInstance { mesh: MeshId(i as u32 % 3), material: MaterialId(i as u32 % 3) };
        world.spawn((StableId(100 + i), body, t));
    }
    settle(&mut app);
    app
}

fn bodies(app: &mut App) -> Vec<Entity> {
    let mut q = app.world_mut().query_filtered::<(Entity, &StableId), With<MeshInstance>>();
    let mut all: Vec<_> = q.iter(app.world()).map(|(e, id)| (*id, e)).collect();
    all.sort();
    all.into_iter().map(|(_, e)| e).collect()
}

/// One random edit of the world.
fn edit(app: &mut App, dice: &mut Dice, next_id: &mut u64) {
    let bodies = bodies(app);
    let pick = |dice: &mut Dice| bodies[dice.below(bodies.len())];
    let kind = dice.below(100);
    if kind < 60 && !bodies.is_empty() {
        // Move, turn, scale; also mirrored.
        let entity = pick(dice);
        let (place, rotation, mut scale) = (dice.within(Vec3::new(4.0, 2.0, 3.0)), dice.rotation(), dice.unit() + 0.5);
        if dice.below(8) == 0 {
            scale = -scale;
        }
        let mut t = app.world_mut().get_mut::<Transform>(entity).expect("a body has a pose");
        *t = Transform { translation: place, rotation, scale: Vec3::new(scale, scale.abs(), scale.abs()) };
    } else if kind < 72 && bodies.len() < 40 {
        let body = MeshInstance { mesh: MeshId(dice.below(3) as u32), material: MaterialId(dice.below(3) as u32) };
        // Ids come in no order: below, between and above those that are there.
        let id = if dice.below(2) == 0 { *next_id } else { 1_000_000 - *next_id };
        *next_id += 1;
        let pose = Transform::from_translation(dice.within(Vec3::new(4.0, 2.0, 3.0)));
        app.world_mut().spawn((StableId(id), body, pose));
    } else if kind < 82 && bodies.len() > 3 {
        let entity = pick(dice);
        app.world_mut().despawn(entity);
    } else if kind < 88 && !bodies.is_empty() {
        let entity = pick(dice);
        let mut e = app.world_mut().entity_mut(entity);
        if e.contains::<Hidden>() {
            e.remove::<Hidden>();
        } else {
            e.insert(Hidden);
        }
    } else if kind < 92 && !bodies.is_empty() {
        let (entity, material) = (pick(dice), MaterialId(dice.below(3) as u32));
        app.world_mut().get_mut::<MeshInstance>(entity).expect("a body").material = material;
    } else if kind < 94 {
        let color = dice.within(Vec3::splat(0.4)) + 0.5;
        app.world_mut().resource_mut::<Assets>().materials[0].base_color = color;
    } else {
        // A light or the camera.
        let place = dice.within(Vec3::new(0.5, 0.5, 0.5));
        let camera = kind < 97;
        let mut q = app.world_mut().query::<(&mut Transform, Option<&LightSource>, Option<&CameraProjection>)>();
        for (mut t, light, lens) in q.iter_mut(app.world_mut()) {
            if camera && lens.is_some() {
                t.translation = Vec3::new(0.0, 0.5, 9.0) + place;
            } else if !camera && light.is_some() {
                t.translation += place;
                break;
            }
        }
    }
}

#[test]
fn a_thousand_edits_equal_a_fresh_world() {
    let settings = RenderSettings { max_depth: 4, ..small(40, 32, 32) };
    let mut app = playground();
    let (mut dice, mut next_id) = (Dice(2026), 500);
    // One renderer sees every state, one only every fiftieth.
    let (mut always, mut seldom) = (cpu(), cpu());
    let mut pictures = Vec::new();
    for n in 1..=1000 {
        edit(&mut app, &mut dice, &mut next_id);
        let scene = extract_now(&mut app);
        let draws = n % 5 == 0;
        let seen = if draws { Some(always.render(&scene, &settings).unwrap().image.hash()) } else { None };
        if n % 50 == 0 {
            let copy = extracted(&fresh_copy(&mut app));
            assert_eq!(scene.instances, copy.instances, "after {n} edits");
            assert_eq!(scene.lights, copy.lights, "after {n} edits");
            let expected = fresh(&copy, &settings).image.hash();
            assert_eq!(seen, Some(expected), "after {n} edits, by a renderer that saw them");
            let late = seldom.render(&scene, &settings).unwrap().image.hash();
            assert_eq!(late, expected, "after {n} edits, by a renderer that missed 49 of 50");
            pictures.push(expected);
        }
    }
    pictures.sort_unstable();
    pictures.dedup();
    assert_eq!(pictures.len(), 20, "twenty states, twenty pictures");
}

#[test]
fn a_camera_that_is_gone_leaves_no_trace() {
    let settings = small(16, 12, 32);
    let mut app = playground();
    let mut renderer = cpu();
    renderer.render(&extracted(&app), &settings).unwrap();
    let mut q = app.world_mut().query_filtered::<Entity, With<CameraProjection>>();
    let camera = q.single(app.world()).unwrap();
    app.world_mut().despawn(camera);
    let scene = extract_now(&mut app);
    let copy = extracted(&fresh_copy(&mut app));
    assert_eq!(scene.camera, copy.camera, "the world remembers a camera that it no longer has");
}

#[test]
fn sequences_build_no_mesh_trees() {
    let settings = small(24, 24, 16);
    for name in SCENE_NAMES {
        let mut app = app_at(name, 0);
        let mut renderer = cpu();
        for frame in 0..20 {
            let stats = renderer.render(&extracted(&app), &settings).unwrap().stats;
            if frame == 0 {
                assert!(stats.blas_builds > 0, "{name}: the first frame builds the trees");
            } else {
                assert_eq!(stats.blas_builds, 0, "{name}: frame {frame}");
                assert!(stats.tlas_nodes_touched > 0, "{name}: something moves in frame {frame}");
            }
            catoptra_engine::app::advance(&mut app, 1);
        }
    }
}

/// Nodes touched after `moved` of 4,096 cubes moved a little.
fn touched(app: &mut App, renderer: &mut Renderer, all: &[Entity], moved: usize, settings: &RenderSettings) -> u32 {
    // Spread over the field.
    for i in 0..moved {
        let entity = all[i * all.len() / moved.max(1)];
        app.world_mut().get_mut::<Transform>(entity).expect("a body").translation.y += 0.01;
    }
    let scene = extract_now(app);
    assert_eq!(scene.moved.len(), moved);
    let stats = renderer.render(&scene, settings).unwrap().stats;
    assert_eq!(stats.blas_builds, 0);
    stats.tlas_nodes_touched
}

#[test]
fn refits_grow_with_what_moved() {
    let settings = RenderSettings { vpl: None, ..small(8, 8, 16) };
    let mut app = new_app();
    let mut assets = Assets::default();
    let (mesh, material) =
        (assets.add_mesh(cuboid(Vec3::splat(0.3), [Vec3::ONE; 6])), assets.add_material(Material::default()));
    app.insert_resource(assets);
    let all: Vec<Entity> = (0..4096u64)
        .map(|i| {
            let t = Transform::from_xyz((i % 64) as f32, 0.0, (i / 64) as f32);
            app.world_mut().spawn((StableId(i), MeshInstance { mesh, material }, t)).id()
        })
        .collect();
    settle(&mut app);
    let mut renderer = cpu();
    let first = renderer.render(&extracted(&app), &settings).unwrap().stats;
    assert_eq!(first.blas_builds, 1, "one mesh, one tree, however many instances");

    let counts = [0, 1, 2, 8, 64, 512].map(|n| (n, touched(&mut app, &mut renderer, &all, n, &settings)));
    println!("TLAS nodes touched after (moved, touched): {counts:?}; {} at first", first.tlas_nodes_touched);
    assert_eq!(counts[0].1, 0, "nothing moved, nothing is touched");
    for (moved, touched) in &counts[1..] {
        // An 8-wide tree over 4,096 leaves is at least 4 deep; 12 leaves room for a lopsided one.
        assert!((1..=*moved as u32 * 12).contains(touched), "{moved} moved, {touched} touched");
    }
    assert!(counts.windows(2).all(|w| w[0].1 <= w[1].1), "{counts:?}");
    assert!(counts[1].1 * 20 < first.tlas_nodes_touched, "one body in 4,096 is far from the whole tree");
}

/// Copies of one scene that are moved apart: revisions count within one history, so a copy starts one of its own.
#[test]
fn forked_scenes_are_told_apart() {
    let mut first = HandScene::parallel(Vec3::Z * 5.0, Vec3::NEG_Z, 2.0).background(Vec3::ONE);
    first.add(cuboid(Vec3::splat(0.5), [Vec3::ONE; 6]), Material::lambert(Vec3::ZERO), Affine3::IDENTITY);
    let mut second = first.clone();
    for (scene, x) in [(&mut first, -1.0), (&mut second, 1.0)] {
        scene.0.begin_revision();
        scene.0.set_transform(0, at(Vec3::X * x));
    }
    let settings = HandScene::settings(16, 16);
    let mut renderer = cpu();
    let other = renderer.render(&first.0, &settings).unwrap().image.hash();
    let seen = renderer.render(&second.0, &settings).unwrap().image.hash();
    assert_eq!(seen, second.render(&settings).image.hash(), "the second scene is drawn as the first");
    assert_ne!(seen, other);
}
