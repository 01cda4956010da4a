//! What files of other writers hold beside the samples: odd encodings, old and rare extensions, fallbacks. Each loads with
//! the geometry, pose or look that it means, or is refused by name.

mod gltf_common;

use catoptra_engine::{
    Extracted, ImportLimits, ImportedScene, Material, Mip, Projection, app, gltf::GltfError, load_gltf, load_gltf_bytes,
};
use glam::{Quat, Vec2, Vec3, Vec4};
use gltf_common::{RIBBON, floats, glb, load, materials};
use serde_json::{Value, json};
use std::path::PathBuf;

/// One triangle over the first 36 bytes of `bin`; `change` may turn it into anything.
fn triangle(mut bin: Vec<u8>, change: impl FnOnce(&mut Value)) -> Vec<u8> {
    let first = floats(&RIBBON[..9]);
    bin.splice(0..0, first);
    let mut json = json!({
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3" }],
        "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
    });
    change(&mut json);
    glb(json, &bin)
}

/// Appends to a list of the document; returns the number of what was appended.
fn push(json: &mut Value, list: &str, value: Value) -> usize {
    let list = json.as_object_mut().unwrap().entry(list).or_insert(json!([])).as_array_mut().unwrap();
    list.push(value);
    list.len() - 1
}

/// Number of an accessor over `length` bytes from `offset` on.
fn accessor(
    json: &mut Value,
    offset: usize,
    length: usize,
    component: u32,
    kind: &str,
    count: usize,
    normalized: bool,
) -> usize {
    let view = push(json, "bufferViews", json!({ "buffer": 0, "byteOffset": offset, "byteLength": length }));
    push(
        json,
        "accessors",
        json!({ "bufferView": view, "componentType": component, "type": kind, "count": count, "normalized": normalized }),
    )
}

fn corners(scene: &ImportedScene) -> Vec<[Vec3; 3]> {
    let poses = scene.instances();
    poses
        .iter()
        .flat_map(|(p, m)| {
            let mesh = &scene.meshes[p.mesh];
            (0..mesh.triangles().len() as u32)
                .map(|t| mesh.corners(t).map(|v| m.transform_point3(v)))
                .collect::<Vec<_>>()
        })
        .collect()
}

fn folder(name: &str) -> PathBuf {
    let path = std::env::temp_dir().join(format!("catoptra-variety-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&path).unwrap();
    path
}

fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    bytes
        .chunks(3)
        .map(|c| {
            let n = c.iter().fold(0_u32, |n, b| n << 8 | u32::from(*b)) << (8 * (3 - c.len()));
            let digit = |i: usize| if i <= c.len() { LETTERS[(n >> (18 - 6 * i) & 63) as usize] as char } else { '=' };
            [0, 1, 2, 3].map(digit).iter().collect::<String>()
        })
        .collect()
}

/// The triangle as JSON alone, its buffer at `uri`.
fn text(uri: &str) -> String {
    json!({
        "asset": { "version": "2.0", "generator": "hand" },
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0] }],
        "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
        "buffers": [{ "uri": uri, "byteLength": 36 }],
    })
    .to_string()
}

const TRIANGLE: [Vec3; 3] = [Vec3::ZERO, Vec3::Y, Vec3::X];

