//! VPLs kept from frame to frame: nothing changes at rest, little where a light moves, the light adds up, and what a light no
//! longer sees gives none of it. Off, a frame has no history: history.rs and determinism.rs hold that.

use catoptra_engine::{
    Camera, LightKind, Material, RenderScene,
    app::advance,
    math,
    shapes::{cuboid, sphere},
};
use catoptra_render_hybrid::{
    Image, Layer, RasterLane, RenderSettings, Renderer, RendererOptions, SimdLevel, Tracer, VplOptions, VplShadows,
    twin::vpl::Vpl,
};
use catoptra_tests::{
    HandScene, at,
    fixtures::{SCENE_NAMES, app_at, cpu, cpu_with, extracted, small},
    opened_or_skip,
};
use glam::{Affine3, Vec3};
use std::collections::BTreeSet;

/// 200 VPLs with maps, of which at most `reuse` are made anew.
fn settings(reuse: u32) -> RenderSettings {
    let vpl = VplOptions { count: 200, map_size: 16, spacing: 4, reuse, ..VplOptions::default() };
    RenderSettings { vpl: Some(vpl), keep_layers: true, ..small(32, 32, 32) }
}

/// A closed room of 4 x 3 x 4 m with a box and a ball in it, and one light.
fn room(kind: LightKind) -> RenderScene {
    let camera = Camera::looking_at(Vec3::new(1.8, 0.6, 1.8), Vec3::new(-0.5, -0.8, -0.5), 1.2);
    let mut s = HandScene::new(camera);
    s.add(
        cuboid(Vec3::new(2.0, 1.5, 2.0), [Vec3::ONE; 6]),
        Material::lambert(Vec3::new(0.7, 0.6, 0.5)),
        at(Vec3::ZERO),
    );
    let body = Material::lambert(Vec3::new(0.3, 0.6, 0.4));
    s.add(cuboid(Vec3::splat(0.3), [Vec3::ONE; 6]), body, at(Vec3::new(-0.8, -1.1, -0.4)));
    s.add(sphere(0.4, 16, 24), body, at(Vec3::new(0.7, -1.0, -0.8)));
    s.light(kind, Vec3::new(0.2, 1.2, 0.1), Vec3::splat(6.0));
    s.0
}

/// An open stage under the sky: floor, back wall and the two bodies.
fn stage(kind: LightKind) -> RenderScene {
    let mut s = room(kind);
    s.meshes[0] = cuboid(Vec3::new(2.0, 0.1, 2.0), [Vec3::ONE; 6]).into();
    s.instances[0].world_from_object = at(Vec3::new(0.0, -1.6, 0.0));
    s
}

/// Frame `k` of a light that goes round, and turns where that shows.
fn move_light(scene: &mut RenderScene, k: u32) {
    let (s, c) = math::sin_cos(0.03 * k as f32);
    let light = &mut scene.lights[0];
    light.position_world = Vec3::new(0.2 + 0.8 * s, 1.2 - 0.1 * (1.0 - c), 0.1 + 0.8 * (1.0 - c));
    light.direction_world = Vec3::new(0.3 * s, -1.0, 0.2 * s).normalize();
    light.up_world = light.direction_world.cross(Vec3::X).normalize();
}

