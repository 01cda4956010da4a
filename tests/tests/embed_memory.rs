//! Memory over a long run: 10,000 spawns, moves and despawns over 1,000 frames with pictures. Alone in its process, so that
//! what the system says of the process is the renderer's.

use catoptra_engine::{
    Assets, CameraProjection, LightSource, Material, MeshInstance, Projection, StableId, bevy_app::App,
    bevy_ecs::prelude::*, bevy_transform::components::Transform, glam::Vec3, shapes,
};
use catoptra_render_hybrid::{RasterLane, RenderHybridPlugin, RenderTarget, RenderedFrames, RendererOptions};
use catoptra_tests::{Crowd, fixtures, gpu_or_skip, skip};

/// Resident memory, KiB.
fn resident() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    status.lines().find_map(|l| l.strip_prefix("VmRSS:"))?.split_whitespace().next()?.parse().ok()
}

fn world(raster: RasterLane) -> (App, Entity, Crowd) {
    let mut app = App::new();
    let options = RendererOptions { raster, ..Default::default() };
    app.add_plugins(RenderHybridPlugin { options, ..RenderHybridPlugin::with_settings(fixtures::small(48, 32, 64)) });
    let w = app.world_mut();
    let mut assets = w.resource_mut::<Assets>();
    let room = assets.add_mesh(shapes::open_room(Vec3::splat(3.0), [Vec3::ONE; 6]));
    let ball = assets.add_mesh(shapes::sphere(0.8, 12, 24));
    let [matte, mirror] = [Material::default(), Material::mirror(Vec3::ONE, 0.9)].map(|m| assets.add_material(m));
    w.spawn((StableId(1), MeshInstance { mesh: room, material: matte }));
    let light = LightSource { kind: Default::default(), intensity: Vec3::splat(12.0), radius: 0.1 };
    w.spawn((StableId(2), light, Transform::from_xyz(0.0, 2.5, 1.0)));
    let lens = CameraProjection { projection: Projection::Perspective { fov_y: 0.9 }, near: 0.05 };
    let camera = w.spawn((StableId(1), lens, Transform::from_xyz(0.0, 0.0, 7.0))).id();
    (app, camera, Crowd::new(MeshInstance { mesh: ball, material: mirror }))
}

/// Memory at the end of each hundred frames, KiB.
fn run(raster: RasterLane) -> Vec<u64> {
    let (mut app, camera, mut crowd) = world(raster);
    let mut out = Vec::new();
    for frame in 0..1000_u32 {
        (0..10).for_each(|_| crowd.edit(app.world_mut(), frame));
        // A picture each tenth frame: what a picture leaves behind shows after a hundred of them.
        let mut entity = app.world_mut().entity_mut(camera);
        if frame % 10 == 0 {
            entity.remove::<RenderTarget>()
        } else {
            entity.insert(RenderTarget::Off)
        };
        app.update();
        if frame % 10 == 0 {
            assert!(app.world().resource::<RenderedFrames>().first().is_some(), "frame {frame} has a picture");
        }
        if frame % 100 == 99 {
            out.extend(resident());
        }
    }
    out
}

#[test]
fn memory_stays_flat() {
    let test = "memory_stays_flat";
    if resident().is_none() {
        return skip(test, "the system does not tell a process its memory");
    }
    let lanes =
        if gpu_or_skip(test).is_some() { vec![RasterLane::Cpu, RasterLane::Gpu] } else { vec![RasterLane::Cpu] };
    for raster in lanes {
        let sizes = run(raster);
        println!("{raster:?}: KiB after each hundred frames: {sizes:?}");
        // The first two hundred frames fill the pools of allocator, ECS and driver. The least of three readings, as a software
        // driver that compiles holds 10 MiB more for a moment.
        let least = |of: &[u64]| of.iter().copied().min().unwrap_or(0);
        let grown = least(&sizes[7..]).saturating_sub(least(&sizes[2..5]));
        assert!(grown < 4 << 10, "{raster:?}: {grown} KiB more after 500 frames: {sizes:?}");
    }
}
