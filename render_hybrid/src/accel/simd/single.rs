//! One ray through the two levels.

use super::count;
use super::lanes::{Lanes, Level};
use crate::accel::blas::Blas;
use crate::accel::node::{BLOCK, EMPTY, LEAF, Node8, STACK, Tri8};
use crate::accel::ray_space::RaySpace;
use crate::accel::triangle::{CONDITION, DET_MAX, DET_MIN, exact};
use crate::accel::world::World;
use crate::accel::{Hit, Ray};
use std::mem::MaybeUninit;

#[derive(Clone, Copy)]
struct Waiting {
    child: u32,
    t: f32,
}

/// What a traversal does at its leaves.
pub(super) trait Visitor<L: Level> {
    /// Closest hit: visit near children first.
    const ORDERED: bool;
    /// Nodes beyond it are left out.
    fn limit(&self) -> f32;
    /// A leaf will be visited soon.
    fn soon(&self, leaf: u32);
    /// Returns true to end the traversal.
    ///
    /// # Safety
    /// The level's features, and a leaf of the visitor's tree.
    unsafe fn leaf(&mut self, leaf: u32) -> bool;
}

/// Walks a wide tree. Returns true where the visitor ended it.
///
/// # Safety
/// The level's features; `nodes` is a tree as `validate` wants it, at most `MAX_DEPTH` deep, that holds `root`.
#[inline(always)]
pub(super) unsafe fn walk<L: Level, V: Visitor<L>>(
    nodes: &[Node8],
    root: u32,
    ray: &RaySpace,
    t_min: f32,
    v: &mut V,
) -> bool {
    let mut stack = [MaybeUninit::<Waiting>::uninit(); STACK];
    // SAFETY: the stack holds 7 waiting children a level for MAX_DEPTH levels and one more node's; node indices and plane
    // numbers are in range by the tree's invariants; features by the caller.
    unsafe {
        let stack = stack.as_mut_ptr().cast::<Waiting>();
        let mut top = 0usize;
        let nodes = nodes.as_ptr();
        let inv = ray.inv.map(|x| L::W8::splat(x));
        let near = ray.near.map(|x| L::W8::splat(x));
        let far = ray.far.map(|x| L::W8::splat(x));
        let t_first = L::W8::splat(t_min);
        let [nx, ny, nz] = ray.near_plane;
        let mut current = root;
        'node: loop {
            'descend: {
                if current & LEAF != 0 {
                    if v.leaf(current & !LEAF) {
                        return true;
                    }
                    break 'descend;
                }
                let node = &*nodes.add(current as usize);
                count::node::<L>(node);
                let planes = node.planes.as_ptr().cast::<f32>();
                let plane = |i: usize| L::W8::load(planes.add(8 * i));
                let enter = plane(nx).slab(inv[0], near[0]);
                let enter = enter.max(plane(ny).slab(inv[1], near[1]));
                let enter = plane(nz).slab(inv[2], near[2]).max(t_first).max(enter);
                let leave = plane(nx ^ 1).slab(inv[0], far[0]);
                let leave = leave.min(plane(ny ^ 1).slab(inv[1], far[1]));
                let leave = plane(nz ^ 1).slab(inv[2], far[2]).min(L::W8::splat(v.limit())).min(leave);
                let mut mask = enter.le(leave);
                if mask == 0 {
                    break 'descend;
                }
                let first = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                let child = |i: usize| *node.child.as_ptr().add(i);
                let soon = |v: &V, c: u32| {
                    if c & LEAF != 0 {
                        v.soon(c & !LEAF);
                    } else {
                        let p = nodes.add(c as usize).cast::<u8>();
                        L::prefetch(p);
                        L::prefetch(p.add(64));
                        L::prefetch(p.add(128));
                        L::prefetch(p.add(192));
                    }
                };
                if mask == 0 {
                    current = child(first);
                    continue 'node;
                }
                if !V::ORDERED {
                    // As the tree has them: none will be culled later either, for the limit stays.
                    current = child(first);
                    while mask != 0 {
                        let last = mask.ilog2();
                        let c = child(last as usize);
                        mask ^= 1 << last;
                        *stack.add(top) = Waiting { child: c, t: 0.0 };
                        top += 1;
                    }
                    continue 'node;
                }
                let mut t = [0.0f32; 8];
                enter.store(t.as_mut_ptr());
                let t = t.as_ptr();
                let at = |i: usize| Waiting { child: child(i), t: *t.add(i) };
                let second = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                let (mut a, mut b) = (at(first), at(second));
                if b.t < a.t {
                    std::mem::swap(&mut a, &mut b);
                }
                soon(v, a.child);
                soon(v, b.child);
                if mask == 0 {
                    *stack.add(top) = b;
                    top += 1;
                    current = a.child;
                    continue 'node;
                }
                // Three or more: insertion sort on the stack, farthest lowest.
                let base = top;
                *stack.add(top) = b;
                *stack.add(top + 1) = a;
                top += 2;
                while mask != 0 {
                    let c = at(mask.trailing_zeros() as usize);
                    mask &= mask - 1;
                    soon(v, c.child);
                    let mut i = top;
                    while i > base && (*stack.add(i - 1)).t < c.t {
                        *stack.add(i) = *stack.add(i - 1);
                        i -= 1;
                    }
                    *stack.add(i) = c;
                    top += 1;
                }
                top -= 1;
                current = (*stack.add(top)).child;
                continue 'node;
            }
            loop {
                if top == 0 {
                    return false;
                }
                top -= 1;
                let next = *stack.add(top);
                if !V::ORDERED || next.t <= v.limit() {
                    current = next.child;
                    break;
                }
            }
        }
    }
}

