//! The GPU lane's frame as a whole: two frames at once, when stages run, what is compiled and sent, VPLs made on the GPU.

use catoptra_demos::scenes;
use catoptra_engine::{
    Extracted, Light, LightKind, Material, RenderScene, app,
    glam::{Affine3, Vec3},
    shapes,
};
use catoptra_render_hybrid::{
    Frame, Layer, MomentOptions, RasterLane, RenderSettings, Renderer, RendererOptions, Shadows, StageInterval, Tracer,
    VplOptions, VplShadows, twin::vpl::Vpl,
};
use catoptra_tests::{HandScene, opened_or_skip};
use std::time::Instant;

fn renderer(test: &str, tracer: Tracer) -> Option<Renderer> {
    let options = RendererOptions { raster: RasterLane::Gpu, tracer, ..RendererOptions::default() };
    opened_or_skip(test, Renderer::new(options))
}

fn small(size: u32) -> RenderSettings {
    // Maps of the usual size are most of a software adapter's time, and no matter here.
    let moments = MomentOptions { size: 64, face_size: 32, ..MomentOptions::default() };
    // VPLs that the GPU may make itself: the preset's, with maps that the CPU makes, are held in lanes.rs.
    let vpl = VplOptions { count: 64, shadows: VplShadows::Off, ..VplOptions::default() };
    RenderSettings { width: size, height: size, moments, vpl: Some(vpl), ..RenderSettings::default() }
}

/// Frames 0 to n - 1 of a scene, each a revision of the one before.
fn frames(name: &str, n: u64, mut each: impl FnMut(u64, &RenderScene)) {
    let mut world = scenes::build(name, &scenes::SceneOptions::default()).unwrap();
    for k in 0..n {
        app::advance(&mut world, u64::from(k > 0));
        each(k, &world.world().resource::<Extracted>().0);
    }
}

#[test]
fn double_buffering_shows_the_same_pictures_one_frame_later() {
    let test = "double_buffering_shows_the_same_pictures_one_frame_later";
    for tracer in [Tracer::Cpu, Tracer::Gpu] {
        let Some(mut plain) = renderer(test, tracer) else { return };
        let mut doubled = renderer(test, tracer).unwrap();
        let single = small(64);
        let (mut expected, mut got) = (Vec::new(), Vec::new());
        frames("rolling-box-donut", 7, |k, scene| {
            let frame = plain.render(scene, &single).unwrap();
            assert_eq!(frame.stats.latency_frames, 0);
            expected.push((frame.image.hash(), frame.stats.masked_pixels, frame.stats.rays));
            let two = RenderSettings { double_buffered: true, ..single };
            let frame = doubled.render(scene, &two).unwrap();
            assert_eq!(frame.stats.latency_frames, u32::from(k > 0), "frame {k}");
            got.push((frame.image.hash(), frame.stats.masked_pixels, frame.stats.rays));
        });
        assert_eq!(got[0], expected[0]);
        // The second call has only the first picture to show.
        assert_eq!(got[1].0, expected[0].0);
        for k in 2..got.len() {
            assert_eq!(got[k].0, expected[k - 1].0, "{}, frame {k}", tracer.name());
            if tracer == Tracer::Cpu {
                assert_eq!((got[k].1, got[k].2), (expected[k - 1].1, expected[k - 1].2), "frame {k}");
            }
            assert_ne!(expected[k].0, expected[k - 1].0, "the pictures must tell frames apart");
        }
    }
}

