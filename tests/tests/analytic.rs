//! Every case of `../shared/analytic/cases.json` within its tolerance on the CPU lane, by the library. The GPU lane's errors
//! are printed beside, and held to a looser bound. cli_analytic.rs renders the files through the command line.
//! Where that folder is absent the tests of files skip loudly; the formulas are tested all the same, on scenes built here.

use catoptra_engine::{
    LightKind, Material, RenderScene,
    gltf::{ImportLimits, load_gltf},
    math,
    shapes::{ShapeBuilder, sphere},
};
use catoptra_render_hybrid::{
    Image, RenderSettings, Renderer, Shadows,
    trace::reference::{ReferenceAccumulator, ReferenceOptions, sphere_indirect_radiance},
    twin::{
        shading::fresnel_dielectric,
        shadow::chebyshev_upper_bound,
        vpl::{Vpl, vpl_irradiance},
    },
};
use catoptra_tests::{
    HandScene, assert_close, assert_relative, at,
    fixtures::{cpu, full_vpls},
    gpu_or_skip, shared_or_skip, wall_of_positions,
};
use glam::{Affine3, Vec2, Vec3};
use serde_json::Value;

/// Relative; single-precision light sums of the software rasteriser and its fused operations. The CPU lane keeps the case's.
const GPU_TOLERANCE: f64 = 2e-3;

fn case(test: &str, id: &str) -> Option<Value> {
    let path = shared_or_skip(test, "analytic/cases.json")?;
    let all: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let found = all.as_array().unwrap().iter().find(|c| c["id"] == id).unwrap_or_else(|| panic!("no case {id}"));
    Some(found.clone())
}

fn number(v: &Value) -> f64 {
    v.as_f64().unwrap_or_else(|| panic!("not a number: {v}"))
}

/// The scene of a case's file.
fn load(case: &Value) -> RenderScene {
    let file = format!("analytic/{}", case["glb"].as_str().expect("a case with a file"));
    let path = shared_or_skip("load", &file).expect("cases.json names a file that lies beside it");
    load_gltf(&path, &ImportLimits::default()).unwrap().to_render_scene(0)
}

/// What the README of the cases asks for: 128x96, one sample at each pixel centre, hard traced shadows, direct light alone.
fn settings() -> RenderSettings {
    RenderSettings { shadows: Shadows::Traced, ..HandScene::settings(128, 96) }
}

/// Expected pixels `"x,y": [radiance..]` of a case: one value for all channels, or three.
fn pixels(expected: &Value) -> Vec<([u32; 2], [f64; 3])> {
    let map = ["pixels_x,y_128x96", "pixels"].iter().find_map(|k| expected.get(k)).unwrap_or(expected);
    let parse = |key: &String, v: &Value| {
        let (x, y) = key.split_once(',').expect("\"x,y\"");
        let v: Vec<f64> = v.as_array().unwrap().iter().map(number).collect();
        let radiance = if v.len() == 1 { [v[0]; 3] } else { [v[0], v[1], v[2]] };
        ([x.parse().unwrap(), y.parse().unwrap()], radiance)
    };
    let out: Vec<_> = map.as_object().unwrap().iter().map(|(k, v)| parse(k, v)).collect();
    assert!(!out.is_empty());
    out
}

/// Greatest relative error over the pixels; where 0 is expected, the value itself.
fn worst(image: &Image, expected: &[([u32; 2], [f64; 3])]) -> f64 {
    let errors = expected.iter().flat_map(|(p, radiance)| {
        let value = image.at(p[0], p[1]);
        (0..3).map(move |c| {
            let (v, e) = (f64::from(value[c]), radiance[c]);
            if e == 0.0 { v.abs() } else { (v / e - 1.0).abs() }
        })
    });
    errors.fold(0.0, f64::max)
}

