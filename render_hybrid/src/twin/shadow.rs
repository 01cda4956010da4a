//! Shadow views and variance shadow maps.
//!
//! Every map is one [`ShadowView`]: a spot light has one, a directional light one, a point light (and a spot wider than
//! [`WIDEST_SPOT_DEGREES`]) six. Depth is linear along the view's axis, 0 at the light, 1 at the scene's far side.

use catoptra_engine::{Aabb, Light, LightKind, math};
use glam::{Vec2, Vec3, Vec4, Vec4Swizzles};

use super::{
    certified::DepthPyramid,
    glance::{self, Square, nearness_of, squares_across},
    penumbra::{self, level_count, level_of, level_size, occluder_depth, penumbra_sigma},
};
use crate::settings::{MomentOptions, ShadowFilter, SimdLevel};

/// Texels a map keeps beyond the light's own frustum, so that the blur and bilinear filtering at its rim read true
/// depths: 1 of the blur, 1 of the filter, and some for coarser levels.
pub const GUARD_TEXELS: u32 = 4;

/// Spots with a wider outer angle get six faces like a point light: a single plane would waste its texels.
pub const WIDEST_SPOT_DEGREES: f32 = 70.0;

/// Weights of the blur, centre last: [±1, 0]. No wider than what hides the texels; penumbrae are the pyramid's.
///
/// Twin: generated into `shaders/moments_blur.wgsl`.
pub const BINOMIAL_3: [f32; 2] = [0.25, 0.5];

/// A plane of texels that a light looks through.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct ShadowView {
    /// Centre of projection, or the middle of the near plane (parallel light).
    pub origin_world: Vec3,
    /// Depth of 1 in metres along `forward`.
    pub far: f32,
    /// Unit axis of the map's +x divided by its half extent (at distance 1, or in metres).
    pub right_scaled: Vec3,
    /// 1: perspective, 0: parallel.
    pub perspective: f32,
    /// Unit axis of the map's +y (upwards) divided by its half extent.
    pub up_scaled: Vec3,
    /// Texels a side.
    pub size: u32,
    /// Unit viewing direction.
    pub forward: Vec3,
    /// σ of a penumbra in texels, over what [`super::penumbra::penumbra_sigma`] says; 0: the light is a point.
    pub softness: f32,
}

/// A point as a light sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShadowCoord {
    /// Map position, (0, 0) = top left, (1, 1) = bottom right.
    pub uv: Vec2,
    /// Normalised linear depth.
    pub depth: f32,
    /// False where the point is behind the light.
    pub in_front: bool,
}

/// Where a world point falls on the map, and how deep.
///
/// Twin: `shaders/shared/shadow.wgsl` (tests/twins.rs).
#[inline]
pub fn shadow_project(view: &ShadowView, point_world: Vec3) -> ShadowCoord {
    let v = point_world - view.origin_world;
    let z = view.forward.dot(v);
    let w = if view.perspective > 0.5 { z } else { 1.0 };
    let in_front = w > 0.0;
    let w = if in_front { w } else { 1.0 };
    let x = view.right_scaled.dot(v) / w;
    let y = view.up_scaled.dot(v) / w;
    ShadowCoord { uv: Vec2::new(0.5 + 0.5 * x, 0.5 - 0.5 * y), depth: z / view.far, in_front }
}

/// Upper bound on the fraction of light that reaches depth `t`, from two filtered moments.
///
/// p = σ²/(σ²+(t−μ)²), the one-sided Chebyshev inequality, then light-bleed reduction (the part below it is cut, the rest
/// stretched to [0, 1]).
/// * `moments`: (E(z), E(z²)), z linear light-space depth in [0, 1]
/// * `min_variance`: floor on σ², > 0. Higher: less acne, softer contacts
/// * `light_bleed_reduction`: in [0, 1). Higher: less bleeding, thinner penumbrae
///
/// Returns visibility in [0, 1], exactly 1 where `t <= moments.x`. Finite in, finite out.
/// Twin: `shaders/shared/shadow.wgsl` (tests/twins.rs).
/// Source: Donnelly & Lauritzen, "Variance Shadow Maps", I3D 2006.
#[inline(always)]
pub fn chebyshev_upper_bound(moments: Vec2, t: f32, min_variance: f32, light_bleed_reduction: f32) -> f32 {
    // Comparisons rather than f32::max: they are single instructions in the wide kernels.
    let variance = moments.y - moments.x * moments.x;
    let variance = if variance > min_variance { variance } else { min_variance };
    let d = t - moments.x;
    let p = variance / (variance + d * d);
    let p = (p - light_bleed_reduction) / (1.0 - light_bleed_reduction);
    let p = if p > 0.0 { p } else { 0.0 };
    let p = if t <= moments.x { 1.0 } else { p };
    if p < 1.0 { p } else { 1.0 }
}

