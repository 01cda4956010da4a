//! The one place where files of the user enter the scenes.

use super::BuildError;
use super::stage::Stage;
use catoptra_engine::{Aabb, Material};
use glam::Vec3;
use std::path::Path;

/// Spawns the file's meshes as one statue: standing on `place`, `height` metres tall, all of `material`.
///
/// # Errors
/// [`BuildError::File`] where the file cannot be read.
pub fn spawn_statue(
    _stage: &mut Stage,
    path: &Path,
    _place: Vec3,
    _height: f32,
    _material: Material,
) -> Result<(), BuildError> {
    Err(BuildError::File { path: path.to_path_buf(), why: "glTF files are not supported yet".into() })
}

/// Spawns the file's meshes with its own materials and returns their bounds.
///
/// # Errors
/// [`BuildError::File`] where the file cannot be read.
pub fn spawn_atrium(_stage: &mut Stage, path: &Path) -> Result<Aabb, BuildError> {
    Err(BuildError::File { path: path.to_path_buf(), why: "glTF files are not supported yet".into() })
}
