//! Typed, bounds-checked, allocation-free views of accessors: strided, sparse, normalised.

use super::{
    buffers::Buffers,
    document::{AccessorDef, Document, item},
    error::GltfError,
};

#[derive(Clone, Copy, PartialEq)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn from_code(code: u32, place: &str) -> Result<Self, GltfError> {
        Ok(match code {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return Err(GltfError::invalid(place, format!("component type {code} does not exist"))),
        })
    }
    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }
    fn read(self, b: &[u8], normalized: bool) -> f32 {
        let (value, max) = match self {
            Self::F32 => return f32::from_le_bytes([b[0], b[1], b[2], b[3]]),
            Self::U32 => return u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f32,
            Self::I8 => (f32::from(b[0] as i8), 127.0),
            Self::U8 => (f32::from(b[0]), 255.0),
            Self::I16 => (f32::from(i16::from_le_bytes([b[0], b[1]])), 32767.0),
            Self::U16 => (f32::from(u16::from_le_bytes([b[0], b[1]])), 65535.0),
        };
        if normalized { (value / max).max(-1.0) } else { value }
    }
}

struct Sparse<'a> {
    indices: &'a [u8],
    kind: Component,
    values: &'a [u8],
    count: usize,
}

impl Sparse<'_> {
    fn index(&self, i: usize) -> u32 {
        read_index(self.kind, &self.indices[i * self.kind.size()..])
    }
    /// Place of element `at` among the values.
    fn find(&self, at: usize) -> Option<usize> {
        let (mut low, mut high) = (0, self.count);
        while low < high {
            let mid = low + (high - low) / 2;
            match (self.index(mid) as usize).cmp(&at) {
                std::cmp::Ordering::Equal => return Some(mid),
                std::cmp::Ordering::Less => low = mid + 1,
                std::cmp::Ordering::Greater => high = mid,
            }
        }
        None
    }
}

fn read_index(kind: Component, b: &[u8]) -> u32 {
    match kind {
        Component::U8 => u32::from(b[0]),
        Component::U16 => u32::from(u16::from_le_bytes([b[0], b[1]])),
        _ => u32::from_le_bytes([b[0], b[1], b[2], b[3]]),
    }
}

/// An accessor whose every element is known to lie within its buffer. Without a buffer view its elements are zero.
pub(super) struct Accessor<'a> {
    pub count: usize,
    pub components: usize,
    kind: Component,
    normalized: bool,
    data: Option<(&'a [u8], usize)>,
    sparse: Option<Sparse<'a>>,
}

impl<'a> Accessor<'a> {
    /// Checks accessor `index` against its buffers.
    pub fn open(document: &Document, buffers: &'a Buffers, index: u32, place: &str) -> Result<Self, GltfError> {
        let def = item(&document.accessors, index, "accessor", place)?;
        let place = &format!("accessor {index}");
        let kind = Component::from_code(def.component_type, place)?;
        let components = match def.kind.as_str() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            "MAT4" => 16,
            other => return Err(GltfError::invalid(place, format!("type {other:?} is of no use here"))),
        };
        let size = components * kind.size();
        let data = match def.buffer_view {
            Some(view) => Some(strided(def, buffers, view, size, place)?),
            None => None,
        };
        let count = usize::try_from(def.count).map_err(|_| GltfError::invalid(place, "count is too large"))?;
        let sparse = match &def.sparse {
            Some(_) => {
                let walked = buffers.walked.borrow().contains(&index);
                let sparse = sparse(def, buffers, size, walked, place)?;
                buffers.walked.borrow_mut().insert(index);
                Some(sparse)
            }
            None => None,
        };
        Ok(Self { count, components, kind, normalized: def.normalized, data, sparse })
    }

    /// Reads integers as fractions whatever the file says: colours are never anything else.
    pub fn force_normalized(mut self) -> Self {
        self.normalized = true;
        self
    }

    fn element(&self, i: usize) -> Option<&[u8]> {
        let size = self.components * self.kind.size();
        if let Some(s) = &self.sparse
            && let Some(k) = s.find(i)
        {
            return Some(&s.values[k * size..(k + 1) * size]);
        }
        let (bytes, stride) = self.data?;
        Some(&bytes[i * stride..i * stride + size])
    }

    /// First `N` components of element `i`; missing ones come from `default`.
    pub fn read<const N: usize>(&self, i: usize, default: [f32; N]) -> [f32; N] {
        debug_assert!(i < self.count);
        let mut out = default;
        let bytes = self.element(i);
        for (k, v) in out.iter_mut().enumerate().take(self.components) {
            *v = bytes.map_or(0.0, |b| self.kind.read(&b[k * self.kind.size()..], self.normalized));
        }
        out
    }

    /// Unsigned integer element `i`.
    pub fn read_index(&self, i: usize) -> u32 {
        self.element(i).map_or(0, |b| read_index(self.kind, b))
    }

    /// First four components of element `i` as unsigned integers.
    pub fn read_joints(&self, i: usize) -> [u32; 4] {
        let mut out = [0; 4];
        if let Some(b) = self.element(i) {
            for (k, v) in out.iter_mut().enumerate().take(self.components) {
                *v = read_index(self.kind, &b[k * self.kind.size()..]);
            }
        }
        out
    }

    /// The value that means "restart the strip" for this type of index; glTF forbids it.
    pub fn restart_value(&self) -> u32 {
        match self.kind {
            Component::U8 => 0xFF,
            Component::U16 => 0xFFFF,
            _ => 0xFFFF_FFFF,
        }
    }

    pub fn is_index_type(&self) -> bool {
        matches!(self.kind, Component::U8 | Component::U16 | Component::U32)
    }
}

