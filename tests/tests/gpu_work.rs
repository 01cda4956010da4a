//! How the one kernel of the compute tracer uses its lanes, counted: the figures behind "one kernel or wavefront queues".

use catoptra_demos::scenes;
use catoptra_engine::{Extracted, app};
use catoptra_render_hybrid::{
    Image, Layer, MomentOptions, RasterLane, RenderSettings, Renderer, RendererOptions, Tracer,
};
use catoptra_tests::opened_or_skip;

/// Share of the lanes' time that is work where `lanes` neighbours of a list wait for their slowest.
fn utilisation(work: &[f64], lanes: usize) -> f64 {
    let most: f64 = work.chunks(lanes).map(|g| g.iter().fold(0.0, |a: f64, b| a.max(*b)) * lanes as f64).sum();
    work.iter().sum::<f64>() / most.max(1.0)
}

/// As [`utilisation`] by steps, of lanes that wait for each other after each ray (one kernel) or of a queue for each ray number of
/// the pixels, in which all lanes have a ray (wavefront). A pixel's rays are taken as equally long, which both flatters alike.
fn utilisation_by_turns(work: &[[f64; 2]], lanes: usize, queues: bool) -> f64 {
    let turns = work.iter().map(|p| p[0]).fold(0.0, f64::max) as usize;
    let turn = |pixels: &[[f64; 2]], k: usize| {
        let (mut most, mut list) = (0.0, Vec::new());
        for p in pixels.iter().filter(|p| p[0] as usize > k) {
            list.push(p[1] / p[0]);
        }
        for group in list.chunks(lanes) {
            most += group.iter().fold(0.0, |a: f64, b| a.max(*b)) * lanes as f64;
        }
        most
    };
    let most: f64 = (0..turns)
        .map(|k| if queues { turn(work, k) } else { work.chunks(lanes).map(|group| turn(group, k)).sum() })
        .sum();
    work.iter().map(|p| p[1]).sum::<f64>() / most.max(1.0)
}

/// Masked pixels by squares of 8 x 8 in Z order, as the list of the tracer has them (`shaders/compact.wgsl`), or by rows.
fn masked(layer: &Image, squares: bool) -> Vec<[f64; 2]> {
    let (w, h) = (layer.width, layer.height);
    let mut order: Vec<(u32, u32)> = (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).collect();
    let spread = |v: u32| (v & 1) | (v & 2) << 1 | (v & 4) << 2;
    if squares {
        assert!(w % 8 == 0 && h % 8 == 0, "whole squares");
        order.sort_by_key(|&(x, y)| (y / 8, x / 8, spread(x % 8) | spread(y % 8) << 1));
    }
    let pixel = |(x, y): (u32, u32)| layer.pixels[(y * w + x) as usize];
    let shown = order.into_iter().map(pixel).filter(|p| p[2] > 0.0);
    shown.map(|p| [f64::from(p[0]), f64::from(p[1])]).collect()
}

/// `cargo test -p catoptra_tests --test gpu_work -- --nocapture`; `CATOPTRA_SIZE` names another size than 128.
#[test]
fn lanes_of_the_one_kernel() {
    let test = "lanes_of_the_one_kernel";
    let size = std::env::var("CATOPTRA_SIZE").ok().and_then(|s| s.parse().ok()).unwrap_or(128);
    let moments = MomentOptions { size: 64, face_size: 32, ..MomentOptions::default() };
    let settings = RenderSettings {
        width: size,
        height: size,
        vpl: None,
        keep_layers: true,
        moments,
        ..RenderSettings::default()
    };
    let options = RendererOptions { raster: RasterLane::Gpu, tracer: Tracer::Gpu, ..RendererOptions::default() };
    let Some(mut renderer) = opened_or_skip(test, Renderer::new(options)) else { return };
    for info in scenes::SCENES.iter().filter(|i| i.name != "rolling-box") {
        let mut world = scenes::build(info.name, &scenes::SceneOptions::default()).unwrap();
        app::advance(&mut world, 30);
        let scene = world.world().resource::<Extracted>().0.clone();
        let plain = renderer.render(&scene, &settings).unwrap();
        renderer.gpu_mut().unwrap().show_work(true);
        let frame = renderer.render(&scene, &settings).unwrap();
        renderer.gpu_mut().unwrap().show_work(false);
        let layer = frame.layer(Layer::Traced).unwrap();
        let list = masked(layer, true);
        // What is shown is what is counted, and showing it leaves no mark.
        let rays: f64 = list.iter().map(|p| p[0]).sum();
        assert_eq!(list.len() as u64, plain.stats.masked_pixels);
        assert_eq!(rays as u64, plain.stats.rays.reflection + plain.stats.rays.refraction, "{}", info.name);
        assert!(list.iter().all(|p| p[0] <= p[1]), "a walk takes a step at least");
        assert_eq!(renderer.render(&scene, &settings).unwrap().image.hash(), plain.image.hash());

        let of = |list: &[[f64; 2]], i: usize| list.iter().map(|p| p[i]).collect::<Vec<_>>();
        let most = |i: usize| list.iter().map(|p| p[i]).fold(0.0, f64::max);
        let n = list.len() as f64;
        println!(
            "{}: {} pixels, rays {:.2} a pixel (most {}), steps {:.1} a ray",
            info.name,
            list.len(),
            rays / n,
            most(0),
            of(&list, 1).iter().sum::<f64>() / rays.max(1.0)
        );
        for (what, list) in [("8 x 8", list), ("rows", masked(layer, false))] {
            let share = |i, lanes| 100.0 * utilisation(&of(&list, i), lanes);
            let three = |f: &dyn Fn(usize) -> f64| [64, 32, 8].map(|lanes| format!("{:.0}", f(lanes))).join(", ");
            println!(
                "  {what}, % of 64, 32, 8 lanes busy: by rays {}; by steps {}",
                three(&|lanes| share(0, lanes)),
                three(&|lanes| share(1, lanes))
            );
            let turns = |lanes, queues| 100.0 * utilisation_by_turns(&list, lanes, queues);
            println!(
                "    ray after ray {}; with a queue for each {}",
                three(&|lanes| turns(lanes, false)),
                three(&|lanes| turns(lanes, true))
            );
            assert!(turns(64, false) > 0.0 && turns(64, true) <= 100.0 && turns(64, false) <= share(1, 64) + 1e-9);
            assert!(share(0, 64) > 0.0 && share(0, 64) <= share(0, 32) && share(0, 32) <= 100.0);
        }
    }
}
