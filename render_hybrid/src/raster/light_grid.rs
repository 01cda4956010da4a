//! Pass: light of the VPLs at the places of a grid of the picture.

use super::{
    device::Gpu,
    direct::write_part,
    indirect::IndirectPass,
    layouts::GridUniform,
    pipeline::{Slot, compute_pipeline, group, group_layout, pipeline_layout, uniform},
    scene_buffers::SceneBuffers,
    shader,
    targets::{PictureTargets, RADIANCE_FORMAT, Target},
};
use crate::{
    error::RenderError,
    twin::grid::{GridPoint, grid_size},
};

/// Layers of the grid's texture: red, green and blue with the normal, and the place.
const LAYERS: u32 = 4;

/// Evaluates all VPLs at what every so-many-th pixel shows.
pub(crate) struct GridPass {
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    uniform: wgpu::Buffer,
    shape: Option<GridUniform>,
    /// The points came from the CPU.
    loaded: bool,
    /// Two, because chunks of VPLs are added to what earlier chunks left; the result is in the first. At least as large as the
    /// grid.
    targets: [Target; 2],
}

/// Bindings that read the second and the first of the two targets.
pub(crate) struct GridGroups([wgpu::BindGroup; 2]);

/// The target that chunk `i` of so many is added into: the last one's is the first.
fn target_of(i: u32, chunks: u32) -> usize {
    ((chunks - 1 - i) % 2) as usize
}

impl GridPass {
    pub fn new(gpu: &Gpu, frame: &wgpu::BindGroupLayout) -> Result<Self, RenderError> {
        use Slot::{Texture, TextureArray, Uniform, WriteArray};
        let chunk = Slot::DynamicUniform(IndirectPass::CHUNK_SIZE);
        let layout = group_layout(
            gpu,
            "light_grid.group",
            wgpu::ShaderStages::COMPUTE,
            &[chunk, Uniform, Texture, Texture, Texture, TextureArray, Texture, WriteArray(RADIANCE_FORMAT)],
        );
        let module = shader::module(&gpu.device, "light_grid");
        let pipeline_layout = pipeline_layout(gpu, "light_grid", Some(frame), Some(&layout));
        Ok(Self {
            pipeline: compute_pipeline(gpu, &module, &pipeline_layout, "light_grid"),
            layout,
            uniform: uniform(gpu, "light_grid.uniform", size_of::<GridUniform>() as u64),
            shape: None,
            loaded: false,
            targets: Self::make_targets(gpu, [1, 1])?,
        })
    }

    fn make_targets(gpu: &Gpu, [width, height]: [u32; 2]) -> Result<[Target; 2], RenderError> {
        let usage =
            wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::COPY_DST;
        let target = |label| Target::new(gpu, label, [width, height, LAYERS], RADIANCE_FORMAT, usage, true);
        Ok([target("light_grid.points")?, target("light_grid.previous")?])
    }

    /// Pixels from place to place in the next frame; 1: there is no grid. True where the textures were replaced, so that what
    /// binds them must do so again.
    /// * `adds`: the light of the VPLs is added to that of [`Self::begin_with`]
    pub fn set(&mut self, gpu: &Gpu, picture: &PictureTargets, spacing: u32, adds: bool) -> Result<bool, RenderError> {
        self.loaded = false;
        let size = if spacing > 1 { grid_size([picture.width, picture.height], spacing) } else { [1, 1] };
        let shape = GridUniform { size, spacing, adds: u32::from(adds) };
        if self.shape != Some(shape) {
            gpu.upload(&self.uniform, 0, bytemuck::bytes_of(&shape));
            self.shape = Some(shape);
        }
        let t = &self.targets[0].texture;
        let replaced = t.width() < size[0] || t.height() < size[1];
        if replaced {
            self.targets = Self::make_targets(gpu, size)?;
        }
        Ok(replaced)
    }

    /// Takes the points from the CPU for the next frame, row by row, in place of a pass over the places. After [`Self::set`].
    ///
    /// # Errors
    /// [`RenderError::Settings`] where there is not a point a place.
    pub fn load(&mut self, gpu: &Gpu, points: &[GridPoint]) -> Result<(), RenderError> {
        self.write(gpu, 0, LAYERS, points)?;
        self.loaded = true;
        Ok(())
    }

    /// Takes light from the CPU, row by row, that the pass over the places adds to. After [`Self::set`].
    /// * `chunks`: that the pass will be recorded with
    ///
    /// # Errors
    /// [`RenderError::Settings`] where there is not a point a place.
    pub fn begin_with(&mut self, gpu: &Gpu, points: &[GridPoint], chunks: u32) -> Result<(), RenderError> {
        // What the first chunk reads.
        let from = 1 - target_of(0, chunks.max(1));
        self.write(gpu, from, LAYERS - 1, points)
    }

    /// Fills in the first so many layers of a target.
    fn write(&self, gpu: &Gpu, target: usize, layers: u32, points: &[GridPoint]) -> Result<(), RenderError> {
        let Some(shape) = self.shape else { return Ok(()) };
        let (given, places) = (points.len(), (shape.size[0] * shape.size[1]) as usize);
        if given != places {
            return Err(RenderError::Settings(format!("the grid of light has {given} of {places} points")));
        }
        for layer in 0..layers {
            let word = |p: &GridPoint| match p.arriving.get(layer as usize) {
                Some(arriving) => arriving.extend(p.normal[layer as usize]),
                None => p.position_world.extend(0.0),
            };
            let words: Vec<[f32; 4]> = points.iter().map(|p| word(p).to_array()).collect();
            let texture = &self.targets[target].texture;
            write_part(gpu, texture, [0, layer], shape.size, bytemuck::cast_slice(&words), 16);
        }
        Ok(())
    }

    /// False where pixels are lit one by one.
    pub fn is_on(&self) -> bool {
        self.shape.is_some_and(|s| s.spacing > 1)
    }

    /// The grid's shape, and its points.
    pub fn resources(&self) -> [wgpu::BindingResource<'_>; 2] {
        [self.uniform.as_entire_binding(), wgpu::BindingResource::TextureView(&self.targets[0].view)]
    }

    pub fn bind(&self, gpu: &Gpu, t: &PictureTargets, indirect: &IndirectPass) -> GridGroups {
        let view = |v| wgpu::BindingResource::TextureView(v);
        GridGroups([0, 1].map(|into: usize| {
            let resources = [
                indirect.chunk_resource(),
                self.uniform.as_entire_binding(),
                view(&t.position.view),
                view(&t.normals.view),
                view(&t.base_color.view),
                view(&self.targets[1 - into].view),
                view(indirect.maps().0),
                view(&self.targets[into].view),
            ];
            group(gpu, "light_grid.group", &self.layout, &resources)
        }))
    }

    /// * `chunks`: how many of the indirect pass's chunks, `stride` bytes apart, hold all VPLs
    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        scene: &SceneBuffers,
        groups: &GridGroups,
        chunks: u32,
        stride: u64,
    ) {
        let Some(shape) = self.shape.filter(|_| !self.loaded) else { return };
        for i in 0..chunks {
            let into = target_of(i, chunks);
            let mut pass = encoder
                .begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some("light_grid"), timestamp_writes: None });
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, scene.group(), &[]);
            pass.set_bind_group(1, &groups.0[into], &[(stride * u64::from(i)) as u32]);
            pass.dispatch_workgroups(shape.size[0].div_ceil(8), shape.size[1].div_ceil(8), 1);
        }
    }
}
