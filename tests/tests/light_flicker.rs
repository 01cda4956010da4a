//! Does indirect light boil? Its change from frame to frame, less that of an oracle with many VPLs and traced visibility, at
//! pixels that show the same place.

use catoptra_engine::RenderScene;
use catoptra_render_hybrid::{Image, Layer, Renderer, VplOptions};
use catoptra_tests::fixtures::{SCENE_NAMES, cpu, full_vpls, scene_at, small};

const SIZE: (u32, u32) = (48, 32);

/// Indirect layer, and depth and albedo, which tell whether a pixel shows the same place.
fn layers(renderer: &mut Renderer, scene: &RenderScene, vpl: VplOptions) -> [Image; 3] {
    let mut settings = small(SIZE.0, SIZE.1, 64);
    (settings.keep_layers, settings.traced, settings.vpl) = (true, false, Some(vpl));
    let frame = renderer.render(scene, &settings).unwrap();
    [Layer::Indirect, Layer::Depth, Layer::Albedo].map(|l| frame.layer(l).unwrap().clone())
}

/// What moves besides the objects.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Motion {
    Objects,
    ObjectsAndLight,
}

/// Mean and 99th percentile of the excess change over all steps, as shares of the oracle's mean.
fn excess(name: &str, motion: Motion, steps: &[u64], oracle: u32, tested: VplOptions) -> [f64; 2] {
    let mut renderer = cpu();
    let fixed = scene_at(name, steps[0]);
    let mut scene = |frame| {
        let mut scene = scene_at(name, frame);
        scene.camera = fixed.camera;
        if motion == Motion::Objects {
            scene.lights.clone_from(&fixed.lights);
        }
        let truth = layers(&mut renderer, &scene, full_vpls(oracle, tested.bounces));
        (truth, layers(&mut renderer, &scene, tested))
    };
    let (mut differences, mut light, mut pixels) = (Vec::new(), 0.0, 0u32);
    for &step in steps {
        let ((truth, of_truth), (next, of_next)) = {
            let (a, b) = scene(step);
            let (c, d) = scene(step + 1);
            ((a, b), (c, d))
        };
        for i in 0..truth[0].pixels.len() {
            let same = (0..3).all(|c| {
                let (a, b) = (truth[1].pixels[i][c], next[1].pixels[i][c]);
                (a - b).abs() <= 1e-4 * a && truth[2].pixels[i][c] == next[2].pixels[i][c]
            });
            let sum = |image: &Image| image.pixels[i].iter().map(|v| f64::from(*v)).sum::<f64>();
            if same && truth[1].pixels[i][0] > 0.0 {
                let change = sum(&of_next[0]) - sum(&of_truth[0]);
                differences.push((change - (sum(&next[0]) - sum(&truth[0]))).abs());
                light += sum(&truth[0]);
                pixels += 1;
            }
        }
    }
    assert!(pixels > 200 * steps.len() as u32, "{name}: most pixels show what they showed");
    differences.sort_by(f64::total_cmp);
    let unit = light / f64::from(pixels);
    let mean = differences.iter().sum::<f64>() / differences.len() as f64;
    [mean / unit, differences[differences.len() * 99 / 100] / unit]
}

fn report(name: &str, motion: Motion, steps: &[u64], oracle: u32) -> [f64; 2] {
    let tested = small(SIZE.0, SIZE.1, 64).vpl.unwrap();
    let [mean, p99] = excess(name, motion, steps, oracle, tested);
    println!("{name}, {motion:?}: excess change mean {:.3} %, 99th percentile {:.2} %", 100.0 * mean, 100.0 * p99);
    [mean, p99]
}

#[test]
fn indirect_light_does_not_boil() {
    for name in ["rolling-box", "two-spheres"] {
        let [mean, p99] = report(name, Motion::Objects, &[30], 4096);
        assert!(mean <= 0.01 && p99 <= 0.08, "{name}: {mean} {p99}");
    }
}

/// All scenes and both motions; minutes.
#[test]
#[ignore = "minutes: run by hand, see docs/light.md"]
fn flicker_of_all_scenes() {
    for name in SCENE_NAMES {
        for motion in [Motion::Objects, Motion::ObjectsAndLight] {
            report(name, motion, &[0, 15, 30, 45, 60, 75, 89], 16_384);
        }
    }
}
