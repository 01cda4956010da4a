//! Scan conversion on the CPU: which triangle is nearest at each pixel of a camera or texel of a shadow map.
//!
//! A triangle's corner weights are affine functions of the pixel (Olano & Greer 1997), so that nothing is clipped: corners
//! behind the eye are as good as others. Weights are set up in double precision and evaluated in single precision from the
//! corner of a fixed 16 x 16 block, so that a pixel's answer depends on the pixel alone: not on tiles, threads or SIMD
//! level. Two triangles that share an edge compute exactly opposite numbers for it, and a weight of zero is inside for both:
//! no gaps. Equal distances go to the smaller (instance, primitive).
//!
//! Twin: the rasteriser of the GPU lane (`shaders/gbuffer.wgsl`, `shaders/moments.wgsl`), whose coverage rule is its own.
//! Source: Olano & Greer, "Triangle Scan Conversion using 2D Homogeneous Coordinates", Graphics Hardware 1997.

mod crowd;
mod kernel;
mod setup;
#[cfg(test)]
mod tests;
mod view;

pub use kernel::{BLOCK, TileBuffers};
pub use setup::{ScanList, ScanTriangle};
pub use view::ScanView;
