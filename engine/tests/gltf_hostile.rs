//! Contract: hostile files are refused with the place and the limit by name, or load as valid scenes; nothing panics.

mod gltf_common;

use catoptra_engine::{
    ImportLimits,
    gltf::{GltfError, export_glb_bytes},
    load_gltf, load_gltf_bytes,
};
use gltf_common::{RIBBON, floats, glb, indexed, load, materials, native_scene, posed_file};
use serde_json::{Value, json};

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
