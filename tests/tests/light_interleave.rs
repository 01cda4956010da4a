//! Interleaved VPLs against their full evaluation: the same light, a little blurred. Both lanes do the same.

use catoptra_engine::{RenderScene, glam::Vec3};
use catoptra_render_hybrid::{
    Frame, Image, Layer, RasterLane, RenderSettings, Renderer, RendererOptions, Tracer, VplOptions, VplShadows,
    metrics,
    raster::{GpuRaster, Indirect},
    twin::{
        interleave::{Guide, filter, subset_of, subset_range},
        shadow::ShadowPlan,
        vpl::Vpl,
    },
};
use catoptra_tests::{
    fixtures::{SCENE_NAMES, cpu, cpu_with, scene_at, small},
    opened_or_skip,
};

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

/// Most FLIP mean of the lanes' indirect layers and pictures; without interleaving on one of them they differ by ten times as
/// much.
const FLIP_MEAN: f64 = 0.002;

/// Neither side is a multiple of a block's.
const SIZE: [u32; 2] = [141, 133];

fn settings(vpl: VplOptions) -> RenderSettings {
    RenderSettings { vpl: Some(vpl), keep_layers: true, ..small(SIZE[0], SIZE[1], 256) }
}

fn on_gpu(test: &str, tracer: Tracer) -> Option<Renderer> {
    opened_or_skip(test, GpuRaster::new())?;
    let options = RendererOptions { raster: RasterLane::Gpu, tracer, ..RendererOptions::default() };
    Some(Renderer::new(options).unwrap())
}

fn flip(a: &Image, b: &Image) -> f64 {
    metrics::compare(a, b).unwrap().flip.mean()
}

/// The lanes' indirect layers and pictures are alike.
fn assert_alike(what: &str, gpu: &Frame, cpu: &Frame) {
    assert_eq!((gpu.stats.raster, cpu.stats.raster), (RasterLane::Gpu, RasterLane::Cpu));
    for layer in [Layer::Indirect, Layer::Final] {
        let mean = flip(gpu.layer(layer).unwrap(), cpu.layer(layer).unwrap());
        println!("{what}, {layer:?}: FLIP mean {mean:.5}");
        assert!(mean <= FLIP_MEAN, "{what}, {layer:?}: FLIP mean {mean}");
    }
}

#[test]
fn lanes_agree_on_interleaved_vpls() {
    let Some(mut gpu) = on_gpu("lanes_agree_on_interleaved_vpls", Tracer::Cpu) else { return };
    let mut cpu = cpu();
    for name in SCENE_NAMES {
        let scene = scene_at(name, 30);
        for (interleave, shadows) in
            [(2, VplShadows::Maps), (2, VplShadows::Off), (4, VplShadows::Maps), (4, VplShadows::Off)]
        {
            let vpl = VplOptions { count: 256, interleave, shadows, ..VplOptions::default() };
            let (a, b) = (cpu.render(&scene, &settings(vpl)).unwrap(), gpu.render(&scene, &settings(vpl)).unwrap());
            assert_alike(&format!("{name}, {interleave}x{interleave}, {shadows:?}"), &b, &a);
            // What must fail: one lane that lights every pixel by all.
            let full = gpu.render(&scene, &settings(VplOptions { interleave: 1, ..vpl })).unwrap();
            let mean = flip(full.layer(Layer::Indirect).unwrap(), a.layer(Layer::Indirect).unwrap());
            println!(
                "{name}, {interleave}x{interleave}, {shadows:?}, the GPU lane evaluates fully: FLIP mean {mean:.5}"
            );
            assert!(mean > 2.0 * FLIP_MEAN, "{name}: full evaluation passes with {mean}");
        }
    }
}

