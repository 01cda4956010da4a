//! Shadow moments on the CPU: depth by rays through texel centres, then a separable 7x7 Gaussian.
//!
//! Twins: `shaders/moments.wgsl`, `shaders/moments_blur.wgsl`.

use catoptra_engine::RenderScene;
use rayon::prelude::*;

use super::shadow::{GAUSSIAN_7, ShadowMaps, ShadowPlan, ShadowView, moments_of};
use crate::{
    accel::{Accel, Hit, Ray},
    settings::{GlassShadows, RenderSettings, ShadowFilter, Shadows, SimdLevel},
    simd::dispatch,
};

/// Rows of texels that one task makes; rays go in 4x4 blocks, so it is a multiple of 4.
const BAND: usize = 8;

/// Renders and filters (or, for certified shadows, bounds) all views of `plan` into `maps`, re-using its memory. Returns the number of rays.
pub fn render_moments(
    maps: &mut ShadowMaps,
    scratch: &mut Vec<[f32; 4]>,
    plan: ShadowPlan,
    scene: &RenderScene,
    accel: &Accel,
    settings: &RenderSettings,
    level: SimdLevel,
) -> u64 {
    maps.plan = plan;
    maps.maps.resize_with(maps.plan.views.len(), Vec::new);
    let certified = settings.shadows == Shadows::Certified;
    maps.pyramids.resize_with(if certified { maps.plan.views.len() } else { 0 }, Default::default);
    let mut rays = 0;
    for (i, (view, map)) in maps.plan.views.iter().zip(&mut maps.maps).enumerate() {
        let size = view.size as usize;
        map.resize(size * size, [1.0; 4]);
        rays += depth_pass(view, map, scene, accel, settings);
        if certified {
            maps.pyramids[i].build(size, map.iter().map(|m| m[0]));
        } else {
            blur_7x7(level, map, scratch, size);
        }
    }
    rays
}

/// Fills `map` with [`moments_of`] the nearest surface through each texel's centre; of depth 1 where there is none.
fn depth_pass(
    view: &ShadowView,
    map: &mut [[f32; 4]],
    scene: &RenderScene,
    accel: &Accel,
    settings: &RenderSettings,
) -> u64 {
    let size = view.size as usize;
    // right_scaled = unit/half; unit·half = right_scaled / |right_scaled|².
    let right = view.right_scaled / view.right_scaled.length_squared();
    let up = view.up_scaled / view.up_scaled.length_squared();
    let texel_ray = |x: usize, y: usize| {
        let across = right * ((2 * x + 1) as f32 / size as f32 - 1.0) + up * (1.0 - (2 * y + 1) as f32 / size as f32);
        // Directions of length such that t is the distance along the view's axis.
        if view.perspective > 0.5 {
            Ray { origin: view.origin_world, direction: view.forward + across, t_min: 0.0, t_max: view.far }
        } else {
            Ray { origin: view.origin_world + across, direction: view.forward, t_min: 0.0, t_max: view.far }
        }
    };
    // Certified shadows want depth itself.
    let filter = match settings.shadows {
        Shadows::Certified => ShadowFilter::Vsm,
        _ => settings.moments.filter,
    };
    let casts = |hit: &Hit| {
        let m = &scene.materials[scene.instances[hit.instance_id as usize].material as usize];
        settings.glass_shadows == GlassShadows::Opaque || m.transmission <= 0.0
    };
    map.par_chunks_mut(size * BAND)
        .enumerate()
        .map_init(
            || (Vec::new(), Vec::new(), Vec::new()),
            |(rays, hits, places), (band, rows)| {
                let (y0, height) = (band * BAND, rows.len() / size);
                rays.clear();
                places.clear();
                // 4x4 blocks: neighbours in the array are neighbours on the map.
                for by in (0..height).step_by(4) {
                    for bx in (0..size).step_by(4) {
                        for y in by..(by + 4).min(height) {
                            for x in bx..(bx + 4).min(size) {
                                rays.push(texel_ray(x, y0 + y));
                                places.push(y * size + x);
                            }
                        }
                    }
                }
                hits.clear();
                hits.resize(rays.len(), Hit::MISS);
                accel.closest_hits(rays, hits);
                let mut count = rays.len() as u64;
                for ((ray, hit), place) in rays.iter().zip(hits.iter_mut()).zip(places.iter()) {
                    // Clear glass is looked through.
                    while hit.is_hit() && !casts(hit) {
                        *hit = accel.closest_hit(&Ray { t_min: hit.t, ..*ray });
                        count += 1;
                    }
                    let z = if hit.is_hit() { (hit.t / view.far).min(1.0) } else { 1.0 };
                    rows[*place] = moments_of(filter, z);
                }
                count
            },
        )
        .sum()
}

