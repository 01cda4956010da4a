//! The window's thread: input in, the newest picture and the panel out.

use super::{
    PlayError,
    panel::{self, Figures},
    present::{PanelDrawing, Presenter, Stage},
    scene_by_number,
    shared::{Controls, Picture, Shared},
    worker::{self, Report},
};
use crate::cli::{Failure, PictureArgs, Target, note};
use catoptra_render_hybrid::image_io;
use std::{path::PathBuf, sync::Arc, thread::JoinHandle, time::Instant};
use winit::{
    application::ApplicationHandler,
    dpi::PhysicalSize,
    event::{ElementState, KeyEvent, WindowEvent},
    event_loop::{ActiveEventLoop, ControlFlow, EventLoop},
    keyboard::{Key, NamedKey},
    window::{Window, WindowId},
};

/// Opens the window and plays until it is closed.
pub fn run(controls: Controls, picture: &PictureArgs) -> Result<(), PlayError> {
    let event_loop = EventLoop::<Report>::with_user_event()
        .build()
        .map_err(|e| PlayError::NoWindow(format!("there is no display ({})", first_words(&e.to_string()))))?;
    event_loop.set_control_flow(ControlFlow::Wait);
    let renderer = picture.renderer()?;
    let (shared, options) = (Arc::new(Shared::new(controls.clone())), picture.scene.options());
    let proxy = event_loop.create_proxy();
    let worker = {
        let shared = shared.clone();
        std::thread::Builder::new()
            .name("catoptra-play".into())
            .spawn(move || worker::run(&shared, renderer, &options, |r| proxy.send_event(r).is_ok()))
            .map_err(|e| PlayError::Other(Failure::other(e)))?
    };
    let mut app = App {
        shared,
        controls,
        open: None,
        panel_shown: true,
        figures: Figures::default(),
        picture: None,
        last_picture: Instant::now(),
        message: String::new(),
        end: None,
    };
    let ran = event_loop.run_app(&mut app);
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
    panel_shown: bool,
    figures: Figures,
    picture: Option<Picture>,
    last_picture: Instant,
    message: String,
    /// Why the window closes, if not because the user wants it.
    end: Option<PlayError>,
}

struct Open {
    window: Arc<Window>,
    presenter: Presenter,
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
            Report::Picture => {
                let (Some(picture), Some(open)) = (self.shared.take_picture(), &mut self.open) else { return };
                if self.controls.target.is_none() {
                    // It was on its way when the picker opened.
                    return;
                }
                // While time stands still pictures come when something changes: their distance tells nothing.
                let since_last = self.last_picture.elapsed().as_secs_f64() * 1e3;
                let interval_ms = if self.controls.paused { picture.frame_ms } else { since_last };
                self.last_picture = Instant::now();
                self.figures.learn(&picture, interval_ms);
                open.presenter.upload(&picture);
                open.window.set_title(&format!("Catoptra - {}", picture.name));
                self.picture = Some(picture);
            }
            Report::Unplayable(why) => {
                note(&why);
                self.message = why;
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
                open.presenter.resize(size.width, size.height);
                // The panel is laid out anew, which tells the picture's new size.
                open.window.request_redraw();
            }
            WindowEvent::RedrawRequested => {
                if let Err(why) = self.redraw() {
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
        let attributes = Window::default_attributes().with_title("Catoptra").with_inner_size(size);
        let window = event_loop.create_window(attributes).map_err(|e| format!("no window opens ({e})"))?;
        let window = Arc::new(window);
        let presenter = Presenter::new(window.clone(), event_loop.owned_display_handle())?;
        let egui = egui_winit::State::new(
            egui::Context::default(),
            egui::ViewportId::ROOT,
            &window,
            Some(window.scale_factor() as f32),
            window.theme(),
            Some(presenter.max_texture_side()),
        );
        Ok(Open { window, presenter, egui })
    }

    /// Changes the wishes and tells the worker.
    fn change(&mut self, edit: impl FnOnce(&mut Controls)) {
        edit(&mut self.controls);
        self.shared.set_controls(self.controls.clone());
        // They are on their way now.
        self.controls.steps = 0;
        if let Some(open) = &self.open {
            open.window.request_redraw();
        }
    }

    fn key(&mut self, event_loop: &ActiveEventLoop, event: &KeyEvent) {
        match &event.logical_key {
            Key::Named(NamedKey::Escape) => event_loop.exit(),
            Key::Named(NamedKey::F1) => {
                self.panel_shown = !self.panel_shown;
                self.change(|_| {});
            }
            Key::Named(NamedKey::Space) => self.change(|c| c.paused = !c.paused),
            Key::Character(text) => match text.as_str() {
                "." => self.change(|c| {
                    c.paused = true;
                    c.steps += 1;
                }),
                "l" => self.change(|c| c.layer = panel::next_layer(c.layer)),
                "r" => self.change(|c| c.restarts += 1),
                "p" => self.screenshot(),
                digit => {
                    if let Some(target) = digit.parse().ok().and_then(scene_by_number) {
                        self.pick(target);
                    }
                }
            },
            _ => {}
        }
    }

    fn pick(&mut self, target: Target) {
        self.message.clear();
        self.change(|c| c.target = Some(target));
    }

    fn redraw(&mut self) -> Result<(), String> {
        let Some(open) = &mut self.open else { return Ok(()) };
        let input = open.egui.take_egui_input(&open.window);
        let context = open.egui.egui_ctx().clone();
        let mut wanted = self.controls.clone();
        let mut wishes = panel::Wishes::default();
        let mut left = egui::Rect::NOTHING;
        let (figures, message, shown) = (&self.figures, self.message.as_str(), self.panel_shown);
        let output = context.run_ui(input, |ui| {
            if wanted.target.is_none() {
                panel::picker(ui, &mut wanted, message);
            } else if shown {
                wishes = panel::panel(ui, &mut wanted, figures, message);
            }
            left = ui.available_rect_before_wrap();
        });
        open.egui.handle_platform_output(&open.window, output.platform_output);
        let pixels_per_point = output.pixels_per_point;
        let primitives = context.tessellate(output.shapes, pixels_per_point);
        let stage = Stage::from_points(left, pixels_per_point, open.window.inner_size().into());
        let textures = output.textures_delta;
        open.presenter.draw(PanelDrawing { primitives, textures, pixels_per_point, stage })?;
        wanted.window = (stage.width, stage.height);
        // Animations of the panel ask for more frames.
        let soon = output.viewport_output.values().any(|v| v.repaint_delay.as_millis() < 20);
        if soon {
            open.window.request_redraw();
        }
        if wishes.picker {
            wanted.target = None;
            open.presenter.clear();
        }
        if wishes.screenshot {
            self.screenshot();
        }
        if wanted != self.controls {
            self.change(|c| *c = wanted);
        }
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
        self.message = match written {
            Ok(()) => format!("wrote {}", path.display()),
            Err(why) => why,
        };
        note(&self.message);
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
