//! Pictures in and out of files: sRGB PNG for looking, 32-bit linear EXR for measuring.
//!
//! Contract: a file appears under its name only when it is complete. It is written beside itself under a temporary name,
//! then renamed; a failure leaves nothing behind.

use crate::output::{Image, Layer};
use catoptra_engine::math;
use image::{ExtendedColorType, ImageEncoder, ImageFormat, ImageReader, Limits};
use rayon::prelude::*;
use std::{
    io::{BufReader, Cursor, Write},
    path::{Path, PathBuf},
    sync::OnceLock,
};

/// Largest picture that is read: a guard against files that lie about their size.
const MAX_READ_BYTES: u64 = 8 << 30;

/// Why a picture could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum ImageIoError {
    /// The file system said no.
    #[error("cannot {action} {}: {source}", path.display())]
    File {
        /// `read` or `write`.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// Reason.
        source: std::io::Error,
    },
    /// The bytes are not a picture, or the picture cannot be encoded.
    #[error("{}: {why}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// Reason in words.
        why: String,
    },
}

/// A picture from a file, as light and as it looks.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedImage {
    /// Linear light. A PNG's comes back through the inverse sRGB curve, in [0, 1].
    pub linear: Image,
    /// sRGB bytes, `[height][width][3]`. An EXR's are its rendering at EV 0.
    pub srgb8: Vec<u8>,
}

/// One byte of sRGB from linear light: floor(255·srgb(x) + 0.5). Values outside [0, 1] are clamped; NaN becomes 0.
///
/// Exactly the polynomial curve of [`math::srgb_from_linear`], by a table of the 255 places where the byte steps up: some
/// twenty times faster, because every frame of a game goes through it.
#[inline]
pub fn srgb8_from_linear(x: f32) -> u8 {
    SrgbTable::get().byte(x)
}

struct SrgbTable {
    /// `step[v]`: least x whose byte is at least v; beyond 255 none.
    step: [f32; 257],
    /// Byte at the low end of each bucket of the upper 19 bits of x, for x in [2^-13, 1). A bucket holds one step at most.
    start: [u8; Self::BUCKETS],
}

impl SrgbTable {
    /// Low bits of x that a bucket does not tell.
    const SHIFT: u32 = 13;
    /// 2^-13 in buckets; below it every byte is 0.
    const FIRST: u32 = ((127 - 13) << 23) >> Self::SHIFT;
    const BUCKETS: usize = (13 << 23) >> Self::SHIFT;

    fn get() -> &'static Self {
        static TABLE: OnceLock<SrgbTable> = OnceLock::new();
        TABLE.get_or_init(Self::new)
    }

    fn new() -> Self {
        let mut step = [f32::INFINITY; 257];
        for (v, step) in step[..256].iter_mut().enumerate().skip(1) {
            // Bisect over the bits: positive floats are ordered as their bits are.
            let (mut low, mut high) = (0u32, 1.0f32.to_bits());
            while low + 1 < high {
                let mid = (low + high) / 2;
                if byte_by_formula(f32::from_bits(mid)) as usize >= v {
                    high = mid;
                } else {
                    low = mid;
                }
            }
            *step = f32::from_bits(high);
        }
        let mut start = [0; Self::BUCKETS];
        for (i, s) in start.iter_mut().enumerate() {
            *s = byte_by_formula(f32::from_bits((Self::FIRST + i as u32) << Self::SHIFT));
        }
        Self { step, start }
    }

    #[inline(always)]
    fn byte(&self, x: f32) -> u8 {
        // The last number below 1 has the byte of 1; NaN and what is too dark have that of 0.
        const LEAST: f32 = 1.0 / 8192.0;
        const MOST: f32 = 1.0 - f32::EPSILON / 2.0;
        let x = if x > LEAST { x } else { LEAST };
        let x = if x < MOST { x } else { MOST };
        let v = self.start[(x.to_bits() >> Self::SHIFT) as usize - Self::FIRST as usize];
        v + u8::from(x >= self.step[v as usize + 1])
    }
}

fn byte_by_formula(x: f32) -> u8 {
    (math::srgb_from_linear(x) * 255.0 + 0.5) as u8
}

/// sRGB bytes of linear radiance, `[height][width][3]`: radiance × 2^`exposure_ev`, clamped to [0, 1], sRGB curve.
pub fn srgb8_from_image(image: &Image, exposure_ev: f32) -> Vec<u8> {
    let mut bytes = Vec::new();
    srgb8_into(image, exposure_ev, &mut bytes);
    bytes
}

