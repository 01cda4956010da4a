//! Tests that must fail, so that nobody forgets the bug and nobody misses its end.

use std::panic::{AssertUnwindSafe, catch_unwind};

/// Runs `test`, which states the right behaviour and fails today because of a known bug.
///
/// # Panics
/// Where `test` passes: the bug is gone, and the test belongs into its own suite.
pub fn known_issue(what: &str, test: impl FnOnce()) {
    if catch_unwind(AssertUnwindSafe(test)).is_ok() {
        panic!("known issue \"{what}\" is fixed: move its test into the suite where it belongs");
    }
}
