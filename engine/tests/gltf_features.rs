//! Contract: each feature of the glTF reader and writer shows in geometry, materials or poses, on files made here; every
//! limit is named in its error.

use catoptra_engine::{
    Camera, Extracted, Hidden, ImportLimits, ImportedScene, Instance, Light, LightKind, LightSource, Material, Mesh,
    MeshData, MeshInstance, Projection, RenderScene, StableId, Texture, TextureRef, Wrap,
    app::settle,
    gltf::{GltfError, MAX_SHININESS, export_glb_bytes, roughness_from_shininess, shininess_from_roughness},
    load_gltf, load_gltf_bytes, new_app,
};
use glam::{Affine3, Mat3, Quat, Vec2, Vec3, Vec4};
use serde_json::{Value, json};
use std::sync::Arc;

/// A GLB of `json` and `bin`; the buffer's entry is added.
fn glb(mut json: Value, bin: &[u8]) -> Vec<u8> {
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

fn load(bytes: &[u8]) -> Result<ImportedScene, GltfError> {
    load_gltf_bytes(bytes, None, &ImportLimits::default())
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// Five points of a bent ribbon.
const RIBBON: [f32; 15] = [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 2.0, 0.0, 0.5];

/// One mesh whose positions are [`RIBBON`], with `indices` appended as component type `kind`.
fn indexed(mode: u32, kind: u32, indices: &[u32]) -> Vec<u8> {
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

/// Corners of all triangles as numbers of ribbon points.
fn ribbon_triangles(scene: &ImportedScene) -> Vec<[usize; 3]> {
    let mesh = &scene.meshes[0];
    let number = |p: Vec3| RIBBON.chunks(3).position(|q| Vec3::from_slice(q) == p).unwrap();
    (0..mesh.triangles().len() as u32).map(|t| mesh.corners(t).map(number)).collect()
}

#[test]
fn lists_strips_and_fans_with_every_index_type() {
    for kind in [5121, 5123, 5125] {
        let triangles = |mode, indices: &[u32]| ribbon_triangles(&load(&indexed(mode, kind, indices)).unwrap());
        assert_eq!(triangles(4, &[0, 2, 1, 1, 2, 3]), [[0, 2, 1], [1, 2, 3]]);
        // A strip turns every other triangle, so that all face the same way.
        assert_eq!(triangles(5, &[0, 2, 1, 3, 4]), [[0, 2, 1], [2, 3, 1], [1, 3, 4]]);
        assert_eq!(triangles(6, &[0, 2, 3, 1]), [[2, 3, 0], [3, 1, 0]]);
        for bad in [5, 254, if kind == 5121 { 255 } else { 65535 }] {
            let error = load(&indexed(4, kind, &[0, 1, bad])).unwrap_err().to_string();
            assert!(error.contains("mesh 0, primitive 0") && error.contains(&bad.to_string()), "{error}");
        }
    }
    for (mode, name) in [(0, "POINTS"), (1, "LINES"), (2, "LINE_LOOP"), (3, "LINE_STRIP")] {
        let scene = load(&indexed(mode, 5125, &[0, 1, 2])).unwrap();
        assert_eq!((scene.report.triangles, scene.report.ignored[0].split(' ').next()), (0, Some(name)));
    }
    assert!(load(&indexed(7, 5125, &[0, 1, 2])).unwrap_err().to_string().contains("mode 7"));
    assert!(load(&indexed(4, 5126, &[0, 1, 2])).is_err(), "float indices");
}

#[test]
fn flat_normals_where_there_are_none_and_unused_vertices_go() {
    let scene = load(&indexed(4, 5121, &[4, 3, 2])).unwrap();
    let mesh = &scene.meshes[0];
    assert_eq!((mesh.positions().len(), mesh.triangles().len()), (3, 1));
    let [a, b, c] = mesh.corners(0);
    assert!((mesh.normals()[0] - (b - a).cross(c - a).normalize()).length() < 1e-6);
}

/// Positions as normalised 16-bit, colours as bytes, interleaved with a stride; uv as normalised bytes.
#[test]
fn quantised_and_interleaved() {
    let mut bin = Vec::new();
    for (p, color, uv) in [
        ([0_i16, 0, 0], [255_u8, 0, 0, 255], [0_u8, 255]),
        ([32767, 0, 0], [0, 255, 0, 255], [255, 255]),
        ([0, -32768, 16384], [0, 0, 51, 0], [51, 0]),
    ] {
        p.iter().for_each(|v| bin.extend(v.to_le_bytes()));
        bin.extend([0, 0]);
        bin.extend(color);
        bin.extend(uv);
        bin.extend([0, 0]);
    }
    assert_eq!(bin.len(), 48);
    let attribute = |offset: u32, component: u32, kind: &str| json!({ "bufferView": 0, "byteOffset": offset, "componentType": component, "count": 3, "type": kind, "normalized": true });
    let json = json!({
        "extensionsRequired": ["KHR_mesh_quantization"],
        "extensionsUsed": ["KHR_mesh_quantization"],
        "nodes": [{ "mesh": 0, "scale": [2, 2, 2] }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0, "COLOR_0": 1, "TEXCOORD_0": 2, "TEXCOORD_1": 2 } }] }],
        "accessors": [attribute(0, 5122, "VEC3"), attribute(8, 5121, "VEC4"), attribute(12, 5121, "VEC2")],
        "bufferViews": [{ "buffer": 0, "byteLength": 48, "byteStride": 16 }],
    });
    let scene = load(&glb(json, &bin)).unwrap();
    let mesh = &scene.meshes[0];
    assert_eq!(mesh.positions(), [Vec3::ZERO, Vec3::X, Vec3::new(0.0, -1.0, 16384.0 / 32767.0)]);
    assert_eq!(
        mesh.colors(),
        [Vec4::new(1.0, 0.0, 0.0, 1.0), Vec4::new(0.0, 1.0, 0.0, 1.0), Vec4::new(0.0, 0.0, 0.2, 0.0)]
    );
    assert_eq!(mesh.uvs(), [Vec2::Y, Vec2::ONE, Vec2::new(0.2, 0.0)]);
    assert_eq!(mesh.uvs1(), mesh.uvs());
    assert_eq!(scene.bounds_world().max.x, 2.0);
    assert!(scene.report.ignored.is_empty());
}