fn file_case(id: &str) {
    let Some(case) = case(id, id) else { return };
    let (scene, expected, tolerance) = (load(&case), pixels(&case["expected"]), number(&case["tolerance"]));
    let error = worst(&cpu().render(&scene, &settings()).unwrap().image, &expected);
    println!("{id}: worst relative error {error:.2e} on the CPU lane, {tolerance:.0e} allowed");
    assert!(error <= tolerance, "{id}: {error:e}");

    // The mismatch: one degree of the camera, a hundredth of the light.
    let mut turned = scene.clone();
    turned.camera.world_from_view.matrix3 *= glam::Mat3::from_rotation_y(1.0f32.to_radians());
    assert!(worst(&cpu().render(&turned, &settings()).unwrap().image, &expected) > tolerance, "{id}: a turned camera");
    let mut brighter = scene.clone();
    brighter.lights[0].intensity *= 1.001;
    assert!(
        worst(&cpu().render(&brighter, &settings()).unwrap().image, &expected) > tolerance,
        "{id}: a brighter light"
    );
}

#[test]
fn lambert_point_plane() {
    file_case("lambert_point_plane");
}

#[test]
fn gltf_spot_falloff() {
    file_case("gltf_spot_falloff");
}

#[test]
fn mirror_reflection_radiance() {
    file_case("mirror_reflection_radiance");
}

#[test]
fn gpu_lane_beside() {
    let ids = ["lambert_point_plane", "gltf_spot_falloff", "mirror_reflection_radiance"];
    if shared_or_skip("gpu_lane_beside", "analytic/cases.json").is_none() {
        return;
    }
    let Some(mut gpu) = gpu_or_skip("gpu_lane_beside") else { return };
    for id in ids {
        let case = case(id, id).expect("the file is there");
        let image = gpu.render(&load(&case), &settings()).unwrap().image;
        let error = worst(&image, &pixels(&case["expected"]));
        println!("{id}: worst relative error {error:.2e} on the GPU lane ({})", gpu.device());
        assert!(error <= GPU_TOLERANCE, "{id}: {error:e} on the GPU lane");
    }
}

/// A plane y = 0 under a light at (0, h, 0), looked at from straight above the radius r.
fn lit_plane(kind: LightKind, rho: f32, intensity: f32, h: f32, r: f32) -> f64 {
    let mut scene = HandScene::parallel(Vec3::new(r, 5.0, 0.0), Vec3::NEG_Y, 1e-3);
    let mut plane = ShapeBuilder::default();
    plane.quad(
        [[-60.0, 60.0], [60.0, 60.0], [60.0, -60.0], [-60.0, -60.0]].map(|[x, z]| Vec3::new(x, 0.0, z)),
        Vec3::ONE,
    );
    scene.add(plane.build(), Material::lambert(Vec3::splat(rho)), Affine3::IDENTITY);
    scene.light(kind, Vec3::new(0.0, h, 0.0), Vec3::splat(intensity));
    f64::from(scene.pixel(|_| ()).x)
}

#[test]
fn radiance_by_radius_and_by_angle() {
    let point = |r: f32| lit_plane(LightKind::Point, 0.5, 10.0, 2.0, r);
    let expected = |r: f64, h: f64| 0.5 / std::f64::consts::PI * 10.0 * h / (r * r + h * h).sqrt().powf_3();
    for r in [0.0f32, 1.0, 2.0, 4.0] {
        assert_relative(&format!("L(r={r})"), point(r), expected(f64::from(r), 2.0), 1e-5);
    }
    assert!((point(1.0) / expected(1.0, 2.02) - 1.0).abs() > 1e-3, "another height is seen");

    let cos = |degrees: f32| math::cos(degrees.to_radians());
    let spot = LightKind::Spot { cos_inner: cos(20.0), cos_outer: cos(40.0) };
    for (degrees, falloff) in
        [(0.0f32, 1.0), (20.0, 1.0), (25.0, 0.652_451_023_5), (30.0, 0.331_508_104_8), (35.0, 0.093_534_732_9)]
    {
        let r = 2.0 * math::tan(degrees.to_radians());
        // Relative; the falloff of 35 degrees squares a difference of nearby cosines, at a place that barycentric
        // coordinates of a plane of 120 m tell to about 0.01 mm.
        assert_relative(&format!("att({degrees})"), lit_plane(spot, 0.5, 10.0, 2.0, r), point(r) * falloff, 6e-5);
    }
    assert_eq!(lit_plane(spot, 0.5, 10.0, 2.0, 2.0 * math::tan(40.1f32.to_radians())), 0.0);

    let Some(case) = case("radiance_by_radius", "lambert_point_plane") else { return };
    for (r, key) in [(0.0, "L(r=0)"), (1.0, "L(r=1)"), (2.0, "L(r=2)"), (4.0, "L(r=4)")] {
        assert_relative(key, point(r), number(&case["expected"][key]), number(&case["tolerance"]));
    }
}

