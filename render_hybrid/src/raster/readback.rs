//! From the GPU to the CPU, through staging buffers that are kept.

use bytemuck::Pod;

use super::device::{Gpu, GrowBuffer};
use crate::error::RenderError;

/// Copies that a submission brings along, read when that one is done: nothing behind it is waited for.
pub(crate) struct Mailbox {
    staging: GrowBuffer,
    used: u64,
    after: Option<wgpu::SubmissionIndex>,
}

impl Mailbox {
    pub fn new(gpu: &Gpu, label: &'static str) -> Self {
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        Self { staging: GrowBuffer::new(gpu, label, usage, 256), used: 0, after: None }
    }

    /// Empties it and makes room for `bytes`.
    pub fn open(&mut self, gpu: &Gpu, bytes: u64) {
        self.staging.reserve(gpu, bytes);
        self.used = 0;
        self.after = None;
    }

    /// Records the copy of `bytes` of a buffer from `offset` on; both multiples of 4. Returns where they will lie.
    pub fn buffer(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        source: &wgpu::Buffer,
        offset: u64,
        bytes: u64,
    ) -> std::ops::Range<usize> {
        let at = self.used;
        if bytes > 0 {
            encoder.copy_buffer_to_buffer(source, offset, &self.staging.buffer, at, bytes);
        }
        self.used += bytes;
        at as usize..self.used as usize
    }

    /// Bytes that a layer of a texture takes, rows padded.
    pub fn texture_bytes(source: &wgpu::Texture) -> u64 {
        padded_row(source) as u64 * u64::from(source.height())
    }

    /// Records the copy of a layer of a texture.
    pub fn texture(&mut self, encoder: &mut wgpu::CommandEncoder, source: &wgpu::Texture, layer: u32) {
        let (width, height) = (source.width(), source.height());
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
                    offset: self.used,
                    bytes_per_row: Some(padded_row(source) as u32),
                    rows_per_image: Some(height),
                },
            },
            wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        );
        self.used += Self::texture_bytes(source);
    }

    /// The copies were submitted.
    pub fn sent(&mut self, submission: &wgpu::SubmissionIndex) {
        self.after = Some(submission.clone());
    }

    /// True where something was sent and not read.
    pub fn is_full(&self) -> bool {
        self.after.is_some()
    }

    /// Waits for the submission.
    pub fn wait(&self, gpu: &Gpu) -> Result<(), RenderError> {
        self.after.as_ref().map_or(Ok(()), |after| gpu.wait_for(after))
    }

    /// Waits for the submission and reads what it brought.
    pub fn read<R>(&mut self, gpu: &Gpu, read: impl FnOnce(&[u8]) -> R) -> Result<R, RenderError> {
        let failed = |message: String| RenderError::Gpu(format!("reading back failed: {message}"));
        let Some(after) = self.after.take() else { return Err(failed("nothing was sent".into())) };
        let slice = self.staging.buffer.slice(..self.used);
        let (sender, receiver) = std::sync::mpsc::channel();
        slice.map_async(wgpu::MapMode::Read, move |result| {
            // The receiver lives until the answer is there; a failed send has nobody to tell.
            let _ = sender.send(result);
        });
        gpu.wait_for(&after)?;
        match receiver.try_recv() {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return Err(failed(error.to_string())),
            Err(_) => return Err(failed("the device gave no answer".into())),
        }
        let view = slice.get_mapped_range().map_err(|e| failed(e.to_string()))?;
        let out = read(&view);
        drop(view);
        self.staging.buffer.unmap();
        gpu.count_down(self.used);
        Ok(out)
    }
}

fn padded_row(texture: &wgpu::Texture) -> usize {
    let texel = texture.format().block_copy_size(None).unwrap_or(16) as usize;
    (texture.width() as usize * texel).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize)
}

/// Rows of a texture's copy, without what pads them.
pub(crate) fn rows<'a>(data: &'a [u8], source: &wgpu::Texture) -> impl Iterator<Item = &'a [u8]> + use<'a> {
    let row = source.width() as usize * source.format().block_copy_size(None).unwrap_or(16) as usize;
    data.chunks_exact(padded_row(source)).map(move |line| &line[..row])
}

/// Copies buffers and textures into vectors, at once: waits for all that was submitted.
pub(crate) struct Readback {
    mailbox: Mailbox,
}

impl Readback {
    pub fn new(gpu: &Gpu) -> Self {
        Self { mailbox: Mailbox::new(gpu, "readback.staging") }
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
        self.mailbox.open(gpu, bytes);
        let mut encoder = gpu.encoder("readback.buffer");
        self.mailbox.buffer(&mut encoder, source, offset, bytes);
        self.mailbox.sent(&gpu.queue.submit([encoder.finish()]));
        self.mailbox.read(gpu, bytemuck::pod_collect_to_vec)
    }

    /// One layer of a texture whose texels have the size of `T`, row by row from the top.
    pub fn texture<T: Pod>(&mut self, gpu: &Gpu, source: &wgpu::Texture, layer: u32) -> Result<Vec<T>, RenderError> {
        self.mailbox.open(gpu, Mailbox::texture_bytes(source));
        let mut encoder = gpu.encoder("readback.texture");
        self.mailbox.texture(&mut encoder, source, layer);
        self.mailbox.sent(&gpu.queue.submit([encoder.finish()]));
        self.mailbox.read(gpu, |data| {
            let mut out = Vec::with_capacity(source.width() as usize * source.height() as usize);
            for line in rows(data, source) {
                out.extend(bytemuck::pod_collect_to_vec::<u8, T>(line));
            }
            out
        })
    }
}
