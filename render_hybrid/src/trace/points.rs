//! Batches of shaded points in flat arrays, and the wide kernel that lights them by all VPLs.

use glam::Vec3;

use crate::{
    simd::dispatch,
    twin::vpl::{Vpl, geometry_term},
};
use std::f32::consts::FRAC_1_PI;

/// Points handled together; a multiple of every SIMD width. The result of a point does not depend on it.
const LANES: usize = 16;

/// Points with normals, and the irradiance that they receive. Arrays are padded to a multiple of the lane count.
#[derive(Clone, Debug, Default)]
pub struct PointBatch {
    len: usize,
    /// Positions, world space: x, y, z planes.
    position: [Vec<f32>; 3],
    /// Unit normals: x, y, z planes.
    normal: [Vec<f32>; 3],
    /// Irradiance: r, g, b planes.
    irradiance: [Vec<f32>; 3],
}

impl PointBatch {
    /// Forgets all points, keeps the memory.
    pub fn clear(&mut self) {
        self.len = 0;
        for plane in self.position.iter_mut().chain(&mut self.normal).chain(&mut self.irradiance) {
            plane.clear();
        }
    }

    /// Adds a point with irradiance 0.
    pub fn push(&mut self, position_world: Vec3, n: Vec3) {
        for axis in 0..3 {
            self.position[axis].push(position_world[axis]);
            self.normal[axis].push(n[axis]);
        }
        self.len += 1;
    }

    /// Points in the batch.
    pub fn len(&self) -> usize {
        self.len
    }

    /// True where no point was added.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Irradiance of point `i`, W/m².
    pub fn irradiance(&self, i: usize) -> Vec3 {
        Vec3::new(self.irradiance[0][i], self.irradiance[1][i], self.irradiance[2][i])
    }

    /// Adds to the irradiance of point `i`.
    pub fn add(&mut self, i: usize, irradiance: Vec3) {
        for axis in 0..3 {
            self.irradiance[axis][i] += irradiance[axis];
        }
    }

    /// Pads with points whose normal is zero: nothing lights them. Call once after the last `push`.
    pub fn pad(&mut self) {
        let padded = self.len.next_multiple_of(LANES);
        for plane in self.position.iter_mut().chain(&mut self.normal).chain(&mut self.irradiance) {
            plane.resize(padded, 0.0);
        }
    }
}

#[inline(always)]
fn accumulate_body(points: &mut PointBatch, vpls: &[Vpl], geometry_term_max: f32) {
    let lanes = |plane: &[f32], at: usize| -> [f32; LANES] { plane[at..at + LANES].try_into().expect("padded") };
    for at in (0..points.len).step_by(LANES) {
        let p: [[f32; LANES]; 3] = std::array::from_fn(|axis| lanes(&points.position[axis], at));
        let n: [[f32; LANES]; 3] = std::array::from_fn(|axis| lanes(&points.normal[axis], at));
        let mut sum = [[0.0f32; LANES]; 3];
        for vpl in vpls {
            let y = vpl.position_world;
            let flux = vpl.flux * FRAC_1_PI;
            for lane in 0..LANES {
                let to_vpl = Vec3::new(y.x - p[0][lane], y.y - p[1][lane], y.z - p[2][lane]);
                let normal = Vec3::new(n[0][lane], n[1][lane], n[2][lane]);
                let g = geometry_term(to_vpl, normal, vpl.normal_world, geometry_term_max);
                sum[0][lane] += flux.x * g;
                sum[1][lane] += flux.y * g;
                sum[2][lane] += flux.z * g;
            }
        }
        for axis in 0..3 {
            points.irradiance[axis][at..at + LANES].copy_from_slice(&sum[axis]);
        }
    }
}

dispatch! {
    /// Sets each point's irradiance to the sum over all VPLs, without visibility, in the order of the VPLs.
    ///
    /// Twin: `shaders/indirect.wgsl`.
    pub fn accumulate_vpls => accumulate_body(points: &mut PointBatch, vpls: &[Vpl], geometry_term_max: f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{settings::SimdLevel, simd, twin::vpl::vpl_irradiance};

    #[test]
    fn every_level_gives_the_bits_of_the_plain_sum() {
        let vpls: Vec<Vpl> = (0..37)
            .map(|i| {
                let a = i as f32;
                Vpl {
                    position_world: Vec3::new(a.rem_euclid(5.0) - 2.0, 1.5, a.rem_euclid(7.0) - 3.0),
                    normal_world: Vec3::new(0.1 * a - 1.8, -1.0, 0.2).normalize(),
                    flux: Vec3::new(1.0, 0.5 + a, 2.0),
                    error: 0.0,
                }
            })
            .collect();
        let points: Vec<(Vec3, Vec3)> = (0..101)
            .map(|i| {
                let b = i as f32 * 0.07;
                (Vec3::new(b - 3.0, -1.0 + 0.1 * b, 0.5 * b), Vec3::new(b - 3.0, 1.0, 0.3).normalize())
            })
            .collect();
        for choice in [SimdLevel::Portable, SimdLevel::Avx2, SimdLevel::Avx512] {
            let Ok(level) = simd::resolve(choice) else { continue };
            let mut batch = PointBatch::default();
            for (p, n) in &points {
                batch.push(*p, *n);
            }
            batch.pad();
            accumulate_vpls(level, &mut batch, &vpls, 3.0);
            for (i, (p, n)) in points.iter().enumerate() {
                let sum = vpls.iter().map(|v| vpl_irradiance(v, *p, *n, 3.0)).fold(Vec3::ZERO, |a, b| a + b);
                assert_eq!(batch.irradiance(i), sum, "point {i} at {choice:?}");
            }
        }
    }
}
