//! Primitives -> meshes: every index is checked, unused vertices are dropped, morph targets and skins are applied as the
//! file poses them.

use super::{
    accessor::Accessor,
    buffers::Buffers,
    document::{Document, Primitive, has_extension, item},
    error::{GltfError, within},
    limits::ImportLimits,
    report::Ignored,
    scene::cofactor,
};
use crate::animation::Deformation;
use crate::mesh::{Mesh, MeshData};
use glam::{Affine3, Mat3, Vec2, Vec3, Vec4};
use std::{collections::BTreeMap, sync::Arc};

/// What a primitive's material reads of its vertices beside position, normal and colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Reads {
    /// Numbers of the sets that become the mesh's first and second.
    pub uv_sets: [u32; 2],
    /// It has a normal map.
    pub tangents: bool,
}

impl Reads {
    fn has(&self, attribute: &str) -> bool {
        let set = attribute.strip_prefix("TEXCOORD_").and_then(|n| n.parse().ok());
        matches!(attribute, "POSITION" | "NORMAL" | "COLOR_0")
            || (self.tangents && attribute == "TANGENT")
            || set.is_some_and(|n| self.uv_sets.contains(&n))
    }
}

/// How a node poses a mesh beyond its transform.
#[derive(Default)]
pub(super) struct Deform {
    /// Morph weights, one a target.
    pub weights: Vec<f32>,
    /// Number of the skin, and one matrix a joint: world space from bind space.
    pub skin: Option<(u32, Arc<[Affine3]>)>,
    /// The node, where an animation will change the mesh: it gets one of its own, and what that is made of is kept.
    pub animated: Option<u32>,
}

type Key = (Vec<(String, u32)>, [u32; 2], Option<u32>, u32, Vec<u32>, Option<u32>, Option<u32>);

/// Builds meshes, sharing those that are built from the same data in the same way.
pub(super) struct Geometry<'a> {
    document: &'a Document,
    buffers: &'a Buffers<'a>,
    limits: &'a ImportLimits,
    vertices: u64,
    triangles: u64,
    cache: BTreeMap<Key, Option<usize>>,
    pub meshes: Vec<Arc<Mesh>>,
    /// What animated meshes are made of, by mesh.
    pub sources: BTreeMap<usize, Deformation>,
    source: Option<Deformation>,
}

impl<'a> Geometry<'a> {
    pub fn new(document: &'a Document, buffers: &'a Buffers<'a>, limits: &'a ImportLimits) -> Self {
        Self {
            document,
            buffers,
            limits,
            vertices: 0,
            triangles: 0,
            cache: BTreeMap::new(),
            meshes: Vec::new(),
            sources: BTreeMap::new(),
            source: None,
        }
    }

    /// Number of the mesh of a primitive; `None` where it draws nothing (points, lines, no positions).
    pub fn primitive(
        &mut self,
        primitive: &Primitive,
        reads: Reads,
        deform: &Deform,
        place: &str,
        ignored: &mut Ignored,
    ) -> Result<Option<usize>, GltfError> {
        let mut attributes = Vec::new();
        for (name, &accessor) in &primitive.attributes {
            let posed = deform.skin.is_some() && matches!(name.as_str(), "JOINTS_0" | "WEIGHTS_0");
            if reads.has(name) || posed {
                attributes.push((name.clone(), accessor));
            } else if (name.starts_with("TEXCOORD_") || name.starts_with("COLOR_"))
                || (deform.skin.is_some() && name.starts_with("JOINTS_"))
            {
                ignored.note(format!("vertex attribute {name}"));
            }
        }
        let weights = if primitive.targets.is_empty() { Vec::new() } else { deform.weights.clone() };
        let bits =
            if weights.iter().all(|w| *w == 0.0) { Vec::new() } else { weights.iter().map(|w| w.to_bits()).collect() };
        // Targets are told apart by their accessors only where they are applied.
        if !bits.is_empty() {
            for (name, &accessor) in primitive.targets.iter().flatten() {
                attributes.push((name.clone(), accessor));
            }
        }
        let skin = deform.skin.as_ref().map(|s| s.0);
        let key = (attributes, reads.uv_sets, primitive.indices, primitive.mode, bits, skin, deform.animated);
        if let Some(&known) = self.cache.get(&key) {
            return Ok(known);
        }
        let built = match self.build(primitive, reads, deform, place, ignored)? {
            Some(data) => {
                let mesh = Mesh::new(data).map_err(|e| GltfError::invalid(place, e.to_string()))?;
                if let Some(source) = self.source.take() {
                    self.sources.insert(self.meshes.len(), source);
                }
                self.meshes.push(Arc::new(mesh));
                Some(self.meshes.len() - 1)
            }
            None => None,
        };
        self.cache.insert(key, built);
        Ok(built)
    }

