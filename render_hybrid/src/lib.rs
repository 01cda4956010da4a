//! Hybrid rendering: a [`catoptra_engine::RenderScene`] becomes a picture by rasterised (or ray-cast) direct and indirect
//! light and Whitted-traced mirrors and glass. `frame.rs` is the whole frame, one readable function.

pub mod accel;
pub mod error;
mod frame;
mod gpu_frame;
pub mod image_io;
#[cfg(feature = "metrics")]
pub mod metrics;
pub mod output;
pub mod plugin;
pub mod query;
pub mod raster;
mod renderer;
pub mod settings;
pub mod simd;
mod still;
pub mod trace;
mod tracer_choice;
pub mod twin;

pub use error::RenderError;
pub use output::*;
pub use plugin::{
    CameraSettings, DefaultSettings, EntityHit, HybridRenderer, Raycaster, RenderHybridPlugin, RenderTarget,
    RenderedCamera, RenderedFrames,
};
pub use query::{SceneQuery, SurfaceHit};
pub use renderer::{Renderer, render_to_image};
pub use settings::*;
pub use tracer_choice::TracerChoice;

pub use bevy_app;
pub use bevy_ecs;
pub use catoptra_engine as engine;
pub use glam;
pub use wgpu;
