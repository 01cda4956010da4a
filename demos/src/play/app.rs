//! The window's thread: input in, the newest picture and the panel out.

use super::{
    PlayError, WindowArg,
    compositor::{PanelDrawing, Stage},
    keys::{self, Command},
    scene_by_number,
    screen::Screen,
    settings::{self, Settings},
    shared::{Answer, Controls, Picture, Requests, Scale, Shared, Thumbnail},
    shell::{self, Menu, Shell, Wishes},
    worker::{self, Machine, Report},
};
use crate::cli::{Failure, PlayArgs, note};
use catoptra_render_hybrid::{Renderer, image_io};
use std::{
    path::PathBuf,
    sync::Arc,
    thread::JoinHandle,
    time::{Duration, Instant},
};
use winit::{
    application::ApplicationHandler,
    dpi::PhysicalSize,
    event::{ElementState, KeyEvent, WindowEvent},
    event_loop::{ActiveEventLoop, ControlFlow, EventLoop},
    window::{Fullscreen, Window, WindowId},
};

/// Opens the window and plays until it is closed.
pub fn run(mut controls: Controls, args: &PlayArgs) -> Result<(), PlayError> {
    let picture = &args.picture;
    let event_loop = EventLoop::<Report>::with_user_event()
        .build()
        .map_err(|e| PlayError::NoWindow(format!("there is no display ({})", first_words(&e.to_string()))))?;
    event_loop.set_control_flow(ControlFlow::Wait);
    let made_with = picture.renderer_options();
    let machine = Machine {
        renderer: picture.renderer()?,
        options: made_with,
        make: |options| Renderer::new(options).map_err(Failure::from),
    };
    let config = settings::path();
    let (remembered, notice) = match &config {
        Some(path) => Settings::load(path),
        None => (Settings::default(), Some("there is no folder for settings: they last for this run".into())),
    };
    if let Some(notice) = &notice {
        note(notice);
    }
    if picture.size.is_none() {
        controls.scale = Scale::of_rate(remembered.rate);
    }
    let (shared, options) = (Arc::new(Shared::new(controls.clone())), picture.scene.options());
    let proxy = event_loop.create_proxy();
    let worker = {
        let (shared, record) = (shared.clone(), args.record.clone());
        std::thread::Builder::new()
            .name("catoptra-play".into())
            .spawn(move || worker::run(&shared, machine, &options, record, |r| proxy.send_event(r).is_ok()))
            .map_err(|e| PlayError::Other(Failure::other(e)))?
    };
    let mut app = App {
        shared,
        controls,
        open: None,
        shell: Shell::new(remembered, notice.unwrap_or_default()),
        config,
        window: args.window,
        picture: None,
        thumbnails: Vec::new(),
        reopened: None,
        last_picture: Instant::now(),
        pictures: 0,
        lose_device: args.lose_device,
        until: args.seconds.map(|s| Instant::now() + Duration::from_secs_f64(s)),
        end: None,
    };
    let ran = event_loop.run_app(&mut app);
    if args.seconds.is_some() {
        app.save_plot();
    }
    app.stop(worker);
    match (app.end, ran) {
        (Some(end), _) => Err(end),
        (None, Err(e)) => Err(PlayError::NoWindow(format!("the window failed ({})", first_words(&e.to_string())))),
        (None, Ok(())) => Ok(()),
    }
}

/// A system's error without the place in winit's sources that it comes from.
fn first_words(text: &str) -> String {
    let told = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let reason = told.strip_prefix("os error at ").and_then(|rest| rest.split_once(": "));
    reason.map_or(told.as_str(), |(_, reason)| reason).trim_end_matches('.').to_string()
}

struct App {
    shared: Arc<Shared>,
    controls: Controls,
    open: Option<Open>,
    shell: Shell,
    /// The settings' file.
    config: Option<PathBuf>,
    window: WindowArg,
    picture: Option<Picture>,
    last_picture: Instant,
    /// Pictures of the picker, for a screen that is made anew.
    thumbnails: Vec<Thumbnail>,
    /// When that was last done.
    reopened: Option<Instant>,
    /// Pictures shown so far.
    pictures: u64,
    /// After how many of them the device is taken away, for tests.
    lose_device: Option<u64>,
    /// When the window closes by itself.
    until: Option<Instant>,
    /// Why the window closes, if not because the user wants it.
    end: Option<PlayError>,
}

