//! "Explain this pixel": the tree of rays behind it, one line a ray.

use catoptra_render_hybrid::{
    image_io::srgb8_from_linear,
    trace::explain::{RayKind, RayNode, RayTree},
};
use egui::{Color32, Rect, RichText, ScrollArea, Ui, Vec2};
use glam::Vec3;

/// Lines that are shown at most.
const MOST_LINES: usize = 200;

/// The window, at first below the title of the game on `stage`; false when it was closed.
pub fn window(ui: &Ui, stage: Rect, tree: &RayTree, names: &[String]) -> bool {
    let mut open = true;
    let window = egui::Window::new("Why this pixel").default_pos(stage.min + Vec2::new(10.0, 95.0));
    let size = Vec2::new((stage.width() - 60.0).clamp(120.0, 660.0), (stage.height() - 200.0).clamp(80.0, 340.0));
    window.open(&mut open).default_size(size).show(ui.ctx(), |ui| {
        let sum = tree.radiance();
        ui.horizontal(|ui| {
            swatch(ui, sum);
            let (x, y) = tree.pixel;
            ui.label(RichText::new(format!("pixel {x}, {y}: radiance {}", triple(sum))).strong());
        });
        let rays = tree.nodes.len();
        ui.label(format!("{rays} ray{}; what they add is the pixel", if rays == 1 { "" } else { "s" }));
        ui.separator();
        ScrollArea::both().show(ui, |ui| {
            for (node, name) in tree.nodes.iter().zip(names).take(MOST_LINES) {
                branch(ui, node, name);
            }
            let left = tree.nodes.len().saturating_sub(MOST_LINES);
            if left > 0 || tree.cut {
                ui.label(format!("and {left} more"));
            }
        });
    });
    open
}

fn branch(ui: &mut Ui, node: &RayNode, name: &str) {
    ui.horizontal(|ui| {
        ui.add_space(14.0 * node.depth as f32);
        swatch(ui, node.added);
        ui.label(line(node, name)).on_hover_text(format!(
            "share of the pixel {}\nlights {}\nvirtual lights {}",
            triple(node.weight),
            triple(node.direct),
            triple(node.indirect)
        ));
    });
}

/// A ray in words.
fn line(node: &RayNode, name: &str) -> String {
    let kind = match node.kind {
        RayKind::Camera => "eye",
        RayKind::Reflection => "reflected",
        RayKind::Refraction => "through",
    };
    let split = match node.kind {
        RayKind::Camera => String::new(),
        _ => format!(" {:.1}%", 100.0 * node.split.element_sum() / 3.0),
    };
    let far = if node.distance.is_finite() { format!(" {:.2} m to", node.distance) } else { " out to".into() };
    format!("{kind}{split}{far} {name}: adds {}", triple(node.added))
}

fn triple(v: Vec3) -> String {
    format!("({:.3}, {:.3}, {:.3})", v.x, v.y, v.z)
}

fn swatch(ui: &mut Ui, radiance: Vec3) {
    let [r, g, b] = radiance.to_array().map(srgb8_from_linear);
    let (rect, _) = ui.allocate_exact_size(Vec2::splat(14.0), egui::Sense::hover());
    ui.painter().rect_filled(rect, 2.0, Color32::from_rgb(r, g, b));
    ui.painter().rect_stroke(rect, 2.0, egui::Stroke::new(1.0, Color32::GRAY), egui::StrokeKind::Inside);
}
