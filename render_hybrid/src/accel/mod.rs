//! The two-level structure: a BLAS per mesh, a TLAS over instances. Moved bodies refit TLAS leaves and their ancestors only.

mod ray;

use crate::{error::RenderError, settings::*};
use catoptra_engine::RenderScene;
pub use ray::{Hit, Ray};
pub struct AccelOptions {
    pub blas: BlasKind,
    pub simd: SimdLevel,
}
pub struct Accel {}
#[derive(Default)]
pub struct UpdateStats {
    pub blas_builds: u32,
    pub tlas_nodes_touched: u32,
    pub tlas_rebuilt: bool,
}
impl Accel {
    pub fn new(_: AccelOptions) -> Result<Self, RenderError> {
        Ok(Self {})
    }
    pub fn update(&mut self, _: &RenderScene) -> UpdateStats {
        UpdateStats::default()
    }
    pub fn closest_hit(&self, _: &Ray) -> Hit {
        Hit::MISS
    }
    pub fn occluded(&self, _: &Ray) -> bool {
        false
    }
    pub fn set_shadow_casters(&mut self, _: impl Fn(u32) -> bool) {}
    pub fn closest_hits(&self, _: &[Ray], _: &mut [Hit]) {}
    pub fn occluded_many(&self, _: &[Ray], _: &mut [bool]) {}
}
