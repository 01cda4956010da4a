//! The systems that make moves of a level into motion: actions in before physics, effects out after it.

use super::{
    action::Action,
    boxes::{BoxLevel, BoxState, Tile},
    cube::{Dir, Hue},
    follow::lean,
    level::Body,
    putt::{aim_direction, shot_speed},
    session::{Move, Outcome, Session, State},
    worlds::{Board, carry_rings},
};
use bevy_app::{App, Plugin, Startup};
use bevy_ecs::prelude::*;
use bevy_transform::components::Transform;
use catoptra_engine::{FixedUpdate, Hidden, MaterialId, MeshId, MeshInstance};
use catoptra_physics_lite::{Motion, PreviousPose, RollingSphere, TippingBox};
use glam::{DVec2, Vec3};
use std::collections::VecDeque;

/// Actions that wait for the body to come to rest; more are forgotten.
const MOST_WAITING: usize = 3;
/// Steps that a box falls, and its fall in metres a step at the end.
const FALL_STEPS: u32 = 36;
/// Steps after which a shot is over, as in the rules.
const MOST_ROLLING: u32 = 1200;

/// The actions of the next fixed step.
#[derive(Resource, Default)]
pub struct Input(pub Vec<Action>);

/// The game in its world.
#[derive(Resource)]
pub struct Game {
    /// Rules, counters, undo.
    pub session: Session,
    /// What is in motion.
    pub phase: Phase,
    /// Actions that wait.
    pub waiting: VecDeque<Action>,
}

/// What is in motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Nothing: the next action can begin.
    Rest,
    /// The box tips; afterwards it rests, tips back, or falls.
    Tipping(Then),
    /// The box falls with the tile that gave way; steps so far.
    Falling([i8; 2], u32),
    /// The ball rolls; steps so far.
    Rolling(u32),
}

/// What follows a tip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Then {
    Rest,
    Back(Dir),
    Fall([i8; 2]),
}

/// The body that the player moves.
#[derive(Component)]
pub struct Player;

/// A thing whose look follows the state.
#[derive(Component, Clone, Copy, Debug)]
pub enum Look {
    /// A tile: its field.
    Tile([i8; 2]),
    /// The one lamp of the donut's game: its meshes by colour.
    Wanted([MeshId; 6]),
    /// A lamp of the statue's row, from 0.
    Lamp(usize),
    /// A part of a gate: its meshes while it is open and shut, where they differ.
    Gate(u8, Option<[MeshId; 2]>),
    /// The putter: a bar from the ball in the direction of the shot.
    Putter,
}

/// Materials that looks change between.
#[derive(Resource, Clone, Debug)]
pub struct Looks {
    /// Shining, by colour.
    pub lit: [MaterialId; 6],
    /// A target, by colour, and one that has had its colour.
    pub target: [MaterialId; 6],
    /// See `target`.
    pub done: [MaterialId; 6],
    /// A lamp that is out.
    pub out: MaterialId,
    /// A gate open and shut.
    pub gate: [MaterialId; 2],
}

/// Adds the systems around the motion.
pub struct GamePlugin;

impl Plugin for GamePlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Input>();
        app.add_systems(FixedUpdate, act.before(Motion));
        app.add_systems(Startup, dress);
        app.add_systems(FixedUpdate, (settle, carry_rings, dress, lean).chain().after(Motion));
    }
}

type Boxes<'w, 's> = Query<'w, 's, (&'static mut TippingBox, &'static mut PreviousPose), With<Player>>;
type Balls<'w, 's> =
    Query<'w, 's, (&'static mut RollingSphere, &'static mut PreviousPose), (With<Player>, Without<TippingBox>)>;

