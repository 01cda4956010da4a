//! Group 0: the scene on the GPU. Meshes and textures are sent once, instances when they moved, the rest when it changed.

use bytemuck::Pod;
use catoptra_engine::{Aabb, Mesh, RenderScene, Texture, glam::Vec3, math};
use std::{collections::HashMap, sync::Arc};

use super::{
    device::{Gpu, GrowBuffer},
    layouts::{self, FrameData, InstanceData, LightData, MaterialData},
};
use crate::{
    error::RenderError,
    twin::shadow::{ShadowPlan, ShadowView},
};

/// Where a mesh lies in the heaps.
#[derive(Clone, Copy, Default)]
struct MeshRange {
    first_index: u32,
    first_vertex: u32,
}

/// One instance's draw call.
#[derive(Clone, Copy)]
pub(crate) struct Draw {
    /// Three vertices a triangle.
    pub vertices: u32,
    /// Instance number.
    pub instance: u32,
    /// Its material lets light through.
    pub transmissive: bool,
    /// Has holes.
    pub cutout: bool,
    /// For leaving out what a shadow view does not see.
    pub bounds_world: Aabb,
}

/// Flat arrays that are compared with what the GPU holds; only runs that differ are sent.
struct Mirrored<T> {
    copy: Vec<T>,
    buffer: GrowBuffer,
}

impl<T: Pod + PartialEq> Mirrored<T> {
    fn new(gpu: &Gpu, label: &'static str) -> Self {
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST;
        // Room for one entry: shaders may not bind an empty array.
        Self { copy: Vec::new(), buffer: GrowBuffer::new(gpu, label, usage, size_of::<T>() as u64) }
    }

    /// Makes the GPU's array equal `data`; true where the buffer was replaced.
    fn update(&mut self, gpu: &Gpu, data: Vec<T>) -> bool {
        let replaced = self.buffer.reserve(gpu, (data.len() * size_of::<T>()) as u64);
        if replaced || self.copy.len() != data.len() {
            gpu.upload(&self.buffer.buffer, 0, bytemuck::cast_slice(&data));
            self.copy = data;
            return replaced;
        }
        let changed = (0..data.len()).filter(|&i| data[i] != self.copy[i]).collect::<Vec<_>>();
        self.copy = data;
        self.send(gpu, &changed);
        false
    }

    /// Sends entries of the copy, ascending, neighbours together.
    fn send(&self, gpu: &Gpu, changed: &[usize]) {
        for run in changed.chunk_by(|a, b| a + 1 == *b) {
            let (first, end) = (run[0], run[run.len() - 1] + 1);
            let offset = (first * size_of::<T>()) as u64;
            gpu.upload(&self.buffer.buffer, offset, bytemuck::cast_slice(&self.copy[first..end]));
        }
    }
}

/// Arrays that many assets share, filled from the front.
struct Heap {
    buffer: GrowBuffer,
    used: u64,
}

/// Linear light of each sRGB byte, by the CPU's own function.
pub(crate) fn linear_of_srgb() -> [f32; 256] {
    std::array::from_fn(|i| math::linear_from_srgb(i as f32 / 255.0))
}

impl Heap {
    fn new(gpu: &Gpu, label: &'static str) -> Self {
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST;
        Self { buffer: GrowBuffer::new(gpu, label, usage, 256), used: 0 }
    }

    fn fits(&self, bytes: u64) -> bool {
        self.used + bytes <= self.buffer.buffer.size()
    }

    fn push(&mut self, gpu: &Gpu, bytes: &[u8]) {
        gpu.upload(&self.buffer.buffer, self.used, bytes);
        self.used += bytes.len() as u64;
    }
}

/// The scene as the shaders read it.
pub(crate) struct SceneBuffers {
    pub layout: wgpu::BindGroupLayout,
    group: Option<wgpu::BindGroup>,
    frame: wgpu::Buffer,
    frame_written: Option<FrameData>,
    srgb_table: wgpu::Buffer,
    positions: Heap,
    attributes: Heap,
    indices: Heap,
    texels: Heap,
    instances: Mirrored<InstanceData>,
    materials: Mirrored<MaterialData>,
    lights: Mirrored<LightData>,
    views: Mirrored<ShadowViewBytes>,
    /// The Arcs keep addresses from being used again while they stand for a place in the heaps.
    meshes: Vec<(Arc<Mesh>, MeshRange)>,
    textures: Vec<(Arc<Texture>, u32)>,
    /// Origin and revision of the scene that the buffers hold.
    last: Option<(Arc<()>, u64)>,
    pub draws: Vec<Draw>,
}

