//! Scene 2: a mirror donut rolls inside a glass box that itself rolls to and fro.

use super::room;
use super::stage::{Stage, looking, sway};
use bevy_app::App;
use catoptra_engine::{Material, shapes};
use catoptra_physics_lite::{RollingRing, TippingBox, TurnRule};
use glam::Vec3;

/// Half side of the glass box, metres.
const HALF: f32 = 0.57;
/// Radii of the donut, metres.
const MAJOR: f32 = 0.29;
const MINOR: f32 = 0.12;

pub fn build() -> App {
    let mut stage = Stage::new(room::DUSK);
    room::spawn(&mut stage);

    let glass_mesh = stage.mesh(shapes::cuboid(Vec3::splat(HALF), [Vec3::ONE; 6]));
    // Glass filled with something like water: the donut stays in sight through two faces at once.
    let glass = stage.material(Material {
        attenuation_color: Vec3::new(0.80, 0.93, 0.95),
        attenuation_distance: 1.6,
        ..Material::glass(Vec3::splat(0.98), 1.33)
    });
    let area = room::area([-1.72, -1.2], [1.72, 1.2]);
    let mut body = TippingBox::new(Vec3::splat(HALF), Vec3::new(-1.14, 0.0, 0.25), area, 0);
    body.turn = TurnRule::Back;
    body.kick = 1.12;
    let container = stage.body(glass_mesh, glass, body);

    let donut_mesh = stage.mesh(shapes::torus(MAJOR, MINOR, 24, 12));
    let mirror = stage.material(Material::mirror(Vec3::new(0.96, 0.84, 0.60), 0.92));
    stage.body(donut_mesh, mirror, RollingRing::new(container, f64::from(MAJOR), f64::from(MINOR)));

    let light = sway(Vec3::new(0.0, 2.5, 0.8), Vec3::new(0.9, 0.08, 0.5), [8.0, 5.0, 9.0], [0.2, 0.0, 1.0]);
    let aim = sway(Vec3::new(0.0, 0.3, -0.6), Vec3::new(0.7, 0.2, 0.4), [8.0, 6.0, 9.0], [0.0, 0.0, 0.5]);
    stage.spot(looking(light, aim), Vec3::new(23.5, 21.0, 17.2), 0.08, 32.0, 56.0);

    let eye = sway(Vec3::new(0.05, 1.25, 2.75), Vec3::new(0.45, 0.14, 0.12), [12.0, 8.0, 13.0], [-0.6, 0.0, 0.0]);
    let target = sway(Vec3::new(0.0, 0.8, -0.6), Vec3::new(0.25, 0.05, 0.0), [12.0, 7.0, 5.0], [-0.6, 0.7, 0.0]);
    stage.camera(looking(eye, target), 56.0);
    stage.finish()
}
