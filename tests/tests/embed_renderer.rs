//! The module without an ECS: one call to a picture, a borrowed device, faults, and questions by rays.

use catoptra_engine::{Light, LightKind, Material, RenderScene, glam::Vec3, shapes};
use catoptra_render_hybrid::{
    RasterLane, RenderError, RenderSettings, Renderer, RendererOptions, SurfaceHit,
    accel::Ray,
    raster::{GpuRaster, testing::InjectedFault},
    render_to_image, wgpu,
};
use catoptra_tests::{HandScene, at, fixtures, opened_or_skip, skip};

const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

fn scene() -> RenderScene {
    let camera = catoptra_engine::Camera::looking_at(Vec3::new(0.0, 1.0, 5.0), Vec3::ZERO, 0.8);
    let mut s = HandScene::new(camera).background(Vec3::new(0.1, 0.2, 0.4));
    s.add(shapes::cuboid(Vec3::new(6.0, 0.5, 6.0), [Vec3::ONE; 6]), Material::default(), at(Vec3::new(0.0, -1.6, 0.0)));
    s.add(shapes::sphere(1.0, 16, 32), Material::mirror(Vec3::new(1.0, 0.8, 0.6), 0.8), at(Vec3::ZERO));
    s.light(LightKind::Point, Vec3::new(2.0, 4.0, 3.0), Vec3::splat(40.0));
    s.0
}

fn settings() -> RenderSettings {
    fixtures::small(96, 64, 64)
}

/// A device as a host would ask for it, or `None` after a loud skip.
fn host(test: &str, limits: impl Fn(&wgpu::Adapter) -> wgpu::Limits) -> Option<(wgpu::Device, wgpu::Queue)> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends: wgpu::Backends::PRIMARY,
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    });
    let Ok(adapter) = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default())) else {
        skip(test, "no Vulkan, Metal or Direct3D 12 adapter");
        return None;
    };
    let descriptor =
        wgpu::DeviceDescriptor { label: Some("host"), required_limits: limits(&adapter), ..Default::default() };
    Some(pollster::block_on(adapter.request_device(&descriptor)).expect("an adapter gives a device"))
}

fn picture(device: &wgpu::Device) -> wgpu::Texture {
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some("host.picture"),
        size: wgpu::Extent3d { width: 96, height: 64, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: FORMAT,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    })
}

fn read(device: &wgpu::Device, queue: &wgpu::Queue, texture: &wgpu::Texture) -> Vec<u8> {
    let row = 96 * 4_u32;
    let padded = row.next_multiple_of(256);
    let buffer = device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("host.read"),
        size: u64::from(padded) * 64,
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&Default::default());
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        wgpu::TexelCopyBufferInfo {
            buffer: &buffer,
            layout: wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(padded), rows_per_image: None },
        },
        texture.size(),
    );
    queue.submit([encoder.finish()]);
    buffer.slice(..).map_async(wgpu::MapMode::Read, |r| r.expect("a small buffer can be mapped"));
    device.poll(wgpu::PollType::wait_indefinitely()).expect("the device answers");
    let data = buffer.slice(..).get_mapped_range().expect("it is mapped");
    data.chunks_exact(padded as usize).flat_map(|l| l[..row as usize].to_vec()).collect()
}

/// Greatest difference of bytes, alpha left out, and the share of bytes that differ by more than 2.
fn difference(a: &[u8], b: &[u8]) -> (u8, f64) {
    let rgb = |v: &[u8]| v.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect::<Vec<_>>();
    let apart: Vec<u8> = rgb(a).iter().zip(rgb(b)).map(|(x, y)| x.abs_diff(y)).collect();
    let far = apart.iter().filter(|d| **d > 2).count();
    (apart.iter().copied().max().unwrap_or(0), far as f64 / apart.len() as f64)
}

fn as_bytes(image: &catoptra_render_hybrid::Image) -> Vec<u8> {
    let rgb = catoptra_render_hybrid::image_io::srgb8_from_image(image, 0.0);
    rgb.chunks_exact(rgb.len() / (96 * 64)).flat_map(|p| [p[0], p[1], p[2], 255]).collect()
}

#[test]
fn one_call_makes_a_picture() {
    let image = render_to_image(&scene(), &settings()).unwrap();
    assert_eq!((image.width, image.height), (96, 64));
    assert!(image.pixels.iter().flatten().all(|v| v.is_finite()));
    let mut broken = scene();
    broken.instances[0].mesh = 9;
    assert!(matches!(render_to_image(&broken, &settings()), Err(RenderError::Scene(_))));
}

