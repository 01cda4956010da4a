//! The panel: a switch for every stage, a view of every layer, and what a frame costs.

use super::{
    shared::{Controls, Machine, Picture, Scale},
    shell::{Shell, Wishes},
};
use crate::cli::Target;
use crate::scenes::SCENES;
use catoptra_render_hybrid::{
    FrameStats, GlassShadows, Layer, Preset, RasterLane, RenderSettings, ShadowFilter, Shadows, Tracer, VplOptions,
    VplShadows,
};
use egui::{ComboBox, Grid, Panel, RichText, ScrollArea, Slider, Ui};

/// Pictures that the plot remembers.
const HISTORY: usize = 180;

/// What the last picture told, kept while the next one is made.
#[derive(Default)]
pub struct Figures {
    /// Name of what is shown.
    pub name: String,
    /// Steps made so far.
    pub frame: u64,
    /// Size of the picture.
    pub size: (u32, u32),
    /// The renderer's figures.
    pub stats: FrameStats,
    /// What made it.
    pub machine: Machine,
    /// Steps and extraction, milliseconds.
    pub physics_ms: f64,
    /// Mean time between pictures over the last half second or so, milliseconds.
    pub interval_ms: f64,
    /// Time that each of the last pictures took to make, milliseconds, the latest last.
    pub history: std::collections::VecDeque<f32>,
}

impl Figures {
    /// Takes over a new picture's figures, `interval_ms` after the one before.
    pub fn learn(&mut self, picture: &Picture, interval_ms: f64) {
        self.name.clone_from(&picture.name);
        self.frame = picture.frame;
        self.size = (picture.width, picture.height);
        self.stats = picture.stats.clone();
        self.machine = picture.machine.clone();
        self.physics_ms = picture.physics_ms;
        if self.history.len() == HISTORY {
            self.history.pop_front();
        }
        self.history.push_back(picture.frame_ms as f32);
        // About half a second of memory, whatever the rate.
        let weight = if self.interval_ms > 0.0 { interval_ms / (interval_ms + 500.0) } else { 1.0 };
        self.interval_ms += (interval_ms - self.interval_ms) * weight;
    }
}

/// The side panel.
pub fn panel(ui: &mut Ui, shell: &mut Shell, controls: &mut Controls, wishes: &mut Wishes) {
    Panel::left("play.panel").default_size(290.0).show(ui, |ui| {
        ScrollArea::vertical().show(ui, |ui| {
            scene(ui, shell, controls);
            ui.separator();
            view(ui, shell, controls, wishes);
            ui.separator();
            stages(ui, controls);
            ui.separator();
            machine(ui, &shell.figures.machine, controls);
            ui.separator();
            cost(ui, &shell.figures);
            shell.plot.ui(ui);
            ui.horizontal(|ui| {
                if ui.button("save plot").clicked() {
                    wishes.save_plot = true;
                }
                if ui.button("clear plot").clicked() {
                    shell.plot.clear();
                }
            });
            if !shell.message.is_empty() {
                ui.separator();
                ui.label(&shell.message);
            }
        });
    });
}

fn scene(ui: &mut Ui, shell: &mut Shell, controls: &mut Controls) {
    let figures = &shell.figures;
    ComboBox::from_label("scene").selected_text(figures.name.as_str()).show_ui(ui, |ui| {
        for info in &SCENES {
            let target = Some(Target::Scene(info.name));
            if ui.selectable_value(&mut controls.target, target, info.title).clicked() {
                shell.hud = None;
            }
        }
    });
    ui.horizontal(|ui| {
        if ui.button(if controls.paused { "play" } else { "pause" }).clicked() {
            controls.paused = !controls.paused;
        }
        if ui.add_enabled(controls.paused, egui::Button::new("step")).clicked() {
            controls.once.steps += 1;
        }
        let mut watch = !controls.game;
        if ui.checkbox(&mut watch, "watch only").changed() {
            controls.game = !watch;
            controls.restarts += 1;
            shell.hud = None;
        }
    });
    ui.label(format!("step {} = {:.2} s", figures.frame, figures.frame as f64 / 60.0));
}

