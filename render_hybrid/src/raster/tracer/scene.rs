//! The scene in the tracer's heaps: meshes and textures once, instances and the upper tree where they moved.

use catoptra_engine::{Mesh, RenderScene, Texture};
use std::{collections::HashMap, sync::Arc};

use super::{
    heap::{Heap, Mirror},
    layout::{self, INSTANCE_WORDS, LIGHT_WORDS, MATERIAL_WORDS, MeshPlace, SceneHead},
    shaders::{HEAPS, HeapKind},
};
use crate::{
    accel::{
        Accel,
        flat::{NODE_WORDS, NONE, TRIANGLE_WORDS, Word},
    },
    raster::{device::Gpu, pipeline::uniform, scene_buffers::first_layers},
    twin::{shadow::ShadowPlan, vpl::Vpl},
};

/// A mesh with its tree, on the GPU.
struct Resident {
    mesh: Arc<Mesh>,
    tree: u32,
    first_node: u64,
    first_triangle: u64,
    first_geometry: u64,
    /// Words of nodes, triangles, words of geometry.
    sizes: [u64; 3],
    place: MeshPlace,
}

/// Everything in group 0.
pub(crate) struct TracerScene {
    pub layout: wgpu::BindGroupLayout,
    pub head: wgpu::Buffer,
    pub group: Option<wgpu::BindGroup>,
    nodes: Heap,
    triangles: Heap,
    geometry: Heap,
    texels: Heap,
    dynamic: Heap,
    vpls: Heap,
    residents: Vec<Resident>,
    resident_of: HashMap<u32, usize>,
    textures: Vec<(Arc<Texture>, u32)>,
    /// Words at the front of the node heap that are kept for the upper tree.
    tlas_room: u64,
    tlas: Mirror,
    instances: Mirror,
    materials: Mirror,
    lights: Mirror,
    views: Mirror,
    vpl_mirror: Mirror,
    head_written: Option<SceneHead>,
    /// First words of materials, lights, views in the dynamic heap, and its length.
    places: [u64; 4],
    last: Option<Seen>,
    /// Sum of steps over instances and the upper tree.
    pub traversal_cap: u32,
    /// Levels of wide nodes of both trees together, at most.
    pub levels: u32,
}

struct Seen {
    origin: Arc<()>,
    revision: u64,
    instances: usize,
    casts: Vec<bool>,
}

fn layout_of(gpu: &Gpu, kind: HeapKind, rayquery: bool) -> wgpu::BindGroupLayout {
    use wgpu::{BindingType as B, BufferBindingType, ShaderStages as S};
    let visibility = match kind {
        HeapKind::Storage => S::COMPUTE,
        HeapKind::Texture => S::FRAGMENT,
    };
    let buffer = |ty| B::Buffer { ty, has_dynamic_offset: false, min_binding_size: None };
    let entry = |binding, ty| wgpu::BindGroupLayoutEntry { binding, visibility, ty, count: None };
    let mut entries: Vec<_> = (0..3).map(|i| entry(i, buffer(BufferBindingType::Uniform))).collect();
    let heap = match kind {
        HeapKind::Storage => buffer(BufferBindingType::Storage { read_only: true }),
        HeapKind::Texture => B::Texture {
            sample_type: wgpu::TextureSampleType::Uint,
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: false,
        },
    };
    entries.extend((3..3 + HEAPS.len() as u32).map(|i| entry(i, heap)));
    if rayquery {
        entries.push(entry(9, B::AccelerationStructure { vertex_return: false }));
    }
    gpu.device
        .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some("tracer.scene"), entries: &entries })
}

