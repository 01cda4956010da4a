//! Every stage shows: with indirect light, shadows or tracing off the picture differs, on the scene that is there to show
//! it. Moments agree with traced shadows roughly, and VPLs converge to the path tracer of the same bounces (the full table
//! is docs/vpl-convergence.md).

use catoptra_engine::RenderScene;
use catoptra_render_hybrid::{
    GlassShadows, Image, RenderSettings, Renderer, Shadows, VplOptions, VplShadows, metrics,
    trace::reference::{ReferenceAccumulator, ReferenceOptions},
};
use catoptra_tests::fixtures::{cpu, full_vpls, scene_at, small};

/// Mean FLIP that the absence of a stage must exceed, in [0, 1]: a difference that an eye sees.
const VISIBLE: f64 = 0.01;

fn picture(scene: &RenderScene, settings: &RenderSettings) -> Image {
    cpu().render(scene, settings).unwrap().image
}

/// FLIP mean between the scene's picture with all stages and with `change`.
fn effect(name: &str, frame: u64, change: impl Fn(&mut RenderSettings)) -> f64 {
    let scene = scene_at(name, frame);
    let all = small(128, 128, 256);
    let mut without = all;
    change(&mut without);
    metrics::compare(&picture(&scene, &without), &picture(&scene, &all)).unwrap().flip.mean()
}

#[test]
fn each_stage_shows_on_its_scene() {
    type Change = fn(&mut RenderSettings);
    let stages: [(&str, &str, Change); 5] = [
        ("rolling-box", "indirect light", |s| s.vpl = None),
        ("rolling-box", "shadows", |s| s.shadows = Shadows::Off),
        ("rolling-box-donut", "tracing", |s| s.traced = false),
        ("two-spheres", "tracing", |s| s.traced = false),
        ("rolling-box-sponza", "tracing", |s| s.traced = false),
    ];
    for (scene, stage, off) in stages {
        let flip = effect(scene, 30, off);
        println!("{scene} without {stage}: FLIP mean {flip:.4}");
        assert!(flip > VISIBLE, "{scene} without {stage}: FLIP mean {flip}");
    }
    // The mismatch: a scene without mirrors loses nothing with the tracer, and an equal picture is no difference.
    assert_eq!(effect("rolling-box", 30, |s| s.traced = false), 0.0);
    assert_eq!(effect("rolling-box-donut", 30, |_| ()), 0.0);
}

#[test]
fn finer_choices_show_too() {
    type Change = fn(&mut RenderSettings);
    let choices: [(&str, &str, Change); 3] = [
        ("rolling-box-donut", "one interface instead of eight", |s| s.max_depth = 1),
        ("rolling-box-donut", "clear glass in shadows", |s| s.glass_shadows = GlassShadows::Clear),
        ("rolling-box", "one bounce instead of two", |s| {
            s.vpl = Some(VplOptions { count: 32, bounces: 1, ..VplOptions::default() })
        }),
    ];
    for (scene, what, change) in choices {
        let flip = effect(scene, 30, change);
        println!("{scene}, {what}: FLIP mean {flip:.4}");
        assert!(flip > 0.001, "{scene}, {what}: FLIP mean {flip}");
    }
}

#[test]
fn moments_agree_with_traced_shadows_roughly() {
    for name in ["rolling-box", "two-spheres"] {
        let scene = scene_at(name, 30);
        let with = |shadows| RenderSettings { shadows, vpl: None, traced: false, ..small(128, 128, 512) };
        let traced = picture(&scene, &with(Shadows::Traced));
        let flip = |shadows| metrics::compare(&picture(&scene, &with(shadows)), &traced).unwrap().flip.mean();
        let (moments, off) = (flip(Shadows::Moments), flip(Shadows::Off));
        println!("{name}: FLIP mean to traced shadows {moments:.4} by moments, {off:.4} without shadows");
        // A filtered map blurs where the truth widens with distance: near, not equal.
        assert!(moments < 0.03 && moments < 0.5 * off, "{name}: {moments} by moments, {off} without");
        assert!(moments > 0.0, "{name}: they are not the same code");
    }
}

/// The path-traced truth, and relMSE between its halves.
fn truth(renderer: &mut Renderer, scene: &RenderScene, settings: &RenderSettings, spp: u32) -> (Image, f64) {
    let mut sums = ReferenceAccumulator::new(settings.width, settings.height);
    renderer.add_reference(&mut sums, scene, &ReferenceOptions::matching(settings), spp).unwrap();
    (sums.image(), metrics::rel_mse(&sums.half(0), &sums.half(1)))
}

/// relMSE of the 99% of the pixels that are nearest. A VPL without a bound next to a pixel lights it out of all proportion:
/// the sum converges, its variance does not, and one such pixel rules a plain mean of squares.
fn trimmed_rel_mse(a: &Image, b: &Image) -> f64 {
    let square = |(a, b): (&[f32; 3], &[f32; 3])| {
        let channel = |c: usize| {
            let (a, b) = (f64::from(a[c]), f64::from(b[c]));
            (a - b) * (a - b) / (b * b + 0.01)
        };
        (channel(0) + channel(1) + channel(2)) / 3.0
    };
    let mut errors: Vec<f64> = a.pixels.iter().zip(&b.pixels).map(square).collect();
    errors.sort_unstable_by(f64::total_cmp);
    errors.truncate(errors.len() * 99 / 100);
    errors.iter().sum::<f64>() / errors.len() as f64
}

#[test]
fn vpls_converge_to_the_reference() {
    let scene = scene_at("rolling-box", 30);
    let with =
        |vpl| RenderSettings { shadows: Shadows::Traced, shadow_samples: 256, vpl: Some(vpl), ..small(24, 24, 64) };
    let mut renderer = cpu();
    let (truth, halves) = truth(&mut renderer, &scene, &with(full_vpls(64, 2)), 2048);
    // The mean of both halves has a quarter of the variance of their difference.
    let noise = halves / 4.0;
    println!("noise of the reference: relMSE {noise:.2e}");
    let mut figures = |what: &str, vpl: VplOptions| {
        let image = renderer.render(&scene, &with(vpl)).unwrap().image;
        let trimmed = trimmed_rel_mse(&image, &truth);
        println!("{what}: relMSE {:.2e}, of the nearest 99% {trimmed:.2e}", metrics::rel_mse(&image, &truth));
        trimmed
    };
    let errors = [64, 256, 1024, 4096].map(|n| figures(&format!("{n} VPLs"), full_vpls(n, 2)));
    let default_bound = VplOptions::default().geometry_term_max;
    figures("4096 under the default bound", VplOptions { geometry_term_max: default_bound, ..full_vpls(4096, 2) });
    let leaking = figures("4096 without visibility", VplOptions { shadows: VplShadows::Off, ..full_vpls(4096, 2) });
    let one_bounce = figures("4096 of one bounce", full_vpls(4096, 1));

    // Four times the VPLs: independent samples would leave a quarter of the variance. The first steps leave more, because
    // ever nearer neighbours without a bound come in.
    assert!(errors.windows(2).all(|w| w[1] - noise < 0.6 * w[0]), "{errors:?} over the noise {noise}");
    assert!(errors[3] - noise < errors[0] / 15.0, "{errors:?} over the noise {noise}");
    // The mismatches: light through walls and a bounce that is missing stay away from the truth.
    assert!(leaking > 2.0 * errors[3], "{leaking} without visibility");
    assert!(one_bounce > 2.0 * errors[3], "{one_bounce} with one bounce");
}
