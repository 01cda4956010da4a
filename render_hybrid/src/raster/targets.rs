//! Textures that live between passes: those of the picture's size, and the shadow moments.

use super::{device::Gpu, shader::COMPACT_BLOCK};
use crate::{
    error::RenderError,
    twin::{penumbra::level_count, shadow::ShadowPlan},
};

/// Linear radiance and positions.
pub(crate) const RADIANCE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Float;
pub(crate) const MOMENTS_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Float;
pub(crate) const VISIBILITY_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rg32Uint;
pub(crate) const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// A texture with its whole view.
pub(crate) struct Target {
    pub texture: wgpu::Texture,
    pub view: wgpu::TextureView,
}

impl Target {
    pub fn new(
        gpu: &Gpu,
        label: &str,
        [width, height, layers]: [u32; 3],
        format: wgpu::TextureFormat,
        usage: wgpu::TextureUsages,
        array: bool,
    ) -> Result<Self, RenderError> {
        Self::with_levels(gpu, label, [width, height, layers], 1, format, usage, array)
    }

    /// [`Self::new`] with `levels` mip levels.
    pub fn with_levels(
        gpu: &Gpu,
        label: &str,
        [width, height, layers]: [u32; 3],
        levels: u32,
        format: wgpu::TextureFormat,
        usage: wgpu::TextureUsages,
        array: bool,
    ) -> Result<Self, RenderError> {
        let limits = gpu.device.limits();
        if width.max(height) > limits.max_texture_dimension_2d {
            let most = limits.max_texture_dimension_2d;
            return Err(RenderError::Gpu(format!("{label} of {width}x{height}: this adapter's limit is {most}")));
        }
        if layers > limits.max_texture_array_layers {
            let most = limits.max_texture_array_layers;
            return Err(RenderError::Gpu(format!("{label} of {layers} layers: this adapter's limit is {most}")));
        }
        let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some(label),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: layers },
            mip_level_count: levels,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage,
            view_formats: &[],
        });
        let dimension = if array { wgpu::TextureViewDimension::D2Array } else { wgpu::TextureViewDimension::D2 };
        let view = texture.create_view(&wgpu::TextureViewDescriptor {
            label: Some(label),
            dimension: Some(dimension),
            ..Default::default()
        });
        Ok(Self { texture, view })
    }

    /// View of one layer, for rendering into it.
    pub fn layer_view(&self, label: &str, layer: u32) -> wgpu::TextureView {
        self.texture.create_view(&wgpu::TextureViewDescriptor {
            label: Some(label),
            dimension: Some(wgpu::TextureViewDimension::D2),
            base_array_layer: layer,
            array_layer_count: Some(1),
            mip_level_count: Some(1),
            ..Default::default()
        })
    }

    /// View of one level of all layers, for compute passes.
    pub fn level_view(&self, label: &str, level: u32) -> wgpu::TextureView {
        self.texture.create_view(&wgpu::TextureViewDescriptor {
            label: Some(label),
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            base_mip_level: level,
            mip_level_count: Some(1),
            ..Default::default()
        })
    }
}

/// Everything of the picture's size.
pub(crate) struct PictureTargets {
    pub width: u32,
    pub height: u32,
    pub visibility: Target,
    pub depth: Target,
    pub position: Target,
    pub normals: Target,
    pub base_color: Target,
    pub emission: Target,
    pub direct: Target,
    /// Two, because chunks of VPLs are added to what earlier chunks left, and interleaved VPLs' light is filtered; the result
    /// is in the first.
    pub indirect: [Target; 2],
    pub traced: Target,
    pub last: Target,
    /// Counts, then places, of the compaction's blocks, and the count of all.
    pub blocks: wgpu::Buffer,
    /// Numbers of the masked pixels.
    pub pixels: wgpu::Buffer,
}

