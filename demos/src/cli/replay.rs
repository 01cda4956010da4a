//! `replay`: a recorded game without a window, to the bit.

use super::{
    args::ReplayArgs,
    failure::{Failure, line},
};
use crate::game::{Recording, last_frame, play_out, replay};
use catoptra_render_hybrid::{Layer, image_io};

/// Largest recording that is read: a day of keys is a few megabytes.
const MOST_BYTES: u64 = 64 << 20;

/// Plays the recording; prints hashes of the last state and the last frame. Exit status 1 where the file holds others.
pub fn run(args: &ReplayArgs) -> Result<(), Failure> {
    let told = |why: String| Failure::other(format!("{}: {why}", args.file.display()));
    let size = std::fs::metadata(&args.file).map_err(|e| told(format!("cannot be read: {e}")))?.len();
    if size > MOST_BYTES {
        return Err(told(format!("{size} bytes are too many for a recording")));
    }
    let bytes = std::fs::read(&args.file).map_err(|e| told(format!("cannot be read: {e}")))?;
    let text = String::from_utf8(bytes).map_err(|_| told("this is no recording (not text)".into()))?;
    let recording = Recording::parse(&text).map_err(|e| told(format!("this is no recording: {e}")))?;
    if let Some(path) = &args.picture {
        let run = play_out(&recording).map_err(|e| told(e.to_string()))?;
        let size = (args.size.0, args.size.1);
        let frame = last_frame(&run, size, args.threads.unwrap_or(0) as usize).map_err(|e| told(e.to_string()))?;
        let srgb8 = image_io::srgb8_from_layer(Layer::Final, &frame, 0.0);
        image_io::write_png(path, frame.width, frame.height, &srgb8)?;
    }
    let end = replay(&recording, args.threads.unwrap_or(0) as usize).map_err(|e| told(e.to_string()))?;
    let (game, level, moves) = (recording.kind.name(), end.level + 1, end.moves);
    let won = if end.won { "won" } else { "open" };
    line(format!("replay game={game} level={level} steps={} moves={moves} result={won}", recording.steps))?;
    line(format!("state hash={:016x}", end.state))?;
    line(format!("frame hash={:016x}", end.frame))?;
    for (what, file, got) in [("state", recording.state, end.state), ("last frame", recording.frame, end.frame)] {
        if let Some(file) = file.filter(|f| *f != got) {
            return Err(told(format!("its {what} was {file:016x} when it was recorded, and is {got:016x} now")));
        }
    }
    Ok(())
}
