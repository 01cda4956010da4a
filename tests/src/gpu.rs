//! A GPU for a test, or a loud word that there is none.

use catoptra_render_hybrid::{RasterLane, RenderError, Renderer, RendererOptions};
use std::{
    io::Write,
    sync::atomic::{AtomicU32, Ordering},
};

static SKIPS: AtomicU32 = AtomicU32::new(0);

/// Tests of this process that were skipped so far.
pub fn skips() -> u32 {
    SKIPS.load(Ordering::Relaxed)
}

/// Says on stderr, past the test runner's capture, that `test` was skipped and why; counts it.
///
/// # Panics
/// Where the environment variable `CI` is set: there a skip would be a hole that nobody sees.
pub fn skip(test: &str, why: &str) {
    let n = SKIPS.fetch_add(1, Ordering::Relaxed) + 1;
    // `eprintln!` would be captured with a passing test's output.
    let _ = writeln!(std::io::stderr(), "SKIPPED {test}: {why} ({n} skipped in this run)");
    assert!(std::env::var_os("CI").is_none(), "{test} was skipped, which CI does not accept: {why}");
}

/// A renderer on the GPU lane (software Vulkan counts), or `None` after [`skip`].
///
/// # Panics
/// As [`opened_or_skip`].
pub fn gpu_or_skip(test: &str) -> Option<Renderer> {
    let options = RendererOptions { raster: RasterLane::Gpu, ..RendererOptions::default() };
    opened_or_skip(test, Renderer::new(options))
}

/// Whatever part of the GPU lane was opened, or `None` after [`skip`] where this machine has no adapter.
///
/// # Panics
/// Where there is an adapter that fails in any other way than not being there, and as [`skip`].
pub fn opened_or_skip<T>(test: &str, opened: Result<T, RenderError>) -> Option<T> {
    match opened {
        Ok(gpu) => Some(gpu),
        Err(RenderError::Unavailable { missing, .. }) => {
            skip(test, &missing);
            None
        }
        Err(e) => panic!("{test}: the GPU lane could not be made: {e}"),
    }
}
