//! Scene 1: a box with six colours rolls round the room under a moving spot light. All matte: indirect light alone
//! lights the ceiling and everything outside the cone.

use super::room;
use super::stage::{Stage, looking, sway};
use bevy_app::App;
use catoptra_engine::{Material, shapes};
use catoptra_physics_lite::TippingBox;
use glam::Vec3;

pub fn build() -> App {
    let mut stage = Stage::new(room::DUSK);
    room::spawn(&mut stage);

    let half = Vec3::splat(0.36);
    let mesh = stage.mesh(shapes::cuboid(half, room::SIX_COLORS));
    let matte = stage.material(Material::lambert(Vec3::ONE));
    let area = room::area([-1.6, -2.0], [1.6, 0.9]);
    let mut body = TippingBox::new(half, Vec3::new(-0.36, 0.0, 0.36), area, 0);
    body.kick = 1.15;
    stage.body(mesh, matte, body);

    let light = sway(Vec3::new(-0.2, 2.5, 0.5), Vec3::new(0.9, 0.08, 0.5), [7.0, 5.0, 9.0], [0.4, 0.0, 1.2]);
    let aim = sway(Vec3::new(-0.3, 0.3, -0.7), Vec3::new(0.7, 0.2, 0.5), [7.0, 6.0, 9.0], [0.0, 0.0, 0.6]);
    stage.spot(looking(light, aim), Vec3::new(23.0, 20.5, 16.8), 0.08, 30.0, 54.0);

    let eye = sway(Vec3::new(0.0, 1.4, 2.8), Vec3::new(0.35, 0.12, 0.12), [11.0, 8.0, 13.0], [0.5, 0.0, 0.0]);
    let target = sway(Vec3::new(0.0, 1.0, -1.0), Vec3::new(0.12, 0.05, 0.0), [9.0, 7.0, 5.0], [0.0, 0.7, 0.0]);
    stage.camera(looking(eye, target), 58.0);
    stage.finish()
}