#[test]
fn what_cannot_be_late_is_not() {
    let Some(mut plain) = renderer("what_cannot_be_late_is_not", Tracer::Cpu) else { return };
    let mut doubled = renderer("what_cannot_be_late_is_not", Tracer::Cpu).unwrap();
    // Another size, kept layers, and the way back: each shows its own picture at once.
    let sizes = [(48, false), (48, false), (32, false), (32, false), (32, true), (32, false), (32, false)];
    let late = [0, 1, 0, 1, 0, 0, 1];
    let mut last = 0;
    frames("two-spheres", sizes.len() as u64, |k, scene| {
        let (size, keep_layers) = sizes[k as usize];
        let settings = RenderSettings { keep_layers, ..small(size) };
        let own = plain.render(scene, &settings).unwrap().image;
        let frame = doubled.render(scene, &RenderSettings { double_buffered: true, ..settings }).unwrap();
        assert_eq!(frame.stats.latency_frames, late[k as usize], "frame {k}");
        let shown = if late[k as usize] == 0 { own.hash() } else { last };
        assert_eq!((frame.image.width, frame.image.hash()), (size, shown), "frame {k}");
        assert_eq!(frame.layers.is_empty(), !keep_layers);
        last = own.hash();
    });
}

fn named<'a>(timeline: &'a [StageInterval], name: &str) -> &'a StageInterval {
    timeline.iter().find(|s| s.name == name).unwrap_or_else(|| panic!("no {name} in {timeline:?}"))
}

#[test]
fn the_timeline_shows_who_waits_for_whom() {
    let Some(mut renderer) = renderer("the_timeline_shows_who_waits_for_whom", Tracer::Cpu) else { return };
    let settings = RenderSettings { time_passes: true, ..small(128) };
    let mut hidden = f64::INFINITY;
    frames("two-spheres", 6, |k, scene| {
        let begun = Instant::now();
        let frame = renderer.render(scene, &settings).unwrap();
        let timeline = &frame.stats.timeline;
        for side in [false, true] {
            let own: Vec<_> = timeline.iter().filter(|s| s.on_gpu == side).collect();
            assert!(own.windows(2).all(|w| w[0].end <= w[1].begin), "frame {k}, stages of one side overlap: {own:?}");
            assert!(own.iter().all(|s| s.begin <= s.end && s.milliseconds() < 60_000.0));
        }
        let gpu: Vec<_> = timeline.iter().filter(|s| s.on_gpu).map(|s| s.name).collect();
        let passes = ["moments", "gbuffer", "compact", "send back", "direct", "indirect", "compose", "send picture"];
        assert_eq!(gpu, passes);
        // Half a submission's time is what the clocks may be off.
        let slack = std::time::Duration::from_millis(5);
        assert!(named(timeline, "trace").begin + slack >= named(timeline, "compact").end);
        assert!(named(timeline, "compose").begin + slack >= named(timeline, "send traced").begin);
        assert!(named(timeline, "gbuffer").begin + slack >= begun && timeline.iter().all(|s| s.begin + slack >= begun));
        let told: f64 = timeline.iter().filter(|s| !s.on_gpu).map(StageInterval::milliseconds).sum();
        hidden = hidden.min((frame.stats.stages_ms.total - told) / frame.stats.stages_ms.total);
        assert!(frame.stats.stages_ms.gbuffer > 0.0 && frame.stats.stages_ms.traced > 0.0);
    });
    // What the CPU's stages do not tell is no stall.
    println!("{:.1}% of the frame outside of the timeline's stages", 100.0 * hidden);
    assert!(hidden < 0.15, "{hidden}");
    let untimed = renderer.render(&scenes_first("two-spheres"), &small(32)).unwrap();
    assert!(untimed.stats.timeline.is_empty());
}

fn scenes_first(name: &str) -> RenderScene {
    let world = scenes::build(name, &scenes::SceneOptions::default()).unwrap();
    world.world().resource::<Extracted>().0.clone()
}

