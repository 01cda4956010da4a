//! A component of the game's own drives what is drawn: change detection does the rest, nothing is registered.

use catoptra_engine::{
    Assets, CameraProjection, FixedUpdate, LightSource, Material, MaterialId, MeshInstance, Projection, StableId,
    bevy_app::App, bevy_ecs::prelude::*, bevy_transform::components::Transform, glam::Vec3, shapes,
};
use catoptra_render_hybrid::{RenderHybridPlugin, RenderSettings, RenderedFrames};

/// A lamp that is on or off.
#[derive(Component)]
struct Lamp {
    on: bool,
}

/// What lamps look like.
#[derive(Resource)]
struct Looks {
    on: MaterialId,
    off: MaterialId,
}

fn main() {
    let mut app = App::new();
    app.add_plugins(RenderHybridPlugin::with_settings(RenderSettings { width: 96, height: 64, ..Default::default() }));
    app.add_systems(FixedUpdate, show_lamps);
    let world = app.world_mut();
    let mut assets = world.resource_mut::<Assets>();
    let mesh = assets.add_mesh(shapes::sphere(1.0, 16, 32));
    let on = assets.add_material(Material { emissive: Vec3::splat(2.0), ..Material::default() });
    let off = assets.add_material(Material::lambert(Vec3::splat(0.2)));
    world.insert_resource(Looks { on, off });
    let lamp = world.spawn((StableId(1), MeshInstance { mesh, material: off }, Lamp { on: false })).id();
    let light = LightSource { kind: Default::default(), intensity: Vec3::splat(5.0), radius: 0.0 };
    world.spawn((StableId(2), light, Transform::from_xyz(0.0, 4.0, 4.0)));
    let lens = CameraProjection { projection: Projection::Perspective { fov_y: 0.9 }, near: 0.05 };
    world.spawn((StableId(3), lens, Transform::from_xyz(0.0, 0.0, 5.0)));
    for on in [false, true] {
        app.world_mut().get_mut::<Lamp>(lamp).expect("it was spawned").on = on;
        app.update();
        let picture = &app.world().resource::<RenderedFrames>().first().expect("a camera has a picture").image;
        println!("lamp on: {on}, radiance in the middle of the picture: {:?}", picture.at(48, 32));
    }
}

fn show_lamps(mut lamps: Query<(&Lamp, &mut MeshInstance), Changed<Lamp>>, looks: Res<Looks>) {
    for (lamp, mut instance) in &mut lamps {
        instance.material = if lamp.on { looks.on } else { looks.off };
    }
}
