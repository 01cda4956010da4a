//! A ring (torus standing on its rim) that rolls inside a tipping box, in the plane in which the box rolls.
//!
//! In that plane it is a disc of the torus's outer radius inside a rotating rectangle. Gravity, impacts and Coulomb
//! friction against the four moving walls act on it; its moment of inertia is the torus's own, m (R² + 3/4 r²).
//! The box must keep to one line (`TurnRule::Back`).

use crate::{DT, GRAVITY, TippingBox, axis_angle};
use bevy_ecs::prelude::*;
use bevy_transform::components::Transform;
use catoptra_engine::{StableId, math};
use glam::{DVec2, DVec3, Quat, Vec3};

const SUBSTEPS: u32 = 16;
/// Below this speed (m/s) a ring in a resting box comes to rest.
const SLEEP_SPEED: f64 = 5e-3;

/// A torus rolling inside the box `container`.
#[derive(Component, Clone, Debug, PartialEq)]
#[require(Transform)]
pub struct RollingRing {
    /// Entity with the [`TippingBox`].
    pub container: Entity,
    /// Radius from the axis to the tube's middle, metres.
    pub major: f64,
    /// Radius of the tube, metres.
    pub minor: f64,
    /// Coefficient of friction.
    pub friction: f64,
    /// Share of the approach speed that an impact keeps, in [0, 1].
    pub restitution: f64,
    /// Deceleration by rolling resistance, m/s².
    pub resistance: f64,
    /// Thickness of the box's walls: the ring keeps this far from its faces, metres.
    pub wall: f64,
    state: Option<State>,
}

/// Motion in the plane (along the line of travel, up).
#[derive(Clone, Copy, Debug, PartialEq)]
struct State {
    /// The box's line runs along x (true) or z.
    along_x: bool,
    place: DVec2,
    velocity: DVec2,
    /// Turned so far and its rate; positive rolls towards + along the line.
    turned: f64,
    spin: f64,
    box_center: DVec2,
    box_angle: f64,
    /// Coordinate across the plane.
    across: f64,
}

impl RollingRing {
    /// A ring at rest on the bottom of its box, which it reaches when the box is first seen.
    pub fn new(container: Entity, major: f64, minor: f64) -> Self {
        Self { container, major, minor, friction: 0.35, restitution: 0.15, resistance: 0.12, wall: 0.02, state: None }
    }
    /// Outer radius, metres.
    pub fn outer(&self) -> f64 {
        self.major + self.minor
    }
    /// Distance by which the ring is inside the box's walls at the nearest one, metres (for tests and games).
    pub fn clearance(&self, container: &TippingBox) -> f64 {
        let Some(s) = &self.state else { return f64::INFINITY };
        let (c, angle) = container.rolling_pose();
        let local = turned(s.place - s.in_plane(c), -angle);
        let half = s.half_in_plane(container);
        (half - local.abs()).min_element() - self.outer()
    }

    fn begin(&mut self, container: &TippingBox) -> State {
        let (c, angle) = container.rolling_pose();
        let along_x = container.direction().x != 0.0;
        let mut s = State {
            along_x,
            place: DVec2::ZERO,
            velocity: DVec2::ZERO,
            turned: 0.0,
            spin: 0.0,
            box_center: DVec2::ZERO,
            box_angle: angle,
            across: if along_x { c.z } else { c.x },
        };
        s.box_center = s.in_plane(c);
        let room = s.half_in_plane(container) - DVec2::splat(self.wall + self.outer());
        assert!(room.min_element() >= 0.0, "the ring does not fit its box");
        s.place = s.box_center - DVec2::Y * room.y;
        s
    }

    /// One fixed step inside a box that has made its own.
    pub fn step(&mut self, container: &TippingBox) {
        let mut s = match self.state {
            Some(s) => s,
            None => self.begin(container),
        };
        let (c, angle) = container.rolling_pose();
        let center = s.in_plane(c);
        let box_velocity = (center - s.box_center) / DT;
        let box_rate = (angle - s.box_angle) / DT;
        let resting = !container.is_tipping() && box_rate == 0.0;
        if resting && s.velocity == DVec2::ZERO && s.spin == 0.0 {
            self.state = Some(s);
            return;
        }
        let room = s.half_in_plane(container) - DVec2::splat(self.wall + self.outer());
        let h = DT / f64::from(SUBSTEPS);
        let mut touching = false;
        for k in 1..=SUBSTEPS {
            let share = f64::from(k) / f64::from(SUBSTEPS);
            let middle = s.box_center + (center - s.box_center) * share;
            let tilt = s.box_angle + (angle - s.box_angle) * share;
            s.velocity.y -= GRAVITY * h;
            s.place += s.velocity * h;
            s.turned += s.spin * h;
            let mut local = turned(s.place - middle, -tilt);
            for axis in 0..2 {
                if local[axis].abs() < room[axis] {
                    continue;
                }
                // Push back to the wall, then take the approach speed and rub.
                let side = local[axis].signum();
                local[axis] = side * room[axis];
                s.place = middle + turned(local, tilt);
                let mut n = DVec2::ZERO;
                n[axis] = side;
                self.touch(&mut s, turned(n, tilt), middle, box_velocity, box_rate);
                touching = true;
            }
        }
        // What floating point left outside goes to the wall: inside is a promise.
        let local = turned(s.place - center, -angle).clamp(-room, room);
        s.place = center + turned(local, angle);
        if touching {
            self.resist(&mut s, box_velocity, resting);
        }
        s.box_center = center;
        s.box_angle = angle;
        self.state = Some(s);
    }

