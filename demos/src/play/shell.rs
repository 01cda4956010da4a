//! Everything on the screen but the picture: picker, display of the game, win screen, menus, photo bar, panel.
//!
//! A function of [`Shell`] and [`Controls`], without window or threads: tests drive it by accessible names.

use super::{
    explain_view,
    keys::Command,
    overlay::Overlay,
    panel::{self, Figures},
    plot::Plot,
    settings::Settings,
    shared::{Controls, Hud, Photo, SaveAs, Scale},
};
use crate::{cli::Target, game::Action, game::Dir, game::Kind, scenes::SCENES};
use catoptra_engine::Camera;
use catoptra_render_hybrid::trace::explain::RayTree;
use egui::{Align2, Color32, Pos2, Rect, RichText, Sense, Stroke, Ui, Vec2};

/// A menu over the game.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Menu {
    /// Pause.
    Pause,
    /// Settings and keys; the command that waits for its new key.
    Settings(Option<Command>),
}

/// What the screen shows.
pub struct Shell {
    /// What is remembered between runs.
    pub settings: Settings,
    /// The open menu.
    pub menu: Option<Menu>,
    /// The game as the last picture showed it.
    pub hud: Option<Hud>,
    /// Direction and strength that keys asked for, and when: pictures that were on their way know nothing of them.
    pub turned: Option<((u8, u8), std::time::Instant)>,
    /// Figures of the last picture.
    pub figures: Figures,
    /// Times of all pictures.
    pub plot: Plot,
    /// Lines and dots over the picture.
    pub overlay: Overlay,
    /// The next click on the picture asks why it looks so.
    pub explaining: bool,
    /// The answer.
    pub tree: Option<(RayTree, Vec<String>)>,
    /// The camera of the last picture.
    pub camera: Camera,
    /// Pictures of the picker, by scene.
    pub thumbnails: [Option<egui::TextureHandle>; 5],
    /// The last thing worth telling.
    pub message: String,
    /// Part of the window that the picture fills, points.
    pub stage: Rect,
}

impl Shell {
    /// With settings and what was told while they were read.
    pub fn new(settings: Settings, message: String) -> Self {
        Self {
            settings,
            menu: None,
            hud: None,
            turned: None,
            figures: Figures::default(),
            plot: Plot::default(),
            overlay: Overlay::default(),
            explaining: false,
            tree: None,
            camera: Camera::default(),
            thumbnails: Default::default(),
            message,
            stage: Rect::NOTHING,
        }
    }

    /// Takes the game over as a picture shows it.
    pub fn learn(&mut self, hud: &Option<Hud>) {
        self.hud.clone_from(hud);
        let lately = self.turned.filter(|(_, at)| at.elapsed() < std::time::Duration::from_secs(2));
        if let (Some(hud), Some((putter, _))) = (&mut self.hud, lately)
            && hud.putter.is_some()
        {
            hud.putter = Some(putter);
        }
    }

    /// True while the win screen is shown.
    pub fn won(&self) -> bool {
        self.menu.is_none() && self.hud.as_ref().is_some_and(|h| h.won.is_some())
    }

    /// What a key's command does here.
    pub fn command(&mut self, command: Command, controls: &mut Controls) -> Wishes {
        let mut wishes = Wishes::default();
        match command {
            Command::Panel => {
                self.settings.panel = !self.settings.panel;
                wishes.save_settings = true;
            }
            Command::Fullscreen => wishes.fullscreen = true,
            Command::Screenshot => wishes.screenshot = true,
            Command::Layer => controls.layer = panel::next_layer(controls.layer),
            Command::Games => self.leave(controls),
            Command::Pause if controls.target.is_none() => wishes.quit = true,
            Command::Pause if controls.photo.is_some() => self.end_photo(controls),
            Command::Pause => self.toggle_pause(controls),
            Command::Photo if controls.target.is_some() => match controls.photo {
                Some(_) => self.end_photo(controls),
                None => {
                    controls.photo = Some(Photo::of(&self.camera));
                    controls.paused = true;
                    self.menu = None;
                }
            },
            _ if self.menu.is_some() || controls.target.is_none() => {}
            _ if controls.photo.is_some() => move_photo(controls, command),
            _ => self.play(command, controls),
        }
        wishes
    }

