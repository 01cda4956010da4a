//! Times of the upper tree's updates: moved instances against a full build, and the ECS's scan for changes that gives their
//! list. Plain medians, one thread.
//! `cargo bench -p catoptra_render_hybrid --bench accel`.

use catoptra_engine::app::new_app;
use catoptra_engine::bevy_ecs::prelude::*;
use catoptra_engine::bevy_transform::components::GlobalTransform;
use catoptra_engine::extract::extract;
use catoptra_engine::mesh::{Mesh, MeshData};
use catoptra_engine::render_scene::{Instance, RenderScene};
use catoptra_engine::{Assets, Extracted, Material, MeshInstance, StableId, shapes};
use catoptra_render_hybrid::accel::{Accel, AccelOptions};
use glam::{Affine3, Vec3};
use std::sync::Arc;
use std::time::Instant;

fn random(state: &mut u32) -> f32 {
    *state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    let w = ((*state >> ((*state >> 28) + 4)) ^ *state).wrapping_mul(277_803_737);
    (((w >> 22) ^ w) >> 8) as f32 / 16_777_216.0
}

fn median(mut v: Vec<f64>) -> f64 {
    v.sort_by(f64::total_cmp);
    v[v.len() / 2]
}

/// Microseconds of the extraction system where `moved` of `count` entities were written.
fn ecs_scan(count: u32, moved: u32) -> f64 {
    let mut app = new_app();
    let world = app.world_mut();
    let mut assets = world.resource_mut::<Assets>();
    let mesh = assets.add_mesh(shapes::sphere(0.1, 3, 4));
    let material = assets.add_material(Material::default());
    let place = |i: u32, shift: f32| GlobalTransform::from_xyz(i as f32, shift, 0.0);
    let entities: Vec<Entity> = (0..count)
        .map(|i| world.spawn((StableId(u64::from(i)), MeshInstance { mesh, material }, place(i, 0.0))).id())
        .collect();
    world.run_system_cached(extract).expect("its resources are there");
    let mut times = Vec::new();
    for round in 1..=21 {
        for k in 0..moved {
            let i = (u64::from(k) * u64::from(count) / u64::from(moved)) as u32;
            *world.get_mut::<GlobalTransform>(entities[i as usize]).expect("spawned with it") = place(i, round as f32);
        }
        let start = Instant::now();
        world.run_system_cached(extract).expect("its resources are there");
        times.push(start.elapsed().as_secs_f64() * 1e6);
        assert_eq!(world.resource::<Extracted>().0.moved.len(), moved as usize);
    }
    median(times)
}

fn main() {
    let corner = vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
    let data = MeshData {
        positions: corner,
        triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        ..Default::default()
    };
    let mesh = Arc::new(Mesh::new(data).expect("a tetrahedron"));
    println!("| instances | moved | update, µs | nodes touched | BLAS builds | full build, µs | ECS scan, µs |");
    println!("|---|---|---|---|---|---|---|");
    for count in [10_000u32, 100_000] {
        let mut seed = 1;
        let mut place = |side: f32| {
            let p = Vec3::new(random(&mut seed), random(&mut seed), random(&mut seed)) * side;
            Affine3::from_translation(p)
        };
        let side = 100.0;
        let instances = (0..count)
            .map(|i| Instance { stable_id: u64::from(i), mesh: 0, material: 0, world_from_object: place(side) })
            .collect();
        let mut scene = RenderScene { meshes: vec![mesh.clone()], instances, ..Default::default() };
        let build = median(
            (0..5)
                .map(|_| {
                    let mut accel = Accel::new(AccelOptions::default()).expect("the best level");
                    let start = Instant::now();
                    accel.update(&scene);
                    start.elapsed().as_secs_f64() * 1e6
                })
                .collect(),
        );
        for moved in [1u32, 100, 10_000] {
            let mut accel = Accel::new(AccelOptions::default()).expect("the best level");
            accel.update(&scene);
            let (mut times, mut touched, mut builds) = (Vec::new(), 0, 0);
            for round in 0..21u32 {
                scene.begin_revision();
                for k in 0..moved {
                    let id = (u64::from(k) * u64::from(count) / u64::from(moved)) as u32;
                    let mut m = scene.instances[id as usize].world_from_object;
                    m.translation += Vec3::splat(if round % 2 == 0 { 0.1 } else { -0.1 });
                    scene.instances[id as usize].world_from_object = m;
                    scene.moved.push(id);
                }
                let start = Instant::now();
                let stats = accel.update(&scene);
                times.push(start.elapsed().as_secs_f64() * 1e6);
                touched = stats.tlas_nodes_touched;
                builds += stats.blas_builds;
                assert!(!stats.tlas_rebuilt);
            }
            let (update, scan) = (median(times), ecs_scan(count, moved));
            println!("| {count} | {moved} | {update:.1} | {touched} | {builds} | {build:.0} | {scan:.0} |");
        }
    }
}