/// Walks a mesh's tree of either kind. Returns true where the visitor ended it.
///
/// # Safety
/// As for [`walk`].
#[inline(always)]
pub(super) unsafe fn tree<L: Level, V: Visitor<L>>(blas: &Blas, ray: &RaySpace, t_min: f32, v: &mut V) -> bool {
    // SAFETY: by the caller.
    unsafe {
        match &blas.kd {
            None => walk::<L, _>(&blas.nodes, blas.root, ray, t_min, v),
            Some(tree) => super::kd::walk::<L, _>(tree, ray, t_min, v),
        }
    }
}

/// What the triangle test needs of a ray: the origin by (kx, ky, kz), the shear, and the scale of its error bounds.
#[derive(Clone, Copy)]
pub(super) struct Sheared {
    pub k: [usize; 3],
    pub origin_k: [f32; 3],
    pub shear: [f32; 3],
    pub reach: f32,
}

impl Sheared {
    #[inline(always)]
    pub(super) fn of(ray: &RaySpace) -> Self {
        let [kx, ky, kz] = ray.k;
        let o = ray.origin;
        Self { k: ray.k, origin_k: [o[kx], o[ky], o[kz]], shear: ray.shear, reach: ray.reach }
    }
}

/// Translated and sheared vertex of eight triangles; z is unsheared.
///
/// # Safety
/// The level's features; `base` points to a block's vertices.
#[inline(always)]
unsafe fn corner8<W: Lanes>(base: *const f32, vertex: usize, k: [usize; 3], o: [W; 3], sx: W, sy: W) -> [W; 3] {
    // SAFETY: by the contract.
    unsafe {
        let p = base.add(24 * vertex);
        let z = W::load(p.add(8 * k[2])).sub(o[2]);
        [W::load(p.add(8 * k[0])).sub(o[0]).sub(sx.mul(z)), W::load(p.add(8 * k[1])).sub(o[1]).sub(sy.mul(z)), z]
    }
}

/// What a ray's line and a block's triangles have in common.
struct Line8<W> {
    t: W,
    v: W,
    w: W,
    reciprocal: W,
    /// Lanes that the line meets.
    met: u32,
    /// Lanes that double precision must decide.
    hard: u32,
}

