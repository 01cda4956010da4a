//! Contract: each feature of the glTF reader shows in geometry, materials or poses, on files made here.

mod gltf_common;

use catoptra_engine::{
    Aabb, Extracted, Hidden, ImportLimits, ImportedScene, LightKind, LightSource, Material, MeshInstance, Projection,
    StableId, Wrap,
    app::settle,
    gltf::{GltfError, MAX_SHININESS, roughness_from_shininess, shininess_from_roughness},
    new_app,
};
use glam::{Affine3, Vec2, Vec3, Vec4};
use gltf_common::{RIBBON, floats, glb, indexed, load, materials, posed_file};
use serde_json::{Value, json};

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
    let old = json!([{ "extensions": { "KHR_materials_pbrSpecularGlossiness": {
        "diffuseFactor": [0.5, 0.25, 1, 1], "specularFactor": [0.5, 0.5, 0.25], "glossinessFactor": 0.5,
    }}}]);
    let old = materials(old, json!({})).unwrap().materials[0];
    // Reflectance beyond a dielectric's counts as metal, here (0.5 - 0.08)/0.92 of it, coloured by the reflectance.
    let metallic = (0.5 - 0.08) / 0.92_f32;
    let color = base_color.lerp(Vec3::new(1.0, 1.0, 0.5), metallic);
    let specular = Vec3::new(0.25, 0.25, 0.125).lerp(color, metallic);
    let near = |a: Vec3, b: Vec3| assert!((a - b).abs().max_element() < 1e-6, "{a} for {b}");
    near(old.base_color, color);
    near(old.specular, specular);
    near(Vec3::splat(old.diffuse), Vec3::splat(1.0 - metallic));
    let (base_color, diffuse, specular) = (old.base_color, old.diffuse, old.specular);
    assert_eq!(old, Material { diffuse, specular, shininess: 30.0, ..Material::lambert(base_color) });
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
    assert_eq!(scene.textures.iter().map(|t| t.srgb()).collect::<Vec<_>>(), [true, false], "as colour and as numbers");
    let m = &scene.materials[0];
    let r = m.base_color_texture.unwrap();
    assert_eq!((r.uv_set, r.nearest, r.wrap), (0, true, [Wrap::Clamp, Wrap::Mirror]));
    // Counter-clockwise in an image whose v points down: (1, 0) turns towards -v.
    let (sin, cos) = catoptra_engine::math::sin_cos(0.5);
    let got = r.transform_uv(Vec2::X);
    assert!((got - Vec2::new(0.5 + 2.0 * cos, 0.25 - 2.0 * sin)).length() < 1e-6, "{got}");
    assert_eq!(scene.textures[0].texels(), [[255, 64, 255, 255], [0, 192, 0, 255]]);
    // Mean G = 128/255, mean B = 1/2; factors 0.5 and 1.
    let roughness: f32 = 0.5 * 128.0 / 255.0;
    assert!((m.diffuse - 0.5).abs() < 1e-6);
    assert!((m.shininess / shininess_from_roughness(roughness) - 1.0).abs() < 1e-4);
    assert!(scene.report.ignored.is_empty(), "{:?}", scene.report.ignored);

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

#[test]
fn extensions_are_refused_or_listed_by_name() {
    let with = |key: &str, name: &str| load(&glb(json!({ key: [name] }), &[]));
    for name in ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu", "MADE_UP"] {
        assert!(matches!(with("extensionsRequired", name), Err(GltfError::Extension(e)) if e == name));
        assert!(with("extensionsUsed", name).unwrap().report.ignored[0].contains(name));
    }
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

    // All of it as one mesh stands in the same place.
    let merged = scene.merged_mesh(&ImportLimits::default()).unwrap();
    let corners = flat.instances.iter().flat_map(|i| {
        let pose = i.world_from_object;
        flat.meshes[0].positions().iter().map(move |p| pose.transform_point3(*p))
    });
    let (a, b) = (merged.bounds_object(), Aabb::from_points(corners));
    assert_eq!(merged.triangles().len(), flat.triangle_count());
    assert!((a.min - b.min).length() < 1e-5 && (a.max - b.max).length() < 1e-5, "{a:?} against {b:?}");
    let few = ImportLimits { triangles: 3, ..Default::default() };
    assert!(matches!(scene.merged_mesh(&few), Err(GltfError::Limit { what: "triangles", value: 4, limit: 3 })));

    // Despawning the root leaves nothing.
    app.world_mut().entity_mut(spawned.root).despawn();
    app.update();
    assert!(app.world().resource::<Extracted>().0.instances.is_empty());
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