struct Open {
    window: Arc<Window>,
    screen: Screen,
    egui: egui_winit::State,
}

impl ApplicationHandler<Report> for App {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.open.is_some() {
            return;
        }
        match self.open_window(event_loop) {
            Ok(open) => {
                let size = open.window.inner_size();
                self.open = Some(open);
                self.change(|c| c.window = (size.width.max(1), size.height.max(1)));
            }
            Err(why) => {
                self.end = Some(PlayError::NoWindow(why));
                event_loop.exit();
            }
        }
    }

    fn user_event(&mut self, event_loop: &ActiveEventLoop, report: Report) {
        match report {
            Report::Picture => self.show_picture(),
            Report::Answer => self.hear_answers(),
            Report::Unplayable(why) => {
                note(&why);
                self.shell.message = why;
                self.change(|c| c.target = None);
            }
            Report::Failed(failure) => {
                self.end = Some(PlayError::Other(failure));
                event_loop.exit();
            }
        }
        if let Some(open) = &self.open {
            open.window.request_redraw();
        }
        if self.until.is_some_and(|until| Instant::now() >= until) {
            event_loop.exit();
        }
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(open) = &mut self.open else { return };
        let response = open.egui.on_window_event(&open.window, &event);
        if response.repaint {
            open.window.request_redraw();
        }
        match event {
            WindowEvent::CloseRequested => event_loop.exit(),
            WindowEvent::Resized(size) => {
                open.screen.resize(size.width, size.height);
                // The panel is laid out anew, which tells the picture's new size.
                open.window.request_redraw();
            }
            WindowEvent::RedrawRequested => {
                if let Err(why) = self.redraw(event_loop) {
                    self.end = Some(PlayError::Other(Failure::other(why)));
                    event_loop.exit();
                }
            }
            WindowEvent::KeyboardInput { event, .. } => {
                let typing = open.egui.egui_ctx().egui_wants_keyboard_input();
                if !typing && event.state == ElementState::Pressed {
                    self.key(event_loop, &event);
                }
            }
            _ => {}
        }
    }
}

impl App {
    fn open_window(&self, event_loop: &ActiveEventLoop) -> Result<Open, String> {
        let size = PhysicalSize::new(self.controls.window.0, self.controls.window.1);
        let full = self.shell.settings.fullscreen.then_some(Fullscreen::Borderless(None));
        let attributes =
            Window::default_attributes().with_title("Catoptra").with_inner_size(size).with_fullscreen(full);
        let window = event_loop.create_window(attributes).map_err(|e| format!("no window opens ({e})"))?;
        self.furnish(Arc::new(window), event_loop)
    }

    /// Screen and panel of a window.
    fn furnish(&self, window: Arc<Window>, event_loop: &ActiveEventLoop) -> Result<Open, String> {
        let display = event_loop.owned_display_handle();
        let screen = Screen::new(window.clone(), display, self.window, self.shell.settings.vsync)?;
        let egui = egui_winit::State::new(
            egui::Context::default(),
            egui::ViewportId::ROOT,
            &window,
            Some(window.scale_factor() as f32),
            window.theme(),
            Some(screen.max_texture_side()),
        );
        Ok(Open { window, screen, egui })
    }

    /// Makes screen and drawing anew after the old ones were lost; gives up where that happens again and again.
    fn reopen(&mut self, why: &str, event_loop: &ActiveEventLoop) -> Result<(), String> {
        let soon = self.reopened.is_some_and(|at| at.elapsed() < Duration::from_secs(3));
        let Some(Open { window, screen, .. }) = self.open.take() else { return Ok(()) };
        // The old surface must go before the window can have another.
        drop(screen);
        if soon {
            return Err(format!("{why} again; `--window cpu` needs no graphics driver"));
        }
        self.reopened = Some(Instant::now());
        note(format!("{why}: the window is set up anew"));
        self.open = Some(self.furnish(window, event_loop)?);
        for thumbnail in std::mem::take(&mut self.thumbnails) {
            self.keep_thumbnail(thumbnail);
        }
        if let (Some(open), Some(picture)) = (&mut self.open, &self.picture) {
            open.screen.upload(picture);
            open.window.request_redraw();
        }
        Ok(())
    }