fn view(ui: &mut Ui, shell: &mut Shell, controls: &mut Controls, wishes: &mut Wishes) {
    ComboBox::from_label("layer").selected_text(layer_name(controls.layer)).show_ui(ui, |ui| {
        for (layer, name) in Layer::ALL {
            ui.selectable_value(&mut controls.layer, layer, name);
        }
    });
    ui.add(Slider::new(&mut controls.exposure_ev, -8.0..=8.0).text("exposure (stops)"));
    let mut hold = matches!(controls.scale, Scale::Hold(_));
    if ui.checkbox(&mut hold, "size follows the frame rate").changed() {
        controls.scale = if hold { Scale::Hold(20.0) } else { Scale::Fixed(1.0) };
    }
    match &mut controls.scale {
        Scale::Hold(rate) => ui.add(Slider::new(rate, 5.0..=120.0).text("pictures/s")),
        Scale::Fixed(share) => ui.add(Slider::new(share, 0.1..=1.0).text("share of the window")),
    };
    let mut boxes = controls.boxes.is_some();
    if ui.checkbox(&mut boxes, "boxes of the BVH").changed() {
        controls.boxes = boxes.then_some(0);
    }
    if let Some(levels) = &mut controls.boxes {
        ui.add(Slider::new(levels, 0..=4).text("levels inside meshes"));
    }
    ui.checkbox(&mut controls.dots, "VPLs as dots");
    ui.horizontal(|ui| {
        let text = if shell.explaining { "click the picture" } else { "explain a pixel" };
        if ui.button(text).clicked() {
            shell.explaining = !shell.explaining;
        }
        wishes.screenshot |= ui.button("screenshot").clicked();
    });
}

fn stages(ui: &mut Ui, controls: &mut Controls) {
    ui.horizontal(|ui| {
        ui.label("preset");
        for (preset, name) in [(Preset::Draft, "draft"), (Preset::Interactive, "interactive"), (Preset::High, "high")] {
            if ui.button(name).clicked() {
                let RenderSettings { width, height, .. } = controls.settings;
                controls.settings = RenderSettings { width, height, ..RenderSettings::preset(preset) };
            }
        }
    });
    let s = &mut controls.settings;
    ComboBox::from_label("shadows").selected_text(format!("{:?}", s.shadows)).show_ui(ui, |ui| {
        for mode in [Shadows::Moments, Shadows::Certified, Shadows::Traced, Shadows::Off] {
            ui.selectable_value(&mut s.shadows, mode, format!("{mode:?}"));
        }
    });
    if matches!(s.shadows, Shadows::Moments | Shadows::Certified) {
        ComboBox::from_label("shadow filter").selected_text(format!("{:?}", s.moments.filter)).show_ui(ui, |ui| {
            for filter in [ShadowFilter::Vsm, ShadowFilter::Evsm4] {
                ui.selectable_value(&mut s.moments.filter, filter, format!("{filter:?}"));
            }
        });
    }
    match s.shadows {
        Shadows::Moments => {
            ui.add(Slider::new(&mut s.moments.light_bleed_reduction, 0.0..=0.9).text("light-bleed reduction"));
        }
        Shadows::Certified | Shadows::Traced => {
            ui.add(Slider::new(&mut s.shadow_samples, 1..=64).text("rays a light"));
        }
        Shadows::Off => {}
    }
    let mut clear = s.glass_shadows == GlassShadows::Clear;
    if ui.checkbox(&mut clear, "light passes through glass").changed() {
        s.glass_shadows = if clear { GlassShadows::Clear } else { GlassShadows::Opaque };
    }
    indirect(ui, s, controls.initial.vpl);
    ui.checkbox(&mut s.traced, "mirrors and glass");
    if s.traced {
        ui.add(Slider::new(&mut s.max_depth, 1..=32).text("depth"));
    }
}

fn indirect(ui: &mut Ui, s: &mut RenderSettings, initial: Option<VplOptions>) {
    let mut on = s.vpl.is_some();
    if ui.checkbox(&mut on, "indirect light").changed() {
        s.vpl = on.then(|| initial.unwrap_or_default());
    }
    let Some(v) = &mut s.vpl else { return };
    ui.add(Slider::new(&mut v.count, 1..=4096).logarithmic(true).text("VPLs"));
    ui.add(Slider::new(&mut v.bounces, 1..=8).text("bounces"));
    v.bounces = v.bounces.min(v.count);
    ComboBox::from_label("shadows of VPLs").selected_text(format!("{:?}", v.shadows)).show_ui(ui, |ui| {
        for mode in [VplShadows::Off, VplShadows::Maps, VplShadows::Traced] {
            ui.selectable_value(&mut v.shadows, mode, format!("{mode:?}"));
        }
    });
    let mut bounded = v.geometry_term_max.is_some();
    if ui.checkbox(&mut bounded, "bounded geometry term").changed() {
        v.geometry_term_max = if bounded { VplOptions::default().geometry_term_max } else { None };
    }
}

