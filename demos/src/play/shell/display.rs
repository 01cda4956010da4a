//! What a game shows while it is played: goal, moves and par, buttons.

use super::Shell;
use crate::{
    game::Action,
    play::{
        keys::Command,
        shared::{Controls, Hud},
    },
};
use egui::{Align2, Color32, Pos2, Rect, RichText, Sense, Stroke, Ui, Vec2};

/// The ground of what lies over the picture.
pub fn shade() -> egui::Frame {
    egui::Frame::new().fill(Color32::from_black_alpha(175)).corner_radius(6.0).inner_margin(8.0)
}

/// A box of text or buttons over the picture.
pub fn over(ui: &Ui, name: &str, rect: Rect, align: Align2, content: impl FnOnce(&mut Ui)) {
    let offset = Vec2::new(rect.left() * f32::from(u8::from(align.x() != egui::Align::Max)), 0.0);
    let offset = match align.x() {
        egui::Align::Center => Vec2::new(rect.center().x - ui.ctx().content_rect().center().x, 0.0),
        _ => offset,
    };
    let margin =
        Vec2::new(10.0, 10.0) * Vec2::new(-(align.x().to_factor() * 2.0 - 1.0), -(align.y().to_factor() * 2.0 - 1.0));
    egui::Area::new(egui::Id::unique(name)).anchor(align, offset + margin).show(ui.ctx(), |ui| {
        // Plain on the dark ground, whatever the picture behind it is.
        let widgets = &mut ui.visuals_mut().widgets;
        (widgets.inactive.bg_fill, widgets.inactive.weak_bg_fill) = (Color32::from_gray(85), Color32::from_gray(65));
        widgets.noninteractive.fg_stroke.color = Color32::from_gray(190);
        shade().show(ui, content)
    });
}

/// Goal, moves and par, buttons.
pub fn display(ui: &Ui, shell: &mut Shell, hud: &Hud, controls: &mut Controls) {
    let white = |text: String| RichText::new(text).color(Color32::WHITE);
    let rect = shell.stage;
    let area = ui.ctx().memory(|m| m.area_rect(egui::Id::unique("display.goal")));
    let pointed = area.zip(ui.ctx().pointer_hover_pos()).is_some_and(|(area, at)| area.contains(at));
    over(ui, "display.goal", rect, Align2::LEFT_TOP, |ui| {
        ui.set_max_width((rect.width() - 230.0).max(120.0));
        let (level, levels) = hud.level;
        ui.label(white(format!("{}  {}/{levels}  {}", hud.kind.title(), level + 1, hud.name)).size(17.0).strong());
        // After the first move they would hide what there is to see; pointing at the title brings them back.
        if hud.moves.0 == 0 || pointed {
            ui.label(white(hud.kind.goal().into()));
            ui.label(RichText::new(hud.kind.look()).color(Color32::from_gray(190)).small());
        }
        if !hud.message.is_empty() {
            ui.label(RichText::new(&hud.message).color(Color32::from_rgb(255, 214, 90)).size(17.0));
        }
    });
    over(ui, "display.moves", rect, Align2::RIGHT_TOP, |ui| {
        ui.style_mut().wrap_mode = Some(egui::TextWrapMode::Extend);
        let (moves, par) = hud.moves;
        let what = if hud.putter.is_some() { "Putts" } else { "Moves" };
        ui.label(white(format!("{what} {moves}   Par {par}")).size(20.0));
        if let Some((aim, power)) = hud.putter {
            ui.label(white(format!("Strength {power} of {}   Aim {aim}", crate::game::POWERS)));
        }
        if let Some(best) = shell.settings.best(hud.kind.name(), hud.level.0) {
            ui.label(white(format!("Best {}, {} of 3 stars", best.moves, best.stars)).small());
        }
    });
    over(ui, "display.buttons", rect, Align2::CENTER_BOTTOM, |ui| {
        ui.set_max_width((rect.width() - 40.0).max(80.0));
        ui.horizontal_wrapped(|ui| buttons(ui, shell, hud, controls));
    });
}

/// All that keys do in a game, for the mouse.
fn buttons(ui: &mut Ui, shell: &mut Shell, hud: &Hud, controls: &mut Controls) {
    ui.style_mut().wrap_mode = Some(egui::TextWrapMode::Extend);
    let (level, levels) = hud.level;
    let mut push = |ui: &mut Ui, on: bool, name: &str, command: Command| {
        let button = ui.add_enabled(on, egui::Button::new(name));
        if button.on_hover_text(format!("key {}", shell.settings.key(command))).clicked() {
            shell.command(command, controls);
        }
    };
    if let Some((_, power)) = hud.putter {
        push(ui, hud.won.is_none(), "Putt", Command::Strike);
        push(ui, power > 1, "Softer", Command::South);
        push(ui, power < crate::game::POWERS, "Harder", Command::North);
    }
    push(ui, hud.can_undo, "Undo", Command::Undo);
    push(ui, true, "Restart", Command::Restart);
    push(ui, hud.won.is_none(), "Hint", Command::Hint);
    push(ui, true, "Menu", Command::Pause);
    for n in 0..levels {
        let best = shell.settings.best(hud.kind.name(), n);
        let name = format!("Level {}", n + 1);
        let stars = best.map_or("not won yet".into(), |b| format!("{} of 3 stars", b.stars));
        let shown = if best.is_some() { format!("{name}: won") } else { name.clone() };
        let label = ui.selectable_label(n == level, shown).on_hover_text(stars);
        label.widget_info(|| egui::WidgetInfo::selected(egui::Role::Button, true, n == level, &name));
        if label.clicked() {
            controls.once.actions.push(Action::Level(n));
        }
    }
    let how = match hud.putter {
        Some(_) => "arrows or click: aim; up, down: strength",
        None => "arrows or click: tip the box",
    };
    ui.label(RichText::new(how).color(Color32::from_gray(190)).small());
}

/// Three stars, `n` of them full; named for those who do not see them.
pub fn stars(ui: &mut Ui, n: u32, size: f32) {
    let (rect, response) = ui.allocate_exact_size(Vec2::new(3.4 * size, size), Sense::hover());
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, format!("{n} of 3 stars")));
    for i in 0..3 {
        let middle = Pos2::new(rect.left() + (0.5 + 1.2 * i as f32) * size, rect.center().y);
        let corner = |k: usize| {
            let radius = if k % 2 == 0 { 0.5 } else { 0.2 } * size;
            middle + Vec2::angled(std::f32::consts::TAU * (k as f32 / 10.0 - 0.25)) * radius
        };
        let color = if i < n { Color32::from_rgb(255, 205, 60) } else { Color32::from_gray(70) };
        // A star is not convex: five points around a middle.
        for k in (0..10).step_by(2) {
            let point = vec![corner(k + 9), corner(k), corner(k + 1), middle];
            ui.painter().add(egui::Shape::convex_polygon(point, color, Stroke::NONE));
        }
    }
}