#[test]
fn no_frame_waits_for_a_compiler() {
    let test = "no_frame_waits_for_a_compiler";
    let traced = RenderSettings { shadows: Shadows::Traced, shadow_samples: 1, ..small(32) };
    for (tracer, settings) in [(Tracer::Cpu, small(32)), (Tracer::Gpu, small(32)), (Tracer::Gpu, traced)] {
        let Some(mut ready) = renderer(test, tracer) else { return };
        ready.prepare(&settings).unwrap();
        for info in &scenes::SCENES {
            frames(info.name, 3, |k, scene| {
                let made = ready.render(scene, &settings).unwrap().stats.pipelines_made;
                assert_eq!(made, 0, "{} frame {k}, {}", info.name, tracer.name());
            });
        }
    }
    // The counter counts: a kernel that nobody prepared is made in the frame that wants it first, and in no other.
    let mut cold = renderer(test, Tracer::Gpu).unwrap();
    let scene = scenes_first("two-spheres");
    let made: Vec<u64> = (0..2).map(|_| cold.render(&scene, &traced).unwrap().stats.pipelines_made).collect();
    assert!(made[0] > 0 && made[1] == 0, "{made:?}");
}

/// Light from every kind of source: lamps, a spot, the sun, a glowing box.
fn lit_by_all() -> RenderScene {
    let mut s = HandScene::default();
    s.add(
        shapes::cuboid(Vec3::splat(3.0), [Vec3::ONE; 6]),
        Material::lambert(Vec3::new(0.7, 0.5, 0.4)),
        Affine3::IDENTITY,
    );
    let glow = Material { emissive: Vec3::new(2.0, 1.0, 0.5), ..Material::lambert(Vec3::splat(0.3)) };
    let box_at = |x: f32| Affine3::from_translation(Vec3::new(x, -1.0, 0.3)) * Affine3::from_scale(Vec3::splat(0.3));
    s.add(shapes::cuboid(Vec3::ONE, [Vec3::ONE; 6]), glow, box_at(-1.0));
    s.add(shapes::sphere(1.0, 24, 48), Material::mirror(Vec3::ONE, 0.6), box_at(1.0));
    s.light(LightKind::Point, Vec3::new(0.4, 1.0, 0.2), Vec3::splat(8.0));
    s.light(LightKind::Spot { cos_inner: 0.9, cos_outer: 0.6 }, Vec3::new(0.0, 1.4, 0.0), Vec3::splat(9.0));
    s.light(LightKind::Directional, Vec3::ZERO, Vec3::splat(1.0)).direction_world =
        Vec3::new(0.3, -0.9, 0.1).normalize();
    s.0
}

/// Share of VPLs that are the same light at the same place in the same order: places within 1e-4 of the scene's radius,
/// normals within 1e-3, flux within 1e-3 of its own size.
fn alike(gpu: &[Vpl], cpu: &[Vpl], radius: f32) -> f64 {
    let same = |(a, b): &(&Vpl, &Vpl)| {
        a.position_world.distance(b.position_world) <= 1e-4 * radius
            && a.normal_world.distance(b.normal_world) <= 1e-3
            && (a.flux - b.flux).abs().max_element() <= 1e-3 * b.flux.max_element()
            && (a.error - b.error).abs() <= 0.01 * b.error
    };
    gpu.iter().zip(cpu).filter(same).count() as f64 / cpu.len().max(gpu.len()).max(1) as f64
}

