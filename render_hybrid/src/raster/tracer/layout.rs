//! What the tracer reads, word for word of 16 bytes. WGSL side: `shaders/tracer/surface.wgsl` and `shade.wgsl`.

use catoptra_engine::{Light, Material, Mesh, RenderScene};
use glam::Affine3;

use crate::{
    accel::flat::{FlatInstance, NONE, Word},
    raster::layouts::{InstanceData, LightData, MaterialData},
    twin::shadow::{ShadowPlan, ShadowView},
};

pub(crate) const INSTANCE_WORDS: u32 = 12;
pub(crate) const INSTANCE_IDENTITY: u32 = 1;
pub(crate) const INSTANCE_CASTS_SHADOW: u32 = 2;
pub(crate) const INSTANCE_CUTOUT: u32 = 4;
/// The mesh encloses a volume.
pub(crate) const INSTANCE_CLOSED: u32 = 8;
pub(crate) const MATERIAL_WORDS: u32 = 30;
pub(crate) const MATERIAL_SCHLICK: u32 = 1;
pub(crate) const MATERIAL_THIN: u32 = 2;
pub(crate) const LIGHT_WORDS: u32 = 6;
pub(crate) const VIEW_WORDS: u32 = 4;
pub(crate) const VERTEX_WORDS: u32 = 5;

/// Head of the scene: where things lie.
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub(crate) struct SceneHead {
    pub tlas_root: u32,
    pub instances: u32,
    pub materials: u32,
    pub lights: u32,
    pub views: u32,
    pub traversal_cap: u32,
    pub extent: f32,
    pub slack: f32,
}

/// One frame's choices.
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub(crate) struct TraceUniform {
    pub max_depth: u32,
    pub min_weight: f32,
    pub ray_cap: u32,
    pub vpl_count: u32,
    pub geometry_term_max: f32,
    pub map_size: u32,
    pub visibility: u32,
    pub min_variance: f32,
    pub light_bleed_reduction: f32,
    pub evsm: u32,
    pub shadow_samples: u32,
    pub seed: u32,
}

/// Light paths of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub(crate) struct PhotonUniform {
    pub paths: u32,
    pub bounces: u32,
    pub slots_a_path: u32,
    pub samples: u32,
    pub starts: u32,
    pub unused0: u32,
    pub unused1: u32,
    pub unused2: u32,
}

/// Where their VPLs go.
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub(crate) struct PackUniform {
    pub slots: u32,
    pub slots_a_path: u32,
    pub interleave: u32,
    pub stride: u32,
    pub geometry_term_max: f32,
    pub chunks: u32,
    pub unused0: u32,
    pub unused1: u32,
}

/// Most rays that a pixel can have: a path of `depth` interfaces branches at each, and passes at most 4 · depth hidden ones
/// on the way. Above 2²⁴ the cap is no longer that bound; a pixel that meets it is counted.
pub(crate) fn ray_cap(depth: u32) -> u32 {
    let most = (2u64 << depth.min(40)) * u64::from(4 * depth + 1);
    most.min(1 << 24) as u32
}

/// Rays that wait at once at most: one a level of depth, and no more than log2(3 / min_weight) + 1, because of two siblings
/// the lesser goes first: it is worth at most half of what their parent was (sum of the channels), and rays below
/// `min_weight` (greatest channel) end.
pub(crate) fn waiting_rays(depth: u32, min_weight: f32) -> u32 {
    // 3 / min_weight < 2^k.
    let by_weight = (0..64u32).find(|k| f64::from(min_weight) * (1u64 << k.min(&62)) as f64 > 3.0).unwrap_or(64);
    depth.min(by_weight + 1)
}

/// Where a mesh's parts lie in the heaps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct MeshPlace {
    /// Root: node number (wide) or word (kd) in the node heap; [`NONE`] where there is nothing to hit.
    pub root: u32,
    /// Words in the geometry heap.
    pub first_index: u32,
    pub first_vertex: u32,
    /// Steps of a walk.
    pub steps: u64,
    /// Levels of wide nodes.
    pub levels: u32,
    pub closed: bool,
}

