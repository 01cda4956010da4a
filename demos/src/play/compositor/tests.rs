//! The window's picture without a window: odd sizes, scales, a device that is lost.

use super::*;
use egui::{Pos2, Rect};

#[test]
fn the_stage_lies_in_the_window() {
    let rect = Rect::from_min_max(Pos2::new(100.0, 0.0), Pos2::new(400.0, 300.0));
    let stage = Stage::from_points(rect, 2.0, (800, 600));
    assert_eq!(stage, Stage { x: 200, y: 0, width: 600, height: 600 });
    let whole = Stage { x: 0, y: 0, width: 10, height: 20 };
    assert_eq!(Stage::from_points(Rect::NOTHING, 1.0, (10, 20)), whole);
    assert_eq!(Stage::from_points(Rect::EVERYTHING, 1.0, (10, 20)), whole);
    assert_eq!(Stage::from_points(rect, 1.0, (50, 20)), Stage { x: 0, y: 0, width: 50, height: 20 });
    assert_eq!(Stage::from_points(Rect::EVERYTHING, 1.0, (0, 0)).width, 1);
}

/// A device that draws, or none with a loud word.
fn compositor(test: &str) -> Option<Compositor> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
    let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default()));
    let Ok(adapter) = adapter else {
        assert!(std::env::var_os("CI").is_none(), "CI without an adapter");
        eprintln!("SKIPPED {test}: no adapter");
        return None;
    };
    let limits = wgpu::Limits::downlevel_defaults().using_resolution(adapter.limits());
    let descriptor = wgpu::DeviceDescriptor { required_limits: limits, ..Default::default() };
    let (device, queue) = pollster::block_on(adapter.request_device(&descriptor)).expect("an adapter gives a device");
    Some(Compositor::new(device, queue, wgpu::TextureFormat::Rgba8Unorm))
}

/// A game's screen as egui draws it, in a window of `size` pixels.
fn screen(context: &egui::Context, size: (u32, u32), pixels_per_point: f32) -> PanelDrawing {
    let target = Some(crate::cli::Target::Scene("two-spheres"));
    let controls = crate::play::shared::Controls::new(target, &crate::cli::PictureArgs::default());
    let mut controls = controls.unwrap_or_else(|_| panic!("standard settings"));
    let mut shell = crate::play::shell::Shell::new(Default::default(), String::new());
    shell.menu = Some(crate::play::shell::Menu::Pause);
    let mut run = |context: &egui::Context| {
        let points = egui::Vec2::new(size.0 as f32, size.1 as f32) / pixels_per_point;
        // Long after the pass before: what fades in is there.
        let time = Some(context.input(|i| i.time) + 10.0);
        let mut input =
            egui::RawInput { time, screen_rect: Some(Rect::from_min_size(Pos2::ZERO, points)), ..Default::default() };
        input.viewports.entry(egui::ViewportId::ROOT).or_default().native_pixels_per_point = Some(pixels_per_point);
        context.run_ui(input, |ui| {
            crate::play::shell::ui(ui, &mut shell, &mut controls);
        })
    };
    // Menus know their size in the second pass.
    let mut textures = egui::TexturesDelta::default();
    for _ in 0..2 {
        textures.append(std::mem::take(&mut run(context).textures_delta));
    }
    let mut output = run(context);
    textures.append(std::mem::take(&mut output.textures_delta));
    let primitives = context.tessellate(std::mem::take(&mut output.shapes), pixels_per_point);
    let stage = Stage::from_points(shell.stage, pixels_per_point, size);
    PanelDrawing { primitives, textures, pixels_per_point, stage }
}

