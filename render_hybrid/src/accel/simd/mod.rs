//! The kernels: every level's code behind safe functions. This module alone holds unsafe code; the rest of `accel` is safe.
#![allow(unsafe_code)]

mod count;
mod kd;
mod lanes;
mod many;
mod packet;
mod single;
mod stream;
#[cfg(target_arch = "x86_64")]
mod x86;

use super::world::World;
use super::{Hit, Ray};
use crate::{RenderError, SimdLevel};
use lanes::{Counted, Half, Portable};

/// A level that this processor has: only [`Detected::new`] makes one, so kernels may rely on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Detected(Option<SimdLevel>);

impl Detected {
    /// Looks for the level; `Auto` takes the best there is.
    pub fn new(wanted: SimdLevel) -> Result<Self, RenderError> {
        let (avx2, avx512) = supported();
        let missing = |choice: &str, missing: &str| {
            Err(RenderError::Unavailable { choice: format!("--simd {choice}"), missing: missing.into() })
        };
        match wanted {
            SimdLevel::Auto if avx512 => Ok(Self(Some(SimdLevel::Avx512))),
            SimdLevel::Auto if avx2 => Ok(Self(Some(SimdLevel::Avx2))),
            SimdLevel::Auto | SimdLevel::Portable => Ok(Self(Some(SimdLevel::Portable))),
            SimdLevel::Avx2 if !avx2 => missing("avx2", "this processor lacks AVX2 or FMA"),
            SimdLevel::Avx512 if !avx512 => missing("avx512", "this processor lacks AVX-512 F, VL or DQ"),
            level => Ok(Self(Some(level))),
        }
    }
    /// Portable code that tallies.
    pub fn counting() -> Self {
        Self(None)
    }
    pub fn level(self) -> SimdLevel {
        self.0.unwrap_or(SimdLevel::Portable)
    }
    /// After rays: what they have tested goes to the world's sum.
    #[inline(always)]
    fn tally(self, world: &World) {
        if self.0.is_none() {
            let mut sum = world.counts.lock().expect("no panic while adding");
            *sum = *sum + count::take();
        }
    }
}

#[cfg(target_arch = "x86_64")]
fn supported() -> (bool, bool) {
    let avx2 = is_x86_feature_detected!("avx2")
        && is_x86_feature_detected!("fma")
        && is_x86_feature_detected!("bmi1")
        && is_x86_feature_detected!("bmi2")
        && is_x86_feature_detected!("lzcnt")
        && is_x86_feature_detected!("popcnt");
    let avx512 = avx2
        && is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512vl")
        && is_x86_feature_detected!("avx512dq");
    (avx2, avx512)
}

#[cfg(not(target_arch = "x86_64"))]
fn supported() -> (bool, bool) {
    (false, false)
}

/// What a ray is for the kernels.
enum Usable {
    Yes,
    No,
    /// Direction too short or too long: (same ray with a moderate one, factor from its t to the ray's).
    Scaled(Ray, f64),
}

/// Greatest direction components that the kernels take as they are.
const MODERATE_MAX: f32 = (1u32 << 20) as f32;
const MODERATE_MIN: f32 = 1.0 / MODERATE_MAX;

#[inline(always)]
fn usable(ray: &Ray) -> Usable {
    let (o, d) = (ray.origin, ray.direction);
    let finite = ((o.x * 0.0 + o.y * 0.0) + (o.z * 0.0 + d.x * 0.0)) + (d.y * 0.0 + d.z * 0.0) == 0.0;
    if !finite || !(ray.t_min < ray.t_max) {
        return Usable::No;
    }
    let m = d.abs().max_element();
    if (MODERATE_MIN..=MODERATE_MAX).contains(&m) { Usable::Yes } else { rescaled(ray, m) }
}

#[cold]
fn rescaled(ray: &Ray, m: f32) -> Usable {
    if m == 0.0 {
        return Usable::No;
    }
    // A power of two, so that the direction stays exact.
    let s = f64::from_bits(f64::from(m).to_bits() & 0x7ff0_0000_0000_0000);
    let d = (ray.direction.as_dvec3() / s).as_vec3();
    let factor = 1.0 / s;
    let back = |t: f32| (f64::from(t) * factor) as f32;
    // Exactly those t that lie in the ray's own range when they are turned back: the same hits for every kind of question.
    let t_min = last_positive(|t| back(t) <= ray.t_min).unwrap_or(-f32::MIN_POSITIVE);
    let t_max = last_positive(|t| back(t) < ray.t_max).map_or(0.0, f32::next_up);
    if !(t_min < t_max) {
        return Usable::No;
    }
    Usable::Scaled(Ray { origin: ray.origin, t_min, direction: d, t_max }, factor)
}

/// The greatest number from 0 to +infinity that still passes a test which, once it fails, fails for all that are greater.
fn last_positive(passes: impl Fn(f32) -> bool) -> Option<f32> {
    let (mut good, mut bad) = (None, f32::INFINITY.to_bits() + 1);
    let mut low = 0;
    while low < bad {
        // Positive floats are ordered as their bits are.
        let middle = low + (bad - low) / 2;
        if passes(f32::from_bits(middle)) {
            (good, low) = (Some(f32::from_bits(middle)), middle + 1);
        } else {
            bad = middle;
        }
    }
    good
}

#[inline(always)]
fn closest_with(ray: &Ray, kernel: impl Fn(&Ray) -> Hit) -> Hit {
    match usable(ray) {
        Usable::Yes => kernel(ray),
        Usable::No => Hit::MISS,
        Usable::Scaled(moderate, factor) => {
            let mut hit = kernel(&moderate);
            hit.t = (f64::from(hit.t) * factor) as f32;
            if hit.is_hit() && ray.t_min < hit.t && hit.t < ray.t_max { hit } else { Hit::MISS }
        }
    }
}

