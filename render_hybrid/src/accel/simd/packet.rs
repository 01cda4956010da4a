//! Sixteen or eight rays together.
//!
//! Inner nodes are tested once for the whole packet: intervals of origins and reciprocal directions against eight children.
//! Leaves, and all children where the packet is wide, are then tested ray by ray, sixteen lanes a child. At a leaf the
//! cheaper of two orders is taken: all rays against one triangle after another, or one ray after another against all eight
//! triangles. A subtree that only few rays reach is walked by each of them alone. Only rays that agree in the signs and the
//! main axis of their directions go together, in the world and again in each instance's space; those that have nobody like
//! them go alone. Each ray's hit is the same bits either way.
//!
//! Source of the interval test: Boulos, Wald & Shirley, "Geometric and Arithmetic Culling Methods for Entire Ray Packets",
//! 2006; of the transposed leaf test and the fall-back: Benthin et al., "Combining Single and Packet Ray Tracing for
//! Arbitrary Ray Distributions on the Intel MIC Architecture", TVCG 2012.

use super::count;
use super::lanes::{Lanes, Level};
use super::single::{self, BlasAny, BlasClosest, Sheared, hard_lane, intersect8, nearer};
use crate::accel::node::{BLOCK, EMPTY, LEAF, LEN_SHIFT, Node8, STACK, Tri8};
use crate::accel::ray_space::{LEAST_SLOPE, PAD, RaySpace};
use crate::accel::triangle::{CONDITION, DET_MAX, DET_MIN};
use crate::accel::world::World;
use crate::accel::{Hit, Ray};
use std::mem::MaybeUninit;

/// Rays of the largest packet.
pub(super) const RAYS: usize = 16;
/// At most so many rays in a subtree: each goes alone.
const FEW: u32 = 2;
/// Greatest ratio of reciprocal directions within a packet that is tested as one at inner nodes.
const TIGHT: f32 = 1.2;
/// An axis whose reciprocals all exceed the main axis's so many times may vary freely: its planes are crossed late or never.
const STEEP: f32 = 16.0;

#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Sixteen([f32; RAYS]);

const ZERO: Sixteen = Sixteen([0.0; RAYS]);

impl Sixteen {
    #[inline(always)]
    unsafe fn load<W: Lanes>(&self) -> W {
        // SAFETY: sixteen f32; features by the caller.
        unsafe { W::load(self.0.as_ptr()) }
    }
    #[inline(always)]
    unsafe fn of<W: Lanes>(w: W) -> Self {
        let mut out = ZERO;
        // SAFETY: room for sixteen f32; features by the caller.
        unsafe { w.store(out.0.as_mut_ptr()) };
        out
    }
}

/// Rays of one packet, world space, and what they have met.
struct Rays {
    origin: [Sixteen; 3],
    direction: [Sixteen; 3],
    t_min: Sixteen,
    t_max: Sixteen,
    /// Distance met so far, or t_max. −infinity: the ray is done.
    t: Sixteen,
    u: Sixteen,
    v: Sixteen,
    prim: [u32; RAYS],
    instance: [u32; RAYS],
    /// Greatest of `t`.
    limit: f32,
}

impl Rays {
    fn hit(&self, lane: usize) -> Hit {
        Hit {
            t: self.t.0[lane],
            u: self.u.0[lane],
            v: self.v.0[lane],
            instance_id: self.instance[lane],
            primitive_id: self.prim[lane],
        }
    }
    #[inline(always)]
    fn put(&mut self, lane: usize, hit: &Hit) {
        self.t.0[lane] = hit.t;
        self.u.0[lane] = hit.u;
        self.v.0[lane] = hit.v;
        self.instance[lane] = hit.instance_id;
        self.prim[lane] = hit.primitive_id;
    }
    #[inline(always)]
    fn done(&mut self, lane: usize) {
        self.t.0[lane] = f32::NEG_INFINITY;
        self.prim[lane] = 0;
    }
    #[inline(always)]
    unsafe fn settle<L: Level>(&mut self) {
        // SAFETY: features by the caller.
        self.limit = unsafe { self.t.load::<L::W16>().greatest() };
    }
}