fn sparse(indices: &[u16], count: u64) -> Result<ImportedScene, GltfError> {
    let mut bin = floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 7.0, 8.0, 9.0]);
    indices.iter().for_each(|i| bin.extend(i.to_le_bytes()));
    let json = json!({
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "accessors": [{
            "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
            "sparse": {
                "count": count,
                "indices": { "bufferView": 2, "componentType": 5123 },
                "values": { "bufferView": 1 },
            },
        }],
        "bufferViews": [
            { "buffer": 0, "byteLength": 36 },
            { "buffer": 0, "byteOffset": 36, "byteLength": 12 },
            { "buffer": 0, "byteOffset": 48, "byteLength": 2 * indices.len() },
        ],
    });
    load(&glb(json, &bin))
}

#[test]
fn sparse_accessors_replace_their_elements() {
    let scene = sparse(&[2], 1).unwrap();
    assert_eq!(scene.meshes[0].positions(), [Vec3::ZERO, Vec3::X, Vec3::new(7.0, 8.0, 9.0)]);
    assert!(sparse(&[3], 1).unwrap_err().to_string().contains("sparse"), "index beyond the elements");
    assert!(sparse(&[1, 1], 2).is_err(), "indices and values must fit");
    assert!(sparse(&[1], u64::MAX).is_err());
}

/// Every way in which an accessor can reach beyond its bytes.
#[test]
fn sizes_that_do_not_fit_are_refused() {
    let triangle = |count: u64, offset: u64, view_offset: u64, view_length: u64, stride: Value| {
        let json = json!({
            "nodes": [{ "mesh": 0 }],
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
            "accessors": [{ "bufferView": 0, "byteOffset": offset, "componentType": 5126, "count": count, "type": "VEC3" }],
            "bufferViews": [{ "buffer": 0, "byteOffset": view_offset, "byteLength": view_length, "byteStride": stride }],
        });
        load(&glb(json, &floats(&RIBBON)))
    };
    assert_eq!(triangle(3, 0, 0, 60, Value::Null).unwrap().report.triangles, 1);
    assert_eq!(triangle(3, 12, 12, 48, Value::Null).unwrap().report.triangles, 1);
    assert_eq!(triangle(3, 0, 0, 60, json!(24)).unwrap().report.triangles, 1);
    let huge = u64::MAX;
    for (count, offset, view_offset, view_length, stride) in [
        (6, 0, 0, 60, Value::Null),
        (5, 4, 0, 60, Value::Null),
        (5, 0, 4, 60, Value::Null),
        (5, 0, 0, 59, Value::Null),
        (4, 0, 0, 60, json!(24)),
        (3, 0, 0, 60, json!(8)),
        (3, 0, 0, 60, json!(0)),
        (3, 0, 0, 60, json!(huge)),
        (huge, 0, 0, 60, Value::Null),
        (huge / 12 + 1, 0, 0, 60, Value::Null),
        (3, huge, 0, 60, Value::Null),
        (3, huge - 10, 0, 60, Value::Null),
        (3, 0, huge, 60, Value::Null),
        (3, 0, 0, huge, Value::Null),
        (3, 0, huge - 5, 60, Value::Null),
    ] {
        let error = triangle(count, offset, view_offset, view_length, stride.clone()).unwrap_err();
        assert!(
            matches!(error, GltfError::Invalid { .. }),
            "{count} {offset} {view_offset} {view_length} {stride}: {error}"
        );
    }
}