#[test]
fn a_view_of_the_hosts_shows_the_picture_whatever_lane_made_it() {
    let test = "a_view_of_the_hosts_shows_the_picture_whatever_lane_made_it";
    let Some((device, queue)) = host(test, |a| a.limits()) else { return };
    let texture = picture(&device);
    let view = texture.create_view(&Default::default());
    let expected = as_bytes(&fixtures::fresh(&scene(), &settings()).image);
    for raster in [RasterLane::Cpu, RasterLane::Gpu] {
        let options = RendererOptions { raster, ..Default::default() };
        let mut renderer = Renderer::with_device(device.clone(), queue.clone(), options).unwrap();
        let mut last = None;
        for _ in 0..2 {
            let stats = renderer.render_to_view(&scene(), &settings(), &view, FORMAT, 0.0).unwrap();
            assert_eq!(stats.raster, raster);
            let shown = read(&device, &queue, &texture);
            let (most, far) = difference(&shown, &expected);
            let allowed = if raster == RasterLane::Cpu { 0.0 } else { 0.03 };
            assert!(far <= allowed, "{raster:?}: {far} of the bytes differ, by up to {most}");
            assert!(last.replace(shown.clone()).is_none_or(|l| l == shown), "frame 0 is a later frame, bit for bit");
        }
        // Two stops darker is darker.
        renderer.render_to_view(&scene(), &settings(), &view, FORMAT, -2.0).unwrap();
        assert!(difference(&read(&device, &queue, &texture), &expected).1 > 0.5);
    }
}

