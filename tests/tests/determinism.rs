//! A pixel is a function of (scene, pixel, settings): one hash for any number of threads, tile size, SIMD level and kind of
//! tree, for repeated runs, alone or within a sequence, and whatever the renderer drew before. Test profile and release are
//! compared by `.ci/run`. history.rs holds the same for edited worlds.

use catoptra_engine::{RenderScene, app::advance};
use catoptra_render_hybrid::{BlasKind, RenderSettings, RendererOptions, Shadows, SimdLevel, simd};
use catoptra_tests::fixtures::{FRAMES, SCENE_NAMES, app_at, cpu, cpu_with, extracted, full_vpls, scene_at, small};

/// Not a multiple of any tile, and larger than the largest.
fn settings() -> RenderSettings {
    small(76, 68, 64)
}

fn hash(options: RendererOptions, scene: &RenderScene, settings: &RenderSettings) -> u64 {
    cpu_with(options).render(scene, settings).unwrap().image.hash()
}

/// All SIMD levels that this machine has, said aloud.
fn levels() -> Vec<SimdLevel> {
    let all = [SimdLevel::Auto, SimdLevel::Portable, SimdLevel::Avx2, SimdLevel::Avx512];
    let there: Vec<SimdLevel> = all.into_iter().filter(|l| simd::resolve(*l).is_ok()).collect();
    println!("SIMD levels here: {:?}", there.iter().map(|l| simd::level_name(*l)).collect::<Vec<_>>());
    there
}

#[test]
fn one_hash_for_threads_tiles_levels_and_trees() {
    let levels = levels();
    for name in SCENE_NAMES {
        for frame in FRAMES {
            let scene = scene_at(name, frame);
            let expected = hash(RendererOptions::default(), &scene, &settings());
            let same = |what: &str, options: RendererOptions, settings: &RenderSettings| {
                assert_eq!(hash(options, &scene, settings), expected, "{name} frame {frame}: {what}");
            };
            same("repeated", RendererOptions::default(), &settings());
            for threads in [1, 2, 3, 8] {
                let options = RendererOptions { threads, ..RendererOptions::default() };
                same(&format!("{threads} threads"), options, &settings());
            }
            for tile in [8, 16, 32, 64] {
                same(&format!("tile {tile}"), RendererOptions::default(), &RenderSettings { tile, ..settings() });
            }
            for &simd in &levels {
                same(&format!("{simd:?}"), RendererOptions { simd, ..RendererOptions::default() }, &settings());
            }
            let blas = BlasKind::KdTree;
            same("kd-tree", RendererOptions { blas, ..RendererOptions::default() }, &settings());
            let odd = RendererOptions { threads: 3, simd: SimdLevel::Portable, blas, ..RendererOptions::default() };
            same("all at once", odd, &RenderSettings { tile: 8, ..settings() });
        }
    }
}

/// Traced shadows, traced VPLs and clear glass take other ways through the code.
#[test]
fn one_hash_for_the_traced_variants() {
    let mut pictures = Vec::new();
    for name in ["rolling-box-donut", "rolling-box-venus"] {
        let scene = scene_at(name, 30);
        let traced = RenderSettings {
            shadows: Shadows::Traced,
            shadow_samples: 5,
            vpl: Some(full_vpls(24, 3)),
            glass_shadows: catoptra_render_hybrid::GlassShadows::Clear,
            ..small(60, 52, 64)
        };
        let expected = hash(RendererOptions::default(), &scene, &traced);
        for level in levels() {
            for (threads, tile, blas) in [(1, 8, BlasKind::Bvh), (3, 64, BlasKind::KdTree)] {
                let options = RendererOptions { threads, simd: level, blas, ..RendererOptions::default() };
                let settings = RenderSettings { tile, ..traced };
                assert_eq!(hash(options, &scene, &settings), expected, "{name}: {level:?}, {threads} threads");
            }
        }
        pictures.push(expected);
    }
    assert_ne!(pictures[0], pictures[1]);
}

/// The mismatch to all these matches: what may change the picture does.
#[test]
fn what_changes_the_picture_changes_the_hash() {
    let scene = scene_at("rolling-box-donut", 30);
    let base = settings();
    let expected = hash(RendererOptions::default(), &scene, &base);
    let changes: [(&str, RenderSettings); 7] = [
        ("size", RenderSettings { width: base.width + 1, ..base }),
        ("seed", RenderSettings { seed: 1, ..base }),
        ("depth", RenderSettings { max_depth: 1, ..base }),
        ("VPLs", RenderSettings { vpl: None, ..base }),
        ("shadows", RenderSettings { shadows: Shadows::Off, ..base }),
        ("tracing", RenderSettings { traced: false, ..base }),
        ("maps", small(base.width, base.height, 96)),
    ];
    for (what, settings) in changes {
        assert_ne!(hash(RendererOptions::default(), &scene, &settings), expected, "{what} does not show");
    }
    let other = scene_at("rolling-box-donut", 31);
    assert_ne!(hash(RendererOptions::default(), &other, &base), expected, "the next frame is the same picture");
}

#[test]
fn a_frame_alone_equals_the_frame_of_a_sequence() {
    let settings = small(48, 40, 32);
    for name in SCENE_NAMES {
        let mut app = app_at(name, 0);
        let mut renderer = cpu();
        let mut sequence = Vec::new();
        for frame in 0..=90 {
            let scene = extracted(&app);
            // Every third frame is left out: a renderer that missed revisions compares everything.
            if frame % 3 == 0 {
                sequence.push(renderer.render(&scene, &settings).unwrap().image.hash());
            }
            advance(&mut app, 1);
        }
        for frame in FRAMES {
            let alone = cpu().render(&scene_at(name, frame), &settings).unwrap().image.hash();
            assert_eq!(alone, sequence[frame as usize / 3], "{name} frame {frame}");
        }
        let mut different = sequence.clone();
        different.sort_unstable();
        different.dedup();
        assert_eq!(different.len(), sequence.len(), "{name}: two frames of the sequence are one picture");
    }
}

#[test]
fn a_renderer_that_drew_another_scene_draws_the_same() {
    let settings = settings();
    let scenes = SCENE_NAMES.map(|name| scene_at(name, 30));
    let alone = scenes.each_ref().map(|s| hash(RendererOptions::default(), s, &settings));
    let mut one = cpu();
    // Forwards and backwards, so that every scene follows each of its neighbours.
    for i in (0..5).chain((0..5).rev()) {
        assert_eq!(one.render(&scenes[i], &settings).unwrap().image.hash(), alone[i], "{}", SCENE_NAMES[i]);
        // Another size in between must not show either.
        one.render(&scenes[i], &small(33, 17, 16)).unwrap();
    }
}
