//! The structure against brute force in double precision, with its own code.

use super::*;
use catoptra_engine::mesh::{Mesh, MeshData};
use catoptra_engine::render_scene::Instance;
use glam::{Affine3, DVec3, Mat3, Quat, Vec3};
use std::sync::Arc;

/// PCG random numbers.
struct Random(u32);
impl Random {
    fn bits(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let w = ((self.0 >> ((self.0 >> 28) + 4)) ^ self.0).wrapping_mul(277_803_737);
        (w >> 22) ^ w
    }
    fn unit(&mut self) -> f32 {
        (self.bits() >> 8) as f32 / 16_777_216.0
    }
    fn signed(&mut self) -> f32 {
        self.unit() * 2.0 - 1.0
    }
    fn vec(&mut self) -> Vec3 {
        Vec3::new(self.signed(), self.signed(), self.signed())
    }
    fn direction(&mut self) -> Vec3 {
        loop {
            let v = self.vec();
            if v.length() > 0.01 && v.length() < 1.0 {
                return v.normalize();
            }
        }
    }
    fn below(&mut self, n: u32) -> u32 {
        self.bits() % n
    }
}

fn mesh(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Arc<Mesh> {
    Arc::new(Mesh::new(MeshData { positions, triangles, ..Default::default() }).unwrap())
}

fn soup(r: &mut Random, n: usize, size: f32) -> Arc<Mesh> {
    let mut positions = Vec::new();
    for _ in 0..n {
        let c = r.vec();
        for _ in 0..3 {
            positions.push(c + r.vec() * size);
        }
    }
    mesh(positions, (0..n as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect())
}

/// Degenerate, duplicate, sliver, huge and tiny triangles together.
fn awkward(r: &mut Random) -> Arc<Mesh> {
    let mut p = Vec::new();
    let mut add = |t: [Vec3; 3]| p.extend(t);
    for _ in 0..20 {
        let (a, b, c) = (r.vec(), r.vec(), r.vec());
        add([a, b, c]);
        add([a, b, c]);
        add([a, a, b]);
        add([a, a, a]);
        add([a, b, a + (b - a) * 0.5]);
        add([a, b, a + (b - a) * 0.3 + r.vec() * 1e-6]);
        add([a * 100.0, b * 100.0, c * 100.0]);
        add([a, a + r.vec() * 1e-4, a + r.vec() * 1e-4]);
        add([a, b, Vec3::new(a.x, b.y, a.z)]);
    }
    for _ in 0..30 {
        add([Vec3::new(0.2, 0.0, 0.1), Vec3::new(0.4, 0.3, 0.1), Vec3::new(-0.1, 0.4, 0.1)]);
    }
    let n = p.len() as u32 / 3;
    mesh(p, (0..n).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect())
}

fn scene(meshes: Vec<Arc<Mesh>>, instances: Vec<(u32, Affine3)>) -> RenderScene {
    let instances = instances.into_iter().enumerate().map(|(i, (mesh, world_from_object))| Instance {
        stable_id: 10 * i as u64 + 5,
        mesh,
        material: 0,
        world_from_object,
    });
    RenderScene { meshes, instances: instances.collect(), ..Default::default() }
}

const LEVELS: [SimdLevel; 3] = [SimdLevel::Portable, SimdLevel::Avx2, SimdLevel::Avx512];
const KINDS: [BlasKind; 2] = [BlasKind::Bvh, BlasKind::KdTree];

/// One structure for each level and kind that this machine has; of each one whose scattered rays go side by side, and one whose go
/// alone.
fn structures(scene: &RenderScene) -> Vec<(String, Accel)> {
    let mut all = Vec::new();
    for simd in LEVELS {
        for blas in KINDS {
            for from in [0, usize::MAX] {
                match Accel::new(AccelOptions { blas, simd, count: false }) {
                    Ok(mut accel) => {
                        accel.world.side_by_side_from = from;
                        accel.update(scene);
                        accel.validate().unwrap();
                        all.push((format!("{simd:?} {blas:?} from {from}"), accel));
                    }
                    Err(e) => eprintln!("skipped: {e}"),
                }
            }
        }
    }
    all
}

/// What the oracle says of one triangle: distance, and how far inside the triangle the ray passes, in units of the vertices'
/// own rounding errors.
struct Truth {
    t: f64,
    inside: f64,
    /// Error of t that single precision may make.
    slack: f64,
    ids: (u32, u32),
}

/// All crossings of the line, in double precision: intersection with the plane, then distances to the three edges.
fn crossings(scene: &RenderScene, ray: &Ray) -> Vec<Truth> {
    let mut out = Vec::new();
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    for (id, instance) in scene.instances.iter().enumerate() {
        let m = instance.world_from_object;
        let (m3, tr) = (m.matrix3.as_dmat3(), m.translation.as_dvec3());
        if m3.determinant() == 0.0 {
            continue;
        }
        // Rounding of the ray into object space and of vertices there, in world space.
        let inverse = m3.inverse();
        let norm = |m: glam::DMat3| m.to_cols_array().iter().map(|x| x.abs()).sum::<f64>();
        let kappa = norm(m3) * norm(inverse);
        let mesh = &scene.meshes[instance.mesh as usize];
        for prim in 0..mesh.triangles().len() as u32 {
            let [a, b, c] = mesh.corners(prim).map(|p| m3 * p.as_dvec3() + tr);
            let n = (b - a).cross(c - a);
            let along = n.dot(d);
            if n.length() == 0.0 || along == 0.0 {
                continue;
            }
            let t = n.dot(a - o) / along;
            let p = o + d * t;
            let reach = [a, b, c].iter().map(|v| (*v - o).length()).fold(0.0, f64::max) + tr.length();
            let ulp = reach * kappa.max(9.0) * 1e-7;
            // Distance from each edge's line, in the plane across the ray, positive inside.
            let q = |v: DVec3| v - o - d * ((v - o).dot(d) / d.length_squared());
            let across = d.normalize() * along.signum();
            let edge = |a: DVec3, b: DVec3| {
                let e = q(b) - q(a);
                across.dot(e.cross(-q(a))) / e.length().max(1e-300)
            };
            let inside = edge(a, b).min(edge(b, c)).min(edge(c, a));
            // A plane seen from the side turns a small error across into a large one along.
            let slope = along.abs() / (n.length() * d.length());
            let slack = 4.0 * ulp / slope / d.length() + 4e-7 * t.abs();
            let _ = p;
            out.push(Truth { t, inside: inside / ulp, slack, ids: (id as u32, prim) });
        }
    }
    out
}

/// Checks a hit against the oracle: what is clearly hit must not be passed, what is clearly missed must not be hit.
fn check(scene: &RenderScene, ray: &Ray, hit: &Hit, name: &str) {
    let all = crossings(scene, ray);
    let certain =
        |c: &&Truth| c.inside > 1.0 && c.t - c.slack > f64::from(ray.t_min) && c.t + c.slack < f64::from(ray.t_max);
    let first = all.iter().filter(certain).min_by(|a, b| (a.t + a.slack).total_cmp(&(b.t + b.slack)));
    if let Some(first) = first {
        assert!(
            hit.is_hit() && f64::from(hit.t) <= first.t + 2.0 * first.slack,
            "{name}: {ray:?} passed {:?} at {} ± {}: {hit:?}",
            first.ids,
            first.t,
            first.slack
        );
    }
    if hit.is_hit() {
        let truth = all.iter().find(|c| c.ids == (hit.instance_id, hit.primitive_id));
        let truth = truth.unwrap_or_else(|| panic!("{name}: {ray:?} met a degenerate triangle: {hit:?}"));
        assert!(
            truth.inside > -1.0 && (f64::from(hit.t) - truth.t).abs() <= truth.slack,
            "{name}: {ray:?} met {hit:?}, truth: t {} ± {}, inside {}",
            truth.t,
            truth.slack,
            truth.inside
        );
        assert!(ray.t_min < hit.t && hit.t < ray.t_max);
    }
}

fn bits(h: &Hit) -> [u32; 5] {
    [h.t.to_bits(), h.u.to_bits(), h.v.to_bits(), h.instance_id, h.primitive_id]
}

/// The same triangle test over all triangles, one by one: trees must not change a bit.
fn without_trees(scene: &RenderScene, ray: &Ray) -> Hit {
    let mut best = Hit::MISS;
    for (id, instance) in scene.instances.iter().enumerate() {
        let Some((record, _)) = instance::InstanceRecord::new(instance, id as u32, 0, true) else { continue };
        let mesh = &scene.meshes[instance.mesh as usize];
        let (o, d) = record.object_ray(ray.origin.to_array(), ray.direction.to_array());
        let space = ray_space::RaySpace::new(o, d, node::Bounds::from(mesh.bounds_object()).extent(), 1.0);
        for prim in 0..mesh.triangles().len() as u32 {
            let corners = mesh.corners(prim).map(|p| p.to_array());
            if let Some((t, u, v)) = triangle::intersect(&space, corners)
                && ray.t_min < t
                && t < ray.t_max
                && t < best.t
            {
                best = Hit { t, u, v, instance_id: id as u32, primitive_id: prim };
            }
        }
    }
    best
}

/// All structures agree bit for bit, single, together and in occlusion, and with the oracle.
fn agree(scene: &RenderScene, rays: &[Ray], oracle: bool) {
    let all = structures(scene);
    let reference: Vec<Hit> = rays.iter().map(|r| all[0].1.closest_hit(r)).collect();
    for (name, accel) in &all {
        let mut hits = vec![Hit::MISS; rays.len()];
        accel.closest_hits(rays, &mut hits);
        let mut occluded = vec![false; rays.len()];
        accel.occluded_many(rays, &mut occluded);
        for (i, ray) in rays.iter().enumerate() {
            assert_eq!(bits(&accel.closest_hit(ray)), bits(&reference[i]), "{name}: ray {i} {ray:?}");
            assert_eq!(bits(&hits[i]), bits(&reference[i]), "{name}: ray {i} {ray:?} in a batch");
            assert_eq!(accel.occluded(ray), reference[i].is_hit(), "{name}: ray {i} {ray:?} occluded");
            assert_eq!(occluded[i], reference[i].is_hit(), "{name}: ray {i} {ray:?} occluded in a batch");
        }
    }
    for (ray, hit) in rays.iter().zip(&reference).step_by(5) {
        assert_eq!(bits(hit), bits(&without_trees(scene, ray)), "{ray:?} without trees");
    }
    if oracle {
        for (ray, hit) in rays.iter().zip(&reference) {
            check(scene, ray, hit, &all[0].0);
        }
    }
}

fn random_rays(r: &mut Random, n: usize, spread: f32) -> Vec<Ray> {
    (0..n)
        .map(|i| {
            let origin = r.vec() * spread;
            let mut ray = match i % 4 {
                0 => Ray::new(origin, r.direction() * (0.1 + r.unit() * 3.0)),
                1 => Ray::new(origin, (r.vec() * 0.5 - origin) * 0.7),
                // Along an axis, with true zeros.
                2 => {
                    let mut d = Vec3::ZERO;
                    d[r.below(3) as usize] = if r.unit() < 0.5 { -1.0 } else { 1.0 };
                    Ray::new(r.vec() * 0.7 - d * spread, d)
                }
                _ => Ray::new(origin, Vec3::new(r.signed(), 0.0, r.signed())),
            };
            if i % 5 == 0 {
                ray.t_min = r.unit();
                ray.t_max = ray.t_min + r.unit() * 2.0;
            }
            ray
        })
        .collect()
}

#[test]
fn soups_against_brute_force() {
    let mut r = Random(1);
    for (n, size) in [(1, 1.0), (2, 1.0), (8, 0.5), (9, 0.5), (70, 0.6), (400, 0.2), (400, 2.0)] {
        let s = scene(vec![soup(&mut r, n, size)], vec![(0, Affine3::IDENTITY)]);
        let rays = random_rays(&mut r, 1500, 2.0);
        agree(&s, &rays, true);
    }
    for _ in 0..3 {
        let s = scene(vec![awkward(&mut r)], vec![(0, Affine3::IDENTITY)]);
        let rays = random_rays(&mut r, 2000, 2.0);
        agree(&s, &rays, true);
    }
}

/// Batches whose neighbours are of one, a few or many kinds, in stretches of any length, with unusable rays in between.
#[test]
fn batches_of_few_kinds() {
    let mut r = Random(11);
    let meshes = vec![soup(&mut r, 300, 0.3), awkward(&mut r)];
    let mut many = vec![(0, Affine3::IDENTITY), (1, Affine3::IDENTITY)];
    for i in 0..20u32 {
        many.push((i % 2, pose(&mut r, Vec3::new(0.5, -0.3, 0.8))));
    }
    for instances in [vec![(0, Affine3::IDENTITY)], vec![(0, pose(&mut r, Vec3::splat(0.7)))], many] {
        let s = scene(meshes.clone(), instances);
        let mut rays = Vec::new();
        while rays.len() < 3000 {
            let ways: Vec<Vec3> = (0..1 + r.below(8)).map(|_| r.direction()).collect();
            for _ in 0..1 + r.below(90) {
                let way = ways[r.below(ways.len() as u32) as usize];
                let mut ray = Ray::new(r.vec() * 0.3 - way * 1.5, way + r.vec() * 0.05);
                match r.below(60) {
                    0 => ray.origin.x = f32::NAN,
                    1 => ray.direction = Vec3::ZERO,
                    2 => ray.direction *= 1e-12,
                    3 => (ray.t_min, ray.t_max) = (1.0, 1.5),
                    4 => (ray.t_min, ray.t_max) = (-2.0, -0.1),
                    _ => {}
                }
                rays.push(ray);
            }
        }
        agree(&s, &rays, false);
    }
}

fn pose(r: &mut Random, scale: Vec3) -> Affine3 {
    let turn = Mat3::from_quat(Quat::from_xyzw(r.signed(), r.signed(), r.signed(), r.signed()).normalize());
    Affine3::from_mat3_translation(turn * Mat3::from_diagonal(scale), r.vec())
}

#[test]
fn instances_against_brute_force() {
    let mut r = Random(2);
    let meshes = vec![soup(&mut r, 60, 0.4), soup(&mut r, 5, 0.8), awkward(&mut r)];
    for round in 0..4 {
        let mut instances = Vec::new();
        for i in 0..25u32 {
            let s = match i % 4 {
                0 => Vec3::splat(0.4),
                1 => Vec3::new(-0.3, 0.5, 0.4),
                2 => Vec3::new(0.9, 0.05, 0.3),
                _ => Vec3::new(-0.3, -0.2, -0.6),
            };
            instances.push((i % 3, pose(&mut r, s)));
        }
        // Twice the same: the smaller id wins.
        instances.push(instances[0]);
        // Flattened: never hit.
        instances.push((0, Affine3::from_scale(Vec3::new(1.0, 0.0, 1.0))));
        if round == 3 {
            instances.truncate(2);
        }
        let s = scene(meshes.clone(), instances);
        let rays = random_rays(&mut r, 1000, 2.5);
        agree(&s, &rays, true);
    }
}

#[test]
fn scales_from_tiny_to_huge() {
    let mut r = Random(3);
    let unit = soup(&mut r, 80, 0.5);
    for scale in [1e-9f32, 1e-6, 1e-3, 1e3, 1e6, 1e9] {
        let scaled = mesh(unit.positions().iter().map(|p| *p * scale).collect(), unit.triangles().to_vec());
        let mut rays = random_rays(&mut r, 600, 2.0);
        for ray in &mut rays {
            ray.origin *= scale;
            if ray.t_max.is_finite() {
                ray.t_min *= scale;
                ray.t_max *= scale;
            }
        }
        agree(&scene(vec![scaled.clone()], vec![(0, Affine3::IDENTITY)]), &rays, true);
        // The same by the transform.
        let m = Affine3::from_scale(Vec3::new(scale, -scale, scale));
        agree(&scene(vec![unit.clone(), scaled], vec![(0, m), (0, m)]), &rays, true);
        // And a unit world of scaled meshes.
        let m = Affine3::from_scale(Vec3::splat(1.0 / scale));
        let s = scene(
            vec![mesh(unit.positions().iter().map(|p| *p * scale).collect(), unit.triangles().to_vec())],
            vec![(0, m)],
        );
        agree(&s, &random_rays(&mut r, 600, 2.0), true);
    }
}

#[test]
fn directions_of_any_length() {
    let mut r = Random(4);
    let s = scene(vec![soup(&mut r, 100, 0.5)], vec![(0, Affine3::IDENTITY)]);
    for all in structures(&s) {
        for ray in random_rays(&mut r, 300, 2.0).iter_mut() {
            (ray.t_min, ray.t_max) = (0.0, f32::INFINITY);
            let base = all.1.closest_hit(ray);
            for exponent in [-140i64, -100, -60, -30, 30, 60, 100] {
                // 2 to the exponent.
                let f = f64::from_bits(((1023 + exponent) as u64) << 52);
                let long = Ray { direction: (ray.direction.as_dvec3() * f).as_vec3(), ..*ray };
                let hit = all.1.closest_hit(&long);
                let t = f64::from(base.t) / f;
                if base.is_hit() && t < 3e38 && exponent > -110 {
                    assert_eq!((hit.instance_id, hit.primitive_id), (base.instance_id, base.primitive_id));
                    assert!((f64::from(hit.t) / t - 1.0).abs() < 1e-6, "{} {t}", hit.t);
                } else if !base.is_hit() && exponent > -110 {
                    assert!(!hit.is_hit());
                }
            }
        }
    }
}

#[test]
fn unusable_rays_miss() {
    let mut r = Random(5);
    let s = scene(vec![soup(&mut r, 100, 3.0)], vec![(0, Affine3::IDENTITY)]);
    for (name, accel) in structures(&s) {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for axis in 0..3 {
                let mut ray = Ray::new(Vec3::ZERO, Vec3::new(0.3, 0.4, 0.5));
                ray.origin[axis] = bad;
                assert!(!accel.closest_hit(&ray).is_hit() && !accel.occluded(&ray), "{name}");
                let mut ray = Ray::new(Vec3::ZERO, Vec3::new(0.3, 0.4, 0.5));
                ray.direction[axis] = bad;
                assert!(!accel.closest_hit(&ray).is_hit() && !accel.occluded(&ray), "{name}");
            }
        }
        let ray = Ray::new(Vec3::ZERO, Vec3::ZERO);
        assert!(!accel.closest_hit(&ray).is_hit() && !accel.occluded(&ray), "{name}");
        let ray = Ray { t_min: 2.0, t_max: 1.0, ..Ray::new(Vec3::ZERO, Vec3::X) };
        assert!(!accel.closest_hit(&ray).is_hit() && !accel.occluded(&ray), "{name}");
        let ray = Ray { t_max: f32::NAN, ..Ray::new(Vec3::ZERO, Vec3::X) };
        assert!(!accel.closest_hit(&ray).is_hit() && !accel.occluded(&ray), "{name}");
    }
}

/// A closed lumpy sphere.
fn lump(r: &mut Random, rings: u32, sides: u32) -> Arc<Mesh> {
    let mut p = vec![Vec3::Y, Vec3::NEG_Y];
    let mut t = Vec::new();
    for i in 1..rings {
        for k in 0..sides {
            let (y, a) = (i as f32 / rings as f32 * 2.0 - 1.0, k as f32 / sides as f32 * std::f32::consts::TAU);
            let (s, c) = catoptra_engine::math::sin_cos(a);
            let q = (1.0 - y * y).sqrt();
            p.push(Vec3::new(q * c, -y, q * s) * (1.0 + 0.2 * r.unit()));
        }
    }
    let at = |i: u32, k: u32| 2 + (i - 1) * sides + k % sides;
    for k in 0..sides {
        t.push([0, at(1, k + 1), at(1, k)]);
        t.push([1, at(rings - 1, k), at(rings - 1, k + 1)]);
        for i in 1..rings - 1 {
            t.push([at(i, k), at(i, k + 1), at(i + 1, k)]);
            t.push([at(i, k + 1), at(i + 1, k + 1), at(i + 1, k)]);
        }
    }
    let m = mesh(p, t);
    assert!(m.closed());
    m
}

#[test]
fn closed_meshes_are_watertight() {
    let mut r = Random(6);
    let m = lump(&mut r, 40, 60);
    for (round, scale) in [1.0f32, 1.0, 1e-9, 1e9, 3e-5].into_iter().enumerate() {
        let mut place = pose(&mut r, Vec3::new(scale, scale * 0.37, -scale * 2.3));
        if round == 0 {
            place = Affine3::IDENTITY;
        }
        if round >= 2 {
            place.translation *= scale;
        }
        let s = scene(vec![m.clone()], vec![(0, place)]);
        let mut rays = Vec::new();
        for i in 0..60_000 {
            let t = m.triangles()[r.below(m.triangles().len() as u32) as usize];
            let (a, b) = (m.positions()[t[0] as usize], m.positions()[t[1] as usize]);
            let f = match i % 3 {
                0 => 0.0,
                1 => 0.5,
                _ => r.unit(),
            };
            let target = place.transform_point3(a + (b - a) * f);
            let origin = place.transform_point3(r.vec() * 0.2);
            let direction = target - origin;
            let direction = if i % 2 == 0 { direction.normalize() } else { direction };
            rays.push(Ray::new(origin, direction));
        }
        for (name, accel) in structures(&s) {
            let mut hits = vec![Hit::MISS; rays.len()];
            accel.closest_hits(&rays, &mut hits);
            for (ray, hit) in rays.iter().zip(&hits) {
                assert!(hit.is_hit(), "{name}: round {round} leaks at {ray:?}");
                assert!(accel.occluded(ray));
            }
        }
    }
}

#[test]
fn open_edges_are_not_fattened() {
    // The square [0, 1]² at z = 1; coordinates are exact, so the answer is too.
    let m = mesh(
        vec![Vec3::new(0.0, 0.0, 1.0), Vec3::new(1.0, 0.0, 1.0), Vec3::new(1.0, 1.0, 1.0), Vec3::new(0.0, 1.0, 1.0)],
        vec![[0, 1, 2], [0, 2, 3]],
    );
    for (name, accel) in structures(&scene(vec![m], vec![(0, Affine3::IDENTITY)])) {
        for (x, hit) in
            [(1.0f32, true), (1.0f32.next_up(), false), (1.0f32.next_down(), true), (0.0, true), (-1e-7, false)]
        {
            for ray in [
                Ray::new(Vec3::new(x, 0.3, 0.0), Vec3::Z),
                Ray::new(Vec3::new(0.3, x, 0.0), Vec3::Z),
                Ray::new(Vec3::new(x, 0.3, 5.0), Vec3::NEG_Z * 3.0),
            ] {
                assert_eq!(accel.closest_hit(&ray).is_hit(), hit, "{name} {ray:?}");
            }
        }
        // The corner and the diagonal.
        for p in [0.0f32, 0.25, 0.3, 1.0] {
            let hit = accel.closest_hit(&Ray::new(Vec3::new(p, p, 0.0), Vec3::Z));
            assert_eq!((hit.t, hit.primitive_id), (1.0, 0), "{name} {p}");
        }
    }
}

#[test]
fn hits_interpolate_to_the_point() {
    let mut r = Random(8);
    let place = pose(&mut r, Vec3::new(0.5, -0.8, 1.1));
    let m = soup(&mut r, 200, 0.5);
    let s = scene(vec![m.clone()], vec![(0, place)]);
    let (_, accel) = &structures(&s)[0];
    let mut hits = 0;
    for ray in random_rays(&mut r, 1000, 2.0) {
        let hit = accel.closest_hit(&ray);
        if hit.is_hit() {
            hits += 1;
            let [a, b, c] = m.corners(hit.primitive_id);
            let p = place.transform_point3(a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v);
            assert!((p - ray.at(hit.t)).length() < 1e-5, "{p} {}", ray.at(hit.t));
        }
    }
    assert!(hits > 300);
}

/// A structure that followed every edit equals one freshly built.
#[test]
fn edits_equal_a_fresh_structure() {
    let mut r = Random(9);
    let meshes = vec![soup(&mut r, 60, 0.4), lump(&mut r, 6, 9)];
    let instances = (0..300).map(|i| (i % 2, pose(&mut r, Vec3::splat(0.08)))).collect();
    let mut s = scene(meshes, instances);
    for i in &mut s.instances {
        i.world_from_object.translation *= 4.0;
    }
    let mut accel = Accel::new(AccelOptions::default()).unwrap();
    let first = accel.update(&s);
    assert!(first.tlas_rebuilt && first.blas_builds == 2);
    assert_eq!(accel.update(&s), UpdateStats::default());
    let mut rebuilt = 0;
    let mut next_id = 1_000_000;
    for step in 0..120 {
        s.begin_revision();
        match step % 6 {
            0 | 1 | 3 => {
                for _ in 0..1 + r.below(20) {
                    let id = r.below(s.instances.len() as u32);
                    let mut place = pose(&mut r, Vec3::splat(0.08));
                    place.translation *= 4.0;
                    if r.below(30) == 0 {
                        place = Affine3::from_scale(Vec3::new(0.0, 1.0, 1.0));
                    }
                    s.set_transform(id, place);
                }
            }
            2 => {
                s.structure_revision = s.revision;
                s.instances.remove(r.below(s.instances.len() as u32) as usize);
            }
            4 => {
                s.structure_revision = s.revision;
                let at = r.below(s.instances.len() as u32) as usize;
                let stable_id = s.instances[at].stable_id + 1;
                if s.instances.get(at + 1).is_none_or(|n| n.stable_id != stable_id) {
                    let place = pose(&mut r, Vec3::splat(0.1));
                    s.instances.insert(at + 1, Instance { stable_id, world_from_object: place, ..s.instances[at] });
                }
                next_id += 1;
                let place = pose(&mut r, Vec3::splat(0.1));
                s.instances.push(Instance { stable_id: next_id, mesh: 1, material: 0, world_from_object: place });
            }
            _ => {
                s.structure_revision = s.revision;
                if step == 65 {
                    // Another mesh takes the place of the first.
                    s.meshes[0] = soup(&mut r, 30, 0.6);
                }
            }
        }
        let stats = accel.update(&s);
        rebuilt += u32::from(stats.tlas_rebuilt);
        assert_eq!(stats.blas_builds, u32::from(step == 65), "step {step}");
        accel.validate().unwrap();
        let mut fresh = Accel::new(AccelOptions::default()).unwrap();
        fresh.update(&s);
        for ray in random_rays(&mut r, 200, 5.0) {
            assert_eq!(bits(&accel.closest_hit(&ray)), bits(&fresh.closest_hit(&ray)), "step {step} {ray:?}");
        }
    }
    assert!(rebuilt < 60, "{rebuilt} of 120 updates were rebuilds");
    // Emptied, and filled again.
    let kept = std::mem::take(&mut s.instances);
    s.begin_revision();
    s.structure_revision = s.revision;
    accel.update(&s);
    accel.validate().unwrap();
    assert!(!accel.closest_hit(&Ray::new(Vec3::new(-9.0, 0.0, 0.0), Vec3::X)).is_hit());
    s.instances = kept;
    s.begin_revision();
    s.structure_revision = s.revision;
    accel.update(&s);
    accel.validate().unwrap();
}

#[test]
fn refitted_meshes_equal_fresh_ones() {
    let mut r = Random(13);
    let old = soup(&mut r, 300, 0.3);
    let moved = old.positions().iter().map(|p| *p * 1.3 + Vec3::new(0.1, -0.2, p.x * p.y)).collect();
    let new = mesh(moved, old.triangles().to_vec());
    let places = vec![(0, pose(&mut r, Vec3::splat(0.5))), (0, pose(&mut r, Vec3::splat(0.7)))];
    let mut accel = Accel::new(AccelOptions::default()).unwrap();
    let mut s = scene(vec![old.clone()], places);
    accel.update(&s);
    assert!(accel.refit_mesh(&old, &new));
    accel.validate().unwrap();
    s.meshes[0] = new.clone();
    let mut fresh = Accel::new(AccelOptions::default()).unwrap();
    fresh.update(&s);
    let rays = random_rays(&mut r, 2000, 2.0);
    for ray in &rays {
        assert_eq!(bits(&accel.closest_hit(ray)), bits(&fresh.closest_hit(ray)));
    }
    s.begin_revision();
    s.structure_revision = s.revision;
    assert_eq!(accel.update(&s).blas_builds, 0);
    assert!(!accel.refit_mesh(&old, &new), "the old mesh is gone");
    let other = soup(&mut r, 299, 0.3);
    assert!(!accel.refit_mesh(&new, &other), "other triangles");
}

/// One hash over builds on 1 to 8 threads, every level, kind, single and together.
#[test]
fn one_hash_of_hits() {
    let mut r = Random(14);
    let meshes = vec![soup(&mut r, 5000, 0.1), lump(&mut r, 30, 40)];
    let places =
        vec![(0, Affine3::IDENTITY), (1, pose(&mut r, Vec3::new(0.3, 0.4, -0.2))), (1, pose(&mut r, Vec3::splat(0.2)))];
    let s = scene(meshes, places);
    // Half of them as a camera sends them, in tiles; half at random.
    let mut rays = random_rays(&mut r, 20_000, 2.0);
    for i in 0..20_000u32 {
        let (tile, at) = (i / 16, i % 16);
        let (x, y) = (tile % 35 * 4 + at % 4, tile / 35 * 4 + at / 4);
        rays.push(Ray::new(Vec3::new(0.0, 0.1, 3.0), Vec3::new(x as f32 / 70.0 - 1.0, y as f32 / 70.0 - 1.0, -2.0)));
    }
    let mut hashes = std::collections::BTreeMap::new();
    for threads in [1, 2, 3, 8] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        for (name, accel) in pool.install(|| structures(&s)) {
            let mut hits = vec![Hit::MISS; rays.len()];
            accel.closest_hits(&rays, &mut hits);
            let bytes = |hits: &[Hit]| hits.iter().flat_map(bits).flat_map(u32::to_le_bytes).collect::<Vec<u8>>();
            let together = xxhash_rust::xxh3::xxh3_64(&bytes(&hits));
            let single: Vec<Hit> = rays.iter().map(|r| accel.closest_hit(r)).collect();
            assert_eq!(together, xxhash_rust::xxh3::xxh3_64(&bytes(&single)), "{name}");
            hashes.entry(together).or_insert(Vec::new()).push(format!("{name} {threads}"));
        }
    }
    assert_eq!(hashes.len(), 1, "{hashes:?}");
}

