//! Surfaces with holes: rays pass where a material's alpha mask says so.
//!
//! Trees hold whole triangles; a hit that falls into a hole is left behind and the ray goes on from its distance. So a thing
//! at exactly the distance of a hole, and not before it in (instance, primitive), is passed too.

use catoptra_engine::{Mesh, RenderScene, Texture, TextureRef};
use glam::Vec2;
use std::sync::Arc;

use super::Hit;

/// Everything that tells a hole from a surface, by instance id.
pub(crate) struct Cutouts {
    masks: Vec<Option<Mask>>,
    /// Chosen by [`super::Accel::set_shadow_casters`]; the trees themselves hold cut-outs for no casters.
    pub casts: Vec<bool>,
}

struct Mask {
    mesh: Arc<Mesh>,
    texture: Option<(Arc<Texture>, TextureRef)>,
    alpha: f32,
    cutoff: f32,
}

impl Cutouts {
    /// `None` where no instance has holes.
    pub fn of(scene: &RenderScene) -> Option<Self> {
        if !scene.materials.iter().any(|m| m.is_cutout()) {
            return None;
        }
        let masks: Vec<Option<Mask>> = scene
            .instances
            .iter()
            .map(|i| {
                let m = &scene.materials[i.material as usize];
                m.is_cutout().then(|| Mask {
                    mesh: scene.meshes[i.mesh as usize].clone(),
                    texture: m.base_color_texture.map(|r| (scene.textures[r.texture as usize].clone(), r)),
                    alpha: m.alpha,
                    cutoff: m.alpha_cutoff,
                })
            })
            .collect();
        masks.iter().any(Option::is_some).then(|| Self { casts: vec![true; masks.len()], masks })
    }

    /// True where the instance has holes.
    pub fn has(&self, instance_id: u32) -> bool {
        self.masks.get(instance_id as usize).is_some_and(Option::is_some)
    }

    /// True where the hit falls into a hole. Twin: `shaders/visibility_cutout.wgsl`.
    pub fn is_hole(&self, hit: &Hit) -> bool {
        let Some(Some(mask)) = self.masks.get(hit.instance_id as usize) else { return false };
        let [a, b, c] = mask.mesh.triangles()[hit.primitive_id as usize].map(|v| v as usize);
        let w = 1.0 - hit.u - hit.v;
        let mut alpha = mask.alpha;
        if let Some((texture, r)) = &mask.texture {
            let uvs = if r.uv_set == 1 { mask.mesh.uvs1() } else { mask.mesh.uvs() };
            let uv = if uvs.is_empty() { Vec2::ZERO } else { uvs[a] * w + uvs[b] * hit.u + uvs[c] * hit.v };
            alpha *= texture.sample(r, uv).w;
        }
        if let colors @ [_, ..] = mask.mesh.colors() {
            alpha *= colors[a].w * w + colors[b].w * hit.u + colors[c].w * hit.v;
        }
        alpha < mask.cutoff
    }
}
