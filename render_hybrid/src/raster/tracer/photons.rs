//! VPLs on the GPU: light paths through the tracer's own trees, packed into the lists of the indirect pass and of the tracer's
//! shading. Starts lie in the frames of their sources, so that a light that moves sends its frame alone; sample points of the
//! paths are sent once.

use std::collections::HashMap;

use super::{
    compute_pass,
    heap::{Heap, Mirror},
    layout::{PackUniform, PhotonUniform},
    module,
    scene::TracerScene,
    shaders::{HeapKind, TRACE_GROUP, Variant},
};
use crate::{
    accel::flat::Word,
    raster::{
        device::{Gpu, GrowBuffer},
        layouts::{IndirectHead, VplData},
        pipeline::{Slot, compute_pipeline, group, group_layout, linear_dispatch, pipeline_layout, uniform},
        readback::Mailbox,
        shader::VPL_CHUNK,
    },
    trace::{emission::SourceFrame, photons::LightPaths},
    twin::vpl::Vpl,
};

/// Words of a path's start.
pub(crate) const PATH_WORDS: u32 = 6;
/// Words of a source's frame.
pub(crate) const SOURCE_WORDS: u32 = 4;
/// Words of a VPL.
pub(crate) const SLOT_WORDS: u32 = 3;
/// Words of the head of an indirect pass's chunk.
pub(crate) const HEAD_WORDS: u32 = (size_of::<IndirectHead>() / size_of::<Word>()) as u32;
const WORD_BYTES: u64 = size_of::<Word>() as u64;

/// What the frame's VPLs are made of and for.
#[derive(Clone, Copy)]
pub(crate) struct PhotonInputs<'a> {
    pub paths: &'a LightPaths,
    /// Side of the blocks of pixels over which they are interleaved; 1: none.
    pub interleave: u32,
    /// Nothing that they depend on has changed since the last frame.
    pub same: bool,
}

/// Traces and packs.
pub(crate) struct GpuPhotons {
    trace: HashMap<Variant, wgpu::ComputePipeline>,
    trace_layout: wgpu::BindGroupLayout,
    pack: wgpu::ComputePipeline,
    pack_layout: wgpu::BindGroupLayout,
    inputs: Heap,
    sources: Mirror,
    starts: Mirror,
    samples: Mirror,
    trace_uniform: wgpu::Buffer,
    pack_uniform: wgpu::Buffer,
    written: (PhotonUniform, PackUniform),
    slots: GrowBuffer,
    packed: GrowBuffer,
    groups: Option<[wgpu::BindGroup; 2]>,
    /// Slots of all paths, paths, sources.
    count: [u32; 3],
    /// The lists hold what the last [`Self::record`] made, and nobody else wrote into them.
    pub valid: bool,
    /// Nothing is left to do in this frame.
    kept: bool,
}

/// Photon kernels differ in the trees alone.
fn variant_of(variant: Variant) -> Variant {
    let Variant { kd, rayquery, levels, .. } = variant;
    Variant { kd, rayquery, levels, ..Variant::new(HeapKind::Storage) }
}

impl GpuPhotons {
    pub fn new(gpu: &Gpu, scene: &TracerScene, variant: Variant) -> Self {
        let layout = |label: &str, slots: &[Slot]| group_layout(gpu, label, wgpu::ShaderStages::COMPUTE, slots);
        let (read, write) = (Slot::Storage(true), Slot::Storage(false));
        let trace_layout = layout("photons.trace", &[Slot::Uniform, read, write]);
        let pack_layout = layout("photons.pack", &[Slot::Uniform, read, write, write]);
        let pack_pipeline_layout = pipeline_layout(gpu, "photons.pack", None, Some(&pack_layout));
        let pack_module = module(gpu, "photons_pack", &variant_of(variant));
        use wgpu::BufferUsages as U;
        let mut photons = Self {
            trace: HashMap::new(),
            trace_layout,
            pack: compute_pipeline(gpu, &pack_module, &pack_pipeline_layout, "pack_photons"),
            pack_layout,
            inputs: Heap::new(gpu, "light path", HeapKind::Storage),
            sources: Mirror::default(),
            starts: Mirror::default(),
            samples: Mirror::default(),
            trace_uniform: uniform(gpu, "photons.uniform", size_of::<PhotonUniform>() as u64),
            pack_uniform: uniform(gpu, "photons.pack_uniform", size_of::<PackUniform>() as u64),
            written: Default::default(),
            slots: GrowBuffer::new(gpu, "photons.slots", U::STORAGE, 256),
            packed: GrowBuffer::new(gpu, "photons.packed", U::STORAGE | U::COPY_SRC, 256),
            groups: None,
            count: [0; 3],
            valid: false,
            kept: false,
        };
        photons.compile(gpu, scene, variant);
        photons
    }

