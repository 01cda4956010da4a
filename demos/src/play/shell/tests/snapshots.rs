//! The screen as it looks, beside committed pictures. egui's triangles are drawn by the same code that draws a window without
//! a graphics driver, so that the pictures are the same on every machine.
//!
//! `CATOPTRA_UPDATE_GOLDENS=1` writes `demos/goldens/*.png` anew.

use super::*;
use crate::play::{
    compositor::Stage,
    shared::{Machine, Picture},
    soft::{Canvas, Painter},
};
use catoptra_render_hybrid::{FrameStats, RasterLane, Tracer, image_io};
use std::{cell::RefCell, path::PathBuf, rc::Rc};

/// Most pixels that may differ visibly: text of another processor may round here and there.
const MOST_DIFFERENT: usize = 8;
/// What is visible, of 255.
const VISIBLE: u8 = 24;

/// Hands egui's textures to the painter as they come.
struct Textures(Rc<RefCell<Painter>>);

impl egui_kittest::TestRenderer for Textures {
    fn handle_delta(&mut self, delta: &mut egui::TexturesDelta) {
        let mut painter = self.0.borrow_mut();
        painter.learn(delta);
        painter.forget(delta);
        delta.clear();
    }
}

/// The screen of a model, over a picture of four colours.
fn drawn(m: Model, size: (u32, u32), prepare: impl FnOnce(&mut Harness<'static, Model>)) -> Canvas {
    let painter = Rc::new(RefCell::new(Painter::default()));
    let show = |ui: &mut Ui, m: &mut Model| {
        super::ui_of(ui, m);
    };
    let mut harness = Harness::builder()
        .with_size([size.0 as f32, size.1 as f32])
        .renderer(Textures(painter.clone()))
        .build_ui_state(show, m);
    prepare(&mut harness);
    harness.run();
    let output = harness.output();
    let primitives = harness.ctx.tessellate(output.shapes.clone(), output.pixels_per_point);
    let mut canvas = Canvas::default();
    canvas.clear(size.0, size.1);
    if harness.state().controls.target.is_some() {
        let stage = Stage::from_points(harness.state().shell.stage, output.pixels_per_point, size);
        let four = [[70, 60, 50, 255], [110, 100, 90, 255], [40, 50, 60, 255], [90, 110, 130, 255]].concat();
        canvas.picture(stage, 2, 2, &four);
    }
    painter.borrow().paint(&mut canvas, &primitives, output.pixels_per_point);
    canvas
}

/// Pixels of which one channel differs visibly; all of them where the sizes differ.
fn different(a: &Canvas, width: u32, height: u32, b: &[[u8; 3]]) -> usize {
    if (a.width, a.height) != (width, height) {
        return a.pixels.len().max(b.len());
    }
    let differs = |(a, b): (&[u8; 3], &[u8; 3])| a.iter().zip(b).any(|(a, b)| a.abs_diff(*b) > VISIBLE);
    a.pixels.iter().zip(b).filter(|pair| differs(*pair)).count()
}

fn golden(name: &str) -> (u32, u32, Vec<[u8; 3]>) {
    let path = file(name);
    let image = image_io::read_image(&path)
        .unwrap_or_else(|e| panic!("{}: {e}; CATOPTRA_UPDATE_GOLDENS=1 writes it", path.display()));
    let pixels = image.srgb8.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
    (image.linear.width, image.linear.height, pixels)
}

fn file(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("goldens").join(format!("{name}.png"))
}

/// Compares with the golden, or writes it.
fn check(name: &str, canvas: &Canvas) {
    let flat: Vec<u8> = canvas.pixels.iter().flatten().copied().collect();
    if std::env::var_os("CATOPTRA_UPDATE_GOLDENS").is_some() {
        std::fs::create_dir_all(file(name).parent().unwrap()).unwrap();
        image_io::write_png(&file(name), canvas.width, canvas.height, &flat).unwrap();
    }
    let (width, height, pixels) = golden(name);
    let different = different(canvas, width, height, &pixels);
    if different > MOST_DIFFERENT {
        let seen = std::env::temp_dir().join(format!("catoptra-{name}.png"));
        image_io::write_png(&seen, canvas.width, canvas.height, &flat).unwrap();
        panic!("{name}: {different} pixels differ; it looks like {} now", seen.display());
    }
}

fn picker() -> Canvas {
    let mut m = model(None);
    for (n, stars) in [(0, 3), (1, 1)] {
        m.shell.settings.learn("rolling-box", n, 12, stars);
    }
    drawn(m, (1280, 720), |harness| {
        for i in 0..4usize {
            let shade = |x: usize, y: usize| Color32::from_rgb(x as u8 * 15, y as u8 * 25, i as u8 * 60);
            let pixels = (0..9).flat_map(|y| (0..16).map(move |x| shade(x, y))).collect();
            let image = egui::ColorImage::new([16, 9], pixels);
            let texture = harness.ctx.load_texture("thumbnail", image, egui::TextureOptions::LINEAR);
            harness.state_mut().shell.thumbnails[i] = Some(texture);
        }
    })
}

fn win(stars: u32, moves: u32) -> Canvas {
    let mut m = model(Some("rolling-box"));
    m.shell.hud = Some(Hud { moves: (moves, 10), ..hud(Some(stars)) });
    drawn(m, (960, 540), |_| {})
}

fn explainer(name: &str) -> Canvas {
    let mut m = model(Some("rolling-box-donut"));
    m.shell.tree = Some(tree(name));
    drawn(m, (640, 400), |_| {})
}

fn panel(edit: impl FnOnce(&mut Model)) -> Canvas {
    let mut m = model(Some("rolling-box-donut"));
    m.shell.settings.panel = true;
    for i in 0..40u32 {
        let picture = measured(i);
        m.shell.figures.learn(&picture, 50.0);
        m.shell.plot.learn(&picture);
    }
    edit(&mut m);
    drawn(m, (700, 1500), |_| {})
}

/// A picture whose figures are the same every time.
pub fn measured(i: u32) -> Picture {
    let mut stats = FrameStats { raster: RasterLane::Gpu, tracer: Tracer::Cpu, ..Default::default() };
    let t = &mut stats.stages_ms;
    (t.accel, t.moments, t.vpls, t.gbuffer) = (0.5, 3.0, 1.5, 4.0);
    (t.direct, t.indirect, t.traced, t.total) = (6.0 + f64::from(i % 7), 8.0, 9.0, 35.0);
    stats.rays.reflection = 1000 * u64::from(i);
    let machine = Machine {
        lane: RasterLane::Gpu,
        device: "Example GPU".into(),
        tracer: Tracer::Cpu,
        chosen: (Tracer::Gpu, "measured: gpu 1.20 ms, cpu 9.00 ms".into()),
        fallback: Some("--tracer gpu: 40 MB of triangles, the adapter's buffers hold 16 MB".into()),
        fault: None,
    };
    Picture {
        width: 640,
        height: 360,
        rgba8: vec![0; 640 * 360 * 4],
        name: "rolling-box-donut".into(),
        frame: u64::from(i),
        machine,
        stats,
        physics_ms: 0.25,
        frame_ms: 36.0,
        camera: Camera::default(),
        hud: None,
        overlay: Overlay::default(),
    }
}

#[test]
fn the_picker_looks_as_it_did() {
    check("picker", &picker());
}

#[test]
fn the_win_screen_looks_as_it_did_and_one_other_letter_or_star_is_seen() {
    let now = win(3, 10);
    check("win", &now);
    let (width, height, pixels) = golden("win");
    for (stars, moves) in [(3, 11), (2, 10)] {
        let changed = different(&win(stars, moves), width, height, &pixels);
        assert!(changed > MOST_DIFFERENT, "{stars} stars, {moves} moves: only {changed} pixels differ");
    }
}

#[test]
fn the_pixel_explainer_looks_as_it_did_and_one_other_letter_is_seen() {
    check("explainer", &explainer("matte"));
    let (width, height, pixels) = golden("explainer");
    assert!(different(&explainer("motte"), width, height, &pixels) > MOST_DIFFERENT);
}

#[test]
fn the_panel_looks_as_it_did_and_one_switch_is_seen() {
    check("panel", &panel(|_| {}));
    let (width, height, pixels) = golden("panel");
    let edits: [fn(&mut Model); 3] = [
        |m| m.controls.dots = true,
        |m| m.shell.figures.machine.device = "Example CPU".into(),
        |m| m.shell.figures.stats.rays.shadow = 7,
    ];
    for (n, edit) in edits.into_iter().enumerate() {
        assert!(different(&panel(edit), width, height, &pixels) > MOST_DIFFERENT, "change {n}");
    }
}

#[test]
fn display_and_menus_look_as_they_did() {
    let putting = || {
        let mut m = model(Some("two-spheres"));
        m.shell.hud = Some(Hud {
            kind: Kind::TwoSpheres,
            message: "hint: aim 29 with strength 4".into(),
            putter: Some((29, 4)),
            level: (1, 3),
            ..hud(None)
        });
        m.shell.settings.learn("two-spheres", 0, 1, 3);
        m
    };
    check("display", &drawn(putting(), (960, 540), |_| {}));
    // A window that is hardly larger than its buttons still shows all of them.
    check("display-small", &drawn(putting(), (420, 320), |_| {}));
    let mut m = model(Some("rolling-box"));
    m.shell.menu = Some(Menu::Settings(Some(Command::Undo)));
    check("settings", &drawn(m, (640, 720), |_| {}));
    let mut m = model(Some("rolling-box"));
    m.shell.menu = Some(Menu::Pause);
    check("pause", &drawn(m, (480, 360), |_| {}));
    let mut m = model(Some("rolling-box"));
    m.shell.command(Command::Photo, &mut m.controls);
    check("photo", &drawn(m, (960, 200), |_| {}));
}
