//! Light paths and the lists of their VPLs, against trace/photons.rs and twin/interleave.rs.

use catoptra_demos::scenes as demos;
use catoptra_engine::{Extracted, Light, LightKind, RenderScene, app, glam::Vec3};
use catoptra_render_hybrid::{
    BlasKind, VplOptions,
    raster::testing::TracedPhotons,
    trace::{photons::Photons, surface::NormalMatrices},
    twin::{interleave::group_subsets, vpl::Vpl},
};

use super::{followed, probe};

const BOUND: f32 = 7.5;
/// Of an indirect pass's chunk.
const CHUNK: usize = 1024;

/// Lights of every kind, surfaces that emit, that are unlit, and half mirrors.
fn scene() -> RenderScene {
    let mut world = demos::build("rolling-box-venus", &demos::SceneOptions::default()).unwrap();
    app::advance(&mut world, 30);
    let mut scene = world.world().resource::<Extracted>().0.clone();
    let bounds = scene.bounds_world();
    let (middle, size) = (bounds.center(), bounds.max - bounds.min);
    let spot = LightKind::Spot { cos_inner: 0.9, cos_outer: 0.4 };
    let kinds = [LightKind::Point, spot, LightKind::Directional];
    scene.lights = kinds
        .into_iter()
        .zip(1..)
        .map(|(kind, n)| Light {
            kind,
            direction_world: Vec3::new(0.3, -0.9, 0.1 * n as f32).normalize(),
            up_world: Vec3::X,
            intensity: Vec3::new(3.0, 2.0, 1.0) / n as f32,
            ..Light::point(n, middle + size * Vec3::new(0.1, 0.3, -0.05 * n as f32))
        })
        .collect();
    for (i, m) in scene.materials.iter_mut().enumerate() {
        m.mirror = m.mirror.min(0.5);
        m.unlit = i == 1;
        if i == 0 {
            m.emissive = Vec3::new(0.2, 0.3, 0.1);
        }
    }
    scene
}

/// VPLs of two lists, in order, that have no like in the other.
fn strangers(a: &[Vpl], b: &[Vpl], radius: f32) -> usize {
    let like = |a: &Vpl, b: &Vpl| {
        let flux = b.flux.max_element();
        a.position_world.distance(b.position_world) <= 2e-4 * radius
            && a.normal_world.distance(b.normal_world) <= 1e-3
            && (a.flux - b.flux).abs().max_element() <= 1e-3 * flux
            && (a.error - b.error).abs() <= 0.01 * b.error
    };
    let (mut i, mut k, mut alone) = (0, 0, 0);
    while i < a.len() && k < b.len() {
        // Where they part, one has a few that the other has not.
        let skip = (0..8)
            .flat_map(|s| (0..=s).map(move |j| (j, s - j)))
            .find(|&(x, y)| a.get(i + x).zip(b.get(k + y)).is_some_and(|(a, b)| like(a, b)));
        let (x, y) = skip.unwrap_or((1, 1));
        alone += x + y;
        (i, k) = (i + x + usize::from(skip.is_some()), k + y + usize::from(skip.is_some()));
    }
    alone + (a.len() - i) + (b.len() - k)
}

/// The chunks hold the list, in order, behind true heads.
fn chunks_hold(made: &TracedPhotons, interleave: u32) -> bool {
    let count = made.vpls.len();
    made.chunks.iter().enumerate().all(|(chunk, words)| {
        let own = &made.vpls[(chunk * CHUNK).min(count)..((chunk + 1) * CHUNK).min(count)];
        let heads = [[own.len() as u32, (chunk * CHUNK) as u32, BOUND.to_bits(), 0], [count as u32, interleave, 0, 0]];
        let words_of = |v: &Vpl| {
            let word = |v: Vec3, w: u32| [v.x.to_bits(), v.y.to_bits(), v.z.to_bits(), w];
            [word(v.position_world, v.error.to_bits()), word(v.normal_world, 0), word(v.flux, 0)]
        };
        let body: Vec<[u32; 4]> = own.iter().flat_map(words_of).collect();
        words[..2] == heads && words[2..2 + body.len()] == body
    })
}

