//! Spheres that roll on a floor without slipping, and bounce off walls and each other.

use crate::{DT, FloorRect, axis_angle};
use bevy_ecs::prelude::*;
use bevy_transform::components::Transform;
use catoptra_engine::StableId;
use glam::{DVec2, DVec3, Quat, Vec3};

/// A rolling sphere. Contacts are frictionless: they change the velocity along the line of contact only, and the spin
/// follows at once so that the foot never slips (ω = up × v / r); the rolling inertia 7/5 m scales all masses alike.
#[derive(Component, Clone, Debug, PartialEq)]
#[require(Transform)]
pub struct RollingSphere {
    /// Metres, over 0.
    pub radius: f64,
    /// Kilograms, over 0; infinity never moves.
    pub mass: f64,
    /// Height of the floor, metres.
    pub floor: f64,
    /// Where it rolls: the whole sphere stays inside.
    pub area: FloorRect,
    /// Share of the approach speed that a bounce keeps, in [0, 1]; of two spheres the lesser holds.
    pub restitution: f64,
    /// Deceleration by rolling resistance, m/s².
    pub resistance: f64,
    /// Centre, world x and z, metres.
    pub place: DVec2,
    /// Velocity along x and z, m/s.
    pub velocity: DVec2,
    /// Orientation.
    pub rotation: Quat,
}

impl RollingSphere {
    /// A lossless ball of 1 kg at `place` (x, z).
    pub fn new(radius: f64, place: DVec2, velocity: DVec2, area: FloorRect) -> Self {
        Self {
            radius,
            mass: 1.0,
            floor: 0.0,
            area,
            restitution: 1.0,
            resistance: 0.0,
            place,
            velocity,
            rotation: Quat::IDENTITY,
        }
    }
    /// Angular velocity, rad/s: up × v / r.
    pub fn angular_velocity(&self) -> DVec3 {
        DVec3::new(self.velocity.y, 0.0, -self.velocity.x) / self.radius
    }
    /// Pose now.
    pub fn pose(&self) -> Transform {
        let translation = DVec3::new(self.place.x, self.floor + self.radius, self.place.y).as_vec3();
        Transform { translation, rotation: self.rotation, scale: Vec3::ONE }
    }

    fn roll(&mut self) {
        if self.velocity == DVec2::ZERO {
            return;
        }
        let speed = self.velocity.length();
        let slower = (speed - self.resistance * DT).max(0.0);
        self.velocity *= slower / speed;
        self.place += self.velocity * DT;
        let omega = self.angular_velocity();
        let rate = omega.length();
        if rate > 0.0 {
            self.rotation = (axis_angle(omega / rate, rate * DT) * self.rotation).normalize();
        }
    }

    /// Keeps the sphere inside its walls; a wall that it moves into turns it back.
    fn bounce_off_walls(&mut self) {
        for i in 0..2 {
            let low = f64::from(self.area.min[i]) + self.radius;
            let high = f64::from(self.area.max[i]) - self.radius;
            if self.place[i] < low {
                self.place[i] = low;
                if self.velocity[i] < 0.0 {
                    self.velocity[i] *= -self.restitution;
                }
            } else if self.place[i] > high {
                self.place[i] = high;
                if self.velocity[i] > 0.0 {
                    self.velocity[i] *= -self.restitution;
                }
            }
        }
    }
}

/// Collision of two spheres: impulse along the line of contact, then they are moved apart in the ratio of their
/// inverse masses.
fn collide(a: &mut RollingSphere, b: &mut RollingSphere) {
    // Centres may lie at different heights: the floor plane sees the horizontal part of the touching distance.
    let rise = (a.floor + a.radius) - (b.floor + b.radius);
    let touching = a.radius + b.radius;
    let reach_squared = touching * touching - rise * rise;
    let between = b.place - a.place;
    let distance_squared = between.length_squared();
    let weight = 1.0 / a.mass + 1.0 / b.mass;
    if reach_squared <= 0.0 || distance_squared >= reach_squared || weight <= 0.0 {
        return;
    }
    let distance = distance_squared.sqrt();
    let n = if distance > 0.0 { between / distance } else { DVec2::X };
    let approach = (a.velocity - b.velocity).dot(n);
    if approach > 0.0 {
        let impulse = (1.0 + a.restitution.min(b.restitution)) * approach / weight;
        a.velocity -= n * (impulse / a.mass);
        b.velocity += n * (impulse / b.mass);
    }
    let overlap = reach_squared.sqrt() - distance;
    a.place -= n * (overlap / (a.mass * weight));
    b.place += n * (overlap / (b.mass * weight));
}

/// One fixed step of spheres that share a floor, in the given order (in a world: that of their `StableId`). For games that
/// look ahead: the same numbers as in [`catoptra_engine::FixedUpdate`].
pub fn step_spheres_together(spheres: &mut [RollingSphere]) {
    for s in spheres.iter_mut() {
        s.roll();
        s.bounce_off_walls();
    }
    for i in 0..spheres.len() {
        let (head, tail) = spheres.split_at_mut(i + 1);
        for other in tail {
            collide(&mut head[i], other);
        }
    }
    // Moving two spheres apart may have pushed one through its wall.
    for s in spheres.iter_mut() {
        s.bounce_off_walls();
    }
}

pub(crate) fn step_spheres(mut query: Query<(Entity, &StableId, &mut RollingSphere)>) {
    let mut rows: Vec<(StableId, Entity, RollingSphere)> = query.iter().map(|(e, id, s)| (*id, e, s.clone())).collect();
    rows.sort_by_key(|r| (r.0, r.1));
    let mut spheres: Vec<RollingSphere> = rows.iter().map(|r| r.2.clone()).collect();
    step_spheres_together(&mut spheres);
    for ((_, entity, before), after) in rows.into_iter().zip(spheres) {
        if before != after
            && let Ok((_, _, mut s)) = query.get_mut(entity)
        {
            *s = after;
        }
    }
}

pub(crate) fn pose_spheres(mut spheres: Query<(&RollingSphere, &mut Transform)>) {
    for (sphere, mut transform) in &mut spheres {
        let scale = transform.scale;
        transform.set_if_neq(Transform { scale, ..sphere.pose() });
    }
}
