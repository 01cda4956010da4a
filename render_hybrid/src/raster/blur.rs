//! Pass: the separable 7x7 Gaussian over the shadow moments.

use super::{
    device::Gpu,
    pipeline::{Slot, compute_pipeline, group, group_layout, pipeline_layout},
    shader,
    targets::{MOMENTS_FORMAT, MomentTargets},
};

/// Blurs rows into the scratch array and columns back.
pub(crate) struct BlurPass {
    horizontal: wgpu::ComputePipeline,
    vertical: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
}

/// Bindings of one array's two directions.
pub(crate) struct BlurGroups([wgpu::BindGroup; 2]);

impl BlurPass {
    pub fn new(gpu: &Gpu) -> Self {
        let layout = group_layout(
            gpu,
            "moments_blur.group",
            wgpu::ShaderStages::COMPUTE,
            &[Slot::TextureArray, Slot::WriteArray(MOMENTS_FORMAT)],
        );
        let pipeline_layout = pipeline_layout(gpu, "moments_blur", None, Some(&layout));
        let module = shader::module(&gpu.device, "moments_blur");
        Self {
            horizontal: compute_pipeline(gpu, &module, &pipeline_layout, "horizontal"),
            vertical: compute_pipeline(gpu, &module, &pipeline_layout, "vertical"),
            layout,
        }
    }

    pub fn bind(&self, gpu: &Gpu, targets: &MomentTargets) -> BlurGroups {
        let view = |v| wgpu::BindingResource::TextureView(v);
        let (a, b) = (&targets.moments.view, &targets.scratch.view);
        BlurGroups([
            group(gpu, "moments_blur.horizontal", &self.layout, &[view(a), view(b)]),
            group(gpu, "moments_blur.vertical", &self.layout, &[view(b), view(a)]),
        ])
    }

    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, groups: &BlurGroups, targets: &MomentTargets) {
        let groups_across = targets.size.div_ceil(8);
        for (pipeline, group) in [&self.horizontal, &self.vertical].into_iter().zip(&groups.0) {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("moments_blur"),
                timestamp_writes: None,
            });
            pass.set_pipeline(pipeline);
            pass.set_bind_group(1, group, &[]);
            pass.dispatch_workgroups(groups_across, groups_across, targets.layers);
        }
    }
}