#[test]
fn limits_are_named_with_their_values() {
    let default = ImportLimits::default();
    let bytes = indexed(4, 5121, &[0, 2, 1, 1, 2, 3]);
    for (limits, what) in [
        (ImportLimits { bytes: 100, ..default }, "bytes"),
        (ImportLimits { json_tokens: 10, ..default }, "JSON tokens"),
        (ImportLimits { vertices: 4, ..default }, "vertices"),
        (ImportLimits { triangles: 1, ..default }, "triangles"),
        (ImportLimits { nodes: 0, ..default }, "nodes"),
        (ImportLimits { depth: 0, ..default }, "depth"),
        (ImportLimits { instances: 0, ..default }, "instances"),
    ] {
        let error = load_gltf_bytes(&bytes, None, &limits).unwrap_err();
        assert!(matches!(error, GltfError::Limit { .. }) && error.to_string().contains(what), "{what}: {error}");
    }
    let near = ImportLimits { coordinate: 0.5, ..default };
    assert!(load_gltf_bytes(&bytes, None, &near).unwrap_err().to_string().contains("0.5"));

    // An accessor without data costs nothing in the file: only the limit stops it.
    let json = json!({
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "accessors": [{ "componentType": 5126, "count": 4_000_000_000_u64, "type": "VEC3" }],
    });
    assert!(matches!(load(&glb(json, &[])), Err(GltfError::Limit { what: "vertices", .. })));
}

#[test]
fn positions_must_be_finite_and_in_reach() {
    for bad in [f32::NAN, f32::INFINITY, -1e30] {
        let mut values = RIBBON;
        values[7] = bad;
        let json = json!({
            "nodes": [{ "mesh": 0 }],
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
            "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 5, "type": "VEC3" }],
            "bufferViews": [{ "buffer": 0, "byteLength": 60 }],
        });
        let error = load(&glb(json, &floats(&values))).unwrap_err().to_string();
        assert!(error.contains("vertex 2"), "{error}");
    }
    // Finite in the file, but not in the world.
    let far = json!({ "nodes": [
        { "scale": [1e20, 1, 1], "children": [1] }, { "scale": [1e20, 1, 1], "translation": [1e20, 0, 0] },
    ]});
    assert!(load(&glb(far, &[])).unwrap_err().to_string().contains("world pose"));
    // A number that no f32 holds.
    assert!(load(&glb(json!({ "nodes": [{ "translation": [1e39, 0, 0] }] }), &[])).is_err());
}