/// Every bit of the trees, not only the hits.
#[test]
fn trees_do_not_depend_on_threads() {
    let mut r = Random(15);
    for mesh in [soup(&mut r, 20_000, 0.05), soup(&mut r, 3000, 1.0), lump(&mut r, 90, 100)] {
        let trees = [1, 2, 3, 8].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let tree = pool.install(|| blas::Blas::build(&mesh, BlasKind::Bvh));
            let nodes: Vec<_> = tree.nodes.iter().map(|n| (n.planes.map(|p| p.map(f32::to_bits)), n.child)).collect();
            (nodes, tree.blocks.iter().map(|b| b.prim).collect::<Vec<_>>())
        });
        assert!(trees[0].0.len() > 50);
        assert!(trees.iter().all(|t| *t == trees[0]));
    }
}

/// Boxes in boxes, boxes of one middle, boxes in a row whose distances double: what makes splits lopsided.
#[test]
fn lopsided_meshes_have_trees() {
    let quads = |places: &mut dyn Iterator<Item = (Vec3, f32)>| {
        let mut p = Vec::new();
        for (at, size) in places {
            p.extend([Vec3::new(-1.0, -1.0, 0.1), Vec3::new(1.0, -1.0, -0.1), Vec3::Y].map(|v| at + v * size));
        }
        let n = p.len() as u32 / 3;
        mesh(p, (0..n).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect())
    };
    let two_to = |i: i32| f32::from_bits(((127 + i) as u32) << 23);
    let meshes = [
        quads(&mut (0..4000).map(|i| (Vec3::ZERO, 1.0 + i as f32))),
        quads(&mut (0..4000).map(|i| (Vec3::splat(i as f32 * 1e-3), 1.0 + i as f32))),
        quads(&mut (0..4000).map(|_| (Vec3::ONE, 1.0))),
        quads(&mut (0..40).map(|i| (Vec3::X * two_to(i), 1e-3))),
        quads(&mut (0..120).map(|i| (Vec3::X * two_to(i - 80), two_to(i - 80)))),
    ];
    for m in meshes {
        let s = scene(vec![m.clone()], vec![(0, Affine3::IDENTITY)]);
        let ray = Ray::new(Vec3::new(0.3, 0.2, 50.0), Vec3::NEG_Z);
        agree(&s, &[ray, Ray::new(Vec3::new(-5.0, 0.0, 0.01), Vec3::X)], false);
    }
}