/// x³ without `powi`.
trait Cube {
    fn powf_3(self) -> Self;
}
impl Cube for f64 {
    fn powf_3(self) -> Self {
        self * self * self
    }
}

/// Lateral displacement of a parallel ray through a slab of thickness 1 between z = -1 and 0, measured where it ends: on a
/// wall at z = -6.
fn displacement(slab: impl Fn(&mut HandScene), degrees: f32) -> f64 {
    let (s, c) = math::sin_cos(degrees.to_radians());
    let direction = Vec3::new(s, 0.0, -c);
    let eye = -direction * 2.0;
    let (x0, half) = (6.0 * s / c, 4.0f32);
    let mut scene = HandScene::parallel(eye, direction, 1e-3);
    slab(&mut scene);
    let (wall, material) = wall_of_positions(Vec3::new(x0, 0.0, -6.0), Vec3::X * half, Vec3::Y * half);
    scene.add(wall, material, Affine3::IDENTITY);
    // Two interfaces: straight through, no light from inner reflections.
    let seen = scene.pixel(|s| s.max_depth = 2);
    let along = f64::from((seen.x / seen.z - 0.5) * 2.0 * half);
    // The wall is met earlier along x; across the ray that is the displacement.
    -along * f64::from(c)
}

#[test]
fn slab_displacement() {
    let cuboid = |ior: f32| {
        move |scene: &mut HandScene| {
            let mesh = catoptra_engine::shapes::cuboid(Vec3::new(60.0, 60.0, 0.5), [Vec3::ONE; 6]);
            scene.add(mesh, Material::glass(Vec3::ONE, ior), at(Vec3::new(0.0, 0.0, -0.5)));
        }
    };
    let formula = |degrees: f64, n: f64| {
        let (s, c) = (math::sin_f64(degrees.to_radians()), math::cos_f64(degrees.to_radians()));
        s * (1.0 - c / (n * n - s * s).sqrt())
    };
    for degrees in [0.0, 15.0, 30.0, 45.0, 60.0, 75.0] {
        let (value, expected) = (displacement(cuboid(1.5), degrees), formula(f64::from(degrees), 1.5));
        println!("slab at {degrees} degrees: {value:.7} for {expected:.7} m");
        // Metres: single precision of the wall's coded position; relative 1e-4 of the case holds beside.
        assert_close(&format!("{degrees} degrees"), value, expected, 5e-6);
        if degrees > 0.0 {
            assert_relative(&format!("{degrees} degrees"), value, expected, 1e-4);
            assert!((displacement(cuboid(1.501), degrees) - expected).abs() > 5e-6, "another ior is seen");
        }
    }

    let Some(case) = case("slab_displacement", "slab_displacement") else { return };
    let file = load(&case);
    for (key, expected) in case["expected"].as_object().unwrap() {
        let degrees: f32 = key.trim_end_matches("deg").parse().unwrap();
        let slab = |scene: &mut HandScene| {
            let glass = file.instances.iter().find(|i| file.materials[i.material as usize].transmission > 0.0).unwrap();
            let mesh = (*file.meshes[glass.mesh as usize]).clone();
            scene.add(mesh, file.materials[glass.material as usize], glass.world_from_object);
        };
        let (value, expected) = (displacement(slab, degrees), number(expected));
        let allowed = number(&case["tolerance"]) * expected + 1e-6;
        assert_close(&format!("the file's slab at {key}"), value, expected, allowed);
    }
}

