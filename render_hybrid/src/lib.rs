//! Hybrid rendering: a [`catoptra_engine::RenderScene`] becomes a picture by rasterised (or ray-cast) direct and indirect
//! light and Whitted-traced mirrors and glass. [`frame`] is the whole frame, one readable function.

pub mod accel;
pub mod error;
pub mod output;
pub mod raster;
pub mod settings;
pub mod twin;

pub use error::RenderError;
pub use output::*;
pub use settings::*;
