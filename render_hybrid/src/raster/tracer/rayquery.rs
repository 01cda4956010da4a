//! The adapter's own trees: one for each mesh, built once, compacted and kept; the upper one from the instances' transforms.

use catoptra_engine::{Mesh, RenderScene};
use std::{collections::BTreeMap, sync::Arc};
use wgpu::util::DeviceExt;

use crate::{accel::Accel, raster::device::Gpu};

/// Set for all instances, and for those that cast shadows: `shaders/tracer/hits_rayquery.wgsl`.
const MASK_CASTS: u8 = 1;
const MASK_ALL: u8 = 2;

struct MeshTree {
    /// Keeps the address from being used again.
    _mesh: Arc<Mesh>,
    blas: wgpu::Blas,
    state: State,
}

enum State {
    /// Vertices and indices wait for the next [`HardwareTrees::build`].
    New {
        vertices: wgpu::Buffer,
        indices: wgpu::Buffer,
        size: wgpu::BlasTriangleGeometrySizeDescriptor,
    },
    /// Built; its compaction is prepared by the driver.
    Built {
        asked: bool,
    },
    Compact,
}

/// What an instance's entry was made from.
#[derive(Clone, PartialEq)]
struct Entry {
    /// Address of the mesh and whether it has holes.
    key: (usize, bool),
    transform: [f32; 12],
    mask: u8,
    compact: bool,
}

/// Trees of one scene.
#[derive(Default)]
pub(crate) struct HardwareTrees {
    meshes: BTreeMap<(usize, bool), MeshTree>,
    pub tlas: Option<wgpu::Tlas>,
    entries: Vec<Option<Entry>>,
    dirty: bool,
}

impl HardwareTrees {
    /// Follows the scene: new meshes, moved instances. True where the upper tree is another object.
    ///
    /// # Errors
    /// What is beyond the adapter, with figures.
    pub fn update(&mut self, gpu: &Gpu, scene: &RenderScene, accel: &Accel) -> Result<bool, String> {
        let limits = gpu.device.limits();
        // Instance numbers have 24 bits there.
        let most = limits.max_tlas_instance_count.min(1 << 24);
        if scene.instances.len() as u64 > u64::from(most) {
            return Err(format!("{} instances, but this adapter's trees hold at most {most}", scene.instances.len()));
        }
        let mut used = BTreeMap::new();
        let mut wanted = Vec::with_capacity(scene.instances.len());
        for (id, instance) in scene.instances.iter().enumerate() {
            let mesh = &scene.meshes[instance.mesh as usize];
            let flat = accel.flat_instance(id as u32);
            let m = &instance.world_from_object;
            let row = |i: usize| [m.matrix3.x_axis[i], m.matrix3.y_axis[i], m.matrix3.z_axis[i], m.translation[i]];
            let transform: [f32; 12] = [row(0), row(1), row(2)].as_flattened().try_into().expect("three rows of four");
            let flattened = m.matrix3.determinant() == 0.0 || transform.iter().any(|x| !x.is_finite());
            if flattened || mesh.triangles().is_empty() {
                wanted.push(None);
                continue;
            }
            let key = (Arc::as_ptr(mesh) as usize, flat.cutout);
            used.insert(key, mesh.clone());
            let mask = MASK_ALL | if flat.casts_shadow { MASK_CASTS } else { 0 };
            wanted.push(Some(Entry { key, transform, mask, compact: false }));
        }
        self.meshes.retain(|key, _| used.contains_key(key));
        for (key, mesh) in used {
            if let std::collections::btree_map::Entry::Vacant(vacant) = self.meshes.entry(key) {
                let triangles = mesh.triangles().len();
                if triangles as u64 > u64::from(limits.max_blas_primitive_count) {
                    let most = limits.max_blas_primitive_count;
                    return Err(format!("a mesh of {triangles} triangles, but this adapter's trees hold {most}"));
                }
                vacant.insert(MeshTree::new(gpu, mesh, key.1));
            }
        }
        self.compact(gpu);
        let mut replaced = false;
        if self.tlas.as_ref().is_none_or(|t| t.get().len() < wanted.len()) {
            replaced = true;
            self.entries = Vec::new();
            self.tlas = Some(gpu.device.create_tlas(&wgpu::CreateTlasDescriptor {
                label: Some("tracer.tlas"),
                max_instances: (wanted.len() as u32 + wanted.len() as u32 / 2).clamp(1, most),
                flags: wgpu::AccelerationStructureFlags::PREFER_FAST_TRACE,
                update_mode: wgpu::AccelerationStructureUpdateMode::Build,
            }));
            self.dirty = true;
        }
        let Some(tlas) = &mut self.tlas else { unreachable!("made above") };
        self.entries.resize(tlas.get().len(), None);
        wanted.resize(tlas.get().len(), None);
        for (i, want) in wanted.into_iter().enumerate() {
            let want = want.map(|e| Entry { compact: matches!(self.meshes[&e.key].state, State::Compact), ..e });
            if self.entries[i] == want {
                continue;
            }
            tlas[i] = want
                .as_ref()
                .map(|e| wgpu::TlasInstance::new(&self.meshes[&e.key].blas, e.transform, i as u32, e.mask));
            // What is sent for a moved instance: its transform, number and mask, and the address of its tree.
            gpu.count_up(64);
            self.entries[i] = want;
            self.dirty = true;
        }
        Ok(replaced)
    }

