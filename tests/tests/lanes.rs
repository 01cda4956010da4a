//! Both lanes give the same picture: FLIP mean at most 0.02 and 99th percentile at most 0.2 for each scene.

use catoptra_demos::scenes;
use catoptra_engine::{Extracted, RenderScene, app};
use catoptra_render_hybrid::{
    Frame, Layer, NearField, RasterLane, RenderSettings, Renderer, RendererOptions, ShadowFilter, Shadows, Tracer,
    VplOptions, VplShadows,
    metrics::{Comparison, compare},
    raster::GpuRaster,
};
use catoptra_tests::{
    fixtures::{app_at, extracted},
    opened_or_skip,
};

/// The tolerance of the lanes, on the final picture.
const FLIP_MEAN: f64 = 0.02;
/// Edges may fall on the other side of a pixel's centre.
const FLIP_P99: f64 = 0.2;
const SIZE: u32 = 192;

fn scene(name: &str, frame: u64) -> RenderScene {
    let mut world = scenes::build(name, &scenes::SceneOptions::default()).unwrap();
    app::advance(&mut world, frame);
    world.world().resource::<Extracted>().0.clone()
}

fn renderer(raster: RasterLane) -> Renderer {
    Renderer::new(RendererOptions { raster, ..RendererOptions::default() }).unwrap()
}

fn settings() -> RenderSettings {
    RenderSettings { width: SIZE, height: SIZE, keep_layers: true, ..RenderSettings::default() }
}

fn layer_difference(a: &Frame, b: &Frame, layer: Layer) -> Comparison {
    compare(a.layer(layer).unwrap(), b.layer(layer).unwrap()).unwrap()
}

fn agrees(c: &Comparison) -> bool {
    c.flip.mean() <= FLIP_MEAN && c.flip.percentile(0.99) <= FLIP_P99
}

#[test]
fn lanes_agree_on_every_scene_and_layer() {
    if opened_or_skip("lanes_agree_on_every_scene_and_layer", GpuRaster::new()).is_none() {
        return;
    }
    let (mut cpu, mut gpu) = (renderer(RasterLane::Cpu), renderer(RasterLane::Gpu));
    for info in &scenes::SCENES {
        for frame in [0, 30, 90] {
            let scene = scene(info.name, frame);
            let a = cpu.render(&scene, &settings()).unwrap();
            let b = gpu.render(&scene, &settings()).unwrap();
            assert_eq!((a.stats.raster, b.stats.raster), (RasterLane::Cpu, RasterLane::Gpu));
            for (layer, name) in Layer::ALL.into_iter().filter(|(l, _)| *l != Layer::Depth) {
                let c = layer_difference(&b, &a, layer);
                let (mean, p99) = (c.flip.mean(), c.flip.percentile(0.99));
                println!(
                    "{} frame {frame} {name}: FLIP mean {mean:.5}, p99 {p99:.4}, relMSE {:.2e}",
                    info.name, c.rel_mse
                );
                assert!(agrees(&c), "{} frame {frame}, {name}: FLIP mean {mean}, p99 {p99}", info.name);
            }
            // Depths are metres, no picture: compared as they are, but for pixels on edges.
            let (da, db) = (a.layer(Layer::Depth).unwrap(), b.layer(Layer::Depth).unwrap());
            let off = da.pixels.iter().zip(&db.pixels).filter(|(x, y)| (x[0] - y[0]).abs() > 1e-4 * x[0].max(1.0));
            let off = off.count();
            assert!(off * 1000 <= da.pixels.len(), "{} frame {frame}: {off} depths differ", info.name);
            let (ma, mb) = (a.stats.masked_pixels, b.stats.masked_pixels);
            assert!(ma.abs_diff(mb) * 200 <= ma, "{} frame {frame}: {ma} and {mb} masked pixels", info.name);
        }
    }
}

#[test]
fn lanes_agree_on_soft_shadows() {
    if opened_or_skip("lanes_agree_on_soft_shadows", GpuRaster::new()).is_none() {
        return;
    }
    let (mut cpu, mut gpu) = (renderer(RasterLane::Cpu), renderer(RasterLane::Gpu));
    for name in ["rolling-box", "rolling-box-sponza"] {
        let scene = scene(name, 30);
        for filter in [ShadowFilter::Vsm, ShadowFilter::Evsm4] {
            let mut settings = RenderSettings { vpl: None, ..settings() };
            (settings.moments.filter, settings.moments.soft) = (filter, true);
            let a = cpu.render(&scene, &settings).unwrap();
            let b = gpu.render(&scene, &settings).unwrap();
            settings.moments.soft = false;
            let hard = cpu.render(&scene, &settings).unwrap();
            for layer in [Layer::Direct, Layer::Traced] {
                let c = layer_difference(&b, &a, layer);
                let noticed = layer_difference(&hard, &a, layer).flip.mean();
                println!("{name} {filter:?} {layer:?}: FLIP {:.5}, of hard ones {noticed:.5}", c.flip.mean());
                assert!(agrees(&c), "{name} {filter:?} {layer:?}: FLIP mean {}", c.flip.mean());
                assert!(
                    layer != Layer::Direct || noticed > 2.0 * c.flip.mean(),
                    "{name}: hard shadows differ by {noticed}"
                );
            }
        }
    }
}

