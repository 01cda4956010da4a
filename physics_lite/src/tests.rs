//! Whole-crate contracts: answers derivable on paper, long runs, bit equality, and rest without writes.

use super::*;
use bevy_transform::components::Transform;
use catoptra_engine::{StableId, app, math};
use glam::{DVec2, Vec3};
use std::f64::consts::FRAC_PI_2;

fn room() -> FloorRect {
    FloorRect { min: [-2.0, -2.0], max: [2.0, 2.0] }
}

fn cube(half: f32) -> TippingBox {
    TippingBox::new(Vec3::splat(half), Vec3::ZERO, room(), 0)
}

fn corners(half: Vec3, pose: &Transform) -> [Vec3; 8] {
    std::array::from_fn(|i| {
        let s = |bit: usize| if i & bit == 0 { -1.0 } else { 1.0 };
        pose.transform_point(half * Vec3::new(s(1), s(2), s(4)))
    })
}

#[test]
fn a_tipping_box_keeps_its_energy_until_it_lands() {
    for half in [Vec3::splat(0.3), Vec3::new(0.2, 0.5, 0.3), Vec3::new(0.6, 0.1, 0.2)] {
        let mut body = TippingBox::new(half, Vec3::ZERO, room(), 0);
        body.step();
        let first = body.energy();
        let mut seen = 0;
        while body.is_tipping() {
            assert!((body.energy() / first - 1.0).abs() < 1e-5, "{} of {first} at {}", body.energy(), body.angle());
            seen += 1;
            body.step();
        }
        assert!(seen > 5);
    }
}

#[test]
fn the_kick_is_what_reaches_the_balance_point_times_its_factor() {
    // Before the first substep: 2/3 r² ω² = kick · g (r − b). Energy at rest is g b, so the whole is g b + that.
    let (half, kick) = (0.3f64, 1.3);
    let mut body = cube(half as f32);
    body.kick = kick;
    body.step();
    let (b, r) = (f64::from(0.3f32), f64::from(0.3f32) * 2f64.sqrt());
    let expected = GRAVITY * b + kick * GRAVITY * (r - b);
    assert!((body.energy() / expected - 1.0).abs() < 1e-5, "{} against {expected}", body.energy());
}

#[test]
fn tip_time_is_the_pendulum_integral() {
    // t = ∫ dθ / ω(θ), ω² = ω0² + (3g/2r)(cos φ0 − cos(θ − φ0)), by the midpoint rule.
    for half in [Vec3::splat(0.3), Vec3::new(0.25, 0.4, 0.3)] {
        let (a, b) = (f64::from(half.x), f64::from(half.y));
        let r = (a * a + b * b).sqrt();
        let phi0 = tipping_box::angle_of(a, b);
        let kick = 1.2;
        let start = 1.5 * kick * GRAVITY * (r - b) / (r * r);
        let n = 20_000;
        let time: f64 = (0..n)
            .map(|i| {
                let theta = (i as f64 + 0.5) / f64::from(n) * FRAC_PI_2;
                let omega = (start + 1.5 * GRAVITY / r * (math::cos_f64(phi0) - math::cos_f64(theta - phi0))).sqrt();
                FRAC_PI_2 / f64::from(n) / omega
            })
            .sum();
        let mut body = TippingBox::new(half, Vec3::ZERO, room(), 0);
        body.kick = kick;
        let mut steps = 0;
        loop {
            body.step();
            steps += 1;
            if !body.is_tipping() {
                break;
            }
        }
        // It lands within the step that holds the moment.
        assert_eq!(steps, (time * 60.0).ceil() as u32, "{half}: {time} s");
    }
}

#[test]
fn no_corner_goes_below_the_floor_and_the_edge_stays_on_it() {
    for half in [Vec3::splat(0.36), Vec3::new(0.2, 0.5, 0.3)] {
        let mut body = TippingBox::new(half, Vec3::new(0.1, 0.0, -0.2), room(), 1);
        for step in 0..2_000 {
            body.step();
            let lowest = corners(half, &body.pose()).iter().fold(f32::INFINITY, |m, c| m.min(c.y));
            assert!(lowest.abs() < 1e-5, "step {step}: lowest corner at {lowest}");
        }
    }
}

