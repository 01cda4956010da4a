//! Rigid motion for Catoptra: a tipping box, rolling spheres, a ring rolling inside a box, spinning bodies and bodies on
//! closed paths.
//!
//! **Contract:** one call of the engine's `FixedUpdate` is one step of [`catoptra_engine::FIXED_DT_SECS`]. The state after
//! K steps is the same bits on every machine and for every way of getting there: state is f64, transcendental functions
//! are the engine's own, bodies are visited in the order of their `StableId`. A body at rest does not get its `Transform`
//! written, so that change detection sees it rest.

mod interpolation;
mod path;
mod ring;
mod rolling_sphere;
mod spinning;
mod tipping_box;

pub use interpolation::{PreviousPose, interpolated};
pub use path::{Path, PathFollower, Sine};
pub use ring::RollingRing;
pub use rolling_sphere::{RollingSphere, step_spheres_together};
pub use spinning::Spinning;
pub use tipping_box::{FloorRect, TippingBox, TurnRule};

use bevy_app::{App, Plugin, Startup};
use bevy_ecs::prelude::*;
use catoptra_engine::{FixedUpdate, clock::FixedClock};
use glam::{Mat3, Quat};

/// Acceleration of free fall, m/s².
pub const GRAVITY: f64 = 9.81;

/// All motion of this crate within [`FixedUpdate`]: what steers bodies goes before it, what reads where they came to, after.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Motion;

/// Adds all motion of this crate to [`FixedUpdate`], and poses all bodies for step 0 at start-up.
#[derive(Default)]
pub struct PhysicsLitePlugin;

impl Plugin for PhysicsLitePlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<FixedClock>();
        let pose = (
            tipping_box::pose_boxes,
            ring::pose_rings,
            rolling_sphere::pose_spheres,
            spinning::pose_spinning,
            path::pose_followers,
        );
        app.add_systems(Startup, pose);
        // One chain: a ring reads the box that it rolls in, and the order of systems is part of the result.
        let step = (
            interpolation::remember,
            tipping_box::step_boxes,
            ring::step_rings,
            rolling_sphere::step_spheres,
            tipping_box::pose_boxes,
            ring::pose_rings,
            rolling_sphere::pose_spheres,
            spinning::pose_spinning,
            path::pose_followers,
        );
        app.add_systems(FixedUpdate, step.chain().in_set(Motion));
    }
}

/// Length of a step, seconds, in the precision of the simulation.
pub(crate) const DT: f64 = 1.0 / 60.0;

/// Rotation by `angle` radians about the unit `axis`, with the engine's sine.
pub(crate) fn axis_angle(axis: glam::DVec3, angle: f64) -> Quat {
    let (s, c) = (catoptra_engine::math::sin_f64(angle * 0.5), catoptra_engine::math::cos_f64(angle * 0.5));
    Quat::from_xyzw((axis.x * s) as f32, (axis.y * s) as f32, (axis.z * s) as f32, c as f32)
}

/// Rotation whose matrix is `m` (orthonormal columns).
pub(crate) fn quat_of(m: &Mat3) -> Quat {
    Quat::from_mat3(m).normalize()
}

#[cfg(test)]
mod tests;
