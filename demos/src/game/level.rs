//! Levels as readable text: what a line means is written here, the levels lie in `demos/levels`.
//!
//! ```text
//! game rolling-box
//! name First steps
//! par 4
//! map                 (box games) far row first: . floor, # stone, S start, ~ cracked, E exit, 1-3 gates,
//! .S.v                r b y v o g red, blue, yellow, violet, orange, green, space: no floor
//! ```
//! Further lines: `order COLOUR..` (donut, statue), `gates N..` and `copper SIDE` (gates; SIDE is top, bottom, north, south,
//! east or west at the start); for putting `area X0 Z0 X1 Z1`, and `ball`, `mirror`, `hole` and `bumper`, each `RADIUS X Z`.

use super::{
    Kind,
    boxes::{BoxLevel, Tile},
    cube::{Hue, Orient},
    putt::{self, PuttLevel},
    session::{Move, Outcome, State},
};
use catoptra_physics_lite::FloorRect;
use glam::DVec2;
use std::sync::Arc;

/// A level of one of the games.
#[derive(Clone, Debug, PartialEq)]
pub struct Level {
    /// Which game.
    pub kind: Kind,
    /// Name for people.
    pub name: String,
    /// Moves of a shortest solution (the tests prove it).
    pub par: u32,
    /// Board or hall.
    pub body: Body,
    /// xxh3-64 of the level's text: what recordings refer to.
    pub layout: u64,
}

/// What is played on.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub enum Body {
    Box(BoxLevel),
    Putt(PuttLevel),
}

/// Why a text is no level.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {why}")]
pub struct LevelError {
    /// Number of the line, from 1.
    pub line: usize,
    /// What is wrong with it.
    pub why: String,
}

macro_rules! texts {
    ($($name:literal),*) => { &[$(include_str!(concat!("../../levels/", $name, ".txt"))),*] };
}

fn texts(kind: Kind) -> &'static [&'static str] {
    match kind {
        Kind::RollingBox => texts!("rolling-box-1", "rolling-box-2", "rolling-box-3", "rolling-box-4"),
        Kind::Donut => texts!("rolling-box-donut-1", "rolling-box-donut-2", "rolling-box-donut-3"),
        Kind::TwoSpheres => texts!("two-spheres-1", "two-spheres-2", "two-spheres-3"),
        Kind::Venus => texts!("rolling-box-venus-1", "rolling-box-venus-2", "rolling-box-venus-3"),
        Kind::Sponza => texts!("rolling-box-sponza-1", "rolling-box-sponza-2", "rolling-box-sponza-3"),
    }
}

/// Number of levels of a game.
pub fn level_count(kind: Kind) -> usize {
    texts(kind).len()
}

/// A level of a game, from 0; `None` beyond the last.
///
/// # Panics
/// Never for the levels that are built in: a test reads them all.
pub fn level(kind: Kind, number: usize) -> Option<Arc<Level>> {
    let text = texts(kind).get(number)?;
    Some(Arc::new(Level::parse(text).expect("the levels that are built in can be read")))
}

impl Level {
    /// Reads a level.
    ///
    /// # Errors
    /// The first line that cannot be understood, or line 0 for what is missing.
    pub fn parse(text: &str) -> Result<Self, LevelError> {
        let fail = |line: usize, why: String| LevelError { line, why };
        let mut lines = text.lines().enumerate().map(|(i, l)| (i + 1, l.trim_end()));
        let (mut kind, mut name, mut par) = (None, None, None);
        let mut parts = Parts::default();
        while let Some((n, line)) = lines.next() {
            if line.is_empty() || line.starts_with("//") {
                continue;
            }
            let (key, rest) = line.split_once(' ').unwrap_or((line, ""));
            match key {
                "game" => kind = Some(Kind::of(rest).ok_or_else(|| fail(n, format!("there is no game {rest:?}")))?),
                "name" => name = Some(rest.to_string()),
                "par" => par = Some(rest.parse().map_err(|_| fail(n, format!("{rest:?} is no number")))?),
                "map" => parts.map = (n, lines.by_ref().map(|(_, l)| l.to_string()).collect()),
                _ => parts.read(key, rest).map_err(|why| fail(n, why))?,
            }
        }
        let kind = kind.ok_or_else(|| fail(0, "no game is named".into()))?;
        let body = match kind {
            Kind::TwoSpheres => Body::Putt(parts.putt().map_err(|why| fail(0, why))?),
            _ => Body::Box(parts.board(kind).map_err(|(line, why)| fail(line, why))?),
        };
        let (name, par) = (name.ok_or_else(|| fail(0, "it has no name".into()))?, par.unwrap_or(0));
        Ok(Self { kind, name, par, body, layout: xxhash_rust::xxh3::xxh3_64(text.as_bytes()) })
    }

