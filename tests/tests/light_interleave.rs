//! Interleaved VPLs against their full evaluation: the same light, a little blurred.

use catoptra_render_hybrid::{Image, Layer, RendererOptions, VplOptions, metrics};
use catoptra_tests::fixtures::{cpu, cpu_with, scene_at, small};

fn mean(image: &Image) -> f64 {
    image.pixels.iter().flatten().map(|v| f64::from(*v)).sum::<f64>() / (3 * image.pixels.len()) as f64
}

#[test]
fn interleaving_keeps_the_light() {
    let mut renderer = cpu();
    for name in ["rolling-box", "two-spheres"] {
        let scene = scene_at(name, 30);
        let mut indirect = |interleave| {
            let mut settings = small(128, 128, 64);
            settings.keep_layers = true;
            settings.vpl = Some(VplOptions { count: 256, interleave, ..VplOptions::default() });
            let frame = renderer.render(&scene, &settings).unwrap();
            (frame.layer(Layer::Indirect).unwrap().clone(), frame.image)
        };
        let (full, picture) = indirect(1);
        for n in [2, 4] {
            let (layer, image) = indirect(n);
            let energy = mean(&layer) / mean(&full);
            let c = metrics::compare(&image, &picture).unwrap();
            println!("{name}, {n}x{n}: energy {energy:.4}, FLIP mean {:.4}", c.flip.mean());
            assert!((energy - 1.0).abs() < 0.01, "{name}, {n}x{n}: energy {energy}");
            assert!(c.flip.mean() < 0.04, "{name}, {n}x{n}: FLIP {}", c.flip.mean());
            assert_ne!(layer, full, "interleaving does something");
        }
    }
}

#[test]
fn interleaved_pictures_do_not_depend_on_tiles_or_threads() {
    let scene = scene_at("two-spheres", 30);
    let picture = |tile, threads| {
        let mut settings = small(70, 53, 64);
        settings.tile = tile;
        settings.vpl = Some(VplOptions { count: 100, interleave: 4, ..VplOptions::default() });
        cpu_with(RendererOptions { threads, ..RendererOptions::default() }).render(&scene, &settings).unwrap().image
    };
    let first = picture(32, 1);
    assert_eq!(picture(8, 3), first);
    assert_eq!(picture(64, 2), first);
}
