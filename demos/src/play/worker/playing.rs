//! A world or a game in time: steps that are due, actions, the recording.

use crate::{
    cli::{Failure, Target, World, millis},
    game::{Action, Kind, Pointer, Recording, Run, replay},
    play::{pose::InBetween, shared::Controls},
    scenes::SceneOptions,
};
use catoptra_engine::{RenderScene, bevy_app::App};
use std::{path::PathBuf, time::Instant};

/// Length of a step.
const STEP: f64 = 1.0 / 60.0;
/// Steps made at most for one picture: where drawing is slower, the world runs slower rather than in jumps.
const MAX_STEPS: u32 = 6;

/// What runs: a world to look at, or a game.
pub enum Content {
    Watched(Box<World>),
    Game(Box<Run>, Option<(PathBuf, Recording)>),
}

impl Content {
    pub fn won(&self) -> bool {
        matches!(self, Self::Game(run, _) if run.at_rest() && run.session().won())
    }

    pub fn app_mut(&mut self) -> &mut App {
        match self {
            Self::Watched(world) => world.app_mut(),
            Self::Game(run, _) => run.app_mut(),
        }
    }

    pub fn scene(&self) -> &RenderScene {
        match self {
            Self::Watched(world) => world.scene(),
            Self::Game(run, _) => run.scene(),
        }
    }

    pub fn steps(&self) -> u64 {
        match self {
            Self::Watched(world) => world.frame(),
            Self::Game(run, _) => run.steps(),
        }
    }

    pub fn step(&mut self, actions: &[Action]) {
        match self {
            Self::Watched(world) => world.advance(1),
            Self::Game(run, recording) => {
                if let Some((_, recording)) = recording {
                    recording.push(actions);
                }
                run.step(actions);
            }
        }
    }
}

pub struct Playing {
    pub target: Target,
    pub restarts: u32,
    pub content: Content,
    pub between: InBetween,
    /// When time was last looked at.
    pub last: Instant,
    /// Time that has passed and is not yet stepped, seconds.
    owed: f64,
    pub physics_ms: f64,
    /// Actions for the next step.
    actions: Vec<Action>,
}

impl Playing {
    pub fn open(
        target: &Target,
        controls: &Controls,
        options: &SceneOptions,
        record: &mut Option<PathBuf>,
    ) -> Result<Self, Failure> {
        let game = match target {
            Target::Scene(name) if controls.game => Kind::of(name),
            _ => None,
        };
        let content = match game {
            Some(kind) => {
                let run = Run::new(kind, 0).ok_or_else(|| Failure::other("the game has no levels"))?;
                let recording = record.take().and_then(|path| Some((path, Recording::begin(kind, 0)?)));
                Content::Game(Box::new(run), recording)
            }
            None => Content::Watched(Box::new(World::open(target, options)?)),
        };
        content.scene().validate()?;
        Ok(Self {
            target: target.clone(),
            restarts: controls.restarts,
            content,
            between: InBetween::default(),
            last: Instant::now(),
            owed: 0.0,
            physics_ms: 0.0,
            actions: Vec::new(),
        })
    }

    /// Ends the game: writes its recording with the hashes that it leads to. Returns what the user should know.
    pub fn finish(mut self) -> Option<String> {
        self.between.restore(self.content.app_mut());
        let Content::Game(run, Some((path, mut recording))) = self.content else { return None };
        let write = |recording: &Recording| {
            let part = path.with_extension("part");
            std::fs::write(&part, recording.to_string()).and_then(|()| std::fs::rename(&part, &path)).map_err(|e| {
                let _ = std::fs::remove_file(&part);
                format!("cannot write {}: {e}", path.display())
            })
        };
        // First the actions alone: what follows takes a while.
        let told = write(&recording).and_then(|()| {
            let end = replay(&recording, 0).map_err(|e| e.to_string())?;
            (recording.state, recording.frame) = (Some(end.state), Some(end.frame));
            write(&recording)?;
            let s = run.session();
            if (end.moves, end.won, end.level) != (s.moves, s.won(), run.number()) {
                return Err("the recording does not come to the same end as the game".into());
            }
            Ok(format!("wrote {} ({} steps)", path.display(), recording.steps))
        });
        let told = told.unwrap_or_else(|why| why);
        crate::cli::note(&told);
        Some(told)
    }

    /// A game that is won and at rest.
    pub fn won(&self) -> bool {
        self.content.won()
    }

    /// Makes the steps that are due and shows the world in between. Returns whether anything may look different.
    pub fn pass_time(&mut self, controls: &mut Controls) -> bool {
        let start = Instant::now();
        let passed = (start - self.last).as_secs_f64();
        self.last = start;
        let (steps, alpha) = if controls.paused {
            self.owed = 0.0;
            (controls.once.steps, 1.0)
        } else {
            self.owed += passed;
            let due = (self.owed / STEP) as u32;
            let steps = due.min(MAX_STEPS);
            // What cannot be caught up with is forgotten.
            self.owed = if due > MAX_STEPS { 0.0 } else { self.owed - f64::from(steps) * STEP };
            (steps, (self.owed / STEP) as f32)
        };
        self.between.restore(self.content.app_mut());
        self.hear(controls);
        for _ in 0..steps {
            let actions = std::mem::take(&mut self.actions);
            self.content.step(&actions);
        }
        let moving = !controls.paused || steps > 0;
        self.between.show(self.content.app_mut(), alpha);
        self.physics_ms = millis(start);
        moving
    }

    /// Takes the player's actions and what he pointed at.
    pub fn hear(&mut self, controls: &mut Controls) {
        let Content::Game(run, _) = &self.content else { return };
        self.actions.append(&mut controls.once.actions);
        for [u, v] in controls.once.clicks.drain(..) {
            let (w, h) = controls.window;
            let (origin, direction) = run.scene().camera.ray(u * w as f32, v * h as f32, w, h);
            self.actions.extend(run.pointed(&Pointer { origin, direction }));
        }
    }
}
