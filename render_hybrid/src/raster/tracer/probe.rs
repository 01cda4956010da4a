//! A scene in the tracer's heaps for kernels that are not among the files: tests of the tracer's functions one by one.

use catoptra_engine::RenderScene;

use super::{
    scene::TracerScene,
    shaders::{HeapKind, Variant, text_of},
};
use crate::{
    accel::Accel,
    error::RenderError,
    raster::{device::Gpu, layouts::FrameData, pipeline::uniform, scene_buffers::linear_of_srgb},
    twin::shadow::ShadowPlan,
};

/// The scene, and what kernels for it are compiled for.
pub(crate) struct HeldScene {
    scene: TracerScene,
    variant: Variant,
}

impl HeldScene {
    /// * `accel`: follows `scene`
    pub fn new(gpu: &Gpu, scene: &RenderScene, accel: &Accel) -> Result<Self, RenderError> {
        gpu.scoped(|| {
            let mut held = TracerScene::new(gpu, HeapKind::Storage, false);
            let too_large = |missing: String| RenderError::Unavailable { choice: "--tracer gpu".into(), missing };
            let plan = ShadowPlan::new(&scene.lights, scene.bounds_world(), &Default::default());
            held.update(gpu, scene, accel, &plan, false).map_err(too_large)?;
            let frame = uniform(gpu, "probe.frame", size_of::<FrameData>() as u64);
            let table = uniform(gpu, "probe.srgb_table", 1024);
            gpu.upload(&frame, 0, bytemuck::bytes_of(&FrameData::new(scene, 1, 1)));
            gpu.upload(&table, 0, bytemuck::cast_slice(&linear_of_srgb()));
            held.bind(gpu, &frame, &table, None);
            let usual = Variant::new(HeapKind::Storage);
            let levels = if held.levels <= usual.levels { usual.levels } else { Variant::ALL_LEVELS };
            let variant = Variant { kd: accel.flat_is_kd(), levels, ..usual };
            Ok(Self { scene: held, variant })
        })
    }

    /// `kernel` behind everything that the tracer of pixels imports. Its groups from 1 on are its own.
    pub fn text(&self, kernel: &str) -> String {
        let imports = "#import tracer/scene\n#import tracer/hits\n#import tracer/pixels\nfn count_ray(kind: u32) {}\n";
        text_of("probe", &format!("{imports}{kernel}"), &self.variant)
    }

    /// Layout and resources of group 0.
    ///
    /// # Panics
    /// Never: [`Self::new`] made them.
    pub fn group(&self) -> (&wgpu::BindGroupLayout, &wgpu::BindGroup) {
        (&self.scene.layout, self.scene.group.as_ref().expect("made with the scene"))
    }
}
