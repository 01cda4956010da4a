//! Interleaved sampling of VPLs: in every block of n x n pixels each pixel is lit by one of n² subsets of the VPLs, and a
//! filter of n x n pixels that stays on one surface puts the subsets together again. On a plane far from edges the filter
//! holds each subset once, so that its mean is the full sum, blurred over n pixels; the cost is 1/n² of the full sum's.
//!
//! Source: Segovia et al., "Non-interleaved Deferred Shading of Interleaved Sample Patterns", Graphics Hardware 2006; the
//! pattern after Keller & Heidrich, "Interleaved Sampling", EGWR 2001.
//!
//! Twins: `shaders/shared/interleave.wgsl`, `shaders/interleave.wgsl` (tests/twins_light.rs, tests/light_interleave.rs).

use glam::Vec3;
use std::ops::Range;

use super::vpl::Vpl;
use crate::trace::sampling;

/// Normals whose cosine is less are another surface (about 18 degrees).
pub(crate) const LEAST_COSINE: f32 = 0.95;
/// A neighbour further off the plane than this share of its distance is another surface.
pub(crate) const MOST_OFF_PLANE: f32 = 0.3;

/// What the filter knows of a pixel.
#[derive(Clone, Copy, Debug, Default)]
pub struct Guide {
    /// The place, world space.
    pub position_world: Vec3,
    /// Unit shading normal.
    pub normal: Vec3,
    /// Irradiance by the pixel's subset, times the number of subsets.
    pub irradiance: Vec3,
    /// Turns irradiance into radiance; zero: nothing to filter here.
    pub albedo: Vec3,
}

/// Which of the n² subsets lights the pixel at (x, y).
///
/// Twin: `split_place` in `shaders/shared/interleave.wgsl`, which puts the pixels of a subset into one draw's rectangle.
#[inline]
pub fn subset_of(x: u32, y: u32, n: u32) -> u32 {
    x % n + n * (y % n)
}

/// VPLs of subset `k` of `subsets` in a list that [`group_subsets`] has ordered.
///
/// Twin: `shaders/shared/interleave.wgsl`.
pub fn subset_range(len: usize, k: u32, subsets: u32) -> Range<usize> {
    let (k, m) = (k as usize, subsets as usize);
    // Subset k holds ceil((len - k) / m).
    let before = |k: usize| k * (len / m) + k.min(len % m);
    before(k)..before(k + 1)
}

/// Orders VPLs so that each subset is a run. One of each `subsets` neighbours goes to each subset, turned by a hash, so that
/// every subset is spread over all paths.
pub fn group_subsets(vpls: &mut Vec<Vpl>, subsets: u32) {
    if subsets <= 1 {
        return;
    }
    let m = subsets as usize;
    let mut out = Vec::with_capacity(vpls.len());
    for k in 0..m {
        for (group, of_group) in vpls.chunks(m).enumerate() {
            // The last group may be short; its members go to the first subsets.
            let turn = if of_group.len() == m { sampling::hash_u32(group as u32 ^ 0x5e60) as usize } else { 0 };
            out.extend(of_group.get((k + turn) % m));
        }
    }
    *vpls = out;
}

/// Pixels of a row or column of `most` over which the filter of the pixel at `c` goes.
///
/// Twin: `shaders/shared/interleave.wgsl`.
#[inline]
pub fn filter_span(c: u32, most: u32, n: u32) -> Range<u32> {
    c.saturating_sub(n / 2)..(c + n - n / 2).min(most)
}

/// True where the light of `other` counts at `center`: it lies on the same surface. True of a pixel and itself.
///
/// Twin: `shaders/shared/interleave.wgsl`.
#[inline]
pub fn same_surface(center: &Guide, other: &Guide) -> bool {
    let to = other.position_world - center.position_world;
    let off = center.normal.dot(to);
    center.normal.dot(other.normal) >= LEAST_COSINE && off * off <= MOST_OFF_PLANE * MOST_OFF_PLANE * to.dot(to)
}

/// Radiance of pixel (x, y): its albedo times the mean irradiance of the n x n pixels around it that lie on its surface.
///
/// * `guides`: one a pixel, row 0 on top
pub fn filter(guides: &[Guide], width: u32, height: u32, x: u32, y: u32, n: u32) -> Vec3 {
    let center = &guides[(y * width + x) as usize];
    if center.albedo == Vec3::ZERO {
        return Vec3::ZERO;
    }
    let (mut sum, mut count) = (Vec3::ZERO, 0.0f32);
    for v in filter_span(y, height, n) {
        for u in filter_span(x, width, n) {
            let g = &guides[(v * width + u) as usize];
            if g.albedo != Vec3::ZERO && same_surface(center, g) {
                sum += g.irradiance;
                count += 1.0;
            }
        }
    }
    // The pixel itself always counts.
    center.albedo * (sum / count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn subsets_are_a_partition() {
        for (len, subsets) in [(0usize, 4u32), (3, 4), (16, 16), (37, 4), (129, 16)] {
            let mut vpls: Vec<Vpl> =
                (0..len).map(|i| Vpl { position_world: Vec3::splat(i as f32), ..Vpl::default() }).collect();
            group_subsets(&mut vpls, subsets);
            let mut seen: Vec<f32> = vpls.iter().map(|v| v.position_world.x).collect();
            seen.sort_by(f32::total_cmp);
            assert_eq!(seen, (0..len).map(|i| i as f32).collect::<Vec<_>>());
            let mut end = 0;
            for k in 0..subsets {
                let range = subset_range(len, k, subsets);
                assert_eq!(range.start, end);
                end = range.end;
                let mut groups: Vec<u32> = vpls[range].iter().map(|v| v.position_world.x as u32 / subsets).collect();
                groups.dedup();
                assert!(groups.len() + 1 >= len / subsets as usize, "one of each group");
            }
            assert_eq!(end, len);
        }
    }

    #[test]
    fn the_filter_holds_each_subset_once_and_keeps_to_the_surface() {
        let (width, height, n) = (16u32, 12u32, 4u32);
        let mut guides = vec![Guide::default(); (width * height) as usize];
        for y in 0..height {
            for x in 0..width {
                // Two floors, the right one a metre lower.
                let step = if x < 8 { 0.0 } else { -1.0 };
                guides[(y * width + x) as usize] = Guide {
                    position_world: Vec3::new(x as f32 * 0.1, step, y as f32 * 0.1),
                    normal: Vec3::Y,
                    irradiance: Vec3::splat(subset_of(x, y, n) as f32 + if x < 8 { 0.0 } else { 100.0 }),
                    albedo: Vec3::ONE,
                };
            }
        }
        assert_eq!(filter(&guides, width, height, 4, 5, n).x, 7.5);
        assert!(filter(&guides, width, height, 7, 5, n).x < 16.0);
        assert!(filter(&guides, width, height, 8, 5, n).x >= 100.0);
        guides[0].albedo = Vec3::ZERO;
        assert_eq!(filter(&guides, width, height, 0, 0, n), Vec3::ZERO);
    }
}