/// `None`: the line meets nothing, and `HASTY`.
///
/// # Safety
/// The level's features.
#[inline(always)]
unsafe fn line8<L: Level, const HASTY: bool>(block: &Tri8, ray: &Sheared) -> Option<Line8<L::W8>> {
    // SAFETY: lanes are eight f32 each; axes are 0..3; features by the caller.
    unsafe {
        let [ox, oy, oz] = ray.origin_k;
        let o = [L::W8::splat(ox), L::W8::splat(oy), L::W8::splat(oz)];
        let [sx, sy, sz] = ray.shear;
        let (sx, sy) = (L::W8::splat(sx), L::W8::splat(sy));
        let base = block.v.as_ptr().cast::<f32>();
        let [ax, ay, az] = corner8::<L::W8>(base, 0, ray.k, o, sx, sy);
        let [bx, by, bz] = corner8::<L::W8>(base, 1, ray.k, o, sx, sy);
        let [cx, cy, cz] = corner8::<L::W8>(base, 2, ray.k, o, sx, sy);
        let u = cx.mul(by).sub(cy.mul(bx));
        let v = ax.mul(cy).sub(ay.mul(cx));
        let w = bx.mul(ay).sub(by.mul(ax));
        let zero = L::W8::splat(0.0);
        let least = u.min(v).min(w);
        let most = u.max(v).max(w);
        let inside = zero.le(least) | most.le(zero);
        if HASTY && inside == 0 {
            return None;
        }
        let det = u.add(v).add(w);
        let reciprocal = L::W8::splat(1.0).div(det);
        let t = u.mul(az).add(v.mul(bz)).add(w.mul(cz)).mul(reciprocal).mul(L::W8::splat(sz));
        let size = det.abs();
        let m = ax.abs().max(ay.abs()).max(bx.abs()).max(by.abs()).max(cx.abs()).max(cy.abs());
        let well = m.mul(m).mul(m).mul(L::W8::splat(CONDITION)).le(size.mul(L::W8::splat(ray.reach)));
        let sound = well
            & L::W8::splat(DET_MIN).le(size)
            & size.le(L::W8::splat(DET_MAX))
            & !(u.eq(zero) | v.eq(zero) | w.eq(zero));
        Some(Line8 { t, v, w, reciprocal, met: inside & sound, hard: inside & !sound })
    }
}

/// (t, u, v) of a block's triangles, and the lanes with t_min < t <= t_max; other lanes are meaningless.
///
/// # Safety
/// The level's features.
#[inline(always)]
pub(super) unsafe fn intersect8<L: Level>(
    block: &Tri8,
    ray: &Sheared,
    t_min: f32,
    t_max: f32,
    out: &mut [[f32; 8]; 3],
) -> u32 {
    // SAFETY: features by the caller.
    unsafe {
        let Some(line) = line8::<L, true>(block, ray) else { return 0 };
        let (t, mut hard) = (line.t, line.hard);
        let mut mask = line.met & L::W8::splat(t_min).lt(t) & t.le(L::W8::splat(t_max));
        if mask | hard == 0 {
            return 0;
        }
        t.store(out[0].as_mut_ptr());
        line.v.mul(line.reciprocal).store(out[1].as_mut_ptr());
        line.w.mul(line.reciprocal).store(out[2].as_mut_ptr());
        while hard != 0 {
            let lane = hard.trailing_zeros() as usize;
            hard &= hard - 1;
            if let Some((t, u, v)) = hard_lane(block, lane, ray)
                && t_min < t
                && t <= t_max
            {
                (out[0][lane], out[1][lane], out[2][lane]) = (t, u, v);
                mask |= 1 << lane;
            }
        }
        mask
    }
}

/// As [`intersect8`] without a branch: lanes with t_min < t <= t_max, and those that [`accept`] must decide.
///
/// # Safety
/// The level's features.
#[inline(always)]
pub(super) unsafe fn candidates8<L: Level>(
    block: &Tri8,
    ray: &Sheared,
    t_min: f32,
    t_max: f32,
    out: &mut [[f32; 8]; 3],
) -> (u32, u32) {
    // SAFETY: features by the caller.
    unsafe {
        let Some(line) = line8::<L, false>(block, ray) else { return (0, 0) };
        line.t.store(out[0].as_mut_ptr());
        line.v.mul(line.reciprocal).store(out[1].as_mut_ptr());
        line.w.mul(line.reciprocal).store(out[2].as_mut_ptr());
        (line.met & L::W8::splat(t_min).lt(line.t) & line.t.le(L::W8::splat(t_max)), line.hard)
    }
}

/// Takes the nearest of what [`candidates8`] has found.
#[inline(always)]
pub(super) fn accept(
    block: &Tri8,
    ray: &Sheared,
    t_min: f32,
    t_max: f32,
    instance_id: u32,
    (mut mask, mut hard): (u32, u32),
    tuv: &mut [[f32; 8]; 3],
    best: &mut Hit,
) {
    while hard != 0 {
        let lane = hard.trailing_zeros() as usize;
        hard &= hard - 1;
        if let Some((t, u, v)) = hard_lane(block, lane, ray)
            && t_min < t
            && t <= best.t
        {
            (tuv[0][lane], tuv[1][lane], tuv[2][lane]) = (t, u, v);
            mask |= 1 << lane;
        }
    }
    while mask != 0 {
        let lane = mask.trailing_zeros() as usize;
        mask &= mask - 1;
        let candidate =
            Hit { t: tuv[0][lane], u: tuv[1][lane], v: tuv[2][lane], instance_id, primitive_id: block.prim[lane] };
        if nearer(&candidate, best, t_max) {
            *best = candidate;
        }
    }
}