fn moved_kinds() -> [(&'static str, RenderScene); 3] {
    let spot = LightKind::Spot { cos_inner: 0.8, cos_outer: 0.5 };
    [("point", room(LightKind::Point)), ("spot", room(spot)), ("directional", stage(LightKind::Directional))]
}

/// Places of VPLs, by their bits.
fn places(vpls: &[Vpl]) -> BTreeSet<[u32; 6]> {
    let bits = |v: &Vpl| {
        let (p, n) = (v.position_world, v.normal_world);
        [p.x, p.y, p.z, n.x, n.y, n.z].map(f32::to_bits)
    };
    vpls.iter().map(bits).collect()
}

fn flux(vpls: &[Vpl]) -> f64 {
    vpls.iter().map(|v| f64::from(v.flux.element_sum())).sum()
}

fn mean(image: &Image) -> f64 {
    image.pixels.iter().flatten().map(|v| f64::from(*v)).sum::<f64>() / (3 * image.pixels.len()) as f64
}

fn render(renderer: &mut Renderer, scene: &RenderScene, settings: &RenderSettings) -> (Image, Image, u64) {
    let frame = renderer.render(scene, settings).unwrap();
    (frame.layer(Layer::Indirect).unwrap().clone(), frame.image, frame.stats.rays.vpl_maps)
}

#[test]
fn the_first_frame_is_that_without_reuse() {
    for name in SCENE_NAMES {
        let scene = extracted(&app_at(name, 30));
        let (mut kept, mut anew) = (cpu(), cpu());
        assert_eq!(
            kept.render(&scene, &settings(20)).unwrap().image,
            anew.render(&scene, &settings(0)).unwrap().image,
            "{name}"
        );
        assert_eq!(kept.vpls(), anew.vpls(), "{name}");
        // And so is that after a change of the scene that is no motion.
        let mut other = scene.clone();
        other.materials[0] = Material::lambert(Vec3::new(0.1, 0.9, 0.2));
        other.structure_revision += 1;
        for (r, reuse) in [(&mut kept, 20), (&mut anew, 0)] {
            assert_eq!(r.render(&other, &settings(reuse)).unwrap().stats.vpls_reused, 0, "{name}");
        }
        assert_eq!(kept.vpls(), anew.vpls(), "{name}: another material");
        let other_seed = RenderSettings { seed: 5, ..settings(20) };
        kept.render(&other, &other_seed).unwrap();
        anew.render(&other, &RenderSettings { seed: 5, ..settings(0) }).unwrap();
        assert_eq!(kept.vpls(), anew.vpls(), "{name}: another seed");
    }
}

#[test]
fn off_remembers_nothing() {
    let mut scene = room(LightKind::Point);
    let mut renderer = cpu();
    for k in 0..4 {
        move_light(&mut scene, k);
        // Reuse in between leaves no trace once it is off.
        renderer.render(&scene, &settings(10)).unwrap();
        let off = renderer.render(&scene, &settings(0)).unwrap();
        let fresh = cpu().render(&scene, &settings(0)).unwrap();
        assert_eq!((off.image, off.stats.vpls_reused), (fresh.image, 0), "frame {k}");
    }
}

#[test]
fn nothing_changes_at_rest() {
    for (what, mut scene) in moved_kinds() {
        let mut renderer = cpu();
        for k in 0..6 {
            move_light(&mut scene, k);
            renderer.render(&scene, &settings(40)).unwrap();
        }
        // Lost paths find their successors in the first frames at rest.
        let mut settled = renderer.vpls().to_vec();
        let mut frames = 0;
        loop {
            renderer.render(&scene, &settings(40)).unwrap();
            if renderer.vpls() == settled {
                break;
            }
            settled = renderer.vpls().to_vec();
            frames += 1;
            assert!(frames <= 10, "{what}: 200 VPLs are made anew within five frames of 40");
        }
        println!("{what}: settled after {frames} frames");
        let first = renderer.render(&scene, &settings(40)).unwrap();
        for _ in 0..3 {
            let next = renderer.render(&scene, &settings(40)).unwrap();
            assert_eq!((next.image, next.stats.rays.photon, next.stats.rays.vpl_maps), (first.image.clone(), 0, 0));
            assert_eq!(next.stats.vpls_reused, next.stats.vpls, "{what}");
            assert_eq!(renderer.vpls(), settled, "{what}");
        }
    }
}

#[test]
fn a_moving_light_moves_few_vpls() {
    for (what, mut scene) in moved_kinds() {
        for reuse in [10, 40] {
            let (mut kept, mut anew) = (cpu(), cpu());
            let mut before = BTreeSet::new();
            let (mut most, mut rays, mut all_rays) = (0, 0, 0);
            for k in 0..12 {
                move_light(&mut scene, k);
                let some = kept.render(&scene, &settings(reuse)).unwrap().stats;
                let all = anew.render(&scene, &settings(0)).unwrap().stats;
                let now = places(kept.vpls());
                if k > 0 {
                    let new = now.difference(&before).count();
                    assert!(new <= reuse as usize, "{what}, frame {k}: {new} VPLs are new");
                    assert!(some.vpls - some.vpls_reused <= reuse, "{what}: {} of {}", some.vpls_reused, some.vpls);
                    // Half of a map's texels lie above its VPL's horizon.
                    assert!(some.rays.vpl_maps <= new as u64 * 200, "{what}: {new} VPLs are new, {:?}", some.rays);
                    most = most.max(new);
                    rays += some.rays.vpl_maps;
                    all_rays += all.rays.vpl_maps;
                }
                before = now;
            }
            println!("{what}, at most {reuse}: {most} new VPLs in a frame, {rays} rays for maps, {all_rays} without");
            assert!(most > 0 && rays * 4 < all_rays, "{what}");
        }
    }
}

/// A light that jumps: the set follows by so many a frame, whether it goes on moving or not, and then is as good as a new one.
#[test]
fn a_light_that_jumps_is_followed_in_a_few_frames() {
    let spot = LightKind::Spot { cos_inner: 0.8, cos_outer: 0.5 };
    for (what, mut scene) in [("point", room(LightKind::Point)), ("spot", room(spot))] {
        let mut renderer = cpu();
        scene.lights[0].position_world = Vec3::new(-1.5, 1.2, -1.5);
        renderer.render(&scene, &settings(20)).unwrap();
        let mut before = places(renderer.vpls());
        scene.lights[0].position_world = Vec3::new(1.5, 0.4, 1.5);
        let mut counts = Vec::new();
        loop {
            let stats = renderer.render(&scene, &settings(20)).unwrap().stats;
            let now = places(renderer.vpls());
            let new = now.difference(&before).count();
            assert!(new <= 20, "{what}, frame {}: {new} VPLs are new", counts.len());
            before = now;
            if stats.rays.photon == 0 {
                break;
            }
            counts.push(new);
            assert!(counts.len() <= 30, "{what}: never at rest, {counts:?}");
        }
        println!("{what}: new VPLs in each frame after the jump: {counts:?}");
        assert!(counts.len() > 2 && counts[0] >= 15, "{what}: {counts:?}");
        let mut fresh = cpu();
        fresh.render(&scene, &settings(0)).unwrap();
        let (kept, of) = (renderer.vpls().len(), fresh.vpls().len());
        assert!(kept * 10 >= of * 8, "{what}: {kept} VPLs, {of} if all were new");
    }
}

#[test]
fn the_light_adds_up() {
    for (what, mut scene) in moved_kinds() {
        let (mut kept, mut anew) = (cpu(), cpu());
        let (mut flux_apart, mut light_apart) = (0.0f64, 0.0f64);
        for k in 0..20 {
            move_light(&mut scene, k);
            scene.lights[0].intensity = Vec3::splat(6.0 + 0.2 * k as f32);
            let (a, _, _) = render(&mut kept, &scene, &settings(20));
            let (b, _, _) = render(&mut anew, &scene, &settings(0));
            flux_apart = flux_apart.max((flux(kept.vpls()) / flux(anew.vpls()) - 1.0).abs());
            light_apart = light_apart.max((mean(&a) / mean(&b) - 1.0).abs());
            if k == 0 {
                assert_eq!(flux(kept.vpls()), flux(anew.vpls()));
            } else {
                assert_ne!(kept.vpls(), anew.vpls());
            }
        }
        println!("{what}: flux {flux_apart:.4} apart at most, indirect light {light_apart:.4}");
        // What is reflected first adds up but for rounding; the second reflections' surfaces are others. Few paths of the
        // directional light go on to another surface.
        assert!(flux_apart < 0.02, "{what}: {flux_apart}");
        assert!(light_apart < if what == "directional" { 0.1 } else { 0.05 }, "{what}: {light_apart}");
    }
}

#[test]
fn the_first_reflections_add_up_exactly() {
    for (what, mut scene) in moved_kinds() {
        let (mut kept, mut anew) = (cpu(), cpu());
        let one = |reuse| with(settings(reuse), |v| v.bounces = 1);
        for k in 0..20 {
            move_light(&mut scene, k);
            kept.render(&scene, &one(20)).unwrap();
            anew.render(&scene, &one(0)).unwrap();
            let ratio = flux(kept.vpls()) / flux(anew.vpls());
            assert!((ratio - 1.0).abs() < 1e-5, "{what}, frame {k}: {ratio}");
        }
    }
}

fn with(settings: RenderSettings, change: impl FnOnce(&mut VplOptions)) -> RenderSettings {
    let mut vpl = settings.vpl.unwrap();
    change(&mut vpl);
    RenderSettings { vpl: Some(vpl), ..settings }
}

/// A wall that drops in front of a light: at once nothing lies behind it that shines.
#[test]
fn what_a_light_no_longer_sees_gives_nothing() {
    let mut s = HandScene(room(LightKind::Point));
    s.0.lights[0].position_world = Vec3::new(-1.2, 0.3, 0.2);
    let wall = cuboid(Vec3::new(0.05, 1.6, 2.1), [Vec3::ONE; 6]);
    let id = s.add(wall, Material::lambert(Vec3::splat(0.7)), at(Vec3::new(-1.9, 0.0, 0.0)));
    let mut scene = s.0;
    let (mut renderer, settings) = (cpu(), settings(10));
    renderer.render(&scene, &settings).unwrap();
    let behind = |r: &Renderer| r.vpls().iter().filter(|v| v.position_world.x > 0.2).map(|v| flux(&[*v])).sum::<f64>();
    let (lit, all) = (behind(&renderer), flux(renderer.vpls()));
    assert!(lit > 0.2 * all, "much of the light lies behind the wall's place: {lit} of {all}");
    scene.begin_revision();
    scene.set_transform(id, at(Vec3::new(0.1, 0.0, 0.0)));
    renderer.render(&scene, &settings).unwrap();
    assert_eq!(behind(&renderer), 0.0, "behind the wall");
    let fresh = {
        let mut r = cpu();
        r.render(&scene, &with(settings, |v| v.reuse = 0)).unwrap();
        flux(r.vpls())
    };
    let ratio = flux(renderer.vpls()) / fresh;
    println!("after the wall fell: flux {ratio:.4} of the true one");
    assert!((ratio - 1.0).abs() < 0.25, "{ratio}");
    // And the picture behind it is dark.
    scene.camera = Camera::looking_at(Vec3::new(1.5, 0.3, 0.7), Vec3::new(0.5, -0.3, -0.5), 1.2);
    let traced = with(settings, |v| v.shadows = VplShadows::Traced);
    let dark = mean(&render(&mut renderer, &scene, &traced).0);
    scene.camera = Camera::looking_at(Vec3::new(-1.7, 0.3, 0.7), Vec3::new(-0.5, -0.3, -0.5), 1.2);
    let bright = mean(&render(&mut renderer, &scene, &traced).0);
    println!("behind the wall {dark}, before it {bright}");
    assert!(bright > 0.0 && dark < 1e-3 * bright);
}

/// Emissive surfaces among the sources: their paths are as they would be without reuse; those on a body go with it.
#[test]
fn all_sources_together() {
    let mut s = HandScene(room(LightKind::Point));
    let glow = Material { emissive: Vec3::new(2.0, 1.0, 0.5), ..Material::lambert(Vec3::splat(0.3)) };
    let lamp = s.add(cuboid(Vec3::splat(0.15), [Vec3::ONE; 6]), glow, at(Vec3::new(-0.5, 0.9, 0.6)));
    s.light(LightKind::Spot { cos_inner: 0.9, cos_outer: 0.6 }, Vec3::new(0.9, 1.3, -0.2), Vec3::splat(7.0));
    s.light(LightKind::Directional, Vec3::ZERO, Vec3::splat(0.3));
    let mut scene = s.0;
    let (mut kept, mut anew) = (cpu(), cpu());
    for k in 0..10 {
        scene.begin_revision();
        move_light(&mut scene, k);
        if k >= 5 {
            scene.set_transform(lamp, at(Vec3::new(-0.5 + 0.05 * k as f32, 0.9, 0.6)));
        }
        kept.render(&scene, &settings(30)).unwrap();
        anew.render(&scene, &settings(0)).unwrap();
        let ratio = flux(kept.vpls()) / flux(anew.vpls());
        assert!((ratio - 1.0).abs() < 0.03, "frame {k}: {ratio}");
        // Starts on the lamp are the same, wherever it is.
        let on_lamp = |r: &Renderer| {
            let center = scene.instances[lamp as usize].world_from_object.translation;
            let near = |v: &&Vpl| (v.position_world - center).abs().max_element() < 0.1501;
            places(&r.vpls().iter().filter(near).copied().collect::<Vec<_>>()).len()
        };
        assert!(on_lamp(&anew) > 0 && on_lamp(&kept) > 0, "frame {k}");
        let kind = |r: &Renderer| places(r.vpls());
        let shared = kind(&kept).intersection(&kind(&anew)).count();
        assert!(shared >= on_lamp(&anew), "frame {k}: emissive starts are not kept, they are the same");
    }
}

/// A VPL on a body goes with it.
#[test]
fn vpls_ride_on_bodies() {
    let mut scene = room(LightKind::Point);
    let mut renderer = cpu();
    let one = with(settings(20), |v| v.bounces = 1);
    renderer.render(&scene, &one).unwrap();
    let on_box = |r: &Renderer, m: Affine3| -> Vec<Vec3> {
        let own = |v: &Vpl| m.inverse().transform_point3(v.position_world);
        r.vpls().iter().map(own).filter(|p| p.abs().max_element() < 0.3001).collect()
    };
    let before = on_box(&renderer, scene.instances[1].world_from_object);
    assert!(before.len() >= 2, "{}", before.len());
    let all = places(renderer.vpls());
    scene.begin_revision();
    let moved = at(Vec3::new(-0.8 + 0.02, -1.1, -0.4 + 0.03));
    scene.set_transform(1, moved);
    renderer.render(&scene, &one).unwrap();
    let after = on_box(&renderer, moved);
    let same = before.iter().filter(|p| after.iter().any(|q| p.distance(*q) < 1e-5)).count();
    assert!(same * 2 > before.len(), "{same} of {} went with the box", before.len());
    // The others stay.
    let stayed = places(renderer.vpls()).intersection(&all).count();
    assert!(stayed + before.len() + 20 >= all.len(), "{stayed} of {} stayed", all.len());
}

#[test]
fn reuse_does_not_depend_on_threads_tiles_or_simd() {
    let pictures = |options: RendererOptions, tile: u32| -> Vec<u64> {
        let mut renderer = cpu_with(options);
        let mut app = app_at("rolling-box", 30);
        (0..6)
            .map(|_| {
                advance(&mut app, 1);
                let candidates = with(RenderSettings { tile, ..settings(20) }, |v| v.candidates = 2);
                renderer.render(&extracted(&app), &candidates).unwrap().image.hash()
            })
            .collect()
    };
    let first = pictures(RendererOptions { threads: 1, ..RendererOptions::default() }, 32);
    for (threads, tile, simd) in [(2, 8, SimdLevel::Auto), (3, 64, SimdLevel::Portable), (8, 32, SimdLevel::Auto)] {
        let options = RendererOptions { threads, simd, ..RendererOptions::default() };
        assert_eq!(pictures(options, tile), first, "{threads} threads, {simd:?}");
    }
    let mut different = first.clone();
    different.sort_unstable();
    different.dedup();
    assert_eq!(different.len(), first.len());
}

/// Where the GPU would make VPLs itself, those that are kept are the CPU's.
#[test]
fn both_lanes_keep_the_same_vpls() {
    let options = RendererOptions { raster: RasterLane::Gpu, tracer: Tracer::Gpu, ..RendererOptions::default() };
    let Some(mut gpu) = opened_or_skip("both_lanes_keep_the_same_vpls", Renderer::new(options)) else { return };
    let mut on_cpu = cpu();
    let off = |reuse| with(settings(reuse), |v| v.shadows = VplShadows::Off);
    let mut scene = room(LightKind::Point);
    for k in 0..5 {
        scene.begin_revision();
        move_light(&mut scene, k);
        let a = gpu.render(&scene, &off(20)).unwrap().stats;
        let b = on_cpu.render(&scene, &off(20)).unwrap().stats;
        assert_eq!(gpu.vpls(), on_cpu.vpls(), "frame {k}");
        assert_eq!((a.vpls_reused, a.rays.photon), (b.vpls_reused, b.rays.photon), "frame {k}");
        assert_eq!(a.vpls_reused > 0, k > 0);
        assert_eq!(a.tracer, Tracer::Gpu);
    }
}

/// The documented price: what came before shows.
#[test]
fn history_shows() {
    let mut scene = room(LightKind::Point);
    let mut renderer = cpu();
    for k in 0..5 {
        move_light(&mut scene, k);
        renderer.render(&scene, &settings(20)).unwrap();
    }
    let fresh = cpu().render(&scene, &settings(20)).unwrap();
    assert_ne!(renderer.render(&scene, &settings(20)).unwrap().image, fresh.image);
}