#[test]
fn photons_on_the_gpu_make_the_same_vpls() {
    let test = "photons_on_the_gpu_make_the_same_vpls";
    let Some(mut gpu) = renderer(test, Tracer::Gpu) else { return };
    let mut cpu = renderer(test, Tracer::Cpu).unwrap();
    let base = small(32);
    let vpl = base.vpl.unwrap();
    let mut cases: Vec<(String, RenderScene, VplOptions)> = vec![
        ("every source".into(), lit_by_all(), VplOptions { count: 600, bounces: 3, ..vpl }),
        // More than one chunk of the indirect pass, in subsets.
        ("every source".into(), lit_by_all(), VplOptions { count: 3000, interleave: 4, ..vpl }),
        ("every source".into(), lit_by_all(), VplOptions { count: 75, interleave: 2, ..vpl }),
    ];
    for info in &scenes::SCENES {
        let mut world = scenes::build(info.name, &scenes::SceneOptions::default()).unwrap();
        app::advance(&mut world, 30);
        let scene = world.world().resource::<Extracted>().0.clone();
        cases.push((info.name.into(), scene.clone(), VplOptions { count: 512, ..vpl }));
    }
    for (name, scene, options) in &cases {
        let settings = RenderSettings { vpl: Some(*options), keep_layers: true, ..base };
        let a = gpu.render(scene, &settings).unwrap();
        let b = cpu.render(scene, &settings).unwrap();
        assert_eq!((a.stats.tracer, a.stats.vpls as usize), (Tracer::Gpu, gpu.vpls().len()));
        let radius = scene.bounds_world().radius();
        let share = alike(gpu.vpls(), cpu.vpls(), radius);
        println!(
            "{name}, {options:?}: {} VPLs, {} on the CPU, {:.2}% alike",
            gpu.vpls().len(),
            cpu.vpls().len(),
            100.0 * share
        );
        assert!(share >= 0.98 && !cpu.vpls().is_empty(), "{name}: {share}");
        // Paths that part at an edge go on elsewhere.
        let (x, y) = (a.stats.rays.photon, b.stats.rays.photon);
        assert!(x.abs_diff(y) * 50 <= y && y > 0, "{name}: {x} rays, {y} on the CPU");
        let light =
            |f: &Frame| f.layer(Layer::Indirect).unwrap().pixels.iter().flatten().map(|v| f64::from(*v)).sum::<f64>();
        let (x, y) = (light(&a), light(&b));
        assert!((x - y).abs() <= 0.01 * y, "{name}: indirect light {x}, {y} on the CPU");
    }
    // The mutation: other samples are other VPLs.
    let (_, scene, options) = &cases[0];
    gpu.render(scene, &RenderSettings { vpl: Some(*options), seed: 1, ..base }).unwrap();
    cpu.render(scene, &RenderSettings { vpl: Some(*options), ..base }).unwrap();
    assert!(alike(gpu.vpls(), cpu.vpls(), scene.bounds_world().radius()) < 0.1);
}

#[test]
fn vpls_of_a_still_scene_are_made_once() {
    let Some(mut gpu) = renderer("vpls_of_a_still_scene_are_made_once", Tracer::Gpu) else { return };
    let mut scene = scenes_first("two-spheres");
    let settings = small(32);
    let first = gpu.render(&scene, &settings).unwrap();
    let again = gpu.render(&scene, &settings).unwrap();
    assert!(first.stats.rays.photon > 0);
    assert_eq!((again.stats.rays.photon, again.stats.vpls), (0, first.stats.vpls));
    assert_eq!(again.image.hash(), first.image.hash());
    // Other settings go another way and come back; then a thing moves.
    let other = gpu.render(&scene, &RenderSettings { vpl: None, ..settings }).unwrap();
    assert_ne!(other.image.hash(), first.image.hash());
    assert_eq!(gpu.render(&scene, &settings).unwrap().image.hash(), first.image.hash());
    scene.begin_revision();
    let place = scene.instances[0].world_from_object;
    scene.set_transform(0, Affine3::from_translation(Vec3::splat(0.01)) * place);
    assert!(gpu.render(&scene, &settings).unwrap().stats.rays.photon > 0);
}

/// Bytes that the light's record, its shadow views and the frame of its paths take in both layouts of the scene: what a light
/// that moves sends at most. Shadow views reach to the scene's bounds and follow them.
fn light_bytes(light: &Light) -> u64 {
    let views = if matches!(light.kind, LightKind::Point) { 6 } else { 1 };
    // Raster passes 64 and 64 a view; tracer 96 and 64 a view; photons 64.
    64 + 96 + 64 + views * 128
}

/// What frames 0 to 89 send.
struct Sent {
    first: u64,
    /// Bytes, moved instances, of the frame that sent most.
    most: (u64, usize),
    median: u64,
    seconds: f64,
}

