//! Shadow moments on the CPU: depth by scan conversion, then a separable 3x3 binomial while the rows are hot, and the
//! further levels of the pyramid.
//!
//! Twins: `shaders/moments.wgsl`, `shaders/moments_blur.wgsl`.

use catoptra_engine::RenderScene;
use rayon::prelude::*;
use std::sync::Mutex;

use super::{
    glance::{self, Square, own_bounds, squares_across, with_neighbours},
    penumbra,
    scan::{BLOCK, ScanList, ScanView, TileBuffers},
    shadow::{BINOMIAL_3, ShadowMaps, ShadowPlan, moments_of},
    tile::TileRect,
};
use crate::{
    accel::Accel,
    settings::{GlassShadows, RenderSettings, ShadowFilter, Shadows, SimdLevel},
    simd::dispatch,
    still::CastBy,
    trace::points::make_room,
};

/// Rows of texels that one task makes. Higher: fewer rows made twice at its rims, worse sharing between threads.
const BAND: usize = 64;

/// Rows beside a row that its blur reads.
const REACH: usize = 1;

/// Memory kept between frames.
#[derive(Debug, Default)]
pub struct MomentsScratch {
    list: ScanList,
    /// What each map was made of.
    made_of: Vec<CastBy>,
    /// Squares of the map in the making, by themselves.
    squares: Vec<Square>,
    /// One a thread.
    bands: Vec<Mutex<BandScratch>>,
}

impl MomentsScratch {
    /// Somebody else wrote the maps.
    pub fn forget(&mut self) {
        self.made_of.clear();
    }
}

#[derive(Debug, Default)]
struct BandScratch {
    candidates: Vec<u32>,
    depths: TileBuffers,
    /// Unfiltered moments of one row.
    row: Vec<[f32; 4]>,
    /// Rows blurred sideways: a ring of three.
    ring: [Vec<[f32; 4]>; 2 * REACH + 1],
}

/// Renders and filters (or, for certified shadows, bounds) all views of `plan` into `maps`, re-using its memory and the maps
/// whose light and casters are as before; `plan` gets the old one. Returns the number of texels made.
pub fn render_moments(
    maps: &mut ShadowMaps,
    scratch: &mut MomentsScratch,
    plan: &mut ShadowPlan,
    scene: &RenderScene,
    accel: &Accel,
    settings: &RenderSettings,
    level: SimdLevel,
) -> u64 {
    std::mem::swap(&mut maps.plan, plan);
    scratch.made_of.resize_with(maps.plan.views.len(), CastBy::default);
    maps.maps.resize_with(maps.plan.views.len(), Vec::new);
    maps.coarser.resize_with(maps.plan.views.len(), Vec::new);
    maps.squares.resize_with(maps.plan.views.len(), Vec::new);
    let certified = settings.shadows == Shadows::Certified;
    maps.pyramids.resize_with(if certified { maps.plan.views.len() } else { 0 }, Default::default);
    scratch.bands.resize_with(rayon::current_num_threads(), Mutex::default);
    // Clear glass is looked through.
    let casts = |instance: u32| {
        let m = &scene.materials[scene.instances[instance as usize].material as usize];
        settings.glass_shadows == GlassShadows::Opaque || m.transmission <= 0.0
    };
    let mut texels = 0;
    for (i, ((view, map), coarser)) in maps.plan.views.iter().zip(&mut maps.maps).zip(&mut maps.coarser).enumerate() {
        let size = view.size as usize;
        map.resize(size * size, [1.0; 4]);
        let scan = ScanView::of_shadow(view);
        scratch.list.choose(&scan, scene, accel, casts);
        let key = (*view, settings.moments, certified);
        if scratch.made_of[i].update(key, scene, accel, scratch.list.instances()) {
            continue;
        }
        texels += (size * size) as u64;
        scratch.list.set_up(level, &scan, scene, accel);
        // Certified shadows want depth itself.
        let filter = if certified { None } else { Some(settings.moments.filter) };
        let squares = filter.is_some() && view.softness > 0.0;
        let pass = Pass { scan, list: &scratch.list, accel, level, far: view.far, size, squares };
        let bands = &scratch.bands;
        let across = squares_across(size);
        scratch.squares.resize(across * across, Square::default());
        let squares = scratch.squares.par_chunks_mut(across * BAND / glance::SIDE);
        map.par_chunks_mut(size * BAND).zip(squares).enumerate().with_max_len(1).for_each(|(band, (rows, squares))| {
            let own = rayon::current_thread_index().unwrap_or(0) % bands.len();
            let mut scratch = bands[own].lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            pass.band(&mut scratch, band * BAND, rows, squares, filter);
        });
        maps.squares[i].clear();
        if pass.squares {
            with_neighbours(&scratch.squares, size, penumbra::steepest(view), &mut maps.squares[i]);
        }
        coarser.clear();
        if certified {
            maps.pyramids[i].build(size, map.iter().map(|m| m[0]));
        } else if view.softness > 0.0 {
            penumbra::make_levels(level, map, view.size, coarser);
        }
    }
    // Which thread gets which band is chance; memory for it must not be.
    let lists = || scratch.bands.iter().map(|b| b.lock().unwrap_or_else(std::sync::PoisonError::into_inner));
    let most = lists().map(|b| b.candidates.capacity()).max().unwrap_or(0);
    lists().for_each(|mut b| make_room(&mut b.candidates, most));
    texels
}

