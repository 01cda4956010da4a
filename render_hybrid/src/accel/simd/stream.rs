//! Rays that have nothing in common, several side by side, each on its own way through the trees.
//!
//! One ray alone waits: for the node, for its arithmetic, and at each branch that is guessed wrongly. So up to [`SLOTS`] rays
//! take turns, and each turn does one kind of work for all of them without a branch in between: nodes are tested and the children that
//! are met go sorted onto each ray's stack; blocks are tested; only then are hits looked at and the next node or block taken from
//! each stack and asked for, which is read a whole turn later. A ray that is done makes room for the next.

use super::count;
use super::lanes::{Lanes, Level};
use super::single::{BlasClosest, Sheared, accept, candidates8, tree};
use crate::accel::node::{BLOCK, EMPTY, LEAF, Node8, STACK, Tri8};
use crate::accel::ray_space::RaySpace;
use crate::accel::world::World;
use crate::accel::{Hit, Ray};
use std::mem::MaybeUninit;

/// Rays side by side.
const SLOTS: usize = 16;
/// Both levels' stacks, and what a push of eight writes beyond.
const DEPTH: usize = 2 * STACK + 8;

/// One ray on its way.
#[repr(C, align(64))]
struct Slot {
    /// In the tree that it is in.
    space: RaySpace,
    sheared: Sheared,
    t_min: f32,
    t_max: f32,
    best: Hit,
    nodes: *const Node8,
    blocks: *const Tri8,
    /// Node or leaf to be tested.
    current: u32,
    instance_id: u32,
    top: usize,
    /// Where the stack of the tree that it is in begins.
    base: usize,
    /// In an instance, with the upper tree still to be gone on with.
    inside: bool,
    /// Number of the ray.
    number: u32,
    mask: u32,
    hard: u32,
    tuv: [[f32; 8]; 3],
    /// In the upper tree.
    above: RaySpace,
    origin: [f32; 3],
    direction: [f32; 3],
    /// Its stack: children, and where the ray enters them.
    child: *mut u32,
    t: *mut f32,
}

/// Room for one ray's stack.
type Stack = (MaybeUninit<[u32; DEPTH]>, MaybeUninit<[f32; DEPTH]>);

/// Traces all rays of a feed.
///
/// # Safety
/// The level's features; as for [`closest`].
#[inline(always)]
unsafe fn run<L: Level>(feed: &mut Numbered) {
    let mut slots = [const { MaybeUninit::<Slot>::uninit() }; SLOTS];
    let mut stacks = [const { (MaybeUninit::uninit(), MaybeUninit::uninit()) }; SLOTS];
    // SAFETY: `live` names slots that were written, and of a stack only what was written is read; features and trees by the caller.
    unsafe {
        let slots = slots.as_mut_ptr().cast::<Slot>();
        // Slots that will test a node, and a block; slots with a ray.
        let (mut nodes, mut leaves, mut live) = ([0u8; SLOTS], [0u8; SLOTS], [0u8; SLOTS]);
        let (mut n, mut l, mut lives) = (0, 0, 0);
        while lives < SLOTS && !feed.left.as_slice().is_empty() {
            let slot = slots.add(lives);
            slot.write(Slot::vacant(&mut stacks[lives]));
            feed.next::<L>(&mut *slot);
            live[lives] = lives as u8;
            lives += 1;
        }
        loop {
            let mut i = 0;
            while i < lives {
                let s = *live.get_unchecked(i);
                i += 1;
                let slot = &mut *slots.add(s as usize);
                loop {
                    if slot.top == slot.base {
                        if slot.inside
                            && let Some(world) = feed.upper()
                        {
                            slot.space = slot.above;
                            slot.nodes = world.tlas.nodes.as_ptr();
                            slot.base = 0;
                            slot.inside = false;
                            continue;
                        }
                        feed.done(slot);
                        if feed.next::<L>(slot) {
                            continue;
                        }
                        lives -= 1;
                        i -= 1;
                        *live.get_unchecked_mut(i) = *live.get_unchecked(lives);
                        break;
                    }
                    slot.top -= 1;
                    if !(*slot.t.add(slot.top) <= slot.best.t) {
                        continue;
                    }
                    let child = *slot.child.add(slot.top);
                    let is_leaf = child & LEAF != 0;
                    if is_leaf
                        && !slot.inside
                        && let Some(world) = feed.upper()
                    {
                        slot.above = slot.space;
                        slot.inside = true;
                        slot.enter::<L>(world, child & !LEAF);
                        continue;
                    }
                    slot.current = child;
                    let node = slot.nodes.wrapping_add(child as usize).cast::<u8>();
                    let block = slot.blocks.wrapping_add((child & BLOCK) as usize).cast::<u8>();
                    let data = if is_leaf { block } else { node };
                    for line in 0..5 {
                        L::prefetch(data.wrapping_add(64 * line));
                    }
                    *leaves.get_unchecked_mut(l) = s;
                    *nodes.get_unchecked_mut(n) = s;
                    l += usize::from(is_leaf);
                    n += usize::from(!is_leaf);
                    break;
                }
            }
            if lives == 0 {
                return;
            }
            for &s in nodes.get_unchecked(..n) {
                step::<L>(&mut *slots.add(s as usize));
            }
            for &s in leaves.get_unchecked(..l) {
                test::<L>(&mut *slots.add(s as usize));
            }
            for &s in leaves.get_unchecked(..l) {
                let slot = &mut *slots.add(s as usize);
                if slot.mask | slot.hard != 0 {
                    let block = &*slot.blocks.add((slot.current & BLOCK) as usize);
                    let met = (slot.mask, slot.hard);
                    let (ray, id) = (&slot.sheared, slot.instance_id);
                    accept(block, ray, slot.t_min, slot.t_max, id, met, &mut slot.tuv, &mut slot.best);
                }
            }
            (n, l) = (0, 0);
        }
    }
}

