//! Indirect light on a grid of the picture against its evaluation at every pixel.

use catoptra_engine::app::advance;
use catoptra_render_hybrid::{Image, Layer, Renderer, RendererOptions, SimdLevel, VplOptions, metrics};
use catoptra_tests::fixtures::{app_at, cpu, cpu_with, extracted, scene_at, small};

fn mean(image: &Image) -> f64 {
    image.pixels.iter().flatten().map(|v| f64::from(*v)).sum::<f64>() / (3 * image.pixels.len()) as f64
}

fn picture(renderer: &mut Renderer, name: &str, size: u32, spacing: u32) -> (Image, Image) {
    let mut settings = small(size, size, 128);
    settings.keep_layers = true;
    settings.vpl = Some(VplOptions { count: 128, spacing, ..VplOptions::default() });
    let frame = renderer.render(&scene_at(name, 30), &settings).unwrap();
    (frame.layer(Layer::Indirect).unwrap().clone(), frame.image)
}

#[test]
fn the_grid_keeps_the_light() {
    let mut renderer = cpu();
    for name in ["rolling-box", "two-spheres", "rolling-box-sponza"] {
        let (full, image) = picture(&mut renderer, name, 192, 1);
        for spacing in [2, 4] {
            let (layer, coarse) = picture(&mut renderer, name, 192, spacing);
            let energy = mean(&layer) / mean(&full);
            let flip = metrics::compare(&coarse, &image).unwrap().flip.mean();
            println!("{name}, every {spacing} pixels: energy {energy:.4}, FLIP mean {flip:.4}");
            assert!((energy - 1.0).abs() < 0.015, "{name}, {spacing}: energy {energy}");
            assert!(flip < 0.01 * f64::from(spacing).sqrt() + 0.015, "{name}, {spacing}: FLIP {flip}");
            assert_ne!(layer, full, "the grid does something");
        }
    }
}

#[test]
fn the_grid_does_not_depend_on_tiles_threads_or_simd() {
    let scene = scene_at("rolling-box-sponza", 30);
    let picture = |tile, threads, simd| {
        let mut settings = small(70, 53, 64);
        settings.tile = tile;
        settings.vpl = Some(VplOptions { count: 64, spacing: 8, mirrored: 16, ..VplOptions::default() });
        cpu_with(RendererOptions { threads, simd, ..RendererOptions::default() })
            .render(&scene, &settings)
            .unwrap()
            .image
    };
    let first = picture(32, 1, SimdLevel::Auto);
    assert_eq!(picture(4, 3, SimdLevel::Auto), first);
    assert_eq!(picture(64, 2, SimdLevel::Portable), first);
}

#[test]
fn mirrors_show_the_set_that_is_theirs() {
    let mut renderer = cpu();
    let scene = scene_at("two-spheres", 30);
    let mut layers = |mirrored| {
        let mut settings = small(96, 96, 64);
        settings.keep_layers = true;
        settings.vpl = Some(VplOptions { count: 128, mirrored, ..VplOptions::default() });
        let frame = renderer.render(&scene, &settings).unwrap();
        [Layer::Indirect, Layer::Traced].map(|l| frame.layer(l).unwrap().clone())
    };
    let ([indirect, traced], [same, few]) = (layers(0), layers(64));
    assert_eq!(indirect, same, "what is seen directly is as before");
    assert_ne!(traced, few);
    let energy = mean(&few) / mean(&traced);
    println!("mirrors by 64 VPLs without shadows: {energy:.3} of the light");
    // Without shadows there is more of it.
    assert!((energy - 1.0).abs() < 0.2, "{energy}");
}

#[test]
fn maps_are_made_again_only_where_something_moved() {
    for name in ["rolling-box", "rolling-box-sponza"] {
        let mut settings = small(48, 48, 64);
        settings.vpl = Some(VplOptions { count: 64, ..VplOptions::default() });
        let mut renderer = cpu();
        let mut app = app_at(name, 30);
        let lights = extracted(&app).lights;
        let (mut first, mut least) = (0, u64::MAX);
        for frame in [30, 31, 32, 33] {
            let mut scene = extracted(&app);
            advance(&mut app, 1);
            // The light stands still, the body moves on.
            scene.lights.clone_from(&lights);
            let kept = renderer.render(&scene, &settings).unwrap();
            let anew = cpu().render(&scene, &settings).unwrap();
            assert_eq!(kept.image, anew.image, "{name}, frame {frame}");
            let (some, all) = (kept.stats.rays.vpl_maps, anew.stats.rays.vpl_maps);
            if frame == 30 {
                first = some;
                assert_eq!(some, all);
            } else {
                least = least.min(some);
                assert!(some < all, "{name}, frame {frame}: {some} of {all} rays");
            }
        }
        println!("{name}: {least} of {first} rays");
    }
}