/// True where any of a block's triangles is met at t_min < t < t_max.
///
/// # Safety
/// The level's features.
#[inline(always)]
unsafe fn occludes8<L: Level>(block: &Tri8, ray: &Sheared, t_min: f32, t_max: f32) -> bool {
    // SAFETY: features by the caller.
    unsafe {
        let Some(line) = line8::<L, true>(block, ray) else { return false };
        if line.met & L::W8::splat(t_min).lt(line.t) & line.t.lt(L::W8::splat(t_max)) != 0 {
            return true;
        }
        let mut hard = line.hard;
        while hard != 0 {
            let lane = hard.trailing_zeros() as usize;
            hard &= hard - 1;
            if hard_lane(block, lane, ray).is_some_and(|(t, ..)| t_min < t && t < t_max) {
                return true;
            }
        }
        false
    }
}

/// One lane in double precision, from the same sheared vertices.
#[cold]
#[inline(never)]
pub(super) fn hard_lane(block: &Tri8, lane: usize, ray: &Sheared) -> Option<(f32, f32, f32)> {
    let corner = |vertex: usize| {
        let p = block.corner(vertex, lane);
        let z = p[ray.k[2]] - ray.origin_k[2];
        [(p[ray.k[0]] - ray.origin_k[0]) - ray.shear[0] * z, (p[ray.k[1]] - ray.origin_k[1]) - ray.shear[1] * z, z]
    };
    exact(corner(0), corner(1), corner(2), ray.shear[2])
}

/// Asks for the lines of a block.
#[inline(always)]
fn prefetch_block<L: Level>(blocks: &[Tri8], leaf: u32) {
    let p = blocks.as_ptr().wrapping_add((leaf & BLOCK) as usize).cast::<u8>();
    for line in 0..5 {
        L::prefetch(p.wrapping_add(64 * line));
    }
}

/// Closest hit in one instance.
pub(super) struct BlasClosest<'a> {
    pub blocks: &'a [Tri8],
    pub ray: Sheared,
    pub t_min: f32,
    pub t_max: f32,
    pub instance_id: u32,
    pub best: &'a mut Hit,
}

impl<L: Level> Visitor<L> for BlasClosest<'_> {
    const ORDERED: bool = true;
    #[inline(always)]
    fn limit(&self) -> f32 {
        self.best.t
    }
    #[inline(always)]
    fn soon(&self, leaf: u32) {
        prefetch_block::<L>(self.blocks, leaf);
    }
    #[inline(always)]
    unsafe fn leaf(&mut self, leaf: u32) -> bool {
        // SAFETY: leaf references are block numbers by the tree's invariants; features by the caller.
        unsafe {
            let block = self.blocks.get_unchecked((leaf & BLOCK) as usize);
            if L::COUNT {
                count::block::<L>(block.len() as u32);
            }
            let mut tuv = [[0.0f32; 8]; 3];
            let mut mask = intersect8::<L>(block, &self.ray, self.t_min, self.best.t, &mut tuv);
            while mask != 0 {
                let lane = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                let candidate = Hit {
                    t: tuv[0][lane],
                    u: tuv[1][lane],
                    v: tuv[2][lane],
                    instance_id: self.instance_id,
                    primitive_id: block.prim[lane],
                };
                if nearer(&candidate, self.best, self.t_max) {
                    *self.best = candidate;
                }
            }
            false
        }
    }
}

/// Order of hits: t, then instance, then primitive; t < t_max strictly.
#[inline(always)]
pub(super) fn nearer(a: &Hit, best: &Hit, t_max: f32) -> bool {
    a.t < t_max
        && (a.t < best.t || (a.t == best.t && (a.instance_id, a.primitive_id) < (best.instance_id, best.primitive_id)))
}

/// Any hit in one instance.
pub(super) struct BlasAny<'a> {
    pub blocks: &'a [Tri8],
    pub ray: Sheared,
    pub t_min: f32,
    pub t_max: f32,
}

