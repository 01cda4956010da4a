//! `list` and `info`.

use super::{
    failure::{Failure, line},
    options::SceneArgs,
    stats,
    target::Target,
    world::World,
};
use crate::scenes::SCENES;
use catoptra_render_hybrid::{Renderer, RendererOptions, raster};

/// Runs `list`: `NAME TRIANGLES ABOUT` a line, the triangles counted in the scene itself.
pub fn list(args: &SceneArgs) -> Result<(), Failure> {
    let options = args.options();
    for info in &SCENES {
        let world = World::open(&Target::Scene(info.name), &options)?;
        line(format!("{:<20} {:>7}  {}", info.name, world.scene().triangle_count(), info.about))?;
    }
    Ok(())
}

/// Runs `info`.
pub fn info() -> Result<(), Failure> {
    line(format!("catoptra {}", env!("CARGO_PKG_VERSION")))?;
    line(format!("system: {} {}", std::env::consts::OS, std::env::consts::ARCH))?;
    line(format!("cpu: {}, {} processors", stats::cpu_name(), stats::cores()))?;
    let renderer = Renderer::new(RendererOptions::default())?;
    line(format!("simd: {}", stats::simd_name(renderer.simd_level())))?;
    line(format!("threads: {}", renderer.threads()))?;
    let adapters = raster::list_adapters();
    if adapters.is_empty() {
        line("adapter: none; the CPU makes every stage")?;
    }
    for adapter in adapters {
        let kind = if adapter.software { ", software" } else { "" };
        line(format!("adapter: {} ({}{kind}), {}", adapter.name, adapter.backend, adapter.driver))?;
    }
    line(format!("raster auto: {} ({})", stats::lane_name(renderer.lane()), renderer.device()))?;
    let choice = renderer.tracer();
    line(format!("tracer auto: {} ({})", choice.tracer.name(), choice.why))
}
