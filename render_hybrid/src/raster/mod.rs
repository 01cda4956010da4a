//! The wgpu lane.
use crate::{
    error::RenderError,
    output::*,
    settings::*,
    twin::{shadow::ShadowPlan, vpl::Vpl},
};
use catoptra_engine::RenderScene;
pub struct AdapterSummary {
    pub name: String,
    pub backend: String,
    pub software: bool,
    pub driver: String,
}
pub fn list_adapters() -> Vec<AdapterSummary> {
    Vec::new()
}
pub enum GpuRaster {}
impl GpuRaster {
    pub fn new() -> Result<Self, RenderError> {
        Err(RenderError::Unavailable { choice: "--raster gpu".into(), missing: "not built yet".into() })
    }
    pub fn adapter(&self) -> &AdapterSummary {
        match *self {}
    }
    pub fn begin(&mut self, _: &RenderScene, _: &RenderSettings, _: &ShadowPlan) -> Result<(), RenderError> {
        match *self {}
    }
    pub fn read_masked_pixels(&mut self) -> Result<Vec<u32>, RenderError> {
        match *self {}
    }
    pub fn read_moments(&mut self) -> Result<Vec<Vec<[f32; 2]>>, RenderError> {
        match *self {}
    }
    pub fn light(
        &mut self,
        _: &[Vpl],
        _: f32,
        _: Option<&[Vec<f32>]>,
        _: Option<&[[f32; 3]]>,
    ) -> Result<(), RenderError> {
        match *self {}
    }
    pub fn compose(&mut self, _: &[(u32, [f32; 3])]) -> Result<(), RenderError> {
        match *self {}
    }
    pub fn read_layer(&mut self, _: Layer) -> Result<Image, RenderError> {
        match *self {}
    }
    pub fn counters(&self) -> (u64, u64) {
        match *self {}
    }
    pub fn take_pass_times(&mut self, _: &mut StageTimes) {
        match *self {}
    }
}
