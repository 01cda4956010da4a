//! The wgpu lane alone: answers derivable on paper, agreement with itself, what it sends, how it fails.

use catoptra_engine::{
    Camera, Environment, Instance, Light, LightKind, Material, Mesh, MeshData, Projection, RenderScene, Texture,
    TextureRef, Wrap,
    camera::world_from_view_looking_at,
    glam::{Affine3, Vec2, Vec3},
    shapes,
};
use catoptra_render_hybrid::{
    GlassShadows, Image, Layer, RenderError, RenderSettings, Shadows, SimdLevel,
    image_io::srgb8_from_image,
    raster::{GpuRaster, Indirect},
    twin::{
        shadow::{ShadowMaps, ShadowPlan},
        vpl::{Vpl, vpl_irradiance},
    },
};
use catoptra_tests::opened_or_skip;
use std::{f32::consts::PI, sync::Arc};

const SIZE: u32 = 64;

fn lane(test: &str) -> Option<GpuRaster> {
    opened_or_skip(test, GpuRaster::new())
}

fn settings(shadows: Shadows) -> RenderSettings {
    RenderSettings { width: SIZE, height: SIZE, shadows, ..RenderSettings::default() }
}

fn plan(scene: &RenderScene, settings: &RenderSettings) -> ShadowPlan {
    ShadowPlan::new(&scene.lights, scene.bounds_world(), &settings.moments)
}

fn point_light(position_world: Vec3, intensity: f32) -> Light {
    Light {
        stable_id: 0,
        kind: LightKind::Point,
        position_world,
        direction_world: Vec3::NEG_Y,
        up_world: Vec3::Z,
        intensity: Vec3::splat(intensity),
        radius: 0.0,
    }
}

fn floor(half: f32) -> Mesh {
    let corners = [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)].map(|(x, z)| Vec3::new(x, 0.0, z) * half);
    let mut data = MeshData {
        positions: corners.to_vec(),
        normals: vec![Vec3::Y; 4],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..MeshData::default()
    };
    data.uvs = [(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)].map(|(u, v)| Vec2::new(u, v)).to_vec();
    Mesh::new(data).unwrap()
}

/// A floor of 4 x 4 m seen from above by an orthographic camera of 2 x 2 m: pixel (x, y) shows the place
/// ((x + 0.5)/SIZE · 2 − 1, 0, ...).
fn floor_scene(material: Material, lights: Vec<Light>) -> RenderScene {
    RenderScene {
        meshes: vec![Arc::new(floor(2.0))],
        materials: vec![material],
        instances: vec![Instance { stable_id: 1, mesh: 0, material: 0, world_from_object: Affine3::IDENTITY }],
        lights,
        camera: Camera {
            world_from_view: world_from_view_looking_at(Vec3::Y * 3.0, Vec3::ZERO),
            projection: Projection::Orthographic { half_height: 1.0 },
            near: 0.01,
        },
        environment: Environment { background: Vec3::new(0.1, 0.2, 0.3), ambient: Vec3::ZERO },
        ..RenderScene::default()
    }
}

/// The place that a pixel shows, by the camera's own rays.
fn floor_point(scene: &RenderScene, pixel: usize) -> Vec3 {
    let (x, y) = (pixel as u32 % SIZE, pixel as u32 / SIZE);
    let (o, d) = scene.camera.ray(x as f32 + 0.5, y as f32 + 0.5, SIZE, SIZE);
    o - d * (o.y / d.y)
}

fn render(gpu: &mut GpuRaster, scene: &RenderScene, settings: &RenderSettings, vpls: &[Vpl]) -> Image {
    gpu.begin(scene, settings, &plan(scene, settings)).unwrap();
    gpu.light(vpls, f32::INFINITY, None, Indirect::Vpls).unwrap();
    gpu.compose(&[]).unwrap();
    gpu.read_layer(Layer::Final).unwrap()
}

fn assert_close(what: &str, got: f32, expected: f32, tolerance: f32) {
    assert!((got - expected).abs() <= tolerance * expected.abs().max(1e-3), "{what}: {got}, on paper {expected}");
}

