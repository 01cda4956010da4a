//! Picking: which thing lies under a point of the picture, what lies behind it, and who sees whom.

use catoptra_engine::{
    Assets, CameraProjection, Material, MeshInstance, Projection, StableId, app,
    bevy_app::App,
    bevy_ecs::{name::Name, prelude::*},
    bevy_transform::components::Transform,
    glam::Vec3,
    shapes,
};
use catoptra_render_hybrid::{RasterLane, Raycaster, RenderHybridPlugin, RendererOptions, accel::Ray};

fn main() {
    let mut app = App::new();
    let options = RendererOptions { raster: RasterLane::Cpu, ..Default::default() };
    app.add_plugins(RenderHybridPlugin { options, ..Default::default() });
    let world = app.world_mut();
    let mut assets = world.resource_mut::<Assets>();
    let mesh = assets.add_mesh(shapes::sphere(1.0, 24, 48));
    let material = assets.add_material(Material::default());
    for (id, name, z) in [(1, "near", 0.0), (2, "far", -5.0)] {
        let place = Transform::from_xyz(0.0, 0.0, z);
        world.spawn((StableId(id), Name::new(name), MeshInstance { mesh, material }, place));
    }
    let lens = CameraProjection { projection: Projection::Perspective { fov_y: 0.9 }, near: 0.05 };
    world.spawn((StableId(3), lens, Transform::from_xyz(0.0, 0.0, 5.0)));
    app::settle(&mut app);
    app.world_mut().run_system_cached(look).expect("the world is there");
}

fn look(mut rays: Raycaster, names: Query<&Name>) {
    let ray = Ray::new(Vec3::new(0.0, 0.0, 5.0), Vec3::NEG_Z);
    for hit in rays.raycast_all(&ray, 8) {
        let name = names.get(hit.entity).map_or("?", |n| n.as_str());
        println!("{name} at {} m: place {}, normal {}", hit.surface.t, hit.surface.position, hit.surface.normal);
    }
    let hidden = rays.query().is_ok_and(|q| !q.sees(Vec3::new(0.0, 0.0, 2.0), Vec3::new(0.0, 0.0, -3.0)));
    println!("the near ball stands between the two points: {hidden}");
}