impl<L: Level> Visitor<L> for BlasAny<'_> {
    const ORDERED: bool = false;
    #[inline(always)]
    fn limit(&self) -> f32 {
        self.t_max
    }
    #[inline(always)]
    fn soon(&self, leaf: u32) {
        prefetch_block::<L>(self.blocks, leaf);
    }
    #[inline(always)]
    unsafe fn leaf(&mut self, leaf: u32) -> bool {
        // SAFETY: as for the closest hit.
        unsafe {
            let block = self.blocks.get_unchecked((leaf & BLOCK) as usize);
            if L::COUNT {
                count::block::<L>(block.len() as u32);
            }
            occludes8::<L>(block, &self.ray, self.t_min, self.t_max)
        }
    }
}

/// Closest hit over instances.
struct TlasClosest<'a> {
    world: &'a World,
    ray: &'a Ray,
    best: Hit,
}

impl<L: Level> Visitor<L> for TlasClosest<'_> {
    const ORDERED: bool = true;
    #[inline(always)]
    fn limit(&self) -> f32 {
        self.best.t
    }
    #[inline(always)]
    fn soon(&self, _: u32) {}
    #[inline(always)]
    unsafe fn leaf(&mut self, leaf: u32) -> bool {
        // SAFETY: leaf references are instance slots and their trees exist by the structure's invariants.
        unsafe {
            let record = self.world.records.get_unchecked(leaf as usize);
            let blas = self.world.trees.get_unchecked(record.blas as usize);
            let (o, d) = record.object_ray(self.ray.origin.to_array(), self.ray.direction.to_array());
            let ray = RaySpace::new(o, d, blas.extent, 1.0);
            let mut v = BlasClosest {
                blocks: &blas.blocks,
                ray: Sheared::of(&ray),
                t_min: self.ray.t_min,
                t_max: self.ray.t_max,
                instance_id: record.instance_id,
                best: &mut self.best,
            };
            tree::<L, _>(blas, &ray, self.ray.t_min, &mut v)
        }
    }
}

/// Any hit over the instances that cast shadows.
struct TlasAny<'a> {
    world: &'a World,
    ray: &'a Ray,
}

impl<L: Level> Visitor<L> for TlasAny<'_> {
    const ORDERED: bool = false;
    #[inline(always)]
    fn limit(&self) -> f32 {
        self.ray.t_max
    }
    #[inline(always)]
    fn soon(&self, _: u32) {}
    #[inline(always)]
    unsafe fn leaf(&mut self, leaf: u32) -> bool {
        // SAFETY: as for the closest hit.
        unsafe {
            let record = self.world.records.get_unchecked(leaf as usize);
            if !record.casts_shadow {
                return false;
            }
            let blas = self.world.trees.get_unchecked(record.blas as usize);
            let (o, d) = record.object_ray(self.ray.origin.to_array(), self.ray.direction.to_array());
            let ray = RaySpace::new(o, d, blas.extent, 1.0);
            let mut v =
                BlasAny { blocks: &blas.blocks, ray: Sheared::of(&ray), t_min: self.ray.t_min, t_max: self.ray.t_max };
            tree::<L, _>(blas, &ray, self.ray.t_min, &mut v)
        }
    }
}

/// Closest hit of a ray that is usable and of moderate direction.
///
/// # Safety
/// The level's features.
#[inline(always)]
pub(super) unsafe fn closest<L: Level>(world: &World, ray: &Ray) -> Hit {
    let mut v = TlasClosest { world, ray, best: Hit { t: ray.t_max, ..Hit::MISS } };
    // SAFETY: the world keeps the trees' invariants; features by the caller.
    unsafe {
        if let Some(only) = world.only {
            Visitor::<L>::leaf(&mut v, only);
        } else if world.tlas.root != EMPTY {
            let space = RaySpace::new(ray.origin.to_array(), ray.direction.to_array(), world.extent, world.slack);
            walk::<L, _>(&world.tlas.nodes, world.tlas.root, &space, ray.t_min, &mut v);
        }
    }
    if v.best.is_hit() { v.best } else { Hit::MISS }
}

/// Any hit of a ray that is usable and of moderate direction.
///
/// # Safety
/// The level's features.
#[inline(always)]
pub(super) unsafe fn any<L: Level>(world: &World, ray: &Ray) -> bool {
    let mut v = TlasAny { world, ray };
    // SAFETY: the world keeps the trees' invariants; features by the caller.
    unsafe {
        if let Some(only) = world.only {
            Visitor::<L>::leaf(&mut v, only)
        } else if world.tlas.root != EMPTY {
            let space = RaySpace::new(ray.origin.to_array(), ray.direction.to_array(), world.extent, world.slack);
            walk::<L, _>(&world.tlas.nodes, world.tlas.root, &space, ray.t_min, &mut v)
        } else {
            false
        }
    }
}
