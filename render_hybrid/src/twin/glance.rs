//! What a shadow map proves at a glance: over most places nothing lies before the receiver's surface, or everything does.
//!
//! A map is divided into squares of [`SIDE`] texels. Nearness (1/z seen in perspective, −z by parallel light) is an affine function
//! of the texel where the map shows a plane, so each square keeps one such function and how far above and below it its texels
//! and those of its neighbours lie, [`REACH`] squares each way. A receiver that is as near as the highest of them is lit by all of
//! the light's disc, if the disc's image reaches no farther than these; one that is farther than the lowest is dark.
//!
//! Both hold where the plane is not so steep that it shades itself from a part of the disc; steeper ones prove nothing.
//!
//! Only the CPU asks: it spares the moments, and shows what they would show.

use rayon::prelude::*;

use crate::simd::dispatch;

/// Texels a side of a square.
pub const SIDE: usize = 16;

/// Neighbours each way that count.
pub const REACH: usize = 2;

/// Widest σ of a search for occluders, in texels, that a square and its neighbours cover: the disc's radius is σ / 0.536.
pub const WIDEST_SIGMA: f32 = 0.5 * (REACH * SIDE) as f32;

/// Share of the depth by which an occluder may be missed.
const SLACK: f32 = 2e-4;

/// Bounds over a square and its neighbours.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Square {
    /// Nearness at its first texel, and from texel to texel along x and y.
    plane: [f32; 3],
    /// Least and greatest nearness over the plane.
    least: f32,
    greatest: f32,
}

/// Squares along a side of a map of `size` texels.
#[inline(always)]
pub fn squares_across(size: usize) -> usize {
    size.div_ceil(SIDE)
}

#[inline(always)]
fn own_bounds_body(nearness: &[[f32; SIDE]], out: &mut [Square]) {
    let runs = out.len();
    let rows = nearness.len() / runs;
    for (i, square) in out.iter_mut().enumerate() {
        let corner = nearness[i][0];
        let gx = (nearness[i][SIDE - 1] - corner) * (1.0 / (SIDE - 1) as f32);
        let gy = if rows > 1 { (nearness[(rows - 1) * runs + i][0] - corner) / (rows - 1) as f32 } else { 0.0 };
        let mut least = [f32::INFINITY; SIDE];
        let mut greatest = [f32::NEG_INFINITY; SIDE];
        for y in 0..rows {
            let start = corner + gy * y as f32;
            let row = &nearness[y * runs + i];
            for k in 0..SIDE {
                let off = row[k] - (start + gx * k as f32);
                least[k] = if off < least[k] { off } else { least[k] };
                greatest[k] = if off > greatest[k] { off } else { greatest[k] };
            }
        }
        *square = Square {
            plane: [corner, gx, gy],
            least: least.iter().copied().fold(f32::INFINITY, f32::min),
            greatest: greatest.iter().copied().fold(f32::NEG_INFINITY, f32::max),
        };
    }
}

dispatch! {
    /// Bounds of a row of squares by themselves.
    /// * `nearness`: up to [`SIDE`] rows of the map, as many runs a row as there are squares; at least the view's farthest
    pub fn own_bounds => own_bounds_body(nearness: &[[f32; SIDE]], out: &mut [Square])
}

/// Widens the bounds of all squares by their neighbours'.
/// * `own`: bounds by themselves; `size`: texels a side of the map
/// * `steepest`: change of nearness from texel to texel up to which a plane proves anything
pub fn with_neighbours(own: &[Square], size: usize, steepest: f32, out: &mut Vec<Square>) {
    let across = squares_across(size);
    out.resize(own.len(), Square::default());
    out.par_iter_mut().with_min_len(512).enumerate().for_each(|(i, out)| {
        let (x, y) = (i % across, i / across);
        let mut square = own[i];
        let [_, gx, gy] = square.plane;
        if !(gx * gx + gy * gy <= steepest * steepest) {
            (square.least, square.greatest) = (f32::NEG_INFINITY, f32::INFINITY);
        }
        for ny in y.saturating_sub(REACH)..(y + REACH + 1).min(across) {
            for nx in x.saturating_sub(REACH)..(x + REACH + 1).min(across) {
                let other = &own[ny * across + nx];
                // Between two planes the difference is greatest and least at corners.
                let (dx, dy) = ((nx as f32 - x as f32) * SIDE as f32, (ny as f32 - y as f32) * SIDE as f32);
                let start = other.plane[0] - (square.plane[0] + square.plane[1] * dx + square.plane[2] * dy);
                let span = (SIDE - 1) as f32;
                let (gx, gy) = ((other.plane[1] - square.plane[1]) * span, (other.plane[2] - square.plane[2]) * span);
                let (low, high) = (gx.min(0.0) + gy.min(0.0), gx.max(0.0) + gy.max(0.0));
                square.least = square.least.min(start + low + other.least);
                square.greatest = square.greatest.max(start + high + other.greatest);
            }
        }
        *out = square;
    });
}

