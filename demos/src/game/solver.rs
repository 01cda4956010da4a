//! Breadth-first search: the proof that a level can be won, and its par.

use super::{
    level::{Body, Level},
    putt::PuttLevel,
    session::{Move, Outcome, State},
};
use crate::game::Dir;
use std::collections::BTreeMap;

/// States visited before the search gives up.
const MOST_STATES: usize = 400_000;

/// A shortest sequence of moves from `from` that wins the level; `None` where there is none, or none was found among
/// some hundred thousand states. Of equally short ones the first in the order of moves, so the answer is always the same.
pub fn solve(level: &Level, from: &State) -> Option<Vec<Move>> {
    if level.won(from) {
        return Some(Vec::new());
    }
    // (state, how it was reached: place of the state before and the move)
    let mut states: Vec<(State, Option<(usize, Move)>)> = vec![(*from, None)];
    let mut seen: BTreeMap<State, ()> = BTreeMap::from([(*from, ())]);
    let mut at = 0;
    while at < states.len() && states.len() < MOST_STATES {
        let state = states[at].0;
        for m in moves(level, &state) {
            let (next, outcome) = level.play(&state, m);
            if outcome != Outcome::Moved || seen.insert(next, ()).is_some() {
                continue;
            }
            states.push((next, Some((at, m))));
            if level.won(&next) {
                return Some(path(&states));
            }
        }
        at += 1;
    }
    None
}

/// The moves that led to the last state.
fn path(states: &[(State, Option<(usize, Move)>)]) -> Vec<Move> {
    let mut moves = Vec::new();
    let mut at = states.len() - 1;
    while let Some((before, m)) = states[at].1 {
        moves.push(m);
        at = before;
    }
    moves.reverse();
    moves
}

fn moves(level: &Level, _: &State) -> Vec<Move> {
    match level.body {
        Body::Box(_) => Dir::ALL.map(Move::Roll).to_vec(),
        Body::Putt(_) => PuttLevel::shots().map(Move::Putt).collect(),
    }
}
