//! The module as a plugin: pictures follow the world, each camera has its own, and an edited world equals a fresh one.

use catoptra_engine::{
    Assets, CameraProjection, LightSource, Material, Mesh, MeshData, MeshInstance, Projection, RenderScene, StableId,
    app::settle,
    bevy_app::App,
    bevy_ecs::{hierarchy::ChildOf, prelude::*, system::RunSystemOnce},
    bevy_transform::components::Transform,
    components::Hidden,
    glam::Vec3,
    shapes,
};
use catoptra_render_hybrid::{
    CameraSettings, Frame, HybridRenderer, RasterLane, Raycaster, RenderError, RenderHybridPlugin, RenderSettings,
    RenderTarget, RenderedFrames, Renderer, RendererOptions, accel::Ray, raster::GpuRaster,
};
use catoptra_tests::{Crowd, fixtures};

const WIDTH: u32 = 96;
const HEIGHT: u32 = 64;

fn plugin() -> RenderHybridPlugin {
    let options = RendererOptions { raster: RasterLane::Cpu, ..Default::default() };
    RenderHybridPlugin { options, ..RenderHybridPlugin::with_settings(fixtures::small(WIDTH, HEIGHT, 64)) }
}

fn lens() -> CameraProjection {
    CameraProjection { projection: Projection::Perspective { fov_y: 0.9 }, near: 0.05 }
}

/// A mirror ball (id 10) and a red box (id 11) in a white room, camera 1.
fn world() -> (App, Entity, Entity, Entity) {
    let mut app = App::new();
    app.add_plugins(plugin());
    let w = app.world_mut();
    let mut assets = w.resource_mut::<Assets>();
    let room = assets.add_mesh(shapes::open_room(Vec3::splat(3.0), [Vec3::ONE; 6]));
    let ball = assets.add_mesh(shapes::sphere(0.8, 12, 24));
    let cube = assets.add_mesh(shapes::cuboid(Vec3::splat(0.5), [Vec3::X; 6]));
    let matte = assets.add_material(Material::default());
    let mirror = assets.add_material(Material::mirror(Vec3::ONE, 0.9));
    w.spawn((StableId(1), MeshInstance { mesh: room, material: matte }));
    let ball = w.spawn((StableId(10), MeshInstance { mesh: ball, material: mirror })).id();
    let place = Transform::from_xyz(1.5, -1.0, 0.5);
    let cube = w.spawn((StableId(11), MeshInstance { mesh: cube, material: matte }, place)).id();
    let light = LightSource { kind: Default::default(), intensity: Vec3::splat(12.0), radius: 0.1 };
    w.spawn((StableId(2), light, Transform::from_xyz(0.0, 2.5, 1.0)));
    let camera = w.spawn((StableId(1), lens(), Transform::from_xyz(0.0, 0.0, 7.0))).id();
    settle(&mut app);
    (app, ball, cube, camera)
}

fn first(app: &App) -> &Frame {
    app.world().resource::<RenderedFrames>().first().expect("the camera has a picture")
}

fn hash(app: &App) -> u64 {
    first(app).image.hash()
}

/// The picture that a renderer without history makes of the world as it stands.
fn fresh_hash(app: &App) -> u64 {
    fixtures::fresh(&fixtures::extracted(app), &fixtures::small(WIDTH, HEIGHT, 64)).image.hash()
}

#[test]
fn the_smallest_example_is_small() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../render_hybrid/examples/minimal_plugin.rs");
    let text = std::fs::read_to_string(path).unwrap();
    let code: Vec<&str> = text.lines().skip_while(|l| !l.starts_with("fn main")).collect();
    assert!(code.len() <= 30, "{} lines from fn main to a moving mirror", code.len());
    let plugin: Vec<&str> = code.iter().copied().filter(|l| l.contains("RenderHybridPlugin")).collect();
    assert!(plugin.len() == 1 && plugin[0].trim_end().ends_with(';'), "the plugin is one line: {plugin:?}");
}

#[test]
fn frame_0_is_right_and_stays() {
    let (mut app, ..) = world();
    let at_once = hash(&app);
    assert_eq!(at_once, fresh_hash(&app));
    assert!(first(&app).image.pixels.iter().any(|p| p[0] > 0.05), "there is light in it");
    for _ in 0..3 {
        app.update();
    }
    assert_eq!(hash(&app), at_once);
}

