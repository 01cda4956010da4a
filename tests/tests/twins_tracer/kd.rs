//! The kd-tree's walk on the GPU: short stack, restart, push-down.
//!
//! The contract of a walk is that it changes no hit. So each ray's hit by the walk must be, bit for bit, the one that the same
//! kernel finds among all triangles without any tree; with a short stack of any length; and that of the CPU's kd-tree as
//! far as two roundings of a triangle's test agree.

use catoptra_engine::{
    Mesh, MeshData, RenderScene,
    glam::{Affine3, Vec3},
};
use catoptra_render_hybrid::{
    BlasKind,
    accel::{Accel, Ray},
    raster::testing::ShaderProbe,
};
use std::sync::Arc;

use super::{Allowed, Random, Verdict, followed, probe, scenes};

/// Origin, t_min, direction, t_max, any hit, nearest so far, and whether all triangles are asked, too.
type Row = [f32; 11];

const COLUMNS: &[(&str, usize)] = &[("t", 1), ("u, v", 2), ("met", 1), ("triangle", 1), ("capped", 1)];

/// First the walk's answer, then that of all triangles (what lies behind the last is 0: triangles without area, which nothing
/// meets), then restarts.
const BODY: &str = "
    let ray = Ray(vec3f(x[0], x[1], x[2]), x[3], vec3f(x[4], x[5], x[6]), x[7]);
    let i = instance_at(0u);
    let flags = dynamic_word(i + 3u).w;
    let own = object_space(i, flags, ray);
    // An instance of a higher number met before.
    var so_far = Hit(ray.t_max, 0.0, 0.0, NONE, NONE);
    if x[9] > 0.0 {
        so_far = Hit(x[9], 0.5, 0.25, 7u, 3u);
    }
    var all = so_far;
    let a = kd_hit(i, own, Entered(0u, flags), ray, x[8] > 0.5, so_far);
    if x[10] > 0.5 && dynamic_word(i).w != NONE {
        all = leaf_hit(0u, arrayLength(&triangle_heap) / TRIANGLE_WORDS, own, Entered(0u, flags), ray, so_far);
    }
    y = array<f32, 13>(
        a.t, a.u, a.v, select(f32(a.instance), -1.0, a.instance == NONE),
        select(f32(a.primitive), -1.0, a.instance == NONE), f32(capped),
        all.t, all.u, all.v, select(f32(all.instance), -1.0, all.instance == NONE),
        select(f32(all.primitive), -1.0, all.instance == NONE), 0.0, f32(walked));";

/// Counts restarts in a counter that the walk has no use for.
const COUNTED: (&str, &str) =
    ("                at = root;\n", "                at = root;\n                walked += 1u;\n");

