//! The JSON of a glTF file, as far as this renderer reads it. Unknown fields are skipped; numbers stay unchecked here.

use super::error::GltfError;
use serde::{Deserialize, de::DeserializeOwned};
use serde_json::{Map, Value};
use std::collections::BTreeMap;

/// `extensions` object of any element.
pub(super) type Extensions = Option<Map<String, Value>>;

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Document {
    pub asset: Asset,
    #[serde(default)]
    pub extensions_used: Vec<String>,
    #[serde(default)]
    pub extensions_required: Vec<String>,
    #[serde(default)]
    pub extensions: Extensions,
    pub scene: Option<u32>,
    #[serde(default)]
    pub scenes: Vec<Scene>,
    #[serde(default)]
    pub nodes: Vec<Node>,
    #[serde(default)]
    pub meshes: Vec<MeshDef>,
    #[serde(default)]
    pub skins: Vec<Skin>,
    #[serde(default)]
    pub animations: Vec<AnimationDef>,
    #[serde(default)]
    pub cameras: Vec<CameraDef>,
    #[serde(default)]
    pub materials: Vec<MaterialDef>,
    #[serde(default)]
    pub textures: Vec<TextureDef>,
    #[serde(default)]
    pub images: Vec<ImageDef>,
    #[serde(default)]
    pub samplers: Vec<SamplerDef>,
    #[serde(default)]
    pub accessors: Vec<AccessorDef>,
    #[serde(default)]
    pub buffer_views: Vec<BufferView>,
    #[serde(default)]
    pub buffers: Vec<BufferDef>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Asset {
    pub version: String,
    pub min_version: Option<String>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Scene {
    #[serde(default)]
    pub nodes: Vec<u32>,
    pub extras: Option<Value>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Node {
    pub name: Option<String>,
    #[serde(default)]
    pub children: Vec<u32>,
    pub mesh: Option<u32>,
    pub camera: Option<u32>,
    pub skin: Option<u32>,
    pub matrix: Option<[f32; 16]>,
    pub translation: Option<[f32; 3]>,
    pub rotation: Option<[f32; 4]>,
    pub scale: Option<[f32; 3]>,
    pub weights: Option<Vec<f32>>,
    #[serde(default)]
    pub extensions: Extensions,
}

#[derive(Debug, Deserialize)]
pub(super) struct MeshDef {
    pub primitives: Vec<Primitive>,
    pub weights: Option<Vec<f32>>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Primitive {
    #[serde(default)]
    pub attributes: BTreeMap<String, u32>,
    pub indices: Option<u32>,
    pub material: Option<u32>,
    #[serde(default = "triangles")]
    pub mode: u32,
    #[serde(default)]
    pub targets: Vec<BTreeMap<String, u32>>,
    #[serde(default)]
    pub extensions: Extensions,
}

fn triangles() -> u32 {
    4
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Skin {
    pub inverse_bind_matrices: Option<u32>,
    #[serde(default)]
    pub joints: Vec<u32>,
}

#[derive(Debug, Deserialize)]
pub(super) struct AnimationDef {
    pub name: Option<String>,
    #[serde(default)]
    pub channels: Vec<ChannelDef>,
    #[serde(default)]
    pub samplers: Vec<AnimationSamplerDef>,
}

#[derive(Debug, Deserialize)]
pub(super) struct ChannelDef {
    pub sampler: u32,
    pub target: TargetDef,
}

#[derive(Debug, Deserialize)]
pub(super) struct TargetDef {
    pub node: Option<u32>,
    pub path: String,
}

#[derive(Debug, Deserialize)]
pub(super) struct AnimationSamplerDef {
    pub input: u32,
    pub output: u32,
    pub interpolation: Option<String>,
}

#[derive(Debug, Deserialize)]
pub(super) struct CameraDef {
    #[serde(rename = "type")]
    pub kind: String,
    pub perspective: Option<Perspective>,
    pub orthographic: Option<Orthographic>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Perspective {
    pub yfov: f32,
    pub znear: f32,
}

#[derive(Debug, Deserialize)]
pub(super) struct Orthographic {
    pub ymag: f32,
    pub znear: f32,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct MaterialDef {
    pub name: Option<String>,
    pub pbr_metallic_roughness: Pbr,
    pub normal_texture: Option<NormalTextureInfo>,
    pub occlusion_texture: Option<serde::de::IgnoredAny>,
    pub emissive_texture: Option<TextureInfo>,
    pub emissive_factor: Option<[f32; 3]>,
    pub alpha_mode: Option<String>,
    pub alpha_cutoff: Option<f32>,
    pub extensions: Extensions,
    pub extras: Option<Value>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct Pbr {
    pub base_color_factor: Option<[f32; 4]>,
    pub base_color_texture: Option<TextureInfo>,
    pub metallic_factor: Option<f32>,
    pub roughness_factor: Option<f32>,
    pub metallic_roughness_texture: Option<TextureInfo>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct TextureInfo {
    pub index: u32,
    #[serde(default)]
    pub tex_coord: u32,
    #[serde(default)]
    pub extensions: Extensions,
}

/// A [`TextureInfo`] with a factor.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct NormalTextureInfo {
    pub index: u32,
    #[serde(default)]
    pub tex_coord: u32,
    pub scale: Option<f32>,
    #[serde(default)]
    pub extensions: Extensions,
}

impl NormalTextureInfo {
    pub fn info(&self) -> TextureInfo {
        TextureInfo { index: self.index, tex_coord: self.tex_coord, extensions: self.extensions.clone() }
    }
}

#[derive(Debug, Deserialize)]
pub(super) struct TextureDef {
    pub sampler: Option<u32>,
    pub source: Option<u32>,
    #[serde(default)]
    pub extensions: Extensions,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct ImageDef {
    pub uri: Option<String>,
    pub buffer_view: Option<u32>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct SamplerDef {
    pub mag_filter: Option<u32>,
    pub min_filter: Option<u32>,
    pub wrap_s: Option<u32>,
    pub wrap_t: Option<u32>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct AccessorDef {
    pub buffer_view: Option<u32>,
    #[serde(default)]
    pub byte_offset: u64,
    pub count: u64,
    pub component_type: u32,
    #[serde(rename = "type")]
    pub kind: String,
    #[serde(default)]
    pub normalized: bool,
    pub sparse: Option<SparseDef>,
}

#[derive(Debug, Deserialize)]
pub(super) struct SparseDef {
    pub count: u64,
    pub indices: SparseIndices,
    pub values: SparseValues,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseIndices {
    pub buffer_view: u32,
    #[serde(default)]
    pub byte_offset: u64,
    pub component_type: u32,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseValues {
    pub buffer_view: u32,
    #[serde(default)]
    pub byte_offset: u64,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub buffer: u32,
    #[serde(default)]
    pub byte_offset: u64,
    pub byte_length: u64,
    pub byte_stride: Option<u64>,
    #[serde(default)]
    pub extensions: Extensions,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferDef {
    pub uri: Option<String>,
    pub byte_length: u64,
}

/// Element `index` of `list`, or an error that names both.
pub(super) fn item<'a, T>(list: &'a [T], index: u32, what: &str, place: &str) -> Result<&'a T, GltfError> {
    list.get(index as usize)
        .ok_or_else(|| GltfError::invalid(place, format!("names {what} {index}, but there are {}", list.len())))
}

/// Extension `name` of an element, read as `T`; `None` where it is absent.
pub(super) fn extension<T: DeserializeOwned>(
    extensions: &Extensions,
    name: &str,
    place: &str,
) -> Result<Option<T>, GltfError> {
    let Some(value) = extensions.as_ref().and_then(|e| e.get(name)) else {
        return Ok(None);
    };
    T::deserialize(value).map(Some).map_err(|e| GltfError::invalid(format!("{place}, {name}"), e.to_string()))
}

/// True where an element carries extension `name`.
pub(super) fn has_extension(extensions: &Extensions, name: &str) -> bool {
    extensions.as_ref().is_some_and(|e| e.contains_key(name))
}

/// Our own field `catoptra` of an `extras` value.
pub(super) fn own_extras(extras: &Option<Value>) -> Option<&Map<String, Value>> {
    extras.as_ref()?.get("catoptra")?.as_object()
}
