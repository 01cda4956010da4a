//! Mirrors and glass against formulas: refraction through layers, nested glass by priority, total internal reflection,
//! absorption, depth limit and weight cut-off, mirror corridors. Walls show their own position or a known radiance, so that
//! every picture says where its ray ended and what it weighed on the way.

use catoptra_engine::{
    Material, Mesh, math,
    shapes::{ShapeBuilder, cuboid},
};
use catoptra_render_hybrid::twin::shading::fresnel_dielectric;
use catoptra_tests::{HandScene, assert_close, assert_relative, at, wall_of_positions};
use glam::{Affine3, Vec3};

/// Relative; a chain of some ten single-precision roundings.
const ROUNDING: f64 = 2e-6;

/// A slab of glass |x|, |y| ≤ 50 between the depths `front` > `back`, on z.
fn slab(front: f32, back: f32) -> (Mesh, Affine3) {
    let half = Vec3::new(50.0, 50.0, 0.5 * (front - back));
    (cuboid(half, [Vec3::ONE; 6]), at(Vec3::Z * (0.5 * (front + back))))
}

/// A wall at depth `z` that shows `radiance` whatever lights it.
fn glowing_wall(z: f32, radiance: Vec3) -> (Mesh, Material) {
    let mut b = ShapeBuilder::default();
    let p = |x: f32, y: f32| Vec3::new(x * 50.0, y * 50.0, z);
    b.quad([p(-1.0, -1.0), p(1.0, -1.0), p(1.0, 1.0), p(-1.0, 1.0)], Vec3::ONE);
    (b.build(), Material { base_color: radiance, unlit: true, ..Material::default() })
}

/// Looks along -z through what `build` puts before a wall of radiance 1 at z = -10.
fn through(
    degrees: f32,
    build: impl FnOnce(&mut HandScene),
    change: impl FnOnce(&mut catoptra_render_hybrid::RenderSettings),
) -> Vec3 {
    let (s, c) = math::sin_cos(degrees.to_radians());
    let mut scene = HandScene::parallel(Vec3::new(0.0, 0.0, 5.0), Vec3::new(s, 0.0, -c), 1e-3);
    build(&mut scene);
    let (wall, material) = glowing_wall(-10.0, Vec3::ONE);
    scene.add(wall, material, Affine3::IDENTITY);
    scene.pixel(change)
}

#[test]
fn absorption_is_beer_lambert() {
    let color = Vec3::new(0.9, 0.5, 0.1);
    for (thickness, distance) in [(1.0f32, 1.0f32), (2.5, 1.0), (0.3, 2.0)] {
        for degrees in [0.0, 40.0] {
            // An index of 1 neither bends nor reflects: absorption alone is left.
            let glass = Material {
                attenuation_color: color,
                attenuation_distance: distance,
                ..Material::glass(Vec3::ONE, 1.0)
            };
            let seen = through(
                degrees,
                |s| {
                    let (mesh, pose) = slab(0.0, -thickness);
                    s.add(mesh, glass, pose);
                },
                |_| (),
            );
            let way = thickness / math::cos(degrees.to_radians());
            for c in 0..3 {
                let expected = libm::pow(f64::from(color[c]), f64::from(way / distance));
                assert_relative(&format!("{thickness} m at {degrees} degrees"), f64::from(seen[c]), expected, 1e-5);
                let other = libm::pow(f64::from(color[c]), f64::from(way * 1.001 / distance));
                assert!((f64::from(seen[c]) / other - 1.0).abs() > 1e-5, "a longer way is seen");
            }
        }
    }
}

#[test]
fn base_color_tints_at_each_interface() {
    let tint = Vec3::new(0.8, 0.6, 0.4);
    let glass = |s: &mut HandScene| {
        let (mesh, pose) = slab(0.0, -1.0);
        s.add(mesh, Material::glass(tint, 1.5), pose);
    };
    let f = 0.04f64;
    let seen = through(0.0, glass, |s| s.max_depth = 2);
    for c in 0..3 {
        let t = f64::from(tint[c]) * (1.0 - f);
        assert_relative("two interfaces", f64::from(seen[c]), t * t, ROUNDING);
    }
    // With inner reflections: the series T²(1 + F² + F⁴ + ..), where a reflection keeps its whole light.
    let seen = through(0.0, glass, |s| (s.max_depth, s.min_weight) = (32, 1e-9));
    for c in 0..3 {
        let t = f64::from(tint[c]) * (1.0 - f);
        assert_relative("all reflections", f64::from(seen[c]), t * t / (1.0 - f * f), ROUNDING);
    }
}