/// `RaySpace` of sixteen rays, and their intervals.
struct Space {
    origin: [Sixteen; 3],
    inv: [Sixteen; 3],
    near: [Sixteen; 3],
    far: [Sixteen; 3],
    shear: [Sixteen; 3],
    reach: Sixteen,
    k: [usize; 3],
    near_plane: [usize; 3],
    /// Per axis (inv low, inv high, near · low, near · high, far · low, far · high).
    bounds: [[f32; 6]; 3],
    t_first: f32,
    tight: bool,
}

/// Which lanes' directions have the same signs and main axis.
struct Kinds {
    negative: [u32; 3],
    x: u32,
    y: u32,
}

impl Kinds {
    /// # Safety
    /// The level's features.
    #[inline(always)]
    unsafe fn new<L: Level>(d: &[L::W16; 3]) -> Self {
        // SAFETY: features by the caller.
        unsafe {
            let zero = L::W16::splat(0.0);
            let size = [d[0].abs(), d[1].abs(), d[2].abs()];
            let (yx, zx, zy) = (size[1].le(size[0]), size[2].le(size[0]), size[2].le(size[1]));
            Self { negative: [d[0].lt(zero), d[1].lt(zero), d[2].lt(zero)], x: yx & zx, y: !yx & zy }
        }
    }

    /// Lanes of `mask` that are like its first.
    #[inline(always)]
    fn like_first(&self, mask: u32) -> u32 {
        let first = mask & mask.wrapping_neg();
        let of = |lanes: u32| if lanes & first != 0 { lanes } else { !lanes };
        of(self.negative[0]) & of(self.negative[1]) & of(self.negative[2]) & of(self.x) & of(self.y) & mask
    }
}

impl Space {
    /// The rays of `group`, which must be alike; the other lanes are filled with its first one's.
    ///
    /// # Safety
    /// The level's features.
    #[inline(always)]
    unsafe fn new<L: Level>(
        origin: &[L::W16; 3],
        direction: &[L::W16; 3],
        t_min: L::W16,
        kinds: &Kinds,
        group: u32,
        extent: f32,
        slack: f32,
    ) -> Self {
        // SAFETY: features by the caller.
        unsafe {
            let all = (1u32 << L::RAYS) - 1;
            let first = group.trailing_zeros() as usize;
            let (mut origin, mut direction) = (*origin, *direction);
            if group != all {
                for v in origin.iter_mut().chain(&mut direction) {
                    *v = v.select(L::W16::splat(Sixteen::of(*v).0[first]), group);
                }
            }
            let zero = L::W16::splat(0.0);
            let size = [direction[0].abs(), direction[1].abs(), direction[2].abs()];
            let k = if kinds.x >> first & 1 != 0 {
                [1, 2, 0]
            } else if kinds.y >> first & 1 != 0 {
                [2, 0, 1]
            } else {
                [0, 1, 2]
            };
            let least = size[k[2]].mul(L::W16::splat(LEAST_SLOPE));
            let one = L::W16::splat(1.0);
            let mut inv = [zero; 3];
            let mut near_plane = [0; 3];
            for a in 0..3 {
                let negative = kinds.negative[a] >> first & 1 != 0;
                let d = direction[a];
                let small = size[a].lt(least);
                let d = if small != 0 { if negative { zero.sub(least) } else { least }.select(d, small) } else { d };
                inv[a] = one.div(d);
                near_plane[a] = 2 * a + usize::from(negative);
            }
            let [kx, ky, kz] = k;
            let sz = inv[kz];
            let reach = origin[0].abs().max(origin[1].abs()).max(origin[2].abs()).add(L::W16::splat(extent));
            let pad = reach.mul(L::W16::splat(PAD)).mul(L::W16::splat(slack));
            let mut space = Self {
                origin: [ZERO; 3],
                inv: [ZERO; 3],
                near: [ZERO; 3],
                far: [ZERO; 3],
                shear: [Sixteen::of(direction[kx].mul(sz)), Sixteen::of(direction[ky].mul(sz)), Sixteen::of(sz)],
                reach: Sixteen::of(reach),
                k,
                near_plane,
                bounds: [[0.0; 6]; 3],
                t_first: t_min.least(),
                tight: true,
            };
            for a in 0..3 {
                let negative = near_plane[a] & 1 == 1;
                let (n, f) = if negative {
                    (origin[a].sub(pad), origin[a].add(pad))
                } else {
                    (origin[a].add(pad), origin[a].sub(pad))
                };
                space.origin[a] = Sixteen::of(origin[a]);
                space.inv[a] = Sixteen::of(inv[a]);
                space.near[a] = Sixteen::of(n.mul(inv[a]));
                space.far[a] = Sixteen::of(f.mul(inv[a]));
                let (low, high) = (inv[a].least(), inv[a].greatest());
                let (n, f) = if negative { (n.least(), f.greatest()) } else { (n.greatest(), f.least()) };
                space.bounds[a] = [low, high, n * low, n * high, f * low, f * high];
                let (small, large) = if negative { (-high, -low) } else { (low, high) };
                space.tight &= large <= small * TIGHT || small > STEEP * sz.greatest().abs();
            }
            space
        }
    }

