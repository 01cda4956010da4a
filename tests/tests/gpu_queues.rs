//! The compute tracer's one kernel against the same tracer wave by wave over queues, and its list of pixels in another order: the
//! same picture, and the time of each.
//!
//! Times are those of processors, not of clocks on the wall: software Vulkan works on all cores, which other programs may
//! want as well. The figures of docs/gpu-tracer.md:
//! `CATOPTRA_SIZE=256 CATOPTRA_ROUNDS=7 cargo test -p catoptra_tests --test gpu_queues -- --nocapture --test-threads 1`

use catoptra_demos::scenes;
use catoptra_engine::{Extracted, RenderScene, app};
use catoptra_render_hybrid::{
    Frame, Layer, RasterLane, RenderSettings, Renderer, RendererOptions, Tracer,
    metrics::compare,
    raster::testing::{ListOrder, Waves},
};
use catoptra_tests::opened_or_skip;

/// Every wave that eight interfaces can have: each of up to 32 hidden ones is a wave, too.
const ALL_WAVES: u32 = 40;
/// Frames a measurement, which counts in hundredths of a second.
const FRAMES: u32 = 2;

fn number(name: &str, or: u32) -> u32 {
    std::env::var(name).ok().and_then(|s| s.parse().ok()).unwrap_or(or)
}

fn settings(size: u32) -> RenderSettings {
    RenderSettings { width: size, height: size, keep_layers: true, time_passes: true, ..RenderSettings::default() }
}

fn scene(name: &str) -> RenderScene {
    let mut world = scenes::build(name, &scenes::SceneOptions::default()).unwrap();
    app::advance(&mut world, 30);
    world.world().resource::<Extracted>().0.clone()
}

fn renderer(test: &str) -> Option<Renderer> {
    let options = RendererOptions { raster: RasterLane::Gpu, tracer: Tracer::Gpu, ..RendererOptions::default() };
    opened_or_skip(test, Renderer::new(options))
}

/// One way to make the layer.
#[derive(Clone, Copy)]
struct Way {
    name: &'static str,
    waves: Option<Waves>,
    order: ListOrder,
    /// False: no layer at all, which is what the others are measured against.
    traced: bool,
}

const ONE_KERNEL: Way = Way { name: "one kernel", waves: None, order: ListOrder::Squares, traced: true };

fn by(renderer: &mut Renderer, scene: &RenderScene, settings: &RenderSettings, way: &Way) -> Frame {
    let gpu = renderer.gpu_mut().unwrap();
    gpu.trace_by_waves(way.waves);
    gpu.list_pixels_by(Some(way.order));
    renderer.render(scene, &RenderSettings { traced: way.traced, ..*settings }).unwrap()
}

/// Milliseconds that processors have spent on this process, in steps of 10; 0 where the system does not say.
fn processor_ms() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or("").split_whitespace().collect();
    let ticks = |i: usize| fields.get(i).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    // utime and stime; USER_HZ is 100 on every Linux.
    10.0 * (ticks(11) + ticks(12))
}

/// Greatest difference of the traced layers, in shares of a channel's light (of at least 0.01).
fn greatest_difference(a: &Frame, b: &Frame) -> f32 {
    let (a, b) = (a.layer(Layer::Traced).unwrap(), b.layer(Layer::Traced).unwrap());
    let channels = a.pixels.iter().flatten().zip(b.pixels.iter().flatten());
    let off = channels.map(|(a, b)| (a - b).abs() / a.abs().max(0.01));
    off.fold(0.0, |worst: f32, off| if off > worst || off.is_nan() { off } else { worst })
}

fn median(mut v: Vec<f64>) -> f64 {
    v.sort_by(f64::total_cmp);
    v[v.len() / 2]
}

/// All ways in turn, `CATOPTRA_ROUNDS` times (default: none), and on stdout the median, least and greatest of processor time a
/// frame beyond that of a frame without the layer, and the shortest time of the layer by the clock on the wall.
fn measure(renderer: &mut Renderer, scene: &RenderScene, settings: &RenderSettings, ways: &[Way]) {
    let rounds = number("CATOPTRA_ROUNDS", 0);
    if rounds == 0 {
        return;
    }
    let nothing = Way { traced: false, ..ONE_KERNEL };
    let mut times = vec![Vec::new(); ways.len()];
    let mut wall = vec![f64::MAX; ways.len()];
    for _ in 0..rounds {
        let mut spent = |way: &Way| {
            // Drivers may have dropped the kernels of one way for those of another.
            drop(by(renderer, scene, settings, way));
            let before = processor_ms();
            let layer = |_| by(renderer, scene, settings, way).stats.stages_ms.traced;
            let least = (0..FRAMES).map(layer).fold(f64::MAX, f64::min);
            ((processor_ms() - before) / f64::from(FRAMES), least)
        };
        let all: Vec<(f64, f64)> = ways.iter().map(&mut spent).collect();
        let without = spent(&nothing).0;
        for (i, (all, least)) in all.into_iter().enumerate() {
            times[i].push(all - without);
            wall[i] = wall[i].min(least);
        }
    }
    for ((way, times), wall) in ways.iter().zip(times).zip(wall) {
        let (least, most) = times.iter().fold((f64::MAX, f64::MIN), |(a, b), t| (a.min(*t), b.max(*t)));
        println!("  {}: {:.0} ms ({least:.0} to {most:.0}), wall {wall:.1}", way.name, median(times));
    }
}

