//! Twins of the shadow filters and of the VPLs' maps, over tables of inputs.

use catoptra_engine::glam::{Vec2, Vec3, Vec4};
use catoptra_render_hybrid::{
    ShadowFilter,
    raster::testing::ShaderProbe,
    twin::{
        grid::{GridPoint, likeness, near_of_four, near_of_sixteen},
        interleave::{Guide, filter_span, same_surface, subset_of, subset_range},
        penumbra::{level_count, level_of, ln_rough, occluder_depth, penumbra_sigma},
        shadow::{evsm_visibility, moments_of},
        vpl_maps::{octahedron_coordinates, octahedron_point, texel_occlusion},
    },
};
use catoptra_tests::opened_or_skip;

fn probe() -> Option<ShaderProbe> {
    opened_or_skip("twins_light", ShaderProbe::new())
}

/// Numbers in [0, 1) that are the same on every run.
fn noise(i: u32) -> f32 {
    let h = (i.wrapping_mul(0x9E37_79B9) ^ 0x85EB_CA6B).wrapping_mul(0x7FEB_352D);
    ((h ^ (h >> 15)) >> 8) as f32 / (1u32 << 24) as f32
}

fn assert_close<const M: usize>(name: &str, gpu: &[[f32; M]], cpu: &[[f32; M]], relative: f32, absolute: f32) {
    assert_eq!(gpu.len(), cpu.len());
    for (row, (g, c)) in gpu.iter().zip(cpu).enumerate() {
        for (i, (a, b)) in g.iter().zip(c).enumerate() {
            let bound = relative * b.abs() + absolute;
            assert!((a - b).abs() <= bound, "{name}, row {row}, number {i}: GPU {a}, CPU {b}");
        }
    }
}

/// Widths of penumbrae, and where the moments say that an occluder is.
#[test]
fn penumbrae() {
    let Some(probe) = probe() else { return };
    let rows: Vec<[f32; 4]> =
        (0..600).map(|i| [noise(i) * 40.0, 1.0 + 0.7 * noise(i + 700), noise(i + 1400), noise(i + 2100)]).collect();
    let body = "let s = penumbra_sigma(x[0], x[1] > 1.3, x[1], x[2], x[3]); y[0] = s; let l = level_of(s, 7u); \
                y[1] = f32(l.level) + l.fraction; y[2] = ln_rough(x[0] + 1e-9); y[3] = f32(level_count(u32(x[0] * 200.0)));";
    let gpu = probe.evaluate(&["shared/shadow"], body, &rows).unwrap();
    let cpu: Vec<[f32; 4]> = rows
        .iter()
        .map(|x| {
            let sigma = penumbra_sigma(x[0], x[1] > 1.3, x[1], x[2], x[3]);
            let (level, fraction) = level_of(sigma, 7);
            let count = level_count((x[0] * 200.0) as u32);
            [sigma, level as f32 + fraction, ln_rough(x[0] + 1e-9), count as f32]
        })
        .collect();
    assert!(cpu.iter().filter(|c| c[1] > 0.5 && c[1] < 5.5).count() > 100, "levels between the first and the last");
    assert_close("penumbra", &gpu, &cpu, 1e-4, 2e-5);

    // Two layers and a receiver: some before both, some between, some behind.
    for (evsm, filter) in [("false", ShadowFilter::Vsm), ("true", ShadowFilter::Evsm4)] {
        let layer = |x: f32| 0.2 + 0.6 * x;
        let row = |i| [layer(noise(i)), layer(noise(i + 900)), noise(i + 1800), layer(noise(i + 2700))];
        let rows: Vec<[f32; 4]> = (0..800).map(row).collect();
        let kind = u32::from(filter == ShadowFilter::Evsm4);
        let body = format!(
            "let m = mix(moments_of({kind}u, x[0]), moments_of({kind}u, x[1]), x[2]); \
             y[0] = occluder_depth({evsm}, m, x[3], 2e-7);"
        );
        let gpu: Vec<[f32; 1]> = probe.evaluate(&["shared/shadow"], &body, &rows).unwrap();
        let cpu: Vec<[f32; 1]> = rows
            .iter()
            .map(|r| {
                let (a, b) = (Vec4::from(moments_of(filter, r[0])), Vec4::from(moments_of(filter, r[1])));
                [occluder_depth(filter, a + (b - a) * r[2], r[3], 2e-7)]
            })
            .collect();
        let found = cpu.iter().zip(&rows).filter(|(c, r)| c[0] < r[3]).count();
        assert!(found > 300, "{found} occluders");
        assert_close("occluder_depth", &gpu, &cpu, 0.0, 2e-3);
    }
}

