//! Holes by alpha masks, as rays (`is_hole`) and rasteriser (`is_cut`) see them, against accel/cutout.rs.

use catoptra_engine::{RenderScene, glam::Vec2};
use catoptra_render_hybrid::{
    BlasKind,
    accel::{Accel, Hit},
    raster::testing::is_hole,
};

use super::{Allowed, Random, Verdict, followed, probe, scenes};

const ROWS: usize = 30_000;

/// Instance, triangle, weights.
type Row = [f32; 4];

const COLUMNS: &[(&str, usize)] = &[("is_hole", 1), ("is_cut", 1)];

const BODY: &str = "
    let i = u32(x[0]);
    y[0] = f32(is_hole(i, u32(x[1]), x[2], x[3]));
    let vertices = triangle_vertices(read_instance(i), u32(x[1]));
    let weights = vec3f(1.0 - x[2] - x[3], x[2], x[3]);
    let at = material_at(i);
    var m: Material;
    m.base_color_texture = read_texture_ref(at + 4u);
    m.alpha = bitcast<vec4f>(dynamic_word(at + 13u)).y;
    m.alpha_cutoff = bitcast<f32>(dynamic_word(at + 3u).w);
    let uv = texture_coordinates(m.base_color_texture, interpolated(vertices, VERTEX_UV, weights));
    y[1] = f32(is_cut(m, uv, interpolated(vertices, VERTEX_POSITION, weights).w));";

/// Surfaces of which each has holes, by alpha of the material, of vertices and of textures.
fn scene(cutoff: f32) -> RenderScene {
    let mut r = Random(21);
    let mut scene = scenes::surfaces(20);
    for m in &mut scene.materials {
        m.alpha = 0.4 + 0.6 * r.unit();
        // Less alpha is left where more of it is multiplied.
        m.alpha_cutoff = (0.1 + 0.5 * r.unit()) * cutoff;
    }
    scene
}

fn rows(scene: &RenderScene) -> Vec<Row> {
    let mut r = Random(22);
    (0..ROWS)
        .map(|i| {
            let (a, b) = (r.unit(), r.unit());
            let [u, v] = match i % 7 {
                0 => [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]][r.below(3)],
                1 => [a, 1.0 - a],
                _ if a + b < 1.0 => [a, b],
                _ => [1.0 - a, 1.0 - b],
            };
            [r.below(scene.instances.len()) as f32, r.below(scenes::TRIANGLES) as f32, u, v]
        })
        .collect()
}

fn answer(accel: &Accel, r: &Row, by: Vec2) -> f32 {
    let hit = Hit { t: 1.0, u: r[2] + by.x, v: r[3] + by.y, instance_id: r[0] as u32, primitive_id: r[1] as u32 };
    f32::from(u8::from(is_hole(accel, &hit)))
}

/// What the CPU says of weights moved by 1e-6 and of cutoffs by a few roundings; anything where it is not of one mind.
fn allowed(accels: &[Accel; 3], r: &Row) -> Allowed {
    let moves = [Vec2::ZERO, Vec2::X, Vec2::NEG_X, Vec2::Y, Vec2::NEG_Y, Vec2::ONE, Vec2::NEG_ONE].map(|m| m * 1e-6);
    let first = answer(&accels[0], r, Vec2::ZERO);
    let same = accels.iter().all(|a| moves.iter().all(|m| answer(a, r, *m) == first));
    if same { Allowed::exactly(first) } else { Allowed::ANY }
}

#[test]
fn holes_are_those_of_the_cpu() {
    let Some(probe) = probe() else { return };
    let scene_of = scene(1.0);
    let accels = [1.0, 1.0 - 1e-6, 1.0 + 1e-6].map(|cutoff| followed(&scene(cutoff), BlasKind::Bvh));
    let held = probe.hold(&scene_of, &accels[0]).unwrap();
    let rows = rows(&scene_of);
    let allowed: Vec<Allowed> = rows.iter().map(|r| allowed(&accels, r)).collect();
    let judge = |edits: &[(&str, &str)]| {
        let gpu: Vec<[f32; 2]> = held.evaluate(edits, BODY, &rows).unwrap();
        Verdict::of(COLUMNS, &gpu, |row| [allowed[row]; 2])
    };

    // The table holds what it should.
    let count = |f: &dyn Fn(&Row, &Allowed) -> bool| rows.iter().zip(&allowed).filter(|(r, a)| f(r, a)).count();
    let material = |r: &Row| &scene_of.materials[r[0] as usize];
    let textured = |r: &Row| material(r).base_color_texture.is_some();
    let [undecided, holes] = [count(&|_, a| a.low < 0.0), count(&|_, a| a.low == 1.0)];
    let by_texture = count(&|r, a| a.low == 1.0 && textured(r) && material(r).alpha > material(r).alpha_cutoff);
    let solid = count(&|r, a| a.low == 0.0 && textured(r));
    println!("{holes} holes, {by_texture} by a texture, {solid} textured and solid, {undecided} undecided");
    assert!(holes > ROWS / 20 && by_texture > 1000 && solid > 1000 && undecided * 50 < ROWS);

    judge(&[]).agrees("holes");
    for (name, from, to) in [
        ("weights exchanged", "vec3f(1.0 - u - v, u, v);", "vec3f(1.0 - u - v, v, u);"),
        ("vertex alpha left out", "* interpolated(vertices, VERTEX_POSITION, weights).w;\n    let r", ";\n    let r"),
        (
            "alpha of the material left out",
            "factors.y * interpolated(vertices, VERTEX_POSITION",
            "interpolated(vertices, VERTEX_POSITION",
        ),
        ("texture left out", "alpha *= sample_alpha(r, ", "alpha *= 1.0 + 0.0 * sample_alpha(r, "),
        ("other side of the cutoff", "return alpha < cutoff;", "return alpha > cutoff;"),
        ("red for alpha", "texels >> vec4u(24u)", "texels & vec4u(255u)"),
        ("rows of the footprint exchanged", "return top * (1.0 - fraction.y)", "return bottom * (1.0 - fraction.y)"),
        ("vertex alpha left out of is_cut", "material.alpha * vertex_alpha", "material.alpha"),
        ("other side of is_cut", "return alpha < material.alpha_cutoff;", "return alpha >= material.alpha_cutoff;"),
    ] {
        judge(&[(from, to)]).fails("holes", name);
    }
}
