//! The picture: pointing at it, what is drawn over it, the free camera of the photo mode.

use super::{Shell, display::over};
use crate::play::{
    keys::Command,
    shared::{Controls, SaveAs},
};
use egui::{Align2, Color32, Pos2, Sense, Stroke, Ui};

/// Pointing at the picture, and what is drawn over it.
pub fn picture(ui: &mut Ui, shell: &mut Shell, controls: &mut Controls) {
    let rect = shell.stage;
    let response = ui.interact(rect, ui.scope_id().with("picture"), Sense::click_and_drag());
    let at = |p: Pos2| [(p.x - rect.left()) / rect.width(), (p.y - rect.top()) / rect.height()];
    if let (true, Some(p)) = (response.clicked(), response.interact_pointer_pos()) {
        if shell.explaining {
            controls.once.explain = Some(at(p));
            shell.explaining = false;
        } else if shell.hud.is_some() && !controls.paused {
            controls.once.clicks.push(at(p));
        }
    }
    if let (Some(photo), true) = (&mut controls.photo, response.dragged()) {
        let d = response.drag_delta() / rect.height().max(1.0) * photo.fov.to_radians();
        photo.yaw += d.x;
        photo.pitch = (photo.pitch + d.y).clamp(-1.5, 1.5);
    }
    if let (Some(photo), true) = (&mut controls.photo, response.hovered()) {
        let turned = ui.input(|i| i.smooth_scroll_delta().y);
        photo.eye += photo.axes().0 * (turned * 0.004);
    }
    let place = |[u, v]: [f32; 2]| Pos2::new(rect.left() + u * rect.width(), rect.top() + v * rect.height());
    let painter = ui.painter_at(rect);
    for (a, b, level) in &shell.overlay.lines {
        let color = match level {
            -1 => Color32::from_rgb(255, 220, 60),
            0 => Color32::from_rgba_unmultiplied(80, 200, 255, 150),
            1 => Color32::from_rgba_unmultiplied(120, 255, 140, 90),
            _ => Color32::from_rgba_unmultiplied(255, 120, 220, 60),
        };
        painter.line_segment([place(*a), place(*b)], Stroke::new(1.0, color));
    }
    for (p, [r, g, b]) in &shell.overlay.dots {
        painter.circle(place(*p), 3.0, Color32::from_rgb(*r, *g, *b), Stroke::new(1.0, Color32::BLACK));
    }
}

/// Moves the free camera.
pub fn move_photo(controls: &mut Controls, command: Command) {
    let Some(photo) = &mut controls.photo else { return };
    let (ahead, right) = photo.axes();
    let step = 0.12;
    photo.eye += match command {
        Command::North => ahead * step,
        Command::South => -ahead * step,
        Command::East => right * step,
        Command::West => -right * step,
        Command::Strike => glam::Vec3::Y * step,
        _ => glam::Vec3::ZERO,
    };
}

/// What the photo mode offers.
pub fn photo_bar(ui: &Ui, shell: &mut Shell, controls: &mut Controls) {
    let rect = shell.stage;
    over(ui, "photo.bar", rect, Align2::CENTER_BOTTOM, |ui| {
        ui.set_max_width((rect.width() - 40.0).max(80.0));
        ui.horizontal_wrapped(|ui| {
            ui.add(egui::Slider::new(&mut controls.exposure_ev, -8.0..=8.0).text("exposure"));
            if let Some(photo) = &mut controls.photo {
                ui.add(egui::Slider::new(&mut photo.fov, 15.0..=100.0).text("field of view"));
                ui.checkbox(&mut photo.high, "high preset");
            }
            if ui.button("Save PNG").clicked() {
                controls.once.save = Some(SaveAs::Png);
            }
            if ui.button("Save EXR").clicked() {
                controls.once.save = Some(SaveAs::Exr);
            }
            if ui.button("Back to the game").clicked() {
                shell.end_photo(controls);
            }
        });
        ui.small("drag: look; wheel or arrows: walk; Space: rise");
        if !shell.message.is_empty() {
            ui.small(&shell.message);
        }
    });
}
