//! Sixteen rays in one space: what boxes and triangles need of them, ray by ray and all as one.

use super::{RAYS, STEEP, TIGHT};
use crate::accel::Hit;
use crate::accel::node::Node8;
use crate::accel::ray_space::{LEAST_SLOPE, PAD, RaySpace};
use crate::accel::simd::lanes::{Lanes, Level};
use crate::accel::simd::single::Sheared;

#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Sixteen(pub(super) [f32; RAYS]);

pub(super) const ZERO: Sixteen = Sixteen([0.0; RAYS]);

impl Sixteen {
    #[inline(always)]
    pub(super) unsafe fn load<W: Lanes>(&self) -> W {
        // SAFETY: sixteen f32; features by the caller.
        unsafe { W::load(self.0.as_ptr()) }
    }
    #[inline(always)]
    pub(super) unsafe fn of<W: Lanes>(w: W) -> Self {
        let mut out = ZERO;
        // SAFETY: room for sixteen f32; features by the caller.
        unsafe { w.store(out.0.as_mut_ptr()) };
        out
    }
}

/// Rays of one packet, world space, and what they have met.
pub(super) struct Rays {
    pub(super) origin: [Sixteen; 3],
    pub(super) direction: [Sixteen; 3],
    pub(super) t_min: Sixteen,
    pub(super) t_max: Sixteen,
    /// Distance met so far, or t_max. −infinity: the ray is done.
    pub(super) t: Sixteen,
    pub(super) u: Sixteen,
    pub(super) v: Sixteen,
    pub(super) prim: [u32; RAYS],
    pub(super) instance: [u32; RAYS],
    /// Greatest of `t`.
    pub(super) limit: f32,
}

impl Rays {
    pub(super) fn hit(&self, lane: usize) -> Hit {
        Hit {
            t: self.t.0[lane],
            u: self.u.0[lane],
            v: self.v.0[lane],
            instance_id: self.instance[lane],
            primitive_id: self.prim[lane],
        }
    }
    #[inline(always)]
    pub(super) fn put(&mut self, lane: usize, hit: &Hit) {
        self.t.0[lane] = hit.t;
        self.u.0[lane] = hit.u;
        self.v.0[lane] = hit.v;
        self.instance[lane] = hit.instance_id;
        self.prim[lane] = hit.primitive_id;
    }
    #[inline(always)]
    pub(super) fn done(&mut self, lane: usize) {
        self.t.0[lane] = f32::NEG_INFINITY;
        self.prim[lane] = 0;
    }
    #[inline(always)]
    pub(super) unsafe fn settle<L: Level>(&mut self) {
        // SAFETY: features by the caller.
        self.limit = unsafe { self.t.load::<L::W16>().greatest() };
    }
}

/// `RaySpace` of sixteen rays, and their intervals.
pub(super) struct Space {
    pub(super) origin: [Sixteen; 3],
    pub(super) inv: [Sixteen; 3],
    pub(super) near: [Sixteen; 3],
    pub(super) far: [Sixteen; 3],
    pub(super) shear: [Sixteen; 3],
    pub(super) k: [usize; 3],
    pub(super) near_plane: [usize; 3],
    /// What box planes are padded by.
    pub(super) pad: Sixteen,
}

/// The rays of a `Space` as one: where any of them may be.
pub(super) struct Intervals {
    /// Per axis (inv low, inv high, near · low, near · high, far · low, far · high).
    pub(super) bounds: [[f32; 6]; 3],
    pub(super) t_first: f32,
    /// They are so much alike that what holds for all holds for most.
    pub(super) tight: bool,
}

impl Intervals {
    pub(super) const NONE: Self = Self { bounds: [[0.0; 6]; 3], t_first: 0.0, tight: false };
}

/// Which lanes' directions have the same signs and main axis.
pub(super) struct Kinds {
    pub(super) negative: [u32; 3],
    pub(super) x: u32,
    pub(super) y: u32,
}

impl Kinds {
    /// # Safety
    /// The level's features.
    #[inline(always)]
    pub(super) unsafe fn new<L: Level>(d: &[L::W16; 3]) -> Self {
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
    pub(super) fn like_first(&self, mask: u32) -> u32 {
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
    pub(super) unsafe fn new<L: Level>(
        origin: &[L::W16; 3],
        direction: &[L::W16; 3],
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
                k,
                near_plane,
                pad: Sixteen::of(pad),
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
            }
            space
        }
    }

    /// # Safety
    /// The level's features.
    #[inline(always)]
    pub(super) unsafe fn intervals<L: Level>(&self, rays: &Rays) -> Intervals {
        // SAFETY: features by the caller.
        unsafe {
            let pad: L::W16 = self.pad.load();
            let main = self.inv[self.k[2]].load::<L::W16>().greatest().abs();
            let t_first = rays.t_min.load::<L::W16>().least();
            let mut out = Intervals { bounds: [[0.0; 6]; 3], t_first, tight: true };
            for a in 0..3 {
                let (origin, inv): (L::W16, L::W16) = (self.origin[a].load(), self.inv[a].load());
                let negative = self.near_plane[a] & 1 == 1;
                let (low, high) = (inv.least(), inv.greatest());
                let (less, more) = (origin.sub(pad), origin.add(pad));
                let (n, f) = if negative { (less.least(), more.greatest()) } else { (more.greatest(), less.least()) };
                out.bounds[a] = [low, high, n * low, n * high, f * low, f * high];
                let (small, large) = if negative { (-high, -low) } else { (low, high) };
                out.tight &= large <= small * TIGHT || small > STEEP * main;
            }
            out
        }
    }

    /// Greatest coordinate of each origin + `extent`, as `RaySpace::reach`.
    ///
    /// # Safety
    /// The level's features.
    #[inline(always)]
    pub(super) unsafe fn reach<L: Level>(&self, extent: f32) -> Sixteen {
        // SAFETY: features by the caller.
        unsafe {
            let size = |a: usize| self.origin[a].load::<L::W16>().abs();
            Sixteen::of(size(0).max(size(1)).max(size(2)).add(L::W16::splat(extent)))
        }
    }

    #[inline(always)]
    pub(super) fn sheared(&self, lane: usize, reach: &Sixteen) -> Sheared {
        let [kx, ky, kz] = self.k;
        Sheared {
            k: self.k,
            origin_k: [self.origin[kx].0[lane], self.origin[ky].0[lane], self.origin[kz].0[lane]],
            shear: [self.shear[0].0[lane], self.shear[1].0[lane], self.shear[2].0[lane]],
            reach: reach.0[lane],
        }
    }

    #[inline(always)]
    pub(super) fn lane(&self, lane: usize, reach: &Sixteen) -> RaySpace {
        let pick = |v: &[Sixteen; 3]| [v[0].0[lane], v[1].0[lane], v[2].0[lane]];
        RaySpace {
            origin: pick(&self.origin),
            shear: pick(&self.shear),
            k: self.k,
            inv: pick(&self.inv),
            near: pick(&self.near),
            far: pick(&self.far),
            near_plane: self.near_plane,
            reach: reach.0[lane],
        }
    }

    /// Lanes of `mask` that may pass through a child's box before their `t`, and where each enters and leaves it.
    ///
    /// # Safety
    /// The level's features.
    #[inline(always)]
    pub(super) unsafe fn lanes<L: Level>(
        &self,
        node: &Node8,
        slot: usize,
        rays: &Rays,
        mask: u32,
    ) -> (u32, L::W16, L::W16) {
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
            (enter.le(leave) & mask, enter, leave)
        }
    }
}