#[test]
fn every_edit_shows_at_once() {
    let (mut app, ball, cube, _) = world();
    let mut seen = vec![hash(&app)];
    let mut step = |app: &mut App, what: &str, builds: u32| {
        app.update();
        let now = hash(app);
        assert_eq!(now, fresh_hash(app), "{what}: the picture is that of a fresh renderer");
        assert_eq!(first(app).stats.blas_builds, builds, "{what}: trees built");
        seen.push(now);
        now
    };
    let start = fresh_hash(&app);
    app.world_mut().get_mut::<Transform>(ball).unwrap().translation.y = 0.6;
    assert_ne!(step(&mut app, "moved", 0), start);
    app.world_mut().entity_mut(ball).insert(ChildOf(cube));
    step(&mut app, "re-parented", 0);
    app.world_mut().get_mut::<Transform>(cube).unwrap().translation.x = -1.0;
    step(&mut app, "moved with its parent", 0);
    app.world_mut().entity_mut(cube).insert(Hidden);
    step(&mut app, "hidden with what hangs on it", 0);
    app.world_mut().entity_mut(cube).remove::<Hidden>();
    step(&mut app, "shown again", 2);
    let (mesh, material) = {
        let m = *app.world().get::<MeshInstance>(ball).unwrap();
        (m.mesh, app.world_mut().resource_mut::<Assets>().add_material(Material::glass(Vec3::ONE, 1.5)))
    };
    app.world_mut().entity_mut(ball).insert(MeshInstance { mesh, material });
    step(&mut app, "another material", 0);
    let mesh = app.world_mut().resource_mut::<Assets>().add_mesh(shapes::torus(0.6, 0.2, 16, 8));
    app.world_mut().get_mut::<MeshInstance>(ball).unwrap().mesh = mesh;
    step(&mut app, "another mesh", 1);
    app.world_mut().resource_mut::<Assets>().materials[material.0 as usize] = Material::lambert(Vec3::Y);
    step(&mut app, "a material edited in place", 0);
    app.world_mut().entity_mut(cube).despawn();
    step(&mut app, "despawned with what hangs on it", 0);
    seen.sort_unstable();
    seen.dedup();
    // Ten pictures; the one shown again and the one without cube and ball were there before.
    assert_eq!(seen.len(), 8, "every edit is seen in the picture");
}

#[test]
fn each_camera_has_its_own_picture() {
    let (mut app, _, _, main) = world();
    let alone = hash(&app);
    let small = RenderSettings { width: 40, height: 24, ..fixtures::small(WIDTH, HEIGHT, 64) };
    let above = Transform::from_xyz(0.0, 2.0, 6.0).looking_at(Vec3::ZERO, Vec3::Y);
    let second = app.world_mut().spawn((StableId(5), lens(), above, CameraSettings(small))).id();
    let off = app.world_mut().spawn((StableId(6), lens(), above, RenderTarget::Off)).id();
    app.update();
    let frames = app.world().resource::<RenderedFrames>();
    assert_eq!(frames.iter().map(|c| c.entity).collect::<Vec<_>>(), [main, second]);
    assert_eq!(
        frames.of(main).unwrap().image.hash(),
        alone,
        "a second camera does not show in the first one's picture"
    );
    let view = &frames.of(second).unwrap().image;
    assert_eq!((view.width, view.height), (40, 24));
    assert!(frames.of(off).is_none());
    let mut scene = fixtures::extracted(&app);
    scene.camera = app.world().resource::<catoptra_engine::ExtractedCameras>().0[1].camera;
    assert_eq!(view.hash(), fixtures::fresh(&scene, &small).image.hash());
    // Gone with its entity.
    app.world_mut().despawn(main);
    app.update();
    assert_eq!(app.world().resource::<RenderedFrames>().iter().len(), 1);
    // A view needs a device: an error in the entry, not a panic.
    app.world_mut().entity_mut(second).insert(CameraSettings(RenderSettings { width: 0, ..small }));
    app.update();
    assert!(matches!(app.world().resource::<RenderedFrames>().error(), Some(RenderError::Settings(_))));
}

#[test]
fn two_apps_live_side_by_side() {
    let (mut a, ball, ..) = world();
    let (mut b, ..) = world();
    let start = hash(&b);
    for i in 0..3 {
        a.world_mut().get_mut::<Transform>(ball).unwrap().translation.x = i as f32 * 0.3;
        a.update();
        b.update();
        assert_eq!(hash(&a), fresh_hash(&a));
        assert_eq!(hash(&b), start);
    }
}

