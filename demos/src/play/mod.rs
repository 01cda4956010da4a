//! `play`: a scene in a window.

use crate::cli::{Failure, PictureArgs, PlayArgs};

/// Why nothing is played.
#[derive(Debug)]
pub enum PlayError {
    /// There is no display, or no adapter can show on it.
    NoWindow(String),
    /// Anything else.
    Other(Failure),
}

/// Runs `play`.
pub fn run(args: &PlayArgs) -> Result<(), Failure> {
    let _ = args;
    Err(Failure::other("no window"))
}

/// Plays a scene until the window is closed.
pub fn play(_scene: Option<&str>, _picture: &PictureArgs) -> Result<(), PlayError> {
    Err(PlayError::NoWindow("there is no display".into()))
}

impl From<PlayError> for Failure {
    fn from(e: PlayError) -> Self {
        match e {
            PlayError::NoWindow(why) => Failure::other(why),
            PlayError::Other(f) => f,
        }
    }
}
