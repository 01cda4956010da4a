//! Which tracer `Auto` takes: what was fastest on this adapter on its first use, remembered in the user's cache folder.

use catoptra_engine::{
    Camera, Environment, Instance, Light, LightKind, Material, RenderScene,
    glam::{Affine3, Vec3},
    shapes,
};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use crate::{
    raster::AdapterSummary,
    settings::{RenderSettings, Tracer},
};

/// The tracer that runs, and why it is that one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TracerChoice {
    /// Never `Auto`.
    pub tracer: Tracer,
    /// One line for a user.
    pub why: String,
}

impl TracerChoice {
    pub(crate) fn new(tracer: Tracer, why: impl Into<String>) -> Self {
        Self { tracer, why: why.into() }
    }
}

/// Frames of a candidate: the first is not counted.
pub(crate) const MEASURED_FRAMES: u32 = 4;

/// What was measured before, one line an adapter: key, tab, tracer, tab, figures.
pub(crate) struct Memory {
    path: Option<PathBuf>,
}

impl Memory {
    /// In the folder that CATOPTRA_CACHE_DIR names, else in the user's cache folder; nowhere where there is none.
    pub fn of_user() -> Self {
        let folder = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
        let home = || folder("HOME");
        let cache = folder("CATOPTRA_CACHE_DIR").or_else(|| {
            if cfg!(target_os = "windows") {
                folder("LOCALAPPDATA").map(|p| p.join("catoptra"))
            } else if cfg!(target_os = "macos") {
                home().map(|p| p.join("Library/Caches/catoptra"))
            } else {
                folder("XDG_CACHE_HOME").or_else(|| home().map(|p| p.join(".cache"))).map(|p| p.join("catoptra"))
            }
        });
        Self { path: cache.map(|c| c.join("tracer.txt")) }
    }

    /// A file of one's own.
    #[cfg(test)]
    pub fn at(path: &Path) -> Self {
        Self { path: Some(path.to_path_buf()) }
    }

    /// What distinguishes measurements: another driver, version or thread count is measured anew.
    pub fn key(adapter: &AdapterSummary, threads: usize) -> String {
        let version = env!("CARGO_PKG_VERSION");
        let AdapterSummary { name, backend, driver, .. } = adapter;
        let clean = |s: &str| s.replace(['\t', '\n', '\r'], " ");
        format!("{} | {backend} | {} | {threads} threads | {version}", clean(name), clean(driver))
    }

    fn lines(&self) -> Vec<String> {
        // No file, or one that cannot be read: nothing is remembered, which costs a measurement.
        let text = self.path.as_ref().and_then(|p| std::fs::read_to_string(p).ok()).unwrap_or_default();
        text.lines().map(str::to_string).collect()
    }

    /// The remembered tracer; anything that does not read as one is no memory.
    pub fn recall(&self, key: &str) -> Option<Tracer> {
        self.lines().iter().find_map(|line| {
            let mut parts = line.split('\t');
            let (k, name) = (parts.next()?, parts.next()?);
            (k == key).then(|| Tracer::ALL.into_iter().find(|t| t.name() == name)).flatten()
        })
    }

    /// Remembers; an error is harmless and only said in the log.
    pub fn remember(&self, key: &str, tracer: Tracer, figures: &str) {
        let Some(path) = &self.path else { return };
        let mut lines: Vec<_> = self.lines().into_iter().filter(|l| l.split('\t').next() != Some(key)).collect();
        lines.push(format!("{key}\t{}\t{figures}", tracer.name()));
        if let Err(error) = write(path, &(lines.join("\n") + "\n")) {
            tracing::debug!("the choice of tracer is not remembered in {}: {error}", path.display());
        }
    }

    /// Where it is kept, for a user.
    pub fn place(&self) -> String {
        self.path.as_deref().map_or_else(|| "nowhere".into(), |p| p.display().to_string())
    }
}

fn write(path: &Path, text: &str) -> std::io::Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    std::fs::write(path, text)
}