#[test]
fn a_move_touches_its_ancestors_only() {
    let mut r = Random(10);
    let m = lump(&mut r, 5, 8);
    let mut s = scene(vec![m], (0..4096).map(|_| (0, pose(&mut r, Vec3::splat(0.01)))).collect());
    let mut accel = Accel::new(AccelOptions::default()).unwrap();
    accel.update(&s);
    s.begin_revision();
    let mut place = s.instances[77].world_from_object;
    place.translation += Vec3::splat(0.01);
    s.set_transform(77, place);
    let stats = accel.update(&s);
    assert!(!stats.tlas_rebuilt && stats.blas_builds == 0);
    assert!((1..=12).contains(&stats.tlas_nodes_touched), "{stats:?}");
}

#[test]
fn a_scattered_world_is_built_anew() {
    let mut r = Random(11);
    let m = lump(&mut r, 5, 8);
    let mut s = scene(vec![m], (0..500).map(|_| (0, pose(&mut r, Vec3::splat(0.01)))).collect());
    let mut accel = Accel::new(AccelOptions::default()).unwrap();
    accel.update(&s);
    s.begin_revision();
    for i in 0..500 {
        let place = pose(&mut r, Vec3::splat(0.01));
        s.set_transform(i, place);
    }
    let stats = accel.update(&s);
    assert!(stats.tlas_rebuilt, "{stats:?}");
    accel.validate().unwrap();
}