fn words<T: bytemuck::Pod>(value: &T) -> &[Word] {
    bytemuck::cast_slice(bytemuck::bytes_of(value))
}

fn word([x, y, z]: [f32; 3], w: u32) -> Word {
    [x.to_bits(), y.to_bits(), z.to_bits(), w]
}

/// * `bounds`: of the tree: least and greatest corner, greatest coordinate
pub(crate) fn instance_words(
    flat: &FlatInstance,
    place: &MeshPlace,
    bounds: ([f32; 3], [f32; 3], f32),
    world_from_object: &Affine3,
    material: u32,
) -> [Word; INSTANCE_WORDS as usize] {
    let flag = |on: bool, bit: u32| if on { bit } else { 0 };
    let flags = flag(flat.identity, INSTANCE_IDENTITY)
        | flag(flat.casts_shadow, INSTANCE_CASTS_SHADOW)
        | flag(flat.cutout, INSTANCE_CUTOUT)
        | flag(place.closed, INSTANCE_CLOSED);
    let data = InstanceData::new(world_from_object, place.first_index, place.first_vertex, material);
    let mut out = [[0; 4]; INSTANCE_WORDS as usize];
    out[0] = word(flat.inverse[0], place.root);
    out[1] = word(flat.inverse[1], bounds.2.to_bits());
    out[2] = word(flat.inverse[2], 0);
    out[3] = word(flat.translation, flags);
    out[4..10].copy_from_slice(words(&data));
    out[10] = word(bounds.0, place.steps.min(u64::from(u32::MAX)) as u32);
    out[11] = word(bounds.1, 0);
    out
}

/// * `first_texel`: place of each of the scene's textures in the texel heap, in texels
pub(crate) fn material_words(
    m: &Material,
    scene: &RenderScene,
    first_texel: &[u32],
) -> [Word; MATERIAL_WORDS as usize] {
    let data = MaterialData::new(m, scene, first_texel);
    let mut out = [[0; 4]; MATERIAL_WORDS as usize];
    let own = words(&data);
    out[..22].copy_from_slice(&own[..22]);
    // Infinity is no number for a shader.
    out[22] = word(m.attenuation_color.to_array(), m.attenuation_distance.min(f32::MAX).to_bits());
    let flags = if m.schlick { MATERIAL_SCHLICK } else { 0 } | if m.thin { MATERIAL_THIN } else { 0 };
    out[23] = [m.ior.to_bits(), m.priority as u32, flags, 0];
    // The two textures of reflectance.
    out[24..].copy_from_slice(&own[22..]);
    out
}

/// * `first_layer`: as in [`LightData::new`]
pub(crate) fn light_words(light: &Light, index: usize, plan: &ShadowPlan, first_layer: u32) -> [Word; 6] {
    let data = LightData::new(light, index, plan, first_layer);
    let mut out = [[0; 4]; LIGHT_WORDS as usize];
    out[..4].copy_from_slice(words(&data));
    out[4] = word([light.radius, 0.0, 0.0], 0);
    out[5] = word(light.up_world.to_array(), 0);
    out
}

pub(crate) fn view_words(view: &ShadowView) -> [Word; VIEW_WORDS as usize] {
    [
        word(view.origin_world.to_array(), view.far.to_bits()),
        word(view.right_scaled.to_array(), view.perspective.to_bits()),
        word(view.up_scaled.to_array(), view.size),
        word(view.forward.to_array(), view.softness.to_bits()),
    ]
}

