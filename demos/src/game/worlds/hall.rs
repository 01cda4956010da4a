//! Parts that several worlds are made of.

use super::{Board, TILE_HALF, marks};
use crate::game::{
    boxes::{BoxLevel, Tile},
    follow::Lean,
    systems::{Look, Looks},
};
use crate::scenes::stage::{CAMERA_ID, Stage, looking, sway};
use bevy_ecs::prelude::*;
use bevy_transform::components::Transform;
use catoptra_engine::{
    CameraProjection, Material, MaterialId, Mesh, MeshId, MeshInstance, Projection, StableId, camera, shapes,
};
use glam::{Quat, Vec3};

/// Albedos of the six colours.
pub const SIX: [Vec3; 6] = crate::scenes::room::SIX_COLORS;
/// The six colours as lamps: purer, so that they are told apart in tinted mirrors.
pub const LAMPS: [Vec3; 6] = [
    Vec3::new(1.00, 0.03, 0.02),
    Vec3::new(0.03, 0.20, 1.00),
    Vec3::new(1.00, 0.85, 0.05),
    Vec3::new(0.55, 0.05, 0.90),
    Vec3::new(1.00, 0.32, 0.01),
    Vec3::new(0.02, 0.80, 0.15),
];

/// Spawns a closed hall from `min` to `max`, seen from inside.
pub fn closed(stage: &mut Stage, min: Vec3, max: Vec3, walls: shapes::FaceColors) {
    let mesh = stage.mesh(shapes::cuboid((max - min) * 0.5, walls));
    let matte = stage.material(Material::lambert(Vec3::ONE));
    stage.fixed(mesh, matte, Transform::from_translation((min + max) * 0.5));
}

/// Spawns a block with the given half sides.
pub fn block(stage: &mut Stage, center: Vec3, half: Vec3, material: MaterialId) -> Entity {
    let mesh = stage.mesh(shapes::cuboid(half, [Vec3::ONE; 6]));
    stage.fixed(mesh, material, Transform::from_translation(center))
}

/// Spawns an upright rectangle of 2 `half` metres whose front looks along `normal`.
pub fn pane(stage: &mut Stage, center: Vec3, normal: Vec3, half: [f32; 2], material: MaterialId) -> Entity {
    let mesh = stage.mesh(marks::pane(center, normal, half));
    stage.fixed(mesh, material, Transform::IDENTITY)
}

/// A pane in a dark frame; `clearance` is how far the frame stands out behind it.
pub fn framed(stage: &mut Stage, center: Vec3, normal: Vec3, half: [f32; 2], material: MaterialId) {
    let wood = stage.material(Material::lambert(Vec3::new(0.16, 0.09, 0.05)));
    let across = Vec3::Y.cross(normal).abs();
    let thick = across * (half[0] + 0.05) + Vec3::Y * (half[1] + 0.05) + normal.abs() * 0.02;
    block(stage, center - normal * 0.025, thick, wood);
    pane(stage, center, normal, half, material);
}

/// Spawns the viewer, who leans after the body that is played: shares of its way from the `middle` by axis for the eye and
/// for what is looked at.
pub fn viewer(stage: &mut Stage, eye: Vec3, target: Vec3, fov_y_degrees: f32, middle: Vec3, shares: [Vec3; 2]) {
    let lens =
        CameraProjection { projection: Projection::Perspective { fov_y: fov_y_degrees.to_radians() }, near: 0.02 };
    let pose = camera::world_from_view_looking_at(eye, target);
    let rotation = Quat::from_mat3(&pose.matrix3).normalize();
    let transform = Transform { translation: eye, rotation, scale: Vec3::ONE };
    let lean = Lean { eye, target, middle, eye_share: shares[0], target_share: shares[1], at: middle };
    stage.world().spawn((StableId(CAMERA_ID), lens, transform, lean));
}