/// Lets the next action begin as soon as nothing moves.
fn act(mut game: ResMut<Game>, mut input: ResMut<Input>, board: Res<Board>, mut boxes: Boxes, mut balls: Balls) {
    let game = &mut *game;
    for action in input.0.drain(..) {
        // Only the last of several aims or strengths in a row counts: a held key would else fill the queue.
        let same = game.waiting.back().is_some_and(|last| {
            matches!((last, action), (Action::Aim(_), Action::Aim(_)) | (Action::Power(_), Action::Power(_)))
        });
        if same {
            game.waiting.pop_back();
        }
        if game.waiting.len() < MOST_WAITING {
            game.waiting.push_back(action);
        }
    }
    if game.phase != Phase::Rest {
        return;
    }
    let Some(action) = game.waiting.pop_front() else { return };
    match action {
        Action::Aim(aim) => game.session.aim = aim,
        Action::Power(power) => game.session.power = power,
        Action::Hint => game.session.ask(),
        Action::Undo | Action::Restart => {
            let changed = match action {
                Action::Undo => game.session.undo(),
                _ => {
                    game.session.restart();
                    true
                }
            };
            if changed {
                place(&game.session, &board, &mut boxes, &mut balls);
            }
        }
        Action::Roll(_) | Action::Putt => {
            if let Some(m) = game.session.move_of(action) {
                begin(game, m, &board, &mut boxes, &mut balls);
            }
        }
        // Another level is another world: `Run` makes it.
        Action::Level(_) => {}
    }
}

/// Plays a move and sets its body in motion.
fn begin(game: &mut Game, m: Move, board: &Board, boxes: &mut Boxes, balls: &mut Balls) {
    let from = game.session.state;
    let outcome = game.session.play(m);
    match (m, outcome) {
        (_, Outcome::Blocked(_)) => {}
        (Move::Roll(dir), _) => {
            let State::Box(from) = from else { return };
            let [dx, dy] = dir.delta();
            let then = match outcome {
                Outcome::ThrownBack(_) => Then::Back(dir.opposite()),
                Outcome::Dropped(_) => Then::Fall([from.at[0] + dx, from.at[1] + dy]),
                _ => Then::Rest,
            };
            for (mut body, _) in boxes {
                let tips = body.tip(board.heading(dir));
                debug_assert!(tips, "the rules let the box go where the world has a wall");
            }
            game.phase = Phase::Tipping(then);
        }
        (Move::Putt(shot), _) => {
            for (mut ball, _) in balls {
                ball.velocity = aim_direction(shot.aim) * shot_speed(shot.power);
            }
            game.phase = Phase::Rolling(0);
        }
    }
}

/// Puts the body where the state says, at rest.
fn place(session: &Session, board: &Board, boxes: &mut Boxes, balls: &mut Balls) {
    match session.state {
        State::Box(state) => {
            for (mut body, mut previous) in boxes {
                lay(&mut body, board, &state);
                // Nothing is shown in between two places that no motion joins.
                previous.0 = body.pose();
            }
        }
        State::Putt(state) => {
            for (mut ball, mut previous) in balls {
                ball.place = state.place();
                ball.velocity = DVec2::ZERO;
                ball.floor = 0.0;
                previous.0 = ball.pose();
            }
        }
    }
}

/// Lays a box down as a state says.
pub fn lay(body: &mut TippingBox, board: &Board, state: &BoxState) {
    let (up, east) = (state.orient.top, board.side_towards_x(state.orient));
    body.lay(board.field(state.at), usize::from(up), usize::from(east));
}

/// Ends what has come to its end.
fn settle(mut game: ResMut<Game>, board: Res<Board>, mut boxes: Boxes, mut balls: Balls) {
    let game = &mut *game;
    match game.phase {
        Phase::Rest => {}
        Phase::Tipping(then) => {
            let Some((mut body, _)) = boxes.iter_mut().next() else { return };
            if body.is_tipping() {
                return;
            }
            game.phase = match then {
                Then::Rest => Phase::Rest,
                Then::Back(dir) => {
                    body.tip(board.heading(dir));
                    Phase::Tipping(Then::Rest)
                }
                Then::Fall(at) => Phase::Falling(at, 0),
            };
        }
        Phase::Falling(at, steps) => {
            if steps < FALL_STEPS {
                for (mut body, _) in &mut boxes {
                    body.start.y = fallen(steps + 1);
                }
                game.phase = Phase::Falling(at, steps + 1);
            } else {
                place(&game.session, &board, &mut boxes, &mut balls);
                game.phase = Phase::Rest;
            }
        }
        Phase::Rolling(steps) => {
            let (State::Putt(state), Body::Putt(level)) = (game.session.state, &game.session.level.body) else {
                return;
            };
            let Some((mut ball, _)) = balls.iter_mut().next() else { return };
            game.phase = Phase::Rolling(steps + 1);
            if level.end_of(&ball).is_some() || steps + 1 >= MOST_ROLLING {
                debug_assert!(level.end_of(&ball).is_none_or(|end| end == state), "world and rules disagree");
                ball.velocity = DVec2::ZERO;
                ball.place = state.place();
                if state.sunk {
                    ball.floor = -1.2 * ball.radius;
                }
                game.phase = Phase::Rest;
            }
        }
    }
}