#[test]
fn light_paths_and_their_lists_are_those_of_the_cpu() {
    let Some(probe) = probe() else { return };
    let scene = scene();
    let radius = scene.bounds_world().radius();
    let accel = followed(&scene, BlasKind::Bvh);
    let mut normals = NormalMatrices::default();
    normals.update(&scene);
    let options = VplOptions { count: 3000, bounces: 3, ..VplOptions::default() };
    let mut cpu = Photons::default();
    cpu.trace(&scene, &normals, &accel, &options, 5);
    let (expected, rays) = (cpu.vpls.clone(), cpu.rays);
    let paths = cpu.paths(&scene, &normals, &options, 5);
    assert!(expected.len() > CHUNK && paths.starts.iter().any(|s| s.vpl.is_some()) && paths.frames.len() == 4);
    let mut held = probe.hold(&scene, &accel).unwrap();
    let mut make = |edits: &[(&str, &str)], interleave: u32| held.photons(edits, &paths, interleave, BOUND).unwrap();

    let made = make(&[], 1);
    let alone = strangers(&made.vpls, &expected, radius);
    println!("{} VPLs, {} on the CPU, {alone} strangers; {} rays, {rays}", made.vpls.len(), expected.len(), made.rays);
    // Paths that part at an edge go on elsewhere.
    assert!(alone * 100 <= expected.len() && made.rays.abs_diff(rays) * 100 <= rays && made.capped == 0);
    assert!(chunks_hold(&made, 1) && made.chunks.len() == 3);
    // The last group of nine is a short one.
    assert_ne!(made.vpls.len() % 9, 0);
    let mut grouped = made.vpls.clone();
    group_subsets(&mut grouped, 9);
    let by_subsets = make(&[], 3);
    assert!(by_subsets.vpls == grouped && chunks_hold(&by_subsets, 3));

    for (name, from, to) in [
        ("mirrors reflect diffusely", "(s.look.diffuse * matte_weight(s.look))", "s.look.diffuse"),
        ("unlit reflects", "vec3f(0.0), unlit);", "vec3f(0.0), false);"),
        ("another half of the disc", "basis[0] * disc.x + basis[1] * disc.y", "basis[0] * disc.x - basis[1] * disc.y"),
        ("another bounce's sample", "along.w * photons.bounces + bounce", "along.w * photons.bounces"),
        ("frames without scale", "* place.w + place.xyz", "+ place.xyz"),
        ("frames without axes", "x.xyz * d.x + y.xyz * d.y + z.xyz * d.z, FAR_AWAY", "d, FAR_AWAY"),
        ("flux of one channel", "vec3f(x.w, y.w, z.w)", "vec3f(x.w)"),
        ("no VPL at the start", "if carried.w != 0u {", "if false {"),
        ("a bounce too few", "bounce < photons.bounces;", "bounce + 1u < photons.bounces;"),
        ("another source's frame", "inputs[at + 4u].w * SOURCE_WORDS", "0u"),
    ] {
        let faulty = make(&[(from, to)], 1);
        let alone = strangers(&faulty.vpls, &expected, radius);
        println!("photons with {name:?}: {alone} strangers");
        assert!(alone * 100 > expected.len(), "photons do not notice {name:?}");
    }
    for (name, from, to) in [
        ("VPLs without flux are kept", "lit += u32(is_lit(slot));", "lit += 1u;"),
        ("a group is not turned", "subset = (subset + m - turn) % m;", ""),
        ("short groups", "+ min(subset, count % m)", ""),
        ("each chunk is the first", "vec4u(count, chunk * VPL_CHUNK", "vec4u(count, 0u"),
        ("the number of all is lost", "vec4u(next, pack.interleave", "vec4u(count, pack.interleave"),
        ("chunks overlap", "(place / VPL_CHUNK) * pack.stride", "0u * pack.stride"),
        ("the bound is lost", "bitcast<u32>(pack.geometry_term_max), 0u", "0u, 0u"),
        ("error is lost", "array(slots[source],", "array(vec4u(slots[source].xyz, 0u),"),
    ] {
        let faulty = make(&[(from, to)], 3);
        assert!(faulty.vpls != grouped || !chunks_hold(&faulty, 3), "lists do not notice {name:?}");
    }
}