#[test]
fn shadow_casters_are_chosen_by_instance() {
    let mut r = Random(12);
    let m = lump(&mut r, 8, 8);
    let at = |x: f32| Affine3::from_translation(Vec3::new(x, 0.0, 0.0));
    for (n, places) in [vec![(0, at(0.0)), (0, at(5.0))], vec![(0, at(0.0))]].into_iter().enumerate() {
        for (_, mut accel) in structures(&scene(vec![m.clone()], places)) {
            let ray = Ray { t_max: 8.0, ..Ray::new(Vec3::new(-4.0, 0.1, 0.1), Vec3::X) };
            let far = Ray { t_max: 20.0, ..ray };
            accel.set_shadow_casters(|id| id != 0);
            let mut answers = [false; 2];
            accel.occluded_many(&[ray, far], &mut answers);
            assert_eq!(answers, [accel.occluded(&ray), accel.occluded(&far)]);
            assert!(accel.closest_hit(&ray).is_hit() && !accel.occluded(&Ray { t_max: 4.5, ..ray }));
            assert_eq!(accel.occluded(&far), n == 0);
            accel.set_shadow_casters(|_| true);
            assert!(accel.occluded(&ray));
        }
    }
}

#[test]
fn empty_scenes_and_levels() {
    let mut accel = Accel::new(AccelOptions::default()).unwrap();
    let ray = Ray::new(Vec3::ZERO, Vec3::X);
    assert_eq!(accel.closest_hit(&ray), Hit::MISS);
    accel.update(&scene(vec![mesh(vec![], vec![])], vec![(0, Affine3::IDENTITY)]));
    accel.validate().unwrap();
    assert_eq!(accel.closest_hit(&ray), Hit::MISS);
    assert!(!accel.occluded(&ray));
    assert_ne!(accel.simd_level(), SimdLevel::Auto);
    if cfg!(not(target_arch = "x86_64")) {
        assert!(Accel::new(AccelOptions { simd: SimdLevel::Avx2, ..Default::default() }).is_err());
    }
}
