//! How far two pictures lie apart: LDR-FLIP as an eye sees it, relMSE on linear light, PSNR.
//!
//! Everywhere `a` is the picture under test and `b` the reference.

use crate::{image_io, output::Image};

/// Why two pictures cannot be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MetricsError {
    /// The sizes differ.
    #[error("the pictures differ in size: {a_width}x{a_height} and {b_width}x{b_height}")]
    Size {
        /// Width of `a`.
        a_width: u32,
        /// Height of `a`.
        a_height: u32,
        /// Width of `b`.
        b_width: u32,
        /// Height of `b`.
        b_height: u32,
    },
    /// There are no pixels.
    #[error("the pictures are empty")]
    Empty,
    /// A value is NaN or infinite.
    #[error("the {which} picture is not finite at pixel ({x}, {y})")]
    NotFinite {
        /// `first` or `second`.
        which: &'static str,
        /// Column.
        x: u32,
        /// Row.
        y: u32,
    },
}

/// FLIP per pixel, in [0, 1]: 0 where no difference is seen.
///
/// Source: Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", HPG 2020; evaluated by NVIDIA's code at
/// its default of 67 pixels per degree.
#[derive(Clone, Debug, PartialEq)]
pub struct FlipMap {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Error per pixel, `[height][width]`.
    pub errors: Vec<f32>,
    sorted: Vec<f32>,
}

impl FlipMap {
    /// FLIP between two pictures of sRGB bytes, `[height][width][3]`.
    ///
    /// # Panics
    /// If a picture is empty or not width × height × 3 bytes.
    pub fn between_srgb8(a: &[u8], b: &[u8], width: u32, height: u32) -> Self {
        let len = width as usize * height as usize * 3;
        assert!(len > 0 && a.len() == len && b.len() == len, "two pictures of {width}x{height}");
        let test = nv_flip::FlipImageRgb8::with_data(width, height, a);
        let reference = nv_flip::FlipImageRgb8::with_data(width, height, b);
        let errors = nv_flip::flip(reference, test, nv_flip::DEFAULT_PIXELS_PER_DEGREE).to_vec();
        let mut sorted = errors.clone();
        sorted.sort_unstable_by(f32::total_cmp);
        Self { width, height, errors, sorted }
    }

    /// Mean error, in [0, 1].
    pub fn mean(&self) -> f64 {
        self.errors.iter().map(|&e| e as f64).sum::<f64>() / self.errors.len() as f64
    }

    /// Least error that at least the share `q` of the pixels does not exceed, `q` in [0, 1] (nearest rank).
    pub fn percentile(&self, q: f64) -> f64 {
        let rank = (q * self.sorted.len() as f64).ceil() as usize;
        self.sorted[rank.clamp(1, self.sorted.len()) - 1] as f64
    }

    /// The error in the magma colours, black = none, as sRGB bytes, `[height][width][3]`.
    pub fn heat_map(&self) -> Vec<u8> {
        let lut = nv_flip::magma_lut().to_vec();
        self.errors
            .iter()
            .flat_map(|&e| {
                let i = 3 * (e.clamp(0.0, 1.0) * 255.0 + 0.5) as usize;
                [lut[i], lut[i + 1], lut[i + 2]]
            })
            .collect()
    }
}

/// All figures of one comparison.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// FLIP of the pictures' PNG rendering at EV 0.
    pub flip: FlipMap,
    /// See [`rel_mse`].
    pub rel_mse: f64,
    /// See [`psnr_db`].
    pub psnr_db: f64,
    /// See [`mean_ratio`].
    pub mean_ratio: [f64; 3],
}

/// Compares linear pictures; FLIP and PSNR look at their PNG rendering at EV 0.
///
/// # Errors
/// Different sizes, no pixels, or a value that is not finite.
pub fn compare(a: &Image, b: &Image) -> Result<Comparison, MetricsError> {
    compare_loaded(
        &image_io::LoadedImage { linear: a.clone(), srgb8: image_io::srgb8_from_image(a, 0.0) },
        &image_io::LoadedImage { linear: b.clone(), srgb8: image_io::srgb8_from_image(b, 0.0) },
    )
}

/// Compares pictures from files; FLIP and PSNR look at a PNG's very bytes.
///
/// # Errors
/// As [`compare`].
pub fn compare_loaded(a: &image_io::LoadedImage, b: &image_io::LoadedImage) -> Result<Comparison, MetricsError> {
    let (la, lb) = (&a.linear, &b.linear);
    if (la.width, la.height) != (lb.width, lb.height) {
        let (a_width, a_height, b_width, b_height) = (la.width, la.height, lb.width, lb.height);
        return Err(MetricsError::Size { a_width, a_height, b_width, b_height });
    }
    if la.pixels.is_empty() {
        return Err(MetricsError::Empty);
    }
    for (which, image) in [("first", la), ("second", lb)] {
        if let Some(i) = image.pixels.iter().position(|p| p.iter().any(|v| !v.is_finite())) {
            let (x, y) = (i as u32 % image.width, i as u32 / image.width);
            return Err(MetricsError::NotFinite { which, x, y });
        }
    }
    Ok(Comparison {
        flip: FlipMap::between_srgb8(&a.srgb8, &b.srgb8, la.width, la.height),
        rel_mse: rel_mse(la, lb),
        psnr_db: psnr_db(&a.srgb8, &b.srgb8),
        mean_ratio: mean_ratio(la, lb),
    })
}

