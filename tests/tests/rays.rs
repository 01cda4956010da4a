//! A million rays through the atrium: one hash of all hits, whatever traces them.

use catoptra_engine::RenderScene;
use catoptra_render_hybrid::{
    BlasKind, SimdLevel,
    accel::{Accel, AccelOptions, Hit, Ray},
};
use catoptra_tests::fixtures::scene_at;
use glam::Vec3;
use rayon::prelude::*;

const RAYS: usize = 1_000_000;

/// A number from 0 to 1 that depends on `i` alone.
fn noise(i: u32) -> f32 {
    let x = i.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    let x = ((x >> ((x >> 28) + 4)) ^ x).wrapping_mul(277_803_737);
    ((x >> 22 ^ x) >> 8) as f32 / 16_777_216.0
}

/// Camera rays in blocks of 4 x 4 pixels, their mirror rays, rays into all directions from the same places, and lines between
/// them.
fn rays(scene: &RenderScene, accel: &Accel) -> Vec<Ray> {
    const SIDE: u32 = 512;
    let mut rays = Vec::with_capacity(RAYS);
    for block in 0..SIDE * SIDE / 16 {
        let (x, y) = (block % (SIDE / 4) * 4, block / (SIDE / 4) * 4);
        for i in 0..16 {
            let (origin, direction) = scene.camera.ray((x + i % 4) as f32 + 0.5, (y + i / 4) as f32 + 0.5, SIDE, SIDE);
            rays.push(Ray::new(origin, direction));
        }
    }
    let mut hits = vec![Hit::MISS; rays.len()];
    accel.closest_hits(&rays, &mut hits);
    let met: Vec<(Vec3, Vec3, Vec3)> = rays
        .iter()
        .zip(&hits)
        .filter(|(_, h)| h.is_hit())
        .map(|(ray, h)| {
            let instance = &scene.instances[h.instance_id as usize];
            let [a, b, c] = scene.meshes[instance.mesh as usize]
                .corners(h.primitive_id)
                .map(|p| instance.world_from_object.transform_point3(p));
            let n = (b - a).cross(c - a).normalize_or(Vec3::Y);
            (ray.at(h.t), if n.dot(ray.direction) > 0.0 { -n } else { n }, ray.direction)
        })
        .collect();
    assert!(met.len() > 200_000, "the camera looks into the atrium: {}", met.len());
    rays.extend(met.iter().map(|(p, n, d)| Ray::new(*p + *n * 1e-3, *d - *n * (2.0 * n.dot(*d)))));
    rays.extend(met.iter().enumerate().map(|(i, (p, n, _))| {
        let [x, y, z] = [0, 1, 2].map(|k| noise(3 * i as u32 + k) * 2.0 - 1.0);
        let d = Vec3::new(x, y, z);
        Ray::new(*p + *n * 1e-3, if n.dot(d) < 0.0 { -d } else { d })
    }));
    let mut i = 0;
    while rays.len() < RAYS {
        let [from, to] = [i, i + 1].map(|k| met[(noise(0x8000_0000 + k) * met.len() as f32) as usize % met.len()].0);
        rays.push(Ray { t_max: 1.0, ..Ray::new(from, to - from) });
        i += 2;
    }
    rays.truncate(RAYS);
    rays
}

/// FNV-1a over all bits of all hits.
fn hash(hits: &[Hit]) -> u64 {
    hits.iter()
        .flat_map(|h| [h.t.to_bits(), h.u.to_bits(), h.v.to_bits(), h.instance_id, h.primitive_id])
        .fold(0xcbf2_9ce4_8422_2325, |hash, word| (hash ^ u64::from(word)).wrapping_mul(0x0000_0100_0000_01b3))
}

fn trace(accel: &Accel, rays: &[Ray], together: bool, threads: usize) -> Vec<Hit> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let mut hits = vec![Hit::MISS; rays.len()];
    pool.install(|| {
        // A length that leaves single rays over.
        hits.par_chunks_mut(1000).zip(rays.par_chunks(1000)).for_each(|(hits, rays)| {
            if together {
                accel.closest_hits(rays, hits);
            } else {
                rays.iter().zip(hits).for_each(|(ray, hit)| *hit = accel.closest_hit(ray));
            }
        });
    });
    hits
}

#[test]
fn one_hash_of_a_million_hits() {
    let scene = scene_at("rolling-box-sponza", 30);
    let make = |options| {
        Accel::new(options).map(|mut accel| {
            accel.update(&scene);
            accel
        })
    };
    let portable = make(AccelOptions { simd: SimdLevel::Portable, ..Default::default() }).unwrap();
    let rays = rays(&scene, &portable);
    assert_eq!(rays.len(), RAYS);
    let hits = trace(&portable, &rays, false, 2);
    assert!(hits.iter().filter(|h| h.is_hit()).count() > RAYS / 2);
    let expected = hash(&hits);
    println!("hash of {RAYS} hits: {expected:016x}");
    for simd in [SimdLevel::Portable, SimdLevel::Avx2, SimdLevel::Avx512] {
        for blas in [BlasKind::Bvh, BlasKind::KdTree] {
            let accel = match make(AccelOptions { blas, simd, count: false }) {
                Ok(accel) => accel,
                Err(e) => {
                    println!("skipped: {e}");
                    continue;
                }
            };
            for (together, threads) in [(false, 1), (true, 1), (true, 3), (true, 8)] {
                let got = hash(&trace(&accel, &rays, together, threads));
                assert_eq!(got, expected, "{simd:?}, {blas:?}, packets {together}, {threads} threads");
            }
        }
    }
}

#[test]
fn tallies_cost_no_hit_and_add_up() {
    let scene = scene_at("rolling-box-sponza", 0);
    for blas in [BlasKind::Bvh, BlasKind::KdTree] {
        let [mut plain, mut counting] =
            [false, true].map(|count| Accel::new(AccelOptions { blas, count, ..Default::default() }).unwrap());
        plain.update(&scene);
        counting.update(&scene);
        let rays = rays(&scene, &plain);
        let (camera, mirror) = (&rays[..20_000], &rays[300_000..320_000]);
        let mut sums = Vec::new();
        for rays in [camera, mirror] {
            assert_eq!(trace(&plain, rays, true, 2), trace(&counting, rays, true, 2));
            let together = counting.counts();
            assert_eq!(trace(&plain, rays, false, 2), trace(&counting, rays, false, 2));
            let single = counting.counts();
            assert!(single.nodes >= rays.len() as u64 && single.boxes <= 8 * single.nodes, "{single:?}");
            assert!(single.triangles >= single.blocks && single.triangles <= 8 * single.blocks, "{single:?}");
            assert_eq!(counting.counts(), Default::default(), "taken once");
            sums.push((together.nodes, single.nodes));
        }
        if blas == BlasKind::Bvh {
            // Sixteen neighbours share their visits.
            assert!(4 * sums[0].0 < sums[0].1, "camera rays: {sums:?}");
        }
        assert_eq!(plain.counts(), Default::default(), "nobody asked");
    }
}
