//! Every function of the shared WGSL and of the tracer's is held against Rust: by name in a twin test, inside of another that is,
//! or by whole pictures, as stated here. A function that is new and nowhere held fails.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

/// Functions and the one that twin tests call them through.
const THROUGH: &[(&str, &str)] = &[
    // Intersection.
    ("permuted", "ray_space"),
    ("with_sign", "ray_space"),
    ("sheared", "intersect_fast"),
    ("surely", "intersect_fast"),
    ("add_64", "exact_difference"),
    ("subtract_64", "exact_difference"),
    ("shift_left_64", "exact_difference"),
    ("multiply_24", "exact_difference"),
    ("significand", "exact_difference"),
    ("exponent_of", "exact_difference"),
    ("scaled_by", "intersect_exact"),
    // Looks and textures.
    ("shininess_from_roughness", "physical_look"),
    ("physical_look", "reflectance_at"),
    ("normalize_or", "surface_at"),
    ("metal_of_reflectance", "reflectance_at"),
    ("reflectance_at", "surface_at"),
    ("matte_weight", "shade"),
    ("sign_not_zero", "octahedral_encode"),
    ("decode_channel", "texel_linear"),
    ("sample_level", "surface_texels"),
    ("surface_texels", "surface_at"),
    ("texture_lod", "surface_at"),
    ("filtered_alpha", "sample_alpha"),
    ("sample_alpha", "is_hole"),
    ("fold_uv", "texture_footprint"),
    ("tangents", "surface_at"),
    ("perturbed_normal", "surface_at"),
    // Shadows.
    ("evsm_warp", "moments_of"),
    ("sample_moments", "soft_moments"),
    ("soft_moments", "view_visibility"),
    ("view_visibility", "moments_visibility"),
    ("moments_visibility", "shade"),
    ("traced_visibility", "shade"),
    ("vpl_texel_coordinates", "vpl_visibility"),
    ("vpl_texel_center", "vpl_visibility"),
    ("inverse_plane_height", "vpl_visibility"),
    ("vpl_tap", "vpl_visibility"),
    ("vpl_visibility", "shade"),
    // The scene in heaps.
    ("float3", "read_light"),
    ("texel_at", "texel_linear"),
    ("srgb_value", "texel_linear"),
    ("corner_uv", "surface_at"),
    ("read_vpl", "shade"),
    // Walks.
    ("child_key", "trace_ray"),
    ("rank", "trace_ray"),
    ("placed", "trace_ray"),
    ("ordered_children", "trace_ray"),
    ("nearer", "trace_ray"),
    ("offered", "trace_ray"),
    ("leaf_hit", "trace_ray"),
    ("object_space", "trace_ray"),
    ("trace_ray", "closest_hit"),
    ("kd_hit", "closest_hit"),
    ("occluded", "shade"),
    // Media and interfaces.
    ("priority_of", "current_medium"),
    ("ior_of", "split"),
    // Photons: `SceneProbe::photons` runs the kernels as they are.
    ("cosine_direction", "trace_photons"),
    ("put", "trace_photons"),
    ("is_lit", "pack_photons"),
    ("place_of", "pack_photons"),
];