/// Holds each frame to what moved in it.
/// * `extra`: bytes that the lane may send beside that
fn frames_send_what_moved(renderer: &mut Renderer, name: &str, vpls: u32, extra: impl Fn(&Frame) -> u64) -> Sent {
    // The frame's uniform, the head of the tracer's scene, the tracer's uniform and those of the light paths, which hold bounds
    // that follow the scene's.
    const FRAME_BYTES: u64 = 112 + 32 + 48 + 32 + 32;
    // An instance's records in both layouts, and the boxes of its ancestors: two levels of nodes here, in which up to four
    // words lie between two that change.
    const MOVED_BYTES: u64 = 96 + 192 + 2 * 96;
    let vpl = Some(VplOptions { count: vpls, ..small(16).vpl.unwrap() });
    let settings = RenderSettings { vpl, ..small(16) };
    let begun = Instant::now();
    let (mut first, mut sent, mut last) = (0, Vec::new(), Vec::<Light>::new());
    let mut frame = Frame::default();
    frames(name, 90, |k, scene| {
        renderer.render_into(scene, &settings, &mut frame).unwrap();
        let up = frame.stats.bytes_up;
        let moved = scene.moved.len();
        if k == 0 {
            first = up;
            // A frame in which nothing changed sends nothing of its own.
            renderer.render_into(scene, &settings, &mut frame).unwrap();
            let again = frame.stats.bytes_up;
            assert!(again <= extra(&frame), "{name}: {again} bytes sent again, at most {}", extra(&frame));
        } else {
            let lights = if moved > 0 || scene.lights != last { scene.lights.iter().map(light_bytes).sum() } else { 0 };
            let most = FRAME_BYTES + MOVED_BYTES * moved as u64 + lights + extra(&frame);
            assert!(up <= most, "{name} frame {k}: {up} bytes for {moved} moved, at most {most}");
            sent.push((up, moved));
        }
        last.clone_from(&scene.lights);
    });
    assert!(sent.iter().any(|s| s.1 > 0), "{name} must move");
    let most = *sent.iter().max().unwrap();
    sent.sort_unstable();
    Sent { first, most, median: sent[sent.len() / 2].0, seconds: begun.elapsed().as_secs_f64() }
}

#[test]
fn ninety_frames_send_what_moved() {
    let test = "ninety_frames_send_what_moved";
    for tracer in [Tracer::Gpu, Tracer::Cpu] {
        for info in &scenes::SCENES {
            let Some(mut renderer) = renderer(test, tracer) else { return };
            // The CPU's tracer sends its own VPLs, 48 bytes each behind heads of 32, and 16 bytes a traced pixel behind 16.
            let extra = |frame: &Frame| match tracer {
                Tracer::Cpu => 32 + 48 * u64::from(frame.stats.vpls) + 16 + 16 * frame.stats.masked_pixels,
                _ => 0,
            };
            let s = frames_send_what_moved(&mut renderer, info.name, 16, extra);
            println!(
                "{}, {}: first frame {} bytes, then {} (median), at most {} ({} moved); {:.1} s",
                info.name,
                tracer.name(),
                s.first,
                s.median,
                s.most.0,
                s.most.1,
                s.seconds
            );
            if tracer == Tracer::Gpu {
                assert!(s.first > 10 * s.most.0, "{}: {} bytes and then {}", info.name, s.first, s.most.0);
            }
            if (tracer, info.name) == (Tracer::Gpu, "two-spheres") {
                // More VPLs make the first frame greater and no other.
                let mut fresh = self::renderer(test, tracer).unwrap();
                let more = frames_send_what_moved(&mut fresh, info.name, 256, extra);
                assert!(more.first > s.first);
                assert_eq!((more.most, more.median), (s.most, s.median));
            }
        }
    }
}

fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut v: Vec<f64> = values.into_iter().collect();
    v.sort_unstable_by(f64::total_cmp);
    v[v.len() / 2]
}