#[test]
fn files_may_not_name_places_outside() {
    let folder = std::env::temp_dir().join(format!("catoptra-gltf-{}", std::process::id()));
    let inner = folder.join("asset");
    std::fs::create_dir_all(inner.join("sub")).unwrap();
    for place in ["secret.bin", "asset/own name.bin", "asset/sub/deep.bin"] {
        std::fs::write(folder.join(place), floats(&RIBBON)).unwrap();
    }
    let file = inner.join("scene.gltf");
    let with = |uri: &str| {
        let json = json!({
            "asset": { "version": "2.0" },
            "nodes": [{ "mesh": 0 }],
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
            "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 5, "type": "VEC3" }],
            "bufferViews": [{ "buffer": 0, "byteLength": 60 }],
            "buffers": [{ "byteLength": 60, "uri": uri }],
        });
        std::fs::write(&file, serde_json::to_vec(&json).unwrap()).unwrap();
        load_gltf(&file, &ImportLimits::default())
    };
    assert_eq!(with("own%20name.bin").unwrap().report.triangles, 1);
    assert_eq!(with("sub/../sub/deep.bin").unwrap().report.triangles, 1);
    let absolute = folder.join("secret.bin");
    let file_uri = format!("file://{}", absolute.display());
    for uri in [
        "../secret.bin",
        "sub/../../secret.bin",
        "%2e%2e/secret.bin",
        absolute.to_str().unwrap(),
        &file_uri,
        "http://localhost/x.bin",
    ] {
        let error = with(uri).unwrap_err().to_string();
        assert!(error.contains("refused URI"), "{uri}: {error}");
    }
    assert!(with("missing.bin").unwrap_err().to_string().contains("missing.bin"));
    assert!(with("sub").is_err(), "a folder is no file");
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("../secret.bin", inner.join("link.bin")).unwrap();
        assert!(with("link.bin").unwrap_err().to_string().contains("refused URI"));
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

/// A scene of one triangle per material in `materials`, extensions and images given.
fn materials(list: Value, more: Value) -> Result<ImportedScene, GltfError> {
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

#[test]
fn materials_follow_the_conventions() {
    let pbr = |m: f32, r: f32| json!({ "pbrMetallicRoughness": { "baseColorFactor": [0.5, 0.25, 1, 1], "metallicFactor": m, "roughnessFactor": r } });
    let mut glass = pbr(0.0, 0.0);
    glass["extensions"] = json!({
        "KHR_materials_transmission": { "transmissionFactor": 0.75 },
        "KHR_materials_ior": { "ior": 1.33 },
        "KHR_materials_volume": { "thicknessFactor": 3, "attenuationDistance": 2, "attenuationColor": [0.5, 1, 1] },
    });
    let mut glow = pbr(0.0, 1.0);
    glow["emissiveFactor"] = json!([1, 0.5, 0]);
    glow["extensions"] =
        json!({ "KHR_materials_emissive_strength": { "emissiveStrength": 8 }, "KHR_materials_unlit": {} });
    let mut shiny = pbr(0.0, 0.5);
    shiny["extensions"] =
        json!({ "KHR_materials_specular": { "specularFactor": 0.5, "specularColorFactor": [1, 0, 1] } });
    let scene = materials(
        json!([
            pbr(1.0, 0.0),
            pbr(0.25, 0.0),
            pbr(0.0, 0.0),
            pbr(0.0, 1.0),
            pbr(0.0, 0.5),
            pbr(1.0, 0.5),
            {},
            glass,
            glow,
            shiny
        ]),
        json!({}),
    )
    .unwrap();
    let base_color = Vec3::new(0.5, 0.25, 1.0);
    let m = &scene.materials;
    assert_eq!(m[0], Material::mirror(base_color, 1.0));
    assert_eq!(m[1], Material::mirror(base_color, 0.25));
    assert_eq!(m[2], Material::lambert(base_color), "a polished dielectric is Lambert");
    assert_eq!(m[3], Material { shininess: 0.0, ..Material::lambert(base_color) });
    // r = 0.5: alpha = 2/r^4 - 2 = 30; F0 (1 - r) = 0.04 x 0.5.
    assert_eq!((m[4].diffuse, m[4].shininess), (1.0, 30.0));
    assert!((m[4].specular - Vec3::splat(0.02)).abs().max_element() < 1e-7);
    assert_eq!((m[5].diffuse, m[5].specular, m[5].mirror), (0.0, base_color, 0.0));
    // glTF's default: metal of roughness 1, a lobe that is Lambert's in all but name: (0 + 8)/(8 pi).
    assert_eq!((m[6].diffuse, m[6].specular, m[6].shininess), (0.0, Vec3::ONE, 0.0));
    let expected = Material {
        transmission: 0.75,
        attenuation_color: Vec3::new(0.5, 1.0, 1.0),
        attenuation_distance: 2.0,
        ..Material::glass(base_color, 1.33)
    };
    assert_eq!(m[7], expected);
    assert_eq!((m[8].emissive, m[8].unlit), (Vec3::new(8.0, 4.0, 0.0), true));
    assert!((m[9].specular - Vec3::new(0.01, 0.0, 0.01)).abs().max_element() < 1e-7);
    assert!(scene.report.has_light, "emission is light");
    assert!(scene.report.ignored.is_empty(), "{:?}", scene.report.ignored);

    for r in [0.2, 0.5, 0.9, 1.0] {
        assert!((roughness_from_shininess(shininess_from_roughness(r)) - r).abs() < 1e-5);
    }
    assert_eq!(shininess_from_roughness(1e-9), MAX_SHININESS);
}

#[test]
fn textures_from_data_uris_with_samplers_and_transforms() {
    // 2 x 1 texels: G 64 and 192, B 255 and 0.
    let image = image::RgbaImage::from_raw(2, 1, vec![255, 64, 255, 255, 0, 192, 0, 255]).unwrap();
    let mut png = std::io::Cursor::new(Vec::new());
    image.write_to(&mut png, image::ImageFormat::Png).unwrap();
    let hex: String = png.get_ref().iter().map(|b| format!("%{b:02x}")).collect();
    let uri = format!("data:image/png,{hex}");
    let info = json!({
        "index": 0, "texCoord": 1,
        "extensions": { "KHR_texture_transform": { "offset": [0.5, 0.25], "rotation": 0.5, "scale": [2, 3], "texCoord": 0 } },
    });
    let more = json!({
        "images": [{ "uri": uri }],
        "samplers": [{ "magFilter": 9728, "wrapS": 33071, "wrapT": 33648 }],
        "textures": [{ "source": 0, "sampler": 0 }],
    });
    let list = json!([
        { "pbrMetallicRoughness": { "baseColorTexture": info, "metallicRoughnessTexture": { "index": 0 }, "roughnessFactor": 0.5 } },
        { "emissiveTexture": { "index": 0 }, "emissiveFactor": [1, 1, 1] },
    ]);
    let scene = materials(list, more.clone()).unwrap();
    assert_eq!(scene.textures.len(), 1, "one image is decoded once");
    let m = &scene.materials[0];
    let r = m.base_color_texture.unwrap();
    assert_eq!((r.uv_set, r.nearest, r.wrap), (0, true, [Wrap::Clamp, Wrap::Mirror]));
    // Counter-clockwise in an image whose v points down: (1, 0) turns towards -v.
    let (sin, cos) = (0.5_f32.sin(), 0.5_f32.cos());
    let got = r.transform_uv(Vec2::X);
    assert!((got - Vec2::new(0.5 + 2.0 * cos, 0.25 - 2.0 * sin)).length() < 1e-6, "{got}");
    assert_eq!(scene.textures[0].texels(), [[255, 64, 255, 255], [0, 192, 0, 255]]);
    // Mean G = 128/255, mean B = 1/2; factors 0.5 and 1.
    let roughness: f32 = 0.5 * 128.0 / 255.0;
    assert!((m.diffuse - 0.5).abs() < 1e-6);
    assert!((m.shininess / shininess_from_roughness(roughness) - 1.0).abs() < 1e-4);
    assert_eq!(scene.report.ignored, ["metallicRoughnessTexture (its mean is used)"]);

    // Limits hold before a texel is decoded; a broken image costs only itself.
    let bytes_of = |more: &Value| {
        materials(json!([{ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }]), more.clone())
    };
    let mut broken = more.clone();
    broken["images"] = json!([{ "uri": "data:image/png;base64,iVBORw0KGgo=" }]);
    let scene = bytes_of(&broken).unwrap();
    assert!(scene.materials[0].base_color_texture.is_none() && scene.report.ignored[0].contains("image 0"));
    let mut far = more;
    far["images"] = json!([{ "uri": "https://example.org/x.png" }]);
    assert!(matches!(bytes_of(&far), Err(GltfError::Uri { .. })));
}

/// A PNG header that promises 60,000 x 60,000 texels is refused by the limit, without memory for them.
#[test]
fn picture_bombs_are_refused() {
    let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
    let mut header = Vec::new();
    header.extend(60_000_u32.to_be_bytes());
    header.extend(60_000_u32.to_be_bytes());
    header.extend([8, 6, 0, 0, 0]);
    png.extend(&header);
    let crc = !b"IHDR".iter().chain(&header).fold(!0_u32, |crc, b| {
        (0..8).fold(crc ^ u32::from(*b), |c, _| if c & 1 == 1 { c >> 1 ^ 0xEDB8_8320 } else { c >> 1 })
    });
    png.extend(crc.to_be_bytes());
    png.extend(b"\0\0\0\x01IDAT\0\0\0\0\0");
    let hex: String = png.iter().map(|b| format!("%{b:02x}")).collect();
    let result = materials(
        json!([{ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }]),
        json!({ "images": [{ "uri": format!("data:,{hex}") }], "textures": [{ "source": 0 }] }),
    );
    match result {
        Err(GltfError::Limit { what: "pixels of an image", value: 3_600_000_000, .. }) => {}
        other => panic!("{:?}", other.map(|s| s.report)),
    }
}

#[test]
fn extensions_are_refused_or_listed_by_name() {
    let with = |key: &str, name: &str| load(&glb(json!({ key: [name] }), &[]));
    for name in ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu", "MADE_UP"] {
        assert!(matches!(with("extensionsRequired", name), Err(GltfError::Extension(e)) if e == name));
        assert!(with("extensionsUsed", name).unwrap().report.ignored[0].contains(name));
    }
}

/// A morphed and a skinned mesh.
fn posed_file() -> Vec<u8> {
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

#[test]
fn morph_targets_and_skins_are_posed() {
    let scene = load(&posed_file()).unwrap();
    assert_eq!(scene.meshes[0].positions(), [Vec3::Z, Vec3::Y, Vec3::X]);
    assert_eq!(
        scene.meshes[1].positions(),
        [Vec3::new(0.0, 20.0, 0.0), Vec3::new(5.0, 11.0, 0.0), Vec3::new(6.0, 10.0, 0.0)]
    );
    // The node's own pose does not move a skinned mesh.
    assert_eq!(scene.bounds_world().max.x, 6.0);
}

/// Nodes with matrix, shear, negative and zero scale: the ECS poses everything as the flat scene does.
#[test]
fn spawned_entities_stand_where_the_file_says() {
    let json = json!({
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": { "KHR_lights_punctual": { "lights": [
            { "type": "spot", "intensity": 4, "color": [1, 0.5, 0.25], "spot": { "innerConeAngle": 0.25, "outerConeAngle": 0.5 } },
            { "type": "directional" },
        ]}},
        "scenes": [{ "nodes": [] }, { "nodes": [0, 4] }],
        "scene": 1,
        "nodes": [
            { "matrix": [1, 0, 0, 0, 0.5, 2, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1], "children": [1, 2], "mesh": 0 },
            { "rotation": [0, 0.6, 0, 0.8], "scale": [-1, 2, 3], "mesh": 0, "extensions": { "KHR_lights_punctual": { "light": 0 } } },
            { "translation": [1, 1, 1], "children": [3] },
            { "scale": [0, 1, 1], "mesh": 0 },
            { "camera": 0, "translation": [0, 0, 9], "extensions": { "KHR_lights_punctual": { "light": 1 } } },
        ],
        "cameras": [{ "type": "orthographic", "orthographic": { "xmag": 3, "ymag": 2, "zfar": 10, "znear": 0.5 } }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }, { "attributes": { "POSITION": 0 } }] }],
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3" }],
        "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
    });
    let scene = load(&glb(json, &floats(&RIBBON))).unwrap();
    assert_eq!(scene.meshes.len(), 1, "the same data is the same mesh");
    assert!(scene.report.has_camera && scene.report.has_light);
    assert_eq!((scene.report.instances, scene.report.triangles), (4, 4), "two of six have no volume");
    let flat = scene.to_render_scene(100);

    let mut app = new_app();
    // Assets that were there before keep their numbers.
    app.world_mut().resource_mut::<catoptra_engine::Assets>().add_material(Material::default());
    let spawned = scene.spawn(app.world_mut(), 100);
    settle(&mut app);
    let world = app.world_mut();
    assert_eq!(world.query::<(&MeshInstance, &Hidden)>().iter(world).count(), 2);
    let mut ids: Vec<u64> = world.query::<&StableId>().iter(world).map(|s| s.0).collect();
    ids.sort_unstable();
    assert_eq!(ids, (100..spawned.next_stable_id).collect::<Vec<_>>());

    let live = &world.resource::<Extracted>().0;
    assert_eq!(live.triangle_count(), flat.triangle_count());
    let close = |a: &Affine3, b: &Affine3| {
        let d = (a.matrix3 - b.matrix3).to_cols_array().into_iter().fold(0.0_f32, |m, v| m.max(v.abs()));
        d.max((a.translation - b.translation).length()) < 1e-5
    };
    for (a, b) in live.instances.iter().zip(&flat.instances) {
        assert_eq!((a.stable_id, a.material), (b.stable_id, b.material + 1));
        assert!(close(&a.world_from_object, &b.world_from_object), "{a:?} against {b:?}");
    }
    assert_eq!(live.instances[0].world_from_object.transform_point3(Vec3::Y).x, 5.5, "shear");
    for (a, b) in live.lights.iter().zip(&flat.lights) {
        assert_eq!((a.stable_id, a.kind, a.intensity), (b.stable_id, b.kind, b.intensity));
        assert!((a.direction_world - b.direction_world).length() < 1e-5);
    }
    assert_eq!(flat.lights[0].intensity, Vec3::new(4.0, 2.0, 1.0));
    assert!(close(&live.camera.world_from_view, &flat.camera.world_from_view));
    assert_eq!((live.camera.projection, live.camera.near), (Projection::Orthographic { half_height: 2.0 }, 0.5));

    // Despawning the root leaves nothing.
    app.world_mut().entity_mut(spawned.root).despawn();
    app.update();
    assert!(app.world().resource::<Extracted>().0.instances.is_empty());
}

