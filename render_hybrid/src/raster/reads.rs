//! What comes back from the GPU: the mask's list, moments, the picture and its layers.

use super::{
    GpuRaster,
    compact::ListOrder,
    layouts::PackedLayer,
    moment_maps,
    readback::{Mailbox, rows},
};
use crate::{
    error::RenderError,
    output::{Image, Layer},
};

/// Surfaces of all pixels, row by row from the top. Where nothing was met everything is 0 and `material` `u32::MAX`.
#[derive(Clone, Debug, Default)]
pub struct GBufferReadback {
    /// World space, metres.
    pub positions_world: Vec<[f32; 3]>,
    /// Unit normal of the triangle, on the viewer's side, world space.
    pub n_geometric: Vec<[f32; 3]>,
    /// Unit interpolated normal, on the viewer's side, world space.
    pub n_shading: Vec<[f32; 3]>,
    /// factor x texture x vertex colour, linear.
    pub base_color: Vec<[f32; 3]>,
    /// Index into the scene's materials.
    pub material: Vec<u32>,
}

impl GpuRaster {
    /// Numbers y · width + x of the pixels that show mirror or glass, ascending. Waits for the G-buffer.
    ///
    /// # Errors
    /// [`RenderError::Gpu`]
    pub fn read_masked_pixels(&mut self) -> Result<Vec<u32>, RenderError> {
        self.begun()?;
        let rows = self.list_order() == ListOrder::Rows;
        let mut list = self.read_list()?;
        if !rows {
            list.sort_unstable();
        }
        Ok(list)
    }

    /// The same, in the order of the list.
    fn read_list(&mut self) -> Result<Vec<u32>, RenderError> {
        self.step(|s| {
            if !s.mail.masked.is_full() {
                return s.compact.read(&s.gpu, &mut s.readback, &s.picture);
            }
            let likely = s.mail.likely as usize;
            let (count, mut list) = s.mail.masked.read(&s.gpu, |data| {
                let words: Vec<u32> = bytemuck::pod_collect_to_vec(data);
                let count = words[0] as usize;
                (count, words[1..1 + count.min(likely)].to_vec())
            })?;
            if count > likely {
                // More than was likely: the rest, once.
                let (from, bytes) = (4 * likely as u64, 4 * (count - likely) as u64);
                list.extend(s.readback.buffer::<u32>(&s.gpu, &s.picture.pixels, from, bytes)?);
            }
            s.mail.likely = count as u64;
            Ok(list)
        })
    }

    /// Blurred moments of every view of the plan, row 0 on top; empty where [`Shadows::Moments`](crate::Shadows::Moments) is not chosen.
    ///
    /// # Errors
    /// [`RenderError::Gpu`]
    pub fn read_moments(&mut self) -> Result<Vec<Vec<[f32; 4]>>, RenderError> {
        let mut out = Vec::new();
        self.read_moments_into(&mut out)?;
        Ok(out)
    }

    /// [`Self::read_moments`] into memory that is used again.
    pub(crate) fn read_moments_into(&mut self, out: &mut Vec<Vec<[f32; 4]>>) -> Result<(), RenderError> {
        if !self.begun()?.moments {
            out.clear();
            return Ok(());
        }
        self.step(|s| {
            let maps = moment_maps(&s.plan, &s.shadows);
            out.resize_with(maps.len(), Vec::new);
            if !s.mail.moments.is_full() {
                for (map, (texture, layer)) in out.iter_mut().zip(maps) {
                    *map = s.readback.texture(&s.gpu, texture, layer)?;
                }
                return Ok(());
            }
            s.mail.moments.read(&s.gpu, |data| {
                let mut at = 0;
                for (map, (texture, _)) in out.iter_mut().zip(maps) {
                    let end = at + Mailbox::texture_bytes(texture) as usize;
                    let width = texture.width() as usize;
                    map.resize(width * texture.height() as usize, [0.0; 4]);
                    for (to, from) in map.chunks_exact_mut(width).zip(rows(&data[at..end], texture)) {
                        bytemuck::cast_slice_mut::<_, u8>(to).copy_from_slice(from);
                    }
                    at = end;
                }
            })
        })
    }