/// Mean radiance of `a` over that of the reference `b`, per channel: 1 where no energy is lost; 1 where both are black.
pub fn mean_ratio(a: &Image, b: &Image) -> [f64; 3] {
    let sum = |image: &Image, c: usize| image.pixels.iter().map(|p| f64::from(p[c])).sum::<f64>();
    std::array::from_fn(|c| {
        let (a, b) = (sum(a, c), sum(b, c));
        if a == b { 1.0 } else { a / b }
    })
}

/// Relative mean squared error on linear light: mean over pixels and channels of (a − b)²/(b² + 0.01).
///
/// # Panics
/// If the pictures differ in size or are empty.
pub fn rel_mse(a: &Image, b: &Image) -> f64 {
    assert!(!a.pixels.is_empty() && a.pixels.len() == b.pixels.len(), "two pictures of one size");
    let sum: f64 = a
        .pixels
        .iter()
        .flatten()
        .zip(b.pixels.iter().flatten())
        .map(|(&a, &b)| {
            let (a, b) = (a as f64, b as f64);
            (a - b) * (a - b) / (b * b + 0.01)
        })
        .sum();
    sum / (3 * a.pixels.len()) as f64
}

/// Peak signal-to-noise ratio of sRGB bytes in decibels, 10 log10(255²/MSE); +infinity for equal pictures.
///
/// # Panics
/// If the pictures differ in size or are empty.
pub fn psnr_db(a_srgb8: &[u8], b_srgb8: &[u8]) -> f64 {
    assert!(!a_srgb8.is_empty() && a_srgb8.len() == b_srgb8.len(), "two pictures of one size");
    let sum: u64 = a_srgb8.iter().zip(b_srgb8).map(|(&a, &b)| u64::from(a.abs_diff(b)).pow(2)).sum();
    if sum == 0 {
        return f64::INFINITY;
    }
    10.0 * libm::log10(255.0 * 255.0 * a_srgb8.len() as f64 / sum as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(f: impl Fn(u32, u32) -> [f32; 3]) -> Image {
        let mut image = Image::new(48, 32);
        for y in 0..32 {
            for x in 0..48 {
                image.pixels[(y * 48 + x) as usize] = f(x, y);
            }
        }
        image
    }

    #[test]
    fn a_picture_equals_itself() {
        let a = picture(|x, y| [x as f32 / 48.0, y as f32 / 32.0, 0.3]);
        let c = compare(&a, &a).unwrap();
        assert_eq!((c.flip.mean(), c.flip.percentile(0.99), c.rel_mse), (0.0, 0.0, 0.0));
        assert_eq!(c.psnr_db, f64::INFINITY);
        assert!(c.flip.heat_map().chunks(3).all(|p| p == &c.flip.heat_map()[..3]));
    }

    #[test]
    fn figures_by_hand() {
        let a = picture(|_, _| [0.6; 3]);
        let b = picture(|_, _| [0.5; 3]);
        let expected = 0.01 / (0.25 + 0.01);
        assert!((rel_mse(&a, &b) - expected).abs() < 1e-7, "{}", rel_mse(&a, &b));
        // One byte of 255 in every place: 20 log10(255).
        assert!((psnr_db(&[10; 12], &[11; 12]) - 48.130_803_608_679_1).abs() < 1e-9);
        // White against black is the greatest error that there is.
        let c = compare(&picture(|_, _| [1.0; 3]), &picture(|_, _| [0.0; 3])).unwrap();
        assert!(c.flip.mean() > 0.9 && c.psnr_db == 0.0, "{} {}", c.flip.mean(), c.psnr_db);
    }

    #[test]
    fn percentile_sees_what_the_mean_hides() {
        let a = picture(|_, _| [0.2; 3]);
        let b = picture(|x, y| if x < 4 && y < 8 { [0.9, 0.1, 0.1] } else { [0.2; 3] });
        let flip = compare(&a, &b).unwrap().flip;
        assert!(flip.mean() < 0.15 && flip.percentile(0.99) > 0.5, "{} {}", flip.mean(), flip.percentile(0.99));
        assert_eq!(flip.percentile(1.0), flip.errors.iter().copied().fold(0.0, f32::max) as f64);
        assert!(flip.percentile(0.0) <= flip.percentile(0.5));
    }

    #[test]
    fn what_cannot_be_compared_is_said() {
        let a = picture(|_, _| [0.2; 3]);
        assert!(matches!(compare(&a, &Image::new(32, 48)), Err(MetricsError::Size { .. })));
        assert_eq!(compare(&Image::default(), &Image::default()), Err(MetricsError::Empty));
        let mut nan = a.clone();
        nan.pixels[48 + 5][1] = f32::NAN;
        assert_eq!(compare(&a, &nan), Err(MetricsError::NotFinite { which: "second", x: 5, y: 1 }));
    }
}
