//! Both lanes give the same picture: FLIP mean at most 0.02 and 99th percentile at most 0.2 for each scene.

use catoptra_demos::scenes;
use catoptra_engine::{Extracted, RenderScene, app};
use catoptra_render_hybrid::{
    Frame, Layer, RasterLane, RenderSettings, Renderer, RendererOptions, Shadows, VplOptions,
    metrics::{Comparison, compare},
    raster::GpuRaster,
};
use catoptra_tests::opened_or_skip;

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
    let preset = RenderSettings::default();
    // The GPU lane has no grid; what the grid changes is held in light_grid.rs.
    let vpl = preset.vpl.map(|v| VplOptions { spacing: 1, ..v });
    RenderSettings { width: SIZE, height: SIZE, keep_layers: true, vpl, ..preset }
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
