//! Rays of a list through the compute tracer's traversal: for tests of the hits themselves, and for measurements.

use catoptra_engine::RenderScene;
use std::time::Instant;

use super::{
    module,
    scene::TracerScene,
    shaders::{HeapKind, TRACE_GROUP, Variant},
};
use crate::{
    accel::{Accel, Hit, Ray},
    error::RenderError,
    raster::{
        device::{Gpu, GrowBuffer},
        layouts::FrameData,
        pipeline::{Slot, compute_pipeline, group, group_layout, linear_dispatch, pipeline_layout, uniform},
        readback::Readback,
    },
    twin::shadow::ShadowPlan,
};

/// Hits of a list of rays.
pub(crate) struct Queried {
    pub hits: Vec<Hit>,
    /// Rays whose walk met its cap.
    pub capped: usize,
    /// Milliseconds of the dispatch, waiting included.
    pub milliseconds: f64,
}

/// Traces `rays` through the structure of `scene`.
pub(crate) fn closest_hits(
    gpu: &Gpu,
    scene: &RenderScene,
    accel: &Accel,
    rays: &[Ray],
) -> Result<Queried, RenderError> {
    gpu.scoped(|| {
        let mut flat = TracerScene::new(gpu, HeapKind::Storage, false);
        let too_large = |missing: String| RenderError::Unavailable { choice: "--tracer gpu".into(), missing };
        flat.update(gpu, scene, accel, &ShadowPlan::default(), false).map_err(too_large)?;
        let frame = uniform(gpu, "query.frame", size_of::<FrameData>() as u64);
        let table = uniform(gpu, "query.table", 1024);
        gpu.upload(&frame, 0, bytemuck::bytes_of(&FrameData::new(scene, 1, 1)));
        flat.bind(gpu, &frame, &table, None);
        let usual = Variant::new(HeapKind::Storage);
        let levels = if flat.levels <= usual.levels { usual.levels } else { Variant::ALL_LEVELS };
        let variant = Variant { kd: accel.flat_is_kd(), levels, ..usual };
        let module = module(gpu, "query", &variant);
        let slots = [Slot::Storage(true), Slot::Storage(false)];
        let layout = group_layout(gpu, "query.group", wgpu::ShaderStages::COMPUTE, &slots);
        let pipeline_layout = pipeline_layout(gpu, "query", Some(&flat.layout), Some(&layout));
        let pipeline = compute_pipeline(gpu, &module, &pipeline_layout, "query");
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC;
        let bytes = rays.len() as u64 * 32;
        let buffer = |label| {
            let size = bytes.max(32);
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage,
                mapped_at_creation: false,
            })
        };
        let (from, to) = (buffer("query.rays"), GrowBuffer::new(gpu, "query.answers", usage, bytes));
        let words: Vec<[f32; 8]> = rays
            .iter()
            .map(|r| {
                let (o, d) = (r.origin, r.direction);
                // Infinity is no number for a shader.
                [o.x, o.y, o.z, r.t_min, d.x, d.y, d.z, r.t_max.min(f32::MAX)]
            })
            .collect();
        gpu.upload(&from, 0, bytemuck::cast_slice(&words));
        let resources = [from.as_entire_binding(), to.buffer.as_entire_binding()];
        let own = group(gpu, "query.group", &layout, &resources);
        gpu.wait()?;
        let start = Instant::now();
        let mut encoder = gpu.encoder("query");
        {
            let mut pass = super::compute_pass(&mut encoder, "query");
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, flat.group.as_ref(), &[]);
            pass.set_bind_group(1, &own, &[]);
            let (x, y) = linear_dispatch((rays.len() as u64).div_ceil(u64::from(TRACE_GROUP)));
            pass.dispatch_workgroups(x, y, 1);
        }
        gpu.queue.submit([encoder.finish()]);
        gpu.wait()?;
        let milliseconds = start.elapsed().as_secs_f64() * 1e3;
        let answers: Vec<[u32; 8]> = Readback::new(gpu).buffer(gpu, &to.buffer, 0, bytes)?;
        let hits = answers.iter().map(|a| {
            if a[3] == u32::MAX {
                return Hit::MISS;
            }
            let f = |i: usize| f32::from_bits(a[i]);
            Hit { t: f(0), u: f(1), v: f(2), instance_id: a[3], primitive_id: a[4] }
        });
        let capped = answers.iter().filter(|a| a[5] != 0).count();
        Ok(Queried { hits: hits.collect(), capped, milliseconds })
    })
}
