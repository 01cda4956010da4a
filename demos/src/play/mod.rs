//! `play`: a scene in a window.
//!
//! Two threads. The worker (`worker`) owns world and renderer: it makes fixed steps of 1/60 s as time passes and draws as
//! fast as it can, at a size that holds the frame rate. The window's thread (`app`) shows the newest picture, takes input
//! and draws the panel; it never waits for a frame, so the panel answers however dear the picture is. Between them stand
//! two mailboxes (`shared`): what the user wants, and the newest picture.

mod app;
mod compositor;
mod explain_view;
mod keys;
mod overlay;
mod panel;
mod plot;
mod pose;
mod present;
mod screen;
mod settings;
mod shared;
mod shell;
mod soft;
mod worker;

use crate::cli::{Failure, PlayArgs, Target};
use crate::scenes::SCENES;
use shared::Controls;

/// Why nothing is played.
#[derive(Debug)]
pub enum PlayError {
    /// There is no display, or no adapter can show on it.
    NoWindow(String),
    /// Anything else.
    Other(Failure),
}

impl<E: Into<Failure>> From<E> for PlayError {
    fn from(e: E) -> Self {
        Self::Other(e.into())
    }
}

/// How pictures come into the window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum WindowArg {
    /// By a graphics driver where there is one, else by the CPU
    #[default]
    Auto,
    /// By a graphics driver, software ones included
    Gpu,
    /// By the CPU
    Cpu,
}

/// Runs `play`.
pub fn run(args: &PlayArgs) -> Result<(), Failure> {
    play(args).map_err(|e| match e {
        PlayError::NoWindow(why) => {
            let scene = args.scene.as_deref().unwrap_or("all");
            Failure::other(format!("{why}: `catoptra render {scene}` makes pictures without a window"))
        }
        PlayError::Other(failure) => failure,
    })
}

/// Plays a scene, or lets the user pick one, until the window is closed.
///
/// # Errors
/// [`PlayError::NoWindow`] where there is no display or nothing can draw on it; an unknown scene; an explicit choice of
/// `picture` that cannot be served.
pub fn play(args: &PlayArgs) -> Result<(), PlayError> {
    let target = match args.scene.as_deref() {
        None => None,
        Some(name) => Some(Target::parse_one(name)?),
    };
    if let (Some(path), Some(Target::File(_))) | (Some(path), _) = (&args.record, &target)
        && (args.watch || matches!(target, Some(Target::File(_))))
    {
        let why = format!("--record {}: only games are recorded, and this is watched", path.display());
        return Err(PlayError::Other(Failure::usage(why)));
    }
    if args.picture.scene.animation.is_some() && !matches!(target, Some(Target::File(_))) {
        let why = "--animation chooses among a file's animations; name a glTF or GLB file";
        return Err(PlayError::Other(Failure::usage(why)));
    }
    let mut controls = Controls::new(target, &args.picture)?;
    controls.game = !args.watch;
    app::run(controls, args)
}

/// The scene with a number of the list, from 1, for picking by key.
fn scene_by_number(number: usize) -> Option<Target> {
    SCENES.get(number.checked_sub(1)?).map(|s| Target::Scene(s.name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_name_scenes() {
        assert_eq!(scene_by_number(0), None);
        assert_eq!(scene_by_number(1), Some(Target::Scene("rolling-box")));
        assert_eq!(scene_by_number(6), None);
    }
}
