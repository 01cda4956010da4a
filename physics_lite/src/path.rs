//! Closed smooth paths for cameras, lights and bodies: the pose is a function of the step's number alone.

use crate::quat_of;
use bevy_ecs::prelude::*;
use bevy_transform::components::Transform;
use catoptra_engine::{camera::world_from_view_looking_at, clock::FixedClock, math};
use glam::{DVec3, Vec3};
use std::f64::consts::TAU;

/// One term of [`Path::Sines`]: amplitude · sin(2π t / period + phase).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sine {
    /// Metres along each axis.
    pub amplitude: Vec3,
    /// Seconds for one swing, over 0.
    pub period_secs: f64,
    /// Radians.
    pub phase: f64,
}

/// A closed path through space.
#[derive(Clone, Debug, PartialEq)]
pub enum Path {
    /// One point.
    Fixed(Vec3),
    /// A centre plus swings: smooth in all derivatives.
    Sines {
        /// Mean point.
        center: Vec3,
        /// Swings that are added.
        terms: Vec<Sine>,
    },
    /// Through all points in turn and back to the first (uniform Catmull-Rom: continuous velocity).
    Loop {
        /// At least one point.
        points: Vec<Vec3>,
        /// Seconds for one round, over 0.
        period_secs: f64,
    },
}

impl Path {
    /// Point at `secs` seconds.
    pub fn point(&self, secs: f64) -> Vec3 {
        match self {
            Path::Fixed(p) => *p,
            Path::Sines { center, terms } => terms
                .iter()
                .fold(center.as_dvec3(), |p, t| {
                    let turns = secs / t.period_secs;
                    p + t.amplitude.as_dvec3() * math::sin_f64((turns - turns.floor()) * TAU + t.phase)
                })
                .as_vec3(),
            Path::Loop { points, period_secs } => catmull_rom(points, secs / period_secs).as_vec3(),
        }
    }
}

/// Closed uniform Catmull-Rom spline; `turns` 1.0 is once round.
fn catmull_rom(points: &[Vec3], turns: f64) -> DVec3 {
    let n = points.len();
    if n == 0 {
        return DVec3::ZERO;
    }
    let s = (turns - turns.floor()) * n as f64;
    let i = (s.floor() as usize).min(n - 1);
    let t = s - i as f64;
    let [a, b, c, d] = [i + n - 1, i, i + 1, i + 2].map(|k| points[k % n].as_dvec3());
    let slope0 = (c - a) * 0.5;
    let slope1 = (d - b) * 0.5;
    let (t2, t3) = (t * t, t * t * t);
    b * (2.0 * t3 - 3.0 * t2 + 1.0) + slope0 * (t3 - 2.0 * t2 + t) + c * (3.0 * t2 - 2.0 * t3) + slope1 * (t3 - t2)
}

/// Moves the entity along a path; with a target it also looks (-Z) at a second path's point.
#[derive(Component, Clone, Debug, PartialEq)]
#[require(Transform)]
pub struct PathFollower {
    /// Where it is.
    pub position: Path,
    /// What it looks at; `None` leaves the rotation alone.
    pub target: Option<Path>,
}

impl PathFollower {
    /// Pose after `step` steps; `now` gives what the path does not say (scale, and rotation where there is no target).
    pub fn pose(&self, step: u64, now: &Transform) -> Transform {
        let secs = step as f64 / 60.0;
        let translation = self.position.point(secs);
        let rotation = match &self.target {
            Some(target) => quat_of(&world_from_view_looking_at(translation, target.point(secs)).matrix3),
            None => now.rotation,
        };
        Transform { translation, rotation, scale: now.scale }
    }
}

pub(crate) fn pose_followers(clock: Res<FixedClock>, mut bodies: Query<(&PathFollower, &mut Transform)>) {
    for (follower, mut transform) in &mut bodies {
        let pose = follower.pose(clock.step, &transform);
        transform.set_if_neq(pose);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> Path {
        let points = vec![Vec3::X, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Z];
        Path::Loop { points, period_secs: 4.0 }
    }

    #[test]
    fn loops_pass_their_points_and_close() {
        let p = square();
        for (secs, at) in [(0.0, Vec3::X), (1.0, Vec3::Z), (2.0, Vec3::NEG_X), (3.0, Vec3::NEG_Z), (4_000.0, Vec3::X)] {
            assert!((p.point(secs) - at).length() < 1e-6);
        }
    }

    #[test]
    fn loops_are_smooth() {
        let p = square();
        let velocity = |t: f64| (p.point(t + 1e-3) - p.point(t - 1e-3)) / 2e-3;
        for k in 0..400 {
            let t = k as f64 * 0.01;
            assert!((velocity(t + 0.005) - velocity(t)).length() < 0.06, "jump at {t}");
        }
    }

    #[test]
    fn sines_follow_their_formula_and_looking_points_at_the_target() {
        let terms = vec![Sine { amplitude: Vec3::new(2.0, 0.0, 0.0), period_secs: 4.0, phase: 0.0 }];
        let follower = PathFollower {
            position: Path::Sines { center: Vec3::Y, terms },
            target: Some(Path::Fixed(Vec3::new(2.0, 1.0, -5.0))),
        };
        let pose = follower.pose(60, &Transform::IDENTITY);
        assert!((pose.translation - Vec3::new(2.0, 1.0, 0.0)).length() < 1e-6);
        assert!((pose.rotation * Vec3::NEG_Z - Vec3::NEG_Z).length() < 1e-6);
    }
}
