//! Twins: every function that Rust and WGSL share gives the same numbers on both, over tables of inputs.
//!
//! The GPU may contract a·b+c, and its `sqrt`, `pow` and division are within a few units in the last place; tolerances say so.

use catoptra_engine::{
    Camera, Light, LightKind, Projection, Texture, TextureRef, Wrap,
    camera::world_from_view_looking_at,
    glam::{Vec2, Vec3},
    light::spot_falloff,
    material::POLISHED,
    texture::wrap_texel,
};
use catoptra_render_hybrid::{
    raster::testing::ShaderProbe,
    twin::{
        shading,
        shadow::{ShadowMaps, ShadowPlan, ShadowView, chebyshev_upper_bound, cube_face, shadow_project},
        vpl::{self, Vpl},
    },
};
use catoptra_tests::opened_or_skip;

/// Plain 32-bit float arithmetic, a few roundings: relative to the greater of the value and 1.
const ARITHMETIC: f32 = 2e-6;
/// `pow` with exponents in the hundreds: the logarithm's rounding is multiplied by the exponent.
const POWER: f32 = 2e-4;

fn probe() -> Option<ShaderProbe> {
    opened_or_skip("twins", ShaderProbe::new())
}

/// Numbers in [0, 1) that are the same on every run.
fn noise(i: u32) -> f32 {
    let mut h = i.wrapping_mul(0x9E37_79B9) ^ 0x85EB_CA6B;
    h = (h ^ (h >> 16)).wrapping_mul(0x7FEB_352D);
    h = (h ^ (h >> 15)).wrapping_mul(0x846C_A68B);
    ((h ^ (h >> 16)) >> 8) as f32 / (1u32 << 24) as f32
}

fn vector(i: u32, scale: f32) -> Vec3 {
    (Vec3::new(noise(3 * i), noise(3 * i + 1), noise(3 * i + 2)) * 2.0 - 1.0) * scale
}

fn unit(i: u32) -> Vec3 {
    vector(i, 1.0).normalize_or(Vec3::Y)
}

fn assert_close<const M: usize>(name: &str, gpu: &[[f32; M]], cpu: &[[f32; M]], tolerance: f32) {
    assert_eq!(gpu.len(), cpu.len());
    for (row, (g, c)) in gpu.iter().zip(cpu).enumerate() {
        for (i, (a, b)) in g.iter().zip(c).enumerate() {
            let bound = tolerance * b.abs().max(1.0);
            assert!((a - b).abs() <= bound, "{name}, row {row}, number {i}: GPU {a}, CPU {b}");
        }
    }
}

#[test]
fn spot_falloff_and_incident() {
    let Some(probe) = probe() else { return };
    let rows: Vec<[f32; 3]> = (0..500).map(|i| [noise(i) * 2.0 - 1.0, 0.9, noise(i + 999) * 0.9]).collect();
    let gpu = probe.evaluate(&["shared/light"], "y[0] = spot_falloff(x[0], x[1], x[2]);", &rows).unwrap();
    let cpu: Vec<_> = rows.iter().map(|r| [spot_falloff(r[0], r[1], r[2])]).collect();
    // The slope of the falloff multiplies the rounding of the cosine's difference.
    assert_close("spot_falloff", &gpu, &cpu, 1e-5);

    for (number, kind) in [LightKind::Point, LightKind::Spot { cos_inner: 0.8, cos_outer: 0.3 }, LightKind::Directional]
        .into_iter()
        .enumerate()
    {
        let light = Light {
            stable_id: 0,
            kind,
            position_world: Vec3::new(0.4, 2.0, -0.3),
            direction_world: Vec3::new(0.6, -0.8, 0.0),
            up_world: Vec3::Z,
            intensity: Vec3::new(3.0, 2.0, 1.0),
            radius: 0.1,
        };
        let rows: Vec<[f32; 3]> = (0..500)
            .map(|i| vector(i, 3.0).to_array())
            // The light's own place gives no light.
            .chain([light.position_world.to_array()])
            .collect();
        let (p, d, l) = (light.position_world, light.direction_world, light.intensity);
        let body = format!(
            "let light = Light(vec3f({:?}, {:?}, {:?}), {number}u, vec3f({:?}, {:?}, {:?}), 0.8, vec3f({:?}, {:?}, {:?}), 0.3,
                0u, 1u, 0u, 0u);
            let i = incident(light, vec3f(x[0], x[1], x[2]));
            y[0] = i.wi.x; y[1] = i.wi.y; y[2] = i.wi.z; y[3] = i.distance;
            y[4] = i.irradiance.x; y[5] = i.irradiance.y; y[6] = i.irradiance.z;",
            p.x, p.y, p.z, d.x, d.y, d.z, l.x, l.y, l.z
        );
        let gpu: Vec<[f32; 7]> = probe.evaluate(&["shared/light"], &body, &rows).unwrap();
        let cpu: Vec<_> = rows
            .iter()
            .map(|r| {
                let (wi, distance, e) = light.incident(Vec3::from(*r));
                // WGSL holds no infinity: the greatest number stands for it.
                [wi.x, wi.y, wi.z, distance.min(f32::MAX), e.x, e.y, e.z]
            })
            .collect();
        assert_close(&format!("incident {kind:?}"), &gpu, &cpu, 1e-5);
    }
}

