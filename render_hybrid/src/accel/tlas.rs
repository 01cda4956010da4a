//! The upper level: a wide tree over instances that follows moves, insertions and removals in place.
//!
//! A move rewrites the leaf's box and the boxes of its ancestors, each ancestor once a batch, stopping where a box did not
//! change. When the surface-area cost has grown past [`REBUILD_FACTOR`] times its value at the last build, the tree is
//! built anew (instances only: no mesh tree is touched).

use super::binary::{Box4, Node2};
use super::node::{Bounds, EMPTY, LEAF, MAX_DEPTH, Node8, WIDTH};
use super::wide::{CollapseCosts, collapse, median_tree};
use glam::Vec3A;
use obvhs::aabb::Aabb;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

/// Growth of the surface-area cost that triggers a rebuild.
pub(crate) const REBUILD_FACTOR: f64 = 1.6;

const NOWHERE: u32 = u32::MAX;
const COSTS: CollapseCosts = CollapseCosts { max_leaf: 1, leaf: 0.0, primitive: 2.0 };

/// Tree over instance slots; leaf reference n is slot n.
pub(crate) struct Tlas {
    pub nodes: Vec<Node8>,
    /// A node (always 0), or [`EMPTY`].
    pub root: u32,
    /// `node * 8 + slot` in the parent; [`NOWHERE`] for the root.
    parent: Vec<u32>,
    depth: Vec<u8>,
    free: Vec<u32>,
    /// Per instance slot: `node * 8 + slot`, [`NOWHERE`] where the instance is not in the tree.
    place: Vec<u32>,
    /// Sum of half areas of all slots.
    area: f64,
    built_cost: f64,
    dirty: Vec<Vec<u32>>,
    is_dirty: Vec<bool>,
}

impl Tlas {
    pub fn new() -> Self {
        Self {
            nodes: Vec::new(),
            root: EMPTY,
            parent: Vec::new(),
            depth: Vec::new(),
            free: Vec::new(),
            place: Vec::new(),
            area: 0.0,
            built_cost: 0.0,
            dirty: vec![Vec::new(); MAX_DEPTH + 1],
            is_dirty: Vec::new(),
        }
    }

    /// Builds over all boxes that are not empty; returns the number of nodes.
    pub fn build(&mut self, boxes: &[Bounds]) -> u32 {
        let slots: Vec<u32> = (0..boxes.len() as u32).filter(|&s| !boxes[s as usize].is_empty()).collect();
        let aabbs: Vec<Aabb> = slots
            .iter()
            .map(|&s| Aabb::new(Vec3A::from(boxes[s as usize].min), Vec3A::from(boxes[s as usize].max)))
            .collect();
        // As if a box were full.
        let full = |b: &Aabb| {
            let b = Box4::from(b);
            Box4 { hi: b.hi.with_w(b.half_area()), ..b }
        };
        let filled: Vec<Box4> = aabbs.iter().map(full).collect();
        self.place.clear();
        self.place.resize(boxes.len(), NOWHERE);
        let extent = slots.iter().fold(0.0f32, |m, &s| m.max(boxes[s as usize].extent()));
        let tree = if aabbs.len() > WIDTH && extent < 1e15 {
            let bvh2 = PlocBuilder::with_capacity(aabbs.len()).build(
                PlocSearchDistance::Low,
                &aabbs,
                (0..aabbs.len() as u32).collect(),
                SortPrecision::U64,
                2,
            );
            let nodes: Vec<Node2> = bvh2.nodes.iter().map(Node2::from).collect();
            collapse(&nodes, &bvh2.primitive_indices, &filled, COSTS)
        } else {
            None
        };
        let tree = tree.unwrap_or_else(|| {
            let (nodes, ids) = median_tree(&filled);
            collapse(&nodes, &ids, &filled, COSTS).expect("a median tree is shallow")
        });
        self.nodes = tree.nodes;
        self.root = tree.root;
        if self.root & LEAF != 0 && self.root != EMPTY {
            // One instance: a node all the same, so that it can be moved and joined.
            let mut node = Node8::VACANT;
            node.set(0, &tree.bounds, LEAF);
            self.nodes = vec![node];
            self.root = 0;
        }
        self.free.clear();
        self.parent = vec![NOWHERE; self.nodes.len()];
        self.depth = vec![0; self.nodes.len()];
        self.is_dirty = vec![false; self.nodes.len()];
        // Marks of the old tree name nodes that may be gone.
        self.dirty.iter_mut().for_each(Vec::clear);
        self.area = 0.0;
        // Children come after their parents here.
        for n in 0..self.nodes.len() {
            for slot in 0..WIDTH {
                let at = (n * WIDTH + slot) as u32;
                let child = self.nodes[n].child[slot];
                if child == EMPTY {
                    continue;
                }
                self.area += self.nodes[n].slot_box(slot).half_area();
                if child & LEAF != 0 {
                    let leaf = tree.leaves[(child & !LEAF) as usize].as_slice()[0];
                    let instance = slots[leaf as usize];
                    self.nodes[n].child[slot] = LEAF | instance;
                    self.place[instance as usize] = at;
                } else {
                    self.parent[child as usize] = at;
                    self.depth[child as usize] = self.depth[n] + 1;
                }
            }
        }
        self.built_cost = self.cost();
        self.nodes.len() as u32
    }

