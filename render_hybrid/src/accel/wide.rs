//! Binary trees become eight-wide ones: dynamic programme over surface-area costs.
//!
//! Source: Ylitie, Karras & Laine, "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs", HPG 2017,
//! section 3.2 (optimal SAH collapse), here with leaves of up to eight triangles.

use super::node::{Bounds, EMPTY, LEAF, MAX_DEPTH, Node8, WIDTH};
use obvhs::bvh2::node::Bvh2Node;

/// What a leaf costs against one node visit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CollapseCosts {
    /// Most primitives a leaf, 1..=8.
    pub max_leaf: u32,
    /// Visit of a leaf.
    pub leaf: f32,
    /// Each primitive in it.
    pub primitive: f32,
}

/// A wide tree; leaf number n holds `leaf_primitives[n]`.
pub(crate) struct WideTree {
    pub nodes: Vec<Node8>,
    pub root: u32,
    pub bounds: Bounds,
    pub leaves: Vec<LeafPrimitives>,
    pub depth: usize,
}

/// Primitives of one leaf without repeats.
#[derive(Clone, Copy)]
pub(crate) struct LeafPrimitives {
    ids: [u32; WIDTH],
    len: u8,
}

impl LeafPrimitives {
    pub fn as_slice(&self) -> &[u32] {
        &self.ids[..self.len as usize]
    }
}

/// `None`: too deep for the traversal stacks.
pub(crate) fn collapse(nodes: &[Bvh2Node], primitives: &[u32], costs: CollapseCosts) -> Option<WideTree> {
    let mut tree = WideTree { nodes: Vec::new(), root: EMPTY, bounds: Bounds::EMPTY, leaves: Vec::new(), depth: 0 };
    let Some(first) = nodes.first() else { return Some(tree) };
    tree.bounds = first.aabb().into();

    // Parents before children, whatever order the builder left.
    let mut order = Vec::with_capacity(nodes.len());
    let mut todo = vec![0u32];
    while let Some(n) = todo.pop() {
        order.push(n);
        let node = &nodes[n as usize];
        if !node.is_leaf() {
            todo.extend([node.first_index, node.first_index + 1]);
        }
    }

    // cost[n][i]: least cost of subtree n as at most i + 1 children of one wide node. pick[n][i]: children given to the left
    // subtree, 0 = same as with one fewer. As a single child: leaf or wide node.
    let mut cost = vec![[0.0f32; 7]; nodes.len()];
    let mut pick = vec![[0u8; 8]; nodes.len()];
    let mut count = vec![0u32; nodes.len()];
    for &n in order.iter().rev() {
        let n = n as usize;
        let node = &nodes[n];
        let area = node.aabb().half_area();
        let leaf = |c: u32| {
            if c <= costs.max_leaf { area * (costs.leaf + costs.primitive * c as f32) } else { f32::INFINITY }
        };
        let (l, r) = (node.first_index as usize, node.first_index as usize + 1);
        count[n] = if node.is_leaf() { node.prim_count } else { count[l] + count[r] };
        // Pairs stay together: half of all nodes are done with here.
        if node.is_leaf() || count[n] <= costs.max_leaf.min(2) {
            cost[n] = [leaf(count[n]); 7];
            pick[n][7] = u8::MAX;
            continue;
        }
        let (cl, cr) = (cost[l], cost[r]);
        let split = |children: usize| {
            let mut best = (f32::INFINITY, 1u8);
            for k in 1..children {
                let c = cl[k - 1] + cr[children - k - 1];
                if c < best.0 {
                    best = (c, k as u8);
                }
            }
            best
        };
        let (inner, k) = split(WIDTH);
        let (as_leaf, as_node) = (leaf(count[n]), area + inner);
        let is_leaf = count[n] <= costs.max_leaf && as_leaf <= as_node;
        // Slot 7 says what the subtree is as a single child: a leaf, or a node whose left subtree gets k children.
        pick[n][7] = if is_leaf { u8::MAX } else { k };
        cost[n][0] = if is_leaf { as_leaf } else { as_node };
        for i in 1..7 {
            let (c, k) = split(i + 1);
            let same = cost[n][i - 1];
            (cost[n][i], pick[n][i]) = if c < same { (c, k) } else { (same, 0) };
        }
    }

    let mut scratch = Vec::new();
    if pick[0][7] == u8::MAX {
        tree.root = LEAF;
        tree.leaves.push(leaf_of(nodes, primitives, 0, &mut scratch));
        return Some(tree);
    }
    tree.root = 0;
    tree.nodes.push(Node8::VACANT);
    // (binary node, wide node, depth of the wide node)
    let mut todo = vec![(0u32, 0u32, 1usize)];
    let mut children: Vec<u32> = Vec::with_capacity(WIDTH);
    let mut parts: Vec<(u32, usize)> = Vec::with_capacity(WIDTH);
    while let Some((n2, n8, depth)) = todo.pop() {
        tree.depth = tree.depth.max(depth);
        children.clear();
        let node = &nodes[n2 as usize];
        let k = pick[n2 as usize][7] as usize;
        parts.extend([(node.first_index + 1, WIDTH - k), (node.first_index, k)]);
        while let Some((n, mut slots)) = parts.pop() {
            while slots > 1 && pick[n as usize][slots - 1] == 0 {
                slots -= 1;
            }
            let node = &nodes[n as usize];
            if slots == 1 || node.is_leaf() {
                children.push(n);
            } else {
                let k = pick[n as usize][slots - 1] as usize;
                parts.extend([(node.first_index + 1, slots - k), (node.first_index, k)]);
            }
        }
        let pushed = todo.len();
        for (slot, &c) in children.iter().enumerate() {
            let child = if pick[c as usize][7] == u8::MAX {
                tree.leaves.push(leaf_of(nodes, primitives, c, &mut scratch));
                LEAF | (tree.leaves.len() as u32 - 1)
            } else {
                let id = tree.nodes.len() as u32;
                tree.nodes.push(Node8::VACANT);
                todo.push((c, id, depth + 1));
                id
            };
            let b = nodes[c as usize].aabb().into();
            tree.nodes[n8 as usize].set(slot, &b, child);
        }
        // Depth first from the first child on.
        todo[pushed..].reverse();
    }
    (tree.depth <= MAX_DEPTH).then_some(tree)
}

