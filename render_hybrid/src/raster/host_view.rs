//! Pictures that the CPU lane made, drawn into a view of the host's device.

use super::{
    device::Gpu,
    present::PresentPass,
    targets::{RADIANCE_FORMAT, Target},
};
use crate::{error::RenderError, output::Image};

/// A picture on a borrowed device and the pass that draws it. Needs nothing of the device but a 32-bit float texture that
/// is read by texel.
pub(crate) struct HostView {
    gpu: Gpu,
    present: PresentPass,
    picture: Option<(Target, wgpu::BindGroup)>,
    rgba: Vec<[f32; 4]>,
}

impl HostView {
    /// Lends the device; the host keeps its error callbacks.
    pub fn new(device: wgpu::Device, queue: wgpu::Queue) -> Result<Self, RenderError> {
        let gpu = Gpu::lend(device, queue);
        let present = gpu.scoped(|| Ok(PresentPass::new(&gpu)))?;
        Ok(Self { gpu, present, picture: None, rgba: Vec::new() })
    }

    /// Sends `image` and draws it over all of `target`, as [`super::GpuRaster::present`] does. Returns the bytes sent.
    pub fn draw(
        &mut self,
        image: &Image,
        target: &wgpu::TextureView,
        format: wgpu::TextureFormat,
        exposure_ev: f32,
    ) -> Result<u64, RenderError> {
        let guard = self.gpu.handles();
        guard.scoped_view(|| self.draw_inner(image, target, format, exposure_ev))
    }

    fn draw_inner(
        &mut self,
        image: &Image,
        target: &wgpu::TextureView,
        format: wgpu::TextureFormat,
        exposure_ev: f32,
    ) -> Result<u64, RenderError> {
        let (width, height) = (image.width, image.height);
        let fits = |t: &Target| (t.texture.width(), t.texture.height()) == (width, height);
        let (picture, group) = match self.picture.take().filter(|(t, _)| fits(t)) {
            Some(kept) => kept,
            None => {
                let usage = wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST;
                let size = [width, height, 1];
                let picture = Target::new(&self.gpu, "host_view.picture", size, RADIANCE_FORMAT, usage, false)?;
                let group = self.present.bind(&self.gpu, &picture.view);
                (picture, group)
            }
        };
        self.rgba.clear();
        self.rgba.extend(image.pixels.iter().map(|&[r, g, b]| [r, g, b, 1.0]));
        self.gpu.queue.write_texture(
            picture.texture.as_image_copy(),
            bytemuck::cast_slice(&self.rgba),
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(16 * width), rows_per_image: None },
            wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        );
        self.present.prepare(&self.gpu, format, exposure_ev);
        let mut encoder = self.gpu.encoder("host_view");
        self.present.record(&mut encoder, &group, target, format);
        self.gpu.queue.submit([encoder.finish()]);
        self.picture = Some((picture, group));
        Ok(self.rgba.len() as u64 * 16)
    }
}
