//! Light at what mirrors and glass show, against the CPU's own way (trace/shade.rs, trace/direct.rs).

use catoptra_engine::{
    Environment, Instance, Light, LightKind, Look, Material, RenderScene,
    glam::{Affine3, Vec3},
};
use catoptra_render_hybrid::{
    BlasKind, MomentOptions, RenderSettings, ShadowFilter, Shadows, SimdLevel, VplOptions, VplShadows,
    accel::Accel,
    raster::testing::{LitBy, ShadedBy, light_at},
    trace::surface::{NormalMatrices, Surface},
    twin::{
        shadow::{ShadowMaps, ShadowPlan, moments_of},
        vpl::Vpl,
        vpl_maps::VplMaps,
    },
};
use std::sync::Arc;

use super::{Allowed, Random, Verdict, followed, probe, scenes};

const ROWS: usize = 6_000;
const MATERIALS: u32 = 6;
const VPLS: usize = 24;
const MAP: u32 = 16;
const SAMPLES: u32 = 4;
const BOUND: f32 = 0.5;

/// Position, both normals, colour, emission, specular, direction of the viewer; shininess, diffuse, mirror, transmission,
/// error, instance, pixel.
type Row = [f32; 28];

const BODY: &str = "
    var s: SurfacePoint;
    s.position_world = vec3f(x[0], x[1], x[2]);
    s.n_geometric = vec3f(x[3], x[4], x[5]);
    s.n_shading = vec3f(x[6], x[7], x[8]);
    s.base_color = vec3f(x[9], x[10], x[11]);
    s.emission = vec3f(x[12], x[13], x[14]);
    s.look = Look(vec3f(x[15], x[16], x[17]), x[21], x[22], x[23], x[24]);
    s.error = x[25];
    s.instance = u32(x[26]);
    let light = shade(s, vec3f(x[18], x[19], x[20]), u32(x[27]));
    y[0] = light.x; y[1] = light.y; y[2] = light.z;";

/// What a frame's settings make of it.
#[derive(Clone, Copy)]
struct Case {
    name: &'static str,
    shadows: Shadows,
    filter: ShadowFilter,
    vpls: VplShadows,
}

fn scene() -> RenderScene {
    let mut r = Random(31);
    let mut scene = RenderScene {
        meshes: vec![Arc::new(scenes::tetrahedron()), Arc::new(scenes::pane())],
        environment: Environment { background: Vec3::ZERO, ambient: Vec3::new(0.1, 0.2, 0.3) },
        ..RenderScene::default()
    };
    for n in 0..MATERIALS {
        scene.materials.push(Material { ambient: r.unit(), unlit: n == 4, ..Material::default() });
    }
    // Things that throw shadows, among the surfaces; each fourth behind lights.
    for n in 0..40 {
        let (reach, size) = if n % 4 == 0 { (5.0, 2.0) } else { (2.0, 0.3) };
        scene.instances.push(Instance {
            stable_id: n,
            mesh: (n % 2) as u32,
            material: (n as u32) % MATERIALS,
            world_from_object: Affine3::from_translation(r.vec() * reach)
                * Affine3::from_rotation_y(r.unit() * 6.0)
                * Affine3::from_scale(Vec3::splat(size + r.unit())),
        });
    }
    let kinds = [LightKind::Point, LightKind::Spot { cos_inner: 0.9, cos_outer: 0.6 }, LightKind::Directional];
    for (n, kind) in kinds.into_iter().cycle().take(5).enumerate() {
        let (place, direction_world) = (r.direction() * 3.0, r.direction());
        scene.lights.push(Light {
            kind,
            // Towards the middle.
            direction_world: if n % 3 == 1 { -place.normalize() } else { direction_world },
            up_world: direction_world.any_orthonormal_vector(),
            intensity: r.color() * 4.0,
            radius: [0.0, 0.2][n / 3],
            ..Light::point(n as u64, place)
        });
    }
    scene
}

