//! Images and samplers. Only images that a used material needs are decoded.

use super::{
    buffers::{Buffers, Source},
    document::{Document, TextureInfo, extension, item},
    error::{GltfError, within},
    limits::ImportLimits,
    report::Ignored,
};
use crate::{
    material::{Mip, TextureRef, Wrap},
    math,
    texture::Texture,
};
use glam::{DVec4, Vec4};
use image::{ImageFormat, ImageReader, RgbaImage};
use serde::Deserialize;
use std::{collections::BTreeMap, io::Cursor, sync::Arc};

/// Decodes images on demand and keeps the textures made of them.
pub(super) struct Textures<'a> {
    document: &'a Document,
    buffers: &'a Buffers<'a>,
    limits: &'a ImportLimits,
    source: &'a mut Source,
    pixels: u64,
    /// By image and whether it is read as sRGB.
    known: BTreeMap<(u32, bool), u32>,
    means: BTreeMap<u32, [f32; 3]>,
    pub textures: Vec<Arc<Texture>>,
    /// Numbers of the texture coordinate sets that a mesh of the material at hand keeps.
    pub uv_sets: [u32; 2],
}

/// Set that a texture uses.
pub(super) fn uv_set(info: &TextureInfo) -> u32 {
    let transform = info.extensions.as_ref().and_then(|e| e.get("KHR_texture_transform"));
    let over = transform.and_then(|t| t.get("texCoord")).and_then(serde_json::Value::as_u64);
    over.and_then(|n| u32::try_from(n).ok()).unwrap_or(info.tex_coord)
}

#[derive(Deserialize)]
#[serde(default)]
struct Transform {
    offset: [f32; 2],
    rotation: f32,
    scale: [f32; 2],
}

impl Default for Transform {
    fn default() -> Self {
        Self { offset: [0.0; 2], rotation: 0.0, scale: [1.0; 2] }
    }
}

#[derive(Deserialize)]
struct Webp {
    source: Option<u32>,
}

impl<'a> Textures<'a> {
    pub fn new(
        document: &'a Document,
        buffers: &'a Buffers<'a>,
        limits: &'a ImportLimits,
        source: &'a mut Source,
    ) -> Self {
        let (known, means) = Default::default();
        Self { document, buffers, limits, source, pixels: 0, known, means, textures: Vec::new(), uv_sets: [0, 1] }
    }

    /// A texture as a material uses it; `None` where it cannot be shown, which is noted.
    /// * `srgb`: true for colours, false for data such as normals
    pub fn reference(
        &mut self,
        info: &TextureInfo,
        srgb: bool,
        place: &str,
        ignored: &mut Ignored,
    ) -> Result<Option<TextureRef>, GltfError> {
        let transform: Transform = extension(&info.extensions, "KHR_texture_transform", place)?.unwrap_or_default();
        let set = uv_set(info);
        let Some(uv_set) = self.uv_sets.iter().position(|s| *s == set).map(|at| at as u32) else {
            ignored.note(format!("textures that use TEXCOORD_{set}, a third set of their material"));
            return Ok(None);
        };
        let Some(image) = self.image_of(info, place, ignored)? else {
            return Ok(None);
        };
        let texture = match self.known.get(&(image, srgb)) {
            Some(&texture) => texture,
            None => {
                let Some(pixels) = self.decode_or_note(image, ignored)? else {
                    return Ok(None);
                };
                let (width, height) = pixels.dimensions();
                let texels = pixels.into_raw().as_chunks::<4>().0.to_vec();
                let texture = Texture::new(width, height, texels, srgb)
                    .map_err(|e| GltfError::invalid(format!("image {image}"), e.to_string()))?;
                self.textures.push(Arc::new(texture));
                let number = self.textures.len() as u32 - 1;
                self.known.insert((image, srgb), number);
                number
            }
        };
        let def = item(&self.document.textures, info.index, "texture", place)?;
        let mut out = TextureRef { texture, uv_set, ..TextureRef::default() };
        if let Some(sampler) = def.sampler {
            let s = item(&self.document.samplers, sampler, "sampler", &format!("texture {}", info.index))?;
            out.wrap = [wrap(s.wrap_s, sampler)?, wrap(s.wrap_t, sampler)?];
            let bad = |what: &str, code: u32| {
                Err(GltfError::invalid(format!("sampler {sampler}"), format!("{what} {code} does not exist")))
            };
            out.nearest = match s.mag_filter {
                Some(9728) => true,
                None | Some(9729) => false,
                Some(other) => return bad("magFilter", other),
            };
            (out.nearest_min, out.mip) = match s.min_filter {
                Some(9728) => (true, Mip::None),
                Some(9729) => (false, Mip::None),
                Some(9984) => (true, Mip::Nearest),
                Some(9985) => (false, Mip::Nearest),
                Some(9986) => (true, Mip::Linear),
                None | Some(9987) => (false, Mip::Linear),
                Some(other) => return bad("minFilter", other),
            };
        }
        let (sin, cos) = math::sin_cos(transform.rotation);
        let ([sx, sy], [ox, oy]) = (transform.scale, transform.offset);
        // Counter-clockwise as seen in the image, whose v points down.
        out.uv_transform = [[cos * sx, sin * sy, ox], [-sin * sx, cos * sy, oy]];
        if out.uv_transform.iter().flatten().any(|v| !v.is_finite()) {
            return Err(GltfError::invalid(place, "KHR_texture_transform holds a value that is not finite"));
        }
        Ok(Some(out))
    }