    #[inline(always)]
    fn sheared(&self, lane: usize) -> Sheared {
        let [kx, ky, kz] = self.k;
        Sheared {
            k: self.k,
            origin_k: [self.origin[kx].0[lane], self.origin[ky].0[lane], self.origin[kz].0[lane]],
            shear: [self.shear[0].0[lane], self.shear[1].0[lane], self.shear[2].0[lane]],
            reach: self.reach.0[lane],
        }
    }

    #[inline(always)]
    fn lane(&self, lane: usize) -> RaySpace {
        let pick = |v: &[Sixteen; 3]| [v[0].0[lane], v[1].0[lane], v[2].0[lane]];
        RaySpace {
            origin: pick(&self.origin),
            shear: pick(&self.shear),
            k: self.k,
            inv: pick(&self.inv),
            near: pick(&self.near),
            far: pick(&self.far),
            near_plane: self.near_plane,
            reach: self.reach.0[lane],
        }
    }

    /// Lanes of `mask` that may pass through a child's box before their `t`.
    ///
    /// # Safety
    /// The level's features.
    #[inline(always)]
    unsafe fn lanes<L: Level>(&self, node: &Node8, slot: usize, rays: &Rays, mask: u32) -> u32 {
        // SAFETY: plane numbers and slots are in range; features by the caller.
        unsafe {
            let [nx, ny, nz] = self.near_plane;
            let planes = node.planes.as_ptr().cast::<f32>();
            let plane = |i: usize| L::W16::splat(*planes.add(8 * i + slot));
            let (ix, iy, iz): (L::W16, L::W16, L::W16) = (self.inv[0].load(), self.inv[1].load(), self.inv[2].load());
            let enter = plane(nx).slab(ix, self.near[0].load());
            let enter = enter.max(plane(ny).slab(iy, self.near[1].load()));
            let enter = plane(nz).slab(iz, self.near[2].load()).max(rays.t_min.load()).max(enter);
            let leave = plane(nx ^ 1).slab(ix, self.far[0].load());
            let leave = leave.min(plane(ny ^ 1).slab(iy, self.far[1].load()));
            let leave = plane(nz ^ 1).slab(iz, self.far[2].load()).min(rays.t.load()).min(leave);
            enter.le(leave) & mask
        }
    }
}