/// Spawns a roaming spot light over `center` that stays `height` above the floor. `reach`: how far it roams along x and z.
pub fn roaming_spot(stage: &mut Stage, center: Vec3, height: f32, reach: [f32; 2], intensity: Vec3) {
    let above = center + Vec3::Y * height;
    let light = sway(above, Vec3::new(reach[0], 0.05, reach[1]), [9.0, 5.0, 11.0], [0.4, 0.0, 1.2]);
    let aim = sway(center, Vec3::new(reach[0] * 0.6, 0.0, reach[1] * 0.5), [9.0, 6.0, 11.0], [0.0, 0.0, 0.6]);
    stage.spot(looking(light, aim), intensity, 0.08, 38.0, 64.0);
}

/// Spawns the board's tiles and stones.
pub fn tiles(stage: &mut Stage, board: &Board, level: &BoxLevel, looks: &Looks) {
    let half = board.cell * 0.5;
    let slab = stage.mesh(shapes::cuboid(Vec3::new(half * 0.96, TILE_HALF, half * 0.96), [Vec3::ONE; 6]));
    let stone = stage.mesh(shapes::cuboid(Vec3::new(half * 0.9, half * 0.5, half * 0.9), [Vec3::ONE; 6]));
    let cracked = stage.mesh(cracked_slab(half * 0.96));
    let pads: [MeshId; 6] =
        std::array::from_fn(|hue| stage.mesh(marks::slab(Vec3::new(half * 0.96, TILE_HALF, half * 0.96), hue)));
    let floor = [0.60, 0.52].map(|a| stage.material(Material::lambert(Vec3::new(a, a * 0.97, a * 0.92))));
    let ice = stage.material(Material::lambert(Vec3::ONE));
    let white = stage.material(Material { emissive: Vec3::splat(0.5), ..Material::lambert(Vec3::splat(0.9)) });
    let rock = stage.material(Material::lambert(Vec3::new(0.30, 0.28, 0.27)));
    let gate = stage.material(Material::lambert(Vec3::new(0.80, 0.62, 0.20)));
    for (at, tile) in level.fields() {
        let plain = floor[(at[0] + at[1]) as usize % 2];
        let (mesh, material): (MeshId, MaterialId) = match tile {
            Tile::Void => continue,
            Tile::Block => {
                let place = board.field(at) + Vec3::Y * (half * 0.5 - 0.001);
                stage.fixed(stone, rock, Transform::from_translation(place));
                (slab, plain)
            }
            Tile::Floor => (slab, plain),
            Tile::Cracked => (cracked, ice),
            Tile::Coloured(hue) => (pads[hue as usize], looks.target[hue as usize]),
            Tile::Exit => (slab, white),
            Tile::Gate(_) => (slab, gate),
        };
        let place = board.field(at) + Vec3::Y * board.tile_height();
        let id = StableId(stage.take_ids(1));
        let transform = Transform::from_translation(place);
        stage.world().spawn((id, MeshInstance { mesh, material }, transform, Look::Tile(at)));
    }
}

/// A pale slab with dark cracks from its middle to its edge.
fn cracked_slab(half: f32) -> Mesh {
    let (pale, dark) = (Vec3::new(0.62, 0.78, 0.86), Vec3::new(0.10, 0.16, 0.20));
    let mut b = shapes::ShapeBuilder::default();
    // Ends of the cracks around the edge, in units of the half side.
    let edge: [[f32; 2]; 12] = [
        [-1.0, -1.0],
        [-0.3, -1.0],
        [-0.2, -1.0],
        [1.0, -1.0],
        [1.0, -0.4],
        [1.0, -0.3],
        [1.0, 1.0],
        [0.5, 1.0],
        [0.4, 1.0],
        [-1.0, 1.0],
        [-1.0, 0.3],
        [-1.0, 0.2],
    ];
    let point = |p: [f32; 2]| Vec3::new(p[0] * half, TILE_HALF, p[1] * half);
    let middle = point([0.1, -0.05]);
    for (i, p) in edge.iter().enumerate() {
        let q = edge[(i + 1) % edge.len()];
        let thin = (p[0] - q[0]).abs() + (p[1] - q[1]).abs() < 0.15;
        b.triangle([middle, point(q), point(*p)], if thin { dark } else { pale });
    }
    b.build()
}
