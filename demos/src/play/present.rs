//! The window's surface: the newest picture beside the panel.
//!
//! The surface has a device of its own. It carries one small texture and the panel, whatever lane makes the picture, so a
//! window works on any adapter that can show at all.

use super::shared::Picture;
use egui_wgpu::ScreenDescriptor;
use std::sync::Arc;
use winit::{event_loop::OwnedDisplayHandle, window::Window};

/// Surface, device and what is drawn with.
pub struct Presenter {
    instance: wgpu::Instance,
    window: Arc<Window>,
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    device: wgpu::Device,
    queue: wgpu::Queue,
    pipeline: wgpu::RenderPipeline,
    layout: wgpu::BindGroupLayout,
    sampler: wgpu::Sampler,
    picture: Option<(wgpu::Texture, wgpu::BindGroup)>,
    egui: egui_wgpu::Renderer,
    /// Set by the driver when the device is gone.
    lost: Arc<std::sync::atomic::AtomicBool>,
}

/// The panel of one frame, tessellated.
pub struct PanelDrawing {
    /// Triangles.
    pub primitives: Vec<egui::ClippedPrimitive>,
    /// Textures that are new, changed or gone.
    pub textures: egui::TexturesDelta,
    /// Pixels a point.
    pub pixels_per_point: f32,
    /// Where the picture goes.
    pub stage: Stage,
}

/// The part of the window that the panel leaves to the picture, in pixels from the top left corner.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stage {
    /// Left edge.
    pub x: u32,
    /// Upper edge.
    pub y: u32,
    /// Width, at least 1.
    pub width: u32,
    /// Height, at least 1.
    pub height: u32,
}

impl Stage {
    /// `rect` in points, cut to a window of `(width, height)` pixels; the whole window where nothing would be left.
    pub fn from_points(rect: egui::Rect, pixels_per_point: f32, window: (u32, u32)) -> Self {
        let (window_width, window_height) = (window.0.max(1), window.1.max(1));
        // Casts of what lies outside saturate.
        let edge = |points: f32, most: u32| ((points * pixels_per_point).round() as u32).min(most);
        let (x, y) = (edge(rect.min.x, window_width), edge(rect.min.y, window_height));
        let (right, bottom) = (edge(rect.max.x, window_width), edge(rect.max.y, window_height));
        if right <= x || bottom <= y {
            return Self { x: 0, y: 0, width: window_width, height: window_height };
        }
        Self { x, y, width: right - x, height: bottom - y }
    }
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

        let (layout, pipeline) = pipeline(&device, config.format);
        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("play.picture_sampler"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        let egui = egui_wgpu::Renderer::new(&device, config.format, egui_wgpu::RendererOptions::default());
        let picture = None;
        let lost = Arc::<std::sync::atomic::AtomicBool>::default();
        let told = lost.clone();
        device.set_device_lost_callback(move |_, _| told.store(true, std::sync::atomic::Ordering::Relaxed));
        Ok(Self { lost, instance, window, surface, config, device, queue, pipeline, layout, sampler, picture, egui })
    }

    /// Greatest side of a texture.
    pub fn max_texture_side(&self) -> usize {
        self.device.limits().max_texture_dimension_2d as usize
    }

    /// Pictures wait for the screen from now on, or not any more.
    pub fn set_vsync(&mut self, on: bool) {
        self.config.present_mode = present_mode(on);
        self.surface.configure(&self.device, &self.config);
    }

    /// The window has another size.
    pub fn resize(&mut self, width: u32, height: u32) {
        // A minimised window has none.
        if width > 0 && height > 0 {
            (self.config.width, self.config.height) = (width, height);
            self.surface.configure(&self.device, &self.config);
        }
    }