#[test]
fn lambert_under_a_point_light() {
    let Some(mut gpu) = lane("lambert_under_a_point_light") else { return };
    let scene = floor_scene(Material::lambert(Vec3::new(0.8, 0.5, 0.2)), vec![point_light(Vec3::Y * 2.0, 10.0)]);
    let image = render(&mut gpu, &scene, &settings(Shadows::Off), &[]);
    for (i, p) in image.pixels.iter().enumerate() {
        let to_light = Vec3::Y * 2.0 - floor_point(&scene, i);
        let d2 = to_light.length_squared();
        // base_color/π · I cos/d², cos = 2/d
        let expected = Vec3::new(0.8, 0.5, 0.2) / PI * 10.0 * (2.0 / d2.sqrt()) / d2;
        for (got, expected) in p.iter().zip(expected.to_array()) {
            assert_close("radiance", *got, expected, 1e-5);
        }
    }
}

#[test]
fn one_vpl_and_many() {
    let Some(mut gpu) = lane("one_vpl_and_many") else { return };
    // The paper value: ρ 0.5, flux 2, distance 2, both cosines 1, seen in the middle.
    let scene = floor_scene(Material::lambert(Vec3::splat(0.5)), vec![]);
    let vpl = |flux: f32| Vpl {
        position_world: Vec3::Y * 2.0,
        normal_world: Vec3::NEG_Y,
        flux: Vec3::splat(flux),
        ..Vpl::default()
    };
    let one = render(&mut gpu, &scene, &settings(Shadows::Off), &[vpl(2.0)]);
    let middle = one.at(SIZE / 2, SIZE / 2)[0];
    assert_close("one VPL", middle, 0.025_330_296, 1e-3);
    for (i, p) in one.pixels.iter().enumerate() {
        let expected = vpl_irradiance(&vpl(2.0), floor_point(&scene, i), Vec3::Y, f32::INFINITY) * (0.5 / PI);
        assert_close("one VPL", p[0], expected.x, 1e-5);
    }
    // The same flux in 2,500 parts: three chunks, which must all count; empty slots add nothing.
    let mut parts = vec![vpl(2.0 / 2500.0); 2500];
    parts.insert(7, vpl(0.0));
    let many = render(&mut gpu, &scene, &settings(Shadows::Off), &parts);
    assert_close("2,500 VPLs", many.at(SIZE / 2, SIZE / 2)[0], middle, 1e-4);
    // Two chunks end in the same target as three.
    let two = render(&mut gpu, &scene, &settings(Shadows::Off), &parts[..1300]);
    assert_close("1,300 VPLs", two.at(SIZE / 2, SIZE / 2)[0], middle * 1299.0 / 2500.0, 1e-4);
    assert_eq!(render(&mut gpu, &scene, &settings(Shadows::Off), &[]).at(3, 3), [0.0; 3]);
}

#[test]
fn ambient_emission_background_and_unlit() {
    let Some(mut gpu) = lane("ambient_emission_background_and_unlit") else { return };
    let material = Material {
        base_color: Vec3::splat(0.5),
        ambient: 0.4,
        emissive: Vec3::new(0.0, 3.0, 0.0),
        mirror: 0.25,
        ..Material::default()
    };
    let mut scene = floor_scene(material, vec![]);
    scene.environment.ambient = Vec3::splat(2.0);
    let image = render(&mut gpu, &scene, &settings(Shadows::Off), &[]);
    // k_a · base_color · i_a · (1 − mirror) + emissive
    assert_close("ambient", image.at(5, 9)[0], 0.4 * 0.5 * 2.0 * 0.75, 1e-6);
    assert_close("emissive", image.at(5, 9)[1], 0.3 + 3.0, 1e-6);

    scene.materials[0] = Material { unlit: true, base_color: Vec3::new(0.1, 0.2, 0.3), ..Material::default() };
    scene.lights.push(point_light(Vec3::Y, 50.0));
    assert_eq!(render(&mut gpu, &scene, &settings(Shadows::Off), &[]).at(5, 9), [0.1, 0.2, 0.3]);

    scene.instances.clear();
    let empty = render(&mut gpu, &scene, &settings(Shadows::Moments), &[]);
    assert!(empty.pixels.iter().all(|p| *p == [0.1, 0.2, 0.3]), "an empty world shows the background");
}

