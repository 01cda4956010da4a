//! Binary trees by binned surface-area splits from the top, on all threads with the same result on any number of them.
//!
//! Source: Wald, "On fast Construction of SAH-based Bounding Volume Hierarchies", RT 2007.

use glam::{Vec4, Vec4Swizzles};
use obvhs::aabb::Aabb;
use obvhs::bvh2::node::Bvh2Node;
use rayon::prelude::*;

/// Box. Its fourth components are anything; where boxes of primitives are asked for, `hi.w` is the primitive's surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Box4 {
    pub lo: Vec4,
    pub hi: Vec4,
}

impl Box4 {
    pub const EMPTY: Self = Self { lo: Vec4::INFINITY, hi: Vec4::NEG_INFINITY };

    /// Of a triangle; `hi.w` is its surface.
    pub fn of(corners: &[glam::Vec3; 3]) -> Self {
        let surface = 0.5 * (corners[1] - corners[0]).cross(corners[2] - corners[0]).length();
        let [a, b, c] = corners.map(|p| p.extend(surface));
        Self { lo: a.min(b).min(c), hi: a.max(b).max(c) }
    }
    #[inline(always)]
    pub fn union(&self, o: &Self) -> Self {
        Self { lo: self.lo.min(o.lo), hi: self.hi.max(o.hi) }
    }
    #[inline(always)]
    pub fn half_area(&self) -> f32 {
        let d = self.hi - self.lo;
        let p = d * d.yzxw();
        (p.x + p.y) + p.z
    }
    /// Twice the centre.
    #[inline(always)]
    fn middle(&self) -> Vec4 {
        self.lo + self.hi
    }
    pub fn same(&self, o: &Self) -> bool {
        self.lo.xyz() == o.lo.xyz() && self.hi.xyz() == o.hi.xyz()
    }
}

/// Node of a binary tree. Two children lie side by side: the first at an odd number, the root is 0.
///
/// The boxes' fourth components are integers by their bits: the first child, or a leaf's first primitive; and a leaf's number of
/// primitives, 0 for others.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Node2 {
    lo: Vec4,
    hi: Vec4,
}

impl Node2 {
    pub const VACANT: Self = Self { lo: Vec4::ZERO, hi: Vec4::ZERO };

    #[inline(always)]
    pub fn new(b: &Box4, first: u32, count: u32) -> Self {
        Self { lo: b.lo.xyz().extend(f32::from_bits(first)), hi: b.hi.xyz().extend(f32::from_bits(count)) }
    }
    #[inline(always)]
    pub fn bounds(&self) -> Box4 {
        Box4 { lo: self.lo, hi: self.hi }
    }
    /// First child, or first primitive of a leaf.
    #[inline(always)]
    pub fn first(&self) -> u32 {
        self.lo.w.to_bits()
    }
    /// Primitives of a leaf, 0 for an inner node.
    #[inline(always)]
    pub fn count(&self) -> u32 {
        self.hi.w.to_bits()
    }
    #[inline(always)]
    pub fn is_leaf(&self) -> bool {
        self.count() != 0
    }
}

impl From<&Aabb> for Box4 {
    fn from(b: &Aabb) -> Self {
        Self { lo: b.min.extend(0.0), hi: b.max.extend(0.0) }
    }
}

impl From<&Bvh2Node> for Node2 {
    fn from(n: &Bvh2Node) -> Self {
        Self::new(&n.aabb().into(), n.first_index, n.prim_count)
    }
}

/// A primitive's box with its number in `lo.w`.
#[derive(Clone, Copy)]
struct Ref {
    b: Box4,
}

/// Of a range of primitives: box, and box of the boxes' middles.
#[derive(Clone, Copy)]
struct Extents {
    whole: Box4,
    middles: Box4,
}

