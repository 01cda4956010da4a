//! Images that materials sample.

use crate::math;
use glam::{Vec2, Vec4};
use std::sync::OnceLock;

use crate::material::{Mip, TextureRef, Wrap};

/// Why a texture was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TextureError {
    /// Width x height does not match the number of texels, or is zero.
    #[error("a {width}x{height} texture needs {} texels, got {len}", *width as u64 * *height as u64)]
    Size {
        /// Texels a row.
        width: u32,
        /// Rows.
        height: u32,
        /// Texels given.
        len: usize,
    },
}

/// RGBA8 image, `[height][width][4]`, row 0 on top, and its smaller copies.
#[derive(Clone, Debug)]
pub struct Texture {
    width: u32,
    height: u32,
    texels: Vec<[u8; 4]>,
    srgb: bool,
    /// Levels 1 and up, one after the other; made when first asked for.
    mips: OnceLock<Vec<[u8; 4]>>,
}

impl PartialEq for Texture {
    fn eq(&self, o: &Self) -> bool {
        (self.width, self.height, self.srgb) == (o.width, o.height, o.srgb) && self.texels == o.texels
    }
}

impl Eq for Texture {}

impl Texture {
    /// * `srgb`: RGB holds sRGB-coded colour (base color, emissive); false: linear data (normals, factors).
    ///
    /// # Errors
    /// [`TextureError::Size`] where the size is zero or does not match the texels.
    pub fn new(width: u32, height: u32, texels: Vec<[u8; 4]>, srgb: bool) -> Result<Self, TextureError> {
        if width == 0 || height == 0 || texels.len() as u64 != width as u64 * height as u64 {
            return Err(TextureError::Size { width, height, len: texels.len() });
        }
        Ok(Self { width, height, texels, srgb, mips: OnceLock::new() })
    }
    /// Texels a row.
    pub fn width(&self) -> u32 {
        self.width
    }
    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }
    /// All texels, row by row from the top.
    pub fn texels(&self) -> &[[u8; 4]] {
        &self.texels
    }
    /// True where RGB is sRGB-coded.
    pub fn srgb(&self) -> bool {
        self.srgb
    }

    /// Number of levels: the image and its copies, each half as wide and high as the one before (rounded down), to 1 x 1.
    pub fn level_count(&self) -> u32 {
        self.width.max(self.height).ilog2() + 1
    }
    /// Width and height of a level.
    pub fn level_size(&self, level: u32) -> (u32, u32) {
        ((self.width >> level).max(1), (self.height >> level).max(1))
    }
    /// Levels 1 and up one after the other, each `[height][width][4]`: the mean of the texels that each covers, in linear
    /// light. Made when first asked for and kept.
    ///
    /// Source: Williams, "Pyramidal Parametrics", SIGGRAPH 1983; odd sizes by exact areas.
    pub fn mips(&self) -> &[[u8; 4]] {
        self.mips.get_or_init(|| mips::build(self.width, self.height, &self.texels, self.srgb))
    }
    /// Place of a level's first texel in the image followed by [`Self::mips`].
    pub fn level_start(&self, level: u32) -> usize {
        (0..level).map(|l| self.level_size(l)).map(|(w, h)| w as usize * h as usize).sum()
    }

    /// One texel as linear RGBA.
    pub fn texel_linear(&self, x: u32, y: u32) -> Vec4 {
        decode(self.texels[(y * self.width + x) as usize], self.srgb)
    }

    /// Filtered linear RGBA of the image itself at `uv` (bilinear or nearest as the reference asks; in linear light).
    ///
    /// Non-finite `uv` reads as (0, 0). Twin: `shaders/shared/texture.wgsl`.
    pub fn sample(&self, r: &TextureRef, uv: Vec2) -> Vec4 {
        self.sample_level(r, uv, 0, r.nearest)
    }

    /// [`Self::sample`] for a pixel that covers 4^`lod` texels: over 0 the smaller copies are read, as the reference asks.
    /// * `lod`: at most 0, and NaN: the image itself
    pub fn sample_lod(&self, r: &TextureRef, uv: Vec2, lod: f32) -> Vec4 {
        if !(lod > 0.0) {
            return self.sample_level(r, uv, 0, r.nearest);
        }
        let lod = lod.min((self.level_count() - 1) as f32);
        match r.mip {
            Mip::None => self.sample_level(r, uv, 0, r.nearest_min),
            Mip::Nearest => self.sample_level(r, uv, (lod + 0.5).floor() as u32, r.nearest_min),
            Mip::Linear => {
                let low = lod.floor();
                let f = lod - low;
                let fine = self.sample_level(r, uv, low as u32, r.nearest_min);
                if f == 0.0 {
                    return fine;
                }
                fine * (1.0 - f) + self.sample_level(r, uv, low as u32 + 1, r.nearest_min) * f
            }
        }
    }

    fn sample_level(&self, r: &TextureRef, uv: Vec2, level: u32, nearest: bool) -> Vec4 {
        let (width, height) = self.level_size(level);
        let texels =
            if level == 0 { &self.texels[..] } else { &self.mips()[self.level_start(level) - self.texels.len()..] };
        let uv = r.transform_uv(uv);
        let uv = if uv.is_finite() { uv } else { Vec2::ZERO };
        // Far-away coordinates would lose the fraction's bits in an i32: keep the repeat count small first.
        let fold = |v: f32, wrap: Wrap| match wrap {
            Wrap::Clamp => v.clamp(-1.0, 2.0),
            Wrap::Repeat | Wrap::Mirror => v - 2.0 * (v * 0.5).floor(),
        };
        let x = fold(uv.x, r.wrap[0]) * width as f32;
        let y = fold(uv.y, r.wrap[1]) * height as f32;
        let at = |ix: i32, iy: i32| {
            let (x, y) = (wrap_texel(ix, width, r.wrap[0]), wrap_texel(iy, height, r.wrap[1]));
            decode(texels[(y * width + x) as usize], self.srgb)
        };
        if nearest {
            return at(x.floor() as i32, y.floor() as i32);
        }
        let (x, y) = (x - 0.5, y - 0.5);
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let (ix, iy) = (x0 as i32, y0 as i32);
        let top = at(ix, iy) * (1.0 - fx) + at(ix + 1, iy) * fx;
        let bottom = at(ix, iy + 1) * (1.0 - fx) + at(ix + 1, iy + 1) * fx;
        top * (1.0 - fy) + bottom * fy
    }
}

