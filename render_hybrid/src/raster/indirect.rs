//! Pass: light of the VPLs, in chunks that fit a uniform buffer.

use super::{
    device::{Gpu, GrowBuffer},
    direct::{write_rows, write_texture},
    layouts::{IndirectHead, VplData},
    pipeline::{Slot, draw_pipeline, group, group_layout, pipeline_layout},
    scene_buffers::SceneBuffers,
    shader::VPL_CHUNK,
    targets::{PictureTargets, RADIANCE_FORMAT, Target, draw_pass},
};
use crate::{
    error::RenderError,
    twin::{vpl::Vpl, vpl_maps::VplMaps},
};

const CHUNK_SIZE: u64 = size_of::<IndirectHead>() as u64 + VPL_CHUNK as u64 * size_of::<VplData>() as u64;

/// Sums the contribution of all VPLs.
pub(crate) struct IndirectPass {
    pipeline: wgpu::RenderPipeline,
    layout: wgpu::BindGroupLayout,
    chunks: GrowBuffer,
    stride: u64,
    /// Shadow maps of the VPLs, a row each; a single texel where there are none.
    maps: Target,
    map_size: u32,
}

/// Bindings that read the second and the first of the two targets.
pub(crate) struct IndirectGroups([wgpu::BindGroup; 2]);

impl IndirectPass {
    pub fn new(gpu: &Gpu, frame: &wgpu::BindGroupLayout) -> Result<Self, RenderError> {
        use Slot::Texture;
        let layout = group_layout(
            gpu,
            "indirect.group",
            wgpu::ShaderStages::FRAGMENT,
            &[Slot::DynamicUniform(CHUNK_SIZE), Texture, Texture, Texture, Texture, Texture],
        );
        let pipeline_layout = pipeline_layout(gpu, "indirect", Some(frame), Some(&layout));
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        let alignment = u64::from(gpu.device.limits().min_uniform_buffer_offset_alignment);
        let stride = CHUNK_SIZE.next_multiple_of(alignment);
        Ok(Self {
            pipeline: draw_pipeline(gpu, "indirect", &pipeline_layout, RADIANCE_FORMAT, false),
            layout,
            chunks: GrowBuffer::new(gpu, "indirect.chunks", usage, stride),
            stride,
            maps: Self::maps_target(gpu, [1, 1])?,
            map_size: 0,
        })
    }

    fn maps_target(gpu: &Gpu, [width, height]: [u32; 2]) -> Result<Target, RenderError> {
        let usage = wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST;
        Target::new(gpu, "indirect.vpl_maps", [width, height, 1], wgpu::TextureFormat::R32Float, usage, false)
    }

    /// Maps for the VPLs of the next [`Self::upload`], in the order of VPLs; of size 0: none. True where the texture was
    /// replaced, so that [`Self::bind`] must follow.
    pub fn upload_maps(&mut self, gpu: &Gpu, maps: &VplMaps) -> Result<bool, RenderError> {
        let width = maps.size * maps.size;
        self.map_size = if maps.texels.is_empty() { 0 } else { maps.size };
        if self.map_size == 0 {
            return Ok(false);
        }
        let rows = maps.texels.len() as u32 / width;
        let t = &self.maps.texture;
        let replaced = t.width() != width || t.height() < rows;
        if replaced {
            self.maps = Self::maps_target(gpu, [width, rows])?;
        }
        write_rows(gpu, &self.maps.texture, bytemuck::cast_slice(&maps.texels), 4);
        Ok(replaced)
    }

    /// The maps, a row each, and texels a side of one; 0: none.
    pub fn maps(&self) -> (&wgpu::TextureView, u32) {
        (&self.maps.view, self.map_size)
    }