#[derive(Clone, Copy)]
struct Waiting {
    child: u32,
    t: f32,
    mask: u32,
}

/// What a packet does at leaves and in narrow subtrees.
trait PacketVisitor<L: Level> {
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
unsafe fn walk<L: Level, V: PacketVisitor<L>>(
    nodes: &[Node8],
    root: u32,
    space: &Space,
    rays: &mut Rays,
    mask: u32,
    visitor: &mut V,
) {
    let mut stack = [MaybeUninit::<Waiting>::uninit(); STACK];
    // SAFETY: as for `single::walk`.
    unsafe {
        let stack = stack.as_mut_ptr().cast::<Waiting>();
        let nodes = nodes.as_ptr();
        let [nx, ny, nz] = space.near_plane;
        let b = &space.bounds;
        let mut top = 1;
        *stack = Waiting { child: root, t: f32::NEG_INFINITY, mask };
        while top != 0 {
            top -= 1;
            let Waiting { child, t, mask } = *stack.add(top);
            if !(t <= rays.limit) {
                continue;
            }
            let mask = mask & L::W16::splat(t).le(rays.t.load());
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
            let enter = near(nx, 0).max(near(ny, 1)).max(near(nz, 2)).max(L::W8::splat(space.t_first));
            let leave = far(nx ^ 1, 0).min(far(ny ^ 1, 1)).min(far(nz ^ 1, 2)).min(L::W8::splat(rays.limit));
            let mut children = enter.le(leave);
            let mut first = [0.0f32; 8];
            enter.store(first.as_mut_ptr());
            let base = top;
            while children != 0 {
                let slot = children.trailing_zeros() as usize;
                children &= children - 1;
                let child = *node.child.as_ptr().add(slot);
                let mut lanes = mask;
                if !space.tight || child & LEAF != 0 {
                    lanes = space.lanes::<L>(node, slot, rays, mask);
                    if lanes == 0 {
                        continue;
                    }
                }
                let t = *first.as_ptr().add(slot);
                let mut i = top;
                while i > base && (*stack.add(i - 1)).t < t {
                    *stack.add(i) = *stack.add(i - 1);
                    i -= 1;
                }
                *stack.add(i) = Waiting { child, t, mask: lanes };
                top += 1;
            }
        }
    }
}

/// One instance's tree.
struct Inside<'a, const CLOSEST: bool> {
    nodes: &'a [Node8],
    blocks: &'a [Tri8],
    space: &'a Space,
    instance_id: u32,
}

impl<L: Level, const CLOSEST: bool> PacketVisitor<L> for Inside<'_, CLOSEST> {
    #[inline(always)]
    unsafe fn leaf(&mut self, rays: &mut Rays, leaf: u32, mask: u32) {
        // SAFETY: leaf references are block numbers and lengths by the tree's invariants; features by the caller.
        unsafe {
            let block = self.blocks.get_unchecked((leaf & BLOCK) as usize);
            let len = leaf >> LEN_SHIFT;
            count::block::<L>(len + 1);
            if mask.count_ones() <= len + 1 {
                self.each_ray::<L>(rays, block, mask);
            } else {
                for lane in 0..=len as usize {
                    self.triangle::<L>(rays, block, lane, mask);
                }
            }
            rays.settle::<L>();
        }
    }

    #[inline(always)]
    unsafe fn alone(&mut self, rays: &mut Rays, child: u32, mut mask: u32) -> bool {
        // SAFETY: by the contract.
        unsafe {
            while mask != 0 {
                let lane = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                let ray = self.space.lane(lane);
                let (t_min, t_max) = (rays.t_min.0[lane], rays.t_max.0[lane]);
                if CLOSEST {
                    let mut best = rays.hit(lane);
                    alone_closest::<L>(self.nodes, self.blocks, child, &ray, t_min, t_max, self.instance_id, &mut best);
                    rays.put(lane, &best);
                } else {
                    let mut v = BlasAny { blocks: self.blocks, ray: self.space.sheared(lane), t_min, t_max };
                    if single::walk::<L, _>(self.nodes, child, &ray, t_min, &mut v) {
                        rays.done(lane);
                    }
                }
            }
            rays.settle::<L>();
            true
        }
    }
}

