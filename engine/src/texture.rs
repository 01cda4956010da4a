//! Images that materials sample.

use crate::math;
use glam::{Vec2, Vec4};
use std::sync::OnceLock;

use crate::material::{TextureRef, Wrap};

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

/// RGBA8 image, `[height][width][4]`, row 0 on top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Texture {
    width: u32,
    height: u32,
    texels: Vec<[u8; 4]>,
    srgb: bool,
}

impl Texture {
    /// * `srgb`: RGB holds sRGB-coded colour (base color, emissive); false: linear data (normals, factors).
    ///
    /// # Errors
    /// [`TextureError::Size`] where the size is zero or does not match the texels.
    pub fn new(width: u32, height: u32, texels: Vec<[u8; 4]>, srgb: bool) -> Result<Self, TextureError> {
        if width == 0 || height == 0 || texels.len() as u64 != width as u64 * height as u64 {
            return Err(TextureError::Size { width, height, len: texels.len() });
        }
        Ok(Self { width, height, texels, srgb })
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

    /// One texel as linear RGBA.
    pub fn texel_linear(&self, x: u32, y: u32) -> Vec4 {
        let t = self.texels[(y * self.width + x) as usize];
        let a = f32::from(t[3]) / 255.0;
        if self.srgb {
            let table = srgb_table();
            Vec4::new(table[t[0] as usize], table[t[1] as usize], table[t[2] as usize], a)
        } else {
            Vec4::new(f32::from(t[0]) / 255.0, f32::from(t[1]) / 255.0, f32::from(t[2]) / 255.0, a)
        }
    }

    /// Filtered linear RGBA at `uv` (first level, bilinear or nearest as the reference asks; filtering in linear light).
    ///
    /// Non-finite `uv` reads as (0, 0). Twin: `shaders/shared/texture.wgsl`.
    pub fn sample(&self, r: &TextureRef, uv: Vec2) -> Vec4 {
        let uv = r.transform_uv(uv);
        let uv = if uv.is_finite() { uv } else { Vec2::ZERO };
        // Far-away coordinates would lose the fraction's bits in an i32: keep the repeat count small first.
        let fold = |v: f32, wrap: Wrap| match wrap {
            Wrap::Clamp => v.clamp(-1.0, 2.0),
            Wrap::Repeat | Wrap::Mirror => v - 2.0 * (v * 0.5).floor(),
        };
        let x = fold(uv.x, r.wrap[0]) * self.width as f32;
        let y = fold(uv.y, r.wrap[1]) * self.height as f32;
        let at = |ix: i32, iy: i32| {
            self.texel_linear(wrap_texel(ix, self.width, r.wrap[0]), wrap_texel(iy, self.height, r.wrap[1]))
        };
        if r.nearest {
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
