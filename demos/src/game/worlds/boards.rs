//! The four worlds with a board: hall of mirrors, glass box, statue, atrium.

use super::{Board, hall, looks, marks};
use crate::game::{
    Kind,
    boxes::BoxLevel,
    systems::{Look, Looks, Player, lay},
};
use crate::scenes::{
    atrium, room,
    stage::{Stage, looking, placed, sway},
    statue,
};
use bevy_ecs::prelude::*;
use bevy_transform::components::Transform;
use catoptra_engine::{Material, MeshInstance, StableId, shapes};
use catoptra_physics_lite::{FloorRect, TippingBox, TurnRule};
use glam::{Quat, Vec3};

/// Side of a field in the halls, metres.
const CELL: f32 = 0.5;
/// Side of a field in the atrium: half of its bay, so that every other row ends under an arch.
const ATRIUM_CELL: f32 = 1.3;
/// How far the viewer of a hall leans after the box, and how far he turns to it.
const LEAN: [Vec3; 2] = [Vec3::new(0.16, 0.0, 0.06), Vec3::new(0.22, 0.0, 0.10)];
/// Warm white of the lights.
const WARM: Vec3 = Vec3::new(1.0, 0.92, 0.80);

/// The world of a board.
pub fn build(level: &BoxLevel) -> (Stage, Board) {
    match level.kind {
        Kind::Donut => donut(level),
        Kind::Venus => venus(level),
        Kind::Sponza => sponza(level),
        _ => rolling_box(level),
    }
}

/// A board around the origin, seen along -Z.
fn centred(level: &BoxLevel) -> Board {
    let [columns, rows] = level.size.map(f32::from);
    let origin = Vec3::new((1.0 - columns) * 0.5 * CELL, 0.0, (1.0 - rows) * 0.5 * CELL);
    Board { origin, east: Vec3::X, south: Vec3::Z, cell: CELL }
}

/// The box that the player tips; `side`: half its side.
fn body(level: &BoxLevel, board: &Board, side: f32) -> TippingBox {
    let all = FloorRect { min: [-99.0; 2], max: [99.0; 2] };
    let mut body = TippingBox::new(Vec3::splat(side), Vec3::ZERO, all, 0);
    body.turn = TurnRule::Wait;
    body.kick = 1.2;
    lay(&mut body, board, &level.begin());
    body
}

/// The place from which a board of this size fills the picture, and what is looked at.
fn seat(level: &BoxLevel) -> (Vec3, Vec3) {
    let [columns, rows] = level.size.map(|n| f32::from(n) * CELL);
    let back = rows * 0.5 + 0.62 * columns.max(rows * 1.2);
    (Vec3::new(0.0, 0.55 + 0.52 * columns.max(rows), back), Vec3::new(0.0, 0.15, -0.10 * rows))
}

/// Mirrors on three walls show the sides of the box that face away.
fn rolling_box(level: &BoxLevel) -> (Stage, Board) {
    let (mut stage, board) = (Stage::new(room::DUSK), centred(level));
    let looks = looks(&mut stage);
    let [w, d] = level.size.map(|n| f32::from(n) * CELL * 0.5);
    let (eye, target) = seat(level);
    let (min, max) = (Vec3::new(-w - 0.75, -0.05, -d - 0.75), Vec3::new(w + 0.75, 2.9, eye.z + 0.6));
    let walls = [
        Vec3::new(0.62, 0.58, 0.52),
        Vec3::new(0.62, 0.58, 0.52),
        Vec3::new(0.22, 0.20, 0.19),
        Vec3::new(0.76, 0.74, 0.70),
        Vec3::new(0.60, 0.58, 0.55),
        Vec3::new(0.55, 0.52, 0.48),
    ];
    hall::closed(&mut stage, min, max, walls);
    hall::tiles(&mut stage, &board, level, &looks);
    let silver = stage.material(Material::mirror(Vec3::new(0.93, 0.95, 0.96), 0.95));
    hall::framed(&mut stage, Vec3::new(0.0, 0.72, min.z + 0.06), Vec3::Z, [w + 0.3, 0.62], silver);
    for side in [-1.0, 1.0] {
        let place = Vec3::new(side * (max.x - 0.06), 0.72, 0.0);
        hall::framed(&mut stage, place, Vec3::X * -side, [d + 0.2, 0.62], silver);
    }
    let half = CELL * 0.5;
    let mesh = stage.mesh(marks::six_box(half));
    let matte = stage.material(Material::lambert(Vec3::ONE));
    player(&mut stage, mesh, matte, body(level, &board, half));
    hall::roaming_spot(&mut stage, Vec3::new(0.0, 0.0, 0.1), 2.6, [0.8, 0.6], WARM * 26.0);
    fill(&mut stage, Vec3::new(0.0, 2.5, eye.z - 0.2), target, WARM * 9.0);
    hall::viewer(&mut stage, eye, target, 46.0, Vec3::ZERO, LEAN);
    (with(stage, looks), board)
}

