//! VPLs on surfels: they keep all light, stay on their bodies, change little where little changes, and give way where they would
//! not cover a scene.

use catoptra_engine::{
    Camera, LightKind, Material, RenderScene,
    app::advance,
    shapes::{ShapeBuilder, cuboid, sphere},
};
use catoptra_render_hybrid::{
    BlasKind, NearField, RenderSettings, RendererOptions, SimdLevel, VplOptions, VplPlacement,
    accel::{Accel, AccelOptions},
    trace::{photons::Photons, surface::NormalMatrices},
    twin::vpl::Vpl,
};
use catoptra_tests::{
    HandScene, assert_relative, at,
    fixtures::{SCENE_NAMES, app_at, cpu, cpu_with, extracted, fresh, scene_at, small},
};
use glam::{Affine3, Quat, Vec3};
use std::collections::HashSet;

const SURFELS: VplOptions = VplOptions {
    count: 400,
    candidates: 1,
    placement: VplPlacement::Surfels,
    bounces: 2,
    geometry_term_max: Some(30.0),
    shadows: catoptra_render_hybrid::VplShadows::Maps,
    map_size: 16,
    spacing: 1,
    mirrored: 0,
    near_field: NearField::Off,
    interleave: 1,
    reuse: 0,
};

/// Keeps its pattern from scene to scene, as the renderer does.
struct Maker {
    photons: Photons,
    level: SimdLevel,
}

impl Maker {
    fn new(level: SimdLevel) -> Self {
        Self { photons: Photons::default(), level }
    }

    fn vpls(&mut self, scene: &RenderScene, options: VplOptions) -> Vec<Vpl> {
        let mut accel =
            Accel::new(AccelOptions { blas: BlasKind::Bvh, simd: self.level, ..Default::default() }).unwrap();
        accel.update(scene);
        let mut normals = NormalMatrices::default();
        normals.update(scene);
        self.photons.trace(scene, &normals, &accel, &options, 0);
        self.photons.vpls.clone()
    }
}

fn vpls_of(scene: &RenderScene, options: VplOptions) -> Vec<Vpl> {
    Maker::new(SimdLevel::Portable).vpls(scene, options)
}

fn flux(vpls: &[Vpl]) -> [f64; 3] {
    [0, 1, 2].map(|c| vpls.iter().map(|v| f64::from(v.flux[c])).sum())
}

/// A closed room of half size 1 with walls of six colours, a light in it, and what else is added.
fn room() -> HandScene {
    let mut scene = HandScene::new(Camera::looking_at(Vec3::new(0.0, 0.2, 0.9), Vec3::ZERO, 1.2));
    let colors = [Vec3::X, Vec3::Y, Vec3::Z, Vec3::ONE, Vec3::new(0.9, 0.5, 0.1), Vec3::splat(0.3)];
    scene.add(cuboid(Vec3::ONE, colors), Material::lambert(Vec3::splat(0.6)), Affine3::IDENTITY);
    scene.light(LightKind::Point, Vec3::new(0.3, 0.5, -0.2), Vec3::splat(2.0));
    scene
}

fn with_box(place: Affine3) -> RenderScene {
    let mut scene = room();
    scene.add(cuboid(Vec3::splat(0.2), [Vec3::ONE; 6]), Material::lambert(Vec3::new(0.7, 0.2, 0.1)), place);
    scene.0
}

#[test]
fn no_light_is_lost() {
    let landings = VplOptions { count: 400 * 16, placement: VplPlacement::Paths, ..SURFELS };
    for scene in [room().0, with_box(at(Vec3::new(-0.4, -0.8, 0.1))), scene_at("rolling-box-venus", 30)] {
        let (gathered, all) = (vpls_of(&scene, SURFELS), vpls_of(&scene, landings));
        assert!(gathered.len() <= 500 && all.len() > 1000, "{} for {}", gathered.len(), all.len());
        for (gathered, all) in flux(&gathered).into_iter().zip(flux(&all)) {
            // Relative; sums of thousands of shares in single precision.
            assert_relative("flux", gathered, all, 2e-5);
        }
    }
}

#[test]
fn the_pattern_is_the_bodies_own() {
    let moves = [
        Affine3::from_translation(Vec3::new(-0.4, -0.7, 0.1)),
        Affine3::from_rotation_translation(Quat::from_rotation_x(0.7), Vec3::new(-0.4, -0.6, 0.1)),
        Affine3::from_rotation_translation(
            Quat::from_euler(glam::EulerRot::XYZ, 1.0, 2.0, 0.3),
            Vec3::new(0.5, 0.1, -0.4),
        ),
    ];
    let mut maker = Maker::new(SimdLevel::Portable);
    // The last eight blocks at most are the box's own: seen from it, its places are the same wherever it is.
    let seen_from_the_box = |vpls: &[Vpl], place: Affine3| -> Vec<Vec3> {
        let from_world = place.inverse();
        let own = |v: &Vpl| from_world.transform_point3(v.position_world);
        vpls.iter().map(own).filter(|p| p.abs().max_element() < 0.2001).collect()
    };
    let first = seen_from_the_box(&maker.vpls(&with_box(moves[0]), SURFELS), moves[0]);
    assert!(first.len() >= 16, "{} lie on the box", first.len());
    let fresh_places = |place: Affine3| seen_from_the_box(&vpls_of(&with_box(place), SURFELS), place);
    for place in moves {
        let vpls = maker.vpls(&with_box(place), SURFELS);
        assert_eq!(vpls, vpls_of(&with_box(place), SURFELS), "what was before does not matter");
        let now = fresh_places(place);
        let near = |a: &Vec3| first.iter().any(|b| a.distance_squared(*b) < 1e-8);
        // One side may be dark at one place and not at another.
        let same = now.iter().filter(|a| near(a)).count();
        assert!(same + 8 >= now.len() && same >= 16, "{same} of {} are where they were", now.len());
    }
}

