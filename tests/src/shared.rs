//! Test data that lies beside the workspace and is never committed.

use std::{io::Write, path::PathBuf};

/// Root of the workspace.
pub(crate) fn workspace() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// `../shared/RELATIVE` beside the workspace, or `None` after a loud word. Unlike a missing GPU this is no failure in CI: a
/// fresh clone has no such folder, and nothing but the author's data is lost.
pub fn shared_or_skip(test: &str, relative: &str) -> Option<PathBuf> {
    let path = workspace().join("../shared").join(relative);
    if path.exists() {
        return Some(path);
    }
    let _ = writeln!(std::io::stderr(), "SKIPPED {test}: there is no ../shared/{relative}");
    None
}