/// One view's pass.
struct Pass<'a> {
    scan: ScanView,
    list: &'a ScanList,
    accel: &'a Accel,
    level: SimdLevel,
    far: f32,
    size: usize,
    /// What is proven at a glance is wanted.
    squares: bool,
}

impl Pass<'_> {
    /// Makes the rows from `y0` on; `filter` `None`: unfiltered depths.
    fn band(
        &self,
        s: &mut BandScratch,
        y0: usize,
        rows: &mut [[f32; 4]],
        squares: &mut [Square],
        filter: Option<ShadowFilter>,
    ) {
        let _span = tracing::info_span!("moments band").entered();
        let size = self.size;
        let height = rows.len() / size;
        let reach = if filter.is_some() { REACH } else { 0 };
        let (top, bottom) = (y0.saturating_sub(reach), (y0 + height + reach).min(size));
        self.list.of_rows(top as u32, bottom as u32 - 1, &mut s.candidates);
        let rect = TileRect { x: 0, y: top as u32, width: size as u32, height: (bottom - top) as u32 };
        s.depths.fill(self.level, &self.scan, self.list, &s.candidates, self.accel, rect);
        let depths = |buffers: &TileBuffers, y: usize| {
            let first = (y - top) * buffers.runs;
            first..first + buffers.runs
        };
        let parallel = !self.scan.perspective;
        let Some(filter) = filter else {
            for (y, out) in rows.chunks_mut(size).enumerate() {
                let row = &s.depths.nearness[depths(&s.depths, y0 + y)];
                moments_row(self.level, out, row, ShadowFilter::Vsm, parallel, self.far);
            }
            return;
        };
        let across = squares_across(size);
        for (k, out) in squares.chunks_mut(across).enumerate().filter(|_| self.squares) {
            let first = y0 + k * glance::SIDE;
            let last = (first + glance::SIDE).min(y0 + height) - 1;
            let range = depths(&s.depths, first).start..depths(&s.depths, last).end;
            own_bounds(self.level, &s.depths.nearness[range], out);
        }
        s.row.resize(size, [0.0; 4]);
        s.ring.iter_mut().for_each(|r| r.resize(size, [0.0; 4]));
        let ring = s.ring.len();
        for y in top..bottom {
            let row = &s.depths.nearness[depths(&s.depths, y)];
            moments_row(self.level, &mut s.row, row, filter, parallel, self.far);
            blur_row(self.level, &mut s.ring[y % ring], &s.row);
            // The row that now has both of its neighbours; at the map's lower rim, all that are left.
            let last = if y + 1 == size { y + 1 } else { (y + 1).saturating_sub(REACH) };
            for done in (y.saturating_sub(REACH)..last).filter(|d| (y0..y0 + height).contains(d)) {
                let tap = |k: usize| &s.ring[(done + k).saturating_sub(REACH).min(size - 1) % ring][..];
                let out = &mut rows[(done - y0) * size..][..size];
                blur_column(self.level, out, [tap(0), tap(1), tap(2)]);
            }
        }
    }
}

