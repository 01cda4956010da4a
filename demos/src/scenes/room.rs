//! The room of the first four scenes: 10 triangles, open towards the camera, a red and a green wall.

use super::stage::Stage;
use catoptra_engine::{Material, Mesh, MeshData, shapes};
use catoptra_physics_lite::FloorRect;
use glam::Vec3;

/// Half extents of the room, metres; the floor is y = 0.
pub const HALF: Vec3 = Vec3::new(1.8, 1.4, 2.6);
/// Middle of the room.
pub const CENTER: Vec3 = Vec3::new(0.0, 1.4, 0.4);
/// How far the drawn floor lies below the one that bodies rest on, metres. A resting box would else share the floor's plane,
/// and through a glass bottom one would see now the one surface, now the other.
const CONTACT_GAP: f32 = 5e-4;
/// Radiance seen through the open side and in mirrors that face it: dusk.
pub const DUSK: Vec3 = Vec3::new(0.10, 0.13, 0.19);

/// Albedos -X, +X, floor, ceiling, back.
const WALLS: [Vec3; 6] = [
    Vec3::new(0.66, 0.10, 0.07),
    Vec3::new(0.13, 0.43, 0.14),
    Vec3::new(0.62, 0.53, 0.41),
    Vec3::new(0.78, 0.76, 0.71),
    Vec3::new(0.76, 0.73, 0.66),
    Vec3::ZERO,
];

/// The room's mesh in world space.
fn mesh() -> Mesh {
    let local = shapes::open_room(HALF, WALLS);
    let data = MeshData {
        positions: local.positions().iter().map(|&p| p + CENTER - Vec3::Y * CONTACT_GAP).collect(),
        normals: local.normals().to_vec(),
        colors: local.colors().to_vec(),
        triangles: local.triangles().to_vec(),
        ..Default::default()
    };
    Mesh::new(data).expect("a moved room is a mesh")
}

/// Spawns the room.
pub fn spawn(stage: &mut Stage) {
    let mesh = stage.mesh(mesh());
    let material = stage.material(Material::lambert(Vec3::ONE));
    stage.fixed(mesh, material, Default::default());
}

/// Rectangle of the floor from `min` to `max` (x, z).
pub fn area(min: [f32; 2], max: [f32; 2]) -> FloorRect {
    FloorRect { min, max }
}

/// Albedos of a box's six sides: red, blue, yellow, violet, orange, green.
pub const SIX_COLORS: shapes::FaceColors = [
    Vec3::new(0.75, 0.10, 0.08),
    Vec3::new(0.10, 0.26, 0.72),
    Vec3::new(0.80, 0.64, 0.08),
    Vec3::new(0.46, 0.16, 0.58),
    Vec3::new(0.85, 0.36, 0.06),
    Vec3::new(0.12, 0.55, 0.30),
];