#[test]
fn what_stands_still_keeps_its_vpls() {
    let places = |scene: &RenderScene| -> HashSet<[u32; 3]> {
        vpls_of(scene, SURFELS).iter().map(|v| v.position_world.to_array().map(f32::to_bits)).collect()
    };
    let scene = room();
    let mut moved = room();
    moved.0.lights[0].position_world = Vec3::new(-0.4, 0.1, 0.3);
    let (a, b) = (places(&scene.0), places(&moved.0));
    assert_eq!(a, b, "another light lights the same places");
    let paths = VplOptions { placement: VplPlacement::Paths, ..SURFELS };
    let of = |scene: &RenderScene| vpls_of(scene, paths)[0].position_world;
    assert_ne!(of(&scene.0), of(&moved.0), "landings do move");
}

/// Sum of what changes, as a share of all flux, where VPLs are told from each other by where they lie.
fn change(a: &[Vpl], b: &[Vpl]) -> f64 {
    assert_eq!(a.len(), b.len());
    let one = |(a, b): (&Vpl, &Vpl)| f64::from((a.flux - b.flux).abs().element_sum());
    a.iter().zip(b).map(one).sum::<f64>() / flux(a).iter().sum::<f64>()
}

#[test]
fn little_motion_changes_little() {
    let mut moved = room();
    moved.0.lights[0].position_world += Vec3::new(0.01, 0.0, 0.005);
    let change = change(&vpls_of(&room().0, SURFELS), &vpls_of(&moved.0, SURFELS));
    println!("11 mm of the light's way change {:.2} % of the flux", 100.0 * change);
    assert!(change > 0.0 && change < 0.03, "{change}");
}

#[test]
fn they_do_not_depend_on_threads_or_simd() {
    let scene = scene_at("two-spheres", 30);
    let of = |threads: usize, level| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| Maker::new(level).vpls(&scene, SURFELS))
    };
    let first = of(1, SimdLevel::Portable);
    assert!(first.len() > 300);
    assert_eq!(of(3, SimdLevel::Portable), first);
    assert_eq!(of(2, SimdLevel::Auto), first);
    let picture = |threads, simd| {
        let settings = small(48, 40, 64);
        cpu_with(RendererOptions { threads, simd, ..RendererOptions::default() })
            .render(&scene, &settings)
            .unwrap()
            .image
    };
    assert_eq!(picture(3, SimdLevel::Auto), picture(1, SimdLevel::Portable));
}

/// A sheet without thickness across the room, lit from above alone.
#[test]
fn both_sides_of_a_sheet_have_light_of_their_own() {
    let mut scene = room();
    let mut b = ShapeBuilder::default();
    b.quad([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]].map(|[x, z]| Vec3::new(x, 0.0, z)), Vec3::ONE);
    scene.add(b.build(), Material::lambert(Vec3::splat(0.5)), Affine3::IDENTITY);
    let vpls = vpls_of(&scene.0, SURFELS);
    let on_sheet = |up: f32| -> f64 {
        let of = |v: &&Vpl| v.position_world.y.abs() < 1e-4 && v.normal_world.y * up > 0.5;
        vpls.iter().filter(of).map(|v| f64::from(v.flux.x)).sum()
    };
    assert!(on_sheet(1.0) > 1.0, "the light shines on its upper side");
    assert_eq!(on_sheet(-1.0), 0.0, "and none comes through");
}

#[test]
fn light_of_what_has_no_surfels_is_kept() {
    // A pane of mirror that glows: its emission starts paths, and it has no matte side to lay surfels on but for that.
    let mut scene = room();
    let glow = Material { emissive: Vec3::new(3.0, 2.0, 1.0), ..Material::lambert(Vec3::ZERO) };
    scene.add(sphere(0.1, 8, 16), glow, at(Vec3::new(-0.5, 0.0, 0.0)));
    let paths = VplOptions { count: 400 * 16, placement: VplPlacement::Paths, ..SURFELS };
    for (of_surfels, of_paths) in flux(&vpls_of(&scene.0, SURFELS)).into_iter().zip(flux(&vpls_of(&scene.0, paths))) {
        assert_relative("flux of a room with a lamp", of_surfels, of_paths, 2e-5);
    }
    // A mirror between matte walls: a sixteenth of it may be missed by the test of what is matte, its light may not.
    let mut bounced = room();
    bounced.add(sphere(0.3, 16, 32), Material::mirror(Vec3::ONE, 1.0), at(Vec3::new(0.3, -0.6, 0.3)));
    for (of_surfels, of_paths) in flux(&vpls_of(&bounced.0, SURFELS)).into_iter().zip(flux(&vpls_of(&bounced.0, paths)))
    {
        assert_relative("flux beside a mirror", of_surfels, of_paths, 2e-5);
    }
}