#[inline(always)]
unsafe fn alone_closest<L: Level>(
    nodes: &[Node8],
    blocks: &[Tri8],
    child: u32,
    ray: &RaySpace,
    t_min: f32,
    t_max: f32,
    instance_id: u32,
    best: &mut Hit,
) {
    // SAFETY: by the caller.
    unsafe {
        let mut v = BlasClosest { blocks, ray: Sheared::of(ray), t_min, t_max, instance_id, best };
        single::walk::<L, _>(nodes, child, ray, t_min, &mut v);
    }
}

impl<const CLOSEST: bool> Inside<'_, CLOSEST> {
    #[inline(always)]
    unsafe fn offer(&self, rays: &mut Rays, lane: usize, prim: u32, t: f32, u: f32, v: f32) {
        if CLOSEST {
            let hit = Hit { t, u, v, instance_id: self.instance_id, primitive_id: prim };
            if nearer(&hit, &rays.hit(lane), rays.t_max.0[lane]) {
                rays.put(lane, &hit);
            }
        } else if t < rays.t_max.0[lane] {
            rays.done(lane);
        }
    }

    /// Each ray against all triangles of the block.
    #[inline(always)]
    unsafe fn each_ray<L: Level>(&self, rays: &mut Rays, block: &Tri8, mut mask: u32) {
        // SAFETY: features by the caller.
        unsafe {
            while mask != 0 {
                let lane = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                let mut tuv = [[0.0f32; 8]; 3];
                let ray = self.space.sheared(lane);
                let mut found = intersect8::<L>(block, &ray, rays.t_min.0[lane], rays.t.0[lane], &mut tuv);
                while found != 0 {
                    let i = found.trailing_zeros() as usize;
                    found &= found - 1;
                    self.offer(rays, lane, block.prim[i], tuv[0][i], tuv[1][i], tuv[2][i]);
                }
            }
        }
    }

    /// All rays against one triangle.
    #[inline(always)]
    unsafe fn triangle<L: Level>(&self, rays: &mut Rays, block: &Tri8, at: usize, mask: u32) {
        // SAFETY: axes are 0..3 and `at` is below 8; features by the caller.
        unsafe {
            let s = self.space;
            let [kx, ky, kz] = s.k;
            let origin = |a: usize| s.origin.get_unchecked(a).load::<L::W16>();
            let (ox, oy, oz) = (origin(kx), origin(ky), origin(kz));
            let (sx, sy): (L::W16, L::W16) = (s.shear[0].load(), s.shear[1].load());
            let base = block.v.as_ptr().cast::<f32>().add(at);
            let [ax, ay, az] = corner16::<L::W16>(base, 0, s.k, [ox, oy, oz], sx, sy);
            let [bx, by, bz] = corner16::<L::W16>(base, 1, s.k, [ox, oy, oz], sx, sy);
            let [cx, cy, cz] = corner16::<L::W16>(base, 2, s.k, [ox, oy, oz], sx, sy);
            let u = cx.mul(by).sub(cy.mul(bx));
            let v = ax.mul(cy).sub(ay.mul(cx));
            let w = bx.mul(ay).sub(by.mul(ax));
            let zero = L::W16::splat(0.0);
            let least = u.min(v).min(w);
            let most = u.max(v).max(w);
            let mut mask = (zero.le(least) | most.le(zero)) & mask;
            if mask == 0 {
                return;
            }
            let det = u.add(v).add(w);
            let r = L::W16::splat(1.0).div(det);
            let t = u.mul(az).add(v.mul(bz)).add(w.mul(cz)).mul(r).mul(s.shear[2].load());
            let size = det.abs();
            let m = ax.abs().max(ay.abs()).max(bx.abs()).max(by.abs()).max(cx.abs()).max(cy.abs());
            let well = m.mul(m).mul(m).mul(L::W16::splat(CONDITION)).le(size.mul(s.reach.load()));
            let sound = well
                & L::W16::splat(DET_MIN).le(size)
                & size.le(L::W16::splat(DET_MAX))
                & !(u.eq(zero) | v.eq(zero) | w.eq(zero));
            let mut hard = mask & !sound;
            let best: L::W16 = rays.t.load();
            mask &= sound & rays.t_min.load::<L::W16>().lt(t) & t.le(best);
            let prim = block.prim[at];
            if mask != 0 {
                if CLOSEST {
                    // Ties and the open end of the range are decided one by one.
                    let mut equal = mask & t.eq(best);
                    let clear = mask & !equal;
                    let (vu, wv) = (v.mul(r), w.mul(r));
                    t.select(best, clear).store(rays.t.0.as_mut_ptr());
                    vu.select(rays.u.load(), clear).store(rays.u.0.as_mut_ptr());
                    wv.select(rays.v.load(), clear).store(rays.v.0.as_mut_ptr());
                    let mut c = clear;
                    while c != 0 {
                        let lane = c.trailing_zeros() as usize;
                        c &= c - 1;
                        *rays.prim.as_mut_ptr().add(lane) = prim;
                        *rays.instance.as_mut_ptr().add(lane) = self.instance_id;
                    }
                    if equal != 0 {
                        let (t, u, v) = (Sixteen::of(t), Sixteen::of(vu), Sixteen::of(wv));
                        while equal != 0 {
                            let lane = equal.trailing_zeros() as usize;
                            equal &= equal - 1;
                            self.offer(rays, lane, prim, t.0[lane], u.0[lane], v.0[lane]);
                        }
                    }
                } else {
                    let mut met = mask & t.lt(rays.t_max.load());
                    while met != 0 {
                        rays.done(met.trailing_zeros() as usize);
                        met &= met - 1;
                    }
                }
            }
            while hard != 0 {
                let lane = hard.trailing_zeros() as usize;
                hard &= hard - 1;
                if let Some((t, u, v)) = hard_lane(block, at, &s.sheared(lane))
                    && rays.t_min.0[lane] < t
                    && t <= rays.t.0[lane]
                {
                    self.offer(rays, lane, prim, t, u, v);
                }
            }
        }
    }
}

