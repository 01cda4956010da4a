//! WGSL of the tracer: one source for storage buffers and textures, kd-trees and hardware ray queries.

use crate::{
    accel::flat,
    raster::shader::{generated_constants, stitch_with},
    trace::media::MediumStack,
};

use super::layout;

macro_rules! sources {
    ($($name:literal),+ $(,)?) => { &[$(($name, include_str!(concat!("../../shaders/", $name, ".wgsl")))),+] };
}

/// Files of `shaders/tracer`.
const FILES: &[(&str, &str)] = sources![
    "tracer/args",
    "tracer/hits",
    "tracer/hits_rayquery",
    "tracer/kd",
    "tracer/media",
    "tracer/no_kd",
    "tracer/photons",
    "tracer/photons_pack",
    "tracer/pixels",
    "tracer/query",
    "tracer/scene",
    "tracer/shade",
    "tracer/surface",
    "tracer/trace",
    "tracer/trace_fragment",
    "tracer/traverse",
    "tracer/wave_args",
    "tracer/waves",
    "tracer/whitted",
];

/// Invocations a workgroup.
pub(crate) const TRACE_GROUP: u32 = 64;
/// Words a row of a heap that lies in a texture.
pub(crate) const HEAP_WIDTH: u32 = 2048;
/// Counters of rays by kind, and of pixels that met a cap.
pub(crate) const COUNTERS: u32 = 5;

/// The heaps in the order of their bindings in group 0, after the first three.
pub(crate) const HEAPS: [&str; 6] = ["node", "triangle", "geometry", "texel", "dynamic", "vpl"];

/// Where the heaps lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum HeapKind {
    Storage,
    Texture,
}

/// What a kernel is compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Variant {
    pub heaps: HeapKind,
    /// Mesh trees are kd-trees.
    pub kd: bool,
    /// The adapter's own trees.
    pub rayquery: bool,
    /// Rays to lights, to VPLs.
    pub traced_shadows: bool,
    pub traced_vpls: bool,
    /// Rays that can wait at once: [`Self::FEW_RAYS`] or 64. Adapters pay for what is reserved, not for what is used, and
    /// software ones for compiling it.
    pub rays: u32,
    /// Shows the work of each pixel in place of light: rays, steps of their walks.
    pub work: bool,
    /// Levels of both trees together: [`Self::FEW_LEVELS`] or all that trees may have.
    pub levels: u32,
}

impl Variant {
    pub const FEW_RAYS: u32 = 15;
    pub const FEW_LEVELS: u32 = 20;
    pub const ALL_LEVELS: u32 = 2 * (flat::MAX_DEPTH as u32 + 1);

    pub fn new(heaps: HeapKind) -> Self {
        let (rays, levels) = (Self::FEW_RAYS, Self::FEW_LEVELS);
        let (kd, rayquery, traced_shadows, traced_vpls, work) = (false, false, false, false, false);
        Self { heaps, kd, rayquery, traced_shadows, traced_vpls, work, rays, levels }
    }
}

/// Accessors of the heaps, `NAME_word(i)`: generated for both kinds of places, so that the rest is written once.
fn heaps(kind: HeapKind) -> String {
    let mut out = String::new();
    for (binding, name) in (3..).zip(HEAPS) {
        out.push_str(&match kind {
            HeapKind::Storage => format!(
                "@group(0) @binding({binding}) var<storage, read> {name}_heap: array<vec4u>;
fn {name}_word(i: u32) -> vec4u {{ return {name}_heap[i]; }}\n"
            ),
            HeapKind::Texture => format!(
                "@group(0) @binding({binding}) var {name}_heap: texture_2d<u32>;
fn {name}_word(i: u32) -> vec4u {{
    return textureLoad({name}_heap, vec2u(i % {HEAP_WIDTH}u, i / {HEAP_WIDTH}u), 0);
}}\n"
            ),
        });
    }
    out
}

fn constants(v: &Variant) -> String {
    let mut out = String::new();
    if v.rayquery {
        out.push_str("enable wgpu_ray_query;\n");
    }
    out.push_str(&generated_constants());
    let mut u = |name: &str, value: u32| out.push_str(&format!("const {name}: u32 = {value}u;\n"));
    u("NODE_WORDS", flat::NODE_WORDS);
    u("TRIANGLE_WORDS", flat::TRIANGLE_WORDS);
    u("REF_LEAF", flat::LEAF);
    u("REF_BLOCK", flat::REF_BLOCK);
    u("REF_LEN_SHIFT", flat::LEN_SHIFT);
    u("KD_LEAF", flat::KD_LEAF_KIND);
    u("KD_SHORT_STACK", 8);
    // One entry a level, and the way back into the upper tree.
    u("TRAVERSAL_STACK", v.levels + 1);
    u("BRANCH_STACK", v.rays);
    u("MEDIA_CAPACITY", MediumStack::CAPACITY as u32);
    u("INSTANCE_WORDS", layout::INSTANCE_WORDS);
    u("INSTANCE_IDENTITY", layout::INSTANCE_IDENTITY);
    u("INSTANCE_CASTS_SHADOW", layout::INSTANCE_CASTS_SHADOW);
    u("INSTANCE_CUTOUT", layout::INSTANCE_CUTOUT);
    u("INSTANCE_CLOSED", layout::INSTANCE_CLOSED);
    u("MATERIAL_WORDS", layout::MATERIAL_WORDS);
    u("MATERIAL_SCHLICK", layout::MATERIAL_SCHLICK);
    u("MATERIAL_THIN", layout::MATERIAL_THIN);
    u("LIGHT_WORDS", layout::LIGHT_WORDS);
    u("VIEW_WORDS", layout::VIEW_WORDS);
    u("VERTEX_WORDS", layout::VERTEX_WORDS);
    u("VERTEX_POSITION", 0);
    u("VERTEX_NORMAL", 1);
    u("VERTEX_UV", 2);
    u("VERTEX_COLOR", 3);
    u("VERTEX_TANGENT", 4);
    u("PATH_WORDS", super::photons::PATH_WORDS);
    u("SOURCE_WORDS", super::photons::SOURCE_WORDS);
    u("SLOT_WORDS", super::photons::SLOT_WORDS);
    u("HEAD_WORDS", super::photons::HEAD_WORDS);
    u("TRACE_GROUP", TRACE_GROUP);
    u("TRACE_COUNTERS", COUNTERS);
    u("RAYS_REFLECTION", 0);
    u("RAYS_REFRACTION", 1);
    u("RAYS_SHADOW", 2);
    u("RAYS_VPL", 3);
    u("RAYS_CAPPED", 4);
    u("RAY_QUERY_CAP", 1 << 16);
    let mut b = |name: &str, value: bool| out.push_str(&format!("const {name}: bool = {value};\n"));
    b("TREES_ARE_KD", v.kd);
    b("TRACED_SHADOWS", v.traced_shadows);
    b("TRACED_VPLS", v.traced_vpls);
    b("SHOWS_WORK", v.work);
    let mut f = |name: &str, value: f32| out.push_str(&format!("const {name}: f32 = {value:e};\n"));
    f("SURFACE_ERROR", 32.0 * f32::EPSILON * 0.5);
    f("GRAZING_COSINE", 0.125);
    f("LEAST_COSINE", 1e-3);
    out
}