#[test]
fn shading_functions() {
    let Some(probe) = probe() else { return };
    let rows: Vec<[f32; 10]> = (0..1000)
        .map(|i| {
            let (n, wi, wo) = (unit(i), unit(i + 5000), unit(i + 9000));
            // Every tenth: light exactly behind, which has no half vector.
            let wo = if i % 10 == 0 { -wi } else { wo };
            let shininess = [0.0, 1.0, 10.0, 100.0, 400.0][i as usize % 5];
            [n.x, n.y, n.z, wi.x, wi.y, wi.z, wo.x, wo.y, wo.z, shininess]
        })
        .collect();
    let at = |r: &[f32; 10], i: usize| Vec3::new(r[i], r[i + 1], r[i + 2]);
    let body =
        "y[0] = blinn_phong_lobe(vec3f(x[0], x[1], x[2]), vec3f(x[3], x[4], x[5]), vec3f(x[6], x[7], x[8]), x[9]);
        y[1] = blinn_phong_normalization(x[9]);";
    let gpu = probe.evaluate(&["shared/shading"], body, &rows).unwrap();
    let cpu: Vec<_> = rows
        .iter()
        .map(|r| {
            let lobe = shading::blinn_phong_lobe(at(r, 0), at(r, 3), at(r, 6), r[9]);
            [lobe, shading::blinn_phong_normalization(r[9])]
        })
        .collect();
    assert_close("blinn_phong_lobe", &gpu, &cpu, POWER);

    let body = "let r = reflect_view(vec3f(x[3], x[4], x[5]), vec3f(x[0], x[1], x[2]));
        y[0] = r.x; y[1] = r.y; y[2] = r.z;";
    let gpu = probe.evaluate(&["shared/shading"], body, &rows).unwrap();
    let cpu: Vec<_> = rows.iter().map(|r| shading::reflect(at(r, 3), at(r, 0)).to_array()).collect();
    assert_close("reflect", &gpu, &cpu, ARITHMETIC);

    let body = "let t = refract_travel(vec3f(x[3], x[4], x[5]), vec3f(x[0], x[1], x[2]), x[9]);
        y[0] = t.x; y[1] = t.y; y[2] = t.z; y[3] = t.w;";
    let rows: Vec<[f32; 10]> = rows
        .iter()
        .enumerate()
        .map(|(i, r)| {
            // Travel against the normal.
            let (n, d) = (at(r, 0), at(r, 3));
            let d = if n.dot(d) > 0.0 { -d } else { d };
            let eta = [1.0 / 1.5, 1.5, 1.0][i % 3];
            [n.x, n.y, n.z, d.x, d.y, d.z, 0.0, 0.0, 0.0, eta]
        })
        // At the critical angle a rounding decides between both answers.
        .filter(|r| {
            let cos_i = -at(r, 0).dot(at(r, 3));
            (r[9] * r[9] * (1.0 - cos_i * cos_i) - 1.0).abs() > 1e-3
        })
        .collect();
    let gpu = probe.evaluate(&["shared/shading"], body, &rows).unwrap();
    let cpu: Vec<_> = rows
        .iter()
        .map(|r| shading::refract(at(r, 3), at(r, 0), r[9]).map_or([0.0; 4], |t| t.extend(1.0).to_array()))
        .collect();
    assert!(cpu.iter().any(|r| r[3] == 0.0) && cpu.iter().any(|r| r[3] == 1.0));
    assert_close("refract", &gpu, &cpu, 1e-4);

    // f32 loses the sine's complement near the critical angle, where the slope is infinite: kept away from it.
    let rows: Vec<[f32; 2]> = (0..1000)
        .map(|i| [noise(i), [1.0 / 1.5, 1.5, 1.0 / 2.4][i as usize % 3]])
        .filter(|r| (r[1] * r[1] * (1.0 - r[0] * r[0]) - 1.0).abs() > 1e-3)
        .collect();
    let body = "y[0] = fresnel_dielectric(x[0], x[1]); let s = schlick(vec3f(0.1, 0.5, 1.0), x[0]);
        y[1] = s.x; y[2] = s.y; y[3] = s.z;";
    let gpu = probe.evaluate(&["shared/shading"], body, &rows).unwrap();
    let cpu: Vec<_> = rows
        .iter()
        .map(|r| {
            let s = shading::schlick(Vec3::new(0.1, 0.5, 1.0), r[0]);
            [shading::fresnel_dielectric(r[0], r[1]), s.x, s.y, s.z]
        })
        .collect();
    assert_close("fresnel_dielectric", &gpu, &cpu, 2e-5);
}

