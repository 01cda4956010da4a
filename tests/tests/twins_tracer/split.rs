//! How interfaces split light, against trace/optics.rs.

use catoptra_engine::{Look, RenderScene, glam::Vec3};
use catoptra_render_hybrid::{
    BlasKind,
    raster::testing::mirrored,
    trace::{
        media::{MediumStack, crossing, ior_of},
        optics::split,
        surface::Surface,
    },
};

use super::{
    Allowed, Random, Verdict, followed,
    media::{STACK, put_stack, stack_numbers},
    probe, scenes,
};

const GLASSES: u32 = 12;
const ROWS: usize = 40_000;
const INSIDE: usize = 6;

/// Instance, front, both normals, direction, colour, mirror, transmission, instances entered.
type Row = [f32; 16 + INSIDE];

const COLUMNS: &[(&str, usize)] = &[
    ("reflected", 3),
    ("transmitted", 3),
    ("transmitted direction", 3),
    ("passes", 1),
    ("hidden", 1),
    ("mirrored direction", 3),
    ("behind", STACK),
];
const NUMBERS: usize = 14 + STACK;

fn body() -> String {
    format!(
        "var s: SurfacePoint;
        s.instance = u32(x[0]);
        s.front = x[1] > 0.5;
        s.n_shading = vec3f(x[2], x[3], x[4]);
        s.n_geometric = vec3f(x[5], x[6], x[7]);
        let d = vec3f(x[8], x[9], x[10]);
        s.base_color = vec3f(x[11], x[12], x[13]);
        s.look.mirror = x[14];
        s.look.transmission = x[15];
        var inside = empty_media();
        for (var k = 0u; k < {INSIDE}u; k += 1u) {{
            if x[16u + k] >= 0.0 {{
                inside = entered_media(inside, u32(x[16u + k]));
            }}
        }}
        let i = split(s, d, inside);
        let passes = i.passes && !i.hidden;
        let t = select(vec3f(0.0), i.transmitted_direction, passes);
        let m = above_horizon(reflect_view(-d, s.n_shading), s.n_geometric);
        y[0] = i.reflected.x; y[1] = i.reflected.y; y[2] = i.reflected.z;
        y[3] = i.transmitted.x; y[4] = i.transmitted.y; y[5] = i.transmitted.z;
        y[6] = t.x; y[7] = t.y; y[8] = t.z; y[9] = f32(passes); y[10] = f32(i.hidden);
        y[11] = m.x; y[12] = m.y; y[13] = m.z;
        {}",
        put_stack("i.behind", 14)
    )
}

fn vec(r: &Row, at: usize) -> Vec3 {
    Vec3::from_slice(&r[at..])
}

fn inside(r: &Row) -> MediumStack {
    r[16..].iter().filter(|i| **i >= 0.0).fold(MediumStack::default(), |m, i| m.entered(*i as u32))
}

/// n_from / n_to of volumes, as `split` has it; `None` where nothing changes.
fn eta(scene: &RenderScene, r: &Row) -> Option<f32> {
    let c = crossing(scene, inside(r), r[0] as u32, r[1] > 0.5);
    (c.from != c.to).then(|| ior_of(scene, c.from) / ior_of(scene, c.to))
}

fn volume(scene: &RenderScene, r: &Row) -> bool {
    let i = &scene.instances[r[0] as usize];
    scene.meshes[i.mesh as usize].closed() && !scene.materials[i.material as usize].thin
}