/// 256 VPLs with maps on a grid of 4 pixels, which is what 16 are at 1024x1024; a set of their own lights what the grid cannot.
fn on_grid(spacing: u32, mirrored: u32) -> RenderSettings {
    let bound = Some(20.0);
    let vpl = VplOptions { count: 256, geometry_term_max: bound, spacing, mirrored, ..VplOptions::default() };
    RenderSettings { width: 256, height: 256, vpl: Some(vpl), ..settings() }
}

fn near(settings: RenderSettings, near_field: NearField) -> RenderSettings {
    RenderSettings { vpl: settings.vpl.map(|v| VplOptions { near_field, ..v }), ..settings }
}

/// Most FLIP mean of the indirect layer on the grid: a tenth of what the lanes differ by where one of them has none.
const GRID_FLIP_MEAN: f64 = 0.002;

#[test]
fn lanes_agree_on_the_light_grid() {
    if opened_or_skip("lanes_agree_on_the_light_grid", GpuRaster::new()).is_none() {
        return;
    }
    let (mut cpu, mut gpu) = (renderer(RasterLane::Cpu), renderer(RasterLane::Gpu));
    for info in &scenes::SCENES {
        let scene = scene(info.name, 30);
        for (mirrored, near_field) in [(64, NearField::Off), (0, NearField::Off), (64, NearField::Light)] {
            let settings = near(on_grid(4, mirrored), near_field);
            let a = cpu.render(&scene, &settings).unwrap();
            let b = gpu.render(&scene, &settings).unwrap();
            assert_eq!((a.stats.raster, b.stats.raster), (RasterLane::Cpu, RasterLane::Gpu));
            for (layer, most) in [(Layer::Indirect, GRID_FLIP_MEAN), (Layer::Final, FLIP_MEAN)] {
                let c = layer_difference(&b, &a, layer);
                let (mean, p99) = (c.flip.mean(), c.flip.percentile(0.99));
                let name = info.name;
                println!("{name}, {mirrored} in mirrors, {near_field:?}, {layer:?}: FLIP mean {mean:.5}, p99 {p99:.4}");
                assert!(mean <= most && agrees(&c), "{}, {layer:?}: FLIP mean {mean}, p99 {p99}", info.name);
            }
            if near_field == NearField::Light {
                // What must fail: one lane without the light close by.
                let without = gpu.render(&scene, &on_grid(4, mirrored)).unwrap();
                let mean = layer_difference(&without, &a, Layer::Indirect).flip.mean();
                println!("{}, the GPU lane without a near field: FLIP mean {mean:.5}", info.name);
                assert!(mean > GRID_FLIP_MEAN, "{}: a missing near field passes with {mean}", info.name);
            } else if mirrored > 0 {
                // What must fail: one lane without the grid, or without the set for pixels that it cannot tell about.
                let every = gpu.render(&scene, &on_grid(1, mirrored)).unwrap();
                let mean = layer_difference(&every, &a, Layer::Indirect).flip.mean();
                println!("{}, the GPU lane without a grid: FLIP mean {mean:.5}", info.name);
                assert!(mean > GRID_FLIP_MEAN, "{}: a missing grid passes with {mean}", info.name);
            }
        }
    }
}