#[test]
fn a_million_steps_end_on_the_lattice_inside_the_room() {
    let half = 0.25f32;
    let mut body = cube(half);
    body.obstacles.push(FloorRect { min: [0.5, 0.5], max: [1.0, 1.0] });
    let mut tips = 0u64;
    for step in 0..1_000_000u32 {
        let was = body.is_tipping();
        body.step();
        if was && !body.is_tipping() {
            tips += 1;
            if tips.is_multiple_of(97) || step > 999_000 {
                let pose = body.pose();
                let p = pose.translation;
                for (v, off) in [(p.x, 0.0), (p.z, 0.0), (p.y, half)] {
                    let cells = (v - off) / (2.0 * half);
                    assert_eq!(cells, cells.round(), "{p} is off the lattice");
                }
                assert!(p.x.abs() + half <= 2.0001 && p.z.abs() + half <= 2.0001);
                let m = glam::Mat3::from_quat(pose.rotation);
                assert!(m.to_cols_array().iter().all(|v| (v - v.round()).abs() < 1e-6), "{m} is no quarter turn");
            }
        }
    }
    assert!(tips > 10_000, "{tips} tips");
}

#[test]
fn a_walled_in_box_rests() {
    let mut body = cube(0.4);
    body.area = FloorRect { min: [-0.5, -0.5], max: [0.5, 0.5] };
    for _ in 0..100 {
        body.step();
    }
    assert!(!body.is_tipping());
    assert_eq!(body.pose().translation, Vec3::new(0.0, 0.4, 0.0));
}

fn ball(place: DVec2, velocity: DVec2) -> RollingSphere {
    RollingSphere::new(0.25, place, velocity, room())
}

#[test]
fn spheres_roll_without_slipping() {
    let mut s = [ball(DVec2::ZERO, DVec2::new(0.9, -0.5))];
    let up = glam::DVec3::Y;
    for _ in 0..500 {
        let (before, rotation) = (s[0].place, s[0].rotation);
        let foot =
            glam::DVec3::new(s[0].velocity.x, 0.0, s[0].velocity.y) + s[0].angular_velocity().cross(-up * s[0].radius);
        assert!(foot.length() < 1e-12, "the foot moves by {foot}");
        rolling_sphere::step_spheres_together(&mut s);
        // The pose follows: distance rolled = angle turned × radius (unless it bounced in this step).
        let rolled = (s[0].place - before).length();
        let turned = f64::from((s[0].rotation * rotation.inverse()).normalize().w.abs());
        let angle = 2.0 * f64::from(math::acos(turned as f32));
        if (rolled - s[0].velocity.length() / 60.0).abs() < 1e-9 {
            assert!((angle * s[0].radius - rolled).abs() < 2e-3, "{angle} rad for {rolled} m");
        }
    }
}

#[test]
fn a_roll_of_one_circumference_is_one_turn() {
    let circumference = std::f64::consts::TAU * 0.25;
    let mut s = [ball(DVec2::new(-1.0, 0.0), DVec2::new(circumference, 0.0))];
    for _ in 0..60 {
        rolling_sphere::step_spheres_together(&mut s);
    }
    assert!((s[0].place.x - (circumference - 1.0)).abs() < 1e-12);
    assert!((s[0].rotation * Vec3::X - Vec3::X).length() < 1e-4, "back where it was");
}

#[test]
fn collisions_conserve_momentum_and_keep_the_stated_share_of_speed() {
    for restitution in [1.0, 0.5, 0.0] {
        let mut s =
            [ball(DVec2::new(-0.5, 0.02), DVec2::new(1.2, 0.1)), ball(DVec2::new(0.2, 0.0), DVec2::new(-0.4, 0.0))];
        s[1].mass = 3.0;
        for x in &mut s {
            x.restitution = restitution;
        }
        let momentum = |s: &[RollingSphere]| s[0].velocity * s[0].mass + s[1].velocity * s[1].mass;
        let before = momentum(&s);
        let energy = |s: &[RollingSphere]| s.iter().map(|x| x.mass * x.velocity.length_squared()).sum::<f64>();
        let energy_before = energy(&s);
        let mut met = false;
        for _ in 0..60 {
            let was = [s[0].velocity, s[1].velocity];
            rolling_sphere::step_spheres_together(&mut s);
            if s[0].velocity != was[0] {
                met = true;
                let n = (s[1].place - s[0].place).normalize();
                let approach = (was[0] - was[1]).dot(n);
                let parting = (s[1].velocity - s[0].velocity).dot(n);
                assert!((parting - restitution * approach).abs() < 1e-9, "{parting} of {approach}");
                break;
            }
        }
        assert!(met);
        assert!((momentum(&s) - before).length() < 1e-12);
        if restitution == 1.0 {
            assert!((energy(&s) / energy_before - 1.0).abs() < 1e-12);
        } else {
            assert!(energy(&s) < energy_before);
        }
    }
}

