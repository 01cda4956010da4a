//! Trees, instances and the upper tree together, and how they follow a scene.

use super::UpdateStats;
use super::blas::Blas;
use super::instance::InstanceRecord;
use super::node::{Bounds, EMPTY};
use super::tlas::Tlas;
use crate::BlasKind;
use catoptra_engine::mesh::Mesh;
use catoptra_engine::render_scene::{Instance, RenderScene};
use glam::Affine3;
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::Arc;

/// Twice the second-level cache of a present processor. What trees are smaller stay near enough that a ray alone waits less than it costs
/// to set it out beside others: measured at 2.5 MB (one by one gains 11%) and 5.5 MB (side by side gains 20%).
const SIDE_BY_SIDE_FROM: usize = 4 << 20;

/// What the kernels read.
pub(crate) struct World {
    /// By instance slot.
    pub records: Vec<InstanceRecord>,
    /// By `InstanceRecord::blas`.
    pub trees: Vec<Blas>,
    pub tlas: Tlas,
    /// Greatest absolute coordinate of instances' boxes and translations.
    pub extent: f32,
    /// Greatest κ of the instances: how much a rounding error may grow between object space and world space.
    pub slack: f32,
    /// The slot of the one instance that can be hit, where there is only one: the upper tree is left out.
    pub only: Option<u32>,
    pub follow: Follow,
    /// Bytes of all mesh trees.
    pub bytes: usize,
    /// Trees of so many bytes have rays without anything in common go through them side by side.
    pub side_by_side_from: usize,
    /// Of the counting level.
    pub counts: std::sync::Mutex<super::TraversalCounts>,
}

/// What is known of the scene that was seen last. Not read while tracing.
pub(crate) struct Follow {
    kind: BlasKind,
    seen: Option<(Arc<()>, u64, u64)>,
    /// By tree: the mesh, held so that its address stays its own.
    meshes: Vec<Option<Arc<Mesh>>>,
    tree_of: HashMap<usize, u32>,
    /// By instance slot.
    slots: Vec<Slot>,
    boxes: Vec<Bounds>,
    free: Vec<u32>,
    /// By instance id.
    slot_of: Vec<u32>,
}

#[derive(Clone, Copy)]
struct Slot {
    stable_id: u64,
    world_from_object: Affine3,
}

impl Follow {
    /// By tree.
    pub fn meshes(&self) -> &[Option<Arc<Mesh>>] {
        &self.meshes
    }
    /// The slot of an instance.
    pub fn slot(&self, instance_id: u32) -> u32 {
        self.slot_of[instance_id as usize]
    }
}

impl World {
    pub fn new(kind: BlasKind) -> Self {
        Self {
            records: Vec::new(),
            trees: Vec::new(),
            tlas: Tlas::new(),
            extent: 0.0,
            slack: 1.0,
            only: None,
            bytes: 0,
            side_by_side_from: SIDE_BY_SIDE_FROM,
            counts: Default::default(),
            follow: Follow {
                kind,
                seen: None,
                meshes: Vec::new(),
                tree_of: HashMap::new(),
                slots: Vec::new(),
                boxes: Vec::new(),
                free: Vec::new(),
                slot_of: Vec::new(),
            },
        }
    }

    pub fn update(&mut self, scene: &RenderScene) -> UpdateStats {
        let mut stats = UpdateStats::default();
        let same_structure = match &self.follow.seen {
            Some((origin, revision, structure)) if Arc::ptr_eq(origin, &scene.origin) => {
                if *revision == scene.revision {
                    return stats;
                }
                *revision + 1 == scene.revision && *structure == scene.structure_revision
            }
            _ => false,
        };
        self.follow.seen = Some((scene.origin.clone(), scene.revision, scene.structure_revision));
        if same_structure && scene.instances.len() == self.follow.slot_of.len() {
            for &id in &scene.moved {
                if let Some(instance) = scene.instances.get(id as usize) {
                    stats.tlas_rebuilt |= !self.place(self.follow.slot_of[id as usize], id, instance);
                }
            }
        } else {
            stats.blas_builds = self.follow_meshes(scene);
            stats.tlas_rebuilt = self.follow_instances(scene);
        }
        if stats.tlas_rebuilt || self.tlas.degraded() {
            self.rebuild(&mut stats);
        } else {
            stats.tlas_nodes_touched = self.tlas.settle();
            if self.tlas.degraded() {
                self.rebuild(&mut stats);
            }
        }
        self.only = self.only_one();
        stats
    }