/// One lamp wall behind the viewer, seen in the ring only.
fn donut(level: &BoxLevel) -> (Stage, Board) {
    let (mut stage, board) = (Stage::new(Vec3::ZERO), centred(level));
    let looks = looks(&mut stage);
    let [w, d] = level.size.map(|n| f32::from(n) * CELL * 0.5);
    let (eye, target) = seat(level);
    let (min, max) = (Vec3::new(-w - 1.2, -0.05, -d - 0.9), Vec3::new(w + 1.2, 3.3, eye.z + 2.0));
    let grey = Vec3::splat(0.36);
    let walls = [grey, grey, Vec3::splat(0.16), Vec3::splat(0.5), Vec3::new(0.34, 0.36, 0.40), Vec3::splat(0.12)];
    hall::closed(&mut stage, min, max, walls);
    hall::tiles(&mut stage, &board, level, &looks);
    // Behind the viewer, and beside him where the walls are out of sight.
    let lamps = [
        (Vec3::new(0.0, 1.6, max.z - 0.05), Vec3::NEG_Z, [w + 0.9, 1.5]),
        (Vec3::new(min.x + 0.05, 1.6, max.z - 1.0), Vec3::X, [0.9, 1.5]),
        (Vec3::new(max.x - 0.05, 1.6, max.z - 1.0), Vec3::NEG_X, [0.9, 1.5]),
    ];
    for (center, normal, half) in lamps {
        let by_hue = std::array::from_fn(|hue| stage.mesh(marks::pane_of(hue, center, normal, half)));
        let lamp = stage.fixed(by_hue[0], looks.out, Transform::IDENTITY);
        stage.world().entity_mut(lamp).insert(Look::Wanted(by_hue));
    }
    let half = CELL * 0.5;
    let mesh = stage.mesh(shapes::cuboid(Vec3::splat(half), [Vec3::ONE; 6]));
    let glass = stage.material(Material::glass(Vec3::splat(0.98), 1.33));
    let container = player(&mut stage, mesh, glass, body(level, &board, half));
    // Small enough to stay inside however the box turns.
    let (major, minor) = (half * 0.52, half * 0.24);
    let ring = stage.mesh(shapes::torus(major, minor, 32, 16));
    let gold = stage.material(Material::mirror(Vec3::new(0.97, 0.95, 0.92), 0.96));
    let id = StableId(stage.take_ids(1));
    let pose = ring_pose(&stage.world().get::<TippingBox>(container).expect("just spawned").pose(), half);
    stage.world().spawn((
        id,
        MeshInstance { mesh: ring, material: gold },
        pose,
        catoptra_physics_lite::PreviousPose(pose),
        Ring { container, drop: half * 0.2 },
    ));
    hall::roaming_spot(&mut stage, Vec3::new(0.0, 0.0, 0.1), 3.0, [0.7, 0.5], WARM * 26.0);
    fill(&mut stage, Vec3::new(0.0, 2.9, eye.z - 0.6), target, WARM * 8.0);
    hall::viewer(&mut stage, eye, target, 46.0, Vec3::ZERO, LEAN);
    (with(stage, looks), board)
}

/// A ring that hangs upright in a box like a compass in its gimbals, facing the viewer, whatever side the box lies on.
#[derive(Component)]
pub struct Ring {
    container: Entity,
    drop: f32,
}

/// The ring's pose inside a box: a little below its middle, its axis tilted back so that it shows what is behind the viewer.
fn ring_pose(container: &Transform, half: f32) -> Transform {
    // The axis (Y of the mesh) towards +Z, leaning up by about 15 degrees.
    let axis = Quat::from_rotation_arc(Vec3::Y, Vec3::new(0.0, 0.26, 0.9656).normalize());
    placed(container.translation - Vec3::Y * (half * 0.2), axis, 1.0)
}