/// `tracer ms` of all candidates, fastest first, and the winner; `None` where nothing could be measured.
pub(crate) fn fastest(mut measured: Vec<(Tracer, f64)>) -> Option<(Tracer, String)> {
    measured.sort_by(|a, b| a.1.total_cmp(&b.1));
    let figures: Vec<_> = measured.iter().map(|(t, ms)| format!("{} {ms:.2} ms", t.name())).collect();
    measured.first().map(|(t, _)| (*t, figures.join(", ")))
}

/// What is measured: a mirror ball and a glass ball in a room, most of whose pixels are traced.
pub(crate) fn measured_scene() -> RenderScene {
    let ball = Arc::new(shapes::sphere(1.0, 48, 96));
    let room = Arc::new(shapes::cuboid(Vec3::new(4.0, 3.0, 4.0), [Vec3::ONE; 6]));
    let instance = |stable_id: u64, mesh, material, at: Vec3| Instance {
        stable_id,
        mesh,
        material,
        world_from_object: Affine3::from_translation(at),
    };
    RenderScene {
        meshes: vec![room, ball],
        materials: vec![
            Material::lambert(Vec3::new(0.7, 0.6, 0.5)),
            Material::mirror(Vec3::splat(0.9), 0.9),
            Material::glass(Vec3::ONE, 1.5),
        ],
        instances: vec![
            instance(1, 0, 0, Vec3::ZERO),
            instance(2, 1, 1, Vec3::new(-1.05, 0.0, 0.0)),
            instance(3, 1, 2, Vec3::new(1.05, 0.0, 0.0)),
        ],
        lights: vec![Light {
            stable_id: 1,
            kind: LightKind::Spot { cos_inner: 0.7, cos_outer: 0.4 },
            position_world: Vec3::new(0.0, 2.8, 0.5),
            direction_world: Vec3::NEG_Y,
            up_world: Vec3::Z,
            intensity: Vec3::splat(20.0),
            radius: 0.05,
        }],
        camera: Camera::looking_at(Vec3::new(0.0, 0.3, 3.5), Vec3::ZERO, 0.9),
        environment: Environment::default(),
        ..RenderScene::default()
    }
}

/// How it is drawn.
pub(crate) fn measured_settings() -> RenderSettings {
    RenderSettings { width: 512, height: 512, ..RenderSettings::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_survives_and_errors_do_no_harm() {
        let folder = std::env::temp_dir().join(format!("catoptra-tracer-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        let file = folder.join("deep/tracer.txt");
        let adapter = |name: &str| AdapterSummary { name: name.into(), ..AdapterSummary::default() };
        let (a, b) = (Memory::key(&adapter("a\tb"), 4), Memory::key(&adapter("b"), 4));
        let memory = Memory::at(&file);
        assert_eq!(memory.recall(&a), None);
        memory.remember(&a, Tracer::Gpu, "gpu 1.00 ms");
        memory.remember(&b, Tracer::Cpu, "cpu 1.00 ms");
        memory.remember(&a, Tracer::GpuFragment, "gpu-fragment 1.00 ms");
        assert_eq!((memory.recall(&a), memory.recall(&b)), (Some(Tracer::GpuFragment), Some(Tracer::Cpu)));
        assert_eq!(memory.lines().len(), 2);
        // Another thread count is another machine.
        assert_eq!(memory.recall(&Memory::key(&adapter("b"), 8)), None);
        // Rubbish in the file is no memory.
        std::fs::write(&file, format!("{b}\twarp\n\u{0}\n{a}")).unwrap();
        assert_eq!((memory.recall(&a), memory.recall(&b)), (None, None));
        std::fs::write(&file, [0xff, 0xfe, 0x00]).unwrap();
        assert_eq!(memory.recall(&a), None);
        // A folder in the file's place cannot be written.
        let blocked = Memory::at(&folder);
        blocked.remember(&a, Tracer::Gpu, "");
        assert_eq!(blocked.recall(&a), None);
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn the_fastest_wins() {
        let measured = vec![(Tracer::Cpu, 9.0), (Tracer::Gpu, 2.5), (Tracer::GpuFragment, f64::INFINITY)];
        let (tracer, figures) = fastest(measured).unwrap();
        assert_eq!((tracer, figures.as_str()), (Tracer::Gpu, "gpu 2.50 ms, cpu 9.00 ms, gpu-fragment inf ms"));
        assert_eq!(fastest(Vec::new()), None);
    }
}