    /// Surface-area cost relative to the whole scene's box.
    pub fn cost(&self) -> f64 {
        if self.root == EMPTY {
            return 0.0;
        }
        let whole = self.nodes[self.root as usize].bounds().half_area();
        if whole > 0.0 { self.area / whole } else { 0.0 }
    }

    /// The cost has grown past the factor.
    pub fn degraded(&self) -> bool {
        let cost = self.cost();
        cost.is_finite() && cost > self.built_cost.max(1.0) * REBUILD_FACTOR
    }

    fn write(&mut self, at: u32, b: &Bounds) {
        let (n, slot) = (at as usize / WIDTH, at as usize % WIDTH);
        let node = &mut self.nodes[n];
        self.area += b.half_area() - node.slot_box(slot).half_area();
        node.set_box(slot, b);
        self.mark(n as u32);
    }

    fn mark(&mut self, n: u32) {
        if !self.is_dirty[n as usize] {
            self.is_dirty[n as usize] = true;
            self.dirty[self.depth[n as usize] as usize].push(n);
        }
    }

    /// New box of an instance that is in the tree; ancestors follow in [`Self::settle`].
    pub fn moved(&mut self, instance: u32, b: &Bounds) {
        self.write(self.place[instance as usize], b);
    }

    pub fn holds(&self, instance: u32) -> bool {
        self.place.get(instance as usize).is_some_and(|&p| p != NOWHERE)
    }

    /// Recomputes the ancestors of everything that changed; returns the number of nodes touched.
    pub fn settle(&mut self) -> u32 {
        let mut touched = 0;
        for level in (0..self.dirty.len()).rev() {
            let mut list = std::mem::take(&mut self.dirty[level]);
            for n in list.drain(..) {
                if !std::mem::take(&mut self.is_dirty[n as usize]) {
                    continue; // Freed meanwhile.
                }
                touched += 1;
                let up = self.parent[n as usize];
                if up != NOWHERE {
                    let b = self.nodes[n as usize].bounds();
                    if self.nodes[up as usize / WIDTH].slot_box(up as usize % WIDTH) != b {
                        self.write(up, &b);
                    }
                }
            }
            self.dirty[level] = list;
        }
        touched
    }

    /// Takes an instance out. Nodes that lose their last child go too.
    pub fn remove(&mut self, instance: u32) {
        let mut at = std::mem::replace(&mut self.place[instance as usize], NOWHERE);
        loop {
            let (n, slot) = (at as usize / WIDTH, at as usize % WIDTH);
            self.area -= self.nodes[n].slot_box(slot).half_area();
            self.nodes[n].set(slot, &Bounds::EMPTY, EMPTY);
            if self.nodes[n].child.iter().any(|&c| c != EMPTY) {
                return self.mark(n as u32);
            }
            at = self.parent[n];
            if at == NOWHERE {
                self.is_dirty[n] = false;
                self.root = EMPTY;
                self.nodes.clear();
                self.free.clear();
                self.parent.clear();
                self.depth.clear();
                self.is_dirty.clear();
                self.dirty.iter_mut().for_each(Vec::clear);
                self.area = 0.0;
                return;
            }
            self.is_dirty[n] = false;
            self.free.push(n as u32);
        }
    }

