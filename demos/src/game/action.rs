//! What a player can do to the world, whatever key or pointer it came from.

use super::{
    cube::Dir,
    putt::{AIMS, POWERS},
};

/// One action. Actions are all that a recording holds and all that changes a game's world.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Tip the box.
    Roll(Dir),
    /// Point the putter in one of the directions.
    Aim(u8),
    /// Set the strength of the stroke.
    Power(u8),
    /// Strike the ball.
    Putt,
    /// Take the last move back.
    Undo,
    /// Begin the level again.
    Restart,
    /// Show the next move of a shortest solution.
    Hint,
    /// Go to a level, from 0.
    Level(usize),
}

impl std::fmt::Display for Action {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Roll(dir) => write!(f, "roll {}", dir.name()),
            Self::Aim(aim) => write!(f, "aim {aim}"),
            Self::Power(power) => write!(f, "power {power}"),
            Self::Putt => write!(f, "putt"),
            Self::Undo => write!(f, "undo"),
            Self::Restart => write!(f, "restart"),
            Self::Hint => write!(f, "hint"),
            Self::Level(n) => write!(f, "level {}", n + 1),
        }
    }
}

impl Action {
    /// Reads what `Display` writes.
    pub fn parse(text: &str) -> Option<Self> {
        let (verb, rest) = text.split_once(' ').unwrap_or((text, ""));
        let action = match verb {
            "roll" => Self::Roll(Dir::ALL.into_iter().find(|d| d.name() == rest)?),
            "aim" => Self::Aim(rest.parse().ok().filter(|a| *a < AIMS)?),
            "power" => Self::Power(rest.parse().ok().filter(|p| (1..=POWERS).contains(p))?),
            "level" => Self::Level(rest.parse::<usize>().ok()?.checked_sub(1)?),
            "putt" => Self::Putt,
            "undo" => Self::Undo,
            "restart" => Self::Restart,
            "hint" => Self::Hint,
            _ => return None,
        };
        // What takes no word has none, and numbers have one spelling.
        (action.to_string() == text).then_some(action)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_come_back() {
        let all = [
            Action::Roll(Dir::West),
            Action::Aim(63),
            Action::Power(5),
            Action::Putt,
            Action::Undo,
            Action::Restart,
            Action::Hint,
            Action::Level(2),
        ];
        for action in all {
            assert_eq!(Action::parse(&action.to_string()), Some(action));
        }
        for bad in ["", "roll", "roll up", "aim 64", "aim -1", "power 0", "putt 3", "level 0", "aim 07", "Roll west"] {
            assert_eq!(Action::parse(bad), None, "{bad}");
        }
    }
}