/// Translated and sheared vertex of one triangle for sixteen rays; z is unsheared.
///
/// # Safety
/// The level's features; `base` points to a lane of a block's vertices.
#[inline(always)]
unsafe fn corner16<W: Lanes>(base: *const f32, vertex: usize, k: [usize; 3], o: [W; 3], sx: W, sy: W) -> [W; 3] {
    // SAFETY: by the contract.
    unsafe {
        let p = base.add(24 * vertex);
        let z = W::splat(*p.add(8 * k[2])).sub(o[2]);
        [W::splat(*p.add(8 * k[0])).sub(o[0]).sub(sx.mul(z)), W::splat(*p.add(8 * k[1])).sub(o[1]).sub(sy.mul(z)), z]
    }
}

/// The upper tree.
struct Above<'a, const CLOSEST: bool> {
    world: &'a World,
}

impl<L: Level, const CLOSEST: bool> PacketVisitor<L> for Above<'_, CLOSEST> {
    #[inline(always)]
    unsafe fn leaf(&mut self, rays: &mut Rays, leaf: u32, mask: u32) {
        // SAFETY: by the contract.
        unsafe { instance::<L, CLOSEST>(self.world, leaf, rays, mask) }
    }
    #[inline(always)]
    unsafe fn alone(&mut self, _: &mut Rays, _: u32, _: u32) -> bool {
        false
    }
}

