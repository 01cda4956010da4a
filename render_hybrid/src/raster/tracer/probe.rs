//! A scene in the tracer's heaps for kernels that are not among the files: tests of the tracer's functions one by one.

use catoptra_engine::RenderScene;

use super::{
    photons::{GpuPhotons, PhotonInputs, ReadPhotons},
    scene::TracerScene,
    shaders::{HeapKind, Variant, text_of},
};
use crate::{
    accel::{Accel, flat::Word},
    error::RenderError,
    raster::{
        device::Gpu,
        layouts::{FrameData, IndirectHead, VplData},
        pipeline::{Slot, uniform},
        readback::Readback,
        scene_buffers::linear_of_srgb,
        shader::VPL_CHUNK,
        testing::LitBy,
    },
    twin::penumbra::level_count,
};

/// Bindings of group 1 from 2 on: moments of single views and of six, VPLs' maps. Where the pixels' kernel has them.
pub(crate) const TEXTURE_SLOTS: [Slot; 3] = [Slot::TextureArray, Slot::TextureArray, Slot::Texture];

/// The scene, and what kernels for it are compiled for.
pub(crate) struct HeldScene {
    scene: TracerScene,
    variant: Variant,
    frame: wgpu::Buffer,
    table: wgpu::Buffer,
    /// [`TEXTURE_SLOTS`].
    textures: [wgpu::TextureView; 3],
}

impl HeldScene {
    /// * `accel`: follows `scene`
    pub fn new(gpu: &Gpu, scene: &RenderScene, accel: &Accel, lit: &LitBy) -> Result<Self, RenderError> {
        gpu.scoped(|| {
            let mut held = TracerScene::new(gpu, HeapKind::Storage, false);
            let too_large = |missing: String| RenderError::Unavailable { choice: "--tracer gpu".into(), missing };
            held.update(gpu, scene, accel, &lit.maps.plan, false).map_err(too_large)?;
            held.update_vpls(gpu, lit.vpls).map_err(too_large)?;
            let frame = uniform(gpu, "probe.frame", size_of::<FrameData>() as u64);
            let table = uniform(gpu, "probe.srgb_table", 1024);
            gpu.upload(&frame, 0, bytemuck::bytes_of(&FrameData::new(scene, 1, 1)));
            gpu.upload(&table, 0, bytemuck::cast_slice(&linear_of_srgb()));
            held.bind(gpu, &frame, &table, None);
            let usual = Variant::new(HeapKind::Storage);
            let levels = if held.levels <= usual.levels { usual.levels } else { Variant::ALL_LEVELS };
            let LitBy { traced_shadows, traced_vpls, .. } = *lit;
            let variant = Variant { kd: accel.flat_is_kd(), levels, traced_shadows, traced_vpls, ..usual };
            Ok(Self { scene: held, variant, frame, table, textures: textures(gpu, lit) })
        })
    }

    /// `kernel` behind everything that the tracer of pixels imports. Its groups from 1 on are its own, but for
    /// [`TEXTURE_SLOTS`]; the frame's choices, `trace`, are a variable that it may set.
    pub fn text(&self, kernel: &str) -> String {
        let imports = "#import tracer/scene\n#import tracer/hits\n#import tracer/pixels\nfn count_ray(kind: u32) {}\n";
        let text = text_of("probe", &format!("{imports}{kernel}"), &self.variant);
        text.replace("@group(1) @binding(0) var<uniform> trace:", "var<private> trace:")
    }

    /// Layout and resources of group 0.
    ///
    /// # Panics
    /// Never: [`Self::new`] made them.
    pub fn group(&self) -> (&wgpu::BindGroupLayout, &wgpu::BindGroup) {
        (&self.scene.layout, self.scene.group.as_ref().expect("made with the scene"))
    }