    fn keep_thumbnail(&mut self, t: Thumbnail) {
        if let Some(open) = &self.open {
            let image = egui::ColorImage::from_rgba_unmultiplied([t.size.0 as usize, t.size.1 as usize], &t.rgba8);
            let name = format!("play.thumbnail.{}", t.scene);
            let texture = open.egui.egui_ctx().load_texture(name, image, egui::TextureOptions::LINEAR);
            self.shell.thumbnails[t.scene] = Some(texture);
        }
        self.thumbnails.push(t);
    }

    /// Changes the wishes and tells the worker.
    fn change(&mut self, edit: impl FnOnce(&mut Controls)) {
        edit(&mut self.controls);
        self.shared.set_controls(self.controls.clone());
        // They are on their way now.
        self.controls.once = Requests::default();
        if let Some(open) = &self.open {
            open.window.request_redraw();
        }
    }

    /// Takes the newest picture over.
    fn show_picture(&mut self) {
        let (Some(picture), Some(open)) = (self.shared.take_picture(), &mut self.open) else { return };
        if self.controls.target.is_none() {
            // It was on its way when the picker opened.
            return;
        }
        // While time stands still pictures come when something changes: their distance tells nothing.
        let since_last = self.last_picture.elapsed().as_secs_f64() * 1e3;
        let interval_ms = if self.controls.paused { picture.frame_ms } else { since_last };
        self.last_picture = Instant::now();
        let shell = &mut self.shell;
        shell.figures.learn(&picture, interval_ms);
        shell.plot.learn(&picture);
        shell.camera = picture.camera;
        shell.overlay.clone_from(&picture.overlay);
        let won_before = shell.hud.as_ref().is_some_and(|h| h.won.is_some());
        shell.learn(&picture.hud);
        let mut save = false;
        if let (false, Some(hud)) = (won_before, &shell.hud)
            && let Some(stars) = hud.won
        {
            save = shell.settings.learn(hud.kind.name(), hud.level.0, hud.moves.0, stars);
        }
        self.pictures += 1;
        if self.lose_device == Some(self.pictures) {
            open.screen.lose_device();
        }
        open.screen.upload(&picture);
        open.window.set_title(&format!("Catoptra - {}", picture.name));
        self.picture = Some(picture);
        if save {
            self.save_settings();
        }
    }

    fn hear_answers(&mut self) {
        for answer in self.shared.take_answers() {
            match answer {
                Answer::Tree(tree, names) => self.shell.tree = Some((tree, names)),
                Answer::Told(text) => self.shell.message = text,
                Answer::Thumbnail(t) => self.keep_thumbnail(t),
                Answer::Machine(options) => self.controls.machine = options,
            }
        }
    }

    fn key(&mut self, event_loop: &ActiveEventLoop, event: &KeyEvent) {
        let Some(name) = keys::name(&event.logical_key) else { return };
        if let Some(Menu::Settings(Some(command))) = self.shell.menu {
            self.shell.settings.keys.set(command, &name);
            self.shell.menu = Some(Menu::Settings(None));
            self.save_settings();
            self.change(|_| {});
            return;
        }
        let Some(command) = self.shell.settings.keys.command(&name) else {
            let digit = name.parse().ok().and_then(scene_by_number);
            if let Some(target) = digit {
                let mut controls = self.controls.clone();
                self.shell.leave(&mut controls);
                controls.target = Some(target);
                self.change(|c| *c = controls);
            }
            return;
        };
        // What a held key repeats is meant where it moves something.
        let moves = [Command::North, Command::South, Command::East, Command::West].contains(&command);
        if event.repeat && !moves {
            return;
        }
        let mut controls = self.controls.clone();
        let wishes = self.shell.command(command, &mut controls);
        self.change(|c| *c = controls);
        self.fulfil(event_loop, wishes);
    }