#[test]
fn a_slab_reflects_and_transmits_all_light() {
    // Between two walls of one radiance a lossless slab is not to be seen, at any angle.
    for degrees in [0.0f32, 30.0, 60.0, 80.0] {
        let (s, c) = math::sin_cos(degrees.to_radians());
        let render = |ior: f32, tint: f32| {
            let mut scene = HandScene::parallel(Vec3::new(0.0, 0.0, 5.0), Vec3::new(s, 0.0, -c), 1e-3);
            scene = scene.background(Vec3::ONE);
            let (mesh, pose) = slab(0.0, -1.0);
            scene.add(mesh, Material::glass(Vec3::splat(tint), ior), pose);
            f64::from(scene.pixel(|s| (s.max_depth, s.min_weight) = (64, 1e-7)).x)
        };
        // Relative; what the cut-off at 1e-7 and the last of 64 reflections leave out.
        assert_relative(&format!("{degrees} degrees"), render(1.5, 1.0), 1.0, 1e-5);
        assert!((render(1.5, 0.999) - 1.0).abs() > 1e-5, "a tint of 0.999 is seen");
    }
}

/// x at which a ray of angle `degrees` ends on the wall z = -6, having started above x = 0, z = 0.
fn landing(degrees: f32, build: impl FnOnce(&mut HandScene)) -> f64 {
    let (s, c) = math::sin_cos(degrees.to_radians());
    let direction = Vec3::new(s, 0.0, -c);
    let mut scene = HandScene::parallel(-direction * 3.0, direction, 1e-3);
    build(&mut scene);
    let (wall, material) = wall_of_positions(Vec3::new(3.0, 0.0, -6.0), Vec3::X * 4.0, Vec3::Y * 4.0);
    scene.add(wall, material, Affine3::IDENTITY);
    // Enough for every interface passed, hidden ones uncounted; reflections end in the dark, but for the inner ones.
    let seen = scene.pixel(|s| (s.max_depth, s.min_weight) = (4, 0.2));
    f64::from((seen.x / seen.z - 0.5) * 8.0 + 3.0)
}

/// Where it must end after layers of (thickness, index), the rest of the way to z = -6 being air.
fn snell(degrees: f32, layers: &[(f64, f64)]) -> f64 {
    let sin = math::sin_f64(f64::from(degrees).to_radians());
    let air: f64 = 6.0 - layers.iter().map(|l| l.0).sum::<f64>();
    layers.iter().copied().chain([(air, 1.0)]).map(|(t, n)| t * (sin / n) / (1.0 - sin * sin / (n * n)).sqrt()).sum()
}

#[test]
fn nested_glass_goes_by_priority() {
    let fill = |s: &mut HandScene, front: f32, back: f32, ior: f32, priority: i32| {
        let (mesh, pose) = slab(front, back);
        s.add(mesh, Material { priority, ..Material::glass(Vec3::ONE, ior) }, pose);
    };
    // Metres on the wall; single precision of its coded position.
    let tolerance = 1e-5;
    for degrees in [0.0f32, 20.0, 35.0] {
        // Two volumes that overlap between -1 and -2: the higher priority has the overlap.
        for (a, b, layers) in [
            (1, 0, [(2.0, 1.5), (1.0, 1.33)]),
            (0, 1, [(1.0, 1.5), (2.0, 1.33)]),
            // Equal: the one entered last.
            (0, 0, [(1.0, 1.5), (2.0, 1.33)]),
        ] {
            let build = |s: &mut HandScene| {
                fill(s, 0.0, -2.0, 1.5, a);
                fill(s, -1.0, -3.0, 1.33, b);
            };
            let what = format!("priorities {a} and {b} at {degrees} degrees");
            assert_close(&what, landing(degrees, build), snell(degrees, &layers), tolerance);
        }
        // One volume wholly inside another: bubble of air (index 1), and glass in water.
        for (inner, n) in [(1.0f32, 1.0), (1.5, 1.5)] {
            let build = |s: &mut HandScene| {
                fill(s, 0.0, -3.0, 1.33, 0);
                fill(s, -1.0, -2.0, inner, 1);
            };
            let layers = [(1.0, 1.33), (1.0, n), (1.0, 1.33)];
            assert_close(&format!("{n} in water"), landing(degrees, build), snell(degrees, &layers), tolerance);
            // Of lower priority it is not there.
            let build = |s: &mut HandScene| {
                fill(s, 0.0, -3.0, 1.33, 1);
                fill(s, -1.0, -2.0, inner, 0);
            };
            assert_close("hidden", landing(degrees, build), snell(degrees, &[(3.0, 1.33)]), tolerance);
        }
        if degrees > 0.0 {
            let wrong = snell(degrees, &[(1.0, 1.5), (2.0, 1.33)]) - snell(degrees, &[(2.0, 1.5), (1.0, 1.33)]);
            assert!(wrong.abs() > 100.0 * tolerance, "the priorities are told apart");
        }
    }
}

