//! The stack of media, against trace/media.rs, and what a medium leaves of light.

use catoptra_engine::glam::Vec3;
use catoptra_render_hybrid::{
    BlasKind,
    trace::media::{MediumStack, crossing},
    twin::shading::beer_lambert,
};

use super::{Allowed, Random, Verdict, followed, probe, scenes};

const GLASSES: u32 = 12;
const STEPS: usize = 14;
const ROWS: usize = 20_000;

/// Steps (instance, and [`LEAVE`] more to leave it), then a surface: instance, front; then metres.
type Row = [f32; STEPS + 3];

const LEAVE: f32 = 64.0;

/// Numbers a stack: instances in the order of entry (−1 behind the last), and how many.
pub const STACK: usize = MediumStack::CAPACITY + 1;

/// WGSL that writes a stack to `y[at..]`.
pub fn put_stack(stack: &str, at: usize) -> String {
    format!(
        "for (var k = 0u; k < MEDIA_CAPACITY; k += 1u) {{
            y[{at}u + k] = select(-1.0, f32({stack}.instances[k]), k < {stack}.count);
        }}
        y[{at}u + MEDIA_CAPACITY] = f32({stack}.count);\n"
    )
}

/// The numbers of the stack of which Rust shows no inside: found by entering the same, which equal stacks have entered.
pub fn stack_numbers(s: MediumStack) -> [f32; STACK] {
    let mut out = [-1.0; STACK];
    let (mut count, mut rest) = (0, s);
    // From the last entry down: taking out the last leaves what was there before.
    let mut backwards = Vec::new();
    while let Some(i) = (0..GLASSES).find(|&i| rest.contains(i) && rest.left(i).entered(i) == rest) {
        backwards.push(i);
        rest = rest.left(i);
        count += 1;
    }
    assert_eq!(rest, MediumStack::default());
    for (k, i) in backwards.into_iter().rev().enumerate() {
        out[k] = i as f32;
    }
    out[STACK - 1] = count as f32;
    out
}

const COLUMNS: &[(&str, usize)] = &[
    ("stack", STACK),
    ("current", 1),
    ("inside", GLASSES as usize),
    ("before", 1),
    ("after", 1),
    ("behind", STACK),
    ("transmittance", 3),
];
const NUMBERS: usize = 2 * STACK + GLASSES as usize + 6;

fn body() -> String {
    let (current, inside) = (STACK, STACK + 1);
    let before = inside + GLASSES as usize;
    format!(
        "var m = empty_media();
        for (var k = 0u; k < {STEPS}u; k += 1u) {{
            if x[k] >= {LEAVE:?} {{
                m = left_media(m, u32(x[k] - {LEAVE:?}));
            }} else if x[k] >= 0.0 {{
                m = entered_media(m, u32(x[k]));
            }}
        }}
        {}
        let current = current_medium(m);
        y[{current}] = select(f32(current), -1.0, current == NONE);
        for (var k = 0u; k < {GLASSES}u; k += 1u) {{
            y[{inside}u + k] = f32(is_inside(m, k));
        }}
        let c = crossing(m, u32(x[{STEPS}]), x[{STEPS} + 1] > 0.5);
        y[{before}] = select(f32(c.before), -1.0, c.before == NONE);
        y[{before} + 1] = select(f32(c.after), -1.0, c.after == NONE);
        {}
        let left = transmittance(m, x[{STEPS} + 2]);
        y[{NUMBERS} - 3] = left.x; y[{NUMBERS} - 2] = left.y; y[{NUMBERS} - 1] = left.z;",
        put_stack("m", 0),
        put_stack("c.behind", before + 2)
    )
}

fn rows() -> Vec<Row> {
    let mut r = Random(5);
    (0..ROWS)
        .map(|i| {
            let mut row = [-1.0; STEPS + 3];
            // From short walks to such as meet the stack's end; some among few instances, so that one is entered twice.
            let steps = r.below(STEPS + 1);
            let among = [GLASSES as usize, 3][i % 2];
            let leaves = [0.1, 0.4][r.below(2)];
            for step in &mut row[..steps] {
                *step = r.below(among) as f32 + if r.chance(leaves) { LEAVE } else { 0.0 };
            }
            row[STEPS] = r.below(among) as f32;
            row[STEPS + 1] = r.below(2) as f32;
            row[STEPS + 2] = [0.0, 1e-4, 0.3, 5.0, 1000.0, r.unit()][r.below(6)];
            row
        })
        .collect()
}

