//! The games: every level can be won, par is its shortest way, the world does what the rules say, and the shipped recordings
//! come to the same bits on any number of threads.
//!
//! `CATOPTRA_UPDATE_GOLDENS=1` writes `demos/replays/*.replay` anew from the solver's moves.

use catoptra_demos::game::{
    Action, Body, Kind, Level, Move, Outcome, Recording, Run, State, level, level_count, replay, solver,
};
use std::{collections::BTreeSet, path::PathBuf, sync::Arc};

fn levels() -> Vec<(Kind, usize, Arc<Level>)> {
    let numbered = |kind| (0..level_count(kind)).map(move |n| (kind, n, level(kind, n).expect("it is counted")));
    Kind::ALL.into_iter().flat_map(numbered).collect()
}

fn path(kind: Kind, number: usize) -> PathBuf {
    let file = format!("{}-{}.replay", kind.name(), number + 1);
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("replays").join(file)
}

/// The actions that a move takes.
fn actions(m: Move) -> Vec<Action> {
    match m {
        Move::Roll(dir) => vec![Action::Roll(dir)],
        Move::Putt(shot) => vec![Action::Aim(shot.aim), Action::Power(shot.power), Action::Putt],
    }
}

/// Steps with nothing to do until all is at rest; at most a minute.
fn rest(run: &mut Run, recording: &mut Recording) {
    for _ in 0..3600 {
        recording.push(&[]);
        run.step(&[]);
        if run.at_rest() {
            return;
        }
    }
    panic!("the world does not come to rest");
}

/// Plays the solver's moves in the world and checks it against the rules after each.
fn win(kind: Kind, number: usize) -> (Run, Recording) {
    let mut run = Run::new(kind, number).unwrap();
    let mut recording = Recording::begin(kind, number).unwrap();
    let level = run.level().clone();
    let mut state = level.begin();
    for m in solver::solve(&level, &state).unwrap() {
        let now = actions(m);
        recording.push(&now);
        run.step(&now);
        rest(&mut run, &mut recording);
        state = level.play(&state, m).0;
        assert_eq!(run.session().state, state, "{} {}: after {m}", kind.name(), number + 1);
        body_lies_as_told(&mut run);
    }
    for _ in 0..30 {
        recording.push(&[]);
        run.step(&[]);
    }
    (run, recording)
}

/// The drawn body is where the state says, lying as the state says.
fn body_lies_as_told(run: &mut Run) {
    use catoptra_physics_lite::{RollingSphere, TippingBox};
    let (state, level) = (run.session().state, run.level().clone());
    let world = run.app_mut().world_mut();
    match (state, &level.body) {
        (State::Box(state), Body::Box(board)) => {
            let body = world.query::<&TippingBox>().single(world).unwrap();
            assert_eq!(body.side_towards(3), usize::from(state.orient.top));
            assert_eq!(body.side_towards(2), usize::from(state.orient.bottom()));
            // A step to the east is a step along the drawn board, too.
            let step = body.pose().translation - body.half.y * glam::Vec3::Y;
            let cells = (f32::from(state.at[0] - board.start[0]), f32::from(state.at[1] - board.start[1]));
            let moved = glam::Vec2::new(cells.0, cells.1).length() * body.half.x * 2.0;
            let start = {
                let fresh = Run::new(level.kind, run.number()).unwrap();
                let mut fresh = fresh;
                let w = fresh.app_mut().world_mut();
                let b = w.query::<&TippingBox>().single(w).unwrap();
                b.pose().translation - b.half.y * glam::Vec3::Y
            };
            assert!(((step - start).length() - moved).abs() < 1e-3, "{step} {start} {cells:?}");
        }
        (State::Putt(state), Body::Putt(_)) => {
            let mut balls = world.query::<&RollingSphere>();
            let places: Vec<_> = balls.iter(world).map(|b| b.place).collect();
            assert!(places.contains(&state.place()));
        }
        _ => panic!("a state of another game"),
    }
}

#[test]
fn every_level_can_be_won_and_par_is_its_shortest_way() {
    for (kind, n, level) in levels() {
        let solution = solver::solve(&level, &level.begin());
        let solution = solution.unwrap_or_else(|| panic!("{} {}: no way wins", kind.name(), n + 1));
        assert_eq!(solution.len() as u32, level.par, "par of {} {}", kind.name(), n + 1);
        // The moves do win, each is one that moves, and no state on the way has won.
        let mut state = level.begin();
        for m in &solution {
            assert!(!level.won(&state));
            let (next, outcome) = level.play(&state, *m);
            assert_eq!(outcome, Outcome::Moved);
            state = next;
        }
        assert!(level.won(&state));
    }
}

