//! Filtered shadow maps asked for a batch of points, sixteen at a time: what [`ShadowMaps::visibility`] says of one.

use catoptra_engine::Light;
use glam::{Vec2, Vec3, Vec4};

use super::points::{LANES, Lane, PointBatch, lanes, store};
use crate::{
    settings::{MomentOptions, ShadowFilter},
    simd::dispatch,
    twin::{
        glance::{Square, WIDEST_SIGMA, glance, nearness_of, squares_across},
        penumbra::{MOST_LEVELS, level_count, level_of, level_size, occluder_depth, penumbra_sigma},
        shadow::{ShadowMaps, ShadowView, chebyshev_upper_bound, cube_face, evsm_floors, evsm_warp},
    },
};

/// Sixteen places on shadow maps.
struct Places {
    /// Position on the map in texels from its corner.
    at: [Lane; 2],
    depth: Lane,
    /// In metres along the view's axis.
    along: Lane,
    /// Distance from the light over the depth along its axis.
    slant: Lane,
    inside: [bool; LANES],
}

/// As [`crate::twin::shadow::shadow_project`].
#[inline(always)]
fn project(view: impl Fn(usize) -> ShadowView, p: &[Lane; 3]) -> Places {
    let zero = [0.0; LANES];
    let mut out = Places { at: [zero; 2], depth: zero, along: zero, slant: zero, inside: [false; LANES] };
    for lane in 0..LANES {
        let view = view(lane);
        let (o, f, r, u) = (view.origin_world, view.forward, view.right_scaled, view.up_scaled);
        let (x, y, z) = (p[0][lane] - o.x, p[1][lane] - o.y, p[2][lane] - o.z);
        let along = (f.x * x + f.y * y) + f.z * z;
        let perspective = view.perspective > 0.5;
        let w = if perspective { along } else { 1.0 };
        let in_front = w > 0.0;
        let inverse = 1.0 / if in_front { w } else { 1.0 };
        let a = 0.5 + 0.5 * (((r.x * x + r.y * y) + r.z * z) * inverse);
        let b = 0.5 - 0.5 * (((u.x * x + u.y * y) + u.z * z) * inverse);
        out.depth[lane] = along / view.far;
        out.along[lane] = along;
        out.slant[lane] = if perspective { ((x * x + y * y) + z * z).sqrt() * inverse } else { 1.0 };
        out.inside[lane] = in_front & (a >= 0.0) & (b >= 0.0) & (a <= 1.0) & (b <= 1.0);
        let size = view.size as f32;
        (out.at[0][lane], out.at[1][lane]) = (a * size, b * size);
    }
    out
}

/// Texels of a level of a map's pyramid.
type Level<'a> = &'a [[f32; 4]];

/// The levels of a map; those beyond `count` are the first.
#[inline(always)]
fn levels_of<'a>(maps: &'a ShadowMaps, number: usize) -> [Level<'a>; MOST_LEVELS] {
    let full = maps.plan.views[number].size;
    let map = maps.maps[number].as_slice();
    let mut rest = maps.coarser[number].as_slice();
    let mut out = [map; MOST_LEVELS];
    if !rest.is_empty() {
        for level in 1..level_count(full) {
            let size = level_size(full, level);
            let (texels, after) = rest.split_at((size * size) as usize);
            out[level as usize] = texels;
            rest = after;
        }
    }
    out
}

/// Where [`ShadowMaps::sample`] reads sixteen maps.
struct Taps {
    /// First texel: number within the level.
    first: [u32; LANES],
    /// Steps to its right and lower neighbour, 0 at the rim.
    right: [u32; LANES],
    below: [u32; LANES],
    fraction: [Lane; 2],
}

/// * `level`: of each place, on a map of `full` texels a side
#[inline(always)]
fn taps(places: &Places, full: u32, level: &[u32; LANES]) -> Taps {
    let zero = [0u32; LANES];
    let mut out = Taps { first: zero, right: zero, below: zero, fraction: [[0.0; LANES]; 2] };
    for lane in 0..LANES {
        let size = full >> level[lane];
        // 1 / 2^level.
        let share = f32::from_bits((127 - level[lane]) << 23);
        let top = (size - 1) as f32;
        let clamped = |v: f32| {
            let c = v * share - 0.5;
            let c = if c > 0.0 { c } else { 0.0 };
            if c < top { c } else { top }
        };
        let (a, b) = (clamped(places.at[0][lane]), clamped(places.at[1][lane]));
        let (i, j) = (a as u32, b as u32);
        out.fraction[0][lane] = a - i as f32;
        out.fraction[1][lane] = b - j as f32;
        out.first[lane] = j * size + i;
        out.right[lane] = u32::from(i + 1 < size);
        out.below[lane] = if j + 1 < size { size } else { 0 };
    }
    out
}

