//! Everything on the screen but the picture: picker, display of the game, win screen, menus, photo bar, panel.
//!
//! A function of [`Shell`] and [`Controls`], without window or threads: tests drive it by accessible names.

mod display;
mod menus;
mod picker;
mod view;

use super::{
    explain_view,
    keys::Command,
    overlay::Overlay,
    panel::{self, Figures},
    plot::Plot,
    settings::Settings,
    shared::{Controls, Hud, Photo},
};
use crate::{game::Action, game::Dir};
use catoptra_engine::Camera;
use catoptra_render_hybrid::trace::explain::RayTree;
use egui::{FontFamily, FontId, Rect, TextStyle, Ui};

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
                    controls.photo = Some(Photo::of(&self.camera, controls.exposure_ev));
                    controls.paused = true;
                    self.menu = None;
                    // What is told from now on is about photos.
                    self.message.clear();
                }
            },
            _ if self.menu.is_some() || controls.target.is_none() => {}
            _ if controls.photo.is_some() => view::move_photo(controls, command),
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
        if let Some(photo) = controls.photo.take() {
            controls.exposure_ev = photo.before_ev;
        }
        controls.paused = false;
    }

    /// Back to all games.
    pub fn leave(&mut self, controls: &mut Controls) {
        (self.menu, self.hud, self.tree) = (None, None, None);
        controls.target = None;
        self.end_photo(controls);
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

/// The whole screen. Sets [`Shell::stage`] to what is left to the picture.
pub fn ui(ui: &mut Ui, shell: &mut Shell, controls: &mut Controls) -> Wishes {
    let mut wishes = Wishes::default();
    style(ui);
    if controls.target.is_none() {
        shell.stage = ui.available_rect_before_wrap();
        picker::picker(ui, shell, controls, &mut wishes);
        return wishes;
    }
    if shell.settings.panel && controls.photo.is_none() {
        panel::panel(ui, shell, controls, &mut wishes);
    }
    shell.stage = ui.available_rect_before_wrap();
    view::picture(ui, shell, controls);
    if controls.photo.is_some() {
        view::photo_bar(ui, shell, controls);
    } else if let Some(hud) = shell.hud.clone() {
        display::display(ui, shell, &hud, controls);
    }
    if let Some((tree, names)) = &shell.tree
        && controls.photo.is_none()
        && !explain_view::window(ui, shell.stage, tree, names)
    {
        shell.tree = None;
    }
    match shell.menu {
        None => {}
        Some(Menu::Pause) => menus::pause(ui, shell, controls, &mut wishes),
        Some(Menu::Settings(waiting)) => menus::settings(ui, shell, controls, waiting, &mut wishes),
    }
    if shell.won() && controls.photo.is_none() {
        let hud = shell.hud.clone();
        menus::win(ui, hud, shell, controls);
    }
    wishes
}

/// Text that can be read from an arm's length; once a context.
fn style(ui: &Ui) {
    let done = egui::Id::unique("shell.style");
    if ui.ctx().data(|d| d.get_temp::<bool>(done)).is_some() {
        return;
    }
    ui.ctx().data_mut(|d| d.insert_temp(done, true));
    ui.ctx().all_styles_mut(|s| {
        let sizes =
            [(TextStyle::Small, 12.0), (TextStyle::Body, 14.0), (TextStyle::Button, 14.0), (TextStyle::Heading, 18.0)];
        s.text_styles.extend(sizes.map(|(style, size)| (style, FontId::new(size, FontFamily::Proportional))));
    });
}

#[cfg(test)]
pub use tests::snapshots::measured;

#[cfg(test)]
mod tests;