fn views() -> Vec<ShadowView> {
    let light = |kind| Light {
        stable_id: 0,
        kind,
        position_world: Vec3::new(0.2, 1.5, 0.1),
        direction_world: Vec3::new(0.0, -0.8, 0.6),
        up_world: Vec3::X,
        intensity: Vec3::ONE,
        radius: 0.0,
    };
    let lights = [LightKind::Point, LightKind::Spot { cos_inner: 0.9, cos_outer: 0.7 }, LightKind::Directional];
    let bounds = catoptra_engine::Aabb { min: Vec3::splat(-2.0), max: Vec3::splat(2.0) };
    ShadowPlan::new(&lights.map(light), bounds, &Default::default()).views
}

#[test]
fn shadow_functions() {
    let Some(probe) = probe() else { return };
    for view in views() {
        let rows: Vec<[f32; 3]> = (0..500)
            .map(|i| vector(i, 2.0))
            // Close to the plane of the light both divide by almost nothing.
            .filter(|p| (view.forward.dot(*p - view.origin_world)).abs() > 0.05)
            .map(|p| p.to_array())
            .collect();
        let v = |v: Vec3| format!("vec3f({:?}, {:?}, {:?})", v.x, v.y, v.z);
        let body = format!(
            "let view = ShadowView({}, {:?}, {}, {:?}, {}, {}u, {}, 0.0);
            let c = shadow_project(view, vec3f(x[0], x[1], x[2]));
            y[0] = c.uv.x; y[1] = c.uv.y; y[2] = c.depth; y[3] = f32(c.in_front);",
            v(view.origin_world),
            view.far,
            v(view.right_scaled),
            view.perspective,
            v(view.up_scaled),
            view.size,
            v(view.forward)
        );
        let gpu = probe.evaluate(&["shared/shadow"], &body, &rows).unwrap();
        let cpu: Vec<_> = rows
            .iter()
            .map(|r| {
                let c = shadow_project(&view, Vec3::from(*r));
                [c.uv.x, c.uv.y, c.depth, f32::from(u8::from(c.in_front))]
            })
            .collect();
        // Coordinates of points near the light's plane are many maps away.
        assert_close("shadow_project", &gpu, &cpu, 2e-5);
    }

    let rows: Vec<[f32; 3]> = (0..1000)
        .map(|i| {
            let mean = noise(i);
            [mean, mean * mean + noise(i + 7000) * 0.01, if i % 5 == 0 { mean } else { noise(i + 3000) }]
        })
        .collect();
    let body = "y[0] = chebyshev_upper_bound(vec2f(x[0], x[1]), x[2], 2e-7, 0.2);";
    let gpu = probe.evaluate(&["shared/shadow"], body, &rows).unwrap();
    let cpu: Vec<_> = rows.iter().map(|r| [chebyshev_upper_bound(Vec2::new(r[0], r[1]), r[2], 2e-7, 0.2)]).collect();
    // A variance of a few millionths is the difference of two numbers near 1.
    assert_close("chebyshev_upper_bound", &gpu, &cpu, 2e-3);
    assert!(rows.iter().zip(&gpu).filter(|(r, _)| r[2] <= r[0]).all(|(_, g)| g[0] == 1.0), "exactly 1 before the mean");

    let rows: Vec<[f32; 3]> = (0..500)
        .map(|i| vector(i, 1.0).to_array())
        .chain([[1.0, 1.0, 1.0], [-1.0, 1.0, -1.0], [0.0, 1.0, 1.0], [0.0, -1.0, 1.0], [0.0, 0.0, -1.0], [0.0; 3]])
        .collect();
    let gpu = probe.evaluate(&["shared/shadow"], "y[0] = f32(cube_face(vec3f(x[0], x[1], x[2])));", &rows).unwrap();
    let cpu: Vec<_> = rows.iter().map(|r| [cube_face(Vec3::from(*r)) as f32]).collect();
    assert_close("cube_face", &gpu, &cpu, 0.0);
}

