//! Golden pictures: the five scenes at frame 30, every layer. The CPU lane gives the same bits everywhere, so its linear
//! pictures are held by hash and their PNGs by byte. The GPU lane (software Vulkan in CI) is held to the CPU lane's pictures
//! by FLIP.
//!
//! `just goldens` rewrites; look at the pictures afterwards.

use catoptra_render_hybrid::{Frame, Layer, RenderSettings, VplOptions};
use catoptra_tests::{
    FlipLimits, Rendering,
    fixtures::{SCENE_NAMES, cpu, golden_hashes, goldens, scene_at, small},
    gpu_or_skip,
};

/// Where most is to be seen: bodies have left their start, nothing is at rest.
const FRAME: u64 = 30;

fn settings() -> RenderSettings {
    let mut settings = RenderSettings { keep_layers: true, ..small(160, 160, 128) };
    // One golden for both lanes: the GPU's has no grid (light_grid.rs holds what that changes).
    settings.vpl = settings.vpl.map(|v| VplOptions { spacing: 1, ..v });
    settings
}

/// What the design allows between the lanes (FLIP, in [0, 1]). harness.rs shows what fails it.
const LANES: FlipLimits = FlipLimits { mean: 0.02, percentile_99: 0.2 };

/// Limits of a layer. Data layers differ along silhouettes alone, where a pixel centre falls to either side of an edge.
fn lane_limits(layer: Layer) -> FlipLimits {
    match layer {
        Layer::Final | Layer::Direct | Layer::Indirect | Layer::Traced => LANES,
        Layer::Mask | Layer::Depth | Layer::Normal | Layer::Albedo => FlipLimits { mean: 0.005, percentile_99: 0.05 },
        Layer::Moments => FlipLimits { mean: 0.01, percentile_99: 0.1 },
    }
}

fn check_cpu(name: &str) {
    let frame = cpu().render(&scene_at(name, FRAME), &settings()).unwrap();
    assert_eq!(frame.stats.non_finite, (0, None));
    let mut failures = Vec::new();
    for (layer, layer_name) in Layer::ALL {
        let image = frame.layer(layer).expect("all layers were kept");
        let snapshot = format!("{name}-{layer_name}");
        if let Err(e) = golden_hashes().check(&snapshot, image.hash()) {
            failures.push(e.to_string());
        }
        if let Err(e) = goldens().check_exact(&snapshot, &Rendering::of_layer(layer, image)) {
            failures.push(e.to_string());
        }
    }
    assert!(failures.is_empty(), "{name}:\n{}", failures.join("\n"));
}

#[test]
fn cpu_rolling_box() {
    check_cpu("rolling-box");
}

#[test]
fn cpu_rolling_box_donut() {
    check_cpu("rolling-box-donut");
}

#[test]
fn cpu_two_spheres() {
    check_cpu("two-spheres");
}

#[test]
fn cpu_rolling_box_venus() {
    check_cpu("rolling-box-venus");
}

#[test]
fn cpu_rolling_box_sponza() {
    check_cpu("rolling-box-sponza");
}

#[test]
fn goldens_are_all_in_use() {
    let wanted: Vec<String> =
        SCENE_NAMES.iter().flat_map(|s| Layer::ALL.map(|(_, layer)| format!("{s}-{layer}"))).collect();
    for name in golden_hashes().names().unwrap() {
        assert!(wanted.contains(&name), "the golden hash {name} belongs to no test");
    }
}

/// The final picture is the sum of its parts, and every part has something to show where the scene has it.
#[test]
fn layers_add_up() {
    for name in SCENE_NAMES {
        let frame: Frame = cpu().render(&scene_at(name, FRAME), &settings()).unwrap();
        let part = |l: Layer| &frame.layer(l).unwrap().pixels;
        let (direct, indirect, traced) = (part(Layer::Direct), part(Layer::Indirect), part(Layer::Traced));
        for (i, p) in frame.image.pixels.iter().enumerate() {
            for c in 0..3 {
                assert_eq!(p[c], direct[i][c] + indirect[i][c] + traced[i][c], "{name}: pixel {i}");
            }
            if part(Layer::Mask)[i] == [0.0; 3] {
                assert_eq!(traced[i], [0.0; 3], "{name}: pixel {i} is not masked and yet traced");
            }
        }
        let lit = |pixels: &Vec<[f32; 3]>| pixels.iter().any(|p| p.iter().any(|v| *v > 0.0));
        assert!(lit(direct) && lit(indirect), "{name}");
        assert_eq!(lit(traced), name != "rolling-box", "{name}");
    }
}

/// The golden pictures are the CPU lane's; this never rewrites them. lanes.rs compares both lanes at more frames.
#[test]
fn gpu_lane_lies_near_the_goldens() {
    let Some(mut gpu) = gpu_or_skip("gpu_lane_lies_near_the_goldens") else { return };
    println!("adapter: {}", gpu.device());
    let mut failures = Vec::new();
    for name in SCENE_NAMES {
        let frame = gpu.render(&scene_at(name, FRAME), &settings()).unwrap();
        for (layer, layer_name) in Layer::ALL {
            let actual = Rendering::of_layer(layer, frame.layer(layer).expect("a kept layer"));
            let snapshot = format!("{name}-{layer_name}");
            match goldens().updating(false).check_flip(&snapshot, &actual, lane_limits(layer)) {
                Ok(r) => println!("{snapshot}: FLIP mean {:.5}, 99th percentile {:.5}", r.mean, r.percentile_99),
                Err(e) => failures.push(e.to_string()),
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// The mutation that each limit must fail: another frame of the same scene.
#[test]
fn another_frame_is_beyond_every_limit() {
    let render = |frame| cpu().render(&scene_at("rolling-box-donut", frame), &settings()).unwrap();
    let (here, there) = (render(FRAME), render(90));
    for (layer, name) in Layer::ALL {
        let [a, b] = [&here, &there].map(|f| Rendering::of_layer(layer, f.layer(layer).expect("a kept layer")));
        let (flip, limits) = (a.flip(&b).expect("equal sizes"), lane_limits(layer));
        let within = flip.mean() <= limits.mean && flip.percentile(0.99) <= limits.percentile_99;
        println!("{name}: FLIP mean {:.4}, 99th percentile {:.4}", flip.mean(), flip.percentile(0.99));
        assert!(!within, "{name}: frame 90 would pass for frame {FRAME}");
    }
}
