//! Pass: light of the VPLs, in chunks that fit a uniform buffer.

use super::{
    device::{Gpu, GrowBuffer},
    direct::{write_rows, write_texture},
    layouts::{IndirectHead, SubsetUniform, VplData},
    light_grid::GridPass,
    pipeline::{Slot, draw_pipeline, group, group_layout, pipeline_layout},
    scene_buffers::SceneBuffers,
    shader::VPL_CHUNK,
    targets::{PictureTargets, RADIANCE_FORMAT, Target, draw_pass},
};
use crate::{
    error::RenderError,
    twin::{interleave::subset_range, vpl::Vpl, vpl_maps::VplMaps},
};

/// Where the VPLs of a frame lie among the chunks.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct VplChunks {
    /// Chunks from the first on that hold all VPLs.
    pub all: u32,
    /// First of the chunks that light pixels of which the grid cannot tell, and all pixels where there is none.
    first: u32,
    /// Number of those.
    count: u32,
    /// Side of the blocks of pixels over which the VPLs are interleaved; 0 or 1: each lights all pixels.
    interleave: u32,
}

impl VplChunks {
    /// True where [`IndirectPass::record`] leaves the light of subsets in the second target, to be filtered.
    pub fn of_subsets(&self) -> bool {
        self.interleave > 1 && self.count > 0
    }
}

/// Sums the contribution of all VPLs.
pub(crate) struct IndirectPass {
    pipeline: wgpu::RenderPipeline,
    layout: wgpu::BindGroupLayout,
    chunks: GrowBuffer,
    stride: u64,
    /// Which subset a draw is for: as many as were ever wanted.
    subsets: GrowBuffer,
    subset_stride: u64,
    subset_count: u32,
    /// Shadow maps of the VPLs, a row each; a single texel where there are none.
    maps: Target,
    map_size: u32,
    /// What the texture's first rows hold.
    held_maps: Vec<f32>,
    /// VPLs of pixels that the grid cannot tell about; `None`: all.
    few: Option<Vec<VplData>>,
}

/// Bindings that read the second and the first of the two targets.
pub(crate) struct IndirectGroups([wgpu::BindGroup; 2]);

impl IndirectPass {
    /// What a shader sees of a chunk, bytes.
    pub const CHUNK_SIZE: u64 = size_of::<IndirectHead>() as u64 + VPL_CHUNK as u64 * size_of::<VplData>() as u64;

    pub fn new(gpu: &Gpu, frame: &wgpu::BindGroupLayout) -> Result<Self, RenderError> {
        use Slot::{Texture, TextureArray, Uniform};
        let layout = group_layout(
            gpu,
            "indirect.group",
            wgpu::ShaderStages::FRAGMENT,
            &[
                Slot::DynamicUniform(Self::CHUNK_SIZE),
                Texture,
                Texture,
                Texture,
                Texture,
                Texture,
                Uniform,
                TextureArray,
                Slot::DynamicUniform(size_of::<SubsetUniform>() as u64),
            ],
        );
        let pipeline_layout = pipeline_layout(gpu, "indirect", Some(frame), Some(&layout));
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        let alignment = u64::from(gpu.device.limits().min_uniform_buffer_offset_alignment);
        let stride = Self::CHUNK_SIZE.next_multiple_of(alignment);
        let subset_stride = (size_of::<SubsetUniform>() as u64).next_multiple_of(alignment);
        let mut pass = Self {
            pipeline: draw_pipeline(gpu, "indirect", &pipeline_layout, RADIANCE_FORMAT, false),
            layout,
            chunks: GrowBuffer::new(gpu, "indirect.chunks", usage, stride),
            stride,
            subsets: GrowBuffer::new(gpu, "indirect.subsets", usage, subset_stride),
            subset_stride,
            subset_count: 0,
            maps: Self::maps_target(gpu, [1, 1])?,
            map_size: 0,
            held_maps: Vec::new(),
            few: None,
        };
        pass.reserve_subsets(gpu, 1);
        Ok(pass)
    }

    /// Makes room for the numbers of n² subsets; true where the buffer was replaced.
    fn reserve_subsets(&mut self, gpu: &Gpu, n: u32) -> bool {
        let count = (n * n).max(1);
        if count <= self.subset_count {
            return false;
        }
        let replaced = self.subsets.reserve(gpu, self.subset_stride * u64::from(count));
        for k in 0..count {
            let data = SubsetUniform { k, unused0: 0, unused1: 0, unused2: 0 };
            gpu.upload(&self.subsets.buffer, self.subset_stride * u64::from(k), bytemuck::bytes_of(&data));
        }
        self.subset_count = count;
        replaced
    }

