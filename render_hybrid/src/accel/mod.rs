//! The two-level structure: a BLAS per mesh, a TLAS over instances. Moved bodies refit TLAS leaves and their ancestors only.
//!
//! Contract: a hit is a function of the ray and the triangles alone. It does not depend on the trees, on [`BlasKind`], on the
//! SIMD level, on rays being taken singly or together, on threads, or on the updates that led to the scene. Closed meshes
//! have no gaps along shared edges and vertices; open edges are not fattened. Equal distances go to the smaller
//! (instance, primitive).

mod binary;
mod blas;
mod boxes;
mod cutout;
pub(crate) mod flat;
mod instance;
mod kdtree;
pub(crate) mod node;
mod ray;
mod ray_space;
mod reinsert;
mod simd;
#[cfg(test)]
mod tests;
mod tlas;
mod triangle;
mod wide;
mod world;

pub use boxes::TreeBox;
pub use ray::{Hit, Ray};

use crate::{BlasKind, RenderError, SimdLevel};
use catoptra_engine::mesh::Mesh;
use catoptra_engine::render_scene::RenderScene;
use std::sync::Arc;

/// How an [`Accel`] is made. Nothing here changes a hit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AccelOptions {
    /// Tree of each mesh.
    pub blas: BlasKind,
    /// SIMD level of the kernels.
    pub simd: SimdLevel,
    /// Tallies what traversals test, for [`Accel::counts`]: portable code, several times slower. The kernels of every other
    /// choice know nothing of it.
    pub count: bool,
}

/// What traversals have tested.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TraversalCounts {
    /// Nodes of the trees of instances and meshes; by a packet once, whatever the rays in it.
    pub nodes: u64,
    /// Boxes in them; a kd-tree's nodes have none.
    pub boxes: u64,
    /// Triangle blocks; by a packet once, whatever the rays in it.
    pub blocks: u64,
    /// Triangles in them.
    pub triangles: u64,
}

impl TraversalCounts {
    /// All zero.
    pub const NONE: Self = Self { nodes: 0, boxes: 0, blocks: 0, triangles: 0 };
}

impl std::ops::Add for TraversalCounts {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Self {
            nodes: self.nodes + o.nodes,
            boxes: self.boxes + o.boxes,
            blocks: self.blocks + o.blocks,
            triangles: self.triangles + o.triangles,
        }
    }
}

/// What an update did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UpdateStats {
    /// Mesh trees built: 0 where no mesh is new.
    pub blas_builds: u32,
    /// Nodes of the upper tree that were recomputed or built.
    pub tlas_nodes_touched: u32,
    /// The upper tree was built anew: at first, after many insertions or removals, or where its surface-area cost had grown
    /// past 1.6 times that of its last build.
    pub tlas_rebuilt: bool,
}

/// Sizes of the structure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AccelStats {
    /// Mesh trees held.
    pub trees: u32,
    /// Nodes of all mesh trees.
    pub blas_nodes: u32,
    /// Triangle blocks of all mesh trees.
    pub blocks: u32,
    /// Nodes of the upper tree.
    pub tlas_nodes: u32,
}

/// A mesh's tree, to be read: see [`node`].
pub(crate) struct MeshTree<'a> {
    pub nodes: &'a [node::Node8],
    pub blocks: &'a [node::Tri8],
    pub root: u32,
}

/// Finds what rays meet in a scene.
pub struct Accel {
    world: world::World,
    level: simd::Detected,
    /// Where instances have holes.
    cutouts: Option<cutout::Cutouts>,
}

impl Accel {
    /// An empty structure.
    ///
    /// # Errors
    /// [`RenderError::Unavailable`] where `options.simd` names a level that this processor lacks.
    pub fn new(options: AccelOptions) -> Result<Self, RenderError> {
        let level = if options.count { simd::Detected::counting() } else { simd::Detected::new(options.simd)? };
        Ok(Self { world: world::World::new(options.blas), level, cutouts: None })
    }

    /// Follows the scene: one that passes [`RenderScene::validate`]. Builds run on the caller's rayon pool.
    ///
    /// The same revision of the same world: nothing happens. The next one with an unchanged structure: only
    /// `scene.moved` is refitted. Otherwise everything is compared; mesh trees are kept by the address of the mesh's `Arc`
    /// (held here, so that it stays unique), instances by `stable_id`. Where anything has an alpha mask, shadow casters are
    /// to be chosen anew after it.
    pub fn update(&mut self, scene: &RenderScene) -> UpdateStats {
        let stats = self.world.update(scene);
        self.cutouts = cutout::Cutouts::of(scene);
        if let Some(cutouts) = &self.cutouts {
            self.world.set_shadow_casters(|i| !cutouts.has(i));
        }
        stats
    }

    /// Lets the tree of a mesh follow moved vertices without a build: `new` has the same triangles as `old`. Hits are those of
    /// a fresh build; only speed suffers where the shape has changed much. Give scenes that name `new` from then on.
    ///
    /// Returns false, and changes nothing, where `old` has no tree here, the triangles differ, or the tree is a kd-tree.
    pub fn refit_mesh(&mut self, old: &Arc<Mesh>, new: &Arc<Mesh>) -> bool {
        self.world.refit_mesh(old, new)
    }