#[test]
fn fresnel_dielectric_by_angle() {
    let Some(case) = case("fresnel_dielectric", "fresnel_dielectric") else { return };
    let n = number(&case["inputs"]["n"]);
    let exact = |cos: f64, eta: f64| {
        let sin2 = eta * eta * (1.0 - cos * cos);
        let c2 = (1.0 - sin2).max(0.0).sqrt();
        let (rs, rp) = ((eta * cos - c2) / (eta * cos + c2), (eta * c2 - cos) / (eta * c2 + cos));
        if sin2 >= 1.0 { 1.0 } else { 0.5 * (rs * rs + rp * rp) }
    };
    for (key, expected) in case["expected"].as_object().unwrap() {
        let (degrees, side) = key.split_once("deg_from_").unwrap();
        let eta = if side == "air" { 1.0 / n } else { n };
        let cos = math::cos_f64(degrees.parse::<f64>().unwrap().to_radians());
        // The function takes a cosine in single precision: next to the critical angle its rounding alone moves the answer.
        let rounded = cos as f32;
        let conditioning = (exact(f64::from(rounded), eta) - exact(cos, eta)).abs();
        let value = f64::from(fresnel_dielectric(rounded, eta as f32));
        let allowed = number(&case["tolerance"]) * number(expected) + conditioning;
        assert_close(key, value, number(expected), allowed);
        let off = f64::from(fresnel_dielectric(rounded, eta as f32 * 1.001));
        assert!(number(expected) == 1.0 || (off - number(expected)).abs() > allowed, "{key}: another ior is seen");
    }
}

/// Mean over the picture of what is not direct light.
fn mean_indirect(total: &Image, direct: &Image) -> f64 {
    let sum: f64 = total.pixels.iter().zip(&direct.pixels).map(|(t, d)| f64::from(t[0]) - f64::from(d[0])).sum();
    sum / total.pixels.len() as f64
}

/// The closed sphere of the case, of the file where it is there, else of this module's own tessellation.
fn closed_sphere() -> (RenderScene, f64) {
    if let Some(case) = case("sphere_indirect_uniform", "sphere_indirect_uniform") {
        return (load(&case), number(&case["tolerance"]));
    }
    let mut scene = HandScene::new(catoptra_engine::Camera::looking_at(Vec3::new(0.0, 0.0, 1.2), Vec3::ZERO, 1.396));
    scene.add(sphere(2.0, 72, 144), Material::lambert(Vec3::splat(0.6)), Affine3::IDENTITY);
    scene.light(LightKind::Point, Vec3::new(0.7, 0.4, -0.2), Vec3::splat(5.0));
    (scene.0, 0.004)
}

#[test]
fn sphere_indirect_uniform_by_reference() {
    let (scene, tolerance) = closed_sphere();
    let settings = HandScene::settings(48, 36);
    let mut renderer = cpu();
    let direct = renderer.render(&scene, &settings).unwrap().image;
    for bounces in 1..=3 {
        let options = ReferenceOptions { bounces, ..ReferenceOptions::matching(&settings) };
        let mut sums = ReferenceAccumulator::new(48, 36);
        renderer.add_reference(&mut sums, &scene, &options, 96).unwrap();
        let expected = f64::from(sphere_indirect_radiance(0.6, 5.0, 2.0, bounces));
        let value = mean_indirect(&sums.image(), &direct);
        let noise = (mean_indirect(&sums.half(0), &direct) - mean_indirect(&sums.half(1), &direct)).abs() / expected;
        println!("reference, N = {bounces}: {value:.6} for {expected:.6}, halves differ by {noise:.1e}");
        assert_relative(&format!("N = {bounces}"), value, expected, tolerance);
        let other = f64::from(sphere_indirect_radiance(0.6, 5.0, 2.0, bounces + 1));
        assert!((value / other - 1.0).abs() > tolerance, "one bounce more is seen");
    }
}

