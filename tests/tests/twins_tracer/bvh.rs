//! Rays through both levels of wide trees (`closest_hit`, `occluded`), against the CPU's.

use catoptra_engine::{
    Instance, Material, RenderScene,
    glam::{Affine3, Vec3},
};
use catoptra_render_hybrid::{
    BlasKind,
    accel::{Accel, Ray},
};
use std::sync::Arc;

use super::{Allowed, Random, Verdict, followed, probe, scenes};

const ROWS: usize = 20_000;
const INSTANCES: usize = 90;

/// Start, least distance, direction, greatest distance.
type Row = [f32; 8];

const COLUMNS: &[(&str, usize)] =
    &[("t", 1), ("u, v", 2), ("instance", 1), ("primitive", 1), ("occluded", 1), ("capped", 1)];

const BODY: &str = "
    let ray = Ray(vec3f(x[0], x[1], x[2]), x[3], vec3f(x[4], x[5], x[6]), x[7]);
    let hit = closest_hit(ray);
    let met = hit.instance != NONE;
    y[0] = select(-1.0, hit.t, met); y[1] = select(-1.0, hit.u, met); y[2] = select(-1.0, hit.v, met);
    y[3] = select(-1.0, f32(hit.instance), met); y[4] = select(-1.0, f32(hit.primitive), met);
    y[5] = f32(occluded(ray)); y[6] = f32(capped);";

/// Many small meshes in each other's way, turned, skewed and mirrored; every third stands where another does; some have holes,
/// some throw no shadow.
fn scene() -> RenderScene {
    let mut r = Random(51);
    let mut scene = RenderScene { textures: scenes::textures(&mut r), ..RenderScene::default() };
    for normals in 0..3 {
        let a = scenes::Attributes { normals, uvs: 2, colors: true, tangents: 0 };
        scene.meshes.push(Arc::new(scenes::open_mesh(&mut r, a)));
    }
    for n in 0..3u32 {
        let cutoff = if n == 2 { 0.5 } else { 0.0 };
        scene.materials.push(Material { alpha_cutoff: cutoff, alpha: 0.9, ..Material::default() });
    }
    for n in 0..INSTANCES {
        let own = Affine3::from_translation(r.vec() * 6.0) * scenes::transforms()[n % 5];
        // Of two in one place both have holes or none: the CPU passes what lies exactly where it passed something
        // (accel/cutout.rs).
        let (mesh, world_from_object, material) = match scene.instances.last() {
            Some(i) if n % 3 == 2 => (i.mesh, i.world_from_object, i.material),
            _ => ((n % 3) as u32, if n % 9 == 0 { Affine3::IDENTITY } else { own }, (n / 7 % 3) as u32),
        };
        scene.instances.push(Instance { stable_id: n as u64, mesh, material, world_from_object });
    }
    scene
}

fn casts(instance: u32) -> bool {
    // Alike for two in one place.
    (instance - u32::from(instance % 3 == 2)) % 4 != 1
}

fn rows(scene: &RenderScene) -> Vec<Row> {
    let mut r = Random(52);
    (0..ROWS)
        .map(|k| {
            let origin = r.vec() * 7.0;
            // Half of them at a place of some triangle.
            let i = &scene.instances[r.below(INSTANCES)];
            let [a, b, c] = scene.meshes[i.mesh as usize].corners(r.below(8) as u32);
            let (u, v) = (r.unit() * 0.5, r.unit() * 0.5);
            let target = i.world_from_object.transform_point3(a + (b - a) * u + (c - a) * v);
            let toward = if k % 2 == 0 { target - origin } else { r.direction() };
            let d = match k % 16 {
                // Along an axis, with zeros in it.
                15 => [Vec3::X, Vec3::NEG_Y, Vec3::Z][r.below(3)],
                14 => Vec3::new(r.unit(), 0.0, -r.unit()).normalize_or(Vec3::X),
                _ => toward.normalize_or(Vec3::X),
            };
            let (least, most) = [(0.0, f32::MAX), (r.unit() * 4.0, f32::MAX), (0.0, r.unit() * 9.0)][r.below(3)];
            [origin.x, origin.y, origin.z, least, d.x, d.y, d.z, most]
        })
        .collect()
}