fn cube() -> MeshData {
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
    }
}

/// A scene with every native field away from its default.
fn native_scene() -> RenderScene {
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
        textures: vec![Arc::new(Texture::new(3, 2, texels, true).unwrap())],
        materials,
        instances,
        lights: vec![
            light(LightKind::Point, 0.05, [10.0, 20.0, 30.1]),
            light(LightKind::Spot { cos_inner: 0.9, cos_outer: 0.7 }, 0.25, [0.001, 0.0, 0.002]),
            light(LightKind::Directional, 0.0, [0.0; 3]),
        ],
        camera: Camera { near: 0.03, ..Camera::looking_at(Vec3::new(3.0, 4.0, 5.0), Vec3::Y, 0.9) },
        environment: catoptra_engine::Environment { background: Vec3::new(0.1, 0.2, 0.3), ambient: Vec3::splat(0.05) },
        ..Default::default()
    }
}

#[test]
fn our_own_exports_reload_exactly() {
    let scene = native_scene();
    let bytes = export_glb_bytes(&scene).unwrap();
    let imported = load(&bytes).unwrap();
    assert!(imported.report.ignored.is_empty(), "{:?}", imported.report.ignored);
    let again = imported.to_render_scene(0);

    assert_eq!(again.materials, scene.materials);
    assert_eq!(again.textures, scene.textures);
    assert_eq!(again.environment, scene.environment);
    assert_eq!(again.instances.len(), scene.instances.len());
    for (a, b) in again.instances.iter().zip(&scene.instances) {
        assert_eq!((a.stable_id, a.material), (b.stable_id, b.material));
        if b.stable_id == 5 {
            // A sheared pose comes back as a product of two.
            let d = a.world_from_object.matrix3 - b.world_from_object.matrix3;
            assert!(d.to_cols_array().iter().all(|v| v.abs() < 1e-5), "{d:?}");
        } else {
            assert_eq!(a.world_from_object, b.world_from_object);
        }
        let (a, b) = (&again.meshes[a.mesh as usize], &scene.meshes[b.mesh as usize]);
        assert_eq!((a.positions(), a.normals(), a.triangles()), (b.positions(), b.normals(), b.triangles()));
        assert_eq!((a.uvs(), a.uvs1(), a.colors(), a.closed()), (b.uvs(), b.uvs1(), b.colors(), b.closed()));
    }
    assert_eq!(again.meshes.len(), 2, "instances of one mesh share it again");
    for (a, b) in again.lights.iter().zip(&scene.lights) {
        assert_eq!((a.kind, a.radius, a.position_world), (b.kind, b.radius, b.position_world));
        assert!((a.intensity - b.intensity).abs().max_element() <= 1e-6 * b.intensity.max_element(), "{a:?} {b:?}");
        assert!((a.direction_world - b.direction_world).length() < 1e-6);
        assert!((a.up_world - b.up_world).length() < 1e-6);
    }
    assert_eq!(again.camera.projection, scene.camera.projection);
    assert_eq!(again.camera.near, scene.camera.near);
    let d = again.camera.world_from_view.matrix3 - scene.camera.world_from_view.matrix3;
    assert!(d.to_cols_array().iter().all(|v| v.abs() < 1e-6));
    assert_eq!(again.camera.world_from_view.translation, scene.camera.world_from_view.translation);

    let twice = export_glb_bytes(&scene).unwrap();
    assert_eq!(bytes, twice, "the same scene is the same file");
}