    fn open(&self, index: u32, place: &str) -> Result<Accessor<'a>, GltfError> {
        Accessor::open(self.document, self.buffers, index, place)
    }

    fn build(
        &mut self,
        primitive: &Primitive,
        reads: Reads,
        deform: &Deform,
        place: &str,
        ignored: &mut Ignored,
    ) -> Result<Option<MeshData>, GltfError> {
        let mode = match primitive.mode {
            0 => "POINTS",
            1 => "LINES",
            2 => "LINE_LOOP",
            3 => "LINE_STRIP",
            4..=6 => "",
            other => return Err(GltfError::invalid(place, format!("primitive mode {other} does not exist"))),
        };
        let Some(&position) = primitive.attributes.get("POSITION") else {
            ignored.note("primitives without POSITION");
            return Ok(None);
        };
        let draco = "KHR_draco_mesh_compression";
        let def = item(&self.document.accessors, position, "accessor", place)?;
        if has_extension(&primitive.extensions, draco) && def.buffer_view.is_none() {
            return Err(GltfError::Extension(draco.into()));
        }
        let positions = self.open(position, place)?;
        if positions.components != 3 {
            return Err(GltfError::invalid(place, "POSITION is not VEC3"));
        }
        within("vertices", positions.count as u64, self.limits.vertices)?;

        let corners = Corners::open(self, primitive, positions.count, place)?;
        if !mode.is_empty() {
            // Not drawn, but a broken file is a broken file. Walking it counts as work.
            self.triangles += corners.count as u64;
            within("triangles", self.triangles, self.limits.triangles)?;
            (0..corners.count).try_for_each(|i| corners.vertex(i, place).map(drop))?;
            ignored.note(format!("{mode} primitives"));
            return Ok(None);
        }

        // Triangles, by the file's vertex numbers.
        let count = corners.triangle_count(primitive.mode);
        self.triangles += count as u64;
        within("triangles", self.triangles, self.limits.triangles)?;
        if primitive.mode == 4 && corners.count % 3 != 0 {
            ignored.note("corners beyond the last whole triangle");
        }
        let mut triangles = Vec::with_capacity(count);
        for t in 0..count {
            let [a, b, c] = corners_of(primitive.mode, t);
            triangles.push([corners.vertex(a, place)?, corners.vertex(b, place)?, corners.vertex(c, place)?]);
        }
        let kept = compact(&mut triangles, positions.count);
        let flat = !primitive.attributes.contains_key("NORMAL");
        self.vertices += if flat { 3 * count as u64 } else { kept.len() as u64 };
        // A short file can name one large morph target many times over.
        let targets = primitive.targets.iter().zip(&deform.weights).filter(|(_, w)| **w != 0.0).count();
        self.vertices = self.vertices.saturating_add(targets as u64 * kept.len() as u64);
        within("vertices", self.vertices, self.limits.vertices)?;

        let mut data = MeshData { triangles, ..Default::default() };
        data.positions = kept.iter().map(|&v| Vec3::from(positions.read(v as usize, [0.0; 3]))).collect();
        let attribute = |name: &str, components: std::ops::RangeInclusive<usize>| -> Result<_, GltfError> {
            let Some(&index) = primitive.attributes.get(name) else {
                return Ok(None);
            };
            let accessor = self.open(index, place)?;
            if accessor.count != positions.count {
                let why = format!("{name} has {} elements for {} positions", accessor.count, positions.count);
                return Err(GltfError::invalid(place, why));
            }
            if !components.contains(&accessor.components) {
                return Err(GltfError::invalid(place, format!("{name} has {} components", accessor.components)));
            }
            Ok(Some(accessor))
        };
        if let Some(a) = attribute("NORMAL", 3..=3)? {
            data.normals = kept.iter().map(|&v| Vec3::from(a.read(v as usize, [0.0; 3]))).collect();
        }
        let uv = |a: Accessor| -> Vec<Vec2> {
            let finite = |v: Vec2| if v.is_finite() { v } else { Vec2::ZERO };
            kept.iter().map(|&v| finite(Vec2::from(a.read(v as usize, [0.0; 2])))).collect()
        };
        let [first, second] = reads.uv_sets.map(|n| format!("TEXCOORD_{n}"));
        data.uvs = attribute(&first, 2..=2)?.map_or_else(Vec::new, uv);
        data.uvs1 = attribute(&second, 2..=2)?.map_or_else(Vec::new, uv);
        // Frames without normals mean nothing: flat ones are computed, and with them the frames.
        if reads.tangents
            && !flat
            && let Some(a) = attribute("TANGENT", 4..=4)?
        {
            let usable = |t: Vec4| if t.is_finite() { t } else { Vec4::ZERO };
            data.tangents = kept.iter().map(|&v| usable(Vec4::from(a.read(v as usize, [0.0; 4])))).collect();
        }
        if let Some(a) = attribute("COLOR_0", 3..=4)? {
            let a = a.force_normalized();
            let unit = |x: f32| if x > 0.0 { x.min(1.0) } else { 0.0 };
            data.colors = kept.iter().map(|&v| Vec4::from(a.read(v as usize, [1.0; 4]).map(unit))).collect();
        }
        let held_by = match &deform.skin {
            Some((skin, _)) => match (attribute("JOINTS_0", 4..=4)?, attribute("WEIGHTS_0", 4..=4)?) {
                (Some(j), Some(w)) => Some((j, w)),
                _ => return Err(GltfError::invalid(place, format!("skin {skin} needs JOINTS_0 and WEIGHTS_0"))),
            },
            None => None,
        };
        self.source = match deform.animated {
            Some(_) => Some(self.keep(primitive, deform, &kept, &data, positions.count, place)?),
            None => None,
        };
        self.morph(primitive, deform, &kept, &mut data, positions.count, place)?;
        if let (Some((_, joints)), Some((j, w))) = (&deform.skin, &held_by) {
            pose(&mut data, &kept, joints, j, w, place)?;
        }
        let limit = self.limits.coordinate;
        if let Some(v) = data.positions.iter().position(|p| !p.is_finite() || p.abs().max_element() > limit) {
            let why =
                format!("position of vertex {} is {:?}, the limit is {limit} m", kept[v], data.positions[v].to_array());
            return Err(GltfError::invalid(place, why));
        }
        mend_normals(&mut data, ignored);
        Ok(Some(data))
    }

    /// Everything that the mesh is posed from.
    fn keep(
        &mut self,
        primitive: &Primitive,
        deform: &Deform,
        kept: &[u32],
        data: &MeshData,
        count: usize,
        place: &str,
    ) -> Result<Deformation, GltfError> {
        self.vertices = self.vertices.saturating_add((primitive.targets.len() as u64 + 2) * kept.len() as u64);
        within("vertices", self.vertices, self.limits.vertices)?;
        let mut out = Deformation { data: data.clone(), ..Default::default() };
        for target in &primitive.targets {
            let read = |name: &str| -> Result<Vec<Vec3>, GltfError> {
                let Some(&index) = target.get(name) else { return Ok(Vec::new()) };
                let a = self.open(index, place)?;
                if a.count != count || a.components != 3 {
                    return Err(GltfError::invalid(place, format!("a morph target's {name} does not fit the mesh")));
                }
                Ok(kept.iter().map(|&v| Vec3::from(a.read(v as usize, [0.0; 3]))).collect())
            };
            out.targets.push((read("POSITION")?, read("NORMAL")?));
        }
        if let (Some(_), Some(&j), Some(&w)) =
            (&deform.skin, primitive.attributes.get("JOINTS_0"), primitive.attributes.get("WEIGHTS_0"))
        {
            let (j, w) = (self.open(j, place)?, self.open(w, place)?);
            // Checked in full where the pose of the file is made.
            if j.is_index_type() && j.count == count && w.count == count {
                out.joints = kept.iter().map(|&v| j.read_joints(v as usize)).collect();
                out.weights = kept.iter().map(|&v| w.read(v as usize, [0.0; 4])).collect();
            }
        }
        Ok(out)
    }

    /// Adds weighted morph targets.
    fn morph(
        &self,
        primitive: &Primitive,
        deform: &Deform,
        kept: &[u32],
        data: &mut MeshData,
        count: usize,
        place: &str,
    ) -> Result<(), GltfError> {
        for (target, &weight) in primitive.targets.iter().zip(&deform.weights) {
            if weight == 0.0 {
                continue;
            }
            for (name, values) in [("POSITION", &mut data.positions), ("NORMAL", &mut data.normals)] {
                let Some(&index) = target.get(name) else { continue };
                let a = self.open(index, place)?;
                if a.count != count || a.components != 3 {
                    return Err(GltfError::invalid(place, format!("a morph target's {name} does not fit the mesh")));
                }
                for (value, &v) in values.iter_mut().zip(kept) {
                    *value += Vec3::from(a.read(v as usize, [0.0; 3])) * weight;
                }
            }
            if let (Some(&index), false) = (target.get("TANGENT"), data.tangents.is_empty()) {
                let a = self.open(index, place)?;
                if a.count != count || a.components != 3 {
                    return Err(GltfError::invalid(place, "a morph target's TANGENT does not fit the mesh"));
                }
                for (value, &v) in data.tangents.iter_mut().zip(kept) {
                    let delta = Vec3::from(a.read(v as usize, [0.0; 3])) * weight;
                    *value += if delta.is_finite() { delta.extend(0.0) } else { Vec4::ZERO };
                }
            }
        }
        Ok(())
    }
}

