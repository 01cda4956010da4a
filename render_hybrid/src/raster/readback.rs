//! From the GPU to the CPU: through one staging buffer that is kept.

use bytemuck::Pod;

use super::device::{Gpu, GrowBuffer};
use crate::error::RenderError;

/// Copies buffers and textures into vectors.
pub(crate) struct Readback {
    staging: GrowBuffer,
}

impl Readback {
    pub fn new(gpu: &Gpu) -> Self {
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        Self { staging: GrowBuffer::new(gpu, "readback.staging", usage, 256) }
    }

    /// `bytes` of a buffer from `offset` on; both multiples of 4.
    pub fn buffer<T: Pod>(
        &mut self,
        gpu: &Gpu,
        source: &wgpu::Buffer,
        offset: u64,
        bytes: u64,
    ) -> Result<Vec<T>, RenderError> {
        if bytes == 0 {
            return Ok(Vec::new());
        }
        self.staging.reserve(gpu, bytes);
        let mut encoder = gpu.encoder("readback.buffer");
        encoder.copy_buffer_to_buffer(source, offset, &self.staging.buffer, 0, bytes);
        gpu.queue.submit([encoder.finish()]);
        self.mapped(gpu, bytes, |data| bytemuck::pod_collect_to_vec(data))
    }

    /// One layer of a texture whose texels have the size of `T`, row by row from the top.
    pub fn texture<T: Pod>(&mut self, gpu: &Gpu, source: &wgpu::Texture, layer: u32) -> Result<Vec<T>, RenderError> {
        let (width, height) = (source.width(), source.height());
        let row = width as usize * size_of::<T>();
        let padded = row.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize);
        let bytes = padded as u64 * u64::from(height);
        self.staging.reserve(gpu, bytes);
        let mut encoder = gpu.encoder("readback.texture");
        encoder.copy_texture_to_buffer(
            wgpu::TexelCopyTextureInfo {
                texture: source,
                mip_level: 0,
                origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
                aspect: wgpu::TextureAspect::All,
            },
            wgpu::TexelCopyBufferInfo {
                buffer: &self.staging.buffer,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(padded as u32),
                    rows_per_image: Some(height),
                },
            },
            wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        );
        gpu.queue.submit([encoder.finish()]);
        self.mapped(gpu, bytes, |data| {
            let mut out = Vec::with_capacity(width as usize * height as usize);
            for line in data.chunks_exact(padded) {
                out.extend(bytemuck::pod_collect_to_vec::<u8, T>(&line[..row]));
            }
            out
        })
    }

    fn mapped<R>(&self, gpu: &Gpu, bytes: u64, read: impl FnOnce(&[u8]) -> R) -> Result<R, RenderError> {
        let slice = self.staging.buffer.slice(..bytes);
        let (sender, receiver) = std::sync::mpsc::channel();
        slice.map_async(wgpu::MapMode::Read, move |result| {
            // The receiver lives until the answer is there; a failed send has nobody to tell.
            let _ = sender.send(result);
        });
        gpu.wait()?;
        let failed = |message: String| RenderError::Gpu(format!("reading back failed: {message}"));
        match receiver.try_recv() {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return Err(failed(error.to_string())),
            Err(_) => return Err(failed("the device gave no answer".into())),
        }
        let view = slice.get_mapped_range().map_err(|e| failed(e.to_string()))?;
        let out = read(&view);
        drop(view);
        self.staging.buffer.unmap();
        gpu.count_down(bytes);
        Ok(out)
    }
}