#[test]
fn blinn_phong_highlight() {
    let Some(mut gpu) = lane("blinn_phong_highlight") else { return };
    let material =
        Material { diffuse: 0.0, specular: Vec3::splat(0.3), shininess: 50.0, ..Material::lambert(Vec3::ONE) };
    let scene = floor_scene(material, vec![point_light(Vec3::Y * 2.0, 10.0)]);
    let image = render(&mut gpu, &scene, &settings(Shadows::Off), &[]);
    for (i, p) in image.pixels.iter().enumerate() {
        let to_light = Vec3::Y * 2.0 - floor_point(&scene, i);
        let (d, wi) = (to_light.length(), to_light.normalize());
        // The camera looks straight down from everywhere: H lies between wi and +Y.
        let n_dot_h = (wi + Vec3::Y).normalize().y;
        let lobe = 0.3 * 58.0 / (8.0 * PI) * catoptra_engine::math::pow(n_dot_h, 50.0);
        assert_close("highlight", p[0], lobe * wi.y * 10.0 / (d * d), 1e-4);
    }
}

/// A floor with a box that floats over its middle.
fn box_over_floor(kind: LightKind) -> RenderScene {
    let mut light = point_light(Vec3::new(0.2, 3.0, 0.1), 20.0);
    light.kind = kind;
    let mut scene = floor_scene(Material::lambert(Vec3::splat(0.7)), vec![light]);
    scene.meshes.push(Arc::new(shapes::cuboid(Vec3::splat(0.2), [Vec3::ONE; 6])));
    scene.instances.push(Instance {
        stable_id: 2,
        mesh: 1,
        material: 0,
        world_from_object: Affine3::from_translation(Vec3::Y * 0.5),
    });
    // From the side, so that the box does not hide its shadow.
    scene.camera = Camera::looking_at(Vec3::new(0.0, 1.2, 2.5), Vec3::ZERO, 0.9);
    scene
}

const KINDS: [LightKind; 3] =
    [LightKind::Point, LightKind::Spot { cos_inner: 0.9, cos_outer: 0.7 }, LightKind::Directional];

#[test]
fn moments_darken_what_the_twin_darkens() {
    let Some(mut gpu) = lane("moments_darken_what_the_twin_darkens") else { return };
    let mut hard = 0;
    for (kind, soft) in KINDS.into_iter().flat_map(|kind| [(kind, false), (kind, true)]) {
        let mut scene = box_over_floor(kind);
        scene.lights[0].radius = 0.1;
        let mut on = settings(Shadows::Moments);
        on.moments.soft = soft;
        let lit = render(&mut gpu, &scene, &settings(Shadows::Off), &[]);
        let shadowed = render(&mut gpu, &scene, &on, &[]);
        let (plan, made) = (plan(&scene, &on), gpu.read_moments().unwrap());
        let mut maps = ShadowMaps { plan, maps: made, ..ShadowMaps::default() };
        maps.make_levels(SimdLevel::Auto);
        assert_eq!(maps.maps.len(), maps.plan.views.len());
        assert!(maps.maps.iter().zip(&maps.plan.views).all(|(m, v)| m.len() == (v.size * v.size) as usize));
        let places = gpu.read_gbuffer().unwrap();
        let (mut dark, mut compared, mut partly) = (0, 0, 0);
        for (i, (a, b)) in lit.pixels.iter().zip(&shadowed.pixels).enumerate() {
            if places.material[i] == u32::MAX || a[0] <= 0.0 {
                continue;
            }
            let place = Vec3::from(places.positions_world[i]);
            let twin = maps.visibility(0, scene.lights[0].position_world, place, &on.moments);
            // A steep Chebyshev bound multiplies the depths' rounding.
            assert!((b[0] / a[0] - twin).abs() < 5e-3, "{kind:?}, {soft}, pixel {i}: {} against {twin}", b[0] / a[0]);
            compared += 1;
            dark += u32::from(twin < 0.05);
            partly += u32::from(twin > 0.1 && twin < 0.9);
        }
        assert!(compared > 1000 && dark > 20, "{kind:?}: {compared} compared, {dark} dark");
        println!("{kind:?}, soft: {soft}: {partly} partly lit");
        assert!(!soft || partly > hard, "{kind:?}: {partly} places are partly lit, {hard} with hard shadows");
        hard = partly;
    }
}

