//! Light against formulas: the cosine law, a furnace of emitting walls, one VPL in a picture, the flux of all VPLs of a
//! closed box, a highlight, and the moments of a known penumbra.

use catoptra_engine::{
    Camera, LightKind, Material, RenderScene, math,
    shapes::{ShapeBuilder, cuboid, sphere},
};
use catoptra_render_hybrid::{
    BlasKind, Layer, RenderSettings, Shadows, SimdLevel, VplOptions,
    accel::{Accel, AccelOptions},
    trace::{
        photons::Photons,
        reference::{ReferenceAccumulator, ReferenceOptions},
        surface::NormalMatrices,
    },
    twin::{
        shading::blinn_phong_normalization,
        vpl::{Vpl, vpl_irradiance},
    },
};
use catoptra_tests::{
    HandScene, assert_close, assert_relative,
    fixtures::{cpu, full_vpls, small},
};
use glam::{Affine3, Vec3};
use std::f64::consts::PI;

/// Relative; sums of a few single-precision products.
const ROUNDING: f64 = 5e-6;

/// A floor of ±50 m under parallel camera rays from straight above.
fn floor(material: Material) -> HandScene {
    let mut scene = HandScene::parallel(Vec3::new(0.0, 5.0, 0.0), Vec3::NEG_Y, 1e-3);
    let mut b = ShapeBuilder::default();
    b.quad([[-50.0, 50.0], [50.0, 50.0], [50.0, -50.0], [-50.0, -50.0]].map(|[x, z]| Vec3::new(x, 0.0, z)), Vec3::ONE);
    scene.add(b.build(), material, Affine3::IDENTITY);
    scene
}

/// Direction towards the ground that comes from `degrees` off the zenith.
fn slanted(degrees: f32) -> Vec3 {
    let (s, c) = math::sin_cos(degrees.to_radians());
    Vec3::new(s, -c, 0.0)
}

#[test]
fn cosine_law() {
    for degrees in [0.0f32, 30.0, 60.0, 85.0] {
        let mut scene = floor(Material::lambert(Vec3::new(0.8, 0.5, 0.2)));
        scene.light(LightKind::Directional, Vec3::ZERO, Vec3::splat(3.0)).direction_world = slanted(degrees);
        let seen = scene.pixel(|_| ());
        for (c, rho) in [0.8f64, 0.5, 0.2].into_iter().enumerate() {
            let expected = rho / PI * 3.0 * math::cos_f64(f64::from(degrees).to_radians());
            // The cosine of a rounded angle: absolute 1e-7 of a value that falls to 0.09.
            assert_relative(&format!("{degrees} degrees"), f64::from(seen[c]), expected, ROUNDING);
            assert!((f64::from(seen[c]) / (expected * 1.0001) - 1.0).abs() > ROUNDING);
        }
    }
    // From below there is no light, though shading is two-sided: the floor itself shades its upper side.
    let mut scene = floor(Material::lambert(Vec3::ONE));
    scene.light(LightKind::Directional, Vec3::ZERO, Vec3::ONE).direction_world = Vec3::Y;
    assert_eq!(scene.pixel(|_| ()), Vec3::ZERO);
}

#[test]
fn highlight_is_the_normalised_lobe() {
    for (degrees, shininess) in [(0.0f32, 1.0f32), (20.0, 32.0), (40.0, 200.0)] {
        let k = Vec3::new(0.5, 0.25, 0.1);
        let mut scene = floor(Material { specular: k, shininess, ..Material::lambert(Vec3::ZERO) });
        scene.light(LightKind::Directional, Vec3::ZERO, Vec3::splat(2.0)).direction_world = slanted(degrees);
        let seen = scene.pixel(|_| ());
        let angle = f64::from(degrees).to_radians();
        // The viewer is at the zenith: H lies half-way.
        let lobe =
            f64::from(blinn_phong_normalization(shininess)) * libm::pow(libm::cos(angle / 2.0), f64::from(shininess));
        for c in 0..3 {
            let expected = f64::from(k[c]) * lobe * math::cos_f64(angle) * 2.0;
            // Relative; the exponent multiplies the rounding of the cosine.
            assert_relative("highlight", f64::from(seen[c]), expected, ROUNDING * f64::from(shininess).max(1.0));
        }
    }
}