fn rows(scene: &RenderScene) -> Vec<Row> {
    let mut r = Random(7);
    (0..ROWS)
        .map(|i| {
            let mut row = [-1.0; 16 + INSIDE];
            row[0] = r.below(GLASSES as usize) as f32;
            row[1] = r.below(2) as f32;
            for place in &mut row[16..16 + r.below(INSIDE + 1)] {
                *place = r.below(GLASSES as usize) as f32;
            }
            let n = r.direction();
            // Smooth normals up to anywhere on the same side.
            let bent = [0.0, 0.1, 2.0][r.below(3)];
            let shading = (n + r.vec() * bent).normalize_or(n);
            let shading = if shading.dot(n) < 0.0 { -shading } else { shading };
            let across = shading.any_orthonormal_vector();
            let cos = match i % 4 {
                // Near the critical angle, on both sides of it, where there is one.
                0 if volume(scene, &row) && eta(scene, &row).is_some_and(|e| e > 1.0) => {
                    let e = eta(scene, &row).unwrap();
                    (1.0 - 1.0 / (e * e)).sqrt() * (1.0 + (r.unit() - 0.5) * [1e-1, 1e-2, 1e-3, 1e-4, 1e-5][r.below(5)])
                }
                // Grazing, along the normal, from behind the smooth normal.
                1 => [1e-6, 1e-3, 0.01, 1.0, -0.1][r.below(5)],
                _ => r.unit(),
            };
            let d = across * (1.0 - cos * cos).max(0.0).sqrt() - shading * cos;
            let share = |r: &mut Random| [0.0, 1.0, r.unit()][r.below(3)];
            let (mirror, transmission, color) = (share(&mut r), share(&mut r), r.color());
            for (at, v) in [(2, shading), (5, n), (8, d.normalize()), (11, color)] {
                row[at..at + 3].copy_from_slice(&v.to_array());
            }
            (row[14], row[15]) = (mirror, transmission);
            row
        })
        .collect()
}

/// What rounding makes of a lifted direction: its length is that of what is left of it.
fn lifted_slack(r: Vec3, n: Vec3) -> f32 {
    let left = (r + n * (1e-3 - r.dot(n))).length();
    if r.dot(n) >= 1e-3 - 1e-6 { 2e-6 } else { 2e-6 / left.clamp(1e-6, 1.0) }
}

fn allowed(scene: &RenderScene, r: &Row) -> [Allowed; NUMBERS] {
    let (n, geometric, d) = (vec(r, 2), vec(r, 5), vec(r, 8));
    let look = Look { mirror: r[14], transmission: r[15], diffuse: 1.0, specular: Vec3::ZERO, shininess: 1.0 };
    let instance = &scene.instances[r[0] as usize];
    let m = &scene.materials[instance.material as usize];
    let s = Surface {
        position_world: Vec3::ZERO,
        error: 0.0,
        n_geometric: geometric,
        n_shading: n,
        front: r[1] > 0.5,
        base_color: vec(r, 11),
        emission: Vec3::ZERO,
        look,
        material: instance.material,
        instance_id: r[0] as u32,
        primitive_id: 0,
    };
    let o = split(scene, m, &s, d, inside(r));
    let cos = f64::from(n.dot(-d)).clamp(0.0, 1.0);
    let eta = f64::from(if volume(scene, r) { eta(scene, r).unwrap_or(1.0) } else { 1.0 / m.ior });
    // f32 knows the square of the refracted cosine to a few units in the last place of 1 and of eta², so the cosine to that over
    // itself; Snell's direction moves as it does, and Fresnel's terms by their slope: that of ((eta c1 − c2)/(eta c1 + c2))² is
    // at most 4 eta c1/(eta c1 + c2)².
    let (unsure, square) = (3e-7 * (eta * eta).max(1.0), 1.0 - eta * eta * (1.0 - cos * cos));
    let c2 = square.max(0.0).sqrt();
    let cosine_off = unsure / square.abs().sqrt().max(unsure.sqrt());
    let slope = |sum: f64| 4.0 * eta * cos / (sum * sum).max(1e-9);
    // Elsewhere no Fresnel term is asked for.
    let reflects = !o.hidden && !m.thin && look.mirror < 1.0 && look.transmission > 0.0;
    let fresnel = 4e-6
        + if reflects {
            (0.5 * (slope(eta * cos + c2) + slope(eta * c2 + cos)) * cosine_off).min(1.0) as f32
        } else {
            0.0
        };
    let cosine_off = cosine_off as f32;
    let critical = volume(scene, r) && !o.hidden && square.abs() <= unsure;
    // A ray that is worth nothing: whether it is there does not show.
    let worthless = o.transmitted_direction.is_some() && o.transmitted.max_element() < 1e-6;
    let t = o.transmitted_direction.unwrap_or(Vec3::ZERO);
    let mirror = mirrored(d, n, geometric);
    let unlifted = n * (2.0 * n.dot(-d)) + d;
    let turned = cosine_off + if volume(scene, r) { lifted_slack(-t, geometric) } else { 0.0 };
    let exact = [f32::from(u8::from(o.transmitted_direction.is_some())), f32::from(u8::from(o.hidden))];
    let behind = stack_numbers(o.behind);
    std::array::from_fn(|i| match i {
        // An index of nearly 1 at grazing angles, or at the critical one: rounding decides all of it.
        0..6 if fresnel > 1e-3 => Allowed::ANY,
        0..3 => Allowed::about(o.reflected[i], fresnel),
        3..6 => Allowed::about(o.transmitted[i - 3], fresnel),
        // At the critical angle a rounding decides.
        6..=9 if critical || worthless => Allowed::ANY,
        6..=8 => Allowed::about(t[i - 6], turned),
        9 | 10 => Allowed::exactly(exact[i - 9]),
        11..14 => Allowed::about(mirror[i - 11], lifted_slack(unlifted, geometric)),
        i => Allowed::exactly(behind[i - 14]),
    })
}

