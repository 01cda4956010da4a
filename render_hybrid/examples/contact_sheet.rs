//! All glTF files of a folder (and the folders in it) in one picture.
//!
//! `cargo run -p catoptra_render_hybrid --example contact_sheet -- FOLDER FILE.png [SIDE]`: squares of SIDE pixels (default
//! 80), by file name, row by row. Files that cannot be read are told with the reason.

use catoptra_engine::{
    Camera, Extracted, ImportLimits, ImportedScene, StableId, app, bevy_ecs::prelude::*,
    bevy_transform::components::Transform, fit_camera, glam::Vec3, headlight, load_gltf,
};
use catoptra_render_hybrid::{Image, Preset, RasterLane, RenderSettings, Renderer, RendererOptions, image_io};
use std::path::{Path, PathBuf};

/// Squares a row.
const COLUMNS: usize = 8;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args_os().skip(1);
    let (Some(folder), Some(out)) = (arguments.next(), arguments.next()) else {
        return Err("contact_sheet FOLDER FILE.png [SIDE]".into());
    };
    let side: u32 = arguments.next().and_then(|s| s.to_str()?.parse().ok()).unwrap_or(80);
    let mut files = Vec::new();
    collect(Path::new(&folder), &mut files)?;
    files.sort();
    let mut renderer = Renderer::new(RendererOptions { raster: RasterLane::Cpu, ..Default::default() })?;
    // Four pixels of the picture make one of the sheet.
    let settings = RenderSettings { width: 2 * side, height: 2 * side, ..RenderSettings::preset(Preset::Interactive) };
    let mut squares = Vec::new();
    for file in &files {
        match load_gltf(file, &ImportLimits::default()) {
            Err(error) => println!("{}: refused: {error}", file.display()),
            Ok(scene) => {
                let (world, camera) = world(&scene);
                let mut drawn = world.resource::<Extracted>().0.clone();
                drawn.camera = camera;
                // Something for mirrors and glass to show.
                drawn.environment.background = Vec3::new(0.2, 0.25, 0.32);
                let frame = renderer.render(&drawn, &settings)?;
                println!(
                    "{}: {} triangles; left out: {:?}",
                    file.display(),
                    drawn.triangle_count(),
                    scene.report.ignored
                );
                squares.push(frame.image);
            }
        }
    }
    let sheet = sheet(&squares, side);
    image_io::write_png(Path::new(&out), sheet.width, sheet.height, &image_io::srgb8_from_image(&sheet, 0.0))?;
    println!("{} pictures of {} files", squares.len(), files.len());
    Ok(())
}

fn collect(folder: &Path, out: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            collect(&path, out)?;
        } else if path.extension().is_some_and(|e| e == "gltf" || e == "glb") {
            out.push(path);
        }
    }
    Ok(())
}

/// The file at frame 0 with a headlight, and a camera that sees all of it.
fn world(scene: &ImportedScene) -> (World, Camera) {
    let mut app = app::new_app();
    scene.spawn(app.world_mut(), 1);
    let camera = fit_camera(scene.bounds_world());
    let pose = Transform::from_matrix(camera.world_from_view.into());
    app.world_mut().spawn((StableId(u64::MAX), headlight(&camera, scene.bounds_world()), pose));
    app::settle(&mut app);
    (std::mem::take(app.world_mut()), camera)
}

fn sheet(squares: &[Image], side: u32) -> Image {
    let side = side as usize;
    let mut out = Image::new((COLUMNS * side) as u32, (squares.len().div_ceil(COLUMNS) * side) as u32);
    let width = out.width as usize;
    for (i, square) in squares.iter().enumerate() {
        let (x0, y0) = (i % COLUMNS * side, i / COLUMNS * side);
        for y in 0..side {
            for x in 0..side {
                let at = |dx: usize, dy: usize| square.at((2 * x + dx) as u32, (2 * y + dy) as u32);
                let four = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
                // Clamped first: one bright highlight would fill its pixel.
                let mean = std::array::from_fn(|c| four.iter().map(|p| p[c].min(1.0)).sum::<f32>() * 0.25);
                out.pixels[(y0 + y) * width + x0 + x] = mean;
            }
        }
    }
    out
}