    /// Shows another picture from now on.
    pub fn upload(&mut self, picture: &Picture) {
        let size = wgpu::Extent3d { width: picture.width, height: picture.height, depth_or_array_layers: 1 };
        if self.picture.as_ref().is_none_or(|(t, _)| t.size() != size) {
            self.picture = Some(self.picture_texture(size));
        }
        let Some((texture, _)) = &self.picture else { return };
        let layout =
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * size.width), rows_per_image: None };
        self.queue.write_texture(texture.as_image_copy(), &picture.rgba8, layout, size);
    }

    /// Shows no picture from now on.
    pub fn clear(&mut self) {
        self.picture = None;
    }

    fn picture_texture(&self, size: wgpu::Extent3d) -> (wgpu::Texture, wgpu::BindGroup) {
        let texture = self.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("play.picture"),
            size,
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba8Unorm,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        });
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        let bind_group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("play.picture"),
            layout: &self.layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(&view) },
                wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::Sampler(&self.sampler) },
            ],
        });
        (texture, bind_group)
    }

    /// Draws picture and panel.
    ///
    /// # Errors
    /// In words, where the surface is lost for good.
    pub fn draw(&mut self, panel: PanelDrawing) -> Result<(), String> {
        use wgpu::CurrentSurfaceTexture as Current;
        if self.lost.load(std::sync::atomic::Ordering::Relaxed) {
            return Err("the graphics device was lost".into());
        }
        // Textures of the panel are told once: take them even where nothing can be shown now.
        for (id, deltas) in &panel.textures.set {
            for delta in deltas {
                self.egui.update_texture(&self.device, &self.queue, *id, delta);
            }
        }
        let frame = match self.surface.get_current_texture() {
            Current::Success(frame) => Some(frame),
            Current::Suboptimal(frame) => {
                drop(frame);
                self.surface.configure(&self.device, &self.config);
                None
            }
            Current::Outdated => {
                self.surface.configure(&self.device, &self.config);
                None
            }
            Current::Lost => {
                self.surface = self
                    .instance
                    .create_surface(self.window.clone())
                    .map_err(|e| format!("the window's surface was lost: {e}"))?;
                self.surface.configure(&self.device, &self.config);
                None
            }
            Current::Timeout | Current::Occluded => None,
            Current::Validation => return Err("the window's surface is not valid any more".into()),
        };
        if let Some(frame) = frame {
            self.draw_into(frame, &panel);
        }
        for id in &panel.textures.free {
            self.egui.free_texture(id);
        }
        Ok(())
    }

    fn draw_into(&mut self, frame: wgpu::SurfaceTexture, panel: &PanelDrawing) {
        let screen = ScreenDescriptor {
            size_in_pixels: [self.config.width, self.config.height],
            pixels_per_point: panel.pixels_per_point,
        };
        let mut encoder =
            self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("play.frame") });
        let mut commands =
            self.egui.update_buffers(&self.device, &self.queue, &mut encoder, &panel.primitives, &screen);
        let view = frame.texture.create_view(&wgpu::TextureViewDescriptor::default());
        {
            let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("play.window"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                ..Default::default()
            });
            // The panel's renderer asks for a pass that borrows nothing.
            let mut pass = pass.forget_lifetime();
            if let Some((_, bind_group)) = &self.picture {
                // The surface may be a step behind the window while it is resized.
                let x = panel.stage.x.min(self.config.width - 1);
                let y = panel.stage.y.min(self.config.height - 1);
                let width = panel.stage.width.min(self.config.width - x);
                let height = panel.stage.height.min(self.config.height - y);
                pass.set_viewport(x as f32, y as f32, width as f32, height as f32, 0.0, 1.0);
                pass.set_pipeline(&self.pipeline);
                pass.set_bind_group(0, bind_group, &[]);
                pass.draw(0..3, 0..1);
            }
            self.egui.render(&mut pass, &panel.primitives, &screen);
        }
        commands.push(encoder.finish());
        self.queue.submit(commands);
        self.window.pre_present_notify();
        self.queue.present(frame);
    }
}

fn present_mode(vsync: bool) -> wgpu::PresentMode {
    if vsync { wgpu::PresentMode::AutoVsync } else { wgpu::PresentMode::AutoNoVsync }
}

fn pipeline(device: &wgpu::Device, format: wgpu::TextureFormat) -> (wgpu::BindGroupLayout, wgpu::RenderPipeline) {
    let shader = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("play.present"),
        source: wgpu::ShaderSource::Wgsl(include_str!("present.wgsl").into()),
    });
    let entry =
        |binding, ty| wgpu::BindGroupLayoutEntry { binding, visibility: wgpu::ShaderStages::FRAGMENT, ty, count: None };
    let texture = wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Float { filterable: true },
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let sampler = wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering);
    let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("play.picture"),
        entries: &[entry(0, texture), entry(1, sampler)],
    });
    let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("play.present"),
        bind_group_layouts: &[Some(&layout)],
        immediate_size: 0,
    });
    let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("play.present"),
        layout: Some(&pipeline_layout),
        vertex: wgpu::VertexState {
            module: &shader,
            entry_point: Some("vs_main"),
            compilation_options: Default::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: &shader,
            entry_point: Some("fs_main"),
            compilation_options: Default::default(),
            targets: &[Some(format.into())],
        }),
        multiview_mask: None,
        cache: None,
    });
    (layout, pipeline)
}

#[cfg(test)]
mod tests {
    use super::*;
    use egui::{Pos2, Rect};

    #[test]
    fn the_stage_lies_in_the_window() {
        let rect = Rect::from_min_max(Pos2::new(100.0, 0.0), Pos2::new(400.0, 300.0));
        let stage = Stage::from_points(rect, 2.0, (800, 600));
        assert_eq!(stage, Stage { x: 200, y: 0, width: 600, height: 600 });
        let whole = Stage { x: 0, y: 0, width: 10, height: 20 };
        assert_eq!(Stage::from_points(Rect::NOTHING, 1.0, (10, 20)), whole);
        assert_eq!(Stage::from_points(Rect::EVERYTHING, 1.0, (10, 20)), whole);
        assert_eq!(Stage::from_points(rect, 1.0, (50, 20)), Stage { x: 0, y: 0, width: 50, height: 20 });
        assert_eq!(Stage::from_points(Rect::EVERYTHING, 1.0, (0, 0)).width, 1);
    }
}
