//! Pass: the final picture to a window, and packed layers to pictures.

use catoptra_engine::math;

use super::{
    device::Gpu,
    layouts::{PackedLayer, PresentUniform},
    pipeline::{Slot, draw_pipeline, group, group_layout, pipeline_layout, uniform},
    readback::Readback,
    scene_buffers::SceneBuffers,
    targets::{PictureTargets, RADIANCE_FORMAT, Target, draw_pass},
};
use crate::error::RenderError;

/// Exposure, clamp and sRGB curve into a target of the host's format.
pub(crate) struct PresentPass {
    pipelines: Vec<(wgpu::TextureFormat, wgpu::RenderPipeline)>,
    layout: wgpu::BindGroupLayout,
    pipeline_layout: wgpu::PipelineLayout,
    uniform: wgpu::Buffer,
    written: Option<PresentUniform>,
}

impl PresentPass {
    pub fn new(gpu: &Gpu) -> Self {
        let layout = group_layout(gpu, "present.group", wgpu::ShaderStages::FRAGMENT, &[Slot::Uniform, Slot::Texture]);
        let pipeline_layout = pipeline_layout(gpu, "present", None, Some(&layout));
        Self {
            pipelines: Vec::new(),
            layout,
            pipeline_layout,
            uniform: uniform(gpu, "present.uniform", size_of::<PresentUniform>() as u64),
            written: None,
        }
    }

    pub fn bind(&self, gpu: &Gpu, picture: &wgpu::TextureView) -> wgpu::BindGroup {
        let resources = [self.uniform.as_entire_binding(), wgpu::BindingResource::TextureView(picture)];
        group(gpu, "present.group", &self.layout, &resources)
    }

    /// Compiles the pipeline for a format and sends what changed.
    pub fn prepare(&mut self, gpu: &Gpu, format: wgpu::TextureFormat, exposure_ev: f32) {
        if !self.pipelines.iter().any(|(f, _)| *f == format) {
            self.pipelines.push((format, draw_pipeline(gpu, "present", &self.pipeline_layout, format, false)));
        }
        let data = PresentUniform {
            exposure: math::exp2(exposure_ev),
            encode_srgb: u32::from(!format.is_srgb()),
            unused0: 0,
            unused1: 0,
        };
        if self.written != Some(data) {
            gpu.upload(&self.uniform, 0, bytemuck::bytes_of(&data));
            self.written = Some(data);
        }
    }

    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        group: &wgpu::BindGroup,
        target: &wgpu::TextureView,
        format: wgpu::TextureFormat,
    ) {
        let Some((_, pipeline)) = self.pipelines.iter().find(|(f, _)| *f == format) else { return };
        let mut pass = draw_pass(encoder, "present", target, wgpu::Color::BLACK, None);
        pass.set_pipeline(pipeline);
        pass.set_bind_group(1, group, &[]);
        pass.draw(0..3, 0..1);
    }
}

/// Unpacks one layer of the G-buffer and reads it back. Its picture is made when first asked for.
pub(crate) struct LayerPass {
    pipeline: wgpu::RenderPipeline,
    layout: wgpu::BindGroupLayout,
    uniform: wgpu::Buffer,
    picture: Option<Target>,
}

impl LayerPass {
    pub fn new(gpu: &Gpu, frame: &wgpu::BindGroupLayout) -> Self {
        let layout = group_layout(
            gpu,
            "layer.group",
            wgpu::ShaderStages::FRAGMENT,
            &[Slot::Uniform, Slot::Texture, Slot::Texture, Slot::Texture],
        );
        let pipeline_layout = pipeline_layout(gpu, "layer", Some(frame), Some(&layout));
        Self {
            pipeline: draw_pipeline(gpu, "layer", &pipeline_layout, RADIANCE_FORMAT, false),
            layout,
            uniform: uniform(gpu, "layer.uniform", 16),
            picture: None,
        }
    }

    pub fn read(
        &mut self,
        gpu: &Gpu,
        readback: &mut Readback,
        scene: &SceneBuffers,
        t: &PictureTargets,
        layer: PackedLayer,
    ) -> Result<Vec<[f32; 4]>, RenderError> {
        let fits = |p: &Target| (p.texture.width(), p.texture.height()) == (t.width, t.height);
        let picture = match self.picture.take().filter(fits) {
            Some(picture) => picture,
            None => {
                let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
                Target::new(gpu, "layer.picture", [t.width, t.height, 1], RADIANCE_FORMAT, usage, false)?
            }
        };
        gpu.upload(&self.uniform, 0, bytemuck::cast_slice(&[layer as u32, 0, 0, 0]));
        let view = |v| wgpu::BindingResource::TextureView(v);
        let resources =
            [self.uniform.as_entire_binding(), view(&t.position.view), view(&t.normals.view), view(&t.base_color.view)];
        let group = group(gpu, "layer.group", &self.layout, &resources);
        let mut encoder = gpu.encoder("layer");
        {
            let mut pass = draw_pass(&mut encoder, "layer", &picture.view, wgpu::Color::TRANSPARENT, None);
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, scene.group(), &[]);
            pass.set_bind_group(1, &group, &[]);
            pass.draw(0..3, 0..1);
        }
        gpu.queue.submit([encoder.finish()]);
        let pixels = readback.texture(gpu, &picture.texture, 0);
        self.picture = Some(picture);
        pixels
    }
}
