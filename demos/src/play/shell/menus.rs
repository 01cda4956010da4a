//! Win screen, pause, settings and keys.

use super::{Menu, Shell, Wishes, display::stars};
use crate::{
    game::Action,
    play::{
        keys::Command,
        shared::{Controls, Hud, Scale},
    },
};
use egui::{Align2, RichText, Ui};

fn centred<'a>(title: &'a str) -> egui::Window<'a> {
    // As large as what is in it: a size that is remembered would be the one of a window that was tiny once.
    egui::Window::new(title).collapsible(false).auto_sized().anchor(Align2::CENTER_CENTER, [0.0, 0.0])
}

/// A level is won.
pub fn win(ui: &Ui, hud: Option<Hud>, shell: &mut Shell, controls: &mut Controls) {
    let Some((hud, won)) = hud.and_then(|h| h.won.map(|won| (h, won))) else { return };
    // Low, so that what was won stays in sight.
    centred("Level won").anchor(Align2::CENTER_BOTTOM, [0.0, -70.0]).show(ui.ctx(), |ui| {
        ui.set_width(350.0);
        ui.vertical_centered(|ui| {
            stars(ui, won, 44.0);
            let (moves, par) = hud.moves;
            let what = if hud.putter.is_some() { "putt" } else { "move" };
            let plural = if moves == 1 { "" } else { "s" };
            ui.label(RichText::new(format!("{}: {moves} {what}{plural}, par {par}", hud.name)).size(18.0));
            let told = match won {
                3 => "The shortest way, without help or slip.",
                2 => "The shortest way. Without hint, undo and slip it is three stars.",
                _ => "There is a shorter way.",
            };
            ui.label(told);
            ui.add_space(8.0);
        });
        let next = (hud.level.0 + 1) % hud.level.1;
        let choices = [
            (if next == 0 { "First level" } else { "Next level" }, Some(Action::Level(next))),
            ("Play again", Some(Action::Restart)),
            ("All games", None),
        ];
        ui.columns(choices.len(), |columns| {
            for (ui, (name, action)) in columns.iter_mut().zip(choices) {
                let button = ui.vertical_centered_justified(|ui| ui.button(RichText::new(name).size(18.0))).inner;
                match action {
                    _ if !button.clicked() => {}
                    None => shell.leave(controls),
                    Some(action) => {
                        controls.once.actions.push(action);
                        if let Some(hud) = &mut shell.hud {
                            hud.won = None;
                        }
                    }
                }
            }
        });
        ui.vertical_centered(|ui| ui.small(format!("{}: next level", shell.settings.key(Command::Strike))));
    });
}

/// Time stands still.
pub fn pause(ui: &Ui, shell: &mut Shell, controls: &mut Controls, wishes: &mut Wishes) {
    centred("Pause").show(ui.ctx(), |ui| {
        ui.set_width(240.0);
        ui.vertical_centered_justified(|ui| pause_buttons(ui, shell, controls, wishes));
    });
}

fn pause_buttons(ui: &mut Ui, shell: &mut Shell, controls: &mut Controls, wishes: &mut Wishes) {
    let big = |text: &str| egui::Button::new(RichText::new(text).size(18.0));
    if ui.add(big("Go on")).clicked() {
        shell.toggle_pause(controls);
    }
    if shell.hud.is_some() && ui.add(big("Restart level")).clicked() {
        controls.once.actions.push(Action::Restart);
        shell.toggle_pause(controls);
    }
    if ui.add(big("Photo mode")).clicked() {
        *wishes = shell.command(Command::Photo, controls);
    }
    if ui.add(big("Settings and keys")).clicked() {
        shell.menu = Some(Menu::Settings(None));
    }
    if ui.add(big("All games")).clicked() {
        shell.leave(controls);
    }
    if ui.add(big("Quit")).clicked() {
        wishes.quit = true;
    }
}

/// What is remembered between runs, keys included.
pub fn settings(ui: &Ui, shell: &mut Shell, controls: &mut Controls, waiting: Option<Command>, wishes: &mut Wishes) {
    centred("Settings").show(ui.ctx(), |ui| {
        ui.set_width(320.0);
        if ui.checkbox(&mut shell.settings.fullscreen, "fill the screen").clicked() {
            // The window's own state follows by the wish.
            shell.settings.fullscreen = !shell.settings.fullscreen;
            wishes.fullscreen = true;
        }
        if ui.checkbox(&mut shell.settings.vsync, "wait for the screen (vsync)").changed() {
            (wishes.vsync, wishes.save_settings) = (true, true);
        }
        let mut hold = shell.settings.rate > 0.0;
        let mut changed = ui.checkbox(&mut hold, "picture size follows the frame rate").changed();
        if changed {
            shell.settings.rate = if hold { 20.0 } else { 0.0 };
        }
        if hold {
            changed |= ui.add(egui::Slider::new(&mut shell.settings.rate, 5.0..=120.0).text("pictures/s")).changed();
        }
        if changed {
            wishes.save_settings = true;
            controls.scale = Scale::of_rate(shell.settings.rate);
        }
        ui.separator();
        let height = (shell.stage.height() - 260.0).max(60.0);
        let list = egui::ScrollArea::vertical().max_height(height).min_scrolled_height(height);
        list.show(ui, |ui| keys(ui, shell, waiting));
        if ui.button("Standard keys").clicked() {
            shell.settings.keys = Default::default();
            wishes.save_settings = true;
        }
        if ui.button(RichText::new("Back").size(18.0)).clicked() {
            shell.menu = Some(Menu::Pause);
        }
    });
}

/// What each command's key is, and a button to change it.
fn keys(ui: &mut Ui, shell: &mut Shell, waiting: Option<Command>) {
    egui::Grid::new("settings.keys").num_columns(2).striped(true).show(ui, |ui| {
        for (command, _, about, _) in Command::ALL {
            ui.label(about);
            let text =
                if waiting == Some(command) { "press a key".into() } else { shell.settings.key(command).to_string() };
            let button = ui.button(text);
            button.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, format!("key of {about}")));
            if button.clicked() {
                shell.menu = Some(Menu::Settings(Some(command)));
            }
            ui.end_row();
        }
    });
}
