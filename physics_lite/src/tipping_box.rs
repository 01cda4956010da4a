//! A rigid box that turns about its bottom edge under gravity.
//!
//! About an edge at distance r from the centre a cuboid has the moment of inertia 4/3 m r² (Steiner: m r²/3 + m r²), so
//! the angle φ of its centre from the vertical obeys φ'' = 3g/(4r) sin φ: an inverted pendulum. A kick lifts it over its
//! balance point; it falls, lands inelastically on the next face, rests a while, and is kicked again. At walls and
//! obstacles it turns.

use crate::{DT, GRAVITY, quat_of};
use bevy_ecs::prelude::*;
use bevy_transform::components::Transform;
use catoptra_engine::{StableId, math};
use glam::{DVec3, Mat3, Vec3};
use std::f64::consts::FRAC_PI_2;

/// Axis-aligned rectangle on the floor, metres, world x and z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FloorRect {
    /// Least x and z.
    pub min: [f32; 2],
    /// Greatest x and z.
    pub max: [f32; 2],
}

impl FloorRect {
    fn contains(&self, o: &Self) -> bool {
        // A box that exactly touches its wall is inside, whatever the last bit says.
        let e = 1e-4;
        (0..2).all(|i| o.min[i] >= self.min[i] - e && o.max[i] <= self.max[i] + e)
    }
    fn overlaps(&self, o: &Self) -> bool {
        let e = 1e-4;
        (0..2).all(|i| o.min[i] < self.max[i] - e && o.max[i] > self.min[i] + e)
    }
}

/// Where a box goes when the way ahead is blocked: the first free direction of the list; if all are blocked it rests.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TurnRule {
    /// Left, right, back: circles a free room.
    #[default]
    Left,
    /// Right, left, back.
    Right,
    /// Back only: stays in its lane.
    Back,
    /// Nowhere by itself: it rests until [`TippingBox::tip`] is called.
    Wait,
}

/// Directions of travel, counter-clockwise seen from above: +X, -Z, -X, +Z.
const DIRECTIONS: [[i32; 2]; 4] = [[1, 0], [0, -1], [-1, 0], [0, 1]];

/// Steps of the integrator in one fixed step.
const SUBSTEPS: u32 = 8;

/// A tipping box. Its place is a sum of whole half extents and its orientation a signed permutation, both kept as
/// integers, so at rest it lies on an exact lattice after any number of steps.
#[derive(Component, Clone, Debug, PartialEq)]
#[require(Transform)]
pub struct TippingBox {
    /// Half extents in the box's own space, metres, over 0.
    pub half: Vec3,
    /// Bottom centre at the start, world.
    pub start: Vec3,
    /// Where its footprint must stay.
    pub area: FloorRect,
    /// Footprints that it must not enter.
    pub obstacles: Vec<FloorRect>,
    /// What it does at a wall.
    pub turn: TurnRule,
    /// Energy of the kick as a multiple of what reaches the balance point, over 1. Higher: faster tipping.
    pub kick: f64,
    /// Whole steps of rest between a landing and the next kick.
    pub rest_steps: u32,
    heading: usize,
    /// Columns of the lattice rotation: image of box axis i is `sign` times world axis `axis`.
    lattice: [(usize, i32); 3],
    /// World x and z of the centre: half extents · these numbers, added to `start`.
    place: [[i64; 3]; 2],
    angle: f64,
    rate: f64,
    tipping: bool,
    rest_left: u32,
    quarter_turns: i64,
}

impl TippingBox {
    /// A box at rest with its own axes along the world's, heading for +X (0), -Z (1), -X (2) or +Z (3).
    pub fn new(half: Vec3, start: Vec3, area: FloorRect, heading: usize) -> Self {
        assert!(half.min_element() > 0.0, "half extents must be over 0");
        Self {
            half,
            start,
            area,
            obstacles: Vec::new(),
            turn: TurnRule::Left,
            kick: 1.3,
            rest_steps: 6,
            heading: heading % 4,
            lattice: [(0, 1), (1, 1), (2, 1)],
            place: [[0; 3]; 2],
            angle: 0.0,
            rate: 0.0,
            tipping: false,
            rest_left: 0,
            quarter_turns: 0,
        }
    }

    /// True while it stands on an edge.
    pub fn is_tipping(&self) -> bool {
        self.tipping
    }
    /// Angle turned about the current edge, radians in [0, π/2).
    pub fn angle(&self) -> f64 {
        self.angle
    }
    /// Rate of turning, radians per second, ≥ 0 unless it falls back.
    pub fn rate(&self) -> f64 {
        self.rate
    }
    /// World direction of travel, unit, in the floor's plane.
    pub fn direction(&self) -> Vec3 {
        let d = DIRECTIONS[self.heading];
        Vec3::new(d[0] as f32, 0.0, d[1] as f32)
    }
    /// Landings so far minus those made in the directions -X and -Z: whole quarter turns of rolling along its line.
    pub fn quarter_turns(&self) -> i64 {
        self.quarter_turns
    }
    /// Kinetic plus potential energy per unit of mass about the current edge, J/kg, zero level at the floor.
    pub fn energy(&self) -> f64 {
        let (a, b) = self.section();
        let r = (a * a + b * b).sqrt();
        let phi = self.angle - angle_of(a, b);
        2.0 / 3.0 * r * r * self.rate * self.rate + GRAVITY * r * math::cos_f64(phi)
    }