impl Taps {
    /// Moments at place `lane` of the level whose texels are `map`.
    #[inline(always)]
    fn read(&self, lane: usize, map: &[[f32; 4]]) -> [f32; 4] {
        let first = self.first[lane] as usize;
        let (right, below) = (self.right[lane] as usize, self.below[lane] as usize);
        let texel = |i: usize| Vec4::from_array(map[i]);
        let (fx, fy) = (self.fraction[0][lane], self.fraction[1][lane]);
        let (a, b) = (texel(first), texel(first + right));
        let (c, d) = (texel(first + below), texel(first + below + right));
        let (upper, lower) = (a + (b - a) * fx, c + (d - c) * fx);
        (upper + (lower - upper) * fy).to_array()
    }
}

/// [`ShadowMaps::visibility`]'s glance at sixteen places; less than 0 where nothing is proven.
#[inline(always)]
fn glances<'a>(squares: impl Fn(usize) -> &'a [Square], view: &ShadowView, places: &Places) -> Lane {
    let (across, perspective) = (squares_across(view.size as usize), view.perspective > 0.5);
    let mut out = [-1.0f32; LANES];
    for lane in 0..LANES {
        let squares = squares(lane);
        if !places.inside[lane] {
            // Outside of the map there is no shadow.
            out[lane] = 1.0;
        } else if !squares.is_empty() {
            let (depth, slant) = (places.depth[lane], places.slant[lane]);
            let (nearness, slack) = nearness_of(perspective, places.along[lane], view.far);
            let sigma = penumbra_sigma(view.softness, perspective, slant, 0.5 * depth, depth);
            let found = glance(squares, across, places.at[0][lane], places.at[1][lane], nearness, slack);
            out[lane] = if sigma > WIDEST_SIGMA { -1.0 } else { found };
        }
    }
    out
}

/// Moments at those of sixteen places that are `asked`, as wide as their penumbrae: [`ShadowMaps::visibility`]'s. Numbers of all
/// lanes go side by side, texels lane by lane.
#[inline(always)]
fn soft_moments<'a>(
    levels: impl Fn(usize) -> &'a [Level<'a>; MOST_LEVELS],
    view: &ShadowView,
    places: &Places,
    asked: &[bool; LANES],
    options: &MomentOptions,
) -> [Lane; 4] {
    let mut moments = [[0.0f32; LANES]; 4];
    let fetch = |moments: &mut [Lane; 4], taps: &Taps, lane: usize, level: u32| {
        let m = taps.read(lane, levels(lane)[level as usize]);
        for c in 0..4 {
            moments[c][lane] = m[c];
        }
    };
    let (count, perspective) = (level_count(view.size), view.perspective > 0.5);
    let (mut level, mut fraction) = ([0u32; LANES], [0.0f32; LANES]);
    for lane in 0..LANES {
        let (slant, receiver) = (places.slant[lane], places.depth[lane]);
        let sigma = penumbra_sigma(view.softness, perspective, slant, 0.5 * receiver, receiver);
        let (l, f) = level_of(sigma, count);
        level[lane] = l + u32::from(f >= 0.5);
    }
    let own = taps(places, view.size, &level);
    for lane in (0..LANES).filter(|l| asked[*l]) {
        fetch(&mut moments, &own, lane, level[lane]);
    }
    match options.filter {
        ShadowFilter::Vsm => penumbrae(ShadowFilter::Vsm, view, places, &moments, options, &mut level, &mut fraction),
        ShadowFilter::Evsm4 => {
            penumbrae(ShadowFilter::Evsm4, view, places, &moments, options, &mut level, &mut fraction)
        }
    }
    let own = taps(places, view.size, &level);
    let mut any = false;
    for lane in (0..LANES).filter(|l| asked[*l]) {
        fetch(&mut moments, &own, lane, level[lane]);
        any |= fraction[lane] > 0.0;
    }
    if !any {
        return moments;
    }
    let mut wider = moments;
    let next: [u32; LANES] = std::array::from_fn(|lane| level[lane] + u32::from(fraction[lane] > 0.0));
    let own = taps(places, view.size, &next);
    for lane in (0..LANES).filter(|l| asked[*l] & (fraction[*l] > 0.0)) {
        fetch(&mut wider, &own, lane, next[lane]);
    }
    for c in 0..4 {
        for lane in 0..LANES {
            let more = (wider[c][lane] - moments[c][lane]) * fraction[lane];
            moments[c][lane] += if fraction[lane] > 0.0 { more } else { 0.0 };
        }
    }
    moments
}

/// Levels of the penumbrae at sixteen places, and how far they are to the next one.
/// * `search`: moments of where occluders are looked for
#[inline(always)]
fn penumbrae(
    filter: ShadowFilter,
    view: &ShadowView,
    places: &Places,
    search: &[Lane; 4],
    options: &MomentOptions,
    level: &mut [u32; LANES],
    fraction: &mut Lane,
) {
    let (count, perspective) = (level_count(view.size), view.perspective > 0.5);
    let [a, b, c, d] = search;
    for lane in 0..LANES {
        let (slant, receiver) = (places.slant[lane], places.depth[lane]);
        let m = Vec4::new(a[lane], b[lane], c[lane], d[lane]);
        let occluder = occluder_depth(filter, m, receiver, options.min_variance);
        let sigma = penumbra_sigma(view.softness, perspective, slant, occluder, receiver);
        (level[lane], fraction[lane]) = level_of(sigma, count);
    }
}

