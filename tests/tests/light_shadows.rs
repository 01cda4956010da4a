//! Shadows of lights and of VPLs: no leaks, certified shadows equal traced ones, the lanes agree with every option.

use catoptra_engine::{Camera, LightKind, Material, RenderScene, shapes};
use catoptra_render_hybrid::{
    Image, Layer, RasterLane, RenderSettings, Renderer, RendererOptions, ShadowFilter, Shadows, VplOptions, VplShadows,
    metrics, raster::GpuRaster,
};
use catoptra_tests::{
    HandScene, at,
    fixtures::{cpu, fresh, scene_at, small},
    opened_or_skip,
};
use glam::Vec3;

fn mean(image: &Image) -> f64 {
    image.pixels.iter().flatten().map(|v| f64::from(*v)).sum::<f64>() / (3 * image.pixels.len()) as f64
}

fn slab(half: Vec3) -> catoptra_engine::Mesh {
    shapes::cuboid(half, [Vec3::ONE; 6])
}

/// The floor under the edge of an upper occluder, all of it covered by a lower one at height `lower`.
fn stacked_occluders(lower: f32) -> HandScene {
    let mut scene = HandScene::parallel(Vec3::new(0.0, 0.3, 1.5), Vec3::new(0.0, -0.3, -1.5), 0.12);
    let white = Material::lambert(Vec3::splat(0.8));
    scene.add(slab(Vec3::new(6.0, 0.05, 6.0)), white, at(Vec3::NEG_Y * 0.05));
    scene.add(slab(Vec3::new(1.0, 0.02, 2.0)), white, at(Vec3::new(-1.0, 2.5, 0.0)));
    scene.add(slab(Vec3::new(0.8, 0.02, 0.8)), white, at(Vec3::Y * lower));
    scene.light(LightKind::Spot { cos_inner: 0.85, cos_outer: 0.75 }, Vec3::Y * 4.0, Vec3::splat(40.0));
    scene
}

#[test]
fn stacked_occluders_do_not_leak() {
    for lower in [0.6f32, 1.2, 2.0] {
        let scene = stacked_occluders(lower);
        let share = |filter, light_bleed_reduction| {
            let mut settings = small(64, 64, 512);
            settings.vpl = None;
            settings.moments.filter = filter;
            settings.moments.light_bleed_reduction = light_bleed_reduction;
            let lit = RenderSettings { shadows: Shadows::Off, ..settings };
            mean(&scene.render(&settings).image) / mean(&scene.render(&lit).image)
        };
        let reduction = RenderSettings::default().moments.light_bleed_reduction;
        let default = share(ShadowFilter::default(), reduction);
        let bare = share(ShadowFilter::Evsm4, 0.0);
        let classic = share(ShadowFilter::Vsm, 0.0);
        println!(
            "lower occluder at {lower} m: default {default:.5}, evsm4 without reduction {bare:.5}, vsm {classic:.4}"
        );
        assert!(default <= 0.01, "{lower} m: {default}");
        assert!(bare <= 0.01, "{lower} m: {bare}");
        // The nearer the two occluders are to each other, the less plain moments bleed.
        assert!(classic > 0.012 || lower > 1.5, "{lower} m: the classic bleed must show: {classic}");
    }
}

/// Two closed chambers, one with a light; the camera is in the chamber on the side of `x`.
fn two_rooms(x: f32) -> RenderScene {
    let mut scene =
        HandScene::new(Camera::looking_at(Vec3::new(1.7 * x, 0.3, 0.7), Vec3::new(0.5 * x, -0.3, -0.5), 1.2));
    let white = Material::lambert(Vec3::splat(0.7));
    // The room's inside: shading is two-sided.
    scene.add(slab(Vec3::new(2.0, 1.0, 1.0)), white, at(Vec3::ZERO));
    scene.add(slab(Vec3::new(0.05, 1.1, 1.1)), white, at(Vec3::ZERO));
    scene.light(LightKind::Point, Vec3::new(-1.0, 0.6, 0.0), Vec3::splat(3.0));
    scene.0
}