/// Rays of a slice by their numbers.
struct Numbered<'a> {
    world: &'a World,
    rays: &'a [Ray],
    left: std::slice::Iter<'a, u32>,
    hits: &'a mut [Hit],
}

impl Numbered<'_> {
    /// Gives the next ray to a slot; false where none is left.
    #[inline(always)]
    unsafe fn next<L: Level>(&mut self, slot: &mut Slot) -> bool {
        let Some(&number) = self.left.next() else { return false };
        // SAFETY: by the contracts of `closest` and the world.
        unsafe {
            let (world, ray) = (self.world, self.rays.get_unchecked(number as usize));
            slot.number = number;
            (slot.origin, slot.direction) = (ray.origin.to_array(), ray.direction.to_array());
            slot.t_min = ray.t_min;
            slot.t_max = ray.t_max;
            slot.best = Hit { t: ray.t_max, ..Hit::MISS };
            slot.inside = false;
            slot.top = 0;
            slot.base = 0;
            match world.only {
                Some(only) => slot.enter::<L>(world, only),
                None => {
                    slot.space = RaySpace::new(slot.origin, slot.direction, world.extent, world.slack);
                    slot.nodes = world.tlas.nodes.as_ptr();
                    slot.blocks = slot.nodes.cast();
                    slot.begin_tree(world.tlas.root);
                }
            }
        }
        true
    }
    /// The slot's ray has its closest hit.
    #[inline(always)]
    unsafe fn done(&mut self, slot: &Slot) {
        let hit = if slot.best.is_hit() { slot.best } else { Hit::MISS };
        // SAFETY: as above.
        unsafe { *self.hits.get_unchecked_mut(slot.number as usize) = hit }
    }
    /// The upper tree, where rays begin in it.
    #[inline(always)]
    fn upper(&self) -> Option<&World> {
        self.world.only.is_none().then_some(self.world)
    }
}

/// Closest hits of the rays whose numbers are given; each is usable and of moderate direction.
///
/// # Safety
/// The level's features; `numbers` are in range of `rays` and `hits`.
#[inline(always)]
pub(super) unsafe fn closest<L: Level>(world: &World, rays: &[Ray], numbers: &[u32], hits: &mut [Hit]) {
    // SAFETY: by the caller; the world keeps the trees' invariants.
    unsafe {
        if world.tlas.root == EMPTY {
            numbers.iter().for_each(|&n| *hits.get_unchecked_mut(n as usize) = Hit::MISS);
        } else {
            run::<L>(&mut Numbered { world, rays, left: numbers.iter(), hits });
        }
    }
}

