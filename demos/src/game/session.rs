//! One try at a level: the state, the way back, and what is counted.

use super::{
    action::Action,
    boxes::BoxState,
    cube::Dir,
    level::{Body, Level},
    putt::{AIMS, PuttState, Shot},
    solver,
};
use std::sync::Arc;

/// Where a game stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs)]
pub enum State {
    Box(BoxState),
    Putt(PuttState),
}

/// One move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[allow(missing_docs)]
pub enum Move {
    Roll(Dir),
    Putt(Shot),
}

impl std::fmt::Display for Move {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Roll(dir) => {
                write!(
                    f,
                    "tip the box {}",
                    ["away from you", "to the right", "towards you", "to the left"][*dir as usize]
                )
            }
            Self::Putt(shot) => write!(f, "aim {} with strength {}", shot.aim, shot.power),
        }
    }
}

/// What a move did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The game went on.
    Moved,
    /// Nothing: the reason.
    Blocked(&'static str),
    /// The box went there and came back.
    ThrownBack(&'static str),
    /// The box fell and begins again.
    Dropped(&'static str),
}

/// A try at a level.
#[derive(Clone, Debug)]
pub struct Session {
    /// The level.
    pub level: Arc<Level>,
    /// Where it stands.
    pub state: State,
    /// States before, for undo.
    past: Vec<State>,
    /// Moves of the line that is played, thrown back and dropped ones included.
    pub moves: u32,
    /// Moves taken back.
    pub undos: u32,
    /// Hints asked for.
    pub hints: u32,
    /// Times thrown back or dropped.
    pub slips: u32,
    /// Direction of the putter.
    pub aim: u8,
    /// Strength of the stroke.
    pub power: u8,
    /// The next move of a shortest solution, while it is shown.
    pub hint: Option<Move>,
    /// What the last action led to, for the player.
    pub message: String,
}

impl Session {
    /// A first try.
    pub fn new(level: Arc<Level>) -> Self {
        let state = level.begin();
        Self {
            level,
            state,
            past: Vec::new(),
            moves: 0,
            undos: 0,
            hints: 0,
            slips: 0,
            aim: 0,
            power: 3,
            hint: None,
            message: String::new(),
        }
    }

    /// True when the level is won.
    pub fn won(&self) -> bool {
        self.level.won(&self.state)
    }

    /// True where there is a move to take back.
    pub fn can_undo(&self) -> bool {
        !self.past.is_empty()
    }

    /// Stars of a won level: one for winning, one for par, one for no help and no slip on the way.
    pub fn stars(&self) -> u32 {
        if !self.won() {
            return 0;
        }
        let par = self.moves <= self.level.par;
        1 + u32::from(par) + u32::from(par && self.undos + self.hints + self.slips == 0)
    }

    /// Plays a move. A won level takes none.
    pub fn play(&mut self, m: Move) -> Outcome {
        if self.won() {
            return Outcome::Blocked("the level is won");
        }
        let (next, outcome) = self.level.play(&self.state, m);
        self.message.clear();
        match outcome {
            Outcome::Blocked(why) => {
                self.message = why.into();
                return outcome;
            }
            Outcome::ThrownBack(why) | Outcome::Dropped(why) => {
                self.message = why.into();
                self.slips += 1;
            }
            Outcome::Moved => {}
        }
        self.hint = None;
        self.past.push(self.state);
        self.state = next;
        self.moves += 1;
        outcome
    }

    /// Takes the last move back; the counter of moves goes with it, that of undos remembers.
    pub fn undo(&mut self) -> bool {
        let Some(before) = self.past.pop() else { return false };
        self.state = before;
        self.moves -= 1;
        self.undos += 1;
        self.hint = None;
        self.message.clear();
        true
    }

    /// Begins again; help that was asked for stays counted, or a solution could be read off and played as one's own.
    pub fn restart(&mut self) {
        let (undos, hints, slips) = (0, self.hints, 0);
        *self = Self { undos, hints, slips, ..Self::new(self.level.clone()) };
    }

    /// Shows the next move of a shortest solution, or says that there is none.
    pub fn ask(&mut self) {
        if self.won() || self.hint.is_some() {
            return;
        }
        self.hints += 1;
        let solution = solver::solve(&self.level, &self.state);
        self.hint = solution.and_then(|s| s.first().copied());
        self.message = match self.hint {
            Some(m) => format!("hint: {m}"),
            None => "no way leads on from here: take moves back or restart".into(),
        };
        if let Some(Move::Putt(shot)) = self.hint {
            (self.aim, self.power) = (shot.aim, shot.power);
        }
    }

    /// The move that an action stands for here.
    pub fn move_of(&self, action: Action) -> Option<Move> {
        match (action, &self.level.body) {
            (Action::Roll(dir), Body::Box(_)) => Some(Move::Roll(dir)),
            (Action::Putt, Body::Putt(_)) => Some(Move::Putt(Shot { aim: self.aim % AIMS, power: self.power })),
            _ => None,
        }
    }
}
