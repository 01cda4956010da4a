//! How widely a shadow map is filtered: penumbrae widen with the distance between occluder and receiver.
//!
//! A map has a pyramid: level l + 1 is level l at half the side, so that level l is blurred to σ = [`LEVEL_SIGMA`] · 2^l texels
//! of the map. Where the light's disc as seen past an occluder at half the distance would be so wide, the moments tell how much
//! is occluded and, as two layers are all that they can tell, how deep the occluder lies; from there the disc's image on the
//! map is σ of the level that is then asked.
//!
//! Limits: occluders at several depths count as one at their mean; one nearer to the light than half the receiver's distance
//! throws a penumbra as wide, but is found within the width of the former only; off the axis the disc's image is taken to be
//! round.
//!
//! Sources: Fernando, "Percentage-Closer Soft Shadows", SIGGRAPH 2005 sketches (width from the mean occluder's depth); Yang et al.,
//! "Variance Soft Shadow Mapping", Pacific Graphics 2010 (that depth from moments).

use glam::Vec4;
use rayon::prelude::*;

use super::shadow::{EVSM_EXPONENTS, ShadowView, evsm_warp};
use crate::{
    settings::{ShadowFilter, SimdLevel},
    simd::dispatch,
};

/// σ of level 0 in texels: a tap of the two beside it, and the tent of bilinear filtering.
pub const LEVEL_SIGMA: f32 = 0.65;

/// Texels a side below which a pyramid has no further level.
pub const COARSEST: u32 = 16;

/// Most levels: of a map of 8192 texels a side.
pub const MOST_LEVELS: usize = 10;

/// σ that makes the edge of a disc's image as wide, from a tenth of its light to nine tenths, as a Gaussian's, over its radius.
pub const DISC_SIGMA: f32 = 0.536;

/// Where less than this share of the search's footprint is occluded nothing is.
pub const LEAST_OCCLUDED: f32 = 1.0 / 64.0;

/// Levels of a map of `size` texels a side.
///
/// Twin: `shaders/shared/shadow.wgsl` (tests/twins_light.rs).
#[inline(always)]
pub fn level_count(size: u32) -> u32 {
    let most = if size > COARSEST { size / COARSEST } else { 1 };
    32 - most.leading_zeros()
}

/// Texels a side of level `level`.
#[inline(always)]
pub fn level_size(size: u32, level: u32) -> u32 {
    size >> level
}

/// Level whose blur is `sigma` texels, and how far it is to the next one, in [0, 1): from level to level in proportion to σ.
///
/// Twin: `shaders/shared/shadow.wgsl` (tests/twins_light.rs).
#[inline(always)]
pub fn level_of(sigma: f32, levels: u32) -> (u32, f32) {
    let x = sigma * (1.0 / LEVEL_SIGMA);
    let x = if x > 1.0 { x } else { 1.0 };
    let x = if x < 65536.0 { x } else { 65536.0 };
    let bits = x.to_bits();
    let level = (bits >> 23) - 127;
    let fraction = (bits & 0x007f_ffff) as f32 * (1.0 / 8_388_608.0);
    if level + 1 < levels { (level, fraction) } else { (levels - 1, 0.0) }
}

/// σ in texels of the image of the light's disc on the map, past an occluder at depth `occluder`, as `receiver` at the same place
/// sees it.
/// * depths: in units of the view's far distance
/// * `slant`: distance from the light over the depth along its axis; 1 for parallel light
///
/// Twin: `shaders/shared/shadow.wgsl` (tests/twins_light.rs).
#[inline(always)]
pub fn penumbra_sigma(softness: f32, perspective: bool, slant: f32, occluder: f32, receiver: f32) -> f32 {
    let near = if occluder > 1e-6 { occluder } else { 1e-6 };
    let spread = if perspective { (receiver - near) / (near * receiver) * slant } else { receiver - near };
    let spread = if spread > 0.0 { spread } else { 0.0 };
    softness * spread
}

/// Natural logarithm of a positive normal number, to 2e-5: without branches or calls.
///
/// Twin: `shaders/shared/shadow.wgsl` (tests/twins_light.rs).
#[inline(always)]
pub fn ln_rough(x: f32) -> f32 {
    let bits = x.to_bits();
    let exponent = (bits >> 23) as i32 - 127;
    let m = f32::from_bits((bits & 0x007f_ffff) | 0x3f80_0000);
    let s = (m - 1.0) / (m + 1.0);
    let s2 = s * s;
    let series = 2.0 * s * (1.0 + s2 * (1.0 / 3.0 + s2 * (1.0 / 5.0 + s2 * (1.0 / 7.0))));
    exponent as f32 * std::f32::consts::LN_2 + series
}