#[test]
fn sphere_indirect_uniform_by_vpls() {
    let (scene, tolerance) = closed_sphere();
    for bounces in [1, 2, 3, 8] {
        // On a sphere cos·cos/d² is 1/(4R²) between any two points: few VPLs are enough, and every pixel is right.
        let settings = RenderSettings {
            vpl: Some(full_vpls(64 * bounces, bounces)),
            keep_layers: true,
            ..HandScene::settings(24, 18)
        };
        let frame = cpu().render(&scene, &settings).unwrap();
        let indirect = frame.layer(catoptra_render_hybrid::Layer::Indirect).unwrap();
        let expected = f64::from(sphere_indirect_radiance(0.6, 5.0, 2.0, bounces));
        let mean = indirect.pixels.iter().map(|p| f64::from(p[0])).sum::<f64>() / indirect.pixels.len() as f64;
        let spread = indirect.pixels.iter().map(|p| (f64::from(p[0]) / expected - 1.0).abs()).fold(0.0, f64::max);
        println!("VPLs, N = {bounces}: {mean:.6} for {expected:.6}, worst pixel off by {spread:.1e}");
        assert_relative(&format!("N = {bounces}"), mean, expected, tolerance);
        // Flat facets with interpolated normals: a VPL next to a pixel sees it under other cosines. Relative.
        assert!(spread < 0.1, "N = {bounces}: the worst pixel is off by {spread}");
    }
}

#[test]
fn sphere_formula_is_the_case() {
    let Some(case) = case("sphere_formula", "sphere_indirect_uniform") else { return };
    for (key, n) in [("N=1", 1), ("N=2", 2), ("N=3", 3), ("N=8", 8)] {
        let value = f64::from(sphere_indirect_radiance(0.6, 5.0, 2.0, n));
        assert_relative(key, value, number(&case["expected"][key]), 1e-6);
    }
}

#[test]
fn vsm_chebyshev_two_depths() {
    let Some(case) = case("vsm_chebyshev", "vsm_chebyshev_two_depths") else { return };
    // Depths are normalised by a far distance of 10 m.
    let (t, d) = (number(&case["inputs"]["t"]) as f32 / 10.0, number(&case["inputs"]["d"]) as f32 / 10.0);
    for (key, q) in case["expected"].as_object().unwrap() {
        let q = number(q) as f32;
        let moments = Vec2::new(q * t + (1.0 - q) * d, q * t * t + (1.0 - q) * d * d);
        // Visibility; the variance is a difference of squares in single precision.
        assert_close(key, f64::from(chebyshev_upper_bound(moments, t, 1e-12, 0.0)), f64::from(q), 1e-5);
        assert!(
            (chebyshev_upper_bound(moments, t + 0.001, 1e-12, 0.0) - q).abs() > 1e-5,
            "{key}: another depth is seen"
        );
    }
}

#[test]
fn vpl_contribution() {
    let Some(case) = case("vpl_contribution", "vpl_contribution") else { return };
    let input = |k: &str| number(&case["inputs"][k]) as f32;
    let vpl = |d: f32| Vpl {
        position_world: Vec3::Y * d,
        normal_world: Vec3::NEG_Y,
        flux: Vec3::splat(input("Phi_i")),
        error: 0.0,
    };
    let radiance = |d: f32| {
        let e = vpl_irradiance(&vpl(d), Vec3::ZERO, Vec3::Y, f32::INFINITY);
        f64::from(e.x * input("rho") * std::f32::consts::FRAC_1_PI)
    };
    assert_relative("one VPL", radiance(input("d")), number(&case["expected"]), 1e-6);
    assert!((radiance(input("d") * 1.001) / number(&case["expected"]) - 1.0).abs() > 1e-3);
}

/// Radiance of the walls of glass_slab.glb, straight from the formula of a point light, in double precision.
struct SlabWorld {
    rho: [f64; 2],
    wall_z: [f64; 2],
    light: [[f64; 3]; 2],
    intensity: [[f64; 3]; 2],
}

