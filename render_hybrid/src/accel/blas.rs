//! A mesh's own tree, in object space.

use super::binary::{self, Box4};
use super::kdtree::KdTree;
use super::node::{BLOCK, Bounds, EMPTY, LEAF, LEN_SHIFT, Node8, Tri8};
use super::reinsert;
use super::wide::{CollapseCosts, WideTree, collapse, median_tree};
use crate::BlasKind;
use catoptra_engine::mesh::Mesh;
use rayon::prelude::*;

/// Wide BVH over triangle blocks.
pub(crate) struct Blas {
    pub nodes: Vec<Node8>,
    pub blocks: Vec<Tri8>,
    pub root: u32,
    /// The kd-tree over the blocks instead of nodes, for `BlasKind::KdTree`.
    pub kd: Option<KdTree>,
    pub bounds: Bounds,
    /// Greatest absolute coordinate.
    pub extent: f32,
}

/// Against one visit of a wide node: see `CollapseCosts`.
const COSTS: CollapseCosts = CollapseCosts { max_leaf: 8, leaf: 0.5, primitive: 0.05 };

/// Nodes, those of the greatest boxes, that are tried elsewhere in the tree in each round, a triangle.
const REINSERTION: f32 = 0.025;

/// Rounds of reinsertion: many over the top of the tree, which most rays see, rather than few over most of it.
const ROUNDS: usize = 26;

/// Triangles of a binary tree's leaves at most.
const BINARY_LEAF: usize = 2;

/// Triangles a task.
const CHUNK: usize = 1024;

/// Coordinates beyond this overflow the builder's surface areas; such meshes get the median tree.
const MAX_BUILDER_COORDINATE: f32 = 1e15;

impl Blas {
    /// The tree of nothing.
    pub fn vacant() -> Self {
        Self { nodes: Vec::new(), blocks: Vec::new(), root: EMPTY, kd: None, bounds: Bounds::EMPTY, extent: 0.0 }
    }

    /// Of what rays read.
    pub fn bytes(&self) -> usize {
        let kd = self.kd.as_ref().map_or(0, |kd| size_of_val(&*kd.nodes));
        size_of_val(&*self.nodes) + size_of_val(&*self.blocks) + kd
    }

