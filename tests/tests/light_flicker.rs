//! Does indirect light boil? Its change from frame to frame, less that of an oracle with many VPLs and traced visibility, at
//! pixels that show the same place.
//!
//! The oracle has the bound of what it judges. Without one, the places next to one of its VPLs flare up, and it changes more from
//! frame to frame than what it is to judge (`an_oracle_without_a_bound_cannot_judge`).

use catoptra_engine::{RenderScene, app::advance};
use catoptra_render_hybrid::{Image, Layer, Preset, RenderSettings, Renderer, VplOptions, VplPlacement};
use catoptra_tests::fixtures::{SCENE_NAMES, app_at, cpu, extracted, full_vpls, small};

/// Picture of the quick test.
const SIZE: (u32, u32) = (48, 32);
/// Of the oracle's in the long one: a few places stand for all where every one costs 65,536 rays a frame.
const FEW: (u32, u32) = (16, 12);
/// Odd share of the oracle's picture's side in that of the tested one, which is large enough for a grid and the near field: the middle
/// of the oracle's pixels are pixels of it.
const FINER: u32 = 11;

/// The pixels in the middle of squares of so many.
fn middles(image: &Image, side: u32) -> Image {
    let (width, height) = (image.width / side, image.height / side);
    let of = |i: u32| ((i / width * side + side / 2) * image.width + i % width * side + side / 2) as usize;
    Image { width, height, pixels: (0..width * height).map(|i| image.pixels[of(i)]).collect() }
}

/// Indirect layer, and depth and albedo, which tell whether a pixel shows the same place; and the rays of the VPLs' maps.
fn layers(
    renderer: &mut Renderer,
    scene: &RenderScene,
    (width, height): (u32, u32),
    vpl: VplOptions,
    seed: u32,
) -> ([Image; 3], u64) {
    let mut settings = small(width, height, 64);
    (settings.keep_layers, settings.traced, settings.vpl, settings.seed) = (true, false, Some(vpl), seed);
    let frame = renderer.render(scene, &settings).unwrap();
    ([Layer::Indirect, Layer::Depth, Layer::Albedo].map(|l| frame.layer(l).unwrap().clone()), frame.stats.rays.vpl_maps)
}

/// What was measured of one choice of VPLs.
#[derive(Clone, Copy, Debug)]
struct Excess {
    /// Mean and 99th percentile over all steps of the change from frame to frame less the oracle's, as shares of the oracle's
    /// mean.
    mean: f64,
    p99: f64,
    /// Mean difference from the oracle, as such a share.
    error: f64,
    /// Rays of the VPLs' maps in a frame after the first.
    map_rays: u64,
}

/// What moves besides the objects.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Motion {
    Objects,
    ObjectsAndLight,
}

/// What is rendered.
#[derive(Clone, Debug)]
struct Trial<'a> {
    name: &'a str,
    motion: Motion,
    frames: std::ops::RangeInclusive<u64>,
    /// Of the oracle's picture.
    size: (u32, u32),
    /// VPLs of the oracle.
    oracle: u32,
    /// How much finer the tested picture is.
    finer: u32,
    /// Of the tested picture; the oracle's is 0.
    seed: u32,
}

impl<'a> Trial<'a> {
    fn long(name: &'a str, motion: Motion) -> Self {
        Self { name, motion, frames: 0..=90, size: FEW, oracle: 65_536, finer: FINER, seed: 0 }
    }
}

/// The measure of each of the settings, which have one bound.
fn excess(trial: Trial, tested: &[VplOptions]) -> Vec<Excess> {
    let Trial { name, motion, frames, size, oracle, finer, seed } = trial;
    // One renderer each, so that every frame follows the one before it.
    let mut renderers: Vec<Renderer> = (0..=tested.len()).map(|_| cpu()).collect();
    let geometry_term_max = tested[0].geometry_term_max;
    let oracle = VplOptions { geometry_term_max, ..full_vpls(oracle, 2) };
    let options: Vec<VplOptions> = std::iter::once(oracle).chain(tested.iter().copied()).collect();
    let fine = (size.0 * finer, size.1 * finer);
    let layers_of = |(i, (renderer, options)): (usize, (&mut Renderer, &VplOptions)), scene: &RenderScene| {
        if i == 0 {
            return layers(renderer, scene, size, *options, 0);
        }
        let (all, rays) = layers(renderer, scene, fine, *options, seed);
        (all.map(|layer| middles(&layer, finer)), rays)
    };
    // One world that moves on, so that what stays in it is known to stay.
    let mut app = app_at(name, *frames.start());
    let fixed = extracted(&app);
    let mut differences = vec![Vec::new(); tested.len()];
    let (mut errors, mut map_rays) = (vec![0.0; tested.len()], vec![0; tested.len()]);
    let (mut light, mut pixels, mut steps) = (0.0, 0u32, 0u32);
    let mut before: Option<Vec<[Image; 3]>> = None;
    for _ in frames {
        let mut scene = extracted(&app);
        advance(&mut app, 1);
        scene.camera = fixed.camera;
        if motion == Motion::Objects {
            scene.lights.clone_from(&fixed.lights);
        }
        let (now, rays): (Vec<[Image; 3]>, Vec<u64>) =
            renderers.iter_mut().zip(&options).enumerate().map(|one| layers_of(one, &scene)).unzip();
        if let Some(before) = &before {
            steps += 1;
            map_rays.iter_mut().zip(&rays[1..]).for_each(|(sum, rays)| *sum += rays);
            for i in 0..now[0][0].pixels.len() {
                let same = (0..3).all(|c| {
                    let (a, b) = (before[0][1].pixels[i][c], now[0][1].pixels[i][c]);
                    (a - b).abs() <= 1e-4 * a && before[0][2].pixels[i][c] == now[0][2].pixels[i][c]
                });
                if same && now[0][1].pixels[i][0] > 0.0 {
                    let sum = |layers: &[Image; 3]| layers[0].pixels[i].iter().map(|v| f64::from(*v)).sum::<f64>();
                    let change = |which: usize| sum(&now[which]) - sum(&before[which]);
                    for (which, differences) in differences.iter_mut().enumerate() {
                        differences.push((change(which + 1) - change(0)).abs());
                        errors[which] += (sum(&now[which + 1]) - sum(&now[0])).abs();
                    }
                    light += sum(&before[0]);
                    pixels += 1;
                }
            }
        }
        before = Some(now);
    }
    assert!(pixels > size.0 * size.1 / 8 * steps, "{name}: many pixels show what they showed");
    let unit = light / f64::from(pixels);
    let shares = |(mut differences, (error, rays)): (Vec<f64>, (f64, u64))| {
        differences.sort_by(f64::total_cmp);
        let mean = differences.iter().sum::<f64>() / differences.len() as f64;
        let p99 = differences[differences.len() * 99 / 100] / unit;
        Excess { mean: mean / unit, p99, error: error / light, map_rays: rays / u64::from(steps) }
    };
    differences.into_iter().zip(errors.into_iter().zip(map_rays)).map(shares).collect()
}

