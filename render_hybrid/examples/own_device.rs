//! The host owns device, queue and texture; the renderer borrows them and draws into a view, as it would into a window's
//! frame or an egui texture.

use catoptra_engine::{
    Camera, Instance, Light, Material, RenderScene,
    glam::{Affine3, Vec3},
    shapes,
};
use catoptra_render_hybrid::{RenderSettings, Renderer, RendererOptions, wgpu};
use std::sync::Arc;

const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8UnormSrgb;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let Ok(adapter) = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default())) else {
        println!("no graphics adapter here: nothing to lend");
        return Ok(());
    };
    // The adapter's own limits let the GPU lane run; with less, the CPU makes the picture and the device shows it.
    let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
        label: Some("host"),
        required_limits: adapter.limits(),
        ..Default::default()
    }))?;
    let texture = device.create_texture(&wgpu::TextureDescriptor {
        label: Some("host.picture"),
        size: wgpu::Extent3d { width: 320, height: 240, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: FORMAT,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    });
    let view = texture.create_view(&wgpu::TextureViewDescriptor::default());

    let mut scene = RenderScene {
        meshes: vec![Arc::new(shapes::torus(1.0, 0.4, 48, 24))],
        materials: vec![Material::lambert(Vec3::new(0.9, 0.6, 0.2))],
        instances: vec![Instance { stable_id: 1, mesh: 0, material: 0, world_from_object: Affine3::IDENTITY }],
        lights: vec![Light { intensity: Vec3::splat(40.0), ..Light::point(2, Vec3::new(1.0, 3.0, 4.0)) }],
        camera: Camera::looking_at(Vec3::new(0.0, 2.0, 4.0), Vec3::ZERO, 0.8),
        ..RenderScene::default()
    };
    let mut renderer = Renderer::with_device(device, queue, RendererOptions::default())?;
    let settings = RenderSettings { width: 320, height: 240, ..RenderSettings::default() };
    for frame in 0..3 {
        // Only what moved is told: nothing is built anew.
        scene.begin_revision();
        scene.set_transform(0, Affine3::from_rotation_x(frame as f32 * 0.1));
        let stats = renderer.render_to_view(&scene, &settings, &view, FORMAT, 0.0)?;
        println!("frame {frame}: {:?} lane on {}, {:.1} ms", stats.raster, stats.device, stats.stages_ms.total);
    }
    Ok(())
}