/// Separable Gaussian of 7 taps over a square map, clamped at the rim.
pub fn blur_7x7(level: SimdLevel, map: &mut [[f32; 4]], scratch: &mut Vec<[f32; 4]>, size: usize) {
    scratch.resize(size * size, [0.0; 4]);
    scratch.par_chunks_mut(size).zip(map.par_chunks(size)).for_each(|(out, row)| blur_row(level, out, row));
    let source: &[[f32; 4]] = scratch;
    map.par_chunks_mut(size).enumerate().for_each(|(y, out)| {
        let row = |dy: isize| {
            let y = (y as isize + dy).clamp(0, size as isize - 1) as usize;
            &source[y * size..(y + 1) * size]
        };
        blur_column(level, out, [row(-3), row(-2), row(-1), row(0), row(1), row(2), row(3)]);
    });
}

/// The seven taps in one fixed order: outermost pair first.
#[inline(always)]
fn seven_taps(t: [f32; 7]) -> f32 {
    let [w3, w2, w1, w0] = GAUSSIAN_7;
    (t[0] + t[6]) * w3 + (t[1] + t[5]) * w2 + (t[2] + t[4]) * w1 + t[3] * w0
}

#[inline(always)]
fn blur_row_body(out: &mut [[f32; 4]], row: &[[f32; 4]]) {
    let n = row.len();
    for x in (0..3.min(n)).chain(n.saturating_sub(3).max(3.min(n))..n) {
        let tap = |k: usize| row[(x + k).saturating_sub(3).min(n - 1)];
        out[x] = std::array::from_fn(|c| seven_taps(std::array::from_fn(|k| tap(k)[c])));
    }
    for (o, w) in out[3.min(n)..].iter_mut().zip(row.windows(7)) {
        *o = std::array::from_fn(|c| seven_taps([w[0][c], w[1][c], w[2][c], w[3][c], w[4][c], w[5][c], w[6][c]]));
    }
}

#[inline(always)]
fn blur_column_body(out: &mut [[f32; 4]], rows: [&[[f32; 4]]; 7]) {
    let n = out.len();
    let rows = rows.map(|r| &r[..n]);
    for x in 0..n {
        for c in 0..4 {
            out[x][c] = seven_taps([
                rows[0][x][c],
                rows[1][x][c],
                rows[2][x][c],
                rows[3][x][c],
                rows[4][x][c],
                rows[5][x][c],
                rows[6][x][c],
            ]);
        }
    }
}

dispatch! { fn blur_row => blur_row_body(out: &mut [[f32; 4]], row: &[[f32; 4]]) }
dispatch! { fn blur_column => blur_column_body(out: &mut [[f32; 4]], rows: [&[[f32; 4]]; 7]) }

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blur_is_the_direct_sum_over_49_taps() {
        let size = 20usize;
        let map: Vec<[f32; 4]> = (0..size * size)
            .map(|i| {
                let v = |m: usize, n: usize| (i * m % n) as f32 / n as f32;
                [v(37, 101), v(17, 89), v(5, 43), v(3, 71)]
            })
            .collect();
        let mut blurred = map.clone();
        blur_7x7(SimdLevel::Portable, &mut blurred, &mut Vec::new(), size);
        let weight = |k: i32| GAUSSIAN_7[(3 - k.abs()) as usize];
        for y in 0..size as i32 {
            for x in 0..size as i32 {
                let mut sum = [0.0f64; 4];
                for dy in -3..=3 {
                    for dx in -3..=3 {
                        let cx = (x + dx).clamp(0, size as i32 - 1);
                        let cy = (y + dy).clamp(0, size as i32 - 1);
                        for c in 0..4 {
                            sum[c] += f64::from(weight(dx) * weight(dy) * map[(cy * size as i32 + cx) as usize][c]);
                        }
                    }
                }
                for c in 0..4 {
                    let b = f64::from(blurred[(y * size as i32 + x) as usize][c]);
                    assert!((b - sum[c]).abs() < 1e-6, "texel {x},{y}: {b} for {}", sum[c]);
                }
            }
        }
    }
}