/// As [`srgb8_from_image`] into memory of the caller's, which is kept where it is large enough.
pub fn srgb8_into(image: &Image, exposure_ev: f32, bytes: &mut Vec<u8>) {
    let scale = math::exp2(exposure_ev);
    let table = SrgbTable::get();
    bytes.resize(image.pixels.len() * 3, 0);
    bytes.par_chunks_mut(3 * 8192).zip(image.pixels.par_chunks(8192)).for_each(|(to, from)| {
        for (t, v) in to.iter_mut().zip(from.as_flattened()) {
            *t = table.byte(v * scale);
        }
    });
}

/// sRGB bytes of a layer, as its PNG shows it.
///
/// Layers of radiance go through exposure; mask, normal, albedo and moments are shown as they are; depth d as d/(1 + d), so
/// that near is dark and nothing met is black.
pub fn srgb8_from_layer(layer: Layer, image: &Image, exposure_ev: f32) -> Vec<u8> {
    match layer {
        Layer::Final | Layer::Direct | Layer::Indirect | Layer::Traced => srgb8_from_image(image, exposure_ev),
        Layer::Mask | Layer::Normal | Layer::Albedo | Layer::Moments => srgb8_from_image(image, 0.0),
        Layer::Depth => {
            let pixels = image.pixels.par_iter().map(|p| p.map(|d| d / (1.0 + d))).collect();
            srgb8_from_image(&Image { width: image.width, height: image.height, pixels }, 0.0)
        }
    }
}

/// Writes sRGB bytes, `[height][width][3]`, as an 8-bit PNG.
///
/// # Errors
/// The file system's reason; nothing is left behind then.
///
/// # Panics
/// If the bytes are not width × height × 3.
pub fn write_png(path: &Path, width: u32, height: u32, srgb8: &[u8]) -> Result<(), ImageIoError> {
    assert_eq!(srgb8.len(), width as usize * height as usize * 3, "three bytes a pixel");
    let mut bytes = Vec::new();
    image::codecs::png::PngEncoder::new(&mut bytes)
        .write_image(srgb8, width, height, ExtendedColorType::Rgb8)
        .map_err(|e| ImageIoError::Format { path: path.into(), why: one_line(&e) })?;
    write_atomically(path, &bytes)
}

/// Writes linear radiance as a 32-bit float EXR, unclamped; the values come back bit for bit.
///
/// # Errors
/// The file system's reason; nothing is left behind then.
pub fn write_exr(path: &Path, image: &Image) -> Result<(), ImageIoError> {
    let mut bytes = Cursor::new(Vec::new());
    image::codecs::openexr::OpenExrEncoder::new(&mut bytes)
        .write_image(bytemuck::cast_slice(&image.pixels), image.width, image.height, ExtendedColorType::Rgb32F)
        .map_err(|e| ImageIoError::Format { path: path.into(), why: one_line(&e) })?;
    write_atomically(path, bytes.get_ref())
}

/// Reads a PNG or an EXR, told apart by content.
///
/// # Errors
/// A missing file, one that is neither PNG nor EXR, or one cut short.
pub fn read_image(path: &Path) -> Result<LoadedImage, ImageIoError> {
    let file = |source| ImageIoError::File { action: "read", path: path.into(), source };
    let format = |why: String| ImageIoError::Format { path: path.into(), why };
    if path.is_dir() {
        return Err(format("it is a folder, not a PNG or an EXR".into()));
    }
    // By content alone: a file's name proves nothing.
    let mut reader = std::fs::File::open(path)
        .and_then(|f| ImageReader::new(BufReader::new(f)).with_guessed_format())
        .map_err(file)?;
    let kind = reader.format();
    if !matches!(kind, Some(ImageFormat::Png | ImageFormat::OpenExr)) {
        return Err(format("it is neither a PNG nor an EXR".into()));
    }
    let mut limits = Limits::default();
    limits.max_alloc = Some(MAX_READ_BYTES);
    reader.limits(limits);
    let decoded = reader.decode().map_err(|e| format(format!("it is damaged: {}", one_line(&e))))?;
    let (width, height) = (decoded.width(), decoded.height());
    if kind == Some(ImageFormat::OpenExr) {
        let rgb = decoded.into_rgb32f();
        let linear = Image { width, height, pixels: rgb.pixels().map(|p| p.0).collect() };
        let srgb8 = srgb8_from_image(&linear, 0.0);
        return Ok(LoadedImage { linear, srgb8 });
    }
    let srgb8 = decoded.into_rgb8().into_raw();
    let curve: Vec<f32> = (0..=255u32).map(|v| math::linear_from_srgb(v as f32 / 255.0)).collect();
    let pixels = srgb8.chunks_exact(3).map(|p| [p[0], p[1], p[2]].map(|v| curve[v as usize])).collect();
    Ok(LoadedImage { linear: Image { width, height, pixels }, srgb8 })
}