/// What a window of `size` would show.
fn shown(c: &mut Compositor, panel: &PanelDrawing, size: (u32, u32)) -> Vec<[u8; 3]> {
    c.learn(panel);
    let texture = c.device().create_texture(&wgpu::TextureDescriptor {
        label: Some("test.window"),
        size: wgpu::Extent3d { width: size.0, height: size.1, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba8Unorm,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    });
    c.draw(&texture.create_view(&wgpu::TextureViewDescriptor::default()), [size.0, size.1], panel);
    c.forget(panel);
    let stride = (size.0 * 4).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
    let buffer = c.device().create_buffer(&wgpu::BufferDescriptor {
        label: Some("test.read"),
        size: u64::from(stride * size.1),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = c.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(stride), rows_per_image: None };
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        wgpu::TexelCopyBufferInfo { buffer: &buffer, layout },
        texture.size(),
    );
    c.queue().submit([encoder.finish()]);
    buffer.slice(..).map_async(wgpu::MapMode::Read, |r| r.expect("the buffer is mapped"));
    c.device().poll(wgpu::PollType::wait_indefinitely()).expect("the device works");
    c.check().expect("nothing was wrong with it");
    let bytes = buffer.slice(..).get_mapped_range().expect("it is mapped").to_vec();
    let rows = bytes.chunks_exact(stride as usize);
    rows.flat_map(|row| row[..size.0 as usize * 4].chunks_exact(4).map(|p| [p[0], p[1], p[2]])).collect()
}

fn four_colours() -> Picture {
    let rgba8 = [[200, 60, 50, 255], [110, 200, 90, 255], [40, 50, 200, 255], [190, 210, 30, 255]].concat();
    Picture { width: 2, height: 2, rgba8, ..crate::play::shell::measured(0) }
}

/// The same by the CPU's way into a window.
fn painted(panel: &PanelDrawing, size: (u32, u32)) -> Vec<[u8; 3]> {
    let (mut painter, mut canvas) = (crate::play::soft::Painter::default(), crate::play::soft::Canvas::default());
    painter.learn(&panel.textures);
    canvas.clear(size.0, size.1);
    canvas.picture(panel.stage, 2, 2, &four_colours().rgba8);
    painter.paint(&mut canvas, &panel.primitives, panel.pixels_per_point);
    canvas.pixels
}

/// Writes a picture for somebody to look at.
fn kept(name: &str, size: (u32, u32), pixels: &[[u8; 3]]) -> String {
    let path = std::env::temp_dir().join(format!("catoptra-compositor-{name}.png"));
    let flat: Vec<u8> = pixels.iter().flatten().copied().collect();
    let written = catoptra_render_hybrid::image_io::write_png(&path, size.0, size.1, &flat);
    written.map_or_else(|e| e.to_string(), |()| path.display().to_string())
}

/// Mean difference of a channel, of 255.
fn difference(a: &[[u8; 3]], b: &[[u8; 3]]) -> f64 {
    assert_eq!(a.len(), b.len());
    let sum: u64 = a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / (3 * a.len()) as f64
}

#[test]
fn windows_of_any_size_and_scale_look_alike_on_both_ways() {
    let Some(mut c) = compositor("windows_of_any_size_and_scale_look_alike_on_both_ways") else { return };
    c.upload(&four_colours());
    // One window that is resized and moved to screens of other scales: one context, one device.
    let (gpu, cpu) = (egui::Context::default(), egui::Context::default());
    let mut at_first = None;
    for (size, scale) in [
        ((640, 400), 1.0),
        ((641, 399), 1.0),
        ((1, 1), 1.0),
        ((3, 701), 1.0),
        ((17, 13), 2.0),
        ((1280, 800), 2.0),
        ((1000, 625), 1.5),
        ((640, 400), 1.0),
    ] {
        let now = shown(&mut c, &screen(&gpu, size, scale), size);
        // The CPU's way begins with a new context each time: what was learned before must not show.
        let fresh = egui::Context::default();
        let other = painted(&screen(&fresh, size, scale), size);
        let d = difference(&now, &other);
        assert!(d < 0.6, "{size:?} at {scale}: {d}; {} and {}", kept("gpu", size, &now), kept("cpu", size, &other));
        if (size, scale) == ((640, 400), 1.0) {
            match &at_first {
                None => at_first = Some(now),
                // Letters lie elsewhere in their texture by now, which may round otherwise.
                Some(first) => {
                    let d = difference(first, &now);
                    assert!(d < 0.02, "back at the first size it looks as at first: {d}");
                }
            }
        }
    }
    // What the tolerance sees: the same window at another scale.
    let size = (640, 400);
    let other = painted(&screen(&cpu, size, 1.25), size);
    assert!(difference(&at_first.unwrap(), &other) > 2.0);
}

#[test]
fn a_minimised_window_keeps_a_stage_and_its_picture() {
    let Some(mut c) = compositor("a_minimised_window_keeps_a_stage_and_its_picture") else { return };
    let context = egui::Context::default();
    c.upload(&four_colours());
    let before = shown(&mut c, &screen(&context, (320, 200), 1.0), (320, 200));
    // Minimised to nothing: egui lays out a screen of no size, textures that are told then are taken over.
    let panel = screen(&context, (0, 0), 1.0);
    assert_eq!((panel.stage.width, panel.stage.height), (1, 1));
    c.learn(&panel);
    c.forget(&panel);
    let after = shown(&mut c, &screen(&context, (320, 200), 1.0), (320, 200));
    let d = difference(&before, &after);
    assert!(d < 0.02, "the picture is back: {d}");
}

#[test]
fn a_lost_device_is_told_and_another_shows_the_same() {
    let test = "a_lost_device_is_told_and_another_shows_the_same";
    let (Some(mut lost), Some(mut next)) = (compositor(test), compositor(test)) else { return };
    let (context, size) = (egui::Context::default(), (320, 200));
    lost.upload(&four_colours());
    let panel = screen(&context, size, 1.0);
    let before = shown(&mut lost, &panel, size);
    lost.device().destroy();
    // Uploads and drawings that were on their way end nothing.
    lost.upload(&four_colours());
    let told = (0..100).find_map(|_| {
        std::thread::sleep(std::time::Duration::from_millis(10));
        lost.check().err()
    });
    let told = told.expect("the loss is told");
    assert!(told.contains("lost") || told.contains("failed"), "{told}");
    assert!(!told.contains('\n'));
    assert_eq!(lost.check().unwrap_err(), told, "it stays lost");
    // As after `App::reopen`: a new context, which tells all its textures once more.
    next.upload(&four_colours());
    let after = shown(&mut next, &screen(&egui::Context::default(), size, 1.0), size);
    assert!(after == before, "the picture is back");
}
