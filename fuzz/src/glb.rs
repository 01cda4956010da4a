//! What holds for any bytes taken as a glTF or GLB file. Shared by the fuzz target and the test over its corpus.

use catoptra_engine::{Extracted, ImportLimits, app, fit, gltf::export_glb_bytes, load_gltf_bytes};
use catoptra_render_hybrid::{RasterLane, RenderSettings, Renderer, RendererOptions};

/// Far less than an import may take, so that a run is short.
const LIMITS: ImportLimits = ImportLimits {
    bytes: 1 << 22,
    json_tokens: 1 << 16,
    vertices: 1 << 16,
    triangles: 1 << 16,
    image_pixels: 1 << 16,
    texture_pixels: 1 << 18,
    nodes: 1 << 10,
    instances: 1 << 10,
    depth: 64,
    coordinate: 1e9,
};

/// True where the file was read and its scene drawn.
///
/// # Panics
/// Where something that must hold does not.
pub fn check(data: &[u8]) -> bool {
    let Ok(scene) = load_gltf_bytes(data, None, &LIMITS) else { return false };
    let mut app = app::new_app();
    scene.spawn(app.world_mut(), 1);
    app::settle(&mut app);
    app::advance(&mut app, 2);
    let mut drawn = app.world().resource::<Extracted>().0.clone();
    if !scene.report.has_camera {
        drawn.camera = fit::fit_camera(scene.bounds_world());
    }
    let settings =
        RenderSettings { width: 16, height: 12, ..RenderSettings::preset(catoptra_render_hybrid::Preset::Draft) };
    let options = RendererOptions { raster: RasterLane::Cpu, threads: 1, ..Default::default() };
    let mut renderer = Renderer::new(options).expect("the CPU lane is always there");
    let frame = renderer.render(&drawn, &settings);
    if let Ok(frame) = &frame {
        assert!(frame.image.pixels.iter().flatten().all(|v| v.is_finite()), "a pixel is not finite");
    }
    // What came in goes out, and comes back as the same things.
    let still = scene.to_render_scene(1);
    if still.validate().is_ok()
        && let Ok(bytes) = export_glb_bytes(&still)
    {
        let again = load_gltf_bytes(&bytes, None, &ImportLimits::default());
        let again = again.unwrap_or_else(|e| panic!("our own export is refused: {e}"));
        assert_eq!(again.triangle_count(), still.triangle_count());
    }
    frame.is_ok()
}