/// Writes a whole file, or none: a temporary file in the same folder, then a rename.
///
/// # Errors
/// The file system's reason; the temporary file is removed.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), ImageIoError> {
    let failed = |source| ImageIoError::File { action: "write", path: path.into(), source };
    let name = path.file_name().ok_or_else(|| failed(std::io::Error::other("it names no file")))?;
    let mut temporary = std::ffi::OsString::from(".");
    temporary.push(name);
    temporary.push(format!(".{}.part", std::process::id()));
    let temporary = path.with_file_name(temporary);
    let written = std::fs::File::create(&temporary)
        .and_then(|mut f| f.write_all(bytes).and_then(|()| f.sync_data()))
        .and_then(|()| std::fs::rename(&temporary, path));
    written.map_err(|e| {
        // Nothing more can be done where even the removal fails.
        let _ = std::fs::remove_file(&temporary);
        failed(e)
    })
}

fn one_line(e: &dyn std::fmt::Display) -> String {
    e.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let dir = std::env::temp_dir().join(format!("catoptra-image-io-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&dir).unwrap();
        dir
    }

    fn gradient() -> Image {
        let mut image = Image::new(19, 7);
        for (i, p) in image.pixels.iter_mut().enumerate() {
            *p = [i as f32 * 0.013, 1e-7 * i as f32, 4096.0 / (i as f32 + 1.0)];
        }
        image
    }

    #[test]
    fn table_is_the_formula() {
        for i in 0..2_000_000u32 {
            // All of [0, 1] by bits, then some beyond.
            let x = f32::from_bits((1.0f32.to_bits() / 2_000_000) * i);
            assert_eq!(srgb8_from_linear(x), byte_by_formula(x), "{x}");
        }
        for x in [-1.0, -0.0, f32::NAN, f32::NEG_INFINITY, f32::MIN_POSITIVE] {
            assert_eq!(srgb8_from_linear(x), 0, "{x}");
        }
        for x in [1.0, 1.5, f32::INFINITY, f32::MAX] {
            assert_eq!(srgb8_from_linear(x), 255, "{x}");
        }
        assert_eq!(srgb8_from_linear(0.214_041_14), 128);
    }

    #[test]
    fn every_byte_survives_a_round_trip() {
        let bytes: Vec<u8> = (0..=255).flat_map(|v| [v, 255 - v, v / 2]).collect();
        let path = folder("png").join("bytes.png");
        write_png(&path, 16, 16, &bytes).unwrap();
        let back = read_image(&path).unwrap();
        assert_eq!(back.srgb8, bytes);
        assert_eq!(srgb8_from_image(&back.linear, 0.0), bytes);
    }

    #[test]
    fn exr_is_exact_and_unclamped() {
        let path = folder("exr").join("gradient.exr");
        write_exr(&path, &gradient()).unwrap();
        let back = read_image(&path).unwrap();
        assert_eq!(back.linear, gradient());
        assert_eq!(back.linear.hash(), gradient().hash());
    }

    #[test]
    fn a_failure_leaves_nothing_behind() {
        let dir = folder("fail");
        // A folder that is not empty cannot be replaced by a file.
        std::fs::create_dir_all(dir.join("taken.png/inside")).unwrap();
        let error = write_png(&dir.join("taken.png"), 1, 1, &[0; 3]).unwrap_err().to_string();
        assert!(error.starts_with("cannot write ") && !error.contains('\n'), "{error}");
        let left: Vec<_> = std::fs::read_dir(&dir).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(left, ["taken.png"]);
    }

    #[test]
    fn bad_files_are_named() {
        let dir = folder("bad");
        write_exr(&dir.join("whole.exr"), &gradient()).unwrap();
        let whole = std::fs::read(dir.join("whole.exr")).unwrap();
        std::fs::write(dir.join("cut.exr"), &whole[..whole.len() / 2]).unwrap();
        std::fs::write(dir.join("text.png"), "hello").unwrap();
        for (name, part) in
            [("cut.exr", "damaged"), ("text.png", "neither"), ("none.png", "cannot read"), (".", "folder")]
        {
            let error = read_image(&dir.join(name)).unwrap_err().to_string();
            assert!(error.contains(part) && !error.contains('\n'), "{error}");
        }
    }

    #[test]
    fn exposure_is_in_stops_and_spares_data() {
        let mut image = Image::new(1, 1);
        image.pixels[0] = [0.25; 3];
        assert_eq!(srgb8_from_image(&image, 1.0), [srgb8_from_linear(0.5); 3]);
        assert_eq!(srgb8_from_layer(Layer::Albedo, &image, 1.0), [srgb8_from_linear(0.25); 3]);
        assert_eq!(srgb8_from_layer(Layer::Depth, &image, 1.0), [srgb8_from_linear(0.2); 3]);
    }
}