/// Renumbers vertices so that only used ones remain; returns their old numbers, ascending. Time and memory follow the
/// smaller of triangles and vertices: many small primitives may share one huge vertex buffer.
fn compact(triangles: &mut [[u32; 3]], vertices: usize) -> Vec<u32> {
    if triangles.len() >= vertices / 16 {
        let mut new_of = vec![u32::MAX; vertices];
        triangles.iter().flatten().for_each(|&v| new_of[v as usize] = 0);
        let mut kept = Vec::new();
        for (old, new) in new_of.iter_mut().enumerate().filter(|(_, n)| **n == 0) {
            *new = kept.len() as u32;
            kept.push(old as u32);
        }
        triangles.iter_mut().flatten().for_each(|v| *v = new_of[*v as usize]);
        return kept;
    }
    let mut kept: Vec<u32> = triangles.iter().flatten().copied().collect();
    kept.sort_unstable();
    kept.dedup();
    for v in triangles.iter_mut().flatten() {
        *v = kept.partition_point(|k| k < v) as u32;
    }
    kept
}

/// Linear blend skinning into world space.
fn pose(
    data: &mut MeshData,
    kept: &[u32],
    joints: &[Affine3],
    j: &Accessor,
    w: &Accessor,
    place: &str,
) -> Result<(), GltfError> {
    if !j.is_index_type() {
        return Err(GltfError::invalid(place, "JOINTS_0 must hold unsigned integers"));
    }
    for (i, &v) in kept.iter().enumerate() {
        let weights = w.read(v as usize, [0.0; 4]);
        let total: f32 = weights.iter().sum();
        let mut sum = Affine3 { matrix3: Mat3::ZERO, translation: Vec3::ZERO };
        for (joint, weight) in j.read_joints(v as usize).into_iter().zip(weights) {
            if weight == 0.0 {
                continue;
            }
            let Some(m) = joints.get(joint as usize) else {
                let why = format!("vertex {v} names joint {joint}, but the skin has {}", joints.len());
                return Err(GltfError::invalid(place, why));
            };
            let weight = if total > 0.0 { weight / total } else { 0.0 };
            sum.matrix3 += m.matrix3 * weight;
            sum.translation += m.translation * weight;
        }
        if total > 0.0 {
            data.positions[i] = sum.transform_point3(data.positions[i]);
            if let Some(n) = data.normals.get_mut(i) {
                *n = cofactor(sum.matrix3) * *n;
            }
            if let Some(t) = data.tangents.get_mut(i) {
                *t = (sum.matrix3 * t.truncate()).extend(t.w);
            }
        }
    }
    Ok(())
}

