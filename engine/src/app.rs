//! Wiring: one plugin that makes a bevy app a world that can be drawn.

use crate::{animation, assets::Assets, clock::ClockPlugin, clock::FixedClock, clock::FixedUpdate, extract};
use bevy_app::{App, Last, Plugin};
use bevy_ecs::schedule::IntoScheduleConfigs;
use bevy_transform::plugins::TransformPlugin;

/// Clock, transforms and extraction. After `App::update` the [`crate::Extracted`] resource holds the scene.
#[derive(Default)]
pub struct EnginePlugin;

impl Plugin for EnginePlugin {
    fn build(&self, app: &mut App) {
        if !app.is_plugin_added::<TransformPlugin>() {
            app.add_plugins(TransformPlugin);
        }
        app.add_plugins(ClockPlugin)
            .init_resource::<Assets>()
            .init_resource::<extract::SceneEnvironment>()
            .init_resource::<extract::Extracted>()
            .init_resource::<extract::ExtractedCameras>()
            .init_resource::<extract::ExtractIndex>()
            .add_systems(FixedUpdate, animation::animate)
            .add_systems(Last, (animation::deform, extract::extract).chain());
    }
}

/// An app with the engine in it, ready for entities. Call [`settle`] once they are there.
pub fn new_app() -> App {
    let mut app = App::new();
    app.add_plugins(EnginePlugin);
    app
}

/// Finishes plugins and extracts the world as it stands, without a step of time: the state of frame 0.
pub fn settle(app: &mut App) {
    app.finish();
    app.cleanup();
    app.world_mut().resource_mut::<FixedClock>().paused = true;
    app.update();
    app.world_mut().resource_mut::<FixedClock>().paused = false;
}

/// Makes `steps` fixed steps; afterwards the extracted scene is that of the last one.
pub fn advance(app: &mut App, steps: u64) {
    for _ in 0..steps {
        app.update();
    }
}
