//! WGSL sources: imports, constants generated from Rust, dumping.

use crate::twin::{
    grid, interleave, penumbra,
    shadow::{BINOMIAL_3, EVSM_EXPONENTS},
    vpl_maps::{DEPTH_SLACK, NEAREST_PLANE},
};

use super::layouts;
use crate::accel::flat;

macro_rules! sources {
    ($($name:literal),+ $(,)?) => { &[$(($name, include_str!(concat!("../shaders/", $name, ".wgsl")))),+] };
}

/// Files with entry points, by name.
pub const PASSES: &[(&str, &str)] = sources![
    "moments",
    "moments_blur",
    "moments_cutout",
    "visibility",
    "visibility_cutout",
    "gbuffer",
    "compact",
    "direct",
    "light_grid",
    "indirect",
    "interleave",
    "traced_scatter",
    "compose",
    "layer",
    "present",
];

/// Files with functions and structs only, by the name that `#import` takes.
pub const SHARED: &[(&str, &str)] = sources![
    "shared/scene",
    "shared/camera",
    "shared/triangle",
    "shared/octahedral",
    "shared/texture",
    "shared/sample",
    "shared/cutout",
    "shared/moments",
    "shared/light",
    "shared/shading",
    "shared/look",
    "shared/shadow",
    "shared/vpl",
    "shared/vpl_maps",
    "shared/vpl_chunk",
    "shared/light_grid",
    "shared/interleave",
    "shared/fullscreen",
    "shared/intersect",
    "shared/sampling",
];

/// Pixels a workgroup of the compaction.
pub const COMPACT_BLOCK: u32 = 256;
/// VPLs in one uniform buffer: 48 KiB, within the 64 KiB that every adapter has.
pub const VPL_CHUNK: u32 = 1024;
/// Near plane of a light's perspective view as a fraction of its far distance.
pub const SHADOW_NEAR_FRACTION: f32 = 1e-6;

