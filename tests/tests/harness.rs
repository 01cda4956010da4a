//! The harness fails when it should: a missing golden, one changed byte, a picture beyond its tolerance in the mean or in
//! a small place, a changed hash, a known issue that is fixed. Every tolerance has a mutation here that must fail it.

use catoptra_engine::math;
use catoptra_render_hybrid::Image;
use catoptra_tests::{
    FlipLimits, HashError, HashLedger, Rendering, SnapshotError, SnapshotFolder, assert_close, assert_relative,
    known_issue,
};
use std::{
    panic::catch_unwind,
    path::{Path, PathBuf},
};

/// FLIP limits of these tests: what the lanes of the renderer are held to.
const LIMITS: FlipLimits = FlipLimits { mean: 0.02, percentile_99: 0.2 };

fn folder(name: &str) -> PathBuf {
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("harness-{name}"));
    let _ = std::fs::remove_dir_all(&dir);
    std::fs::create_dir_all(&dir).unwrap();
    dir
}

fn snapshots(name: &str) -> SnapshotFolder {
    let dir = folder(name);
    SnapshotFolder::new(dir.join("goldens"), dir.join("failures")).updating(false)
}

fn picture() -> Image {
    let mut image = Image::new(160, 120);
    for (i, p) in image.pixels.iter_mut().enumerate() {
        let (x, y) = ((i % 160) as f32, (i / 160) as f32);
        *p = [0.3 + 0.2 * math::sin(x * 0.2), 0.3 + 0.2 * math::cos(y * 0.3), 0.25];
    }
    image
}

fn changed(change: impl Fn(u32, u32, &mut [f32; 3])) -> Rendering {
    let mut image = picture();
    for (i, p) in image.pixels.iter_mut().enumerate() {
        change(i as u32 % 160, i as u32 / 160, p);
    }
    Rendering::of_image(&image)
}

#[test]
fn a_missing_golden_fails_and_is_not_written() {
    let s = snapshots("missing");
    let p = Rendering::of_image(&picture());
    for _ in 0..2 {
        assert!(matches!(s.check_exact("a", &p), Err(SnapshotError::Missing(_))));
        assert!(matches!(s.check_flip("a", &p, LIMITS), Err(SnapshotError::Missing(_))));
    }
}

#[test]
fn exact_means_every_byte() {
    let s = snapshots("exact");
    let good = Rendering::of_image(&picture());
    assert!(s.clone().updating(true).check_exact("a", &good).unwrap().updated);
    s.check_exact("a", &good).unwrap();
    let mut off = good.clone();
    off.srgb8[1000] ^= 1;
    let error = s.check_exact("a", &off).unwrap_err();
    let SnapshotError::Differs { bytes, folder, .. } = error else { panic!("{error}") };
    assert_eq!(bytes, 1);
    for kind in ["actual", "expected", "heat"] {
        assert!(folder.join(format!("a.{kind}.png")).is_file(), "{kind} is left behind");
    }
    // The same byte is within the tolerance of FLIP.
    s.check_flip("a", &off, LIMITS).unwrap();
    let small = Rendering::of_image(&Image::new(8, 8));
    assert!(matches!(s.check_exact("a", &small), Err(SnapshotError::Size { .. })));
}

#[test]
fn flip_mean_fails_a_slightly_wrong_picture() {
    let s = snapshots("mean");
    s.clone().updating(true).check_exact("a", &Rendering::of_image(&picture())).unwrap();
    // Too bright by a tenth of a percent, by two percent.
    let brighter = |f: f32| changed(move |_, _, p| *p = p.map(|v| v * f));
    s.check_flip("a", &brighter(1.001), LIMITS).unwrap();
    let error = s.check_flip("a", &brighter(1.02), LIMITS).unwrap_err();
    let SnapshotError::Differs { report, .. } = error else { panic!("{error}") };
    assert!(report.mean > LIMITS.mean && report.percentile_99 < LIMITS.percentile_99, "{report:?}");
}

#[test]
fn flip_percentile_fails_a_small_wrong_place() {
    let s = snapshots("percentile");
    s.clone().updating(true).check_exact("a", &Rendering::of_image(&picture())).unwrap();
    let spot = changed(|x, y, p| {
        if (20..32).contains(&x) && (20..32).contains(&y) {
            *p = [0.0, 0.0, 0.6];
        }
    });
    let error = s.check_flip("a", &spot, LIMITS).unwrap_err();
    let SnapshotError::Differs { report, .. } = error else { panic!("{error}") };
    assert!(report.mean < LIMITS.mean && report.percentile_99 > LIMITS.percentile_99, "{report:?}");
}

#[test]
fn a_golden_that_is_no_picture_fails() {
    let dir = folder("damaged");
    let s = SnapshotFolder::new(&dir, dir.join("failures")).updating(false);
    std::fs::write(dir.join("a.png"), b"\x89PNG\r\n\x1a\nnothing").unwrap();
    assert!(matches!(s.check_exact("a", &Rendering::of_image(&picture())), Err(SnapshotError::File(_))));
}

#[test]
fn hashes_are_held_exactly() {
    let path = folder("hashes").join("hashes.txt");
    let ledger = || HashLedger::new(&path).updating(false);
    let hash = picture().hash();
    assert_eq!(ledger().check("a", hash), Err(HashError::Missing("a".into())));
    ledger().updating(true).check("b", 7).unwrap();
    ledger().updating(true).check("a", hash).unwrap();
    ledger().check("a", hash).unwrap();
    assert_eq!(ledger().names().unwrap(), ["a", "b"]);

    // The least step of one channel of one pixel, and nothing less, changes the hash.
    let mut image = picture();
    image.pixels[77][2] = image.pixels[77][2].next_up();
    let actual = image.hash();
    assert_eq!(ledger().check("a", actual), Err(HashError::Differs { name: "a".into(), actual, expected: hash }));
    image = Image::new(4, 4);
    let zero = image.hash();
    image.pixels[3] = [-0.0; 3];
    assert_eq!(image.hash(), zero, "-0 counts as +0");

    std::fs::write(&path, "a nothing\n").unwrap();
    assert!(matches!(ledger().check("a", hash), Err(HashError::File(_))));
}

#[test]
fn known_issues_tell_when_they_are_fixed() {
    known_issue("two and two", || assert_eq!(2 + 2, 5));
    assert!(catch_unwind(|| known_issue("fixed", || ())).is_err());
}

#[test]
fn numbers_out_of_tolerance_fail() {
    assert_close("within", 1.0, 1.1, 0.11);
    assert_relative("within", 99.0, 100.0, 0.011);
    for wrong in [1.2, f64::NAN, f64::INFINITY] {
        assert!(catch_unwind(|| assert_close("wrong", wrong, 1.0, 0.1)).is_err());
        assert!(catch_unwind(|| assert_relative("wrong", wrong, 1.0, 0.1)).is_err());
    }
}