#[test]
fn a_dark_room_beside_a_lit_one_stays_dark() {
    let share = |shadows| {
        let mut settings = small(48, 48, 256);
        settings.vpl = Some(VplOptions { count: 256, shadows, ..VplOptions::default() });
        mean(&fresh(&two_rooms(1.0), &settings).image) / mean(&fresh(&two_rooms(-1.0), &settings).image)
    };
    let (maps, off) = (share(VplShadows::Maps), share(VplShadows::Off));
    println!("dark room: {maps:.6} of the lit one with maps, {off:.4} without");
    assert!(maps <= 0.005, "{maps}");
    assert!(off > 0.05, "without visibility light leaks: {off}");
}

#[test]
fn maps_of_vpls_agree_with_rays() {
    let mut renderer = cpu();
    for name in ["rolling-box", "two-spheres"] {
        let scene = scene_at(name, 30);
        let mut indirect = |shadows| {
            let mut settings = RenderSettings { keep_layers: true, ..small(64, 64, 64) };
            settings.vpl = Some(VplOptions { count: 512, shadows, ..VplOptions::default() });
            renderer.render(&scene, &settings).unwrap().layer(Layer::Indirect).unwrap().clone()
        };
        let (maps, traced, off) = (indirect(VplShadows::Maps), indirect(VplShadows::Traced), indirect(VplShadows::Off));
        let (maps_error, off_error) = (metrics::rel_mse(&maps, &traced), metrics::rel_mse(&off, &traced));
        let ratio = mean(&maps) / mean(&traced);
        println!("{name}: maps {maps_error:.5}, off {off_error:.5}, energy {ratio:.4}");
        assert!((ratio - 1.0).abs() < 0.03, "{name}: energy {ratio}");
        assert!(maps_error < 0.4 * off_error, "{name}: {maps_error} against {off_error}");
    }
}

#[test]
fn certified_shadows_equal_traced_ones() {
    let mut renderer = cpu();
    for name in ["rolling-box", "rolling-box-donut", "two-spheres", "rolling-box-venus", "rolling-box-sponza"] {
        let scene = scene_at(name, 30);
        let mut direct = |shadows| {
            let settings = RenderSettings { shadows, vpl: None, traced: false, ..small(128, 128, 1024) };
            let frame = renderer.render(&scene, &settings).unwrap();
            (frame.image, frame.stats.rays.shadow)
        };
        let ((certified, rays), (traced, all)) = (direct(Shadows::Certified), direct(Shadows::Traced));
        let close = |a: &[f32; 3], b: &[f32; 3]| (0..3).all(|c| (a[c] - b[c]).abs() <= 2.0 / 255.0);
        let equal = certified.pixels.iter().zip(&traced.pixels).filter(|(a, b)| close(a, b)).count() as f64
            / traced.pixels.len() as f64;
        let share = rays as f64 / all as f64;
        println!("{name}: {:.2} % equal with {:.1} % of the rays", equal * 100.0, share * 100.0);
        assert!(equal >= 0.995, "{name}: {equal}");
        // The atrium's carved edges leave more to rays.
        let most = 0.25;
        assert!(share <= most, "{name}: {share}");
    }
}

#[test]
fn lanes_agree_with_every_option() {
    if opened_or_skip("lanes_agree_with_every_option", GpuRaster::new()).is_none() {
        return;
    }
    let lane = |raster| Renderer::new(RendererOptions { raster, ..RendererOptions::default() }).unwrap();
    let (mut cpu, mut gpu) = (lane(RasterLane::Cpu), lane(RasterLane::Gpu));
    let scene = scene_at("two-spheres", 30);
    let base = small(96, 96, 256);
    let mut vsm = base;
    vsm.moments.filter = ShadowFilter::Vsm;
    let vpls = |shadows, map_size| RenderSettings {
        vpl: Some(VplOptions { shadows, map_size, ..VplOptions::default() }),
        ..base
    };
    for (what, settings) in [
        ("vsm", vsm),
        ("certified", RenderSettings { shadows: Shadows::Certified, ..base }),
        ("no VPL shadows", vpls(VplShadows::Off, 32)),
        ("VPL maps of 16", vpls(VplShadows::Maps, 16)),
        ("VPL maps of 64", vpls(VplShadows::Maps, 64)),
        // The default last: nothing of the earlier ones may stay behind.
        ("default", base),
    ] {
        let (a, b) = (gpu.render(&scene, &settings).unwrap(), cpu.render(&scene, &settings).unwrap());
        let c = metrics::compare(&a.image, &b.image).unwrap();
        println!("{what}: FLIP mean {:.5}, p99 {:.4}", c.flip.mean(), c.flip.percentile(0.99));
        assert!(c.flip.mean() <= 0.02 && c.flip.percentile(0.99) <= 0.2, "{what}: {}", c.flip.mean());
    }
}