/// Vertices of [`VERTEX_WORDS`] words each (place and alpha, normal, both texture coordinates, colour, tangent),
/// then one word a
/// triangle.
pub(crate) fn geometry_words(mesh: &Mesh) -> Vec<Word> {
    let attributes = crate::raster::layouts::attributes(mesh);
    let mut out = Vec::with_capacity(geometry_size(mesh) as usize);
    let stride = crate::raster::layouts::ATTRIBUTE_STRIDE as usize;
    for (p, a) in mesh.positions().iter().zip(attributes.chunks_exact(stride)) {
        out.push(word(p.to_array(), a[10].to_bits()));
        out.push(word([a[0], a[1], a[2]], 0));
        out.push([a[3], a[4], a[5], a[6]].map(f32::to_bits));
        out.push(word([a[7], a[8], a[9]], 0));
        out.push([a[11], a[12], a[13], a[14]].map(f32::to_bits));
    }
    out.extend(mesh.triangles().iter().map(|&[a, b, c]| [a, b, c, 0]));
    out
}

/// Words of [`geometry_words`].
pub(crate) fn geometry_size(mesh: &Mesh) -> u64 {
    mesh.positions().len() as u64 * u64::from(VERTEX_WORDS) + mesh.triangles().len() as u64
}

impl MeshPlace {
    pub const NOWHERE: Self = Self { root: NONE, first_index: 0, first_vertex: 0, steps: 0, levels: 0, closed: false };
}

#[cfg(test)]
mod tests {
    use super::super::shaders::{HeapKind, Variant, text};
    use super::*;
    use std::mem::offset_of;

    macro_rules! assert_layout {
        ($kernel:literal, $wgsl:literal, $rust:ty, $($field:ident),+ $(,)?) => {{
            let text = text($kernel, &Variant::new(HeapKind::Storage));
            let module = naga::front::wgsl::parse_str(&text).unwrap();
            let (members, span) = module
                .types
                .iter()
                .find_map(|(_, t)| match &t.inner {
                    naga::TypeInner::Struct { members, span } if t.name.as_deref() == Some($wgsl) => {
                        Some((members.clone(), *span as usize))
                    }
                    _ => None,
                })
                .unwrap();
            let members: Vec<_> = members.iter().map(|m| (m.name.clone().unwrap(), m.offset as usize)).collect();
            assert_eq!(members, vec![$((stringify!($field).to_string(), offset_of!($rust, $field))),+], $wgsl);
            assert_eq!(span, size_of::<$rust>(), "size of {}", $wgsl);
        }};
    }

    #[test]
    fn uniforms_agree_with_wgsl() {
        assert_layout!(
            "trace",
            "SceneHead",
            SceneHead,
            tlas_root,
            instances,
            materials,
            lights,
            views,
            traversal_cap,
            extent,
            slack
        );
        assert_layout!(
            "photons",
            "PhotonUniform",
            PhotonUniform,
            paths,
            bounces,
            slots_a_path,
            samples,
            starts,
            unused0,
            unused1,
            unused2
        );
        assert_layout!(
            "photons_pack",
            "PackUniform",
            PackUniform,
            slots,
            slots_a_path,
            interleave,
            stride,
            geometry_term_max,
            chunks,
            unused0,
            unused1
        );
        assert_layout!(
            "trace",
            "TraceUniform",
            TraceUniform,
            max_depth,
            min_weight,
            ray_cap,
            vpl_count,
            geometry_term_max,
            map_size,
            visibility,
            min_variance,
            light_bleed_reduction,
            evsm,
            shadow_samples,
            seed
        );
    }

    #[test]
    fn few_rays_wait() {
        // log2(3 · 512) = 10.6, log2(3 · 4096) = 13.6.
        assert_eq!((waiting_rays(64, 1.0 / 512.0), waiting_rays(8, 1.0 / 512.0)), (12, 8));
        assert_eq!((waiting_rays(64, 1.0 / 4096.0), waiting_rays(64, 0.0), waiting_rays(5, 0.0)), (15, 64, 5));
    }

    #[test]
    fn ray_caps_hold_whole_trees() {
        // Depth 8: 2^9 rays, 32 hidden interfaces before each.
        assert_eq!(ray_cap(8), 512 * 33);
        assert_eq!(ray_cap(64), 1 << 24);
        assert!((1..64).all(|d| ray_cap(d) <= ray_cap(d + 1)));
    }
}
