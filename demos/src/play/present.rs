//! The window's surface: the newest picture beside the panel.
//!
//! The surface has a device of its own. It carries one small texture and the panel, whatever lane makes the picture, so a
//! window works on any adapter that can show at all.

use super::{
    compositor::{Compositor, PanelDrawing},
    shared::Picture,
};
use std::sync::Arc;
use winit::{event_loop::OwnedDisplayHandle, window::Window};

/// A window's surface and what is drawn with.
pub struct Presenter {
    instance: wgpu::Instance,
    window: Arc<Window>,
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    compositor: Compositor,
}

impl Presenter {
    /// Finds an adapter that can show on the window.
    ///
    /// # Errors
    /// In words, where there is none.
    pub fn new(window: Arc<Window>, display: OwnedDisplayHandle, vsync: bool) -> Result<Self, String> {
        let descriptor = wgpu::InstanceDescriptor::new_with_display_handle_from_env(Box::new(display));
        let instance = wgpu::Instance::new(descriptor);
        let surface = instance.create_surface(window.clone()).map_err(|e| format!("the window has no surface: {e}"))?;
        let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            compatible_surface: Some(&surface),
            ..Default::default()
        }))
        .map_err(|_| "no graphics adapter can show in a window here".to_string())?;
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("play.device"),
            required_limits: wgpu::Limits::downlevel_defaults().using_resolution(adapter.limits()),
            ..Default::default()
        }))
        .map_err(|e| format!("{} gives no device: {e}", adapter.get_info().name))?;
        let size = window.inner_size();
        let mut config = surface
            .get_default_config(&adapter, size.width.max(1), size.height.max(1))
            .ok_or_else(|| format!("{} cannot show in this window", adapter.get_info().name))?;
        // Picture and panel come as sRGB bytes: the surface must not encode them once more.
        let formats = surface.get_capabilities(&adapter).formats;
        config.format = formats.iter().copied().find(|f| !f.is_srgb()).unwrap_or(config.format);
        config.present_mode = present_mode(vsync);
        surface.configure(&device, &config);
        let compositor = Compositor::new(device, queue, config.format);
        Ok(Self { instance, window, surface, config, compositor })
    }

    /// Greatest side of a texture.
    pub fn max_texture_side(&self) -> usize {
        self.compositor.device().limits().max_texture_dimension_2d as usize
    }

    /// Pictures wait for the screen from now on, or not any more.
    pub fn set_vsync(&mut self, on: bool) {
        self.config.present_mode = present_mode(on);
        self.configure();
    }

    /// The window has another size.
    pub fn resize(&mut self, width: u32, height: u32) {
        // A minimised window has none, and no texture is larger than the device holds.
        if width > 0 && height > 0 {
            let most = self.max_texture_side() as u32;
            (self.config.width, self.config.height) = (width.min(most), height.min(most));
            self.configure();
        }
    }

    fn configure(&self) {
        self.surface.configure(self.compositor.device(), &self.config);
    }

    /// Shows another picture from now on.
    pub fn upload(&mut self, picture: &Picture) {
        self.compositor.upload(picture);
    }

    /// Shows no picture from now on.
    pub fn clear(&mut self) {
        self.compositor.clear();
    }

    /// For tests: takes the device away, as a driver does that crashes or is replaced.
    pub fn lose_device(&self) {
        self.compositor.device().destroy();
    }

    /// Draws picture and panel.
    ///
    /// # Errors
    /// In words, where device or surface are lost for good.
    pub fn draw(&mut self, panel: &PanelDrawing) -> Result<(), String> {
        use wgpu::CurrentSurfaceTexture as Current;
        self.compositor.check()?;
        self.compositor.learn(panel);
        let (frame, stale) = match self.surface.get_current_texture() {
            Current::Success(frame) => (Some(frame), false),
            // It can still be shown; the next one fits better.
            Current::Suboptimal(frame) => (Some(frame), true),
            Current::Outdated => (None, true),
            Current::Lost => {
                self.surface = self
                    .instance
                    .create_surface(self.window.clone())
                    .map_err(|e| format!("the window's surface was lost: {e}"))?;
                (None, true)
            }
            Current::Timeout | Current::Occluded => (None, false),
            Current::Validation => return Err("the window's surface is not valid any more".into()),
        };
        let shown = frame.is_some();
        if let Some(frame) = frame {
            let view = frame.texture.create_view(&wgpu::TextureViewDescriptor::default());
            self.compositor.draw(&view, [self.config.width, self.config.height], panel);
            self.window.pre_present_notify();
            self.compositor.queue().present(frame);
        }
        if stale {
            self.configure();
            if !shown {
                self.window.request_redraw();
            }
        }
        self.compositor.forget(panel);
        Ok(())
    }
}

fn present_mode(vsync: bool) -> wgpu::PresentMode {
    if vsync { wgpu::PresentMode::AutoVsync } else { wgpu::PresentMode::AutoNoVsync }
}