impl TracerScene {
    pub fn new(gpu: &Gpu, kind: HeapKind, rayquery: bool) -> Self {
        let heap = |name| Heap::new(gpu, name, kind);
        Self {
            layout: layout_of(gpu, kind, rayquery),
            head: uniform(gpu, "tracer.head", size_of::<SceneHead>() as u64),
            group: None,
            nodes: heap(HEAPS[0]),
            triangles: heap(HEAPS[1]),
            geometry: heap(HEAPS[2]),
            texels: heap(HEAPS[3]),
            dynamic: heap(HEAPS[4]),
            vpls: heap(HEAPS[5]),
            residents: Vec::new(),
            resident_of: HashMap::new(),
            textures: Vec::new(),
            tlas_room: 0,
            tlas: Mirror::default(),
            instances: Mirror::default(),
            materials: Mirror::default(),
            lights: Mirror::default(),
            views: Mirror::default(),
            vpl_mirror: Mirror::default(),
            head_written: None,
            places: [0; 4],
            last: None,
            traversal_cap: 0,
            levels: 0,
        }
    }

    /// Brings the heaps up to the scene, which `accel` follows. True where the bind group must be made anew.
    ///
    /// # Errors
    /// What is beyond the adapter, with figures.
    pub fn update(
        &mut self,
        gpu: &Gpu,
        scene: &RenderScene,
        accel: &Accel,
        plan: &ShadowPlan,
        rayquery: bool,
    ) -> Result<bool, String> {
        let casts: Vec<bool> = (0..scene.instances.len() as u32).map(|i| accel.flat_instance(i).casts_shadow).collect();
        let only_moved = self.last.as_ref().is_some_and(|seen| {
            Arc::ptr_eq(&seen.origin, &scene.origin)
                && (scene.revision == seen.revision || scene.revision == seen.revision + 1)
                && scene.structure_revision <= seen.revision
                && seen.instances == scene.instances.len()
                && seen.casts == casts
        });
        let same = only_moved && self.last.as_ref().is_some_and(|seen| seen.revision == scene.revision);
        // Until the end of this update the heaps hold no scene that could be built upon.
        self.last = None;
        let mut replaced = false;
        // A refitted mesh has another Arc under the same tree.
        replaced |= self.update_meshes(gpu, accel, rayquery)?;
        let counts = [scene.instances.len(), scene.materials.len(), scene.lights.len(), plan.views.len()];
        replaced |= self.make_room(gpu, counts)?;
        if only_moved && !replaced {
            if !same {
                for &id in &scene.moved {
                    let words = self.instance(scene, accel, id);
                    let offset = id as usize * INSTANCE_WORDS as usize;
                    self.instances.patch(gpu, &self.dynamic, 0, offset, &words);
                }
            }
        } else {
            replaced |= self.update_textures(gpu, scene)?;
            let all = (0..scene.instances.len() as u32).flat_map(|id| self.instance(scene, accel, id)).collect();
            self.instances.update(gpu, &self.dynamic, 0, all);
            let first_texel: Vec<u32> = scene.textures.iter().map(|t| self.texture_place(t)).collect();
            let materials =
                scene.materials.iter().flat_map(|m| layout::material_words(m, scene, &first_texel)).collect();
            self.materials.update(gpu, &self.dynamic, self.places[0], materials);
            self.traversal_cap = self.cap(scene, accel);
        }
        let layers = first_layers(plan);
        let layer = |i: usize| layers.get(i).copied().unwrap_or(0);
        let lights = scene.lights.iter().enumerate().flat_map(|(i, l)| layout::light_words(l, i, plan, layer(i)));
        self.lights.update(gpu, &self.dynamic, self.places[1], lights.collect());
        let views = plan.views.iter().flat_map(layout::view_words).collect();
        self.views.update(gpu, &self.dynamic, self.places[2], views);
        let mut root = NONE;
        if !rayquery {
            let (tlas, tlas_root) = accel.flat_tlas(0);
            root = tlas_root;
            self.levels = accel.flat_tlas_levels() + self.residents.iter().map(|r| r.place.levels).max().unwrap_or(0);
            self.tlas.update(gpu, &self.nodes, 0, tlas);
        }
        let (extent, slack) = accel.flat_extent();
        let head = SceneHead {
            tlas_root: root,
            instances: 0,
            materials: self.places[0] as u32,
            lights: self.places[1] as u32,
            views: self.places[2] as u32,
            traversal_cap: self.traversal_cap,
            extent,
            slack,
        };
        if self.head_written != Some(head) {
            gpu.upload(&self.head, 0, bytemuck::bytes_of(&head));
            self.head_written = Some(head);
        }
        self.last = Some(Seen {
            origin: scene.origin.clone(),
            revision: scene.revision,
            instances: scene.instances.len(),
            casts,
        });
        Ok(replaced)
    }

