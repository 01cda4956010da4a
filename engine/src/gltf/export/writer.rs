//! Collects JSON and binary data, and puts them into one GLB.

use crate::gltf::error::GltfError;
use glam::Vec3;
use serde_json::{Map, Value, json};
use std::collections::BTreeSet;

#[derive(Default)]
pub(super) struct Writer {
    root: Map<String, Value>,
    lights: Vec<Value>,
    extensions: BTreeSet<&'static str>,
    bin: Vec<u8>,
}

impl Writer {
    /// Appends to a top-level list; returns its number.
    pub fn push(&mut self, list: &str, value: Value) -> usize {
        let list = self.root.entry(list).or_insert_with(|| json!([]));
        match list {
            Value::Array(items) => {
                items.push(value);
                items.len() - 1
            }
            _ => unreachable!("every top-level entry is made by push"),
        }
    }

    pub fn len(&self, list: &str) -> usize {
        self.root.get(list).and_then(Value::as_array).map_or(0, Vec::len)
    }

    pub fn push_light(&mut self, value: Value) -> usize {
        self.uses("KHR_lights_punctual");
        self.lights.push(value);
        self.lights.len() - 1
    }

    pub fn uses(&mut self, extension: &'static str) {
        self.extensions.insert(extension);
    }

    /// A buffer view of the bytes, aligned to 4.
    pub fn view(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let mut value = json!({ "buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len() });
        if let Some(target) = target {
            value["target"] = json!(target);
        }
        self.bin.extend_from_slice(bytes);
        self.push("bufferViews", value)
    }

    /// A vertex attribute of 32-bit floats.
    pub fn floats<T: bytemuck::NoUninit>(&mut self, kind: &str, values: &[T], bounds: Option<[Vec3; 2]>) -> usize {
        let view = self.view(&little_endian(bytemuck::cast_slice(values)), Some(34962));
        let mut value = json!({ "bufferView": view, "componentType": 5126, "count": values.len(), "type": kind });
        if let Some([low, high]) = bounds {
            value["min"] = json!(low.to_array());
            value["max"] = json!(high.to_array());
        }
        self.push("accessors", value)
    }

    pub fn indices(&mut self, triangles: &[[u32; 3]]) -> usize {
        let view = self.view(&little_endian(bytemuck::cast_slice(triangles)), Some(34963));
        self.push(
            "accessors",
            json!({ "bufferView": view, "componentType": 5125, "count": 3 * triangles.len(), "type": "SCALAR" }),
        )
    }

    pub fn finish(mut self) -> Result<Vec<u8>, GltfError> {
        self.root.insert("asset".into(), json!({ "version": "2.0", "generator": "Catoptra" }));
        self.root.insert("scene".into(), json!(0));
        if !self.extensions.is_empty() {
            self.root.insert("extensionsUsed".into(), json!(self.extensions));
        }
        if !self.lights.is_empty() {
            self.root.insert("extensions".into(), json!({ "KHR_lights_punctual": { "lights": self.lights } }));
        }
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        if !self.bin.is_empty() {
            self.root.insert("buffers".into(), json!([{ "byteLength": self.bin.len() }]));
        }
        let mut text = serde_json::to_vec(&self.root).map_err(|e| GltfError::Export(e.to_string()))?;
        text.resize(text.len().next_multiple_of(4), b' ');
        let chunks: &[(&[u8; 4], &[u8])] = &[(b"JSON", &text), (b"BIN\0", &self.bin)];
        let chunks = if self.bin.is_empty() { &chunks[..1] } else { chunks };
        let total = 12 + chunks.iter().map(|(_, c)| 8 + c.len() as u64).sum::<u64>();
        let Ok(length) = u32::try_from(total) else {
            return Err(GltfError::Export(format!("{total} bytes do not fit into a GLB, which ends at 4 GiB")));
        };
        let mut out = Vec::with_capacity(total as usize);
        out.extend(b"glTF");
        out.extend(2_u32.to_le_bytes());
        out.extend(length.to_le_bytes());
        for (kind, bytes) in chunks {
            out.extend((bytes.len() as u32).to_le_bytes());
            out.extend(*kind);
            out.extend(*bytes);
        }
        Ok(out)
    }
}

fn little_endian(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|w| w.to_le_bytes()).collect()
}