#[test]
fn exponential_moments() {
    let Some(probe) = probe() else { return };
    let rows: Vec<[f32; 1]> = (0..400).map(|i| [noise(i) * 1.4 - 0.2]).collect();
    let body = "let m = moments_of(1u, x[0]); y[0] = m.x; y[1] = m.y; y[2] = m.z; y[3] = m.w;";
    let gpu = probe.evaluate(&["shared/shadow"], body, &rows).unwrap();
    let cpu: Vec<_> = rows.iter().map(|r| moments_of(ShadowFilter::Evsm4, r[0])).collect();
    // exp of up to 40 multiplies the rounding of its argument by 40; its square doubles that.
    assert_close("moments_of", &gpu, &cpu, 2e-4, 0.0);

    let rows: Vec<[f32; 4]> = (0..800).map(|i| [noise(i), noise(i + 900), noise(i + 1800), noise(i + 2700)]).collect();
    let body =
        "let m = mix(moments_of(1u, x[0]), moments_of(1u, x[1]), x[2]); y[0] = evsm_visibility(m, x[3], 2e-7, 0.2);";
    let gpu = probe.evaluate(&["shared/shadow"], body, &rows).unwrap();
    let cpu: Vec<_> = rows
        .iter()
        .map(|r| {
            let (a, b) =
                (Vec4::from(moments_of(ShadowFilter::Evsm4, r[0])), Vec4::from(moments_of(ShadowFilter::Evsm4, r[1])));
            [evsm_visibility(a + (b - a) * r[2], r[3], 2e-7, 0.2)]
        })
        .collect();
    let partial = cpu.iter().filter(|v| v[0] > 0.01 && v[0] < 0.99).count();
    assert!(partial > 20, "{partial} partly lit");
    assert_close("evsm_visibility", &gpu, &cpu, 0.0, 5e-3);
}

#[test]
fn octahedral_maps() {
    let Some(probe) = probe() else { return };
    let rows: Vec<[f32; 3]> = (0..600)
        .map(|i| [noise(i) * 2.0 - 1.0, noise(i + 700) * 2.0 - 1.0, noise(i + 1400) * 2.0 - 1.0])
        .chain([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.5, 0.5, 0.0], [-0.25, 0.25, -0.5]])
        .collect();
    let body = "let v = vec3f(x[0], x[1], x[2]);
        let e = octahedron_coordinates(v, 1.0 / l1_length(v));
        let p = octahedron_point(vec2f(x[0], x[1]));
        y[0] = e.x; y[1] = e.y; y[2] = p.x; y[3] = p.y; y[4] = p.z;";
    let gpu = probe.evaluate(&["shared/vpl_maps"], body, &rows).unwrap();
    let cpu: Vec<_> = rows
        .iter()
        .map(|r| {
            let v = Vec3::from(*r);
            let e = octahedron_coordinates(v, 1.0 / (v.x.abs() + v.y.abs() + v.z.abs()));
            let p = octahedron_point(Vec2::new(r[0], r[1]));
            [e.x, e.y, p.x, p.y, p.z]
        })
        .collect();
    assert_close("octahedron", &gpu, &cpu, 0.0, 2e-6);

    let rows: Vec<[f32; 3]> = (0..600).map(|i| [noise(i) * 3.0, noise(i + 700) * 3.0, 0.2 + noise(i + 1400)]).collect();
    let body = "y[0] = texel_occlusion(x[0], x[1], x[2], 1.0 / x[2]);";
    let gpu = probe.evaluate(&["shared/vpl_maps"], body, &rows).unwrap();
    let cpu: Vec<_> = rows.iter().map(|r| [texel_occlusion(r[0], r[1], r[2], 1.0 / r[2])]).collect();
    // The slack multiplies roundings by 2/0.04.
    assert_close("texel_occlusion", &gpu, &cpu, 0.0, 1e-4);
}