/// Height of what has fallen for some steps, metres.
fn fallen(steps: u32) -> f32 {
    let seconds = steps as f32 / 60.0;
    -0.5 * 9.81 * seconds * seconds
}

/// Makes everything look as the state says. Waits for motion to end, so that nothing is told before it happens.
fn dress(
    game: Res<Game>,
    board: Res<Board>,
    looks: Res<Looks>,
    mut commands: Commands,
    mut things: Query<(Entity, &Look, &mut MeshInstance, &mut Transform, Option<&Hidden>)>,
) {
    let mut hide = |entity: Entity, now: Option<&Hidden>, hidden: bool| match (now.is_some(), hidden) {
        (false, true) => {
            commands.entity(entity).insert(Hidden);
        }
        (true, false) => {
            commands.entity(entity).remove::<Hidden>();
        }
        _ => {}
    };
    for (entity, look, mut instance, mut transform, hidden) in &mut things {
        let mut wear = |material: MaterialId, mesh: Option<MeshId>| {
            let worn = MeshInstance { material, mesh: mesh.unwrap_or(instance.mesh) };
            instance.set_if_neq(worn);
        };
        match (look, &game.session.level.body, &game.session.state) {
            (Look::Putter, Body::Putt(level), State::Putt(state)) => {
                hide(entity, hidden, game.phase != Phase::Rest || state.sunk);
                transform.set_if_neq(putter(&game.session, state.place(), level.ball.0));
            }
            (Look::Tile(at), Body::Box(level), State::Box(state)) => {
                let drop = match game.phase {
                    Phase::Falling(under, steps) if under == *at => fallen(steps),
                    _ => 0.0,
                };
                let mut place = *transform;
                place.translation.y = board.tile_height() + drop;
                transform.set_if_neq(place);
                if game.phase == Phase::Rest {
                    hide(entity, hidden, level.is_broken(state, *at));
                    if let Tile::Coloured(hue) = level.tile(*at) {
                        wear(tile_look(level, state, *at, hue, &looks), None);
                    }
                }
            }
            (_, Body::Box(level), State::Box(state)) if game.phase == Phase::Rest => match *look {
                Look::Wanted(by_hue) => match level.next(state) {
                    Some(i) => wear(looks.lit[level.order[i] as usize], Some(by_hue[level.order[i] as usize])),
                    None => wear(looks.out, None),
                },
                Look::Lamp(i) => {
                    let burns = level.next(state).is_some_and(|next| i >= next);
                    wear(if burns { looks.lit[level.order[i] as usize] } else { looks.out }, None);
                }
                Look::Gate(gate, meshes) => {
                    let open = level.next(state).is_none_or(|i| level.gates[i] == gate);
                    wear(looks.gate[usize::from(!open)], meshes.map(|m| m[usize::from(!open)]));
                }
                _ => {}
            },
            _ => {}
        }
    }
}

fn tile_look(level: &BoxLevel, state: &BoxState, at: [i8; 2], hue: Hue, looks: &Looks) -> MaterialId {
    let i = hue as usize;
    if level.is_painted(state, at) { looks.done[i] } else { looks.target[i] }
}

/// Pose of the putter, a bar of unit length along its -Z.
fn putter(session: &Session, ball: DVec2, radius: f64) -> Transform {
    let d = aim_direction(session.aim);
    let length = 0.12 + 0.16 * f64::from(session.power);
    let middle = ball + d * (radius * 1.25 + length * 0.5);
    let rotation = glam::Quat::from_rotation_arc(Vec3::NEG_Z, Vec3::new(d.x as f32, 0.0, d.y as f32));
    Transform {
        translation: Vec3::new(middle.x as f32, 0.02, middle.y as f32),
        rotation,
        scale: Vec3::new(1.0, 1.0, length as f32),
    }
}
