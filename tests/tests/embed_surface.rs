//! Normal maps, alpha masks and alpha blending, by pixels that arithmetic foretells, on both lanes.

use catoptra_engine::{
    LightKind, Material, Mesh, MeshData, Texture, TextureRef,
    glam::{Affine3, Mat3, Vec2, Vec3},
};
use catoptra_render_hybrid::{Image, RasterLane, RenderSettings, Renderer, Shadows, accel::Ray};
use catoptra_tests::{HandScene, at, fixtures, gpu_or_skip};
use std::{f32::consts::PI, sync::Arc};

/// A square of 2 m in the plane z = 0 that faces +z; u runs along +x, v downwards, as a picture hangs.
fn picture() -> Mesh {
    Mesh::new(MeshData {
        positions: vec![
            Vec3::new(-1.0, 1.0, 0.0),
            Vec3::new(-1.0, -1.0, 0.0),
            Vec3::new(1.0, -1.0, 0.0),
            Vec3::new(1.0, 1.0, 0.0),
        ],
        normals: vec![Vec3::Z; 4],
        uvs: vec![Vec2::ZERO, Vec2::Y, Vec2::ONE, Vec2::X],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Default::default()
    })
    .unwrap()
}

fn texture(width: u32, texels: &[[u8; 4]], srgb: bool) -> Arc<Texture> {
    Arc::new(Texture::new(width, texels.len() as u32 / width, texels.to_vec(), srgb).unwrap())
}

