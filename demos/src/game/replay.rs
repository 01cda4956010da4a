//! Recordings: the actions of each fixed step as text, and what they lead to.
//!
//! ```text
//! catoptra-replay 1
//! game two-spheres
//! level 1
//! layout 0123456789abcdef     xxh3-64 of the level's text
//! size 256x144                of the last frame
//! @12 aim 40                  in the step after 12 steps
//! @13 putt
//! end 431                     steps in all
//! state 0123456789abcdef      both may be missing while a recording is made
//! frame 0123456789abcdef
//! ```

use super::{Action, Kind, Run, level};
use catoptra_render_hybrid::{Image, RasterLane, RenderSettings, Renderer, RendererOptions};
use std::fmt;

/// What the first line says.
const HEADER: &str = "catoptra-replay";
/// The version that is written and read.
const VERSION: u32 = 1;
/// Most steps: a day.
const MOST_STEPS: u64 = 24 * 3600 * 60;
/// Size of the last frame where none is said.
const SIZE: (u32, u32) = (256, 144);

/// A recorded game.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recording {
    /// Which game.
    pub kind: Kind,
    /// First level, from 0.
    pub level: usize,
    /// Layout of that level.
    pub layout: u64,
    /// Size of the last frame in pixels.
    pub size: (u32, u32),
    /// Actions with the number of steps before them, ascending.
    pub actions: Vec<(u64, Action)>,
    /// Steps in all.
    pub steps: u64,
    /// Hash of the state at the end ([`Run::state_hash`]).
    pub state: Option<u64>,
    /// Hash of the last frame on the CPU lane at the interactive preset.
    pub frame: Option<u64>,
}

/// Why a recording cannot be played.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ReplayError {
    /// The text is no recording.
    #[error("line {line}: {why}")]
    Text {
        /// Number of the line, from 1.
        line: usize,
        /// What is wrong.
        why: String,
    },
    /// It was recorded on another layout of the level.
    #[error("level {level} of {game} has changed since this was recorded")]
    OtherLayout {
        /// The game.
        game: &'static str,
        /// The level, from 1.
        level: usize,
    },
    /// The last frame could not be made.
    #[error("the last frame could not be drawn: {0}")]
    Frame(String),
}

/// What a recording led to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Replayed {
    /// Hash of the state at the end.
    pub state: u64,
    /// Hash of the last frame.
    pub frame: u64,
    /// The level at the end, from 0.
    pub level: usize,
    /// It was won.
    pub won: bool,
    /// Moves of the line that was played.
    pub moves: u32,
}

impl Recording {
    /// An empty recording of a level, from 0; `None` where there is no such level.
    pub fn begin(kind: Kind, number: usize) -> Option<Self> {
        let layout = level(kind, number)?.layout;
        Some(Self { kind, level: number, layout, size: SIZE, actions: Vec::new(), steps: 0, state: None, frame: None })
    }

    /// Adds the actions of one step.
    pub fn push(&mut self, actions: &[Action]) {
        self.actions.extend(actions.iter().map(|a| (self.steps, *a)));
        self.steps += 1;
    }

    /// Reads what `Display` writes.
    ///
    /// # Errors
    /// The first line that cannot be understood.
    pub fn parse(text: &str) -> Result<Self, ReplayError> {
        let fail = |line: usize, why: &str| ReplayError::Text { line, why: why.into() };
        let mut lines = text.lines().enumerate().map(|(i, l)| (i + 1, l.trim_end()));
        let mut wanted = |key: &'static str| -> Result<(usize, &str), ReplayError> {
            let (n, line) = lines.next().ok_or_else(|| fail(1, &format!("the line `{key}` is missing")))?;
            let rest = line.strip_prefix(key).and_then(|r| r.strip_prefix(' '));
            rest.map(|r| (n, r)).ok_or_else(|| fail(n, &format!("`{key} ..` should stand here")))
        };
        let (n, version) = wanted(HEADER)?;
        match version.parse::<u32>() {
            Ok(VERSION) => {}
            Ok(v) => return Err(fail(n, &format!("version {v} of the format is not known to this program"))),
            Err(_) => return Err(fail(n, "the version is no number")),
        }
        let (n, name) = wanted("game")?;
        let kind = Kind::of(name).ok_or_else(|| fail(n, "there is no such game"))?;
        let (n, number) = wanted("level")?;
        let number = number.parse::<usize>().ok().and_then(|l| l.checked_sub(1));
        let number = number.filter(|l| level(kind, *l).is_some()).ok_or_else(|| fail(n, "there is no such level"))?;
        let (n, layout) = wanted("layout")?;
        let layout = hash_of(layout).ok_or_else(|| fail(n, "the layout is no hash of 16 digits"))?;
        let (n, size) = wanted("size")?;
        let size = size_of(size).ok_or_else(|| fail(n, "the size is not WxH from 1x1 to 4096x4096"))?;
        let mut recording =
            Self { kind, level: number, layout, size, ..Self::begin(kind, number).ok_or_else(|| fail(n, ""))? };
        let mut end = None;
        for (n, line) in lines {
            if line.is_empty() {
                continue;
            }
            let (key, rest) = line.split_once(' ').unwrap_or((line, ""));
            match (key, end) {
                ("end", None) => {
                    let least = recording.actions.last().map_or(0, |a| a.0 + 1);
                    let steps = rest.parse::<u64>().ok().filter(|s| (least..=MOST_STEPS).contains(s));
                    end = Some(steps.ok_or_else(|| fail(n, "the end is no number of steps after the last action"))?);
                }
                ("state", Some(_)) => {
                    recording.state = Some(hash_of(rest).ok_or_else(|| fail(n, "no hash of 16 digits"))?)
                }
                ("frame", Some(_)) => {
                    recording.frame = Some(hash_of(rest).ok_or_else(|| fail(n, "no hash of 16 digits"))?)
                }
                (key, None) if key.starts_with('@') => {
                    let step = key[1..].parse::<u64>().ok().filter(|s| *s < MOST_STEPS);
                    let step = step.ok_or_else(|| fail(n, "the step is no number"))?;
                    if recording.actions.last().is_some_and(|a| a.0 > step) {
                        return Err(fail(n, "steps must rise"));
                    }
                    let action = Action::parse(rest).ok_or_else(|| fail(n, "there is no such action"))?;
                    recording.actions.push((step, action));
                }
                _ => return Err(fail(n, "this line means nothing here")),
            }
        }
        recording.steps =
            end.ok_or_else(|| fail(text.lines().count(), "the line `end STEPS` is missing: the file is cut off"))?;
        Ok(recording)
    }
}