fn ray(r: &Row) -> Ray {
    let t_max = if r[7] == f32::MAX { f32::INFINITY } else { r[7] };
    Ray { origin: Vec3::from_slice(r), direction: Vec3::from_slice(&r[4..]), t_min: r[3], t_max }
}

fn allowed(accel: &Accel, r: &Row) -> [Allowed; 7] {
    let hit = accel.closest_hit(&ray(r));
    let occluded = f32::from(u8::from(accel.occluded(&ray(r))));
    let [t, u, v, instance, primitive] = match hit.is_hit() {
        true => [hit.t, hit.u, hit.v, hit.instance_id as f32, hit.primitive_id as f32],
        false => [-1.0; 5],
    };
    [
        // Double precision against whole numbers, rounded once more each.
        Allowed::about(t, 2e-6 * t.abs().max(1.0)),
        Allowed::about(u, 1e-5),
        Allowed::about(v, 1e-5),
        Allowed::exactly(instance),
        Allowed::exactly(primitive),
        Allowed::exactly(occluded),
        Allowed::exactly(0.0),
    ]
}

#[test]
fn walks_meet_what_the_cpu_meets() {
    let Some(probe) = probe() else { return };
    let scene = scene();
    let mut accel = followed(&scene, BlasKind::Bvh);
    accel.set_shadow_casters(casts);
    let held = probe.hold(&scene, &accel).unwrap();
    let rows = rows(&scene);
    let allowed: Vec<_> = rows.iter().map(|r| allowed(&accel, r)).collect();
    let judge = |edits: &[(&str, &str)]| {
        let gpu: Vec<[f32; 7]> = held.evaluate(edits, BODY, &rows).unwrap();
        Verdict::of(COLUMNS, &gpu, |row| allowed[row])
    };

    // The table holds what it should.
    let count = |f: &dyn Fn(&[Allowed; 7]) -> bool| allowed.iter().filter(|a| f(a)).count();
    let [hits, dark] = [count(&|a| a[3].low >= 0.0), count(&|a| a[5].low == 1.0)];
    let shadowless = count(&|a| a[3].low >= 0.0 && a[5].low == 0.0);
    let twice = count(&|a| a[3].low >= 0.0 && a[3].low as usize % 3 == 1);
    println!("{hits} hits, {dark} occluded, {shadowless} by what throws no shadow, {twice} of two in one place");
    assert!(hits > ROWS / 3 && dark > ROWS / 4 && shadowless > 200 && twice > 500);

    let verdict = judge(&[]);
    println!("closest_hit, occluded: {} of {} rows are wrong; {}", verdict.wrong, verdict.rows, verdict.first);
    // Rays along an edge fall on the neighbour.
    assert!(verdict.wrong * 2000 <= verdict.rows);
    for (name, from, to) in [
        ("the later of two at one distance", "instance < best.instance ||", "instance > best.instance ||"),
        ("hits before the start", "tuv.x > ray.t_min &&", "tuv.x > 0.0 &&"),
        ("holes are solid", "(entered.flags & INSTANCE_CUTOUT) == 0u ||", "true ||"),
        ("all things throw shadows", "any_hit && (flags & INSTANCE_CASTS_SHADOW) == 0u", "false"),
        ("things are where they were made", "if (flags & INSTANCE_IDENTITY) == 0u {", "if false {"),
        (
            "a triangle left out",
            "let count = ((low.w >> REF_LEN_SHIFT) & 7u) + 1u;",
            "let count = (low.w >> REF_LEN_SHIFT) & 7u;",
        ),
        ("hard triangles are missed", "hard |= 1u << i;", ""),
        ("a child left out", "child_key(at, 7u, s, t_min, limit)", "NONE"),
        (
            "what waits is lost",
            "if (order >> ORDER_COUNT_SHIFT) != 0u {\n                    stack[top]",
            "if false {\n                    stack[top]",
        ),
        ("the way back keeps the inner space", "space = world;\n            }", "}"),
        (
            "the last thing alone",
            "best = leaf_hit(low.w & REF_BLOCK, count, space, entered, ray, best);",
            "best = leaf_hit(low.w & REF_BLOCK, count, space, entered, ray, Hit(ray.t_max, 0.0, 0.0, NONE, NONE));",
        ),
    ] {
        let faulty = judge(&[(from, to)]);
        assert!(faulty.wrong > 20, "walks with {name:?}: {} rows are wrong", faulty.wrong);
        faulty.fails("walks", name);
    }
}
