//! The one place where files of the user enter the scenes.

use super::BuildError;
use super::stage::Stage;
use bevy_transform::components::Transform;
use catoptra_engine::{Aabb, ImportLimits, ImportedScene, Material, StableId, load_gltf};
use glam::Vec3;
use std::path::Path;

/// Reads a file for its meshes; its cameras, lights and background stay out, the scene has its own.
fn load(path: &Path) -> Result<(ImportedScene, Aabb), BuildError> {
    let wrong = |why: String| BuildError::File { path: path.to_path_buf(), why };
    let mut scene = load_gltf(path, &ImportLimits::default()).map_err(|e| wrong(e.to_string()))?;
    scene.environment = None;
    for node in &mut scene.nodes {
        node.camera = None;
        node.light = None;
    }
    let bounds = scene.bounds_world();
    let size = bounds.max - bounds.min;
    if bounds.is_empty() || !(size.y > 0.0 && size.is_finite()) {
        return Err(wrong("it draws nothing of any height".into()));
    }
    Ok((scene, bounds))
}

/// Spawns the meshes below a root with the given pose.
fn spawn(stage: &mut Stage, scene: &ImportedScene, pose: Transform) {
    let first = stage.take_ids(0);
    let spawned = scene.spawn(stage.world(), first);
    stage.take_ids(spawned.next_stable_id - first);
    *stage.world().get_mut::<Transform>(spawned.root).expect("a root has a pose") = pose;
    debug_assert!(stage.world().get::<StableId>(spawned.root).is_none());
}

/// Spawns the file's meshes as one statue of one material: standing on `place`, `height` metres tall, but at most
/// `width` wide and deep.
///
/// # Errors
/// [`BuildError::File`] where the file cannot be read or draws nothing.
pub fn spawn_statue(
    stage: &mut Stage,
    path: &Path,
    place: Vec3,
    height: f32,
    width: f32,
    material: Material,
) -> Result<(), BuildError> {
    let (mut scene, bounds) = load(path)?;
    for m in &mut scene.materials {
        *m = material;
    }
    let size = bounds.max - bounds.min;
    let scale = (height / size.y).min(width / size.x.max(size.z).max(1e-9));
    let foot = Vec3::new(bounds.center().x, bounds.min.y, bounds.center().z);
    let pose = Transform { translation: place - foot * scale, scale: Vec3::splat(scale), ..Default::default() };
    spawn(stage, &scene, pose);
    Ok(())
}

/// Where there is ground to roll on: of all surfaces on the upright through the middle of `bounds`, the one with the
/// most free height above it (file space).
fn ground(scene: &ImportedScene, bounds: &Aabb) -> f32 {
    let c = bounds.center();
    // Off the middle by a little, so that the upright does not run along a seam of a symmetric building.
    let (x, z) = (c.x + 0.003 * bounds.radius(), c.z + 0.002 * bounds.radius());
    let mut heights = vec![bounds.max.y];
    for (primitive, pose) in scene.instances() {
        let mesh = &scene.meshes[primitive.mesh];
        for i in 0..mesh.triangles().len() as u32 {
            let [p, q, r] = mesh.corners(i).map(|v| pose.transform_point3(v));
            let (e1, e2) = (q - p, r - p);
            let det = e1.x * e2.z - e2.x * e1.z;
            let (dx, dz) = (x - p.x, z - p.z);
            let (u, v) = ((dx * e2.z - e2.x * dz) / det, (e1.x * dz - dx * e1.z) / det);
            if u >= 0.0 && v >= 0.0 && u + v <= 1.0 {
                heights.push(p.y + u * e1.y + v * e2.y);
            }
        }
    }
    heights.sort_by(f32::total_cmp);
    let gaps = heights.windows(2).max_by(|a, b| (a[1] - a[0]).total_cmp(&(b[1] - b[0])));
    gaps.map_or(bounds.min.y, |w| w[0])
}

/// Spawns the file's meshes with its own materials, turned so that the longer side runs along x, and returns their
/// bounds in the world, from the ground of the court up.
///
/// # Errors
/// [`BuildError::File`] where the file cannot be read or draws nothing.
pub fn spawn_atrium(stage: &mut Stage, path: &Path) -> Result<Aabb, BuildError> {
    let (scene, bounds) = load(path)?;
    let size = bounds.max - bounds.min;
    let mut pose = Transform::IDENTITY;
    let mut placed = bounds;
    if size.z > size.x {
        // A quarter turn about Y: (x, z) becomes (z, -x).
        let half = std::f32::consts::FRAC_1_SQRT_2;
        pose.rotation = glam::Quat::from_xyzw(0.0, half, 0.0, half);
        placed.min = Vec3::new(bounds.min.z, bounds.min.y, -bounds.max.x);
        placed.max = Vec3::new(bounds.max.z, bounds.max.y, -bounds.min.x);
    }
    placed.min.y = ground(&scene, &bounds);
    spawn(stage, &scene, pose);
    Ok(placed)
}