    fn play(&mut self, command: Command, controls: &mut Controls) {
        let Some(hud) = &self.hud else {
            match command {
                Command::Restart => controls.restarts += 1,
                Command::Strike => controls.paused = !controls.paused,
                _ => {}
            }
            return;
        };
        let turned = |aim: u8, by: i32| (i32::from(aim) + by).rem_euclid(i32::from(crate::game::AIMS)) as u8;
        let action = match (command, hud.putter) {
            (Command::Undo, _) => Some(Action::Undo),
            (Command::Restart, _) => Some(Action::Restart),
            (Command::Hint, _) => Some(Action::Hint),
            (Command::Strike, _) if hud.won.is_some() => Some(Action::Level((hud.level.0 + 1) % hud.level.1)),
            (Command::Strike, Some(_)) => Some(Action::Putt),
            (Command::West, Some((aim, _))) => Some(Action::Aim(turned(aim, -1))),
            (Command::East, Some((aim, _))) => Some(Action::Aim(turned(aim, 1))),
            (Command::North, Some((_, power))) if power < crate::game::POWERS => Some(Action::Power(power + 1)),
            (Command::South, Some((_, power))) if power > 1 => Some(Action::Power(power - 1)),
            (Command::North, None) => Some(Action::Roll(Dir::North)),
            (Command::South, None) => Some(Action::Roll(Dir::South)),
            (Command::East, None) => Some(Action::Roll(Dir::East)),
            (Command::West, None) => Some(Action::Roll(Dir::West)),
            _ => None,
        };
        // Keys that repeat faster than pictures come count on from what they asked for.
        if let (Some(action), Some(hud)) = (action, &mut self.hud) {
            match (action, &mut hud.putter) {
                (Action::Aim(aim), Some(putter)) => putter.0 = aim,
                (Action::Power(power), Some(putter)) => putter.1 = power,
                (Action::Level(_), _) => hud.won = None,
                _ => {}
            }
            if matches!(action, Action::Aim(_) | Action::Power(_)) {
                self.turned = hud.putter.map(|putter| (putter, std::time::Instant::now()));
            }
            controls.once.actions.push(action);
        }
    }

    fn toggle_pause(&mut self, controls: &mut Controls) {
        self.menu = if self.menu.is_some() { None } else { Some(Menu::Pause) };
        controls.paused = self.menu.is_some();
    }

    fn end_photo(&mut self, controls: &mut Controls) {
        controls.photo = None;
        controls.paused = false;
    }

    /// Back to all games.
    fn leave(&mut self, controls: &mut Controls) {
        (self.menu, self.hud, self.tree) = (None, None, None);
        controls.target = None;
        controls.photo = None;
        controls.paused = false;
    }
}

/// What the user asked for beside the controls.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wishes {
    /// Write the picture to a file.
    pub screenshot: bool,
    /// Change between window and full screen.
    pub fullscreen: bool,
    /// Waiting for the screen was switched.
    pub vsync: bool,
    /// Settings changed.
    pub save_settings: bool,
    /// Write the plot of frame times.
    pub save_plot: bool,
    /// Close the window.
    pub quit: bool,
}