/// The packet in one instance.
#[inline(always)]
unsafe fn instance<L: Level, const CLOSEST: bool>(world: &World, slot: u32, rays: &mut Rays, mask: u32) {
    // SAFETY: slots and trees exist by the structure's invariants; features by the caller.
    unsafe {
        let record = world.records.get_unchecked(slot as usize);
        if !CLOSEST && !record.casts_shadow {
            return;
        }
        let blas = world.trees.get_unchecked(record.blas as usize);
        let mut o: [L::W16; 3] = [rays.origin[0].load(), rays.origin[1].load(), rays.origin[2].load()];
        let mut d: [L::W16; 3] = [rays.direction[0].load(), rays.direction[1].load(), rays.direction[2].load()];
        if !record.identity {
            let shifted = [
                o[0].sub(L::W16::splat(record.translation[0])),
                o[1].sub(L::W16::splat(record.translation[1])),
                o[2].sub(L::W16::splat(record.translation[2])),
            ];
            let (vo, vd) = (shifted, d);
            for a in 0..3 {
                let m = record.inverse[a];
                let row = [L::W16::splat(m[0]), L::W16::splat(m[1]), L::W16::splat(m[2])];
                o[a] = row[0].mul(vo[0]).add(row[1].mul(vo[1])).add(row[2].mul(vo[2]));
                d[a] = row[0].mul(vd[0]).add(row[1].mul(vd[1])).add(row[2].mul(vd[2]));
            }
        }
        let (mut left, mut singly) = (mask, 0);
        if blas.kd.is_some() || mask.count_ones() <= FEW {
            (left, singly) = (0, mask);
        }
        let kinds = Kinds::new::<L>(&d);
        while left != 0 {
            let group = kinds.like_first(left);
            left &= !group;
            if group.count_ones() <= FEW {
                singly |= group;
                continue;
            }
            let space = Space::new::<L>(&o, &d, rays.t_min.load(), &kinds, group, blas.extent, 1.0);
            let mut v = Inside::<CLOSEST> {
                nodes: &blas.nodes,
                blocks: &blas.blocks,
                space: &space,
                instance_id: record.instance_id,
            };
            walk::<L, _>(&blas.nodes, blas.root, &space, rays, group, &mut v);
        }
        if singly == 0 {
            return;
        }
        let (o, d) = (o.map(|w| Sixteen::of(w)), d.map(|w| Sixteen::of(w)));
        let mut mask = singly;
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            let at = |v: &[Sixteen; 3]| [v[0].0[lane], v[1].0[lane], v[2].0[lane]];
            let ray = RaySpace::new(at(&o), at(&d), blas.extent, 1.0);
            let (t_min, t_max) = (rays.t_min.0[lane], rays.t_max.0[lane]);
            let shear = Sheared::of(&ray);
            if CLOSEST {
                let mut best = rays.hit(lane);
                let instance_id = record.instance_id;
                let mut v =
                    BlasClosest { blocks: &blas.blocks, ray: shear, t_min, t_max, instance_id, best: &mut best };
                single::tree::<L, _>(blas, &ray, t_min, &mut v);
                rays.put(lane, &best);
            } else if single::tree::<L, _>(
                blas,
                &ray,
                t_min,
                &mut BlasAny { blocks: &blas.blocks, ray: shear, t_min, t_max },
            ) {
                rays.done(lane);
            }
        }
        rays.settle::<L>();
    }
}

