//! Pass: Blinn-Phong under shadowed lights, ambient and emitted radiance.

use super::{
    device::Gpu,
    layouts::{DirectUniform, VISIBILITY_MOMENTS, VISIBILITY_NONE, VISIBILITY_PLANES},
    pipeline::{Slot, draw_pipeline, group, group_layout, pipeline_layout, uniform},
    scene_buffers::SceneBuffers,
    targets::{PictureTargets, RADIANCE_FORMAT, ShadowTargets, Target, draw_pass},
};
use crate::{
    error::RenderError,
    settings::{MomentOptions, ShadowFilter, Shadows},
};

/// Direct light of all lights.
pub(crate) struct DirectPass {
    pipeline: wgpu::RenderPipeline,
    layout: wgpu::BindGroupLayout,
    uniform: wgpu::Buffer,
    written: Option<DirectUniform>,
    /// Visibility that the CPU has traced, one layer a light; a single texel where there is none.
    pub planes: Target,
}

impl DirectPass {
    pub fn new(gpu: &Gpu, frame: &wgpu::BindGroupLayout) -> Result<Self, RenderError> {
        use Slot::{Texture, TextureArray, Uniform};
        let layout = group_layout(
            gpu,
            "direct.group",
            wgpu::ShaderStages::FRAGMENT,
            &[Uniform, Texture, Texture, Texture, Texture, TextureArray, TextureArray, TextureArray],
        );
        let pipeline_layout = pipeline_layout(gpu, "direct", Some(frame), Some(&layout));
        Ok(Self {
            pipeline: draw_pipeline(gpu, "direct", &pipeline_layout, RADIANCE_FORMAT, false),
            layout,
            uniform: uniform(gpu, "direct.uniform", size_of::<DirectUniform>() as u64),
            written: None,
            planes: Self::planes_target(gpu, [1, 1, 1])?,
        })
    }

    fn planes_target(gpu: &Gpu, size: [u32; 3]) -> Result<Target, RenderError> {
        let usage = wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST;
        Target::new(gpu, "direct.visibility_planes", size, wgpu::TextureFormat::R32Float, usage, true)
    }

    pub fn bind(&self, gpu: &Gpu, t: &PictureTargets, shadows: &ShadowTargets) -> wgpu::BindGroup {
        let resources = [
            self.uniform.as_entire_binding(),
            wgpu::BindingResource::TextureView(&t.position.view),
            wgpu::BindingResource::TextureView(&t.normals.view),
            wgpu::BindingResource::TextureView(&t.base_color.view),
            wgpu::BindingResource::TextureView(&t.emission.view),
            wgpu::BindingResource::TextureView(&shadows.maps.moments.view),
            wgpu::BindingResource::TextureView(&shadows.faces.moments.view),
            wgpu::BindingResource::TextureView(&self.planes.view),
        ];
        group(gpu, "direct.group", &self.layout, &resources)
    }

    /// Uploads the lights' traced visibility; true where the texture was replaced, so that [`Self::bind`] must follow.
    pub fn upload_planes(
        &mut self,
        gpu: &Gpu,
        planes: &[Vec<f32>],
        width: u32,
        height: u32,
    ) -> Result<bool, RenderError> {
        let pixels = width as usize * height as usize;
        if let Some(bad) = planes.iter().position(|p| p.len() != pixels) {
            let len = planes[bad].len();
            return Err(RenderError::Settings(format!("visibility of light {bad} has {len} of {pixels} pixels")));
        }
        let size = [width, height, planes.len().max(1) as u32];
        let t = &self.planes.texture;
        let replaced = [t.width(), t.height(), t.depth_or_array_layers()] != size;
        if replaced {
            self.planes = Self::planes_target(gpu, size)?;
        }
        for (layer, plane) in planes.iter().enumerate() {
            write_texture(gpu, &self.planes.texture, layer as u32, bytemuck::cast_slice(plane), 4);
        }
        Ok(replaced)
    }

    /// Chooses where visibility comes from.
    pub fn set_options(&mut self, gpu: &Gpu, shadows: Shadows, planes: bool, options: &MomentOptions) {
        let visibility = match shadows {
            _ if planes => VISIBILITY_PLANES,
            Shadows::Moments => VISIBILITY_MOMENTS,
            Shadows::Traced | Shadows::Certified | Shadows::Off => VISIBILITY_NONE,
        };
        let data = DirectUniform {
            visibility,
            min_variance: options.min_variance,
            light_bleed_reduction: options.light_bleed_reduction,
            evsm: u32::from(options.filter == ShadowFilter::Evsm4),
        };
        if self.written != Some(data) {
            gpu.upload(&self.uniform, 0, bytemuck::bytes_of(&data));
            self.written = Some(data);
        }
    }

    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        scene: &SceneBuffers,
        group: &wgpu::BindGroup,
        targets: &PictureTargets,
    ) {
        let mut pass = draw_pass(encoder, "direct", &targets.direct.view, wgpu::Color::BLACK, None);
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, scene.group(), &[]);
        pass.set_bind_group(1, group, &[]);
        pass.draw(0..3, 0..1);
    }
}

/// Writes one whole layer of a texture.
pub(crate) fn write_texture(gpu: &Gpu, texture: &wgpu::Texture, layer: u32, bytes: &[u8], texel_bytes: u32) {
    write_part(gpu, texture, [0, layer], [texture.width(), texture.height()], bytes, texel_bytes);
}

/// Writes whole rows of a texture from row `first` on, as many as the bytes fill.
pub(crate) fn write_rows(gpu: &Gpu, texture: &wgpu::Texture, first: u32, bytes: &[u8], texel_bytes: u32) {
    let rows = bytes.len() as u32 / (texture.width() * texel_bytes);
    write_part(gpu, texture, [first, 0], [texture.width(), rows], bytes, texel_bytes);
}

/// Writes a layer's texels (0, y) to (width, y + height).
pub(crate) fn write_part(
    gpu: &Gpu,
    texture: &wgpu::Texture,
    [y, z]: [u32; 2],
    [width, height]: [u32; 2],
    bytes: &[u8],
    texel_bytes: u32,
) {
    gpu.queue.write_texture(
        wgpu::TexelCopyTextureInfo {
            texture,
            mip_level: 0,
            origin: wgpu::Origin3d { x: 0, y, z },
            aspect: wgpu::TextureAspect::All,
        },
        bytes,
        wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(width * texel_bytes),
            rows_per_image: Some(height),
        },
        wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
    );
    gpu.count_up(bytes.len() as u64);
}