fn mesh(positions: Vec<Vec3>) -> Mesh {
    let triangles = (0..positions.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    Mesh::new(MeshData { positions, triangles, ..MeshData::default() }).unwrap()
}

/// Small triangles anywhere in a cube.
fn soup(r: &mut Random, count: usize, size: f32) -> Mesh {
    let one = |r: &mut Random| {
        let p = r.vec();
        [p, p + r.vec() * size, p + r.vec() * size]
    };
    mesh((0..count).flat_map(|_| one(r)).collect())
}

/// Heaps of triangles with nothing between them: cells without triangles.
fn clusters(r: &mut Random) -> Mesh {
    let mut positions = Vec::new();
    for _ in 0..12 {
        let middle = r.vec();
        for _ in 0..60 {
            let p = middle + r.vec() * 0.02;
            positions.extend([p, p + r.vec() * 0.01, p + r.vec() * 0.01]);
        }
    }
    mesh(positions)
}

/// Ever smaller heaps towards the origin: rays from there leave a far side waiting at each of a dozen levels and more.
fn nested(r: &mut Random) -> Mesh {
    let mut positions = Vec::new();
    for k in 0..14 {
        let size = 1.0 / (1 << k) as f32;
        for _ in 0..24 {
            let p = Vec3::new(1.0, r.unit() - 0.5, r.unit() - 0.5);
            let corner = |r: &mut Random| (p + r.vec() * Vec3::new(0.01, 0.05, 0.05)) * size;
            positions.extend([corner(r), corner(r), corner(r)]);
        }
    }
    mesh(positions)
}

/// A box of squares in the planes of a grid, each of them twice: triangles in split planes, equal distances.
fn grid() -> Mesh {
    let mut positions = Vec::new();
    for axis in 0..3 {
        for plane in -3..=3i32 {
            for (i, k) in (-2..=1i32).flat_map(|i| (-2..=1i32).map(move |k| (i, k))) {
                let at = |di: i32, dk: i32| {
                    let p = [plane as f32 / 4.0, (i + di) as f32 / 2.0, (k + dk) as f32 / 2.0];
                    Vec3::new(p[(3 - axis) % 3], p[(4 - axis) % 3], p[(5 - axis) % 3])
                };
                for _ in 0..1 + (plane & 1) {
                    positions.extend([at(0, 0), at(1, 0), at(1, 1), at(0, 0), at(1, 1), at(0, 1)]);
                }
            }
        }
    }
    mesh(positions)
}

fn scene(mesh: Mesh, world_from_object: Affine3) -> RenderScene {
    let instance = catoptra_engine::Instance { stable_id: 1, mesh: 0, material: 0, world_from_object };
    RenderScene {
        meshes: vec![Arc::new(mesh)],
        materials: vec![Default::default()],
        instances: vec![instance],
        ..RenderScene::default()
    }
}

/// From inside and outside, along axes and in the planes of a grid, past everything, with ends, with something met before.
fn rows(r: &mut Random, mesh: &Mesh, place: &Affine3, count: usize) -> Vec<Row> {
    (0..count)
        .map(|i| {
            let snapped = |v: Vec3| (v * 4.0).round() / 4.0;
            let axis = [Vec3::X, Vec3::Y, Vec3::Z][r.below(3)] * if r.chance(0.5) { 1.0 } else { -1.0 };
            let (origin, d) = match i % 8 {
                0 => (snapped(r.vec()) - axis * 2.0, axis),
                1 => (snapped(r.vec()), axis),
                2 => (r.vec(), axis + r.vec() * 1e-6),
                // In a plane of the grid, askew.
                3 => (snapped(r.vec()), r.vec() * (Vec3::ONE - axis.abs())),
                // Past everything.
                4 => (r.direction() * 4.0, r.direction()),
                5 => (r.vec() * 3.0, -r.vec()),
                // From the smallest of nested heaps through all of them.
                6 => (r.vec() * 1e-5, Vec3::new(1.0, r.unit() - 0.5, r.unit() - 0.5)),
                // At a triangle.
                _ if !mesh.triangles().is_empty() => {
                    let [a, b, c] = mesh.corners(r.below(mesh.triangles().len()) as u32);
                    let (origin, target) = (r.vec() * 1.5, a + (b - a) * 0.4 + (c - a) * (r.unit() * 0.6));
                    (origin, target - origin)
                }
                _ => (r.vec(), r.direction()),
            };
            let (o, d) = (place.transform_point3(origin), place.transform_vector3(d.normalize_or(Vec3::X)));
            let length = d.length();
            let d = d / length;
            let (mut t_min, mut t_max) = (0.0, f32::MAX);
            if r.chance(0.25) {
                (t_min, t_max) = (r.unit() * 0.5 * length, (0.5 + r.unit()) * length);
            }
            let so_far = if r.chance(0.1) { r.unit() * length } else { 0.0 };
            let any = f32::from(u8::from(r.chance(0.2)));
            [o.x, o.y, o.z, t_min, d.x, d.y, d.z, t_max, any, so_far.min(t_max), 1.0]
        })
        .collect()
}

fn ray(r: &Row) -> Ray {
    let v = |at: usize| Vec3::from_slice(&r[at..]);
    let t_max = if r[7] == f32::MAX { f32::INFINITY } else { r[7] };
    Ray { origin: v(0), direction: v(4), t_min: r[3], t_max }
}

struct Walks<'a> {
    probe: &'a ShaderProbe,
    scene: RenderScene,
    accel: Accel,
    rows: Vec<Row>,
    /// What the same kernel finds among all triangles.
    all: Vec<[f32; 6]>,
}

impl<'a> Walks<'a> {
    fn new(probe: &'a ShaderProbe, r: &mut Random, mesh: Mesh, place: Affine3, count: usize) -> Self {
        let rows = rows(r, &mesh, &place, count);
        let scene = scene(mesh, place);
        let accel = followed(&scene, BlasKind::KdTree);
        accel.validate().unwrap();
        let mut walks = Self { probe, rows, accel, scene, all: Vec::new() };
        walks.all = walks.evaluate(&[COUNTED]).iter().map(|g| *g[6..12].first_chunk().unwrap()).collect();
        walks.rows.iter_mut().for_each(|r| r[10] = 0.0);
        walks
    }

    fn evaluate(&self, edits: &[(&str, &str)]) -> Vec<[f32; 13]> {
        let held = self.probe.hold(&self.scene, &self.accel).unwrap();
        held.evaluate(edits, BODY, &self.rows).unwrap()
    }

