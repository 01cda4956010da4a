//! Pass: the separable 3x3 binomial over the shadow moments, then the further levels of their pyramid.

use super::{
    device::Gpu,
    pipeline::{Slot, compute_pipeline, group, group_layout, pipeline_layout},
    shader,
    targets::{MOMENTS_FORMAT, MomentTargets},
};
use crate::twin::penumbra::{level_count, level_size};

/// Blurs rows into the scratch array and columns back.
pub(crate) struct BlurPass {
    horizontal: wgpu::ComputePipeline,
    vertical: wgpu::ComputePipeline,
    halve: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
}

/// Bindings of one array.
pub(crate) struct BlurGroups {
    directions: [wgpu::BindGroup; 2],
    /// From each level to the next one.
    levels: Vec<wgpu::BindGroup>,
}

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
            halve: compute_pipeline(gpu, &module, &pipeline_layout, "halve"),
            layout,
        }
    }

    pub fn bind(&self, gpu: &Gpu, targets: &MomentTargets) -> BlurGroups {
        fn view(v: &wgpu::TextureView) -> wgpu::BindingResource<'_> {
            wgpu::BindingResource::TextureView(v)
        }
        let of_level = |l| targets.moments.level_view("moments.level", l);
        let (a, b) = (&of_level(0), &targets.scratch.view);
        let levels = 1..level_count(targets.size);
        BlurGroups {
            directions: [
                group(gpu, "moments_blur.horizontal", &self.layout, &[view(a), view(b)]),
                group(gpu, "moments_blur.vertical", &self.layout, &[view(b), view(a)]),
            ],
            levels: levels
                .map(|l| {
                    let (fine, coarse) = (of_level(l - 1), of_level(l));
                    group(gpu, "moments_blur.halve", &self.layout, &[view(&fine), view(&coarse)])
                })
                .collect(),
        }
    }

    /// * `soft`: some light has a disc, so that the further levels are read
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, groups: &BlurGroups, targets: &MomentTargets, soft: bool) {
        let mut run = |pipeline: &wgpu::ComputePipeline, group: &wgpu::BindGroup, size: u32| {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("moments_blur"),
                timestamp_writes: None,
            });
            pass.set_pipeline(pipeline);
            pass.set_bind_group(1, group, &[]);
            pass.dispatch_workgroups(size.div_ceil(8), size.div_ceil(8), targets.layers);
        };
        for (pipeline, group) in [&self.horizontal, &self.vertical].into_iter().zip(&groups.directions) {
            run(pipeline, group, targets.size);
        }
        if soft {
            for (level, group) in (1..).zip(&groups.levels) {
                run(&self.halve, group, level_size(targets.size, level));
            }
        }
    }
}