/// Another reader finds no fault with what we write, and sees what the design promises other renderers.
#[test]
fn exports_are_valid_for_others() {
    let bytes = export_glb_bytes(&native_scene()).unwrap();
    let theirs = gltf::Gltf::from_slice(&bytes).unwrap();
    assert_eq!(theirs.lights().unwrap().count(), 3);
    assert_eq!(theirs.cameras().count(), 1);
    let materials: Vec<_> = theirs.materials().collect();
    assert_eq!(materials[2].transmission().unwrap().transmission_factor(), 1.0);
    assert_eq!(materials[2].ior(), Some(1.77));
    assert_eq!(materials[2].volume().unwrap().attenuation_distance(), 0.7);
    assert!(materials[8].volume().unwrap().thickness_factor() > 0.0, "closed clear glass is a volume");
    assert!(materials[3].volume().is_none(), "open glass is a thin wall");
    assert_eq!(materials[6].emissive_strength(), Some(512.0));
    assert!(theirs.images().all(|i| matches!(i.source(), gltf::image::Source::View { mime_type: "image/png", .. })));
    for mesh in theirs.meshes() {
        for p in mesh.primitives() {
            let reader = p.reader(|_| theirs.blob.as_deref());
            assert_eq!(reader.read_positions().unwrap().count(), 8);
            assert_eq!(reader.read_colors(0).unwrap().into_rgba_f32().count(), 8);
        }
    }
}

