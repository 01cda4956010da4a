//! What an import found and what it left out.

use std::collections::BTreeMap;

/// Figures of an import, and one list of all that was not honoured.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImportReport {
    /// What was ignored or approximated, sorted, each with how often; empty: the scene is shown as the file means it.
    pub ignored: Vec<String>,
    /// Triangles of all instances in the scene.
    pub triangles: usize,
    /// Mesh instances in the scene.
    pub instances: usize,
    /// True where the scene holds a camera.
    pub has_camera: bool,
    /// True where the scene holds a light or an emissive surface.
    pub has_light: bool,
}

/// Collects what is ignored, each kind once, with a count.
#[derive(Default)]
pub(super) struct Ignored(BTreeMap<String, u64>);

impl Ignored {
    pub fn note(&mut self, what: impl Into<String>) {
        *self.0.entry(what.into()).or_default() += 1;
    }
    pub fn list(self) -> Vec<String> {
        self.0.into_iter().map(|(what, n)| if n == 1 { what } else { format!("{what} (x{n})") }).collect()
    }
}