/// Constants and enumerations that Rust and WGSL share, as WGSL text.
pub fn generated_constants() -> String {
    let mut out = String::from("// Generated from Rust (raster/shader.rs).\n");
    let mut u = |name: &str, value: u32| out.push_str(&format!("const {name}: u32 = {value}u;\n"));
    u("WRAP_REPEAT", catoptra_engine::Wrap::Repeat as u32);
    u("WRAP_CLAMP", catoptra_engine::Wrap::Clamp as u32);
    u("WRAP_MIRROR", catoptra_engine::Wrap::Mirror as u32);
    u("TEXTURE_NEAREST", layouts::TEXTURE_NEAREST);
    u("TEXTURE_SRGB", layouts::TEXTURE_SRGB);
    u("TEXTURE_UV1", layouts::TEXTURE_UV1);
    u("TEXTURE_NEAREST_MIN", layouts::TEXTURE_NEAREST_MIN);
    u("TEXTURE_MIP_NEAREST", layouts::TEXTURE_MIP_NEAREST);
    u("TEXTURE_MIP_LINEAR", layouts::TEXTURE_MIP_LINEAR);
    u("PHYSICAL", layouts::PHYSICAL);
    u("PHYSICAL_BLENDED", layouts::PHYSICAL_BLENDED);
    u("PHYSICAL_REFLECTANCE", layouts::PHYSICAL_REFLECTANCE);
    u("PHYSICAL_BY_REFLECTANCE", layouts::PHYSICAL_BY_REFLECTANCE);
    u("NO_TEXTURE", layouts::NO_TEXTURE);
    u("LIGHT_POINT", layouts::LIGHT_POINT);
    u("LIGHT_SPOT", layouts::LIGHT_SPOT);
    u("LIGHT_DIRECTIONAL", layouts::LIGHT_DIRECTIONAL);
    u("VISIBILITY_NONE", layouts::VISIBILITY_NONE);
    u("VISIBILITY_MOMENTS", layouts::VISIBILITY_MOMENTS);
    u("VISIBILITY_PLANES", layouts::VISIBILITY_PLANES);
    u("ATTRIBUTE_STRIDE", layouts::ATTRIBUTE_STRIDE);
    u("ATTRIBUTE_NORMAL", layouts::ATTRIBUTE_NORMAL);
    u("ATTRIBUTE_UV0", layouts::ATTRIBUTE_UV0);
    u("ATTRIBUTE_UV1", layouts::ATTRIBUTE_UV1);
    u("ATTRIBUTE_COLOR", layouts::ATTRIBUTE_COLOR);
    u("ATTRIBUTE_ALPHA", layouts::ATTRIBUTE_ALPHA);
    u("ATTRIBUTE_TANGENT", layouts::ATTRIBUTE_TANGENT);
    u("ATTRIBUTE_HANDEDNESS", layouts::ATTRIBUTE_HANDEDNESS);
    for (slot, name) in layouts::SLOTS.iter().enumerate() {
        u(&format!("SLOT_{name}"), slot as u32);
    }
    u("TEXTURE_SLOTS", layouts::SLOTS.len() as u32);
    u("NONE", u32::MAX);
    u("COMPACT_BLOCK", COMPACT_BLOCK);
    u("VPL_CHUNK", VPL_CHUNK);
    u("PENUMBRA_COARSEST", penumbra::COARSEST);
    for (name, kind) in layouts::PACKED_LAYERS {
        u(name, *kind as u32);
    }
    let mut f = |name: &str, value: f32| out.push_str(&format!("const {name}: f32 = {value:e};\n"));
    f("PI", std::f32::consts::PI);
    f("MIN_POSITIVE", f32::MIN_POSITIVE);
    f("POLISHED", catoptra_engine::material::POLISHED);
    f("NOT_POLISHED", catoptra_engine::material::NOT_POLISHED);
    f("DIELECTRIC_REFLECTANCE", catoptra_engine::material::DIELECTRIC_REFLECTANCE);
    f("MAX_SHININESS", catoptra_engine::material::MAX_SHININESS);
    // Stands for infinity, which shaders must not hold.
    f("FAR_AWAY", f32::MAX);
    f("SHADOW_NEAR_FRACTION", SHADOW_NEAR_FRACTION);
    f("EVSM_POSITIVE", EVSM_EXPONENTS[0]);
    f("EVSM_NEGATIVE", EVSM_EXPONENTS[1]);
    f("BLUR_BESIDE", BINOMIAL_3[0]);
    f("BLUR_CENTER", BINOMIAL_3[1]);
    f("PENUMBRA_LEVEL_SIGMA", penumbra::LEVEL_SIGMA);
    f("PENUMBRA_LEAST_OCCLUDED", penumbra::LEAST_OCCLUDED);
    f("VPL_DEPTH_SLACK", DEPTH_SLACK);
    f("VPL_NEAREST_PLANE_INVERSE", 1.0 / NEAREST_PLANE);
    f("GRID_LEAST_COSINE", grid::LEAST_COSINE);
    f("GRID_COSINE_SPAN", grid::COSINE_SPAN);
    f("GRID_OFF_PLANE", grid::OFF_PLANE);
    f("GRID_OFF_PLANE_SPAN", grid::OFF_PLANE_SPAN);
    f("GRID_LEAST_WEIGHT", grid::LEAST_WEIGHT);
    f("GRID_ROUNDING", grid::ROUNDING);
    f("INTERLEAVE_LEAST_COSINE", interleave::LEAST_COSINE);
    f("INTERLEAVE_MOST_OFF_PLANE", interleave::MOST_OFF_PLANE);
    f("RAY_PAD", flat::PAD);
    f("RAY_LEAST_SLOPE", flat::LEAST_SLOPE);
    f("TRIANGLE_CONDITION", flat::CONDITION);
    f("TRIANGLE_DET_MIN", flat::DET_MIN);
    f("TRIANGLE_DET_MAX", flat::DET_MAX);
    // Two products and a difference, each rounded or not: 2^-22 of the products' sum is more than they can be off.
    f("EDGE_DOUBT", 1.0 / 4_194_304.0);
    out
}

