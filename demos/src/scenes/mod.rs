//! The five scenes of the method: each a world in which camera, light and objects move on fixed paths.
//!
//! Frame K of a scene is [`build`] followed by `catoptra_engine::app::advance(app, K)`.

pub(crate) mod atrium;
mod files;
mod rolling_box;
mod rolling_box_donut;
mod rolling_box_sponza;
mod rolling_box_venus;
pub(crate) mod room;
pub(crate) mod stage;
pub(crate) mod statue;
mod two_spheres;

pub use atrium::atrium_meshes;
pub use statue::{StatueMeshes, statue_meshes};

use bevy_app::App;
use std::path::PathBuf;

/// What is known of a scene before it is built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SceneInfo {
    /// Name on the command line.
    pub name: &'static str,
    /// Name for people.
    pub title: &'static str,
    /// Triangles over all instances, with the project's own statue and atrium.
    pub triangles: usize,
    /// True where mirror or glass covers at least a tenth of the picture.
    pub traced: bool,
    /// What it shows.
    pub about: &'static str,
}

/// All scenes, by rising number of triangles.
pub const SCENES: [SceneInfo; 5] = [
    SceneInfo {
        name: "rolling-box",
        title: "Rolling box",
        triangles: 22,
        traced: false,
        about: "a box with six colours rolls through a room under a moving spot light: indirect light",
    },
    SceneInfo {
        name: "rolling-box-donut",
        title: "Rolling box and donut",
        triangles: 598,
        traced: true,
        about: "a mirror donut rolls inside a rolling glass box: reflection within refraction",
    },
    SceneInfo {
        name: "two-spheres",
        title: "Two spheres",
        triangles: 1_066,
        traced: true,
        about: "a moving and a static sphere with different reflection factors",
    },
    SceneInfo {
        name: "rolling-box-venus",
        title: "Rolling box and Venus",
        triangles: 31_420,
        traced: true,
        about: "a box rolls around a mirror statue",
    },
    SceneInfo {
        name: "rolling-box-sponza",
        title: "Rolling box in the atrium",
        triangles: 66_466,
        traced: true,
        about: "a mirror box rolls through an arcaded courtyard: many triangles",
    },
];

/// What a user may choose of the scenes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SceneOptions {
    /// glTF or GLB file that stands in for the statue of `rolling-box-venus`.
    pub statue: Option<PathBuf>,
    /// glTF or GLB file that stands in for the atrium of `rolling-box-sponza`.
    pub atrium: Option<PathBuf>,
    /// Animation that a file plays, by number or name; the five scenes have none.
    pub animation: Option<String>,
}

/// Why a scene could not be built.
#[derive(Debug)]
pub enum BuildError {
    /// There is no scene of this name.
    UnknownScene(String),
    /// A file of [`SceneOptions`] could not be used.
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
}

impl std::fmt::Display for BuildError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            BuildError::UnknownScene(name) => {
                let names = SCENES.map(|s| s.name).join(", ");
                write!(f, "there is no scene \"{name}\"; the scenes are {names}")
            }
            BuildError::File { path, why } => write!(f, "{}: {why}", path.display()),
        }
    }
}

impl std::error::Error for BuildError {}

/// Facts about a scene by its name.
pub fn info(name: &str) -> Option<&'static SceneInfo> {
    SCENES.iter().find(|s| s.name == name)
}

/// The scene at frame 0: an app with engine, motion, camera, lights and objects, extracted once.
///
/// # Errors
/// [`BuildError`] for an unknown name or a file that cannot be used.
pub fn build(name: &str, options: &SceneOptions) -> Result<App, BuildError> {
    match name {
        "rolling-box" => Ok(rolling_box::build()),
        "rolling-box-donut" => Ok(rolling_box_donut::build()),
        "two-spheres" => Ok(two_spheres::build()),
        "rolling-box-venus" => rolling_box_venus::build(options),
        "rolling-box-sponza" => rolling_box_sponza::build(options),
        _ => Err(BuildError::UnknownScene(name.to_string())),
    }
}

#[cfg(test)]
mod tests;
