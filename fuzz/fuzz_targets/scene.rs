//! Bytes as a recipe of a `RenderScene`: drawn small, refused or drawn, never a panic, twice the same.
#![no_main]

use libfuzzer_sys::fuzz_target;

#[path = "../src/scene.rs"]
mod check;

fuzz_target!(|data: &[u8]| {
    check::check(data);
});