/// Mean depth of what lies before depth `t` within the footprint of `moments`; `t` where nothing does.
///
/// Of two layers at t and o, a share p of them at t, mean and variance tell p (Chebyshev's bound is exact then) and o.
///
/// Twin: `shaders/shared/shadow.wgsl` (tests/twins_light.rs).
#[inline(always)]
pub fn occluder_depth(filter: ShadowFilter, moments: Vec4, t: f32, min_variance: f32) -> f32 {
    let (mean, square, receiver, slope) = match filter {
        ShadowFilter::Vsm => (moments.x, moments.y, t, 1.0),
        ShadowFilter::Evsm4 => {
            let w = evsm_warp(t).y;
            (moments.z, moments.w, w, 2.0 * EVSM_EXPONENTS[1] * w)
        }
    };
    let floor = min_variance * slope * slope;
    let variance = square - mean * mean;
    let variance = if variance > floor { variance } else { floor };
    let d = receiver - mean;
    let lit = variance / (variance + d * d);
    let occluded = 1.0 - lit;
    let none = !(d > 0.0) | !(occluded > LEAST_OCCLUDED);
    let occluder = mean - d * lit / if none { 1.0 } else { occluded };
    let depth = match filter {
        ShadowFilter::Vsm => occluder,
        ShadowFilter::Evsm4 => {
            let x = if -occluder > 1e-30 { -occluder } else { 1e-30 };
            0.5 - ln_rough(x) * (0.5 / EVSM_EXPONENTS[1])
        }
    };
    let depth = if depth > 0.0 { depth } else { 0.0 };
    if none | !(depth < t) { t } else { depth }
}

/// [`ShadowView::softness`] of a light with a disc of `radius` (metres; for parallel light the tangent of its angle).
/// * `view`: all of it but that
/// * `light_bleed_reduction`: cuts the dark end of a penumbra off, which is made as much wider
pub fn softness(view: &ShadowView, radius: f32, light_bleed_reduction: f32) -> f32 {
    let scale = (view.right_scaled.length() * view.up_scaled.length()).sqrt();
    let texels = 0.5 * view.size as f32 * scale;
    // A Gaussian's width from a tenth to nine tenths of what is left, over that without the cut, is 1 / (1 + 1.45 r) to 2 %.
    let wider = 1.0 + 1.45 * light_bleed_reduction;
    DISC_SIGMA * wider * radius.max(0.0) * texels * if view.perspective > 0.5 { 1.0 / view.far } else { view.far }
}

/// Nearness (1/z in 1/m in perspective, −z in m by parallel light) from texel to texel above which a plane hides a part of the
/// light's disc from itself.
pub fn steepest(view: &ShadowView) -> f32 {
    let texels = view.softness / DISC_SIGMA * if view.perspective > 0.5 { view.far } else { 1.0 / view.far };
    // Off the axis the disc's image is wider.
    0.5 / texels
}

/// Fills `out` with all levels after the first, one after the other.
/// * `map`: level 0, `size`² texels
pub fn make_levels(level: SimdLevel, map: &[[f32; 4]], size: u32, out: &mut Vec<[f32; 4]>) {
    let levels = level_count(size);
    let total: usize = (1..levels).map(|l| level_size(size, l) as usize).map(|n| n * n).sum();
    out.resize(total, [0.0; 4]);
    let (mut fine, mut n) = (map, size as usize);
    let mut rest = out.as_mut_slice();
    for l in 1..levels {
        let half = level_size(size, l) as usize;
        let (coarse, after) = std::mem::take(&mut rest).split_at_mut(half * half);
        let rows = |(band, rows): (usize, &mut [[f32; 4]])| {
            for (y, row) in rows.chunks_mut(half).enumerate() {
                halve_row(level, fine, n, band * ROWS + y, row);
            }
        };
        coarse.par_chunks_mut(half * ROWS).enumerate().for_each(rows);
        (fine, n, rest) = (coarse, half, after);
    }
}

/// Rows of a level that one task makes.
const ROWS: usize = 32;

/// Columns that are summed before they are summed sideways: what fits on the stack.
const SPAN: usize = 64;

