//! The viewer leans a little after the body that is played, slowly enough to be no distraction from a puzzle.

use super::systems::Player;
use bevy_ecs::prelude::*;
use bevy_transform::components::Transform;
use catoptra_engine::{CameraProjection, camera};
use glam::{Quat, Vec3};

/// Share of the way that is left made in each fixed step: half of it in about a quarter of a second.
const PACE: f32 = 0.045;
/// What is left is no longer worth a new picture, metres.
const CLOSE: f32 = 1e-4;

/// On the camera: how it leans.
#[derive(Component, Clone, Copy, Debug)]
pub struct Lean {
    /// Where it stands while the body is in the middle, world metres.
    pub eye: Vec3,
    /// What it looks at then.
    pub target: Vec3,
    /// Middle of the board.
    pub middle: Vec3,
    /// Share of the body's distance from the middle, by axis, that the eye goes along.
    pub eye_share: Vec3,
    /// The same for what it looks at.
    pub target_share: Vec3,
    /// Where the lean is now: the body's place, followed.
    pub at: Vec3,
}

impl Lean {
    /// Standing as if the body were at `at`.
    fn pose(&self) -> Transform {
        let off = self.at - self.middle;
        let (eye, target) = (self.eye + off * self.eye_share, self.target + off * self.target_share);
        let pose = camera::world_from_view_looking_at(eye, target);
        Transform { translation: eye, rotation: Quat::from_mat3(&pose.matrix3).normalize(), scale: Vec3::ONE }
    }
}

/// Leans after the player's body.
pub fn lean(
    mut cameras: Query<(&mut Lean, &mut Transform), (With<CameraProjection>, Without<Player>)>,
    bodies: Query<&Transform, With<Player>>,
) {
    let Some(body) = bodies.iter().next() else { return };
    for (mut lean, mut pose) in &mut cameras {
        // A body that falls is not followed down.
        let wanted = Vec3::new(body.translation.x, lean.middle.y, body.translation.z);
        let left = wanted - lean.at;
        if left.length() > CLOSE {
            lean.at += left * PACE;
        }
        pose.set_if_neq(lean.pose());
    }
}