impl fmt::Display for Recording {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{HEADER} {VERSION}\ngame {}\nlevel {}", self.kind.name(), self.level + 1)?;
        writeln!(f, "layout {:016x}\nsize {}x{}", self.layout, self.size.0, self.size.1)?;
        for (step, action) in &self.actions {
            writeln!(f, "@{step} {action}")?;
        }
        writeln!(f, "end {}", self.steps)?;
        if let Some(state) = self.state {
            writeln!(f, "state {state:016x}")?;
        }
        if let Some(frame) = self.frame {
            writeln!(f, "frame {frame:016x}")?;
        }
        Ok(())
    }
}

fn hash_of(text: &str) -> Option<u64> {
    let digits = text.len() == 16 && text.bytes().all(|b| b.is_ascii_hexdigit());
    digits.then(|| u64::from_str_radix(text, 16).ok()).flatten()
}

fn size_of(text: &str) -> Option<(u32, u32)> {
    let (w, h) = text.split_once('x')?;
    let side = |t: &str| t.parse::<u32>().ok().filter(|s| (1..=4096).contains(s));
    Some((side(w)?, side(h)?))
}

/// Plays a recording without a window. `threads`: worker threads of the last frame, 0 for one a processor; they change
/// nothing but the time it takes.
///
/// # Errors
/// Where the level has changed, or the last frame cannot be made.
pub fn replay(recording: &Recording, threads: usize) -> Result<Replayed, ReplayError> {
    let run = play_out(recording)?;
    let frame = last_frame(&run, recording.size, threads)?;
    Ok(Replayed {
        state: run.state_hash(),
        frame: frame.hash(),
        level: run.number(),
        won: run.session().won(),
        moves: run.session().moves,
    })
}

/// The frame that a run stands at, on the CPU lane at the interactive preset.
///
/// # Errors
/// Where it cannot be made.
pub fn last_frame(run: &Run, (width, height): (u32, u32), threads: usize) -> Result<Image, ReplayError> {
    let failed = |e: catoptra_render_hybrid::RenderError| ReplayError::Frame(e.to_string());
    let options = RendererOptions { raster: RasterLane::Cpu, threads, ..RendererOptions::default() };
    let settings = RenderSettings { width, height, ..RenderSettings::default() };
    Ok(Renderer::new(options).map_err(failed)?.render(run.scene(), &settings).map_err(failed)?.image)
}

/// Plays all steps of a recording without a window.
///
/// # Errors
/// Where the level has changed.
pub fn play_out(recording: &Recording) -> Result<Run, ReplayError> {
    let other = ReplayError::OtherLayout { game: recording.kind.name(), level: recording.level + 1 };
    let mut run = Run::new(recording.kind, recording.level).ok_or(other.clone())?;
    if run.level().layout != recording.layout {
        return Err(other);
    }
    let mut rest = recording.actions.as_slice();
    let mut now = Vec::new();
    for step in 0..recording.steps {
        let due = rest.iter().take_while(|a| a.0 == step).count();
        now.clear();
        now.extend(rest[..due].iter().map(|a| a.1));
        rest = &rest[due..];
        run.step(&now);
    }
    Ok(run)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::game::Dir;

    fn sample() -> Recording {
        let mut r = Recording::begin(Kind::RollingBox, 0).unwrap();
        r.push(&[Action::Roll(Dir::East), Action::Undo]);
        r.push(&[]);
        r.push(&[Action::Level(1)]);
        r
    }

    #[test]
    fn texts_come_back() {
        let mut r = sample();
        assert_eq!(Recording::parse(&r.to_string()).unwrap(), r);
        (r.state, r.frame) = (Some(7), Some(u64::MAX));
        assert_eq!(Recording::parse(&r.to_string()).unwrap(), r);
    }

    #[test]
    fn garbled_texts_name_the_line_and_never_panic() {
        let text = sample().to_string();
        // Cut anywhere, the text is refused, up to where the end is told.
        for cut in 0..text.len() - 2 {
            assert!(Recording::parse(&text[..cut]).is_err(), "{}", &text[..cut]);
        }
        for (from, to, told) in [
            ("catoptra-replay 1", "catoptra-replay 2", "line 1: version 2"),
            ("catoptra-replay 1", "PNG", "line 1"),
            ("game rolling-box", "game chess", "line 2"),
            ("level 1", "level 99", "line 3"),
            ("layout ", "layout x", "line 4"),
            ("size 256x144", "size 0x144", "line 5"),
            ("@0 roll east", "@0 roll up", "line 6"),
            ("@0 undo", "@99999999999999 undo", "line 7"),
            ("@2 level 2", "@2", "line 8"),
            ("end 3", "end 2", "line 9"),
            ("end 3", "end 3\nmore", "line 10"),
        ] {
            let e = Recording::parse(&text.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(e.starts_with(told) && !e.contains('\n'), "{to}: {e}");
        }
    }
}