/// The corner list of a primitive: an index accessor, or the vertices in their order.
struct Corners<'a> {
    indices: Option<Accessor<'a>>,
    count: usize,
    vertices: usize,
}

impl<'a> Corners<'a> {
    fn open(g: &Geometry<'a>, primitive: &Primitive, vertices: usize, place: &str) -> Result<Self, GltfError> {
        let Some(index) = primitive.indices else {
            return Ok(Self { indices: None, count: vertices, vertices });
        };
        let indices = g.open(index, place)?;
        if indices.components != 1 || !indices.is_index_type() {
            return Err(GltfError::invalid(place, "indices must be unsigned integer scalars"));
        }
        Ok(Self { count: indices.count, indices: Some(indices), vertices })
    }

    fn triangle_count(&self, mode: u32) -> usize {
        if mode == 4 { self.count / 3 } else { self.count.saturating_sub(2) }
    }

    fn vertex(&self, corner: usize, place: &str) -> Result<u32, GltfError> {
        let Some(a) = &self.indices else {
            return Ok(corner as u32);
        };
        let v = a.read_index(corner);
        if v == a.restart_value() {
            return Err(GltfError::invalid(
                place,
                format!("index {corner} is {v}, which glTF forbids (primitive restart)"),
            ));
        }
        if v as usize >= self.vertices {
            return Err(GltfError::invalid(
                place,
                format!("index {corner} names vertex {v}, but there are {}", self.vertices),
            ));
        }
        Ok(v)
    }
}