#[test]
fn every_light_adds() {
    let render = |lights: &[usize]| {
        let mut scene = floor(Material::lambert(Vec3::splat(0.7)));
        for &i in lights {
            let kind =
                [LightKind::Point, LightKind::Spot { cos_inner: 0.9, cos_outer: 0.5 }, LightKind::Directional][i];
            scene.light(kind, Vec3::new(0.5, 2.0, 0.3), Vec3::splat(1.0 + i as f32));
        }
        scene.pixel(|_| ())
    };
    let sum = render(&[0]) + render(&[1]) + render(&[2]);
    assert!(render(&[0]).x > 0.0 && render(&[1]).x > 0.0 && render(&[2]).x > 0.0);
    assert_relative("three lights", f64::from(render(&[0, 1, 2]).x), f64::from(sum.x), 1e-6);
}

/// A closed sphere of radius 2 that emits; everything in it has one radiance.
fn furnace(rho: f32, emitted: f32) -> RenderScene {
    let mut scene = HandScene::new(Camera::looking_at(Vec3::new(0.3, 0.2, 1.0), Vec3::ZERO, 1.2));
    let material = Material { emissive: Vec3::splat(emitted), ..Material::lambert(Vec3::splat(rho)) };
    scene.add(sphere(2.0, 48, 96), material, Affine3::IDENTITY);
    scene.0
}

#[test]
fn furnace_of_emitting_walls() {
    let (rho, emitted) = (0.5f64, 0.25f64);
    let scene = furnace(rho as f32, emitted as f32);
    for bounces in [1u32, 2, 4] {
        // What is emitted, what one reflection of it adds, and `bounces` more before that last one.
        let series = |n: u32| (0..=n).fold((0.0, 1.0), |(s, p), _| (s + p, p * rho)).0 * emitted;
        let expected = series(bounces + 1);
        let settings =
            RenderSettings { vpl: Some(full_vpls(512 * (bounces + 1), bounces)), ..HandScene::settings(16, 12) };
        let image = cpu().render(&scene, &settings).unwrap().image;
        let mean = image.pixels.iter().map(|p| f64::from(p[0])).sum::<f64>() / image.pixels.len() as f64;
        println!("furnace, {bounces} bounces: {mean:.5} by VPLs for {expected:.5}");
        // Relative; flat facets, and how evenly 512 paths start on both sides of the walls.
        assert_relative(&format!("VPLs of {bounces} bounces"), mean, expected, 0.004);
        assert!((mean / series(bounces + 2) - 1.0).abs() > 0.004, "one bounce more is seen");

        let mut sums = ReferenceAccumulator::new(16, 12);
        let options = ReferenceOptions { bounces, ..ReferenceOptions::matching(&settings) };
        cpu().add_reference(&mut sums, &scene, &options, 64).unwrap();
        let truth = sums.image();
        let mean = truth.pixels.iter().map(|p| f64::from(p[0])).sum::<f64>() / truth.pixels.len() as f64;
        println!("furnace, {bounces} bounces: {mean:.5} by reference for {expected:.5}");
        // Relative. Every path has one value, but for the few that an interpolated normal sends below their facet.
        assert_relative(&format!("reference of {bounces} bounces"), mean, expected, 5e-4);
        assert!((mean / series(bounces + 2) - 1.0).abs() > 5e-4, "one bounce more is seen");
    }
}

/// VPLs of a scene as the renderer makes them.
fn vpls_of(scene: &RenderScene, options: VplOptions) -> Vec<Vpl> {
    let mut accel =
        Accel::new(AccelOptions { blas: BlasKind::Bvh, simd: SimdLevel::Portable, ..Default::default() }).unwrap();
    accel.update(scene);
    let mut normals = NormalMatrices::default();
    normals.update(scene);
    let mut photons = Photons::default();
    photons.trace(scene, &normals, &accel, &options, 0);
    photons.vpls
}