/// [`chebyshev_upper_bound`] of sixteen points.
#[inline(always)]
fn chebyshev(mean: &Lane, square: &Lane, t: &Lane, floor: &Lane, reduction: f32) -> Lane {
    let mut out = [0.0f32; LANES];
    for lane in 0..LANES {
        out[lane] = chebyshev_upper_bound(Vec2::new(mean[lane], square[lane]), t[lane], floor[lane], reduction);
    }
    out
}

/// Fraction of light that reaches sixteen places: [`chebyshev_upper_bound`] or [`crate::twin::shadow::evsm_visibility`].
#[inline(always)]
fn bounds(moments: &[Lane; 4], depth: &Lane, options: &MomentOptions) -> Lane {
    let (floor, reduction) = (options.min_variance, options.light_bleed_reduction);
    match options.filter {
        ShadowFilter::Vsm => chebyshev(&moments[0], &moments[1], depth, &[floor; LANES], reduction),
        ShadowFilter::Evsm4 => {
            let (mut near, mut far) = ([0.0f32; LANES], [0.0f32; LANES]);
            let (mut near_floor, mut far_floor) = ([0.0f32; LANES], [0.0f32; LANES]);
            for lane in 0..LANES {
                let w = evsm_warp(depth[lane]);
                (near[lane], far[lane]) = (w.x, w.y);
                let [a, b] = evsm_floors(w, floor);
                (near_floor[lane], far_floor[lane]) = (a, b);
            }
            let near = chebyshev(&moments[0], &moments[1], &near, &near_floor, reduction);
            let far = chebyshev(&moments[2], &moments[3], &far, &far_floor, reduction);
            let mut least = near;
            for lane in 0..LANES {
                least[lane] = if far[lane] < near[lane] { far[lane] } else { near[lane] };
            }
            least
        }
    }
}

#[inline(always)]
fn add_filtered_body(points: &mut PointBatch, maps: &ShadowMaps, index: u32, light: &Light, options: &MomentOptions) {
    let own = maps.plan.lights[index as usize];
    // All views of a light are of one size and softness.
    let view = maps.plan.views[own.first as usize];
    let soft = view.softness > 0.0;
    let levels: [_; 6] = std::array::from_fn(|i| levels_of(maps, own.first as usize + i.min(own.count as usize - 1)));
    for at in (0..points.len()).step_by(LANES) {
        let unshadowed = lanes(&points.unshadowed, at);
        let mut any = 0;
        for lane in 0..LANES {
            any |= unshadowed[0][lane].to_bits() | unshadowed[1][lane].to_bits() | unshadowed[2][lane].to_bits();
        }
        if any == 0 {
            continue;
        }
        let p = lanes(&points.position, at);
        let mut number = [own.first; LANES];
        let places = if own.count == 6 {
            for lane in 0..LANES {
                let to = Vec3::new(p[0][lane], p[1][lane], p[2][lane]) - light.position_world;
                number[lane] += cube_face(to);
            }
            project(|lane| maps.plan.views[number[lane] as usize], &p)
        } else {
            project(|_| view, &p)
        };
        let mut visibility = [1.0f32; LANES];
        if soft {
            let proven = glances(|lane| &maps.squares[number[lane] as usize], &view, &places);
            let mut asked = [false; LANES];
            for lane in 0..LANES {
                asked[lane] = proven[lane] < 0.0;
            }
            visibility = proven;
            if asked.contains(&true) {
                let levels = |lane: usize| &levels[(number[lane] - own.first) as usize];
                let moments = soft_moments(levels, &view, &places, &asked, options);
                let found = bounds(&moments, &places.depth, options);
                for lane in 0..LANES {
                    visibility[lane] = if asked[lane] { found[lane] } else { proven[lane] };
                }
            }
        } else {
            let taps = taps(&places, view.size, &[0; LANES]);
            let mut moments = [[0.0f32; LANES]; 4];
            for lane in (0..LANES).filter(|l| places.inside[*l]) {
                let [a, b, c, d] = taps.read(lane, &maps.maps[number[lane] as usize]);
                (moments[0][lane], moments[1][lane]) = (a, b);
                (moments[2][lane], moments[3][lane]) = (c, d);
            }
            let found = bounds(&moments, &places.depth, options);
            for lane in 0..LANES {
                // Outside of the map there is no shadow.
                visibility[lane] = if places.inside[lane] { found[lane] } else { 1.0 };
            }
        }
        let mut out = lanes(&points.radiance, at);
        for lane in 0..LANES {
            out[0][lane] += unshadowed[0][lane] * visibility[lane];
            out[1][lane] += unshadowed[1][lane] * visibility[lane];
            out[2][lane] += unshadowed[2][lane] * visibility[lane];
        }
        store(&mut points.radiance, at, &out);
    }
}

dispatch! {
    /// Adds the unshadowed light times what the light's filtered maps let through.
    pub(crate) fn add_filtered => add_filtered_body(
        points: &mut PointBatch,
        maps: &ShadowMaps,
        index: u32,
        light: &Light,
        options: &MomentOptions,
    )
}
