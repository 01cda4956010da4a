//! Scene 4: a box rolls around a mirror statue.

use super::stage::{Stage, looking, placed, sway};
use super::{BuildError, SceneOptions, files, room, statue};
use bevy_app::App;
use catoptra_engine::{Material, shapes};
use catoptra_physics_lite::TippingBox;
use glam::{Quat, Vec3};

/// Where the statue stands, its height with the plinth and the half side of its ground, metres.
const PLACE: Vec3 = Vec3::new(0.1, 0.0, -0.35);
const HEIGHT: f32 = 2.4;
const GROUND: f32 = 0.45;

pub fn build(options: &SceneOptions) -> Result<App, BuildError> {
    let mut stage = Stage::new(room::DUSK);
    room::spawn(&mut stage);

    let bronze = Material::mirror(Vec3::new(0.97, 0.90, 0.78), 0.88);
    match &options.statue {
        Some(path) => files::spawn_statue(&mut stage, path, PLACE, HEIGHT, 1.4, bronze)?,
        None => {
            let meshes = statue::statue_meshes(HEIGHT);
            let mirror = stage.material(bronze);
            let marble = stage.material(Material::mirror(Vec3::new(0.72, 0.68, 0.62), 0.12));
            let turned = Quat::from_xyzw(0.0, 0.130_526, 0.0, 0.991_445);
            let torso = stage.mesh(meshes.torso);
            stage.fixed(torso, mirror, placed(PLACE, turned, 1.0));
            let plinth = stage.mesh(meshes.plinth);
            stage.fixed(plinth, marble, placed(PLACE, turned, 1.0));
        }
    }

    let half = Vec3::splat(0.25);
    let mesh = stage.mesh(shapes::cuboid(half, room::SIX_COLORS));
    let matte = stage.material(Material::lambert(Vec3::ONE));
    let mut body = TippingBox::new(half, Vec3::new(-0.95, 0.0, -0.7), room::area([-1.7, -1.8], [1.4, 0.9]), 3);
    body.obstacles.push(room::area([PLACE.x - GROUND, PLACE.z - GROUND], [PLACE.x + GROUND, PLACE.z + GROUND]));
    body.kick = 1.15;
    stage.body(mesh, matte, body);

    let light = sway(Vec3::new(-0.4, 2.55, 1.2), Vec3::new(0.9, 0.06, 0.4), [8.0, 5.0, 9.0], [0.3, 0.0, 1.0]);
    let aim = sway(Vec3::new(0.0, 0.6, -0.7), Vec3::new(0.6, 0.2, 0.3), [8.0, 6.0, 9.0], [0.0, 0.0, 0.5]);
    stage.spot(looking(light, aim), Vec3::new(23.5, 21.0, 17.2), 0.08, 34.0, 58.0);

    let eye = sway(Vec3::new(0.05, 1.35, 2.55), Vec3::new(0.5, 0.12, 0.12), [12.0, 8.0, 13.0], [-0.5, 0.0, 0.0]);
    let target = sway(Vec3::new(0.0, 1.15, -0.4), Vec3::new(0.08, 0.05, 0.0), [12.0, 7.0, 5.0], [-0.5, 0.7, 0.0]);
    stage.camera(looking(eye, target), 54.0);
    Ok(stage.finish())
}