/// A closed white box of half size 1 with the light in it.
fn box_with(kind: LightKind, albedo: f32, intensity: f32) -> RenderScene {
    let mut scene = HandScene::new(Camera::looking_at(Vec3::new(0.0, 0.2, 0.9), Vec3::ZERO, 1.2));
    scene.add(cuboid(Vec3::ONE, [Vec3::ONE; 6]), Material::lambert(Vec3::splat(albedo)), Affine3::IDENTITY);
    scene.light(kind, Vec3::new(0.3, 0.5, -0.2), Vec3::splat(intensity));
    scene.0
}

fn flux(vpls: &[Vpl]) -> f64 {
    vpls.iter().map(|v| f64::from(v.flux.x)).sum()
}

#[test]
fn vpls_of_a_closed_box_carry_all_the_flux() {
    let (albedo, intensity) = (0.6f64, 2.0f64);
    for bounces in [1u32, 2, 5] {
        let scene = box_with(LightKind::Point, albedo as f32, intensity as f32);
        let vpls = vpls_of(&scene, full_vpls(64 * bounces, bounces));
        assert_eq!(vpls.len(), 64 * bounces as usize, "no path of a closed box is lost");
        // 4πI, of which each reflection leaves the albedo: a sum without noise.
        let reflected = (0..bounces).fold((0.0, albedo), |(s, p), _| (s + p, p * albedo)).0;
        let expected = 4.0 * PI * intensity * reflected;
        assert_relative(&format!("{bounces} bounces"), flux(&vpls), expected, 1e-5);
        assert!((flux(&vpls) / (expected * 1.001) - 1.0).abs() > 1e-5);
    }
}

#[test]
fn vpls_of_a_spot_carry_its_falloff() {
    let (inner, outer) = (0.9f64, 0.7f64);
    let kind = LightKind::Spot { cos_inner: inner as f32, cos_outer: outer as f32 };
    let scene = box_with(kind, 0.5, 3.0);
    let vpls = vpls_of(&scene, full_vpls(256, 1));
    // ∫ of ((cos − outer)/(inner − outer))² over the rim is a third of its width; the core counts whole.
    let expected = 0.5 * 3.0 * 2.0 * PI * ((1.0 - inner) + (inner - outer) / 3.0);
    // Relative; midpoint rule of 256 strata over a parabola with a kink.
    assert_relative("spot", flux(&vpls), expected, 1e-3);
    assert!(vpls.iter().all(|v| v.position_world.y < 0.5), "none lies above the light");
}

#[test]
fn photons_are_shared_by_power_and_no_light_is_forgotten() {
    let mut scene = HandScene(box_with(LightKind::Point, 0.5, 1.0));
    scene.light(LightKind::Point, Vec3::new(-0.5, 0.0, 0.0), Vec3::splat(0.001));
    let vpls = vpls_of(&scene.0, full_vpls(64, 1));
    let expected = 0.5 * 4.0 * PI * 1.001;
    assert_relative("flux of a strong and a weak light", flux(&vpls), expected, 1e-5);
    scene.0.lights.clear();
    assert!(vpls_of(&scene.0, full_vpls(64, 1)).is_empty(), "no light, no VPLs");
}

#[test]
fn a_picture_is_the_sum_of_its_vpls() {
    let scene = box_with(LightKind::Point, 0.6, 2.0);
    for count in [1, 7] {
        let options = full_vpls(count, 1);
        let settings = RenderSettings { vpl: Some(options), keep_layers: true, ..HandScene::settings(8, 8) };
        let frame = cpu().render(&scene, &settings).unwrap();
        let vpls = vpls_of(&scene, options);
        assert_eq!(vpls.len(), count as usize);
        let mut lit = 0;
        for y in 0..8 {
            for x in 0..8 {
                // The box is convex: whatever faces a VPL sees it.
                let (origin, direction) = scene.camera.ray(x as f32 + 0.5, y as f32 + 0.5, 8, 8);
                let away = |o: f32, d: f32| if d > 0.0 { (1.0 - o) / d } else { (-1.0 - o) / d };
                let t = [0, 1, 2].map(|a| away(origin[a], direction[a]));
                let axis = (0..3).min_by(|a, b| t[*a].total_cmp(&t[*b])).unwrap();
                let place = origin + direction * t[axis];
                let mut normal = Vec3::ZERO;
                normal[axis] = -direction[axis].signum();
                let sum: Vec3 = vpls.iter().map(|v| vpl_irradiance(v, place, normal, f32::INFINITY)).sum();
                let expected = f64::from(sum.x) * 0.6 / PI;
                let seen = f64::from(frame.layer(Layer::Indirect).unwrap().at(x, y)[0]);
                // Relative: the two places differ by a rounding, next to a VPL that shows.
                assert_close(&format!("{count} VPLs, pixel {x},{y}"), seen, expected, 1e-4 * expected + 1e-6);
                lit += u32::from(seen > 0.0);
            }
        }
        assert!(lit > 16, "{lit} pixels are lit");
    }
}