    /// The state before the first move.
    pub fn begin(&self) -> State {
        match &self.body {
            Body::Box(b) => State::Box(b.begin()),
            Body::Putt(p) => State::Putt(p.begin()),
        }
    }

    /// True when the level is won.
    pub fn won(&self, state: &State) -> bool {
        match (&self.body, state) {
            (Body::Box(b), State::Box(s)) => b.won(s),
            (Body::Putt(p), State::Putt(s)) => p.won(s),
            _ => false,
        }
    }

    /// The state after a move, and what the move did.
    pub fn play(&self, state: &State, m: Move) -> (State, Outcome) {
        match (&self.body, state, m) {
            (Body::Box(b), State::Box(s), Move::Roll(dir)) => {
                let (next, outcome) = b.play(s, dir);
                (State::Box(next), outcome)
            }
            (Body::Putt(p), State::Putt(s), Move::Putt(shot)) => {
                let (next, outcome) = p.play(s, shot);
                (State::Putt(next), outcome)
            }
            _ => (*state, Outcome::Blocked("that is no move of this game")),
        }
    }
}

type Ball = (f64, DVec2);

#[derive(Default)]
struct Parts {
    map: (usize, Vec<String>),
    order: Vec<Hue>,
    gates: Vec<u8>,
    copper: Option<String>,
    area: Option<FloorRect>,
    ball: Option<Ball>,
    mirror: Option<Ball>,
    hole: Option<Ball>,
    bumpers: Vec<Ball>,
}

impl Parts {
    fn read(&mut self, key: &str, rest: &str) -> Result<(), String> {
        let words = rest.split_whitespace();
        let numbers = || -> Result<Vec<f64>, String> {
            let read = |w: &str| w.parse::<f64>().ok().filter(|v| v.is_finite()).ok_or(format!("{w:?} is no number"));
            rest.split_whitespace().map(read).collect()
        };
        let ball = || match numbers()?[..] {
            [radius, x, z] if radius > 0.0 => Ok((radius, DVec2::new(x, z))),
            _ => Err("it takes a radius over 0, x and z".to_string()),
        };
        match key {
            "order" => {
                let hue = |w: &str| Hue::of(w).ok_or(format!("there is no colour {w:?}"));
                self.order = words.map(hue).collect::<Result<_, _>>()?;
            }
            "gates" => {
                let gate = |w: &str| w.parse().map_err(|_| format!("there is no gate {w:?}"));
                self.gates = words.map(gate).collect::<Result<_, _>>()?;
            }
            "copper" => self.copper = Some(rest.to_string()),
            "area" => match numbers()?[..] {
                [x0, z0, x1, z1] if x0 < x1 && z0 < z1 => {
                    self.area = Some(FloorRect { min: [x0 as f32, z0 as f32], max: [x1 as f32, z1 as f32] });
                }
                _ => return Err("it takes x0 z0 x1 z1, rising".into()),
            },
            "ball" => self.ball = Some(ball()?),
            "mirror" => self.mirror = Some(ball()?),
            "hole" => self.hole = Some(ball()?),
            "bumper" => self.bumpers.push(ball()?),
            _ => return Err(format!("{key:?} means nothing here")),
        }
        Ok(())
    }

