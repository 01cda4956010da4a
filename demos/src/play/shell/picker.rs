//! All games, with a picture each.

use super::{Shell, Wishes, display::stars};
use crate::{cli::Target, game::Kind, play::shared::Controls, scenes::SCENES};
use egui::{Align2, Color32, Rect, RichText, Sense, Stroke, Ui, Vec2};

/// Height of a card's text under its picture, points.
const TEXT_HEIGHT: f32 = 94.0;
/// Height of the title.
const TITLE_HEIGHT: f32 = 112.0;
/// Distance between cards.
const GAP: f32 = 16.0;

/// All games, as large as the window lets them be.
pub fn picker(ui: &mut Ui, shell: &mut Shell, controls: &mut Controls, wishes: &mut Wishes) {
    let window = shell.stage.size();
    let (columns, width) = layout(window);
    egui::Area::new(egui::Id::unique("picker")).anchor(Align2::CENTER_CENTER, [0.0, 0.0]).show(ui.ctx(), |ui| {
        let height = (window.y - 16.0).max(60.0);
        egui::ScrollArea::vertical().max_height(height).min_scrolled_height(height).show(ui, |ui| {
            ui.set_width(columns as f32 * (width + GAP) - GAP);
            ui.vertical_centered(|ui| {
                ui.label(RichText::new("Catoptra").size(40.0).strong().color(Color32::WHITE));
                ui.label("Five games that are won by looking into mirrors");
                ui.add_space(10.0);
            });
            egui::Grid::new("picker.games").num_columns(columns).spacing([GAP, GAP]).show(ui, |ui| {
                for (i, info) in SCENES.iter().enumerate() {
                    let Some(kind) = Kind::of(info.name) else { continue };
                    card(ui, shell, controls, i, kind, width);
                    if i % columns == columns - 1 {
                        ui.end_row();
                    }
                }
                ui.vertical(|ui| {
                    ui.set_width(width);
                    ui.small(
                        "1-5 or click: play. Arrow keys or clicks move, Escape opens the menu with settings and keys \
                         (here: quits), F1 the panel.",
                    );
                    if !shell.message.is_empty() {
                        ui.small(&shell.message);
                    }
                    if ui.button("Quit").clicked() {
                        wishes.quit = true;
                    }
                });
            });
        });
    });
}

/// Columns of cards, and the width of one, that show all six fields in a window where that is possible.
fn layout(window: Vec2) -> (usize, f32) {
    let columns = match window.x {
        x if x < 440.0 => 1,
        x if x < 700.0 => 2,
        _ => 3,
    };
    let rows = 6usize.div_ceil(columns) as f32;
    let by_width = (window.x - 30.0) / columns as f32 - GAP;
    let by_height = ((window.y - TITLE_HEIGHT) / rows - TEXT_HEIGHT - GAP) * 16.0 / 9.0;
    (columns, by_height.clamp(190.0, 520.0).min(by_width.max(120.0)))
}

fn card(ui: &mut Ui, shell: &Shell, controls: &mut Controls, i: usize, kind: Kind, width: f32) {
    ui.vertical(|ui| {
        ui.set_width(width);
        let (rect, button) = ui.allocate_exact_size(Vec2::new(width, width * 9.0 / 16.0), Sense::click());
        button.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, kind.title()));
        thumbnail(ui, shell, i, rect);
        if button.hovered() || button.has_focus() {
            let stroke = Stroke::new(3.0, Color32::from_rgb(255, 205, 60));
            ui.painter().rect_stroke(rect, 6.0, stroke, egui::StrokeKind::Outside);
        }
        if button.clicked() {
            controls.target = Some(Target::Scene(kind.name()));
        }
        let levels = crate::game::level_count(kind);
        let results: Vec<_> = (0..levels).map(|l| shell.settings.best(kind.name(), l)).collect();
        ui.horizontal(|ui| {
            ui.label(RichText::new(format!("{}  {}", i + 1, kind.title())).strong().color(Color32::WHITE));
            for best in results.iter().flatten() {
                stars(ui, best.stars, 10.0);
            }
        });
        let won = results.iter().flatten().count();
        ui.small(format!("{}: {won} of {levels} levels won", kind.name()));
        ui.small(kind.goal());
    });
}

/// The game's picture, or its place while it is made.
fn thumbnail(ui: &Ui, shell: &Shell, i: usize, rect: Rect) {
    match &shell.thumbnails[i] {
        Some(texture) => {
            let image = egui::load::SizedTexture::new(texture.id(), rect.size());
            egui::Image::new(image).corner_radius(6).paint_at(ui, rect);
        }
        None => {
            ui.painter().rect_filled(rect, 6.0, Color32::from_gray(30));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cards_fit_in_the_window() {
        for (x, y) in [(1280.0, 720.0), (1920.0, 1080.0), (3840.0, 2160.0), (640.0, 480.0), (320.0, 240.0), (1.0, 1.0)]
        {
            let (columns, width) = layout(Vec2::new(x, y));
            assert!((120.0..=520.0).contains(&width), "{x}x{y}: {width}");
            if x >= 320.0 {
                assert!(columns as f32 * (width + GAP) <= x, "{x}x{y}: {columns} of {width}");
            }
            if y >= 720.0 {
                assert!(2.0 * (width * 9.0 / 16.0 + TEXT_HEIGHT + GAP) + TITLE_HEIGHT <= y + 1.0, "{x}x{y}: {width}");
            }
        }
    }
}