fn move_photo(controls: &mut Controls, command: Command) {
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

/// The whole screen. Sets [`Shell::stage`] to what is left to the picture.
pub fn ui(ui: &mut Ui, shell: &mut Shell, controls: &mut Controls) -> Wishes {
    let mut wishes = Wishes::default();
    if controls.target.is_none() {
        shell.stage = ui.available_rect_before_wrap();
        picker(ui, shell, controls, &mut wishes);
        return wishes;
    }
    if shell.settings.panel && controls.photo.is_none() {
        panel::panel(ui, shell, controls, &mut wishes);
    }
    shell.stage = ui.available_rect_before_wrap();
    picture(ui, shell, controls);
    if controls.photo.is_some() {
        photo_bar(ui, shell, controls);
    } else if let Some(hud) = shell.hud.clone() {
        display(ui, shell, &hud, controls);
    }
    if let Some((tree, names)) = &shell.tree
        && !explain_view::window(ui, tree, names)
    {
        shell.tree = None;
    }
    match shell.menu {
        None => {}
        Some(Menu::Pause) => pause(ui, shell, controls, &mut wishes),
        Some(Menu::Settings(waiting)) => settings(ui, shell, controls, waiting, &mut wishes),
    }
    if shell.won() && controls.photo.is_none() {
        let hud = shell.hud.clone();
        win(ui, hud, shell, controls);
    }
    wishes
}

/// Pointing at the picture, and what is drawn over it.
fn picture(ui: &mut Ui, shell: &mut Shell, controls: &mut Controls) {
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

fn shade() -> egui::Frame {
    egui::Frame::new().fill(Color32::from_black_alpha(175)).corner_radius(6.0).inner_margin(8.0)
}

/// A box of text or buttons over the picture.
fn over(ui: &Ui, name: &str, rect: Rect, align: Align2, content: impl FnOnce(&mut Ui)) {
    let offset = Vec2::new(rect.left() * f32::from(u8::from(align.x() != egui::Align::Max)), 0.0);
    let offset = match align.x() {
        egui::Align::Center => Vec2::new(rect.center().x - ui.ctx().content_rect().center().x, 0.0),
        _ => offset,
    };
    let margin =
        Vec2::new(10.0, 10.0) * Vec2::new(-(align.x().to_factor() * 2.0 - 1.0), -(align.y().to_factor() * 2.0 - 1.0));
    egui::Area::new(egui::Id::unique(name))
        .anchor(align, offset + margin)
        .show(ui.ctx(), |ui| shade().show(ui, content));
}

fn display(ui: &Ui, shell: &Shell, hud: &Hud, controls: &mut Controls) {
    let white = |text: String| RichText::new(text).color(Color32::WHITE);
    let rect = shell.stage;
    over(ui, "display.goal", rect, Align2::LEFT_TOP, |ui| {
        ui.set_max_width((rect.width() - 230.0).max(120.0));
        let (level, levels) = hud.level;
        ui.label(white(format!("{}  {}/{levels}  {}", hud.kind.title(), level + 1, hud.name)).size(17.0).strong());
        ui.label(white(hud.kind.goal().into()));
        ui.label(RichText::new(hud.kind.look()).color(Color32::from_gray(190)).small());
        if !hud.message.is_empty() {
            ui.label(RichText::new(&hud.message).color(Color32::from_rgb(255, 214, 90)));
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
        ui.style_mut().wrap_mode = Some(egui::TextWrapMode::Extend);
        ui.horizontal(|ui| {
            let key = |c: Command| shell.settings.key(c).to_string();
            let mut push = |ui: &mut Ui, on: bool, name: &str, command: Command, action: Action| {
                let button = ui.add_enabled(on, egui::Button::new(name));
                if button.on_hover_text(format!("key {}", key(command))).clicked() {
                    controls.once.actions.push(action);
                }
            };
            if hud.putter.is_some() {
                push(ui, hud.won.is_none(), "Putt", Command::Strike, Action::Putt);
            }
            push(ui, hud.can_undo, "Undo", Command::Undo, Action::Undo);
            push(ui, true, "Restart", Command::Restart, Action::Restart);
            push(ui, hud.won.is_none(), "Hint", Command::Hint, Action::Hint);
            let (level, levels) = hud.level;
            for n in 0..levels {
                let name = format!("Level {}", n + 1);
                if ui.selectable_label(n == level, name).clicked() {
                    controls.once.actions.push(Action::Level(n));
                }
            }
            let how = if hud.putter.is_some() {
                "arrows or click: aim; up, down: strength"
            } else {
                "arrows or click: tip the box"
            };
            ui.label(
                RichText::new(format!("{how}; {}: menu", key(Command::Pause))).color(Color32::from_gray(190)).small(),
            );
        });
    });
}

/// Three stars, `n` of them full; named for those who do not see them.
fn stars(ui: &mut Ui, n: u32, size: f32) {
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

fn centred<'a>(title: &'a str) -> egui::Window<'a> {
    egui::Window::new(title).collapsible(false).resizable(false).anchor(Align2::CENTER_CENTER, [0.0, 0.0])
}

/// A level is won.
fn win(ui: &Ui, hud: Option<Hud>, shell: &mut Shell, controls: &mut Controls) {
    let Some((hud, won)) = hud.and_then(|h| h.won.map(|won| (h, won))) else { return };
    // Low, so that what was won stays in sight.
    centred("Level won").anchor(Align2::CENTER_BOTTOM, [0.0, -70.0]).show(ui.ctx(), |ui| {
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
        ui.horizontal(|ui| {
            let next = (hud.level.0 + 1) % hud.level.1;
            let name = if next == 0 { "First level" } else { "Next level" };
            let mut go = |action: Action, shell: &mut Shell| {
                controls.once.actions.push(action);
                if let Some(hud) = &mut shell.hud {
                    hud.won = None;
                }
            };
            if ui.button(RichText::new(name).size(18.0)).clicked() {
                go(Action::Level(next), shell);
            }
            if ui.button(RichText::new("Play again").size(18.0)).clicked() {
                go(Action::Restart, shell);
            }
            if ui.button(RichText::new("All games").size(18.0)).clicked() {
                shell.leave(controls);
            }
        });
        ui.small(format!("{}: next level", shell.settings.key(Command::Strike)));
    });
}

fn pause(ui: &Ui, shell: &mut Shell, controls: &mut Controls, wishes: &mut Wishes) {
    centred("Pause").show(ui.ctx(), |ui| {
        ui.set_min_width(220.0);
        let big = |text: &str| egui::Button::new(RichText::new(text).size(18.0)).min_size(Vec2::new(220.0, 0.0));
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
    });
}

fn settings(ui: &Ui, shell: &mut Shell, controls: &mut Controls, waiting: Option<Command>, wishes: &mut Wishes) {
    centred("Settings").show(ui.ctx(), |ui| {
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
            controls.scale = scale_of(shell.settings.rate);
        }
        ui.separator();
        egui::Grid::new("settings.keys").num_columns(2).striped(true).show(ui, |ui| {
            for (command, _, about, _) in Command::ALL {
                ui.label(about);
                let text = if waiting == Some(command) {
                    "press a key".into()
                } else {
                    shell.settings.key(command).to_string()
                };
                let button = ui.button(text);
                button.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, format!("key of {about}")));
                if button.clicked() {
                    shell.menu = Some(Menu::Settings(Some(command)));
                }
                ui.end_row();
            }
        });
        if ui.button("Standard keys").clicked() {
            shell.settings.keys = Default::default();
            wishes.save_settings = true;
        }
        if ui.button(RichText::new("Back").size(18.0)).clicked() {
            shell.menu = Some(Menu::Pause);
        }
    });
}

