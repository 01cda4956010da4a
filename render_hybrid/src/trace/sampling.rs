//! Sample patterns: every number is a function of (pixel, sample, dimension, seed), never of the thread.

use catoptra_engine::math;
use glam::{Vec2, Vec3};
use std::f32::consts::TAU;

/// 32-bit mix (the finaliser of MurmurHash3).
#[inline]
pub fn hash_u32(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x85eb_ca6b);
    x ^= x >> 13;
    x = x.wrapping_mul(0xc2b2_ae35);
    x ^ (x >> 16)
}

/// Mixes two words.
#[inline]
pub fn hash_combine(a: u32, b: u32) -> u32 {
    hash_u32(a ^ b.wrapping_mul(0x9e37_79b9).wrapping_add(0x7f4a_7c15))
}

/// Uniform in [0, 1) from the upper 24 bits.
#[inline]
pub fn unit_f32(x: u32) -> f32 {
    (x >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Van der Corput's radical inverse of `i` in `base`, in [0, 1).
pub fn radical_inverse(base: u32, mut i: u32) -> f32 {
    let (mut inverse, mut denominator) = (0u64, 1u64);
    // 2^40 leaves room for one more digit of any base used here.
    while i > 0 && denominator < 1 << 40 {
        inverse = inverse * u64::from(base) + u64::from(i % base);
        denominator *= u64::from(base);
        i /= base;
    }
    ((inverse as f64 / denominator as f64) as f32).min(1.0 - f32::EPSILON * 0.5)
}

/// Hash-based Owen scrambling of the base-2 digits of `x`.
///
/// Source: Burley, "Practical Hash-based Owen Scrambling", JCGT 2020 (the improved hash by Vegdahl, 2021).
#[inline]
fn owen_scramble(x: u32, seed: u32) -> u32 {
    let mut x = x.reverse_bits();
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^= x.wrapping_mul(0x53a2_2864);
    x.reverse_bits()
}

/// Second dimension of the Sobol' sequence: digit k of the index (from the top) is the exclusive or of the digits j ≥ k for which
/// the binomial coefficient (j over k) is odd, that is of those whose number contains k's bits; so a sum over supersets,
/// one bit of the digits' numbers after the other.
#[inline]
fn sobol_1(index: u32) -> u32 {
    let mut x = index;
    x ^= (x & 0xffff_0000) >> 16;
    x ^= (x & 0xff00_ff00) >> 8;
    x ^= (x & 0xf0f0_f0f0) >> 4;
    x ^= (x & 0xcccc_cccc) >> 2;
    x ^= (x & 0xaaaa_aaaa) >> 1;
    x.reverse_bits()
}

/// Sample `index` of a two-dimensional Owen-scrambled Sobol' set that is shuffled and scrambled by `seed`: one set per
/// (pixel, dimension pair), padded together for paths. In [0, 1)².
///
/// Source: Burley 2020, as above.
#[inline]
pub fn sobol_2d(index: u32, seed: u32) -> Vec2 {
    let shuffled = owen_scramble(index, seed);
    let x = owen_scramble(shuffled.reverse_bits(), hash_combine(seed, 1));
    let y = owen_scramble(sobol_1(shuffled), hash_combine(seed, 2));
    Vec2::new(unit_f32(x), unit_f32(y))
}

/// Place of (x, y), each under 2^16, on a Z curve: their bits in turns, x first.
#[inline]
pub fn morton(x: u32, y: u32) -> u32 {
    let spread = |v: u32| {
        let v = (v | v << 8) & 0x00ff_00ff;
        let v = (v | v << 4) & 0x0f0f_0f0f;
        let v = (v | v << 2) & 0x3333_3333;
        (v | v << 1) & 0x5555_5555
    };
    spread(x) | spread(y) << 1
}

/// Direction around unit `n` with density cos/π.
#[inline]
pub fn cosine_direction(n: Vec3, xi: Vec2) -> Vec3 {
    let (t, b) = math::orthonormal_basis(n);
    let d = concentric_disc(xi);
    let z = (1.0 - d.length_squared()).max(0.0).sqrt();
    (t * d.x + b * d.y + n * z).normalize_or(n)
}

/// Uniform direction on the unit sphere.
#[inline]
pub fn sphere_direction(xi: Vec2) -> Vec3 {
    let z = 1.0 - 2.0 * xi.x;
    let r = (1.0 - z * z).max(0.0).sqrt();
    let (s, c) = math::sin_cos(TAU * xi.y);
    Vec3::new(r * c, r * s, z)
}

/// Uniform point in the unit disc, area-preserving and continuous.
///
/// Source: Shirley & Chiu, "A Low Distortion Map Between Disk and Square", JGT 1997.
#[inline]
pub fn concentric_disc(xi: Vec2) -> Vec2 {
    let o = xi * 2.0 - 1.0;
    if o == Vec2::ZERO {
        return Vec2::ZERO;
    }
    use std::f32::consts::{FRAC_PI_2, FRAC_PI_4};
    let (r, theta) =
        if o.x.abs() > o.y.abs() { (o.x, FRAC_PI_4 * (o.y / o.x)) } else { (o.y, FRAC_PI_2 - FRAC_PI_4 * (o.x / o.y)) };
    let (s, c) = math::sin_cos(theta);
    Vec2::new(r * c, r * s)
}

/// Point `i` of `n` on the unit disc: a Vogel spiral turned by `rotation` radians. Low discrepancy for every n.
///
/// Source: Vogel, "A better way to construct the sunflower head", Mathematical Biosciences 1979.
#[inline]
pub fn vogel_disc(i: u32, n: u32, rotation: f32) -> Vec2 {
    const GOLDEN_ANGLE: f32 = 2.399_963_2;
    let r = ((i as f32 + 0.5) / n as f32).sqrt();
    let (s, c) = math::sin_cos(i as f32 * GOLDEN_ANGLE + rotation);
    Vec2::new(r * c, r * s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sobol_sets_are_stratified() {
        // Any 2^k-aligned run of a (0,2)-sequence has one point in each elementary interval.
        for seed in [1u32, 77, 123_456] {
            let mut seen = [false; 64];
            for i in 0..64 {
                let p = sobol_2d(i, seed);
                let cell = (p.x * 8.0) as usize * 8 + (p.y * 8.0) as usize;
                assert!(!seen[cell], "two points in cell {cell}");
                seen[cell] = true;
            }
        }
    }

    #[test]
    fn cosine_directions_average_two_thirds() {
        let n = Vec3::new(0.6, 0.0, 0.8);
        let mean: f32 = (0..4096).map(|i| cosine_direction(n, sobol_2d(i, 9)).dot(n)).sum::<f32>() / 4096.0;
        assert!((mean - 2.0 / 3.0).abs() < 1e-3, "{mean}");
    }

    #[test]
    fn radical_inverse_of_small_numbers() {
        assert_eq!(radical_inverse(2, 1), 0.5);
        assert_eq!(radical_inverse(2, 6), 0.375);
        assert!((radical_inverse(3, 5) - 7.0 / 9.0).abs() < 1e-7);
        assert!(radical_inverse(2, u32::MAX) < 1.0);
    }
}