/// Keeps rings in their boxes.
pub fn carry_rings(mut rings: Query<(&Ring, &mut Transform)>, boxes: Query<&TippingBox>) {
    for (ring, mut pose) in &mut rings {
        if let Ok(container) = boxes.get(ring.container) {
            let wanted = ring_pose(&container.pose(), ring.drop * 5.0);
            pose.set_if_neq(wanted);
        }
    }
}

/// A column of lamps behind the viewer, seen in the statue only.
fn venus(level: &BoxLevel) -> (Stage, Board) {
    let (mut stage, board) = (Stage::new(Vec3::ZERO), centred(level));
    let looks = looks(&mut stage);
    let [w, d] = level.size.map(|n| f32::from(n) * CELL * 0.5);
    let (eye, _) = seat(level);
    let eye = eye + Vec3::new(0.0, 0.12, 0.65);
    let target = Vec3::new(0.0, 0.50, -d);
    let (min, max) = (Vec3::new(-w - 1.2, -0.05, -d - 2.2), Vec3::new(w + 1.2, 3.7, eye.z + 3.0));
    let dark = Vec3::new(0.20, 0.20, 0.23);
    let walls = [dark, dark, Vec3::splat(0.15), dark, Vec3::new(0.30, 0.28, 0.32), Vec3::splat(0.03)];
    hall::closed(&mut stage, min, max, walls);
    hall::tiles(&mut stage, &board, level, &looks);
    let count = level.order.len() as f32;
    let pitch = 3.0 / count;
    for i in 0..level.order.len() {
        let y = 0.35 + pitch * (i as f32 + 0.5);
        let place = Vec3::new(0.0, y, max.z - 0.05);
        let hue = level.order[i] as usize;
        let mesh = stage.mesh(marks::pane_of(hue, place, Vec3::NEG_Z, [2.2, pitch * 0.42]));
        let lamp = stage.fixed(mesh, looks.out, Transform::IDENTITY);
        stage.world().entity_mut(lamp).insert(Look::Lamp(i));
    }
    // Her mirror leans against the plinth, tilted up to the lamps: a plane shows the code that the folds scatter.
    let silver = stage.material(Material::mirror(Vec3::new(0.95, 0.96, 0.98), 0.96));
    let wood = stage.material(Material::lambert(Vec3::new(0.45, 0.30, 0.08)));
    let glass = stage.mesh(shapes::cuboid(Vec3::new(0.86, 0.70, 0.01), [Vec3::ONE; 6]));
    let frame = stage.mesh(shapes::cuboid(Vec3::new(0.92, 0.76, 0.012), [Vec3::ONE; 6]));
    let lean = Quat::from_xyzw(-0.085_4, 0.0, 0.0, 0.996_347);
    let foot = Vec3::new(0.0, 0.78, -d - 0.42);
    stage.fixed(glass, silver, placed(foot, lean, 1.0));
    stage.fixed(frame, wood, placed(foot + lean * Vec3::new(0.0, 0.0, -0.015), lean, 1.0));
    let meshes = statue::statue_meshes(3.3);
    let bronze = stage.material(Material::mirror(Vec3::new(0.97, 0.95, 0.92), 0.94));
    let marble = stage.material(Material::mirror(Vec3::new(0.72, 0.68, 0.62), 0.12));
    let place = placed(Vec3::new(0.0, 0.0, -d - 1.15), Quat::IDENTITY, 1.0);
    let torso = stage.mesh(meshes.torso);
    stage.fixed(torso, bronze, place);
    let plinth = stage.mesh(meshes.plinth);
    stage.fixed(plinth, marble, place);
    let half = CELL * 0.5;
    let mesh = stage.mesh(marks::six_box(half));
    let matte = stage.material(Material::lambert(Vec3::ONE));
    player(&mut stage, mesh, matte, body(level, &board, half));
    hall::roaming_spot(&mut stage, Vec3::new(0.0, 0.0, 0.0), 3.3, [0.6, 0.4], WARM * 34.0);
    fill(&mut stage, Vec3::new(0.0, 3.2, eye.z - 0.6), target, WARM * 9.0);
    hall::viewer(&mut stage, eye, target, 50.0, Vec3::ZERO, LEAN);
    (with(stage, looks), board)
}

