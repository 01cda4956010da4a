//! Scene 3: a moving and a static sphere with different reflection factors.

use super::room;
use super::stage::{Stage, looking, sway};
use bevy_app::App;
use catoptra_engine::{Material, shapes};
use catoptra_physics_lite::RollingSphere;
use glam::{DVec2, Vec3};

/// Radius of the static sphere and of the moving one, metres.
const STATIC_RADIUS: f32 = 0.72;
const MOVING_RADIUS: f32 = 0.5;

pub fn build() -> App {
    let mut stage = Stage::new(room::DUSK);
    room::spawn(&mut stage);

    let area = room::area([-1.8, -2.2], [1.8, 1.35]);
    // 12 rings, 24 segments: 528 triangles.
    let static_mesh = stage.mesh(shapes::sphere(STATIC_RADIUS, 12, 24));
    let strong = stage.material(Material::mirror(Vec3::new(0.95, 0.95, 0.96), 0.9));
    let at = DVec2::new(-0.62, -0.75);
    let still =
        RollingSphere { mass: f64::INFINITY, ..RollingSphere::new(f64::from(STATIC_RADIUS), at, DVec2::ZERO, area) };
    stage.body(static_mesh, strong, still);

    let moving_mesh = stage.mesh(shapes::sphere(MOVING_RADIUS, 12, 24));
    let weak = stage.material(Material::mirror(Vec3::new(0.92, 0.55, 0.18), 0.4));
    let ball = RollingSphere::new(f64::from(MOVING_RADIUS), DVec2::new(0.85, 0.55), DVec2::new(-0.72, -0.35), area);
    stage.body(moving_mesh, weak, ball);

    let light = sway(Vec3::new(0.2, 2.5, 0.7), Vec3::new(0.9, 0.08, 0.5), [8.0, 5.0, 9.0], [0.9, 0.0, 1.0]);
    let aim = sway(Vec3::new(-0.1, 0.3, -0.7), Vec3::new(0.6, 0.2, 0.4), [8.0, 6.0, 9.0], [0.5, 0.0, 0.5]);
    stage.spot(looking(light, aim), Vec3::new(22.5, 20.0, 16.4), 0.08, 32.0, 56.0);

    let eye = sway(Vec3::new(0.05, 1.3, 2.8), Vec3::new(0.4, 0.14, 0.12), [12.0, 8.0, 13.0], [-0.4, 0.0, 0.0]);
    let target = sway(Vec3::new(0.0, 0.9, -0.8), Vec3::new(0.15, 0.05, 0.0), [12.0, 7.0, 5.0], [-0.4, 0.7, 0.0]);
    stage.camera(looking(eye, target), 56.0);
    stage.finish()
}