/// Lane and tracer: what is asked for, what runs, and why it is that.
fn machine(ui: &mut Ui, machine: &Machine, controls: &mut Controls) {
    let before = controls.machine;
    ui.horizontal(|ui| {
        let o = &mut controls.machine;
        let name = |lane: RasterLane| match lane {
            RasterLane::Auto => "auto",
            RasterLane::Cpu => "CPU",
            RasterLane::Gpu => "GPU",
        };
        ComboBox::from_label("lane").width(60.0).selected_text(name(o.raster)).show_ui(ui, |ui| {
            for lane in [RasterLane::Auto, RasterLane::Cpu, RasterLane::Gpu] {
                ui.selectable_value(&mut o.raster, lane, name(lane));
            }
        });
        ComboBox::from_label("tracer").width(90.0).selected_text(o.tracer.name()).show_ui(ui, |ui| {
            for tracer in [Tracer::Auto].into_iter().chain(Tracer::ALL) {
                ui.selectable_value(&mut o.tracer, tracer, tracer.name());
            }
        });
    });
    for line in machine.lines() {
        ui.label(line);
    }
    let again = machine.fault.is_some() && ui.button("try the GPU again").clicked();
    if again || controls.machine != before {
        controls.once.machine = Some(controls.machine);
    }
}

/// A bar a picture, as high as it took long; the line is 1/30 s.
fn history(ui: &mut Ui, history: &std::collections::VecDeque<f32>) {
    let (rect, _) = ui.allocate_exact_size(egui::vec2(ui.available_width().min(260.0), 48.0), egui::Sense::hover());
    let painter = ui.painter_at(rect);
    painter.rect_filled(rect, 2.0, ui.visuals().extreme_bg_color);
    let most = history.iter().fold(40.0f32, |m, &v| m.max(v));
    let y = |ms: f32| rect.bottom() - rect.height() * (ms / most).min(1.0);
    let width = rect.width() / HISTORY as f32;
    for (i, &ms) in history.iter().enumerate() {
        let x = rect.left() + width * i as f32;
        let bar = egui::Rect::from_min_max(egui::pos2(x, y(ms)), egui::pos2(x + width, rect.bottom()));
        painter.rect_filled(bar, 0.0, ui.visuals().selection.bg_fill);
    }
    let line = y(1e3 / 30.0);
    painter.hline(rect.x_range(), line, egui::Stroke::new(1.0, ui.visuals().weak_text_color()));
}

fn cost(ui: &mut Ui, figures: &Figures) {
    let s = &figures.stats;
    let rate = 1e3 / figures.interval_ms.max(0.001);
    ui.label(RichText::new(format!("{rate:.1} pictures/s at {}x{}", figures.size.0, figures.size.1)).strong());
    history(ui, &figures.history);
    let rate = s.rays.total() as f64 * 1e-3 / s.stages_ms.total.max(1e-6);
    ui.label(format!("{rate:.2} Mray/s, {} rays", s.rays.total()));
    let t = &s.stages_ms;
    let stages = [
        ("physics", figures.physics_ms),
        ("structure", t.accel),
        ("moments", t.moments),
        ("photons", t.vpls),
        ("G-buffer", t.gbuffer),
        ("direct", t.direct),
        ("indirect", t.indirect),
        ("traced", t.traced),
        ("compose", t.compose),
        ("transfer", t.transfer),
        ("render", t.total),
    ];
    Grid::new("play.stages").num_columns(2).striped(true).show(ui, |ui| {
        for (name, ms) in stages {
            ui.label(name);
            ui.monospace(format!("{ms:8.2} ms"));
            ui.end_row();
        }
    });
    let r = &s.rays;
    let pixels = f64::from(figures.size.0) * f64::from(figures.size.1);
    let rows = [
        ("pixels seen", r.camera),
        ("moment texels", r.moments),
        ("reflection rays", r.reflection),
        ("refraction rays", r.refraction),
        ("shadow rays", r.shadow),
        ("photon rays", r.photon),
        ("VPL rays", r.vpl),
        ("VPLs", u64::from(s.vpls)),
        ("TLAS nodes touched", u64::from(s.tlas_nodes_touched)),
        ("BLAS builds", u64::from(s.blas_builds)),
    ];
    Grid::new("play.counts").num_columns(2).striped(true).show(ui, |ui| {
        for (name, count) in rows {
            ui.label(name);
            ui.monospace(format!("{count:>11}"));
            ui.end_row();
        }
        ui.label("masked pixels");
        ui.monospace(format!("{:>9.1} %", 100.0 * s.masked_pixels as f64 / pixels.max(1.0)));
        ui.end_row();
    });
}

/// Name of a layer, as on the command line.
pub fn layer_name(layer: Layer) -> &'static str {
    Layer::ALL.iter().find(|(l, _)| *l == layer).map_or("final", |(_, name)| name)
}

/// The layer after `layer`, around the end.
pub fn next_layer(layer: Layer) -> Layer {
    let at = Layer::ALL.iter().position(|(l, _)| *l == layer).unwrap_or(0);
    Layer::ALL[(at + 1) % Layer::ALL.len()].0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layers_go_around() {
        let mut layer = Layer::Final;
        for (_, name) in Layer::ALL {
            assert_eq!(layer_name(layer), name);
            layer = next_layer(layer);
        }
        assert_eq!(layer, Layer::Final);
    }
}