#[inline(always)]
fn any_with(ray: &Ray, kernel: impl Fn(&Ray) -> bool) -> bool {
    match usable(ray) {
        Usable::Yes => kernel(ray),
        Usable::No => false,
        Usable::Scaled(moderate, _) => kernel(&moderate),
    }
}

/// One level's entry points: the functions with the features, under which everything else is inlined.
macro_rules! level {
    ($name:ident, $level:ty, $($features:literal)?) => {
        mod $name {
            use super::*;
            $(#[target_feature(enable = $features)])?
            pub(super) unsafe fn closest(world: &World, ray: &Ray) -> Hit {
                // SAFETY: the caller has the features.
                unsafe { single::closest::<$level>(world, ray) }
            }
            $(#[target_feature(enable = $features)])?
            pub(super) unsafe fn any(world: &World, ray: &Ray) -> bool {
                // SAFETY: the caller has the features.
                unsafe { single::any::<$level>(world, ray) }
            }
            $(#[target_feature(enable = $features)])?
            pub(super) unsafe fn stream(world: &World, rays: &[Ray], numbers: &[u32], hits: &mut [Hit]) {
                // SAFETY: the caller has the features.
                unsafe { stream::closest::<$level>(world, rays, numbers, hits) }
            }
            $(#[target_feature(enable = $features)])?
            pub(super) unsafe fn closest16(world: &World, rays: &[Ray], hits: &mut [Hit]) -> bool {
                // SAFETY: the caller has the features.
                unsafe { packet::closest::<$level>(world, rays, hits) }
            }
            $(#[target_feature(enable = $features)])?
            pub(super) unsafe fn closest8(world: &World, rays: &[Ray], hits: &mut [Hit]) -> bool {
                // SAFETY: the caller has the features.
                unsafe { packet::closest::<Half<$level>>(world, rays, hits) }
            }
            $(#[target_feature(enable = $features)])?
            pub(super) unsafe fn any16(world: &World, rays: &[Ray], hits: &mut [bool]) -> bool {
                // SAFETY: the caller has the features.
                unsafe { packet::any::<$level>(world, rays, hits) }
            }
            $(#[target_feature(enable = $features)])?
            pub(super) unsafe fn any8(world: &World, rays: &[Ray], hits: &mut [bool]) -> bool {
                // SAFETY: the caller has the features.
                unsafe { packet::any::<Half<$level>>(world, rays, hits) }
            }
        }
    };
}

level!(portable, Portable,);
level!(counted, Counted,);
#[cfg(target_arch = "x86_64")]
level!(avx2, x86::Avx2, "avx2,fma,bmi1,bmi2,lzcnt,popcnt");
#[cfg(target_arch = "x86_64")]
level!(avx512, x86::Avx512, "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512vl,avx512dq");

macro_rules! dispatch {
    ($level:expr, $f:ident($($a:expr),*)) => {
        // SAFETY: `Detected` exists only for levels that this processor has.
        unsafe {
            match $level.0 {
                #[cfg(target_arch = "x86_64")]
                Some(SimdLevel::Avx2) => avx2::$f($($a),*),
                #[cfg(target_arch = "x86_64")]
                Some(SimdLevel::Avx512) => avx512::$f($($a),*),
                Some(_) => portable::$f($($a),*),
                None => counted::$f($($a),*),
            }
        }
    };
}

/// Closest hits of eight or sixteen rays that are alike; false where they are not, or one of them is unusable.
#[inline(always)]
fn closest_packet(level: Detected, world: &World, rays: &[Ray], hits: &mut [Hit]) -> bool {
    if rays.len() == 8 {
        dispatch!(level, closest8(world, rays, hits))
    } else {
        assert!(rays.len() == 16 && hits.len() == 16, "a packet of sixteen");
        dispatch!(level, closest16(world, rays, hits))
    }
}

/// As [`closest_packet`].
#[inline(always)]
fn any_packet(level: Detected, world: &World, rays: &[Ray], hits: &mut [bool]) -> bool {
    if rays.len() == 8 {
        dispatch!(level, any8(world, rays, hits))
    } else {
        assert!(rays.len() == 16 && hits.len() == 16, "a packet of sixteen");
        dispatch!(level, any16(world, rays, hits))
    }
}

/// Closest hits of usable rays of moderate direction, by their numbers.
fn closest_side_by_side(level: Detected, world: &World, rays: &[Ray], numbers: &[u32], hits: &mut [Hit]) {
    assert!(numbers.iter().all(|&n| (n as usize) < rays.len().min(hits.len())), "numbers of rays");
    dispatch!(level, stream(world, rays, numbers, hits));
}

/// Closest hit of any ray.
#[inline]
pub(crate) fn closest(level: Detected, world: &World, ray: &Ray) -> Hit {
    let hit = closest_with(ray, |ray| dispatch!(level, closest(world, ray)));
    level.tally(world);
    hit
}

/// Any hit of any ray.
#[inline]
pub(crate) fn any(level: Detected, world: &World, ray: &Ray) -> bool {
    let hit = any_with(ray, |ray| dispatch!(level, any(world, ray)));
    level.tally(world);
    hit
}

/// Closest hits of many rays: see `many`.
pub(crate) fn closest_many(level: Detected, world: &World, rays: &[Ray], hits: &mut [Hit]) {
    many::all::<many::Closest>(level, world, rays, hits);
}

/// Any hits of many rays: see `many`.
pub(crate) fn any_many(level: Detected, world: &World, rays: &[Ray], occluded: &mut [bool]) {
    many::all::<many::Any>(level, world, rays, occluded);
}
