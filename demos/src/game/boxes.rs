//! The rules of the four games in which a box tips over a board.

use super::{
    Kind,
    cube::{Dir, Hue, Orient},
    session::Outcome,
};

/// One field of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tile {
    /// Nothing: the board ends here.
    Void,
    /// A block of stone.
    Block,
    /// Plain floor.
    Floor,
    /// Breaks when the box leaves it.
    Cracked,
    /// Coloured: a target, a pad or a step, as the game has it.
    Coloured(Hue),
    /// Where the box leaves the board.
    Exit,
    /// A gate, from 1.
    Gate(u8),
}

/// A board and what is asked on it.
#[derive(Clone, Debug, PartialEq)]
pub struct BoxLevel {
    /// Which game's rules hold.
    pub kind: Kind,
    /// Columns and rows; row 0 is the farthest from the viewer.
    pub size: [i8; 2],
    /// `[row][column]`.
    pub tiles: Vec<Tile>,
    /// Column and row where the box begins.
    pub start: [i8; 2],
    /// How it lies there.
    pub orient: Orient,
    /// Colours (donut, statue) in the order in which they are asked.
    pub order: Vec<Hue>,
    /// Gates in the order in which they open.
    pub gates: Vec<u8>,
    /// The box's copper side.
    pub copper: Option<u8>,
}

/// Where a box game stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BoxState {
    /// Column and row of the box.
    pub at: [i8; 2],
    /// How it lies.
    pub orient: Orient,
    /// Targets that have had their colour, as bits by number of the target; elsewhere how much of the order is done.
    pub progress: u32,
    /// Broken tiles, as bits by number of the cracked tile.
    pub broken: u64,
}

impl BoxLevel {
    /// The state before the first move.
    pub fn begin(&self) -> BoxState {
        BoxState { at: self.start, orient: self.orient, progress: 0, broken: 0 }
    }

    /// The field at a column and row; void outside the board.
    pub fn tile(&self, at: [i8; 2]) -> Tile {
        let inside = (0..2).all(|i| (0..self.size[i]).contains(&at[i]));
        if inside { self.tiles[self.index(at)] } else { Tile::Void }
    }

    /// Place of a field of the board in `tiles`.
    pub fn index(&self, at: [i8; 2]) -> usize {
        at[1] as usize * self.size[0] as usize + at[0] as usize
    }

    /// All fields with their column and row.
    pub fn fields(&self) -> impl Iterator<Item = ([i8; 2], Tile)> {
        self.tiles.iter().enumerate().map(|(i, &tile)| {
            let columns = self.size[0] as usize;
            ([(i % columns) as i8, (i / columns) as i8], tile)
        })
    }

    /// Number of a field among those of its kind that `same` picks: its bit in the state.
    fn bit(&self, at: [i8; 2], same: impl Fn(Tile) -> bool) -> u32 {
        self.tiles[..self.index(at)].iter().filter(|t| same(**t)).count() as u32
    }

    /// True where the tile at `at` has broken.
    pub fn is_broken(&self, state: &BoxState, at: [i8; 2]) -> bool {
        self.tile(at) == Tile::Cracked && state.broken >> self.bit(at, |t| t == Tile::Cracked) & 1 == 1
    }

    /// True where the target at `at` has had its colour.
    pub fn is_painted(&self, state: &BoxState, at: [i8; 2]) -> bool {
        self.kind == Kind::RollingBox && state.progress >> self.bit(at, is_coloured) & 1 == 1
    }

    /// What is asked next: its place in `order` or `gates`; `None` when all is done.
    pub fn next(&self, state: &BoxState) -> Option<usize> {
        let asked = self.order.len().max(self.gates.len());
        ((state.progress as usize) < asked).then_some(state.progress as usize)
    }

    /// True when nothing is left to do.
    pub fn won(&self, state: &BoxState) -> bool {
        match self.kind {
            Kind::RollingBox => {
                let targets = self.tiles.iter().filter(|t| is_coloured(**t)).count() as u32;
                state.progress == (1u32 << targets) - 1
            }
            Kind::Venus => self.tile(state.at) == Tile::Exit,
            _ => self.next(state).is_none(),
        }
    }

    /// Tips the box. A blocked move changes nothing and does not count.
    pub fn play(&self, state: &BoxState, dir: Dir) -> (BoxState, Outcome) {
        let [dx, dy] = dir.delta();
        let at = [state.at[0] + dx, state.at[1] + dy];
        let tile = self.tile(at);
        if matches!(tile, Tile::Void | Tile::Block) || self.is_broken(state, at) {
            return (*state, Outcome::Blocked("there is no way"));
        }
        let mut next = BoxState { at, orient: state.orient.rolled(dir), ..*state };
        if self.copper.is_some_and(|side| next.orient.bottom() == side) {
            return (*state, Outcome::Blocked("copper would touch the stone"));
        }
        if self.tile(state.at) == Tile::Cracked {
            next.broken |= 1 << self.bit(state.at, |t| t == Tile::Cracked);
        }
        let wanted = self.next(state);
        match (self.kind, tile) {
            (Kind::RollingBox, Tile::Coloured(hue)) if next.orient.top == hue as u8 => {
                next.progress |= 1 << self.bit(at, is_coloured);
            }
            (Kind::Donut, Tile::Coloured(hue)) => match wanted {
                Some(i) if self.order[i] == hue => next.progress += 1,
                // Pads that have had their turn are floor.
                i if self.order[..i.unwrap_or(self.order.len())].contains(&hue) => {}
                _ => return (*state, Outcome::ThrownBack("not the colour that glows")),
            },
            (Kind::Venus, Tile::Coloured(hue)) => match wanted {
                Some(i) if self.order[i] == hue => next.progress += 1,
                i if i.unwrap_or(self.order.len()).checked_sub(1).is_some_and(|last| self.order[last] == hue) => {}
                _ => return (self.begin(), Outcome::Dropped("the wrong colour gave way")),
            },
            (Kind::Venus, Tile::Exit) if wanted.is_some() => {
                return (*state, Outcome::ThrownBack("the way out opens after the last colour"));
            }
            (Kind::Sponza, Tile::Gate(gate)) => match wanted {
                Some(i) if self.gates[i] == gate => next.progress += 1,
                _ => return (*state, Outcome::ThrownBack("that gate is shut")),
            },
            _ => {}
        }
        (next, Outcome::Moved)
    }
}

fn is_coloured(tile: Tile) -> bool {
    matches!(tile, Tile::Coloured(_))
}