/// Row `y` of the next level: four by four texels around each, weighed 1, 3, 3, 1 each way; clamped at the rim.
#[inline(always)]
fn halve_row_body(fine: &[[f32; 4]], n: usize, y: usize, row: &mut [[f32; 4]]) {
    let at = |i: usize, k: usize| (2 * i + k).saturating_sub(1).min(n - 1);
    let rows = [0, 1, 2, 3].map(|k| &fine[at(y, k) * n..][..n]);
    let mut columns = [[0.0f32; 4]; 2 * SPAN + 2];
    for (part, out) in row.chunks_mut(SPAN).enumerate() {
        let first = part * SPAN;
        let (low, high) = (at(first, 0), at(first + out.len() - 1, 3) + 1);
        let [a, b, c, d] = rows.map(|r| r[low..high].as_flattened());
        for (i, sum) in columns.as_flattened_mut()[..a.len()].iter_mut().enumerate() {
            *sum = (a[i] + d[i]) + (b[i] + c[i]) * 3.0;
        }
        for (x, out) in out.iter_mut().enumerate() {
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| columns[at(first + x, k) - low]);
            for channel in 0..4 {
                out[channel] = ((a[channel] + d[channel]) + (b[channel] + c[channel]) * 3.0) * (1.0 / 64.0);
            }
        }
    }
}

dispatch! { fn halve_row => halve_row_body(fine: &[[f32; 4]], n: usize, y: usize, row: &mut [[f32; 4]]) }

#[cfg(test)]
mod tests {
    use super::*;
    use crate::twin::shadow::moments_of;

    #[test]
    fn levels_follow_sigma_without_jumps() {
        assert_eq!([16, 31, 32, 1024, 8192].map(level_count), [1, 1, 2, 7, 10]);
        assert_eq!(level_count(8192) as usize, MOST_LEVELS);
        let mut before = 0.0;
        for i in 0..20_000 {
            let sigma = 0.01 * i as f32;
            let (level, fraction) = level_of(sigma, 7);
            assert!(level < 7 && (0.0..1.0).contains(&fraction));
            let at = level as f32 + fraction;
            assert!(at >= before && at - before < 0.02, "{sigma}: from {before} to {at}");
            before = at;
        }
        assert_eq!(level_of(f32::NAN, 7), (0, 0.0));
        assert_eq!(level_of(f32::INFINITY, 7), (6, 0.0));
        assert_eq!(level_of(LEVEL_SIGMA * 4.0, 7), (2, 0.0));
    }

    #[test]
    fn the_logarithm_is_near() {
        for i in 1..2000 {
            let x = (i as f32 - 1000.0) * 0.005;
            assert!((ln_rough(catoptra_engine::math::exp(x)) - x).abs() < 3e-5, "{x}");
        }
    }

    #[test]
    fn two_layers_tell_the_nearer_one() {
        for filter in [ShadowFilter::Vsm, ShadowFilter::Evsm4] {
            for (o, t) in [(0.3f32, 0.8f32), (0.7, 0.8), (0.1, 0.95)] {
                for lit in [0.1f32, 0.5, 0.9] {
                    let m = Vec4::from(moments_of(filter, t)) * lit + Vec4::from(moments_of(filter, o)) * (1.0 - lit);
                    let found = occluder_depth(filter, m, t, 1e-9);
                    assert!((found - o).abs() < 0.01, "{filter:?} {o} before {t}, lit {lit}: {found}");
                }
            }
            let own = Vec4::from(moments_of(filter, 0.6));
            assert_eq!(occluder_depth(filter, own, 0.6, 2e-7), 0.6);
            assert_eq!(occluder_depth(filter, own, 0.5, 2e-7), 0.5, "what lies behind occludes nothing");
        }
    }

    #[test]
    fn coarser_levels_keep_the_mean_and_planes() {
        let size = 64u32;
        let plane = |x: u32, y: u32| [0.01 * x as f32, 0.02 * y as f32, 1.0, (x % 2) as f32];
        let map: Vec<[f32; 4]> = (0..size * size).map(|i| plane(i % size, i / size)).collect();
        let mut levels = Vec::new();
        make_levels(SimdLevel::Portable, &map, size, &mut levels);
        assert_eq!(levels.len(), 32 * 32 + 16 * 16);
        // Texel (x, y) of level 1 lies at (2x + 0.5, 2y + 0.5) of level 0.
        for y in 1..31 {
            for x in 1..31 {
                let [a, b, c, d] = levels[y * 32 + x];
                assert!((a - 0.01 * (2.0 * x as f32 + 0.5)).abs() < 1e-5);
                assert!((b - 0.02 * (2.0 * y as f32 + 0.5)).abs() < 1e-5);
                assert!(c == 1.0 && d == 0.5, "stripes are gone: {d}");
            }
        }
    }
}