/// `ShadowView` as shaders read it, compared by its bits.
#[derive(Clone, Copy, PartialEq, Pod, bytemuck::Zeroable)]
#[repr(C)]
struct ShadowViewBytes([u32; 16]);

impl ShadowViewBytes {
    fn new(v: &ShadowView) -> Self {
        let four = |v: Vec3, w: u32| [v.x.to_bits(), v.y.to_bits(), v.z.to_bits(), w];
        let rows = [
            four(v.origin_world, v.far.to_bits()),
            four(v.right_scaled, v.perspective.to_bits()),
            four(v.up_scaled, v.size),
            four(v.forward, v.softness.to_bits()),
        ];
        Self(bytemuck::cast(rows))
    }
}

impl SceneBuffers {
    pub fn new(gpu: &Gpu) -> Self {
        use wgpu::{BufferBindingType::*, ShaderStages as S};
        let all = S::VERTEX | S::FRAGMENT | S::COMPUTE;
        let entry = |binding: u32, ty: wgpu::BufferBindingType| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: all,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
            count: None,
        };
        let mut entries = vec![entry(0, Uniform)];
        entries.extend((1..=8).map(|i| entry(i, Storage { read_only: true })));
        entries.push(entry(9, Uniform));
        let layout = gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("frame.layout"),
            entries: &entries,
        });
        let uniform = |label, size| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let srgb_table = uniform("frame.srgb_table", 1024);
        gpu.upload(&srgb_table, 0, bytemuck::cast_slice(&linear_of_srgb()));
        Self {
            layout,
            group: None,
            frame: uniform("frame.uniform", size_of::<FrameData>() as u64),
            frame_written: None,
            srgb_table,
            positions: Heap::new(gpu, "frame.positions"),
            attributes: Heap::new(gpu, "frame.attributes"),
            indices: Heap::new(gpu, "frame.indices"),
            texels: Heap::new(gpu, "frame.texels"),
            instances: Mirrored::new(gpu, "frame.instances"),
            materials: Mirrored::new(gpu, "frame.materials"),
            lights: Mirrored::new(gpu, "frame.lights"),
            views: Mirrored::new(gpu, "frame.views"),
            meshes: Vec::new(),
            textures: Vec::new(),
            last: None,
            draws: Vec::new(),
        }
    }

    /// The bind group of the last [`Self::update`].
    ///
    /// # Panics
    /// Before the first update: a mistake in the order of passes.
    pub fn group(&self) -> &wgpu::BindGroup {
        self.group.as_ref().expect("SceneBuffers::update comes first")
    }

    /// The frame's uniform and the table of sRGB values, for passes that bind them otherwise.
    pub fn uniforms(&self) -> [&wgpu::Buffer; 2] {
        [&self.frame, &self.srgb_table]
    }

    /// Brings the GPU's copy up to the scene.
    pub fn update(
        &mut self,
        gpu: &Gpu,
        scene: &RenderScene,
        plan: &ShadowPlan,
        width: u32,
        height: u32,
    ) -> Result<(), RenderError> {
        let only_moved = self.last.as_ref().is_some_and(|(origin, revision)| {
            Arc::ptr_eq(origin, &scene.origin)
                && scene.revision == revision + 1
                && scene.structure_revision <= *revision
                && self.draws.len() == scene.instances.len()
        });
        // Until the end of this update the buffers hold no scene that could be built upon.
        self.last = None;
        let mut replaced = false;
        if only_moved {
            let mut moved: Vec<_> = scene.moved.iter().map(|&i| i as usize).collect();
            moved.retain(|&i| self.update_instance(scene, i));
            self.instances.send(gpu, &moved);
        } else {
            replaced |= self.update_meshes(gpu, scene)?;
            replaced |= self.update_textures(gpu, scene)?;
            replaced |= self.update_instances(gpu, scene);
            let first_texel: Vec<u32> =
                self.places(&scene.textures, &self.textures).into_iter().map(|i| self.textures[i].1).collect();
            let materials = scene.materials.iter().map(|m| MaterialData::new(m, scene, &first_texel)).collect();
            replaced |= self.materials.update(gpu, materials);
        }
        let layers = first_layers(plan);
        let lights = scene
            .lights
            .iter()
            .enumerate()
            .map(|(i, l)| LightData::new(l, i, plan, layers.get(i).copied().unwrap_or(0)))
            .collect();
        replaced |= self.lights.update(gpu, lights);
        let views = plan.views.iter().map(ShadowViewBytes::new).collect();
        replaced |= self.views.update(gpu, views);
        let frame = FrameData::new(scene, width, height);
        if self.frame_written != Some(frame) {
            gpu.upload(&self.frame, 0, bytemuck::bytes_of(&frame));
            self.frame_written = Some(frame);
        }
        if replaced || self.group.is_none() {
            self.group = Some(self.bind(gpu));
        }
        self.last = Some((scene.origin.clone(), scene.revision));
        Ok(())
    }

    fn bind(&self, gpu: &Gpu) -> wgpu::BindGroup {
        let buffers = [
            &self.frame,
            &self.instances.buffer.buffer,
            &self.materials.buffer.buffer,
            &self.positions.buffer.buffer,
            &self.attributes.buffer.buffer,
            &self.indices.buffer.buffer,
            &self.texels.buffer.buffer,
            &self.lights.buffer.buffer,
            &self.views.buffer.buffer,
            &self.srgb_table,
        ];
        let entries: Vec<_> = buffers
            .iter()
            .enumerate()
            .map(|(i, b)| wgpu::BindGroupEntry { binding: i as u32, resource: b.as_entire_binding() })
            .collect();
        gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("frame.group"),
            layout: &self.layout,
            entries: &entries,
        })
    }

    /// Index of each asset among the resident ones; `usize::MAX` where it is not resident.
    fn places<T, P>(&self, wanted: &[Arc<T>], resident: &[(Arc<T>, P)]) -> Vec<usize> {
        let by_address: HashMap<*const T, usize> =
            resident.iter().enumerate().map(|(i, (asset, _))| (Arc::as_ptr(asset), i)).collect();
        wanted.iter().map(|a| by_address.get(&Arc::as_ptr(a)).copied().unwrap_or(usize::MAX)).collect()
    }

    fn update_meshes(&mut self, gpu: &Gpu, scene: &RenderScene) -> Result<bool, RenderError> {
        let places = self.places(&scene.meshes, &self.meshes);
        let bytes = |meshes: &mut dyn Iterator<Item = &Arc<Mesh>>| {
            meshes.fold((0u64, 0u64), |(v, t), m| (v + m.positions().len() as u64, t + m.triangles().len() as u64))
        };
        let mut missing: Vec<Arc<Mesh>> = Vec::new();
        for (mesh, _) in scene.meshes.iter().zip(&places).filter(|(_, p)| **p == usize::MAX) {
            // Two handles of one mesh are sent once.
            if !missing.iter().any(|m| Arc::ptr_eq(m, mesh)) {
                missing.push(mesh.clone());
            }
        }
        if missing.is_empty() {
            return Ok(false);
        }
        let stride = u64::from(layouts::ATTRIBUTE_STRIDE) * 4;
        let (vertices, triangles) = bytes(&mut missing.iter());
        let fits = self.positions.fits(vertices * 12)
            && self.attributes.fits(vertices * stride)
            && self.indices.fits(triangles * 12);
        let mut replaced = false;
        if !fits {
            // Start anew with what this scene holds; meshes that nobody uses fall out.
            missing = unique(&scene.meshes);
            let (vertices, triangles) = bytes(&mut missing.iter());
            let limit = gpu.device.limits().max_storage_buffer_binding_size;
            check_size("vertices", vertices * stride, limit)?;
            check_size("triangles", triangles * 12, limit)?;
            self.meshes.clear();
            for (heap, size) in [
                (&mut self.positions, vertices * 12),
                (&mut self.attributes, vertices * stride),
                (&mut self.indices, triangles * 12),
            ] {
                heap.used = 0;
                replaced |= heap.buffer.reserve(gpu, size);
            }
        }
        for mesh in missing {
            let range = MeshRange {
                first_index: (self.indices.used / 4) as u32,
                first_vertex: (self.positions.used / 12) as u32,
            };
            self.positions.push(gpu, bytemuck::cast_slice(mesh.positions()));
            self.attributes.push(gpu, bytemuck::cast_slice(&layouts::attributes(&mesh)));
            self.indices.push(gpu, bytemuck::cast_slice(mesh.triangles()));
            self.meshes.push((mesh, range));
        }
        Ok(replaced)
    }

    fn update_textures(&mut self, gpu: &Gpu, scene: &RenderScene) -> Result<bool, RenderError> {
        let places = self.places(&scene.textures, &self.textures);
        let mut missing: Vec<Arc<Texture>> = Vec::new();
        for (texture, _) in scene.textures.iter().zip(&places).filter(|(_, p)| **p == usize::MAX) {
            if !missing.iter().any(|m| Arc::ptr_eq(m, texture)) {
                missing.push(texture.clone());
            }
        }
        let bytes = |textures: &[Arc<Texture>]| {
            textures.iter().map(|t| (t.texels().len() + t.mips().len()) as u64 * 4).sum::<u64>()
        };
        let mut replaced = false;
        if !self.texels.fits(bytes(&missing)) {
            missing = unique(&scene.textures);
            let size = bytes(&missing);
            check_size("texels", size, gpu.device.limits().max_storage_buffer_binding_size)?;
            self.textures.clear();
            self.texels.used = 0;
            replaced = self.texels.buffer.reserve(gpu, size);
        }
        for texture in missing {
            let first = (self.texels.used / 4) as u32;
            self.texels.push(gpu, bytemuck::cast_slice(texture.texels()));
            self.texels.push(gpu, bytemuck::cast_slice(texture.mips()));
            self.textures.push((texture, first));
        }
        Ok(replaced)
    }

    fn update_instances(&mut self, gpu: &Gpu, scene: &RenderScene) -> bool {
        let ranges: Vec<MeshRange> =
            self.places(&scene.meshes, &self.meshes).into_iter().map(|i| self.meshes[i].1).collect();
        let mut data = Vec::with_capacity(scene.instances.len());
        self.draws.clear();
        for (number, i) in scene.instances.iter().enumerate() {
            let range = ranges[i.mesh as usize];
            let mesh = &scene.meshes[i.mesh as usize];
            data.push(InstanceData::new(&i.world_from_object, range.first_index, range.first_vertex, i.material));
            self.draws.push(Draw {
                vertices: mesh.triangles().len() as u32 * 3,
                instance: number as u32,
                transmissive: scene.materials[i.material as usize].transmission > 0.0,
                cutout: scene.materials[i.material as usize].is_cutout(),
                bounds_world: mesh.bounds_object().transformed(&i.world_from_object),
            });
        }
        self.instances.update(gpu, data)
    }

    /// True where the instance's record is another one now.
    fn update_instance(&mut self, scene: &RenderScene, at: usize) -> bool {
        let instance = &scene.instances[at];
        let old = self.instances.copy[at];
        self.instances.copy[at] =
            InstanceData::new(&instance.world_from_object, old.first_index, old.first_vertex, old.material);
        self.draws[at].bounds_world =
            scene.meshes[instance.mesh as usize].bounds_object().transformed(&instance.world_from_object);
        self.instances.copy[at] != old
    }
}

fn unique<T>(assets: &[Arc<T>]) -> Vec<Arc<T>> {
    let mut out: Vec<Arc<T>> = Vec::new();
    let mut seen = std::collections::HashSet::new();
    for a in assets {
        if seen.insert(Arc::as_ptr(a)) {
            out.push(a.clone());
        }
    }
    out
}

fn check_size(what: &str, bytes: u64, limit: u64) -> Result<(), RenderError> {
    if bytes > limit {
        return Err(RenderError::Gpu(format!("{what} take {bytes} bytes, but this adapter binds at most {limit}")));
    }
    Ok(())
}

/// Layer of each light's first view: single maps and faces are in two arrays, each numbered on its own.
pub(crate) fn first_layers(plan: &ShadowPlan) -> Vec<u32> {
    let (mut maps, mut faces) = (0, 0);
    plan.lights
        .iter()
        .map(|l| {
            let next = if l.count == 6 { &mut faces } else { &mut maps };
            let first = *next;
            *next += l.count;
            first
        })
        .collect()
}
