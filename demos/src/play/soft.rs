//! The window without any graphics driver: picture and panel are drawn by the CPU and handed to the window system.

use super::{
    compositor::{PanelDrawing, Stage},
    shared::Picture,
};
use egui::{Color32, epaint::Primitive};
use std::{collections::BTreeMap, num::NonZeroU32, sync::Arc};
use winit::{event_loop::OwnedDisplayHandle, window::Window};

/// Surface and what is drawn with.
pub struct SoftScreen {
    window: Arc<Window>,
    surface: softbuffer::Surface<OwnedDisplayHandle, Arc<Window>>,
    picture: Option<(u32, u32, Vec<u8>)>,
    painter: Painter,
    canvas: Canvas,
}

impl SoftScreen {
    /// Asks the window system for memory to draw in.
    ///
    /// # Errors
    /// In words.
    pub fn new(window: Arc<Window>, display: OwnedDisplayHandle) -> Result<Self, String> {
        let told = |e: softbuffer::SoftBufferError| format!("the window takes no pictures from the CPU ({e})");
        let context = softbuffer::Context::new(display).map_err(told)?;
        let surface = softbuffer::Surface::new(&context, window.clone()).map_err(told)?;
        Ok(Self { window, surface, picture: None, painter: Painter::default(), canvas: Canvas::default() })
    }

    /// Shows another picture from now on.
    pub fn upload(&mut self, p: &Picture) {
        let (_, _, bytes) = self.picture.get_or_insert_default();
        bytes.clone_from(&p.rgba8);
        if let Some((width, height, _)) = &mut self.picture {
            (*width, *height) = (p.width, p.height);
        }
    }

    /// Shows no picture from now on.
    pub fn clear(&mut self) {
        self.picture = None;
    }

    /// Draws picture and panel.
    ///
    /// # Errors
    /// In words, where the window system takes no more.
    pub fn draw(&mut self, panel: &PanelDrawing) -> Result<(), String> {
        let size = self.window.inner_size();
        self.painter.learn(&panel.textures);
        // A minimised window shows nothing.
        let (Some(width), Some(height)) = (NonZeroU32::new(size.width), NonZeroU32::new(size.height)) else {
            self.painter.forget(&panel.textures);
            return Ok(());
        };
        self.canvas.clear(size.width, size.height);
        if let Some((w, h, rgba8)) = &self.picture {
            self.canvas.picture(panel.stage, *w, *h, rgba8);
        }
        self.painter.paint(&mut self.canvas, &panel.primitives, panel.pixels_per_point);
        self.painter.forget(&panel.textures);
        let told = |e: softbuffer::SoftBufferError| format!("the window takes no more pictures ({e})");
        self.surface.resize(width, height).map_err(told)?;
        let mut buffer = self.surface.buffer_mut().map_err(told)?;
        for (to, [r, g, b]) in buffer.iter_mut().zip(&self.canvas.pixels) {
            *to = u32::from(*r) << 16 | u32::from(*g) << 8 | u32::from(*b);
        }
        self.window.pre_present_notify();
        buffer.present().map_err(told)
    }
}

/// sRGB bytes, `[height][width][3]`.
#[derive(Default)]
pub struct Canvas {
    pub width: u32,
    pub height: u32,
    pub pixels: Vec<[u8; 3]>,
}

impl Canvas {
    /// Black, of another size.
    pub fn clear(&mut self, width: u32, height: u32) {
        (self.width, self.height) = (width, height);
        self.pixels.clear();
        self.pixels.resize(width as usize * height as usize, [0; 3]);
    }

    /// Draws a picture over the stage, bilinear.
    pub fn picture(&mut self, stage: Stage, w: u32, h: u32, rgba8: &[u8]) {
        if w == 0 || h == 0 {
            return;
        }
        // Places in 1/256 pixels of the picture.
        let source = |i: u32, side: u32, count: u32| {
            let at = (((2 * i + 1) as u64 * u64::from(count) * 128) / u64::from(side)).saturating_sub(128) as u32;
            let low = (at >> 8).min(count - 1);
            (low as usize, (low + 1).min(count - 1) as usize, at & 255)
        };
        let columns: Vec<_> = (0..stage.width).map(|x| source(x, stage.width, w)).collect();
        for y in 0..stage.height.min(self.height.saturating_sub(stage.y)) {
            let (y0, y1, fy) = source(y, stage.height, h);
            let row = ((stage.y + y) * self.width + stage.x) as usize;
            let (upper, lower) = (y0 * w as usize * 4, y1 * w as usize * 4);
            let visible = self.width.saturating_sub(stage.x) as usize;
            for (i, &(x0, x1, fx)) in columns.iter().take(visible).enumerate() {
                self.pixels[row + i] = std::array::from_fn(|c| {
                    let at = |line: usize, x: usize| u32::from(rgba8[line + x * 4 + c]);
                    let top = at(upper, x0) * (256 - fx) + at(upper, x1) * fx;
                    let bottom = at(lower, x0) * (256 - fx) + at(lower, x1) * fx;
                    ((top * (256 - fy) + bottom * fy + (1 << 15)) >> 16) as u8
                });
            }
        }
    }