#[test]
fn scenes_that_are_not_valid_are_not_written() {
    let mut scene = native_scene();
    scene.instances[0].world_from_object.translation.x = f32::NAN;
    assert!(matches!(export_glb_bytes(&scene), Err(GltfError::Export(_))));
    // An empty scene is a valid file.
    let empty = load(&export_glb_bytes(&RenderScene::default()).unwrap()).unwrap();
    assert_eq!((empty.report.triangles, empty.report.has_camera), (0, true));
}

#[test]
fn lights_out_of_range_are_refused() {
    let light = |v: Value| {
        let json = json!({
            "extensions": { "KHR_lights_punctual": { "lights": [v] } },
            "nodes": [{ "extensions": { "KHR_lights_punctual": { "light": 0 } } }],
        });
        load(&glb(json, &[]))
    };
    let ok = light(json!({ "type": "point", "intensity": 3, "range": 5 })).unwrap();
    assert_eq!(
        ok.nodes[0].light,
        Some(LightSource { kind: LightKind::Point, intensity: Vec3::splat(3.0), radius: 0.0 })
    );
    assert_eq!(ok.report.ignored, ["range of lights"]);
    for bad in [
        json!({ "type": "laser" }),
        json!({ "type": "point", "intensity": -1 }),
        json!({ "type": "spot", "spot": { "innerConeAngle": 1, "outerConeAngle": 0.5 } }),
        json!({ "type": "spot", "spot": { "outerConeAngle": 3 } }),
    ] {
        assert!(light(bad.clone()).unwrap_err().to_string().contains("light 0"), "{bad}");
    }
}