/// VPLs that surfels make are not those of paths.
fn on_surfels(scene: &RenderScene, count: u32) -> bool {
    let options = VplOptions { count, ..SURFELS };
    vpls_of(scene, options) != vpls_of(scene, VplOptions { placement: VplPlacement::Paths, ..options })
}

#[test]
fn surfels_give_way_where_they_would_not_cover() {
    for name in SCENE_NAMES {
        let scene = scene_at(name, 0);
        let room = name != "rolling-box-sponza";
        assert_eq!(on_surfels(&scene, 400), room, "{name}, 400");
        assert_eq!(on_surfels(&scene, 6144), room, "{name}, 6144");
        assert!(!on_surfels(&scene, 64), "{name}: 64 are too few");
    }
    let mut crowd = room();
    for i in 0..40 {
        let place = at(Vec3::new(-0.8 + 0.04 * i as f32, -0.9, 0.0));
        crowd.add(cuboid(Vec3::splat(0.01), [Vec3::ONE; 6]), Material::lambert(Vec3::ONE), place);
    }
    assert!(!on_surfels(&crowd.0, 400), "bodies would have them all");
    assert!(on_surfels(&crowd.0, 3000));
    let mut without = VplOptions { shadows: catoptra_render_hybrid::VplShadows::Off, ..SURFELS };
    let off = vpls_of(&room().0, without);
    without.placement = VplPlacement::Paths;
    assert_eq!(off, vpls_of(&room().0, without), "without visibility paths serve");
}

#[test]
fn size_does_not_matter() {
    for scale in [1e-4f32, 1.0, 1e4] {
        let mut scene = HandScene::new(Camera::looking_at(Vec3::new(0.0, 0.2, 0.9) * scale, Vec3::ZERO, 1.2));
        let material = Material::lambert(Vec3::splat(0.6));
        scene.add(cuboid(Vec3::ONE, [Vec3::ONE; 6]), material, Affine3::from_scale(Vec3::splat(scale)));
        scene.light(LightKind::Point, Vec3::new(0.3, 0.5, -0.2) * scale, Vec3::splat(2.0));
        let vpls = vpls_of(&scene.0, SURFELS);
        assert!((300..=420).contains(&vpls.len()), "scale {scale}: {}", vpls.len());
        assert!(vpls.iter().all(|v| v.flux.is_finite() && v.position_world.is_finite()));
        let extent = vpls.iter().map(|v| v.position_world.abs().max_element()).fold(0.0, f32::max);
        assert_relative("they lie on the walls", f64::from(extent), f64::from(scale), 1e-3);
    }
}

#[test]
fn what_has_no_area_does_no_harm() {
    let expected = vpls_of(&room().0, SURFELS);
    let mut scene = room();
    let mut b = ShapeBuilder::default();
    b.quad([Vec3::ZERO; 4], Vec3::ONE);
    scene.add(b.build(), Material::lambert(Vec3::ONE), Affine3::IDENTITY);
    let flat = Affine3::from_scale(Vec3::ZERO);
    scene.add(cuboid(Vec3::splat(0.1), [Vec3::ONE; 6]), Material::lambert(Vec3::ONE), flat);
    let vpls = vpls_of(&scene.0, SURFELS);
    assert!(vpls.iter().all(|v| v.flux.is_finite() && v.position_world.is_finite() && v.normal_world.is_finite()));
    assert_relative("flux", flux(&vpls)[0], flux(&expected)[0], 1e-3);
}

/// What a renderer keeps from frame to frame never shows, and where lights alone move no map is made anew.
#[test]
fn maps_of_surfels_are_kept() {
    let mut settings: RenderSettings = small(48, 48, 64);
    settings.vpl = settings.vpl.map(|v| VplOptions { mirrored: 0, ..v });
    let mut renderer = cpu();
    let mut app = app_at("rolling-box", 30);
    let bodies = extracted(&app).instances;
    let mut first = 0;
    for frame in 30..34 {
        let mut scene = extracted(&app);
        advance(&mut app, 1);
        scene.instances.clone_from(&bodies);
        let (kept, anew) = (renderer.render(&scene, &settings).unwrap(), fresh(&scene, &settings));
        assert_eq!(kept.image, anew.image, "frame {frame}");
        if frame == 30 {
            first = kept.stats.rays.vpl_maps;
            assert!(first > 10_000, "{first} rays");
        } else {
            // At most some for surfels that were dark.
            let now = kept.stats.rays.vpl_maps;
            assert!(now < first / 20, "frame {frame}: {now} of {first} rays");
        }
    }
}
