//! Vectors of 8 and 16 f32 for each instruction set. Only add, subtract, multiply, divide, min, max and comparisons: IEEE
//! operations with one answer on every machine. `min` and `max` return the second operand where either is NaN.
//!
//! `slab` (a·b − c) alone may or may not be fused; it is for boxes, whose padding holds either rounding.

/// A vector of `N` f32.
///
/// # Safety
/// Every method of a type requires the processor features of its level; `load` and `store` require `N` valid f32.
pub(super) trait Lanes: Copy {
    unsafe fn splat(x: f32) -> Self;
    unsafe fn load(p: *const f32) -> Self;
    unsafe fn store(self, p: *mut f32);
    unsafe fn add(self, o: Self) -> Self;
    unsafe fn sub(self, o: Self) -> Self;
    unsafe fn mul(self, o: Self) -> Self;
    unsafe fn div(self, o: Self) -> Self;
    unsafe fn min(self, o: Self) -> Self;
    unsafe fn max(self, o: Self) -> Self;
    unsafe fn abs(self) -> Self;
    /// self · b − c, fused or not.
    unsafe fn slab(self, b: Self, c: Self) -> Self;
    /// Bit i: self[i] <= o[i], false for NaN.
    unsafe fn le(self, o: Self) -> u32;
    /// Bit i: self[i] < o[i], false for NaN.
    unsafe fn lt(self, o: Self) -> u32;
    /// Bit i: self[i] == o[i], false for NaN.
    unsafe fn eq(self, o: Self) -> u32;
    /// Lanes whose bit is set from `self`, the others from `o`.
    unsafe fn select(self, o: Self, mask: u32) -> Self;
    /// Least of all lanes.
    unsafe fn least(self) -> f32;
    /// Greatest of all lanes.
    unsafe fn greatest(self) -> f32;
}

/// Instruction-set level: its vectors.
pub(super) trait Level {
    type W8: Lanes;
    type W16: Lanes;
    /// Rays of a packet: the lanes of `W16`.
    const RAYS: usize = 16;
    /// Traversals tally what they test: see `count`.
    const COUNT: bool = false;
    /// Asks for a cache line that will be read soon.
    #[inline(always)]
    fn prefetch(_: *const u8) {}
    /// Children with enter <= leave, each with its `enter`, the farthest first (within 1e-6 of each other in any order). Returns how
    /// many; eight are written in any case.
    ///
    /// # Safety
    /// The level's features, eight children, room for eight.
    #[inline(always)]
    unsafe fn push(enter: Self::W8, leave: Self::W8, child: *const u32, to_child: *mut u32, to_t: *mut f32) -> usize {
        // SAFETY: by the contract.
        unsafe {
            let mut mask = enter.le(leave);
            let mut t = [0.0f32; 8];
            enter.store(t.as_mut_ptr());
            let mut count = 0;
            while mask != 0 {
                let slot = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                let mut i = count;
                while i > 0 && *to_t.add(i - 1) < t[slot] {
                    *to_t.add(i) = *to_t.add(i - 1);
                    *to_child.add(i) = *to_child.add(i - 1);
                    i -= 1;
                }
                *to_t.add(i) = t[slot];
                *to_child.add(i) = *child.add(slot);
                count += 1;
            }
            count
        }
    }
}

/// Arrays, which the compiler turns into whatever vectors the target guarantees.
#[derive(Clone, Copy)]
#[repr(align(32))]
pub(super) struct Array<const N: usize>([f32; N]);

macro_rules! zip {
    ($a:expr, $b:expr, |$x:ident, $y:ident| $f:expr) => {{
        let (a, b) = ($a.0, $b.0);
        let mut out = a;
        for i in 0..N {
            let ($x, $y) = (a[i], b[i]);
            out[i] = $f;
        }
        Array(out)
    }};
}

