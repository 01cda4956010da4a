//! The packet on its way through a tree of either level.

use super::FEW;
use super::space::{Intervals, Rays, Sixteen, Space};
use crate::accel::node::{EMPTY, LEAF, Node8, STACK, WIDTH};
use crate::accel::simd::count;
use crate::accel::simd::lanes::{Lanes, Level};
use std::mem::MaybeUninit;

#[derive(Clone, Copy)]
struct Waiting {
    child: u32,
    /// No ray of the packet is in the box before it.
    t: f32,
    mask: u32,
    /// The least of the waiting is visited first.
    key: f32,
}

/// What a packet does at leaves and in narrow subtrees.
pub(super) trait PacketVisitor<L: Level> {
    /// Children are visited by the middle of the way through them, not by its start: a box that holds the others, as a room
    /// holds what stands in it, comes last, when most of it lies behind what was met.
    const BY_MIDDLE: bool;
    /// Any hit will do: of children that are entered at the same distance, the first goes first. Else it goes last: of boxes that all hold
    /// the rays' origin, the small ones are worth more.
    const ANY: bool;
    /// # Safety
    /// The level's features and a leaf of the visitor's tree.
    unsafe fn leaf(&mut self, rays: &mut Rays, leaf: u32, mask: u32);
    /// Walks a subtree for each ray alone; false where this tree has no such way.
    ///
    /// # Safety
    /// The level's features and a node of the visitor's tree.
    unsafe fn alone(&mut self, rays: &mut Rays, child: u32, mask: u32) -> bool;
}

/// # Safety
/// As for `single::walk`.
#[inline(always)]
pub(super) unsafe fn walk<L: Level, V: PacketVisitor<L>>(
    nodes: &[Node8],
    root: u32,
    space: &Space,
    rays: &mut Rays,
    mask: u32,
    visitor: &mut V,
) {
    let mut stack = [MaybeUninit::<Waiting>::uninit(); STACK];
    let mut entered = [const { MaybeUninit::<Sixteen>::uninit() }; WIDTH];
    // SAFETY: as for `single::walk`; what is read of `entered` was written for the same slot.
    unsafe {
        let stack = stack.as_mut_ptr().cast::<Waiting>();
        let [nx, ny, nz] = space.near_plane;
        let mut top;
        // A tree of one node: its leaves' boxes are tested ray by ray at once, which spares the intervals.
        let one_node = nodes.len() == 1 && root & LEAF == 0;
        let nodes = nodes.as_ptr();
        let mut intervals = Intervals::NONE;
        if one_node {
            top = enter_leaves::<L>(space, &*nodes, rays, mask, V::BY_MIDDLE, stack, &mut entered);
        } else {
            intervals = space.intervals::<L>(rays);
            top = 1;
            *stack = Waiting { child: root, t: f32::NEG_INFINITY, mask, key: 0.0 };
        }
        let Intervals { bounds: b, t_first, tight } = intervals;
        while top != 0 {
            top -= 1;
            let Waiting { mut child, t, mut mask, .. } = *stack.add(top);
            if one_node {
                mask &= entered.get_unchecked(child as usize).assume_init_ref().load::<L::W16>().le(rays.t.load());
                child = *(*nodes).child.as_ptr().add(child as usize);
            } else {
                if !(t <= rays.limit) {
                    continue;
                }
                mask &= L::W16::splat(t).le(rays.t.load());
            }
            if mask == 0 {
                continue;
            }
            if child & LEAF != 0 {
                visitor.leaf(rays, child & !LEAF, mask);
                continue;
            }
            if mask.count_ones() <= FEW && visitor.alone(rays, child, mask) {
                continue;
            }
            let node = &*nodes.add(child as usize);
            count::node::<L>(node);
            let planes = node.planes.as_ptr().cast::<f32>();
            let near = |i: usize, a: usize| {
                let p = L::W8::load(planes.add(8 * i));
                let low = p.slab(L::W8::splat(b[a][0]), L::W8::splat(b[a][2]));
                low.min(p.slab(L::W8::splat(b[a][1]), L::W8::splat(b[a][3])))
            };
            let far = |i: usize, a: usize| {
                let p = L::W8::load(planes.add(8 * i));
                let low = p.slab(L::W8::splat(b[a][0]), L::W8::splat(b[a][4]));
                low.max(p.slab(L::W8::splat(b[a][1]), L::W8::splat(b[a][5])))
            };
            let enter = near(nx, 0).max(near(ny, 1)).max(near(nz, 2)).max(L::W8::splat(t_first));
            let leave = far(nx ^ 1, 0).min(far(ny ^ 1, 1)).min(far(nz ^ 1, 2)).min(L::W8::splat(rays.limit));
            let mut children = enter.le(leave);
            let mut first = [0.0f32; 8];
            enter.store(first.as_mut_ptr());
            let mut keys = first;
            if V::BY_MIDDLE {
                enter.add(leave).store(keys.as_mut_ptr());
            }
            let base = top;
            while children != 0 {
                let slot = children.trailing_zeros() as usize;
                children &= children - 1;
                let child = *node.child.as_ptr().add(slot);
                let mut lanes = mask;
                if !tight || child & LEAF != 0 {
                    (lanes, ..) = space.lanes::<L>(node, slot, rays, mask);
                    if lanes == 0 {
                        continue;
                    }
                }
                let (t, key) = (*first.as_ptr().add(slot), *keys.as_ptr().add(slot));
                let mut i = top;
                let is_later = |k: f32| if V::ANY { k <= key } else { k < key };
                while i > base && is_later((*stack.add(i - 1)).key) {
                    *stack.add(i) = *stack.add(i - 1);
                    i -= 1;
                }
                *stack.add(i) = Waiting { child, t, mask: lanes, key };
                top += 1;
            }
        }
    }
}

/// Puts the leaves of a tree of one node on the stack, the first to visit on top: their slots in place of their
/// references, and where each ray enters them into `entered`. Returns how many.
///
/// # Safety
/// The level's features, room for eight.
#[inline(always)]
unsafe fn enter_leaves<L: Level>(
    space: &Space,
    node: &Node8,
    rays: &Rays,
    mask: u32,
    by_middle: bool,
    stack: *mut Waiting,
    entered: &mut [MaybeUninit<Sixteen>; WIDTH],
) -> usize {
    count::node::<L>(node);
    let mut top = 0;
    // SAFETY: by the contract.
    unsafe {
        for slot in 0..WIDTH {
            if node.child[slot] == EMPTY {
                continue;
            }
            let (lanes, enter, leave) = space.lanes::<L>(node, slot, rays, mask);
            if lanes == 0 {
                continue;
            }
            // One ray's word: the order is a matter of speed alone.
            let key = Sixteen::of(if by_middle { enter.add(leave) } else { enter });
            let key = *key.0.as_ptr().add(lanes.trailing_zeros() as usize);
            enter.store(entered.as_mut_ptr().add(slot).cast::<f32>());
            let mut i = top;
            while i > 0 && (*stack.add(i - 1)).key < key {
                *stack.add(i) = *stack.add(i - 1);
                i -= 1;
            }
            *stack.add(i) = Waiting { child: slot as u32, t: 0.0, mask: lanes, key };
            top += 1;
        }
    }
    top
}