/// Maps of any depths, two in a texel: as soft as maps can be.
fn maps(scene: &RenderScene, filter: ShadowFilter) -> ShadowMaps {
    let mut r = Random(32);
    let options = MomentOptions { size: MAP, face_size: MAP / 2, filter, soft: true, ..MomentOptions::default() };
    let plan = ShadowPlan::new(&scene.lights, scene.bounds_world(), &options);
    let texel = |r: &mut Random| {
        let [a, b] = [0; 2].map(|_| moments_of(filter, r.unit()));
        let share = r.unit();
        std::array::from_fn(|i| a[i] * share + b[i] * (1.0 - share))
    };
    let maps = plan.views.iter().map(|v| (0..v.size * v.size).map(|_| texel(&mut r)).collect()).collect();
    let mut maps = ShadowMaps { plan, maps, ..ShadowMaps::default() };
    maps.make_levels(SimdLevel::Auto);
    maps
}

fn vpls(r: &mut Random) -> Vec<Vpl> {
    let vpl = |r: &mut Random| Vpl {
        position_world: r.vec() * 2.5,
        normal_world: r.direction(),
        flux: r.color() * 3.0,
        error: 1e-3 * r.unit(),
    };
    (0..VPLS).map(|_| vpl(r)).collect()
}

fn rows() -> Vec<Row> {
    let mut r = Random(33);
    (0..ROWS)
        .map(|_| {
            let n = r.direction();
            let bent = (n + r.vec() * [0.0, 0.3, 1.0][r.below(3)]).normalize_or(n);
            let bent = if bent.dot(n) < 0.0 { -bent } else { bent };
            let specular = if r.chance(0.5) { r.color() } else { Vec3::ZERO };
            let emission = if r.chance(0.3) { r.color() } else { Vec3::ZERO };
            let mut row = [0.0; 28];
            for (at, v) in [r.vec() * 2.0, n, bent, r.color(), emission, specular, r.direction()].iter().enumerate() {
                row[3 * at..3 * at + 3].copy_from_slice(&v.to_array());
            }
            row[21] = [1.0, 10.0, 100.0, 400.0][r.below(4)];
            row[22] = [0.0, 1.0, r.unit()][r.below(3)];
            row[23] = [0.0, 0.0, r.unit()][r.below(3)];
            row[24] = [0.0, 0.0, r.unit()][r.below(3)];
            row[25] = 1e-5 + 1e-3 * r.unit();
            row[26] = r.below(40) as f32;
            row[27] = r.below(1 << 20) as f32;
            row
        })
        .collect()
}

fn vec(r: &Row, at: usize) -> Vec3 {
    Vec3::from_slice(&r[at..])
}

fn surface(r: &Row) -> Surface {
    Surface {
        position_world: vec(r, 0),
        error: r[25],
        n_geometric: vec(r, 3),
        n_shading: vec(r, 6),
        front: true,
        base_color: vec(r, 9),
        emission: vec(r, 12),
        look: Look { specular: vec(r, 15), shininess: r[21], diffuse: r[22], mirror: r[23], transmission: r[24] },
        material: r[26] as u32 % MATERIALS,
        instance_id: r[26] as u32,
        primitive_id: 0,
    }
}

/// All that the CPU says of places and normals moved by a few roundings, and a few roundings more.
fn allowed(by: &ShadedBy, r: &Row) -> [Allowed; 3] {
    let light = |r: &Row| light_at(by, &surface(r), vec(r, 18), r[27] as u32).to_array();
    let center = light(r);
    let (mut low, mut high) = (center, center);
    for (at, step) in [(0, 1e-6), (6, 3e-7)] {
        for (axis, sign) in [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), (2, 1.0), (2, -1.0)] {
            let mut other = *r;
            other[at + axis] += step * sign;
            for (i, v) in light(&other).into_iter().enumerate() {
                (low[i], high[i]) = (low[i].min(v), high[i].max(v));
            }
        }
    }
    // Powers of up to 400 multiply the rounding of a logarithm.
    std::array::from_fn(|i| Allowed { low: low[i], high: high[i], slack: 2e-4 * center[i].max(0.01) })
}