#[test]
fn vpl_functions() {
    let Some(probe) = probe() else { return };
    let rows: Vec<[f32; 13]> = (0..1000)
        .map(|i| {
            let (p, v) = (vector(i, 1.0), vector(i + 4000, 1.0));
            // Every tenth lies at the lit point itself.
            let v = if i % 10 == 0 { p } else { v };
            let (n, m) = (unit(i + 8000), unit(i + 6000));
            [p.x, p.y, p.z, n.x, n.y, n.z, v.x, v.y, v.z, m.x, m.y, m.z, [0.5, 20.0, f32::MAX][i as usize % 3]]
        })
        .collect();
    let body = "var v: Vpl;
        v.position_world = vec3f(x[6], x[7], x[8]);
        v.normal_world = vec3f(x[9], x[10], x[11]);
        v.flux = vec3f(1.0, 2.0, 3.0);
        let e = vpl_irradiance(v, vec3f(x[0], x[1], x[2]), vec3f(x[3], x[4], x[5]), x[12]);
        y[0] = e.x; y[1] = e.y; y[2] = e.z;
        y[3] = geometry_term(v.position_world - vec3f(x[0], x[1], x[2]), vec3f(x[3], x[4], x[5]), v.normal_world, x[12]);";
    let gpu = probe.evaluate(&["shared/vpl"], body, &rows).unwrap();
    let at = |r: &[f32; 13], i: usize| Vec3::new(r[i], r[i + 1], r[i + 2]);
    let cpu: Vec<_> = rows
        .iter()
        .map(|r| {
            let flux = Vec3::new(1.0, 2.0, 3.0);
            let vpl = Vpl { position_world: at(r, 6), normal_world: at(r, 9), flux, ..Vpl::default() };
            let e = vpl::vpl_irradiance(&vpl, at(r, 0), at(r, 3), r[12]);
            let g = vpl::geometry_term(at(r, 6) - at(r, 0), at(r, 3), at(r, 9), r[12]);
            [e.x, e.y, e.z, g]
        })
        .collect();
    assert_close("vpl_irradiance", &gpu, &cpu, 2e-5);
}

#[test]
fn texture_functions() {
    let Some(probe) = probe() else { return };
    let wraps = [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror];
    let rows: Vec<[f32; 3]> = (0..3u32)
        .flat_map(|w| (-20..20).flat_map(move |i| [1u32, 2, 3, 7].map(|n| [i as f32, n as f32, w as f32])))
        .collect();
    let body = "y[0] = f32(wrap_texel(i32(x[0]), u32(x[1]), u32(x[2])));";
    let gpu = probe.evaluate(&["shared/texture"], body, &rows).unwrap();
    let cpu: Vec<_> =
        rows.iter().map(|r| [wrap_texel(r[0] as i32, r[1] as u32, wraps[r[2] as usize]) as f32]).collect();
    assert_close("wrap_texel", &gpu, &cpu, 0.0);

    // A texture whose texel number is its colour: the footprint's weighted sum is what the CPU samples.
    let (width, height) = (5u32, 3u32);
    let texels: Vec<[u8; 4]> = (0..width * height).map(|i| [(i * 17) as u8, 0, 0, 255]).collect();
    let texture = Texture::new(width, height, texels, false).unwrap();
    let transform = [[1.5f32, 0.25, 0.125], [-0.5, 2.0, 0.375]];
    for (w, wrap) in wraps.into_iter().enumerate() {
        for nearest in [false, true] {
            let r = TextureRef { wrap: [wrap, wrap], nearest, uv_transform: transform, ..TextureRef::default() };
            let rows: Vec<[f32; 2]> = (0..500).map(|i| [noise(i) * 6.0 - 3.0, noise(i + 700) * 6.0 - 3.0]).collect();
            let body = format!(
                "let r = TextureRef(vec3f(1.5, 0.25, 0.125), 5u, vec3f(-0.5, 2.0, 0.375), 3u, 0u, {w}u, {w}u, {});
                let f = texture_footprint(r, vec2f(x[0], x[1]));
                let t = vec4f(f.texels * 17u) / 255.0;
                let top = t.x * (1.0 - f.fraction.x) + t.y * f.fraction.x;
                let bottom = t.z * (1.0 - f.fraction.x) + t.w * f.fraction.x;
                y[0] = top * (1.0 - f.fraction.y) + bottom * f.fraction.y;",
                if nearest { "TEXTURE_NEAREST" } else { "0u" }
            );
            let gpu = probe.evaluate(&["shared/texture"], &body, &rows).unwrap();
            let cpu: Vec<_> = rows.iter().map(|&uv| [texture.sample(&r, Vec2::from(uv)).x]).collect();
            assert_close(&format!("texture {wrap:?} nearest {nearest}"), &gpu, &cpu, 2e-5);
        }
    }
}

