//! Pass: shadow moments of every view.

use catoptra_engine::Aabb;

use super::{
    device::{Gpu, GrowBuffer},
    pipeline::{Slot, draw_pipeline, group, group_layout, pipeline_layout},
    scene_buffers::{Draw, SceneBuffers, first_layers},
    targets::{MOMENTS_FORMAT, ShadowTargets, draw_pass},
};
use crate::{
    settings::ShadowFilter,
    twin::shadow::{ShadowPlan, ShadowView, moments_of},
};

const UNIFORM_SIZE: u64 = 16;

/// Draws the moments of the nearest surfaces into each view's layer.
pub(crate) struct MomentsPass {
    pipeline: wgpu::RenderPipeline,
    /// For surfaces with holes.
    cutout: wgpu::RenderPipeline,
    layout: wgpu::BindGroupLayout,
    /// View numbers, one each `stride` bytes.
    views: GrowBuffer,
    stride: u64,
    group: Option<wgpu::BindGroup>,
    written: u32,
    filter: ShadowFilter,
}

impl MomentsPass {
    pub fn new(gpu: &Gpu, frame: &wgpu::BindGroupLayout) -> Self {
        let layout = group_layout(
            gpu,
            "moments.group",
            wgpu::ShaderStages::VERTEX_FRAGMENT,
            &[Slot::DynamicUniform(UNIFORM_SIZE)],
        );
        let pipeline_layout = pipeline_layout(gpu, "moments", Some(frame), Some(&layout));
        let stride = u64::from(gpu.device.limits().min_uniform_buffer_offset_alignment).max(UNIFORM_SIZE);
        Self {
            pipeline: draw_pipeline(gpu, "moments", &pipeline_layout, MOMENTS_FORMAT, true),
            cutout: draw_pipeline(gpu, "moments_cutout", &pipeline_layout, MOMENTS_FORMAT, true),
            layout,
            views: GrowBuffer::new(
                gpu,
                "moments.views",
                wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
                stride,
            ),
            stride,
            group: None,
            written: 0,
            filter: ShadowFilter::default(),
        }
    }

    /// View numbers never change, so they are written once for as many views as were ever needed, and anew for another
    /// filter.
    fn prepare(&mut self, gpu: &Gpu, count: u32, filter: ShadowFilter) {
        if count <= self.written && self.group.is_some() && filter == self.filter {
            return;
        }
        let mut bytes = vec![0u8; (self.stride * u64::from(count)) as usize];
        for i in 0..count {
            let at = (u64::from(i) * self.stride) as usize;
            bytes[at..at + 4].copy_from_slice(&i.to_le_bytes());
            bytes[at + 4..at + 8].copy_from_slice(&u32::from(filter == ShadowFilter::Evsm4).to_le_bytes());
        }
        self.views.reserve(gpu, bytes.len() as u64);
        gpu.upload(&self.views.buffer, 0, &bytes);
        self.written = count;
        self.filter = filter;
        let binding = wgpu::BufferBinding {
            buffer: &self.views.buffer,
            offset: 0,
            size: std::num::NonZeroU64::new(UNIFORM_SIZE),
        };
        self.group = Some(group(gpu, "moments.group", &self.layout, &[wgpu::BindingResource::Buffer(binding)]));
    }

    /// * `clear_glass`: what lets light through throws no shadow
    pub fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        scene: &SceneBuffers,
        plan: &ShadowPlan,
        targets: &ShadowTargets,
        filter: ShadowFilter,
        clear_glass: bool,
    ) {
        self.prepare(gpu, plan.views.len() as u32, filter);
        let Some(views) = &self.group else { return };
        for (maps, first_layer) in plan.lights.iter().zip(first_layers(plan)) {
            let arrays = if maps.count == 6 { &targets.faces } else { &targets.maps };
            for i in 0..maps.count {
                let number = maps.first + i;
                let view = &plan.views[number as usize];
                // Where nothing is met depth is 1.
                let [r, g, b, a] = moments_of(filter, 1.0).map(f64::from);
                let clear = wgpu::Color { r, g, b, a };
                let target = arrays.layer(first_layer + i);
                let mut pass = draw_pass(encoder, "moments", target, clear, Some(&arrays.depth.view));
                pass.set_bind_group(0, scene.group(), &[]);
                pass.set_bind_group(1, views, &[(u64::from(number) * self.stride) as u32]);
                let casts = |d: &&Draw| !(clear_glass && d.transmissive) && may_be_seen(view, &d.bounds_world);
                for (pipeline, cutout) in [(&self.pipeline, false), (&self.cutout, true)] {
                    for (i, draw) in scene.draws.iter().filter(|d| d.cutout == cutout).filter(casts).enumerate() {
                        if i == 0 {
                            pass.set_pipeline(pipeline);
                        }
                        pass.draw(0..draw.vertices, draw.instance..draw.instance + 1);
                    }
                }
            }
        }
    }
}

/// False only where the box lies outside one side of the view's frustum.
fn may_be_seen(view: &ShadowView, bounds: &Aabb) -> bool {
    if bounds.is_empty() {
        return false;
    }
    // Outside of each side so far: left, right, bottom, top, behind.
    let mut outside = [true; 5];
    for corner in bounds.corners() {
        let v = corner - view.origin_world;
        let (x, y, z) = (view.right_scaled.dot(v), view.up_scaled.dot(v), view.forward.dot(v));
        let w = if view.perspective > 0.5 { z } else { 1.0 };
        // A hair of slack, since the box's corners are rounded.
        let slack = 1e-4 * (w.abs() + x.abs() + y.abs());
        let here = [x < -w - slack, x > w + slack, y < -w - slack, y > w + slack, w <= 0.0];
        outside = std::array::from_fn(|i| outside[i] && here[i]);
    }
    !outside.contains(&true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use catoptra_engine::glam::Vec3;

    #[test]
    fn culling_keeps_all_that_a_view_may_see() {
        let view = ShadowView {
            origin_world: Vec3::ZERO,
            far: 10.0,
            right_scaled: Vec3::X,
            perspective: 1.0,
            up_scaled: Vec3::Y,
            size: 64,
            forward: Vec3::NEG_Z,
            softness: 0.0,
        };
        let at = |c: Vec3| Aabb { min: c - Vec3::ONE, max: c + Vec3::ONE };
        assert!(may_be_seen(&view, &at(Vec3::new(0.0, 0.0, -5.0))));
        assert!(may_be_seen(&view, &at(Vec3::ZERO)), "a box around the light");
        assert!(may_be_seen(&view, &at(Vec3::new(5.0, 0.0, -5.0))), "a box on the rim");
        assert!(!may_be_seen(&view, &at(Vec3::new(0.0, 0.0, 5.0))), "behind");
        assert!(!may_be_seen(&view, &at(Vec3::new(9.0, 0.0, -5.0))), "beside");
        assert!(!may_be_seen(&view, &Aabb::EMPTY));
    }
}