macro_rules! bits {
    ($a:expr, $b:expr, |$x:ident, $y:ident| $f:expr) => {{
        let (a, b) = ($a.0, $b.0);
        let mut out = 0;
        for i in 0..N {
            let ($x, $y) = (a[i], b[i]);
            out |= u32::from($f) << i;
        }
        out
    }};
}

impl<const N: usize> Lanes for Array<N> {
    #[inline(always)]
    unsafe fn splat(x: f32) -> Self {
        Self([x; N])
    }
    #[inline(always)]
    unsafe fn load(p: *const f32) -> Self {
        // SAFETY: the caller gives N valid f32.
        Self(unsafe { p.cast::<[f32; N]>().read_unaligned() })
    }
    #[inline(always)]
    unsafe fn store(self, p: *mut f32) {
        // SAFETY: the caller gives room for N f32.
        unsafe { p.cast::<[f32; N]>().write_unaligned(self.0) }
    }
    #[inline(always)]
    unsafe fn add(self, o: Self) -> Self {
        zip!(self, o, |a, b| a + b)
    }
    #[inline(always)]
    unsafe fn sub(self, o: Self) -> Self {
        zip!(self, o, |a, b| a - b)
    }
    #[inline(always)]
    unsafe fn mul(self, o: Self) -> Self {
        zip!(self, o, |a, b| a * b)
    }
    #[inline(always)]
    unsafe fn div(self, o: Self) -> Self {
        zip!(self, o, |a, b| a / b)
    }
    #[inline(always)]
    unsafe fn min(self, o: Self) -> Self {
        zip!(self, o, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    unsafe fn max(self, o: Self) -> Self {
        zip!(self, o, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    unsafe fn abs(self) -> Self {
        Self(self.0.map(f32::abs))
    }
    #[inline(always)]
    unsafe fn slab(self, b: Self, c: Self) -> Self {
        // SAFETY: no features are needed.
        unsafe { self.mul(b).sub(c) }
    }
    #[inline(always)]
    unsafe fn le(self, o: Self) -> u32 {
        bits!(self, o, |a, b| a <= b)
    }
    #[inline(always)]
    unsafe fn lt(self, o: Self) -> u32 {
        bits!(self, o, |a, b| a < b)
    }
    #[inline(always)]
    unsafe fn eq(self, o: Self) -> u32 {
        bits!(self, o, |a, b| a == b)
    }
    #[inline(always)]
    unsafe fn select(self, o: Self, mask: u32) -> Self {
        let mut out = o.0;
        for i in 0..N {
            if mask >> i & 1 != 0 {
                out[i] = self.0[i];
            }
        }
        Self(out)
    }
    #[inline(always)]
    unsafe fn least(self) -> f32 {
        self.0.iter().fold(f32::INFINITY, |m, &x| if x < m { x } else { m })
    }
    #[inline(always)]
    unsafe fn greatest(self) -> f32 {
        self.0.iter().fold(f32::NEG_INFINITY, |m, &x| if x > m { x } else { m })
    }
}

/// What the compile target guarantees.
pub(super) struct Portable;
impl Level for Portable {
    type W8 = Array<8>;
    type W16 = Array<16>;
}

/// [`Portable`] with tallies; visits what every level visits.
pub(super) struct Counted;
impl Level for Counted {
    type W8 = Array<8>;
    type W16 = Array<16>;
    const COUNT: bool = true;
}

/// A level whose packets have eight rays.
pub(super) struct Half<L>(std::marker::PhantomData<L>);
impl<L: Level> Level for Half<L> {
    type W8 = L::W8;
    type W16 = L::W8;
    const RAYS: usize = 8;
    const COUNT: bool = L::COUNT;
    #[inline(always)]
    fn prefetch(p: *const u8) {
        L::prefetch(p);
    }
    #[inline(always)]
    unsafe fn push(enter: Self::W8, leave: Self::W8, child: *const u32, to_child: *mut u32, to_t: *mut f32) -> usize {
        // SAFETY: by the contract.
        unsafe { L::push(enter, leave, child, to_child, to_t) }
    }
}