#[test]
fn camera_rays_and_octahedral_normals() {
    let Some(probe) = probe() else { return };
    let pose = world_from_view_looking_at(Vec3::new(1.0, 2.0, 3.0), Vec3::new(-0.5, 0.0, 0.3));
    for projection in [Projection::Perspective { fov_y: 0.9 }, Projection::Orthographic { half_height: 1.7 }] {
        let camera = Camera { world_from_view: pose, projection, near: 0.01 };
        let (half_width, half_height) = camera.half_extent(40, 30);
        let v = |v: Vec3| format!("vec3f({:?}, {:?}, {:?})", v.x, v.y, v.z);
        let orthographic = u32::from(matches!(projection, Projection::Orthographic { .. }));
        let body = format!(
            "var frame: Frame;
            frame.orthographic = {orthographic}u; frame.size = vec2u(40u, 30u); frame.near = 0.01; frame.far = 100.0;
            frame.eye_world = {}; frame.half_width = {half_width:?}; frame.half_height = {half_height:?};
            frame.right_world = {}; frame.up_world = {}; frame.forward_world = {};
            let r = camera_ray(frame, vec2f(x[0], x[1]));
            y[0] = r.origin.x; y[1] = r.origin.y; y[2] = r.origin.z;
            y[3] = r.direction.x; y[4] = r.direction.y; y[5] = r.direction.z;
            // A point on the ray falls on the pixel that it came from, inside the depth range.
            let c = clip_from_world(frame, r.origin + r.direction * 5.0);
            y[6] = (0.5 + 0.5 * c.x / c.w) * 40.0; y[7] = (0.5 - 0.5 * c.y / c.w) * 30.0;
            y[8] = f32(c.z > 0.0 && c.z < c.w);",
            v(pose.translation),
            v(pose.matrix3.x_axis),
            v(pose.matrix3.y_axis),
            v(-pose.matrix3.z_axis)
        );
        let rows: Vec<[f32; 2]> = (0..300).map(|i| [noise(i) * 40.0, noise(i + 500) * 30.0]).collect();
        let gpu = probe.evaluate(&["shared/camera"], &body, &rows).unwrap();
        let cpu: Vec<_> = rows
            .iter()
            .map(|r| {
                let (o, d) = camera.ray(r[0], r[1], 40, 30);
                [o.x, o.y, o.z, d.x, d.y, d.z, r[0], r[1], 1.0]
            })
            .collect();
        assert_close("camera_ray", &gpu, &cpu, 2e-5);
    }

    let rows: Vec<[f32; 3]> = (0..500)
        .map(|i| unit(i).to_array())
        .chain([Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z].map(|v| v.to_array()))
        .collect();
    let body = "let n = octahedral_decode(octahedral_encode(vec3f(x[0], x[1], x[2])));
        y[0] = n.x; y[1] = n.y; y[2] = n.z;";
    let gpu = probe.evaluate(&["shared/octahedral"], body, &rows).unwrap();
    assert_close("octahedral", &gpu, &rows, ARITHMETIC);
}