fn leaf_of(nodes: &[Bvh2Node], primitives: &[u32], root: u32, scratch: &mut Vec<u32>) -> LeafPrimitives {
    let mut out = LeafPrimitives { ids: [u32::MAX; WIDTH], len: 0 };
    scratch.clear();
    scratch.push(root);
    while let Some(n) = scratch.pop() {
        let node = &nodes[n as usize];
        if node.is_leaf() {
            for i in node.first_index..node.first_index + node.prim_count {
                let id = primitives[i as usize];
                if !out.as_slice().contains(&id) {
                    out.ids[out.len as usize] = id;
                    out.len += 1;
                }
            }
        } else {
            scratch.extend([node.first_index + 1, node.first_index]);
        }
    }
    out
}

/// Binary tree by object median, for input that defeats the locally ordered builder: depth ⌈log₂ n⌉, one primitive a leaf.
pub(crate) fn median_tree(boxes: &[obvhs::aabb::Aabb]) -> (Vec<Bvh2Node>, Vec<u32>) {
    let mut ids: Vec<u32> = (0..boxes.len() as u32).collect();
    if boxes.is_empty() {
        return (Vec::new(), ids);
    }
    let whole = |ids: &[u32]| ids.iter().fold(obvhs::aabb::Aabb::empty(), |b, &i| b.union(&boxes[i as usize]));
    let center = |i: u32, axis: usize| {
        let b = &boxes[i as usize];
        b.min[axis] * 0.5 + b.max[axis] * 0.5
    };
    let mut nodes = vec![Bvh2Node::new(whole(&ids), 0, 0)];
    let mut todo = vec![(0usize, 0usize, ids.len())];
    while let Some((n, from, to)) = todo.pop() {
        if to - from == 1 {
            nodes[n].prim_count = 1;
            nodes[n].first_index = from as u32;
            continue;
        }
        let part = &mut ids[from..to];
        let spread = |axis: usize| {
            let (lo, hi) = part.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(lo, hi), &i| {
                (lo.min(center(i, axis)), hi.max(center(i, axis)))
            });
            hi * 0.5 - lo * 0.5
        };
        let axis = (0..3).fold(0, |best, a| if spread(a) > spread(best) { a } else { best });
        let mid = part.len() / 2;
        part.select_nth_unstable_by(mid, |&a, &b| center(a, axis).total_cmp(&center(b, axis)).then(a.cmp(&b)));
        let first = nodes.len();
        nodes[n].first_index = first as u32;
        for (from, to) in [(from, from + mid), (from + mid, to)] {
            nodes.push(Bvh2Node::new(whole(&ids[from..to]), 0, 0));
            todo.push((nodes.len() - 1, from, to));
        }
    }
    (nodes, ids)
}
