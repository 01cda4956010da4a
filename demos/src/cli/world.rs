//! A target come to life: the world of a scene or of a file, stepped and looked at.

use super::{failure::Failure, file, target::Target};
use crate::scenes::{self, SceneOptions};
use catoptra_engine::{Extracted, RenderScene, app, bevy_app::App};

/// A world at some frame.
pub struct World {
    app: App,
    /// Name in output and file names.
    pub name: String,
    frame: u64,
}

impl World {
    /// The target at frame 0.
    ///
    /// # Errors
    /// A file that cannot be read or used; an animation that is not there (wrong use).
    pub fn open(target: &Target, options: &SceneOptions) -> Result<Self, Failure> {
        let app = match target {
            Target::Scene(name) => scenes::build(name, options)?,
            Target::File(path) => file::open(path, options.animation.as_deref())?,
        };
        Ok(Self { app, name: target.name(), frame: 0 })
    }

    /// Number of the frame that the world is at.
    pub fn frame(&self) -> u64 {
        self.frame
    }

    /// Makes steps of 1/60 s.
    pub fn advance(&mut self, steps: u64) {
        app::advance(&mut self.app, steps);
        self.frame += steps;
    }

    /// Makes steps until `frame`, with a bar if that takes long. Frames before the current one are not reached again.
    pub fn advance_to(&mut self, frame: u64) {
        let mut progress = super::progress::Progress::new(&format!("{} steps", self.name), frame);
        while self.frame < frame {
            let steps = (frame - self.frame).min(64);
            self.advance(steps);
            progress.set(self.frame);
        }
    }

    /// The app behind it, for showing poses that are no whole step.
    pub fn app_mut(&mut self) -> &mut App {
        &mut self.app
    }

    /// The scene as it stands.
    pub fn scene(&self) -> &RenderScene {
        &self.app.world().resource::<Extracted>().0
    }
}
