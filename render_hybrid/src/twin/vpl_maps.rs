//! Shadow maps of virtual point lights: one small octahedral map each, made by rays, compared texel by texel.
//!
//! A texel holds s = 1/t, where t is the L1 distance at which the ray along the octahedron's point P (|P.x|+|P.y|+|P.z| = 1)
//! met something, 0 where nothing. On a plane s is n·P/h, a linear function of P: the receiver's own plane gives the exact
//! value that each of the four texels around it would hold if nothing stood before it, so that flat receivers need no slope
//! bias. Axes are the world's: a VPL that turns does not turn its map.
//!
//! Sources: Ritschel et al., "Imperfect Shadow Maps for Efficient Computation of Indirect Illumination", SIGGRAPH Asia 2008
//! (small maps suffice for VPLs); Cigolle et al., "A Survey of Efficient Representations for Independent Unit Vectors", JCGT
//! 2014 (the octahedral map); Reeves et al., "Rendering Antialiased Shadows with Depth Maps", SIGGRAPH 1987 (comparing
//! before filtering).

use catoptra_engine::RenderScene;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::sync::{Mutex, PoisonError};

use super::vpl::Vpl;
use crate::{
    accel::{Accel, Hit, Ray},
    settings::GlassShadows,
    still::{MapsBy, meets},
    trace::points::make_room,
};

/// An occluder must be nearer than the receiver by this share of its distance to count fully; half of it to count at all.
/// Higher: fewer false shadows on curved receivers, more light through contacts.
pub const DEPTH_SLACK: f32 = 0.04;

/// The receiver's plane is followed towards the VPL down to this share of the receiver's distance, and never away from it:
/// beyond a concave corner lies another wall, not the plane.
pub const NEAREST_PLANE: f32 = 0.5;

/// Maps of all VPLs of a frame.
#[derive(Debug, Default)]
pub struct VplMaps {
    /// Texels a side: 16, 32 or 64; 0: no maps.
    pub size: u32,
    /// `size`² reciprocal L1 distances in 1/m per VPL, in the order of VPLs; row 0 is v = −1.
    pub texels: Vec<f32>,
    /// Centre of each map, and the normal of its VPL.
    made_for: Vec<(Vec3, Vec3)>,
    made_by: MapsBy,
    spare: Spare,
    scratch: Vec<Mutex<Scratch>>,
}

/// Memory for bringing maps to other places of the list.
#[derive(Debug, Default)]
struct Spare {
    texels: Vec<f32>,
    made_for: Vec<(Vec3, Vec3)>,
    order: Vec<usize>,
}

/// Memory of a thread.
#[derive(Debug, Default)]
struct Scratch {
    rays: Vec<Ray>,
    hits: Vec<Hit>,
    /// Texel of each ray.
    places: Vec<u32>,
}

/// Point on the octahedron |x|+|y|+|z| = 1 of `e` in [-1, 1]².
///
/// Twin: `shaders/shared/vpl_maps.wgsl` (tests/twins_light.rs).
#[inline(always)]
pub fn octahedron_point(e: Vec2) -> Vec3 {
    let (ax, ay) = (e.x.abs(), e.y.abs());
    let z = 1.0 - ax - ay;
    let fold = |a: f32, other: f32| {
        let folded = if a < 0.0 { other - 1.0 } else { 1.0 - other };
        if z < 0.0 { folded } else { a }
    };
    Vec3::new(fold(e.x, ay), fold(e.y, ax), z)
}

/// Inverse of [`octahedron_point`] for `v` / |v|₁ with `inverse_l1` = 1/|v|₁.
///
/// Twin: `shaders/shared/vpl_maps.wgsl` (tests/twins_light.rs).
#[inline(always)]
pub fn octahedron_coordinates(v: Vec3, inverse_l1: f32) -> Vec2 {
    let (x, y) = (v.x * inverse_l1, v.y * inverse_l1);
    let fold = |a: f32, other: f32| {
        let folded = if a < 0.0 { other.abs() - 1.0 } else { 1.0 - other.abs() };
        if v.z < 0.0 { folded } else { a }
    };
    Vec2::new(fold(x, y), fold(y, x))
}