/// Runs `case` as it is and with faults. Returns the rows that jump.
fn run(case: Case, accel: &Accel, scene: &RenderScene, rows: &[Row], faults: &[(&str, &str, &str)]) {
    let Some(probe) = probe() else { return };
    let mut normals = NormalMatrices::default();
    normals.update(scene);
    let mut r = Random(34);
    let (vpls, maps) = (vpls(&mut r), maps(scene, case.filter));
    let mut vpl_maps = VplMaps::default();
    if case.vpls == VplShadows::Maps {
        vpl_maps.size = MAP;
        // Occluders at 0.5 to 20 m.
        vpl_maps.texels = (0..VPLS as u32 * MAP * MAP).map(|_| 1.0 / (0.5 + 19.5 * r.unit() * r.unit())).collect();
    }
    let moments =
        MomentOptions { size: MAP, face_size: MAP / 2, filter: case.filter, soft: true, ..MomentOptions::default() };
    let settings = RenderSettings {
        shadows: case.shadows,
        shadow_samples: SAMPLES,
        moments,
        vpl: Some(VplOptions { shadows: case.vpls, map_size: MAP, ..VplOptions::default() }),
        seed: 9,
        ..RenderSettings::default()
    };
    let lit = LitBy {
        maps: &maps,
        vpls: &vpls,
        vpl_maps: &vpl_maps,
        traced_shadows: case.shadows == Shadows::Traced,
        traced_vpls: case.vpls == VplShadows::Traced,
    };
    let by = ShadedBy { scene, normals: &normals, accel, lit, settings: &settings, geometry_term_max: BOUND };
    let held = probe.hold_lit(scene, accel, &lit).unwrap();
    let visibility = if case.shadows == Shadows::Moments { "VISIBILITY_MOMENTS" } else { "VISIBILITY_NONE" };
    let (floor, reduction) = (moments.min_variance, moments.light_bleed_reduction);
    let body = format!(
        "trace.vpl_count = {VPLS}u;
        trace.geometry_term_max = {BOUND:?};
        trace.map_size = {}u;
        trace.visibility = {visibility};
        trace.min_variance = {floor:e};
        trace.light_bleed_reduction = {reduction:e};
        trace.evsm = {}u;
        trace.shadow_samples = {SAMPLES}u;
        trace.seed = 9u;
        {BODY}",
        vpl_maps.size,
        u32::from(case.filter == ShadowFilter::Evsm4)
    );
    let allowed: Vec<_> = rows.iter().map(|r| allowed(&by, r)).collect();
    let judge = |edits: &[(&str, &str)]| {
        let gpu: Vec<[f32; 3]> = held.evaluate(edits, &body, rows).unwrap();
        Verdict::of(&[("radiance", 3)], &gpu, |row| allowed[row])
    };
    let jump = |a: &&[Allowed; 3]| a.iter().any(|a| a.high - a.low > 0.01 * a.high.max(0.1));
    let jumps = allowed.iter().filter(jump).count();
    println!("{}: {jumps} of {} jump", case.name, rows.len());
    assert!(jumps * 20 < rows.len());
    let verdict = judge(&[]);
    if case.shadows == Shadows::Traced {
        // Rays along edges: another rounding meets what this one passes.
        println!("{}: {} of {} rows are wrong", case.name, verdict.wrong, verdict.rows);
        assert!(verdict.wrong * 500 <= verdict.rows, "{}", verdict.first);
    } else {
        verdict.agrees(case.name);
    }
    for (name, from, to) in faults {
        let faulty = judge(&[(from, to)]);
        assert!(faulty.wrong * 100 > faulty.rows, "{} with {name:?}: {} rows are wrong", case.name, faulty.wrong);
        faulty.fails(case.name, name);
    }
}