impl Extents {
    const EMPTY: Self = Self { whole: Box4::EMPTY, middles: Box4::EMPTY };
    #[inline(always)]
    fn add(&mut self, b: &Box4) {
        self.whole = self.whole.union(b);
        let m = b.middle();
        self.middles = self.middles.union(&Box4 { lo: m, hi: m });
    }
    fn of(refs: &[Ref]) -> Self {
        let mut e = Self::EMPTY;
        refs.iter().for_each(|r| e.add(&r.b));
        e
    }
    fn with(self, o: &Self) -> Self {
        Self { whole: self.whole.union(&o.whole), middles: self.middles.union(&o.middles) }
    }
}

/// Most bins an axis.
const BINS: usize = 16;
/// Ranges of fewer primitives are split on one thread.
const PARALLEL: usize = 512;
/// Primitives that are looked at together; part of the result only by the signs of zeros, so it is the same for all threads.
const CHUNK: usize = 4096;
/// Deeper ranges are halved, so that recursion ends.
const DEEPEST: u32 = 96;

/// Nodes, and the primitives in the order of the leaves. Of at least one box, with finite areas.
pub(crate) fn build(boxes: &[Box4], max_leaf: usize) -> (Vec<Node2>, Vec<u32>) {
    let n = boxes.len();
    let mut refs: Vec<Ref> = boxes
        .par_iter()
        .enumerate()
        .with_min_len(CHUNK)
        .map(|(i, b)| Ref { b: Box4 { lo: b.lo.xyz().extend(f32::from_bits(i as u32)), hi: b.hi } })
        .collect();
    let parts: Vec<Extents> = refs.par_chunks(CHUNK).map(Extents::of).collect();
    let all = parts.iter().fold(Extents::EMPTY, |a, b| a.with(b));
    let mut nodes = vec![Node2::VACANT; 2 * n - 1];
    let mut ids = vec![0; n];
    let mut spare = refs.clone();
    let (root, below) = nodes.split_first_mut().expect("at least one");
    let range = Range { refs: &mut refs, spare: &mut spare, ids: &mut ids, first: 0, extents: all, depth: 0 };
    range.split(max_leaf, root, below, 1);
    (nodes, ids)
}

struct Range<'a> {
    refs: &'a mut [Ref],
    /// Room for as many.
    spare: &'a mut [Ref],
    /// Where their numbers go.
    ids: &'a mut [u32],
    /// Number of the first.
    first: u32,
    extents: Extents,
    depth: u32,
}

impl<'a> Range<'a> {
    /// * `below`: room for all nodes below this one, the first of which has the number `at`
    fn split(self, max_leaf: usize, node: &mut Node2, below: &mut [Node2], at: u32) {
        let n = self.refs.len();
        if n <= max_leaf {
            *node = Node2::new(&self.extents.whole, self.first, n as u32);
            self.ids.iter_mut().zip(self.refs).for_each(|(id, r)| *id = r.b.lo.w.to_bits());
            return;
        }
        *node = Node2::new(&self.extents.whole, at, 0);
        let [l, r] = self.halves();
        let (pair, below) = below.split_at_mut(2);
        let [left, right] = pair else { unreachable!("two") };
        let (lb, rb) = below.split_at_mut(2 * l.refs.len() - 2);
        let (la, ra) = (at + 2, at + 2 * l.refs.len() as u32);
        if n > PARALLEL {
            rayon::join(|| l.split(max_leaf, left, lb, la), || r.split(max_leaf, right, rb, ra));
        } else {
            l.split(max_leaf, left, lb, la);
            r.split(max_leaf, right, rb, ra);
        }
    }

    fn at(self, mid: usize) -> [Self; 2] {
        let (l, r) = self.refs.split_at_mut(mid);
        let (ls, rs) = self.spare.split_at_mut(mid);
        let (li, ri) = self.ids.split_at_mut(mid);
        let depth = self.depth + 1;
        let (left, right) = (Extents::of(l), Extents::of(r));
        [
            Range { refs: l, spare: ls, ids: li, first: self.first, extents: left, depth },
            Range { refs: r, spare: rs, ids: ri, first: self.first + mid as u32, extents: right, depth },
        ]
    }