#[test]
fn clear_glass_throws_no_shadow() {
    let Some(mut gpu) = lane("clear_glass_throws_no_shadow") else { return };
    let mut scene = box_over_floor(LightKind::Point);
    scene.materials.push(Material::glass(Vec3::ONE, 1.5));
    scene.instances[1].material = 1;
    let opaque = render(&mut gpu, &scene, &settings(Shadows::Moments), &[]);
    let clear = RenderSettings { glass_shadows: GlassShadows::Clear, ..settings(Shadows::Moments) };
    let clear = render(&mut gpu, &scene, &clear, &[]);
    let off = render(&mut gpu, &scene, &settings(Shadows::Off), &[]);
    let difference = |a: &Image, b: &Image| {
        a.pixels.iter().zip(&b.pixels).map(|(a, b)| f64::from((a[0] - b[0]).abs())).sum::<f64>() / a.pixels.len() as f64
    };
    assert!(difference(&clear, &off) < 1e-4, "{}", difference(&clear, &off));
    assert!(difference(&opaque, &off) > 2e-3, "{}", difference(&opaque, &off));
}

#[test]
fn masked_pixels_are_listed_in_order() {
    let Some(mut gpu) = lane("masked_pixels_are_listed_in_order") else { return };
    let mut scene = box_over_floor(LightKind::Point);
    // Sizes that do and do not fill the blocks of the compaction.
    for (width, height) in [(64, 64), (61, 37), (1, 1), (200, 30)] {
        let settings = RenderSettings { width, height, ..settings(Shadows::Off) };
        scene.materials = vec![Material::default(); 2];
        scene.instances[1].material = 1;
        for material in [Material::mirror(Vec3::ONE, 0.5), Material::glass(Vec3::ONE, 1.5), Material::default()] {
            scene.materials[1] = material;
            gpu.begin(&scene, &settings, &plan(&scene, &settings)).unwrap();
            let list = gpu.read_masked_pixels().unwrap();
            let mask = gpu.read_layer(Layer::Mask).unwrap();
            let expected: Vec<u32> =
                (0..width * height).filter(|&i| mask.pixels[i as usize][..2] != [0.0, 0.0]).collect();
            assert_eq!(list, expected, "{width}x{height}");
            assert_eq!(list.is_empty(), !material.is_traced() || width == 1, "{width}x{height}");
        }
    }
}

#[test]
fn traced_pixels_are_added() {
    let Some(mut gpu) = lane("traced_pixels_are_added") else { return };
    let scene = floor_scene(Material { emissive: Vec3::ONE, ..Material::default() }, vec![]);
    let settings = settings(Shadows::Off);
    gpu.begin(&scene, &settings, &ShadowPlan::default()).unwrap();
    let indirect = vec![[0.0, 0.5, 0.0]; (SIZE * SIZE) as usize];
    gpu.light(&[], f32::INFINITY, None, Indirect::Layer(&indirect)).unwrap();
    let list = [(0, [1.0, 0.0, 0.0]), (70, [0.0, 0.0, 2.0]), (SIZE * SIZE - 1, [3.0; 3])];
    gpu.compose(&list).unwrap();
    let traced = gpu.read_layer(Layer::Traced).unwrap();
    let last = gpu.read_layer(Layer::Final).unwrap();
    for i in 0..(SIZE * SIZE) as usize {
        let own = list.iter().find(|(p, _)| *p as usize == i).map_or([0.0; 3], |(_, r)| *r);
        assert_eq!(traced.pixels[i], own);
        assert_eq!(last.pixels[i], [1.0 + own[0], 1.5 + own[1], 1.0 + own[2]]);
    }
    // The list of the frame before leaves nothing behind.
    gpu.compose(&[]).unwrap();
    assert!(gpu.read_layer(Layer::Traced).unwrap().pixels.iter().all(|p| *p == [0.0; 3]));
    // Planes of traced visibility scale each light.
    let lit = floor_scene(Material::default(), vec![point_light(Vec3::Y, 1.0), point_light(Vec3::Y * 2.0, 1.0)]);
    let full = render(&mut gpu, &lit, &settings, &[]);
    gpu.begin(&lit, &settings, &ShadowPlan::default()).unwrap();
    let planes = vec![vec![0.5; (SIZE * SIZE) as usize]; 2];
    gpu.light(&[], f32::INFINITY, Some(&planes), Indirect::Vpls).unwrap();
    let half = gpu.read_layer(Layer::Direct).unwrap();
    for (a, b) in full.pixels.iter().zip(&half.pixels) {
        assert_close("half visibility", b[0], a[0] * 0.5, 1e-6);
    }
}

