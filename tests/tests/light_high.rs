//! What the preset for stills adds: VPLs chosen by what they give to the picture, and the near field of the grid's places.

use catoptra_engine::{Camera, LightKind, Material, RenderScene, shapes};
use catoptra_render_hybrid::{
    BlasKind, Image, Layer, NearField, Preset, RasterLane, RenderSettings, Renderer, RendererOptions, Shadows,
    SimdLevel, VplOptions, VplPlacement, metrics,
    raster::GpuRaster,
    trace::reference::{ReferenceAccumulator, ReferenceOptions},
};
use catoptra_tests::{
    HandScene, at,
    fixtures::{cpu, cpu_with, fresh, full_vpls, scene_at, small},
    opened_or_skip,
};
use glam::Vec3;

fn slab(half: Vec3) -> catoptra_engine::Mesh {
    shapes::cuboid(half, [Vec3::ONE; 6])
}

fn mean(image: &Image) -> f64 {
    image.pixels.iter().flatten().map(|v| f64::from(*v)).sum::<f64>() / (3 * image.pixels.len()) as f64
}

/// The `high` preset at 128 x 128, small enough for tests: a place every other pixel, and VPLs on light paths, among which there
/// is a choice.
fn high() -> RenderSettings {
    let preset = RenderSettings::preset(Preset::High);
    let base = small(128, 128, 128);
    let vpl = preset.vpl.map(|v| VplOptions {
        count: 256,
        placement: VplPlacement::Paths,
        bounces: 2,
        spacing: 2,
        map_size: 16,
        ..v
    });
    RenderSettings { vpl, shadows: preset.shadows, ..base }
}

fn with(settings: RenderSettings, change: impl FnOnce(&mut VplOptions)) -> RenderSettings {
    let mut vpl = settings.vpl.unwrap();
    change(&mut vpl);
    RenderSettings { vpl: Some(vpl), ..settings }
}

fn truth(scene: &RenderScene, settings: &RenderSettings, spp: u32) -> Image {
    let mut sums = ReferenceAccumulator::new(settings.width, settings.height);
    cpu().add_reference(&mut sums, scene, &ReferenceOptions::matching(settings), spp).unwrap();
    sums.image()
}

fn chosen(settings: RenderSettings, count: u32, candidates: u32) -> RenderSettings {
    with(settings, |v| (v.count, v.candidates, v.near_field) = (count, candidates, NearField::Off))
}

/// A floor of 40 m with a light high above, most of which lies outside of the picture.
fn wide_floor() -> HandScene {
    let mut scene = HandScene::new(Camera::looking_at(Vec3::new(0.0, 1.0, 3.0), Vec3::new(0.0, 0.5, 0.0), 0.9));
    let white = Material::lambert(Vec3::splat(0.7));
    scene.add(slab(Vec3::new(20.0, 0.1, 20.0)), white, at(Vec3::NEG_Y * 0.1));
    scene.add(slab(Vec3::new(1.5, 1.0, 0.05)), white, at(Vec3::new(0.0, 1.0, -1.0)));
    // Turned away from the light: what it sees of the floor is all its light.
    scene.add(slab(Vec3::new(0.8, 0.05, 0.4)), white, at(Vec3::new(0.0, 1.2, -0.2)));
    scene.light(LightKind::Directional, Vec3::ZERO, Vec3::splat(2.0)).direction_world =
        Vec3::new(0.2, -1.0, -0.1).normalize();
    scene
}

#[test]
fn chosen_vpls_are_worth_all_candidates() {
    let scene = wide_floor();
    let base = RenderSettings { traced: false, keep_layers: true, ..high() };
    let indirect = |settings: &RenderSettings| scene.render(settings).layer(Layer::Indirect).unwrap().clone();
    let oracle = indirect(&chosen(base, 16_384, 1));
    let error = |count, candidates| metrics::rel_mse(&indirect(&chosen(base, count, candidates)), &oracle);
    for count in [256, 1024] {
        let (blind, best, all) = (error(count, 1), error(count, 4), error(4 * count, 1));
        println!("relMSE of {count} VPLs: {blind:.4}, best of four times as many {best:.4}, those {all:.4}");
        assert!(best < 1.05 * all && best < 0.5 * blind, "{count}: {best} of {all}, {blind}");
    }
}