    /// Makes the kernel for the trees of `variant`, where it is not there.
    pub fn compile(&mut self, gpu: &Gpu, scene: &TracerScene, variant: Variant) {
        let variant = variant_of(variant);
        if !self.trace.contains_key(&variant) {
            let layout = pipeline_layout(gpu, "photons.trace", Some(&scene.layout), Some(&self.trace_layout));
            let module = module(gpu, "photons", &variant);
            self.trace.insert(variant, compute_pipeline(gpu, &module, &layout, "trace_photons"));
        }
    }

    /// For tests: kernels of edited texts in place of its own.
    /// * `edit`: a kernel's name and text to another text
    pub fn replace_kernels(
        &mut self,
        gpu: &Gpu,
        scene: &TracerScene,
        variant: Variant,
        edit: &dyn Fn(&str, String) -> String,
    ) {
        let variant = variant_of(variant);
        let pipeline = |kernel: &str, entry: &str, layouts: [Option<&wgpu::BindGroupLayout>; 2]| {
            let text = edit(kernel, super::shaders::text(kernel, &variant));
            let source = wgpu::ShaderSource::Wgsl(text.into());
            let label = Some("photons.edited");
            let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor { label, source });
            compute_pipeline(gpu, &module, &pipeline_layout(gpu, kernel, layouts[0], layouts[1]), entry)
        };
        let trace = pipeline("photons", "trace_photons", [Some(&scene.layout), Some(&self.trace_layout)]);
        self.trace.insert(variant, trace);
        self.pack = pipeline("photons_pack", "pack_photons", [None, Some(&self.pack_layout)]);
    }

    /// Sends what changed and makes room for as many VPLs as there can be. True where the scene's heap of VPLs was replaced.
    /// * `stride`: bytes from one chunk of the indirect pass to the next
    ///
    /// # Errors
    /// What is beyond the adapter, with figures.
    pub fn prepare(
        &mut self,
        gpu: &Gpu,
        inputs: &PhotonInputs,
        scene: &mut TracerScene,
        geometry_term_max: f32,
        stride: u64,
    ) -> Result<bool, String> {
        let paths = inputs.paths;
        let sources: Vec<Word> = paths.frames.iter().flat_map(words_of_source).collect();
        let words = words_of_paths(paths);
        let samples: Vec<Word> = paths.samples.iter().map(|s| [s[0].to_bits(), s[1].to_bits(), 0, 0]).collect();
        let slots = (paths.starts.len() as u32) * paths.slots_a_path;
        let count = [slots, paths.starts.len() as u32, paths.frames.len() as u32];
        // In the heap: sources, starts, sample points.
        let first_start = sources.len() as u64;
        let at = first_start + words.len() as u64;
        let mut replaced = self.inputs.reserve(gpu, at + samples.len() as u64)?;
        if replaced || count[1..] != self.count[1..] {
            for mirror in [&mut self.sources, &mut self.starts, &mut self.samples] {
                mirror.clear();
            }
        }
        self.sources.update(gpu, &self.inputs, 0, sources);
        self.starts.update(gpu, &self.inputs, first_start, words);
        self.samples.update(gpu, &self.inputs, at, samples);
        let chunks = slots.div_ceil(VPL_CHUNK);
        let vpl_bytes = u64::from(slots * SLOT_WORDS) * WORD_BYTES;
        replaced |= self.slots.reserve(gpu, vpl_bytes);
        replaced |= self.packed.reserve(gpu, stride * u64::from(chunks));
        let vpls_replaced = scene.reserve_vpls(gpu, slots)?;
        let trace = PhotonUniform {
            paths: count[1],
            bounces: paths.bounces,
            slots_a_path: paths.slots_a_path,
            samples: at as u32,
            starts: first_start as u32,
            ..PhotonUniform::default()
        };
        let pack = PackUniform {
            slots,
            slots_a_path: paths.slots_a_path,
            interleave: inputs.interleave,
            stride: (stride / WORD_BYTES) as u32,
            // Infinity is no number for a shader.
            geometry_term_max: geometry_term_max.min(f32::MAX),
            chunks,
            ..PackUniform::default()
        };
        let same = !replaced && !vpls_replaced && self.written == (trace, pack);
        if self.written.0 != trace {
            gpu.upload(&self.trace_uniform, 0, bytemuck::bytes_of(&trace));
        }
        if self.written.1 != pack {
            gpu.upload(&self.pack_uniform, 0, bytemuck::bytes_of(&pack));
        }
        self.written = (trace, pack);
        self.count = count;
        self.kept = self.valid && inputs.same && same;
        if replaced || vpls_replaced || self.groups.is_none() {
            let trace =
                [self.trace_uniform.as_entire_binding(), self.inputs.resource(), self.slots.buffer.as_entire_binding()];
            let pack = [
                self.pack_uniform.as_entire_binding(),
                self.slots.buffer.as_entire_binding(),
                scene.vpl_list(),
                self.packed.buffer.as_entire_binding(),
            ];
            self.groups = Some([
                group(gpu, "photons.trace", &self.trace_layout, &trace),
                group(gpu, "photons.pack", &self.pack_layout, &pack),
            ]);
        }
        Ok(vpls_replaced)
    }

    /// Most VPLs of the frame.
    pub fn most(&self) -> u32 {
        self.count[0]
    }

    /// Fills the tracer's list and the indirect pass's `chunks`, where they do not hold these VPLs already.
    pub fn record(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        scene: &wgpu::BindGroup,
        variant: Variant,
        (chunks, stride): (&wgpu::Buffer, u64),
        emptied: bool,
    ) {
        self.kept &= !emptied;
        if self.kept {
            return;
        }
        let Some([trace, pack]) = &self.groups else { unreachable!("prepare comes first") };
        if self.count[1] > 0 {
            let mut pass = compute_pass(encoder, "photons");
            pass.set_pipeline(&self.trace[&variant_of(variant)]);
            pass.set_bind_group(0, scene, &[]);
            pass.set_bind_group(1, trace, &[]);
            let (x, y) = linear_dispatch(u64::from(self.count[1].div_ceil(TRACE_GROUP)));
            pass.dispatch_workgroups(x, y, 1);
        }
        {
            let mut pass = compute_pass(encoder, "photons.pack");
            pass.set_pipeline(&self.pack);
            pass.set_bind_group(1, pack, &[]);
            pass.dispatch_workgroups(1, 1, 1);
        }
        for chunk in 0..self.count[0].div_ceil(VPL_CHUNK) {
            let vpls = u64::from((self.count[0] - chunk * VPL_CHUNK).min(VPL_CHUNK));
            let bytes = size_of::<IndirectHead>() as u64 + vpls * size_of::<VplData>() as u64;
            let at = stride * u64::from(chunk);
            encoder.copy_buffer_to_buffer(&self.packed.buffer, at, chunks, at, bytes);
        }
        self.valid = true;
    }

    /// Records that the list comes back.
    pub fn record_read(&self, encoder: &mut wgpu::CommandEncoder, mailbox: &mut Mailbox, scene: &TracerScene) {
        mailbox.buffer(encoder, scene.vpl_buffer(), 0, u64::from(self.count[0] * SLOT_WORDS + 1) * WORD_BYTES);
    }

    /// Bytes of [`Self::record_read`].
    pub fn read_bytes(&self) -> u64 {
        u64::from(self.count[0] * SLOT_WORDS + 1) * WORD_BYTES
    }

    /// Nothing was traced in this frame: the VPLs are those of the frame before.
    pub fn kept(&self) -> bool {
        self.kept
    }
}

