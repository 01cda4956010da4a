//! AVX2 + FMA and AVX-512 (F, VL) vectors.

use super::lanes::{Lanes, Level};
use std::arch::x86_64::*;

/// 256-bit vectors with movemask.
#[derive(Clone, Copy)]
pub(super) struct A8(__m256);

/// Two of them.
#[derive(Clone, Copy)]
pub(super) struct A16(A8, A8);

/// 256-bit vectors with AVX-512's mask registers.
#[derive(Clone, Copy)]
pub(super) struct Z8(__m256);

/// 512-bit vectors.
#[derive(Clone, Copy)]
pub(super) struct Z16(__m512);

macro_rules! body {
    // SAFETY of every expansion: the trait's contract gives the processor features, and valid memory for load and store.
    ($($e:tt)*) => { unsafe { $($e)* } };
}

macro_rules! common8 {
    () => {
        #[inline(always)]
        unsafe fn splat(x: f32) -> Self {
            body!(Self(_mm256_set1_ps(x)))
        }
        #[inline(always)]
        unsafe fn load(p: *const f32) -> Self {
            body!(Self(_mm256_loadu_ps(p)))
        }
        #[inline(always)]
        unsafe fn store(self, p: *mut f32) {
            body!(_mm256_storeu_ps(p, self.0))
        }
        #[inline(always)]
        unsafe fn add(self, o: Self) -> Self {
            body!(Self(_mm256_add_ps(self.0, o.0)))
        }
        #[inline(always)]
        unsafe fn sub(self, o: Self) -> Self {
            body!(Self(_mm256_sub_ps(self.0, o.0)))
        }
        #[inline(always)]
        unsafe fn mul(self, o: Self) -> Self {
            body!(Self(_mm256_mul_ps(self.0, o.0)))
        }
        #[inline(always)]
        unsafe fn div(self, o: Self) -> Self {
            body!(Self(_mm256_div_ps(self.0, o.0)))
        }
        #[inline(always)]
        unsafe fn min(self, o: Self) -> Self {
            body!(Self(_mm256_min_ps(self.0, o.0)))
        }
        #[inline(always)]
        unsafe fn max(self, o: Self) -> Self {
            body!(Self(_mm256_max_ps(self.0, o.0)))
        }
        #[inline(always)]
        unsafe fn abs(self) -> Self {
            body!(Self(_mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0)))
        }
        #[inline(always)]
        unsafe fn slab(self, b: Self, c: Self) -> Self {
            body!(Self(_mm256_fmsub_ps(self.0, b.0, c.0)))
        }
        #[inline(always)]
        unsafe fn least(self) -> f32 {
            body!({
                let h = _mm_min_ps(_mm256_castps256_ps128(self.0), _mm256_extractf128_ps::<1>(self.0));
                let h = _mm_min_ps(h, _mm_movehl_ps(h, h));
                _mm_cvtss_f32(_mm_min_ss(h, _mm_shuffle_ps::<1>(h, h)))
            })
        }
        #[inline(always)]
        unsafe fn greatest(self) -> f32 {
            body!({
                let h = _mm_max_ps(_mm256_castps256_ps128(self.0), _mm256_extractf128_ps::<1>(self.0));
                let h = _mm_max_ps(h, _mm_movehl_ps(h, h));
                _mm_cvtss_f32(_mm_max_ss(h, _mm_shuffle_ps::<1>(h, h)))
            })
        }
    };
}

impl Lanes for A8 {
    common8!();
    #[inline(always)]
    unsafe fn le(self, o: Self) -> u32 {
        body!(_mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(self.0, o.0)) as u32)
    }
    #[inline(always)]
    unsafe fn lt(self, o: Self) -> u32 {
        body!(_mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, o.0)) as u32)
    }
    #[inline(always)]
    unsafe fn eq(self, o: Self) -> u32 {
        body!(_mm256_movemask_ps(_mm256_cmp_ps::<_CMP_EQ_OQ>(self.0, o.0)) as u32)
    }
    #[inline(always)]
    unsafe fn select(self, o: Self, mask: u32) -> Self {
        body!({
            let bit = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
            let m = _mm256_cmpeq_epi32(_mm256_and_si256(_mm256_set1_epi32(mask as i32), bit), bit);
            Self(_mm256_blendv_ps(o.0, self.0, _mm256_castsi256_ps(m)))
        })
    }
}

impl Lanes for Z8 {
    common8!();
    #[inline(always)]
    unsafe fn le(self, o: Self) -> u32 {
        body!(u32::from(_mm256_cmp_ps_mask::<_CMP_LE_OQ>(self.0, o.0)))
    }
    #[inline(always)]
    unsafe fn lt(self, o: Self) -> u32 {
        body!(u32::from(_mm256_cmp_ps_mask::<_CMP_LT_OQ>(self.0, o.0)))
    }
    #[inline(always)]
    unsafe fn eq(self, o: Self) -> u32 {
        body!(u32::from(_mm256_cmp_ps_mask::<_CMP_EQ_OQ>(self.0, o.0)))
    }
    #[inline(always)]
    unsafe fn select(self, o: Self, mask: u32) -> Self {
        body!(Self(_mm256_mask_blend_ps(mask as u8, o.0, self.0)))
    }
}

macro_rules! both {
    ($self:ident, $o:ident, $f:ident) => {
        body!(Self($self.0.$f($o.0), $self.1.$f($o.1)))
    };
}

