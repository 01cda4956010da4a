//! Why a file was refused or could not be written.

use std::path::PathBuf;

/// Every way in which reading or writing glTF can fail; each is one line that names the place.
#[derive(Debug, thiserror::Error)]
pub enum GltfError {
    /// The file system said no.
    #[error("{}: {source}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The bytes are no glTF at all.
    #[error("not a glTF file: {0}")]
    NotGltf(String),
    /// The GLB container around the JSON is broken.
    #[error("broken GLB container: {0}")]
    Container(String),
    /// The JSON text is broken, or a field has the wrong type.
    #[error("broken glTF JSON: {0}")]
    Json(String),
    /// Not glTF 2.x.
    #[error("glTF version {0:?} is not supported, only 2.x")]
    Version(String),
    /// The file cannot be shown without an extension that is not supported.
    #[error("the file requires the extension {0}, which is not supported")]
    Extension(String),
    /// A limit of [`super::ImportLimits`] was passed.
    #[error("over the import limit: {what} is {value}, the limit is {limit}")]
    Limit {
        /// Which limit.
        what: &'static str,
        /// What the file asks for.
        value: u64,
        /// What is allowed.
        limit: u64,
    },
    /// A URI that may not be followed, or cannot be decoded.
    #[error("refused URI {uri:?}: {why}")]
    Uri {
        /// The URI, shortened.
        uri: String,
        /// Why it was refused.
        why: &'static str,
    },
    /// A value in the file is wrong.
    #[error("{place}: {why}")]
    Invalid {
        /// Where, such as `accessor 3`.
        place: String,
        /// What is wrong with it.
        why: String,
    },
    /// The scene cannot be written.
    #[error("cannot export: {0}")]
    Export(String),
}

impl GltfError {
    pub(super) fn invalid(place: impl Into<String>, why: impl Into<String>) -> Self {
        Self::Invalid { place: place.into(), why: why.into() }
    }
    pub(super) fn uri(uri: &str, why: &'static str) -> Self {
        Self::Uri { uri: uri.chars().take(80).collect(), why }
    }
}

/// `value` as an error where it passes `limit`.
pub(super) fn within(what: &'static str, value: u64, limit: u64) -> Result<(), GltfError> {
    if value > limit { Err(GltfError::Limit { what, value, limit }) } else { Ok(()) }
}