#[inline(always)]
fn moments_row_body(out: &mut [[f32; 4]], nearness: &[[f32; BLOCK]], filter: ShadowFilter, parallel: bool, far: f32) {
    let mut depth = [0.0f32; BLOCK];
    for (out, nearness) in out.chunks_mut(BLOCK).zip(nearness) {
        for lane in 0..BLOCK {
            depth[lane] = if parallel { -nearness[lane] / far } else { 1.0 / (nearness[lane] * far) };
        }
        let mut moments = [[0.0f32; BLOCK]; 4];
        for lane in 0..BLOCK {
            let m = moments_of(filter, depth[lane]);
            for c in 0..4 {
                moments[c][lane] = m[c];
            }
        }
        for (lane, o) in out.iter_mut().enumerate() {
            *o = [moments[0][lane], moments[1][lane], moments[2][lane], moments[3][lane]];
        }
    }
}

dispatch! {
    /// [`moments_of`] a row of nearness values; of depth 1 where there is nothing.
    fn moments_row => moments_row_body(
        out: &mut [[f32; 4]],
        nearness: &[[f32; BLOCK]],
        filter: ShadowFilter,
        parallel: bool,
        far: f32,
    )
}

/// The three taps in one fixed order: the outer pair first.
#[inline(always)]
fn three_taps(t: [f32; 3]) -> f32 {
    let [w1, w0] = BINOMIAL_3;
    (t[0] + t[2]) * w1 + t[1] * w0
}

#[inline(always)]
fn blur_row_body(out: &mut [[f32; 4]], row: &[[f32; 4]]) {
    let n = row.len();
    for x in [0, n - 1] {
        for c in 0..4 {
            let tap = |k: usize| row[(x + k).saturating_sub(REACH).min(n - 1)][c];
            out[x][c] = three_taps([tap(0), tap(1), tap(2)]);
        }
    }
    if n < 3 {
        return;
    }
    // Flat: four channels side by side, so that a tap is four numbers on.
    let (out, row) = (out.as_flattened_mut(), row.as_flattened());
    let len = 4 * (n - 2);
    let out = &mut out[4..4 + len];
    let tap = |k: usize| &row[4 * k..4 * k + len];
    let t = [tap(0), tap(1), tap(2)];
    for i in 0..len {
        out[i] = three_taps([t[0][i], t[1][i], t[2][i]]);
    }
}

#[inline(always)]
fn blur_column_body(out: &mut [[f32; 4]], rows: [&[[f32; 4]]; 3]) {
    let out = out.as_flattened_mut();
    let n = out.len();
    let flat = |k: usize| &rows[k].as_flattened()[..n];
    let t = [flat(0), flat(1), flat(2)];
    for i in 0..n {
        out[i] = three_taps([t[0][i], t[1][i], t[2][i]]);
    }
}

dispatch! { fn blur_row => blur_row_body(out: &mut [[f32; 4]], row: &[[f32; 4]]) }
dispatch! { fn blur_column => blur_column_body(out: &mut [[f32; 4]], rows: [&[[f32; 4]]; 3]) }

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blur_is_the_direct_sum_over_nine_taps() {
        let size = 20usize;
        let map: Vec<[f32; 4]> = (0..size * size)
            .map(|i| {
                let v = |m: usize, n: usize| (i * m % n) as f32 / n as f32;
                [v(37, 101), v(17, 89), v(5, 43), v(3, 71)]
            })
            .collect();
        let row = |y: usize| {
            let mut out = vec![[0.0; 4]; size];
            blur_row(SimdLevel::Portable, &mut out, &map[y * size..(y + 1) * size]);
            out
        };
        let sideways: Vec<_> = (0..size).map(row).collect();
        let mut blurred = vec![[0.0; 4]; size * size];
        for y in 0..size {
            let taps = std::array::from_fn(|k| sideways[(y + k).saturating_sub(REACH).min(size - 1)].as_slice());
            blur_column(SimdLevel::Portable, &mut blurred[y * size..(y + 1) * size], taps);
        }
        let weight = |k: i32| BINOMIAL_3[(1 - k.abs()) as usize];
        for y in 0..size as i32 {
            for x in 0..size as i32 {
                let mut sum = [0.0f64; 4];
                for dy in -1..=1 {
                    for dx in -1..=1 {
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
