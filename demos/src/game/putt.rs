//! The rules of putting: a ball, a great fixed sphere, bumpers and a hole.
//!
//! Shots are quantised (64 directions, 5 strengths), so that a search over all of them is a proof. The ball moves by
//! `physics_lite`'s own step, the same here and in the world that is drawn.

use super::session::Outcome;
use catoptra_engine::math;
use catoptra_physics_lite::{FloorRect, RollingSphere, step_spheres_together};
use glam::DVec2;

/// Number of directions of a shot; direction 0 goes away from the viewer, then clockwise seen from above.
pub const AIMS: u8 = 64;
/// Number of strengths, from 1.
pub const POWERS: u8 = 5;
/// Deceleration of the rolling ball, m/s².
const RESISTANCE: f64 = 0.6;
/// Share of the approach speed that a bounce keeps.
const RESTITUTION: f64 = 0.8;
/// Above this speed the ball rolls over the hole, m/s.
const CATCH_SPEED: f64 = 2.1;
/// Steps after which a shot counts as ended, whatever still rolls.
const MAX_STEPS: u32 = 1200;

/// A hall to putt in. Lengths in metres, places (x, z).
#[derive(Clone, Debug, PartialEq)]
pub struct PuttLevel {
    /// Floor of the hall.
    pub area: FloorRect,
    /// Radius and place of the ball.
    pub ball: (f64, DVec2),
    /// Radius and place of the great mirror sphere.
    pub mirror: (f64, DVec2),
    /// Radii and places of the bumpers.
    pub bumpers: Vec<(f64, DVec2)>,
    /// Radius and place of the hole.
    pub hole: (f64, DVec2),
}

/// Where the game stands between shots: the ball's place, as bits so that states can be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PuttState {
    place: [u64; 2],
    /// The ball lies in the hole.
    pub sunk: bool,
}

/// One stroke.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Shot {
    /// Direction, below [`AIMS`].
    pub aim: u8,
    /// Strength, 1 to [`POWERS`].
    pub power: u8,
}

/// Unit direction (x, z) of an aim: 0 is -Z, then clockwise seen from above.
pub fn aim_direction(aim: u8) -> DVec2 {
    let angle = std::f64::consts::TAU * f64::from(aim % AIMS) / f64::from(AIMS);
    DVec2::new(math::sin_f64(angle), -math::cos_f64(angle))
}

/// Speed of the ball after a stroke, m/s.
pub fn shot_speed(power: u8) -> f64 {
    0.6 + 0.65 * f64::from(power)
}

impl PuttState {
    /// A ball at rest on the floor.
    pub fn at(place: DVec2) -> Self {
        Self { place: [place.x.to_bits(), place.y.to_bits()], sunk: false }
    }

    /// Where the ball lies (x, z).
    pub fn place(&self) -> DVec2 {
        DVec2::new(f64::from_bits(self.place[0]), f64::from_bits(self.place[1]))
    }
}

impl PuttLevel {
    /// The state before the first shot.
    pub fn begin(&self) -> PuttState {
        PuttState::at(self.ball.1)
    }

    /// All spheres with the ball at `place`: the ball first, then the fixed ones.
    pub fn spheres(&self, place: DVec2) -> Vec<RollingSphere> {
        let ball = RollingSphere {
            resistance: RESISTANCE,
            restitution: RESTITUTION,
            ..RollingSphere::new(self.ball.0, place, DVec2::ZERO, self.area)
        };
        let fixed = |(radius, place): (f64, DVec2)| RollingSphere {
            mass: f64::INFINITY,
            restitution: RESTITUTION,
            ..RollingSphere::new(radius, place, DVec2::ZERO, self.area)
        };
        [ball].into_iter().chain([fixed(self.mirror)]).chain(self.bumpers.iter().copied().map(fixed)).collect()
    }

    /// True where the ball, as it moves now, falls into the hole.
    pub fn catches(&self, ball: &RollingSphere) -> bool {
        (ball.place - self.hole.1).length() < self.hole.0 && ball.velocity.length() < CATCH_SPEED
    }

    /// True when the ball is in the hole.
    pub fn won(&self, state: &PuttState) -> bool {
        state.sunk
    }

    /// All shots.
    pub fn shots() -> impl Iterator<Item = Shot> {
        (1..=POWERS).flat_map(|power| (0..AIMS).map(move |aim| Shot { aim, power }))
    }

    /// The state after a shot has come to rest.
    pub fn play(&self, state: &PuttState, shot: Shot) -> (PuttState, Outcome) {
        let mut spheres = self.spheres(state.place());
        spheres[0].velocity = aim_direction(shot.aim) * shot_speed(shot.power);
        for _ in 0..MAX_STEPS {
            step_spheres_together(&mut spheres);
            if let Some(end) = self.end_of(&spheres[0]) {
                return (end, Outcome::Moved);
            }
        }
        (PuttState::at(spheres[0].place), Outcome::Moved)
    }

    /// The state that a ball has come to; `None` while it rolls on.
    pub fn end_of(&self, ball: &RollingSphere) -> Option<PuttState> {
        if self.catches(ball) {
            return Some(PuttState { sunk: true, ..PuttState::at(self.hole.1) });
        }
        (ball.velocity == DVec2::ZERO).then(|| PuttState::at(ball.place))
    }
}