#[test]
fn rays_name_entities() {
    let (mut app, ball, cube, _) = world();
    let look = move |mut rays: Raycaster| {
        let hit = rays.raycast(&Ray::new(Vec3::new(0.0, 0.0, 7.0), Vec3::NEG_Z)).expect("the ball is in the way");
        assert_eq!(hit.entity, ball);
        assert!((hit.surface.position - Vec3::new(0.0, 0.0, 0.8)).length() < 1e-4);
        let through = Ray::new(Vec3::new(1.5, -1.0, 7.0), Vec3::NEG_Z);
        let all = rays.raycast_all(&through, 10);
        assert_eq!(all.iter().map(|h| h.entity == cube).collect::<Vec<_>>(), [true, true, false]);
        assert!(rays.occluded(&through));
        assert!(rays.raycast(&Ray::new(Vec3::new(9.0, 9.0, 7.0), Vec3::NEG_Z)).is_none());
    };
    app.world_mut().run_system_once(look).unwrap();
    app.world_mut().entity_mut(ball).insert(Hidden);
    app.update();
    let gone = move |mut rays: Raycaster| {
        let hit = rays.raycast(&Ray::new(Vec3::new(0.0, 0.0, 7.0), Vec3::NEG_Z)).expect("the back wall");
        assert_ne!(hit.entity, ball);
    };
    app.world_mut().run_system_once(gone).unwrap();
}

#[test]
fn what_is_promised_to_be_sent_is_sent() {
    fn sent<T: Send>() {}
    fn shared<T: Send + Sync>() {}
    sent::<Renderer>();
    sent::<RenderScene>();
    sent::<Frame>();
    sent::<GpuRaster>();
    shared::<HybridRenderer>();
}

#[test]
fn a_world_of_a_thousand_frames_of_edits_equals_a_fresh_one() {
    let (mut app, ball, ..) = world();
    let mut crowd = Crowd::new(*app.world().get::<MeshInstance>(ball).unwrap());
    // No pictures but at the end: what is tested is what the edits leave behind.
    let camera = app.world().resource::<catoptra_engine::ExtractedCameras>().0[0].entity;
    app.world_mut().entity_mut(camera).insert(RenderTarget::Off);
    let renderer = |app: &mut App| {
        let scene = fixtures::extracted(app);
        let mut renderer = app.world_mut().resource_mut::<HybridRenderer>();
        let renderer = renderer.0.as_mut().expect("the CPU lane is always there");
        renderer.query(&scene).map(drop).expect("a valid scene");
        renderer.accel().validate().expect("sound trees");
        renderer.accel().stats()
    };
    let mut sizes = Vec::new();
    for frame in 0..1000_u32 {
        for _ in 0..10 {
            crowd.edit(app.world_mut(), frame);
        }
        app.update();
        if frame % 20 == 0 {
            sizes.push(renderer(&mut app));
        }
    }
    app.world_mut().entity_mut(camera).remove::<RenderTarget>();
    app.update();
    let mut copy = catoptra_tests::ecs::fresh_copy(&mut app);
    assert_eq!(hash(&app), fresh_hash(&copy), "the picture is that of a world freshly built");
    let _ = &mut copy;
    // Memory: trees of no more meshes and upper nodes than the crowd needs, early as late.
    let most = |s: &[catoptra_render_hybrid::accel::AccelStats]| s.iter().map(|s| s.tlas_nodes).max().unwrap();
    let (early, late) = sizes.split_at(sizes.len() / 2);
    assert!(most(late) <= 2 * most(early), "{} upper nodes became {}", most(early), most(late));
    assert!(sizes.iter().all(|s| s.trees <= 3));
}

#[test]
fn a_deformed_mesh_is_refitted_not_built() {
    let (mut app, ball, ..) = world();
    let slot = app.world().get::<MeshInstance>(ball).unwrap().mesh.0 as usize;
    for i in 1..4 {
        let mut assets = app.world_mut().resource_mut::<Assets>();
        let old = assets.meshes[slot].clone();
        let data = MeshData {
            positions: old.positions().iter().map(|p| *p * Vec3::new(1.0, 1.0 + 0.1 * i as f32, 0.9)).collect(),
            normals: old.normals().to_vec(),
            triangles: old.triangles().to_vec(),
            ..Default::default()
        };
        assets.meshes[slot] = std::sync::Arc::new(Mesh::new(data).unwrap());
        app.update();
        assert_eq!(first(&app).stats.blas_builds, 0);
        assert_eq!(hash(&app), fresh_hash(&app), "pose {i}: refitted trees give the hits of built ones");
    }
}