fn strided<'a>(
    def: &AccessorDef,
    buffers: &'a Buffers,
    view: u32,
    size: usize,
    place: &str,
) -> Result<(&'a [u8], usize), GltfError> {
    let (bytes, view_def) = buffers.view(view, place)?;
    let stride = view_def.byte_stride.unwrap_or(size as u64);
    if stride < size as u64 || stride > 252.max(size as u64) {
        return Err(GltfError::invalid(place, format!("byteStride {stride} does not fit elements of {size} bytes")));
    }
    // The last element needs its own bytes only, not a whole stride.
    let length = match def.count {
        0 => Some(0),
        n => (n - 1).checked_mul(stride).and_then(|b| b.checked_add(size as u64)),
    };
    let end = length.and_then(|l| l.checked_add(def.byte_offset));
    if end.is_none_or(|e| e > bytes.len() as u64) {
        let why = format!(
            "{} elements of {size} bytes, {stride} apart, from {} pass the end of buffer view {view} ({} bytes)",
            def.count,
            def.byte_offset,
            bytes.len()
        );
        return Err(GltfError::invalid(place, why));
    }
    Ok((&bytes[def.byte_offset as usize..], stride as usize))
}

fn sparse<'a>(
    def: &AccessorDef,
    buffers: &'a Buffers,
    size: usize,
    walked: bool,
    place: &str,
) -> Result<Sparse<'a>, GltfError> {
    let place = &format!("{place}, sparse");
    let Some(s) = &def.sparse else {
        return Err(GltfError::invalid(place, "missing"));
    };
    if s.count > def.count {
        return Err(GltfError::invalid(place, format!("{} entries for {} elements", s.count, def.count)));
    }
    let kind = Component::from_code(s.indices.component_type, place)?;
    if !matches!(kind, Component::U8 | Component::U16 | Component::U32) {
        return Err(GltfError::invalid(place, "indices must be unsigned integers"));
    }
    let part = |view: u32, offset: u64, each: usize, what: &str| -> Result<&'a [u8], GltfError> {
        let (bytes, _) = buffers.view(view, place)?;
        let end = s.count.checked_mul(each as u64).and_then(|l| l.checked_add(offset));
        match end {
            Some(end) if end <= bytes.len() as u64 => Ok(&bytes[offset as usize..end as usize]),
            _ => Err(GltfError::invalid(place, format!("its {what} pass the end of buffer view {view}"))),
        }
    };
    let out = Sparse {
        indices: part(s.indices.buffer_view, s.indices.byte_offset, kind.size(), "indices")?,
        kind,
        values: part(s.values.buffer_view, s.values.byte_offset, size, "values")?,
        count: s.count as usize,
    };
    for i in 0..if walked { 0 } else { out.count } {
        let index = out.index(i);
        if u64::from(index) >= def.count {
            return Err(GltfError::invalid(place, format!("index {index}, but there are {} elements", def.count)));
        }
        if i > 0 && index <= out.index(i - 1) {
            return Err(GltfError::invalid(place, "indices do not increase"));
        }
    }
    Ok(out)
}
