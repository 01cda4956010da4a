//! A game running in its world, one fixed step at a time.

use super::{
    Dir, Kind,
    action::Action,
    level::{Body, Level, level, level_count},
    putt::AIMS,
    session::{Session, State},
    systems::{Game, Input, Phase},
    worlds::{self, Board},
};
use bevy_app::App;
use catoptra_engine::{Extracted, RenderScene, app, math};
use glam::Vec3;
use std::sync::Arc;

/// A ray into the world, from a mouse pointer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pointer {
    /// Where it starts, world metres.
    pub origin: Vec3,
    /// Where it goes, any length over 0.
    pub direction: Vec3,
}

/// A game in its world. The state after K steps is a function of game, first level and the actions of each step.
pub struct Run {
    app: App,
    kind: Kind,
    number: usize,
    steps: u64,
}

impl Run {
    /// A game at the start of a level, from 0; `None` where there is no such level.
    pub fn new(kind: Kind, number: usize) -> Option<Self> {
        Some(Self { app: worlds::build(&level(kind, number)?), kind, number, steps: 0 })
    }

    /// Which game.
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// Number of the level, from 0.
    pub fn number(&self) -> usize {
        self.number
    }

    /// Fixed steps made so far, over all levels.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// The level.
    pub fn level(&self) -> &Arc<Level> {
        &self.session().level
    }

    /// The try: counters, hint, message.
    pub fn session(&self) -> &Session {
        &self.game().session
    }

    fn game(&self) -> &Game {
        self.app.world().resource::<Game>()
    }

    /// True when nothing moves and nothing waits: the session's state is what is seen.
    pub fn at_rest(&self) -> bool {
        self.game().phase == Phase::Rest && self.game().waiting.is_empty()
    }

    /// The world, for showing poses between steps.
    pub fn app_mut(&mut self) -> &mut App {
        &mut self.app
    }

    /// The scene after the last step.
    pub fn scene(&self) -> &RenderScene {
        &self.app.world().resource::<Extracted>().0
    }

    /// One fixed step with its actions. Going to a level that is not there does nothing.
    pub fn step(&mut self, actions: &[Action]) {
        for &action in actions {
            match action {
                Action::Level(n) if n < level_count(self.kind) => {
                    if let Some(level) = level(self.kind, n) {
                        self.app = worlds::build(&level);
                        self.number = n;
                    }
                }
                _ => self.app.world_mut().resource_mut::<Input>().0.push(action),
            }
        }
        app::advance(&mut self.app, 1);
        self.steps += 1;
    }

    /// The action that pointing at a place of the world stands for: tip the box that way, or aim the putter there.
    pub fn pointed(&self, pointer: &Pointer) -> Option<Action> {
        let t = -pointer.origin.y / pointer.direction.y;
        if !(t > 0.0 && t < 1e4) {
            return None;
        }
        let place = pointer.origin + pointer.direction * t;
        let session = self.session();
        match (&session.state, &session.level.body) {
            (State::Box(state), Body::Box(_)) => {
                let board = self.app.world().resource::<Board>();
                let d = place - board.field(state.at);
                let (dir, along) = Dir::ALL
                    .into_iter()
                    .map(|dir| (dir, board.towards(dir).dot(d)))
                    .max_by(|a, b| a.1.total_cmp(&b.1))?;
                (along > board.cell * 0.3).then_some(Action::Roll(dir))
            }
            (State::Putt(state), Body::Putt(_)) => {
                let d = place.as_dvec3() - glam::DVec3::new(state.place().x, 0.0, state.place().y);
                // Direction 0 is -Z, then clockwise seen from above.
                let turn = math::atan2(d.x as f32, -d.z as f32) / std::f32::consts::TAU;
                Some(Action::Aim((turn * f32::from(AIMS)).round().rem_euclid(f32::from(AIMS)) as u8 % AIMS))
            }
            _ => None,
        }
    }

    /// xxh3-64 over level, steps, counters, state and every pose in the world, bit by bit.
    pub fn state_hash(&self) -> u64 {
        use std::fmt::Write;
        let s = self.session();
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = write!(text, "{} {} {} {:016x};", self.kind.name(), self.number, self.steps, s.level.layout);
        let _ = write!(text, "{} {} {} {} {} {};", s.moves, s.undos, s.hints, s.slips, s.aim, s.power);
        let _ = match &s.state {
            State::Box(b) => {
                let o = b.orient;
                write!(text, "{:?} {} {} {} {} {};", b.at, o.top, o.north, o.east, b.progress, b.broken)
            }
            State::Putt(p) => write!(text, "{:x} {:x} {};", p.place().x.to_bits(), p.place().y.to_bits(), p.sunk),
        };
        let scene = self.scene();
        let mut pose = |id: u64, numbers: &[f32]| {
            let _ = write!(text, "{id}");
            for n in numbers {
                // -0 and 0 are one place.
                let _ = write!(text, " {:08x}", (n + 0.0).to_bits());
            }
            text.push(';');
        };
        for i in &scene.instances {
            pose(i.stable_id, &i.world_from_object.to_cols_array());
            pose(i.stable_id, &[i.material as f32]);
        }
        for l in &scene.lights {
            pose(l.stable_id, &l.position_world.to_array());
            pose(l.stable_id, &l.direction_world.to_array());
        }
        pose(0, &scene.camera.world_from_view.to_cols_array());
        xxhash_rust::xxh3::xxh3_64(text.as_bytes())
    }
}
