//! From bytes to the parsed document: GLB container, size of the JSON, version, required extensions.

use super::{
    document::Document,
    error::{GltfError, within},
    limits::ImportLimits,
};

/// Extensions whose meaning is honoured, at least as far as the module's docs say.
pub(super) const SUPPORTED: &[&str] = &[
    "EXT_mesh_gpu_instancing",
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_node_visibility",
    "KHR_texture_transform",
];

/// Extensions that change only the look of a surface, or nothing that is seen: without them the scene is plainer, not wrong, so that a file may
/// even require them.
const ONLY_LOOK: &[&str] = &[
    "EXT_lights_ies",
    "EXT_lights_image_based",
    "EXT_mesh_features",
    "EXT_mesh_manifold",
    "EXT_structural_metadata",
    "KHR_animation_pointer",
    "KHR_audio_emitter",
    "KHR_interactivity",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_dispersion",
    "KHR_materials_iridescence",
    "KHR_materials_sheen",
    "KHR_materials_variants",
    "KHR_materials_volume_scatter",
    "KHR_node_hoverability",
    "KHR_node_selectability",
    "KHR_physics_rigid_bodies",
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "MSFT_lod",
];

/// Splits a file by its content (not by its name) into JSON text and the GLB's binary chunk.
pub(super) fn split(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), GltfError> {
    if !bytes.starts_with(b"glTF") {
        let text = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
        return match text.iter().find(|b| !b.is_ascii_whitespace()) {
            Some(b'{') => Ok((text, None)),
            Some(_) => Err(GltfError::NotGltf("it starts with neither 'glTF' nor '{'".into())),
            None => Err(GltfError::NotGltf("it is empty".into())),
        };
    }
    let bad = |why: String| Err(GltfError::Container(why));
    let word = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        return bad(format!("{} bytes are too few for the header of 12", bytes.len()));
    };
    if version != 2 {
        return Err(GltfError::Version(version.to_string()));
    }
    let length = length as usize;
    if length > bytes.len() {
        return bad(format!("truncated: the header says {length} bytes, the file has {}", bytes.len()));
    }
    let (mut json, mut bin, mut at) = (None, None, 12);
    while at + 8 <= length {
        let (Some(size), Some(kind)) = (word(at), word(at + 4)) else { break };
        let Some(chunk) = (at + 8).checked_add(size as usize).filter(|&e| e <= length).map(|e| &bytes[at + 8..e])
        else {
            return bad(format!("the chunk at byte {at} says {size} bytes, but the file ends at {length}"));
        };
        match &kind.to_le_bytes() {
            b"JSON" if json.is_none() => json = Some(chunk),
            b"BIN\0" if json.is_some() && bin.is_none() => bin = Some(chunk),
            _ if json.is_none() => return bad("the first chunk is not JSON".into()),
            _ => {} // Unknown chunks are to be skipped.
        }
        at += 8 + size as usize;
    }
    match json {
        Some(json) => Ok((json, bin)),
        None => bad("there is no JSON chunk".into()),
    }
}

/// Parses the JSON. Its structure is counted first, so that a small text cannot become a huge tree.
pub(super) fn parse(json: &[u8], limits: &ImportLimits) -> Result<Document, GltfError> {
    let json = json.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(json);
    within("JSON tokens", count_tokens(json), limits.json_tokens)?;
    // GLB pads with spaces, some writers with zero bytes.
    let end = json.iter().rposition(|b| *b != 0).map_or(0, |i| i + 1);
    let document: Document = serde_json::from_slice(&json[..end]).map_err(|e| GltfError::Json(e.to_string()))?;
    let version = document.asset.min_version.as_ref().unwrap_or(&document.asset.version);
    let newer = document.asset.min_version.as_ref().is_some_and(|v| v.as_str() != "2.0");
    if newer || !version.starts_with("2.") {
        return Err(GltfError::Version(version.clone()));
    }
    for name in &document.extensions_required {
        if !SUPPORTED.contains(&name.as_str()) && !ONLY_LOOK.contains(&name.as_str()) {
            return Err(GltfError::Extension(name.clone()));
        }
    }
    Ok(document)
}

/// Commas, colons and opening brackets outside strings: an upper bound of the values in the text.
fn count_tokens(json: &[u8]) -> u64 {
    let (mut count, mut in_string, mut escaped) = (0, false, false);
    for &b in json {
        if in_string {
            (in_string, escaped) = if escaped { (true, false) } else { (b != b'"', b == b'\\') };
        } else {
            in_string = b == b'"';
            count += u64::from(matches!(b, b',' | b':' | b'{' | b'['));
        }
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    fn glb(json: &[u8]) -> Vec<u8> {
        let mut out = b"glTF".to_vec();
        for word in [2, 20 + json.len() as u32, json.len() as u32] {
            out.extend(u32::to_le_bytes(word));
        }
        out.extend(b"JSON");
        out.extend(json);
        out
    }

    #[test]
    fn every_truncation_is_refused() {
        let whole = glb(br#"{"asset":{"version":"2.0"}}"#);
        assert!(split(&whole).is_ok());
        for n in 0..whole.len() {
            assert!(split(&whole[..n]).is_err(), "{n} bytes were accepted");
        }
    }

    #[test]
    fn tokens_in_strings_do_not_count() {
        assert_eq!(count_tokens(br#"{"a":"{[,:\"]","b":[1,2]}"#), 6);
        let limits = ImportLimits { json_tokens: 5, ..Default::default() };
        let error = parse(br#"{"asset":{"version":"2.0"},"nodes":[{},{}]}"#, &limits).unwrap_err();
        assert!(matches!(error, GltfError::Limit { what: "JSON tokens", limit: 5, .. }), "{error}");
    }

    #[test]
    fn versions_and_extensions_are_named() {
        let parse = |s: &str| parse(s.as_bytes(), &ImportLimits::default());
        assert!(matches!(parse(r#"{"asset":{"version":"1.0"}}"#), Err(GltfError::Version(v)) if v == "1.0"));
        assert!(matches!(parse(r#"{"asset":{"version":"2.1","minVersion":"2.1"}}"#), Err(GltfError::Version(_))));
        let draco = r#"{"asset":{"version":"2.0"},"extensionsRequired":["KHR_draco_mesh_compression"]}"#;
        assert!(parse(draco).unwrap_err().to_string().contains("KHR_draco_mesh_compression"));
    }
}
