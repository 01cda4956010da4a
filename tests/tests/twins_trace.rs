//! Twins of the GPU tracer's own functions: edge functions in whole numbers, sample patterns, absorption.

use catoptra_engine::{
    glam::Vec3,
    math::{self, orthonormal_basis},
};
use catoptra_render_hybrid::{
    raster::testing::ShaderProbe,
    trace::sampling::{hash_combine, hash_u32, unit_f32, vogel_disc},
    twin::shading::beer_lambert,
};
use catoptra_tests::opened_or_skip;

fn probe() -> Option<ShaderProbe> {
    opened_or_skip("twins_trace", ShaderProbe::new())
}

fn noise(i: u32) -> f32 {
    unit_f32(hash_u32(i.wrapping_add(77)))
}

/// A number some units in the last place from `x`.
fn near(x: f32, ulps: i32) -> f32 {
    f32::from_bits((x.to_bits() as i32 + ulps) as u32)
}

#[test]
fn edge_functions_have_the_right_sign_whatever_cancels() {
    let Some(probe) = probe() else { return };
    let rows: Vec<[f32; 4]> = (0..20_000u32)
        .map(|i| {
            let sign = |k: u32| if hash_u32(i ^ k) & 1 == 0 { 1.0 } else { -1.0 };
            let scale = [1.0, 1e-3, 1e-6][i as usize % 3];
            let (a, b) = ((noise(4 * i) + 0.01) * sign(1), (noise(4 * i + 1) + 0.01) * sign(2) * scale);
            match i % 5 {
                // Nearly or exactly equal products, in either order of the factors.
                0 => [a, b, near(a, (hash_u32(i) % 7) as i32 - 3), near(b, (hash_u32(i ^ 9) % 7) as i32 - 3)],
                1 => [a, b, near(b, (hash_u32(i) % 3) as i32 - 1), near(a, (hash_u32(i ^ 5) % 3) as i32 - 1)],
                2 => [a, b, a * 2.0, b * 0.5],
                3 => [a, b, 0.0, b],
                _ => [a, b, noise(4 * i + 2) * sign(3), noise(4 * i + 3) * sign(4)],
            }
        })
        .collect();
    let gpu = probe.evaluate(&["shared/intersect"], "y[0] = exact_difference(x[0], x[1], x[2], x[3]);", &rows).unwrap();
    let (mut zeros, mut wrong_in_f32) = (0, 0);
    for (r, g) in rows.iter().zip(&gpu) {
        let [a, b, c, d] = r.map(f64::from);
        // Products of f32 are exact in f64, and so is the sign of their difference.
        let (p, q) = (a * b, c * d);
        let truth = p - q;
        let got: [f32; 1] = *g;
        assert_eq!(f64::from(got[0]).partial_cmp(&0.0), truth.partial_cmp(&0.0), "{r:?}: {} for {truth:e}", got[0]);
        assert!((f64::from(got[0]) - truth).abs() <= 3e-7 * truth.abs(), "{r:?}: {} for {truth:e}", got[0]);
        zeros += u32::from(truth == 0.0);
        wrong_in_f32 += u32::from((r[0] * r[1] - r[2] * r[3] == 0.0) != (truth == 0.0));
    }
    assert!(zeros > 1000 && wrong_in_f32 > 100, "the table must hold what f32 gets wrong: {zeros}, {wrong_in_f32}");
}

#[test]
fn sample_patterns() {
    let Some(probe) = probe() else { return };
    let rows: Vec<[f32; 2]> = (0..2000).map(|i| [(i * 37 % 4096) as f32, (i % 19) as f32]).collect();
    let body = "y[0] = unit_f32(hash_combine(u32(x[0]), u32(x[1]))); y[1] = unit_f32(hash_u32(u32(x[0])));
        let v = vogel_disc(u32(x[1]), 19u, x[0] * 0.001); y[2] = v.x; y[3] = v.y;";
    let gpu: Vec<[f32; 4]> = probe.evaluate(&["shared/sampling"], body, &rows).unwrap();
    for (r, g) in rows.iter().zip(&gpu) {
        let (a, b) = (r[0] as u32, r[1] as u32);
        assert_eq!((g[0], g[1]), (unit_f32(hash_combine(a, b)), unit_f32(hash_u32(a))), "{r:?}");
        let v = vogel_disc(b, 19, r[0] * 0.001);
        // Sine and cosine of tens of radians.
        assert!((v.x - g[2]).abs() < 2e-4 && (v.y - g[3]).abs() < 2e-4, "{r:?}: {g:?} for {v}");
    }
    let directions: Vec<[f32; 3]> = (0..500)
        .map(|i| (Vec3::new(noise(3 * i), noise(3 * i + 1), noise(3 * i + 2)) * 2.0 - 1.0).normalize().to_array())
        .chain([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
        .collect();
    let body = "let m = orthonormal_basis(vec3f(x[0], x[1], x[2]));
        y[0] = m[0].x; y[1] = m[0].y; y[2] = m[0].z; y[3] = m[1].x; y[4] = m[1].y; y[5] = m[1].z;";
    let gpu: Vec<[f32; 6]> = probe.evaluate(&["shared/sampling"], body, &directions).unwrap();
    for (d, g) in directions.iter().zip(&gpu) {
        let (t, b) = orthonormal_basis(Vec3::from(*d));
        let off = [t.x - g[0], t.y - g[1], t.z - g[2], b.x - g[3], b.y - g[4], b.z - g[5]];
        assert!(off.iter().all(|o| o.abs() < 1e-4), "{d:?}");
    }
}

#[test]
fn absorption() {
    let Some(probe) = probe() else { return };
    let rows: Vec<[f32; 5]> = (0..1000)
        .map(|i| {
            let distance = [0.0, 0.3, 5.0, 40.0][i as usize % 4];
            let reach = [0.5, 2.0, f32::MAX][i as usize % 3];
            [noise(3 * i), noise(3 * i + 1).max(0.01), 1.0, reach, distance]
        })
        .collect();
    let body = "let a = beer_lambert(vec3f(x[0], x[1], x[2]), x[3], x[4]); y[0] = a.x; y[1] = a.y; y[2] = a.z;";
    let gpu: Vec<[f32; 3]> = probe.evaluate(&["shared/shading"], body, &rows).unwrap();
    for (r, g) in rows.iter().zip(&gpu) {
        let reach = if r[3] == f32::MAX { f32::INFINITY } else { r[3] };
        let cpu = beer_lambert(Vec3::new(r[0], r[1], r[2]), reach, r[4]);
        assert!((cpu - Vec3::from(*g)).abs().max_element() < 2e-5, "{r:?}: {g:?} for {cpu}");
    }
    // The mutation: twice the way is not the same.
    let twice = beer_lambert(Vec3::splat(0.5), 1.0, 2.0);
    assert!((math::pow(0.5, 1.0) - twice.x).abs() > 0.1);
}