    fn rebuild(&mut self, stats: &mut UpdateStats) {
        stats.tlas_rebuilt = true;
        stats.tlas_nodes_touched += self.tlas.build(&self.follow.boxes);
        (self.extent, self.slack) = (0.0, 1.0);
        for k in 0..self.follow.slot_of.len() {
            self.widen(self.follow.slot_of[k]);
        }
    }

    fn only_one(&self) -> Option<u32> {
        if self.tlas.root == EMPTY {
            return None;
        }
        let node = &self.tlas.nodes[self.tlas.root as usize];
        let mut children = node.child.iter().filter(|&&c| c != EMPTY);
        let first = *children.next()?;
        (children.next().is_none() && first & super::node::LEAF != 0).then_some(first & !super::node::LEAF)
    }

    /// Extent and slack only grow between rebuilds: both only make box tests more careful.
    fn widen(&mut self, slot: u32) {
        let b = self.follow.boxes[slot as usize];
        if b.is_empty() {
            return;
        }
        let m = &self.follow.slots[slot as usize].world_from_object;
        self.extent = self.extent.max(b.extent()).max(m.translation.abs().max_element());
        if let Some((_, kappa)) = super::instance::invert(m) {
            self.slack = self.slack.max(kappa);
        }
    }

    /// Gives a slot its instance's record and box and puts it into, moves it in, or takes it out of the upper tree.
    /// Returns false where the tree must be built anew.
    fn place(&mut self, slot: u32, id: u32, instance: &Instance) -> bool {
        let s = slot as usize;
        let record = &mut self.records[s];
        self.follow.slots[s] = Slot { stable_id: instance.stable_id, world_from_object: instance.world_from_object };
        let mut bounds = Bounds::EMPTY;
        match InstanceRecord::new(instance, id, record.blas, record.casts_shadow) {
            Some((new, kappa)) => {
                *record = new;
                let mesh = self.follow.meshes[new.blas as usize].as_ref().expect("a tree in use has its mesh");
                let b = mesh.bounds_object().transformed(&instance.world_from_object);
                let finite = b.min.is_finite() && b.max.is_finite();
                if finite {
                    bounds = b.into();
                    let t = instance.world_from_object.translation.abs().max_element();
                    self.extent = self.extent.max(bounds.extent()).max(t);
                    self.slack = self.slack.max(kappa);
                }
            }
            None => record.instance_id = id,
        }
        self.follow.boxes[s] = bounds;
        match (self.tlas.holds(slot), bounds.is_empty()) {
            (true, false) => self.tlas.moved(slot, &bounds),
            (true, true) => self.tlas.remove(slot),
            (false, false) => return self.tlas.insert(slot, &bounds),
            (false, true) => {}
        }
        true
    }

