//! Direct light of a batch of points: Lambert under each light, sixteen points at a time, times visibility.
//!
//! Highlights and traced visibility, which few points need, are computed one by one.

use catoptra_engine::{Light, LightKind};
use glam::{Vec2, Vec3, Vec4};

use super::{
    points::{LANES, Lane, PointBatch, lanes, store},
    shade::{FrameContext, light_visibility},
};
use crate::{
    accel::Ray,
    output::RayCounts,
    settings::{MomentOptions, ShadowFilter, Shadows},
    simd::dispatch,
    twin::{
        glance::{Square, WIDEST_SIGMA, glance, nearness_of, squares_across},
        penumbra::{MOST_LEVELS, level_count, level_of, level_size, occluder_depth, penumbra_sigma},
        shading::blinn_phong_lobe,
        shadow::{ShadowMaps, ShadowView, chebyshev_upper_bound, cube_face, evsm_floors, evsm_warp},
    },
};

/// Adds the light of all lights to the radiance of every point of the batch, which must be padded, and have ray starts where
/// shadows are traced or certified.
/// * `pixel`: number of the picture's pixel that a point belongs to; turns the pattern on a light's disc
pub fn direct_light(ctx: &FrameContext, points: &mut PointBatch, pixel: impl Fn(usize) -> u32, rays: &mut RayCounts) {
    for (index, light) in ctx.scene.lights.iter().enumerate() {
        let index = index as u32;
        unshadowed(ctx.level, points, light);
        highlights(points, light);
        match ctx.settings.shadows {
            Shadows::Off => add(ctx.level, points),
            Shadows::Moments => add_filtered(ctx.level, points, ctx.maps, index, light, &ctx.settings.moments),
            // One ray a light: all points' rays go together.
            Shadows::Traced if light.radius <= 0.0 || ctx.settings.shadow_samples == 1 => {
                add_by_rays(ctx, points, index, rays);
            }
            Shadows::Traced | Shadows::Certified => {
                for i in 0..points.len() {
                    let unshadowed = unshadowed_at(points, i);
                    if unshadowed != Vec3::ZERO {
                        let seen = unshadowed * light_visibility(ctx, index, &points.ray_start(i), pixel(i), rays);
                        add_at(points, i, seen);
                    }
                }
            }
        }
    }
}

fn unshadowed_at(points: &PointBatch, i: usize) -> Vec3 {
    Vec3::from_array([0, 1, 2].map(|axis| points.unshadowed[axis][i]))
}

fn add_at(points: &mut PointBatch, i: usize, radiance: Vec3) {
    for axis in 0..3 {
        points.radiance[axis][i] += radiance[axis];
    }
}

/// Adds the unshadowed light of the points that a ray to the middle of the light's disc does not find occluded.
fn add_by_rays(ctx: &FrameContext, points: &mut PointBatch, index: u32, counts: &mut RayCounts) {
    let mut shadows = std::mem::take(&mut points.shadows);
    shadows.clear();
    let light = &ctx.scene.lights[index as usize];
    let t_max = if matches!(light.kind, LightKind::Directional) { f32::INFINITY } else { 1.0 };
    let mut lanes = ShadowLanes::default();
    for at in (0..points.len()).step_by(LANES) {
        shadow_lanes(ctx.level, points, at, light, &mut lanes);
        for lane in 0..LANES.min(points.len() - at) {
            if lanes.casts[lane] != 0 {
                let vec = |v: &[Lane; 3]| Vec3::new(v[0][lane], v[1][lane], v[2][lane]);
                let (origin, direction) = (vec(&lanes.origin), vec(&lanes.direction));
                shadows.rays.push(Ray { origin, direction, t_min: 0.0, t_max });
                shadows.of.push((at + lane) as u32);
            }
        }
    }
    counts.shadow += shadows.rays.len() as u64;
    shadows.occluded.resize(shadows.rays.len(), false);
    ctx.accel.occluded_many(&shadows.rays, &mut shadows.occluded);
    for (&i, occluded) in shadows.of.iter().zip(&shadows.occluded) {
        if !occluded {
            let seen = unshadowed_at(points, i as usize);
            add_at(points, i as usize, seen);
        }
    }
    points.shadows = shadows;
}

/// Sixteen rays towards a light.
#[derive(Default)]
struct ShadowLanes {
    origin: [Lane; 3],
    direction: [Lane; 3],
    /// Not 0: the point would be lit, so that its ray is worth casting.
    casts: [u32; LANES],
}