    /// The walk with `edits` against all triangles; restarts. Where any hit will do, only whether there is one counts.
    fn judge(&self, edits: &[(&str, &str)]) -> (Verdict, f64) {
        let gpu = self.evaluate(edits);
        let restarts = gpu.iter().map(|g| f64::from(g[12])).sum();
        let walk: Vec<[f32; 6]> = gpu.iter().map(|g| *g.first_chunk().unwrap()).collect();
        let verdict = Verdict::of(COLUMNS, &walk, |row| {
            let all = self.all[row];
            let any = self.rows[row][8] > 0.5;
            std::array::from_fn(|i| match i {
                // Met is met: by this instance or by what was met before.
                3 if any && all[3] >= 0.0 => Allowed { low: 0.0, high: 7.0, slack: 0.0 },
                0..=4 if any && all[3] >= 0.0 => Allowed::ANY,
                _ => Allowed::exactly(all[i]),
            })
        });
        (verdict, restarts)
    }

    /// Hits that are not the CPU's, and the greatest relative distance between those that are.
    fn against_cpu(&self) -> (usize, usize, f32) {
        let gpu = self.evaluate(&[]);
        let (mut other, mut hits, mut worst) = (0, 0, 0.0f32);
        for (r, g) in self.rows.iter().zip(&gpu).filter(|(r, _)| r[9] == 0.0) {
            let hit = self.accel.closest_hit(&ray(r));
            hits += usize::from(hit.is_hit());
            if r[8] > 0.5 {
                other += usize::from(hit.is_hit() != (g[3] >= 0.0));
            } else if hit.is_hit() != (g[3] >= 0.0) || (hit.is_hit() && hit.primitive_id as f32 != g[4]) {
                other += 1;
            } else if hit.is_hit() {
                worst = worst.max((g[0] - hit.t).abs() / hit.t.max(1.0));
            }
        }
        (other, hits, worst)
    }
}

fn cases<'a>(probe: &'a ShaderProbe) -> Vec<(&'static str, Walks<'a>)> {
    let mut r = Random(9);
    let turned = Affine3::from_rotation_y(0.7) * Affine3::from_rotation_x(0.4);
    let skewed =
        Affine3::from_translation(Vec3::new(0.3, -0.2, 0.1)) * turned * Affine3::from_scale(Vec3::new(1.0, 0.37, -2.3));
    let soup_of_all = soup(&mut r, 1500, 0.1);
    let long = soup(&mut r, 600, 1.0);
    let heaps = clusters(&mut r);
    let few = soup(&mut r, 5, 1.0);
    let nested = nested(&mut r);
    [
        ("soup", soup_of_all, skewed, 6_000),
        ("long triangles", long, Affine3::IDENTITY, 3_000),
        ("clusters", heaps, turned, 6_000),
        ("grid", grid(), Affine3::IDENTITY, 3_000),
        ("nested", nested, skewed, 12_000),
        ("one leaf", few, skewed, 4_000),
        ("nothing", mesh(Vec::new()), Affine3::IDENTITY, 1_000),
    ]
    .map(|(name, mesh, place, count)| (name, Walks::new(probe, &mut r, mesh, place, count)))
    .into()
}

#[test]
fn walks_change_no_hit() {
    let Some(probe) = probe() else { return };
    for (name, walks) in cases(&probe) {
        let (mut restarted, mut verdicts) = (Vec::new(), Vec::new());
        // The shipped stack, others, and one that no tree fills. A length that is a power of two, so that numbers may wrap.
        for length in ["8u", "1u", "2u", "64u"] {
            let stack = format!("const KD_SHORT_STACK: u32 = {length};");
            let (verdict, restarts) = walks.judge(&[("const KD_SHORT_STACK: u32 = 8u;", &stack), COUNTED]);
            restarted.push(restarts);
            verdicts.push(verdict);
        }
        println!("{name}: {restarted:?} restarts with stacks of 8, 1, 2, 64");
        verdicts.iter().for_each(|v| v.agrees(name));
        // One pop too many on the way: a walk restarts where its stack has lost entries, and only there.
        assert_eq!(restarted[3], 0.0, "{name}: nothing is lost of 64");
        if !["one leaf", "nothing"].contains(&name) {
            assert!(restarted[1] > 300.0 && restarted[2] > 100.0, "{name}: {restarted:?}");
        }
        if name == "nested" {
            assert!(restarted[0] > 500.0, "{name}: the shipped stack restarts, too: {restarted:?}");
        }
        let (other, hits, worst) = walks.against_cpu();
        println!(
            "{name}: {other} of {} hits are not the CPU's, {hits} hits; greatest distance {worst:.1e}",
            walks.rows.len()
        );
        // Rays along edges fall on the neighbour. The test of a triangle is another: in f32 here, in part in f64 there.
        assert!(other * 1000 <= walks.rows.len() && worst < 2e-5, "{name}: {other} others, {worst}");
        assert!(hits > walks.rows.len() / 20 || name == "nothing");
    }
}