    /// Keeps, builds and drops mesh trees; returns how many were built.
    fn follow_meshes(&mut self, scene: &RenderScene) -> u32 {
        let f = &mut self.follow;
        let mut used = vec![false; f.meshes.len()];
        let mut new: Vec<Arc<Mesh>> = Vec::new();
        let mut queued = std::collections::HashSet::new();
        for instance in &scene.instances {
            let mesh = &scene.meshes[instance.mesh as usize];
            let address = Arc::as_ptr(mesh) as usize;
            match f.tree_of.get(&address) {
                Some(&tree) => used[tree as usize] = true,
                None if queued.insert(address) => new.push(mesh.clone()),
                None => {}
            }
        }
        let mut vacant = Vec::new();
        for (tree, used) in used.iter().enumerate() {
            if !used {
                if let Some(mesh) = f.meshes[tree].take() {
                    f.tree_of.remove(&(Arc::as_ptr(&mesh) as usize));
                    self.trees[tree] = Blas::vacant();
                }
                vacant.push(tree);
            }
        }
        let kind = f.kind;
        let built: Vec<Blas> = new.par_iter().map(|mesh| Blas::build(mesh, kind)).collect();
        let builds = built.len() as u32;
        for (mesh, blas) in new.into_iter().zip(built) {
            let tree = vacant.pop().unwrap_or_else(|| {
                f.meshes.push(None);
                self.trees.push(Blas::vacant());
                self.trees.len() - 1
            });
            f.tree_of.insert(Arc::as_ptr(&mesh) as usize, tree as u32);
            f.meshes[tree] = Some(mesh);
            self.trees[tree] = blas;
        }
        self.bytes = self.trees.iter().map(Blas::bytes).sum();
        builds
    }

    /// Matches instances by stable id; returns true where the upper tree should be built anew.
    fn follow_instances(&mut self, scene: &RenderScene) -> bool {
        let n = scene.instances.len();
        let sorted = scene.instances.is_sorted_by_key(|i| i.stable_id);
        let old = std::mem::take(&mut self.follow.slot_of);
        let old_id = |follow: &Follow, k: usize| follow.slots[old[k] as usize].stable_id;
        let old_sorted = (1..old.len()).all(|k| old_id(&self.follow, k - 1) <= old_id(&self.follow, k));
        let mut slot_of = vec![u32::MAX; n];
        let mut fresh = Vec::new();
        let mut gone = Vec::new();
        if sorted && old_sorted {
            let (mut k, mut id) = (0, 0);
            while k < old.len() || id < n {
                let order = match (k < old.len(), id < n) {
                    (true, true) => old_id(&self.follow, k).cmp(&scene.instances[id].stable_id),
                    (true, false) => std::cmp::Ordering::Less,
                    _ => std::cmp::Ordering::Greater,
                };
                if order.is_le() && order.is_ge() {
                    slot_of[id] = old[k];
                    (k, id) = (k + 1, id + 1);
                } else if order.is_lt() {
                    gone.push(old[k]);
                    k += 1;
                } else {
                    fresh.push(id);
                    id += 1;
                }
            }
        } else {
            gone.extend_from_slice(&old);
            fresh.extend(0..n);
        }
        // Many changes at once: one build is cheaper than many insertions.
        let rebuild = self.tlas.root == EMPTY || gone.len() + fresh.len() > n / 4 + 8;
        for slot in gone {
            if self.tlas.holds(slot) {
                self.tlas.remove(slot);
            }
            self.follow.boxes[slot as usize] = Bounds::EMPTY;
            self.follow.free.push(slot);
        }
        for &id in &fresh {
            slot_of[id] = self.follow.free.pop().unwrap_or_else(|| {
                self.records.push(InstanceRecord::VACANT);
                self.follow.boxes.push(Bounds::EMPTY);
                self.follow.slots.push(Slot { stable_id: 0, world_from_object: Affine3::IDENTITY });
                self.records.len() as u32 - 1
            });
            self.records[slot_of[id] as usize] = InstanceRecord::VACANT;
        }
        let mut deep = false;
        let mut is_fresh = fresh.iter().copied().peekable();
        for (id, instance) in scene.instances.iter().enumerate() {
            let slot = slot_of[id];
            let address = Arc::as_ptr(&scene.meshes[instance.mesh as usize]) as usize;
            let blas = self.follow.tree_of[&address];
            let fresh = is_fresh.next_if_eq(&id).is_some();
            let record = &mut self.records[slot as usize];
            let moved = fresh
                || record.blas != blas
                || self.follow.slots[slot as usize].world_from_object != instance.world_from_object;
            record.blas = blas;
            record.instance_id = id as u32;
            // A tree that was dropped may have given its number to another mesh: the box tells.
            if moved || self.box_of(instance, blas) != self.follow.boxes[slot as usize] {
                if rebuild && fresh {
                    // The build will put it in.
                    self.prepare(slot, id as u32, instance);
                } else {
                    deep |= !self.place(slot, id as u32, instance);
                }
            }
        }
        self.follow.slot_of = slot_of;
        rebuild || deep
    }