/// Both sides of the lane on one thread each:
/// `LP_NUM_THREADS=1 taskset -c 0,1 cargo test -p catoptra_tests --test gpu_frame -- --ignored --nocapture`, on an idle machine.
#[test]
#[ignore = "measures: wants an idle machine and LP_NUM_THREADS=1"]
fn latency_and_period_against_the_stages_timed_apart() {
    const FRAMES: usize = 15;
    let options =
        RendererOptions { raster: RasterLane::Gpu, tracer: Tracer::Cpu, threads: 1, ..RendererOptions::default() };
    let test = "latency_and_period";
    let size = std::env::var("CATOPTRA_SIZE").ok().and_then(|s| s.parse().ok()).unwrap_or(512);
    let settings = RenderSettings { time_passes: true, moments: MomentOptions::default(), ..small(size) };
    let mut worst = [0.0f64; 2];
    for name in ["rolling-box-donut", "two-spheres", "rolling-box-venus", "rolling-box-sponza"] {
        // One world for each way, the same frames.
        let run = |doubled: bool, apart: bool| -> Option<Vec<(f64, Vec<StageInterval>)>> {
            let mut renderer = opened_or_skip(test, Renderer::new(options))?;
            renderer.gpu_mut().unwrap().set_one_by_one(apart);
            let settings = RenderSettings { double_buffered: doubled, ..settings };
            let mut out = Vec::new();
            let mut frame = Frame::default();
            frames(name, FRAMES as u64 + 3, |k, scene| {
                let start = Instant::now();
                renderer.render_into(scene, &settings, &mut frame).unwrap();
                if k >= 3 {
                    out.push((start.elapsed().as_secs_f64() * 1e3, frame.stats.timeline.clone()));
                }
            });
            Some(out)
        };
        let Some(apart) = run(false, true) else { return };
        let (single, double) = (run(false, false).unwrap(), run(true, false).unwrap());
        let of = |names: &[&str]| {
            median(apart.iter().map(|(_, t)| {
                t.iter().filter(|s| names.contains(&s.name)).map(StageInterval::milliseconds).sum::<f64>()
            }))
        };
        let first = of(&["moments", "gbuffer", "compact", "send back"]);
        let light = of(&["direct", "indirect"]);
        let last = of(&["compose", "send picture"]);
        let send = of(&["send scene"]);
        let prepare = of(&["structures", "virtual lights", "send to tracer", "submit light"]);
        let trace = of(&["read moments", "trace", "send traced", "submit"]);
        let read = of(&["read picture"]);
        let critical = send + first.max(prepare) + light.max(trace) + last + read;
        let longer = (send + prepare + trace + read).max(first + light + last);
        let latency = median(single.iter().map(|f| f.0));
        let period = median(double.iter().map(|f| f.0));
        println!(
            "{name}: GPU {first:.1} + {light:.1} + {last:.1}, CPU {send:.1} + {prepare:.1} + {trace:.1} + {read:.1} ms; critical \
             path {critical:.1}, latency {latency:.1} ({:.3}); longer side {longer:.1}, period {period:.1} ({:.3})",
            latency / critical,
            period / longer
        );
        for (i, frames) in [&single, &double].into_iter().enumerate() {
            println!("  {}", ["a frame", "a call, double buffered"][i]);
            let (total, timeline) = &frames[FRAMES / 2];
            let begin = timeline.iter().map(|s| s.begin).min().unwrap();
            let ms = |at: Instant| at.duration_since(begin).as_secs_f64() * 1e3;
            for s in timeline.iter().filter(|s| s.milliseconds() >= 0.02 * total) {
                println!(
                    "    {} {:7.1} to {:7.1}  {}",
                    if s.on_gpu { "GPU" } else { "CPU" },
                    ms(s.begin),
                    ms(s.end),
                    s.name
                );
            }
        }
        worst = [worst[0].max(latency / critical), worst[1].max(period / longer)];
    }
    assert!(worst[0] <= 1.15 && worst[1] <= 1.15, "{worst:?}");
}