#[test]
fn hits_are_shaded_as_on_the_cpu() {
    let scene = scene();
    let accel = followed(&scene, BlasKind::Bvh);
    let rows = rows();
    let plain = Case { name: "shade", shadows: Shadows::Off, filter: ShadowFilter::Vsm, vpls: VplShadows::Off };
    let unlit = "if dynamic_word(m + 3u).z != 0u {\n        return s.emission;";
    run(
        plain,
        &accel,
        &scene,
        &rows,
        &[
            ("unlit is lit", unlit, "if false {\n        return s.emission;"),
            ("ambient of mirrors", "(dynamic_word(m + 2u).w) * matte)", "(dynamic_word(m + 2u).w))"),
            ("no share of the matte", "(s.look.diffuse * matte / PI)", "(s.look.diffuse / PI)"),
            ("no highlight", "if any(specular > vec3f(0.0)) {", "if false {"),
            ("cosine left out", "arriving.irradiance * (cos_i * visible)", "arriving.irradiance * visible"),
            (
                "flat normal",
                "let cos_i = dot(s.n_shading, arriving.wi);",
                "let cos_i = dot(s.n_geometric, arriving.wi);",
            ),
            ("a light left out", "i < frame.light_count;", "i + 1u < frame.light_count;"),
            ("a VPL left out", "i < trace.vpl_count;", "i + 1u < trace.vpl_count;"),
            ("no bound", "s.n_shading, trace.geometry_term_max)", "s.n_shading, 1e6)"),
            ("indirect light unshaded", "return radiance + diffuse * sum;", "return radiance + sum;"),
        ],
    );
    run(
        Case { name: "shade, vsm and VPLs' maps", shadows: Shadows::Moments, vpls: VplShadows::Maps, ..plain },
        &accel,
        &scene,
        &rows,
        &[
            ("the first face of six", "face = cube_face(point_world - light.position_world);", "face = 0u;"),
            ("another layer of faces", "light.first_layer + face, view,", "light.first_view + face, view,"),
            (
                "another layer of maps",
                "view_visibility(moment_maps, light.first_layer, view",
                "view_visibility(moment_maps, light.first_view, view",
            ),
            (
                "floor and reduction exchanged",
                "trace.min_variance, trace.light_bleed_reduction,",
                "trace.light_bleed_reduction, trace.min_variance,",
            ),
            ("columns of moments exchanged", "let b = m01 + (m11 - m01) * f.x;", "let b = m11 + (m01 - m11) * f.x;"),
            ("another VPL's map", "vpl_visibility(vpl_maps, vpl.map,", "vpl_visibility(vpl_maps, vpl.map + 1u,"),
            (
                "flat plane of the receiver",
                "s.position_world - center, s.n_shading)",
                "s.position_world - center, s.n_geometric)",
            ),
            ("a tap left out", "let b = t01 + (t11 - t01) * f.x;", "let b = t01;"),
        ],
    );
    run(
        Case { name: "shade, evsm", shadows: Shadows::Moments, filter: ShadowFilter::Evsm4, ..plain },
        &accel,
        &scene,
        &rows,
        &[("moments for warps", "if options.z != 0.0 {", "if options.z == 0.0 {")],
    );
    let traced = Case { name: "shade, traced", shadows: Shadows::Traced, vpls: VplShadows::Traced, ..plain };
    run(
        traced,
        &accel,
        &scene,
        &rows[..ROWS / 2],
        &[
            (
                "the middle of the disc",
                "select(vogel_disc(i, samples, rotation), vec2f(0.0), samples == 1u)",
                "vec2f(0.0)",
            ),
            ("the pattern is not turned", "let rotation = 2.0 * PI * unit_f32(turn);", "let rotation = 0.0;"),
            ("rays to lights beyond the light", "select(1.0, FAR_AWAY, far_away)", "FAR_AWAY"),
            (
                "any thing behind a VPL",
                "Ray(origin, 0.0, center - origin, 1.0)",
                "Ray(origin, 0.0, center - origin, FAR_AWAY)",
            ),
            ("VPLs shine through", "if occluded(Ray(origin, 0.0, center - origin, 1.0)) {", "if false {"),
        ],
    );
}
