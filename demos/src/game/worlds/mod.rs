//! The worlds that the games are seen in: boards, halls, lamps, mirrors. Rules know nothing of them.

mod boards;
mod hall;
mod marks;
mod putting;

pub use boards::carry_rings;

use super::{
    cube::{Dir, Orient},
    level::{Body, Level},
    session::Session,
    systems::{Game, GamePlugin, Input, Looks, Phase},
};
use crate::scenes::stage::Stage;
use bevy_app::App;
use bevy_ecs::prelude::*;
use catoptra_engine::Material;
use glam::Vec3;
use std::{collections::VecDeque, sync::Arc};

/// How far drawn floors lie below the plane that bodies rest on, metres: a resting side would else share the floor's plane.
const CONTACT_GAP: f32 = 1.5e-3;
/// Half thickness of a tile, metres.
const TILE_HALF: f32 = 0.03;

/// Where the fields of a board lie in the world.
#[derive(Resource, Clone, Copy, Debug)]
pub struct Board {
    /// Middle of column 0, row 0 on the floor.
    pub origin: Vec3,
    /// Unit direction of rising columns.
    pub east: Vec3,
    /// Unit direction of rising rows, towards the viewer.
    pub south: Vec3,
    /// Side of a field, metres.
    pub cell: f32,
}

impl Board {
    /// Middle of a field on the floor.
    pub fn field(&self, at: [i8; 2]) -> Vec3 {
        self.origin + (self.east * f32::from(at[0]) + self.south * f32::from(at[1])) * self.cell
    }

    /// Height of a tile's middle.
    pub fn tile_height(&self) -> f32 {
        -TILE_HALF - CONTACT_GAP
    }

    /// World direction.
    pub fn towards(&self, dir: Dir) -> Vec3 {
        match dir {
            Dir::North => -self.south,
            Dir::East => self.east,
            Dir::South => self.south,
            Dir::West => -self.east,
        }
    }

    /// The direction as a tipping box counts them: +X, -Z, -X, +Z.
    pub fn heading(&self, dir: Dir) -> usize {
        let d = self.towards(dir);
        match (d.x, d.z) {
            (x, _) if x > 0.5 => 0,
            (_, z) if z < -0.5 => 1,
            (x, _) if x < -0.5 => 2,
            _ => 3,
        }
    }

    /// Which of a box's sides looks towards world +X.
    pub fn side_towards_x(&self, o: Orient) -> u8 {
        match Dir::ALL.into_iter().find(|d| self.towards(*d).x > 0.5) {
            Some(Dir::North) => o.north,
            Some(Dir::South) => o.north ^ 1,
            Some(Dir::West) => o.east ^ 1,
            _ => o.east,
        }
    }
}

/// The world of a level, extracted once.
pub fn build(level: &Arc<Level>) -> App {
    let (mut stage, board) = match &level.body {
        Body::Box(b) => boards::build(b),
        Body::Putt(p) => putting::build(p),
    };
    let session = Session::new(level.clone());
    stage.world().insert_resource(board);
    stage.world().insert_resource(Game { session, phase: Phase::Rest, waiting: VecDeque::new() });
    stage.world().init_resource::<Input>();
    stage.finish_with(GamePlugin)
}

/// Materials that looks change between.
fn looks(stage: &mut Stage) -> Looks {
    let six = |stage: &mut Stage, f: fn(Vec3) -> Material| hall::SIX.map(|c| stage.material(f(c)));
    let shining = |c: Vec3| Material { unlit: true, ..Material::lambert(c) };
    Looks {
        lit: hall::LAMPS.map(|c| stage.material(shining(c))),
        target: six(stage, Material::lambert),
        done: six(stage, |c| Material { emissive: c * 0.9, ..Material::lambert(c) }),
        out: stage.material(Material::lambert(Vec3::splat(0.06))),
        gate: [
            stage.material(shining(Vec3::new(0.10, 0.95, 0.25))),
            stage.material(shining(Vec3::new(0.75, 0.03, 0.02))),
        ],
    }
}