    fn maps_target(gpu: &Gpu, [width, height]: [u32; 2]) -> Result<Target, RenderError> {
        let usage = wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST;
        Target::new(gpu, "indirect.vpl_maps", [width, height, 1], wgpu::TextureFormat::R32Float, usage, false)
    }

    /// Maps for the VPLs of the next [`Self::upload`], in the order of VPLs; of size 0: none. Only those are sent that the GPU
    /// does not hold. True where the texture was replaced, so that [`Self::bind`] must follow.
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
            self.held_maps.clear();
            self.maps = Self::maps_target(gpu, [width, rows])?;
        }
        let row = |texels: &[f32], i: usize| -> bool {
            let at = i * width as usize..(i + 1) * width as usize;
            self.held_maps.get(at.clone()) == Some(&texels[at])
        };
        let renewed: Vec<usize> = (0..rows as usize).filter(|&i| !row(&maps.texels, i)).collect();
        for run in renewed.chunk_by(|a, b| a + 1 == *b) {
            let (first, end) = (run[0], run[run.len() - 1] + 1);
            let texels = &maps.texels[first * width as usize..end * width as usize];
            write_rows(gpu, &self.maps.texture, first as u32, bytemuck::cast_slice(texels), 4);
        }
        if !renewed.is_empty() {
            let held = self.held_maps.len().max(maps.texels.len());
            self.held_maps.resize(held, 0.0);
            for i in renewed {
                let at = i * width as usize..(i + 1) * width as usize;
                self.held_maps[at.clone()].copy_from_slice(&maps.texels[at]);
            }
        }
        Ok(replaced)
    }

    /// VPLs without shadows that light, in the next [`Self::upload`], pixels of which the grid cannot tell; `None`: all VPLs do.
    pub fn set_few(&mut self, few: Option<&[Vpl]>) {
        self.few = few.map(|few| lit(few).collect());
    }

    /// The maps, a row each, and texels a side of one; 0: none.
    pub fn maps(&self) -> (&wgpu::TextureView, u32) {
        (&self.maps.view, self.map_size)
    }

    /// The first chunk; others by offset.
    pub fn chunk_resource(&self) -> wgpu::BindingResource<'_> {
        wgpu::BindingResource::Buffer(wgpu::BufferBinding {
            buffer: &self.chunks.buffer,
            offset: 0,
            size: std::num::NonZeroU64::new(Self::CHUNK_SIZE),
        })
    }

    pub fn bind(&self, gpu: &Gpu, t: &PictureTargets, grid: &GridPass) -> IndirectGroups {
        let view = |v| wgpu::BindingResource::TextureView(v);
        IndirectGroups([1, 0].map(|previous: usize| {
            let [shape, points] = grid.resources();
            let resources = [
                self.chunk_resource(),
                view(&t.position.view),
                view(&t.normals.view),
                view(&t.base_color.view),
                view(&t.indirect[previous].view),
                view(&self.maps.view),
                shape,
                points,
                wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                    buffer: &self.subsets.buffer,
                    offset: 0,
                    size: std::num::NonZeroU64::new(size_of::<SubsetUniform>() as u64),
                }),
            ];
            group(gpu, "indirect.group", &self.layout, &resources)
        }))
    }

    /// Makes room for chunks of `vpls` VPLs that another pass writes, laid out as [`Self::upload`] does; true where the buffer
    /// was replaced, so that [`Self::bind`] must follow.
    /// * `interleave`: as in [`Self::upload`]; that pass groups them
    pub fn reserve(&mut self, gpu: &Gpu, vpls: u32, interleave: u32) -> (VplChunks, bool) {
        let all = vpls.div_ceil(VPL_CHUNK);
        let mut replaced = self.chunks.reserve(gpu, (self.stride * u64::from(all)).max(self.stride));
        replaced |= self.reserve_subsets(gpu, interleave);
        (VplChunks { all, first: 0, count: all, interleave }, replaced)
    }

    /// The chunks, and bytes from one to the next.
    pub fn chunks(&self) -> (&wgpu::Buffer, u64) {
        (&self.chunks.buffer, self.stride)
    }

    /// Uploads the VPLs that carry light; true where the buffer was replaced, so that [`Self::bind`] must follow.
    /// * `grid`: pixels of which it cannot tell are lit by those of [`Self::set_few`]
    /// * `interleave`: side of the blocks of pixels over which `vpls` are interleaved, which then are in runs of subsets
    ///   ([`crate::twin::interleave::group_subsets`]); 1: each lights all pixels
    pub fn upload(
        &mut self,
        gpu: &Gpu,
        vpls: &[Vpl],
        geometry_term_max: f32,
        grid: bool,
        interleave: u32,
    ) -> (VplChunks, bool) {
        // A subset is a run of places in the whole list.
        let of_all: Vec<VplData> = if interleave > 1 {
            vpls.iter().zip(0..).map(|(v, map)| VplData::new(v, map)).collect()
        } else {
            lit(vpls).collect()
        };
        let few = self.few.take();
        let of_few = few.as_deref().filter(|_| grid && !of_all.is_empty());
        let all = of_all.len().div_ceil(VPL_CHUNK as usize) as u32;
        // Where the few are none, an empty chunk makes pixels black.
        let count = of_few.map_or(all, |few| few.len().div_ceil(VPL_CHUNK as usize).max(1) as u32);
        let chunks = VplChunks { all, first: if of_few.is_some() { all } else { 0 }, count, interleave };
        let mut replaced = self.chunks.reserve(gpu, self.stride * u64::from((chunks.first + count).max(1)));
        replaced |= self.reserve_subsets(gpu, interleave);
        self.upload_list(gpu, 0, &of_all, geometry_term_max, self.map_size, interleave);
        if let Some(few) = of_few {
            self.upload_list(gpu, all, few, geometry_term_max, 0, 1);
        }
        self.few = few;
        (chunks, replaced)
    }

    fn upload_list(
        &self,
        gpu: &Gpu,
        first: u32,
        vpls: &[VplData],
        geometry_term_max: f32,
        map_size: u32,
        interleave: u32,
    ) {
        let mut lists: Vec<_> = vpls.chunks(VPL_CHUNK as usize).collect();
        if lists.is_empty() {
            lists.push(&[]);
        }
        for (i, list) in lists.into_iter().enumerate() {
            let offset = self.stride * (u64::from(first) + i as u64);
            let head = IndirectHead {
                count: list.len() as u32,
                first: i as u32 * VPL_CHUNK,
                // Infinity is no number for a shader.
                geometry_term_max: geometry_term_max.min(f32::MAX),
                map_size,
                all: vpls.len() as u32,
                interleave,
                unused0: 0,
                unused1: 0,
            };
            gpu.upload(&self.chunks.buffer, offset, bytemuck::bytes_of(&head));
            gpu.upload(&self.chunks.buffer, offset + size_of::<IndirectHead>() as u64, bytemuck::cast_slice(list));
        }
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

    /// No chunks: the layer becomes black. [`VplChunks::of_subsets`]: the light is left in the second target, as
    /// [`super::interleave::InterleavePass`] wants it.
    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        scene: &SceneBuffers,
        groups: &IndirectGroups,
        targets: &PictureTargets,
        chunks: VplChunks,
    ) {
        let VplChunks { first, count, .. } = chunks;
        let n = chunks.interleave.max(1);
        if count == 0 {
            draw_pass(encoder, "indirect", &targets.indirect[0].view, wgpu::Color::BLACK, None);
        }
        for i in 0..count {
            // The last chunk ends in the first target, or in the second for the filter to read.
            let into = ((count - 1 - i + u32::from(chunks.of_subsets())) % 2) as usize;
            let mut pass = draw_pass(encoder, "indirect", &targets.indirect[into].view, wgpu::Color::BLACK, None);
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, scene.group(), &[]);
            let chunk = (self.stride * u64::from(first + i)) as u32;
            for k in 0..n * n {
                // Where the places of the subset's pixels are.
                let columns = subset_range(targets.width as usize, k % n, n);
                let rows = subset_range(targets.height as usize, k / n, n);
                if columns.is_empty() || rows.is_empty() {
                    continue;
                }
                pass.set_scissor_rect(columns.start as u32, rows.start as u32, columns.len() as u32, rows.len() as u32);
                pass.set_bind_group(1, &groups.0[into], &[chunk, (self.subset_stride * u64::from(k)) as u32]);
                pass.draw(0..3, 0..1);
            }
        }
    }
}

/// VPLs that carry light, each with the row of its map: empty slots add nothing.
fn lit(vpls: &[Vpl]) -> impl Iterator<Item = VplData> {
    let list = vpls.iter().zip(0..).filter(|(v, _)| v.flux.max_element() > 0.0);
    list.map(|(v, map)| VplData::new(v, map))
}