    pub fn build(mesh: &Mesh, kind: BlasKind) -> Self {
        if kind == BlasKind::KdTree {
            return Self::build_kd(mesh);
        }
        let bounds = Bounds::from(mesh.bounds_object());
        let boxes: Vec<Box4> = (0..mesh.triangles().len() as u32)
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|i| Box4::of(&mesh.corners(i)))
            .collect();
        let tree = if boxes.len() > 8 && bounds.extent() < MAX_BUILDER_COORDINATE {
            let (mut nodes, ids) = binary::build(&boxes, BINARY_LEAF);
            reinsert::improve(&mut nodes, (boxes.len() as f32 * REINSERTION) as usize, ROUNDS);
            collapse(&nodes, &ids, &boxes, COSTS)
        } else {
            None
        };
        let tree = tree.unwrap_or_else(|| {
            let (nodes, ids) = median_tree(&boxes);
            collapse(&nodes, &ids, &boxes, COSTS).expect("a median tree is shallow")
        });
        Self::from_tree(mesh, tree)
    }

    /// Follows moved vertices: blocks and boxes are rewritten, the tree keeps its shape. False for a kd-tree, whose planes
    /// cannot follow. `mesh` has the triangles that the tree was built for.
    pub fn refit(&mut self, mesh: &Mesh) -> bool {
        if self.kd.is_some() {
            return false;
        }
        self.bounds = Bounds::from(mesh.bounds_object());
        self.extent = self.bounds.extent();
        let mut boxes = Vec::with_capacity(self.blocks.len());
        for block in &mut self.blocks {
            let mut b = Bounds::EMPTY;
            for lane in 0..block.len() {
                let prim = block.prim[lane];
                let corners = mesh.corners(prim);
                block.set(lane, corners, prim);
                for p in corners {
                    b = b.union(Bounds { min: p.to_array(), max: p.to_array() });
                }
            }
            boxes.push(b);
        }
        // Children come after their parents.
        for n in (0..self.nodes.len()).rev() {
            for slot in 0..8 {
                let child = self.nodes[n].child[slot];
                if child != EMPTY {
                    let inner = child & LEAF == 0;
                    let b = if inner { self.nodes[child as usize].bounds() } else { boxes[(child & BLOCK) as usize] };
                    self.nodes[n].set_box(slot, &b);
                }
            }
        }
        true
    }

    fn build_kd(mesh: &Mesh) -> Self {
        let (tree, blocks) = super::kdtree::build(mesh);
        let bounds = tree.bounds;
        Self { nodes: Vec::new(), blocks, root: EMPTY, kd: Some(tree), bounds, extent: bounds.extent() }
    }

    fn from_tree(mesh: &Mesh, tree: WideTree) -> Self {
        assert!(tree.leaves.len() < BLOCK as usize, "a mesh of at most 2^28 leaves");
        let refer = |child: u32| {
            if child == EMPTY || child & LEAF == 0 {
                return child;
            }
            child | (tree.leaves[(child & !LEAF) as usize].as_slice().len() as u32 - 1) << LEN_SHIFT
        };
        let mut nodes = tree.nodes;
        for node in &mut nodes {
            node.child = node.child.map(refer);
        }
        let root = refer(tree.root);
        let blocks = tree
            .leaves
            .par_iter()
            .map(|leaf| {
                let mut block = Tri8::VACANT;
                for (lane, &prim) in leaf.as_slice().iter().enumerate() {
                    block.set(lane, mesh.corners(prim), prim);
                }
                block
            })
            .collect();
        let bounds = Bounds::from(mesh.bounds_object());
        Self { nodes, blocks, root, kd: None, bounds, extent: bounds.extent() }
    }

    /// What is wrong with the tree, if anything: references, boxes, and that every triangle is there.
    pub fn validate(&self, mesh: &Mesh) -> Result<(), String> {
        if let Some(tree) = &self.kd {
            return tree.validate(mesh, &self.blocks);
        }
        let mut seen = vec![false; mesh.triangles().len()];
        let mut nodes_seen = 0;
        let mut todo = Vec::new();
        if self.root != EMPTY {
            todo.push((self.root, self.bounds, 0));
        }
        while let Some((child, bounds, depth)) = todo.pop() {
            if depth > super::node::MAX_DEPTH {
                return Err(format!("deeper than {}", super::node::MAX_DEPTH));
            }
            if child & LEAF != 0 {
                let block = self.blocks.get((child & BLOCK) as usize).ok_or("a leaf names no block")?;
                if block.len() != ((child & !LEAF) >> LEN_SHIFT) as usize + 1 {
                    return Err("a leaf's length is wrong".into());
                }
                for lane in 0..block.len() {
                    let prim = block.prim[lane];
                    let corners = [0, 1, 2].map(|v| glam::Vec3::from(block.corner(v, lane)));
                    if mesh.corners(prim) != corners {
                        return Err(format!("block holds a wrong triangle {prim}"));
                    }
                    seen[prim as usize] = true;
                }
                continue;
            }
            let node = self.nodes.get(child as usize).ok_or("a child names no node")?;
            nodes_seen += 1;
            for slot in 0..8 {
                if node.child[slot] != EMPTY {
                    let b = node.slot_box(slot);
                    if !bounds.contains(&b) {
                        return Err(format!("box {slot} of node {child} leaves its parent's"));
                    }
                    todo.push((node.child[slot], b, depth + 1));
                } else if !node.slot_box(slot).is_empty() {
                    return Err(format!("empty slot {slot} of node {child} has a box"));
                }
            }
        }
        if nodes_seen != self.nodes.len() {
            return Err(format!("{nodes_seen} of {} nodes are reachable", self.nodes.len()));
        }
        match seen.iter().position(|s| !s) {
            Some(prim) => Err(format!("triangle {prim} is in no leaf")),
            None => Ok(()),
        }
    }
}