/// What the squares of a map prove about a receiver: 1 lit, 0 dark, less than 0 nothing.
/// * (`x`, `y`): texels from the map's corner, on the map; `nearness`: the receiver's
#[inline(always)]
pub fn glance(squares: &[Square], across: usize, x: f32, y: f32, nearness: f32, slack: f32) -> f32 {
    let (i, j) = ((x as usize) / SIDE, (y as usize) / SIDE);
    let top = across - 1;
    let (i, j) = (if i < top { i } else { top }, if j < top { j } else { top });
    let s = &squares[j * across + i];
    let (dx, dy) = (x - 0.5 - (i * SIDE) as f32, y - 0.5 - (j * SIDE) as f32);
    let over = nearness - ((s.plane[0] + s.plane[1] * dx) + s.plane[2] * dy);
    let lit = over >= s.greatest - slack;
    let dark = over < s.least - slack;
    if lit {
        1.0
    } else if dark {
        0.0
    } else {
        -1.0
    }
}

/// Nearness of a receiver at `along` metres along the view's axis, and the slack there.
#[inline(always)]
pub fn nearness_of(perspective: bool, along: f32, far: f32) -> (f32, f32) {
    let inverse = 1.0 / along;
    if perspective { (inverse, inverse * SLACK) } else { (-along, far * SLACK) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::SimdLevel;

    /// Texels of a disc's image over nearness.
    const K: f32 = 40.0;

    fn squares(size: usize, nearness: &dyn Fn(usize, usize) -> f32) -> Vec<Square> {
        let across = squares_across(size);
        let run = |i: usize| std::array::from_fn(|k| nearness(i % across * SIDE + k, i / across));
        let runs: Vec<[f32; SIDE]> = (0..across * size).map(run).collect();
        let mut own = vec![Square::default(); across * across];
        for (rows, out) in runs.chunks(SIDE * across).zip(own.chunks_mut(across)) {
            own_bounds(SimdLevel::Portable, rows, out);
        }
        let mut out = Vec::new();
        with_neighbours(&own, size, 1.0 / K, &mut out);
        out
    }

    #[test]
    fn a_plane_is_lit_on_itself_and_dark_behind() {
        for size in [64, 40] {
            let plane = |x: usize, y: usize| 0.5 + 0.003 * x as f32 - 0.002 * y as f32;
            let all = squares(size, &plane);
            for y in 0..size {
                for x in 0..size {
                    let n = plane(x, y);
                    let ask = |n: f32| glance(&all, squares_across(size), x as f32 + 0.5, y as f32 + 0.5, n, 1e-4 * n);
                    assert_eq!((ask(n), ask(n * 1.1), ask(n * 0.9)), (1.0, 1.0, 0.0), "at {x}, {y}");
                }
            }
        }
    }

    #[test]
    fn nothing_is_proven_wrongly() {
        // A slanted floor, a box over a part of it, and a needle.
        let size = 256;
        let near = |x: usize, y: usize| {
            let floor = 0.3 + 0.001 * x as f32;
            let blocked = ((40..140).contains(&x) && (30..150).contains(&y)) || (x, y) == (200, 200);
            if blocked { 0.9 } else { floor }
        };
        let all = squares(size, &near);
        let across = squares_across(size);
        let mut proven = [0; 2];
        for y in (0..size).step_by(3) {
            for x in (0..size).step_by(3) {
                for n in [0.3 + 0.001 * x as f32, 0.2, 0.6, 0.95] {
                    let answer = glance(&all, across, x as f32 + 0.5, y as f32 + 0.5, n, 1e-5);
                    if answer < 0.0 {
                        continue;
                    }
                    proven[answer as usize] += 1;
                    // A texel occludes a part of the disc if it lies within the disc's image at its own depth.
                    let reach = REACH * SIDE;
                    for v in y.saturating_sub(reach)..(y + reach + 1).min(size) {
                        for u in x.saturating_sub(reach)..(x + reach + 1).min(size) {
                            let (du, dv) = (u as f32 - x as f32, v as f32 - y as f32);
                            let away = (du * du + dv * dv).sqrt();
                            let inside = away < K * (near(u, v) - n) - 1.0;
                            assert!(answer == 0.0 || !inside, "({x}, {y}) at {n} is not lit: ({u}, {v})");
                            let inside = away < K * (near(x, y) - n) - 1.0;
                            assert!(answer == 1.0 || !inside || near(u, v) > n, "({x}, {y}) at {n} is not dark");
                        }
                    }
                }
            }
        }
        assert!(proven[0] > 2000 && proven[1] > 5000, "{proven:?}");
    }
}