impl PictureTargets {
    pub fn new(gpu: &Gpu, width: u32, height: u32) -> Result<Self, RenderError> {
        use wgpu::TextureUsages as U;
        let read = U::TEXTURE_BINDING | U::COPY_SRC;
        let target = |label: &str, format, usage| Target::new(gpu, label, [width, height, 1], format, usage, false);
        let radiance = |label: &str, usage| target(label, RADIANCE_FORMAT, usage);
        let drawn = read | U::RENDER_ATTACHMENT;
        let pixels = u64::from(width) * u64::from(height);
        let storage = |label: &str, size: u64| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            })
        };
        Ok(Self {
            width,
            height,
            visibility: target("gbuffer.visibility", VISIBILITY_FORMAT, drawn)?,
            depth: target("gbuffer.depth", DEPTH_FORMAT, U::RENDER_ATTACHMENT)?,
            position: radiance("gbuffer.position", read | U::STORAGE_BINDING)?,
            normals: radiance("gbuffer.normals", read | U::STORAGE_BINDING)?,
            base_color: radiance("gbuffer.base_color", read | U::STORAGE_BINDING)?,
            emission: radiance("gbuffer.emission", read | U::STORAGE_BINDING)?,
            direct: radiance("direct.radiance", drawn)?,
            indirect: [radiance("indirect.radiance", drawn | U::COPY_DST)?, radiance("indirect.previous", drawn)?],
            traced: radiance("traced.radiance", drawn | U::STORAGE_BINDING)?,
            last: radiance("compose.final", drawn)?,
            blocks: storage("compact.blocks", (pixels.div_ceil(u64::from(COMPACT_BLOCK)) + 1) * 4),
            pixels: storage("compact.pixels", pixels * 4),
        })
    }
}

/// Shadow moments of one map size.
pub(crate) struct MomentTargets {
    /// Texels a side.
    pub size: u32,
    /// Moments, blurred in the end, and the further levels of their pyramid.
    pub moments: Target,
    /// Blurred along rows.
    pub scratch: Target,
    pub depth: Target,
    pub layers: u32,
    layer_views: Vec<wgpu::TextureView>,
}

impl MomentTargets {
    fn new(gpu: &Gpu, name: &str, size: u32, layers: u32) -> Result<Self, RenderError> {
        use wgpu::TextureUsages as U;
        let array = |label: String, usage| Target::new(gpu, &label, [size, size, layers], MOMENTS_FORMAT, usage, true);
        let usage = U::RENDER_ATTACHMENT | U::TEXTURE_BINDING | U::STORAGE_BINDING | U::COPY_SRC;
        let extent = [size, size, layers];
        let label = format!("{name}.moments");
        let moments = Target::with_levels(gpu, &label, extent, level_count(size), MOMENTS_FORMAT, usage, true)?;
        let scratch = array(format!("{name}.scratch"), U::TEXTURE_BINDING | U::STORAGE_BINDING)?;
        let depth_label = format!("{name}.depth");
        let depth = Target::new(gpu, &depth_label, [size, size, 1], DEPTH_FORMAT, U::RENDER_ATTACHMENT, false)?;
        let layer_views = (0..layers).map(|l| moments.layer_view(&format!("{name}.layer"), l)).collect();
        Ok(Self { size, moments, scratch, depth, layers, layer_views })
    }

    pub fn layer(&self, layer: u32) -> &wgpu::TextureView {
        &self.layer_views[layer as usize]
    }
}

/// Both arrays of shadow moments: single maps, and faces of cubes.
pub(crate) struct ShadowTargets {
    pub maps: MomentTargets,
    pub faces: MomentTargets,
}

impl ShadowTargets {
    /// Sizes and layer counts that `plan` needs: [maps, faces].
    pub fn wanted(plan: &ShadowPlan) -> [(u32, u32); 2] {
        let mut wanted = [(1, 0), (1, 0)];
        for light in &plan.lights {
            let kind = &mut wanted[usize::from(light.count == 6)];
            if let Some(view) = plan.views.get(light.first as usize) {
                *kind = (view.size, kind.1 + light.count);
            }
        }
        wanted.map(|(size, layers)| (size, layers.max(1)))
    }

    pub fn new(gpu: &Gpu, [maps, faces]: [(u32, u32); 2]) -> Result<Self, RenderError> {
        Ok(Self {
            maps: MomentTargets::new(gpu, "maps", maps.0, maps.1)?,
            faces: MomentTargets::new(gpu, "faces", faces.0, faces.1)?,
        })
    }

    pub fn fits(&self, [maps, faces]: [(u32, u32); 2]) -> bool {
        (self.maps.size, self.maps.layers) == maps && (self.faces.size, self.faces.layers) == faces
    }
}

/// One pass that clears and draws into `target`.
pub(crate) fn draw_pass<'e>(
    encoder: &'e mut wgpu::CommandEncoder,
    label: &str,
    target: &wgpu::TextureView,
    clear: wgpu::Color,
    depth: Option<&wgpu::TextureView>,
) -> wgpu::RenderPass<'e> {
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some(label),
        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
            view: target,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations { load: wgpu::LoadOp::Clear(clear), store: wgpu::StoreOp::Store },
        })],
        depth_stencil_attachment: depth.map(|view| wgpu::RenderPassDepthStencilAttachment {
            view,
            // Reversed depth: 0 is infinitely far.
            depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Discard }),
            stencil_ops: None,
        }),
        ..Default::default()
    })
}
