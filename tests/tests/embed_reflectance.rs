//! What textures say of a surface's reflectance: `KHR_materials_specular` and `KHR_materials_pbrSpecularGlossiness`, from the
//! file to pixels that arithmetic foretells, on both lanes, seen directly and in a mirror.

use catoptra_engine::{
    ImportLimits, ImportedScene, LightKind, Material, RenderScene,
    glam::{Affine3, Mat3, Vec3},
    gltf::export_glb_bytes,
    load_gltf_bytes,
    material::{metal_of_reflectance, shininess_from_roughness},
    shapes::ShapeBuilder,
};
use catoptra_render_hybrid::{Image, RenderSettings, Renderer, Shadows, raster::testing::ShaderProbe};
use catoptra_tests::{HandScene, at, fixtures, gpu_or_skip, opened_or_skip};
use std::f32::consts::PI;

/// A picture of 2 m in the plane z = 0 that faces +z, of one material with the given JSON; images of two texels, left and
/// right.
fn file(material: &str, images: &[[[u8; 4]; 2]]) -> ImportedScene {
    let hex = |bytes: &[u8]| bytes.iter().map(|b| format!("%{b:02x}")).collect::<String>();
    let png = |texels: &[[u8; 4]; 2]| {
        let mut out = std::io::Cursor::new(Vec::new());
        let image = image::RgbaImage::from_raw(2, 1, texels.as_flattened().to_vec()).unwrap();
        image.write_to(&mut out, image::ImageFormat::Png).unwrap();
        format!(r#"{{"uri":"data:image/png,{}"}}"#, hex(out.get_ref()))
    };
    let places = [
        [-1.0_f32, 1.0, 0.0],
        [-1.0, -1.0, 0.0],
        [1.0, -1.0, 0.0],
        [-1.0, 1.0, 0.0],
        [1.0, -1.0, 0.0],
        [1.0, 1.0, 0.0],
    ];
    let uvs = places.map(|[x, y, _]| [(x + 1.0) * 0.5, (1.0 - y) * 0.5]);
    let floats: Vec<f32> = places.into_iter().flatten().chain(uvs.into_iter().flatten()).collect();
    let data = hex(&floats.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>());
    let list = |f: &dyn Fn(usize) -> String| (0..images.len()).map(f).collect::<Vec<_>>().join(",");
    let text = format!(
        r#"{{"asset":{{"version":"2.0"}},"nodes":[{{"mesh":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}},"material":0}}]}}],"materials":[{material}],
        "samplers":[{{"magFilter":9728,"minFilter":9728}}],"textures":[{}],"images":[{}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":6,"type":"VEC3"}},
        {{"bufferView":0,"byteOffset":72,"componentType":5126,"count":6,"type":"VEC2"}}],
        "bufferViews":[{{"buffer":0,"byteLength":120}}],
        "buffers":[{{"byteLength":120,"uri":"data:application/octet-stream,{data}"}}]}}"#,
        list(&|i| format!(r#"{{"source":{i},"sampler":0}}"#)),
        list(&|i| png(&images[i])),
    );
    let scene = load_gltf_bytes(text.as_bytes(), None, &ImportLimits::default()).unwrap();
    assert!(scene.report.ignored.is_empty(), "{:?}", scene.report.ignored);
    scene
}

/// Seen and lit from straight ahead, directly (`mirror` false) or by a mirror that stands before it at 45 degrees.
fn seen(model: &RenderScene, mirror: bool, sky: Vec3) -> HandScene {
    let (eye, forward) = if mirror { (Vec3::X * 3.0, Vec3::NEG_X) } else { (Vec3::Z * 3.0, Vec3::NEG_Z) };
    let mut s = HandScene::parallel(eye, forward, 0.7).background(sky);
    (s.0.meshes, s.0.materials, s.0.textures) = (model.meshes.clone(), model.materials.clone(), model.textures.clone());
    s.0.instances = model.instances.clone();
    let mut light = Vec3::NEG_Z;
    if mirror {
        // The picture stands on +z and looks back.
        let turned = Mat3::from_rotation_y(PI);
        s.0.instances[0].world_from_object = Affine3 { matrix3: turned, translation: Vec3::Z * 5.0 };
        let corners = [(-1.0, -1.0, 1.0), (1.0, -1.0, -1.0), (1.0, 1.0, -1.0), (-1.0, 1.0, 1.0)];
        let pane = ShapeBuilder::default().quad(corners.map(Vec3::from), Vec3::ONE).build();
        s.add(pane, Material::mirror(Vec3::ONE, 1.0), at(Vec3::ZERO));
        light = Vec3::Z;
    }
    s.light(LightKind::Directional, Vec3::ZERO, Vec3::splat(PI)).direction_world = light;
    s
}

/// The CPU lane, and the GPU lane where there is one.
fn lanes(test: &str) -> Vec<Renderer> {
    std::iter::once(fixtures::cpu()).chain(gpu_or_skip(test)).collect()
}

fn halves(image: &Image) -> [Vec3; 2] {
    [image.width / 4, 3 * image.width / 4].map(|x| Vec3::from(image.at(x, image.height / 2)))
}

/// Compares left and right half, as they are and in the mirror, with what is expected of `model` under the sky.
fn expect(test: &str, model: &ImportedScene, sky: Vec3, expected: [Vec3; 2]) {
    let settings = RenderSettings { shadows: Shadows::Off, vpl: None, ..fixtures::small(16, 16, 64) };
    let exported =
        load_gltf_bytes(&export_glb_bytes(&model.to_render_scene(1)).unwrap(), None, &ImportLimits::default());
    for mut renderer in lanes(test) {
        for (model, told) in [(model, "as read"), (exported.as_ref().unwrap(), "exported and read again")] {
            for mirror in [false, true] {
                let image = renderer.render(&seen(&model.to_render_scene(0), mirror, sky).0, &settings).unwrap().image;
                let mut got = halves(&image);
                if mirror {
                    // Turned about once by the pose and once by the mirror: the test holds both ways round.
                    let apart = |g: &[Vec3; 2]| (g[0] - expected[0]).length() + (g[1] - expected[1]).length();
                    let swapped = [got[1], got[0]];
                    if apart(&swapped) < apart(&got) {
                        got = swapped;
                    }
                }
                for (got, expected) in got.into_iter().zip(expected) {
                    let lane = renderer.lane();
                    let off = (got - expected).length();
                    // Nine bits of reflectance and eight of roughness on the GPU.
                    assert!(
                        off < 0.01 + 0.02 * expected.length(),
                        "{lane:?}, {told}, mirror {mirror}: {got} for {expected}"
                    );
                }
            }
        }
    }
}

/// The highlight of exponent `shininess_from_roughness(r)` where viewer, light and normal are one, light of irradiance π.
fn lobe(r: f32) -> f32 {
    (shininess_from_roughness(r) + 8.0) / 8.0
}

#[test]
fn specular_factor_and_color_follow_their_textures() {
    let color = Vec3::new(0.1, 0.2, 0.3);
    let model = file(
        r#"{"pbrMetallicRoughness":{"baseColorFactor":[0.1,0.2,0.3,1],"metallicFactor":0,"roughnessFactor":0.5},
        "extensions":{"KHR_materials_specular":{"specularFactor":0.5,"specularTexture":{"index":0},
        "specularColorFactor":[1,1,0.5],"specularColorTexture":{"index":1}}}}"#,
        &[[[9, 9, 9, 255], [9, 9, 9, 51]], [[255, 0, 255, 7], [255, 255, 255, 7]]],
    );
    // F0 · factor · (1 − r).
    let lit = |reflectance: Vec3| color + reflectance * (0.04 * 0.5 * 0.5 * lobe(0.5));
    let expected = [lit(Vec3::new(1.0, 0.0, 0.5)), lit(Vec3::new(1.0, 1.0, 0.5) * 0.2)];
    assert!((expected[0] - expected[1]).length() > 0.02, "the halves differ enough to be told apart");
    expect("specular_factor_and_color_follow_their_textures", &model, Vec3::ZERO, expected);
    // The material's own fields stand for the mean.
    let m = model.materials[0];
    let mean = Vec3::new(1.0, 0.5, 0.5) * (0.04 * 0.5 * 0.6) * 0.5;
    assert!((m.specular - mean).length() < 1e-5, "{} for {mean}", m.specular);
    assert_eq!(m.textures().count(), 2);
}

