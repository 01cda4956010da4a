//! Why a picture could not be made.

use catoptra_engine::SceneError;

/// Everything that can go wrong in a renderer.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// A setting is out of range.
    #[error("{0}")]
    Settings(String),
    /// The scene cannot be drawn.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// An explicit choice that this machine cannot serve.
    #[error("{choice}: {missing}")]
    Unavailable {
        /// The choice, as on the command line.
        choice: String,
        /// What is missing here.
        missing: String,
    },
    /// A view given to draw into cannot be drawn into: its texture is gone, or it is of another format, usage or device. The
    /// renderer itself is sound; give it a view that works.
    #[error("the view cannot be drawn into: {0}")]
    View(String),
    /// The GPU failed while working.
    #[error("the GPU failed: {0}")]
    Gpu(String),
}