#[test]
fn buffers_in_the_text_and_files_of_odd_names() {
    let bytes = floats(&RIBBON[..9]);
    for media in ["application/octet-stream", "application/gltf-buffer", ""] {
        let uri = format!("data:{media};base64,{}", base64(&bytes));
        assert_eq!(corners(&load(text(&uri).as_bytes()).unwrap()), [TRIANGLE], "{media:?}");
    }
    let folder = folder("names");
    std::fs::create_dir_all(folder.join("sub dir")).unwrap();
    for (file, uri) in [
        ("a b.bin", "a%20b.bin"),
        ("a b.bin", "a b.bin"),
        ("grün.bin", "gr%C3%BCn.bin"),
        ("grün.bin", "grün.bin"),
        ("100%.bin", "100%25.bin"),
        ("sub dir/x.bin", "./sub%20dir/../sub%20dir/x.bin"),
        ("sub dir/x.bin", "sub dir\\x.bin"),
    ] {
        std::fs::write(folder.join(file), &bytes).unwrap();
        let path = folder.join("scene.gltf");
        std::fs::write(&path, text(uri)).unwrap();
        let scene = load_gltf(&path, &ImportLimits::default()).unwrap_or_else(|e| panic!("{uri}: {e}"));
        assert_eq!(corners(&scene), [TRIANGLE], "{uri}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn byte_order_marks_and_blanks_before_the_text() {
    let uri = format!("data:;base64,{}", base64(&floats(&RIBBON[..9])));
    let plain = text(&uri);
    for prefix in ["\u{feff}", "\r\n \t", "\u{feff}\n"] {
        assert_eq!(corners(&load(format!("{prefix}{plain}").as_bytes()).unwrap()), [TRIANGLE], "{prefix:?}");
    }
    // The same mark inside a GLB's chunk.
    let mut json = format!("\u{feff}{plain}").into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut file = b"glTF".to_vec();
    [2, 20 + json.len() as u32, json.len() as u32].iter().for_each(|w| file.extend(w.to_le_bytes()));
    file.extend(b"JSON");
    file.extend(&json);
    assert_eq!(corners(&load(&file).unwrap()), [TRIANGLE]);
    // Chunks that nobody knows, and bytes behind the end, are skipped.
    let mut file = triangle(Vec::new(), |_| {});
    file.extend([4, 0, 0, 0]);
    file.extend(b"ZZZZ1234");
    let length = file.len() as u32;
    file[8..12].copy_from_slice(&length.to_le_bytes());
    file.extend(b"trailing");
    assert_eq!(corners(&load(&file).unwrap()), [TRIANGLE]);
}

#[test]
fn none_and_many_scenes() {
    let nodes = json!([{ "mesh": 0, "children": [1] }, { "mesh": 0, "translation": [5, 0, 0] }, { "mesh": 0, "translation": [0, 7, 0] }]);
    let count = |scenes: Option<Value>, scene: Option<u32>| {
        load(&triangle(Vec::new(), |j| {
            j["nodes"] = nodes.clone();
            if let Some(s) = scenes {
                j["scenes"] = s;
            }
            if let Some(s) = scene {
                j["scene"] = json!(s);
            }
        }))
        .map(|s| s.report.instances)
        .map_err(|e| e.to_string())
    };
    assert_eq!(count(None, None), Ok(3), "a library: all of it");
    assert_eq!(count(Some(json!([])), None), Ok(3));
    assert_eq!(count(Some(json!([{}])), None), Ok(0), "an empty scene");
    let many = json!([{ "nodes": [2] }, { "nodes": [0] }, { "nodes": [0, 2], "name": "both" }]);
    assert_eq!([None, Some(0), Some(1), Some(2)].map(|n| count(Some(many.clone()), n)), [Ok(1), Ok(1), Ok(2), Ok(3)]);
    assert!(count(Some(many), Some(9)).unwrap_err().contains("scene 9"));
    // Nothing at all is a file too.
    assert_eq!(load(br#"{"asset":{"version":"2.0"}}"#).unwrap().report.instances, 0);
    assert_eq!(load(&triangle(Vec::new(), |j| j["meshes"][0]["primitives"] = json!([]))).unwrap().report.triangles, 0);
}

#[test]
fn cameras_without_what_may_be_left_out() {
    let camera = |v: Value| {
        load(&triangle(Vec::new(), |j| {
            j["cameras"] = json!([v]);
            j["nodes"][0]["camera"] = json!(0);
        }))
    };
    let bare = camera(json!({ "type": "perspective", "perspective": { "yfov": 0.75, "znear": 0.25 } })).unwrap();
    let lens = bare.nodes[0].camera.unwrap();
    assert_eq!((lens.projection, lens.near), (Projection::Perspective { fov_y: 0.75 }, 0.25));
    let infinite = json!({ "type": "perspective", "perspective": { "yfov": 0.75, "znear": 0.25, "zfar": 1e30, "aspectRatio": 2.5 } });
    assert_eq!(camera(infinite).unwrap().nodes[0].camera, Some(lens));
    let flipped = json!({ "type": "orthographic", "orthographic": { "xmag": -1, "ymag": -3, "zfar": 9, "znear": 0 } });
    assert_eq!(
        camera(flipped).unwrap().nodes[0].camera.unwrap().projection,
        Projection::Orthographic { half_height: 3.0 }
    );
    for bad in [
        json!({ "type": "perspective", "perspective": { "yfov": 0, "znear": 1 } }),
        json!({ "type": "orthographic", "orthographic": { "xmag": 1, "ymag": 0, "zfar": 9, "znear": 0 } }),
        json!({ "type": "fisheye" }),
        json!({ "type": "perspective" }),
    ] {
        assert!(camera(bad.clone()).unwrap_err().to_string().contains("camera 0"), "{bad}");
    }
}

#[test]
fn quantised_attributes_in_every_permitted_form() {
    // Positions in five types, plain and normalised, under the node's scale; the triangle is the same.
    for (component, size, one, normalized) in [
        (5120, 1, 127_i32, true),
        (5121, 1, 255, true),
        (5122, 2, 32767, true),
        (5123, 2, 65535, true),
        (5120, 1, 1, false),
        (5122, 2, 1, false),
        (5123, 2, 1, false),
    ] {
        let mut bin = Vec::new();
        for v in TRIANGLE.iter().flat_map(|v| v.to_array()) {
            bin.extend(&(v as i32 * one).to_le_bytes()[..size]);
        }
        let length = bin.len();
        let file = triangle(bin, |j| {
            j["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
            let a = accessor(j, 36, length, component, "VEC3", 3, normalized);
            j["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(a);
            j["nodes"][0]["scale"] = json!([2, 2, 2]);
        });
        assert_eq!(corners(&load(&file).unwrap()), [TRIANGLE.map(|v| v * 2.0)], "{component} {normalized}");
    }
    // Normals and tangents of bytes, coordinates of whole texels under a transform.
    let mut bin = [0, 0, 127, 0].repeat(3); // normals with a stride of 4
    bin.extend([127_u8, 0, 0, 129].repeat(3)); // tangents, handedness -127/127
    bin.extend([0_u16, 0, 0, 512, 1024, 0].iter().flat_map(|v| v.to_le_bytes()));
    let file = triangle(bin, |j| {
        let view = push(j, "bufferViews", json!({ "buffer": 0, "byteOffset": 36, "byteLength": 12, "byteStride": 4 }));
        let n = push(
            j,
            "accessors",
            json!({ "bufferView": view, "componentType": 5120, "type": "VEC3", "count": 3, "normalized": true }),
        );
        let t = accessor(j, 48, 12, 5120, "VEC4", 3, true);
        let uv = accessor(j, 60, 12, 5123, "VEC2", 3, false);
        let attributes = &mut j["meshes"][0]["primitives"][0]["attributes"];
        (attributes["NORMAL"], attributes["TANGENT"], attributes["TEXCOORD_0"]) = (json!(n), json!(t), json!(uv));
        j["meshes"][0]["primitives"][0]["material"] = json!(0);
        let scale = json!({ "KHR_texture_transform": { "scale": [0.0009765625, 0.001953125] } });
        j["materials"] = json!([{ "normalTexture": { "index": 0, "extensions": scale } }]);
        j["textures"] = json!([{ "source": 0 }]);
        j["images"] = json!([{ "uri": one_texel() }]);
    });
    let scene = load(&file).unwrap();
    let mesh = &scene.meshes[0];
    assert_eq!((mesh.normals()[0], mesh.tangents()[2]), (Vec3::Z, Vec4::new(1.0, 0.0, 0.0, -1.0)));
    let r = scene.materials[0].normal_texture.unwrap();
    assert_eq!([0, 1, 2].map(|i| r.transform_uv(mesh.uvs()[i])), [Vec2::ZERO, Vec2::Y, Vec2::X]);
}

fn one_texel() -> String {
    png_uri(image::DynamicImage::ImageRgba8(image::RgbaImage::from_raw(1, 1, vec![128, 128, 255, 255]).unwrap()))
}

fn png_uri(image: image::DynamicImage) -> String {
    let mut out = std::io::Cursor::new(Vec::new());
    image.write_to(&mut out, image::ImageFormat::Png).unwrap();
    format!("data:image/png;base64,{}", base64(out.get_ref()))
}

#[test]
fn pictures_of_every_depth_and_channel_count() {
    use image::{DynamicImage as D, ImageBuffer as B};
    let forms: [(D, [u8; 4]); 6] = [
        (D::ImageLuma8(B::from_raw(1, 1, vec![77]).unwrap()), [77, 77, 77, 255]),
        (D::ImageLumaA8(B::from_raw(1, 1, vec![77, 9]).unwrap()), [77, 77, 77, 9]),
        (D::ImageRgb8(B::from_raw(1, 1, vec![1, 2, 3]).unwrap()), [1, 2, 3, 255]),
        (D::ImageLuma16(B::from_raw(1, 1, vec![77 * 257]).unwrap()), [77, 77, 77, 255]),
        (D::ImageRgb16(B::from_raw(1, 1, vec![257, 514, 771]).unwrap()), [1, 2, 3, 255]),
        (D::ImageRgba16(B::from_raw(1, 1, vec![257, 514, 771, 1028]).unwrap()), [1, 2, 3, 4]),
    ];
    let textured = |image: Value| {
        let list = json!([{ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }]);
        materials(list, json!({ "images": [image], "textures": [{ "source": 0 }] })).unwrap()
    };
    for (image, texel) in forms {
        let scene = textured(json!({ "uri": png_uri(image) }));
        assert_eq!(scene.textures[0].texels(), [texel]);
    }
    // A type that contradicts the bytes: the bytes are right.
    let wrong = textured(json!({ "uri": one_texel().replace("image/png", "image/jpeg"), "mimeType": "image/jpeg" }));
    assert_eq!(wrong.textures.len(), 1);
    let gif = textured(json!({ "uri": format!("data:image/gif;base64,{}", base64(b"GIF89a\x01\0\x01\0")) }));
    assert!(
        gif.textures.is_empty() && gif.report.ignored[0].contains("neither PNG, JPEG nor WebP"),
        "{:?}",
        gif.report.ignored
    );
}

#[test]
fn textures_with_and_without_a_fallback() {
    for name in ["KHR_texture_basisu", "EXT_texture_avif", "MSFT_texture_dds"] {
        let scene = |fallback: bool, required: bool| {
            let mut texture = json!({ "extensions": { name: { "source": 1 } } });
            if fallback {
                texture["source"] = json!(0);
            }
            let mut more = json!({
                "extensionsUsed": [name],
                "images": [{ "uri": one_texel() }, { "uri": "data:image/x;base64,AAAA" }],
                "textures": [texture],
            });
            if required {
                more["extensionsRequired"] = json!([name]);
            }
            materials(json!([{ "emissiveFactor": [1, 1, 1], "emissiveTexture": { "index": 0 } }]), more)
        };
        let with = scene(true, false).unwrap();
        assert!(with.materials[0].emissive_texture.is_some(), "{name}: the fallback is shown");
        assert_eq!(with.report.ignored, [format!("extension {name}")]);
        let without = scene(false, false).unwrap();
        assert!(without.materials[0].emissive_texture.is_none());
        assert!(
            without.report.ignored.iter().any(|i| i.contains("whose image only") && i.contains(name)),
            "{:?}",
            without.report.ignored
        );
        assert!(matches!(scene(true, true), Err(GltfError::Extension(e)) if e == name));
    }
}

#[test]
fn samplers_say_which_copies_are_read() {
    let filters = [
        (None, false, Mip::Linear),
        (Some(9728), true, Mip::None),
        (Some(9729), false, Mip::None),
        (Some(9984), true, Mip::Nearest),
        (Some(9985), false, Mip::Nearest),
        (Some(9986), true, Mip::Linear),
        (Some(9987), false, Mip::Linear),
    ];
    let with = |min: Option<u32>| {
        let mut sampler = json!({});
        if let Some(min) = min {
            sampler["minFilter"] = json!(min);
        }
        let more = json!({ "images": [{ "uri": one_texel() }], "samplers": [sampler], "textures": [{ "source": 0, "sampler": 0 }] });
        materials(json!([{ "emissiveFactor": [1, 1, 1], "emissiveTexture": { "index": 0 } }]), more)
    };
    for (code, nearest_min, mip) in filters {
        let r = with(code).unwrap().materials[0].emissive_texture.unwrap();
        assert_eq!((r.nearest, r.nearest_min, r.mip), (false, nearest_min, mip), "{code:?}");
    }
    assert!(with(Some(1)).unwrap_err().to_string().contains("minFilter 1"));
}

#[test]
fn old_and_rare_material_extensions() {
    let used = |name: &str, required: bool, material: Value| {
        let mut more = json!({ "extensionsUsed": [name] });
        if required {
            more["extensionsRequired"] = json!([name]);
        }
        materials(json!([material]), more)
    };
    // Variants: the default is shown, even where the file requires them.
    let red = json!({ "pbrMetallicRoughness": { "baseColorFactor": [1, 0, 0, 1], "metallicFactor": 0 } });
    let scene = used("KHR_materials_variants", true, red.clone()).unwrap();
    assert_eq!(scene.materials[0].base_color, Vec3::X);
    assert_eq!(scene.report.ignored, ["extension KHR_materials_variants"]);
    for name in
        ["anisotropy", "clearcoat", "diffuse_transmission", "dispersion", "iridescence", "sheen", "volume_scatter"]
    {
        let name = format!("KHR_materials_{name}");
        let mut material = red.clone();
        material["extensions"] = json!({ &name: { "sheenColorFactor": [1, 1, 1], "clearcoatFactor": 1 } });
        for required in [false, true] {
            let scene = used(&name, required, material.clone()).unwrap();
            assert_eq!(scene.report.ignored, [format!("extension {name}")]);
            assert_eq!(scene.materials[0].base_color, Vec3::X);
        }
    }
    // The old model: colour, gloss and highlight, with a texture of its own.
    let old = json!({ "extensions": { "KHR_materials_pbrSpecularGlossiness": {
        "diffuseFactor": [0.5, 1, 1, 0.25], "diffuseTexture": { "index": 0 }, "specularFactor": [0.02, 0.04, 0.06], "glossinessFactor": 0.5,
    }}, "alphaMode": "BLEND" });
    let more = json!({ "extensionsRequired": ["KHR_materials_pbrSpecularGlossiness"], "images": [{ "uri": one_texel() }], "textures": [{ "source": 0 }] });
    let m = materials(json!([old]), more).unwrap().materials[0];
    assert!(m.base_color_texture.is_some() && m.thin);
    assert!(
        (m.transmission - 0.75).abs() < 1e-6 && (m.specular - Vec3::new(0.01, 0.02, 0.03) * 0.25).length() < 1e-6,
        "{m:?}"
    );
    // Glass by texture and metal by texture stay with the material.
    let both = json!([{
        "pbrMetallicRoughness": { "metallicRoughnessTexture": { "index": 0 }, "roughnessFactor": 0.5 },
        "extensions": { "KHR_materials_transmission": { "transmissionFactor": 0.5, "transmissionTexture": { "index": 0 } } },
    }]);
    let more = json!({ "images": [{ "uri": one_texel() }], "textures": [{ "source": 0 }] });
    let scene = materials(both, more).unwrap();
    let p = scene.materials[0].physical.unwrap();
    assert_eq!((p.metallic, p.roughness, p.transmission, p.blended), (1.0, 0.5, 0.5, false));
    assert!(p.metallic_roughness_texture.is_some() && p.transmission_texture.is_some());
    assert_eq!(scene.textures.len(), 1);
    assert_eq!(scene.materials[0], Material { physical: Some(p), ..scene.materials[0] });
}

#[test]
fn copies_of_a_mesh_by_instancing() {
    let mut bin = floats(&[1.0, 0.0, 0.0, 0.0, 2.0, 0.0]); // translations
    bin.extend([0_i16, 0, 32767, 0, 0, 0, 0, 32767].iter().flat_map(|v| v.to_le_bytes())); // half a turn round z; none
    bin.extend(floats(&[1.0, 1.0, 1.0, 3.0, 3.0, 3.0]));
    let file = |count: usize| {
        triangle(bin.clone(), |j| {
            j["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
            let t = accessor(j, 36, 24, 5126, "VEC3", 2, false);
            let r = accessor(j, 60, 16, 5122, "VEC4", 2, true);
            let s = accessor(j, 76, 12 * count, 5126, "VEC3", count, false);
            let copies = json!({ "attributes": { "TRANSLATION": t, "ROTATION": r, "SCALE": s, "_ID": 0 } });
            j["nodes"][0]["extensions"] = json!({ "EXT_mesh_gpu_instancing": copies });
            j["nodes"][0]["translation"] = json!([0, 0, 10]);
        })
    };
    let scene = load(&file(2)).unwrap();
    let near = |got: [Vec3; 3], expected: [Vec3; 3]| got.iter().zip(expected).all(|(a, b)| (*a - b).length() < 1e-5);
    let all = corners(&scene);
    assert_eq!((all.len(), scene.meshes.len(), scene.report.instances), (2, 1, 2));
    let first = TRIANGLE.map(|p| Quat::from_rotation_z(std::f32::consts::PI) * p + Vec3::new(1.0, 0.0, 10.0));
    assert!(near(all[0], first) && near(all[1], TRIANGLE.map(|p| p * 3.0 + Vec3::new(0.0, 2.0, 10.0))), "{all:?}");
    let error = load(&file(1)).unwrap_err().to_string();
    assert!(error.contains("[2, 2, 1] elements") || error.contains("elements"), "{error}");
    let few = ImportLimits { instances: 1, ..Default::default() };
    assert!(matches!(load_gltf_bytes(&file(2), None, &few), Err(GltfError::Limit { what: "instances", .. })));
}

#[test]
fn sparse_targets_without_a_buffer() {
    // A target that moves one vertex only: zeros but for one sparse entry.
    let mut bin = floats(&[0.0, 0.0, 8.0]);
    bin.extend([2_u8]);
    let file = triangle(bin, |j| {
        let values = push(j, "bufferViews", json!({ "buffer": 0, "byteOffset": 36, "byteLength": 12 }));
        let indices = push(j, "bufferViews", json!({ "buffer": 0, "byteOffset": 48, "byteLength": 1 }));
        let target = push(
            j,
            "accessors",
            json!({ "componentType": 5126, "type": "VEC3", "count": 3, "sparse": {
            "count": 1, "indices": { "bufferView": indices, "componentType": 5121 }, "values": { "bufferView": values } } }),
        );
        j["meshes"][0]["primitives"][0]["targets"] = json!([{ "POSITION": target }]);
        j["meshes"][0]["weights"] = json!([0.5]);
    });
    assert_eq!(corners(&load(&file).unwrap()), [[Vec3::ZERO, Vec3::Y, Vec3::new(1.0, 0.0, 4.0)]]);
}

#[test]
fn interleaved_skins_without_bind_matrices() {
    // Joints as bytes and weights as normalised bytes, one beside the other.
    let mut bin = Vec::new();
    for (joints, weights) in
        [([0_u8, 1, 0, 0], [255_u8, 0, 0, 0]), ([1, 0, 0, 0], [255, 0, 0, 0]), ([0, 1, 0, 0], [51, 204, 0, 0])]
    {
        bin.extend(joints);
        bin.extend(weights);
    }
    let file = triangle(bin, |j| {
        let view = push(j, "bufferViews", json!({ "buffer": 0, "byteOffset": 36, "byteLength": 24, "byteStride": 8 }));
        let joints =
            push(j, "accessors", json!({ "bufferView": view, "componentType": 5121, "type": "VEC4", "count": 3 }));
        let weights = push(
            j,
            "accessors",
            json!({ "bufferView": view, "byteOffset": 4, "componentType": 5121, "type": "VEC4", "count": 3, "normalized": true }),
        );
        let attributes = &mut j["meshes"][0]["primitives"][0]["attributes"];
        (attributes["JOINTS_0"], attributes["WEIGHTS_0"]) = (json!(joints), json!(weights));
        j["skins"] = json!([{ "joints": [1, 2], "skeleton": 1 }]);
        j["nodes"] = json!([{ "mesh": 0, "skin": 0 }, { "translation": [0, 0, 1], "children": [2] }, { "translation": [10, 0, 0] }]);
    });
    let [a, b, c] = corners(&load(&file).unwrap())[0];
    assert_eq!((a, b), (Vec3::Z, Vec3::new(10.0, 1.0, 1.0)));
    assert!((c - Vec3::new(1.0 + 8.0, 0.0, 1.0)).length() < 1e-5, "{c}");
}

#[test]
fn third_and_later_coordinate_sets() {
    let sets: Vec<f32> = (0..4).flat_map(|set| (0..6).map(move |i| (10 * set + i) as f32)).collect();
    let build = |info: Value| {
        triangle(floats(&sets), |j| {
            for set in 0..4 {
                let a = accessor(j, 36 + 24 * set, 24, 5126, "VEC2", 3, false);
                j["meshes"][0]["primitives"][0]["attributes"][format!("TEXCOORD_{set}")] = json!(a);
            }
            j["meshes"][0]["primitives"][0]["material"] = json!(0);
            j["materials"] = json!([info]);
            j["textures"] = json!([{ "source": 0 }]);
            j["images"] = json!([{ "uri": one_texel() }]);
        })
    };
    let base = |set: u32| json!({ "baseColorTexture": { "index": 0, "texCoord": set }, "metallicFactor": 0 });
    let scene =
        load(&build(json!({ "pbrMetallicRoughness": base(3), "emissiveTexture": { "index": 0, "texCoord": 2 } })))
            .unwrap();
    let (mesh, m) = (&scene.meshes[0], &scene.materials[0]);
    assert_eq!((mesh.uvs()[0].x, mesh.uvs1()[0].x), (20.0, 30.0));
    assert_eq!((m.base_color_texture.unwrap().uv_set, m.emissive_texture.unwrap().uv_set), (1, 0));
    assert!(
        scene.report.ignored.iter().all(|i| i.contains("TEXCOORD_0") || i.contains("TEXCOORD_1")),
        "{:?}",
        scene.report.ignored
    );
    // Of three sets the two lowest are kept; the third is told.
    let three = json!({ "pbrMetallicRoughness": base(0), "emissiveTexture": { "index": 0, "texCoord": 2 }, "normalTexture": { "index": 0, "texCoord": 3 } });
    let scene = load(&build(three)).unwrap();
    assert_eq!((scene.meshes[0].uvs()[0].x, scene.meshes[0].uvs1()[0].x), (0.0, 20.0));
    assert!(
        scene.materials[0].normal_texture.is_none()
            && scene.report.ignored.iter().any(|i| i.contains("TEXCOORD_3, a third set"))
    );
}

#[test]
fn one_of_several_animations_is_chosen() {
    let mut bin = floats(&[0.0, 1.0]);
    bin.extend(floats(&[0.0, 0.0, 0.0, 6.0, 0.0, 0.0]));
    bin.extend(floats(&[0.0, 0.0, 0.0, 0.0, 6.0, 0.0]));
    let file = triangle(bin, |j| {
        let times = accessor(j, 36, 8, 5126, "SCALAR", 2, false);
        let [x, y] = [44, 68].map(|at| accessor(j, at, 24, 5126, "VEC3", 2, false));
        let clip = |name: Value, output: usize, node: u32| {
            json!({ "name": name, "samplers": [{ "input": times, "output": output }],
            "channels": [{ "sampler": 0, "target": { "node": node, "path": "translation" } }] })
        };
        j["nodes"] = json!([{ "mesh": 0, "translation": [0, 0, 3] }, { "mesh": 0 }]);
        j["animations"] = json!([clip(json!("right"), x, 0), clip(json!("up"), y, 0), clip(json!(null), y, 1)]);
    });
    let scene = load(&file).unwrap();
    assert!(scene.report.ignored.is_empty(), "{:?}", scene.report.ignored);
    assert_eq!(scene.animations.len(), 3);
    assert_eq!([scene.animation_named("up"), scene.animation_named("down")], [Some(1), None]);
    let mut app = app::new_app();
    let spawned = scene.spawn(app.world_mut(), 0);
    app::settle(&mut app);
    app::advance(&mut app, 30);
    let places = |app: &catoptra_engine::bevy_app::App| {
        app.world()
            .resource::<Extracted>()
            .0
            .instances
            .iter()
            .map(|i| i.world_from_object.translation)
            .collect::<Vec<_>>()
    };
    assert_eq!(places(&app), [Vec3::new(3.0, 0.0, 0.0), Vec3::ZERO], "the first plays");
    scene.play(app.world_mut(), &spawned, scene.animation_named("up"));
    app::advance(&mut app, 1);
    assert!((places(&app)[0] - Vec3::new(0.0, 6.0 * 31.0 / 60.0, 0.0)).length() < 1e-5);
    scene.play(app.world_mut(), &spawned, Some(2));
    app::advance(&mut app, 1);
    let now = places(&app);
    assert!(now[0] == Vec3::new(0.0, 0.0, 3.0) && now[1].y > 3.0, "back to the file's pose, the other moves: {now:?}");
    scene.play(app.world_mut(), &spawned, None);
    app::advance(&mut app, 9);
    assert_eq!(places(&app), [Vec3::new(0.0, 0.0, 3.0), Vec3::ZERO]);
}

#[test]
fn hidden_nodes_hide_what_hangs_on_them() {
    let hidden = json!({ "KHR_node_visibility": { "visible": false } });
    let file = |nodes: Value| {
        triangle(Vec::new(), |j| {
            j["extensionsRequired"] = json!(["KHR_node_visibility"]);
            j["extensions"] = json!({ "KHR_lights_punctual": { "lights": [{ "type": "point" }] } });
            j["nodes"] = nodes;
            j["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 1, "znear": 0.1 } }]);
        })
    };
    let lamp = json!({ "KHR_lights_punctual": { "light": 0 } });
    // Mesh, lamp and camera twice, once below a hidden node.
    let nodes = json!([
        { "children": [1, 2], "extensions": hidden },
        { "mesh": 0, "extensions": lamp },
        { "camera": 0, "extensions": { "KHR_node_visibility": { "visible": true } } },
        { "mesh": 0, "translation": [5, 0, 0], "extensions": lamp },
        { "camera": 0, "translation": [0, 0, 7] },
    ]);
    let scene = load(&file(nodes.clone())).unwrap();
    assert!(scene.report.ignored.is_empty(), "{:?}", scene.report.ignored);
    assert_eq!((scene.report.instances, scene.report.has_light, scene.report.has_camera), (1, true, true));
    let still = scene.to_render_scene(1);
    assert_eq!((still.instances.len(), still.lights.len()), (1, 1));
    assert_eq!(still.instances[0].world_from_object.translation, Vec3::X * 5.0);
    assert_eq!(still.camera.world_from_view.translation, Vec3::Z * 7.0);
    assert_eq!(scene.camera().unwrap().world_from_view.translation, Vec3::Z * 7.0);
    // As entities they are there, hidden; shown again, all is.
    let mut app = catoptra_engine::app::new_app();
    let spawned = scene.spawn(app.world_mut(), 1);
    let drawn = |app: &mut bevy_app::App| {
        catoptra_engine::app::settle(app);
        let scene = &app.world().resource::<catoptra_engine::Extracted>().0;
        (scene.instances.clone(), scene.lights.len())
    };
    assert_eq!(drawn(&mut app), (still.instances.clone(), 1));
    app.world_mut().entity_mut(spawned.nodes[0]).remove::<catoptra_engine::Hidden>();
    let (instances, lights) = drawn(&mut app);
    assert_eq!((instances.len(), lights), (2, 2));
    // Everything hidden: nothing is drawn, and what is lacking is told.
    let mut all = nodes;
    all[3]["extensions"] = hidden.clone();
    all[4]["extensions"] = hidden;
    let scene = load(&file(all)).unwrap();
    assert_eq!((scene.report.instances, scene.report.has_light, scene.report.has_camera), (0, false, false));
    assert!(scene.camera().is_none() && scene.bounds_world().is_empty());
}

#[test]
fn pictures_in_webp() {
    let texels = vec![255, 0, 0, 255, 0, 128, 255, 51, 7, 8, 9, 0, 255, 255, 255, 128];
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbaImage::from_raw(2, 2, texels.clone()).unwrap().write_to(&mut bytes, image::ImageFormat::WebP).unwrap();
    let webp = format!("data:image/webp;base64,{}", base64(bytes.get_ref()));
    let scene = |image: &str, texture: Value| {
        let more = json!({ "extensionsRequired": ["EXT_texture_webp"],
            "images": [{ "uri": one_texel() }, { "uri": image }], "textures": [texture] });
        materials(json!([{ "emissiveFactor": [1, 1, 1], "emissiveTexture": { "index": 0 } }]), more).unwrap()
    };
    // With and without a fallback, and where the file simply names one.
    for texture in [
        json!({ "extensions": { "EXT_texture_webp": { "source": 1 } } }),
        json!({ "source": 0, "extensions": { "EXT_texture_webp": { "source": 1 } } }),
        json!({ "source": 1 }),
    ] {
        let scene = scene(&webp, texture);
        assert!(scene.report.ignored.is_empty(), "{:?}", scene.report.ignored);
        assert_eq!(scene.textures[0].texels().as_flattened(), texels);
    }
    // Cut off at every byte: noted, never worse.
    for n in 12..bytes.get_ref().len() {
        let cut = format!("data:image/webp;base64,{}", base64(&bytes.get_ref()[..n]));
        let scene = scene(&cut, json!({ "extensions": { "EXT_texture_webp": { "source": 1 } } }));
        assert!(scene.textures.is_empty() == !scene.report.ignored.is_empty(), "{n}: {:?}", scene.report.ignored);
    }
    // A header that promises a picture beyond the limits is refused before memory is asked for.
    let mut huge = b"RIFF\x1e\0\0\0WEBPVP8X\x0a\0\0\0\0\0\0\0".to_vec();
    huge.extend([0xff, 0xff, 0xfe, 0xff, 0xff, 0]);
    huge.extend(b"VP8L\0\0\0\0");
    let uri = format!("data:image/webp;base64,{}", base64(&huge));
    let more = json!({ "images": [{ "uri": uri }], "textures": [{ "source": 0 }] });
    match materials(json!([{ "emissiveFactor": [1, 1, 1], "emissiveTexture": { "index": 0 } }]), more) {
        Ok(scene) => {
            assert!(scene.textures.is_empty() && scene.report.ignored.len() == 1, "{:?}", scene.report.ignored)
        }
        Err(e) => assert!(matches!(e, GltfError::Limit { .. }), "{e}"),
    }
}

#[test]
fn extensions_of_other_things_are_ignored_or_refused_by_name() {
    for (name, required_too) in [
        ("KHR_xmp_json_ld", true),
        ("KHR_animation_pointer", true),
        ("EXT_lights_image_based", true),
        ("MSFT_lod", true),
        ("KHR_gaussian_splatting", false),
        ("VENDOR_unheard_of", false),
    ] {
        let file = |key: &str| {
            triangle(Vec::new(), |j| {
                j[key] = json!([name]);
                j["nodes"][0]["extensions"] = json!({ name: { "anything": [1, { "x": null }] } });
                j["extensions"] = json!({ name: { "packets": [] } });
            })
        };
        let scene = load(&file("extensionsUsed")).unwrap();
        assert_eq!((corners(&scene), scene.report.ignored), (vec![TRIANGLE], vec![format!("extension {name}")]));
        match load(&file("extensionsRequired")) {
            Ok(_) => assert!(required_too, "{name}"),
            Err(GltfError::Extension(e)) => assert!(!required_too && e == name),
            Err(e) => panic!("{name}: {e}"),
        }
    }
}

#[test]
fn compressed_meshes_are_refused_by_name_and_fallbacks_are_read() {
    // Draco with a plain copy beside it loads; without one it is refused.
    let draco = |plain: bool| {
        triangle(Vec::new(), |j| {
            j["extensionsUsed"] = json!(["KHR_draco_mesh_compression"]);
            j["meshes"][0]["primitives"][0]["extensions"] =
                json!({ "KHR_draco_mesh_compression": { "bufferView": 0, "attributes": {} } });
            if !plain {
                j["accessors"][0].as_object_mut().unwrap().remove("bufferView");
            }
        })
    };
    assert_eq!(corners(&load(&draco(true)).unwrap()), [TRIANGLE]);
    assert!(matches!(load(&draco(false)), Err(GltfError::Extension(e)) if e == "KHR_draco_mesh_compression"));
    // meshopt whose uncompressed buffer is a promise.
    let meshopt = triangle(Vec::new(), |j| {
        j["extensionsUsed"] = json!(["EXT_meshopt_compression"]);
        j["bufferViews"][0]["buffer"] = json!(1);
        j["bufferViews"][0]["extensions"] = json!({ "EXT_meshopt_compression": { "buffer": 0, "byteLength": 9, "byteStride": 12, "count": 3, "mode": "ATTRIBUTES" } });
    });
    // The harness writes one buffer; a second one without data is added to the text.
    let text = String::from_utf8_lossy(&meshopt).into_owned();
    assert!(text.contains("EXT_meshopt_compression"));
    let error = load(&meshopt).unwrap_err().to_string();
    assert!(error.contains("meshopt") || error.contains("buffer 1"), "{error}");
}

#[test]
fn names_of_all_scripts_and_sizes() {
    for name in ["", "木", "🪞", "a\\\"b", &"x".repeat(10_000)] {
        let scene = load(&triangle(Vec::new(), |j| j["nodes"][0]["name"] = json!(name))).unwrap();
        assert_eq!(scene.nodes[0].name.as_deref(), Some(name));
    }
}
