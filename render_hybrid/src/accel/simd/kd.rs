//! One ray through a kd-tree: short stack with restart and push-down.
//!
//! Source: Horn, Sugerman, Houston & Hanrahan, "Interactive k-D Tree GPU Raytracing", I3D 2007. Padded cells overlap, so a
//! restart by distance could pass a cell or find the same one again; the way is kept as one bit a level instead (Laine,
//! "Restart Trail for Stackless BVH Traversal", HPG 2010): 1 where nothing more waits at that level.

use super::count;
use super::lanes::Level;
use super::single::Visitor;
use crate::accel::kdtree::{KD_LEAF, KdTree};
use crate::accel::ray_space::RaySpace;

/// Entries of the short stack; a power of two. The oldest is lost first, and found again by a restart.
const SHORT: usize = 8;

#[derive(Clone, Copy)]
struct Waiting {
    node: u32,
    level: u32,
    from: f32,
    to: f32,
}

/// Visits leaf blocks in the order of their cells along the ray. Returns true where the visitor ended it.
///
/// # Safety
/// The level's features; a tree as `validate` wants it, whose blocks are the visitor's.
#[inline(always)]
pub(super) unsafe fn walk<L: Level, V: Visitor<L>>(tree: &KdTree, ray: &RaySpace, t_min: f32, v: &mut V) -> bool {
    // Interval of the padded root cell.
    let plane = |a: usize, near: bool| {
        let b = &tree.bounds;
        if (ray.inv[a] < 0.0) == near { b.max[a] } else { b.min[a] }
    };
    let (mut from, mut to) = (t_min, f32::INFINITY);
    for a in 0..3 {
        from = from.max(plane(a, true) * ray.inv[a] - ray.near[a]);
        to = to.min(plane(a, false) * ray.inv[a] - ray.far[a]);
    }
    if !(from <= to) || tree.nodes.is_empty() {
        return false;
    }
    let mut root = Waiting { node: 0, level: 0, from, to };
    let mut stack = [root; SHORT];
    // Entries pushed and popped so far; those between are waiting, at most `SHORT` of them.
    let (mut top, mut held) = (0usize, 0usize);
    let mut done = 0u64;
    let mut at = root;
    // A walk from the restart node, on which only finished levels were passed yet.
    let mut pushing_down = true;
    loop {
        loop {
            // SAFETY: node numbers are in range by the tree's invariants.
            let node = unsafe { tree.nodes.get_unchecked(at.node as usize) };
            count::kd_node::<L>();
            if node.kind == KD_LEAF {
                for block in node.first..node.first + node.count {
                    // SAFETY: block numbers are in range by the tree's invariants; features by the caller.
                    if unsafe { v.leaf(block) } {
                        return true;
                    }
                }
                break;
            }
            let a = node.kind as usize % 3;
            let enter = node.plane * ray.inv[a] - ray.near[a];
            let leave = node.plane * ray.inv[a] - ray.far[a];
            let near = node.first + u32::from(ray.inv[a] < 0.0);
            let far = node.first + u32::from(ray.inv[a] >= 0.0);
            let bit = 1u64 << at.level;
            let level = at.level + 1;
            let behind = Waiting { node: far, level, from: at.from.max(enter), to: at.to };
            let ahead = Waiting { node: near, level, from: at.from, to: at.to.min(leave) };
            let (go_near, go_far) = (at.from <= leave, enter <= at.to);
            let finished = done & bit != 0;
            at = if go_near && go_far && !finished {
                stack[top % SHORT] = behind;
                top += 1;
                held = (held + 1).min(SHORT);
                pushing_down = false;
                ahead
            } else {
                done |= bit;
                // Both were open and the near side is finished, or only one is open.
                if go_far && (!go_near || finished) { behind } else { ahead }
            };
            if pushing_down {
                root = at;
            }
        }
        // Next: the deepest level where the far side still waits.
        loop {
            let path = ((1u64 << at.level) - 1) & !((1u64 << root.level) - 1);
            let waiting = !done & path;
            if waiting == 0 {
                return false;
            }
            let level = waiting.ilog2();
            done = done & ((1u64 << level) - 1) | 1u64 << level;
            if held > 0 {
                top -= 1;
                held -= 1;
                at = stack[top % SHORT];
                if at.from <= v.limit() {
                    break;
                }
            } else {
                at = root;
                pushing_down = true;
                break;
            }
        }
    }
}