#[test]
fn barycentrics_of_points_on_a_triangle() {
    let Some(probe) = probe() else { return };
    for scale in [1e-6f32, 1.0, 1e6] {
        let (p0, p1, p2) = (Vec3::new(0.1, 0.2, -3.0), Vec3::new(1.3, -0.1, -2.5), Vec3::new(-0.2, 1.1, -3.5));
        let rows: Vec<[f32; 14]> = (0..300)
            .map(|i| {
                let (a, b) = (noise(i), noise(i + 900));
                let (u, v) = if a + b < 1.0 { (a, b) } else { (1.0 - a, 1.0 - b) };
                let target = p0 * (1.0 - u - v) + p1 * u + p2 * v;
                let origin = vector(i, 0.5);
                let d = (target - origin).normalize();
                let (o, [a, b]) = (origin * scale, [p0, p1].map(|p| p * scale));
                [o.x, o.y, o.z, d.x, d.y, d.z, a.x, a.y, a.z, b.x, b.y, b.z, u, v]
            })
            .collect();
        let c = p2 * scale;
        let body = format!(
            "let w = plane_barycentrics(vec3f(x[0], x[1], x[2]), vec3f(x[3], x[4], x[5]), vec3f(x[6], x[7], x[8]),
                vec3f(x[9], x[10], x[11]), vec3f({:?}, {:?}, {:?}));
            y[0] = w.x; y[1] = w.y;",
            c.x, c.y, c.z
        );
        let gpu = probe.evaluate(&["shared/triangle"], &body, &rows).unwrap();
        let cpu: Vec<_> = rows.iter().map(|r| [r[12], r[13]]).collect();
        assert_close("plane_barycentrics", &gpu, &cpu, 1e-5);
    }
}

/// What the rasteriser of moments makes of a place is where shadows are looked up.
#[test]
fn places_on_moment_maps() {
    let Some(probe) = probe() else { return };
    for view in views() {
        let rows: Vec<[f32; 3]> = (0..500)
            .map(|i| vector(i, 2.0))
            .filter(|p| view.forward.dot(*p - view.origin_world) > 0.05)
            .map(|p| p.to_array())
            .collect();
        assert!(rows.len() > 50);
        let v = |v: Vec3| format!("vec3f({:?}, {:?}, {:?})", v.x, v.y, v.z);
        let body = format!(
            "let view = ShadowView({}, {:?}, {}, {:?}, {}, {}u, {}, 0.0);
            let m = moments_vertex(view, vec3f(x[0], x[1], x[2]));
            let at = m.position_clip.xy / m.position_clip.w;
            y[0] = 0.5 + 0.5 * at.x; y[1] = 0.5 - 0.5 * at.y; y[2] = m.depth;
            y[3] = m.position_clip.z / m.position_clip.w;",
            v(view.origin_world),
            view.far,
            v(view.right_scaled),
            view.perspective,
            v(view.up_scaled),
            view.size,
            v(view.forward),
        );
        let gpu: Vec<[f32; 4]> = probe.evaluate(&["shared/moments"], &body, &rows).unwrap();
        let cpu: Vec<[f32; 3]> = rows
            .iter()
            .map(|r| {
                let c = shadow_project(&view, Vec3::from(*r));
                [c.uv.x, c.uv.y, c.depth]
            })
            .collect();
        let places: Vec<[f32; 3]> = gpu.iter().map(|g| [g[0], g[1], g[2]]).collect();
        assert_close("moments_vertex", &places, &cpu, 1e-4);
        // Nearer is greater: reversed depth.
        let mut by_depth = gpu;
        by_depth.sort_by(|a, b| a[2].total_cmp(&b[2]));
        assert!(by_depth.windows(2).all(|w| w[0][3] >= w[1][3] && w[0][2] <= w[1][2]));
    }
}

