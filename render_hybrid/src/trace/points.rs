//! Batches of shaded points in flat arrays, and the wide kernel that lights them by all VPLs.

use glam::{Vec2, Vec3};

use crate::{
    simd::dispatch,
    twin::{
        vpl::{Vpl, geometry_term},
        vpl_maps::{
            inverse_plane_height, l1_length, map_center, octahedron_coordinates, octahedron_point, texel_center,
            texel_coordinate, texel_occlusion,
        },
    },
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

/// As [`accumulate_body`] with each VPL's light weighed by [`crate::twin::vpl_maps::vpl_visibility`], in phases: geometry,
/// map coordinates, loads, comparison. The sizes are constants so that no load needs a bounds check.
#[inline(always)]
fn accumulate_shadowed_body<const SIZE: usize, const AREA: usize>(
    points: &mut PointBatch,
    vpls: &[Vpl],
    maps: &[f32],
    geometry_term_max: f32,
) {
    let lanes = |plane: &[f32], at: usize| -> [f32; LANES] { plane[at..at + LANES].try_into().expect("padded") };
    let (maps, rest) = maps.as_chunks::<AREA>();
    assert!(maps.len() == vpls.len() && rest.is_empty() && SIZE * SIZE == AREA && AREA.is_power_of_two());
    let size = SIZE as u32;
    for at in (0..points.len).step_by(LANES) {
        let p: [[f32; LANES]; 3] = std::array::from_fn(|axis| lanes(&points.position[axis], at));
        let n: [[f32; LANES]; 3] = std::array::from_fn(|axis| lanes(&points.normal[axis], at));
        let mut sum = [[0.0f32; LANES]; 3];
        for (vpl, map) in vpls.iter().zip(maps) {
            let y = vpl.position_world;
            let mut g = [0.0f32; LANES];
            let mut lit = 0u32;
            for lane in 0..LANES {
                let to_vpl = Vec3::new(y.x - p[0][lane], y.y - p[1][lane], y.z - p[2][lane]);
                let normal = Vec3::new(n[0][lane], n[1][lane], n[2][lane]);
                g[lane] = geometry_term(to_vpl, normal, vpl.normal_world, geometry_term_max);
                lit |= g[lane].to_bits();
            }
            // None of these points is before the VPL.
            if lit == 0 {
                continue;
            }
            let center = map_center(vpl);
            let (mut own, mut l1, mut inverse_height) = ([0.0f32; LANES], [0.0f32; LANES], [0.0f32; LANES]);
            let (mut x0, mut y0) = ([0u32; LANES], [0u32; LANES]);
            let (mut fx, mut fy) = ([0.0f32; LANES], [0.0f32; LANES]);
            for lane in 0..LANES {
                let v = Vec3::new(p[0][lane] - center.x, p[1][lane] - center.y, p[2][lane] - center.z);
                l1[lane] = l1_length(v);
                own[lane] = 1.0 / l1[lane];
                inverse_height[lane] = inverse_plane_height(Vec3::new(n[0][lane], n[1][lane], n[2][lane]), v);
                let e = octahedron_coordinates(v, own[lane]);
                let (x, y) = (texel_coordinate(e.x, size), texel_coordinate(e.y, size));
                (x0[lane], y0[lane]) = (x as u32, y as u32);
                (fx[lane], fy[lane]) = (x - x0[lane] as f32, y - y0[lane] as f32);
            }
            let mut stored = [[0.0f32; LANES]; 4];
            for lane in 0..LANES {
                let first = y0[lane] as usize * SIZE + x0[lane] as usize;
                stored[0][lane] = map[first & (AREA - 1)];
                stored[1][lane] = map[(first + 1) & (AREA - 1)];
                stored[2][lane] = map[(first + SIZE) & (AREA - 1)];
                stored[3][lane] = map[(first + SIZE + 1) & (AREA - 1)];
            }
            let flux = vpl.flux * FRAC_1_PI;
            for lane in 0..LANES {
                let tap = |dx: u32, dy: u32| {
                    let c = Vec2::new(
                        texel_center((x0[lane] + dx) as f32, size),
                        texel_center((y0[lane] + dy) as f32, size),
                    );
                    let q = octahedron_point(c);
                    let expected = (n[0][lane] * q.x + n[1][lane] * q.y + n[2][lane] * q.z) * inverse_height[lane];
                    texel_occlusion(stored[(dx + 2 * dy) as usize][lane], expected, own[lane], l1[lane])
                };
                let (t00, t10, t01, t11) = (tap(0, 0), tap(1, 0), tap(0, 1), tap(1, 1));
                let a = t00 + (t10 - t00) * fx[lane];
                let b = t01 + (t11 - t01) * fx[lane];
                let visible = g[lane] * (1.0 - (a + (b - a) * fy[lane]));
                sum[0][lane] += flux.x * visible;
                sum[1][lane] += flux.y * visible;
                sum[2][lane] += flux.z * visible;
            }
        }
        for axis in 0..3 {
            points.irradiance[axis][at..at + LANES].copy_from_slice(&sum[axis]);
        }
    }
}

#[inline(always)]
fn shadowed_body(points: &mut PointBatch, vpls: &[Vpl], size: u32, maps: &[f32], geometry_term_max: f32) {
    match size {
        16 => accumulate_shadowed_body::<16, 256>(points, vpls, maps, geometry_term_max),
        32 => accumulate_shadowed_body::<32, 1024>(points, vpls, maps, geometry_term_max),
        64 => accumulate_shadowed_body::<64, 4096>(points, vpls, maps, geometry_term_max),
        other => unreachable!("settings allow no VPL maps of {other} texels"),
    }
}

dispatch! {
    /// Sets each point's irradiance to the sum over all VPLs, each seen through its map, in the order of the VPLs.
    /// * `size`: texels a side of a map; `maps`: those of `vpls`, in their order
    ///
    /// Twin: `shaders/indirect.wgsl`.
    pub fn accumulate_shadowed_vpls => shadowed_body(
        points: &mut PointBatch,
        vpls: &[Vpl],
        size: u32,
        maps: &[f32],
        geometry_term_max: f32,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        settings::SimdLevel,
        simd,
        twin::{
            vpl::vpl_irradiance,
            vpl_maps::{VplMaps, vpl_visibility},
        },
    };

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
            for size in [16u32, 32, 64] {
                // Any numbers will do for depths.
                let texels =
                    (0..vpls.len() as u32 * size * size).map(|i| (i % 23) as f32 * 0.04 * (i % 7) as f32).collect();
                let maps = VplMaps { size, texels };
                accumulate_shadowed_vpls(level, &mut batch, &vpls, maps.size, &maps.texels, 3.0);
                let mut shadowed = 0;
                for (i, (p, n)) in points.iter().enumerate() {
                    let mut sum = Vec3::ZERO;
                    for (v, vpl) in vpls.iter().enumerate() {
                        let g = geometry_term(vpl.position_world - *p, *n, vpl.normal_world, 3.0);
                        if g != 0.0 {
                            let visible = vpl_visibility(maps.map(v), size, *p - map_center(vpl), *n);
                            shadowed += u32::from(visible > 0.0 && visible < 1.0);
                            sum += vpl.flux * FRAC_1_PI * (g * visible);
                        }
                    }
                    assert_eq!(batch.irradiance(i), sum, "point {i} at {choice:?} with maps of {size}");
                }
                assert!(shadowed > 20, "the table must reach partial shadow");
            }
        }
    }
}
