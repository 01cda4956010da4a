//! The five scenes at small sizes, and the renderers that draw them.

use crate::{HashLedger, SnapshotFolder, shared::workspace};
use bevy_app::App;
use catoptra_demos::scenes::{SceneOptions, build};
use catoptra_engine::{Extracted, RenderScene, app::advance};
use catoptra_render_hybrid::{
    Frame, MomentOptions, Preset, RasterLane, RenderSettings, Renderer, RendererOptions, VplOptions, VplShadows,
};

/// Names of the five scenes.
pub const SCENE_NAMES: [&str; 5] =
    ["rolling-box", "rolling-box-donut", "two-spheres", "rolling-box-venus", "rolling-box-sponza"];

/// The frames at which pictures are compared.
pub const FRAMES: [u64; 3] = [0, 30, 90];

/// The app of a scene after `frame` steps.
///
/// # Panics
/// Where there is no such scene.
pub fn app_at(name: &str, frame: u64) -> App {
    let mut app = build(name, &SceneOptions::default()).unwrap_or_else(|e| panic!("{name}: {e}"));
    advance(&mut app, frame);
    app
}

/// The extracted scene of an app as it stands.
pub fn extracted(app: &App) -> RenderScene {
    app.world().resource::<Extracted>().0.clone()
}

/// The extracted scene after `frame` steps.
///
/// # Panics
/// As [`app_at`].
pub fn scene_at(name: &str, frame: u64) -> RenderScene {
    extracted(&app_at(name, frame))
}

/// Interactive settings at a small size with small shadow maps.
/// * `moments`: texels a side of every shadow map
pub fn small(width: u32, height: u32, moments: u32) -> RenderSettings {
    let preset = RenderSettings::preset(Preset::Interactive);
    let moments = MomentOptions { size: moments, face_size: moments, ..preset.moments };
    // The preset's own grid is for 1024x1024.
    let vpl = preset.vpl.map(|v| VplOptions { spacing: 2, ..v });
    RenderSettings { width, height, moments, vpl, ..preset }
}

/// VPLs as the truth wants them: no bound, one visibility ray per point and VPL.
pub fn full_vpls(count: u32, bounces: u32) -> VplOptions {
    VplOptions { count, bounces, geometry_term_max: None, shadows: VplShadows::Traced, ..VplOptions::default() }
}

/// A renderer on the CPU lane with everything else automatic.
///
/// # Panics
/// Where worker threads cannot be started.
pub fn cpu() -> Renderer {
    cpu_with(RendererOptions::default())
}

/// A renderer on the CPU lane with the given choices.
///
/// # Panics
/// Where an explicit SIMD level is missing.
pub fn cpu_with(options: RendererOptions) -> Renderer {
    Renderer::new(RendererOptions { raster: RasterLane::Cpu, ..options }).unwrap_or_else(|e| panic!("CPU lane: {e}"))
}

/// A picture by a renderer that never drew anything before.
///
/// # Panics
/// Where the scene or the settings cannot be drawn.
pub fn fresh(scene: &RenderScene, settings: &RenderSettings) -> Frame {
    cpu().render(scene, settings).unwrap_or_else(|e| panic!("{e}"))
}

/// This workspace's golden pictures; failures go to `target/snapshots`.
pub fn goldens() -> SnapshotFolder {
    SnapshotFolder::new(workspace().join("tests/goldens"), workspace().join("target/snapshots"))
}

/// This workspace's golden hashes.
pub fn golden_hashes() -> HashLedger {
    HashLedger::new(workspace().join("tests/goldens/hashes.txt"))
}
