//! Inputs by chance that are the same on every run.

use catoptra_engine::glam::Vec3;

/// A stream of numbers; the field is its seed.
///
/// Source: O'Neill, "PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms for Random Number Generation",
/// 2014 (RXS-M-XS).
#[derive(Clone, Debug)]
pub struct Random(pub u32);

impl Random {
    /// The next 32 bits.
    pub fn bits(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let w = ((self.0 >> ((self.0 >> 28) + 4)) ^ self.0).wrapping_mul(277_803_737);
        (w >> 22) ^ w
    }

    /// A number below `n`, which is not 0.
    pub fn below(&mut self, n: usize) -> usize {
        self.bits() as usize % n
    }

    /// A number in [0, 1).
    pub fn unit(&mut self) -> f32 {
        (self.bits() >> 8) as f32 / 16_777_216.0
    }

    /// True with probability `p`.
    pub fn chance(&mut self, p: f32) -> bool {
        self.unit() < p
    }

    /// In the cube from 0 to 1.
    pub fn color(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit())
    }

    /// In the cube from -1 to 1.
    pub fn vec(&mut self) -> Vec3 {
        self.color() * 2.0 - 1.0
    }

    /// A unit vector.
    pub fn direction(&mut self) -> Vec3 {
        self.vec().normalize_or(Vec3::Y)
    }
}
