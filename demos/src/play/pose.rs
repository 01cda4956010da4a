//! Poses between two steps, so that motion looks smooth at any frame rate.
//!
//! The world's own poses stay those of whole steps: [`InBetween::show`] sets the interpolated ones, extracts, and
//! [`InBetween::restore`] puts the true ones back before the next step reads them.

use bevy_ecs::prelude::*;
use bevy_transform::components::Transform;
use catoptra_engine::{FixedClock, bevy_app::App};
use catoptra_physics_lite::{PreviousPose, interpolated};

/// The true poses of what is shown in between.
#[derive(Default)]
pub struct InBetween {
    true_poses: Vec<(Entity, Transform)>,
}

impl InBetween {
    /// Shows the world at the share `alpha` in [0, 1] of the way from the step before the last to the last.
    pub fn show(&mut self, app: &mut App, alpha: f32) {
        self.true_poses.clear();
        let mut query = app.world_mut().query::<(Entity, &mut Transform, &PreviousPose)>();
        for (entity, mut pose, previous) in query.iter_mut(app.world_mut()) {
            let shown = interpolated(&previous.0, &pose, alpha);
            if shown != *pose {
                self.true_poses.push((entity, *pose));
                *pose = shown;
            }
        }
        extract_without_a_step(app);
    }

    /// Puts the true poses back.
    pub fn restore(&mut self, app: &mut App) {
        for (entity, pose) in self.true_poses.drain(..) {
            if let Some(mut now) = app.world_mut().get_mut::<Transform>(entity) {
                *now = pose;
            }
        }
    }
}

fn extract_without_a_step(app: &mut App) {
    app.world_mut().resource_mut::<FixedClock>().paused = true;
    app.update();
    app.world_mut().resource_mut::<FixedClock>().paused = false;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{self, SceneOptions};
    use catoptra_engine::{Extracted, app::advance};

    #[test]
    fn showing_in_between_leaves_no_trace() {
        let poses = |app: &App| {
            let scene = &app.world().resource::<Extracted>().0;
            (scene.instances.clone(), scene.lights.clone(), scene.camera)
        };
        let mut plain = scenes::build("rolling-box", &SceneOptions::default()).unwrap();
        let mut shown = scenes::build("rolling-box", &SceneOptions::default()).unwrap();
        let mut between = InBetween::default();
        for _ in 0..10 {
            advance(&mut plain, 1);
            between.restore(&mut shown);
            advance(&mut shown, 1);
            assert!(poses(&plain) == poses(&shown));
            between.show(&mut shown, 0.5);
            assert!(poses(&plain) != poses(&shown), "the picture is of another time");
            assert_eq!(shown.world().resource::<FixedClock>().step, plain.world().resource::<FixedClock>().step);
        }
    }
}