/// Exponents of the positive and the negative warp. Higher: less bleeding, more noise; e^(2·40) is within f32's range with
/// room for filtering, and beyond 5 the negative warp gains nothing against bleeding.
pub const EVSM_EXPONENTS: [f32; 2] = [40.0, 5.0];

/// The two warps (e^{c₊ζ}, −e^{−c₋ζ}) with ζ = 2z − 1, of a depth clamped to [0, 1] first; NaN counts as 1.
///
/// Twin: `shaders/shared/shadow.wgsl` (tests/twins_light.rs).
/// Source: Lauritzen & McCool, "Layered Variance Shadow Maps", GI 2008.
#[inline(always)]
pub fn evsm_warp(z: f32) -> Vec2 {
    let z = clamp_depth(z) * 2.0 - 1.0;
    Vec2::new(math::exp_moderate(EVSM_EXPONENTS[0] * z), -math::exp_moderate(-EVSM_EXPONENTS[1] * z))
}

/// Depth in [0, 1]; NaN becomes 1, as far as nothing met.
#[inline(always)]
pub fn clamp_depth(z: f32) -> f32 {
    let most = if z < 1.0 { z } else { 1.0 };
    if most > 0.0 { most } else { 0.0 }
}

/// What a texel holds of depth `z`: (z, z², 0, 0), or both warps with their squares (w₊, w₊², w₋, w₋²).
///
/// Twin: `shaders/shared/shadow.wgsl` (tests/twins_light.rs).
#[inline(always)]
pub fn moments_of(filter: ShadowFilter, z: f32) -> [f32; 4] {
    match filter {
        ShadowFilter::Vsm => {
            let z = clamp_depth(z);
            [z, z * z, 0.0, 0.0]
        }
        ShadowFilter::Evsm4 => {
            let w = evsm_warp(z);
            [w.x, w.x * w.x, w.y, w.y * w.y]
        }
    }
}

/// Fraction of light that reaches depth `t`: the lesser of the two warps' [`chebyshev_upper_bound`]s.
///
/// * `min_variance`: of z; each warp's floor is that times its slope squared
///
/// Twin: `shaders/shared/shadow.wgsl` (tests/twins_light.rs).
#[inline]
pub fn evsm_visibility(moments: Vec4, t: f32, min_variance: f32, light_bleed_reduction: f32) -> f32 {
    let w = evsm_warp(t);
    let [near_floor, far_floor] = evsm_floors(w, min_variance);
    let near = chebyshev_upper_bound(moments.xy(), w.x, near_floor, light_bleed_reduction);
    let far = chebyshev_upper_bound(moments.zw(), w.y, far_floor, light_bleed_reduction);
    if far < near { far } else { near }
}

/// Floors on the variance of both warps where they are `w`.
#[inline(always)]
pub fn evsm_floors(w: Vec2, min_variance: f32) -> [f32; 2] {
    let floor = |c: f32, w: f32| min_variance * (2.0 * c * w) * (2.0 * c * w);
    [floor(EVSM_EXPONENTS[0], w.x), floor(EVSM_EXPONENTS[1], w.y)]
}

/// Which of six faces (+X, -X, +Y, -Y, +Z, -Z) a direction falls on: the axis of greatest magnitude, ties to the earlier.
///
/// Twin: `shaders/shared/shadow.wgsl` (tests/twins.rs).
#[inline(always)]
pub fn cube_face(v: Vec3) -> u32 {
    let a = v.abs();
    if a.x >= a.y && a.x >= a.z {
        u32::from(v.x < 0.0)
    } else if a.y >= a.z {
        2 + u32::from(v.y < 0.0)
    } else {
        4 + u32::from(v.z < 0.0)
    }
}

