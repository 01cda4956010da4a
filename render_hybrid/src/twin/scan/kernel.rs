//! Which triangle is nearest at each pixel of a tile.

use super::{ScanList, ScanTriangle, ScanView, setup::PixelBox};
use crate::{
    accel::{Accel, Hit},
    settings::SimdLevel,
    simd::dispatch,
    twin::tile::TileRect,
};

/// Pixels that the kernels handle together, and side of the blocks from whose corner weights are evaluated.
pub const BLOCK: usize = 16;

/// The nearest triangle of each pixel of a tile. Rows are runs of [`BLOCK`] pixels that start on multiples of it, so that the
/// first and the last run may reach beyond the tile.
#[derive(Clone, Debug, Default)]
pub struct TileBuffers {
    /// Column of the first run.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Runs a row.
    pub runs: usize,
    /// Rows.
    pub rows: usize,
    /// 1/t, or −t in parallel views, per pixel; the farthest allowed where there is no triangle.
    pub nearness: Vec<[f32; BLOCK]>,
    /// Number of the triangle in the list, or [`Self::NONE`].
    pub triangle: Vec<[u32; BLOCK]>,
}

impl TileBuffers {
    /// No triangle.
    pub const NONE: u32 = u32::MAX;

    /// Fills the tile from the triangles `list` (ascending numbers) of `all`.
    pub fn fill(
        &mut self,
        level: SimdLevel,
        view: &ScanView,
        all: &ScanList,
        list: &[u32],
        accel: &Accel,
        rect: TileRect,
    ) {
        let first = rect.x as usize / BLOCK;
        let end = (rect.x + rect.width) as usize;
        (self.x, self.y) = ((first * BLOCK) as u32, rect.y);
        (self.runs, self.rows) = (end.div_ceil(BLOCK) - first, rect.height as usize);
        let (farthest, nearest) = view.nearness_range();
        let size = self.runs * self.rows;
        self.nearness.clear();
        self.nearness.resize(size, [farthest; BLOCK]);
        self.triangle.clear();
        self.triangle.resize(size, [Self::NONE; BLOCK]);
        let (x1, y1) = (self.x + (self.runs * BLOCK) as u32 - 1, rect.y + rect.height - 1);
        // Triangles with holes are looked at pixel by pixel, in their place among the others.
        let mut rest = list;
        while !rest.is_empty() {
            let has_holes = |n: &u32| accel.has_holes(all.triangle(*n).instance_id);
            let whole =
                if accel.any_holes() { rest.iter().position(has_holes).unwrap_or(rest.len()) } else { rest.len() };
            scan(level, self, all, &rest[..whole], [self.x, x1, self.y, y1], nearest);
            if let Some(&n) = rest.get(whole) {
                self.fill_with_holes(view, all, n, accel, [self.x, x1, self.y, y1], nearest);
            }
            rest = &rest[(whole + 1).min(rest.len())..];
        }
    }

    fn fill_with_holes(
        &mut self,
        view: &ScanView,
        all: &ScanList,
        n: u32,
        accel: &Accel,
        bounds: [u32; 4],
        nearest: f32,
    ) {
        let (t, b) = (all.triangle(n), all.pixel_box(n));
        let Some([x0, x1, y0, y1]) = overlap(b, bounds) else { return };
        for y in y0..=y1 {
            for x in x0..=x1 {
                let at = (y - self.y) as usize * self.runs + (x - self.x) as usize / BLOCK;
                let lane = x as usize % BLOCK;
                let [u, v, w, z] = t.at(x, y);
                let covers = u >= 0.0 && v >= 0.0 && w >= 0.0 && z > self.nearness[at][lane] && z < nearest;
                if !covers {
                    continue;
                }
                let sum = (u + v) + w;
                let hit = Hit {
                    t: ScanView::distance(view.perspective, z),
                    u: v / sum,
                    v: w / sum,
                    instance_id: t.instance_id,
                    primitive_id: t.primitive_id,
                };
                if !accel.is_hole(&hit) {
                    self.nearness[at][lane] = z;
                    self.triangle[at][lane] = n;
                }
            }
        }
    }
}

