//! Hybrid rendering: a [`catoptra_engine::RenderScene`] becomes a picture by rasterised (or ray-cast) direct and indirect
//! light and Whitted-traced mirrors and glass. [`frame`] is the whole frame, one readable function.

pub mod accel;
pub mod error;
pub mod settings;

pub use error::RenderError;
pub use settings::*;
