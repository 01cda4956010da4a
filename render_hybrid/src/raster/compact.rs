//! Pass: the list of pixels that the tracer works on.

use super::{
    device::Gpu,
    pipeline::{Slot, compute_pipeline_with, group, group_layout, linear_dispatch, pipeline_layout},
    readback::{Mailbox, Readback},
    shader::{self, COMPACT_BLOCK},
    targets::PictureTargets,
};
use crate::error::RenderError;

/// Order of the list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ListOrder {
    /// Ascending: as the CPU's tracer takes them.
    Rows,
    /// By squares of 8 x 8 pixels, each in Z order: neighbours in the list are neighbours in the picture, and so take like ways.
    Squares,
}

/// Count per block, scan, scatter.
pub(crate) struct CompactPass {
    /// By [`ListOrder`].
    pipelines: [[wgpu::ComputePipeline; 3]; 2],
    layout: wgpu::BindGroupLayout,
}

fn block_count(targets: &PictureTargets) -> u64 {
    (u64::from(targets.width) * u64::from(targets.height)).div_ceil(u64::from(COMPACT_BLOCK))
}

impl CompactPass {
    pub fn new(gpu: &Gpu) -> Self {
        let layout = group_layout(
            gpu,
            "compact.group",
            wgpu::ShaderStages::COMPUTE,
            &[Slot::Texture, Slot::Storage(false), Slot::Storage(false)],
        );
        let pipeline_layout = pipeline_layout(gpu, "compact", None, Some(&layout));
        let module = shader::module(&gpu.device, "compact");
        Self {
            pipelines: [ListOrder::Rows, ListOrder::Squares].map(|order| {
                let constants = [("BY_SQUARES", f64::from(u8::from(order == ListOrder::Squares)))];
                ["count", "scan", "scatter"]
                    .map(|entry| compute_pipeline_with(gpu, &module, &pipeline_layout, entry, &constants))
            }),
            layout,
        }
    }

    pub fn bind(&self, gpu: &Gpu, t: &PictureTargets) -> wgpu::BindGroup {
        group(
            gpu,
            "compact.group",
            &self.layout,
            &[
                wgpu::BindingResource::TextureView(&t.base_color.view),
                t.blocks.as_entire_binding(),
                t.pixels.as_entire_binding(),
            ],
        )
    }

    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        group: &wgpu::BindGroup,
        targets: &PictureTargets,
        order: ListOrder,
    ) {
        let all = linear_dispatch(block_count(targets));
        let mut pass =
            encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some("compact"), timestamp_writes: None });
        pass.set_bind_group(1, group, &[]);
        for (pipeline, (x, y)) in self.pipelines[order as usize].iter().zip([all, (1, 1), all]) {
            pass.set_pipeline(pipeline);
            pass.dispatch_workgroups(x, y, 1);
        }
    }

    /// Records that length and the first `likely` pixels of the list come back.
    pub fn record_read(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        mailbox: &mut Mailbox,
        targets: &PictureTargets,
        likely: u64,
    ) {
        mailbox.buffer(encoder, &targets.blocks, block_count(targets) * 4, 4);
        mailbox.buffer(encoder, &targets.pixels, 0, likely * 4);
    }

    /// The list of the last [`Self::record`], in its order.
    pub fn read(&self, gpu: &Gpu, readback: &mut Readback, targets: &PictureTargets) -> Result<Vec<u32>, RenderError> {
        let count = self.read_count(gpu, readback, targets)?;
        readback.buffer(gpu, &targets.pixels, 0, u64::from(count) * 4)
    }

    /// Length of that list.
    pub fn read_count(&self, gpu: &Gpu, readback: &mut Readback, targets: &PictureTargets) -> Result<u32, RenderError> {
        let count: Vec<u32> = readback.buffer(gpu, &targets.blocks, block_count(targets) * 4, 4)?;
        Ok(count[0])
    }
}
