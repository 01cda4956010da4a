//! `surface_at` and the rays that leave a surface, against trace/surface.rs and trace/facet.rs.

use catoptra_engine::{RenderScene, glam::Vec3};
use catoptra_render_hybrid::{
    BlasKind,
    accel::{Hit, Ray},
    raster::testing::surface_by_facet,
    trace::surface::{NormalMatrices, Surface, surface_seen},
};

use super::{Allowed, Random, Verdict, followed, probe, scenes};

const ROWS: usize = 30_000;

/// Instance, triangle, weights, direction, pixel width, direction of leaving.
type Row = [f32; 11];

const COLUMNS: &[(&str, usize)] = &[
    ("position", 3),
    ("error", 1),
    ("n_geometric", 3),
    ("n_shading", 3),
    ("front", 1),
    ("base_color", 3),
    ("emission", 3),
    ("specular", 3),
    ("shininess", 1),
    ("diffuse", 1),
    ("mirror", 1),
    ("transmission", 1),
    ("leaving origin", 3),
    ("leaving t_min", 1),
    ("offset origin", 3),
];
const NUMBERS: usize = 31;

const BODY: &str = "
    let d = vec3f(x[4], x[5], x[6]);
    let s = surface_at(d, Hit(1.0, x[2], x[3], u32(x[0]), u32(x[1])), x[7]);
    let w = vec3f(x[8], x[9], x[10]);
    let ray = leaving_ray(s, w);
    let o = offset_origin(s, w);
    let l = s.look;
    y = array<f32, 31>(
        s.position_world.x, s.position_world.y, s.position_world.z, s.error,
        s.n_geometric.x, s.n_geometric.y, s.n_geometric.z, s.n_shading.x, s.n_shading.y, s.n_shading.z, f32(s.front),
        s.base_color.x, s.base_color.y, s.base_color.z, s.emission.x, s.emission.y, s.emission.z,
        l.specular.x, l.specular.y, l.specular.z, l.shininess, l.diffuse, l.mirror, l.transmission,
        ray.origin.x, ray.origin.y, ray.origin.z, ray.t_min, o.x, o.y, o.z);";

fn vec(r: &Row, at: usize) -> Vec3 {
    Vec3::from_slice(&r[at..])
}

fn hit(r: &Row) -> Hit {
    Hit { t: 1.0, u: r[2], v: r[3], instance_id: r[0] as u32, primitive_id: r[1] as u32 }
}

fn seen(scene: &RenderScene, normals: &NormalMatrices, r: &Row) -> Surface {
    surface_seen(scene, normals, &Ray::new(Vec3::ZERO, vec(r, 4)), &hit(r), r[7])
}

fn numbers(s: &Surface, leaving: Vec3) -> [f32; NUMBERS] {
    let ray = s.leaving_ray(leaving);
    let mut out = [0.0; NUMBERS];
    let parts: [&[f32]; 15] = [
        &s.position_world.to_array(),
        &[s.error],
        &s.n_geometric.to_array(),
        &s.n_shading.to_array(),
        &[f32::from(u8::from(s.front))],
        &s.base_color.to_array(),
        &s.emission.to_array(),
        &s.look.specular.to_array(),
        &[s.look.shininess],
        &[s.look.diffuse],
        &[s.look.mirror],
        &[s.look.transmission],
        &ray.origin.to_array(),
        &[ray.t_min],
        &s.ray_start().offset_origin(leaving).to_array(),
    ];
    out.copy_from_slice(&parts.concat());
    out
}

