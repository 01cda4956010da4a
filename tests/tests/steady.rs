//! A frame like the one before it costs no memory, and what did not change is not made again; neither shows in the picture.
#![allow(unsafe_code)]

use catoptra_demos::scenes::{SceneOptions, build};
use catoptra_engine::{Extracted, Material, RenderScene, app::advance, math};
use catoptra_render_hybrid::{Frame, RenderSettings, RendererOptions, VplOptions, VplShadows};
use catoptra_tests::fixtures::{cpu, cpu_with, fresh, scene_at, small};
use glam::{Affine3, Quat, Vec3};
use std::{
    alloc::{GlobalAlloc, Layout, System},
    sync::{
        Mutex, MutexGuard, PoisonError,
        atomic::{AtomicI64, AtomicU64, Ordering::Relaxed},
    },
};

/// Counts what the whole process asks for.
struct Counting;

static CALLS: AtomicU64 = AtomicU64::new(0);
static LIVE: AtomicI64 = AtomicI64::new(0);

// SAFETY: every call is handed on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        CALLS.fetch_add(1, Relaxed);
        LIVE.fetch_add(layout.size() as i64, Relaxed);
        // SAFETY: by the caller's contract.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, p: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size() as i64, Relaxed);
        // SAFETY: by the caller's contract.
        unsafe { System.dealloc(p, layout) }
    }
    unsafe fn realloc(&self, p: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        CALLS.fetch_add(1, Relaxed);
        LIVE.fetch_add(size as i64 - layout.size() as i64, Relaxed);
        // SAFETY: by the caller's contract.
        unsafe { System.realloc(p, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// One test at a time, so that each counts its own.
fn alone() -> MutexGuard<'static, ()> {
    static ONE: Mutex<()> = Mutex::new(());
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The next moment of a scene: two bodies, the light and the camera move.
fn step(scene: &mut RenderScene, k: u32) {
    scene.begin_revision();
    let angle = 0.02 * (k % 7) as f32;
    let (s, c) = math::sin_cos(angle);
    let turn = Affine3::from_quat(Quat::from_xyzw(0.0, s, 0.0, c));
    for id in [0, scene.instances.len() as u32 - 1] {
        let m = scene.instances[id as usize].world_from_object;
        scene.set_transform(id, Affine3 { translation: m.translation, ..(turn * m) });
    }
    scene.lights[0].position_world.x += 0.01 * s;
    scene.camera.world_from_view.translation.y += 0.01 * s;
}

/// Requests of memory in each of 200 frames in which bodies, light and camera move.
fn calls_per_frame(name: &str, threads: usize) -> Vec<u64> {
    let mut scene = scene_at(name, 30);
    let settings = small(128, 96, 64);
    let mut renderer = cpu_with(RendererOptions { threads, ..RendererOptions::default() });
    let mut frame = Frame::default();
    let counts: Vec<u64> = renderer.run(|renderer| {
        let mut counts = Vec::with_capacity(256);
        for k in 0..200 {
            step(&mut scene, k);
            let before = CALLS.load(Relaxed);
            renderer.render_into(&scene, &settings, &mut frame).unwrap();
            counts.push(CALLS.load(Relaxed) - before);
        }
        counts
    });
    println!("{name}, {threads} threads: {counts:?}");
    assert!(counts[0] > 0, "{name}: the counter counts");
    assert!(frame.image.pixels.iter().any(|p| p[0] > 0.0));
    assert_eq!(frame.image.hash(), fresh(&scene, &settings).image.hash(), "{name}: a fresh renderer's picture");
    counts
}

#[test]
fn a_steady_frame_allocates_nothing() {
    let _alone = alone();
    for name in ["rolling-box-donut", "two-spheres", "rolling-box-sponza"] {
        assert_eq!(calls_per_frame(name, 1)[100..].iter().sum::<u64>(), 0, "{name}, one thread");
        // Of two threads, chance says which makes which tile, and so when each one's scratch has grown to what it needs:
        // single frames may still ask, most do not.
        let asking = calls_per_frame(name, 2)[100..].iter().filter(|&&n| n > 0).count();
        assert!(asking <= 5, "{name}, two threads: {asking} of 100 frames asked for memory");
    }
}

/// Live bytes of the process after 3,000 and after 10,000 frames of rolling-box, all but what it held before.
fn live_over_frames(threads: usize) -> [i64; 2] {
    let before = LIVE.load(Relaxed);
    let mut app = build("rolling-box", &SceneOptions::default()).unwrap();
    let mut renderer = cpu_with(RendererOptions { threads, ..RendererOptions::default() });
    // The preset's 256 maps would take minutes; 16 small ones are made in every frame.
    let vpl = Some(VplOptions { count: 16, map_size: 16, mirrored: 8, ..VplOptions::default() });
    let settings = RenderSettings { vpl, ..small(24, 24, 32) };
    let mut frame = Frame::default();
    let mut after = [0; 2];
    for k in 1..=10_000 {
        advance(&mut app, 1);
        let scene = &app.world().resource::<Extracted>().0;
        renderer.render_into(scene, &settings, &mut frame).unwrap();
        match k {
            3_000 => after[0] = LIVE.load(Relaxed) - before,
            10_000 => after[1] = LIVE.load(Relaxed) - before,
            _ => {}
        }
    }
    println!("{threads} threads: live bytes after 3,000 frames: {}, after 10,000: {}", after[0], after[1]);
    after
}

#[test]
fn memory_is_flat_over_ten_thousand_frames() {
    let _alone = alone();
    let [early, late] = live_over_frames(1);
    assert!(early > 0 && late as f64 <= early as f64 * 1.01, "one thread: {early} {late}");
    // Of two threads, chance says which makes a tile, and so when each one's scratch has what a tile needs; a scratch
    // each, and nothing that one thread would not hold, bounds it whenever that is.
    let [_, two] = live_over_frames(2);
    assert!(two < 2 * late, "two threads: {two}, one: {late}");
}

#[test]
fn what_did_not_change_is_not_made_again() {
    let _alone = alone();
    let vpl = Some(VplOptions { count: 32, shadows: VplShadows::Maps, map_size: 16, ..VplOptions::default() });
    let settings = catoptra_render_hybrid::RenderSettings { vpl, ..small(64, 48, 64) };
    let mut scene = scene_at("rolling-box-donut", 30);
    let mut renderer = cpu();
    let mut check = |what: &str, scene: &RenderScene, moments: bool, photons: bool| {
        let frame = renderer.render(scene, &settings).unwrap();
        assert_eq!(frame.image.hash(), fresh(scene, &settings).image.hash(), "{what}: a fresh renderer's picture");
        let rays = frame.stats.rays;
        assert_eq!((rays.moments > 0, rays.photon > 0), (moments, photons), "{what}: {rays:?}");
        assert_eq!(rays.vpl_maps > 0, photons, "{what}");
    };
    check("the first frame", &scene, true, true);
    check("the same again", &scene, false, false);
    scene.begin_revision();
    scene.camera.world_from_view.translation.x += 0.1;
    check("another camera", &scene, false, false);
    scene.begin_revision();
    scene.lights[0].position_world.x += 0.05;
    check("a moved light", &scene, true, true);
    scene.begin_revision();
    let last = scene.instances.len() as u32 - 1;
    let moved = Affine3::from_translation(Vec3::new(0.02, 0.0, 0.0)) * scene.instances[last as usize].world_from_object;
    scene.set_transform(last, moved);
    check("a moved body", &scene, true, true);
    scene.begin_revision();
    scene.structure_revision = scene.revision;
    scene.materials[0] = Material::lambert(Vec3::new(0.1, 0.9, 0.2));
    check("another colour", &scene, false, true);
    check("and the same again", &scene, false, false);
}
