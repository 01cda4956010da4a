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

/// Bits of a distance, so that greater ones come first, with the number of the child in the lowest three.
///
/// # Safety
/// AVX2.
#[inline(always)]
unsafe fn keys(enter: __m256) -> __m256i {
    body!({
        let turned = _mm256_xor_si256(_mm256_castps_si256(enter), _mm256_set1_epi32(i32::MAX));
        _mm256_or_si256(_mm256_and_si256(turned, _mm256_set1_epi32(!7)), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7))
    })
}

/// One layer of a sorting network of four: lanes against those of `$order`, the greater ones to `$greater`.
macro_rules! layer4 {
    ($k:expr, $order:literal, $greater:literal) => {{
        let (k, o) = ($k, _mm_shuffle_epi32::<$order>($k));
        _mm_blend_epi32::<$greater>(_mm_min_epu32(k, o), _mm_max_epu32(k, o))
    }};
}

/// Sorts keys and writes children and distances in their order.
///
/// # Safety
/// AVX2, eight children, room for eight.
#[inline(always)]
unsafe fn sort(k: __m256i, enter: __m256, child: *const u32, to_child: *mut u32, to_t: *mut f32) {
    macro_rules! layer {
        ($k:expr, $other:expr, $greater:literal) => {{
            let (k, o) = ($k, $other);
            _mm256_blend_epi32::<$greater>(_mm256_min_epu32(k, o), _mm256_max_epu32(k, o))
        }};
    }
    body!({
        let k = layer!(k, _mm256_shuffle_epi32::<0xB1>(k), 0xAA);
        let k = layer!(k, _mm256_shuffle_epi32::<0x1B>(k), 0xCC);
        let k = layer!(k, _mm256_shuffle_epi32::<0xB1>(k), 0xAA);
        let k = layer!(k, _mm256_permutevar8x32_epi32(k, _mm256_setr_epi32(7, 6, 5, 4, 3, 2, 1, 0)), 0xF0);
        let k = layer!(k, _mm256_shuffle_epi32::<0x4E>(k), 0xCC);
        let k = layer!(k, _mm256_shuffle_epi32::<0xB1>(k), 0xAA);
        // The permutation reads the lowest three bits alone.
        let children = _mm256_permutevar8x32_epi32(_mm256_loadu_si256(child.cast()), k);
        _mm256_storeu_si256(to_child.cast(), children);
        _mm256_storeu_ps(to_t, _mm256_permutevar8x32_ps(enter, k));
    })
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
    #[inline(always)]
    unsafe fn push(enter: A8, leave: A8, child: *const u32, to_child: *mut u32, to_t: *mut f32) -> usize {
        body!({
            let met = _mm256_cmp_ps::<_CMP_LE_OQ>(enter.0, leave.0);
            let missed = _mm256_xor_si256(_mm256_castps_si256(met), _mm256_set1_epi32(-1));
            sort(_mm256_or_si256(keys(enter.0), missed), enter.0, child, to_child, to_t);
            (_mm256_movemask_ps(met) as u32).count_ones() as usize
        })
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
    #[inline(always)]
    unsafe fn push(enter: Z8, leave: Z8, child: *const u32, to_child: *mut u32, to_t: *mut f32) -> usize {
        body!({
            let met = _mm256_cmp_ps_mask::<_CMP_LE_OQ>(enter.0, leave.0);
            let count = met.count_ones() as usize;
            let keys = keys(enter.0);
            if count > 4 {
                sort(_mm256_mask_blend_epi32(met, _mm256_set1_epi32(-1), keys), enter.0, child, to_child, to_t);
                return count;
            }
            let k = _mm256_mask_compress_epi32(_mm256_set1_epi32(-1), met, keys);
            let k = _mm256_castsi256_si128(k);
            let k = layer4!(k, 0xB1, 0xA);
            let k = layer4!(k, 0x1B, 0xC);
            let k = layer4!(k, 0xB1, 0xA);
            let children = _mm256_permutevar8x32_epi32(_mm256_loadu_si256(child.cast()), _mm256_castsi128_si256(k));
            _mm_storeu_si128(to_child.cast(), _mm256_castsi256_si128(children));
            let t = _mm256_permutevar8x32_ps(enter.0, _mm256_castsi128_si256(k));
            _mm_storeu_ps(to_t, _mm256_castps256_ps128(t));
            count
        })
    }
}