/// All places of a JSON value, as JSON pointers.
fn pointers(value: &Value, at: String, out: &mut Vec<String>) {
    match value {
        Value::Object(map) => map.iter().for_each(|(k, v)| pointers(v, format!("{at}/{k}"), out)),
        Value::Array(list) => list.iter().enumerate().for_each(|(i, v)| pointers(v, format!("{at}/{i}"), out)),
        _ => {}
    }
    out.push(at);
}

/// Every value of rich, valid files replaced by hostile ones: whatever still loads is a valid scene.
#[test]
fn hostile_values_are_harmless() {
    let hostile = [
        json!(null),
        json!(0),
        json!(1),
        json!(2),
        json!(-1),
        json!(255),
        json!(65536),
        json!(4294967295_u64),
        json!(4294967296_u64),
        json!(u64::MAX),
        json!(i64::MIN),
        json!(0.5),
        json!(-1e-40),
        json!(1e30),
        json!(1e39),
        json!(1e308),
        json!(""),
        json!("MAT4"),
        json!("SCALAR"),
        json!([]),
        json!({}),
        json!([0, 0, 0]),
        json!(true),
    ];
    // Tight limits keep wrong counts from costing time; the point is what happens around them.
    let limits = ImportLimits { vertices: 4096, triangles: 4096, image_pixels: 4096, ..Default::default() };
    let (mut loaded, mut refused) = (0, 0);
    for bytes in [export_glb_bytes(&native_scene()).unwrap(), posed_file()] {
        let json_length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let json: Value = serde_json::from_slice(&bytes[20..20 + json_length]).unwrap();
        let bin = &bytes[28 + json_length..];
        let mut places = Vec::new();
        pointers(&json, String::new(), &mut places);
        for place in places.iter().filter(|p| !p.is_empty()) {
            for value in &hostile {
                let mut broken = json.clone();
                *broken.pointer_mut(place).unwrap() = value.clone();
                let result = if place.starts_with("/buffers") || place.starts_with("/asset") {
                    let mut whole = b"glTF".to_vec();
                    let mut text = serde_json::to_vec(&broken).unwrap();
                    text.resize(text.len().next_multiple_of(4), b' ');
                    whole.extend(2_u32.to_le_bytes());
                    whole.extend((28 + text.len() as u32 + bin.len() as u32).to_le_bytes());
                    whole.extend((text.len() as u32).to_le_bytes());
                    whole.extend(b"JSON");
                    whole.extend(&text);
                    whole.extend((bin.len() as u32).to_le_bytes());
                    whole.extend(b"BIN\0");
                    whole.extend(bin);
                    load_gltf_bytes(&whole, None, &limits)
                } else {
                    load_gltf_bytes(&glb(broken, bin), None, &limits)
                };
                match result {
                    Ok(scene) => {
                        scene.to_render_scene(0).validate().unwrap_or_else(|e| panic!("{place} = {value}: {e}"));
                        loaded += 1;
                    }
                    Err(error) => {
                        assert!(!error.to_string().contains('\n'), "{error}");
                        refused += 1;
                    }
                }
            }
        }
    }
    println!("{loaded} loaded, {refused} refused");
    assert!(loaded > 1000 && refused > 1000, "{loaded} loaded, {refused} refused");
}