/// [`super::shade::shadow_ray`] to the middle of the light's disc, of the points from `at` on.
#[inline(always)]
fn shadow_lanes_body(points: &PointBatch, at: usize, light: &Light, out: &mut ShadowLanes) {
    let parallel = matches!(light.kind, LightKind::Directional);
    let (target, towards) = (light.position_world, -light.direction_world);
    let unshadowed = lanes(&points.unshadowed, at);
    let (p, n) = (lanes(&points.position, at), lanes(&points.n_geometric, at));
    let error = super::points::lane(&points.error, at);
    for lane in 0..LANES {
        let lit = (unshadowed[0][lane] != 0.0) | (unshadowed[1][lane] != 0.0) | (unshadowed[2][lane] != 0.0);
        let to = |axis: usize, from: f32| if parallel { towards[axis] } else { target[axis] - from };
        let to_target = [0, 1, 2].map(|axis| to(axis, p[axis][lane]));
        let above = (n[0][lane] * to_target[0] + n[1][lane] * to_target[1]) + n[2][lane] * to_target[2];
        out.casts[lane] = u32::from(lit & (above > 0.0));
        for axis in 0..3 {
            let origin = p[axis][lane] + n[axis][lane] * error[lane];
            out.origin[axis][lane] = origin;
            out.direction[axis][lane] = to(axis, origin);
        }
    }
}

dispatch! {
    fn shadow_lanes => shadow_lanes_body(points: &PointBatch, at: usize, light: &Light, out: &mut ShadowLanes)
}

/// Adds Blinn-Phong lobes to the unshadowed light of the points that have one.
fn highlights(points: &mut PointBatch, light: &Light) {
    for k in 0..points.glossy.len() {
        let glossy = points.glossy[k];
        let i = glossy.point as usize;
        let n = points.normal(i);
        let (wi, _, incident) = light.incident(points.position_world(i));
        let n_dot_l = n.dot(wi);
        if n_dot_l > 0.0 {
            let lobe = glossy.specular * blinn_phong_lobe(n, wi, glossy.wo, glossy.shininess) * incident * n_dot_l;
            for axis in 0..3 {
                points.unshadowed[axis][i] += lobe[axis];
            }
        }
    }
}

#[inline(always)]
fn unshadowed_body(points: &mut PointBatch, light: &Light) {
    let (position, towards, intensity) = (light.position_world, light.direction_world, light.intensity);
    let (parallel, spot, cos_outer, per_range) = match light.kind {
        LightKind::Directional => (true, false, 0.0, 1.0),
        LightKind::Point => (false, false, 0.0, 1.0),
        LightKind::Spot { cos_inner, cos_outer } => (false, true, cos_outer, 1.0 / (cos_inner - cos_outer).max(0.001)),
    };
    for at in (0..points.len()).step_by(LANES) {
        let (p, n) = (lanes(&points.position, at), lanes(&points.normal, at));
        let base = lanes(&points.base_color, at);
        let matte = super::points::lane(&points.matte, at);
        let mut out = [[0.0f32; LANES]; 3];
        for lane in 0..LANES {
            let (x, y, z) = (position.x - p[0][lane], position.y - p[1][lane], position.z - p[2][lane]);
            let d2 = (x * x + y * y) + z * z;
            let inverse = 1.0 / d2.sqrt();
            let (wx, wy, wz) = (x * inverse, y * inverse, z * inverse);
            let cos = -((wx * towards.x + wy * towards.y) + wz * towards.z);
            let x = (cos - cos_outer) * per_range;
            let x = if x > 0.0 { x } else { 0.0 };
            let x = if x < 1.0 { x } else { 1.0 };
            let falloff = if spot { x * x } else { 1.0 };
            let falloff = falloff * (inverse * inverse);
            // At the light's own place there is no light.
            let falloff = if d2 > 0.0 { falloff } else { 0.0 };
            let (wx, wy, wz) = if parallel { (-towards.x, -towards.y, -towards.z) } else { (wx, wy, wz) };
            let falloff = if parallel { 1.0 } else { falloff };
            let n_dot_l = (n[0][lane] * wx + n[1][lane] * wy) + n[2][lane] * wz;
            let received = if n_dot_l > 0.0 { n_dot_l * falloff } else { 0.0 };
            let reflected = received * matte[lane];
            out[0][lane] = base[0][lane] * (intensity.x * reflected);
            out[1][lane] = base[1][lane] * (intensity.y * reflected);
            out[2][lane] = base[2][lane] * (intensity.z * reflected);
        }
        store(&mut points.unshadowed, at, &out);
    }
}

dispatch! {
    /// Sets the radiance that one light would cause by the matte share: base · matte · N·L · incident.
    fn unshadowed => unshadowed_body(points: &mut PointBatch, light: &Light)
}

#[inline(always)]
fn add_body(points: &mut PointBatch) {
    for axis in 0..3 {
        for (r, u) in points.radiance[axis].iter_mut().zip(&points.unshadowed[axis]) {
            *r += u;
        }
    }
}

dispatch! { fn add => add_body(points: &mut PointBatch) }

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
    fn add_filtered => add_filtered_body(
        points: &mut PointBatch,
        maps: &ShadowMaps,
        index: u32,
        light: &Light,
        options: &MomentOptions,
    )
}