    /// Half extent along the world axis (0 x, 1 y, 2 z) as it lies on the lattice.
    fn half_along(&self, axis: usize) -> f64 {
        self.half[self.box_axis_along(axis)] as f64
    }
    /// Which box axis lies along the world axis.
    fn box_axis_along(&self, axis: usize) -> usize {
        (0..3).find(|&i| self.lattice[i].0 == axis).expect("the lattice is a permutation")
    }
    /// (half extent along the direction of travel, half height), metres.
    fn section(&self) -> (f64, f64) {
        (self.half_along(self.travel_axis()), self.half_along(1))
    }
    fn travel_axis(&self) -> usize {
        if DIRECTIONS[self.heading][0] != 0 { 0 } else { 2 }
    }
    fn sign(&self) -> i32 {
        DIRECTIONS[self.heading][0] + DIRECTIONS[self.heading][1]
    }

    /// Centre as it lies (or lay before the current tip), f64 world metres.
    fn center_at_rest(&self) -> DVec3 {
        let along = |place: &[i64; 3]| (0..3).map(|i| place[i] as f64 * self.half[i] as f64).sum::<f64>();
        self.start.as_dvec3() + DVec3::new(along(&self.place[0]), self.half_along(1), along(&self.place[1]))
    }

    /// Lattice rotation as a matrix with entries -1, 0 and 1.
    fn lattice_rotation(&self) -> Mat3 {
        let column = |i: usize| {
            let (axis, sign) = self.lattice[i];
            let mut v = Vec3::ZERO;
            v[axis] = sign as f32;
            v
        };
        Mat3::from_cols(column(0), column(1), column(2))
    }

    /// Centre and the angle of rolling along the current line since the start (positive towards +X or +Z), f64.
    pub(crate) fn rolling_pose(&self) -> (DVec3, f64) {
        let sign = f64::from(self.sign());
        (self.center(), self.quarter_turns as f64 * FRAC_PI_2 + sign * self.angle)
    }

    /// Centre, world metres.
    fn center(&self) -> DVec3 {
        let rest = self.center_at_rest();
        if self.angle == 0.0 {
            return rest;
        }
        let (a, b) = self.section();
        let d = self.direction().as_dvec3();
        let (s, c) = (math::sin_f64(self.angle), math::cos_f64(self.angle));
        // The edge lies a ahead of and b below the centre at rest; (-a, b) from it turns towards the direction of travel.
        let edge = rest + d * a - DVec3::Y * b;
        edge + d * (b * s - a * c) + DVec3::Y * (a * s + b * c)
    }

    /// Pose now.
    pub fn pose(&self) -> Transform {
        let lattice = quat_of(&self.lattice_rotation());
        // Turning towards d about Y x d: right-handed, the top moves along d.
        let axis = DVec3::Y.cross(self.direction().as_dvec3());
        let rotation =
            if self.angle == 0.0 { lattice } else { (crate::axis_angle(axis, self.angle) * lattice).normalize() };
        Transform { translation: self.center().as_vec3(), rotation, scale: Vec3::ONE }
    }

    /// Footprint after a quarter turn towards `heading`, joined with the present one.
    fn swept(&self, heading: usize) -> FloorRect {
        let ahead = Self { heading, angle: 0.0, ..self.clone_state() };
        let c = ahead.center_at_rest();
        let half = [self.half_along(0), self.half_along(2)];
        let height = 2.0 * self.half_along(1);
        let mut r = FloorRect {
            min: [(c.x - half[0]) as f32, (c.z - half[1]) as f32],
            max: [(c.x + half[0]) as f32, (c.z + half[1]) as f32],
        };
        for (i, &d) in DIRECTIONS[heading].iter().enumerate() {
            if d > 0 {
                r.max[i] += height as f32;
            } else if d < 0 {
                r.min[i] -= height as f32;
            }
        }
        r
    }
    fn clone_state(&self) -> Self {
        Self { obstacles: Vec::new(), ..self.clone() }
    }
    fn is_free(&self, heading: usize) -> bool {
        let r = self.swept(heading);
        self.area.contains(&r) && !self.obstacles.iter().any(|o| o.overlaps(&r))
    }

    /// Begins to tip towards +X (0), -Z (1), -X (2) or +Z (3) with the next step. Returns false, and does nothing, while it
    /// tips already or where area or obstacles bar the way.
    pub fn tip(&mut self, heading: usize) -> bool {
        let heading = heading % 4;
        if self.tipping || !self.is_free(heading) {
            return false;
        }
        self.heading = heading;
        self.kick_off();
        true
    }