#[test]
fn textures_are_sampled_as_on_the_cpu() {
    let Some(mut gpu) = lane("textures_are_sampled_as_on_the_cpu") else { return };
    let texels: Vec<[u8; 4]> =
        (0..7 * 5u32).map(|i| [(i * 7) as u8, (i * 31 % 256) as u8, (255 - i) as u8, 255]).collect();
    for srgb in [true, false] {
        let texture = Arc::new(Texture::new(7, 5, texels.clone(), srgb).unwrap());
        let r = TextureRef {
            wrap: [Wrap::Mirror, Wrap::Repeat],
            uv_transform: [[3.0, 0.5, 0.1], [0.0, 4.0, -0.3]],
            ..TextureRef::default()
        };
        let mut scene = floor_scene(
            Material { base_color_texture: Some(r), base_color: Vec3::new(1.0, 0.5, 0.25), ..Material::default() },
            vec![],
        );
        scene.textures = vec![texture.clone()];
        gpu.begin(&scene, &settings(Shadows::Off), &ShadowPlan::default()).unwrap();
        let albedo = gpu.read_layer(Layer::Albedo).unwrap();
        for (i, p) in albedo.pixels.iter().enumerate() {
            let place = floor_point(&scene, i);
            let uv = Vec2::new(place.x, place.z) * 0.25 + 0.5;
            let expected = texture.sample(&r, uv).truncate() * scene.materials[0].base_color;
            let off = (Vec3::from(*p) - expected).abs().max_element();
            assert!(off < 1e-5, "pixel {i}: {p:?}, on the CPU {expected}");
        }
    }
}

#[test]
fn layers_hold_what_they_say() {
    let Some(mut gpu) = lane("layers_hold_what_they_say") else { return };
    let mut scene = box_over_floor(LightKind::Directional);
    scene.camera = Camera {
        world_from_view: world_from_view_looking_at(Vec3::Y * 3.0, Vec3::ZERO),
        projection: Projection::Perspective { fov_y: 1.0 },
        near: 0.01,
    };
    // The underside of a triangle shows a normal towards the viewer as well.
    for flipped in [false, true] {
        if flipped {
            scene.instances[0].world_from_object = Affine3::from_rotation_x(PI);
        }
        // Depth and its square; the other filter keeps exponential warps of it.
        let mut vsm = settings(Shadows::Moments);
        vsm.moments.filter = catoptra_render_hybrid::ShadowFilter::Vsm;
        gpu.begin(&scene, &vsm, &plan(&scene, &vsm)).unwrap();
        let depth = gpu.read_layer(Layer::Depth).unwrap();
        let normal = gpu.read_layer(Layer::Normal).unwrap();
        assert_close("floor", depth.at(1, 1)[0], 3.0, 1e-5);
        assert_close("top of the box", depth.at(SIZE / 2, SIZE / 2)[0], 3.0 - 0.7, 1e-5);
        for pixel in [normal.at(1, 1), normal.at(SIZE / 2, SIZE / 2)] {
            assert!((Vec3::from(pixel) - Vec3::new(0.5, 1.0, 0.5)).length() < 1e-4, "{pixel:?}");
        }
        let moments = gpu.read_layer(Layer::Moments).unwrap();
        assert_eq!(moments.width, settings(Shadows::Moments).moments.size);
        assert!(moments.pixels.iter().all(|m| m[0] > 0.0 && m[0] <= 1.0 && m[1] <= m[0] + 1e-6 && m[2] == 0.0));
    }
    // What is nearer than the near plane is not seen: only the box's bottom is left, from inside.
    scene.camera.near = 2.5;
    gpu.begin(&scene, &settings(Shadows::Off), &ShadowPlan::default()).unwrap();
    let depth = gpu.read_layer(Layer::Depth).unwrap();
    assert_close("bottom of the box", depth.at(SIZE / 2, SIZE / 2)[0], 2.7, 1e-5);
}

