//! Binary trees are improved by putting subtrees elsewhere.
//!
//! Source: Meister & Bittner, "Parallel Reinsertion for Bounding Volume Hierarchy Optimization", Eurographics 2018. Here from the top of
//! the tree, which most rays see.

use super::binary::{Box4, Node2};
use rayon::prelude::*;
use std::collections::BinaryHeap;

/// A subtree that would better be next to another.
#[derive(Clone, Copy)]
struct Move {
    /// Of surface area over the tree, half areas.
    gain: f32,
    from: u32,
    to: u32,
}

struct Tree<'a> {
    nodes: &'a mut [Node2],
    parents: Vec<u32>,
}

fn sibling(n: u32) -> u32 {
    ((n - 1) ^ 1) + 1
}

/// Searches better places for the `count` subtrees of the greatest boxes, at most `rounds` times. Children lie as [`Node2`] has it. The search runs
/// on all threads; moves are made one after the other, the best first, so that the result is the same on any number of them.
pub(crate) fn improve(nodes: &mut [Node2], count: usize, rounds: usize) {
    if nodes.len() < 5 {
        return;
    }
    let mut parents = vec![0; nodes.len()];
    for (n, node) in nodes.iter().enumerate() {
        if !node.is_leaf() && node.first() != 0 {
            parents[node.first() as usize] = n as u32;
            parents[node.first() as usize + 1] = n as u32;
        }
    }
    let mut tree = Tree { nodes, parents };
    let mut touched = vec![0u32; tree.nodes.len()];
    let (mut candidates, mut moves) = (Vec::new(), Vec::new());
    let mut least = 0.0;
    for round in 1..=rounds as u32 {
        if round % 8 == 1 {
            least = tree.least_of(count);
        }
        tree.greater_than(least, &mut candidates);
        candidates.par_iter().with_min_len(32).map(|&n| tree.find(n)).collect_into_vec(&mut moves);
        moves.retain(|m| m.gain > 0.0);
        if moves.is_empty() {
            return;
        }
        moves.sort_unstable_by(|a, b| b.gain.total_cmp(&a.gain).then(a.from.cmp(&b.from)));
        for m in &moves {
            let parent = |n: u32| tree.parents[n as usize];
            let part = [m.to, m.from, sibling(m.from), parent(m.to), parent(m.from)];
            if part.iter().all(|&n| touched[n as usize] != round) {
                part.iter().for_each(|&n| touched[n as usize] = round);
                tree.apply(m.from, m.to);
            }
        }
    }
}

impl Tree<'_> {
    fn bounds(&self, n: u32) -> Box4 {
        self.nodes[n as usize].bounds()
    }

    /// Area of the node number `count` by size.
    fn least_of(&self, count: usize) -> f32 {
        // Areas are at least 0, so that they are ordered as their bits are.
        let key = |n: u32| (self.bounds(n).half_area().to_bits(), n);
        let mut heap = BinaryHeap::from([key(0)]);
        let mut left = count;
        while let Some((area, n)) = heap.pop() {
            if left == 0 {
                return f32::from_bits(area);
            }
            left -= 1;
            let node = &self.nodes[n as usize];
            if !node.is_leaf() {
                heap.extend([key(node.first()), key(node.first() + 1)]);
            }
        }
        0.0
    }

    /// Nodes of at least this area but the root and its children.
    fn greater_than(&self, least: f32, out: &mut Vec<u32>) {
        out.clear();
        let mut todo = vec![self.nodes[0].first() + 1, self.nodes[0].first()];
        while let Some(n) = todo.pop() {
            let node = &self.nodes[n as usize];
            if node.bounds().half_area() < least {
                continue;
            }
            out.push(n);
            if !node.is_leaf() {
                todo.extend([node.first() + 1, node.first()]);
            }
        }
    }

    /// The best place for a subtree: depth first with bounds.
    fn find(&self, from: u32) -> Move {
        let b = self.bounds(from);
        let own = b.half_area();
        let parent = self.parents[from as usize];
        let mut best = Move { gain: 0.0, from, to: 0 };
        let mut stack = Vec::with_capacity(64);
        let mut next = sibling(from);
        let mut pivot = parent;
        let mut without = self.bounds(next);
        // What is saved so far by the removal.
        let mut saved = self.bounds(parent).half_area();
        loop {
            // A subtree is worth a look while even a place that costs nothing but the box itself would be better.
            let look = |n: u32, saved: f32, best: &mut Move, stack: &mut Vec<(f32, u32)>| {
                let node = &self.nodes[n as usize];
                let bounds = node.bounds();
                let gain = saved - bounds.union(&b).half_area();
                if gain > best.gain {
                    (best.gain, best.to) = (gain, n);
                }
                let below = gain + bounds.half_area();
                if !node.is_leaf() && below - own > best.gain {
                    stack.push((below, node.first()));
                }
            };
            if saved - own > best.gain {
                look(next, saved, &mut best, &mut stack);
            }
            while let Some((saved, first)) = stack.pop() {
                if saved - own > best.gain {
                    look(first, saved, &mut best, &mut stack);
                    look(first + 1, saved, &mut best, &mut stack);
                }
            }
            if pivot != parent {
                without = without.union(&self.bounds(next));
                saved += self.bounds(pivot).half_area() - without.half_area();
            }
            if pivot == 0 {
                break;
            }
            next = sibling(pivot);
            pivot = self.parents[pivot as usize];
        }
        if best.to == 0 || best.to == parent || best.to == sibling(from) {
            best.gain = 0.0;
        }
        best
    }

    /// `to`'s place is taken by a parent of `from` and of what was there, which goes where the sibling of `from` was; the sibling goes
    /// where their parent was.
    fn apply(&mut self, from: u32, to: u32) {
        let (beside, parent) = (sibling(from), self.parents[from as usize]);
        let (sibling_node, there) = (self.nodes[beside as usize], self.nodes[to as usize]);
        let pair = from.min(beside);
        self.set(to, Node2::new(&there.bounds().union(&self.bounds(from)), pair, 0));
        self.set(beside, there);
        self.set(parent, sibling_node);
        self.shrink_or_grow(parent);
        self.shrink_or_grow(to);
    }

    fn set(&mut self, n: u32, node: Node2) {
        self.nodes[n as usize] = node;
        if !node.is_leaf() {
            self.parents[node.first() as usize] = n;
            self.parents[node.first() as usize + 1] = n;
        }
    }

    /// Boxes of the ancestors.
    fn shrink_or_grow(&mut self, mut n: u32) {
        while n != 0 {
            n = self.parents[n as usize];
            let first = self.nodes[n as usize].first();
            let b = self.bounds(first).union(&self.bounds(first + 1));
            if b.same(&self.bounds(n)) {
                break;
            }
            self.nodes[n as usize] = Node2::new(&b, first, 0);
        }
    }
}