    fn fulfil(&mut self, event_loop: &ActiveEventLoop, wishes: Wishes) {
        if wishes.screenshot {
            self.screenshot();
        }
        if wishes.fullscreen
            && let Some(open) = &self.open
        {
            let full = open.window.fullscreen().is_none();
            open.window.set_fullscreen(full.then_some(Fullscreen::Borderless(None)));
            self.shell.settings.fullscreen = full;
        }
        if wishes.vsync
            && let Some(open) = &mut self.open
        {
            open.screen.set_vsync(self.shell.settings.vsync);
        }
        if wishes.save_settings || wishes.fullscreen {
            self.save_settings();
        }
        if wishes.save_plot {
            self.save_plot();
        }
        if wishes.quit {
            event_loop.exit();
        }
    }

    fn save_settings(&mut self) {
        let Some(path) = &self.config else { return };
        if let Err(why) = self.shell.settings.save(path) {
            note(&why);
            self.shell.message = why;
        }
    }

    fn redraw(&mut self, event_loop: &ActiveEventLoop) -> Result<(), String> {
        let Some(open) = &mut self.open else { return Ok(()) };
        let input = open.egui.take_egui_input(&open.window);
        let context = open.egui.egui_ctx().clone();
        let mut wanted = self.controls.clone();
        let mut wishes = Wishes::default();
        let shell = &mut self.shell;
        let output = context.run_ui(input, |ui| wishes = shell::ui(ui, shell, &mut wanted));
        open.egui.handle_platform_output(&open.window, output.platform_output);
        let pixels_per_point = output.pixels_per_point;
        let primitives = context.tessellate(output.shapes, pixels_per_point);
        let size = open.window.inner_size();
        let stage = Stage::from_points(self.shell.stage, pixels_per_point, size.into());
        let textures = output.textures_delta;
        if let Err(why) = open.screen.draw(PanelDrawing { primitives, textures, pixels_per_point, stage }) {
            return self.reopen(&why, event_loop);
        }
        // A minimised window keeps the size that it had.
        if size.width > 0 && size.height > 0 {
            wanted.window = (stage.width, stage.height);
        }
        // Animations of the panel ask for more frames.
        let soon = output.viewport_output.values().any(|v| v.repaint_delay.as_millis() < 20);
        if soon {
            open.window.request_redraw();
        }
        if wanted.target.is_none() && self.controls.target.is_some() {
            open.screen.clear();
        }
        if wanted != self.controls {
            self.change(|c| *c = wanted);
        }
        self.fulfil(event_loop, wishes);
        Ok(())
    }

    /// Writes the picture that is shown, in its own size, without the panel.
    fn screenshot(&mut self) {
        let Some(p) = &self.picture else { return };
        let srgb8: Vec<u8> = p.rgba8.chunks_exact(4).flat_map(|c| [c[0], c[1], c[2]]).collect();
        let path = PathBuf::from("out").join(format!("{}-play-{:04}.png", p.name, p.frame));
        let written = std::fs::create_dir_all("out")
            .map_err(|e| format!("cannot make the folder out: {e}"))
            .and_then(|()| image_io::write_png(&path, p.width, p.height, &srgb8).map_err(|e| e.to_string()));
        self.tell(written.map(|()| path));
    }

    /// Writes the times of all frames so far.
    fn save_plot(&mut self) {
        let name = self.picture.as_ref().map_or("play", |p| p.name.as_str());
        let path = PathBuf::from("out").join(format!("{name}-times.svg"));
        let written = std::fs::create_dir_all("out")
            .map_err(|e| format!("cannot make the folder out: {e}"))
            .and_then(|()| self.shell.plot.write_svg(&path));
        let (n, median, greatest) = self.shell.plot.figures();
        note(format!("{n} frames, median {median:.2} ms, greatest {greatest:.2} ms"));
        self.tell(written.map(|()| path));
    }

    fn tell(&mut self, written: Result<PathBuf, String>) {
        self.shell.message = match written {
            Ok(path) => format!("wrote {}", path.display()),
            Err(why) => why,
        };
        note(&self.shell.message);
    }

    fn stop(&mut self, worker: JoinHandle<()>) {
        // The event loop has ended: a window that is still asked to redraw would panic.
        self.open = None;
        self.change(|c| c.quit = true);
        // A worker that panicked has said so itself.
        let _ = worker.join();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn source_lines_are_left_out() {
        let told = "os error at /x/winit-0.30.13/src/y.rs:765: neither A nor DISPLAY is set.";
        assert_eq!(first_words(told), "neither A nor DISPLAY is set");
        assert_eq!(first_words("a\n  b"), "a b");
    }
}