#[test]
fn queues_make_the_picture_of_the_one_kernel() {
    let test = "queues_make_the_picture_of_the_one_kernel";
    let settings = settings(number("CATOPTRA_SIZE", 128));
    let Some(mut renderer) = renderer(test) else { return };
    let way =
        |name, most, finish, two| Way { name, waves: Some(Waves { most, finish, two_kernels: two }), ..ONE_KERNEL };
    for info in &scenes::SCENES {
        let scene = scene(info.name);
        let one = by(&mut renderer, &scene, &settings, &ONE_KERNEL);
        let rays = one.stats.rays;
        // As many waves as there are: the fewest that follow every ray.
        let deepest = (0..=ALL_WAVES)
            .find(|&most| {
                let r = by(&mut renderer, &scene, &settings, &way("", most, false, false)).stats.rays;
                (r.reflection, r.refraction) == (rays.reflection, rays.refraction)
            })
            .expect("all rays are followed");
        let ways = [
            ONE_KERNEL,
            way("a queue a bounce, 40 waves", ALL_WAVES, false, false),
            way("a queue a bounce, as many as there are", deepest, false, false),
            way("the same, walk and shading apart", deepest, false, true),
            way("one queue, then the one kernel", 0, true, false),
            way("two queues, then the one kernel", 1, true, false),
            way("three queues, then the one kernel", 2, true, false),
        ];
        println!(
            "{}: {} pixels, {} rays in {deepest} waves",
            info.name,
            one.stats.masked_pixels,
            rays.reflection + rays.refraction,
        );
        let mut hashes = Vec::new();
        for way in &ways {
            let [frame, again] = [0; 2].map(|_| by(&mut renderer, &scene, &settings, way));
            let r = frame.stats.rays;
            let (name, scene) = (way.name, info.name);
            assert_eq!((r.reflection, r.refraction), (rays.reflection, rays.refraction), "{scene}, {name}");
            let c = compare(frame.layer(Layer::Traced).unwrap(), one.layer(Layer::Traced).unwrap()).unwrap();
            let off = greatest_difference(&one, &frame);
            println!("  {name}: FLIP mean {:.1e}, greatest difference {off:.1e}", c.flip.mean());
            assert!(c.flip.mean() <= 1e-4 && off <= 1e-3, "{scene}, {name}: {off}, {}", c.flip.mean());
            // The same bits on every run, by queues too: sums are whole numbers.
            let hash = |f: &Frame| f.layer(Layer::Traced).unwrap().hash();
            assert_eq!(hash(&frame), hash(&again), "{scene}, {name}");
            hashes.push(hash(&frame));
        }
        assert!(hashes[1] == hashes[2] && hashes[1] == hashes[3], "{}", info.name);
        measure(&mut renderer, &scene, &settings, &ways);
    }
}

/// The test above can fail: with waves too few, light is missing.
#[test]
fn a_missing_wave_is_noticed() {
    let Some(mut renderer) = renderer("a_missing_wave_is_noticed") else { return };
    let settings = settings(64);
    let scene = scene("rolling-box-donut");
    let one = by(&mut renderer, &scene, &settings, &ONE_KERNEL);
    let two = Waves { most: 2, finish: false, two_kernels: false };
    let few = by(&mut renderer, &scene, &settings, &Way { waves: Some(two), ..ONE_KERNEL });
    assert!(few.stats.rays.reflection < one.stats.rays.reflection);
    assert!(greatest_difference(&one, &few) > 0.01);
}

#[test]
fn the_order_of_pixels_does_not_show() {
    let Some(mut renderer) = renderer("the_order_of_pixels_does_not_show") else { return };
    let ways = [("by rows", ListOrder::Rows), ("by squares of 8 x 8 in Z order", ListOrder::Squares)]
        .map(|(name, order)| Way { name, order, ..ONE_KERNEL });
    for info in &scenes::SCENES {
        let scene = scene(info.name);
        println!("{}", info.name);
        // Sides of no whole squares, too.
        for (width, height) in [(124, 124), (97, 131), (5, 64), (64, 3)] {
            let settings = RenderSettings { width, height, ..settings(0) };
            let mut lists = Vec::new();
            let frames = ways.map(|way| {
                let frame = by(&mut renderer, &scene, &settings, &way);
                lists.push(renderer.gpu_mut().unwrap().read_masked_pixels().unwrap());
                frame
            });
            // The CPU is told of the same pixels in ascending order.
            assert_eq!(lists[0].len() as u64, frames[0].stats.masked_pixels);
            assert!(lists[0] == lists[1] && lists[0].is_sorted());
            let hash = |f: &Frame| f.layer(Layer::Traced).unwrap().hash();
            let counted = |f: &Frame| (f.stats.masked_pixels, f.stats.rays.reflection, f.stats.rays.refraction);
            for f in &frames[1..] {
                assert_eq!((hash(f), counted(f)), (hash(&frames[0]), counted(&frames[0])), "{}", info.name);
            }
        }
        measure(&mut renderer, &scene, &settings(number("CATOPTRA_SIZE", 128)), &ways);
    }
}