/// Functions without a twin of their own, and what holds them.
const BY_PICTURES: &[(&str, &str)] = &[
    ("fullscreen_position", "every pass that covers the picture: gpu_lane.rs"),
    ("cutout_uv", "holes of the rasteriser: gpu_tracer.rs, textures place by place and holes; gpu_lane.rs"),
    ("matte_albedo", "lanes.rs and light_interleave.rs: indirect layers of both lanes"),
    ("grid_pixel", "light_grid.rs: both lanes' pictures"),
    ("grid_share", "light_grid.rs: both lanes' pictures"),
    ("grid_irradiance", "light_grid.rs: both lanes' pictures"),
    ("trace_photons", "twins_tracer/photons.rs: the kernel itself"),
    ("pack_photons", "twins_tracer/photons.rs: the kernel itself"),
    // Order and sum of a pixel's rays: the traced layers of tests/gpu_tracer.rs, and gpu_queues.rs against another order.
    ("worth", "gpu_tracer.rs: layers and numbers of rays"),
    ("sum", "gpu_tracer.rs: layers and numbers of rays"),
    ("choose", "gpu_tracer.rs: layers and numbers of rays"),
    ("children", "gpu_tracer.rs: layers and numbers of rays"),
    ("camera_branch", "gpu_tracer.rs: layers and numbers of rays"),
    ("traced_radiance", "gpu_tracer.rs: layers and numbers of rays"),
    ("seen_at", "gpu_tracer.rs: layers and numbers of rays"),
    ("trace_pixel", "gpu_tracer.rs: layers and numbers of rays"),
    // Kernels and what is theirs alone.
    ("count_ray", "gpu_tracer.rs: numbers of rays"),
    ("prepare", "gpu_tracer.rs: the dispatch of every layer"),
    ("query", "gpu_tracer.rs: hits are those of the CPU"),
    ("trace_masked", "gpu_tracer.rs: layers"),
    ("vertex", "gpu_tracer.rs: layers of the fragment tracer"),
    ("fragment", "gpu_tracer.rs: layers of the fragment tracer"),
    ("committed", "validation alone: no adapter at hand has ray queries"),
    ("add_counts", "gpu_queues.rs"),
    ("add_light", "gpu_queues.rs"),
    ("put_ray", "gpu_queues.rs"),
    ("take_ray", "gpu_queues.rs"),
    ("put_children", "gpu_queues.rs"),
    ("arrived", "gpu_queues.rs"),
    ("invocation", "gpu_queues.rs"),
    ("begin", "gpu_queues.rs"),
    ("follow", "gpu_queues.rs"),
    ("find", "gpu_queues.rs"),
    ("shade_found", "gpu_queues.rs"),
    ("finish", "gpu_queues.rs"),
    ("resolve", "gpu_queues.rs"),
    ("next_wave", "gpu_queues.rs"),
];

fn files(folder: &Path, ending: &str) -> Vec<PathBuf> {
    let mut out: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    out.retain(|p| p.extension().is_some_and(|e| e == ending));
    out.sort();
    out
}

/// Names of the functions that a WGSL text defines.
fn functions(text: &str) -> impl Iterator<Item = String> {
    let after = text.lines().filter_map(|l| l.strip_prefix("fn "));
    after.map(|l| l.split('(').next().unwrap_or("").to_string())
}

/// What stands between quotes in a Rust text: WGSL bodies of tests, and faults.
fn literals(text: &str) -> String {
    let code: String = text.lines().filter(|l| !l.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n");
    code.split('"').skip(1).step_by(2).collect::<Vec<_>>().join("\n")
}

fn calls(text: &str, name: &str) -> bool {
    text.match_indices(name).any(|(at, _)| {
        let before = text[..at].chars().next_back();
        text[at + name.len()..].starts_with('(') && !before.is_some_and(|c| c.is_alphanumeric() || c == '_')
    })
}

#[test]
fn every_shared_function_is_held_against_rust() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let shaders = root.join("../render_hybrid/src/shaders");
    let mut all = BTreeSet::new();
    for folder in ["shared", "tracer"] {
        for file in files(&shaders.join(folder), "wgsl") {
            all.extend(functions(&fs::read_to_string(file).unwrap()));
        }
    }
    assert!(all.len() > 150, "{} functions", all.len());
    let tests = root.join("tests");
    let mut called = String::new();
    let twins = files(&tests, "rs").into_iter().filter(|p| {
        p.file_stem().unwrap().to_string_lossy().starts_with("twins") && !p.ends_with("twins_inventory.rs")
    });
    for file in twins.chain(files(&tests.join("twins_tracer"), "rs")) {
        called.push_str(&literals(&fs::read_to_string(file).unwrap()));
    }
    let through: BTreeMap<&str, &str> = THROUGH.iter().copied().collect();
    let pictures: BTreeMap<&str, &str> = BY_PICTURES.iter().copied().collect();
    let mut missing = Vec::new();
    let (mut direct, mut inside) = (0, 0);
    for name in &all {
        let mut at = name.as_str();
        let mut steps = 0;
        while !calls(&called, at) && steps < 8 {
            match through.get(at) {
                Some(next) => at = next,
                None => break,
            }
            steps += 1;
        }
        match calls(&called, at) {
            true if steps == 0 => direct += 1,
            true => inside += 1,
            false if pictures.contains_key(at) => {}
            false => missing.push(name),
        }
    }
    println!(
        "{} functions: {direct} in twin tests by name, {inside} inside of those, the others by pictures",
        all.len()
    );
    assert!(missing.is_empty(), "no test holds {missing:?}");
    // The lists name what is there.
    let listed = through.iter().flat_map(|(a, b)| [*a, *b]).chain(pictures.keys().copied());
    let gone: Vec<&str> = listed.filter(|name| !all.contains(*name)).collect();
    assert!(gone.is_empty(), "no longer there: {gone:?}");
}