/// The whole text of a kernel: `trace`, `trace_fragment`, `query`, `photons`, `photons_pack`, `args`, `waves` or `wave_args`.
///
/// # Panics
/// Where it does not exist: a mistake in this crate, met by its tests.
pub(crate) fn text(kernel: &str, v: &Variant) -> String {
    let source = file(&format!("tracer/{kernel}")).unwrap_or_else(|| panic!("there is no kernel {kernel}"));
    text_of(&format!("tracer_{kernel}"), source, v)
}

fn file(name: &str) -> Option<&'static str> {
    FILES.iter().find(|(n, _)| *n == name).map(|(_, text)| *text)
}

/// [`text`] of a kernel that is not among the files; `name` is its name in dumps.
pub(crate) fn text_of(name: &str, source: &str, v: &Variant) -> String {
    let heaps = heaps(v.heaps);
    let own = |import: &str| match import {
        "tracer/heaps" => Some(heaps.as_str()),
        "tracer/kd_hit" => file(if v.kd { "tracer/kd" } else { "tracer/no_kd" }),
        "tracer/hits" if v.rayquery => file("tracer/hits_rayquery"),
        other => file(other),
    };
    stitch_with(name, &constants(v), source, &own)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn validated(what: &str, text: &str, capabilities: naga::valid::Capabilities) -> naga::Module {
        let module =
            naga::front::wgsl::parse_str(text).unwrap_or_else(|e| panic!("{what}: {}", e.emit_to_string(text)));
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), capabilities)
            .validate(&module)
            .unwrap_or_else(|e| panic!("{what}: {}", e.emit_to_string(text)));
        module
    }

    fn variants() -> Vec<Variant> {
        let mut all = Vec::new();
        for heaps in [HeapKind::Storage, HeapKind::Texture] {
            for bits in 0..32u32 {
                let on = |i: u32| bits & 1 << i != 0;
                let (rays, levels) = if on(3) { (64, Variant::ALL_LEVELS) } else { (15, Variant::FEW_LEVELS) };
                let v = Variant {
                    kd: on(0),
                    traced_shadows: on(1),
                    traced_vpls: on(2),
                    work: on(4),
                    rays,
                    levels,
                    ..Variant::new(heaps)
                };
                all.push(v);
            }
        }
        all
    }

    #[test]
    fn every_kernel_validates_in_every_variant() {
        let plain = naga::valid::Capabilities::default();
        for v in variants() {
            let kernels: &[&str] = match v.heaps {
                HeapKind::Storage => &["args", "trace", "query", "photons", "photons_pack", "wave_args", "waves"],
                HeapKind::Texture => &["trace_fragment"],
            };
            for kernel in kernels {
                let module = validated(&format!("{kernel} {v:?}"), &text(kernel, &v), plain);
                assert!(!module.entry_points.is_empty(), "{kernel}");
            }
            if v.heaps == HeapKind::Storage && !v.kd {
                let v = Variant { rayquery: true, ..v };
                for kernel in ["trace", "query", "photons"] {
                    validated(kernel, &text(kernel, &v), plain | naga::valid::Capabilities::RAY_QUERY);
                }
            }
        }
    }

    #[test]
    fn the_fragment_tracer_has_no_storage() {
        for v in variants().into_iter().filter(|v| v.heaps == HeapKind::Texture) {
            let module = validated("trace_fragment", &text("trace_fragment", &v), naga::valid::Capabilities::default());
            let mut textures = 0;
            for (_, variable) in module.global_variables.iter() {
                assert!(!matches!(variable.space, naga::AddressSpace::Storage { .. }), "{:?}", variable.name);
                textures += u32::from(variable.space == naga::AddressSpace::Handle);
            }
            // What GLES 3 and WebGL 2 grant a stage.
            assert!(textures <= 16, "{textures} textures");
        }
    }

    #[test]
    fn every_file_is_listed() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src/shaders/tracer");
        assert_eq!(std::fs::read_dir(folder).unwrap().count(), FILES.len());
    }
}