/// Places inside triangles, at their rims and corners; directions anywhere, grazing, along a normal.
fn rows(scene: &RenderScene, seed: u32) -> Vec<Row> {
    let mut r = Random(seed);
    (0..ROWS)
        .map(|i| {
            let instance = r.below(scene.instances.len());
            let primitive = r.below(scenes::TRIANGLES);
            let (a, b) = (r.unit(), r.unit());
            let (u, v) = match i % 11 {
                0 => [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)][r.below(3)],
                1 => (a, 1.0 - a),
                _ if a + b < 1.0 => (a, b),
                _ => (1.0 - a, 1.0 - b),
            };
            let own = &scene.instances[instance];
            let [p0, p1, p2] = scene.meshes[own.mesh as usize].corners(primitive as u32);
            let to_world = |v: Vec3| own.world_from_object.transform_vector3(v);
            let n = to_world(p1 - p0).normalize_or_zero().cross(to_world(p2 - p0).normalize_or_zero());
            let along = (to_world(p1 - p0).normalize_or_zero() + to_world(p2 - p0).normalize_or_zero() * r.unit())
                .normalize_or(Vec3::X);
            let mut toward = || match r.below(8) {
                // From in the plane itself to a few degrees above it.
                0 => (along + n * ((r.unit() - 0.5) * [0.0, 1e-6, 1e-4, 0.1][r.below(4)])).normalize(),
                1 => n.normalize_or(Vec3::Z),
                _ => r.direction(),
            };
            let (d, w) = (toward(), toward());
            let scale = own.world_from_object.matrix3.x_axis.length();
            let width = [0.0, 1e-3, 0.03, 0.3, 3.0][r.below(5)] * scale;
            [instance as f32, primitive as f32, u, v, d.x, d.y, d.z, width, w.x, w.y, w.z]
        })
        .collect()
}

/// What the GPU may answer: all that the CPU answers to inputs that are moved by less than roundings on the way move what is
/// made of them, and a few units in the last place.
///
/// Moving the inputs covers what jumps: a nearest texel, a level of a texture, the side of a grazing ray, a start that is
/// lifted below 7 degrees. * weights and directions by 1e-6: 8 units in the last place of 1 * pixel widths by 1e-5, which
/// moves a level by 1.4e-5: `log2` may be 2^-21 off
fn allowed(scene: &RenderScene, normals: &NormalMatrices, r: &Row) -> [Allowed; NUMBERS] {
    let s = seen(scene, normals, r);
    let center = numbers(&s, vec(r, 8));
    let (mut low, mut high) = (center, center);
    let mut moved = |change: &dyn Fn(&mut Row)| {
        let mut other = *r;
        change(&mut other);
        let s = seen(scene, normals, &other);
        for (i, v) in numbers(&s, vec(&other, 8)).into_iter().enumerate() {
            (low[i], high[i]) = (low[i].min(v), high[i].max(v));
        }
    };
    for by in [-1.0f32, 1.0] {
        moved(&|o| o[2] += 1e-6 * by);
        moved(&|o| o[3] += 1e-6 * by);
        moved(&|o| o[7] *= 1.0 + 1e-5 * by);
        for at in [4, 8] {
            (0..3).for_each(|k| moved(&|o| o[at + k] += 1e-6 * by));
        }
    }
    let ulp = f32::EPSILON * 0.5;
    std::array::from_fn(|i| {
        let slack = match i {
            // `error` is 32 units in the last place of the greatest term; a quarter of it.
            0..=2 | 24..=26 | 28..=30 => s.error * 0.25,
            3 => s.error * 8.0 * ulp,
            // Unit vectors of a dozen operations and an inverse square root.
            4..10 => 32.0 * ulp,
            10 => 0.0,
            // Texels are sums of four products, up to 1; the light of what emits is up to 4.
            11..17 => 32.0 * ulp * center[i].abs().max(1.0),
            // 2/r^4 multiplies the roundings of the roughness by 4.
            20 => 64.0 * ulp * center[i].max(1.0),
            // Shares of what is left, divided by it.
            17..20 | 21..24 => 64.0 * ulp,
            _ => s.error * 8.0 * 8.0 * ulp,
        };
        Allowed { low: low[i], high: high[i], slack }
    })
}

