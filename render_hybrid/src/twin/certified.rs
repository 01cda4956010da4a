//! Certified shadows: the least and greatest depth over the part of a shadow map through which rays from a point to the
//! light's disc pass prove the point fully lit or fully dark; where they prove nothing, rays decide.
//!
//! A ray from the point p (depth z_p, distance D) to a disc of radius r is, at depth z, at most r(1 − z/D) off the line to the
//! disc's centre, which on the map (tangents) is r(1/z − 1/D).
//! * Lit: no texel that is nearer than the receiver's own plane lies within the footprint that its own depth allows; found by
//!   descending a pyramid of least depths.
//! * Dark: every texel in the footprint of the nearest occluder over it is nearer, and all at so nearly one depth that no ray
//!   can pass from texel to texel between layers.
//!
//! Limits: a light of one view does not know what lies beside its cone, nor a face what lies on another face (the dark proof
//! stays on one face; for the lit proof both count as empty). A map knows depth at texel centres only. What is thinner than a texel, or closer to the receiver than its plane's
//! depth changes over the footprint (at most [`MOST_SLACK_TEXELS`]), may be missed.
//!
//! Sources: the footprint of Fernando, "Percentage-Closer Soft Shadows", SIGGRAPH 2005 sketches; classifying by minimum and
//! maximum depth after Guennebaud et al., "Real-time Soft Shadow Mapping by Backprojection", EGSR 2006.

use catoptra_engine::{Light, LightKind};
use glam::Vec2;

use super::shadow::{ShadowMaps, shadow_project};
use crate::trace::surface::RayStart;

/// Most texel widths by which an occluder may be missed. Higher: fewer rays, later contacts.
pub const MOST_SLACK_TEXELS: f32 = 4.0;

/// Most squares of the pyramid that are looked at to prove a point lit. Higher: fewer rays, dearer proofs.
pub const MOST_VISITS: u32 = 96;

/// What a footprint proves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Certainty {
    /// All of the light's disc is seen.
    Lit,
    /// None of it.
    Dark,
    /// Rays must decide.
    Unknown,
}

/// Least and greatest depth over squares of 1, 2, 4 .. texels.
#[derive(Clone, Debug, Default)]
pub struct DepthPyramid {
    /// (texels a side, [least, greatest] per texel), finest first; the last has one texel.
    levels: Vec<(usize, Vec<[f32; 2]>)>,
}

