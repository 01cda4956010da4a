//! The fuzz targets' own checks over their corpus and over bytes made on the spot: hostile files and impossible scenes never
//! bring a program down. `cargo +nightly fuzz run glb` and `... run scene` go on from there.

#[path = "../../fuzz/src/glb.rs"]
mod glb;
#[path = "../../fuzz/src/scene.rs"]
mod scene;

use std::path::Path;

fn corpus(name: &str) -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus").join(name);
    let mut out: Vec<_> = std::fs::read_dir(&folder)
        .unwrap_or_else(|e| panic!("{}: {e}", folder.display()))
        .map(|e| e.expect("a readable folder").path())
        .map(|p| (p.display().to_string(), std::fs::read(&p).expect("a readable file")))
        .collect();
    out.sort();
    assert!(!out.is_empty(), "{} is empty", folder.display());
    out
}

/// Bytes that look random and are the same in each run.
fn noise(seed: u64, length: usize) -> Vec<u8> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    (0..length)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 24) as u8
        })
        .collect()
}

#[test]
fn glb_corpus_and_its_mutations() {
    let mut drawn = 0;
    for (path, bytes) in corpus("glb") {
        // Those that a fuzzer found need not be files at all.
        if path.contains("fuzz-") {
            println!("{path}");
            glb::check(&bytes);
            continue;
        }
        assert!(glb::check(&bytes), "{path} is a file that can be drawn");
        for seed in 0..24 {
            let mut changed = bytes.clone();
            for pair in noise(seed, 8).chunks_exact(4) {
                let at = (usize::from(pair[0]) << 8 | usize::from(pair[1])) % changed.len();
                changed[at] = pair[2];
            }
            drawn += u32::from(glb::check(&changed));
            glb::check(&bytes[..bytes.len() * seed as usize / 24]);
        }
    }
    assert!(drawn > 0, "some changes leave a file that can be drawn");
}

#[test]
fn scene_corpus_and_noise() {
    let mut drawn = 0;
    for (path, bytes) in corpus("scene") {
        println!("{path}");
        scene::check(&bytes);
    }
    for seed in 1..300 {
        println!("noise {seed}");
        drawn += u32::from(scene::check(&noise(seed, 600)));
    }
    println!("{drawn} of 299 drawn");
    assert!((60..299).contains(&drawn), "some are refused, but not most: {drawn} of 299 were drawn");
}