/// Gates in the three arches behind the viewer, seen in the box itself.
fn sponza(level: &BoxLevel) -> (Stage, Board) {
    let mut stage = Stage::new(Vec3::new(0.34, 0.50, 0.78));
    let looks = looks(&mut stage);
    for mesh in atrium::atrium_meshes() {
        let stone = stage.material(Material::lambert(Vec3::ONE));
        let mesh = stage.mesh(mesh);
        // The tiles of the board lie on the court's paving.
        stage.fixed(mesh, stone, Transform::from_translation(Vec3::NEG_Y * 0.07));
    }
    let [columns, rows] = level.size.map(f32::from);
    // The nearest row ends short of the viewer; the outer columns lie in front of the outer arches.
    let near = 3.9;
    let origin = Vec3::new(near - (rows - 1.0) * ATRIUM_CELL, 0.0, (columns - 1.0) * 0.5 * ATRIUM_CELL);
    let board = Board { origin, east: Vec3::NEG_Z, south: Vec3::X, cell: ATRIUM_CELL };
    hall::tiles(&mut stage, &board, level, &looks);
    for gate in 1..=3u8 {
        let z = (2.0 - f32::from(gate)) * 2.0 * ATRIUM_CELL;
        // The gate's glow, and its carpet, which a low side of the box shows first.
        let (center, half) = (Vec3::new(8.9, 1.3, z), [1.2, 1.3]);
        let open = stage.mesh(marks::pane(center, Vec3::NEG_X, half));
        let shut = stage.mesh(marks::crossed_pane(center, Vec3::NEG_X, half));
        let pane = stage.fixed(open, looks.out, Transform::IDENTITY);
        stage.world().entity_mut(pane).insert(Look::Gate(gate, Some([open, shut])));
        let carpet = hall::block(&mut stage, Vec3::new(8.0, 0.0, z), Vec3::new(0.9, 0.02, 1.1), looks.out);
        stage.world().entity_mut(carpet).insert(Look::Gate(gate, None));
    }
    let half = ATRIUM_CELL * 0.5;
    let mirror = stage.material(Material::mirror(Vec3::new(0.86, 0.91, 0.95), 0.95));
    let mesh = stage.mesh(shapes::cuboid(Vec3::splat(half), [Vec3::ONE; 6]));
    let container = player(&mut stage, mesh, mirror, body(level, &board, half));
    if let Some(side) = level.copper {
        let copper = stage.material(Material::lambert(Vec3::new(0.72, 0.30, 0.13)));
        let mut out = Vec3::ZERO;
        out[usize::from(side) / 2] = if side % 2 == 1 { 1.0 } else { -1.0 };
        // A plate that covers the side and stands out by a hair.
        let flat = Vec3::ONE - out.abs();
        let mesh = stage.mesh(shapes::cuboid(flat * (half * 0.97) + out.abs() * 0.004, [Vec3::ONE; 6]));
        let id = StableId(stage.take_ids(1));
        let place = Transform::from_translation(out * (half + 0.002));
        stage.world().spawn((id, MeshInstance { mesh, material: copper }, place, ChildOf(container)));
    }
    let sun = sway(Vec3::new(2.0, 17.0, 4.6), Vec3::new(1.6, 0.4, 0.4), [23.0, 17.0, 29.0], [0.0, 0.0, 0.8]);
    let aim = sway(Vec3::new(0.0, 0.0, -0.4), Vec3::new(0.6, 0.0, 0.3), [21.0, 17.0, 23.0], [0.3, 0.0, 0.0]);
    stage.spot(looking(sun, aim), WARM * (4.6 * 17.0 * 17.0), 0.14, 22.0, 32.0);
    let shares = [Vec3::new(0.0, 0.0, 0.12), Vec3::new(0.0, 0.0, 0.30)];
    hall::viewer(&mut stage, Vec3::new(6.9, 1.85, 0.0), Vec3::new(0.0, 0.62, 0.0), 50.0, Vec3::ZERO, shares);
    (with(stage, looks), board)
}

/// A weak wide light from the viewer's side, so that no side of the box is black.
fn fill(stage: &mut Stage, from: Vec3, to: Vec3, intensity: Vec3) {
    let still = |at| sway(at, Vec3::ZERO, [1.0; 3], [0.0; 3]);
    stage.spot(looking(still(from), still(to)), intensity, 0.15, 40.0, 70.0);
}

fn player(
    stage: &mut Stage,
    mesh: catoptra_engine::MeshId,
    material: catoptra_engine::MaterialId,
    body: TippingBox,
) -> Entity {
    let entity = stage.body(mesh, material, body);
    stage.world().entity_mut(entity).insert(Player);
    entity
}

fn with(mut stage: Stage, looks: Looks) -> Stage {
    stage.world().insert_resource(looks);
    stage
}