#[inline]
fn decode(t: [u8; 4], srgb: bool) -> Vec4 {
    let a = f32::from(t[3]) / 255.0;
    if srgb {
        let table = srgb_table();
        Vec4::new(table[t[0] as usize], table[t[1] as usize], table[t[2] as usize], a)
    } else {
        Vec4::new(f32::from(t[0]) / 255.0, f32::from(t[1]) / 255.0, f32::from(t[2]) / 255.0, a)
    }
}

mod mips {
    //! The smaller copies of an image.

    use super::decode;
    use crate::math;
    use glam::Vec4;
    use std::sync::OnceLock;

    pub fn build(width: u32, height: u32, texels: &[[u8; 4]], srgb: bool) -> Vec<[u8; 4]> {
        let mut out: Vec<[u8; 4]> = Vec::with_capacity(texels.len() / 3 + 16);
        let (mut w, mut h) = (width, height);
        // The level above, as it stands: the image, then a stretch of `out`.
        let mut above = None;
        while w > 1 || h > 1 {
            let (half_w, half_h) = ((w / 2).max(1), (h / 2).max(1));
            let start = out.len();
            for y in 0..half_h {
                let rows = taps(y, h, half_h);
                for x in 0..half_w {
                    let columns = taps(x, w, half_w);
                    let source = above.map_or(texels, |from: usize| &out[from..start]);
                    let mut sum = Vec4::ZERO;
                    for (row, share_y) in rows {
                        for (column, share_x) in columns.into_iter().filter(|c| c.1 > 0.0) {
                            if share_y > 0.0 {
                                let t = source[(row * w + column) as usize];
                                sum += decode(t, srgb) * (share_x * share_y);
                            }
                        }
                    }
                    out.push(encode(sum, srgb));
                }
            }
            above = Some(start);
            (w, h) = (half_w, half_h);
        }
        out
    }

    /// Up to three texels that texel `i` of a line of `half` covers in the line of `size`, with their shares of it.
    fn taps(i: u32, size: u32, half: u32) -> [(u32, f32); 3] {
        match (size, size % 2) {
            (1, _) => [(0, 1.0), (0, 0.0), (0, 0.0)],
            (_, 0) => [(2 * i, 0.5), (2 * i + 1, 0.5), (0, 0.0)],
            _ => {
                let n = size as f32;
                [(2 * i, (half - i) as f32 / n), (2 * i + 1, half as f32 / n), (2 * i + 2, (i + 1) as f32 / n)]
            }
        }
    }

    fn encode(v: Vec4, srgb: bool) -> [u8; 4] {
        let plain = |v: f32| (v * 255.0 + 0.5).clamp(0.0, 255.0) as u8;
        if !srgb {
            return v.to_array().map(plain);
        }
        // The least linear value that rounds to each code: half-way between two codes.
        static BOUNDS: OnceLock<[f32; 255]> = OnceLock::new();
        let bounds = BOUNDS.get_or_init(|| std::array::from_fn(|i| math::linear_from_srgb((i as f32 + 0.5) / 255.0)));
        let code = |v: f32| bounds.partition_point(|b| *b <= v) as u8;
        [code(v.x), code(v.y), code(v.z), plain(v.w)]
    }
}