    /// Puts an instance in, down the path whose boxes grow least. Returns false where the tree has become too deep: build
    /// anew.
    pub fn insert(&mut self, instance: u32, b: &Bounds) -> bool {
        if self.place.len() <= instance as usize {
            self.place.resize(instance as usize + 1, NOWHERE);
        }
        if self.root == EMPTY {
            self.root = self.new_node(NOWHERE, 0);
        }
        let mut n = self.root as usize;
        loop {
            if let Some(slot) = self.nodes[n].child.iter().position(|&c| c == EMPTY) {
                self.put_leaf(n, slot, instance, b);
                return true;
            }
            let growth = |slot: usize| {
                let old = self.nodes[n].slot_box(slot);
                // Growth first, then size: descend where it costs least.
                let new = old.union(*b).half_area();
                (new - old.half_area(), new)
            };
            let slot = (1..WIDTH).fold(0, |best, s| if growth(s) < growth(best) { s } else { best });
            let child = self.nodes[n].child[slot];
            if child & LEAF == 0 {
                n = child as usize;
                continue;
            }
            // A leaf in the way: both go into a node of their own.
            if usize::from(self.depth[n]) + 2 > MAX_DEPTH {
                return false;
            }
            let old = self.nodes[n].slot_box(slot);
            let inner = self.new_node((n * WIDTH + slot) as u32, self.depth[n] + 1);
            self.nodes[n].child[slot] = inner;
            self.put_leaf(inner as usize, 0, child & !LEAF, &old);
            self.put_leaf(inner as usize, 1, instance, b);
            return true;
        }
    }

    fn put_leaf(&mut self, n: usize, slot: usize, instance: u32, b: &Bounds) {
        self.nodes[n].set(slot, b, LEAF | instance);
        self.area += b.half_area();
        self.place[instance as usize] = (n * WIDTH + slot) as u32;
        self.mark(n as u32);
    }

    fn new_node(&mut self, parent: u32, depth: u8) -> u32 {
        let n = self.free.pop().unwrap_or_else(|| {
            self.nodes.push(Node8::VACANT);
            self.parent.push(NOWHERE);
            self.depth.push(0);
            self.is_dirty.push(false);
            self.nodes.len() as u32 - 1
        });
        self.nodes[n as usize] = Node8::VACANT;
        self.parent[n as usize] = parent;
        self.depth[n as usize] = depth;
        n
    }

    /// What is wrong with the tree, if anything.
    pub fn validate(&self, boxes: &[Bounds]) -> Result<(), String> {
        let mut found = vec![false; boxes.len()];
        let mut area = 0.0;
        let mut todo = Vec::new();
        if self.root != EMPTY {
            todo.push((self.root, Bounds { min: [f32::NEG_INFINITY; 3], max: [f32::INFINITY; 3] }, NOWHERE, 0u8));
        }
        while let Some((n, bounds, parent, depth)) = todo.pop() {
            let node = self.nodes.get(n as usize).ok_or("a child names no node")?;
            if self.parent[n as usize] != parent || self.depth[n as usize] != depth || usize::from(depth) > MAX_DEPTH {
                return Err(format!("node {n} has a wrong parent or depth"));
            }
            if depth > 0 && node.bounds() != bounds {
                return Err(format!("node {n}'s box in its parent is not the box of its children"));
            }
            for slot in 0..WIDTH {
                let (child, b, at) = (node.child[slot], node.slot_box(slot), n * WIDTH as u32 + slot as u32);
                if child == EMPTY {
                    continue;
                }
                area += b.half_area();
                if child & LEAF == 0 {
                    todo.push((child, b, at, depth + 1));
                    continue;
                }
                let instance = (child & !LEAF) as usize;
                if boxes.get(instance) != Some(&b) || self.place[instance] != at || found[instance] {
                    return Err(format!("leaf of instance {instance} is wrong"));
                }
                found[instance] = true;
            }
        }
        if let Some(i) = (0..boxes.len()).find(|&i| found[i] == boxes[i].is_empty()) {
            return Err(format!("instance {i} is wrongly in or out of the tree"));
        }
        if (area - self.area).abs() > 1e-6 * (1.0 + area) {
            return Err(format!("the surface-area cost drifted: {} for {area}", self.area));
        }
        Ok(())
    }
}