/// Texel coordinate of `e`: texel centres lie on whole numbers, the first and the last on the map's rim, so that the map's
/// folded edges meet without a seam.
#[inline(always)]
pub fn texel_coordinate(e: f32, size: u32) -> f32 {
    let top = (size - 1) as f32;
    let x = (e * 0.5 + 0.5) * top;
    let x = if x > 0.0 { x } else { 0.0 };
    // Below the last texel, so that its right neighbour exists.
    let most = top - 0.001;
    if x < most { x } else { most }
}

/// Map coordinate of whole texel number `i`.
#[inline(always)]
pub fn texel_center(i: f32, size: u32) -> f32 {
    i * (2.0 / (size - 1) as f32) - 1.0
}

/// Fraction of an occluder that one texel shows, in [0, 1].
/// * `stored`: the texel; `expected`: what the receiver's own plane would put there; `own`: the receiver's 1/t
///
/// Twin: `shaders/shared/vpl_maps.wgsl` (tests/twins_light.rs).
#[inline(always)]
pub fn texel_occlusion(stored: f32, expected: f32, own: f32, inverse_own: f32) -> f32 {
    let least = own;
    let most = own * (1.0 / NEAREST_PLANE);
    let expected = if expected > least { expected } else { least };
    let expected = if expected < most { expected } else { most };
    // 0 up to half the slack nearer than the plane, 1 from the whole slack on.
    let x = (stored - expected) * inverse_own * (2.0 / DEPTH_SLACK) - 1.0;
    let x = if x > 0.0 { x } else { 0.0 };
    if x < 1.0 { x } else { 1.0 }
}

/// Visibility in [0, 1] of the VPL whose map is `map` from a point.
/// * `from_vpl`: from the map's centre to the point, world space
/// * `n`: the point's unit normal
///
/// Bilinear over the four texels around the direction, each compared with where the receiver's plane lies along it. The
/// wide kernel in `trace/points.rs` computes the same, operation by operation.
/// Twin: `shaders/shared/vpl_maps.wgsl` (tests/twins_light.rs).
pub fn vpl_visibility(map: &[f32], size: u32, from_vpl: Vec3, n: Vec3) -> f32 {
    let l1 = l1_length(from_vpl);
    let own = 1.0 / l1;
    let e = octahedron_coordinates(from_vpl, own);
    let (x, y) = (texel_coordinate(e.x, size), texel_coordinate(e.y, size));
    let (x0, y0) = (x as u32, y as u32);
    let (fx, fy) = (x - x0 as f32, y - y0 as f32);
    let inverse_height = inverse_plane_height(n, from_vpl);
    let tap = |dx: u32, dy: u32| {
        let c = Vec2::new(texel_center((x0 + dx) as f32, size), texel_center((y0 + dy) as f32, size));
        let p = octahedron_point(c);
        let expected = (n.x * p.x + n.y * p.y + n.z * p.z) * inverse_height;
        texel_occlusion(map[((y0 + dy) * size + x0 + dx) as usize], expected, own, l1)
    };
    let a = tap(0, 0) + (tap(1, 0) - tap(0, 0)) * fx;
    let b = tap(0, 1) + (tap(1, 1) - tap(0, 1)) * fx;
    1.0 - (a + (b - a) * fy)
}

/// |v|₁, at least a little.
#[inline(always)]
pub fn l1_length(v: Vec3) -> f32 {
    let l1 = v.x.abs() + v.y.abs() + v.z.abs();
    if l1 > 1e-30 { l1 } else { 1e-30 }
}