/// Texel number after the wrap rule, always in 0..size.
pub fn wrap_texel(i: i32, size: u32, wrap: Wrap) -> u32 {
    let n = size as i32;
    (match wrap {
        Wrap::Clamp => i.clamp(0, n - 1),
        Wrap::Repeat => i.rem_euclid(n),
        Wrap::Mirror => {
            let m = i.rem_euclid(2 * n);
            if m < n { m } else { 2 * n - 1 - m }
        }
    }) as u32
}

fn srgb_table() -> &'static [f32; 256] {
    static TABLE: OnceLock<[f32; 256]> = OnceLock::new();
    TABLE.get_or_init(|| std::array::from_fn(|i| math::linear_from_srgb(i as f32 / 255.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two() -> Texture {
        Texture::new(2, 1, vec![[0, 0, 0, 255], [255, 255, 255, 255]], false).unwrap()
    }

    #[test]
    fn bilinear_between_texel_centres() {
        let r = TextureRef::default();
        assert_eq!(two().sample(&r, Vec2::new(0.25, 0.5)).x, 0.0);
        assert_eq!(two().sample(&r, Vec2::new(0.75, 0.5)).x, 1.0);
        assert!((two().sample(&r, Vec2::new(0.5, 0.5)).x - 0.5).abs() < 1e-6);
        // Repeat: half-way over the seam.
        assert!((two().sample(&r, Vec2::new(1.0, 0.5)).x - 0.5).abs() < 1e-6);
        let clamp = TextureRef { wrap: [Wrap::Clamp; 2], ..r };
        assert_eq!(two().sample(&clamp, Vec2::new(5.0, 0.5)).x, 1.0);
    }

    #[test]
    fn copies_are_means_in_linear_light() {
        // Black and white in sRGB average to half the light, code 188, not to half the code.
        let t = Texture::new(2, 2, vec![[0; 4], [255; 4], [255; 4], [0; 4]], true).unwrap();
        assert_eq!((t.level_count(), t.mips()), (2, &[[188, 188, 188, 128]][..]));
        // An odd width: each texel of the copy covers one and a half.
        let t = Texture::new(3, 1, vec![[90, 0, 0, 255], [150, 0, 0, 255], [30, 0, 0, 255]], false).unwrap();
        assert_eq!(t.mips(), &[[90, 0, 0, 255]]);
        let t = Texture::new(5, 1, (0..5).map(|i| [i * 50, 0, 0, 255]).collect(), false).unwrap();
        assert_eq!((t.level_count(), t.level_start(2)), (3, 7));
        assert_eq!(t.mips(), &[[40, 0, 0, 255], [160, 0, 0, 255], [100, 0, 0, 255]]);
    }

    #[test]
    fn far_away_the_reference_says_what_is_read() {
        let t = Texture::new(4, 4, (0..16).map(|i| [if (i + i / 4) % 2 == 0 { 200 } else { 0 }; 4]).collect(), false)
            .unwrap();
        let at = |r: TextureRef, lod| (t.sample_lod(&r, Vec2::new(0.126, 0.126), lod).x * 255.0).round();
        let r = TextureRef { nearest: true, nearest_min: true, ..TextureRef::default() };
        assert_eq!([-1.0, 0.0, f32::NAN].map(|lod| at(r, lod)), [200.0; 3]);
        assert_eq!([0.5, 1.0, 1.7, 9.0].map(|lod| at(r, lod)), [150.0, 100.0, 100.0, 100.0]);
        let near = TextureRef { mip: Mip::Nearest, ..r };
        assert_eq!([0.4, 0.6, 9.0].map(|lod| at(near, lod)), [200.0, 100.0, 100.0]);
        assert_eq!(at(TextureRef { mip: Mip::None, ..r }, 9.0), 200.0);
    }

    #[test]
    fn wraps_stay_in_range() {
        for wrap in [Wrap::Clamp, Wrap::Repeat, Wrap::Mirror] {
            for i in -9..9 {
                assert!(wrap_texel(i, 3, wrap) < 3);
            }
        }
        assert_eq!(wrap_texel(-1, 3, Wrap::Mirror), 0);
        assert_eq!(wrap_texel(3, 3, Wrap::Mirror), 2);
        assert!(two().sample(&TextureRef::default(), Vec2::new(f32::NAN, 1e30)).is_finite());
    }
}
