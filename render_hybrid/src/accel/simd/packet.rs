//! Sixteen or eight rays together.
//!
//! Inner nodes are tested once for the whole packet: intervals of origins and reciprocal directions against eight children.
//! Leaves, and all children where the packet is wide, are then tested ray by ray, sixteen lanes a child. At a leaf the
//! cheaper of two orders is taken: all rays against one triangle after another, or one ray after another against all eight
//! triangles. A subtree that only few rays reach is walked by each of them alone. Only rays that agree in the signs and the
//! main axis of their directions are a packet (`many` sees to it); where an instance's space turns them apart, they go on in
//! groups that are alike there, and those that have nobody like them alone. Each ray's hit is the same bits either way. A tree of one node, as the upper tree of a small scene is, goes
//! without intervals, and its children are visited by the middle of the way through them: a room that holds all else comes
//! last, when most of it lies behind what was met.
//!
//! Source of the interval test: Boulos, Wald & Shirley, "Geometric and Arithmetic Culling Methods for Entire Ray Packets",
//! 2006; of the transposed leaf test and the fall-back: Benthin et al., "Combining Single and Packet Ray Tracing for
//! Arbitrary Ray Distributions on the Intel MIC Architecture", TVCG 2012.

mod inside;
mod space;
mod walk;

use self::inside::Inside;
use self::space::{Kinds, Rays, Sixteen, Space, ZERO};
use self::walk::{PacketVisitor, walk};
use super::lanes::{Lanes, Level};
use super::single::{self, BlasAny, BlasClosest, Sheared};
use crate::accel::node::EMPTY;
use crate::accel::ray_space::RaySpace;
use crate::accel::world::World;
use crate::accel::{Hit, Ray};

/// Rays of the largest packet.
pub(super) const RAYS: usize = 16;
/// At most so many rays in a subtree: each goes alone.
const FEW: u32 = 2;
/// As [`FEW`], where the packet falls into more than [`LIKE`] groups: so are diffuse rays, and what they have in common ends
/// soon.
const FEW_UNLIKE: u32 = 5;
const LIKE: u32 = 3;
/// Greatest ratio of reciprocal directions within a packet that is tested as one at inner nodes.
const TIGHT: f32 = 1.2;
/// An axis whose reciprocals all exceed the main axis's so many times may vary freely: its planes are crossed late or never.
const STEEP: f32 = 16.0;

/// The upper tree.
struct Above<'a, const CLOSEST: bool> {
    world: &'a World,
    space: &'a Space,
}

impl<L: Level, const CLOSEST: bool> PacketVisitor<L> for Above<'_, CLOSEST> {
    const BY_MIDDLE: bool = true;
    const ANY: bool = !CLOSEST;

    #[inline(always)]
    unsafe fn leaf(&mut self, rays: &mut Rays, leaf: u32, mask: u32) {
        // SAFETY: by the contract.
        unsafe { instance::<L, CLOSEST>(self.world, leaf, rays, mask, Some(self.space)) }
    }
    #[inline(always)]
    unsafe fn alone(&mut self, _: &mut Rays, _: u32, _: u32) -> bool {
        false
    }
}

/// The packet in one instance.
/// * `above`: the rays in world space, where they are alike
#[inline(always)]
unsafe fn instance<L: Level, const CLOSEST: bool>(
    world: &World,
    slot: u32,
    rays: &mut Rays,
    mask: u32,
    above: Option<&Space>,
) {
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
        // The boxes of the world hold this instance's: what is padded for them is padded for these.
        let above = above.filter(|_| record.identity);
        let few = if above.is_some() { FEW } else { few_of(&kinds, left) };
        while left != 0 {
            let group = if above.is_some() { left } else { kinds.like_first(left) };
            left &= !group;
            if group.count_ones() <= few {
                singly |= group;
                continue;
            }
            let own;
            let space = match above {
                Some(space) => space,
                None => {
                    own = Space::new::<L>(&o, &d, &kinds, group, blas.extent, 1.0);
                    &own
                }
            };
            let reach = space.reach::<L>(blas.extent);
            let (nodes, blocks, instance_id) = (&blas.nodes, &blas.blocks, record.instance_id);
            let mut v = Inside::<CLOSEST> { nodes, blocks, space, reach, instance_id };
            walk::<L, _>(nodes, blas.root, space, rays, group, &mut v);
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

/// At most so many like rays of a packet go alone.
#[inline(always)]
fn few_of(kinds: &Kinds, mask: u32) -> u32 {
    let (mut left, mut groups) = (mask, 0);
    while left != 0 {
        left &= !kinds.like_first(left);
        groups += 1;
    }
    if groups > LIKE { FEW_UNLIKE } else { FEW }
}

/// The level's number of rays; `None` where they are not all alike, usable and of moderate direction.
///
/// # Safety
/// The level's features.
#[inline(always)]
unsafe fn together<L: Level, const CLOSEST: bool>(world: &World, input: &[Ray]) -> Option<Rays> {
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
        let kinds = Kinds::new::<L>(&d);
        if kinds.like_first(all) != all {
            return None;
        }
        rays.settle::<L>();
        if let Some(only) = world.only {
            instance::<L, CLOSEST>(world, only, &mut rays, all, None);
        } else if world.tlas.root != EMPTY {
            let space = Space::new::<L>(&o, &d, &kinds, all, world.extent, world.slack);
            let mut v = Above::<CLOSEST> { world, space: &space };
            walk::<L, _>(&world.tlas.nodes, world.tlas.root, &space, &mut rays, all, &mut v);
        }
        Some(rays)
    }
}

/// Closest hits of the level's packet; false, and nothing is done, where it is none: see `together`.
///
/// # Safety
/// The level's features.
#[inline(always)]
pub(super) unsafe fn closest<L: Level>(world: &World, input: &[Ray], hits: &mut [Hit]) -> bool {
    // SAFETY: by the caller.
    let Some(rays) = (unsafe { together::<L, true>(world, input) }) else { return false };
    for (i, hit) in hits.iter_mut().enumerate() {
        *hit = if rays.prim[i] == Hit::NONE { Hit::MISS } else { rays.hit(i) };
    }
    true
}

/// Any hits of the level's packet, as [`closest`].
///
/// # Safety
/// The level's features.
#[inline(always)]
pub(super) unsafe fn any<L: Level>(world: &World, input: &[Ray], hits: &mut [bool]) -> bool {
    // SAFETY: by the caller.
    let Some(rays) = (unsafe { together::<L, false>(world, input) }) else { return false };
    for (i, hit) in hits.iter_mut().enumerate() {
        *hit = rays.prim[i] != Hit::NONE;
    }
    true
}