    /// Resources of [`TEXTURE_SLOTS`].
    pub fn textures(&self) -> impl Iterator<Item = wgpu::BindingResource<'_>> {
        self.textures.iter().map(wgpu::BindingResource::TextureView)
    }

    /// VPLs by the photon kernels; words of the indirect pass's chunks, and how many words each has.
    /// * `edit`: what becomes of a kernel's text
    pub fn photons(
        &mut self,
        gpu: &Gpu,
        inputs: &PhotonInputs,
        geometry_term_max: f32,
        edit: &dyn Fn(&str, String) -> String,
    ) -> Result<(ReadPhotons, Vec<Word>, usize), RenderError> {
        gpu.scoped(|| {
            let too_large = |missing: String| RenderError::Unavailable { choice: "--tracer gpu".into(), missing };
            let bytes = size_of::<IndirectHead>() + VPL_CHUNK as usize * size_of::<VplData>();
            let stride = bytes.next_multiple_of(256) as u64;
            let mut photons = GpuPhotons::new(gpu, &self.scene, self.variant);
            photons.replace_kernels(gpu, &self.scene, self.variant, edit);
            photons.prepare(gpu, inputs, &mut self.scene, geometry_term_max, stride).map_err(too_large)?;
            self.scene.bind(gpu, &self.frame, &self.table, None);
            let size = stride * u64::from(photons.most().div_ceil(VPL_CHUNK)).max(1);
            let chunks = gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("probe.chunks"),
                size,
                usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            });
            let mut encoder = gpu.encoder("probe.photons");
            photons.record(&mut encoder, self.group().1, self.variant, (&chunks, stride), true);
            gpu.queue.submit([encoder.finish()]);
            let mut readback = Readback::new(gpu);
            let list: Vec<u32> = readback.buffer(gpu, self.scene.vpl_buffer(), 0, photons.read_bytes())?;
            let words: Vec<u32> = readback.buffer(gpu, &chunks, 0, size)?;
            let words = words.as_chunks::<4>().0.to_vec();
            Ok((ReadPhotons::of(&list), words, stride as usize / size_of::<Word>()))
        })
    }
}

fn textures(gpu: &Gpu, lit: &LitBy) -> [wgpu::TextureView; 3] {
    let texture = |width: u32, height: u32, levels: u32, layers: &[&[u8]], format, bytes: u32| {
        let size = wgpu::Extent3d { width, height, depth_or_array_layers: layers.len().max(1) as u32 };
        let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("probe.maps"),
            size,
            mip_level_count: levels,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        });
        for (layer, mut data) in (0..).zip(layers.iter().copied()) {
            // All levels, one after the other; where there is but one, the others are not read.
            for level in (0..levels).take_while(|l| *l == 0 || !data.is_empty()) {
                let (width, height) = (width >> level, height >> level);
                let (own, rest) = data.split_at((width * height * bytes) as usize);
                let mut place = texture.as_image_copy();
                (place.origin.z, place.mip_level) = (layer, level);
                let rows =
                    wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(width * bytes), rows_per_image: None };
                gpu.queue.write_texture(place, own, rows, wgpu::Extent3d { width, height, depth_or_array_layers: 1 });
                data = rest;
            }
        }
        texture
    };
    let plan = &lit.maps.plan;
    let moments = |six: bool| {
        let of_light = plan.lights.iter().filter(|l| (l.count == 6) == six).flat_map(|l| l.first..l.first + l.count);
        let views: Vec<u32> = of_light.filter(|v| (*v as usize) < lit.maps.maps.len()).collect();
        let side = views.first().map_or(1, |v| plan.views[*v as usize].size);
        let of_view = |v: &u32| [lit.maps.maps[*v as usize].as_slice(), &lit.maps.coarser[*v as usize]].concat();
        let layers: Vec<Vec<[f32; 4]>> = views.iter().map(of_view).collect();
        let layers: Vec<&[u8]> = layers.iter().map(|l| bytemuck::cast_slice(l)).collect();
        texture(side, side, level_count(side), &layers, wgpu::TextureFormat::Rgba32Float, 16).create_view(
            &wgpu::TextureViewDescriptor { dimension: Some(wgpu::TextureViewDimension::D2Array), ..Default::default() },
        )
    };
    // A row a map.
    let (width, height) = ((lit.vpl_maps.size * lit.vpl_maps.size).max(1), lit.vpls.len().max(1) as u32);
    let texels: &[u8] = bytemuck::cast_slice(&lit.vpl_maps.texels);
    let rows: &[&[u8]] = if texels.is_empty() { &[] } else { &[texels] };
    let maps = texture(width, height, 1, rows, wgpu::TextureFormat::R32Float, 4);
    [moments(false), moments(true), maps.create_view(&Default::default())]
}