    /// Waits until [`Self::read_picture`] has nothing to wait for.
    pub(crate) fn wait_for_picture(&mut self) -> Result<(), RenderError> {
        self.step(|s| s.mail.picture.wait(&s.gpu))
    }

    /// The picture that [`Self::finish`] sent. Waits for it and for nothing behind it.
    pub(crate) fn read_picture(&mut self, image: &mut Image) -> Result<(), RenderError> {
        self.step(|s| {
            let texture = &s.picture.last.texture;
            image.resize(texture.width(), texture.height());
            s.mail.picture.read(&s.gpu, |data| {
                let width = texture.width() as usize;
                for (to, from) in image.pixels.chunks_exact_mut(width).zip(rows(data, texture)) {
                    for (to, from) in to.iter_mut().zip(bytemuck::cast_slice::<u8, f32>(from).chunks_exact(4)) {
                        to.copy_from_slice(&from[..3]);
                    }
                }
            })
        })
    }

    fn packed(&mut self, layer: PackedLayer) -> Result<Vec<[f32; 4]>, RenderError> {
        self.layers.read(&self.gpu, &mut self.readback, &self.scene, &self.picture, layer)
    }

    /// The surfaces of all pixels, for work that the CPU does on them (traced shadows, traced VPL visibility).
    ///
    /// # Errors
    /// [`RenderError::Gpu`]
    pub fn read_gbuffer(&mut self) -> Result<GBufferReadback, RenderError> {
        self.begun()?;
        let rgb = |pixels: Vec<[f32; 4]>| pixels.into_iter().map(|[r, g, b, _]| [r, g, b]).collect::<Vec<_>>();
        self.step(|s| {
            let places: Vec<[f32; 4]> = s.readback.texture(&s.gpu, &s.picture.position.texture, 0)?;
            let material = places.iter().map(|p| (p[3] as u32).wrapping_sub(1)).collect();
            Ok(GBufferReadback {
                positions_world: rgb(places),
                n_geometric: rgb(s.packed(PackedLayer::NormalGeometric)?),
                n_shading: rgb(s.packed(PackedLayer::NormalShading)?),
                base_color: rgb(s.packed(PackedLayer::Albedo)?),
                material,
            })
        })
    }

    /// One layer of the frame, as [`Layer`] says. Waits for it.
    ///
    /// # Errors
    /// [`RenderError::Gpu`]
    pub fn read_layer(&mut self, layer: Layer) -> Result<Image, RenderError> {
        let frame = self.begun()?;
        self.step(|s| {
            let (width, height) = (s.picture.width, s.picture.height);
            let image = |pixels: Vec<[f32; 4]>| Image {
                width,
                height,
                pixels: pixels.into_iter().map(|[r, g, b, _]| [r, g, b]).collect(),
            };
            let texture = match layer {
                Layer::Final => &s.picture.last,
                Layer::Direct => &s.picture.direct,
                Layer::Indirect => &s.picture.indirect[0],
                Layer::Traced => &s.picture.traced,
                Layer::Mask => return Ok(image(s.packed(PackedLayer::Mask)?)),
                Layer::Depth => return Ok(image(s.packed(PackedLayer::Depth)?)),
                Layer::Normal => return Ok(image(s.packed(PackedLayer::Normal)?)),
                Layer::Albedo => return Ok(image(s.packed(PackedLayer::Albedo)?)),
                Layer::Moments => {
                    let Some(view) = s.plan.views.first().filter(|_| frame.moments) else {
                        return Ok(Image::new(1, 1));
                    };
                    let array = if s.plan.lights.first().is_some_and(|l| l.count == 6) {
                        &s.shadows.faces
                    } else {
                        &s.shadows.maps
                    };
                    let map: Vec<[f32; 4]> = s.readback.texture(&s.gpu, &array.moments.texture, 0)?;
                    let pixels = map.into_iter().map(|[a, b, ..]| [a, b, 0.0]).collect();
                    return Ok(Image { width: view.size, height: view.size, pixels });
                }
            };
            Ok(image(s.readback.texture(&s.gpu, &texture.texture, 0)?))
        })
    }
}