/// The scale that a setting stands for.
pub fn scale_of(rate: f32) -> Scale {
    if rate > 0.0 { Scale::Hold(rate) } else { Scale::Fixed(1.0) }
}

fn photo_bar(ui: &Ui, shell: &mut Shell, controls: &mut Controls) {
    let rect = shell.stage;
    over(ui, "photo.bar", rect, Align2::CENTER_BOTTOM, |ui| {
        ui.horizontal(|ui| {
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
        ui.small(if shell.message.is_empty() {
            "drag: look; arrows: walk; Space: rise"
        } else {
            shell.message.as_str()
        });
    });
}

/// All games, with a picture each.
fn picker(ui: &mut Ui, shell: &mut Shell, controls: &mut Controls, wishes: &mut Wishes) {
    egui::Area::new(egui::Id::unique("picker")).anchor(Align2::CENTER_CENTER, [0.0, 0.0]).show(ui.ctx(), |ui| {
        ui.vertical_centered(|ui| {
            ui.label(RichText::new("Catoptra").size(40.0).strong().color(Color32::WHITE));
            ui.label("Five games that are won by looking into mirrors");
            ui.add_space(10.0);
        });
        egui::Grid::new("picker.games").num_columns(3).spacing([14.0, 14.0]).show(ui, |ui| {
            for (i, info) in SCENES.iter().enumerate() {
                let Some(kind) = Kind::of(info.name) else { continue };
                card(ui, shell, controls, i, kind);
                if i % 3 == 2 {
                    ui.end_row();
                }
            }
            ui.vertical(|ui| {
                ui.set_width(250.0);
                ui.small(
                    "1-5 or click: play. Arrow keys move, Escape opens the menu with settings and keys (here: quits), F1 the panel.",
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
}

fn card(ui: &mut Ui, shell: &Shell, controls: &mut Controls, i: usize, kind: Kind) {
    ui.vertical(|ui| {
        ui.set_width(250.0);
        let size = Vec2::new(250.0, 140.0);
        let button = match &shell.thumbnails[i] {
            Some(texture) => ui.add(egui::Button::image(egui::load::SizedTexture::new(texture.id(), size))),
            None => ui.add_sized(size, egui::Button::new("...")),
        };
        button.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, kind.title()));
        if button.clicked() {
            controls.target = Some(Target::Scene(kind.name()));
        }
        let levels = crate::game::level_count(kind);
        let won = (0..levels).filter(|l| shell.settings.best(kind.name(), *l).is_some()).count();
        ui.label(RichText::new(format!("{}  {}", i + 1, kind.title())).strong().color(Color32::WHITE));
        ui.small(format!("{}: {won} of {levels} levels won", kind.name()));
        ui.small(kind.goal());
    });
}

#[cfg(test)]
mod tests;