fn map(number: u32) -> Option<TextureRef> {
    Some(TextureRef { texture: number, nearest: true, ..TextureRef::default() })
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

#[test]
fn normal_maps_turn_the_normal_as_the_picture_hangs() {
    // Texels that lean to the right and upwards in the picture.
    let right = [255, 128, 192, 255];
    let up = [128, 255, 192, 255];
    let flat = [128, 128, 255, 255];
    let toward = Vec3::new(0.5, 0.3, 0.8).normalize();
    let mirrored = Affine3 { matrix3: Mat3::from_diagonal(Vec3::new(-1.0, 1.0, 1.0)), translation: Vec3::ZERO };
    let turned = Affine3 { matrix3: Mat3::from_rotation_z(PI * 0.5), translation: Vec3::ZERO };
    for mut renderer in lanes("normal_maps_turn_the_normal_as_the_picture_hangs") {
        for (texel, pose, scale) in [
            (flat, at(Vec3::ZERO), 1.0),
            (right, at(Vec3::ZERO), 1.0),
            (up, at(Vec3::ZERO), 1.0),
            (right, mirrored, 1.0),
            (up, turned, 1.0),
            (right, at(Vec3::ZERO), 0.5),
            (up, at(Vec3::ZERO), -1.0),
        ] {
            let mut s = HandScene::parallel(Vec3::new(0.1, 0.2, 3.0), Vec3::NEG_Z, 0.1);
            let material = Material { normal_texture: map(0), normal_scale: scale, ..Material::lambert(Vec3::ONE) };
            s.add(picture(), material, pose);
            s.0.textures.push(texture(1, &[texel], false));
            let light = s.light(LightKind::Directional, Vec3::ZERO, Vec3::splat(PI));
            light.direction_world = -toward;
            let c = Vec3::new(f32::from(texel[0]), f32::from(texel[1]), f32::from(texel[2])) / 127.5 - 1.0;
            let n_object = Vec3::new(c.x * scale, c.y * scale, c.z).normalize();
            // Rigid and mirrored poses carry this frame's normals as they carry directions.
            let expected = (pose.matrix3 * n_object).dot(toward).max(0.0);
            let pixel = draw(&mut renderer, &s, &direct_only(3, 3)).at(1, 1)[0];
            let lane = renderer.lane();
            assert!((pixel - expected).abs() < 2e-3, "{lane:?} {texel:?} {pose:?} x {scale}: {pixel} for {expected}");
        }
    }
}

#[test]
fn a_mesh_without_coordinates_ignores_its_normal_map() {
    let mut data = MeshData { uvs: vec![Vec2::ZERO; 4], ..Default::default() };
    (data.positions, data.normals) = (picture().positions().to_vec(), picture().normals().to_vec());
    data.triangles = picture().triangles().to_vec();
    for mut renderer in lanes("a_mesh_without_coordinates_ignores_its_normal_map") {
        let image = |material: Material, renderer: &mut Renderer| {
            let mut s = HandScene::parallel(Vec3::new(0.1, 0.2, 3.0), Vec3::NEG_Z, 0.1);
            s.add(Mesh::new(data.clone()).unwrap(), material, at(Vec3::ZERO));
            s.0.textures.push(texture(1, &[[255, 128, 192, 255]], false));
            s.light(LightKind::Directional, Vec3::ZERO, Vec3::splat(PI)).direction_world = Vec3::NEG_Z;
            draw(renderer, &s, &direct_only(3, 3))
        };
        let plain = image(Material::lambert(Vec3::ONE), &mut renderer);
        let mapped = image(Material { normal_texture: map(0), ..Material::lambert(Vec3::ONE) }, &mut renderer);
        // Places with and without textures are shaded by different kernels: the same sums in another order.
        for (a, b) in plain.pixels.iter().flatten().zip(mapped.pixels.iter().flatten()) {
            assert!((a - b).abs() <= 1e-6, "{a} for {b}");
        }
    }
}

/// A grating 2 m wide whose right half is a hole, one metre before a wall that is white where light falls.
fn grating(cutoff: f32) -> HandScene {
    let mut s = HandScene::parallel(Vec3::new(0.0, 0.0, 5.0), Vec3::NEG_Z, 1.0);
    let holes = Material {
        base_color_texture: map(0),
        alpha_cutoff: cutoff,
        alpha: 1.0,
        ..Material { emissive: Vec3::X, ..Material::lambert(Vec3::ZERO) }
    };
    s.add(picture(), holes, at(Vec3::ZERO));
    s.0.textures.push(texture(2, &[[255, 255, 255, 200], [255, 255, 255, 100]], true));
    let wall = Affine3 { matrix3: Mat3::from_diagonal(Vec3::splat(4.0)), translation: Vec3::new(0.0, 0.0, -1.0) };
    s.add(picture(), Material::lambert(Vec3::ONE), wall);
    // From the left above, so that the hole's light falls beside the hole as the camera sees it.
    let light = s.light(LightKind::Directional, Vec3::ZERO, Vec3::splat(PI));
    light.direction_world = Vec3::new(-0.5, 0.0, -1.0).normalize();
    light.up_world = Vec3::Y;
    s
}

#[test]
fn masks_cut_holes_for_eyes_shadows_and_rays() {
    for mut renderer in lanes("masks_cut_holes_for_eyes_shadows_and_rays") {
        let lane = renderer.lane();
        for shadows in [Shadows::Moments, Shadows::Traced] {
            let settings = RenderSettings { shadows, vpl: None, ..fixtures::small(64, 64, 256) };
            let image = draw(&mut renderer, &grating(0.5), &settings);
            let red = |x: u32| image.at(x, 32)[0] - image.at(x, 32)[1];
            let white = |x: u32| image.at(x, 32)[1];
            assert!((8..24).all(|x| red(x) == 1.0), "{lane:?} {shadows:?}: the left half stands");
            assert!((36..60).all(|x| red(x) == 0.0), "{lane:?} {shadows:?}: the right half is open");
            // Light comes from the right: through the hole it falls from x = -0.5 to 0.5 on the wall, seen from 0 to 0.5.
            assert!((36..44).all(|x| white(x) > 0.8), "{lane:?} {shadows:?}: light through the hole");
            let solid = draw(&mut renderer, &grating(0.0), &settings);
            assert!((36..44).all(|x| solid.at(x, 32)[0] > 0.9), "{lane:?}: no mask, no hole");
            let all_hole = draw(&mut renderer, &grating(0.9), &settings);
            assert!((8..60).all(|x| all_hole.at(x, 32)[0] == all_hole.at(x, 32)[1]), "{lane:?}: all of it is a hole");
        }
    }
    let s = grating(0.5);
    let mut renderer = fixtures::cpu();
    let query = renderer.query(&s.0).unwrap();
    let ray = |x: f32| Ray::new(Vec3::new(x, 0.1, 5.0), Vec3::NEG_Z);
    assert_eq!(query.raycast(&ray(-0.5)).unwrap().stable_id, 0);
    assert_eq!(query.raycast(&ray(0.5)).unwrap().stable_id, 1);
    assert_eq!(query.raycast_many(&[ray(-0.5), ray(0.5)]).iter().flatten().map(|h| h.stable_id).sum::<u64>(), 1);
    let short = |x: f32| Ray { t_max: 5.5, ..ray(x) };
    assert_eq!([-0.5, 0.5].map(|x| query.occluded(&short(x))), [true, false]);
    assert_eq!(query.occluded_many(&[short(-0.5), short(0.5)]), [true, false]);
    // Moved, it is followed without another build.
    let mut moved = s.clone();
    moved.0.begin_revision();
    moved.0.set_transform(0, at(Vec3::new(1.0, 0.0, 0.0)));
    let query = renderer.query(&moved.0).unwrap();
    assert_eq!([0.5, 1.5].map(|x| query.raycast(&ray(x)).unwrap().stable_id), [0, 1]);
}

#[test]
fn blending_covers_a_share_and_lets_the_rest_by() {
    for mut renderer in lanes("blending_covers_a_share_and_lets_the_rest_by") {
        let mut s = HandScene::parallel(Vec3::new(0.0, 0.0, 5.0), Vec3::NEG_Z, 0.5);
        let veil = Material { thin: true, transmission: 0.75, ..Material::lambert(Vec3::new(0.0, 0.8, 0.0)) };
        s.add(picture(), veil, at(Vec3::ZERO));
        // A closed box too is only a veil: two faces, no bend, no tint.
        let cube = catoptra_engine::shapes::cuboid(Vec3::new(0.3, 2.0, 0.3), [Vec3::ONE; 6]);
        s.add(cube, Material { ior: 1.5, ..veil }, at(Vec3::new(0.35, 0.0, -1.0)));
        s.add(picture(), Material { unlit: true, ..Material::lambert(Vec3::new(1.0, 0.5, 0.25)) }, at(Vec3::Z * -3.0));
        s.light(LightKind::Directional, Vec3::ZERO, Vec3::splat(PI)).direction_world = Vec3::NEG_Z;
        let image = draw(&mut renderer, &s, &direct_only(32, 32));
        let veiled = Vec3::new(0.0, 0.8, 0.0) * 0.25 + Vec3::new(1.0, 0.5, 0.25) * 0.75;
        let got = Vec3::from(image.at(8, 16));
        assert!((got - veiled).length() < 1e-3, "{:?}: {got} for {veiled}", renderer.lane());
        let twice_more = Vec3::from(image.at(28, 16));
        // Front and back of the box, the back one lit from behind: two-sided shading does not light it from the front.
        let green = Vec3::new(0.0, 0.8, 0.0) * 0.25;
        let behind = Vec3::new(1.0, 0.5, 0.25) * (0.75 * 0.75);
        assert!((twice_more.x - 0.75 * behind.x).abs() < 1e-3, "{:?}: {twice_more}", renderer.lane());
        assert!(twice_more.y >= green.y + 0.75 * (green.y + 0.0) + 0.75 * behind.y - 1e-3);
    }
}

#[test]
fn lanes_agree_on_a_masked_and_mapped_scene() {
    let Some(mut gpu) = gpu_or_skip("lanes_agree_on_a_masked_and_mapped_scene") else { return };
    assert_eq!(gpu.lane(), RasterLane::Gpu);
    let mut s = grating(0.5);
    s.0.materials[1].normal_texture = map(1);
    s.0.textures.push(texture(2, &[[200, 128, 200, 255], [60, 160, 220, 255]], false));
    let settings = fixtures::small(96, 64, 256);
    let a = draw(&mut gpu, &s, &settings);
    let b = fixtures::fresh(&s.0, &settings).image;
    let c = catoptra_render_hybrid::metrics::compare(&a, &b).unwrap();
    assert!(c.flip.mean() <= 0.02, "FLIP {}", c.flip.mean());
}
