//! The structure as words of 16 bytes, for tracers that run elsewhere. Read access only.
//!
//! A node is eight children of two words: (least corner, reference), (greatest corner, 0). A triangle is three words:
//! (vertex, primitive), (vertex, 0), (vertex, 0), a leaf's triangles one after the other. References of leaves:
//! [`LEAF`] | (triangles − 1) << [`LEN_SHIFT`] | first triangle in mesh trees, [`LEAF`] | instance id in the upper one.

use super::Accel;
use super::blas::Blas;
use super::kdtree::{KD_LEAF, MAX_DEPTH as KD_MAX_DEPTH};
use super::node::{BLOCK, EMPTY, Node8, Tri8, WIDTH};
use catoptra_engine::mesh::Mesh;
use std::sync::Arc;

pub(crate) use super::kdtree::KD_LEAF as KD_LEAF_KIND;
pub(crate) use super::node::{BLOCK as REF_BLOCK, EMPTY as NONE, LEAF, LEN_SHIFT, MAX_DEPTH};
pub(crate) use super::ray_space::{LEAST_SLOPE, PAD};
pub(crate) use super::triangle::{CONDITION, DET_MAX, DET_MIN};

/// Words of 16 bytes.
pub(crate) type Word = [u32; 4];
/// Words a node.
pub(crate) const NODE_WORDS: u32 = 2 * WIDTH as u32;
/// Words a triangle.
pub(crate) const TRIANGLE_WORDS: u32 = 3;

/// A mesh's tree.
pub(crate) struct FlatTree {
    /// Wide nodes of [`NODE_WORDS`], or kd nodes of one word (plane, kind, first, count): children relative to the tree's
    /// first word, triangles absolute.
    pub nodes: Vec<Word>,
    pub triangles: Vec<Word>,
    /// Steps that a walk can take at most.
    pub steps: u64,
    /// Levels of wide nodes.
    pub levels: u32,
}

/// An instance's own part.
pub(crate) struct FlatInstance {
    pub inverse: [[f32; 3]; 3],
    pub translation: [f32; 3],
    pub tree: u32,
    pub identity: bool,
    pub casts_shadow: bool,
    pub cutout: bool,
}

fn corner([x, y, z]: [f32; 3], w: u32) -> Word {
    [x.to_bits(), y.to_bits(), z.to_bits(), w]
}

/// A node's words, its references mapped; empty slots hold no infinite boxes.
fn node_words(node: &Node8, refer: impl Fn(u32) -> u32, out: &mut Vec<Word>) {
    for slot in 0..WIDTH {
        if node.child[slot] == EMPTY {
            out.extend([corner([0.0; 3], EMPTY), [0; 4]]);
            continue;
        }
        let b = node.slot_box(slot);
        out.extend([corner(b.min, refer(node.child[slot])), corner(b.max, 0)]);
    }
}

/// Levels of nodes from `root` down; 0 without a root.
fn levels(nodes: &[Node8], root: u32) -> u32 {
    let mut deepest = 0;
    let mut todo = Vec::new();
    if root != EMPTY {
        todo.push((root, 1));
    }
    while let Some((n, level)) = todo.pop() {
        deepest = deepest.max(level);
        let inner = nodes[n as usize].child.iter().filter(|&&c| c != EMPTY && c & LEAF == 0);
        todo.extend(inner.map(|&c| (c, level + 1)));
    }
    deepest
}

fn triangles(blocks: &[Tri8]) -> (Vec<Word>, Vec<u32>) {
    let (mut words, mut first) = (Vec::new(), Vec::with_capacity(blocks.len() + 1));
    for block in blocks {
        first.push(words.len() as u32 / TRIANGLE_WORDS);
        for lane in 0..block.len() {
            words.push(corner(block.corner(0, lane), block.prim[lane]));
            words.extend([corner(block.corner(1, lane), 0), corner(block.corner(2, lane), 0)]);
        }
    }
    first.push(words.len() as u32 / TRIANGLE_WORDS);
    (words, first)
}