/// Which maps belong to one light: `count` is 1 or 6.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LightMaps {
    /// First view in the plan.
    pub first: u32,
    /// 1 or 6.
    pub count: u32,
}

/// All shadow views of a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShadowPlan {
    /// Views in the order of lights, faces in the order of [`cube_face`].
    pub views: Vec<ShadowView>,
    /// One entry a light.
    pub lights: Vec<LightMaps>,
}

impl ShadowPlan {
    /// Chooses the views of all lights.
    /// * `bounds_world`: all that can throw or receive shadows
    pub fn new(lights: &[Light], bounds_world: Aabb, options: &MomentOptions) -> Self {
        let mut plan = Self::default();
        plan.update(lights, bounds_world, options);
        plan
    }

    /// [`Self::new`] in the memory of an old plan.
    pub fn update(&mut self, lights: &[Light], bounds_world: Aabb, options: &MomentOptions) {
        let plan = self;
        plan.views.clear();
        plan.lights.clear();
        for light in lights {
            let first = plan.views.len() as u32;
            let wide = |cos_outer: f32| cos_outer < math::cos(WIDEST_SPOT_DEGREES.to_radians());
            match light.kind {
                LightKind::Spot { cos_outer, .. } if !wide(cos_outer) => {
                    plan.views.push(spot_view(light, cos_outer, bounds_world, options.size));
                }
                LightKind::Directional => plan.views.push(directional_view(light, bounds_world, options.size)),
                _ => plan.views.extend(point_views(light, bounds_world, options.face_size)),
            }
            for view in &mut plan.views[first as usize..] {
                view.softness = if options.soft {
                    penumbra::softness(view, light.radius, options.light_bleed_reduction)
                } else {
                    0.0
                };
            }
            plan.lights.push(LightMaps { first, count: plan.views.len() as u32 - first });
        }
    }

    /// The view on which `point_world` is looked up for `light`.
    #[inline]
    pub fn view_of(&self, light: u32, position_world: Vec3, point_world: Vec3) -> u32 {
        let maps = self.lights[light as usize];
        if maps.count == 6 { maps.first + cube_face(point_world - position_world) } else { maps.first }
    }
}

/// Half extent that leaves [`GUARD_TEXELS`] around `inner`.
fn guarded(inner: f32, size: u32) -> f32 {
    inner * size as f32 / (size - 2 * GUARD_TEXELS) as f32
}

/// Greatest distance along `forward` of the scene's corners, at least a little.
fn farthest(origin: Vec3, forward: Vec3, bounds: Aabb) -> f32 {
    if bounds.is_empty() {
        return 1.0;
    }
    let far = bounds.corners().iter().map(|c| forward.dot(*c - origin)).fold(0.0f32, f32::max);
    // A little beyond, so that the farthest surface is nearer than "nothing met". Scale-free.
    (far * 1.01).max(bounds.radius() * 1e-3).max(f32::MIN_POSITIVE)
}

fn spot_view(light: &Light, cos_outer: f32, bounds: Aabb, size: u32) -> ShadowView {
    let forward = light.direction_world;
    let right = forward.cross(light.up_world).normalize_or(math::orthonormal_basis(forward).0);
    let up = right.cross(forward);
    let tan_outer = (1.0 - cos_outer * cos_outer).max(0.0).sqrt() / cos_outer;
    let half = guarded(tan_outer.max(1e-4), size);
    ShadowView {
        origin_world: light.position_world,
        far: farthest(light.position_world, forward, bounds),
        right_scaled: right / half,
        perspective: 1.0,
        up_scaled: up / half,
        size,
        forward,
        softness: 0.0,
    }
}