#[test]
fn specular_color_beyond_one_is_kept_in_range_before_the_factor() {
    // F0 is min(0.04 x 50, 1) x 0.5.
    let model = file(
        r#"{"pbrMetallicRoughness":{"metallicFactor":0,"roughnessFactor":0.5},
        "extensions":{"KHR_materials_specular":{"specularFactor":0.5,"specularColorFactor":[50,1,0]}}}"#,
        &[],
    );
    let expected = Vec3::new(0.5, 0.02, 0.0) * 0.5;
    assert!((model.materials[0].specular - expected).length() < 1e-6, "{}", model.materials[0].specular);
}

#[test]
fn gloss_and_reflectance_make_metal_and_matte_place_by_place() {
    let sky = Vec3::new(0.25, 0.5, 1.0);
    // Left: gold leaf, polished. Right: no reflectance, no gloss: the diffuse colour alone.
    let model = file(
        r#"{"extensions":{"KHR_materials_pbrSpecularGlossiness":{"diffuseFactor":[0.5,1,1,1],"diffuseTexture":{"index":0},
        "specularFactor":[1,1,1],"glossinessFactor":1,"specularGlossinessTexture":{"index":1}}}}"#,
        &[[[0, 0, 0, 255], [255, 255, 255, 255]], [[255, 188, 0, 255], [0, 0, 0, 0]]],
    );
    let gold = Vec3::new(1.0, 0.5029, 0.0);
    expect(
        "gloss_and_reflectance_make_metal_and_matte_place_by_place",
        &model,
        sky,
        [gold * sky, Vec3::new(0.5, 1.0, 1.0)],
    );
    assert!(model.materials[0].physical.is_some_and(|p| p.by_reflectance));
}

