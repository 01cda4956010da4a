//! Directions on the board, the six colours, and how a box lies.

/// A direction on the board: north is away from the viewer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs)]
pub enum Dir {
    North,
    East,
    South,
    West,
}

impl Dir {
    /// All four, clockwise.
    pub const ALL: [Self; 4] = [Self::North, Self::East, Self::South, Self::West];

    /// Change of (column, row); rows count towards the viewer.
    pub fn delta(self) -> [i8; 2] {
        match self {
            Self::North => [0, -1],
            Self::East => [1, 0],
            Self::South => [0, 1],
            Self::West => [-1, 0],
        }
    }

    /// The way back.
    pub fn opposite(self) -> Self {
        Self::ALL[(self as usize + 2) % 4]
    }

    /// Name in levels and recordings.
    pub fn name(self) -> &'static str {
        ["north", "east", "south", "west"][self as usize]
    }
}

/// A colour of the six-coloured box; its number is that of the box's side: -X, +X, -Y, +Y, -Z, +Z.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs)]
pub enum Hue {
    Red,
    Blue,
    Yellow,
    Violet,
    Orange,
    Green,
}

impl Hue {
    /// All six by side.
    pub const ALL: [Self; 6] = [Self::Red, Self::Blue, Self::Yellow, Self::Violet, Self::Orange, Self::Green];

    /// Name in levels and texts.
    pub fn name(self) -> &'static str {
        ["red", "blue", "yellow", "violet", "orange", "green"][self as usize]
    }

    /// The colour of a name.
    pub fn of(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|h| h.name() == name)
    }

    /// The colour of its initial, as on a level's map.
    pub fn of_letter(letter: char) -> Option<Self> {
        Self::ALL.into_iter().find(|h| h.name().starts_with(letter))
    }
}

/// How a box lies: which of its sides (numbered as [`Hue`]; opposite sides differ in the last bit) look where.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Orient {
    /// The side on top.
    pub top: u8,
    /// The side that looks away from the viewer.
    pub north: u8,
    /// The side that looks to the right.
    pub east: u8,
}

impl Orient {
    /// The side on the floor.
    pub fn bottom(self) -> u8 {
        self.top ^ 1
    }

    /// As it lies after a quarter turn about the bottom edge in that direction: what was on top looks there.
    pub fn rolled(self, dir: Dir) -> Self {
        match dir {
            Dir::North => Self { top: self.north ^ 1, north: self.top, ..self },
            Dir::South => Self { top: self.north, north: self.top ^ 1, ..self },
            Dir::East => Self { top: self.east ^ 1, east: self.top, ..self },
            Dir::West => Self { top: self.east, east: self.top ^ 1, ..self },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_rolls_and_there_and_back_change_nothing() {
        let start = Orient { top: 3, north: 4, east: 1 };
        for dir in Dir::ALL {
            assert_eq!(start.rolled(dir).rolled(dir.opposite()), start);
            assert_eq!((0..4).fold(start, |o, _| o.rolled(dir)), start);
            assert_ne!(start.rolled(dir), start);
        }
        // A box has 24 ways to lie, and rolling reaches all of them.
        let mut all = std::collections::BTreeSet::from([start]);
        loop {
            let more: Vec<_> = all.iter().flat_map(|o| Dir::ALL.map(|d| o.rolled(d))).collect();
            let before = all.len();
            all.extend(more);
            if all.len() == before {
                break;
            }
        }
        assert_eq!(all.len(), 24);
    }
}