fn directional_view(light: &Light, bounds: Aabb, size: u32) -> ShadowView {
    let forward = light.direction_world;
    let right = forward.cross(light.up_world).normalize_or(math::orthonormal_basis(forward).0);
    let up = right.cross(forward);
    // Fit the parallel frustum to the scene's corners in the light's own axes.
    let (mut min, mut max) = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
    for c in if bounds.is_empty() { [Vec3::ZERO; 8] } else { bounds.corners() } {
        let p = Vec3::new(right.dot(c), up.dot(c), forward.dot(c));
        (min, max) = (min.min(p), max.max(p));
    }
    let center = (min + max) * 0.5;
    let half = ((max - min) * 0.5).max(Vec3::splat(bounds.radius().max(1e-30) * 1e-3));
    // The near plane lies a little before the nearest corner.
    let margin = half.z * 0.02;
    let near = min.z - margin;
    ShadowView {
        origin_world: right * center.x + up * center.y + forward * near,
        far: (max.z - min.z).max(half.z) + 2.0 * margin,
        right_scaled: right / guarded(half.x, size),
        perspective: 0.0,
        up_scaled: up / guarded(half.y, size),
        size,
        forward,
        softness: 0.0,
    }
}

fn point_views(light: &Light, bounds: Aabb, size: u32) -> [ShadowView; 6] {
    const FACES: [(Vec3, Vec3); 6] = [
        (Vec3::X, Vec3::Y),
        (Vec3::NEG_X, Vec3::Y),
        (Vec3::Y, Vec3::Z),
        (Vec3::NEG_Y, Vec3::Z),
        (Vec3::Z, Vec3::Y),
        (Vec3::NEG_Z, Vec3::Y),
    ];
    FACES.map(|(forward, up)| {
        let half = guarded(1.0, size);
        ShadowView {
            origin_world: light.position_world,
            far: farthest(light.position_world, forward, bounds),
            right_scaled: forward.cross(up) / half,
            perspective: 1.0,
            up_scaled: up / half,
            size,
            forward,
            softness: 0.0,
        }
    })
}

/// Filtered moments of all views.
#[derive(Clone, Debug, Default)]
pub struct ShadowMaps {
    /// The views that the maps were made through.
    pub plan: ShadowPlan,
    /// One map a view: filtered [`moments_of`] per texel, row 0 on top.
    pub maps: Vec<Vec<[f32; 4]>>,
    /// The further levels of each map's pyramid, one after the other; empty where the light is a point.
    pub coarser: Vec<Vec<[f32; 4]>>,
    /// Bounds of each map's squares; empty where the CPU did not make the map.
    pub squares: Vec<Vec<Square>>,
    /// One a view where shadows are certified, in place of `maps`.
    pub pyramids: Vec<DepthPyramid>,
}

impl ShadowMaps {
    /// Makes the further levels of all maps whose light has a disc, where somebody else made the maps.
    pub fn make_levels(&mut self, level: SimdLevel) {
        self.squares.clear();
        self.squares.resize_with(self.maps.len(), Vec::new);
        self.coarser.resize_with(self.maps.len(), Vec::new);
        for ((view, map), coarser) in self.plan.views.iter().zip(&self.maps).zip(&mut self.coarser) {
            if view.softness > 0.0 && !map.is_empty() {
                penumbra::make_levels(level, map, view.size, coarser);
            } else {
                coarser.clear();
            }
        }
    }

    /// A level of a view's pyramid.
    fn level(&self, view: u32, level: u32) -> &[[f32; 4]] {
        let size = self.plan.views[view as usize].size;
        let area = |l: u32| (level_size(size, l) as usize).pow(2);
        match level {
            0 => &self.maps[view as usize],
            _ => &self.coarser[view as usize][(1..level).map(area).sum()..][..area(level)],
        }
    }

