//! What textures say of a surface, place by place: metal and roughness, glass, coverage, tangents, smaller copies. By pixels
//! that arithmetic foretells, on both lanes.

use catoptra_engine::{
    ImportLimits, LightKind, Material, Mesh, MeshData, Mip, Physical, PhysicalPlace, Texture, TextureRef,
    glam::{Affine3, Mat3, Vec2, Vec3, Vec4},
    load_gltf_bytes,
    material::{NOT_POLISHED, POLISHED, shininess_from_roughness},
};
use catoptra_render_hybrid::{
    Image, Layer, RasterLane, RenderSettings, Renderer, Shadows, metrics, raster::testing::ShaderProbe,
};
use catoptra_tests::{HandScene, at, fixtures, gpu_or_skip, opened_or_skip};
use std::{f32::consts::PI, sync::Arc};

/// A square of 2 m in the plane z = 0 that faces +z; u runs along +x, v downwards, as a picture hangs.
fn picture() -> MeshData {
    MeshData {
        positions: [(-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (1.0, 1.0)].map(|(x, y)| Vec3::new(x, y, 0.0)).to_vec(),
        normals: vec![Vec3::Z; 4],
        uvs: vec![Vec2::ZERO, Vec2::Y, Vec2::ONE, Vec2::X],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Default::default()
    }
}

fn mesh(data: MeshData) -> Mesh {
    Mesh::new(data).unwrap()
}

fn texture(width: u32, texels: &[[u8; 4]], srgb: bool) -> Arc<Texture> {
    Arc::new(Texture::new(width, texels.len() as u32 / width, texels.to_vec(), srgb).unwrap())
}

fn map(number: u32) -> Option<TextureRef> {
    Some(TextureRef { texture: number, nearest: true, nearest_min: true, mip: Mip::None, ..TextureRef::default() })
}

fn physical() -> Physical {
    Physical::default()
}

/// The CPU lane, and the GPU lane where there is one.
fn lanes(test: &str) -> Vec<Renderer> {
    std::iter::once(fixtures::cpu()).chain(gpu_or_skip(test)).collect()
}

fn draw(renderer: &mut Renderer, scene: &HandScene, settings: &RenderSettings) -> Image {
    renderer.render(&scene.0, settings).unwrap().image
}

fn direct_only(width: u32, height: u32) -> RenderSettings {
    RenderSettings { shadows: Shadows::Off, vpl: None, ..fixtures::small(width, height, 64) }
}

/// The picture's left and right half at its middle row.
fn halves(image: &Image) -> [Vec3; 2] {
    [image.width / 4, 3 * image.width / 4].map(|x| Vec3::from(image.at(x, image.height / 2)))
}

#[test]
fn metal_and_roughness_follow_their_texture() {
    // Left: rough dielectric; right: polished metal. The colour of the texture tints the metal.
    let color = Vec3::new(0.8, 0.4, 0.2);
    let sky = Vec3::new(0.25, 0.5, 1.0);
    for mut renderer in lanes("metal_and_roughness_follow_their_texture") {
        let lane = renderer.lane();
        let mut s = HandScene::parallel(Vec3::new(0.0, 0.0, 3.0), Vec3::NEG_Z, 1.0).background(sky);
        let material = Material {
            physical: Some(Physical { metallic_roughness_texture: map(0), ..physical() }),
            ..Material::lambert(color)
        };
        s.add(mesh(picture()), material, at(Vec3::ZERO));
        s.0.textures.push(texture(2, &[[9, 255, 0, 255], [9, 0, 255, 255]], false));
        s.light(LightKind::Directional, Vec3::ZERO, Vec3::splat(PI)).direction_world = Vec3::NEG_Z;
        let settings = RenderSettings { keep_layers: true, ..direct_only(16, 16) };
        let frame = renderer.render(&s.0, &settings).unwrap();
        let [left, right] = halves(&frame.image);
        assert!((left - color).length() < 2e-3, "{lane:?}: {left} is the colour, matte");
        assert!((right - color * sky).length() < 2e-3, "{lane:?}: {right} is the sky in metal");
        let mask = halves(frame.layer(Layer::Mask).unwrap());
        assert_eq!(mask, [Vec3::ZERO, Vec3::X], "{lane:?}: only the mirror half is traced");
        assert_eq!(frame.stats.masked_pixels, 128, "{lane:?}");

        // A texture of middling roughness: the lobe of the formula, in the metal's own colour.
        s.0.textures[0] = texture(2, &[[9, 128, 0, 255], [9, 128, 255, 255]], false);
        let frame = renderer.render(&s.0, &settings).unwrap();
        let r = 128.0 / 255.0;
        // Viewer, light and normal are one direction: N·H = 1.
        let lobe = (shininess_from_roughness(r) + 8.0) / (8.0 * PI) * PI;
        let expected = [color + Vec3::splat(0.04 * (1.0 - r) * lobe), color * lobe];
        for (got, expected) in halves(&frame.image).into_iter().zip(expected) {
            assert!((got - expected).length() < 0.01 * expected.length(), "{lane:?}: {got} for {expected}");
        }
    }
}

#[test]
fn looks_change_without_a_jump() {
    // What leaves a place in all directions stays the same as the mirror fades; only neighbours of equal roughness differ.
    let p = Physical { reflectance: Vec3::splat(0.04), ..physical() };
    let look = |metallic: f32, roughness: f32, transmission: f32| {
        p.look(Vec3::new(0.9, 0.5, 0.1), PhysicalPlace { metallic, roughness, transmission, coverage: 1.0 })
    };
    for metallic in [0.0, 0.25, 0.9, 1.0] {
        for transmission in [0.0, 0.5, 1.0] {
            let mut last = look(metallic, 0.0, transmission);
            assert_eq!((last.mirror, last.specular), (metallic, Vec3::ZERO));
            for step in 1..=1000 {
                let l = look(metallic, step as f32 * 2e-4, transmission);
                let matte = |l: &catoptra_engine::Look| l.matte_weight() * l.diffuse;
                let glass = |l: &catoptra_engine::Look| (1.0 - l.mirror) * l.transmission;
                assert!((matte(&l) - (1.0 - metallic) * (1.0 - transmission)).abs() < 1e-5, "{l:?}");
                assert!((glass(&l) - (1.0 - metallic) * transmission).abs() < 1e-5, "{l:?}");
                assert!((l.mirror - last.mirror).abs() < 3e-3, "{last:?} then {l:?}");
                assert!((l.specular - last.specular).abs().max_element() < 3e-3, "{last:?} then {l:?}");
                last = l;
            }
            assert_eq!(last.mirror, 0.0);
        }
    }
}

#[test]
fn glass_follows_its_texture() {
    let behind = Vec3::new(0.5, 0.25, 1.0);
    for mut renderer in lanes("glass_follows_its_texture") {
        let lane = renderer.lane();
        let mut s = HandScene::parallel(Vec3::new(0.0, 0.0, 3.0), Vec3::NEG_Z, 1.0).background(behind);
        let glass =
            Physical { metallic: 0.0, roughness: 0.0, transmission: 1.0, transmission_texture: map(0), ..physical() };
        let material = Material {
            physical: Some(glass),
            transmission: 0.5,
            ior: 1.0,
            ..Material::lambert(Vec3::new(0.0, 0.6, 0.0))
        };
        s.add(mesh(picture()), material, at(Vec3::ZERO));
        s.0.textures.push(texture(2, &[[0, 99, 99, 255], [255, 0, 0, 255]], false));
        s.light(LightKind::Directional, Vec3::ZERO, Vec3::splat(PI)).direction_world = Vec3::NEG_Z;
        let [left, right] = halves(&draw(&mut renderer, &s, &direct_only(16, 16)));
        assert!((left - Vec3::new(0.0, 0.6, 0.0)).length() < 2e-3, "{lane:?}: {left} is opaque");
        // Glass of index 1 reflects nothing and tints once on a pane.
        assert!((right - behind * Vec3::new(0.0, 0.6, 0.0)).length() < 2e-3, "{lane:?}: {right} is seen through");
    }
}

#[test]
fn blending_follows_alpha_of_factor_texture_and_vertex() {
    let behind = Vec3::new(0.5, 0.25, 1.0);
    for mut renderer in lanes("blending_follows_alpha_of_factor_texture_and_vertex") {
        let lane = renderer.lane();
        let mut s = HandScene::parallel(Vec3::new(0.0, 0.0, 3.0), Vec3::NEG_Z, 1.0).background(behind);
        let veil = Physical { metallic: 0.0, reflectance: Vec3::ZERO, blended: true, ..physical() };
        let material = Material {
            physical: Some(veil),
            thin: true,
            transmission: 0.5,
            alpha: 0.5,
            base_color_texture: map(0),
            emissive: Vec3::new(0.0, 0.0, 0.5),
            ..Material::lambert(Vec3::new(0.0, 0.8, 0.0))
        };
        s.add(mesh(MeshData { colors: vec![Vec4::new(1.0, 1.0, 1.0, 0.8); 4], ..picture() }), material, at(Vec3::ZERO));
        s.0.textures.push(texture(2, &[[255, 255, 255, 255], [255, 255, 255, 51]], true));
        s.light(LightKind::Directional, Vec3::ZERO, Vec3::splat(PI)).direction_world = Vec3::NEG_Z;
        let own = Vec3::new(0.0, 0.8, 0.5);
        let got = halves(&draw(&mut renderer, &s, &direct_only(16, 16)));
        for (got, alpha) in got.into_iter().zip([0.5 * 0.8, 0.5 * 0.8 * 0.2]) {
            let expected = own * alpha + behind * (1.0 - alpha);
            // Seven bits of coverage on the GPU.
            assert!((got - expected).length() < 8e-3, "{lane:?}: {got} for {expected}");
        }
    }
}

#[test]
fn tangents_of_the_file_turn_the_normal_map() {
    let texel = [255, 128, 192, 255];
    let c = Vec3::new(255.0, 128.0, 192.0) / 127.5 - 1.0;
    let toward = Vec3::new(0.5, 0.3, 0.8).normalize();
    let mirrored = Affine3 { matrix3: Mat3::from_diagonal(Vec3::new(-1.0, 1.0, 1.0)), translation: Vec3::ZERO };
    for mut renderer in lanes("tangents_of_the_file_turn_the_normal_map") {
        // x of the map along the tangent, whatever the texture coordinates say; y along cross(n, t) w.
        for (t, w) in [(Vec3::X, 1.0), (Vec3::Y, 1.0), (Vec3::Y, -1.0), (Vec3::new(0.6, -0.8, 0.0), -1.0)] {
            for pose in [at(Vec3::ZERO), mirrored] {
                let mut s = HandScene::parallel(Vec3::new(0.1, 0.2, 3.0), Vec3::NEG_Z, 0.1);
                let material = Material { normal_texture: map(0), ..Material::lambert(Vec3::ONE) };
                s.add(mesh(MeshData { tangents: vec![t.extend(w); 4], ..picture() }), material, pose);
                s.0.textures.push(texture(1, &[texel], false));
                s.light(LightKind::Directional, Vec3::ZERO, Vec3::splat(PI)).direction_world = -toward;
                let n_object = (t * c.x + Vec3::Z.cross(t) * (w * c.y) + Vec3::Z * c.z).normalize();
                let expected = (pose.matrix3 * n_object).dot(toward).max(0.0);
                let pixel = draw(&mut renderer, &s, &direct_only(3, 3)).at(1, 1)[0];
                let lane = renderer.lane();
                assert!((pixel - expected).abs() < 3e-3, "{lane:?} {t} {w} {pose:?}: {pixel} for {expected}");
            }
        }
    }
}

/// A floor of fine black and white squares that runs to the horizon.
fn checkered(mip: Mip) -> HandScene {
    let texels: Vec<[u8; 4]> =
        (0..64 * 64).map(|i| if (i + i / 64) % 2 == 0 { [255; 4] } else { [0, 0, 0, 255] }).collect();
    let camera = catoptra_engine::Camera::looking_at(Vec3::new(0.0, 1.0, 0.0), Vec3::new(0.0, 0.7, -4.0), 0.9);
    let mut s = HandScene::new(camera);
    let wide = 20.0;
    let floor = MeshData { uvs: picture().uvs.iter().map(|uv| *uv * 40.0).collect(), ..picture() };
    let flat = Affine3 {
        matrix3: Mat3::from_cols(Vec3::X * wide, Vec3::NEG_Z * wide, Vec3::Y * wide),
        translation: Vec3::new(0.0, 0.0, -wide),
    };
    let tiles = TextureRef { nearest: true, mip, ..TextureRef::default() };
    s.add(mesh(floor), Material { base_color_texture: Some(tiles), unlit: true, ..Material::default() }, flat);
    // A mirror that shows the floor once more.
    let upright = Affine3 { matrix3: Mat3::from_diagonal(Vec3::splat(1.5)), translation: Vec3::new(1.0, 1.0, -6.0) };
    s.add(mesh(picture()), Material::mirror(Vec3::ONE, 1.0), upright);
    s.0.textures.push(texture(64, &texels, true));
    s
}

#[test]
fn smaller_copies_calm_what_is_far_on_both_lanes() {
    let settings = direct_only(96, 64);
    let rough = |image: &Image, x: u32, rows: std::ops::Range<u32>| {
        let steps: Vec<f32> = rows.map(|y| (image.at(x, y)[0] - image.at(x + 1, y)[0]).abs()).collect();
        steps.iter().sum::<f32>() / steps.len() as f32
    };
    let mut pictures = Vec::new();
    for mut renderer in lanes("smaller_copies_calm_what_is_far_on_both_lanes") {
        let lane = renderer.lane();
        let [sharp, calm] = [Mip::None, Mip::Linear].map(|mip| draw(&mut renderer, &checkered(mip), &settings));
        // Far away a pixel holds many squares: grey with copies, black or white without.
        let far = 30..34;
        assert!(rough(&sharp, 20, far.clone()) > 0.1, "{lane:?}: {}", rough(&sharp, 20, far.clone()));
        assert!(rough(&calm, 20, far.clone()) < 0.02, "{lane:?}: {}", rough(&calm, 20, far));
        let grey = calm.at(20, 31)[0];
        assert!((grey - 0.5).abs() < 0.03, "{lane:?}: {grey} is the mean in linear light");
        // So it is in the mirror, whose rays go on where the camera's end.
        let mirrored = |image: &Image| (56..60).map(|x| rough(image, x, 33..37)).sum::<f32>() / 4.0;
        assert!(mirrored(&calm) < 0.02 && mirrored(&sharp) > 0.1, "{lane:?}: {} {}", mirrored(&calm), mirrored(&sharp));
        pictures.push(calm);
    }
    if let [cpu, gpu] = &pictures[..] {
        let c = metrics::compare(gpu, cpu).unwrap();
        assert!(c.flip.mean() <= 0.02, "FLIP {}", c.flip.mean());
    }
}

#[test]
fn near_things_keep_every_texel() {
    // One texel is many pixels: the copies must not be touched.
    for mut renderer in lanes("near_things_keep_every_texel") {
        let image = |mip: Mip, renderer: &mut Renderer| {
            let mut s = HandScene::parallel(Vec3::new(0.0, 0.0, 3.0), Vec3::NEG_Z, 1.0);
            let tiles = TextureRef { nearest: true, mip, ..TextureRef::default() };
            s.add(
                mesh(picture()),
                Material { base_color_texture: Some(tiles), unlit: true, ..Material::default() },
                at(Vec3::ZERO),
            );
            s.0.textures.push(texture(
                4,
                &(0..16u8).map(|i| [i * 16, 255 - i * 16, i, 255]).collect::<Vec<_>>(),
                false,
            ));
            draw(renderer, &s, &direct_only(32, 32))
        };
        assert_eq!(image(Mip::None, &mut renderer), image(Mip::Linear, &mut renderer));
        assert_eq!(image(Mip::None, &mut renderer), image(Mip::Nearest, &mut renderer));
    }
}

/// A GLB with every kind of texture, each transformed and on its own coordinate set: base colour, metal and roughness,
/// normal, emission.
fn all_kinds() -> Vec<u8> {
    let png = |texels: Vec<u8>| {
        let mut out = std::io::Cursor::new(Vec::new());
        image::RgbaImage::from_raw(2, 1, texels).unwrap().write_to(&mut out, image::ImageFormat::Png).unwrap();
        let hex: String = out.get_ref().iter().map(|b| format!("%{b:02x}")).collect();
        format!(r#"{{"uri":"data:image/png,{hex}"}}"#)
    };
    let images = [
        png(vec![255, 0, 0, 255, 0, 255, 0, 255]),
        png(vec![0, 255, 0, 255, 0, 0, 255, 255]),
        png(vec![217, 128, 217, 255, 128, 128, 255, 255]),
        png(vec![0, 0, 0, 255, 0, 0, 255, 255]),
    ];
    let data: Vec<f32> = {
        let p = [[-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0]];
        let uv = [[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]];
        let mut out: Vec<f32> = p.into_iter().flatten().collect();
        // Set 3 as the picture hangs, set 5 upside down and swapped left for right.
        out.extend(uv.into_iter().flatten());
        out.extend(uv.into_iter().flatten().map(|v| 1.0 - v));
        out
    };
    let mut bin: Vec<u8> = data.iter().flat_map(|v| v.to_le_bytes()).collect();
    bin.extend([0_u16, 1, 2, 0, 2, 3].iter().flat_map(|v| v.to_le_bytes()));
    // A shift by half a picture swaps the two texels of a repeated image.
    let shift = r#"{"KHR_texture_transform":{"offset":[0.5,0]}}"#;
    let info = |index: u32, set: u32, extra: &str| format!(r#"{{"index":{index},"texCoord":{set}{extra}}}"#);
    let moved = format!(r#","extensions":{shift}"#);
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"extensionsUsed":["KHR_texture_transform"],"extensionsRequired":["KHR_texture_transform"],
        "nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_3":1,"TEXCOORD_5":2}},"indices":3,"material":0}}]}}],
        "materials":[{{"pbrMetallicRoughness":{{"baseColorTexture":{},"metallicRoughnessTexture":{}}},
        "normalTexture":{},"emissiveTexture":{},"emissiveFactor":[1,1,1]}}],
        "samplers":[{{"magFilter":9728,"minFilter":9728}}],
        "textures":[{}],"images":[{}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3"}},{{"bufferView":1,"componentType":5126,"count":4,"type":"VEC2"}},
        {{"bufferView":2,"componentType":5126,"count":4,"type":"VEC2"}},{{"bufferView":3,"componentType":5123,"count":6,"type":"SCALAR"}}],
        "bufferViews":[{{"buffer":0,"byteLength":48}},{{"buffer":0,"byteOffset":48,"byteLength":32}},{{"buffer":0,"byteOffset":80,"byteLength":32}},
        {{"buffer":0,"byteOffset":112,"byteLength":12}}],"buffers":[{{"byteLength":{}}}]}}"#,
        info(0, 3, ""),
        info(1, 3, &moved),
        info(2, 3, &moved),
        info(3, 5, &moved),
        (0..4).map(|i| format!(r#"{{"source":{i},"sampler":0}}"#)).collect::<Vec<_>>().join(","),
        images.join(","),
        bin.len(),
    );
    let mut text = json.into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut out = b"glTF".to_vec();
    for word in [2, 28 + text.len() + bin.len(), text.len()] {
        out.extend((word as u32).to_le_bytes());
    }
    out.extend(b"JSON");
    out.extend(text);
    out.extend((bin.len() as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(bin);
    out
}

#[test]
fn every_kind_of_texture_has_its_set_and_its_transform() {
    let imported = load_gltf_bytes(&all_kinds(), None, &ImportLimits::default()).unwrap();
    assert!(imported.report.ignored.is_empty(), "{:?}", imported.report.ignored);
    for mut renderer in lanes("every_kind_of_texture_has_its_set_and_its_transform") {
        let lane = renderer.lane();
        let mut s = HandScene::parallel(Vec3::new(0.0, 0.0, 3.0), Vec3::NEG_Z, 1.0).background(Vec3::ONE);
        let imported = imported.to_render_scene(0);
        (s.0.meshes, s.0.materials, s.0.textures) = (imported.meshes, imported.materials, imported.textures);
        s.0.instances = imported.instances;
        let toward = Vec3::new(0.6, 0.0, 0.8);
        s.light(LightKind::Directional, Vec3::ZERO, Vec3::splat(PI)).direction_world = -toward;
        // Red metal on the left, where the shift has put it; on the right matte green that leans to the right by 45 degrees,
        // and blue light: its set runs backwards, the shift turns that round.
        let lean = Vec3::new(1.0, 0.0, 1.0).normalize().dot(toward);
        let expected = [Vec3::X, Vec3::new(0.0, lean, 1.0)];
        for (got, expected) in halves(&draw(&mut renderer, &s, &direct_only(16, 16))).into_iter().zip(expected) {
            assert!((got - expected).length() < 0.01, "{lane:?}: {got} for {expected}");
        }
    }
}

#[test]
fn looks_agree_with_the_shader() {
    let Some(probe) = opened_or_skip("looks_agree_with_the_shader", ShaderProbe::new()) else { return };
    let noise = |i: u32| {
        ((i.wrapping_mul(0x9E37_79B9) ^ 0x85EB_CA6B).wrapping_mul(0x7FEB_352D) >> 8) as f32 / (1u32 << 24) as f32
    };
    let mut rows: Vec<[f32; 6]> = (0..400)
        .map(|i| std::array::from_fn(|k| noise(6 * i + k as u32)))
        .map(|r: [f32; 6]| [r[0], r[1].max(0.1), r[2], r[3], r[4], r[5]])
        .collect();
    for roughness in [0.0, POLISHED, POLISHED + 1e-6, 3.0 / 255.0, 0.05, NOT_POLISHED, 0.2, 1.0] {
        for edge in 0..16u32 {
            let bit = |k: u32| (edge >> k & 1) as f32;
            rows.push([bit(0), roughness, bit(1), 1.0 - 0.5 * bit(2), 0.3 + 0.5 * bit(3), 0.04]);
        }
    }
    let body = "let p = PhysicalPlace(x[0], x[1], x[2], x[3]);
        let l = physical_look(vec3f(x[5]), vec3f(x[4], 0.5, 0.25), p);
        y[0] = l.diffuse; y[1] = l.specular.x; y[2] = l.specular.z; y[3] = l.shininess; y[4] = l.mirror; y[5] = l.transmission;";
    let gpu = probe.evaluate(&["shared/look"], body, &rows).unwrap();
    let place = |r: &[f32; 6]| PhysicalPlace { metallic: r[0], roughness: r[1], transmission: r[2], coverage: r[3] };
    for (r, g) in rows.iter().zip(&gpu) {
        let p = Physical { reflectance: Vec3::splat(r[5]), ..physical() };
        let l = p.look(Vec3::new(r[4], 0.5, 0.25), place(r));
        let cpu = [l.diffuse, l.specular.x, l.specular.z, l.shininess, l.mirror, l.transmission];
        let g: &[f32; 6] = g;
        for (a, b) in g.iter().zip(cpu) {
            assert!((a - b).abs() <= 2e-5 * b.abs().max(1.0), "{r:?}: GPU {g:?}, CPU {cpu:?}");
        }
    }
    // What is packed comes back within its bits, and on its side of every decision.
    let body = "let p = PhysicalPlace(x[0], x[1], x[2], x[3]);
        let w = pack_place(p, x[4] > 0.5); let q = unpack_place(w);
        y[0] = q.metallic; y[1] = q.roughness; y[2] = q.transmission; y[3] = q.coverage; y[4] = f32(w > 0.5);";
    let gpu: Vec<[f32; 5]> = probe.evaluate(&["shared/look"], body, &rows).unwrap();
    for (r, g) in rows.iter().zip(&gpu) {
        for (k, bits) in [(0, 127.0), (1, 255.0), (2, 127.0), (3, 127.0)] {
            assert!((g[k] - r[k]).abs() <= 1.01 / bits, "{r:?}: {g:?}");
        }
        assert_eq!(g[1] <= POLISHED, r[1] <= POLISHED, "{r:?}: {g:?}");
        assert_eq!(
            [g[0] > 0.0, g[2] > 0.0, g[3] < 1.0, g[4] > 0.5],
            [r[0] > 0.0, r[2] > 0.0, r[3] < 1.0, r[4] > 0.5],
            "{r:?}: {g:?}"
        );
    }
}

#[test]
fn lanes_agree_on_a_scene_of_all_of_it() {
    let Some(mut gpu) = gpu_or_skip("lanes_agree_on_a_scene_of_all_of_it") else { return };
    assert_eq!(gpu.lane(), RasterLane::Gpu);
    let mut s = checkered(Mip::Linear);
    let varied =
        Physical { metallic_roughness_texture: Some(TextureRef { texture: 1, ..Default::default() }), ..physical() };
    let tiles = Some(TextureRef { texture: 2, ..TextureRef::default() });
    let ball =
        Material { physical: Some(varied), base_color_texture: tiles, ..Material::lambert(Vec3::new(0.9, 0.7, 0.4)) };
    s.add(catoptra_engine::shapes::sphere(0.6, 24, 48), ball, at(Vec3::new(-1.0, 0.6, -3.0)));
    let veil = Physical { metallic: 0.0, blended: true, ..physical() };
    let veil = Material {
        physical: Some(veil),
        thin: true,
        transmission: 0.4,
        base_color_texture: tiles,
        ..Material::default()
    };
    s.add(
        mesh(picture()),
        veil,
        Affine3 { matrix3: Mat3::from_diagonal(Vec3::splat(0.5)), translation: Vec3::new(0.2, 0.7, -2.5) },
    );
    s.light(LightKind::Point, Vec3::new(0.0, 3.0, -1.0), Vec3::splat(20.0));
    let ramp = |f: &dyn Fn(u8) -> [u8; 4]| (0..64u8).map(f).collect::<Vec<_>>();
    s.0.textures.push(texture(8, &ramp(&|i| [0, 40 + i * 3, 255 - i * 4, 255]), false));
    s.0.textures.push(texture(8, &ramp(&|i| [255 - i, 200, 128 + i * 2, 60 + i * 3]), true));
    let settings = fixtures::small(128, 96, 256);
    let a = draw(&mut gpu, &s, &settings);
    let b = fixtures::fresh(&s.0, &settings).image;
    let c = metrics::compare(&a, &b).unwrap();
    assert!(c.flip.mean() <= 0.02, "FLIP {}", c.flip.mean());
}