/// Nothing shorter than par: all states that fewer moves reach, by plain enumeration instead of the solver's search.
#[test]
fn no_shorter_way_wins() {
    for (kind, n, level) in levels() {
        let Body::Box(_) = level.body else {
            // Two shots are 102,400 pairs; the first of them alone must not win where par is 2.
            let first = catoptra_demos::game::PuttLevel::shots();
            let wins = first.filter(|s| level.won(&level.play(&level.begin(), Move::Putt(*s)).0)).count();
            assert_eq!(wins > 0, level.par == 1, "{} {}", kind.name(), n + 1);
            continue;
        };
        let mut reached = BTreeSet::from([level.begin()]);
        for moves in 0..level.par {
            assert!(!reached.iter().any(|s| level.won(s)), "{} {} is won by {moves} moves", kind.name(), n + 1);
            // Thrown back and dropped boxes count as well: they are moves.
            let next = reached
                .iter()
                .flat_map(|s| catoptra_demos::game::Dir::ALL.map(|d| level.play(s, Move::Roll(d)).0))
                .collect::<Vec<_>>();
            reached.extend(next);
        }
        assert!(reached.iter().any(|s| level.won(s)));
    }
}

#[test]
fn shipped_recordings_win_and_come_to_the_same_bits_on_any_thread_count() {
    let update = std::env::var_os("CATOPTRA_UPDATE_GOLDENS").is_some();
    for (kind, n, level) in levels() {
        let path = path(kind, n);
        if update {
            let (_, mut recording) = win(kind, n);
            let end = replay(&recording, 1).unwrap();
            (recording.state, recording.frame) = (Some(end.state), Some(end.frame));
            std::fs::write(&path, recording.to_string()).unwrap();
        }
        let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let recording = Recording::parse(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        for threads in [1, 2] {
            let end = replay(&recording, threads).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            assert!(end.won && end.moves == level.par, "{}: {end:?}", path.display());
            let told = (recording.state, recording.frame);
            assert_eq!(told, (Some(end.state), Some(end.frame)), "{} on {threads} threads", path.display());
        }
        // Without its last action it does not win, and both hashes see that.
        let mut other = recording.clone();
        other.actions.pop();
        let end = replay(&other, 0).unwrap();
        assert!(!end.won && Some(end.state) != recording.state && Some(end.frame) != recording.frame);
    }
}

#[test]
fn the_world_follows_the_rules_and_undo_goes_all_the_way_back() {
    for (kind, n, level) in levels() {
        let (mut run, mut recording) = win(kind, n);
        assert!(run.session().won() && run.session().stars() == 3, "{} {}", kind.name(), n + 1);
        while run.session().can_undo() {
            run.step(&[Action::Undo]);
            rest(&mut run, &mut recording);
        }
        assert_eq!((run.session().state, run.session().moves), (level.begin(), 0));
        assert_eq!(run.session().undos, level.par);
        body_lies_as_told(&mut run);
    }
}

/// Random keys: the world never leaves the rules, and the same keys give the same bits.
#[test]
fn any_keys_give_the_same_state_twice() {
    let mut random = 0x9E37_79B9_7F4A_7C15u64;
    let mut next = move |n: u64| {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        random % n
    };
    for kind in Kind::ALL {
        let mut recording = Recording::begin(kind, 0).unwrap();
        let mut run = Run::new(kind, 0).unwrap();
        for _ in 0..2400 {
            let mut now = Vec::new();
            if next(12) == 0 {
                now.push(match next(14) {
                    0 => Action::Undo,
                    1 if next(8) == 0 => Action::Restart,
                    2 if next(8) == 0 => Action::Level(next(4) as usize),
                    3 => Action::Aim(next(64) as u8),
                    4 => Action::Power(1 + next(5) as u8),
                    5 => Action::Putt,
                    i => Action::Roll(catoptra_demos::game::Dir::ALL[i as usize % 4]),
                });
            }
            recording.push(&now);
            run.step(&now);
        }
        let again = Recording::parse(&recording.to_string()).unwrap();
        let (a, b) = (replay(&again, 2).unwrap(), replay(&again, 1).unwrap());
        assert_eq!(a, b);
        assert_eq!(a.state, run.state_hash(), "{}: played and replayed", kind.name());
    }
}

#[test]
fn a_changed_level_refuses_old_recordings() {
    let mut recording = Recording::begin(Kind::Venus, 0).unwrap();
    recording.layout ^= 1;
    assert!(replay(&recording, 1).unwrap_err().to_string().contains("has changed"));
}
