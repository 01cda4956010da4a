//! The way into the window: a graphics driver, or the CPU where there is none.

use super::{WindowArg, compositor::PanelDrawing, present::Presenter, shared::Picture, soft::SoftScreen};
use crate::cli::note;
use std::sync::Arc;
use winit::{event_loop::OwnedDisplayHandle, window::Window};

/// What shows pictures and panel.
pub struct Screen(Way);

enum Way {
    Gpu(Box<Presenter>),
    Cpu(Box<SoftScreen>),
}

impl Screen {
    /// Opens the way that is asked for.
    ///
    /// # Errors
    /// In words, where it cannot be had; `Auto` tries both.
    pub fn new(
        window: Arc<Window>,
        display: OwnedDisplayHandle,
        wanted: WindowArg,
        vsync: bool,
    ) -> Result<Self, String> {
        let gpu = || Presenter::new(window.clone(), display.clone(), vsync).map(|p| Way::Gpu(Box::new(p)));
        let cpu = || SoftScreen::new(window.clone(), display.clone()).map(|s| Way::Cpu(Box::new(s)));
        let way = match wanted {
            WindowArg::Gpu => gpu()?,
            WindowArg::Cpu => cpu()?,
            WindowArg::Auto => match gpu() {
                Ok(way) => way,
                Err(why) => {
                    let way = cpu().map_err(|also| format!("{why}; {also}"))?;
                    note(format!("{why}: the CPU draws the window"));
                    way
                }
            },
        };
        Ok(Self(way))
    }

    /// Greatest side of a texture.
    pub fn max_texture_side(&self) -> usize {
        match &self.0 {
            Way::Gpu(p) => p.max_texture_side(),
            Way::Cpu(_) => 8192,
        }
    }

    /// The window has another size; none while it is minimised.
    pub fn resize(&mut self, width: u32, height: u32) {
        if let Way::Gpu(p) = &mut self.0 {
            p.resize(width, height);
        }
    }

    /// Pictures wait for the screen from now on, or not any more.
    pub fn set_vsync(&mut self, on: bool) {
        if let Way::Gpu(p) = &mut self.0 {
            p.set_vsync(on);
        }
    }

    /// For tests: takes the graphics device away; the CPU's way has none.
    pub fn lose_device(&self) {
        if let Way::Gpu(p) = &self.0 {
            p.lose_device();
        }
    }

    /// Shows another picture from now on.
    pub fn upload(&mut self, picture: &Picture) {
        match &mut self.0 {
            Way::Gpu(p) => p.upload(picture),
            Way::Cpu(s) => s.upload(picture),
        }
    }

    /// Shows no picture from now on.
    pub fn clear(&mut self) {
        match &mut self.0 {
            Way::Gpu(p) => p.clear(),
            Way::Cpu(s) => s.clear(),
        }
    }

    /// Draws picture and panel.
    ///
    /// # Errors
    /// In words, where this way is gone: a new screen, and a new context of egui's, may find another.
    pub fn draw(&mut self, panel: PanelDrawing) -> Result<(), String> {
        match &mut self.0 {
            Way::Cpu(s) => s.draw(&panel),
            Way::Gpu(p) => p.draw(&panel),
        }
    }
}