#[test]
fn faults_of_walks_are_noticed() {
    let Some(probe) = probe() else { return };
    let cases = cases(&probe);
    for (name, case, length, from, to) in [
        ("no restart", 4, 8, "                at = root;\n", "                return best;\n"),
        (
            "levels below kept as done",
            4,
            8,
            "done = (done & levels_below(level)) | level_bit(level);",
            "done = done | level_bit(level);",
        ),
        (
            "the oldest entry is popped as the newest",
            4,
            2,
            "held = min(held + 1u, KD_SHORT_STACK);",
            "held = held + 1u;",
        ),
        (
            "children exchanged",
            0,
            8,
            "let near_child = node.z + u32(inverse < 0.0);",
            "let near_child = node.z + u32(inverse >= 0.0);",
        ),
        ("cells too short", 0, 8, "let leave = plane - s.far[axis];", "let leave = plane - s.far[axis] - 0.3;"),
        ("far children left out", 2, 8, "let go_far = enter <= at.end;", "let go_far = false;"),
        ("ends at the first leaf", 0, 8, "found = at.start <= best.t;", "return best;"),
        ("one triangle of each leaf too few", 5, 8, "leaf_hit(node.z, node.w,", "leaf_hit(node.z, node.w - 1u,"),
        ("cap too low", 0, 8, "let cap = low.w;", "let cap = 6u;"),
    ] {
        let stack = format!("const KD_SHORT_STACK: u32 = {length}u;");
        let (verdict, _) = cases[case].1.judge(&[("const KD_SHORT_STACK: u32 = 8u;", &stack), (from, to)]);
        verdict.fails(cases[case].0, name);
    }
}

#[test]
fn bits_of_levels() {
    let Some(probe) = probe() else { return };
    let scene = scene(scenes::tetrahedron(), Affine3::IDENTITY);
    let held = probe.hold(&scene, &followed(&scene, BlasKind::KdTree)).unwrap();
    let mut r = Random(10);
    // Level, then a word of 64 bits by 16.
    let rows: Vec<[f32; 5]> = (0..2000)
        .map(|i| {
            let sparse = r.chance(0.5);
            let part = |r: &mut Random| if sparse && r.chance(0.7) { 0.0 } else { (r.bits() >> 16) as f32 };
            [(i % 64) as f32, part(&mut r), part(&mut r), part(&mut r), part(&mut r)]
        })
        .collect();
    let parts = |at: usize, v: &str| {
        format!(
            "y[{at}] = f32({v}.x & 65535u); y[{at} + 1] = f32({v}.x >> 16u); y[{at} + 2] = f32({v}.y & 65535u); y[{at} + 3] = f32({v}.y >> 16u);"
        )
    };
    let body = format!(
        "let w = vec2u(u32(x[1]) | (u32(x[2]) << 16u), u32(x[3]) | (u32(x[4]) << 16u));
        let b = level_bit(u32(x[0])); let l = levels_below(u32(x[0])); {} {} y[8] = f32(greatest_level(w));",
        parts(0, "b"),
        parts(4, "l")
    );
    let judge = |edits: &[(&str, &str)]| {
        let gpu: Vec<[f32; 9]> = held.evaluate(edits, &body, &rows).unwrap();
        Verdict::of(&[("level_bit", 4), ("levels_below", 4), ("greatest_level", 1)], &gpu, |row| {
            let [level, w @ ..] = rows[row];
            let word = (0..4).fold(0u64, |sum, k| sum | (w[k] as u64) << (16 * k));
            let split = |v: u64| [0, 16, 32, 48].map(|s| Allowed::exactly((v >> s & 65535) as f32));
            let [a, b] = [split(1 << level as u32), split((1 << level as u32) - 1)];
            // Of no level at all the walk never asks.
            let greatest = if word == 0 { Allowed::ANY } else { Allowed::exactly(word.ilog2() as f32) };
            [a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3], greatest]
        })
    };
    judge(&[]).agrees("levels");
    judge(&[("32u + firstLeadingBit(bits.y)", "31u + firstLeadingBit(bits.y)")])
        .fails("levels", "greatest of the high word");
    judge(&[("vec2u(part, 0u), level < 32u", "vec2u(part, 0u), level <= 32u")]).fails("levels", "level 32");
}