/// The G-buffer's packed factors come back to half a step, on the same side of what decides between kinds of surface.
#[test]
fn packed_places_and_reflectances() {
    let Some(probe) = probe() else { return };
    let edge = |i: u32, v: f32| [0.0, 1.0, 1e-6, 1.0 - 1e-6, POLISHED, POLISHED + 1e-5, v, v][i as usize % 8];
    let rows: Vec<[f32; 8]> = (0..4000)
        .map(|i| {
            let n = |k: u32| noise(i + 5000 * k);
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| edge((n(k + 10) * 8.0) as u32, n(k)));
            [a, b, c, d, n(5), n(6), edge((n(20) * 8.0) as u32, n(7)), f32::from(u8::from(i % 2 == 0))]
        })
        .collect();
    let body = "let packed = pack_place(PhysicalPlace(x[0], x[1], x[2], x[3]), x[7] > 0.5);
        let p = unpack_place(packed);
        let r = unpack_reflectance(pack_reflectance(vec3f(x[4], x[5], x[6])));
        var m: Material;
        m.physical = PHYSICAL | PHYSICAL_REFLECTANCE;
        let color = vec3f(0.3, 0.6, 0.9);
        let l = look_of(m, color, packed, pack_reflectance(vec3f(x[4], x[5], x[6])));
        let same = physical_look(r, color, p);
        m.physical = PHYSICAL;
        m.reflectance = vec3f(0.25, 0.5, 0.75);
        let own = look_of(m, color, packed, 0.0);
        let same_own = physical_look(m.reflectance, color, p);
        m.physical = 0u;
        m.specular = vec3f(0.1, 0.2, 0.3); m.shininess = 7.0; m.diffuse = 0.4; m.mirror = 0.5; m.transmission = 0.6;
        let plain = look_of(m, color, packed, 0.0);
        y[0] = p.metallic; y[1] = p.roughness; y[2] = p.transmission; y[3] = p.coverage;
        y[4] = r.x; y[5] = r.y; y[6] = r.z; y[7] = f32(packed > 0.5); y[8] = f32(packed < -0.5);
        y[9] = f32(all(l.specular == same.specular) && l.shininess == same.shininess && l.diffuse == same.diffuse
            && l.mirror == same.mirror && l.transmission == same.transmission);
        y[10] = f32(all(own.specular == same_own.specular) && own.mirror == same_own.mirror);
        y[11] = plain.specular.z + plain.shininess + plain.diffuse + plain.mirror + plain.transmission;";
    let gpu: Vec<[f32; 12]> = probe.evaluate(&["shared/look"], body, &rows).unwrap();
    for (x, y) in rows.iter().zip(&gpu) {
        for (k, step) in [127.0, 255.0, 127.0, 127.0].into_iter().enumerate() {
            // What keeps its side of a decision may be a step off.
            assert!((x[k] - y[k]).abs() <= 1.001 / step, "{k}: {x:?} {y:?}");
        }
        assert!((x[0] > 0.0) == (y[0] > 0.0) && (x[2] > 0.0) == (y[2] > 0.0), "{x:?} {y:?}");
        assert!((x[1] <= POLISHED) == (y[1] <= POLISHED) && (x[3] < 1.0) == (y[3] < 1.0), "{x:?} {y:?}");
        for k in 4..7 {
            assert!((x[k].sqrt() - y[k].sqrt()).abs() <= 0.501 / 511.0, "{x:?} {y:?}");
        }
        assert_eq!((y[7], y[8]), (x[7], 1.0 - x[7]));
        assert_eq!((y[9], y[10]), (1.0, 1.0), "{x:?} {y:?}");
        assert!((y[11] - 8.8).abs() < 1e-5);
    }
}

#[test]
fn a_wrong_twin_is_noticed() {
    // The mutation that must fail: schlick with the exponent 4 differs by more than any tolerance above.
    let Some(probe) = probe() else { return };
    let rows: Vec<[f32; 1]> = (0..100).map(|i| [noise(i)]).collect();
    let gpu: Vec<[f32; 1]> = probe.evaluate(&["shared/shading"], "y[0] = schlick(vec3f(0.1), x[0]).x;", &rows).unwrap();
    let wrong = |c: f32| 0.1 + 0.9 * (1.0 - c) * (1.0 - c) * (1.0 - c) * (1.0 - c);
    let worst = rows.iter().zip(&gpu).map(|(r, g)| (g[0] - wrong(r[0])).abs()).fold(0.0, f32::max);
    assert!(worst > 0.01, "{worst}");
    // And so does a map that was not filtered by hand: neighbours differ.
    let maps = ShadowMaps {
        plan: ShadowPlan { views: vec![ShadowView { size: 2, ..views()[0] }], lights: vec![] },
        maps: vec![vec![[0.0; 4], [1.0; 4], [0.0; 4], [1.0; 4]]],
        ..ShadowMaps::default()
    };
    assert_eq!(maps.sample(0, Vec2::new(0.5, 0.5), 0).x, 0.5);
}
