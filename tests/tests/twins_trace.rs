//! Twins of the GPU tracer's own functions: edge functions in whole numbers, sample patterns, absorption.

use catoptra_engine::{
    glam::{DVec3, Vec3},
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

/// Rays and triangles in a cube of side 2, every fifth ray at a point of an edge.
fn rays_and_triangles() -> Vec<[f32; 15]> {
    (0..6000u32)
        .map(|i| {
            let v = |k: u32| {
                let n = |c: u32| noise(i * 64 + 3 * k + c) * 2.0 - 1.0;
                Vec3::new(n(0), n(1), n(2))
            };
            let (origin, a, b, c) = (v(0) * 3.0, v(1), v(2), v(3));
            let (u, w) = (noise(i * 64 + 20), noise(i * 64 + 21));
            let target = match i % 5 {
                0 => a + (b - a) * u,
                1 | 2 => a + (b - a) * (u * w) + (c - a) * (u * (1.0 - w)),
                _ => v(4),
            };
            let d = (target - origin).normalize();
            let mut row = [0.0; 15];
            for (k, p) in [origin, d, a, b, c].into_iter().enumerate() {
                row[3 * k..3 * k + 3].copy_from_slice(&p.to_array());
            }
            row
        })
        .collect()
}

fn point(row: &[f32; 15], k: usize) -> DVec3 {
    Vec3::from_slice(&row[3 * k..]).as_dvec3()
}

#[test]
fn rays_meet_a_triangle_where_double_precision_says() {
    let Some(probe) = probe() else { return };
    let rows = rays_and_triangles();
    let body = "let s = ray_space(vec3f(x[0], x[1], x[2]), vec3f(x[3], x[4], x[5]), 1.0, 1.0);
        let a = vec3f(x[6], x[7], x[8]); let b = vec3f(x[9], x[10], x[11]); let c = vec3f(x[12], x[13], x[14]);
        let f = intersect_fast(s, a, b, c); y[0] = f.x; y[1] = f.y; y[2] = f.z; y[3] = f.w;
        let e = intersect_exact(s, a, b, c); y[4] = e.x; y[5] = e.y; y[6] = e.z; y[7] = e.w;";
    let gpu: Vec<[f32; 8]> = probe.evaluate(&["shared/intersect"], body, &rows).unwrap();
    let (mut hits, mut misses, mut hard) = (0, 0, 0);
    for (r, g) in rows.iter().zip(&gpu) {
        let [o, d, a, b, c] = std::array::from_fn(|k| point(r, k));
        let (p, q) = (b - a, c - a);
        let n = p.cross(q);
        let det = -d.dot(n);
        // Where the ray grazes the plane, its place there is ill-conditioned in any precision.
        if det.abs() < 1e-2 * n.length() || n.length() < 1e-2 {
            continue;
        }
        let (t, m) = ((o - a).dot(n) / det, (o - a).cross(d));
        let (u, v) = (-q.dot(m) / -det, p.dot(m) / -det);
        let inside = u.min(v).min(1.0 - u - v);
        hard += u32::from(g[3] == 2.0);
        for got in [&g[..4], &g[4..]] {
            // 2: f32 does not decide, which whole numbers always do.
            match got[3] {
                1.0 => {
                    assert!(inside > -1e-4, "{r:?}: {got:?} for {inside}");
                    let off = [f64::from(got[0]) - t, f64::from(got[1]) - u, f64::from(got[2]) - v];
                    assert!(off.iter().all(|o| o.abs() < 2e-3), "{r:?}: {got:?} for {t}, {u}, {v}");
                    hits += 1;
                }
                0.0 => {
                    assert!(inside < 1e-4, "{r:?}: {got:?} for {inside}");
                    misses += 1;
                }
                other => assert!(other == 2.0 && got.as_ptr() == g.as_ptr(), "{r:?}: {g:?}"),
            }
        }
    }
    assert!(hits > 2000 && misses > 2000 && hard > 100, "{hits} hits, {misses} misses, {hard} hard");
}

#[test]
fn boxes_are_never_missed() {
    let Some(probe) = probe() else { return };
    let rows = rays_and_triangles();
    // The box of the second and third point, met between 0 and 100.
    let body = "let s = ray_space(vec3f(x[0], x[1], x[2]), vec3f(x[3], x[4], x[5]), 1.0, 1.0);
        let a = vec3f(x[6], x[7], x[8]); let b = vec3f(x[9], x[10], x[11]);
        y[0] = box_entry(bitcast<vec3u>(min(a, b)), bitcast<vec3u>(max(a, b)), s, 0.0, 100.0);";
    let gpu: Vec<[f32; 1]> = probe.evaluate(&["shared/intersect"], body, &rows).unwrap();
    let (mut met, mut passed) = (0, 0);
    for (r, g) in rows.iter().zip(&gpu) {
        let [o, d, a, b] = std::array::from_fn(|k| point(r, k));
        let interval = |pad: f64| {
            let (low, high) = ((a.min(b) - pad - o) / d, (a.max(b) + pad - o) / d);
            (low.min(high).max_element().max(0.0), low.max(high).min_element().min(100.0))
        };
        let got = f64::from(g[0]);
        let (enter, leave) = interval(0.0);
        if enter <= leave {
            // At most as far as the box is; never -1.
            assert!((0.0..=enter + 1e-6).contains(&got), "{r:?}: {got} for {enter}");
            met += 1;
        }
        let (enter, leave) = interval(1e-4);
        if enter > leave {
            assert_eq!(got, -1.0, "{r:?}");
            passed += 1;
        }
    }
    assert!(met > 500 && passed > 500, "{met} met, {passed} passed");
}

#[test]
fn places_directions_and_normals_of_instances() {
    let Some(probe) = probe() else { return };
    use catoptra_engine::glam::Affine3;
    let place = Affine3::from_translation(Vec3::new(3.0, -2.0, 0.5))
        * Affine3::from_rotation_y(0.7)
        * Affine3::from_scale(Vec3::new(1.5, -0.4, 2.0))
        * Affine3::from_rotation_x(0.3);
    let m = place.matrix3;
    let cofactor = m.inverse().transpose() * m.determinant() * m.determinant().signum();
    let vec = |n: Vec3| format!("vec3f({:e}, {:e}, {:e})", n.x, n.y, n.z);
    let rows = [0, 1, 2].map(|k| {
        let r = m.row(k);
        format!("vec4f({:e}, {:e}, {:e}, {:e})", r.x, r.y, r.z, place.translation[k])
    });
    let normals = [0, 1, 2].map(|k| format!("{}, 0u", vec(cofactor.row(k))));
    let body = format!(
        "let i = Instance({}, {}); let v = vec3f(x[0], x[1], x[2]);
        let p = point_world_from_object(i, v); y[0] = p.x; y[1] = p.y; y[2] = p.z;
        let d = direction_world_from_object(i, v); y[3] = d.x; y[4] = d.y; y[5] = d.z;
        let n = normal_world_from_object(i, v); y[6] = n.x; y[7] = n.y; y[8] = n.z;",
        rows.join(", "),
        normals.join(", ")
    );
    let inputs: Vec<[f32; 3]> = (0..300).map(|i| [0, 1, 2].map(|k| noise(3 * i + k) * 4.0 - 2.0)).collect();
    let gpu: Vec<[f32; 9]> = probe.evaluate(&["shared/scene"], &body, &inputs).unwrap();
    for (v, g) in inputs.iter().zip(&gpu) {
        let v = Vec3::from(*v);
        let expected = [place.transform_point3(v), place.transform_vector3(v), cofactor * v];
        for (k, e) in expected.into_iter().enumerate() {
            assert!((e - Vec3::from_slice(&g[3 * k..])).abs().max_element() < 1e-5, "{v}: {g:?} for {e}");
        }
        // What a normal is for: it stays across what lies in the surface.
        let tangent = v.normalize().any_orthonormal_vector();
        assert!(place.transform_vector3(tangent).dot(Vec3::from_slice(&g[6..])).abs() < 1e-4);
    }
}