impl Slot {
    #[inline(always)]
    fn vacant(stack: &mut Stack) -> Self {
        Self {
            space: RaySpace::VACANT,
            sheared: Sheared::of(&RaySpace::VACANT),
            t_min: 0.0,
            t_max: 0.0,
            best: Hit::MISS,
            nodes: std::ptr::null(),
            blocks: std::ptr::null(),
            current: EMPTY,
            instance_id: 0,
            top: 0,
            base: 0,
            inside: false,
            number: 0,
            mask: 0,
            hard: 0,
            tuv: [[0.0; 8]; 3],
            above: RaySpace::VACANT,
            origin: [0.0; 3],
            direction: [0.0; 3],
            child: stack.0.as_mut_ptr().cast(),
            t: stack.1.as_mut_ptr().cast(),
        }
    }

    /// Into an instance.
    #[inline(always)]
    unsafe fn enter<L: Level>(&mut self, world: &World, leaf: u32) {
        // SAFETY: by the caller.
        unsafe {
            let record = world.records.get_unchecked(leaf as usize);
            let blas = world.trees.get_unchecked(record.blas as usize);
            let (o, d) = record.object_ray(self.origin, self.direction);
            self.space = RaySpace::new(o, d, blas.extent, 1.0);
            self.sheared = Sheared::of(&self.space);
            self.instance_id = record.instance_id;
            self.base = self.top;
            if blas.kd.is_some() {
                let (t_min, t_max, instance_id) = (self.t_min, self.t_max, self.instance_id);
                let (blocks, ray, best) = (&blas.blocks, self.sheared, &mut self.best);
                let mut v = BlasClosest { blocks, ray, t_min, t_max, instance_id, best };
                tree::<L, _>(blas, &self.space, t_min, &mut v);
                return;
            }
            self.nodes = blas.nodes.as_ptr();
            self.blocks = blas.blocks.as_ptr();
            self.begin_tree(blas.root);
        }
    }

    #[inline(always)]
    unsafe fn begin_tree(&mut self, root: u32) {
        // SAFETY: there is room.
        unsafe {
            *self.child.add(self.top) = root;
            *self.t.add(self.top) = self.t_min;
            self.top += 1;
        }
    }
}

/// Tests the children of a node and puts those that are met on the stack, the nearest on top.
#[inline(always)]
unsafe fn step<L: Level>(slot: &mut Slot) {
    // SAFETY: nodes and planes are in range by the tree's invariants, the stack has room for a node's children at every level; features by
    // the caller.
    unsafe {
        let node = &*slot.nodes.add(slot.current as usize);
        count::node::<L>(node);
        let planes = node.planes.as_ptr().cast::<f32>();
        let plane = |i: usize| L::W8::load(planes.add(8 * i));
        let ray = &slot.space;
        let [nx, ny, nz] = ray.near_plane;
        let (inv, near, far) = (ray.inv.map(|x| L::W8::splat(x)), ray.near, ray.far);
        let enter = plane(nx).slab(inv[0], L::W8::splat(near[0]));
        let enter = enter.max(plane(ny).slab(inv[1], L::W8::splat(near[1])));
        let enter = plane(nz).slab(inv[2], L::W8::splat(near[2])).max(L::W8::splat(slot.t_min)).max(enter);
        let leave = plane(nx ^ 1).slab(inv[0], L::W8::splat(far[0]));
        let leave = leave.min(plane(ny ^ 1).slab(inv[1], L::W8::splat(far[1])));
        let leave = plane(nz ^ 1).slab(inv[2], L::W8::splat(far[2])).min(L::W8::splat(slot.best.t)).min(leave);
        let (child, t) = (slot.child.add(slot.top), slot.t.add(slot.top));
        slot.top += L::push(enter, leave, node.child.as_ptr(), child, t);
    }
}

/// Tests a block's triangles.
#[inline(always)]
unsafe fn test<L: Level>(slot: &mut Slot) {
    // SAFETY: as for `step`.
    unsafe {
        let block = &*slot.blocks.add((slot.current & BLOCK) as usize);
        if L::COUNT {
            count::block::<L>(block.len() as u32);
        }
        (slot.mask, slot.hard) = candidates8::<L>(block, &slot.sheared, slot.t_min, slot.best.t, &mut slot.tuv);
    }
}
