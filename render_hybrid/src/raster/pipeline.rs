//! Short hands for layouts and pipelines.

use super::{device::Gpu, shader, targets::DEPTH_FORMAT};

/// What a group-1 binding is.
#[derive(Clone, Copy)]
pub(crate) enum Slot {
    /// Uniform buffer.
    Uniform,
    /// Uniform buffer at an offset chosen when drawing; size of what the shader sees.
    DynamicUniform(u64),
    /// Float texture, read by `textureLoad`.
    Texture,
    /// Unsigned texture.
    TextureUint,
    /// Float texture array.
    TextureArray,
    /// Texture that a compute pass writes.
    Write(wgpu::TextureFormat),
    /// Texture array that a compute pass writes.
    WriteArray(wgpu::TextureFormat),
    /// Storage buffer; true: read only.
    Storage(bool),
}

/// Group layout of a pass: the slots are bindings 0, 1, ...
pub(crate) fn group_layout(
    gpu: &Gpu,
    label: &str,
    visibility: wgpu::ShaderStages,
    slots: &[Slot],
) -> wgpu::BindGroupLayout {
    use wgpu::{BindingType as B, BufferBindingType, TextureSampleType, TextureViewDimension as D};
    let buffer = |ty, has_dynamic_offset, size| B::Buffer {
        ty,
        has_dynamic_offset,
        min_binding_size: std::num::NonZeroU64::new(size),
    };
    let texture = |sample_type, view_dimension| B::Texture { sample_type, view_dimension, multisampled: false };
    let float = TextureSampleType::Float { filterable: false };
    let write = |format, view_dimension| B::StorageTexture {
        access: wgpu::StorageTextureAccess::WriteOnly,
        format,
        view_dimension,
    };
    let entries: Vec<_> = slots
        .iter()
        .enumerate()
        .map(|(binding, slot)| wgpu::BindGroupLayoutEntry {
            binding: binding as u32,
            visibility,
            ty: match *slot {
                Slot::Uniform => buffer(BufferBindingType::Uniform, false, 0),
                Slot::DynamicUniform(size) => buffer(BufferBindingType::Uniform, true, size),
                Slot::Texture => texture(float, D::D2),
                Slot::TextureUint => texture(TextureSampleType::Uint, D::D2),
                Slot::TextureArray => texture(float, D::D2Array),
                Slot::Write(format) => write(format, D::D2),
                Slot::WriteArray(format) => write(format, D::D2Array),
                Slot::Storage(read_only) => buffer(BufferBindingType::Storage { read_only }, false, 0),
            },
            count: None,
        })
        .collect();
    gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries })
}

/// Group of a pass: the resources are bindings 0, 1, ...
pub(crate) fn group(
    gpu: &Gpu,
    label: &str,
    layout: &wgpu::BindGroupLayout,
    resources: &[wgpu::BindingResource<'_>],
) -> wgpu::BindGroup {
    let entries: Vec<_> = resources
        .iter()
        .enumerate()
        .map(|(i, r)| wgpu::BindGroupEntry { binding: i as u32, resource: r.clone() })
        .collect();
    gpu.device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some(label), layout, entries: &entries })
}

/// Group 0 is the frame's or none, group 1 the pass's.
pub(crate) fn pipeline_layout(
    gpu: &Gpu,
    label: &str,
    frame: Option<&wgpu::BindGroupLayout>,
    pass: Option<&wgpu::BindGroupLayout>,
) -> wgpu::PipelineLayout {
    gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(label),
        bind_group_layouts: &[frame, pass],
        immediate_size: 0,
    })
}

/// A pipeline that draws triangles of `vertex` with `fragment` into one target, both sides, nearest depth where asked.
pub(crate) fn draw_pipeline(
    gpu: &Gpu,
    pass: &str,
    layout: &wgpu::PipelineLayout,
    target: wgpu::TextureFormat,
    depth: bool,
) -> wgpu::RenderPipeline {
    let module = shader::module(&gpu.device, pass);
    gpu.count_pipeline();
    gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(pass),
        layout: Some(layout),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("vertex"),
            compilation_options: Default::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: depth.then(|| wgpu::DepthStencilState {
            format: DEPTH_FORMAT,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: Default::default(),
            bias: Default::default(),
        }),
        multisample: Default::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("fragment"),
            compilation_options: Default::default(),
            targets: &[Some(target.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// A compute pipeline.
pub(crate) fn compute_pipeline(
    gpu: &Gpu,
    module: &wgpu::ShaderModule,
    layout: &wgpu::PipelineLayout,
    entry_point: &str,
) -> wgpu::ComputePipeline {
    compute_pipeline_with(gpu, module, layout, entry_point, &[])
}

/// A compute pipeline whose `override` constants are given by name.
pub(crate) fn compute_pipeline_with(
    gpu: &Gpu,
    module: &wgpu::ShaderModule,
    layout: &wgpu::PipelineLayout,
    entry_point: &str,
    constants: &[(&str, f64)],
) -> wgpu::ComputePipeline {
    gpu.count_pipeline();
    gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(entry_point),
        layout: Some(layout),
        module,
        entry_point: Some(entry_point),
        compilation_options: wgpu::PipelineCompilationOptions { constants, ..Default::default() },
        cache: None,
    })
}

/// Workgroups in two dimensions, since one holds at most 65,535; shaders number them y · count.x + x.
pub(crate) fn linear_dispatch(groups: u64) -> (u32, u32) {
    let x = groups.clamp(1, 32_768);
    (x as u32, groups.max(1).div_ceil(x) as u32)
}

/// A small uniform buffer.
pub(crate) fn uniform(gpu: &Gpu, label: &str, size: u64) -> wgpu::Buffer {
    gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size,
        usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}