impl DepthPyramid {
    /// Builds all levels over a square map of depths; reuses the memory.
    pub fn build(&mut self, size: usize, depth: impl Iterator<Item = f32>) {
        let mut spare: Vec<Vec<[f32; 2]>> = self.levels.drain(..).map(|l| l.1).collect();
        spare.reverse();
        let mut next = || {
            let mut v = spare.pop().unwrap_or_default();
            v.clear();
            v
        };
        let mut base = next();
        base.extend(depth.map(|z| [z, z]));
        assert_eq!(base.len(), size * size, "a square map");
        self.levels.push((size, base));
        while let Some((n, fine)) = self.levels.last().filter(|l| l.0 > 1) {
            let half = n.div_ceil(2);
            let mut coarse = next();
            for y in 0..half {
                for x in 0..half {
                    let (x1, y1) = ((2 * x + 1).min(n - 1), (2 * y + 1).min(n - 1));
                    let four = [(2 * x, 2 * y), (x1, 2 * y), (2 * x, y1), (x1, y1)];
                    coarse.push(four.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |m, &(x, y)| {
                        let t = fine[y * n + x];
                        [m[0].min(t[0]), m[1].max(t[1])]
                    }));
                }
            }
            self.levels.push((half, coarse));
        }
    }

    /// Whether `blocks(depth, offset)` holds for any texel, with its offset from `center_uv`; it must hold for nearer depths
    /// and smaller offsets wherever it holds at all. `None` where finding out takes more than [`MOST_VISITS`] steps.
    pub fn any(&self, center_uv: Vec2, blocks: impl Fn(f32, Vec2) -> bool) -> Option<bool> {
        let Some(&(size, _)) = self.levels.first() else { return Some(false) };
        let center = center_uv * size as f32 - 0.5;
        let mut stack = [(0u8, 0u16, 0u16); 64];
        stack[0] = (self.levels.len() as u8 - 1, 0, 0);
        let mut top = 1;
        for _ in 0..MOST_VISITS {
            if top == 0 {
                return Some(false);
            }
            top -= 1;
            let (level, x, y) = stack[top];
            let (n, texels) = &self.levels[level as usize];
            let (tx, ty) = (x as usize, y as usize);
            // The square of texel centres below this one, and how far the centre is outside it.
            let low = Vec2::new((tx << level) as f32, (ty << level) as f32);
            let high = (low + ((1usize << level) - 1) as f32).min(Vec2::splat((size - 1) as f32));
            let off = (low - center).max(center - high).max(Vec2::ZERO) / size as f32;
            if !blocks(texels[ty * n + tx][0], off) {
                continue;
            }
            if level == 0 {
                return Some(true);
            }
            let finer = self.levels[level as usize - 1].0;
            for (cx, cy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let (cx, cy) = (2 * x + cx, 2 * y + cy);
                if (cx as usize) < finer && (cy as usize) < finer {
                    // Depth first: at most three siblings wait a level, which 64 entries hold for any map.
                    stack[top] = (level - 1, cx, cy);
                    top += 1;
                }
            }
        }
        None
    }

    /// Least and greatest depth over the texels that bilinear filtering anywhere in the box would read. `None` where the box
    /// leaves the map.
    pub fn over(&self, center_uv: Vec2, half_uv: Vec2) -> Option<[f32; 2]> {
        let size = self.levels.first()?.0;
        let low = (center_uv - half_uv) * size as f32 - 0.5;
        let high = (center_uv + half_uv) * size as f32 + 0.5;
        if !(low.min_element() >= 0.0 && high.max_element() <= (size - 1) as f32) {
            return None;
        }
        let (x0, y0) = (low.x as usize, low.y as usize);
        let (x1, y1) = (high.x.ceil() as usize, high.y.ceil() as usize);
        let mut level = 0;
        while (x1 >> level) - (x0 >> level) > 2 || (y1 >> level) - (y0 >> level) > 2 {
            level += 1;
        }
        let (n, texels) = &self.levels[level];
        let mut out = [f32::INFINITY, f32::NEG_INFINITY];
        for y in y0 >> level..=y1 >> level {
            for t in &texels[y * n + (x0 >> level)..=y * n + (x1 >> level)] {
                out = [out[0].min(t[0]), out[1].max(t[1])];
            }
        }
        Some(out)
    }
}

