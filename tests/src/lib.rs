//! The harness of Catoptra's suites, small enough to use in the tests of a game that embeds the module:
//!
//! * [`SnapshotFolder`] compares pictures with golden PNGs, exactly or by FLIP (mean and 99th percentile), and leaves the
//!   actual picture, the expected one and a heat map behind where they differ. `CATOPTRA_UPDATE_GOLDENS=1` rewrites.
//! * [`HashLedger`] holds exact hashes of linear pictures in one text file.
//! * [`gpu_or_skip`] gives a GPU renderer, or says loudly that there is none; with `CI` set that is a failure.
//! * [`HandScene`] builds scenes without an ECS, for answers derivable on paper.
//!
//! ```no_run
//! use catoptra_tests::{FlipLimits, Rendering, SnapshotFolder};
//! # let frame = catoptra_render_hybrid::Frame::default();
//! let goldens = SnapshotFolder::new("tests/goldens", "target/snapshots");
//! let limits = FlipLimits { mean: 0.02, percentile_99: 0.2 };
//! goldens.check_flip("title-screen", &Rendering::of_image(&frame.image), limits).unwrap();
//! ```

mod crowd;
pub mod ecs;
pub mod fixtures;
mod gpu;
mod hand;
mod hashes;
mod known_issue;
mod numbers;
mod random;
mod shared;
mod snapshot;

pub use crowd::Crowd;
pub use gpu::{gpu_or_skip, opened_or_skip, skip, skips};
pub use hand::{HandScene, at, wall_of_positions};
pub use hashes::{HashError, HashLedger};
pub use known_issue::known_issue;
pub use numbers::{assert_close, assert_relative};
pub use random::Random;
pub use shared::shared_or_skip;
pub use snapshot::{FlipLimits, Rendering, SnapshotError, SnapshotFolder, SnapshotReport};

/// True where golden pictures and hashes are to be rewritten: `CATOPTRA_UPDATE_GOLDENS` is set to anything but `0`.
pub fn updating_goldens() -> bool {
    std::env::var_os("CATOPTRA_UPDATE_GOLDENS").is_some_and(|v| !v.is_empty() && v != "0")
}

/// The README's example, compiled and run.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
struct Readme;

/// The embedding page's examples, compiled and run.
#[cfg(doctest)]
#[doc = include_str!("../../docs/embedding.md")]
struct Embedding;
