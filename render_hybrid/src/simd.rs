//! Run-time choice of instruction set for loops over flat arrays.
//!
//! A kernel is written once, as a plain loop in an `#[inline(always)]` function; `dispatch!` compiles it for each level
//! and calls the one that the processor has. Rust never contracts a·b+c into an FMA on its own, so every level computes
//! the same operations in the same order: the same bits.
//!
//! **Architecture invariant:** this and `accel`'s kernels are the only places where `unsafe` is allowed on the CPU side.

use crate::{error::RenderError, settings::SimdLevel};

/// The level that `choice` means on this machine: never `Auto`.
///
/// # Errors
/// [`RenderError::Unavailable`] where an explicit level is not there.
pub fn resolve(choice: SimdLevel) -> Result<SimdLevel, RenderError> {
    let (avx2, avx512) = detected();
    let missing = |name: &str| {
        Err(RenderError::Unavailable {
            choice: format!("--simd {name}"),
            missing: "this processor does not have these instructions".into(),
        })
    };
    match choice {
        SimdLevel::Auto if avx512 => Ok(SimdLevel::Avx512),
        SimdLevel::Auto if avx2 => Ok(SimdLevel::Avx2),
        SimdLevel::Auto | SimdLevel::Portable => Ok(SimdLevel::Portable),
        SimdLevel::Avx2 if avx2 => Ok(SimdLevel::Avx2),
        SimdLevel::Avx2 => missing("avx2"),
        SimdLevel::Avx512 if avx512 => Ok(SimdLevel::Avx512),
        SimdLevel::Avx512 => missing("avx512"),
    }
}

#[cfg(target_arch = "x86_64")]
fn detected() -> (bool, bool) {
    let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
    let avx512 = avx2
        && is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512vl")
        && is_x86_feature_detected!("avx512dq")
        && is_x86_feature_detected!("avx512bw");
    (avx2, avx512)
}

#[cfg(not(target_arch = "x86_64"))]
fn detected() -> (bool, bool) {
    (false, false)
}

/// Name as on the command line.
pub fn level_name(level: SimdLevel) -> &'static str {
    match level {
        SimdLevel::Auto => "auto",
        SimdLevel::Portable => "portable",
        SimdLevel::Avx2 => "avx2",
        SimdLevel::Avx512 => "avx512",
    }
}

/// Defines `fn $name(level, args..)` that runs the `#[inline(always)]` function `$body` compiled for the level.
///
/// The level must come from [`resolve`].
macro_rules! dispatch {
    ($(#[$meta:meta])* $vis:vis fn $name:ident => $body:ident($($arg:ident: $ty:ty),* $(,)?)) => {
        $(#[$meta])*
        #[allow(unsafe_code)]
        $vis fn $name(level: crate::settings::SimdLevel, $($arg: $ty),*) {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn avx2($($arg: $ty),*) {
                    $body($($arg),*)
                }
                #[target_feature(enable = "avx2,avx512f,avx512vl,avx512dq,avx512bw")]
                fn avx512($($arg: $ty),*) {
                    $body($($arg),*)
                }
                match level {
                    // SAFETY: `simd::resolve` gave this level, so the processor has AVX2.
                    crate::settings::SimdLevel::Avx2 => return unsafe { avx2($($arg),*) },
                    // SAFETY: `simd::resolve` gave this level, so the processor has AVX-512 F, VL, DQ and BW.
                    crate::settings::SimdLevel::Avx512 => return unsafe { avx512($($arg),*) },
                    _ => {}
                }
            }
            let _ = level;
            $body($($arg),*)
        }
    };
}
pub(crate) use dispatch;