    /// Bilinearly filtered moments of a level of the pyramid at `uv`, clamped at the rim.
    ///
    /// Twin: `shaders/shared/shadow.wgsl` (filtered by hand there too: RG32F filtering is optional in wgpu).
    #[inline]
    pub fn sample(&self, view: u32, uv: Vec2, level: u32) -> Vec4 {
        let full = self.plan.views[view as usize].size;
        let (size, map) = (level_size(full, level), self.level(view, level));
        let top = size as f32 - 1.0;
        // Texel i of a level covers 2^l texels from 2^l · i on.
        let share = 1.0 / (1u32 << level) as f32;
        let p = (uv * full as f32 * share - 0.5).clamp(Vec2::ZERO, Vec2::splat(top));
        let (x0, y0) = (p.x as u32, p.y as u32);
        let (x1, y1) = ((x0 + 1).min(size - 1), (y0 + 1).min(size - 1));
        let (fx, fy) = (p.x - x0 as f32, p.y - y0 as f32);
        let at = |x: u32, y: u32| Vec4::from(map[(y * size + x) as usize]);
        let a = at(x0, y0) + (at(x1, y0) - at(x0, y0)) * fx;
        let b = at(x0, y1) + (at(x1, y1) - at(x0, y1)) * fx;
        a + (b - a) * fy
    }

    /// [`glance()`] at a receiver; less than 0 where nothing is proven.
    fn glance(&self, number: u32, point_world: Vec3, c: &ShadowCoord) -> f32 {
        let (view, squares) = (&self.plan.views[number as usize], self.squares[number as usize].as_slice());
        if squares.is_empty() {
            return -1.0;
        }
        let perspective = view.perspective > 0.5;
        let v = point_world - view.origin_world;
        let along = view.forward.dot(v);
        let slant = if perspective { v.length() / along } else { 1.0 };
        if penumbra_sigma(view.softness, perspective, slant, 0.5 * c.depth, c.depth) > glance::WIDEST_SIGMA {
            return -1.0;
        }
        let (nearness, slack) = nearness_of(perspective, along, view.far);
        let at = c.uv * view.size as f32;
        glance::glance(squares, squares_across(view.size as usize), at.x, at.y, nearness, slack)
    }

    /// Moments at a receiver, filtered as widely as the light's disc spreads what shadows it.
    ///
    /// Twin: `shaders/shared/shadow.wgsl`.
    #[inline]
    fn soft_moments(&self, number: u32, point_world: Vec3, c: &ShadowCoord, options: &MomentOptions) -> Vec4 {
        let view = &self.plan.views[number as usize];
        if !(view.softness > 0.0) {
            return self.sample(number, c.uv, 0);
        }
        let levels = level_count(view.size);
        let perspective = view.perspective > 0.5;
        let v = point_world - view.origin_world;
        let slant = if perspective { v.length() / (c.depth * view.far) } else { 1.0 };
        let sigma = |occluder: f32| penumbra_sigma(view.softness, perspective, slant, occluder, c.depth);
        let (level, fraction) = level_of(sigma(0.5 * c.depth), levels);
        let search = self.sample(number, c.uv, if fraction >= 0.5 { level + 1 } else { level });
        let occluder = occluder_depth(options.filter, search, c.depth, options.min_variance);
        let (level, fraction) = level_of(sigma(occluder), levels);
        let fine = self.sample(number, c.uv, level);
        if fraction > 0.0 { fine + (self.sample(number, c.uv, level + 1) - fine) * fraction } else { fine }
    }