#[test]
fn interfaces_split_light_as_on_the_cpu() {
    let Some(probe) = probe() else { return };
    let scene = scenes::glasses(8, GLASSES);
    let held = probe.hold(&scene, &followed(&scene, BlasKind::Bvh)).unwrap();
    let rows = rows(&scene);
    let allowed: Vec<_> = rows.iter().map(|r| allowed(&scene, r)).collect();
    let judge = |edits: &[(&str, &str)]| {
        let gpu: Vec<[f32; NUMBERS]> = held.evaluate(edits, &body(), &rows).unwrap();
        Verdict::of(COLUMNS, &gpu, |row| allowed[row])
    };

    // The table holds what it should.
    let count =
        |f: &dyn Fn(&Row, &[Allowed; NUMBERS]) -> bool| rows.iter().zip(&allowed).filter(|(r, a)| f(r, a)).count();
    let glass = |r: &Row| r[14] < 1.0 && r[15] > 0.0;
    let hidden = count(&|_, a| a[10].low == 1.0);
    let total = count(&|r, a| volume(&scene, r) && glass(r) && a[10].low == 0.0 && a[9].low == 0.0);
    let through = count(&|_, a| a[9].low == 1.0);
    let panes = count(&|r, _| glass(r) && !volume(&scene, r) && !scene.materials[r[0] as usize].thin);
    let films = count(&|r, _| glass(r) && scene.materials[r[0] as usize].thin);
    let full = count(&|r, _| r[16..].iter().all(|i| *i >= 0.0) && r[1] > 0.5);
    let critical = count(&|_, a| a[9].low == f32::NEG_INFINITY);
    println!(
        "{hidden} hidden, {total} total, {through} through, {panes} panes, {films} films, {full} full, {critical} undecided"
    );
    assert!([hidden, total, through, panes, films, full].iter().all(|&n| n > 1000));
    assert!(critical * 20 < ROWS, "{critical} rows say little");
    let loose = count(&|_, a| a[0].low == f32::NEG_INFINITY);
    println!("{loose} rows of undecided weights");
    assert!(loose * 50 < ROWS);

    judge(&[]).agrees("split");
    for (name, from, to) in [
        (
            "index of refraction upside down",
            "let eta = ior_of(c.before) / ior_of(c.after);",
            "let eta = ior_of(c.after) / ior_of(c.before);",
        ),
        ("one face of a pane", "let r = 2.0 * f / (1.0 + f);", "let r = f;"),
        ("no raise of the tint", "tint = schlick(s.base_color, cos_i);", ""),
        ("tinted film", "out.transmitted = vec3f(glass);", "out.transmitted = s.base_color * glass;"),
        ("hidden surfaces split light", "out.hidden = true;", "out.hidden = false;"),
        (
            "glass before mirror",
            "let glass = (1.0 - s.look.mirror) * s.look.transmission;",
            "let glass = s.look.transmission;",
        ),
        ("directions below the horizon", "if cos >= LEAST_COSINE {\n        return r;", "if true {\n        return r;"),
        ("total reflection is dropped", "out.passes = f < 1.0 && t.w > 0.0;", "out.passes = true;"),
        (
            "always from outside",
            "let c = crossing(inside, s.instance, s.front);",
            "let c = crossing(inside, s.instance, true);",
        ),
    ] {
        judge(&[(from, to)]).fails("split", name);
    }
}