impl Lanes for A16 {
    #[inline(always)]
    unsafe fn splat(x: f32) -> Self {
        body!(Self(A8::splat(x), A8::splat(x)))
    }
    #[inline(always)]
    unsafe fn load(p: *const f32) -> Self {
        body!(Self(A8::load(p), A8::load(p.add(8))))
    }
    #[inline(always)]
    unsafe fn store(self, p: *mut f32) {
        body!({
            self.0.store(p);
            self.1.store(p.add(8));
        })
    }
    #[inline(always)]
    unsafe fn add(self, o: Self) -> Self {
        both!(self, o, add)
    }
    #[inline(always)]
    unsafe fn sub(self, o: Self) -> Self {
        both!(self, o, sub)
    }
    #[inline(always)]
    unsafe fn mul(self, o: Self) -> Self {
        both!(self, o, mul)
    }
    #[inline(always)]
    unsafe fn div(self, o: Self) -> Self {
        both!(self, o, div)
    }
    #[inline(always)]
    unsafe fn min(self, o: Self) -> Self {
        both!(self, o, min)
    }
    #[inline(always)]
    unsafe fn max(self, o: Self) -> Self {
        both!(self, o, max)
    }
    #[inline(always)]
    unsafe fn abs(self) -> Self {
        body!(Self(self.0.abs(), self.1.abs()))
    }
    #[inline(always)]
    unsafe fn slab(self, b: Self, c: Self) -> Self {
        body!(Self(self.0.slab(b.0, c.0), self.1.slab(b.1, c.1)))
    }
    #[inline(always)]
    unsafe fn le(self, o: Self) -> u32 {
        body!(self.0.le(o.0) | self.1.le(o.1) << 8)
    }
    #[inline(always)]
    unsafe fn lt(self, o: Self) -> u32 {
        body!(self.0.lt(o.0) | self.1.lt(o.1) << 8)
    }
    #[inline(always)]
    unsafe fn eq(self, o: Self) -> u32 {
        body!(self.0.eq(o.0) | self.1.eq(o.1) << 8)
    }
    #[inline(always)]
    unsafe fn select(self, o: Self, mask: u32) -> Self {
        body!(Self(self.0.select(o.0, mask & 255), self.1.select(o.1, mask >> 8)))
    }
    #[inline(always)]
    unsafe fn least(self) -> f32 {
        body!(self.0.min(self.1).least())
    }
    #[inline(always)]
    unsafe fn greatest(self) -> f32 {
        body!(self.0.max(self.1).greatest())
    }
}

impl Lanes for Z16 {
    #[inline(always)]
    unsafe fn splat(x: f32) -> Self {
        body!(Self(_mm512_set1_ps(x)))
    }
    #[inline(always)]
    unsafe fn load(p: *const f32) -> Self {
        body!(Self(_mm512_loadu_ps(p)))
    }
    #[inline(always)]
    unsafe fn store(self, p: *mut f32) {
        body!(_mm512_storeu_ps(p, self.0))
    }
    #[inline(always)]
    unsafe fn add(self, o: Self) -> Self {
        body!(Self(_mm512_add_ps(self.0, o.0)))
    }
    #[inline(always)]
    unsafe fn sub(self, o: Self) -> Self {
        body!(Self(_mm512_sub_ps(self.0, o.0)))
    }
    #[inline(always)]
    unsafe fn mul(self, o: Self) -> Self {
        body!(Self(_mm512_mul_ps(self.0, o.0)))
    }
    #[inline(always)]
    unsafe fn div(self, o: Self) -> Self {
        body!(Self(_mm512_div_ps(self.0, o.0)))
    }
    #[inline(always)]
    unsafe fn min(self, o: Self) -> Self {
        body!(Self(_mm512_min_ps(self.0, o.0)))
    }
    #[inline(always)]
    unsafe fn max(self, o: Self) -> Self {
        body!(Self(_mm512_max_ps(self.0, o.0)))
    }
    #[inline(always)]
    unsafe fn abs(self) -> Self {
        body!(Self(_mm512_abs_ps(self.0)))
    }
    #[inline(always)]
    unsafe fn slab(self, b: Self, c: Self) -> Self {
        body!(Self(_mm512_fmsub_ps(self.0, b.0, c.0)))
    }
    #[inline(always)]
    unsafe fn le(self, o: Self) -> u32 {
        body!(u32::from(_mm512_cmp_ps_mask::<_CMP_LE_OQ>(self.0, o.0)))
    }
    #[inline(always)]
    unsafe fn lt(self, o: Self) -> u32 {
        body!(u32::from(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, o.0)))
    }
    #[inline(always)]
    unsafe fn eq(self, o: Self) -> u32 {
        body!(u32::from(_mm512_cmp_ps_mask::<_CMP_EQ_OQ>(self.0, o.0)))
    }
    #[inline(always)]
    unsafe fn select(self, o: Self, mask: u32) -> Self {
        body!(Self(_mm512_mask_blend_ps(mask as u16, o.0, self.0)))
    }
    #[inline(always)]
    unsafe fn least(self) -> f32 {
        body!(_mm512_reduce_min_ps(self.0))
    }
    #[inline(always)]
    unsafe fn greatest(self) -> f32 {
        body!(_mm512_reduce_max_ps(self.0))
    }
}

/// AVX2 and FMA.
pub(super) struct Avx2;
impl Level for Avx2 {
    type W8 = A8;
    type W16 = A16;
    #[inline(always)]
    fn prefetch(p: *const u8) {
        // SAFETY: a prefetch reads nothing, whatever the address; SSE is part of x86-64.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(p.cast()) }
    }
}

/// AVX-512 F and VL on top.
pub(super) struct Avx512;
impl Level for Avx512 {
    type W8 = Z8;
    type W16 = Z16;
    #[inline(always)]
    fn prefetch(p: *const u8) {
        // SAFETY: a prefetch reads nothing, whatever the address; SSE is part of x86-64.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(p.cast()) }
    }
}