    /// Visibility of a light from a point, in [0, 1]; 1 outside the map.
    ///
    /// Twin: `shaders/shared/shadow.wgsl`.
    #[inline]
    pub fn visibility(&self, light: u32, position_world: Vec3, point_world: Vec3, options: &MomentOptions) -> f32 {
        let view = self.plan.view_of(light, position_world, point_world);
        let c = shadow_project(&self.plan.views[view as usize], point_world);
        let inside = c.in_front && c.uv.cmpge(Vec2::ZERO).all() && c.uv.cmple(Vec2::ONE).all();
        if !inside {
            return 1.0;
        }
        let proven = self.glance(view, point_world, &c);
        if proven >= 0.0 {
            return proven;
        }
        let moments = self.soft_moments(view, point_world, &c, options);
        let (floor, reduction) = (options.min_variance, options.light_bleed_reduction);
        match options.filter {
            ShadowFilter::Vsm => chebyshev_upper_bound(moments.xy(), c.depth, floor, reduction),
            ShadowFilter::Evsm4 => evsm_visibility(moments, c.depth, floor, reduction),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chebyshev_is_exact_for_two_depths() {
        // ../shared/analytic vsm_chebyshev_two_depths, in units of a far distance of 10.
        let (t, d) = (0.5f32, 0.3f32);
        for q in [0.1f32, 0.25, 0.5, 0.9] {
            let m = Vec2::new(q * t + (1.0 - q) * d, q * t * t + (1.0 - q) * d * d);
            assert!((chebyshev_upper_bound(m, t, 1e-12, 0.0) - q).abs() < 1e-5);
        }
        assert_eq!(chebyshev_upper_bound(Vec2::new(0.5, 0.25), 0.5, 1e-7, 0.2), 1.0);
    }

    #[test]
    fn warps_are_finite_and_two_occluders_do_not_bleed() {
        for z in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -3.0, 0.0, 0.5, 1.0, 9.0] {
            assert!(moments_of(ShadowFilter::Evsm4, z).iter().all(|m| m.is_finite()), "{z}");
            assert!(moments_of(ShadowFilter::Vsm, z).iter().all(|m| (0.0..=1.0).contains(m)), "{z}");
        }
        // Half of the filter sees an occluder at 0.3, half one at 0.6; the receiver at 0.8 is in the dark.
        let mean = |f| {
            let (a, b) = (Vec4::from(moments_of(f, 0.3)), Vec4::from(moments_of(f, 0.6)));
            (a + b) * 0.5
        };
        let vsm = chebyshev_upper_bound(mean(ShadowFilter::Vsm).xy(), 0.8, 2e-7, 0.0);
        let evsm = evsm_visibility(mean(ShadowFilter::Evsm4), 0.8, 2e-7, 0.0);
        assert!(vsm > 0.15, "the classic bleed: {vsm}");
        assert!(evsm < 0.002, "{evsm}");
        // Fully lit at its own depth.
        assert_eq!(evsm_visibility(Vec4::from(moments_of(ShadowFilter::Evsm4, 0.4)), 0.4, 2e-7, 0.2), 1.0);
    }

    #[test]
    fn cube_faces_cover_every_direction() {
        let light = Light {
            stable_id: 0,
            kind: LightKind::Point,
            position_world: Vec3::new(0.1, 0.2, 0.3),
            direction_world: Vec3::NEG_Z,
            up_world: Vec3::Y,
            intensity: Vec3::ONE,
            radius: 0.0,
        };
        let bounds = Aabb { min: Vec3::splat(-2.0), max: Vec3::splat(2.0) };
        let plan = ShadowPlan::new(&[light], bounds, &MomentOptions::default());
        assert_eq!(plan.views.len(), 6);
        for i in 0..1000u32 {
            let a = i as f32 * 2.399_963;
            let y = 1.0 - 2.0 * (i as f32 + 0.5) / 1000.0;
            let r = (1.0 - y * y).sqrt();
            let p = light.position_world + Vec3::new(r * math::cos(a), y, r * math::sin(a));
            let c = shadow_project(&plan.views[plan.view_of(0, light.position_world, p) as usize], p);
            assert!(c.in_front && c.uv.min_element() > 0.0 && c.uv.max_element() < 1.0 && c.depth > 0.0);
        }
    }

    #[test]
    fn views_keep_depth_in_range_and_right_handed_pictures() {
        let bounds = Aabb { min: Vec3::splat(-2.0), max: Vec3::splat(2.0) };
        let light = |kind| Light {
            stable_id: 0,
            kind,
            position_world: Vec3::new(0.0, 1.9, 0.0),
            direction_world: Vec3::NEG_Y,
            up_world: Vec3::Z,
            intensity: Vec3::ONE,
            radius: 0.0,
        };
        for kind in [LightKind::Directional, LightKind::Spot { cos_inner: 0.9, cos_outer: 0.8 }] {
            let plan = ShadowPlan::new(&[light(kind)], bounds, &MomentOptions::default());
            let v = &plan.views[0];
            let c = shadow_project(v, Vec3::new(0.3, -2.0, 0.4));
            assert!(c.depth > 0.5 && c.depth < 1.0, "{kind:?}: {c:?}");
            assert!(v.right_scaled.cross(v.up_scaled).dot(v.forward) < 0.0, "right x up = backwards");
        }
    }
}