#[test]
fn a_grid_of_several_chunks_on_a_ragged_picture() {
    if opened_or_skip("a_grid_of_several_chunks_on_a_ragged_picture", GpuRaster::new()).is_none() {
        return;
    }
    let (mut cpu, mut gpu) = (renderer(RasterLane::Cpu), renderer(RasterLane::Gpu));
    let options = RendererOptions { raster: RasterLane::Gpu, tracer: Tracer::Gpu, ..RendererOptions::default() };
    let mut tracing = Renderer::new(options).unwrap();
    let scene = scene("two-spheres", 30);
    // 2500 VPLs are three chunks; neither side is a multiple of the spacing.
    for (shadows, mirrored) in [(VplShadows::Off, 0), (VplShadows::Maps, 0), (VplShadows::Off, 1500)] {
        let vpl = VplOptions { count: 2500, shadows, map_size: 16, mirrored, spacing: 2, ..VplOptions::default() };
        let settings = RenderSettings { width: 141, height: 133, vpl: Some(vpl), ..settings() };
        let a = cpu.render(&scene, &settings).unwrap();
        let b = gpu.render(&scene, &settings).unwrap();
        let c = layer_difference(&b, &a, Layer::Indirect);
        let mean = c.flip.mean();
        println!("{shadows:?}, {mirrored} in mirrors: FLIP mean {mean:.5}");
        assert!(mean <= GRID_FLIP_MEAN, "{shadows:?}, {mirrored}: {mean}");
        // So they do with what the CPU adds to three chunks.
        let close = near(settings, NearField::Light);
        let (lit, c) = (cpu.render(&scene, &close).unwrap(), gpu.render(&scene, &close).unwrap());
        let (mean, without) =
            (layer_difference(&c, &lit, Layer::Indirect), layer_difference(&b, &lit, Layer::Indirect));
        let (mean, without) = (mean.flip.mean(), without.flip.mean());
        println!("{shadows:?}, {mirrored} in mirrors, near field: FLIP mean {mean:.5}, without {without:.5}");
        assert!(mean <= GRID_FLIP_MEAN && mean < 0.5 * without, "{shadows:?}, {mirrored}: {mean}, {without}");
        // The same frame without the grid is another.
        let every = RenderSettings { vpl: Some(VplOptions { spacing: 1, ..vpl }), ..settings };
        assert_ne!(gpu.render(&scene, &every).unwrap().layer(Layer::Indirect), b.layer(Layer::Indirect));
        if shadows == VplShadows::Off && mirrored == 0 {
            // VPLs that the GPU makes itself are on the grid as well.
            let c = tracing.render(&scene, &settings).unwrap();
            assert_eq!(c.stats.tracer, Tracer::Gpu);
            let mean = layer_difference(&c, &a, Layer::Indirect).flip.mean();
            println!("VPLs made on the GPU: FLIP mean {mean:.5}");
            assert!(mean <= GRID_FLIP_MEAN, "VPLs made on the GPU: {mean}");
        }
    }
}

#[test]
fn only_renewed_maps_are_sent() {
    if opened_or_skip("only_renewed_maps_are_sent", GpuRaster::new()).is_none() {
        return;
    }
    let mut gpu = renderer(RasterLane::Gpu);
    let mut app = app_at("rolling-box-sponza", 30);
    let mut first_scene = extracted(&app);
    // Without what the CPU traces, which is sent, too.
    let settings = RenderSettings { traced: false, ..on_grid(4, 64) };
    let sent = |gpu: &mut Renderer, scene: &RenderScene| gpu.render(scene, &settings).unwrap().stats.bytes_up;
    let first = sent(&mut gpu, &first_scene);
    // More than half of the 256 paths meet something, and a map has four bytes a texel.
    let all = 128 * 32 * 32 * 4;
    assert!(first >= all, "{first} bytes");
    let again = sent(&mut gpu, &first_scene);
    assert!(again < all / 8, "{again} bytes for the same scene");
    // The box moves on while the light stands still: some maps see it, most do not.
    app::advance(&mut app, 1);
    let mut moved = extracted(&app);
    moved.lights.clone_from(&first_scene.lights);
    let some = sent(&mut gpu, &moved);
    println!("bytes sent: first {first}, again {again}, moved body {some}");
    assert!(some > again && some < all, "{some} bytes");
    // And the picture is that of a lane that never drew before.
    let kept = gpu.render(&moved, &settings).unwrap();
    assert_eq!(kept.image, renderer(RasterLane::Gpu).render(&moved, &settings).unwrap().image);
    first_scene.lights.clear();
    assert!(gpu.render(&first_scene, &settings).is_ok(), "no light at all");
}

#[test]
fn the_tolerance_notices_a_missing_stage() {
    // The mutations that must fail the tolerance: no shadows, no indirect light, no tracing.
    if opened_or_skip("the_tolerance_notices_a_missing_stage", GpuRaster::new()).is_none() {
        return;
    }
    let (mut cpu, mut gpu) = (renderer(RasterLane::Cpu), renderer(RasterLane::Gpu));
    let scene = scene("two-spheres", 30);
    let full = cpu.render(&scene, &settings()).unwrap();
    for (what, mutated) in [
        ("no shadows", RenderSettings { shadows: Shadows::Off, ..settings() }),
        ("no indirect light", RenderSettings { vpl: None, ..settings() }),
        ("no tracing", RenderSettings { traced: false, ..settings() }),
    ] {
        let c = layer_difference(&gpu.render(&scene, &mutated).unwrap(), &full, Layer::Final);
        println!("{what}: FLIP mean {:.4}, p99 {:.3}", c.flip.mean(), c.flip.percentile(0.99));
        assert!(!agrees(&c), "{what} passes the tolerance: FLIP mean {}", c.flip.mean());
    }
}