#[test]
fn surfaces_are_those_of_the_cpu() {
    let Some(probe) = probe() else { return };
    let scene = scenes::surfaces(1);
    let held = probe.hold(&scene, &followed(&scene, BlasKind::Bvh)).unwrap();
    let mut normals = NormalMatrices::default();
    normals.update(&scene);
    let rows = rows(&scene, 2);
    let allowed: Vec<_> = rows.iter().map(|r| allowed(&scene, &normals, r)).collect();
    let judge = |edits: &[(&str, &str)]| {
        let gpu: Vec<[f32; NUMBERS]> = held.evaluate(edits, BODY, &rows).unwrap();
        Verdict::of(COLUMNS, &gpu, |row| allowed[row])
    };
    let verdict = judge(&[]);

    // The table holds what it should.
    let count = |f: &dyn Fn(&Row, &Surface) -> bool| rows.iter().filter(|r| f(r, &seen(&scene, &normals, r))).count();
    let material = |s: &Surface| &scene.materials[s.material as usize];
    let grazing = count(&|r, s| s.n_geometric.dot(vec(r, 4)).abs() < 1e-5);
    let backs = count(&|_, s| !s.front);
    let flat = count(&|r, _| scenes::DEGENERATE.contains(&(r[1] as usize)));
    let mapped = count(&|_, s| material(s).normal_texture.is_some());
    let textured = count(&|_, s| material(s).textures().next().is_some());
    let mirrored = count(&|r, _| scene.instances[r[0] as usize].world_from_object.matrix3.determinant() < 0.0);
    println!(
        "{grazing} grazing, {backs} backs, {flat} without area, {mapped} normal maps, {textured} textured, {mirrored} mirrored"
    );
    assert!([grazing, backs, flat, mapped, textured, mirrored].iter().all(|&n| n > 1000));
    // What jumps under a moved input is rare.
    let wide = |a: &[Allowed; NUMBERS]| a[4..24].iter().any(|a| a.high - a.low > 0.01 * a.high.abs().max(1.0));
    let jumps = allowed.iter().filter(|a| wide(a)).count();
    println!("{jumps} of {ROWS} jump");
    assert!(jumps * 8 < ROWS);

    verdict.agrees("surface_at");
    for (name, from, to) in [
        ("no flip of shading normals", "if flipped {", "if false {"),
        ("sides exchanged", "let front = dot(outward, direction) < 0.0;", "let front = dot(outward, direction) > 0.0;"),
        ("weights exchanged", "vec3f(1.0 - hit.u - hit.v, hit.u, hit.v);", "vec3f(1.0 - hit.u - hit.v, hit.v, hit.u);"),
        ("emission of unlit left out", "        emission += base_color;", "        emission += vec3f(0.0);"),
        ("footprint of the cosine left out", "max(abs(dot(n_geometric, direction)), LEAST_COSINE),", "1.0,"),
        ("second set of coordinates", "(r.flags & TEXTURE_UV1) != 0u", "(r.flags & TEXTURE_UV1) == 0u"),
        ("channels of metal and roughness", "texel.metallic_roughness.z,", "texel.metallic_roughness.x,"),
        ("coverage of emission", "emission *= place.coverage;", ""),
        (
            "handedness of tangents",
            "-cross(normal_object, tangent.xyz) * tangent.w",
            "-cross(normal_object, tangent.xyz)",
        ),
        ("starts lifted to the wrong side", "select(-s.error, s.error,", "select(s.error, -s.error,"),
        ("half of the error", "* SURFACE_ERROR;", "* (0.5 * SURFACE_ERROR);"),
        ("texels by the wrong level", "+ u32(second));", "+ 1u);"),
        ("mirrored wrap", "2 * n - 1 - m, m, m < n", "m % n, m, m < n"),
    ] {
        judge(&[(from, to)]).fails("surface_at", name);
    }
}

/// Plain materials take another way on the CPU.
#[test]
fn kept_triangles_have_the_same_surfaces() {
    let scene = scenes::surfaces(3);
    let mut normals = NormalMatrices::default();
    normals.update(&scene);
    let rows = rows(&scene, 4);
    let (mut allowed_rows, mut got) = (Vec::new(), Vec::new());
    for r in &rows {
        let ray = Ray::new(Vec3::ZERO, vec(r, 4));
        let s = surface_by_facet(&scene, &normals, &ray, &hit(r), r[7]);
        let bounds = allowed(&scene, &normals, r);
        // The bound of the whole triangle, and what starts there: at least the place's own, at most that of the farthest corner.
        let error = Allowed { high: f32::MAX, ..bounds[3] };
        got.push(numbers(&s, vec(r, 8)));
        let own: [Allowed; NUMBERS] = std::array::from_fn(|i| match i {
            3 => error,
            24.. => Allowed::ANY,
            i => bounds[i],
        });
        allowed_rows.push(own);
    }
    Verdict::of(COLUMNS, &got, |row| allowed_rows[row]).agrees("facet");
}
