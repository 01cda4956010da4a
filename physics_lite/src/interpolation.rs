//! Poses between two steps, for display only: frames of the command line are always whole steps.

use bevy_ecs::prelude::*;
use bevy_transform::components::Transform;

/// Pose before the last step. Add it to any entity whose motion `play` should show smoothly.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct PreviousPose(pub Transform);

/// Pose at the share `alpha` in [0, 1] of the way from `previous` to `now`: straight for places, the shorter way for
/// rotations (normalised linear, which over one step of 1/60 s is as good as the arc). `alpha` 1 is `now` exactly.
pub fn interpolated(previous: &Transform, now: &Transform, alpha: f32) -> Transform {
    if alpha >= 1.0 || previous == now {
        return *now;
    }
    let alpha = alpha.max(0.0);
    let mix = |a: glam::Vec3, b: glam::Vec3| a + (b - a) * alpha;
    let to = if previous.rotation.dot(now.rotation) < 0.0 { -now.rotation } else { now.rotation };
    Transform {
        translation: mix(previous.translation, now.translation),
        rotation: (previous.rotation * (1.0 - alpha) + to * alpha).normalize(),
        scale: mix(previous.scale, now.scale),
    }
}

/// Copies each pose before the step changes it.
pub(crate) fn remember(mut bodies: Query<(&Transform, &mut PreviousPose)>) {
    for (now, mut previous) in &mut bodies {
        previous.set_if_neq(PreviousPose(*now));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Quat, Vec3};

    #[test]
    fn ends_are_exact_and_the_middle_is_between() {
        let a = Transform::from_translation(Vec3::ZERO);
        let b = Transform { translation: Vec3::X, rotation: Quat::from_xyzw(0.0, 1.0, 0.0, 0.0), ..a };
        assert_eq!(interpolated(&a, &b, 1.0), b);
        assert_eq!(interpolated(&a, &b, 0.0), a);
        let m = interpolated(&a, &b, 0.5);
        assert_eq!(m.translation, Vec3::new(0.5, 0.0, 0.0));
        // Half of a half turn about Y is a quarter turn: X goes to -Z.
        assert!((m.rotation * Vec3::X - Vec3::NEG_Z).length() < 1e-6);
    }
}