/// What the maps prove about light `index` at a surface. The rule is the module's.
pub fn certify(maps: &ShadowMaps, index: u32, light: &Light, s: &RayStart) -> Certainty {
    use Certainty::Unknown;
    let number = maps.plan.view_of(index, light.position_world, s.position_world) as usize;
    let (view, pyramid) = (&maps.plan.views[number], &maps.pyramids[number]);
    let c = shadow_project(view, s.position_world);
    if !c.in_front {
        return Unknown;
    }
    let z_receiver = c.depth * view.far;
    let (wi, distance, _) = light.incident(s.position_world);
    let parallel = matches!(light.kind, LightKind::Directional);
    // Where part of the disc is below the surface's horizon the fraction is neither 0 nor 1.
    let r = light.radius;
    let above = s.n_geometric.dot(wi) * if parallel { 1.0 } else { distance };
    if above <= r * 1.001 {
        return Unknown;
    }
    // Map units: metres (parallel) or tangents. Off the axis a disc that faces the point spreads over 1/cos² of the map, and
    // depths along the axis are cos of distances: 1/cos in all.
    let half_extent = Vec2::new(1.0 / view.right_scaled.length(), 1.0 / view.up_scaled.length());
    let texel = half_extent.max_element() * 2.0 / view.size as f32;
    let slant = if parallel { 1.0 } else { distance / z_receiver };
    let spread = |near: f32, far: f32| {
        let lateral = if parallel { far - near } else { 1.0 / near.max(1e-30) - 1.0 / far };
        (r * lateral).max(0.0) * slant * 1.05
    };
    // Depth by which the receiver's own plane comes nearer within the texels around it.
    let along = if parallel { view.forward } else { (s.position_world - view.origin_world) / z_receiver };
    let n_forward = s.n_geometric.dot(view.forward);
    let n_across = (1.0 - n_forward * n_forward).max(0.0).sqrt();
    let n_along = s.n_geometric.dot(along).abs();
    let width = if parallel { texel } else { texel * z_receiver };
    if 1.2 * n_across > MOST_SLACK_TEXELS * n_along {
        return Unknown;
    }
    let nearest_own = z_receiver - (1.2 * width * n_across / n_along + 1e-4 * z_receiver);
    let reaches = |depth: f32, off_uv: Vec2| {
        let z = depth * view.far;
        z < nearest_own && (off_uv * 2.0 * half_extent).length() <= spread(z, z_receiver) + texel
    };
    match pyramid.any(c.uv, reaches) {
        Some(false) => return Certainty::Lit,
        Some(true) => {}
        None => return Unknown,
    }

    // Dark: the footprint that the layer over the point allows, widened until it holds its own least depth.
    let mut least = z_receiver;
    for _ in 0..4 {
        let half_uv = Vec2::splat(spread(least, z_receiver) + texel) / half_extent * 0.5;
        let Some(range) = pyramid.over(c.uv, half_uv) else { return Unknown };
        let (low, greatest) = (range[0] * view.far, range[1] * view.far);
        if greatest >= nearest_own {
            return Unknown;
        }
        if low >= least {
            let one_layer = spread(low, greatest) <= 0.5 * texel;
            return if one_layer { Certainty::Dark } else { Unknown };
        }
        least = low;
    }
    Unknown
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pyramid_bounds_every_box() {
        let size = 37usize;
        let depth = |x: usize, y: usize| ((x * 31 + y * 57) % 101) as f32 / 101.0;
        let mut pyramid = DepthPyramid::default();
        pyramid.build(size, (0..size * size).map(|i| depth(i % size, i / size)));
        for i in 0..100usize {
            let center = Vec2::new(0.1 + 0.008 * i as f32, 0.9 - 0.007 * i as f32);
            let blocks = |z: f32, off: Vec2| z + 3.0 * off.length() < 0.03;
            let brute = (0..size * size).any(|k| {
                let uv = (Vec2::new((k % size) as f32, (k / size) as f32) + 0.5) / size as f32;
                blocks(depth(k % size, k / size), (uv - center).abs())
            });
            let found = pyramid.any(center, blocks);
            assert!(found.is_none() || found == Some(brute), "{center}: {found:?} for {brute}");
        }
        assert!(pyramid.over(Vec2::splat(0.02), Vec2::splat(0.1)).is_none(), "off the map");
        for i in 0..200usize {
            let center = Vec2::new(0.3 + 0.002 * i as f32, 0.6 - 0.0015 * i as f32);
            let half = Vec2::splat(0.001 * i as f32);
            let [low, high] = pyramid.over(center, half).unwrap();
            let inside = |k: usize, c: f32, h: f32| ((k as f32 + 0.5) / size as f32 - c).abs() <= h;
            for y in (0..size).filter(|&y| inside(y, center.y, half.y)) {
                for x in (0..size).filter(|&x| inside(x, center.x, half.x)) {
                    assert!(low <= depth(x, y) && depth(x, y) <= high);
                }
            }
        }
    }
}