    /// Which of the box's sides (0 to 5: -X, +X, -Y, +Y, -Z, +Z) looks towards the world's side of the same numbering, as it
    /// lies or lay before the current tip.
    pub fn side_towards(&self, world: usize) -> usize {
        let axis = self.box_axis_along(world / 2);
        let along = self.lattice[axis].1 > 0;
        2 * axis + usize::from((world % 2 == 1) == along)
    }

    /// Lays the box down with side `east` towards world +X and side `up` on top (sides as in [`Self::side_towards`]), at rest,
    /// its bottom centre at `start`.
    ///
    /// # Panics
    /// Where the two sides lie on one axis.
    pub fn lay(&mut self, start: Vec3, up: usize, east: usize) {
        assert!(up / 2 != east / 2 && up < 6 && east < 6, "sides {up} and {east} do not meet");
        let column = |axis: usize, side: usize| (axis, if side % 2 == 1 { 1 } else { -1 });
        let third = 3 - up / 2 - east / 2;
        self.lattice[up / 2] = column(1, up);
        self.lattice[east / 2] = column(0, east);
        self.lattice[third] = (2, 1);
        if self.lattice_rotation().determinant() < 0.0 {
            self.lattice[third].1 = -1;
        }
        self.start = start;
        self.place = [[0; 3]; 2];
        self.stop();
        self.rest_left = 0;
    }

    /// Chooses the next edge and kicks; stays at rest where every way is blocked.
    fn start_tip(&mut self) {
        let turns: &[usize] = match self.turn {
            TurnRule::Left => &[0, 1, 3, 2],
            TurnRule::Right => &[0, 3, 1, 2],
            TurnRule::Back => &[0, 2],
            TurnRule::Wait => &[],
        };
        let Some(heading) = turns.iter().map(|t| (self.heading + t) % 4).find(|&h| self.is_free(h)) else {
            return;
        };
        self.heading = heading;
        self.kick_off();
    }

    fn kick_off(&mut self) {
        let (a, b) = self.section();
        let r = (a * a + b * b).sqrt();
        // 2/3 r² ω² = kick · g (r - b)
        self.rate = (1.5 * self.kick * GRAVITY * (r - b)).sqrt() / r;
        self.angle = 0.0;
        self.tipping = true;
    }

    fn land(&mut self) {
        let axis = self.travel_axis();
        let place = if axis == 0 { 0 } else { 1 };
        let sign = i64::from(self.sign());
        // The centre moves by the half extent ahead plus the half height.
        let (ahead, up) = (self.box_axis_along(axis), self.box_axis_along(1));
        self.place[place][ahead] += sign;
        self.place[place][up] += sign;
        // Quarter turn: what pointed up points ahead, what pointed ahead points down.
        for column in &mut self.lattice {
            *column = match *column {
                (1, s) => (axis, s * sign as i32),
                (k, s) if k == axis => (1, -s * sign as i32),
                other => other,
            };
        }
        self.quarter_turns += sign;
        self.stop();
    }
    fn stop(&mut self) {
        self.angle = 0.0;
        self.rate = 0.0;
        self.tipping = false;
        self.rest_left = self.rest_steps;
    }

    /// One fixed step.
    pub fn step(&mut self) {
        if !self.tipping {
            if self.rest_left > 0 {
                self.rest_left -= 1;
                return;
            }
            self.start_tip();
            if !self.tipping {
                return;
            }
        }
        let (a, b) = self.section();
        let r = (a * a + b * b).sqrt();
        let phi0 = angle_of(a, b);
        let stiffness = 0.75 * GRAVITY / r;
        let h = DT / f64::from(SUBSTEPS);
        for _ in 0..SUBSTEPS {
            // Velocity Verlet: energy errs by O(h²) and does not drift.
            let half_rate = self.rate + 0.5 * h * stiffness * math::sin_f64(self.angle - phi0);
            self.angle += h * half_rate;
            self.rate = half_rate + 0.5 * h * stiffness * math::sin_f64(self.angle - phi0);
            if self.angle >= FRAC_PI_2 {
                return self.land();
            }
            if self.angle <= 0.0 {
                return self.stop();
            }
        }
    }
}

/// Angle whose tangent is y/x for y, x > 0, f64, by the engine's f32 atan2 and two Newton steps on its sine and cosine.
pub(crate) fn angle_of(y: f64, x: f64) -> f64 {
    let r = (x * x + y * y).sqrt();
    let mut t = f64::from(math::atan2(y as f32, x as f32));
    for _ in 0..2 {
        t += (y * math::cos_f64(t) - x * math::sin_f64(t)) / r;
    }
    t
}

pub(crate) fn step_boxes(mut boxes: Query<&mut TippingBox, With<StableId>>) {
    for mut body in &mut boxes {
        body.step();
    }
}

pub(crate) fn pose_boxes(mut boxes: Query<(&TippingBox, &mut Transform)>) {
    for (body, mut transform) in &mut boxes {
        let scale = transform.scale;
        transform.set_if_neq(Transform { scale, ..body.pose() });
    }
}
