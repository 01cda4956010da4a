//! Binary trees become eight-wide ones: dynamic programme over surface-area costs.
//!
//! Source: Ylitie, Karras & Laine, "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs", HPG 2017,
//! section 3.2 (optimal SAH collapse), here with leaves of up to eight triangles.

use super::binary::{Box4, Node2};
use super::node::{Bounds, EMPTY, LEAF, MAX_DEPTH, Node8, WIDTH};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

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

/// Primitives of one leaf.
#[derive(Clone, Copy)]
pub(crate) struct LeafPrimitives {
    ids: [u32; WIDTH],
    len: u8,
    surface: f32,
}

impl LeafPrimitives {
    pub fn as_slice(&self) -> &[u32] {
        &self.ids[..self.len as usize]
    }
}

/// `None`: too deep for the traversal stacks. Children are in the order in which a ray that asks for any hit should take them, see
/// [`order`].
/// * `boxes`: of the primitives by their numbers, with their surfaces
pub(crate) fn collapse(nodes: &[Node2], primitives: &[u32], boxes: &[Box4], costs: CollapseCosts) -> Option<WideTree> {
    let mut tree = WideTree { nodes: Vec::new(), root: EMPTY, bounds: Bounds::EMPTY, leaves: Vec::new(), depth: 0 };
    let Some(first) = nodes.first() else { return Some(tree) };
    tree.bounds = first.bounds().into();

    let choices: Vec<AtomicU64> = std::iter::repeat_with(AtomicU64::default).take(nodes.len()).collect();
    choose(&Choosing { nodes, costs, choices: &choices }, 0, PARALLEL_DEPTH);
    let pick = |n: u32| choices[n as usize].load(Ordering::Relaxed).to_le_bytes();

    let leaf_of = |&n: &u32| leaf_of(nodes, primitives, boxes, n);
    if pick(0)[7] == u8::MAX {
        tree.root = LEAF;
        tree.leaves.push(leaf_of(&0));
        return Some(tree);
    }
    // Binary nodes that become leaves.
    let mut leaves = Vec::new();
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
        let k = pick(n2)[7] as usize;
        parts.extend([(node.first() + 1, WIDTH - k), (node.first(), k)]);
        while let Some((n, mut slots)) = parts.pop() {
            while slots > 1 && pick(n)[slots - 1] == 0 {
                slots -= 1;
            }
            let node = &nodes[n as usize];
            if slots == 1 || node.is_leaf() {
                children.push(n);
            } else {
                let k = pick(n)[slots - 1] as usize;
                parts.extend([(node.first() + 1, slots - k), (node.first(), k)]);
            }
        }
        let pushed = todo.len();
        for (slot, &c) in children.iter().enumerate() {
            let child = if pick(c)[7] == u8::MAX {
                leaves.push(c);
                LEAF | (leaves.len() as u32 - 1)
            } else {
                let id = tree.nodes.len() as u32;
                tree.nodes.push(Node8::VACANT);
                todo.push((c, id, depth + 1));
                id
            };
            let b = nodes[c as usize].bounds().into();
            tree.nodes[n8 as usize].set(slot, &b, child);
        }
        // Depth first from the first child on.
        todo[pushed..].reverse();
    }
    tree.leaves = leaves.par_iter().with_min_len(256).map(leaf_of).collect();
    if tree.depth > MAX_DEPTH {
        return None;
    }
    order(&mut tree, costs);
    Some(tree)
}

/// What a ray that is in a box may expect there when any hit will do.
#[derive(Clone, Copy)]
struct Prospect {
    /// Probability of a hit.
    hit: f32,
    /// Cost until there is one, or until it is known that there is none.
    cost: f32,
}

/// Puts the children of each node in the order of hit by cost, best first: the order of least expected cost where they are
/// independent. A ray in a box of half area a meets a surface s that lies in it with a probability of s / a.
///
/// Source: Nah & Manocha, "SATO: Surface Area Traversal Order for Shadow Ray Tracing", CGF 2014, of two children and without costs.
fn order(tree: &mut WideTree, costs: CollapseCosts) {
    let leaves = &tree.leaves;
    let leaf = |id: u32, area: f32| {
        let LeafPrimitives { len, surface, .. } = leaves[id as usize];
        let hit = if surface < area { surface / area } else { 1.0 };
        Prospect { hit, cost: costs.leaf + costs.primitive * f32::from(len) }
    };
    let mut prospects = vec![Prospect { hit: 0.0, cost: 0.0 }; tree.nodes.len()];
    // Children come after their parents.
    for n in (0..tree.nodes.len()).rev() {
        let node = &tree.nodes[n];
        let whole = node.bounds().half_area() as f32;
        let mut children = [(0.0, 0.0, Prospect { hit: 0.0, cost: 0.0 }, 0usize); WIDTH];
        let mut count = 0;
        for slot in 0..WIDTH {
            let child = node.child[slot];
            if child == EMPTY {
                continue;
            }
            let area = node.slot_box(slot).half_area() as f32;
            let p = if child & LEAF != 0 { leaf(child & !LEAF, area) } else { prospects[child as usize] };
            let entered = if whole > 0.0 { area / whole } else { 1.0 };
            children[count] = (p.hit / p.cost, entered, p, slot);
            count += 1;
        }
        let children = &mut children[..count];
        children.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (mut missed, mut cost) = (1.0, 1.0);
        let mut ordered = Node8::VACANT;
        for (slot, (_, entered, p, from)) in children.iter().enumerate() {
            ordered.set(slot, &node.slot_box(*from), node.child[*from]);
            cost += missed * entered * p.cost;
            missed *= 1.0 - entered * p.hit;
        }
        prospects[n] = Prospect { hit: 1.0 - missed, cost };
        tree.nodes[n] = ordered;
    }
}

