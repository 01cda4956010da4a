//! Pass: the tracer's pixels in their places, and final = direct + indirect + traced.

use super::{
    device::{Gpu, GrowBuffer},
    layouts::TracedPixel,
    pipeline::{Slot, compute_pipeline, draw_pipeline, group, group_layout, linear_dispatch, pipeline_layout, uniform},
    shader,
    targets::{PictureTargets, RADIANCE_FORMAT, draw_pass},
};
use crate::error::RenderError;

/// Pixels sent at once: bounds the buffer at 64 MiB.
const BATCH: usize = 1 << 22;

/// Scatters and sums.
pub(crate) struct ComposePass {
    scatter: wgpu::ComputePipeline,
    scatter_layout: wgpu::BindGroupLayout,
    sum: wgpu::RenderPipeline,
    sum_layout: wgpu::BindGroupLayout,
    uniform: wgpu::Buffer,
    pixels: GrowBuffer,
}

/// Bindings of both steps.
pub(crate) struct ComposeGroups {
    scatter: wgpu::BindGroup,
    sum: wgpu::BindGroup,
}

impl ComposePass {
    pub fn new(gpu: &Gpu) -> Self {
        use wgpu::ShaderStages as S;
        let scatter_layout = group_layout(
            gpu,
            "traced_scatter.group",
            S::COMPUTE,
            &[Slot::Uniform, Slot::Storage(true), Slot::Write(RADIANCE_FORMAT)],
        );
        let sum_layout =
            group_layout(gpu, "compose.group", S::FRAGMENT, &[Slot::Texture, Slot::Texture, Slot::Texture]);
        let module = shader::module(&gpu.device, "traced_scatter");
        let scatter_pipeline_layout = pipeline_layout(gpu, "traced_scatter", None, Some(&scatter_layout));
        let sum_pipeline_layout = pipeline_layout(gpu, "compose", None, Some(&sum_layout));
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST;
        Self {
            scatter: compute_pipeline(gpu, &module, &scatter_pipeline_layout, "scatter"),
            scatter_layout,
            sum: draw_pipeline(gpu, "compose", &sum_pipeline_layout, RADIANCE_FORMAT, false),
            sum_layout,
            uniform: uniform(gpu, "traced_scatter.uniform", 16),
            pixels: GrowBuffer::new(gpu, "traced_scatter.pixels", usage, 256),
        }
    }

    pub fn bind(&self, gpu: &Gpu, t: &PictureTargets) -> ComposeGroups {
        let view = |v| wgpu::BindingResource::TextureView(v);
        let scatter = [self.uniform.as_entire_binding(), self.pixels.buffer.as_entire_binding(), view(&t.traced.view)];
        let sum = [view(&t.direct.view), view(&t.indirect[0].view), view(&t.traced.view)];
        ComposeGroups {
            scatter: group(gpu, "traced_scatter.group", &self.scatter_layout, &scatter),
            sum: group(gpu, "compose.group", &self.sum_layout, &sum),
        }
    }

    /// Makes room for the tracer's list; true where [`Self::bind`] must follow.
    pub fn reserve(&mut self, gpu: &Gpu, count: usize) -> bool {
        self.pixels.reserve(gpu, (count.min(BATCH) * size_of::<TracedPixel>()) as u64)
    }

    /// Uploads the tracer's list and records both steps. A list of several batches is submitted batch by batch, since they
    /// share one buffer.
    pub fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        groups: &ComposeGroups,
        targets: &PictureTargets,
        traced: &[(u32, [f32; 3])],
    ) -> Result<(), RenderError> {
        let pixels = u64::from(targets.width) * u64::from(targets.height);
        if let Some((pixel, _)) = traced.iter().find(|(p, _)| u64::from(*p) >= pixels) {
            return Err(RenderError::Settings(format!(
                "traced pixel {pixel} lies outside the {pixels} of the picture"
            )));
        }
        draw_pass(encoder, "traced.clear", &targets.traced.view, wgpu::Color::BLACK, None);
        let mut batches = traced.chunks(BATCH).peekable();
        while let Some(batch) = batches.next() {
            let data: Vec<TracedPixel> =
                batch.iter().map(|&(pixel, radiance)| TracedPixel { radiance, pixel }).collect();
            gpu.upload(&self.pixels.buffer, 0, bytemuck::cast_slice(&data));
            gpu.upload(&self.uniform, 0, bytemuck::cast_slice(&[data.len() as u32, 0, 0, 0]));
            {
                let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                    label: Some("traced_scatter"),
                    timestamp_writes: None,
                });
                pass.set_pipeline(&self.scatter);
                pass.set_bind_group(1, &groups.scatter, &[]);
                let (x, y) = linear_dispatch((data.len() as u64).div_ceil(256));
                pass.dispatch_workgroups(x, y, 1);
            }
            if batches.peek().is_some() {
                let full = std::mem::replace(encoder, gpu.encoder("traced_scatter"));
                gpu.queue.submit([full.finish()]);
            }
        }
        self.record_sum(encoder, groups, targets);
        Ok(())
    }

    /// Records the sum alone: the traced layer is there already.
    pub fn record_sum(&self, encoder: &mut wgpu::CommandEncoder, groups: &ComposeGroups, targets: &PictureTargets) {
        let mut pass = draw_pass(encoder, "compose", &targets.last.view, wgpu::Color::BLACK, None);
        pass.set_pipeline(&self.sum);
        pass.set_bind_group(1, &groups.sum, &[]);
        pass.draw(0..3, 0..1);
    }
}