#[test]
fn a_static_shot_does_not_flicker() {
    let mut renderer = cpu();
    let scene = scene_at("rolling-box", 30);
    let settings = small(48, 48, 128);
    let first = renderer.render(&scene, &settings).unwrap().image;
    let other = scene_at("two-spheres", 0);
    renderer.render(&other, &settings).unwrap();
    assert_eq!(renderer.render(&scene, &settings).unwrap().image, first);
}

/// Width in metres over which the floor's light goes from a tenth to nine tenths behind the edge of an occluder.
fn penumbra_width(light_radius: f32, height: f32, settings: &RenderSettings) -> f64 {
    // The camera looks from the side under the occluder, which covers x < 0; the light is at 4 m.
    let half_height = 0.02;
    let mut scene = HandScene::parallel(Vec3::new(0.0, 2.0, 5.0), Vec3::new(0.0, -2.0, -5.0), half_height);
    let white = Material::lambert(Vec3::splat(0.8));
    scene.add(slab(Vec3::new(6.0, 0.05, 6.0)), white, at(Vec3::NEG_Y * 0.05));
    scene.add(slab(Vec3::new(1.0, 0.001, 0.3)), white, at(Vec3::new(-1.0, height, 0.0)));
    let light = scene.light(LightKind::Spot { cos_inner: 0.85, cos_outer: 0.75 }, Vec3::Y * 4.0, Vec3::splat(40.0));
    light.radius = light_radius;
    let lit = RenderSettings { shadows: Shadows::Off, ..*settings };
    let (shadowed, lit) = (scene.render(settings).image, scene.render(&lit).image);
    // The mean of the rows: what light is left, column by column.
    let (width, rows) = (settings.width as usize, settings.height as usize);
    let share: Vec<f64> = (0..width)
        .map(|x| {
            let sum = |i: &Image| (0..rows).map(|y| f64::from(i.pixels[y * width + x][1])).sum::<f64>();
            sum(&shadowed) / sum(&lit)
        })
        .collect();
    let crossing = |level: f64| {
        let after = share.iter().position(|s| *s >= level).expect("the picture shows the whole penumbra");
        assert!(after > 0, "the picture begins in the umbra");
        after as f64 - (share[after] - level) / (share[after] - share[after - 1])
    };
    let metres_a_pixel = 2.0 * f64::from(half_height) / f64::from(settings.height);
    (crossing(0.9) - crossing(0.1)) * metres_a_pixel
}

/// A disc of radius r at height D over an edge at height h: the share of the disc that is seen goes from 0 to 1 while the
/// point moves by 2 r h/(D - h); from a tenth to nine tenths it takes 0.6870 of that (the disc's area, not its diameter).
#[test]
fn penumbrae_are_as_wide_as_the_light_makes_them() {
    let (radius, light) = (0.25f64, 4.0f64);
    for height in [0.2f64, 0.5, 1.0] {
        let truth = 0.6870 * 2.0 * radius * height / (light - height);
        let mut settings = RenderSettings { shadow_samples: 16, vpl: None, ..small(512, 64, 1024) };
        let mut width = |shadows, filter, soft| {
            settings.shadows = shadows;
            (settings.moments.filter, settings.moments.soft) = (filter, soft);
            penumbra_width(radius as f32, height as f32, &settings) / truth
        };
        for (what, shadows, filter, soft, held) in [
            ("traced", Shadows::Traced, ShadowFilter::Evsm4, false, true),
            ("certified", Shadows::Certified, ShadowFilter::Evsm4, false, true),
            ("soft evsm4", Shadows::Moments, ShadowFilter::Evsm4, true, true),
            ("soft vsm", Shadows::Moments, ShadowFilter::Vsm, true, true),
            ("evsm4", Shadows::Moments, ShadowFilter::Evsm4, false, false),
        ] {
            let share = width(shadows, filter, soft);
            println!("occluder at {height} m: {what} {share:.3} of {truth:.4} m");
            assert!(!held || (share - 1.0).abs() < 0.25, "{what}, {height} m: {share} of the true width");
        }
    }
}
