//! Tallies of what traversals test. Kernels call these under `if L::COUNT`, so that every other level has no trace of them.

use super::lanes::Level;
use crate::accel::TraversalCounts;
use crate::accel::node::{EMPTY, Node8};
use std::cell::Cell;

thread_local! {
    static TALLY: Cell<TraversalCounts> = const { Cell::new(TraversalCounts::NONE) };
}

/// A wide node was tested.
#[inline(always)]
pub(super) fn node<L: Level>(node: &Node8) {
    if L::COUNT {
        let boxes = node.child.iter().filter(|&&c| c != EMPTY).count() as u64;
        TALLY.with(|t| t.set(TraversalCounts { nodes: 1, boxes, ..TraversalCounts::NONE } + t.get()));
    }
}

/// A node of a kd-tree was passed.
#[inline(always)]
pub(super) fn kd_node<L: Level>() {
    if L::COUNT {
        TALLY.with(|t| t.set(TraversalCounts { nodes: 1, ..TraversalCounts::NONE } + t.get()));
    }
}

/// `triangles` of one block were tested.
#[inline(always)]
pub(super) fn block<L: Level>(triangles: u32) {
    if L::COUNT {
        let triangles = u64::from(triangles);
        TALLY.with(|t| t.set(TraversalCounts { blocks: 1, triangles, ..TraversalCounts::NONE } + t.get()));
    }
}

/// What this thread has tallied since the last call.
pub(super) fn take() -> TraversalCounts {
    TALLY.with(|t| t.replace(TraversalCounts::NONE))
}
