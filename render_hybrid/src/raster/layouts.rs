//! What the GPU reads, byte for byte, and how it is made from the engine's types. WGSL side: `shaders/shared/scene.wgsl` and
//! the passes' uniforms; the test below holds names, offsets and sizes together.

use bytemuck::{Pod, Zeroable};
use catoptra_engine::{
    Light, LightKind, Material, Mesh, Mip, Physical, Projection, RenderScene, Texture, TextureRef,
    glam::{Affine3, Mat3, Vec3},
};

use crate::twin::{shadow::ShadowPlan, vpl::Vpl};

pub(crate) const TEXTURE_NEAREST: u32 = 1;
pub(crate) const TEXTURE_SRGB: u32 = 2;
pub(crate) const TEXTURE_UV1: u32 = 4;
pub(crate) const TEXTURE_NEAREST_MIN: u32 = 8;
pub(crate) const TEXTURE_MIP_NEAREST: u32 = 16;
pub(crate) const TEXTURE_MIP_LINEAR: u32 = 32;
pub(crate) const PHYSICAL: u32 = 1;
pub(crate) const PHYSICAL_BLENDED: u32 = 2;
pub(crate) const PHYSICAL_REFLECTANCE: u32 = 4;
pub(crate) const PHYSICAL_BY_REFLECTANCE: u32 = 8;
pub(crate) const NO_TEXTURE: u32 = u32::MAX;
/// A material's textures, in the order of [`texture_slots`].
pub(crate) const SLOTS: [&str; 7] =
    ["BASE_COLOR", "EMISSIVE", "NORMAL", "METALLIC_ROUGHNESS", "TRANSMISSION", "REFLECTANCE", "REFLECTANCE_STRENGTH"];
pub(crate) const LIGHT_POINT: u32 = 0;
pub(crate) const LIGHT_SPOT: u32 = 1;
pub(crate) const LIGHT_DIRECTIONAL: u32 = 2;
pub(crate) const VISIBILITY_NONE: u32 = 0;
pub(crate) const VISIBILITY_MOMENTS: u32 = 1;
pub(crate) const VISIBILITY_PLANES: u32 = 2;

/// Numbers a vertex in the attribute heap: normal, two texture coordinate sets, colour, alpha, tangent and its
/// handedness (0 without).
pub(crate) const ATTRIBUTE_STRIDE: u32 = 15;
pub(crate) const ATTRIBUTE_NORMAL: u32 = 0;
pub(crate) const ATTRIBUTE_UV0: u32 = 3;
pub(crate) const ATTRIBUTE_UV1: u32 = 5;
pub(crate) const ATTRIBUTE_COLOR: u32 = 7;
pub(crate) const ATTRIBUTE_ALPHA: u32 = 10;
pub(crate) const ATTRIBUTE_TANGENT: u32 = 11;
pub(crate) const ATTRIBUTE_HANDEDNESS: u32 = 14;

/// What the layer pass unpacks from the G-buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub(crate) enum PackedLayer {
    Mask = 0,
    Depth = 1,
    Normal = 2,
    NormalGeometric = 3,
    NormalShading = 4,
    Albedo = 5,
}

pub(crate) const PACKED_LAYERS: &[(&str, PackedLayer)] = &[
    ("LAYER_MASK", PackedLayer::Mask),
    ("LAYER_DEPTH", PackedLayer::Depth),
    ("LAYER_NORMAL", PackedLayer::Normal),
    ("LAYER_NORMAL_GEOMETRIC", PackedLayer::NormalGeometric),
    ("LAYER_NORMAL_SHADING", PackedLayer::NormalShading),
    ("LAYER_ALBEDO", PackedLayer::Albedo),
];

#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct FrameData {
    pub orthographic: u32,
    pub light_count: u32,
    pub size: [u32; 2],
    pub eye_world: Vec3,
    pub near: f32,
    pub right_world: Vec3,
    pub half_width: f32,
    pub up_world: Vec3,
    pub half_height: f32,
    pub forward_world: Vec3,
    pub far: f32,
    pub background: Vec3,
    pub unused0: u32,
    pub ambient: Vec3,
    pub unused1: u32,
}

