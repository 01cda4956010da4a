//! The raster stages on the CPU, and the maths that CPU and GPU share. Functions here carry the names of their twins in
//! `shaders/shared/*.wgsl`; tests/twins.rs evaluates both over tables of inputs.

pub mod certified;
pub mod gbuffer;
pub mod glance;
pub mod grid;
pub mod interleave;
pub mod moments;
pub mod penumbra;
pub mod scan;
pub mod shading;
pub mod shadow;
pub mod tile;
pub mod vpl;
pub mod vpl_maps;