    /// Impact and friction at a wall whose outward direction (from the ring into the wall) is `n`.
    fn touch(&self, s: &mut State, n: DVec2, middle: DVec2, box_velocity: DVec2, box_rate: f64) {
        let outer = self.outer();
        let arm = s.place + n * outer - middle;
        // Angles turn from up towards +: a point at `arm` moves with rate · (arm.y, -arm.x).
        let wall_velocity = box_velocity + DVec2::new(arm.y, -arm.x) * box_rate;
        let approach = (s.velocity - wall_velocity).dot(n);
        if approach <= 0.0 {
            return;
        }
        // Slow contacts do not bounce, so that resting is possible.
        let restitution = if approach > 0.2 { self.restitution } else { 0.0 };
        let impulse = (1.0 + restitution) * approach;
        s.velocity -= n * impulse;
        let t = DVec2::new(n.y, -n.x);
        let slip = (s.velocity - wall_velocity).dot(t) + s.spin * outer;
        let gyration_squared = self.major * self.major + 0.75 * self.minor * self.minor;
        let weight = 1.0 + outer * outer / gyration_squared;
        let rub = (-slip / weight).clamp(-self.friction * impulse, self.friction * impulse);
        s.velocity += t * rub;
        s.spin += rub * outer / gyration_squared;
    }

    fn resist(&self, s: &mut State, box_velocity: DVec2, resting: bool) {
        let loss = self.resistance * DT;
        let relative = s.velocity - box_velocity;
        let speed = relative.length();
        if speed > 0.0 {
            let keep = (speed - loss).max(0.0) / speed;
            s.velocity = box_velocity + relative * keep;
            s.spin *= keep;
        }
        if resting && s.velocity.length() < SLEEP_SPEED && s.spin.abs() * self.outer() < SLEEP_SPEED {
            s.velocity = DVec2::ZERO;
            s.spin = 0.0;
        }
    }

    /// Pose now, of a mesh whose axis is Y.
    fn pose(&self, container: &TippingBox) -> Transform {
        let s = match self.state {
            Some(s) => s,
            None => self.clone().begin(container),
        };
        let (translation, axis) = if s.along_x {
            (DVec3::new(s.place.x, s.place.y, s.across), DVec3::NEG_Z)
        } else {
            (DVec3::new(s.across, s.place.y, s.place.x), DVec3::X)
        };
        // Stand the torus up: its axis Y goes to the axis of rolling.
        let stand = Quat::from_rotation_arc(Vec3::Y, axis.as_vec3());
        let rotation = (axis_angle(axis, s.turned % std::f64::consts::TAU) * stand).normalize();
        Transform { translation: translation.as_vec3(), rotation, scale: Vec3::ONE }
    }
}

impl State {
    fn in_plane(&self, p: DVec3) -> DVec2 {
        DVec2::new(if self.along_x { p.x } else { p.z }, p.y)
    }
    fn half_in_plane(&self, container: &TippingBox) -> DVec2 {
        let h = container.half.as_dvec3();
        DVec2::new(if self.along_x { h.x } else { h.z }, h.y)
    }
}

/// `v` turned by `angle` from up towards + along the line.
fn turned(v: DVec2, angle: f64) -> DVec2 {
    let (s, c) = (math::sin_f64(angle), math::cos_f64(angle));
    DVec2::new(v.x * c + v.y * s, v.y * c - v.x * s)
}

pub(crate) fn step_rings(mut rings: Query<&mut RollingRing, With<StableId>>, boxes: Query<&TippingBox>) {
    for mut ring in &mut rings {
        if let Ok(container) = boxes.get(ring.container) {
            ring.step(container);
        }
    }
}

pub(crate) fn pose_rings(mut rings: Query<(&RollingRing, &mut Transform)>, boxes: Query<&TippingBox>) {
    for (ring, mut transform) in &mut rings {
        if let Ok(container) = boxes.get(ring.container) {
            let scale = transform.scale;
            transform.set_if_neq(Transform { scale, ..ring.pose(container) });
        }
    }
}