impl FrameData {
    pub fn new(scene: &RenderScene, width: u32, height: u32) -> Self {
        let camera = &scene.camera;
        let pose = &camera.world_from_view;
        let (half_width, half_height) = camera.half_extent(width, height);
        let forward_world = -pose.matrix3.z_axis;
        let bounds = scene.bounds_world();
        let farthest = if bounds.is_empty() {
            1.0
        } else {
            bounds.corners().iter().map(|c| forward_world.dot(*c - pose.translation)).fold(0.0f32, f32::max)
        };
        Self {
            orthographic: u32::from(matches!(camera.projection, Projection::Orthographic { .. })),
            light_count: scene.lights.len() as u32,
            size: [width, height],
            eye_world: pose.translation,
            // Reversed floating-point depth keeps its relative precision at any near plane, but not at none.
            near: camera.near.max(f32::MIN_POSITIVE * 1e12).max(bounds.radius().min(1.0) * 1e-9),
            right_world: pose.matrix3.x_axis,
            half_width,
            up_world: pose.matrix3.y_axis,
            half_height,
            forward_world,
            far: (farthest * 1.01).max(camera.near * 1.01).max(f32::MIN_POSITIVE * 1e13),
            background: scene.environment.background,
            unused0: 0,
            ambient: scene.environment.ambient,
            unused1: 0,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct InstanceData {
    pub world_row0: [f32; 4],
    pub world_row1: [f32; 4],
    pub world_row2: [f32; 4],
    pub normal_row0: Vec3,
    pub first_index: u32,
    pub normal_row1: Vec3,
    pub first_vertex: u32,
    pub normal_row2: Vec3,
    pub material: u32,
}

impl InstanceData {
    pub fn new(world_from_object: &Affine3, first_index: u32, first_vertex: u32, material: u32) -> Self {
        let (m, t) = (world_from_object.matrix3, world_from_object.translation);
        let row = |i: usize| [m.x_axis[i], m.y_axis[i], m.z_axis[i], t[i]];
        let n = normal_from_object(m).transpose();
        Self {
            world_row0: row(0),
            world_row1: row(1),
            world_row2: row(2),
            normal_row0: n.x_axis,
            first_index,
            normal_row1: n.y_axis,
            first_vertex,
            normal_row2: n.z_axis,
            material,
        }
    }
}

/// Cofactor matrix with the determinant's sign, of a matrix scaled to unit size so that no scale leaves f32's range.
fn normal_from_object(m: Mat3) -> Mat3 {
    let size = m.x_axis.abs().max(m.y_axis.abs()).max(m.z_axis.abs()).max_element();
    let m = if size > 0.0 { m * (1.0 / size) } else { m };
    let c = Mat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
    if m.x_axis.dot(c.x_axis) < 0.0 { c * -1.0 } else { c }
}

#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct TextureRefData {
    pub uv_row0: Vec3,
    pub width: u32,
    pub uv_row1: Vec3,
    pub height: u32,
    pub first_texel: u32,
    pub wrap_u: u32,
    pub wrap_v: u32,
    pub flags: u32,
}

impl TextureRefData {
    const NONE: Self = Self {
        uv_row0: Vec3::ZERO,
        width: 1,
        uv_row1: Vec3::ZERO,
        height: 1,
        first_texel: NO_TEXTURE,
        wrap_u: 0,
        wrap_v: 0,
        flags: 0,
    };

    pub fn new(r: &TextureRef, texture: &Texture, first_texel: u32) -> Self {
        let flag = |on: bool, bit: u32| if on { bit } else { 0 };
        Self {
            uv_row0: r.uv_transform[0].into(),
            width: texture.width(),
            uv_row1: r.uv_transform[1].into(),
            height: texture.height(),
            first_texel,
            wrap_u: r.wrap[0] as u32,
            wrap_v: r.wrap[1] as u32,
            flags: flag(r.nearest, TEXTURE_NEAREST)
                | flag(texture.srgb(), TEXTURE_SRGB)
                | flag(r.uv_set == 1, TEXTURE_UV1)
                | flag(r.nearest_min, TEXTURE_NEAREST_MIN)
                | flag(r.mip == Mip::Nearest, TEXTURE_MIP_NEAREST)
                | flag(r.mip == Mip::Linear, TEXTURE_MIP_LINEAR),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct MaterialData {
    pub base_color: Vec3,
    pub diffuse: f32,
    pub specular: Vec3,
    pub shininess: f32,
    pub emissive: Vec3,
    pub ambient: f32,
    pub mirror: f32,
    pub transmission: f32,
    pub unlit: u32,
    pub alpha_cutoff: f32,
    pub base_color_texture: TextureRefData,
    pub emissive_texture: TextureRefData,
    pub normal_texture: TextureRefData,
    pub normal_scale: f32,
    pub alpha: f32,
    pub metallic: f32,
    pub roughness: f32,
    pub metallic_roughness_texture: TextureRefData,
    pub transmission_texture: TextureRefData,
    pub reflectance: Vec3,
    pub physical: u32,
    pub physical_transmission: f32,
    pub texture_slots: u32,
    pub unused1: u32,
    pub unused2: u32,
    pub reflectance_texture: TextureRefData,
    pub reflectance_strength_texture: TextureRefData,
}

impl MaterialData {
    /// * `first_texel`: place of each of the scene's textures in the heap
    pub fn new(m: &Material, scene: &RenderScene, first_texel: &[u32]) -> Self {
        let texture = |r: &Option<TextureRef>| match r {
            Some(r) => TextureRefData::new(r, &scene.textures[r.texture as usize], first_texel[r.texture as usize]),
            None => TextureRefData::NONE,
        };
        let p = m.physical;
        Self {
            base_color: m.base_color,
            diffuse: m.diffuse,
            specular: m.specular,
            shininess: m.shininess,
            emissive: m.emissive,
            ambient: m.ambient,
            mirror: m.mirror,
            transmission: m.transmission,
            unlit: u32::from(m.unlit),
            alpha_cutoff: m.alpha_cutoff,
            base_color_texture: texture(&m.base_color_texture),
            emissive_texture: texture(&m.emissive_texture),
            normal_texture: texture(&m.normal_texture),
            normal_scale: m.normal_scale,
            alpha: m.alpha,
            metallic: p.map_or(0.0, |p| p.metallic),
            roughness: p.map_or(0.0, |p| p.roughness),
            metallic_roughness_texture: texture(&p.and_then(|p| p.metallic_roughness_texture)),
            transmission_texture: texture(&p.and_then(|p| p.transmission_texture)),
            reflectance: p.map_or(Vec3::ZERO, |p| p.reflectance),
            physical: p.map_or(0, physical_flags),
            physical_transmission: p.map_or(0.0, |p| p.transmission),
            texture_slots: texture_slots(m),
            unused1: 0,
            unused2: 0,
            reflectance_texture: texture(&p.and_then(|p| p.reflectance_texture)),
            reflectance_strength_texture: texture(&p.and_then(|p| p.reflectance_strength_texture)),
        }
    }
}

/// Bit s: the material has texture s of [`SLOTS`].
fn texture_slots(m: &Material) -> u32 {
    let p = m.physical;
    let there = [
        m.base_color_texture.is_some(),
        m.emissive_texture.is_some(),
        m.normal_texture.is_some(),
        p.is_some_and(|p| p.metallic_roughness_texture.is_some()),
        p.is_some_and(|p| p.transmission_texture.is_some()),
        p.is_some_and(|p| p.reflectance_texture.is_some()),
        p.is_some_and(|p| p.reflectance_strength_texture.is_some()),
    ];
    there.iter().enumerate().map(|(s, there)| u32::from(*there) << s).sum()
}

fn physical_flags(p: Physical) -> u32 {
    let flag = |on: bool, bit: u32| if on { bit } else { 0 };
    let varies = p.reflectance_texture.is_some() || p.reflectance_strength_texture.is_some();
    PHYSICAL
        | flag(p.blended, PHYSICAL_BLENDED)
        | flag(varies, PHYSICAL_REFLECTANCE)
        | flag(p.by_reflectance, PHYSICAL_BY_REFLECTANCE)
}

#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct LightData {
    pub position_world: Vec3,
    pub kind: u32,
    pub direction_world: Vec3,
    pub cos_inner: f32,
    pub intensity: Vec3,
    pub cos_outer: f32,
    pub first_view: u32,
    pub view_count: u32,
    pub first_layer: u32,
    pub unused: u32,
}

impl LightData {
    /// * `first_layer`: layer of the light's first view in its texture array
    pub fn new(light: &Light, index: usize, plan: &ShadowPlan, first_layer: u32) -> Self {
        let (kind, cos_inner, cos_outer) = match light.kind {
            LightKind::Point => (LIGHT_POINT, 1.0, -1.0),
            LightKind::Spot { cos_inner, cos_outer } => (LIGHT_SPOT, cos_inner, cos_outer),
            LightKind::Directional => (LIGHT_DIRECTIONAL, 1.0, -1.0),
        };
        let maps = plan.lights.get(index);
        Self {
            position_world: light.position_world,
            kind,
            direction_world: light.direction_world,
            cos_inner,
            intensity: light.intensity,
            cos_outer,
            first_view: maps.map_or(0, |m| m.first),
            view_count: maps.map_or(0, |m| m.count),
            first_layer,
            unused: 0,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct VplData {
    pub position_world: Vec3,
    pub error: f32,
    pub normal_world: Vec3,
    pub map: u32,
    pub flux: Vec3,
    pub unused2: f32,
}

impl VplData {
    /// * `map`: row of its shadow map
    pub fn new(v: &Vpl, map: u32) -> Self {
        Self {
            position_world: v.position_world,
            error: v.error,
            normal_world: v.normal_world,
            map,
            flux: v.flux,
            unused2: 0.0,
        }
    }
}

/// Head of the indirect pass's uniform; the VPLs follow.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct IndirectHead {
    pub count: u32,
    pub first: u32,
    pub geometry_term_max: f32,
    pub map_size: u32,
    pub all: u32,
    pub interleave: u32,
    pub unused0: u32,
    pub unused1: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct SubsetUniform {
    pub k: u32,
    pub unused0: u32,
    pub unused1: u32,
    pub unused2: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct InterleaveUniform {
    pub n: u32,
    pub unused0: u32,
    pub unused1: u32,
    pub unused2: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct GridUniform {
    pub size: [u32; 2],
    pub spacing: u32,
    pub adds: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct DirectUniform {
    pub visibility: u32,
    pub min_variance: f32,
    pub light_bleed_reduction: f32,
    pub evsm: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct TracedPixel {
    pub radiance: [f32; 3],
    pub pixel: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct PresentUniform {
    pub exposure: f32,
    pub encode_srgb: u32,
    pub unused0: u32,
    pub unused1: u32,
}

/// Attributes of all vertices of a mesh, [`ATTRIBUTE_STRIDE`] numbers each. Missing texture coordinates are (0, 0), missing
/// colours white, as on the CPU.
pub(crate) fn attributes(mesh: &Mesh) -> Vec<f32> {
    let mut out = Vec::with_capacity(mesh.positions().len() * ATTRIBUTE_STRIDE as usize);
    let finite = |v: f32| if v.is_finite() { v } else { 0.0 };
    for i in 0..mesh.positions().len() {
        out.extend(mesh.normals().get(i).copied().unwrap_or(Vec3::ZERO).to_array().map(finite));
        out.extend(mesh.uvs().get(i).copied().unwrap_or_default().to_array().map(finite));
        out.extend(mesh.uvs1().get(i).copied().unwrap_or_default().to_array().map(finite));
        out.extend(mesh.colors().get(i).map_or(Vec3::ONE, |c| c.truncate()).to_array().map(finite));
        out.push(finite(mesh.colors().get(i).map_or(1.0, |c| c.w)));
        out.extend(mesh.tangents().get(i).map_or([0.0; 4], |t| t.to_array().map(finite)));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::twin::shadow::ShadowView;
    use std::mem::{offset_of, size_of};

    /// (name, offset) of every member and the size of a WGSL struct.
    fn wgsl_struct(pass: &str, name: &str) -> (Vec<(String, usize)>, usize) {
        let text = super::super::shader::stitch(pass);
        let module = naga::front::wgsl::parse_str(&text).unwrap_or_else(|e| panic!("{}", e.emit_to_string(&text)));
        for (_, t) in module.types.iter() {
            if let naga::TypeInner::Struct { members, span } = &t.inner
                && t.name.as_deref() == Some(name)
            {
                let members = members.iter().map(|m| (m.name.clone().unwrap_or_default(), m.offset as usize)).collect();
                return (members, *span as usize);
            }
        }
        panic!("{pass} has no struct {name}");
    }

    macro_rules! assert_layout {
        ($pass:literal, $wgsl:literal, $rust:ty, $($field:ident),+ $(,)?) => {{
            let (members, span) = wgsl_struct($pass, $wgsl);
            let expected = vec![$((stringify!($field).to_string(), offset_of!($rust, $field))),+];
            assert_eq!(members, expected, "{}", $wgsl);
            assert_eq!(span, size_of::<$rust>(), "size of {}", $wgsl);
        }};
    }

    #[test]
    fn layouts_agree_with_wgsl() {
        assert_layout!(
            "gbuffer",
            "Frame",
            FrameData,
            orthographic,
            light_count,
            size,
            eye_world,
            near,
            right_world,
            half_width,
            up_world,
            half_height,
            forward_world,
            far,
            background,
            unused0,
            ambient,
            unused1
        );
        assert_layout!(
            "gbuffer",
            "Instance",
            InstanceData,
            world_row0,
            world_row1,
            world_row2,
            normal_row0,
            first_index,
            normal_row1,
            first_vertex,
            normal_row2,
            material
        );
        assert_layout!(
            "gbuffer",
            "TextureRef",
            TextureRefData,
            uv_row0,
            width,
            uv_row1,
            height,
            first_texel,
            wrap_u,
            wrap_v,
            flags
        );
        assert_layout!(
            "gbuffer",
            "Material",
            MaterialData,
            base_color,
            diffuse,
            specular,
            shininess,
            emissive,
            ambient,
            mirror,
            transmission,
            unlit,
            alpha_cutoff,
            base_color_texture,
            emissive_texture,
            normal_texture,
            normal_scale,
            alpha,
            metallic,
            roughness,
            metallic_roughness_texture,
            transmission_texture,
            reflectance,
            physical,
            physical_transmission,
            texture_slots,
            unused1,
            unused2,
            reflectance_texture,
            reflectance_strength_texture
        );
        assert_layout!(
            "direct",
            "Light",
            LightData,
            position_world,
            kind,
            direction_world,
            cos_inner,
            intensity,
            cos_outer,
            first_view,
            view_count,
            first_layer,
            unused
        );
        assert_layout!(
            "direct",
            "ShadowView",
            ShadowView,
            origin_world,
            far,
            right_scaled,
            perspective,
            up_scaled,
            size,
            forward,
            softness
        );
        assert_layout!("direct", "DirectUniform", DirectUniform, visibility, min_variance, light_bleed_reduction, evsm);
        assert_layout!("indirect", "Vpl", VplData, position_world, error, normal_world, map, flux, unused2);
        assert_layout!("indirect", "GridUniform", GridUniform, size, spacing, adds);
        assert_layout!("indirect", "SubsetUniform", SubsetUniform, k, unused0, unused1, unused2);
        assert_layout!("interleave", "InterleaveUniform", InterleaveUniform, n, unused0, unused1, unused2);
        assert_layout!("traced_scatter", "TracedPixel", TracedPixel, radiance, pixel);
        assert_layout!("present", "PresentUniform", PresentUniform, exposure, encode_srgb, unused0, unused1);

        let (members, span) = wgsl_struct("indirect", "IndirectUniform");
        assert_eq!(members[0], ("count".into(), offset_of!(IndirectHead, count)));
        assert_eq!(members[1], ("first".into(), offset_of!(IndirectHead, first)));
        assert_eq!(members[2], ("geometry_term_max".into(), offset_of!(IndirectHead, geometry_term_max)));
        assert_eq!(members[3], ("map_size".into(), offset_of!(IndirectHead, map_size)));
        assert_eq!(members[4], ("all".into(), offset_of!(IndirectHead, all)));
        assert_eq!(members[5], ("interleave".into(), offset_of!(IndirectHead, interleave)));
        assert_eq!(members[8], ("vpls".into(), size_of::<IndirectHead>()));
        let chunk = super::super::shader::VPL_CHUNK as usize * size_of::<VplData>();
        assert_eq!(span, size_of::<IndirectHead>() + chunk);
    }
}
