//! What the two threads of `play` tell each other.

use super::PlayError;
use crate::cli::{PictureArgs, Size, Target};
use catoptra_render_hybrid::{FrameStats, Layer, RenderSettings};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Window that opens where no size was asked for.
const DEFAULT_SIZE: Size = Size(1280, 720);

/// How large the picture is drawn, as a share of the window's side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scale {
    /// As large as holds so many frames a second.
    Hold(f32),
    /// So large, however long it takes.
    Fixed(f32),
}

/// What the user wants.
#[derive(Clone, Debug, PartialEq)]
pub struct Controls {
    /// What is played; `None` while the picker is open.
    pub target: Option<Target>,
    /// Counts up to start the target anew.
    pub restarts: u32,
    /// Settings of the picture; its size is `window`, times the scale.
    pub settings: RenderSettings,
    /// What the settings were at the start, for switching a stage back on.
    pub initial: RenderSettings,
    /// Which layer is shown.
    pub layer: Layer,
    /// Exposure in stops.
    pub exposure_ev: f32,
    /// Time stands still.
    pub paused: bool,
    /// Single steps asked for while time stands still.
    pub steps: u32,
    /// Size of the picture.
    pub scale: Scale,
    /// Size in pixels of the part of the window that shows the picture.
    pub window: (u32, u32),
    /// The window is closing.
    pub quit: bool,
    /// Counts changes, so that a picture of a world at rest is drawn once.
    pub version: u64,
}

impl Controls {
    /// As the command line says.
    pub fn new(target: Option<Target>, picture: &PictureArgs) -> Result<Self, PlayError> {
        let settings = picture.settings(DEFAULT_SIZE)?;
        Ok(Self {
            target,
            restarts: 0,
            settings,
            initial: settings,
            layer: Layer::Final,
            exposure_ev: picture.exposure,
            paused: false,
            steps: 0,
            // An explicit size is the size of the picture, not a wish.
            scale: if picture.size.is_some() { Scale::Fixed(1.0) } else { Scale::Hold(30.0) },
            window: (settings.width, settings.height),
            quit: false,
            version: 0,
        })
    }
}

/// A finished picture.
pub struct Picture {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// sRGB bytes and full opacity, `[height][width][4]`.
    pub rgba8: Vec<u8>,
    /// Name of what is shown.
    pub name: String,
    /// Steps made so far.
    pub frame: u64,
    /// The renderer's figures.
    pub stats: FrameStats,
    /// Steps and extraction, milliseconds.
    pub physics_ms: f64,
    /// From steps to bytes, milliseconds.
    pub frame_ms: f64,
}

/// The two mailboxes.
pub struct Shared {
    controls: Mutex<Controls>,
    changed: Condvar,
    picture: Mutex<Option<Picture>>,
}

impl Shared {
    /// Empty, with the first wishes.
    pub fn new(controls: Controls) -> Self {
        Self { controls: Mutex::new(controls), changed: Condvar::new(), picture: Mutex::new(None) }
    }

    /// A copy of the wishes; single steps are taken out, because a step is made once.
    pub fn take_controls(&self) -> Controls {
        let mut controls = lock(&self.controls);
        let copy = controls.clone();
        controls.steps = 0;
        copy
    }

    /// Replaces the wishes and wakes the worker.
    pub fn set_controls(&self, mut wanted: Controls) {
        let mut controls = lock(&self.controls);
        wanted.version = controls.version + 1;
        // Steps not yet taken out are still to be made.
        wanted.steps += controls.steps;
        *controls = wanted;
        self.changed.notify_all();
    }

    /// Waits for other wishes than those of `version`, at most for `timeout`.
    pub fn wait_for_change(&self, version: u64, timeout: std::time::Duration) {
        let controls = lock(&self.controls);
        let _ = self.changed.wait_timeout_while(controls, timeout, |c| c.version == version && !c.quit);
    }

    /// Leaves a picture; one that nobody looked at is dropped.
    pub fn put_picture(&self, picture: Picture) {
        *lock(&self.picture) = Some(picture);
    }

    /// Takes the newest picture.
    pub fn take_picture(&self) -> Option<Picture> {
        lock(&self.picture).take()
    }
}

/// A thread that died while it held the lock left whole values behind: they are only ever replaced.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_made_once_and_never_lost() {
        let shared = Shared::new(Controls::new(None, &PictureArgs::default()).unwrap_or_else(|_| panic!()));
        let mut wanted = shared.take_controls();
        wanted.steps = 1;
        shared.set_controls(wanted.clone());
        shared.set_controls(Controls { steps: 1, ..wanted });
        assert_eq!(shared.take_controls().steps, 2);
        assert_eq!(shared.take_controls().steps, 0);
    }
}
