//! A moving mirror in a game's own world: the plugin is one line, the pictures go to `mirror-*.png` in the system's
//! temporary folder.

use catoptra_engine::{
    Assets, CameraProjection, FixedClock, FixedUpdate, LightSource, Material, MeshInstance, Projection, StableId,
    bevy_app::{App, Startup},
    bevy_ecs::prelude::*,
    bevy_transform::components::Transform,
    glam::Vec3,
    math, shapes,
};
use catoptra_render_hybrid::{RenderHybridPlugin, RenderedFrames, image_io};

#[derive(Component)]
struct Mirror;

fn main() {
    let mut app = App::new();
    app.add_plugins(RenderHybridPlugin::of_size(320, 240));
    app.add_systems(Startup, spawn).add_systems(FixedUpdate, swing);
    for frame in 0..3 {
        app.update();
        let picture = &app.world().resource::<RenderedFrames>().first().expect("a camera has a picture").image;
        let path = std::env::temp_dir().join(format!("mirror-{frame}.png"));
        image_io::write_png(&path, 320, 240, &image_io::srgb8_from_image(picture, 0.0)).expect("a folder to write to");
    }
}

fn spawn(mut commands: Commands, mut assets: ResMut<Assets>) {
    let [matte, mirror] = [Material::default(), Material::mirror(Vec3::ONE, 0.9)].map(|m| assets.add_material(m));
    let room = assets
        .add_mesh(shapes::open_room(Vec3::splat(2.0), [Vec3::X, Vec3::Y, Vec3::ONE, Vec3::Z, Vec3::ONE, Vec3::ONE]));
    let ball = assets.add_mesh(shapes::sphere(0.7, 24, 48));
    commands.spawn((StableId(1), MeshInstance { mesh: room, material: matte }));
    commands.spawn((StableId(2), MeshInstance { mesh: ball, material: mirror }, Mirror));
    let light = LightSource { kind: Default::default(), intensity: Vec3::splat(8.0), radius: 0.1 };
    commands.spawn((StableId(3), light, Transform::from_xyz(0.0, 1.8, 0.0)));
    let lens = CameraProjection { projection: Projection::Perspective { fov_y: 0.9 }, near: 0.05 };
    commands.spawn((StableId(4), lens, Transform::from_xyz(0.0, 0.0, 6.0)));
}

fn swing(clock: Res<FixedClock>, mut mirror: Single<&mut Transform, With<Mirror>>) {
    mirror.translation.x = math::sin(clock.seconds());
}
