//! A scene without an ECS, a picture without a window: one call, right at once.
//!
//! `cargo run --example headless_image -- FILE.png`

use catoptra_engine::{
    Camera, Environment, Instance, Light, Material, RenderScene,
    glam::{Affine3, Mat3, Vec3},
    shapes,
};
use catoptra_render_hybrid::{RenderSettings, image_io, render_to_image};
use std::{path::PathBuf, sync::Arc};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let at = |translation| Affine3 { matrix3: Mat3::IDENTITY, translation };
    let scene = RenderScene {
        meshes: vec![
            Arc::new(shapes::sphere(1.0, 32, 64)),
            Arc::new(shapes::cuboid(Vec3::splat(20.0), [Vec3::ONE; 6])),
        ],
        materials: vec![
            Material::glass(Vec3::ONE, 1.5),
            Material::mirror(Vec3::new(1.0, 0.8, 0.5), 0.9),
            Material::lambert(Vec3::splat(0.7)),
        ],
        instances: vec![
            Instance { stable_id: 1, mesh: 0, material: 0, world_from_object: at(Vec3::new(-1.1, 1.0, 0.0)) },
            Instance { stable_id: 2, mesh: 0, material: 1, world_from_object: at(Vec3::new(1.1, 1.0, 0.0)) },
            Instance { stable_id: 3, mesh: 1, material: 2, world_from_object: at(Vec3::new(0.0, -20.0, 0.0)) },
        ],
        lights: vec![Light { intensity: Vec3::splat(60.0), radius: 0.2, ..Light::point(4, Vec3::new(2.0, 5.0, 3.0)) }],
        camera: Camera::looking_at(Vec3::new(0.0, 2.0, 6.0), Vec3::new(0.0, 0.8, 0.0), 0.8),
        environment: Environment { background: Vec3::new(0.3, 0.5, 0.8), ambient: Vec3::ZERO },
        ..RenderScene::default()
    };
    let image = render_to_image(&scene, &RenderSettings { width: 640, height: 480, ..RenderSettings::default() })?;
    let path = std::env::args_os().nth(1).map_or_else(|| std::env::temp_dir().join("headless.png"), PathBuf::from);
    image_io::write_png(&path, image.width, image.height, &image_io::srgb8_from_image(&image, 0.0))?;
    println!("{} hash={:016x}", path.display(), image.hash());
    Ok(())
}