    /// [`Self::reference`] of a colour.
    pub fn color(
        &mut self,
        info: &TextureInfo,
        place: &str,
        ignored: &mut Ignored,
    ) -> Result<Option<TextureRef>, GltfError> {
        self.reference(info, true, place, ignored)
    }

    /// Mean alpha of a texture in [0, 1], and the share of its texels whose alpha lies between a twentieth and nineteen
    /// twentieths.
    pub fn mean_alpha(&self, texture: u32) -> (f32, f32) {
        let texels = self.textures[texture as usize].texels();
        let sum: u64 = texels.iter().map(|t| u64::from(t[3])).sum();
        let between = texels.iter().filter(|t| (13..=242).contains(&t[3])).count();
        ((sum as f64 / (255.0 * texels.len() as f64)) as f32, between as f32 / texels.len() as f32)
    }

    /// Mean of (R, G, B), each in [0, 1], over the codes of a texture.
    pub fn mean(&mut self, texture: u32) -> [f32; 3] {
        if let Some(&mean) = self.means.get(&texture) {
            return mean;
        }
        let texels = self.textures[texture as usize].texels();
        let mut sum = [0_u64; 3];
        for t in texels {
            (0..3).for_each(|c| sum[c] += u64::from(t[c]));
        }
        let count = 255.0 * texels.len() as f64;
        let mean = sum.map(|s| (s as f64 / count) as f32);
        self.means.insert(texture, mean);
        mean
    }

    /// Mean of a texture's values, colour in linear light.
    pub fn mean_linear(&self, texture: u32) -> Vec4 {
        let t = &self.textures[texture as usize];
        let mut sum = DVec4::ZERO;
        for y in 0..t.height() {
            for x in 0..t.width() {
                sum += t.texel_linear(x, y).as_dvec4();
            }
        }
        (sum / t.texels().len() as f64).as_vec4()
    }

    fn image_of(&self, info: &TextureInfo, place: &str, ignored: &mut Ignored) -> Result<Option<u32>, GltfError> {
        let def = item(&self.document.textures, info.index, "texture", place)?;
        let webp: Option<Webp> = extension(&def.extensions, "EXT_texture_webp", place)?;
        if let Some(source) = webp.and_then(|w| w.source) {
            return Ok(Some(source));
        }
        if def.source.is_none() {
            let names: Vec<&str> = def.extensions.iter().flatten().map(|(k, _)| k.as_str()).collect();
            ignored.note(match names.as_slice() {
                [] => "textures without an image".to_string(),
                names => format!("textures whose image only {} can read", names.join(", ")),
            });
        }
        Ok(def.source)
    }

    /// An image that is missing or broken costs the look of a surface, not the scene: noted, with its reason. What passes
    /// a limit or reaches for a forbidden place stays an error.
    fn decode_or_note(&mut self, index: u32, ignored: &mut Ignored) -> Result<Option<RgbaImage>, GltfError> {
        match self.decode(index) {
            Ok(image) => Ok(Some(image)),
            Err(error @ (GltfError::Limit { .. } | GltfError::Uri { .. })) => Err(error),
            Err(GltfError::Io { path, source }) => {
                let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                ignored.note(format!("image {index} ({name}: {source})"));
                Ok(None)
            }
            Err(error) => {
                ignored.note(error.to_string());
                Ok(None)
            }
        }
    }

    fn decode(&mut self, index: u32) -> Result<RgbaImage, GltfError> {
        let place = &format!("image {index}");
        let def = item(&self.document.images, index, "image", "texture")?;
        let owned;
        let bytes = match (&def.uri, def.buffer_view) {
            (_, Some(view)) => self.buffers.view(view, place)?.0,
            (Some(uri), None) => {
                owned = self.source.fetch(uri)?;
                &owned
            }
            (None, None) => return Err(GltfError::invalid(place, "it has neither a uri nor a buffer view")),
        };
        let format = match image::guess_format(bytes) {
            Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::WebP)) => format,
            _ => return Err(GltfError::invalid(place, "its bytes are neither PNG, JPEG nor WebP")),
        };
        let bad = |e: image::ImageError| GltfError::invalid(place, e.to_string());
        let (width, height) = ImageReader::with_format(Cursor::new(bytes), format).into_dimensions().map_err(bad)?;
        let pixels = u64::from(width) * u64::from(height);
        within("pixels of an image", pixels, self.limits.image_pixels)?;
        self.pixels += pixels;
        within("pixels of all textures", self.pixels, self.limits.texture_pixels)?;
        let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
        let mut limits = image::Limits::default();
        // Sixteen bits a channel, the decoder's own buffers beside.
        limits.max_alloc = Some(pixels.saturating_mul(16).saturating_add(16 << 20));
        reader.limits(limits);
        Ok(reader.decode().map_err(bad)?.into_rgba8())
    }
}

fn wrap(code: Option<u32>, sampler: u32) -> Result<Wrap, GltfError> {
    Ok(match code {
        None | Some(10497) => Wrap::Repeat,
        Some(33071) => Wrap::Clamp,
        Some(33648) => Wrap::Mirror,
        Some(other) => {
            return Err(GltfError::invalid(format!("sampler {sampler}"), format!("wrap mode {other} does not exist")));
        }
    })
}
