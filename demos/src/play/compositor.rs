//! Draws the newest picture and the panel with a device: into a window's surface, or into any other view.

use super::shared::Picture;
use egui_wgpu::ScreenDescriptor;
use std::sync::{Arc, Mutex, PoisonError};

/// What is drawn with.
pub struct Compositor {
    device: wgpu::Device,
    queue: wgpu::Queue,
    pipeline: wgpu::RenderPipeline,
    layout: wgpu::BindGroupLayout,
    sampler: wgpu::Sampler,
    picture: Option<(wgpu::Texture, wgpu::BindGroup)>,
    egui: egui_wgpu::Renderer,
    /// The first thing that went wrong with the device.
    fault: Arc<Mutex<Option<String>>>,
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

impl Drop for PanelDrawing {
    fn drop(&mut self) {
        // egui takes textures that nobody took over for a mistake; where the device is lost there is nobody.
        self.textures.clear();
    }
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

impl Compositor {
    /// For views of `format`, which must take sRGB bytes as they are.
    pub fn new(device: wgpu::Device, queue: wgpu::Queue, format: wgpu::TextureFormat) -> Self {
        let fault = Arc::<Mutex<Option<String>>>::default();
        let keep = |fault: &Arc<Mutex<Option<String>>>, why: String| {
            fault.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(why);
        };
        let told = fault.clone();
        device.set_device_lost_callback(move |_, why| keep(&told, format!("the graphics device was lost ({why})")));
        // What a lost device is asked to do in the meantime are errors too; none of them may end the program.
        let told = fault.clone();
        device.on_uncaptured_error(Arc::new(move |e: wgpu::Error| {
            keep(&told, format!("the graphics device failed ({e})"))
        }));
        let (layout, pipeline) = pipeline(&device, format);
        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("play.picture_sampler"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        let egui = egui_wgpu::Renderer::new(&device, format, egui_wgpu::RendererOptions::default());
        Self { device, queue, pipeline, layout, sampler, picture: None, egui, fault }
    }

    /// The device.
    pub fn device(&self) -> &wgpu::Device {
        &self.device
    }

    /// The device's queue.
    pub fn queue(&self) -> &wgpu::Queue {
        &self.queue
    }

    /// Whether the device still works.
    ///
    /// # Errors
    /// In words, what it said first.
    pub fn check(&self) -> Result<(), String> {
        // A lost device tells so while it is polled.
        let polled = self.device.poll(wgpu::PollType::Poll);
        if let Some(why) = &*self.fault.lock().unwrap_or_else(PoisonError::into_inner) {
            return Err(why.split_whitespace().collect::<Vec<_>>().join(" "));
        }
        polled.map(|_| ()).map_err(|e| format!("the graphics device failed ({e})"))
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

    /// Takes the panel's new textures over. They are told once: even where nothing can be shown now.
    pub fn learn(&mut self, panel: &PanelDrawing) {
        for (id, deltas) in &panel.textures.set {
            for delta in deltas {
                self.egui.update_texture(&self.device, &self.queue, *id, delta);
            }
        }
    }

    /// Gives up the panel's textures that are gone.
    pub fn forget(&mut self, panel: &PanelDrawing) {
        for id in &panel.textures.free {
            self.egui.free_texture(id);
        }
    }

    /// Draws picture and panel into a view of `size` pixels and submits.
    pub fn draw(&mut self, view: &wgpu::TextureView, size: [u32; 2], panel: &PanelDrawing) {
        let screen = ScreenDescriptor { size_in_pixels: size, pixels_per_point: panel.pixels_per_point };
        let mut encoder =
            self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("play.frame") });
        let mut commands =
            self.egui.update_buffers(&self.device, &self.queue, &mut encoder, &panel.primitives, &screen);
        {
            let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("play.window"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view,
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
                let x = panel.stage.x.min(size[0] - 1);
                let y = panel.stage.y.min(size[1] - 1);
                let width = panel.stage.width.min(size[0] - x);
                let height = panel.stage.height.min(size[1] - y);
                pass.set_viewport(x as f32, y as f32, width as f32, height as f32, 0.0, 1.0);
                pass.set_pipeline(&self.pipeline);
                pass.set_bind_group(0, bind_group, &[]);
                pass.draw(0..3, 0..1);
            }
            self.egui.render(&mut pass, &panel.primitives, &screen);
        }
        commands.push(encoder.finish());
        self.queue.submit(commands);
    }
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
mod tests;
