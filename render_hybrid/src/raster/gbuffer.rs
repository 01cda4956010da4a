//! Pass: the visible triangle of each pixel, then the surface there with the material mask's bit.

use super::{
    device::Gpu,
    pipeline::{Slot, compute_pipeline, draw_pipeline, group, group_layout, pipeline_layout},
    scene_buffers::SceneBuffers,
    shader,
    targets::{PictureTargets, RADIANCE_FORMAT, VISIBILITY_FORMAT, draw_pass},
};

/// Visibility by rasterisation, surfaces by meeting the camera ray with the visible triangle.
pub(crate) struct GbufferPass {
    visibility: wgpu::RenderPipeline,
    /// For surfaces with holes.
    cutout: wgpu::RenderPipeline,
    resolve: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
}

impl GbufferPass {
    pub fn new(gpu: &Gpu, frame: &wgpu::BindGroupLayout) -> Self {
        let write = Slot::Write(RADIANCE_FORMAT);
        let layout = group_layout(
            gpu,
            "gbuffer.group",
            wgpu::ShaderStages::COMPUTE,
            &[Slot::TextureUint, write, write, write, write],
        );
        let visibility_layout = pipeline_layout(gpu, "visibility", Some(frame), None);
        let resolve_layout = pipeline_layout(gpu, "gbuffer", Some(frame), Some(&layout));
        let module = shader::module(&gpu.device, "gbuffer");
        Self {
            visibility: draw_pipeline(gpu, "visibility", &visibility_layout, VISIBILITY_FORMAT, true),
            cutout: draw_pipeline(gpu, "visibility_cutout", &visibility_layout, VISIBILITY_FORMAT, true),
            resolve: compute_pipeline(gpu, &module, &resolve_layout, "resolve"),
            layout,
        }
    }

    pub fn bind(&self, gpu: &Gpu, t: &PictureTargets) -> wgpu::BindGroup {
        let views = [&t.visibility, &t.position, &t.normals, &t.base_color, &t.emission]
            .map(|t| wgpu::BindingResource::TextureView(&t.view));
        group(gpu, "gbuffer.group", &self.layout, &views)
    }

    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        scene: &SceneBuffers,
        group: &wgpu::BindGroup,
        targets: &PictureTargets,
    ) {
        {
            let clear = wgpu::Color::TRANSPARENT;
            let mut pass = draw_pass(encoder, "visibility", &targets.visibility.view, clear, Some(&targets.depth.view));
            pass.set_bind_group(0, scene.group(), &[]);
            for (pipeline, cutout) in [(&self.visibility, false), (&self.cutout, true)] {
                for (i, draw) in scene.draws.iter().filter(|d| d.cutout == cutout).enumerate() {
                    if i == 0 {
                        pass.set_pipeline(pipeline);
                    }
                    pass.draw(0..draw.vertices, draw.instance..draw.instance + 1);
                }
            }
        }
        let mut pass =
            encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some("gbuffer"), timestamp_writes: None });
        pass.set_pipeline(&self.resolve);
        pass.set_bind_group(0, scene.group(), &[]);
        pass.set_bind_group(1, group, &[]);
        pass.dispatch_workgroups(targets.width.div_ceil(8), targets.height.div_ceil(8), 1);
    }
}
