//! A posed frame as GLB.

mod materials;
mod writer;

use super::error::GltfError;
use crate::{
    camera::Projection,
    light::{Light, LightKind},
    math,
    mesh::Mesh,
    render_scene::RenderScene,
};
use glam::{Affine3, Mat3, Vec3};
use serde_json::{Map, Value, json};
use std::{collections::BTreeMap, path::Path, sync::Arc};
use writer::Writer;

/// Writes `scene` as a `.glb`: geometry with vertex colours, textures as PNG, camera, `KHR_lights_punctual`,
/// transmission, ior, volume (also for closed glass that absorbs nothing), emissive strength, unlit. What glTF cannot say
/// (k_a, k_s, shininess, priority, light radius, environment) goes into `extras.catoptra`, so that [`super::load_gltf`]
/// gives the scene back.
///
/// The file appears whole or not at all: it is written beside its place under another name, then renamed.
///
/// # Errors
/// [`GltfError::Export`] where the scene is not valid or too large, [`GltfError::Io`] where it cannot be written.
pub fn export_glb(scene: &RenderScene, path: &Path) -> Result<(), GltfError> {
    let bytes = export_glb_bytes(scene)?;
    let name = path.file_name().ok_or_else(|| GltfError::Export(format!("{} names no file", path.display())))?;
    let temporary = path.with_file_name(format!(".{}.{}.tmp", name.to_string_lossy(), std::process::id()));
    let written = std::fs::write(&temporary, bytes).and_then(|()| std::fs::rename(&temporary, path));
    written.map_err(|source| {
        // The first error is the one to tell; the remains may not even exist.
        let _ = std::fs::remove_file(&temporary);
        GltfError::Io { path: path.to_path_buf(), source }
    })
}

/// The same as bytes in memory.
///
/// # Errors
/// [`GltfError::Export`] where the scene is not valid or does not fit into GLB's 4 GiB.
pub fn export_glb_bytes(scene: &RenderScene) -> Result<Vec<u8>, GltfError> {
    scene.validate().map_err(|e| GltfError::Export(e.to_string()))?;
    let mut w = Writer::default();
    let thickness = materials::thickness(scene);
    let textures = materials::Textures::write(scene, &mut w)?;
    for (i, material) in scene.materials.iter().enumerate() {
        let value = materials::material(material, thickness[i], &textures, &mut w);
        w.push("materials", value);
    }
    instances(scene, &mut w);
    lights(scene, &mut w);
    camera(scene, &mut w);
    let environment = &scene.environment;
    let mut shown = json!({ "nodes": (0..w.len("nodes")).collect::<Vec<_>>() });
    if *environment != Default::default() {
        shown["extras"] = json!({ "catoptra": {
            "background": environment.background.to_array(),
            "ambient": environment.ambient.to_array(),
        }});
    }
    w.push("scenes", shown);
    w.finish()
}

fn instances(scene: &RenderScene, w: &mut Writer) {
    // Attributes once a mesh (by identity), one glTF mesh for each pair of mesh and material.
    let mut primitives: BTreeMap<usize, Option<Value>> = BTreeMap::new();
    let mut meshes: BTreeMap<(usize, u32), usize> = BTreeMap::new();
    for instance in &scene.instances {
        let mesh = &scene.meshes[instance.mesh as usize];
        let identity = Arc::as_ptr(mesh) as usize;
        let Some(primitive) = primitives.entry(identity).or_insert_with(|| primitive(mesh, w)).clone() else {
            continue; // glTF has no empty meshes.
        };
        let number = *meshes.entry((identity, instance.material)).or_insert_with(|| {
            let mut primitive = primitive;
            primitive["material"] = json!(instance.material);
            w.push("meshes", json!({ "primitives": [primitive] }))
        });
        let name = format!("instance {}", instance.stable_id);
        node(w, &instance.world_from_object, json!({ "name": name, "mesh": number }));
    }
}

/// Attributes and indices of a mesh; `None` where it has no triangle.
fn primitive(mesh: &Mesh, w: &mut Writer) -> Option<Value> {
    if mesh.triangles().is_empty() {
        return None;
    }
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for &p in mesh.positions() {
        (low, high) = (low.min(p), high.max(p));
    }
    let mut attributes = Map::new();
    let positions = w.floats("VEC3", mesh.positions(), Some([low, high]));
    attributes.insert("POSITION".into(), json!(positions));
    attributes.insert("NORMAL".into(), json!(w.floats("VEC3", mesh.normals(), None)));
    for (name, uvs) in [("TEXCOORD_0", mesh.uvs()), ("TEXCOORD_1", mesh.uvs1())] {
        if !uvs.is_empty() {
            attributes.insert(name.into(), json!(w.floats("VEC2", uvs, None)));
        }
    }
    // TEXCOORD_1 needs a TEXCOORD_0 before it.
    if mesh.uvs().is_empty() && !mesh.uvs1().is_empty() {
        let zero = vec![glam::Vec2::ZERO; mesh.positions().len()];
        attributes.insert("TEXCOORD_0".into(), json!(w.floats("VEC2", &zero, None)));
    }
    if !mesh.colors().is_empty() {
        attributes.insert("COLOR_0".into(), json!(w.floats("VEC4", mesh.colors(), None)));
    }
    Some(json!({ "attributes": attributes, "indices": w.indices(mesh.triangles()) }))
}