    /// VPLs in the order of their maps. True where the bind group must be made anew.
    ///
    /// # Errors
    /// As [`Self::update`].
    pub fn update_vpls(&mut self, gpu: &Gpu, vpls: &[Vpl]) -> Result<bool, String> {
        let words: Vec<Word> = vpls
            .iter()
            .zip(0..)
            .flat_map(|(v, map)| -> [Word; 3] { bytemuck::cast(crate::raster::layouts::VplData::new(v, map)) })
            .collect();
        let replaced = self.vpls.reserve(gpu, words.len() as u64)?;
        if replaced {
            self.vpl_mirror.clear();
        }
        self.vpl_mirror.update(gpu, &self.vpls, 0, words);
        Ok(replaced)
    }

    /// Makes room for VPLs that a pass writes, and a word of its own behind them. True where the bind group must be made anew.
    ///
    /// # Errors
    /// As [`Self::update`].
    pub fn reserve_vpls(&mut self, gpu: &Gpu, count: u32) -> Result<bool, String> {
        // What the CPU had sent is overwritten.
        self.vpl_mirror.clear();
        self.vpls.reserve(gpu, 3 * u64::from(count) + 1)
    }

    /// The list of VPLs, to be written by a pass.
    pub fn vpl_list(&self) -> wgpu::BindingResource<'_> {
        self.vpls.resource()
    }

    /// Its buffer.
    ///
    /// # Panics
    /// Where the heaps are textures, which no pass writes: a mistake in this crate.
    pub fn vpl_buffer(&self) -> &wgpu::Buffer {
        self.vpls.buffer().expect("VPLs are traced where heaps are buffers")
    }

    /// Makes the bind group.
    pub fn bind(&mut self, gpu: &Gpu, frame: &wgpu::Buffer, srgb_table: &wgpu::Buffer, tlas: Option<&wgpu::Tlas>) {
        let mut resources =
            vec![frame.as_entire_binding(), srgb_table.as_entire_binding(), self.head.as_entire_binding()];
        let heaps = [&self.nodes, &self.triangles, &self.geometry, &self.texels, &self.dynamic, &self.vpls];
        resources.extend(heaps.map(Heap::resource));
        if let Some(tlas) = tlas {
            resources.push(tlas.as_binding());
        }
        self.group = Some(crate::raster::pipeline::group(gpu, "tracer.scene", &self.layout, &resources));
    }

    fn instance(&self, scene: &RenderScene, accel: &Accel, id: u32) -> [Word; INSTANCE_WORDS as usize] {
        let flat = accel.flat_instance(id);
        let place = self.resident_of.get(&flat.tree).map_or(MeshPlace::NOWHERE, |&r| self.residents[r].place);
        let instance = &scene.instances[id as usize];
        let bounds = accel.flat_bounds(flat.tree);
        layout::instance_words(&flat, &place, bounds, &instance.world_from_object, instance.material)
    }

    fn cap(&self, scene: &RenderScene, accel: &Accel) -> u32 {
        let steps = (0..scene.instances.len() as u32).fold(0u64, |sum, id| {
            let tree = accel.flat_instance(id).tree;
            // The leaf itself, the walk, the way back.
            sum + 3 + self.resident_of.get(&tree).map_or(0, |&r| self.residents[r].place.steps)
        });
        // Nodes of the upper tree are at most as many as leaves of trees without empty slots, or all that it has room for.
        (steps + self.tlas_room).min(u64::from(u32::MAX)) as u32
    }

    fn update_meshes(&mut self, gpu: &Gpu, accel: &Accel, rayquery: bool) -> Result<bool, String> {
        let tlas_words = u64::from(accel.stats().tlas_nodes) * u64::from(NODE_WORDS);
        let trees: Vec<(u32, Arc<Mesh>)> = accel.flat_trees().map(|(t, m)| (t, m.clone())).collect();
        let held = |s: &Self, tree: u32, mesh: &Arc<Mesh>| {
            s.resident_of.get(&tree).is_some_and(|&r| Arc::ptr_eq(&s.residents[r].mesh, mesh))
        };
        let missing: Vec<_> = trees.iter().filter(|(t, m)| !held(self, *t, m)).cloned().collect();
        if missing.is_empty() && tlas_words <= self.tlas_room {
            return Ok(false);
        }
        let sizes = |tree: u32, mesh: &Mesh| {
            let (nodes, triangles) = if rayquery { (0, 0) } else { accel.flat_sizes(tree) };
            [nodes, triangles, layout::geometry_size(mesh)]
        };
        // The same tree with moved vertices: in its place.
        let mut later = Vec::new();
        for (tree, mesh) in missing {
            match self.resident_of.get(&tree) {
                Some(&r) if self.residents[r].sizes == sizes(tree, &mesh) => {
                    self.residents[r].mesh = mesh;
                    self.send_mesh(gpu, accel, r, rayquery);
                }
                _ => later.push((tree, mesh)),
            }
        }
        if later.is_empty() && tlas_words <= self.tlas_room {
            return Ok(false);
        }
        let total = |list: &[(u32, Arc<Mesh>)]| {
            list.iter().fold([0u64; 3], |sum, (t, m)| {
                let own = sizes(*t, m);
                // Wide nodes are numbered in whole nodes.
                [sum[0] + own[0].next_multiple_of(u64::from(NODE_WORDS)), sum[1] + own[1], sum[2] + own[2]]
            })
        };
        let more = total(&later);
        let words = u64::from(TRIANGLE_WORDS);
        let fits = tlas_words <= self.tlas_room
            && self.nodes.fits(self.nodes.used + more[0])
            && self.triangles.fits((self.triangles.used + more[1]) * words)
            && self.geometry.fits(self.geometry.used + more[2]);
        if !fits {
            // Start anew with what this scene holds; meshes that nobody uses fall out.
            later = trees;
            self.tlas_room = (tlas_words * 2).max(u64::from(NODE_WORDS) * 16);
            self.tlas.clear();
            self.residents.clear();
            self.resident_of.clear();
            let all = total(&later);
            self.nodes.reserve(gpu, self.tlas_room + all[0])?;
            self.triangles.reserve(gpu, all[1] * words)?;
            self.geometry.reserve(gpu, all[2])?;
            (self.nodes.used, self.triangles.used, self.geometry.used) = (self.tlas_room, 0, 0);
        }
        for (tree, mesh) in later {
            let own = sizes(tree, &mesh);
            let resident = Resident {
                mesh,
                tree,
                first_node: self.nodes.used,
                first_triangle: self.triangles.used,
                first_geometry: self.geometry.used,
                sizes: own,
                place: MeshPlace::NOWHERE,
            };
            self.nodes.used += own[0].next_multiple_of(u64::from(NODE_WORDS));
            self.triangles.used += own[1];
            self.geometry.used += own[2];
            self.resident_of.insert(tree, self.residents.len());
            self.residents.push(resident);
            self.send_mesh(gpu, accel, self.residents.len() - 1, rayquery);
        }
        // Places changed: instances and their bound must follow even where nothing moved.
        self.last = None;
        Ok(true)
    }

    fn send_mesh(&mut self, gpu: &Gpu, accel: &Accel, r: usize, rayquery: bool) {
        let resident = &mut self.residents[r];
        let vertices = resident.mesh.positions().len() as u64 * u64::from(layout::VERTEX_WORDS);
        let mut root = NONE;
        let (mut steps, mut levels) = (0, 0);
        if !rayquery {
            let first_node = (resident.first_node / u64::from(NODE_WORDS)) as u32;
            let flat = accel.flat_tree(resident.tree, first_node, resident.first_triangle as u32);
            (steps, levels) = (flat.steps, flat.levels);
            if !flat.nodes.is_empty() {
                root = if accel.flat_is_kd() { resident.first_node as u32 } else { first_node };
            }
            self.nodes.write(gpu, resident.first_node, &flat.nodes);
            self.triangles.write(gpu, resident.first_triangle * u64::from(TRIANGLE_WORDS), &flat.triangles);
        }
        self.geometry.write(gpu, resident.first_geometry, &layout::geometry_words(&resident.mesh));
        resident.place = MeshPlace {
            root,
            first_vertex: resident.first_geometry as u32,
            first_index: (resident.first_geometry + vertices) as u32,
            steps,
            levels,
            closed: resident.mesh.closed(),
        };
    }

    fn texture_place(&self, texture: &Arc<Texture>) -> u32 {
        self.textures.iter().find(|(t, _)| Arc::ptr_eq(t, texture)).map_or(0, |(_, first)| *first)
    }

    fn update_textures(&mut self, gpu: &Gpu, scene: &RenderScene) -> Result<bool, String> {
        // Four texels a word; each texture begins a word.
        let words = |t: &Texture| (t.texels().len() + t.mips().len()).div_ceil(4) as u64;
        let mut missing: Vec<Arc<Texture>> = Vec::new();
        for t in &scene.textures {
            let held = self.textures.iter().any(|(h, _)| Arc::ptr_eq(h, t));
            if !held && !missing.iter().any(|m| Arc::ptr_eq(m, t)) {
                missing.push(t.clone());
            }
        }
        let mut replaced = false;
        if !self.texels.fits(self.texels.used + missing.iter().map(|t| words(t)).sum::<u64>()) {
            missing.clear();
            for t in &scene.textures {
                if !missing.iter().any(|m| Arc::ptr_eq(m, t)) {
                    missing.push(t.clone());
                }
            }
            self.textures.clear();
            self.texels.used = 0;
            replaced = self.texels.reserve(gpu, missing.iter().map(|t| words(t)).sum())?;
        }
        for texture in missing {
            let mut data = vec![[0u32; 4]; words(&texture) as usize];
            let (image, copies): (&[u8], &[u8]) =
                (bytemuck::cast_slice(texture.texels()), bytemuck::cast_slice(texture.mips()));
            let bytes = bytemuck::cast_slice_mut::<Word, u8>(&mut data);
            bytes[..image.len()].copy_from_slice(image);
            // The smaller copies follow the image.
            bytes[image.len()..image.len() + copies.len()].copy_from_slice(copies);
            self.texels.write(gpu, self.texels.used, &data);
            self.textures.push((texture, self.texels.used as u32 * 4));
            self.texels.used += data.len() as u64;
        }
        Ok(replaced)
    }

    /// Places in the dynamic heap. True where they changed: everything must be sent again.
    fn make_room(&mut self, gpu: &Gpu, [instances, materials, lights, views]: [usize; 4]) -> Result<bool, String> {
        let sizes = [
            instances as u64 * u64::from(INSTANCE_WORDS),
            materials as u64 * u64::from(MATERIAL_WORDS),
            lights as u64 * u64::from(LIGHT_WORDS),
            views as u64 * u64::from(layout::VIEW_WORDS),
        ];
        let mut places = [0; 4];
        let mut sum = 0;
        for (place, size) in places.iter_mut().zip(sizes) {
            sum += size;
            *place = sum;
        }
        let replaced = self.dynamic.reserve(gpu, sum)?;
        if !replaced && places == self.places {
            return Ok(false);
        }
        self.places = places;
        for mirror in [&mut self.instances, &mut self.materials, &mut self.lights, &mut self.views] {
            mirror.clear();
        }
        Ok(true)
    }
}