    fn blend(&mut self, at: usize, c: [f32; 4]) {
        let keep = 1.0 - c[3] / 255.0;
        for (to, c) in self.pixels[at].iter_mut().zip(c) {
            *to = (f32::from(*to) * keep + c + 0.5).clamp(0.0, 255.0) as u8;
        }
    }
}

/// Draws egui's triangles, blended as egui means it: premultiplied sRGB bytes.
#[derive(Default)]
pub struct Painter {
    textures: BTreeMap<egui::TextureId, egui::ColorImage>,
}

impl Painter {
    /// Takes new and changed textures over.
    pub fn learn(&mut self, textures: &egui::TexturesDelta) {
        for (id, deltas) in &textures.set {
            for delta in deltas {
                let egui::ImageData::Color(image) = &delta.image;
                match (delta.pos, self.textures.get_mut(id)) {
                    (Some([x, y]), Some(whole)) => {
                        for row in 0..image.size[1] {
                            let to = (y + row) * whole.size[0] + x;
                            let from = row * image.size[0];
                            whole.pixels[to..to + image.size[0]]
                                .copy_from_slice(&image.pixels[from..from + image.size[0]]);
                        }
                    }
                    _ => {
                        self.textures.insert(*id, (**image).clone());
                    }
                }
            }
        }
    }

    /// Gives up textures that are gone.
    pub fn forget(&mut self, textures: &egui::TexturesDelta) {
        for id in &textures.free {
            self.textures.remove(id);
        }
    }

    /// Paints triangles in their order.
    pub fn paint(&self, canvas: &mut Canvas, primitives: &[egui::ClippedPrimitive], pixels_per_point: f32) {
        for primitive in primitives {
            let Primitive::Mesh(mesh) = &primitive.primitive else { continue };
            let Some(texture) = self.textures.get(&mesh.texture_id) else { continue };
            let edge = |points: f32, most: u32| ((points * pixels_per_point).round().max(0.0) as u32).min(most);
            let clip = primitive.clip_rect;
            let clip = [
                edge(clip.min.x, canvas.width),
                edge(clip.min.y, canvas.height),
                edge(clip.max.x, canvas.width),
                edge(clip.max.y, canvas.height),
            ];
            for corner in mesh.indices.chunks_exact(3) {
                let corners = [0, 1, 2].map(|i| &mesh.vertices[corner[i] as usize]);
                let mut places = corners.map(|v| [v.pos.x * pixels_per_point, v.pos.y * pixels_per_point]);
                let mut order = [0, 1, 2];
                if area(places[0], places[1], places[2]) < 0.0 {
                    places.swap(1, 2);
                    order.swap(1, 2);
                }
                triangle(canvas, clip, places, order.map(|i| corners[i]), texture);
            }
        }
    }
}

fn area(a: [f32; 2], b: [f32; 2], c: [f32; 2]) -> f32 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Fills a triangle whose corners run clockwise on the screen. A pixel on the edge of two triangles belongs to one of them.
fn triangle(
    canvas: &mut Canvas,
    clip: [u32; 4],
    p: [[f32; 2]; 3],
    corners: [&egui::epaint::Vertex; 3],
    texture: &egui::ColorImage,
) {
    let whole = area(p[0], p[1], p[2]);
    if !(whole > 0.0) {
        return;
    }
    let low = |i: usize, least: u32| {
        (p.iter().map(|c| c[i]).fold(f32::INFINITY, f32::min).floor().max(0.0) as u32).max(least)
    };
    let high = |i: usize, most: u32| (p.iter().map(|c| c[i]).fold(0.0, f32::max).ceil() as u32).min(most);
    // An edge owns its pixels where it is an upper or a left one.
    let owns = |a: [f32; 2], b: [f32; 2]| (a[1] == b[1] && b[0] > a[0]) || b[1] < a[1];
    let own = [owns(p[1], p[2]), owns(p[2], p[0]), owns(p[0], p[1])];
    let color = corners.map(|v| v.color.to_array().map(f32::from));
    let plain = corners.iter().all(|v| v.color == corners[0].color && v.uv == corners[0].uv);
    let flat = plain.then(|| shaded(texture, [corners[0].uv.x, corners[0].uv.y], color[0]));
    for y in low(1, clip[1])..high(1, clip[3]) {
        for x in low(0, clip[0])..high(0, clip[2]) {
            let at = [x as f32 + 0.5, y as f32 + 0.5];
            let w = [area(p[1], p[2], at), area(p[2], p[0], at), area(p[0], p[1], at)];
            if !(0..3).all(|i| w[i] > 0.0 || (w[i] == 0.0 && own[i])) {
                continue;
            }
            let share = w.map(|w| w / whole);
            let pixel = (y * canvas.width + x) as usize;
            let mixed = flat.unwrap_or_else(|| {
                let mix = |f: &dyn Fn(usize) -> f32| f(0) * share[0] + f(1) * share[1] + f(2) * share[2];
                let uv = [mix(&|i| corners[i].uv.x), mix(&|i| corners[i].uv.y)];
                shaded(texture, uv, std::array::from_fn(|c| mix(&|i| color[i][c])))
            });
            if mixed[3] > 0.0 || mixed[0] > 0.0 {
                canvas.blend(pixel, mixed);
            }
        }
    }
}

