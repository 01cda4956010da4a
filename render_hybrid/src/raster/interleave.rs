//! Pass: the filter that puts the subsets of interleaved VPLs together. Made where first wanted: full evaluation has no part in
//! it.

use super::{
    device::Gpu,
    layouts::InterleaveUniform,
    pipeline::{Slot, draw_pipeline, group, group_layout, pipeline_layout, uniform},
    scene_buffers::SceneBuffers,
    targets::{PictureTargets, RADIANCE_FORMAT, draw_pass},
};

/// Means over the pixels of a block that lie on one surface.
pub(crate) struct InterleavePass {
    pipeline: wgpu::RenderPipeline,
    layout: wgpu::BindGroupLayout,
    uniform: wgpu::Buffer,
    n: u32,
}

impl InterleavePass {
    pub fn new(gpu: &Gpu, frame: &wgpu::BindGroupLayout) -> Self {
        use Slot::{Texture, Uniform};
        let slots = [Uniform, Texture, Texture, Texture, Texture];
        let layout = group_layout(gpu, "interleave.group", wgpu::ShaderStages::FRAGMENT, &slots);
        let pipeline_layout = pipeline_layout(gpu, "interleave", Some(frame), Some(&layout));
        Self {
            pipeline: draw_pipeline(gpu, "interleave", &pipeline_layout, RADIANCE_FORMAT, false),
            layout,
            uniform: uniform(gpu, "interleave.uniform", size_of::<InterleaveUniform>() as u64),
            n: 0,
        }
    }

    /// Side of the blocks in the next [`Self::record`].
    pub fn set(&mut self, gpu: &Gpu, n: u32) {
        if self.n != n {
            let data = InterleaveUniform { n, unused0: 0, unused1: 0, unused2: 0 };
            gpu.upload(&self.uniform, 0, bytemuck::bytes_of(&data));
            self.n = n;
        }
    }

    pub fn bind(&self, gpu: &Gpu, t: &PictureTargets) -> wgpu::BindGroup {
        let view = |v| wgpu::BindingResource::TextureView(v);
        let resources = [
            self.uniform.as_entire_binding(),
            view(&t.position.view),
            view(&t.normals.view),
            view(&t.base_color.view),
            view(&t.indirect[1].view),
        ];
        group(gpu, "interleave.group", &self.layout, &resources)
    }

    /// From the second of the indirect pass's targets into the first.
    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        scene: &SceneBuffers,
        group: &wgpu::BindGroup,
        targets: &PictureTargets,
    ) {
        let mut pass = draw_pass(encoder, "interleave", &targets.indirect[0].view, wgpu::Color::BLACK, None);
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, scene.group(), &[]);
        pass.set_bind_group(1, group, &[]);
        pass.draw(0..3, 0..1);
    }
}