#[test]
fn the_bound_takes_light_away_and_nothing_else() {
    let scene = box_with(LightKind::Point, 0.6, 2.0);
    let render = |bound| {
        let vpl = VplOptions { geometry_term_max: bound, ..full_vpls(256, 1) };
        let settings = RenderSettings { vpl: Some(vpl), ..small(24, 24, 64) };
        cpu().render(&scene, &settings).unwrap().image
    };
    let (free, bounded, loose) = (render(None), render(Some(1.0)), render(Some(1e9)));
    assert_eq!(free.hash(), loose.hash(), "a bound that nothing reaches is none");
    let sum = |image: &catoptra_render_hybrid::Image| image.pixels.iter().map(|p| f64::from(p[0])).sum::<f64>();
    assert!(bounded.pixels.iter().zip(&free.pixels).all(|(b, f)| b[0] <= f[0]));
    println!("light lost to a bound of 1/radius²: {:.1}%", 100.0 * (1.0 - sum(&bounded) / sum(&free)));
    assert!(sum(&bounded) < 0.99 * sum(&free));
}

/// A half plane at height 1 over the floor, lit from the zenith by a light of angular radius `radius`: on the floor the lit
/// fraction at distance x from the edge's shadow is that of a disc of this radius cut at x.
fn penumbra(x: f32, radius: f32, samples: u32) -> f64 {
    let mut scene = floor(Material::lambert(Vec3::ONE));
    let mut b = ShapeBuilder::default();
    // The camera looks under it: from beside, along a slant that meets the floor at x.
    b.quad([[-50.0, 50.0], [0.0, 50.0], [0.0, -50.0], [-50.0, -50.0]].map(|[x, z]| Vec3::new(x, 1.0, z)), Vec3::ONE);
    scene.add(b.build(), Material::lambert(Vec3::ONE), Affine3::IDENTITY);
    let eye = Vec3::new(x + 3.0, 0.9, 0.0);
    let camera = HandScene::parallel(eye, Vec3::new(x, 0.0, 0.0) - eye, 1e-3).0.camera;
    scene.0.camera = camera;
    scene.light(LightKind::Directional, Vec3::ZERO, Vec3::splat(PI as f32)).radius = radius;
    f64::from(scene.pixel(|s| (s.shadows, s.shadow_samples) = (Shadows::Traced, samples)).x)
}

#[test]
fn traced_penumbra_is_the_cut_disc() {
    let radius = 0.2f64;
    for x in [-0.25f64, -0.15, -0.08, 0.0, 0.08, 0.15, 0.25] {
        let u = (x / radius).clamp(-1.0, 1.0);
        // Fraction of the disc on the open side of the edge.
        let expected = 0.5 + (u * (1.0 - u * u).sqrt() + libm::asin(u)) / PI;
        let seen = penumbra(x as f32, radius as f32, 4096);
        // Fraction of light: 4096 points of a spiral.
        assert_close(&format!("x = {x}"), seen, expected, 2e-3);
        let few = penumbra(x as f32, radius as f32, 16);
        assert_close(&format!("x = {x}, 16 samples"), few, expected, 0.13);
        let hard = penumbra(x as f32, 0.0, 16);
        assert_eq!(hard, if x < 0.0 { 0.0 } else { hard }, "radius 0 gives a hard edge");
        assert!(x == 0.0 || (hard - if x > 0.0 { 1.0 } else { 0.0 }).abs() < 1e-5);
    }
}
