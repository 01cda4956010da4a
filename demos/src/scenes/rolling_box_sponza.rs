//! Scene 5: a mirror box rolls through the court of an atrium.

use super::stage::{Stage, looking, sway};
use super::{BuildError, SceneOptions, atrium, files, room};
use bevy_app::App;
use catoptra_engine::{Material, shapes};
use catoptra_physics_lite::TippingBox;
use glam::Vec3;

/// Radiance of the sky.
const SKY: Vec3 = Vec3::new(0.34, 0.50, 0.78);

/// The open ground of an atrium and what surrounds it, world metres; the court's long side runs along x.
struct Court {
    center: Vec3,
    half: [f32; 2],
    height: f32,
}

pub fn build(options: &SceneOptions) -> Result<App, BuildError> {
    let mut stage = Stage::new(SKY);
    let court = match &options.atrium {
        Some(path) => {
            let bounds = files::spawn_atrium(&mut stage, path)?;
            let (c, h) = (bounds.center(), (bounds.max - bounds.min) * 0.5);
            // Galleries take about a third of the width on either side.
            Court {
                center: Vec3::new(c.x, bounds.min.y, c.z),
                half: [h.x * 0.62, h.z * 0.32],
                height: bounds.max.y - bounds.min.y,
            }
        }
        None => {
            let stone = stage.material(Material::lambert(Vec3::ONE));
            for mesh in atrium::atrium_meshes() {
                let mesh = stage.mesh(mesh);
                stage.fixed(mesh, stone, Default::default());
            }
            Court { center: Vec3::ZERO, half: [atrium::COURT[0] - 0.3, atrium::COURT[1] - 0.3], height: 9.0 }
        }
    };

    // One unit is a metre in the project's own atrium.
    let unit = court.half[1] / 3.6;
    let at = |x: f32, y: f32, z: f32| court.center + Vec3::new(x, y, z) * unit;
    let half = Vec3::splat(0.82 * unit);
    let mesh = stage.mesh(shapes::cuboid(half, [Vec3::ONE; 6]));
    let mirror = stage.material(Material::mirror(Vec3::new(0.80, 0.87, 0.93), 0.94));
    let (low, high) = (at(-4.2, 0.0, -3.3), at(1.7, 0.0, 3.3));
    let mut body = TippingBox::new(half, at(0.82, 0.0, 0.82), room::area([low.x, low.z], [high.x, high.z]), 1);
    body.kick = 1.12;
    stage.body(mesh, mirror, body);

    // The sun stands so high that the near eave's shadow leaves four fifths of the court in its light.
    let up = court.height * 1.9;
    let sun = sway(
        court.center + Vec3::new(1.5 * unit, up, court.half[1] * 1.18),
        Vec3::new(2.2, 0.5, 0.5) * unit,
        [16.0, 11.0, 19.0],
        [0.0, 0.0, 0.8],
    );
    let aim = sway(at(-1.0, 0.8, -0.6), Vec3::new(1.0, 0.0, 0.5) * unit, [14.0, 9.0, 17.0], [0.3, 0.0, 0.0]);
    let intensity = Vec3::new(4.3, 3.9, 3.3) * (up * up);
    stage.spot(looking(sun, aim), intensity, 0.14 * unit, 22.0, 32.0);

    let eye = sway(at(5.1, 1.9, 1.2), Vec3::new(0.4, 0.25, 0.9) * unit, [13.0, 9.0, 15.0], [0.0, 0.0, 0.6]);
    let target = sway(at(-1.2, 1.75, -0.3), Vec3::new(0.0, 0.1, 0.5) * unit, [9.0, 7.0, 15.0], [0.0, 0.5, 0.6]);
    stage.camera(looking(eye, target), 58.0);
    Ok(stage.finish())
}