    pub fn bind(&self, gpu: &Gpu, t: &PictureTargets) -> IndirectGroups {
        let chunk = || {
            wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                buffer: &self.chunks.buffer,
                offset: 0,
                size: std::num::NonZeroU64::new(CHUNK_SIZE),
            })
        };
        let view = |v| wgpu::BindingResource::TextureView(v);
        IndirectGroups([1, 0].map(|previous: usize| {
            let resources = [
                chunk(),
                view(&t.position.view),
                view(&t.normals.view),
                view(&t.base_color.view),
                view(&t.indirect[previous].view),
                view(&self.maps.view),
            ];
            group(gpu, "indirect.group", &self.layout, &resources)
        }))
    }

    /// Makes room for chunks of `vpls` VPLs that another pass writes, laid out as [`Self::upload`] does; (number of chunks, true
    /// where the buffer was replaced, so that [`Self::bind`] must follow).
    pub fn reserve(&mut self, gpu: &Gpu, vpls: u32) -> (u32, bool) {
        let chunks = vpls.div_ceil(VPL_CHUNK);
        (chunks, self.chunks.reserve(gpu, (self.stride * u64::from(chunks)).max(self.stride)))
    }

    /// The chunks, and bytes from one to the next.
    pub fn chunks(&self) -> (&wgpu::Buffer, u64) {
        (&self.chunks.buffer, self.stride)
    }

    /// Uploads the VPLs that carry light; (number of chunks, true where the buffer was replaced, so that [`Self::bind`]
    /// must follow).
    pub fn upload(&mut self, gpu: &Gpu, vpls: &[Vpl], geometry_term_max: f32) -> (u32, bool) {
        // Empty slots add nothing.
        let lit: Vec<VplData> = vpls
            .iter()
            .zip(0..)
            .filter(|(v, _)| v.flux.max_element() > 0.0)
            .map(|(v, map)| VplData::new(v, map))
            .collect();
        let chunks: Vec<_> = lit.chunks(VPL_CHUNK as usize).collect();
        let replaced = self.chunks.reserve(gpu, (self.stride * chunks.len() as u64).max(self.stride));
        for (i, chunk) in chunks.iter().enumerate() {
            let offset = self.stride * i as u64;
            let head = IndirectHead {
                count: chunk.len() as u32,
                accumulate: u32::from(i > 0),
                // Infinity is no number for a shader.
                geometry_term_max: geometry_term_max.min(f32::MAX),
                map_size: self.map_size,
            };
            gpu.upload(&self.chunks.buffer, offset, bytemuck::bytes_of(&head));
            gpu.upload(&self.chunks.buffer, offset + size_of::<IndirectHead>() as u64, bytemuck::cast_slice(chunk));
        }
        (chunks.len() as u32, replaced)
    }

    /// Uploads a layer that was made on the CPU in place of [`Self::record`].
    pub fn upload_layer(&self, gpu: &Gpu, targets: &PictureTargets, layer: &[[f32; 3]]) -> Result<(), RenderError> {
        let pixels = targets.width as usize * targets.height as usize;
        if layer.len() != pixels {
            return Err(RenderError::Settings(format!("the indirect layer has {} of {pixels} pixels", layer.len())));
        }
        let rgba: Vec<[f32; 4]> = layer.iter().map(|&[r, g, b]| [r, g, b, 1.0]).collect();
        write_texture(gpu, &targets.indirect[0].texture, 0, bytemuck::cast_slice(&rgba), 16);
        Ok(())
    }

    /// No chunks: the layer becomes black.
    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        scene: &SceneBuffers,
        groups: &IndirectGroups,
        targets: &PictureTargets,
        chunks: u32,
    ) {
        if chunks == 0 {
            draw_pass(encoder, "indirect", &targets.indirect[0].view, wgpu::Color::BLACK, None);
        }
        for i in 0..chunks {
            // The last chunk ends in the first target.
            let into = ((chunks - 1 - i) % 2) as usize;
            let mut pass = draw_pass(encoder, "indirect", &targets.indirect[into].view, wgpu::Color::BLACK, None);
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, scene.group(), &[]);
            pass.set_bind_group(1, &groups.0[into], &[(self.stride * u64::from(i)) as u32]);
            pass.draw(0..3, 0..1);
        }
    }
}
