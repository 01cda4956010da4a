//! The thesis's tree: a kd-tree by the surface-area heuristic.
//!
//! The cost of splitting node N at v is C(v) = K_T + C_l(v) + C_r(v), with
//! C_l(v) = K_I n_l(v) [2 (s1 + s2)(v − v_min) + 2 s1 s2] / SA(N) and C_r alike with (v_max − v); s1, s2 are the node's extents
//! on the other two axes, n_l and n_r the triangles on either side (Popov et al., "Experiences with Streaming Construction
//! of SAH KD-Trees", 2006). Candidates are the sorted triangle bounds. A node is a leaf at [`MIN_TRIANGLES`], at the
//! greatest depth, or where no split costs less than its triangles.

use super::node::{Bounds, Tri8, WIDTH};
use catoptra_engine::mesh::Mesh;

/// K_T against K_I = 1.
const TRAVERSAL: f64 = 3.0;
/// Fewer are not split.
const MIN_TRIANGLES: usize = WIDTH;
/// No tree is deeper: a traversal keeps one bit a level.
pub(crate) const MAX_DEPTH: u32 = 48;
/// `KdNode::kind` of a leaf; 0, 1, 2 are split axes.
pub(crate) const KD_LEAF: u32 = 3;

/// A split (children `first`, `first + 1`: below and above `plane`) or a leaf (blocks `first .. first + count`).
#[derive(Clone, Copy, Debug)]
#[repr(C, align(16))]
pub(crate) struct KdNode {
    pub plane: f32,
    pub kind: u32,
    pub first: u32,
    pub count: u32,
}

/// Nodes from the root on; empty for a mesh without triangles.
pub(crate) struct KdTree {
    pub nodes: Vec<KdNode>,
    pub bounds: Bounds,
}

/// The tree and its blocks.
pub(crate) fn build(mesh: &Mesh) -> (KdTree, Vec<Tri8>) {
    let boxes: Vec<Bounds> = (0..mesh.triangles().len() as u32)
        .map(|i| {
            mesh.corners(i).iter().fold(Bounds::EMPTY, |b, p| b.union(Bounds { min: p.to_array(), max: p.to_array() }))
        })
        .collect();
    let bounds = Bounds::from(mesh.bounds_object());
    let mut tree = KdTree { nodes: Vec::new(), bounds };
    let mut blocks = Vec::new();
    if boxes.is_empty() {
        return (tree, blocks);
    }
    // The usual bound: Pharr & Humphreys 2004, section 4.4.
    let max_depth = (8 + (1.3 * f64::from(usize::BITS - boxes.len().leading_zeros())) as u32).min(MAX_DEPTH);
    let blank = KdNode { plane: 0.0, kind: KD_LEAF, first: 0, count: 0 };
    tree.nodes.push(blank);
    let mut todo = vec![(0usize, bounds, (0..boxes.len() as u32).collect::<Vec<u32>>(), 0u32)];
    while let Some((at, cell, ids, depth)) = todo.pop() {
        let split = if ids.len() > MIN_TRIANGLES && depth < max_depth { best_split(&boxes, &cell, &ids) } else { None };
        let Some((axis, plane)) = split else {
            tree.nodes[at] = KdNode { first: blocks.len() as u32, count: ids.len().div_ceil(WIDTH) as u32, ..blank };
            for part in ids.chunks(WIDTH) {
                let mut block = Tri8::VACANT;
                for (lane, &prim) in part.iter().enumerate() {
                    block.set(lane, mesh.corners(prim), prim);
                }
                blocks.push(block);
            }
            continue;
        };
        let side = |keep: &dyn Fn(f32, f32) -> bool| -> Vec<u32> {
            let span = |&&i: &&u32| keep(boxes[i as usize].min[axis], boxes[i as usize].max[axis]);
            ids.iter().filter(span).copied().collect()
        };
        let below = side(&|lo, hi| lo < plane || hi <= plane);
        let above = side(&|lo, hi| hi > plane || lo >= plane);
        let first = tree.nodes.len();
        tree.nodes[at] = KdNode { plane, kind: axis as u32, first: first as u32, count: 0 };
        tree.nodes.extend([blank, blank]);
        let (mut low, mut high) = (cell, cell);
        low.max[axis] = plane;
        high.min[axis] = plane;
        todo.push((first + 1, high, above, depth + 1));
        todo.push((first, low, below, depth + 1));
    }
    (tree, blocks)
}