impl SlabWorld {
    fn of(scene: &RenderScene) -> Self {
        let f = |v: Vec3| v.to_array().map(f64::from);
        let (a, b) = (&scene.lights[0], &scene.lights[1]);
        Self {
            rho: [0.8, 0.7],
            wall_z: [-6.0, 7.0],
            light: [f(a.position_world), f(b.position_world)],
            intensity: [f(a.intensity), f(b.intensity)],
        }
    }
    /// Wall 0 lies behind the slab, wall 1 behind the camera; the slab shades each from the other's light.
    fn wall(&self, which: usize, x: f64, y: f64) -> [f64; 3] {
        let l = self.light[which];
        let h = (l[2] - self.wall_z[which]).abs();
        let d2 = (l[0] - x) * (l[0] - x) + (l[1] - y) * (l[1] - y) + h * h;
        self.intensity[which].map(|i| self.rho[which] / std::f64::consts::PI * i * h / d2.sqrt().powf_3())
    }
    /// Radiance along a ray from `o` (z over 0) towards `d` (unit, z under 0): the sum over all inner reflections.
    fn radiance(&self, o: [f64; 3], d: [f64; 3], n: f64, most: usize) -> [f64; 3] {
        let across = (d[0] * d[0] + d[1] * d[1]).sqrt();
        let (cos, inside) = (-d[2], across / n);
        let cos_inside = (1.0 - inside * inside).sqrt();
        let rs = (cos - n * cos_inside) / (cos + n * cos_inside);
        let rp = (cos_inside - n * cos) / (cos_inside + n * cos);
        let f = 0.5 * (rs * rs + rp * rp);
        let unit = if across > 0.0 { [d[0] / across, d[1] / across] } else { [0.0; 2] };
        let slope = across / cos;
        // Sideways way to the first face, then one crossing of the slab (1 m) after another.
        let first = o[2] * slope;
        let step = inside / cos_inside;
        let place = |s: f64| (o[0] + unit[0] * s, o[1] + unit[1] * s);
        let at_wall = |which: usize, s: f64| {
            let (x, y) = place(s + if which == 0 { 5.0 * slope } else { 7.0 * slope });
            self.wall(which, x, y)
        };
        let mut sum = at_wall(1, first).map(|l| f * l);
        let mut weight = (1.0 - f) * (1.0 - f);
        for crossings in 1..=most {
            let s = first + step * crossings as f64;
            let seen = at_wall(if crossings % 2 == 1 { 0 } else { 1 }, s);
            sum = std::array::from_fn(|c| sum[c] + weight * seen[c]);
            weight *= f;
        }
        sum
    }
}

#[test]
fn glass_slab_picture() {
    let Some(case) = case("glass_slab_picture", "slab_displacement") else { return };
    let scene = load(&case);
    let world = SlabWorld::of(&scene);
    let render = |renderer: &mut Renderer| {
        let settings = RenderSettings { max_depth: 16, min_weight: 1e-7, ..settings() };
        renderer.render(&scene, &settings).unwrap().image
    };
    let expected: Vec<([u32; 2], [f64; 3])> = [[64, 48], [10, 80], [100, 90], [64, 94], [30, 60], [3, 3], [120, 10]]
        .into_iter()
        .map(|[x, y]| {
            let (o, d) = scene.camera.ray(x as f32 + 0.5, y as f32 + 0.5, 128, 96);
            let f = |v: Vec3| v.to_array().map(f64::from);
            ([x, y], world.radiance(f(o), f(d), 1.5, 40))
        })
        .collect();
    let error = worst(&render(&mut cpu()), &expected);
    println!("glass_slab.glb: worst relative error {error:.2e} on the CPU lane");
    assert!(error <= number(&case["tolerance"]), "{error:e}");
    // One inner reflection less is seen.
    let fewer: Vec<_> = expected
        .iter()
        .map(|(p, _)| {
            let (o, d) = scene.camera.ray(p[0] as f32 + 0.5, p[1] as f32 + 0.5, 128, 96);
            let f = |v: Vec3| v.to_array().map(f64::from);
            (*p, world.radiance(f(o), f(d), 1.5, 1))
        })
        .collect();
    assert!(worst(&render(&mut cpu()), &fewer) > number(&case["tolerance"]));
}
