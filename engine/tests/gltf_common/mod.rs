//! Files and scenes made for the glTF tests. Each test binary uses a part of them.
#![allow(dead_code)]

use catoptra_engine::{
    Camera, Environment, ImportLimits, ImportedScene, Instance, Light, LightKind, Material, Mesh, MeshData,
    RenderScene, Texture, TextureRef, Wrap, gltf::GltfError, load_gltf_bytes,
};
use glam::{Affine3, Mat3, Quat, Vec2, Vec3};
use serde_json::{Value, json};
use std::sync::Arc;

/// A GLB of `json` and `bin`; the buffer's entry is added.
pub fn glb(mut json: Value, bin: &[u8]) -> Vec<u8> {
    json["asset"] = json!({ "version": "2.0" });
    if !bin.is_empty() {
        json["buffers"] = json!([{ "byteLength": bin.len() }]);
    }
    let mut text = serde_json::to_vec(&json).unwrap();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut bin = bin.to_vec();
    bin.resize(bin.len().next_multiple_of(4), 0);
    let mut out = b"glTF".to_vec();
    out.extend(2_u32.to_le_bytes());
    out.extend((28 + text.len() as u32 + bin.len() as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &bin)] {
        out.extend((chunk.len() as u32).to_le_bytes());
        out.extend(kind);
        out.extend(chunk);
    }
    out
}

pub fn load(bytes: &[u8]) -> Result<ImportedScene, GltfError> {
    load_gltf_bytes(bytes, None, &ImportLimits::default())
}

pub fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// Five points of a bent ribbon.
pub const RIBBON: [f32; 15] = [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 2.0, 0.0, 0.5];

/// A morphed and a skinned mesh.
pub fn posed_file() -> Vec<u8> {
    let mut bin = floats(&RIBBON[..9]);
    bin.extend(floats(&[0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
    // Joints and weights: the first vertex is held by joint 1 alone, the others by halves.
    bin.extend([1, 0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0]);
    bin.extend(floats(&[1.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.0, 0.0, 0.5, 0.5, 0.0, 0.0]));
    let json = json!({
        "nodes": [
            { "mesh": 0, "weights": [0.25] },
            { "mesh": 1, "skin": 0, "translation": [100, 0, 0] },
            { "translation": [10, 0, 0] },
            { "translation": [0, 20, 0] },
        ],
        "skins": [{ "joints": [2, 3] }],
        "meshes": [
            { "weights": [1], "primitives": [{ "attributes": { "POSITION": 0 }, "targets": [{ "POSITION": 1 }] }] },
            { "primitives": [{ "attributes": { "POSITION": 0, "JOINTS_0": 2, "WEIGHTS_0": 3 } }] },
        ],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3" },
            { "bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC3" },
            { "bufferView": 2, "componentType": 5121, "count": 3, "type": "VEC4" },
            { "bufferView": 3, "componentType": 5126, "count": 3, "type": "VEC4" },
        ],
        "bufferViews": [
            { "buffer": 0, "byteLength": 36 },
            { "buffer": 0, "byteOffset": 36, "byteLength": 36 },
            { "buffer": 0, "byteOffset": 72, "byteLength": 12 },
            { "buffer": 0, "byteOffset": 84, "byteLength": 48 },
        ],
    });
    glb(json, &bin)
}

pub fn cube() -> MeshData {
    let positions: Vec<Vec3> =
        (0..8).map(|i| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) - 0.5).collect();
    let mut triangles = Vec::new();
    for [a, b, c, d] in [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]] {
        triangles.extend([[a, b, c], [a, c, d]]);
    }
    MeshData {
        normals: positions.iter().map(|p| p.normalize()).collect(),
        uvs: positions.iter().map(|p| Vec2::new(p.x, p.y)).collect(),
        uvs1: positions.iter().map(|p| Vec2::new(p.z, p.y)).collect(),
        colors: positions.iter().map(|p| (*p + 0.5).extend(0.75)).collect(),
        positions,
        triangles,
        ..Default::default()
    }
}

