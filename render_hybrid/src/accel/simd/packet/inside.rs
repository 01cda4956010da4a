//! The packet in one instance's tree: leaves, and narrow subtrees ray by ray.

use super::space::{Rays, Sixteen, Space};
use super::walk::PacketVisitor;
use crate::accel::Hit;
use crate::accel::node::{BLOCK, LEN_SHIFT, Node8, Tri8};
use crate::accel::ray_space::RaySpace;
use crate::accel::simd::count;
use crate::accel::simd::lanes::{Lanes, Level};
use crate::accel::simd::single::{self, BlasAny, BlasClosest, Sheared, hard_lane, intersect8, nearer};
use crate::accel::triangle::{CONDITION, DET_MAX, DET_MIN};

/// One instance's tree.
pub(super) struct Inside<'a, const CLOSEST: bool> {
    pub(super) nodes: &'a [Node8],
    pub(super) blocks: &'a [Tri8],
    pub(super) space: &'a Space,
    /// `RaySpace::reach` of each ray.
    pub(super) reach: Sixteen,
    pub(super) instance_id: u32,
}

impl<L: Level, const CLOSEST: bool> PacketVisitor<L> for Inside<'_, CLOSEST> {
    const BY_MIDDLE: bool = false;
    const ANY: bool = !CLOSEST;

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
                let ray = self.space.lane(lane, &self.reach);
                let (t_min, t_max) = (rays.t_min.0[lane], rays.t_max.0[lane]);
                if CLOSEST {
                    let mut best = rays.hit(lane);
                    alone_closest::<L>(self.nodes, self.blocks, child, &ray, t_min, t_max, self.instance_id, &mut best);
                    rays.put(lane, &best);
                } else {
                    let mut v =
                        BlasAny { blocks: self.blocks, ray: self.space.sheared(lane, &self.reach), t_min, t_max };
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
                let ray = self.space.sheared(lane, &self.reach);
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
            let well = m.mul(m).mul(m).mul(L::W16::splat(CONDITION)).le(size.mul(self.reach.load()));
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
                if let Some((t, u, v)) = hard_lane(block, at, &s.sheared(lane, &self.reach))
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
