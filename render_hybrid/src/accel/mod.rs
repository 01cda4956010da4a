//! The two-level structure: a BLAS per mesh, a TLAS over instances. Moved bodies refit TLAS leaves and their ancestors only.

mod ray;

pub use ray::{Hit, Ray};