/// A scene with every native field away from its default.
pub fn native_scene() -> RenderScene {
    let texels = vec![[1, 2, 3, 4], [250, 128, 7, 255], [9, 9, 9, 0], [255, 0, 255, 128], [0, 0, 0, 0], [5, 6, 7, 8]];
    let reference = |uv_set, wrap, nearest| TextureRef { texture: 0, uv_set, wrap, nearest, ..Default::default() };
    let base = Vec3::new(0.1, 0.7, 0.3);
    let materials = vec![
        Material::lambert(base),
        Material {
            base_color_texture: Some(reference(1, [Wrap::Mirror, Wrap::Clamp], true)),
            ..Material::mirror(base, 0.3)
        },
        Material {
            attenuation_color: Vec3::new(0.9, 0.1, 0.33),
            attenuation_distance: 0.7,
            priority: -3,
            ..Material::glass(base, 1.77)
        },
        Material { transmission: 0.4, specular: base, shininess: 77.7, ..Material::glass(base, 1.5) },
        Material {
            ambient: 0.11,
            diffuse: 0.6,
            specular: Vec3::new(0.3, 0.2, 0.1),
            shininess: 123.4,
            ..Material::lambert(base)
        },
        Material { schlick: true, ..Material::mirror(base, 1.0) },
        Material {
            emissive: Vec3::new(13.7, 0.001, 400.0),
            emissive_texture: Some(reference(0, [Wrap::Repeat; 2], false)),
            unlit: true,
            ..Material::default()
        },
        Material { mirror: 0.2, transmission: 0.5, specular: Vec3::ONE, ..Material::default() },
        // Clear closed glass, which glTF without a volume would call a thin wall.
        Material::glass(Vec3::ONE, 1.5),
        // Holes, and a normal map.
        Material {
            base_color_texture: Some(reference(0, [Wrap::Repeat; 2], false)),
            normal_texture: Some(TextureRef { texture: 1, ..reference(1, [Wrap::Clamp; 2], false) }),
            normal_scale: -0.7,
            alpha: 0.9,
            alpha_cutoff: 0.3,
            ..Material::lambert(base)
        },
        // Half there.
        Material { thin: true, transmission: 0.35, specular: base, shininess: 30.0, ..Material::lambert(base) },
    ];
    let mut open = cube();
    open.triangles.pop();
    let meshes = vec![Arc::new(Mesh::new(cube()).unwrap()), Arc::new(Mesh::new(open).unwrap())];
    let instances = (0..materials.len() as u32)
        .map(|i| {
            let rotation = Quat::from_rotation_y(0.3 * i as f32) * Quat::from_rotation_x(0.1);
            let scale = Vec3::new(1.0 + i as f32, if i == 4 { -2.0 } else { 0.3 }, 1.0);
            let mut world_from_object =
                Affine3::from_scale_rotation_translation(scale, rotation, Vec3::splat(i as f32));
            if i == 5 {
                world_from_object.matrix3 *= Mat3::from_cols(Vec3::X, Vec3::new(0.5, 1.0, 0.0), Vec3::Z);
            }
            Instance { stable_id: u64::from(i), mesh: i % 2, material: i, world_from_object }
        })
        .collect();
    let (direction_world, up_world) = (Vec3::new(0.0, -0.6, -0.8), Vec3::new(0.0, 0.8, -0.6));
    let light = |kind, radius, intensity: [f32; 3]| Light {
        stable_id: 0,
        kind,
        position_world: Vec3::new(1.0, 9.0, -3.3),
        direction_world,
        up_world,
        intensity: Vec3::from(intensity),
        radius,
    };
    RenderScene {
        meshes,
        textures: vec![
            Arc::new(Texture::new(3, 2, texels.clone(), true).unwrap()),
            Arc::new(Texture::new(3, 2, texels, false).unwrap()),
        ],
        materials,
        instances,
        lights: vec![
            light(LightKind::Point, 0.05, [10.0, 20.0, 30.1]),
            light(LightKind::Spot { cos_inner: 0.9, cos_outer: 0.7 }, 0.25, [0.001, 0.0, 0.002]),
            light(LightKind::Directional, 0.0, [0.0; 3]),
        ],
        camera: Camera { near: 0.03, ..Camera::looking_at(Vec3::new(3.0, 4.0, 5.0), Vec3::Y, 0.9) },
        environment: Environment { background: Vec3::new(0.1, 0.2, 0.3), ambient: Vec3::splat(0.05) },
        ..Default::default()
    }
}

/// One mesh whose positions are [`RIBBON`], with `indices` appended as component type `kind`.
pub fn indexed(mode: u32, kind: u32, indices: &[u32]) -> Vec<u8> {
    let mut bin = floats(&RIBBON);
    for i in indices {
        match kind {
            5121 => bin.push(*i as u8),
            5123 => bin.extend((*i as u16).to_le_bytes()),
            _ => bin.extend(i.to_le_bytes()),
        }
    }
    let json = json!({
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1, "mode": mode }] }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 5, "type": "VEC3" },
            { "bufferView": 1, "componentType": kind, "count": indices.len(), "type": "SCALAR" },
        ],
        "bufferViews": [
            { "buffer": 0, "byteLength": 60 },
            { "buffer": 0, "byteOffset": 60, "byteLength": bin.len() - 60 },
        ],
    });
    glb(json, &bin)
}

/// A scene of one triangle per material in `materials`, extensions and images given.
pub fn materials(list: Value, more: Value) -> Result<ImportedScene, GltfError> {
    let count = list.as_array().unwrap().len();
    let primitives: Vec<Value> =
        (0..count).map(|i| json!({ "attributes": { "POSITION": 0 }, "material": i })).collect();
    let mut json = json!({
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": primitives }],
        "materials": list,
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3" }],
        "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
    });
    for (key, value) in more.as_object().unwrap() {
        json[key] = value.clone();
    }
    load(&glb(json, &floats(&RIBBON)))
}
