//! Bodies that turn at a constant rate.

use crate::axis_angle;
use bevy_ecs::prelude::*;
use bevy_transform::components::Transform;
use catoptra_engine::clock::FixedClock;
use glam::{Quat, Vec3};

/// Turns the entity about an axis. The pose is a function of the step's number alone, so it never drifts.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
#[require(Transform)]
pub struct Spinning {
    /// Axis in the parent's space, any length over 0.
    pub axis: Vec3,
    /// Radians per second; 0 rests.
    pub rate: f64,
    /// Angle at step 0, radians.
    pub phase: f64,
    /// Rotation before the turn.
    pub base: Quat,
}

impl Spinning {
    /// Rotation after `step` steps.
    pub fn rotation(&self, step: u64) -> Quat {
        let axis = self.axis.as_dvec3().normalize_or(glam::DVec3::Y);
        let angle = (self.phase + self.rate * (step as f64 / 60.0)) % std::f64::consts::TAU;
        (axis_angle(axis, angle) * self.base).normalize()
    }
}

pub(crate) fn pose_spinning(clock: Res<FixedClock>, mut bodies: Query<(&Spinning, &mut Transform)>) {
    for (spinning, mut transform) in &mut bodies {
        let rotation = spinning.rotation(clock.step);
        if transform.rotation != rotation {
            transform.rotation = rotation;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_a_second_comes_round_after_any_number_of_seconds() {
        let s = Spinning { axis: Vec3::Y * 3.0, rate: std::f64::consts::TAU, phase: 0.0, base: Quat::IDENTITY };
        for seconds in [0u64, 1, 1_000, 100_000] {
            let quarter = s.rotation(seconds * 60 + 15) * Vec3::X;
            assert!((quarter - Vec3::NEG_Z).length() < 1e-5, "{quarter}");
        }
    }
}