    fn box_of(&self, instance: &Instance, blas: u32) -> Bounds {
        let mesh = self.follow.meshes[blas as usize].as_ref().expect("a tree in use has its mesh");
        let b = mesh.bounds_object().transformed(&instance.world_from_object);
        let usable = b.min.is_finite() && b.max.is_finite();
        let regular = usable && super::instance::invert(&instance.world_from_object).is_some();
        if regular { b.into() } else { Bounds::EMPTY }
    }

    /// Record and box alone, for a tree that will be built.
    fn prepare(&mut self, slot: u32, id: u32, instance: &Instance) {
        let s = slot as usize;
        let record = &mut self.records[s];
        self.follow.slots[s] = Slot { stable_id: instance.stable_id, world_from_object: instance.world_from_object };
        if let Some((new, _)) = InstanceRecord::new(instance, id, record.blas, record.casts_shadow) {
            *record = new;
        }
        let blas = self.records[s].blas;
        self.follow.boxes[s] = self.box_of(instance, blas);
    }

    /// The tree of `old` follows `new`, which has the same triangles. False where it cannot.
    pub fn refit_mesh(&mut self, old: &Arc<Mesh>, new: &Arc<Mesh>) -> bool {
        let Some(&tree) = self.follow.tree_of.get(&(Arc::as_ptr(old) as usize)) else { return false };
        if old.triangles() != new.triangles() || !self.trees[tree as usize].refit(new) {
            return false;
        }
        self.follow.tree_of.remove(&(Arc::as_ptr(old) as usize));
        self.follow.tree_of.insert(Arc::as_ptr(new) as usize, tree);
        self.follow.meshes[tree as usize] = Some(new.clone());
        for id in 0..self.follow.slot_of.len() {
            let slot = self.follow.slot_of[id];
            if self.records[slot as usize].blas == tree {
                let s = self.follow.slots[slot as usize];
                let instance =
                    Instance { stable_id: s.stable_id, mesh: 0, material: 0, world_from_object: s.world_from_object };
                if !self.place(slot, id as u32, &instance) {
                    self.rebuild(&mut UpdateStats::default());
                }
            }
        }
        self.tlas.settle();
        self.only = self.only_one();
        true
    }

    pub fn can_be_hit(&self, instance_id: u32) -> bool {
        let f = &self.follow;
        f.slot_of.get(instance_id as usize).is_some_and(|&slot| !f.boxes[slot as usize].is_empty())
    }

    pub fn set_shadow_casters(&mut self, casts: impl Fn(u32) -> bool) {
        for (id, &slot) in self.follow.slot_of.iter().enumerate() {
            self.records[slot as usize].casts_shadow = casts(id as u32);
        }
    }

    pub fn validate(&self) -> Result<(), String> {
        self.tlas.validate(&self.follow.boxes)?;
        for (tree, mesh) in self.trees.iter().zip(&self.follow.meshes) {
            if let Some(mesh) = mesh {
                tree.validate(mesh)?;
            }
        }
        for (id, &slot) in self.follow.slot_of.iter().enumerate() {
            let record = &self.records[slot as usize];
            if record.instance_id != id as u32 || record.blas as usize >= self.trees.len() {
                return Err(format!("record of instance {id} is wrong"));
            }
        }
        if self.follow.slot_of.len() + self.follow.free.len() != self.records.len() {
            return Err("instance slots were lost".into());
        }
        Ok(())
    }
}