fn print(name: &str, motion: Motion, what: &str, Excess { mean, p99, error, map_rays }: Excess) {
    println!(
        "{name}, {motion:?}, {what}: excess change mean {:.3} %, 99th percentile {:.2} %; {:.2} % from the oracle, \
         {map_rays} rays a frame for maps",
        100.0 * mean,
        100.0 * p99,
        100.0 * error
    );
}

#[test]
fn indirect_light_does_not_boil() {
    for name in ["rolling-box", "two-spheres"] {
        let interactive = small(SIZE.0, SIZE.1, 64).vpl.unwrap();
        let trial = Trial { frames: 30..=31, size: SIZE, oracle: 4096, ..Trial::long(name, Motion::Objects) };
        let excess = excess(trial, &[interactive])[0];
        let Excess { mean, p99, .. } = excess;
        print(name, Motion::Objects, "interactive", excess);
        assert!(mean <= 0.01 && p99 <= 0.05, "{name}: {mean} {p99}");
    }
}

/// Why the oracle has a bound: one without, judged by another of the same kind.
#[test]
#[ignore = "minutes: run by hand, see docs/light.md"]
fn an_oracle_without_a_bound_cannot_judge() {
    let (name, motion) = ("two-spheres", Motion::ObjectsAndLight);
    for geometry_term_max in [None, Some(30.0)] {
        let other = VplOptions { geometry_term_max, ..full_vpls(65_536, 2) };
        let trial = Trial { finer: 1, seed: 1, ..Trial::long(name, motion) };
        print(name, motion, &format!("another oracle, bound {geometry_term_max:?}"), excess(trial, &[other])[0]);
    }
}

/// All scenes and both motions over 90 frames. What the camera's own motion adds is not in it: at rest it chooses the same VPLs.
fn flicker_of_all_scenes(preset: Preset, what: &str) {
    let vpl = VplOptions { bounces: 2, ..RenderSettings::preset(preset).vpl.unwrap() };
    for name in SCENE_NAMES {
        for motion in [Motion::Objects, Motion::ObjectsAndLight] {
            print(name, motion, what, excess(Trial::long(name, motion), &[vpl])[0]);
        }
    }
}

#[test]
#[ignore = "half an hour: run by hand, see docs/light.md"]
fn flicker_of_interactive() {
    flicker_of_all_scenes(Preset::Interactive, "interactive");
}

/// VPLs that are kept from frame to frame against those made anew, where the light moves.
#[test]
#[ignore = "minutes: run by hand, see docs/light.md"]
fn flicker_with_reuse() {
    let preset = VplOptions { bounces: 2, ..RenderSettings::preset(Preset::Interactive).vpl.unwrap() };
    let vpl = VplOptions { placement: VplPlacement::Paths, ..preset };
    let choices = [(1, 0), (1, 10), (1, 40), (2, 0), (2, 10), (2, 40)];
    let mut tested: Vec<_> = choices.map(|(candidates, reuse)| VplOptions { candidates, reuse, ..vpl }).into();
    tested.push(preset);
    for name in ["rolling-box", "two-spheres"] {
        let motion = Motion::ObjectsAndLight;
        let whats = choices.map(|(candidates, reuse)| format!("400 of {}, reuse {reuse}", 400 * candidates));
        let whats = whats.iter().map(String::as_str).chain(["400 on surfels"]);
        let trial = Trial { frames: 0..=30, finer: 1, ..Trial::long(name, motion) };
        for (what, excess) in whats.zip(excess(trial, &tested)) {
            print(name, motion, what, excess);
        }
    }
}

/// Where VPLs lie on light paths, 6,144 maps of 64 texels are made anew for every frame in which a light moves.
#[test]
#[ignore = "hours: run by hand, see docs/light.md"]
fn flicker_of_high() {
    flicker_of_all_scenes(Preset::High, "high");
}