#[test]
fn a_choice_belongs_to_its_camera() {
    let settings = chosen(high(), 64, 8);
    let scene = scene_at("rolling-box-sponza", 30);
    let mut turned = scene.clone();
    turned.camera = Camera::looking_at(Vec3::new(2.0, 2.0, 1.0), Vec3::new(-5.0, 2.0, 0.5), 1.0);
    let mut renderer = cpu();
    let first = renderer.render(&scene, &settings).unwrap();
    assert!(first.stats.vpls <= 64 && first.stats.vpls > 48, "{} VPLs", first.stats.vpls);
    let other = renderer.render(&turned, &settings).unwrap();
    assert_eq!(other.image, fresh(&turned, &settings).image, "what the camera before had chosen is forgotten");
    assert_eq!(renderer.render(&scene, &settings).unwrap().image, first.image);
    let again = renderer.render(&scene, &settings).unwrap();
    assert_eq!(again.image, first.image);
    assert_eq!(again.stats.rays.photon, 0, "a still picture keeps its choice");
}

/// Two walls and a floor that meet in a corner, and a lamp that shines on one wall's foot.
fn corner() -> HandScene {
    let mut scene = HandScene::new(Camera::looking_at(Vec3::new(2.4, 1.6, 2.4), Vec3::new(0.4, 0.4, 0.4), 0.8));
    let white = Material::lambert(Vec3::splat(0.8));
    scene.add(slab(Vec3::new(3.0, 0.1, 3.0)), white, at(Vec3::new(3.0, -0.1, 3.0)));
    scene.add(slab(Vec3::new(0.1, 2.0, 3.0)), white, at(Vec3::new(-0.1, 2.0, 3.0)));
    scene.add(slab(Vec3::new(3.0, 2.0, 0.1)), white, at(Vec3::new(3.0, 2.0, -0.1)));
    let light =
        scene.light(LightKind::Spot { cos_inner: 0.96, cos_outer: 0.9 }, Vec3::new(2.5, 2.5, 1.0), Vec3::splat(20.0));
    light.direction_world = Vec3::new(-1.0, -0.9, -0.1).normalize();
    scene
}

#[test]
fn the_near_field_brings_back_what_the_bound_cuts_off() {
    let scene = corner();
    // A low bound, which cuts off much; what the VPLs of the near field lose by it is the square of that.
    let base = RenderSettings { traced: false, shadows: Shadows::Traced, ..high() };
    let base = with(base, |v| (v.count, v.candidates, v.geometry_term_max) = (2048, 1, Some(15.0)));
    let reference = truth(&scene.0, &base, 256);
    let of = |near_field| {
        let image = scene.render(&with(base, |v| v.near_field = near_field)).image;
        (mean(&image) / mean(&reference), metrics::rel_mse(&image, &reference))
    };
    let ((dark, error_without), (right, error)) = (of(NearField::Off), of(NearField::Full));
    println!("light {dark:.4} and {right:.4} of the truth, relMSE {error_without:.5} and {error:.5}");
    assert!(dark < 0.97, "the bound must cut something off: {dark}");
    assert!((right - 1.0).abs() < 0.015, "{right}");
    assert!(error < 0.3 * error_without, "{error} against {error_without}");
    // Few rays find the light alone, in this corner all there is to find.
    let (light, error) = of(NearField::Light);
    println!("the light alone: {light:.4} of the truth, relMSE {error:.5}");
    assert!((light - 1.0).abs() < 0.02 && error < 0.4 * error_without, "{light}, {error} against {error_without}");
}