#[test]
fn subsets_may_span_chunks_and_come_from_the_gpu_or_from_rays() {
    let test = "subsets_may_span_chunks_and_come_from_the_gpu_or_from_rays";
    let Some(mut gpu) = on_gpu(test, Tracer::Cpu) else { return };
    let mut tracing = on_gpu(test, Tracer::Gpu).unwrap();
    let mut cpu = cpu();
    let scene = scene_at("two-spheres", 30);
    // The GPU holds 1024 in a chunk.
    let many = VplOptions { count: 4500, interleave: 2, shadows: VplShadows::Off, ..VplOptions::default() };
    let a = cpu.render(&scene, &settings(many)).unwrap();
    assert!(a.stats.vpls > 2048, "{} VPLs", a.stats.vpls);
    assert_alike("several chunks", &gpu.render(&scene, &settings(many)).unwrap(), &a);
    let b = tracing.render(&scene, &settings(many)).unwrap();
    assert_eq!(b.stats.tracer, Tracer::Gpu);
    assert_alike("VPLs made on the GPU", &b, &a);
    // A grid that is asked for beside it is none, and neither are VPLs of their own for what it cannot tell.
    let beside = VplOptions { count: 256, interleave: 4, spacing: 2, mirrored: 16, ..VplOptions::default() };
    let a = cpu.render(&scene, &settings(beside)).unwrap();
    assert_alike("beside a grid", &gpu.render(&scene, &settings(beside)).unwrap(), &a);
    let traced = VplOptions { count: 32, interleave: 2, shadows: VplShadows::Traced, ..VplOptions::default() };
    let a = cpu.render(&scene, &settings(traced)).unwrap();
    assert_alike("traced visibility", &gpu.render(&scene, &settings(traced)).unwrap(), &a);
    // After all of these, a frame is what it is on a lane that never drew.
    let fresh = on_gpu(test, Tracer::Cpu).unwrap().render(&scene, &settings(many)).unwrap();
    assert_eq!(gpu.render(&scene, &settings(many)).unwrap().image, fresh.image);
    // Nobody has VPLs.
    let mut dark = scene.clone();
    dark.lights.clear();
    let black = gpu.render(&dark, &settings(many)).unwrap();
    assert!(black.layer(Layer::Indirect).unwrap().pixels.iter().flatten().all(|v| *v == 0.0));
}

#[test]
fn full_evaluation_makes_nothing_for_the_filter() {
    let Some(mut gpu) = on_gpu("full_evaluation_makes_nothing_for_the_filter", Tracer::Cpu) else { return };
    let scene = scene_at("rolling-box", 30);
    let vpl = VplOptions { count: 64, shadows: VplShadows::Off, ..VplOptions::default() };
    let mut made =
        |interleave| gpu.render(&scene, &settings(VplOptions { interleave, ..vpl })).unwrap().stats.pipelines_made;
    made(1);
    assert_eq!([made(1), made(4), made(2), made(1)], [0, 1, 0, 0], "one pipeline, when first wanted");
}

/// The GPU lane's light of each subset alone, at all pixels, as if each were all; from the parts that do not interleave.
fn by_subset(raster: &mut GpuRaster, scene: &RenderScene, vpls: &[Vpl], bound: f32, n: u32) -> Vec<Image> {
    (0..n * n)
        .map(|k| {
            let scaled = |v: &Vpl| Vpl { flux: v.flux * (n * n) as f32, ..*v };
            let own: Vec<Vpl> = vpls[subset_range(vpls.len(), k, n * n)].iter().map(scaled).collect();
            let full = settings(VplOptions { shadows: VplShadows::Off, ..VplOptions::default() });
            let plan = ShadowPlan::new(&scene.lights, scene.bounds_world(), &full.moments);
            raster.begin(scene, &full, &plan).unwrap();
            raster.light(&own, bound, None, Indirect::Vpls).unwrap();
            raster.read_layer(Layer::Indirect).unwrap()
        })
        .collect()
}

