//! Harness of the suites in `tests/`.

use catoptra_render_hybrid::RenderError;

/// The GPU part of a test, or `None` after saying that it was skipped because this machine has no adapter.
///
/// # Panics
/// Where the environment variable CI is set and there is no adapter: CI has software Vulkan, a skip there is a failure. And
/// where an adapter is there but fails.
pub fn gpu_or_skip<T>(test: &str, opened: Result<T, RenderError>) -> Option<T> {
    match opened {
        Ok(gpu) => Some(gpu),
        Err(RenderError::Unavailable { missing, .. }) => {
            assert!(std::env::var_os("CI").is_none(), "{test}: CI must have an adapter, but: {missing}");
            eprintln!("SKIPPED {test}: {missing}");
            None
        }
        Err(error) => panic!("{test}: {error}"),
    }
}