/// The whole text of a pass: constants, imports (each once, depth first), the file.
///
/// # Panics
/// Where the pass or an import does not exist: a mistake in this crate, met by its tests.
pub fn stitch(pass: &str) -> String {
    let (_, source) =
        PASSES.iter().find(|(name, _)| *name == pass).unwrap_or_else(|| panic!("there is no shader {pass}"));
    stitch_source(pass, source)
}

/// [`stitch`] for a text that is not among the passes; `name` is its name in dumps.
pub fn stitch_source(name: &str, source: &str) -> String {
    stitch_with(name, &generated_constants(), source, &|_| None)
}

/// [`stitch_source`] with other constants and with imports beside the shared ones.
pub(crate) fn stitch_with<'a>(
    name: &str,
    constants: &str,
    source: &'a str,
    own: &dyn Fn(&str) -> Option<&'a str>,
) -> String {
    let mut out = constants.to_string();
    append(source, own, &mut Vec::new(), &mut out);
    dump(name, &out);
    out
}

fn append<'a>(source: &'a str, own: &dyn Fn(&str) -> Option<&'a str>, done: &mut Vec<String>, out: &mut String) {
    for line in source.lines() {
        let Some(import) = line.strip_prefix("#import ") else {
            out.push_str(line);
            out.push('\n');
            continue;
        };
        let import = import.trim();
        if done.iter().any(|d| d == import) {
            continue;
        }
        done.push(import.to_string());
        let shared = || SHARED.iter().find(|(name, _)| *name == import).map(|(_, text)| *text);
        let text = own(import).or_else(shared).unwrap_or_else(|| panic!("there is no shader {import}"));
        append(text, own, done, out);
    }
}

/// Writes the stitched text to the folder that the environment variable CATOPTRA_WGSL_DUMP names.
fn dump(name: &str, text: &str) {
    let Some(folder) = std::env::var_os("CATOPTRA_WGSL_DUMP") else { return };
    let file = std::path::Path::new(&folder).join(format!("{}.wgsl", name.replace('/', "_")));
    if let Err(error) = std::fs::create_dir_all(&folder).and_then(|()| std::fs::write(&file, text)) {
        tracing::warn!("cannot write {}: {error}", file.display());
    }
}

/// Compiles a pass.
pub(crate) fn module(device: &wgpu::Device, pass: &str) -> wgpu::ShaderModule {
    device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(pass),
        source: wgpu::ShaderSource::Wgsl(stitch(pass).into()),
    })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub fn validated(name: &str, text: &str) -> naga::Module {
        let module =
            naga::front::wgsl::parse_str(text).unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string(text)));
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::default())
            .validate(&module)
            .unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string(text)));
        module
    }

    /// What `shared/sample` and `shared/cutout` want of their importers.
    const IMPORTERS: &str = "
fn texel_at(i: u32) -> u32 { return i; }
fn srgb_value(byte: u32) -> f32 { return f32(byte); }
fn material_texture(material: u32, slot: u32) -> TextureRef { return TextureRef(); }
fn corner_uv(r: TextureRef, vertex: u32) -> vec2f { return vec2f(0.0); }
";

    #[test]
    fn every_shader_validates() {
        for (name, _) in PASSES {
            assert!(!validated(name, &stitch(name)).entry_points.is_empty(), "{name} has no entry point");
        }
        for (name, source) in SHARED {
            let mut text = stitch_source(name, source);
            if ["shared/sample", "shared/cutout"].contains(name) {
                text.push_str(IMPORTERS);
            }
            let module = validated(name, &text);
            assert!(module.entry_points.is_empty() && module.global_variables.is_empty(), "{name} is not pure");
        }
    }

    #[test]
    fn every_file_is_listed() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src/shaders");
        let count = |folder: &std::path::Path| {
            std::fs::read_dir(folder)
                .unwrap()
                .filter(|f| f.as_ref().unwrap().path().extension().is_some_and(|e| e == "wgsl"))
                .count()
        };
        assert_eq!(count(&folder), PASSES.len());
        assert_eq!(count(&folder.join("shared")), SHARED.len());
    }
}