/// 1/(n·v) for the height of the map's centre over the receiver's plane; huge where it lies in the plane.
#[inline(always)]
pub fn inverse_plane_height(n: Vec3, from_vpl: Vec3) -> f32 {
    let height = n.x * from_vpl.x + n.y * from_vpl.y + n.z * from_vpl.z;
    // The VPL is in front of the receiver, so the height is negative.
    let height = if height < -1e-30 { height } else { -1e-30 };
    1.0 / height
}

/// Centre of a VPL's map: clear of its own surface.
#[inline(always)]
pub fn map_center(vpl: &Vpl) -> Vec3 {
    vpl.position_world + vpl.normal_world * vpl.error
}

impl VplMaps {
    /// Maps with given texels.
    #[cfg(test)]
    pub(crate) fn of_texels(size: u32, texels: Vec<f32>) -> Self {
        Self { size, texels, ..Self::default() }
    }

    /// Forgets all maps, keeps the memory.
    pub fn clear(&mut self) {
        self.size = 0;
        self.texels.clear();
        self.made_for.clear();
        self.made_by.forget();
    }

    /// Brings the maps of VPLs that stand where one stood before, wherever in the list, to their places.
    fn find_again(&mut self, vpls: &[Vpl], area: usize) {
        let key = |vpl: &Vpl| (map_center(vpl), vpl.normal_world);
        if vpls.iter().zip(&self.made_for).all(|(vpl, made_for)| key(vpl) == *made_for) {
            return;
        }
        let bits = |(c, n): (Vec3, Vec3)| [c.x, c.y, c.z, n.x, n.y, n.z].map(f32::to_bits);
        let Self { texels, made_for, spare, .. } = self;
        spare.order.clear();
        spare.order.extend(0..made_for.len());
        spare.order.sort_unstable_by_key(|&i| (bits(made_for[i]), i));
        spare.texels.resize(vpls.len() * area, 0.0);
        spare.made_for.clear();
        for (vpl, map) in vpls.iter().zip(spare.texels.chunks_mut(area)) {
            let key = key(vpl);
            let at = spare.order.partition_point(|&i| bits(made_for[i]) < bits(key));
            let found = spare.order.get(at).copied().filter(|&i| made_for[i] == key);
            if let Some(i) = found {
                map.copy_from_slice(&texels[i * area..(i + 1) * area]);
            }
            // No VPL has this normal.
            spare.made_for.push(found.map_or((Vec3::ZERO, Vec3::ZERO), |i| made_for[i]));
        }
        std::mem::swap(texels, &mut spare.texels);
        std::mem::swap(made_for, &mut spare.made_for);
    }

