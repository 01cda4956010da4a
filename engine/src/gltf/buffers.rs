//! The bytes behind buffers and images, counted against the limit.

use super::{
    document::{BufferView, Document, has_extension, item},
    error::{GltfError, within},
    limits::ImportLimits,
    uri::{self, Target},
};
use std::{
    borrow::Cow,
    cell::RefCell,
    collections::BTreeSet,
    fs::File,
    io::Read,
    path::{Path, PathBuf},
};

/// Reads a regular file of at most `limit` bytes.
pub(super) fn read_file(path: &Path, already: u64, limit: u64) -> Result<Vec<u8>, GltfError> {
    let io = |source| GltfError::Io { path: path.to_path_buf(), source };
    let meta = std::fs::metadata(path).map_err(io)?;
    if !meta.is_file() {
        return Err(io(std::io::Error::other("not a regular file")));
    }
    within("bytes", already.saturating_add(meta.len()), limit)?;
    let mut bytes = Vec::with_capacity(meta.len() as usize);
    // The file may grow while it is read; one byte more than allowed is enough to tell.
    let allowed = limit - already.min(limit);
    File::open(path).map_err(io)?.take(allowed.saturating_add(1)).read_to_end(&mut bytes).map_err(io)?;
    within("bytes", already.saturating_add(bytes.len() as u64), limit)?;
    Ok(bytes)
}

/// Where data comes from, and how much of it has been read.
pub(super) struct Source {
    folder: Option<PathBuf>,
    limit: u64,
    read: u64,
}

impl Source {
    pub fn new(folder: Option<&Path>, already: u64, limits: &ImportLimits) -> Self {
        Self { folder: folder.map(Path::to_path_buf), limit: limits.bytes, read: already }
    }

    /// Bytes that a URI stands for.
    pub fn fetch(&mut self, text: &str) -> Result<Vec<u8>, GltfError> {
        let bytes = match uri::resolve(text)? {
            // Its text was counted with the JSON; what it decodes to is smaller.
            Target::Data(bytes) => return Ok(bytes),
            Target::File(relative) => {
                let Some(folder) = &self.folder else {
                    return Err(GltfError::uri(text, "bytes without a folder cannot name files"));
                };
                // A bare file name has the empty folder, which is the current one.
                let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
                read_file(&uri::contained(folder, &relative, text)?, self.read, self.limit)?
            }
        };
        self.read += bytes.len() as u64;
        Ok(bytes)
    }
}

/// All buffers of a document. One that could not be had is an error only when something needs it.
pub(super) struct Buffers<'a> {
    document: &'a Document,
    data: Vec<Result<Cow<'a, [u8]>, GltfError>>,
    /// Sparse accessors whose indices have been walked: once is enough, however many primitives name them.
    pub walked: RefCell<BTreeSet<u32>>,
}

impl<'a> Buffers<'a> {
    pub fn load(document: &'a Document, bin: Option<&'a [u8]>, source: &mut Source) -> Result<Self, GltfError> {
        let mut needed = vec![false; document.buffers.len()];
        for view in &document.buffer_views {
            if let Some(flag) = needed.get_mut(view.buffer as usize) {
                *flag = true;
            }
        }
        let mut data = Vec::with_capacity(document.buffers.len());
        for (i, buffer) in document.buffers.iter().enumerate() {
            let bytes = match (&buffer.uri, bin) {
                _ if !needed[i] => Err(GltfError::invalid(format!("buffer {i}"), "no buffer view uses it")),
                (Some(uri), _) => match source.fetch(uri) {
                    Err(over @ GltfError::Limit { .. }) => return Err(over),
                    other => other.map(Cow::Owned),
                },
                (None, Some(bin)) if i == 0 => Ok(Cow::Borrowed(bin)),
                (None, _) => Err(GltfError::invalid(format!("buffer {i}"), "it has no data")),
            };
            data.push(bytes.and_then(|b| {
                if (b.len() as u64) < buffer.byte_length {
                    let why = format!("byteLength is {}, but only {} bytes are there", buffer.byte_length, b.len());
                    return Err(GltfError::invalid(format!("buffer {i}"), why));
                }
                Ok(b)
            }));
        }
        Ok(Self { document, data, walked: RefCell::default() })
    }

    /// Bytes of a buffer view, and the view itself.
    pub fn view(&self, index: u32, place: &str) -> Result<(&[u8], &'a BufferView), GltfError> {
        let view = item(&self.document.buffer_views, index, "buffer view", place)?;
        let here = format!("buffer view {index}");
        let buffer = item(&self.document.buffers, view.buffer, "buffer", &here)?;
        let bytes = match &self.data[view.buffer as usize] {
            Ok(bytes) => bytes,
            // The compressed stream stands in another buffer; this one is only a promise.
            Err(_) if has_extension(&view.extensions, "EXT_meshopt_compression") => {
                return Err(GltfError::Extension("EXT_meshopt_compression".into()));
            }
            Err(error) => return Err(GltfError::invalid(here, error.to_string())),
        };
        let end =
            view.byte_offset.checked_add(view.byte_length).filter(|&e| e <= buffer.byte_length.min(bytes.len() as u64));
        let Some(end) = end else {
            let why = format!(
                "{} bytes from {} pass the end of buffer {} ({} bytes)",
                view.byte_length, view.byte_offset, view.buffer, buffer.byte_length
            );
            return Err(GltfError::invalid(here, why));
        };
        Ok((&bytes[view.byte_offset as usize..end as usize], view))
    }
}