#[test]
fn weights_of_the_light_grid() {
    let Some(probe) = probe() else { return };
    let vector = |i: u32| Vec3::new(noise(i) * 2.0 - 1.0, noise(i + 3000) * 2.0 - 1.0, noise(i + 6000) * 2.0 - 1.0);
    // Normals up to far apart, places from on the plane to beside it, and the place itself.
    let rows: Vec<[f32; 12]> = (0..2000)
        .map(|i| {
            let m = (vector(i) + Vec3::Z * 0.1).normalize();
            let n = (m + vector(i + 9000) * noise(i + 500)).normalize_or(m);
            let at = vector(i + 18_000) * 10.0;
            let along = m.cross(vector(i + 27_000));
            let to = along + m * (noise(i + 900) * 0.5 * along.length());
            let p = if i % 50 == 0 { at } else { at + to * 0.3 };
            [m, at, p, n].map(|v| v.to_array()).as_flattened().try_into().unwrap()
        })
        .collect();
    let of = |r: &[f32; 12], k: usize| Vec3::from_slice(&r[3 * k..]);
    let body = "y[0] = grid_likeness(vec3f(x[0], x[1], x[2]), vec3f(x[3], x[4], x[5]), vec3f(x[6], x[7], x[8]),
        vec3f(x[9], x[10], x[11]));";
    let gpu = probe.evaluate(&["shared/light_grid"], body, &rows).unwrap();
    let cpu: Vec<_> = rows
        .iter()
        .map(|r| {
            let g = GridPoint { normal: of(r, 0), position_world: of(r, 1), ..GridPoint::default() };
            [likeness(&g, of(r, 2), of(r, 3))]
        })
        .collect();
    let partial = cpu.iter().filter(|w| w[0] > 0.01 && w[0] < 0.99).count();
    let none = cpu.iter().filter(|w| w[0] == 0.0).count();
    assert!(partial > 100 && none > 100, "{partial} partly alike, {none} not at all");
    assert!(
        cpu.iter().step_by(50).zip(rows.iter().step_by(50)).all(|(w, r)| w[0] == 1.0 || of(r, 0).dot(of(r, 3)) < 0.9)
    );
    // The plane's span multiplies the roundings of places by 1/0.07, and those are 10 m from the origin.
    assert_close("grid_likeness", &gpu, &cpu, 0.0, 2e-4);

    let rows: Vec<[f32; 3]> = (0..400).map(|i| [noise(i), noise(i + 700), (i % 4) as f32]).collect();
    let body = "let i = u32(x[2]); let f = vec2f(x[0], x[1]);
        y[0] = grid_near_of_four(f, vec2u(i & 1u, i >> 1u)); y[1] = grid_near_of_sixteen(f * 4.0 - 2.0);";
    let gpu = probe.evaluate(&["shared/light_grid"], body, &rows).unwrap();
    let cpu: Vec<_> = rows
        .iter()
        .map(|r| [near_of_four(r[0], r[1], r[2] as usize), near_of_sixteen(r[0] * 4.0 - 2.0, r[1] * 4.0 - 2.0)])
        .collect();
    assert_close("grid_near", &gpu, &cpu, 1e-5, 1e-6);
}