#[test]
fn equal_spheres_swap_velocities_head_on() {
    let mut s = [ball(DVec2::new(-0.4, 0.0), DVec2::new(1.0, 0.0)), ball(DVec2::new(0.2, 0.0), DVec2::ZERO)];
    for _ in 0..30 {
        rolling_sphere::step_spheres_together(&mut s);
    }
    assert!(s[0].velocity.length() < 1e-12 && (s[1].velocity - DVec2::new(1.0, 0.0)).length() < 1e-12);
}

#[test]
fn a_million_steps_of_spheres_stay_finite_and_inside() {
    let mut s = [
        ball(DVec2::new(-1.0, 0.3), DVec2::new(1.7, 0.9)),
        ball(DVec2::new(1.0, -0.2), DVec2::new(-0.6, 1.1)),
        RollingSphere { mass: f64::INFINITY, ..ball(DVec2::ZERO, DVec2::ZERO) },
    ];
    let energy = |s: &[RollingSphere]| s[..2].iter().map(|x| x.velocity.length_squared()).sum::<f64>();
    let before = energy(&s);
    for _ in 0..1_000_000 {
        rolling_sphere::step_spheres_together(&mut s);
        for x in &s[..2] {
            assert!(x.place.abs().max_element() <= 1.75 + 1e-12, "{}", x.place);
        }
    }
    assert_eq!(s[2].place, DVec2::ZERO);
    assert!((energy(&s) / before - 1.0).abs() < 1e-6);
    assert!((s[0].rotation.length() - 1.0).abs() < 1e-5);
}

#[test]
fn the_ring_never_leaves_its_box_and_settles_in_a_resting_one() {
    let mut world = bevy_ecs::world::World::new();
    let entity = world.spawn_empty().id();
    let mut container = TippingBox::new(Vec3::splat(0.5), Vec3::ZERO, room(), 0);
    container.turn = TurnRule::Back;
    let mut ring = RollingRing::new(entity, 0.25, 0.1);
    let mut farthest = 0.0f64;
    for step in 0..100_000 {
        container.step();
        ring.step(&container);
        let gap = ring.clearance(&container);
        assert!(gap >= ring.wall - 1e-9, "step {step}: {gap} m to the wall");
        farthest = farthest.max(gap);
    }
    // It lies on a wall, but not always on the same: it does roll.
    assert!(farthest < 0.2);
    // Shut in, the box rests and the ring comes to rest too.
    container.area = FloorRect { min: [-9.0, -9.0], max: [-8.0, -8.0] };
    for _ in 0..2_000 {
        container.step();
        ring.step(&container);
    }
    let before = ring.clone();
    ring.step(&container);
    assert_eq!(before, ring);
}

fn crowd() -> bevy_app::App {
    let mut app = app::new_app();
    app.add_plugins(PhysicsLitePlugin);
    let w = app.world_mut();
    let mut lane = cube(0.5);
    lane.turn = TurnRule::Back;
    let container = w.spawn((StableId(1), lane, PreviousPose::default())).id();
    w.spawn((StableId(2), RollingRing::new(container, 0.2, 0.1)));
    w.spawn((StableId(3), ball(DVec2::new(-1.0, 0.4), DVec2::new(0.8, 0.3))));
    w.spawn((StableId(4), ball(DVec2::new(1.0, 0.4), DVec2::new(-0.7, 0.2))));
    let spin = Spinning { axis: Vec3::ONE, rate: 1.3, phase: 0.2, base: glam::Quat::IDENTITY };
    w.spawn((StableId(5), spin));
    let terms = vec![Sine { amplitude: Vec3::ONE, period_secs: 3.0, phase: 0.1 }];
    let path = Path::Sines { center: Vec3::Y, terms };
    w.spawn((StableId(6), PathFollower { position: path, target: Some(Path::Fixed(Vec3::ZERO)) }));
    app::settle(&mut app);
    app
}

fn poses(app: &mut bevy_app::App) -> Vec<(u64, [u32; 7])> {
    let mut query = app.world_mut().query::<(&StableId, &Transform)>();
    let mut rows: Vec<(u64, [u32; 7])> = query
        .iter(app.world())
        .map(|(id, t)| {
            let (p, q) = (t.translation, t.rotation);
            (id.0, [p.x, p.y, p.z, q.x, q.y, q.z, q.w].map(f32::to_bits))
        })
        .collect();
    rows.sort_unstable();
    rows
}