    fn putt(self) -> Result<PuttLevel, String> {
        let area = self.area.ok_or("it has no area")?;
        let ball = self.ball.ok_or("it has no ball")?;
        let mirror = self.mirror.ok_or("it has no mirror")?;
        let hole = self.hole.ok_or("it has no hole")?;
        Ok(putt::PuttLevel { area, ball, mirror, bumpers: self.bumpers, hole })
    }

    fn board(self, kind: Kind) -> Result<BoxLevel, (usize, String)> {
        let (first, rows) = self.map;
        let columns = rows.iter().map(|r| r.chars().count()).max().unwrap_or(0);
        if columns == 0 || columns > 32 || rows.len() > 32 {
            return Err((first, "the map must have 1 to 32 rows and columns".into()));
        }
        let (mut tiles, mut start) = (Vec::new(), None);
        for (r, row) in rows.iter().enumerate() {
            let letters = row.chars().chain(std::iter::repeat(' ')).take(columns);
            for (c, letter) in letters.enumerate() {
                tiles.push(match letter {
                    ' ' => Tile::Void,
                    '#' => Tile::Block,
                    '.' => Tile::Floor,
                    '~' => Tile::Cracked,
                    'E' => Tile::Exit,
                    '1'..='3' => Tile::Gate(letter as u8 - b'0'),
                    'S' => {
                        start = Some([c as i8, r as i8]);
                        Tile::Floor
                    }
                    other => match Hue::of_letter(other) {
                        Some(hue) => Tile::Coloured(hue),
                        None => return Err((first + 1 + r, format!("{other:?} is no field"))),
                    },
                });
            }
        }
        let count = |same: fn(&Tile) -> bool| tiles.iter().filter(|t| same(t)).count();
        if count(|t| matches!(t, Tile::Coloured(_))) > 31 && kind == Kind::RollingBox
            || count(|t| *t == Tile::Cracked) > 64
        {
            return Err((first, "there are more than 31 targets or 64 cracked tiles".into()));
        }
        let start = start.ok_or((first, "the map has no start".to_string()))?;
        // In the atrium the viewer looks along -X, elsewhere along -Z.
        let orient = match kind {
            Kind::Sponza => Orient { top: 3, north: 0, east: 4 },
            _ => Orient { top: 3, north: 4, east: 1 },
        };
        let copper = match self.copper.as_deref() {
            None => None,
            Some("top") => Some(orient.top),
            Some("north") => Some(orient.north),
            Some("south") => Some(orient.north ^ 1),
            Some("east") => Some(orient.east),
            Some("west") => Some(orient.east ^ 1),
            Some(other) => return Err((0, format!("copper cannot lie at {other:?}"))),
        };
        let size = [columns as i8, rows.len() as i8];
        Ok(BoxLevel { kind, size, tiles, start, orient, order: self.order, gates: self.gates, copper })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_levels_can_be_read_and_each_game_has_three() {
        for kind in Kind::ALL {
            assert!(level_count(kind) >= 3);
            for n in 0..level_count(kind) {
                let level = level(kind, n).unwrap();
                assert_eq!(level.kind, kind);
                assert!(!level.won(&level.begin()));
            }
            assert!(level(kind, level_count(kind)).is_none());
        }
    }

    #[test]
    fn garbled_levels_name_the_line() {
        let told = |text: &str| Level::parse(text).unwrap_err().to_string();
        assert!(told("").contains("no game"));
        assert!(told("game chess").starts_with("line 1"));
        assert!(told("game rolling-box\nname x\nmap\n.S?").starts_with("line 4"));
        assert!(told("game rolling-box\nname x\nmap\n...").contains("no start"));
        assert!(told("game two-spheres\nname x\nball 0 1 1").starts_with("line 3"));
        assert!(told("game two-spheres\nname x\narea 0 0 1 nan").contains("no number"));
    }
}