#[test]
fn a_moved_world_equals_a_fresh_one_and_sends_little() {
    let Some(mut gpu) = lane("a_moved_world_equals_a_fresh_one") else { return };
    let settings = settings(Shadows::Moments);
    let mut scene = box_over_floor(LightKind::Point);
    let first = render(&mut gpu, &scene, &settings, &[]);
    let (sent_first, _) = gpu.counters();
    assert_eq!(render(&mut gpu, &scene, &settings, &[]), first, "the same scene again");

    // Teleport the box, the light and the camera.
    scene.begin_revision();
    scene.set_transform(1, Affine3::from_translation(Vec3::new(0.4, 0.8, -0.3)));
    scene.lights[0].position_world = Vec3::new(-0.5, 2.5, 0.3);
    scene.camera = Camera::looking_at(Vec3::new(1.5, 1.0, 2.0), Vec3::ZERO, 0.8);
    let moved = render(&mut gpu, &scene, &settings, &[]);
    let (sent_moved, _) = gpu.counters();
    assert_ne!(moved, first);
    assert!(sent_moved < 1200 && sent_moved < sent_first, "{sent_moved} bytes after {sent_first}");

    let mut fresh = lane("fresh").unwrap();
    let mut copy = scene.clone();
    copy.origin = Arc::new(());
    assert_eq!(render(&mut fresh, &copy, &settings, &[]).hash(), moved.hash());

    // A missed revision, another mesh and another material: all is compared.
    scene.begin_revision();
    scene.begin_revision();
    scene.meshes[1] = Arc::new(shapes::sphere(0.3, 8, 16));
    scene.materials[0] = Material::lambert(Vec3::new(0.1, 0.9, 0.1));
    scene.structure_revision = scene.revision;
    let other = render(&mut gpu, &scene, &settings, &[]);
    let mut fresh = lane("fresh").unwrap();
    assert_eq!(render(&mut fresh, &scene, &settings, &[]).hash(), other.hash());
    // Another size and back.
    let small = RenderSettings { width: 33, height: 21, ..settings };
    assert_eq!(render(&mut gpu, &scene, &small, &[]).pixels.len(), 33 * 21);
    assert_eq!(render(&mut gpu, &scene, &settings, &[]), other);
}

#[test]
fn presents_what_the_png_holds() {
    let Some(mut gpu) = lane("presents_what_the_png_holds") else { return };
    let scene = floor_scene(Material::lambert(Vec3::new(0.8, 0.5, 0.2)), vec![point_light(Vec3::Y * 2.0, 30.0)]);
    let image = render(&mut gpu, &scene, &settings(Shadows::Off), &[]);
    let expected = srgb8_from_image(&image, -1.0);
    for format in [wgpu::TextureFormat::Rgba8Unorm, wgpu::TextureFormat::Rgba8UnormSrgb] {
        let (device, queue) = gpu.device();
        let (device, queue) = (device.clone(), queue.clone());
        let extent = wgpu::Extent3d { width: SIZE, height: SIZE, depth_or_array_layers: 1 };
        let target = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("test.target"),
            size: extent,
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        gpu.present(&target.create_view(&Default::default()), format, -1.0).unwrap();
        let buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("test.buffer"),
            size: u64::from(SIZE * SIZE * 4),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = device.create_command_encoder(&Default::default());
        encoder.copy_texture_to_buffer(
            target.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &buffer,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(SIZE * 4),
                    rows_per_image: Some(SIZE),
                },
            },
            extent,
        );
        queue.submit([encoder.finish()]);
        buffer.map_async(wgpu::MapMode::Read, .., |r| r.unwrap());
        device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
        let shown = buffer.get_mapped_range(..).unwrap();
        for (i, (a, b)) in shown.chunks_exact(4).zip(expected.chunks_exact(3)).enumerate() {
            // The hardware's sRGB curve may round the other way.
            assert!((0..3).all(|c| a[c].abs_diff(b[c]) <= 1), "{format:?}, pixel {i}: {a:?} against {b:?}");
        }
    }
}