#[test]
fn the_near_field_sees_occluders_that_maps_miss() {
    // A plate just above a floor, lit by a far wall that a lamp shines on.
    let mut scene = HandScene::new(Camera::looking_at(Vec3::new(0.0, 0.9, 2.2), Vec3::new(0.0, 0.0, 0.1), 0.7));
    let (white, black) = (Material::lambert(Vec3::splat(0.8)), Material::lambert(Vec3::ZERO));
    scene.add(slab(Vec3::new(8.0, 0.1, 8.0)), white, at(Vec3::NEG_Y * 0.1));
    scene.add(slab(Vec3::new(8.0, 4.0, 0.1)), white, at(Vec3::new(0.0, 4.0, 8.1)));
    scene.add(slab(Vec3::new(0.5, 0.01, 0.5)), black, at(Vec3::new(0.0, 0.16, 0.0)));
    let light =
        scene.light(LightKind::Spot { cos_inner: 0.9, cos_outer: 0.8 }, Vec3::new(0.0, 4.0, 3.0), Vec3::splat(60.0));
    light.direction_world = Vec3::Z;
    let base = RenderSettings { traced: false, keep_layers: true, ..high() };
    let indirect =
        |vpl| scene.render(&RenderSettings { vpl: Some(vpl), ..base }).layer(Layer::Indirect).unwrap().clone();
    let vpl = VplOptions { candidates: 1, count: 512, ..base.vpl.unwrap() };
    let oracle = indirect(full_vpls(2048, 2));
    let error = |near_field| metrics::rel_mse(&indirect(VplOptions { near_field, ..vpl }), &oracle);
    let (without, with) = (error(NearField::Off), error(NearField::Full));
    println!("relMSE {without:.2e} by maps, {with:.2e} with the near field");
    assert!(with < 0.6 * without, "{with} against {without}");
}

#[test]
fn one_hash_for_threads_levels_and_trees() {
    let scene = scene_at("rolling-box-venus", 30);
    let settings = high();
    let hash = |options| cpu_with(options).render(&scene, &settings).unwrap().image.hash();
    let expected = hash(RendererOptions::default());
    for (threads, simd, blas) in [
        (1, SimdLevel::Portable, BlasKind::Bvh),
        (2, SimdLevel::Auto, BlasKind::KdTree),
        (3, SimdLevel::Portable, BlasKind::KdTree),
    ] {
        let options = RendererOptions { threads, simd, blas, ..RendererOptions::default() };
        assert_eq!(hash(options), expected, "{threads} threads, {simd:?}, {blas:?}");
    }
    for (what, change) in [
        ("candidates", with(settings, |v| v.candidates = 1)),
        ("the near field", with(settings, |v| v.near_field = NearField::Off)),
    ] {
        let other = fresh(&scene, &change).image.hash();
        assert_ne!(other, expected, "{what} does not show");
    }
}

/// Without VPLs there is no grid: the scene is dark, and no lane minds.
#[test]
fn a_scene_without_lights_is_dark_on_both_lanes() {
    let mut scene = scene_at("rolling-box", 0);
    scene.lights.clear();
    for raster in [RasterLane::Cpu, RasterLane::Gpu] {
        let options = RendererOptions { raster, ..RendererOptions::default() };
        if raster == RasterLane::Gpu && opened_or_skip("a_scene_without_lights", GpuRaster::new()).is_none() {
            continue;
        }
        let mut renderer = Renderer::new(options).unwrap();
        let mut high = high();
        high.keep_layers = true;
        let frame = renderer.render(&scene, &high).unwrap();
        assert_eq!(mean(frame.layer(Layer::Indirect).unwrap()), 0.0, "{raster:?}");
    }
}

#[test]
fn the_lanes_agree() {
    if opened_or_skip("the_lanes_agree", GpuRaster::new()).is_none() {
        return;
    }
    let lane = |raster| Renderer::new(RendererOptions { raster, ..RendererOptions::default() }).unwrap();
    let (mut cpu, mut gpu) = (lane(RasterLane::Cpu), lane(RasterLane::Gpu));
    for name in ["rolling-box", "rolling-box-sponza"] {
        let scene = scene_at(name, 30);
        let filtered = RenderSettings { shadows: Shadows::Moments, ..high() };
        for (what, settings) in [
            ("certified", high()),
            ("filtered", filtered),
            // Nothing of the grid that the CPU sent may stay behind.
            ("no near field", with(filtered, |v| v.near_field = NearField::Off)),
        ] {
            let (a, b) = (gpu.render(&scene, &settings).unwrap(), cpu.render(&scene, &settings).unwrap());
            let c = metrics::compare(&a.image, &b.image).unwrap();
            println!("{name}, {what}: FLIP mean {:.5}, p99 {:.4}", c.flip.mean(), c.flip.percentile(0.99));
            assert!(c.flip.mean() <= 0.005 && c.flip.percentile(0.99) <= 0.08, "{name}, {what}: {}", c.flip.mean());
        }
    }
}