#[test]
fn a_ball_lens_obeys_snell() {
    // A fine sphere with exact normals against the exact ball: a ray at height h is turned twice by asin h − asin(h/n).
    let (n, h) = (1.5f64, 0.5f64);
    let mut scene = HandScene::parallel(Vec3::new(0.0, h as f32, 5.0), Vec3::NEG_Z, 1e-3);
    scene.add(catoptra_engine::shapes::sphere(1.0, 256, 512), Material::glass(Vec3::ONE, n as f32), Affine3::IDENTITY);
    let (wall, material) = wall_of_positions(Vec3::Z * -4.0, Vec3::X * 4.0, Vec3::Y * 4.0);
    scene.add(wall, material, Affine3::IDENTITY);
    let seen = scene.pixel(|s| s.max_depth = 2);
    let landed = f64::from((seen.y / seen.z - 0.5) * 8.0);
    let (i, t) = (libm::asin(h), libm::asin(h / n));
    let turn = 2.0 * (i - t);
    // The chord subtends π − 2t at the centre: the ray leaves 2t − i above the axis.
    let exit = 2.0 * t - i;
    let expected = libm::sin(exit) - libm::tan(turn) * (4.0 - libm::cos(exit));
    // Metres: 512 facets round leave 2e-5 of the radius, four metres of lever behind it.
    assert_close("landing height", landed, expected, 2e-3);
    assert!((landed - h).abs() > 0.5, "it is bent at all");
}

/// A prism with the right angle at the front and the floor: in through the front face, hypotenuse at 45 degrees.
fn prism() -> Mesh {
    // Cross-section in (z, y): (0, 0), (0, 1), (-1, 0); the hypotenuse joins the last two.
    let corner = |z: f32, y: f32, x: f32| Vec3::new(x, y, z);
    let [a0, b0, c0] = [(0.0, 0.0), (0.0, 1.0), (-1.0, 0.0)].map(|(z, y)| corner(z, y, -1.0));
    let [a1, b1, c1] = [(0.0, 0.0), (0.0, 1.0), (-1.0, 0.0)].map(|(z, y)| corner(z, y, 1.0));
    let mut b = ShapeBuilder::default();
    b.quad([a0, a1, b1, b0], Vec3::ONE);
    b.quad([b0, b1, c1, c0], Vec3::ONE);
    b.quad([c0, c1, a1, a0], Vec3::ONE);
    b.triangle([a0, b0, c0], Vec3::ONE);
    b.triangle([a1, c1, b1], Vec3::ONE);
    let mesh = b.build();
    assert!(mesh.closed());
    mesh
}

#[test]
fn total_internal_reflection() {
    // The ray comes in along -z at y = 0.4, meets the hypotenuse at z = -0.6 and, where it is reflected, leaves downwards.
    let seen = |ior: f32| {
        let mut scene = HandScene::parallel(Vec3::new(0.1, 0.4, 3.0), Vec3::NEG_Z, 1e-3);
        scene.add(prism(), Material::glass(Vec3::ONE, ior), Affine3::IDENTITY);
        let (wall, material) = wall_of_positions(Vec3::new(0.0, -2.0, -0.5), Vec3::X * 2.0, Vec3::Z * 2.0);
        scene.add(wall, material, Affine3::IDENTITY);
        scene.pixel(|s| s.max_depth = 3)
    };
    let total = seen(1.5);
    // Two normal passes of 96% each, nothing lost at the hypotenuse.
    assert_relative("weight", f64::from(total.z), 0.96 * 0.96, 1e-5);
    assert_close("x", f64::from((total.x / total.z - 0.5) * 4.0), 0.1, 1e-5);
    assert_close("z", f64::from((total.y / total.z - 0.5) * 4.0 - 0.5), -0.6, 1e-5);

    // Below the critical index (1.414) part of the light leaves through the hypotenuse.
    let partial = f64::from(seen(1.3).z);
    let normal = f64::from(fresnel_dielectric(1.0, 1.0 / 1.3));
    let oblique = f64::from(fresnel_dielectric(std::f32::consts::FRAC_1_SQRT_2, 1.3));
    assert!(oblique < 0.2);
    assert_relative("partial", partial, (1.0 - normal) * (1.0 - normal) * oblique, 1e-4);
}