    /// Takes over the small copies of trees that are ready, and asks for those of newly built ones.
    fn compact(&mut self, gpu: &Gpu) {
        for tree in self.meshes.values_mut() {
            if let State::Built { asked } = &mut tree.state {
                if !*asked {
                    *asked = true;
                    // A tree that cannot be compacted stays as it is.
                    tree.blas.prepare_compaction_async(|_| {});
                } else if tree.blas.ready_for_compaction() {
                    tree.blas = gpu.queue.compact_blas(&tree.blas);
                    tree.state = State::Compact;
                }
            }
        }
    }

    /// Records the builds that [`Self::update`] found due.
    pub fn build(&mut self, encoder: &mut wgpu::CommandEncoder) {
        let Some(tlas) = &self.tlas else { return };
        let entries: Vec<_> = self
            .meshes
            .values()
            .filter_map(|tree| match &tree.state {
                State::New { vertices, indices, size } => Some(wgpu::BlasBuildEntry {
                    blas: &tree.blas,
                    geometry: wgpu::BlasGeometries::TriangleGeometries(vec![wgpu::BlasTriangleGeometry {
                        size,
                        vertex_buffer: vertices,
                        first_vertex: 0,
                        vertex_stride: 12,
                        index_buffer: Some(indices),
                        first_index: Some(0),
                        transform_buffer: None,
                        transform_buffer_offset: None,
                    }]),
                }),
                _ => None,
            })
            .collect();
        if !self.dirty && entries.is_empty() {
            return;
        }
        encoder.build_acceleration_structures(entries.iter(), std::iter::once(tlas));
        drop(entries);
        for tree in self.meshes.values_mut() {
            if matches!(tree.state, State::New { .. }) {
                tree.state = State::Built { asked: false };
            }
        }
        self.dirty = false;
    }
}

impl MeshTree {
    fn new(gpu: &Gpu, mesh: Arc<Mesh>, cutout: bool) -> Self {
        let buffer = |label, contents: &[u8]| {
            gpu.count_up(contents.len() as u64);
            let usage = wgpu::BufferUsages::BLAS_INPUT;
            gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: Some(label), contents, usage })
        };
        let size = wgpu::BlasTriangleGeometrySizeDescriptor {
            vertex_format: wgpu::VertexFormat::Float32x3,
            vertex_count: mesh.positions().len() as u32,
            index_format: Some(wgpu::IndexFormat::Uint32),
            index_count: Some(mesh.triangles().len() as u32 * 3),
            flags: if cutout {
                // Each candidate once is enough: a hole stays a hole.
                wgpu::AccelerationStructureGeometryFlags::empty()
            } else {
                wgpu::AccelerationStructureGeometryFlags::OPAQUE
            },
        };
        let blas = gpu.device.create_blas(
            &wgpu::CreateBlasDescriptor {
                label: Some("tracer.blas"),
                flags: wgpu::AccelerationStructureFlags::PREFER_FAST_TRACE
                    | wgpu::AccelerationStructureFlags::ALLOW_COMPACTION,
                update_mode: wgpu::AccelerationStructureUpdateMode::Build,
            },
            wgpu::BlasGeometrySizeDescriptors::Triangles { descriptors: vec![size.clone()] },
        );
        let state = State::New {
            vertices: buffer("tracer.blas_vertices", bytemuck::cast_slice(mesh.positions())),
            indices: buffer("tracer.blas_indices", bytemuck::cast_slice(mesh.triangles())),
            size,
        };
        Self { _mesh: mesh, blas, state }
    }
}