    /// First thing that the ray meets at `t_min < t < t_max`, or [`Hit::MISS`]. A ray with a non-finite origin or direction,
    /// or a zero direction, misses.
    #[inline]
    pub fn closest_hit(&self, ray: &Ray) -> Hit {
        let hit = simd::closest(self.level, &self.world, ray);
        if self.cutouts.is_some() { self.beyond_holes(ray, hit) } else { hit }
    }

    /// True where the ray meets an instance that casts shadows, at `t_min < t < t_max`.
    #[inline]
    pub fn occluded(&self, ray: &Ray) -> bool {
        simd::any(self.level, &self.world, ray) || (self.cutouts.is_some() && self.occluded_by_cutout(ray))
    }

    /// Chooses by instance id which instances [`Self::occluded`] sees; all at first, and each new one.
    pub fn set_shadow_casters(&mut self, casts: impl Fn(u32) -> bool) {
        match &mut self.cutouts {
            None => self.world.set_shadow_casters(casts),
            Some(cutouts) => {
                cutouts.casts.iter_mut().enumerate().for_each(|(i, c)| *c = casts(i as u32));
                self.world.set_shadow_casters(|i| !cutouts.has(i) && casts(i));
            }
        }
    }

    /// [`Self::closest_hit`] of each ray, the same bits; fastest where neighbours in the slice are alike.
    ///
    /// # Panics
    /// Where the slices differ in length.
    pub fn closest_hits(&self, rays: &[Ray], hits: &mut [Hit]) {
        assert_eq!(rays.len(), hits.len(), "one hit a ray");
        simd::closest_many(self.level, &self.world, rays, hits);
        if self.cutouts.is_some() {
            rays.iter().zip(hits).for_each(|(ray, hit)| *hit = self.beyond_holes(ray, *hit));
        }
    }

    /// [`Self::occluded`] of each ray.
    ///
    /// # Panics
    /// Where the slices differ in length.
    pub fn occluded_many(&self, rays: &[Ray], occluded: &mut [bool]) {
        assert_eq!(rays.len(), occluded.len(), "one answer a ray");
        simd::any_many(self.level, &self.world, rays, occluded);
        if self.cutouts.is_some() {
            rays.iter().zip(occluded).for_each(|(ray, o)| *o = *o || self.occluded_by_cutout(ray));
        }
    }

    /// True where rays can meet the instance: its transform is regular and its box finite.
    pub(crate) fn can_be_hit(&self, instance_id: u32) -> bool {
        self.world.can_be_hit(instance_id)
    }

    /// The tree of an instance's mesh, of boxes in object space; `None` where it is a kd-tree.
    pub(crate) fn mesh_tree(&self, instance_id: u32) -> Option<MeshTree<'_>> {
        let record = &self.world.records[self.world.follow.slot(instance_id) as usize];
        let tree = &self.world.trees[record.blas as usize];
        tree.kd.is_none().then_some(MeshTree { nodes: &tree.nodes, blocks: &tree.blocks, root: tree.root })
    }

    /// True where anything has holes.
    pub(crate) fn any_holes(&self) -> bool {
        self.cutouts.is_some()
    }

    /// True where the instance has holes.
    pub(crate) fn has_holes(&self, instance_id: u32) -> bool {
        self.cutouts.as_ref().is_some_and(|c| c.has(instance_id))
    }

    /// True where the hit falls into a hole.
    pub(crate) fn is_hole(&self, hit: &Hit) -> bool {
        self.cutouts.as_ref().is_some_and(|c| c.is_hole(hit))
    }

    /// The first hit from `hit` on that falls into no hole.
    fn beyond_holes(&self, ray: &Ray, mut hit: Hit) -> Hit {
        let Some(cutouts) = &self.cutouts else { return hit };
        while hit.is_hit() && cutouts.is_hole(&hit) {
            hit = simd::closest(self.level, &self.world, &Ray { t_min: hit.t, ..*ray });
        }
        hit
    }

    /// [`Self::occluded`] by what has holes, which the trees take for no casters.
    fn occluded_by_cutout(&self, ray: &Ray) -> bool {
        let Some(cutouts) = &self.cutouts else { return false };
        let mut rest = *ray;
        loop {
            let hit = simd::closest(self.level, &self.world, &rest);
            if !hit.is_hit() {
                return false;
            }
            let casts = cutouts.has(hit.instance_id) && cutouts.casts[hit.instance_id as usize];
            if casts && !cutouts.is_hole(&hit) {
                return true;
            }
            rest.t_min = hit.t;
        }
    }

    /// The level in use; never `Auto`.
    pub fn simd_level(&self) -> SimdLevel {
        self.level.level()
    }

    /// What all rays since the last call have tested; zero without [`AccelOptions::count`].
    pub fn counts(&self) -> TraversalCounts {
        std::mem::take(&mut *self.world.counts.lock().expect("no panic while adding"))
    }

    /// Sizes.
    pub fn stats(&self) -> AccelStats {
        let trees = &self.world.trees;
        AccelStats {
            trees: trees.iter().filter(|t| !t.blocks.is_empty()).count() as u32,
            blas_nodes: trees.iter().map(|t| (t.nodes.len() + t.kd.as_ref().map_or(0, |k| k.nodes.len())) as u32).sum(),
            blocks: trees.iter().map(|t| t.blocks.len() as u32).sum(),
            tlas_nodes: self.world.tlas.nodes.len() as u32,
        }
    }

    /// Checks every invariant of the trees.
    ///
    /// # Errors
    /// What is wrong, in words.
    pub fn validate(&self) -> Result<(), String> {
        self.world.validate()
    }
}
