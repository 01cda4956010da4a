//! Golden pictures.

use catoptra_render_hybrid::{Image, Layer, image_io, metrics::FlipMap};
use std::path::{Path, PathBuf};

/// A picture as its PNG shows it: sRGB bytes, `[height][width][3]`, row 0 on top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rendering {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// sRGB bytes.
    pub srgb8: Vec<u8>,
}

impl Rendering {
    /// Linear radiance through the sRGB curve at EV 0.
    pub fn of_image(image: &Image) -> Self {
        Self::of_layer(Layer::Final, image)
    }
    /// A layer as the command line would write it.
    pub fn of_layer(layer: Layer, image: &Image) -> Self {
        Self { width: image.width, height: image.height, srgb8: image_io::srgb8_from_layer(layer, image, 0.0) }
    }
    /// FLIP per pixel of this picture under test against `expected`; `None` where sizes differ or there are no pixels.
    pub fn flip(&self, expected: &Self) -> Option<FlipMap> {
        let same_size = (self.width, self.height) == (expected.width, expected.height);
        (same_size && !self.srgb8.is_empty())
            .then(|| FlipMap::between_srgb8(&self.srgb8, &expected.srgb8, self.width, self.height))
    }
}

/// How far a picture may lie from its golden one. Both must hold: a mean alone hides small wrong places.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlipLimits {
    /// Greatest mean FLIP, in [0, 1].
    pub mean: f64,
    /// Greatest 99th percentile of FLIP, in [0, 1].
    pub percentile_99: f64,
}

/// How far it was.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SnapshotReport {
    /// Mean FLIP.
    pub mean: f64,
    /// 99th percentile of FLIP.
    pub percentile_99: f64,
    /// The golden picture was written by this very call.
    pub updated: bool,
}

/// Why a snapshot failed.
#[derive(Debug, PartialEq)]
pub enum SnapshotError {
    /// There is no golden picture. It is never made up: run with `CATOPTRA_UPDATE_GOLDENS=1` and look at it.
    Missing(PathBuf),
    /// The sizes differ.
    Size {
        /// Width and height of the picture under test.
        actual: (u32, u32),
        /// Those of the golden one.
        expected: (u32, u32),
    },
    /// The pictures differ by more than allowed; actual, expected and heat map lie in the folder.
    Differs {
        /// Name of the snapshot.
        name: String,
        /// Bytes that differ.
        bytes: usize,
        /// Mean and 99th percentile of FLIP.
        report: SnapshotReport,
        /// Where the three pictures are.
        folder: PathBuf,
    },
    /// A file could not be read or written.
    File(String),
}

impl std::fmt::Display for SnapshotError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Missing(path) => write!(f, "there is no golden picture {}", path.display()),
            Self::Size { actual, expected } => write!(f, "the picture is {actual:?}, the golden one {expected:?}"),
            Self::Differs { name, bytes, report, folder } => write!(
                f,
                "{name}: {bytes} bytes differ, FLIP mean {:.5}, 99th percentile {:.5}; see {}",
                report.mean,
                report.percentile_99,
                folder.display()
            ),
            Self::File(why) => f.write_str(why),
        }
    }
}

impl std::error::Error for SnapshotError {}

/// A folder of golden PNGs and a folder for what failed.
#[derive(Clone, Debug)]
pub struct SnapshotFolder {
    goldens: PathBuf,
    failures: PathBuf,
    update: bool,
}

impl SnapshotFolder {
    /// * `goldens`: the committed pictures, `NAME.png`
    /// * `failures`: gets `NAME.actual.png`, `NAME.expected.png`, `NAME.heat.png`; made when needed
    pub fn new(goldens: impl Into<PathBuf>, failures: impl Into<PathBuf>) -> Self {
        Self { goldens: goldens.into(), failures: failures.into(), update: crate::updating_goldens() }
    }
    /// Rewrites goldens or not, whatever the environment says.
    pub fn updating(mut self, update: bool) -> Self {
        self.update = update;
        self
    }

    /// The picture's bytes are the golden one's bytes.
    ///
    /// # Errors
    /// [`SnapshotError`]; no golden picture is an error too.
    pub fn check_exact(&self, name: &str, actual: &Rendering) -> Result<SnapshotReport, SnapshotError> {
        self.check(name, actual, None)
    }

    /// The picture lies within `limits` of the golden one.
    ///
    /// # Errors
    /// As [`Self::check_exact`].
    pub fn check_flip(
        &self,
        name: &str,
        actual: &Rendering,
        limits: FlipLimits,
    ) -> Result<SnapshotReport, SnapshotError> {
        self.check(name, actual, Some(limits))
    }

    fn check(
        &self,
        name: &str,
        actual: &Rendering,
        limits: Option<FlipLimits>,
    ) -> Result<SnapshotReport, SnapshotError> {
        let path = self.goldens.join(format!("{name}.png"));
        if self.update {
            make_folder(&self.goldens)?;
            // An equal picture keeps its file: encoders differ in bytes from version to version.
            if read(&path).ok().as_ref() != Some(actual) {
                write(&path, actual)?;
            }
            return Ok(SnapshotReport { updated: true, ..SnapshotReport::default() });
        }
        if !path.is_file() {
            return Err(SnapshotError::Missing(path));
        }
        self.compare(name, actual, &read(&path)?, limits)
    }

    /// Compares two pictures that both were just made, with the same traces of a failure. Never rewrites anything.
    /// * `limits`: `None`: equal bytes
    ///
    /// # Errors
    /// [`SnapshotError::Size`] or [`SnapshotError::Differs`].
    pub fn compare(
        &self,
        name: &str,
        actual: &Rendering,
        expected: &Rendering,
        limits: Option<FlipLimits>,
    ) -> Result<SnapshotReport, SnapshotError> {
        let (a, e) = ((actual.width, actual.height), (expected.width, expected.height));
        let Some(flip) = actual.flip(expected) else {
            return Err(SnapshotError::Size { actual: a, expected: e });
        };
        let report = SnapshotReport { mean: flip.mean(), percentile_99: flip.percentile(0.99), updated: false };
        let bytes = actual.srgb8.iter().zip(&expected.srgb8).filter(|(a, e)| a != e).count();
        let good = match limits {
            None => bytes == 0,
            Some(l) => report.mean <= l.mean && report.percentile_99 <= l.percentile_99,
        };
        if good {
            return Ok(report);
        }
        make_folder(&self.failures)?;
        let heat = Rendering { width: flip.width, height: flip.height, srgb8: flip.heat_map() };
        for (kind, picture) in [("actual", actual), ("expected", expected), ("heat", &heat)] {
            write(&self.failures.join(format!("{name}.{kind}.png")), picture)?;
        }
        Err(SnapshotError::Differs { name: name.to_string(), bytes, report, folder: self.failures.clone() })
    }
}

fn make_folder(path: &Path) -> Result<(), SnapshotError> {
    std::fs::create_dir_all(path).map_err(|e| SnapshotError::File(format!("cannot make {}: {e}", path.display())))
}

fn read(path: &Path) -> Result<Rendering, SnapshotError> {
    let loaded = image_io::read_image(path).map_err(|e| SnapshotError::File(e.to_string()))?;
    Ok(Rendering { width: loaded.linear.width, height: loaded.linear.height, srgb8: loaded.srgb8 })
}

fn write(path: &Path, picture: &Rendering) -> Result<(), SnapshotError> {
    image_io::write_png(path, picture.width, picture.height, &picture.srgb8)
        .map_err(|e| SnapshotError::File(e.to_string()))
}
