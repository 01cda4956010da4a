//! The hall of the putting game: the hole lies behind the viewer, the mirror sphere shows it.

use super::{Board, hall, looks};
use crate::game::{
    putt::PuttLevel,
    systems::{Look, Player},
};
use crate::scenes::stage::{Stage, placed};
use bevy_transform::components::Transform;
use catoptra_engine::{Material, MeshInstance, StableId, shapes};
use glam::{DVec2, Quat, Vec3};

/// The world of a putting level.
pub fn build(level: &PuttLevel) -> (Stage, Board) {
    let mut stage = Stage::new(Vec3::ZERO);
    let looks = looks(&mut stage);
    let (min, max) = (level.area.min, level.area.max);
    let at = |p: DVec2, y: f32| Vec3::new(p.x as f32, y, p.y as f32);
    let walls = [
        Vec3::new(0.66, 0.20, 0.14),
        Vec3::new(0.16, 0.34, 0.58),
        Vec3::new(0.16, 0.34, 0.17),
        Vec3::new(0.80, 0.78, 0.74),
        Vec3::new(0.70, 0.68, 0.62),
        Vec3::new(0.78, 0.66, 0.30),
    ];
    let gap = super::CONTACT_GAP;
    hall::closed(&mut stage, Vec3::new(min[0], -gap, min[1]), Vec3::new(max[0], 2.8, max[1]), walls);

    let spheres = level.spheres(level.ball.1);
    let silver = stage.material(Material::mirror(Vec3::new(0.95, 0.95, 0.97), 0.95));
    let mesh = stage.mesh(shapes::sphere(level.mirror.0 as f32, 24, 48));
    stage.body(mesh, silver, spheres[1].clone());
    let mesh = stage.mesh(shapes::sphere(level.ball.0 as f32, 16, 24));
    let pearl = stage.material(Material::mirror(Vec3::new(0.98, 0.93, 0.85), 0.25));
    let ball = stage.body(mesh, pearl, spheres[0].clone());
    stage.world().entity_mut(ball).insert(Player);
    for (i, bumper) in spheres[2..].iter().enumerate() {
        let mesh = stage.mesh(shapes::sphere(bumper.radius as f32, 16, 24));
        let color = if i % 2 == 0 { Vec3::new(0.80, 0.25, 0.08) } else { Vec3::new(0.85, 0.60, 0.10) };
        let matte = stage.material(Material::lambert(color));
        stage.body(mesh, matte, bumper.clone());
    }

    // The hole: a dark disc with a shining rim, and a flag that is seen over the bumpers.
    let (radius, place) = (level.hole.0 as f32, level.hole.1);
    let dark = stage.material(Material::lambert(Vec3::splat(0.01)));
    let disc = stage.mesh(disc(radius));
    stage.fixed(disc, dark, Transform::from_translation(at(place, 0.003)));
    let glow = stage.material(Material { unlit: true, ..Material::lambert(Vec3::new(0.2, 1.0, 0.35)) });
    let rim = stage.mesh(shapes::torus(radius, 0.035, 32, 8));
    stage.fixed(rim, glow, placed(at(place, 0.0), Quat::IDENTITY, 1.0));
    let white = stage.material(Material::lambert(Vec3::splat(0.9)));
    hall::block(&mut stage, at(place, 0.75), Vec3::new(0.018, 0.75, 0.018), white);
    hall::block(&mut stage, at(place, 1.3) + Vec3::X * 0.24, Vec3::new(0.23, 0.16, 0.012), glow);

    // The putter: a bar of unit length along -Z.
    let bar = stage.mesh(shapes::cuboid(Vec3::new(0.03, 0.015, 0.5), [Vec3::ONE; 6]));
    let id = StableId(stage.take_ids(1));
    stage.world().spawn((id, MeshInstance { mesh: bar, material: glow }, Transform::IDENTITY, Look::Putter));

    let middle = (min[1] + max[1]) * 0.5;
    hall::roaming_spot(&mut stage, Vec3::new(0.0, 0.0, middle - 1.6), 2.6, [0.5, 0.5], Vec3::new(24.0, 22.0, 19.0));
    hall::roaming_spot(&mut stage, Vec3::new(0.0, 0.0, middle + 1.9), 2.6, [0.4, 0.4], Vec3::new(24.0, 22.0, 19.0));
    // He leans to the side alone, and not back: the hole stays behind him.
    let shares = [Vec3::new(0.14, 0.0, 0.0), Vec3::new(0.10, 0.0, 0.0)];
    hall::viewer(&mut stage, Vec3::new(0.0, 1.75, 2.95), Vec3::new(0.0, 0.42, -0.7), 52.0, Vec3::ZERO, shares);
    stage.world().insert_resource(looks);
    let origin = Vec3::new(min[0], 0.0, min[1]);
    (stage, Board { origin, east: Vec3::X, south: Vec3::Z, cell: 1.0 })
}

/// A flat disc that looks up.
fn disc(radius: f32) -> catoptra_engine::Mesh {
    let mut b = shapes::ShapeBuilder::default();
    let point = |i: u32| {
        let (s, c) = catoptra_engine::math::sin_cos(std::f32::consts::TAU * (i % 32) as f32 / 32.0);
        Vec3::new(c, 0.0, -s) * radius
    };
    for i in 0..32 {
        b.triangle([Vec3::ZERO, point(i), point(i + 1)], Vec3::ONE);
    }
    b.build()
}