#[test]
fn the_hosts_error_handling_stays_the_hosts() {
    let Some((device, queue)) = host("the_hosts_error_handling_stays_the_hosts", |a| a.limits()) else { return };
    let seen = std::sync::Arc::new(std::sync::Mutex::new(Vec::new()));
    let sink = seen.clone();
    device.on_uncaptured_error(std::sync::Arc::new(move |e: wgpu::Error| sink.lock().unwrap().push(e.to_string())));
    let options = RendererOptions { raster: RasterLane::Gpu, ..Default::default() };
    let mut renderer = Renderer::with_device(device.clone(), queue, options).unwrap();
    renderer.render(&scene(), &settings()).unwrap();
    assert!(seen.lock().unwrap().is_empty(), "the renderer's work raises nothing");
    // A mistake of the host's own still reaches the host, and not the renderer.
    let _ = device.create_texture(&wgpu::TextureDescriptor {
        label: Some("host.mistake"),
        size: wgpu::Extent3d { width: 0, height: 1, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: FORMAT,
        usage: wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    });
    assert_eq!(seen.lock().unwrap().len(), 1);
    renderer.render(&scene(), &settings()).unwrap();
}

#[test]
fn a_device_that_lacks_something_is_told_or_only_shows() {
    let test = "a_device_that_lacks_something_is_told_or_only_shows";
    let weak = |_: &wgpu::Adapter| wgpu::Limits { max_storage_buffers_per_shader_stage: 4, ..wgpu::Limits::default() };
    let Some((device, queue)) = host(test, weak) else { return };
    let options = |raster| RendererOptions { raster, ..Default::default() };
    match Renderer::with_device(device.clone(), queue.clone(), options(RasterLane::Gpu)) {
        Err(RenderError::Unavailable { missing, .. }) => assert!(missing.contains("storage buffers"), "{missing}"),
        other => panic!("refused by name was expected: {:?}", other.map(|r| r.device())),
    }
    let mut renderer = Renderer::with_device(device.clone(), queue, options(RasterLane::Auto)).unwrap();
    assert_eq!(renderer.lane(), RasterLane::Cpu);
    let texture = picture(&device);
    let view = texture.create_view(&Default::default());
    renderer.render_to_view(&scene(), &settings(), &view, FORMAT, 0.0).unwrap();
    // Without any device a view is refused with what to do.
    let error = fixtures::cpu().render_to_view(&scene(), &settings(), &view, FORMAT, 0.0).unwrap_err();
    assert!(error.to_string().contains("with_device"), "{error}");
}

/// A renderer with the GPU lane on the host's device, whatever kind of adapter that is.
fn on_gpu(device: &wgpu::Device, queue: &wgpu::Queue, options: RendererOptions) -> Renderer {
    let gpu = GpuRaster::from_device(device.clone(), queue.clone()).unwrap();
    Renderer::with_gpu(options, Some(gpu)).unwrap()
}

#[test]
fn a_lost_surface_costs_one_picture_and_not_the_lane() {
    let Some((device, queue)) = host("a_lost_surface_costs_one_picture_and_not_the_lane", |a| a.limits()) else {
        return;
    };
    let lost = |format| {
        let texture = picture(&device);
        let view = texture.create_view(&Default::default());
        texture.destroy();
        (texture, view, format)
    };
    for raster in [RasterLane::Auto, RasterLane::Gpu, RasterLane::Cpu] {
        let options = RendererOptions { raster, ..Default::default() };
        // `Auto` would leave a software adapter to the CPU: here it has the GPU lane.
        let mut renderer = match raster {
            RasterLane::Auto => on_gpu(&device, &queue, options),
            _ => Renderer::with_device(device.clone(), queue.clone(), options).unwrap(),
        };
        let lane = renderer.lane();
        assert_eq!(lane == RasterLane::Cpu, raster == RasterLane::Cpu);
        // As a swap chain leaves it when its window goes or changes: the texture is gone, or is not of the format asked for.
        let other = picture(&device);
        let other_view = other.create_view(&Default::default());
        for (_texture, view, format) in
            [lost(FORMAT), (other, other_view, wgpu::TextureFormat::Bgra8Unorm), lost(FORMAT)]
        {
            match renderer.render_to_view(&scene(), &settings(), &view, format, 0.0) {
                Err(RenderError::View(why)) => assert!(!why.is_empty() && !why.contains('\n'), "{why}"),
                outcome => panic!("{raster:?}: {:?}", outcome.map(|s| s.raster)),
            }
        }
        assert_eq!((renderer.lane(), renderer.fault()), (lane, None), "the view was at fault, not the GPU");
        let good = picture(&device);
        renderer.render_to_view(&scene(), &settings(), &good.create_view(&Default::default()), FORMAT, 0.0).unwrap();
        let expected = as_bytes(&fixtures::fresh(&scene(), &settings()).image);
        assert!(difference(&read(&device, &queue, &good), &expected).1 <= 0.03, "{raster:?}");
    }
}

#[test]
fn a_scene_too_large_for_the_adapter_is_told_or_goes_to_the_cpu() {
    let test = "a_scene_too_large_for_the_adapter_is_told_or_goes_to_the_cpu";
    let small = |a: &wgpu::Adapter| wgpu::Limits { max_storage_buffer_binding_size: 128 << 10, ..a.limits() };
    let Some((device, queue)) = host(test, small) else { return };
    let mut large = scene();
    let ball = shapes::sphere(1.0, 64, 128);
    assert!(ball.positions().len() * 60 > 128 << 10);
    large.meshes[1] = std::sync::Arc::new(ball);
    for raster in [RasterLane::Auto, RasterLane::Gpu] {
        let options = RendererOptions { raster, ..Default::default() };
        let mut renderer = on_gpu(&device, &queue, options);
        assert_eq!(renderer.lane(), RasterLane::Gpu);
        match renderer.render(&large, &settings()) {
            Err(RenderError::Gpu(why)) if raster == RasterLane::Gpu => {
                assert!(why.contains("vertices") && why.contains("131072"), "{why}");
            }
            Ok(frame) if raster == RasterLane::Auto => {
                assert_eq!(frame.image.hash(), fixtures::fresh(&large, &settings()).image.hash());
            }
            outcome => panic!("{raster:?}: {:?}", outcome.map(|f| f.stats.raster)),
        }
    }
}

#[test]
fn with_auto_the_cpu_takes_over_from_a_broken_gpu() {
    let expected = fixtures::fresh(&scene(), &settings()).image.hash();
    for fault in [InjectedFault::DeviceLost, InjectedFault::OutOfMemory] {
        for explicit in [false, true] {
            let Some(gpu) = opened_or_skip("with_auto_the_cpu_takes_over_from_a_broken_gpu", GpuRaster::new()) else {
                return;
            };
            let raster = if explicit { RasterLane::Gpu } else { RasterLane::Auto };
            let options = RendererOptions { raster, ..Default::default() };
            let mut renderer = Renderer::with_gpu(options, Some(gpu)).unwrap();
            renderer.render(&scene(), &settings()).unwrap();
            assert_eq!(renderer.lane(), RasterLane::Gpu);
            renderer.gpu_mut().unwrap().inject_fault(fault);
            match renderer.render(&scene(), &settings()) {
                Err(RenderError::Gpu(why)) if explicit => assert!(!why.is_empty() && !why.contains('\n'), "{why}"),
                Ok(frame) if !explicit => {
                    assert_eq!(frame.stats.raster, RasterLane::Cpu);
                    assert_eq!(frame.image.hash(), expected, "{fault:?}: the picture of the CPU lane");
                    assert!(renderer.fault().is_some());
                    assert_eq!(renderer.render(&scene(), &settings()).unwrap().image.hash(), expected);
                }
                other => panic!("{fault:?}, explicit {explicit}: {:?}", other.map(|f| f.stats)),
            }
        }
    }
}

#[test]
fn rays_find_what_arithmetic_says() {
    let s = scene();
    let mut renderer = fixtures::cpu();
    let query = renderer.query(&s).unwrap();
    let down = Ray::new(Vec3::new(0.0, 5.0, 0.0), Vec3::NEG_Y);
    let hit = query.raycast(&down).unwrap();
    assert_eq!((hit.stable_id, hit.front), (1, true));
    assert!((hit.t - 4.0).abs() < 1e-5 && (hit.normal - Vec3::Y).length() < 1e-2);
    // Ball twice, slab twice, in order, and no more than asked for.
    let all = query.raycast_all(&down, 10);
    assert_eq!(all.iter().map(|h| h.stable_id).collect::<Vec<_>>(), [1, 1, 0, 0]);
    let distances = [4.0, 6.0, 6.1, 7.1];
    assert!(all.iter().zip(distances).all(|(h, d)| (h.t - d).abs() < 1e-4));
    assert_eq!(query.raycast_all(&down, 2), all[..2]);
    // The batch is the single, ray by ray, and the picture's middle is what the camera looks at.
    let rays: Vec<Ray> = (0..3000)
        .map(|i| {
            Ray::new(Vec3::new(0.0, 1.0, 5.0), Vec3::new((i % 60) as f32 * 0.03 - 0.9, i as f32 * 3e-4 - 0.6, -1.0))
        })
        .collect();
    let single: Vec<Option<SurfaceHit>> = rays.iter().map(|r| query.raycast(r)).collect();
    assert_eq!(query.raycast_many(&rays), single);
    assert!(single.iter().any(Option::is_none) && single.iter().flatten().any(|h| h.stable_id == 1));
    let occluded: Vec<bool> = rays.iter().map(|r| query.occluded(r)).collect();
    assert_eq!(occluded, single.iter().map(Option::is_some).collect::<Vec<_>>());
    assert_eq!(query.occluded_many(&rays), occluded);
    assert_eq!(query.pick(48.0, 32.0, 96, 64).unwrap().stable_id, 1);
    assert!(query.sees(Vec3::new(0.0, 1.0, 5.0), Vec3::new(0.0, 0.0, 1.0)));
    assert!(!query.sees(Vec3::new(0.0, 1.0, 5.0), Vec3::new(0.0, 0.0, -1.0)));
    for bad in [Vec3::NAN, Vec3::ZERO, Vec3::INFINITY] {
        assert_eq!(query.raycast(&Ray::new(Vec3::ZERO, bad)), None);
    }
    // Questions leave no mark on the pictures: glass that throws no shadow still throws none.
    let clear =
        RenderSettings { glass_shadows: catoptra_render_hybrid::GlassShadows::Clear, ..HandScene::settings(48, 32) };
    let mut glass = s.clone();
    glass.materials[1] = Material::glass(Vec3::ONE, 1.5);
    let expected = fixtures::fresh(&glass, &clear).image.hash();
    renderer.query(&glass).unwrap().occluded(&down);
    assert_eq!(renderer.render(&glass, &clear).unwrap().image.hash(), expected);
}

#[test]
fn light_from_a_hand_made_scene_needs_no_ecs() {
    let mut s = scene();
    let lit = fixtures::fresh(&s, &settings()).image;
    s.lights = vec![Light { intensity: Vec3::ZERO, ..s.lights[0] }];
    let dark = fixtures::fresh(&s, &settings()).image;
    let sum = |i: &catoptra_render_hybrid::Image| i.pixels.iter().flatten().sum::<f32>();
    assert!(sum(&lit) > 1.1 * sum(&dark));
}