/// What the filter takes, of pixels lit by the subset that `lit_by` tells, or by all.
fn guides(
    raster: &mut GpuRaster,
    scene: &RenderScene,
    subsets: &[Image],
    lit_by: impl Fn(u32, u32) -> Option<u32>,
) -> Vec<Guide> {
    let g = raster.read_gbuffer().unwrap();
    let width = subsets[0].width;
    (0..g.material.len())
        .map(|i| {
            let Some(m) = scene.materials.get(g.material[i] as usize) else { return Guide::default() };
            assert!(m.physical.is_none() && !m.unlit, "this test knows plain materials");
            let matte = m.diffuse * (1.0 - m.mirror) * (1.0 - m.transmission) / std::f32::consts::PI;
            let albedo = Vec3::from(g.base_color[i]) * matte;
            let radiance = match lit_by(i as u32 % width, i as u32 / width) {
                Some(k) => Vec3::from(subsets[k as usize].pixels[i]),
                None => subsets.iter().map(|s| Vec3::from(s.pixels[i])).sum::<Vec3>() / subsets.len() as f32,
            };
            let irradiance = Vec3::select(albedo.cmpgt(Vec3::ZERO), radiance / albedo, Vec3::ZERO);
            let (position_world, normal) = (g.positions_world[i].into(), g.n_shading[i].into());
            Guide { position_world, normal, irradiance, albedo }
        })
        .collect()
}

/// The lane's light is the filter's twin over what each subset alone gives its pixels; and the lanes' tolerance notices where
/// either the filter or the assignment is left out.
#[test]
fn the_lane_filters_what_subsets_give() {
    let Some(mut gpu) = on_gpu("the_lane_filters_what_subsets_give", Tracer::Cpu) else { return };
    let mut cpu = cpu();
    let mut raster = GpuRaster::new().unwrap();
    let scene = scene_at("two-spheres", 30);
    let radius = scene.bounds_world().radius();
    let [width, height] = SIZE;
    for n in [2, 4] {
        let vpl = VplOptions { count: 256, interleave: n, shadows: VplShadows::Off, ..VplOptions::default() };
        let bound = vpl.geometry_term_max.unwrap() / (radius * radius);
        let frame = gpu.render(&scene, &settings(vpl)).unwrap();
        let made = frame.layer(Layer::Indirect).unwrap();
        let on_cpu = cpu.render(&scene, &settings(vpl)).unwrap().layer(Layer::Indirect).unwrap().clone();
        let subsets = by_subset(&mut raster, &scene, gpu.vpls(), bound, n);
        let filtered = |guides: &[Guide]| Image {
            width,
            height,
            pixels: (0..width * height)
                .map(|i| filter(guides, width, height, i % width, i / width, n).into())
                .collect(),
        };
        let own = guides(&mut raster, &scene, &subsets, |x, y| Some(subset_of(x, y, n)));
        let expected = filtered(&own);
        let off = |a: &Image| {
            let differ = a.pixels.iter().zip(&made.pixels).map(|(a, b)| (Vec3::from(*a) - Vec3::from(*b)).length());
            differ.map(f64::from).sum::<f64>() / (3.0 * a.pixels.len() as f64) / mean(made)
        };
        println!("{n}x{n}: the lane and the twin over its parts differ by {:.2e} of the light", off(&expected));
        assert!(off(&expected) < 1e-4, "{}", off(&expected));
        let unfiltered: Vec<[f32; 3]> = own.iter().map(|g| (g.albedo * g.irradiance).into()).collect();
        let unfiltered = Image { width, height, pixels: unfiltered };
        let all_by_all = filtered(&guides(&mut raster, &scene, &subsets, |_, _| None));
        let all_by_one = filtered(&guides(&mut raster, &scene, &subsets, |_, _| Some(0)));
        let turned = filtered(&guides(&mut raster, &scene, &subsets, |x, y| Some(subset_of(x + 1, y, n))));
        assert!(flip(&expected, &on_cpu) <= FLIP_MEAN);
        for (what, mutant) in [
            ("no filter", unfiltered),
            ("all pixels by all VPLs, filtered", all_by_all),
            ("all pixels by one subset", all_by_one),
            ("subsets of the neighbours", turned),
        ] {
            let (mean, off) = (flip(&mutant, &on_cpu), off(&mutant));
            println!("{n}x{n}, {what}: FLIP mean {mean:.5} from the CPU lane, {off:.2e} of the light");
            assert!(mean > FLIP_MEAN && off > 1e-3, "{n}x{n}: {what} passes with FLIP mean {mean}, {off}");
        }
    }
}