/// Axis and plane of least cost, where that is less than the cost of a leaf.
fn best_split(boxes: &[Bounds], cell: &Bounds, ids: &[u32]) -> Option<(usize, f32)> {
    let size = [0, 1, 2].map(|a| f64::from(cell.max[a]) - f64::from(cell.min[a]));
    let area = 2.0 * (size[0] * size[1] + size[1] * size[2] + size[2] * size[0]);
    if !(area > 0.0) {
        return None;
    }
    let n = ids.len();
    let mut best = (n as f64, 0, 0.0f32);
    for axis in 0..3 {
        let (s1, s2) = (size[(axis + 1) % 3], size[(axis + 2) % 3]);
        let sorted = |f: &dyn Fn(&Bounds) -> f32| {
            let mut v: Vec<f32> = ids.iter().map(|&i| f(&boxes[i as usize])).collect();
            v.sort_unstable_by(f32::total_cmp);
            v
        };
        let (starts, ends) = (sorted(&|b| b.min[axis]), sorted(&|b| b.max[axis]));
        // Both lists are walked together; `started` begin before v, `ended` end before v.
        let (mut started, mut ended) = (0, 0);
        let (mut i, mut j) = (0, 0);
        while i < n || j < n {
            let v = match (starts.get(i), ends.get(j)) {
                (Some(&a), Some(&b)) => a.min(b),
                (Some(&a), None) => a,
                (None, Some(&b)) => b,
                (None, None) => break,
            };
            while started < n && starts[started] < v {
                started += 1;
            }
            while ended < n && ends[ended] < v {
                ended += 1;
            }
            while i < n && starts[i] <= v {
                i += 1;
            }
            while j < n && ends[j] <= v {
                j += 1;
            }
            if !(v > cell.min[axis] && v < cell.max[axis]) {
                continue;
            }
            // Below: begins before v. Above: ends after v. What lies in the plane goes to both sides, few as it is.
            let flat = (j - ended).min(i - started);
            let (below, above) = (started + flat, n - j + flat);
            let inner = |d: f64| 2.0 * (s1 + s2) * d + 2.0 * s1 * s2;
            let (l, r) = (f64::from(v) - f64::from(cell.min[axis]), f64::from(cell.max[axis]) - f64::from(v));
            let cost = TRAVERSAL + (below as f64 * inner(l) + above as f64 * inner(r)) / area;
            if cost < best.0 {
                best = (cost, axis, v);
            }
        }
    }
    (best.0 < n as f64).then_some((best.1, best.2))
}

impl KdTree {
    /// What is wrong with the tree, if anything: references, cells, and that each cell lists what overlaps it.
    pub fn validate(&self, mesh: &Mesh, blocks: &[Tri8]) -> Result<(), String> {
        let mut seen = vec![false; mesh.triangles().len()];
        let mut todo = Vec::new();
        if !self.nodes.is_empty() {
            todo.push((0u32, self.bounds, 0));
        }
        let mut visited = 0;
        while let Some((n, cell, depth)) = todo.pop() {
            let node = self.nodes.get(n as usize).ok_or("a child names no node")?;
            visited += 1;
            if depth > MAX_DEPTH {
                return Err("too deep".into());
            }
            if node.kind == KD_LEAF {
                let blocks = blocks.get(node.first as usize..(node.first + node.count) as usize);
                for block in blocks.ok_or("a leaf names no block")? {
                    for lane in 0..block.len() {
                        let corners = [0, 1, 2].map(|v| glam::Vec3::from(block.corner(v, lane)));
                        if mesh.corners(block.prim[lane]) != corners {
                            return Err("block holds a wrong triangle".into());
                        }
                        seen[block.prim[lane] as usize] = true;
                    }
                }
                continue;
            }
            let axis = node.kind as usize;
            if axis > 2 || !(cell.min[axis] < node.plane && node.plane < cell.max[axis]) {
                return Err("a plane does not divide its cell".into());
            }
            let (mut low, mut high) = (cell, cell);
            low.max[axis] = node.plane;
            high.min[axis] = node.plane;
            todo.extend([(node.first, low, depth + 1), (node.first + 1, high, depth + 1)]);
        }
        if visited != self.nodes.len() {
            return Err("nodes are out of reach".into());
        }
        match seen.iter().position(|s| !s) {
            Some(prim) => Err(format!("triangle {prim} is in no leaf")),
            None => Ok(()),
        }
    }
}