/// The level's number of rays, all usable and of moderate direction, and which of them went together with others that are
/// alike. `None`: none of them.
///
/// # Safety
/// The level's features.
#[inline(always)]
unsafe fn together<L: Level, const CLOSEST: bool>(world: &World, input: &[Ray]) -> Option<(Rays, u32)> {
    // SAFETY: the world keeps the trees' invariants; features by the caller.
    unsafe {
        let mut rays = Rays {
            origin: [ZERO; 3],
            direction: [ZERO; 3],
            t_min: ZERO,
            t_max: ZERO,
            t: ZERO,
            u: ZERO,
            v: ZERO,
            prim: [Hit::NONE; RAYS],
            instance: [Hit::NONE; RAYS],
            limit: 0.0,
        };
        for (i, r) in input.iter().enumerate().take(L::RAYS) {
            rays.origin[0].0[i] = r.origin.x;
            rays.origin[1].0[i] = r.origin.y;
            rays.origin[2].0[i] = r.origin.z;
            rays.direction[0].0[i] = r.direction.x;
            rays.direction[1].0[i] = r.direction.y;
            rays.direction[2].0[i] = r.direction.z;
            rays.t_min.0[i] = r.t_min;
            rays.t_max.0[i] = r.t_max;
        }
        rays.t = rays.t_max;
        let o: [L::W16; 3] = [rays.origin[0].load(), rays.origin[1].load(), rays.origin[2].load()];
        let d: [L::W16; 3] = [rays.direction[0].load(), rays.direction[1].load(), rays.direction[2].load()];
        // Usable and moderate, as `usable` has it for one ray.
        let zero = L::W16::splat(0.0);
        let finite = o[0].mul(zero).add(o[1].mul(zero)).add(o[2].mul(zero).add(d[0].mul(zero)));
        let finite = finite.add(d[1].mul(zero).add(d[2].mul(zero))).eq(zero);
        let size = d[0].abs().max(d[1].abs()).max(d[2].abs());
        let all = (1u32 << L::RAYS) - 1;
        let moderate = L::W16::splat(super::MODERATE_MIN).le(size) & size.le(L::W16::splat(super::MODERATE_MAX));
        let ranged = rays.t_min.load::<L::W16>().lt(rays.t_max.load());
        if finite & moderate & ranged != all {
            return None;
        }
        rays.settle::<L>();
        let mut done = 0;
        if let Some(only) = world.only {
            instance::<L, CLOSEST>(world, only, &mut rays, all);
            done = all;
        } else if world.tlas.root != EMPTY {
            let kinds = Kinds::new::<L>(&d);
            let mut left = all;
            while left != 0 {
                let group = kinds.like_first(left);
                left &= !group;
                if group.count_ones() > FEW {
                    let space = Space::new::<L>(&o, &d, rays.t_min.load(), &kinds, group, world.extent, world.slack);
                    let mut v = Above::<CLOSEST> { world };
                    walk::<L, _>(&world.tlas.nodes, world.tlas.root, &space, &mut rays, group, &mut v);
                    done |= group;
                }
            }
        }
        Some((rays, done))
    }
}

/// Closest hits of the level's packet; the lanes whose hits are set, the others have to go alone.
///
/// # Safety
/// The level's features.
#[inline(always)]
pub(super) unsafe fn closest<L: Level>(world: &World, input: &[Ray], hits: &mut [Hit]) -> u32 {
    // SAFETY: by the caller.
    let Some((rays, done)) = (unsafe { together::<L, true>(world, input) }) else { return 0 };
    for (i, hit) in hits.iter_mut().enumerate() {
        *hit = if rays.prim[i] == Hit::NONE { Hit::MISS } else { rays.hit(i) };
    }
    done
}

/// Any hits of the level's packet; the lanes that are set, the others have to go alone.
///
/// # Safety
/// The level's features.
#[inline(always)]
pub(super) unsafe fn any<L: Level>(world: &World, input: &[Ray], hits: &mut [bool]) -> u32 {
    // SAFETY: by the caller.
    let Some((rays, done)) = (unsafe { together::<L, false>(world, input) }) else { return 0 };
    for (i, hit) in hits.iter_mut().enumerate() {
        *hit = rays.prim[i] != Hit::NONE;
    }
    done
}
