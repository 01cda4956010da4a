//! Words of 16 bytes on the GPU: in a storage buffer, or in a texture of [`HEAP_WIDTH`] words a row.

use super::shaders::{HEAP_WIDTH, HeapKind};
use crate::{accel::flat::Word, raster::device::Gpu};

const WORD_BYTES: u64 = size_of::<Word>() as u64;

enum Place {
    Buffer(wgpu::Buffer),
    Texture(wgpu::Texture, wgpu::TextureView),
}

/// A growing array of words; what it held is gone when it grows.
pub(crate) struct Heap {
    name: &'static str,
    kind: HeapKind,
    place: Place,
    capacity: u64,
    /// Words in use, for heaps that are filled from the front.
    pub used: u64,
}

/// Most words of one heap on this device.
fn limit(gpu: &Gpu, kind: HeapKind) -> u64 {
    let limits = gpu.device.limits();
    match kind {
        HeapKind::Storage => limits.max_storage_buffer_binding_size.min(limits.max_buffer_size) / WORD_BYTES,
        HeapKind::Texture => u64::from(HEAP_WIDTH) * u64::from(limits.max_texture_dimension_2d),
    }
}

impl Heap {
    pub fn new(gpu: &Gpu, name: &'static str, kind: HeapKind) -> Self {
        Self { name, kind, place: Self::make(gpu, name, kind, 16), capacity: 16, used: 0 }
    }

    fn make(gpu: &Gpu, name: &str, kind: HeapKind, words: u64) -> Place {
        let label = format!("tracer.{name}");
        match kind {
            HeapKind::Storage => Place::Buffer(gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(&label),
                size: words * WORD_BYTES,
                usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            })),
            HeapKind::Texture => {
                let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
                    label: Some(&label),
                    size: wgpu::Extent3d {
                        width: HEAP_WIDTH,
                        height: words.div_ceil(u64::from(HEAP_WIDTH)) as u32,
                        depth_or_array_layers: 1,
                    },
                    mip_level_count: 1,
                    sample_count: 1,
                    dimension: wgpu::TextureDimension::D2,
                    // Whole numbers: bits of references survive, floats are read by bitcast.
                    format: wgpu::TextureFormat::Rgba32Uint,
                    usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
                    view_formats: &[],
                });
                let view = texture.create_view(&Default::default());
                Place::Texture(texture, view)
            }
        }
    }

    pub fn resource(&self) -> wgpu::BindingResource<'_> {
        match &self.place {
            Place::Buffer(buffer) => buffer.as_entire_binding(),
            Place::Texture(_, view) => wgpu::BindingResource::TextureView(view),
        }
    }

    /// The buffer; `None` where the words lie in a texture.
    pub fn buffer(&self) -> Option<&wgpu::Buffer> {
        match &self.place {
            Place::Buffer(buffer) => Some(buffer),
            Place::Texture(..) => None,
        }
    }

    pub fn fits(&self, words: u64) -> bool {
        words <= self.capacity
    }

    /// Makes room for `words`; true where the heap was replaced.
    ///
    /// # Errors
    /// What does not fit, with its figures.
    pub fn reserve(&mut self, gpu: &Gpu, words: u64) -> Result<bool, String> {
        if self.fits(words) {
            return Ok(false);
        }
        let most = limit(gpu, self.kind);
        if words > most {
            return Err(format!(
                "its {} heap takes {} bytes, but this adapter binds at most {}",
                self.name,
                words * WORD_BYTES,
                most * WORD_BYTES
            ));
        }
        let capacity = (words + words / 2).min(most);
        self.place = Self::make(gpu, self.name, self.kind, capacity);
        self.capacity = capacity;
        Ok(true)
    }

    /// Writes words from word `at` on; the bytes are counted.
    pub fn write(&self, gpu: &Gpu, at: u64, words: &[Word]) {
        match &self.place {
            Place::Buffer(buffer) => gpu.upload(buffer, at * WORD_BYTES, bytemuck::cast_slice(words)),
            Place::Texture(texture, _) => {
                let (mut at, mut rest) = (at, words);
                while !rest.is_empty() {
                    let x = at % u64::from(HEAP_WIDTH);
                    // Whole rows together, else what is left of this one.
                    let rows = if x == 0 { (rest.len() as u64 / u64::from(HEAP_WIDTH)).max(1) } else { 1 };
                    let width = (u64::from(HEAP_WIDTH) - x).min(rest.len() as u64);
                    let (part, later) = rest.split_at((rows * width) as usize);
                    write_rows(gpu, texture, [x as u32, (at / u64::from(HEAP_WIDTH)) as u32], width as u32, part);
                    at += part.len() as u64;
                    rest = later;
                }
            }
        }
    }
}

fn write_rows(gpu: &Gpu, texture: &wgpu::Texture, [x, y]: [u32; 2], width: u32, words: &[Word]) {
    gpu.queue.write_texture(
        wgpu::TexelCopyTextureInfo {
            texture,
            mip_level: 0,
            origin: wgpu::Origin3d { x, y, z: 0 },
            aspect: wgpu::TextureAspect::All,
        },
        bytemuck::cast_slice(words),
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(width * WORD_BYTES as u32), rows_per_image: None },
        wgpu::Extent3d { width, height: words.len() as u32 / width, depth_or_array_layers: 1 },
    );
    gpu.count_up(words.len() as u64 * WORD_BYTES);
}

/// The CPU's copy of a part of a heap: only what differs is sent.
#[derive(Default)]
pub(crate) struct Mirror {
    words: Vec<Word>,
}

impl Mirror {
    /// Forgets what the GPU holds.
    pub fn clear(&mut self) {
        self.words.clear();
    }

    /// Makes the heap's words from `at` on equal `wanted`.
    pub fn update(&mut self, gpu: &Gpu, heap: &Heap, at: u64, wanted: Vec<Word>) {
        if wanted.len() != self.words.len() {
            heap.write(gpu, at, &wanted);
            self.words = wanted;
            return;
        }
        let mut i = 0;
        while i < wanted.len() {
            if wanted[i] == self.words[i] {
                i += 1;
                continue;
            }
            // A run ends at four equal words: a call costs more than they do.
            let (first, mut end) = (i, i + 1);
            while i < wanted.len() && i < end + 4 {
                if wanted[i] != self.words[i] {
                    end = i + 1;
                }
                i += 1;
            }
            heap.write(gpu, at + first as u64, &wanted[first..end]);
        }
        self.words = wanted;
    }

    /// [`Self::update`] of a few words alone.
    pub fn patch(&mut self, gpu: &Gpu, heap: &Heap, at: u64, offset: usize, words: &[Word]) {
        if self.words[offset..offset + words.len()] != *words {
            self.words[offset..offset + words.len()].copy_from_slice(words);
            heap.write(gpu, at + offset as u64, words);
        }
    }
}