fn number(instance: Option<u32>) -> f32 {
    instance.map_or(-1.0, |i| i as f32)
}

#[test]
fn media_are_those_of_the_cpu() {
    let Some(probe) = probe() else { return };
    let scene = scenes::glasses(6, GLASSES);
    let held = probe.hold(&scene, &followed(&scene, BlasKind::Bvh)).unwrap();
    let rows = rows();
    let (mut full, mut twice, mut started_inside, mut absorbed) = (0, 0, 0, 0);
    let allowed: Vec<[Allowed; NUMBERS]> = rows
        .iter()
        .map(|r| {
            let mut m = MediumStack::default();
            for &step in r[..STEPS].iter().filter(|s| **s >= 0.0) {
                m = if step >= LEAVE {
                    m.left((step - LEAVE) as u32)
                } else {
                    let i = step as u32;
                    // Without room it stays as it is.
                    full += usize::from(m.entered(i) == m);
                    twice += usize::from(m.contains(i));
                    m.entered(i)
                };
            }
            let current = m.current(&scene);
            let (instance, front) = (r[STEPS] as u32, r[STEPS + 1] > 0.5);
            started_inside += usize::from(!front && !m.contains(instance));
            let c = crossing(&scene, m, instance, front);
            let left = current.map_or(Vec3::ONE, |i| {
                let m = &scene.materials[scene.instances[i as usize].material as usize];
                beer_lambert(m.attenuation_color, m.attenuation_distance, r[STEPS + 2])
            });
            absorbed += usize::from(left.max_element() < 1.0);
            let inside = (0..GLASSES).map(|i| f32::from(u8::from(m.contains(i))));
            let exact: Vec<f32> = stack_numbers(m)
                .into_iter()
                .chain([number(current)])
                .chain(inside)
                .chain([number(c.from), number(c.to)])
                .chain(stack_numbers(c.behind))
                .collect();
            std::array::from_fn(|i| match exact.get(i) {
                Some(v) => Allowed::exactly(*v),
                // A power: the logarithm, up to ln 100 · 10^4, but at most 88 where it shows, times its rounding, in f32.
                None => Allowed::about(left[i - exact.len()], 2e-5),
            })
        })
        .collect();
    println!("{full} entries without room, {twice} entries again, {started_inside} started inside, {absorbed} absorb");
    assert!([full, twice, started_inside, absorbed].iter().all(|&n| n > 1000));
    let judge = |edits: &[(&str, &str)]| {
        let gpu: Vec<[f32; NUMBERS]> = held.evaluate(edits, &body(), &rows).unwrap();
        Verdict::of(COLUMNS, &gpu, |row| allowed[row])
    };
    judge(&[]).agrees("media");
    for (name, from, to) in [
        ("the first of equals", "priority >= highest", "priority > highest"),
        (
            "priorities without sign",
            "bitcast<i32>(dynamic_word(material_at(instance) + 23u).y)",
            "abs(bitcast<i32>(dynamic_word(material_at(instance) + 23u).y))",
        ),
        ("one entry fewer", "if out.count < MEDIA_CAPACITY {", "if out.count + 1u < MEDIA_CAPACITY {"),
        (
            "the first entry is left",
            "if own[i] == instance {\n            at = i;",
            "if own[i] == instance && at == NONE {\n            at = i;",
        ),
        ("no entry closes up", "own[i] = own[i + 1u];", ""),
        ("who started inside is forgotten", "if !front && !is_inside(inside, instance) {", "if false {"),
        ("absorption per metre", "min(travelled / attenuation_distance, 1e30)", "min(travelled, 1e30)"),
    ] {
        judge(&[(from, to)]).fails("media", name);
    }
}