/// Two mirrors 1 m apart; the ray enters at 45 degrees and meets one or the other each metre, then a wall of radiance 1.
fn corridor(
    bounces: u32,
    tint: f32,
    share: f32,
    change: impl FnOnce(&mut catoptra_render_hybrid::RenderSettings),
) -> f64 {
    let mut scene = HandScene::parallel(Vec3::new(-0.5, 0.0, 0.5), Vec3::new(1.0, 0.0, -1.0), 1e-3);
    for x in [0.0f32, -1.0] {
        let mut b = ShapeBuilder::default();
        let p = |y: f32, z: f32| Vec3::new(x, y, z);
        b.quad([p(-1.0, 1.0), p(1.0, 1.0), p(1.0, -99.0), p(-1.0, -99.0)], Vec3::ONE);
        scene.add(b.build(), Material::mirror(Vec3::splat(tint), share), Affine3::IDENTITY);
    }
    let (wall, material) = glowing_wall(0.5 - bounces as f32, Vec3::ONE);
    scene.add(wall, material, Affine3::IDENTITY);
    f64::from(scene.pixel(change).x)
}

#[test]
fn a_mirror_corridor_fades_by_its_tint() {
    for bounces in [1u32, 2, 5, 12] {
        let expected = (0..bounces).fold(1.0, |p, _| p * 0.9f64);
        let seen = corridor(bounces, 0.9, 1.0, |s| (s.max_depth, s.min_weight) = (bounces, 1e-4));
        assert_relative(&format!("{bounces} reflections"), seen, expected, ROUNDING);
        // A mixed mirror keeps its share each time; the rest is matte and unlit here.
        let expected = (0..bounces).fold(1.0, |p, _| p * 0.9f64 * 0.75);
        let seen = corridor(bounces, 0.9, 0.75, |s| (s.max_depth, s.min_weight) = (bounces, 1e-6));
        assert_relative(&format!("{bounces} reflections of a mixed mirror"), seen, expected, ROUNDING);
    }
}

#[test]
fn depth_limit_counts_interfaces() {
    for bounces in [1u32, 3, 7] {
        let at_depth = |d: u32| corridor(bounces, 0.9, 1.0, |s| (s.max_depth, s.min_weight) = (d, 1e-4));
        assert!(at_depth(bounces) > 0.0 && at_depth(bounces + 1) == at_depth(bounces));
        if bounces > 1 {
            assert_eq!(at_depth(bounces - 1), 0.0, "{bounces} reflections at depth {}", bounces - 1);
        }
    }
}

#[test]
fn weight_cutoff_ends_rays() {
    // 0.5⁴ = 0.0625 is the weight of the fourth reflection.
    let with = |min_weight: f32| corridor(4, 0.5, 1.0, |s| (s.max_depth, s.min_weight) = (8, min_weight));
    assert_relative("just below", with(0.0624), 0.0625, ROUNDING);
    assert_eq!(with(0.0626), 0.0, "just above");
}

#[test]
fn a_parallel_mirror_pair_ends_at_the_limit() {
    // Rays that never leave: the corridor's end is taken away and the walls are perfect.
    let mut scene = HandScene::parallel(Vec3::new(0.0, 0.0, 0.5), Vec3::NEG_Z, 1.0).background(Vec3::ONE);
    let (front, back) = (glowing_wall(1.0, Vec3::ONE).0, glowing_wall(0.0, Vec3::ONE).0);
    for mesh in [front, back] {
        scene.add(mesh, Material::mirror(Vec3::ONE, 1.0), Affine3::IDENTITY);
    }
    let frame = scene.render(&catoptra_render_hybrid::RenderSettings {
        max_depth: 64,
        min_weight: 0.0,
        ..HandScene::settings(8, 8)
    });
    assert_eq!(frame.stats.rays.reflection, 64 * 64, "64 pixels, 64 reflections each");
    assert!(frame.image.pixels.iter().all(|p| *p == [0.0; 3]));
}