#[test]
fn gloss_without_textures_is_told_once_for_all() {
    let material = |specular: f32, gloss: f32| {
        let text = format!(
            r#"{{"extensions":{{"KHR_materials_pbrSpecularGlossiness":{{"diffuseFactor":[0.5,0.25,1,1],
            "specularFactor":[{specular},{specular},0],"glossinessFactor":{gloss}}}}}}}"#
        );
        file(&text, &[]).materials[0]
    };
    let diffuse = Vec3::new(0.5, 0.25, 1.0);
    // Plastic: a highlight of its reflectance, no metal.
    let plastic = material(0.05, 0.5);
    assert_eq!((plastic.base_color, plastic.mirror, plastic.diffuse, plastic.physical), (diffuse, 0.0, 1.0, None));
    assert!((plastic.specular - Vec3::new(0.025, 0.025, 0.0)).length() < 1e-6, "{}", plastic.specular);
    // Polished metal: a mirror of its reflectance.
    let chrome = material(1.0, 1.0);
    assert_eq!((chrome.base_color, chrome.mirror, chrome.physical), (Vec3::new(1.0, 1.0, 0.0), 1.0, None));
    // Between them nothing jumps, and mirrors grow with reflectance.
    let mut last = material(0.0, 1.0);
    for step in 1..=100 {
        let m = material(step as f32 / 100.0, 1.0);
        assert!((m.mirror - last.mirror).abs() < 0.012 && m.mirror >= last.mirror, "{step}");
        assert!(
            (m.base_color - last.base_color).abs().max_element() < 0.03,
            "{step}: {} {}",
            m.base_color,
            last.base_color
        );
        last = m;
    }
}

#[test]
fn metal_of_reflectance_and_its_packing_agree_with_the_shader() {
    let Some(probe) = opened_or_skip("metal_of_reflectance_and_its_packing_agree_with_the_shader", ShaderProbe::new())
    else {
        return;
    };
    let noise = |i: u32| {
        ((i.wrapping_mul(0x9E37_79B9) ^ 0x85EB_CA6B).wrapping_mul(0x7FEB_352D) >> 8) as f32 / (1u32 << 24) as f32
    };
    let mut rows: Vec<[f32; 6]> = (0..300).map(|i| std::array::from_fn(|k| noise(6 * i + k as u32))).collect();
    rows.extend([[0.3, 0.2, 0.1, 0.0, 0.0, 0.0], [0.3, 0.2, 0.1, 0.08, 0.01, 0.0], [0.3, 0.2, 0.1, 1.0, 0.0, 1.0]]);
    let body = "let m = metal_of_reflectance(vec3f(x[0], x[1], x[2]), vec3f(x[3], x[4], x[5]));
        let r = unpack_reflectance(pack_reflectance(vec3f(x[3], x[4], x[5])));
        y[0] = m.x; y[1] = m.y; y[2] = m.z; y[3] = m.w; y[4] = r.x; y[5] = r.y; y[6] = r.z;";
    let gpu: Vec<[f32; 7]> = probe.evaluate(&["shared/look"], body, &rows).unwrap();
    for (x, y) in rows.iter().zip(&gpu) {
        let (diffuse, reflectance) = (Vec3::new(x[0], x[1], x[2]), Vec3::new(x[3], x[4], x[5]));
        let (color, metallic) = metal_of_reflectance(diffuse, reflectance);
        assert!((Vec3::new(y[0], y[1], y[2]) - color).abs().max_element() < 1e-5, "{x:?}: {y:?} for {color}");
        assert!((y[3] - metallic).abs() < 1e-5, "{x:?}: {y:?} for {metallic}");
        let packed = Vec3::new(y[4], y[5], y[6]);
        let bound = 1.01 / 511.0;
        for c in 0..3 {
            assert!((packed[c].sqrt() - reflectance[c].sqrt()).abs() <= bound, "{x:?}: {packed} for {reflectance}");
        }
    }
}
