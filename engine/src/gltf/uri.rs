//! URIs of buffers and images: data URIs are decoded, file names stay inside the asset's folder, all else is refused.

use super::error::GltfError;
use std::path::{Path, PathBuf};

/// What a URI stands for.
#[derive(Debug, PartialEq)]
pub(super) enum Target {
    /// The bytes of a data URI.
    Data(Vec<u8>),
    /// A file below the asset's folder, as a relative path without `..`.
    File(PathBuf),
}

/// Reads a URI without touching the file system.
pub(super) fn resolve(uri: &str) -> Result<Target, GltfError> {
    if let Some(rest) = uri.get(..5).filter(|s| s.eq_ignore_ascii_case("data:")).and(uri.get(5..)) {
        let (meta, data) = rest.split_once(',').ok_or_else(|| GltfError::uri(uri, "a data URI needs a comma"))?;
        if meta.len() >= 7 && meta.as_bytes()[meta.len() - 7..].eq_ignore_ascii_case(b";base64") {
            return base64(data.as_bytes()).map(Target::Data).ok_or_else(|| GltfError::uri(uri, "broken base64"));
        }
        return percent_decode(data).map(Target::Data).ok_or_else(|| GltfError::uri(uri, "broken percent-encoding"));
    }
    let decoded = percent_decode(uri).ok_or_else(|| GltfError::uri(uri, "broken percent-encoding"))?;
    let name = String::from_utf8(decoded).map_err(|_| GltfError::uri(uri, "not UTF-8"))?;
    // Some writers use the other system's separator; seen as one, it cannot be used to slip past the checks either.
    let name = name.replace('\\', "/");
    if name.contains('\0') {
        return Err(GltfError::uri(uri, "a zero byte in a file name"));
    }
    if name.starts_with('/') {
        return Err(GltfError::uri(uri, "absolute or network paths are not followed"));
    }
    // A colon before the first slash makes a scheme (http:) or a drive (C:).
    if name.split('/').next().is_some_and(|first| first.contains(':')) {
        return Err(GltfError::uri(uri, "network places and drives are not followed"));
    }
    let mut path = PathBuf::new();
    for part in name.split('/') {
        match part {
            "" | "." => {}
            ".." => {
                if !path.pop() {
                    return Err(GltfError::uri(uri, "it leaves the asset's folder"));
                }
            }
            _ => path.push(part),
        }
    }
    if path.as_os_str().is_empty() {
        return Err(GltfError::uri(uri, "it names no file"));
    }
    Ok(Target::File(path))
}

/// Real place of `relative` below `folder`; links that lead outside are refused.
pub(super) fn contained(folder: &Path, relative: &Path, uri: &str) -> Result<PathBuf, GltfError> {
    let io = |path: &Path| {
        let path = path.to_path_buf();
        move |source| GltfError::Io { path, source }
    };
    let folder = folder.canonicalize().map_err(io(folder))?;
    let wanted = folder.join(relative);
    let place = wanted.canonicalize().map_err(io(&wanted))?;
    if place.starts_with(&folder) { Ok(place) } else { Err(GltfError::uri(uri, "it leaves the asset's folder")) }
}

fn percent_decode(text: &str) -> Option<Vec<u8>> {
    let bytes = text.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut i = 0;
    while i < bytes.len() {
        if bytes[i] == b'%' {
            let hex = |b: u8| (b as char).to_digit(16);
            out.push((hex(*bytes.get(i + 1)?)? * 16 + hex(*bytes.get(i + 2)?)?) as u8);
            i += 3;
        } else {
            out.push(bytes[i]);
            i += 1;
        }
    }
    Some(out)
}

/// Standard alphabet (and the URL-safe one), padding optional, white space skipped.
fn base64(text: &[u8]) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(text.len() / 4 * 3 + 3);
    let (mut bits, mut have, mut padded) = (0_u32, 0_u32, false);
    for &b in text {
        let value = match b {
            b'A'..=b'Z' => b - b'A',
            b'a'..=b'z' => b - b'a' + 26,
            b'0'..=b'9' => b - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            b'=' => {
                padded = true;
                continue;
            }
            b' ' | b'\t' | b'\r' | b'\n' => continue,
            _ => return None,
        };
        if padded {
            return None;
        }
        bits = bits << 6 | u32::from(value);
        have += 6;
        if have >= 8 {
            have -= 8;
            out.push((bits >> have) as u8);
            bits &= (1 << have) - 1;
        }
    }
    // A single left-over character holds six bits: no byte.
    if have == 6 { None } else { Some(out) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_leaves_the_folder() {
        for uri in [
            "../secret.bin",
            "a/../../secret.bin",
            "%2e%2e/secret.bin",
            "..%2fsecret.bin",
            "..\\secret.bin",
            "/etc/passwd",
            "%2Fetc/passwd",
            "//host/share",
            "\\\\host\\share",
            "http://example.org/x.bin",
            "HTTPS://example.org/x.bin",
            "file:///etc/passwd",
            "C:/windows/x.bin",
            "c:x.bin",
            "a%00b.bin",
            "",
            ".",
            "%zz",
            "%4",
        ] {
            assert!(resolve(uri).is_err(), "{uri:?} was accepted");
        }
        for (uri, path) in [("a b.bin", "a b.bin"), ("a%20b.bin", "a b.bin"), ("x/../y/./z.png", "y/z.png")] {
            assert_eq!(resolve(uri).unwrap(), Target::File(path.into()));
        }
    }

    #[test]
    fn data_uris() {
        let data = |uri| resolve(uri).unwrap();
        assert_eq!(data("data:application/octet-stream;base64,AAEC/w=="), Target::Data(vec![0, 1, 2, 255]));
        assert_eq!(data("data:,a%20b"), Target::Data(b"a b".to_vec()));
        assert!(
            resolve("data:;base64,A").is_err() && resolve("data:;base64,A*==").is_err() && resolve("data:x").is_err()
        );
    }
}