/// What [`GpuPhotons::record_read`] brought.
#[derive(Clone, Debug, Default)]
pub(crate) struct ReadPhotons {
    pub vpls: Vec<Vpl>,
    pub rays: u64,
    /// Paths whose walk met its cap: 0.
    pub capped: u64,
}

impl ReadPhotons {
    pub fn of(words: &[u32]) -> Self {
        let Some(info) = words.len().checked_sub(4) else { return Self::default() };
        let (list, info) = words.split_at(info);
        let float = |w: &[u32]| glam::Vec3::new(f32::from_bits(w[0]), f32::from_bits(w[1]), f32::from_bits(w[2]));
        let vpls = list.chunks_exact(12).take(info[2] as usize).map(|w| Vpl {
            position_world: float(w),
            normal_world: float(&w[4..]),
            flux: float(&w[8..]),
            error: f32::from_bits(w[3]),
        });
        Self { vpls: vpls.collect(), rays: u64::from(info[0]), capped: u64::from(info[1]) }
    }
}

fn words_of_source(s: &SourceFrame) -> [Word; SOURCE_WORDS as usize] {
    let word = |v: glam::Vec3, w: f32| [v.x, v.y, v.z, w].map(f32::to_bits);
    let [x, y, z] = s.axes;
    [word(s.origin, s.scale), word(x, s.flux.x), word(y, s.flux.y), word(z, s.flux.z)]
}

fn words_of_paths(paths: &LightPaths) -> Vec<Word> {
    let word = |v: glam::Vec3, w: u32| [v.x.to_bits(), v.y.to_bits(), v.z.to_bits(), w];
    let mut out = Vec::with_capacity(paths.starts.len() * PATH_WORDS as usize);
    for s in &paths.starts {
        let vpl = s.vpl.unwrap_or_default();
        out.extend([
            word(s.ray.origin, s.ray.t_min.to_bits()),
            word(s.ray.direction, s.index),
            word(s.flux, u32::from(s.vpl.is_some())),
            word(vpl.position_world, vpl.error.to_bits()),
            word(vpl.normal_world, s.source),
            word(vpl.flux, 0),
        ]);
    }
    out
}