    /// Makes the maps of `vpls` by rays; returns their number. `size` 0: none. Where a VPL is where one was, only those texels
    /// are made whose rays may meet what has moved since; the others would be the same.
    pub fn render(
        &mut self,
        vpls: &[Vpl],
        size: u32,
        scene: &RenderScene,
        accel: &Accel,
        glass_shadows: GlassShadows,
    ) -> u64 {
        if size == 0 {
            self.clear();
            return 0;
        }
        let comparable = self.made_by.update(scene, accel, size, glass_shadows);
        self.size = size;
        let area = (size * size) as usize;
        if comparable {
            self.find_again(vpls, area);
        }
        let known = if comparable { self.made_for.len().min(vpls.len()) } else { 0 };
        let changed = self.made_by.changed.as_slice();
        self.made_for.resize(vpls.len(), (Vec3::ZERO, Vec3::ZERO));
        self.texels.resize(vpls.len() * area, 0.0);
        self.scratch.resize_with(rayon::current_num_threads(), Mutex::default);
        let scratch = &self.scratch;
        // Which thread makes which map is chance, memory for it must not be.
        for s in scratch {
            let mut s = s.lock().unwrap_or_else(PoisonError::into_inner);
            make_room(&mut s.rays, area);
            make_room(&mut s.hits, area);
            make_room(&mut s.places, area);
        }
        let casts = |hit: &Hit| {
            let m = &scene.materials[scene.instances[hit.instance_id as usize].material as usize];
            glass_shadows == GlassShadows::Opaque || m.transmission <= 0.0
        };
        self.texels
            .par_chunks_mut(area)
            .zip(&mut self.made_for)
            .zip(vpls)
            .enumerate()
            .with_min_len(4)
            .map(|(i, ((map, made_for), vpl))| {
                let own = rayon::current_thread_index().unwrap_or(0) % scratch.len();
                let mut own = scratch[own].lock().unwrap_or_else(PoisonError::into_inner);
                let Scratch { rays, hits, places } = &mut *own;
                rays.clear();
                places.clear();
                let origin = map_center(vpl);
                let kept = i < known && *made_for == (origin, vpl.normal_world);
                *made_for = (origin, vpl.normal_world);
                if !kept {
                    map.fill(0.0);
                }
                for by in (0..size).step_by(4) {
                    for bx in (0..size).step_by(4) {
                        for y in by..by + 4 {
                            for x in bx..bx + 4 {
                                let c = Vec2::new(texel_center(x as f32, size), texel_center(y as f32, size));
                                let direction = octahedron_point(c);
                                // Below the VPL's horizon it gives no light.
                                if vpl.normal_world.dot(direction) > 0.0
                                    && (!kept || changed.iter().any(|b| meets(b, origin, direction)))
                                {
                                    rays.push(Ray::new(origin, direction));
                                    places.push(y * size + x);
                                }
                            }
                        }
                    }
                }
                hits.clear();
                hits.resize(rays.len(), Hit::MISS);
                accel.closest_hits(rays, hits);
                let mut count = rays.len() as u64;
                for ((ray, hit), place) in rays.iter().zip(hits.iter_mut()).zip(places.iter()) {
                    while hit.is_hit() && !casts(hit) {
                        *hit = accel.closest_hit(&Ray { t_min: hit.t, ..*ray });
                        count += 1;
                    }
                    map[*place as usize] = if hit.is_hit() { 1.0 / hit.t.max(1e-30) } else { 0.0 };
                }
                count
            })
            .sum()
    }

    /// Map of VPL `i`.
    pub fn map(&self, i: usize) -> &[f32] {
        let area = (self.size * self.size) as usize;
        &self.texels[i * area..(i + 1) * area]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn directions() -> impl Iterator<Item = Vec3> {
        (0..997u32).map(|i| {
            let y = 1.0 - 2.0 * (i as f32 + 0.5) / 997.0;
            let (s, c) = catoptra_engine::math::sin_cos(i as f32 * 2.399_963);
            let r = (1.0 - y * y).sqrt();
            Vec3::new(r * c, y, r * s)
        })
    }

    #[test]
    fn the_octahedron_is_a_round_trip() {
        for d in directions() {
            let l1 = d.x.abs() + d.y.abs() + d.z.abs();
            let e = octahedron_coordinates(d, 1.0 / l1);
            assert!(e.x.abs() <= 1.0 && e.y.abs() <= 1.0);
            assert!((octahedron_point(e) - d / l1).length() < 1e-6, "{d}");
        }
    }

    #[test]
    fn a_plane_never_shadows_itself_and_a_nearer_one_always_does() {
        // A map that sees only the plane y = -1 (or y = -0.7) from the origin.
        for (height, size, horizon, expected) in [(1.0, 16, -0.25, 1.0), (0.7, 64, -0.5, 0.0)] {
            let map: Vec<f32> = (0..size * size)
                .map(|i| {
                    let c = Vec2::new(texel_center((i % size) as f32, size), texel_center((i / size) as f32, size));
                    (-octahedron_point(c).y / height).max(0.0)
                })
                .collect();
            for d in directions().filter(|d| d.y < horizon) {
                let v = vpl_visibility(&map, size, d / -d.y, Vec3::Y);
                assert!((v - expected).abs() < 1e-4, "towards {d}: {v} for {expected}");
            }
        }
    }
}