/// Colour of a vertex times the texture there, bilinear.
fn shaded(texture: &egui::ColorImage, uv: [f32; 2], color: [f32; 4]) -> [f32; 4] {
    let [w, h] = texture.size;
    let (x, y) = ((uv[0] * w as f32 - 0.5).max(0.0), (uv[1] * h as f32 - 0.5).max(0.0));
    let (x0, y0) = ((x as usize).min(w - 1), (y as usize).min(h - 1));
    let (x1, y1) = ((x0 + 1).min(w - 1), (y0 + 1).min(h - 1));
    let (fx, fy) = ((x - x0 as f32).min(1.0), (y - y0 as f32).min(1.0));
    let texel = |x: usize, y: usize| -> [f32; 4] {
        let c: Color32 = texture.pixels[y * w + x];
        c.to_array().map(f32::from)
    };
    let (a, b, c, d) = (texel(x0, y0), texel(x1, y0), texel(x0, y1), texel(x1, y1));
    std::array::from_fn(|i| {
        let top = a[i] * (1.0 - fx) + b[i] * fx;
        let bottom = c[i] * (1.0 - fx) + d[i] * fx;
        color[i] * (top * (1.0 - fy) + bottom * fy) / 255.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Paints what a function draws, on black.
    fn painted(width: u32, height: u32, content: impl FnMut(&mut egui::Ui)) -> Canvas {
        let context = egui::Context::default();
        let screen = egui::Rect::from_min_size(egui::Pos2::ZERO, egui::Vec2::new(width as f32, height as f32));
        let input = egui::RawInput { screen_rect: Some(screen), ..Default::default() };
        let mut output = context.run_ui(input, content);
        let primitives = context.tessellate(std::mem::take(&mut output.shapes), 1.0);
        let (mut painter, mut canvas) = (Painter::default(), Canvas::default());
        painter.learn(&output.textures_delta);
        canvas.clear(width, height);
        painter.paint(&mut canvas, &primitives, 1.0);
        canvas
    }

    #[test]
    fn rectangles_cover_their_pixels_once() {
        let canvas = painted(40, 30, |ui| {
            let rect = egui::Rect::from_min_max(egui::Pos2::new(10.0, 5.0), egui::Pos2::new(30.0, 25.0));
            let mut mesh = egui::Mesh::default();
            mesh.add_colored_rect(rect, Color32::from_rgba_unmultiplied(255, 255, 255, 128));
            ui.painter().add(mesh);
        });
        for (i, p) in canvas.pixels.iter().enumerate() {
            let (x, y) = (i % 40, i / 40);
            let inside = (10..30).contains(&x) && (5..25).contains(&y);
            // Half transparent: a pixel painted twice along the diagonal would be lighter.
            assert_eq!(*p, if inside { [128; 3] } else { [0; 3] }, "({x}, {y})");
        }
    }

    #[test]
    fn text_is_drawn() {
        let canvas = painted(200, 60, |ui| {
            ui.label(egui::RichText::new("Catoptra").color(Color32::WHITE).size(30.0));
        });
        let lit = canvas.pixels.iter().filter(|p| p[0] > 128).count();
        assert!((300..4000).contains(&lit), "{lit} pixels");
    }

    #[test]
    fn pictures_fill_the_stage_and_nothing_else() {
        let mut canvas = Canvas::default();
        canvas.clear(8, 6);
        canvas.picture(Stage { x: 2, y: 1, width: 4, height: 4 }, 1, 1, &[9, 8, 7, 255]);
        assert_eq!(canvas.pixels.iter().filter(|p| **p == [9, 8, 7]).count(), 16);
        // A stage that is a step behind the window is cut.
        canvas.picture(Stage { x: 6, y: 5, width: 9, height: 9 }, 2, 2, &[5; 16]);
        assert_eq!(canvas.pixels[47], [5; 3]);
        canvas.clear(2, 1);
        let two = [0, 0, 0, 255, 200, 100, 50, 255];
        canvas.picture(Stage { x: 0, y: 0, width: 2, height: 1 }, 2, 1, &two);
        assert_eq!(canvas.pixels, [[0; 3], [200, 100, 50]]);
    }
}