    fn halves(self) -> [Self; 2] {
        let n = self.refs.len();
        if n == 2 || self.depth > DEEPEST {
            return self.at(n / 2);
        }
        let bins = if n < 32 { BINS / 2 } else { BINS };
        let grid = Grid::new(&self.extents.middles, bins);
        let best = if bins == BINS { grid.best::<BINS>(self.refs) } else { grid.best::<{ BINS / 2 }>(self.refs) };
        let Some((axis, border)) = best else { return self.at(n / 2) };
        // Each goes to both ends of what is left: no branch to be guessed.
        let (mut left, mut right) = (0, n - 1);
        for r in self.refs.iter() {
            self.spare[left] = *r;
            self.spare[right] = *r;
            let is_left = grid.bin(&r.b, axis, bins) < border;
            left += usize::from(is_left);
            right = right.wrapping_sub(usize::from(!is_left));
        }
        let turned = Range { refs: self.spare, spare: self.refs, ..self };
        turned.at(if left == 0 || left == n { n / 2 } else { left })
    }
}

/// Bins of boxes by their middles.
struct Grid {
    lo: Vec4,
    scale: Vec4,
}

/// Added to a small number, leaves its nearest integer in the lowest bits.
const ROUND: f32 = 12_582_912.0;

impl Grid {
    fn new(middles: &Box4, bins: usize) -> Self {
        let size = (middles.hi - middles.lo).xyz();
        let scale = (bins as f32 * 0.9999) / size;
        // A flat axis has one bin.
        let scale = glam::Vec3::select(scale.cmplt(glam::Vec3::INFINITY), scale, glam::Vec3::ZERO);
        Self { lo: middles.lo, scale: scale.extend(0.0) }
    }
    #[inline(always)]
    fn bin(&self, b: &Box4, axis: usize, bins: usize) -> u32 {
        let at = (b.lo[axis] + b.hi[axis] - self.lo[axis]) * self.scale[axis] - 0.5 + ROUND;
        at.to_bits() & (bins as u32 - 1)
    }
    #[inline(always)]
    fn bins<const N: usize>(&self, b: &Box4) -> [usize; 3] {
        let at = (b.middle() - self.lo) * self.scale - Vec4::splat(0.5) + Vec4::splat(ROUND);
        [at.x, at.y, at.z].map(|at| at.to_bits() as usize & (N - 1))
    }

    /// Axis, and first bin on the right: the least sum of areas times primitives. `None` where all primitives share a bin.
    #[inline(always)]
    fn best<const N: usize>(&self, refs: &[Ref]) -> Option<(usize, u32)> {
        let mut bins = [[Box4::EMPTY; N]; 3];
        let mut counts = [[0u32; N]; 3];
        for r in refs {
            let at = self.bins::<N>(&r.b);
            for axis in 0..3 {
                let bin = &mut bins[axis][at[axis]];
                *bin = bin.union(&r.b);
                counts[axis][at[axis]] += 1;
            }
        }
        let mut best = (f32::INFINITY, None);
        for (axis, (bins, counts)) in bins.iter().zip(&counts).enumerate() {
            let mut right = [f32::INFINITY; N];
            let (mut b, mut count) = (Box4::EMPTY, 0);
            for i in (1..N).rev() {
                b = b.union(&bins[i]);
                count += counts[i];
                if count != 0 {
                    right[i] = b.half_area() * count as f32;
                }
            }
            let (mut b, mut count) = (Box4::EMPTY, 0);
            for i in 1..N {
                b = b.union(&bins[i - 1]);
                count += counts[i - 1];
                if count == 0 {
                    continue;
                }
                let cost = b.half_area() * count as f32 + right[i];
                if cost < best.0 {
                    best = (cost, Some((axis, i as u32)));
                }
            }
        }
        best.1
    }
}
