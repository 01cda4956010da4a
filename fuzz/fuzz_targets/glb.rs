//! Bytes as a glTF or GLB file: imported, spawned, played for two steps, drawn small, exported and read again.
#![no_main]

use libfuzzer_sys::fuzz_target;

#[path = "../src/glb.rs"]
mod check;

fuzz_target!(|data: &[u8]| {
    check::check(data);
});
