//! Rays on the CPU: surfaces behind hits, shading, light paths, the Whitted tracer and the reference path tracer.

pub mod budget;
pub mod camera_rays;
pub(crate) mod choice;
pub mod direct;
pub mod emission;
pub mod explain;
pub(crate) mod facet;
pub(crate) mod filtered;
pub mod media;
pub(crate) mod meet;
pub(crate) mod near;
pub mod optics;
pub mod photons;
pub mod points;
pub mod reference;
pub(crate) mod reuse;
pub mod sampling;
pub mod shade;
pub mod surface;
pub mod surfels;
pub(crate) mod visibility;
pub mod whitted;