fn lights(scene: &RenderScene, w: &mut Writer) {
    for light in &scene.lights {
        let number = w.push_light(light_value(light));
        let extensions = json!({ "KHR_lights_punctual": { "light": number } });
        let pose = pose_of(light);
        node(w, &pose, json!({ "name": format!("light {}", light.stable_id), "extensions": extensions }));
    }
}

/// Pose whose -Z is the light's direction and whose +Y is its up vector.
fn pose_of(light: &Light) -> Affine3 {
    let (z, y) = (-light.direction_world, light.up_world);
    let x = y.cross(z);
    let matrix3 = if light.direction_world.is_normalized() && x.is_normalized() {
        Mat3::from_cols(x, y, z)
    } else {
        let z = z.normalize_or(Vec3::Z);
        let (x, y) = math::orthonormal_basis(z);
        Mat3::from_cols(x, y, z)
    };
    Affine3 { matrix3, translation: light.position_world }
}

fn light_value(light: &Light) -> Value {
    // glTF wants a colour in [0, 1]. A power of two keeps every digit of colour x intensity.
    let brightest = light.intensity.max_element();
    let mut intensity = 1.0;
    while intensity < brightest && intensity < 1e38 {
        intensity *= 2.0;
    }
    while intensity > 2.0 * brightest && intensity > 1e-30 {
        intensity *= 0.5;
    }
    let color = light.intensity / intensity;
    let mut own = Map::new();
    if light.radius != 0.0 {
        own.insert("radius".into(), json!(light.radius));
    }
    let mut value = json!({ "color": color.to_array(), "intensity": intensity });
    value["type"] = json!(match light.kind {
        LightKind::Point => "point",
        LightKind::Directional => "directional",
        LightKind::Spot { cos_inner, cos_outer } => {
            let outer = math::acos(cos_outer).clamp(1e-6, std::f32::consts::FRAC_PI_2);
            let inner = math::acos(cos_inner).clamp(0.0, outer * (1.0 - 1e-6));
            value["spot"] = json!({ "innerConeAngle": inner, "outerConeAngle": outer });
            // An angle of a cosine is not exact, and a cone wider than a half space has no glTF form.
            if math::cos(inner) != cos_inner {
                own.insert("cos_inner".into(), json!(cos_inner));
            }
            if math::cos(outer) != cos_outer {
                own.insert("cos_outer".into(), json!(cos_outer));
            }
            "spot"
        }
    });
    if !own.is_empty() {
        value["extras"] = json!({ "catoptra": own });
    }
    value
}

fn camera(scene: &RenderScene, w: &mut Writer) {
    let camera = &scene.camera;
    let near = camera.near;
    let value = match camera.projection {
        Projection::Perspective { fov_y } => {
            // glTF demands znear over 0; ours may be 0.
            let near = if near > 0.0 { near } else { 1e-6 };
            json!({ "type": "perspective", "perspective": { "yfov": fov_y, "znear": near } })
        }
        Projection::Orthographic { half_height } => {
            let bounds = scene.bounds_world();
            let far = (camera.world_from_view.translation - bounds.center()).length() + bounds.radius();
            let far = if far.is_finite() { far.max(2.0 * near).max(1.0) } else { near + 1000.0 };
            let lens = json!({ "xmag": half_height, "ymag": half_height, "znear": near, "zfar": far });
            json!({ "type": "orthographic", "orthographic": lens })
        }
    };
    let number = w.push("cameras", value);
    node(w, &camera.world_from_view, json!({ "name": "camera", "camera": number }));
}

fn node(w: &mut Writer, pose: &Affine3, mut value: Value) {
    let (m, t) = (&pose.matrix3, pose.translation);
    let column = |v: Vec3, last: f32| [v.x, v.y, v.z, last];
    let columns = [column(m.x_axis, 0.0), column(m.y_axis, 0.0), column(m.z_axis, 0.0), column(t, 1.0)];
    if *pose != Affine3::IDENTITY {
        value["matrix"] = json!(columns.concat());
    }
    w.push("nodes", value);
}