impl ScanTriangle {
    /// Weights and nearness as single-precision functions of the place within the block that holds pixel (x, y):
    /// [per x, per y, at the block's corner].
    #[inline(always)]
    pub fn in_block(&self, x: u32, y: u32) -> [[f32; 3]; 4] {
        let mask = !(BLOCK as u32 - 1);
        let (x, y) = (f64::from(x & mask), f64::from(y & mask));
        let of = |f: &[f64; 3]| [f[0] as f32, f[1] as f32, ((f[0] * x + f[1] * y) + f[2]) as f32];
        [of(&self.weights[0]), of(&self.weights[1]), of(&self.weights[2]), of(&self.nearness)]
    }

    /// Weights and nearness at a pixel: the kernels' numbers.
    pub fn at(&self, x: u32, y: u32) -> [f32; 4] {
        let mask = BLOCK as u32 - 1;
        let (dx, dy) = ((x & mask) as f32, (y & mask) as f32);
        self.in_block(x, y).map(|f| (f[0] * dx + f[1] * dy) + f[2])
    }
}

/// Common columns and rows of a triangle's box and [x0, x1, y0, y1].
#[inline(always)]
fn overlap(b: PixelBox, [x0, x1, y0, y1]: [u32; 4]) -> Option<[u32; 4]> {
    let (x0, x1) = (x0.max(b.x0.into()), x1.min(b.x1.into()));
    let (y0, y1) = (y0.max(b.y0.into()), y1.min(b.y1.into()));
    (x0 <= x1 && y0 <= y1).then_some([x0, x1, y0, y1])
}

#[inline(always)]
fn scan_body(tile: &mut TileBuffers, all: &ScanList, list: &[u32], bounds: [u32; 4], nearest: f32) {
    let (first_run, first_row, runs) = (tile.x as usize / BLOCK, tile.y as usize, tile.runs);
    for &n in list {
        let Some([x0, x1, y0, y1]) = overlap(all.pixel_box(n), bounds).map(|b| b.map(|v| v as usize)) else { continue };
        let triangle = all.triangle(n);
        for block_y in y0 / BLOCK..=y1 / BLOCK {
            let rows = y0.max(block_y * BLOCK)..(y1 + 1).min((block_y + 1) * BLOCK);
            for block_x in x0 / BLOCK..=x1 / BLOCK {
                let f = triangle.in_block((block_x * BLOCK) as u32, (block_y * BLOCK) as u32);
                // Rounding is monotone, so this bounds what the pixels compute.
                let last = (BLOCK - 1) as f32;
                let most = |g: [f32; 3]| {
                    let x = if g[0] > 0.0 { g[0] * last } else { 0.0 };
                    let y = if g[1] > 0.0 { g[1] * last } else { 0.0 };
                    (x + y) + g[2]
                };
                if most(f[0]) < 0.0 || most(f[1]) < 0.0 || most(f[2]) < 0.0 {
                    continue;
                }
                let across: [[f32; BLOCK]; 4] = f.map(|g| std::array::from_fn(|lane| g[0] * lane as f32));
                for y in rows.clone() {
                    let dy = (y - block_y * BLOCK) as f32;
                    let down = f.map(|g| g[1] * dy);
                    let at = (y - first_row) * runs + block_x - first_run;
                    let (nearness, number) = (&mut tile.nearness[at], &mut tile.triangle[at]);
                    for lane in 0..BLOCK {
                        let value = |i: usize| (across[i][lane] + down[i]) + f[i][2];
                        let (u, v, w, z) = (value(0), value(1), value(2), value(3));
                        let covers = (u >= 0.0) & (v >= 0.0) & (w >= 0.0) & (z > nearness[lane]) & (z < nearest);
                        nearness[lane] = if covers { z } else { nearness[lane] };
                        number[lane] = if covers { n } else { number[lane] };
                    }
                }
            }
        }
    }
}

dispatch! {
    /// Takes each triangle of `list` where it is nearest.
    fn scan => scan_body(tile: &mut TileBuffers, all: &ScanList, list: &[u32], bounds: [u32; 4], nearest: f32)
}
