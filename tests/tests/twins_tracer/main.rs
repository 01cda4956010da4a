//! Twins of the GPU tracer's stages over a scene in its heaps: places of surfaces, media, interfaces, the kd-tree's walk, and
//! the words that all of them read.
//!
//! Every test runs its WGSL once as it is, which must agree with Rust, and again with each of some faults put into the text,
//! which must not: that a test can fail is part of it.

mod bvh;
mod camera;
mod heaps;
mod holes;
mod kd;
mod media;
mod photons;
mod scenes;
mod shade;
mod split;
mod surface;

use catoptra_engine::RenderScene;
use catoptra_render_hybrid::{
    BlasKind,
    accel::{Accel, AccelOptions},
    raster::testing::ShaderProbe,
};
use catoptra_tests::{Random, opened_or_skip};

fn probe() -> Option<ShaderProbe> {
    opened_or_skip("twins_tracer", ShaderProbe::new())
}

fn followed(scene: &RenderScene, blas: BlasKind) -> Accel {
    scene.validate().unwrap();
    let mut accel = Accel::new(AccelOptions { blas, ..AccelOptions::default() }).unwrap();
    accel.update(scene);
    accel
}

/// What the GPU may say: `low` to `high`, and `slack` more on both sides.
#[derive(Clone, Copy, Debug)]
struct Allowed {
    low: f32,
    high: f32,
    slack: f32,
}

impl Allowed {
    fn about(value: f32, slack: f32) -> Self {
        Self { low: value, high: value, slack }
    }
    fn exactly(value: f32) -> Self {
        Self::about(value, 0.0)
    }
    /// Anything: what a rounding decides.
    const ANY: Self = Self { low: f32::NEG_INFINITY, high: f32::INFINITY, slack: 0.0 };

    /// How far off `got` is, in slacks: at most 1 is right.
    fn excess(&self, got: f32) -> f32 {
        if self.low == f32::NEG_INFINITY {
            return 0.0;
        }
        let off = (self.low - got).max(got - self.high).max(0.0);
        // NaN is never right.
        if off == 0.0 && !got.is_nan() { 0.0 } else { (off / self.slack).max(f32::MIN_POSITIVE) }
    }
}

/// A table of the GPU's answers against what is allowed.
struct Verdict {
    rows: usize,
    wrong: usize,
    /// The first row that is wrong, in words.
    first: String,
    /// By named columns: greatest distance from what is allowed without slack, absolute and in slacks.
    worst: Vec<(String, f32, f32)>,
}

impl Verdict {
    /// * `columns`: names with the count of numbers that each has
    fn of<const M: usize>(
        columns: &[(&str, usize)],
        gpu: &[[f32; M]],
        allowed: impl Fn(usize) -> [Allowed; M],
    ) -> Self {
        let names: Vec<usize> = columns.iter().enumerate().flat_map(|(k, c)| vec![k; c.1]).collect();
        assert_eq!(names.len(), M, "names for all numbers");
        let worst = columns.iter().map(|c| (c.0.to_string(), 0.0, 0.0)).collect();
        let mut out = Self { rows: gpu.len(), wrong: 0, first: String::new(), worst };
        for (row, g) in gpu.iter().enumerate() {
            let allowed = allowed(row);
            let mut bad = false;
            for (i, (a, got)) in allowed.iter().zip(g).enumerate() {
                let excess = a.excess(*got);
                let off = if excess > 0.0 { (a.low - got).max(got - a.high) } else { 0.0 };
                let w = &mut out.worst[names[i]];
                (w.1, w.2) = (w.1.max(off), w.2.max(excess));
                // A NaN in the sum of both is no right answer, either.
                if !(excess <= 1.0) || got.is_nan() {
                    bad = true;
                    if out.first.is_empty() {
                        out.first = format!("row {row}, {} (number {i}): GPU {got:e}, allowed {a:?}", w.0);
                    }
                }
            }
            out.wrong += usize::from(bad);
        }
        out
    }

    /// All rows are right; says how right.
    fn agrees(&self, what: &str) {
        println!("{what}: {} rows, greatest differences (and in what is allowed):", self.rows);
        for (name, off, excess) in self.worst.iter().filter(|w| w.1 > 0.0) {
            println!("  {name}: {off:.2e} ({excess:.2})");
        }
        assert_eq!(self.wrong, 0, "{what}: {} of {} rows are wrong; {}", self.wrong, self.rows, self.first);
    }

    /// A fault was noticed.
    fn fails(&self, what: &str, fault: &str) {
        println!("{what} with {fault:?}: {} of {} rows are wrong", self.wrong, self.rows);
        assert!(self.wrong > 0, "{what} does not notice {fault:?}");
    }
}

#[test]
fn verdicts_notice_what_is_wrong() {
    let verdict = |got: f32, a: Allowed| Verdict::of(&[("it", 1)], &[[got]], |_| [a]).wrong;
    assert_eq!(verdict(1.0, Allowed::exactly(1.0)), 0);
    assert_eq!(verdict(1.000_000_1, Allowed::exactly(1.0)), 1);
    assert_eq!(verdict(1.05, Allowed::about(1.0, 0.1)), 0);
    assert_eq!(verdict(1.2, Allowed::about(1.0, 0.1)), 1);
    assert_eq!(verdict(f32::NAN, Allowed::about(1.0, 0.1)), 1);
    assert_eq!(verdict(f32::INFINITY, Allowed::about(1.0, 0.1)), 1);
    assert_eq!(verdict(f32::NAN, Allowed::ANY), 1);
}
