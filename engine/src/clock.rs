//! Fixed time: frame K of a scene is its state after K steps of [`FIXED_DT_SECS`].

use bevy_app::{App, MainScheduleOrder, Plugin, Update};
use bevy_ecs::{prelude::*, schedule::ScheduleLabel};

/// Length of one step in seconds.
pub const FIXED_DT_SECS: f32 = 1.0 / 60.0;

/// Schedule of motion: runs exactly once per `App::update`, after `Update` and before transforms propagate.
#[derive(ScheduleLabel, Clone, Debug, PartialEq, Eq, Hash)]
pub struct FixedUpdate;

/// Steps done so far. Systems in [`FixedUpdate`] see the number of the step that they make (first: 1).
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FixedClock {
    /// Number of the step.
    pub step: u64,
    /// While true `App::update` makes no step (the first update of an app, a paused game).
    pub paused: bool,
}

impl FixedClock {
    /// Time after the current step, in seconds: step × dt, computed afresh so that it never drifts.
    pub fn seconds(&self) -> f32 {
        (self.step as f64 / 60.0) as f32
    }
}

/// Adds [`FixedClock`] and runs [`FixedUpdate`].
pub struct ClockPlugin;

impl Plugin for ClockPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<FixedClock>().init_schedule(FixedUpdate);
        app.world_mut().resource_mut::<MainScheduleOrder>().insert_after(Update, RunFixed);
        app.init_schedule(RunFixed).add_systems(RunFixed, run_fixed_update);
    }
}

#[derive(ScheduleLabel, Clone, Debug, PartialEq, Eq, Hash)]
struct RunFixed;

fn run_fixed_update(world: &mut World) {
    let mut clock = world.resource_mut::<FixedClock>();
    if clock.paused {
        return;
    }
    clock.step += 1;
    world.run_schedule(FixedUpdate);
}