#[test]
fn mistakes_are_errors_not_panics() {
    let Some(mut gpu) = lane("mistakes_are_errors_not_panics") else { return };
    assert!(matches!(gpu.read_layer(Layer::Final), Err(RenderError::Gpu(_))), "nothing was begun");
    let scene = floor_scene(Material::default(), vec![point_light(Vec3::Y, 1.0)]);
    let settings = settings(Shadows::Off);
    gpu.begin(&scene, &settings, &ShadowPlan::default()).unwrap();
    let short = vec![vec![1.0; 3]];
    assert!(matches!(gpu.light(&[], 1.0, Some(&short), Indirect::Vpls), Err(RenderError::Settings(_))));
    assert!(matches!(gpu.light(&[], 1.0, None, Indirect::Layer(&[[0.0; 3]])), Err(RenderError::Settings(_))));
    let grid = RenderSettings {
        vpl: Some(catoptra_render_hybrid::VplOptions { spacing: 2, ..Default::default() }),
        width: 128,
        height: 128,
        ..settings
    };
    gpu.begin(&scene, &grid, &ShadowPlan::default()).unwrap();
    let points = [catoptra_render_hybrid::twin::grid::GridPoint::default(); 3];
    assert!(matches!(gpu.light(&[], 1.0, None, Indirect::Grid(&points)), Err(RenderError::Settings(_))));
    gpu.begin(&scene, &settings, &ShadowPlan::default()).unwrap();
    assert!(matches!(gpu.compose(&[(SIZE * SIZE, [1.0; 3])]), Err(RenderError::Settings(_))));
    // A lost device: destroyed behind the lane's back. The loss shows once its queue has run dry; every call after that is
    // an error, and none a panic.
    gpu.device().0.destroy();
    gpu.device().0.poll(wgpu::PollType::wait_indefinitely()).unwrap();
    let results = [
        gpu.begin(&scene, &RenderSettings { width: 80, ..settings }, &ShadowPlan::default()).err(),
        gpu.read_masked_pixels().err(),
        gpu.light(&[], 1.0, None, Indirect::Vpls).err(),
        gpu.compose(&[]).err(),
        gpu.read_layer(Layer::Final).err(),
    ];
    for (i, error) in results.into_iter().enumerate() {
        assert!(matches!(error, Some(RenderError::Gpu(_))), "call {i}: {error:?}");
    }
}

#[test]
fn a_borrowed_device_serves_and_passes_are_timed() {
    let Some(owner) = lane("a_borrowed_device_serves") else { return };
    let (device, queue) = owner.device();
    let mut gpu = GpuRaster::from_device(device.clone(), queue.clone()).unwrap();
    gpu.set_timing(true);
    let scene = box_over_floor(LightKind::Point);
    render(&mut gpu, &scene, &settings(Shadows::Moments), &[Vpl { flux: Vec3::ONE, ..Vpl::default() }]);
    let times = gpu.take_pass_times().unwrap();
    let names: Vec<_> = times.iter().map(|t| t.0).collect();
    assert_eq!(names, ["moments", "gbuffer", "compact", "direct", "indirect", "compose"]);
    assert!(times.iter().all(|t| t.1 > 0.0 && t.1 < 60_000.0), "{times:?}");
    assert!(gpu.take_pass_times().unwrap().is_empty());
    let (up, down) = gpu.counters();
    assert!(up > 0 && down >= u64::from(SIZE * SIZE) * 16);
}

#[test]
fn default_limits_suffice_and_lesser_ones_are_refused() {
    // What every WebGPU implementation grants: the lane asks for no more, so it runs on any host's device.
    if lane("default_limits_suffice").is_none() {
        return;
    }
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY));
    let device = |required_limits| {
        let descriptor = wgpu::DeviceDescriptor { required_limits, ..Default::default() };
        pollster::block_on(adapters[0].request_device(&descriptor)).unwrap()
    };
    let (own, queue) = device(wgpu::Limits::default());
    let mut gpu = GpuRaster::from_device(own, queue).unwrap();
    gpu.set_timing(true);
    let scene = box_over_floor(LightKind::Point);
    let vpls = [Vpl { flux: Vec3::ONE, ..Vpl::default() }];
    let borrowed = render(&mut gpu, &scene, &settings(Shadows::Moments), &vpls);
    // No timestamps were asked for: stages are timed by waiting.
    assert_eq!(gpu.take_pass_times().unwrap().len(), 6);
    let mut best = lane("default_limits_suffice").unwrap();
    assert_eq!(borrowed, render(&mut best, &scene, &settings(Shadows::Moments), &vpls));

    let few = wgpu::Limits { max_storage_buffers_per_shader_stage: 4, ..wgpu::Limits::default() };
    let (own, queue) = device(few);
    match GpuRaster::from_device(own, queue) {
        Err(RenderError::Unavailable { missing, .. }) => assert!(missing.contains("storage buffers"), "{missing}"),
        other => panic!("{:?}", other.err()),
    }

    // A picture larger than the device's textures is an error, and the lane still works afterwards.
    let wide = RenderSettings { width: 10_000, height: 4, ..settings(Shadows::Off) };
    let error = gpu.begin(&scene, &wide, &ShadowPlan::default()).unwrap_err();
    assert!(error.to_string().contains("10000x4"), "{error}");
    assert_eq!(borrowed, render(&mut gpu, &scene, &settings(Shadows::Moments), &vpls));
}
