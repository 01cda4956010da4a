//! Five games whose rules, levels and solver know neither window nor renderer.
//!
//! **Contract:** a game is a function of its level and of the actions per fixed step. [`Level::play`] plays moves on plain values
//! ([`State`]), [`solver`] proves that a level can be won and gives its par, [`Session`] adds undo, hints and counting, and
//! [`Run`] puts all of it into an ECS world in which actions start motion and motion takes its time. Keys, windows, threads
//! and pictures have no say in any of it.

mod action;
mod boxes;
mod cube;
mod follow;
mod level;
mod putt;
mod replay;
mod run;
mod session;
pub mod solver;
mod systems;
mod worlds;

pub use action::Action;
pub use boxes::{BoxLevel, BoxState, Tile};
pub use cube::{Dir, Hue, Orient};
pub use level::{Body, Level, LevelError, level, level_count};
pub use putt::{AIMS, POWERS, PuttLevel, PuttState, Shot, aim_direction, shot_speed};
pub use replay::{Recording, ReplayError, Replayed, last_frame, play_out, replay};
pub use run::{Pointer, Run};
pub use session::{Move, Outcome, Session, State};

/// Which of the five games.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// Six colours, each to its tile.
    RollingBox,
    /// A mirror donut in a glass box.
    Donut,
    /// Putting around a mirror sphere.
    TwoSpheres,
    /// A code in a mirror statue.
    Venus,
    /// A mirror box and three gates.
    Sponza,
}

impl Kind {
    /// All games, in the order of the scenes.
    pub const ALL: [Self; 5] = [Self::RollingBox, Self::Donut, Self::TwoSpheres, Self::Venus, Self::Sponza];

    /// The scene's name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::RollingBox => "rolling-box",
            Self::Donut => "rolling-box-donut",
            Self::TwoSpheres => "two-spheres",
            Self::Venus => "rolling-box-venus",
            Self::Sponza => "rolling-box-sponza",
        }
    }

    /// The game of a scene's name.
    pub fn of(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|k| k.name() == name)
    }

    /// Title for people.
    pub fn title(self) -> &'static str {
        match self {
            Self::RollingBox => "Six Colours",
            Self::Donut => "The Glass Courier",
            Self::TwoSpheres => "Blind Putt",
            Self::Venus => "The Code of Venus",
            Self::Sponza => "Three Gates",
        }
    }

    /// The goal in one sentence.
    pub fn goal(self) -> &'static str {
        match self {
            Self::RollingBox => "Tip the box so that every coloured tile once has its own colour lying on top of it.",
            Self::Donut => "Carry the donut to the pad of the colour that glows behind you, again and again.",
            Self::TwoSpheres => "Putt the ball into the hole behind you.",
            Self::Venus => {
                "Cross the floor colour by colour in the order of the lamps behind you, then leave by the white tile."
            }
            Self::Sponza => {
                "Roll the mirror box out through whichever gate behind you glows green; copper must never touch the stone."
            }
        }
    }

    /// Where to look for what the player must know.
    pub fn look(self) -> &'static str {
        match self {
            Self::RollingBox => {
                "The mirrors on the walls show the sides that face away from you. Each colour has its pips, as on a die."
            }
            Self::Donut => {
                "The ring and the glass show what glows behind you. Cracked tiles break once you leave them."
            }
            Self::TwoSpheres => "The great sphere shows the whole hall, hole and bumpers included.",
            Self::Venus => {
                "Venus's mirror shows the lamps: the lowest colour comes first. A wrong tile drops you back to the start."
            }
            Self::Sponza => "The box's own mirror sides show the gates. Red ones, crossed out, throw you back.",
        }
    }
}