#[test]
fn subsets_of_interleaved_vpls() {
    let Some(probe) = probe() else { return };
    // Length, subset, number of subsets; some of the lists are shorter than that.
    let rows: Vec<[f32; 3]> = [1u32, 4, 9, 16]
        .iter()
        .flat_map(|&m| [0u32, 1, 3, 15, 16, 17, 1023, 1024, 2500].map(|len| (len, m)))
        .flat_map(|(len, m)| (0..m).map(move |k| [len as f32, k as f32, m as f32]))
        .collect();
    let body = "let r = subset_range(u32(x[0]), u32(x[1]), u32(x[2])); y[0] = f32(r.x); y[1] = f32(r.y);";
    let gpu: Vec<[f32; 2]> = probe.evaluate(&["shared/interleave"], body, &rows).unwrap();
    for (g, r) in gpu.iter().zip(&rows) {
        let range = subset_range(r[0] as usize, r[1] as u32, r[2] as u32);
        assert_eq!(*g, [range.start as f32, range.end as f32], "{r:?}");
    }

    // Pictures whose sides are multiples of the block's, are not, and are smaller than it.
    for (width, height) in [(16u32, 12u32), (7, 5), (141, 9), (3, 2), (1, 6)] {
        for n in [1u32, 2, 4] {
            let pixels = || (0..height).flat_map(move |y| (0..width).map(move |x| (x, y)));
            let rows: Vec<[f32; 2]> = pixels().map(|(x, y)| [x as f32, y as f32]).collect();
            let body = format!(
                "let p = vec2u(u32(x[0]), u32(x[1])); let size = vec2u({width}u, {height}u);
                let span = filter_span(p, size, {n}u);
                y[0] = f32(span.x); y[1] = f32(span.y); y[2] = f32(span.z); y[3] = f32(span.w);
                let place = split_place(p, size, {n}u); y[4] = f32(place.x); y[5] = f32(place.y);
                let back = pixel_of_split(place, size, {n}u); y[6] = f32(back.x); y[7] = f32(back.y);"
            );
            let gpu: Vec<[f32; 8]> = probe.evaluate(&["shared/interleave"], &body, &rows).unwrap();
            // Columns and rows in the order of their residues.
            let order = |len: u32| {
                let mut list: Vec<u32> = (0..len).collect();
                list.sort_by_key(|c| c % n);
                list
            };
            let (columns, lines) = (order(width), order(height));
            for (g, (x, y)) in gpu.iter().zip(pixels()) {
                let (u, v) = (filter_span(x, width, n), filter_span(y, height, n));
                let [column, line] = [(&columns, x), (&lines, y)].map(|(l, c)| l.iter().position(|o| *o == c).unwrap());
                let cpu = [u.start, v.start, u.end, v.end, column as u32, line as u32, x, y];
                assert_eq!(*g, cpu.map(|v| v as f32), "pixel ({x}, {y}) of {width}x{height}, {n}");
                // The draw of its subset covers that place.
                let k = subset_of(x, y, n);
                let drawn = [subset_range(width as usize, k % n, n), subset_range(height as usize, k / n, n)];
                assert!(drawn[0].contains(&column) && drawn[1].contains(&line), "pixel ({x}, {y}), {n}");
            }
        }
    }
}

#[test]
fn surfaces_of_the_interleaving_filter() {
    let Some(probe) = probe() else { return };
    let vector = |i: u32| Vec3::new(noise(i) * 2.0 - 1.0, noise(i + 3000) * 2.0 - 1.0, noise(i + 6000) * 2.0 - 1.0);
    // Normals up to 40 degrees apart; places from on the plane to half as far off it as away, and the place itself.
    let rows: Vec<[f32; 12]> = (0..2000)
        .map(|i| {
            let n = (vector(i) + Vec3::Z * 0.1).normalize();
            let m = (n + vector(i + 9000).normalize() * (0.6 * noise(i + 500))).normalize();
            let at = vector(i + 18_000) * 10.0;
            let along = n.cross(vector(i + 27_000));
            let to = (along + n * (noise(i + 900) * 0.6 * along.length())) * 0.3;
            let (m, other) = if i % 50 == 0 { (n, at) } else { (m, at + to) };
            [at, n, other, m].map(|v| v.to_array()).as_flattened().try_into().unwrap()
        })
        .collect();
    let of = |r: &[f32; 12], k: usize| Vec3::from_slice(&r[3 * k..]);
    let body = "y[0] = f32(same_surface(vec3f(x[0], x[1], x[2]), vec3f(x[3], x[4], x[5]), vec3f(x[6], x[7], x[8]),
        vec3f(x[9], x[10], x[11])));";
    let gpu: Vec<[f32; 1]> = probe.evaluate(&["shared/interleave"], body, &rows).unwrap();
    let (mut same, mut other, mut near) = (0, 0, 0);
    for (row, (g, r)) in gpu.iter().zip(&rows).enumerate() {
        let guide = |k: usize| Guide { position_world: of(r, k), normal: of(r, k + 1), ..Guide::default() };
        let cpu = same_surface(&guide(0), &guide(2));
        assert!(cpu || row % 50 != 0, "a place counts at itself");
        // Rounding decides where both tests are within it of their bounds: the places are 10 m from the origin.
        let (to, n) = (of(r, 2) - of(r, 0), of(r, 1));
        let off = n.dot(to).abs() / to.length().max(1e-6);
        if (n.dot(of(r, 3)) - 0.95).abs() < 1e-6 || (off - 0.3).abs() < 1e-4 {
            near += 1;
            continue;
        }
        assert_eq!(g[0] > 0.5, cpu, "row {row}");
        same += u32::from(cpu);
        other += u32::from(!cpu);
    }
    assert!(same > 300 && other > 300 && near < 20, "{same} the same, {other} others, {near} undecided");
}
