//! Large worlds. Not run by default: `cargo test -p catoptra_tests --test embed_scale -- --ignored --nocapture` prints time and
//! memory.

use catoptra_engine::{
    Camera, Instance, LightKind, Material, Mesh, RenderScene,
    glam::{Affine3, Mat3, Vec3},
    gltf::{ImportLimits, load_gltf},
    shapes,
};
use catoptra_render_hybrid::{BlasKind, RasterLane, RenderSettings, Renderer, RendererOptions, SimdLevel};
use catoptra_tests::{HandScene, at, fixtures, shared_or_skip};
use std::{sync::Arc, time::Instant};

/// Resident memory now and at most so far, MiB; 0 where the system does not tell.
fn memory() -> (u64, u64) {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let field = |name: &str| {
        let line = status.lines().find(|l| l.starts_with(name))?;
        line.split_whitespace().nth(1)?.parse::<u64>().ok()
    };
    (field("VmRSS:").unwrap_or(0) / 1024, field("VmHWM:").unwrap_or(0) / 1024)
}

/// Two pictures of the scene, the second with nothing new; prints what they took.
fn report(what: &str, scene: &RenderScene, settings: &RenderSettings) {
    let mut renderer = fixtures::cpu();
    let start = Instant::now();
    let first = renderer.render(scene, settings).unwrap();
    let first_ms = start.elapsed().as_secs_f64() * 1e3;
    let start = Instant::now();
    let second = renderer.render(scene, settings).unwrap();
    let second_ms = start.elapsed().as_secs_f64() * 1e3;
    assert_eq!(first.image.hash(), second.image.hash());
    assert!(first.image.pixels.iter().any(|p| p[0] > 0.05), "there is something to see");
    let (now, most) = memory();
    println!(
        "{what}: {} triangles, first picture {first_ms:.0} ms (accel {:.0}), next {second_ms:.0} ms, {} threads, {now} MiB, at most {most} MiB",
        scene.triangle_count(),
        first.stats.stages_ms.accel,
        renderer.threads(),
    );
}

fn lit(eye: Vec3) -> HandScene {
    let mut s = HandScene::new(Camera::looking_at(eye, Vec3::ZERO, 0.8)).background(Vec3::splat(0.2));
    s.light(LightKind::Directional, Vec3::ZERO, Vec3::splat(3.0)).direction_world =
        Vec3::new(-0.3, -0.8, -0.5).normalize();
    s
}

#[test]
fn the_picture_of_a_crowd_does_not_depend_on_how_it_is_found() {
    // Balls of more triangles than pixels, 600 of them; from a kd-tree every triangle is looked at, from boxes only those
    // that a pixel sees.
    let mut s = lit(Vec3::new(9.0, 7.0, 9.0));
    s.0.meshes.push(Arc::new(shapes::sphere(0.4, 30, 60)));
    s.0.materials.push(Material::mirror(Vec3::splat(0.9), 0.3));
    for i in 0..600_u32 {
        let place = Vec3::new((i % 25) as f32 - 12.0, 0.0, (i / 25) as f32 - 12.0);
        let matrix3 = Mat3::from_rotation_y(i as f32) * (0.3 + 0.02 * (i % 50) as f32);
        let world_from_object = Affine3 { matrix3, translation: place };
        s.0.instances.push(Instance { stable_id: u64::from(i), mesh: 0, material: 0, world_from_object });
    }
    let mut hashes = Vec::new();
    for blas in [BlasKind::Bvh, BlasKind::KdTree] {
        for simd in [SimdLevel::Portable, SimdLevel::Auto] {
            let options = RendererOptions { blas, simd, raster: RasterLane::Cpu, ..Default::default() };
            let frame = Renderer::new(options).unwrap().render(&s.0, &fixtures::small(96, 80, 128)).unwrap();
            assert!(frame.image.pixels.iter().any(|p| p[0] > 0.05), "there is something to see");
            hashes.push(frame.image.hash());
        }
    }
    assert!(hashes.iter().all(|h| *h == hashes[0]), "{hashes:?}");
}

#[test]
#[ignore = "a minute and much memory"]
fn a_million_triangles_in_one_mesh() {
    let mut s = lit(Vec3::new(0.0, 1.0, 3.5));
    let start = Instant::now();
    let ball = shapes::sphere(1.0, 501, 1000);
    println!("made and checked in {:.0} ms", start.elapsed().as_secs_f64() * 1e3);
    assert_eq!(ball.triangles().len(), 1_000_000);
    s.add(ball, Material::mirror(Vec3::new(1.0, 0.9, 0.7), 0.5), at(Vec3::ZERO));
    report("a million triangles", &s.0, &fixtures::small(256, 256, 256));
}

#[test]
#[ignore = "a minute and much memory"]
fn ten_thousand_statues() {
    let Some(folder) = shared_or_skip("ten_thousand_statues", "assets/venus") else { return };
    let file = folder.join("venus_31402.glb");
    let limits = ImportLimits::default();
    let statue: Mesh = load_gltf(&file, &limits).unwrap().merged_mesh(&limits).unwrap();
    let size = statue.bounds_object().radius();
    let middle = statue.bounds_object().center();
    let mut s = lit(Vec3::new(60.0, 45.0, 60.0));
    s.0.meshes.push(Arc::new(statue));
    s.0.materials.push(Material::mirror(Vec3::splat(0.9), 0.3));
    for i in 0..10_000_u32 {
        let place = Vec3::new((i % 100) as f32 - 50.0, 0.0, (i / 100) as f32 - 50.0);
        let matrix3 = Mat3::from_rotation_y(i as f32) * (0.45 / size);
        let world_from_object = Affine3 { matrix3, translation: place - matrix3 * middle };
        s.0.instances.push(Instance { stable_id: u64::from(i), mesh: 0, material: 0, world_from_object });
    }
    report("ten thousand statues", &s.0, &fixtures::small(256, 256, 256));
}