#[test]
fn two_worlds_stepped_alike_are_the_same_bits() {
    let (mut a, mut b) = (crowd(), crowd());
    app::advance(&mut a, 3_000);
    for _ in 0..3 {
        app::advance(&mut b, 1_000);
    }
    assert_eq!(poses(&mut a), poses(&mut b));
    let now = poses(&mut a);
    app::advance(&mut a, 1);
    assert!(poses(&mut a) != now, "something moves");
}

#[test]
fn bodies_at_rest_are_not_written() {
    use bevy_ecs::prelude::*;
    #[derive(Resource, Default)]
    struct Written(usize);
    fn count(moved: Query<(), Changed<Transform>>, mut written: ResMut<Written>) {
        written.0 += moved.iter().count();
    }
    let mut app = app::new_app();
    app.add_plugins(PhysicsLitePlugin).init_resource::<Written>();
    app.add_systems(FixedUpdate, count.after(path::pose_followers));
    let w = app.world_mut();
    let mut shut_in = cube(0.4);
    shut_in.area = FloorRect { min: [-0.5, -0.5], max: [0.5, 0.5] };
    let container = w.spawn((StableId(1), shut_in, PreviousPose::default())).id();
    w.spawn((StableId(2), RollingRing::new(container, 0.2, 0.1)));
    w.spawn((StableId(3), ball(DVec2::new(1.0, 1.0), DVec2::ZERO)));
    w.spawn((StableId(4), Spinning { axis: Vec3::Y, rate: 0.0, phase: 0.4, base: glam::Quat::IDENTITY }));
    w.spawn((StableId(5), PathFollower { position: Path::Fixed(Vec3::X), target: Some(Path::Fixed(Vec3::ZERO)) }));
    app::settle(&mut app);
    // The first step sees the writes of start-up; the ring may take a few to lie still.
    app::advance(&mut app, 30);
    app.world_mut().resource_mut::<Written>().0 = 0;
    app::advance(&mut app, 100);
    assert_eq!(app.world().resource::<Written>().0, 0);
    // And a moving one is.
    app.world_mut().spawn((StableId(6), ball(DVec2::new(-1.0, 0.0), DVec2::X)));
    app::advance(&mut app, 10);
    assert!(app.world().resource::<Written>().0 >= 10);
}

#[test]
fn a_box_that_waits_tips_when_told_and_lies_as_laid() {
    let area = FloorRect { min: [-2.0, -2.0], max: [2.0, 2.0] };
    let mut body = TippingBox::new(Vec3::splat(0.25), Vec3::ZERO, area, 0);
    body.turn = TurnRule::Wait;
    for _ in 0..100 {
        body.step();
    }
    assert!(!body.is_tipping() && body.pose().translation == Vec3::Y * 0.25, "it waits");
    assert_eq!((0..6).map(|w| body.side_towards(w)).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5]);
    for (heading, towards) in [(0, Vec3::X), (1, Vec3::NEG_Z), (2, Vec3::NEG_X), (3, Vec3::Z)] {
        let before = body.pose().translation;
        let top = body.side_towards(3);
        assert!(body.tip(heading) && !body.tip(heading), "one at a time");
        for _ in 0..200 {
            body.step();
        }
        assert!((body.pose().translation - before - towards * 0.5).length() < 1e-5);
        // What was on top looks the way it went.
        assert_eq!(body.side_towards([1, 4, 0, 5][heading]), top);
    }
    // Any of the 24 ways to lie, and the pose agrees with the numbers.
    let sides = [Vec3::NEG_X, Vec3::X, Vec3::NEG_Y, Vec3::Y, Vec3::NEG_Z, Vec3::Z];
    for up in 0..6 {
        for east in (0..6).filter(|e| e / 2 != up / 2) {
            body.lay(Vec3::new(0.5, 0.0, 0.5), up, east);
            assert_eq!((body.side_towards(3), body.side_towards(1)), (up, east));
            let rotation = body.pose().rotation;
            assert!((rotation * sides[up] - Vec3::Y).length() < 1e-5, "{up} {east}");
            assert!((rotation * sides[east] - Vec3::X).length() < 1e-5, "{up} {east}");
        }
    }
    // Walls bar the way.
    body.lay(Vec3::new(1.7, 0.0, 0.0), 3, 1);
    assert!(!body.tip(0) && body.tip(2));
}