/// Places in the corner list of triangle `t`: list, strip, fan, wound as glTF 2.0 section 3.7.2.1 says.
fn corners_of(mode: u32, t: usize) -> [usize; 3] {
    match mode {
        5 => [t, t + 1 + t % 2, t + 2 - t % 2],
        6 => [t + 1, t + 2, 0],
        _ => [3 * t, 3 * t + 1, 3 * t + 2],
    }
}

/// Makes every normal a unit vector; one that has no direction becomes the mean of its triangles' own.
fn mend_normals(data: &mut MeshData, ignored: &mut Ignored) {
    let mut broken = Vec::new();
    for (i, n) in data.normals.iter_mut().enumerate() {
        let length_squared = n.length_squared();
        if (length_squared - 1.0).abs() <= 1e-5 {
            continue; // Left as it is, so that what we wrote comes back bit for bit.
        }
        match n.try_normalize() {
            Some(unit) => *n = unit,
            None => broken.push(i),
        }
    }
    if broken.is_empty() {
        return;
    }
    let mut sum = vec![Vec3::ZERO; data.positions.len()];
    for t in &data.triangles {
        let [a, b, c] = t.map(|v| data.positions[v as usize]);
        let n = (b - a).cross(c - a).normalize_or_zero();
        t.iter().for_each(|&v| sum[v as usize] += n);
    }
    ignored.note("meshes with normals of no direction (taken from the triangles)");
    for i in broken {
        data.normals[i] = sum[i].normalize_or(Vec3::Y);
    }
}
