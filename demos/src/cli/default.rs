//! The bare command: play, or, without a display, render the five scenes.

use super::{
    args::{Format, LayerArg, PlayArgs},
    failure::{Failure, note},
    options::PictureArgs,
    render::{RenderJob, render},
    target::Target,
};
use crate::play;
use std::path::Path;

/// Plays rolling-box; where no window can be had, says so and renders the five scenes to ./out.
pub fn run() -> Result<(), Failure> {
    let picture = PictureArgs::default();
    match play::play(&PlayArgs { scene: Some("rolling-box".into()), ..PlayArgs::default() }) {
        Err(play::PlayError::NoWindow(why)) => {
            note(format!("{why}: rendering the five scenes to ./out instead"));
            let out = Path::new("out");
            let (layer, format) = (LayerArg::Final, Format::Png);
            render(&RenderJob {
                targets: Target::parse("all")?,
                first: 0,
                frames: 1,
                layer,
                format,
                out,
                picture: &picture,
            })
        }
        Err(play::PlayError::Other(failure)) => Err(failure),
        Ok(()) => Ok(()),
    }
}