impl FlatTree {
    /// * `first_node`: the number of the tree's first node where it will lie (wide trees); `first_triangle` alike
    fn of(tree: &Blas, first_node: u32, first_triangle: u32) -> Self {
        let (words, first) = triangles(&tree.blocks);
        let mut nodes = Vec::new();
        if let Some(kd) = &tree.kd {
            for node in &kd.nodes {
                let word = if node.kind == KD_LEAF {
                    let (from, to) = (first[node.first as usize], first[(node.first + node.count) as usize]);
                    [0, KD_LEAF, first_triangle + from, to - from]
                } else {
                    [node.plane.to_bits(), node.kind, node.first, 0]
                };
                nodes.push(word);
            }
            // Each leaf is met once, after at most a walk from the root.
            let steps = kd.nodes.len() as u64 * u64::from(KD_MAX_DEPTH + 2);
            return Self { nodes, triangles: words, steps, levels: 0 };
        }
        let refer = |child: u32| {
            if child & LEAF == 0 {
                return first_node + child;
            }
            child & !BLOCK | (first_triangle + first[(child & BLOCK) as usize])
        };
        if tree.root != EMPTY && tree.root & LEAF != 0 {
            // A lone leaf gets a node all the same, so that there is one kind of root.
            let mut node = Node8::VACANT;
            node.set(0, &tree.bounds, tree.root);
            node_words(&node, refer, &mut nodes);
        }
        for node in &tree.nodes {
            node_words(node, refer, &mut nodes);
        }
        // Entering each node, taking each child, coming back to each node, leaving the tree.
        let steps = nodes.len() as u64 / u64::from(NODE_WORDS) * (WIDTH as u64 + 2) + 2;
        let root = if tree.root & LEAF == 0 { tree.root } else { EMPTY };
        Self { nodes, triangles: words, steps, levels: levels(&tree.nodes, root).max(1) }
    }
}

impl Accel {
    /// Sizes of a tree when flat: words of nodes, triangles.
    pub(crate) fn flat_sizes(&self, tree: u32) -> (u64, u64) {
        let tree = &self.world.trees[tree as usize];
        let triangles = tree.blocks.iter().map(|b| b.len() as u64).sum();
        match &tree.kd {
            Some(kd) => (kd.nodes.len() as u64, triangles),
            None if !tree.nodes.is_empty() => (tree.nodes.len() as u64 * u64::from(NODE_WORDS), triangles),
            None if tree.root != EMPTY => (u64::from(NODE_WORDS), triangles),
            None => (0, 0),
        }
    }

    /// Trees with the meshes that they stand for; vacant ones are left out.
    pub(crate) fn flat_trees(&self) -> impl Iterator<Item = (u32, &Arc<Mesh>)> {
        self.world.follow.meshes().iter().zip(0..).filter_map(|(mesh, tree)| mesh.as_ref().map(|m| (tree, m)))
    }

    /// A mesh's tree in words; see [`FlatTree`].
    pub(crate) fn flat_tree(&self, tree: u32, first_node: u32, first_triangle: u32) -> FlatTree {
        FlatTree::of(&self.world.trees[tree as usize], first_node, first_triangle)
    }

    /// Bounds and greatest coordinate of a tree.
    pub(crate) fn flat_bounds(&self, tree: u32) -> ([f32; 3], [f32; 3], f32) {
        let t = &self.world.trees[tree as usize];
        (t.bounds.min, t.bounds.max, t.extent)
    }

    /// True where mesh trees are kd-trees.
    pub(crate) fn flat_is_kd(&self) -> bool {
        self.world.trees.iter().any(|t| t.kd.is_some())
    }

    /// One instance; its slot exists as long as the structure follows the scene that names it.
    pub(crate) fn flat_instance(&self, instance_id: u32) -> FlatInstance {
        let record = &self.world.records[self.world.follow.slot(instance_id) as usize];
        let cutout = self.cutouts.as_ref().is_some_and(|c| c.has(instance_id));
        let casts = match &self.cutouts {
            Some(c) if cutout => c.casts[instance_id as usize],
            _ => record.casts_shadow,
        };
        FlatInstance {
            inverse: record.inverse,
            translation: record.translation,
            tree: record.blas,
            identity: record.identity,
            casts_shadow: casts,
            cutout,
        }
    }

    /// Levels of the upper tree.
    pub(crate) fn flat_tlas_levels(&self) -> u32 {
        levels(&self.world.tlas.nodes, self.world.tlas.root)
    }

    /// The upper tree's nodes, children counted from `first_node`, and its root; [`NONE`] where it is empty.
    pub(crate) fn flat_tlas(&self, first_node: u32) -> (Vec<Word>, u32) {
        let tlas = &self.world.tlas;
        if tlas.root == EMPTY {
            return (Vec::new(), NONE);
        }
        let refer = |child: u32| {
            if child & LEAF == 0 {
                return first_node + child;
            }
            LEAF | self.world.records[(child & !LEAF) as usize].instance_id
        };
        let mut words = Vec::with_capacity(tlas.nodes.len() * NODE_WORDS as usize);
        for node in &tlas.nodes {
            node_words(node, refer, &mut words);
        }
        (words, first_node + tlas.root)
    }

    /// Greatest absolute coordinate and slack of the upper tree.
    pub(crate) fn flat_extent(&self) -> (f32, f32) {
        (self.world.extent, self.world.slack)
    }
}