/// Levels of the binary tree whose two sides are chosen for in parallel.
const PARALLEL_DEPTH: u32 = 7;

struct Choosing<'a> {
    nodes: &'a [Node2],
    costs: CollapseCosts,
    /// By binary node eight bytes. Byte i below 7: children given to the left side where the subtree is at most i + 1
    /// children of one wide node, 0 = the same as with one fewer. Byte 7: what it is as a single child: `u8::MAX` a leaf,
    /// else a wide node whose left side gets that many children.
    choices: &'a [AtomicU64],
}

/// Of a subtree: its primitives, and the least cost as at most i + 1 children of one wide node.
#[derive(Clone, Copy)]
struct Subtree {
    count: u32,
    cost: [f32; 7],
}

/// Chooses for a subtree, its upper levels in parallel.
fn choose(c: &Choosing, root: u32, parallel: u32) -> Subtree {
    let node = &c.nodes[root as usize];
    if node.is_leaf() || parallel == 0 {
        return choose_in_turn(c, root);
    }
    let sides = [node.first(), node.first() + 1];
    let (left, right) = rayon::join(|| choose(c, sides[0], parallel - 1), || choose(c, sides[1], parallel - 1));
    choose_one(c, root, Some((left, right)))
}

/// Children before parents by a stack: a tree may be deep.
fn choose_in_turn(c: &Choosing, root: u32) -> Subtree {
    let mut done: Vec<Subtree> = Vec::with_capacity(64);
    let mut todo = vec![(root, false)];
    while let Some((n, sides_done)) = todo.pop() {
        let node = &c.nodes[n as usize];
        if node.is_leaf() {
            done.push(choose_one(c, n, None));
        } else if sides_done {
            let right = done.pop().expect("the right side was pushed last");
            let left = done.pop().expect("the left side was pushed before");
            done.push(choose_one(c, n, Some((left, right))));
        } else {
            todo.extend([(n, true), (node.first() + 1, false), (node.first(), false)]);
        }
    }
    done[0]
}

fn choose_one(c: &Choosing, n: u32, sides: Option<(Subtree, Subtree)>) -> Subtree {
    let (node, costs) = (&c.nodes[n as usize], &c.costs);
    let area = node.bounds().half_area();
    let leaf = |count: u32| {
        if count <= costs.max_leaf { area * (costs.leaf + costs.primitive * count as f32) } else { f32::INFINITY }
    };
    let mut pick = [0u8; 8];
    let count = sides.map_or(node.count(), |(l, r)| l.count + r.count);
    let (cl, cr) = match sides {
        // Pairs stay together: half of all nodes are done with here.
        Some((l, r)) if count > costs.max_leaf.min(2) => (l.cost, r.cost),
        _ => {
            pick[7] = u8::MAX;
            c.choices[n as usize].store(u64::from_le_bytes(pick), Ordering::Relaxed);
            return Subtree { count, cost: [leaf(count); 7] };
        }
    };
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
    let (as_leaf, as_node) = (leaf(count), area + inner);
    let is_leaf = count <= costs.max_leaf && as_leaf <= as_node;
    pick[7] = if is_leaf { u8::MAX } else { k };
    let mut cost = [if is_leaf { as_leaf } else { as_node }; 7];
    for i in 1..7 {
        let (c, k) = split(i + 1);
        let same = cost[i - 1];
        (cost[i], pick[i]) = if c < same { (c, k) } else { (same, 0) };
    }
    c.choices[n as usize].store(u64::from_le_bytes(pick), Ordering::Relaxed);
    Subtree { count, cost }
}

fn leaf_of(nodes: &[Node2], primitives: &[u32], boxes: &[Box4], root: u32) -> LeafPrimitives {
    let mut out = LeafPrimitives { ids: [u32::MAX; WIDTH], len: 0, surface: 0.0 };
    // A leaf has at most eight primitives, so that no more than eight nodes wait.
    let mut todo = [root; WIDTH];
    let mut waiting = 1;
    while waiting != 0 {
        waiting -= 1;
        let n = todo[waiting];
        let node = &nodes[n as usize];
        if node.is_leaf() {
            for i in node.first()..node.first() + node.count() {
                let id = primitives[i as usize];
                out.ids[out.len as usize] = id;
                out.len += 1;
                out.surface += boxes[id as usize].hi.w;
            }
        } else {
            todo[waiting] = node.first() + 1;
            todo[waiting + 1] = node.first();
            waiting += 2;
        }
    }
    out
}

/// Binary tree by object median, for input that defeats the surface-area builder: depth ⌈log₂ n⌉, one primitive a leaf.
pub(crate) fn median_tree(boxes: &[Box4]) -> (Vec<Node2>, Vec<u32>) {
    let mut ids: Vec<u32> = (0..boxes.len() as u32).collect();
    if boxes.is_empty() {
        return (Vec::new(), ids);
    }
    let whole = |ids: &[u32]| ids.iter().fold(Box4::EMPTY, |b, &i| b.union(&boxes[i as usize]));
    let center = |i: u32, axis: usize| {
        let b = &boxes[i as usize];
        b.lo[axis] * 0.5 + b.hi[axis] * 0.5
    };
    let mut nodes = vec![Node2::VACANT];
    let mut todo = vec![(0usize, 0usize, ids.len())];
    while let Some((n, from, to)) = todo.pop() {
        let b = whole(&ids[from..to]);
        if to - from == 1 {
            nodes[n] = Node2::new(&b, from as u32, 1);
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
        nodes[n] = Node2::new(&b, nodes.len() as u32, 0);
        todo.extend([(nodes.len(), from, from + mid), (nodes.len() + 1, from + mid, to)]);
        nodes.extend([Node2::VACANT; 2]);
    }
    (nodes, ids)
}
