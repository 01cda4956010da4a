//! Contract: which way an instance's triangles are looked at does not show.

use super::{
    ScanView,
    setup::{ScanList, Ways},
};
use crate::{
    accel::{Accel, AccelOptions},
    settings::SimdLevel,
    simd,
};
use catoptra_engine::{Camera, Instance, Material, Projection, RenderScene, shapes};
use glam::{Affine3, Quat, Vec3};

/// Bodies of 1,000 to 16,000 triangles: before, beside and behind the camera, through it, near, far, stretched and mirrored.
fn crowd() -> RenderScene {
    let mut scene = RenderScene {
        meshes: vec![
            shapes::sphere(1.0, 32, 48).into(),
            shapes::sphere(1.0, 90, 90).into(),
            shapes::torus(1.0, 0.3, 40, 40).into(),
        ],
        materials: vec![Material::default()],
        camera: Camera::looking_at(Vec3::new(0.3, 1.1, 6.0), Vec3::ZERO, 0.8),
        ..RenderScene::default()
    };
    let mut state = 7_u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32 * 2.0 - 1.0
    };
    for i in 0..120_u32 {
        let far = [2.0, 8.0, 60.0, 900.0][i as usize % 4];
        let translation = Vec3::new(next(), next(), next()) * far;
        let size = [0.05, 0.4, 3.0][i as usize / 4 % 3];
        let scale =
            Vec3::new(size, size * if i % 5 == 0 { -1.0 } else { 1.0 }, size * if i % 7 == 0 { 4.0 } else { 1.0 });
        let rotation = Quat::from_xyzw(next(), next(), next(), next() + 2.0).normalize();
        let world_from_object = Affine3::from_scale_rotation_translation(scale, rotation, translation);
        scene.instances.push(Instance { stable_id: i.into(), mesh: i % 3, material: 0, world_from_object });
    }
    scene
}

fn views(scene: &RenderScene) -> Vec<ScanView> {
    let mut camera = scene.camera;
    let mut views = vec![];
    for (width, height) in [(64, 48), (257, 129), (3, 500)] {
        camera.projection = Camera::default().projection;
        views.push(ScanView::of_camera(&camera, width, height));
        camera.projection = Projection::Orthographic { half_height: 5.0 };
        views.push(ScanView::of_camera(&camera, width, height));
    }
    views
}

#[test]
fn a_search_finds_what_a_look_at_each_triangle_keeps() {
    let scene = crowd();
    scene.validate().unwrap();
    let mut accel = Accel::new(AccelOptions::default()).unwrap();
    accel.update(&scene);
    let mut found = 0;
    for view in views(&scene) {
        let list = |ways, level| {
            let mut list = ScanList::with_ways(ways);
            list.build(level, &view, &scene, &accel);
            list.seen()
        };
        let each = list(Ways::NoneSearched, SimdLevel::Portable);
        found += each.len();
        for level in [SimdLevel::Portable, SimdLevel::Auto] {
            let level = simd::resolve(level).unwrap();
            assert!(each == list(Ways::AllSearched, level), "{view:?}: searched, {level:?}");
            assert!(each == list(Ways::Chosen, level), "{view:?}: chosen, {level:?}");
        }
    }
    assert!(found > 10_000, "{found} triangles were compared");
}

#[test]
fn far_bodies_are_searched_and_near_ones_are_not() {
    let scene = crowd();
    let view = ScanView::of_camera(&scene.camera, 1024, 1024);
    let at = |distance: f32| {
        let pose = Affine3::from_translation(scene.camera.world_from_view.transform_point3(Vec3::Z * -distance));
        super::crowd::is_crowd(&view, &scene.meshes[1], &view.rows_from_object(&pose))
    };
    assert!(!at(3.0), "a ball that fills the picture");
    assert!(at(300.0), "a ball of a few pixels");
    assert!(!at(0.5), "the camera is in it, and the picture has a million pixels");
}

#[test]
fn memory_is_kept() {
    let scene = crowd();
    let mut accel = Accel::new(AccelOptions::default()).unwrap();
    accel.update(&scene);
    let view = &views(&scene)[2];
    let mut list = ScanList::with_ways(Ways::AllSearched);
    let mut build = || {
        list.build(SimdLevel::Portable, view, &scene, &accel);
        (list.seen(), list.places())
    };
    let (first, again) = (build(), build());
    assert!(first == again && !first.0.is_empty());
}

/// `cargo test -p catoptra_tests -p catoptra_render_hybrid --lib which_way -- --ignored --nocapture`: what the rule of
/// [`super::crowd`] was chosen by.
#[test]
#[ignore = "prints times"]
fn which_way_is_faster() {
    let level = simd::resolve(SimdLevel::Auto).unwrap();
    for (rings, segments) in [(16, 17), (32, 48), (90, 90), (126, 126), (500, 1000)] {
        let mesh = shapes::sphere(1.0, rings, segments);
        let triangles = mesh.triangles().len();
        let scene = RenderScene {
            meshes: vec![mesh.into()],
            materials: vec![Material::default()],
            camera: Camera::looking_at(Vec3::Z * 3.0, Vec3::ZERO, 0.8),
            instances: vec![Instance { stable_id: 1, mesh: 0, material: 0, world_from_object: Affine3::IDENTITY }],
            ..RenderScene::default()
        };
        let mut accel = Accel::new(AccelOptions::default()).unwrap();
        accel.update(&scene);
        for size in [16, 32, 64, 128, 256, 512, 1024] {
            let view = ScanView::of_camera(&scene.camera, size, size);
            let time = |ways| {
                let mut list = ScanList::with_ways(ways);
                let times = (0..9).map(|_| {
                    let start = std::time::Instant::now();
                    list.build(level, &view, &scene, &accel);
                    start.elapsed().as_secs_f64() * 1e6
                });
                times.fold(f64::INFINITY, f64::min)
            };
            let (each, searched) = (time(Ways::NoneSearched), time(Ways::AllSearched));
            // The ball is 0.84 of the picture high.
            let per_pixel = triangles as f64 / (0.84 * 0.84 * f64::from(size) * f64::from(size));
            println!(
                "{triangles} triangles, {size}: {per_pixel:.3} a pixel, each {each:.0} us, searched {searched:.0} us"
            );
        }
    }
}
