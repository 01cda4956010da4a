//! Native materials -> metallic-roughness and extensions, the closest that glTF can say, and the exact rest in `extras`.

use super::writer::Writer;
use crate::{
    gltf::{error::GltfError, materials::f0},
    material::{Material, Mip, NOT_POLISHED, Physical, PhysicalPlace, TextureRef, Wrap, roughness_from_shininess},
    render_scene::RenderScene,
};
use glam::Vec3;
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// For each material the thickness to state: the least extent of the first closed mesh that it is glass of, else 0.
pub(super) fn thickness(scene: &RenderScene) -> Vec<f32> {
    let mut out = vec![0.0; scene.materials.len()];
    for i in &scene.instances {
        let mesh = &scene.meshes[i.mesh as usize];
        let slot = &mut out[i.material as usize];
        if *slot == 0.0 && scene.materials[i.material as usize].transmission > 0.0 && mesh.closed() {
            let bounds = mesh.bounds_object();
            // A flat closed mesh is still a volume to other renderers.
            *slot = (bounds.max - bounds.min).min_element().max(1e-6);
        }
    }
    out
}

/// Image, wrap rules, filters.
type Key = (u32, [u32; 2], [u32; 2]);

/// glTF textures are pairs of image and sampler: made as materials ask for them.
pub(super) struct Textures {
    sampled: BTreeMap<Key, usize>,
}

impl Textures {
    /// Writes every image and every pair that the materials use.
    pub fn write(scene: &RenderScene, w: &mut Writer) -> Result<Self, GltfError> {
        let mut sampled = BTreeMap::new();
        let mut images = BTreeMap::new();
        for r in scene.materials.iter().flat_map(Material::textures) {
            if sampled.contains_key(&key(r)) {
                continue;
            }
            let image = match images.get(&r.texture) {
                Some(&image) => image,
                None => {
                    let texture = &scene.textures[r.texture as usize];
                    let mut png = Vec::new();
                    PngEncoder::new(&mut png)
                        .write_image(
                            texture.texels().as_flattened(),
                            texture.width(),
                            texture.height(),
                            ExtendedColorType::Rgba8,
                        )
                        .map_err(|e| GltfError::Export(format!("texture {}: {e}", r.texture)))?;
                    let view = w.view(&png, None);
                    let image = w.push("images", json!({ "bufferView": view, "mimeType": "image/png" }));
                    images.insert(r.texture, image);
                    image
                }
            };
            let [mag, min] = filters(r);
            let [s, t] = r.wrap.map(|v| match v {
                Wrap::Repeat => 10497,
                Wrap::Clamp => 33071,
                Wrap::Mirror => 33648,
            });
            let sampler = w.push("samplers", json!({ "magFilter": mag, "minFilter": min, "wrapS": s, "wrapT": t }));
            sampled.insert(key(r), w.push("textures", json!({ "source": image, "sampler": sampler })));
        }
        Ok(Self { sampled })
    }

    fn info(&self, r: &TextureRef, w: &mut Writer) -> Value {
        let mut value = json!({ "index": self.sampled[&key(r)] });
        if r.uv_set != 0 {
            value["texCoord"] = json!(r.uv_set);
        }
        if r.uv_transform != TextureRef::default().uv_transform {
            w.uses("KHR_texture_transform");
            value["extensions"] = json!({ "KHR_texture_transform": uv_transform(&r.uv_transform) });
        }
        value
    }
}

fn key(r: &TextureRef) -> Key {
    (r.texture, r.wrap.map(|w| w as u32), filters(r))
}

/// glTF's codes for magnification and minification.
fn filters(r: &TextureRef) -> [u32; 2] {
    let linear = u32::from(!r.nearest_min);
    let min = match r.mip {
        Mip::None => 9728,
        Mip::Nearest => 9984,
        Mip::Linear => 9986,
    };
    [9728 + u32::from(!r.nearest), min + linear]
}

/// Offset, rotation and scale of [[c sx, s sy, ox], [-s sx, c sy, oy]].
fn uv_transform(m: &[[f32; 3]; 2]) -> Value {
    let [[a, b, ox], [c, d, oy]] = *m;
    let rotation = crate::math::atan2(-c, a);
    let sx = (a * a + c * c).sqrt();
    let sign = if a * d - b * c < 0.0 { -1.0 } else { 1.0 };
    let sy = (b * b + d * d).sqrt() * sign;
    json!({ "offset": [ox, oy], "rotation": rotation, "scale": [sx, sy] })
}

/// One material.
pub(super) fn material(m: &Material, thickness: f32, textures: &Textures, w: &mut Writer) -> Value {
    let (metallic, roughness) = metallic_roughness(m);
    let covered = if m.thin && m.physical.is_none() { 1.0 - m.transmission } else { m.alpha };
    let mut pbr = json!({
        "baseColorFactor": [m.base_color.x, m.base_color.y, m.base_color.z, covered],
        "metallicFactor": metallic,
        "roughnessFactor": roughness,
    });
    if let Some(r) = &m.base_color_texture {
        pbr["baseColorTexture"] = textures.info(r, w);
    }
    if let Some(r) = m.physical.as_ref().and_then(|p| p.metallic_roughness_texture.as_ref()) {
        pbr["metallicRoughnessTexture"] = textures.info(r, w);
    }
    let mut value = json!({ "pbrMetallicRoughness": pbr, "doubleSided": true });
    if let Some(r) = &m.normal_texture {
        value["normalTexture"] = textures.info(r, w);
        value["normalTexture"]["scale"] = json!(m.normal_scale);
    }
    if m.thin {
        value["alphaMode"] = json!("BLEND");
    } else if m.is_cutout() {
        value["alphaMode"] = json!("MASK");
        value["alphaCutoff"] = json!(m.alpha_cutoff);
    }
    let mut ext = Map::new();
    let mut add = |w: &mut Writer, name: &'static str, v: Value| {
        w.uses(name);
        ext.insert(name.into(), v);
    };

    // Emission: a factor in [0, 1] and a strength; a power of two keeps every digit.
    let mut strength = 1.0_f32;
    while strength < m.emissive.max_element() {
        strength *= 2.0;
    }
    if m.emissive != Vec3::ZERO {
        value["emissiveFactor"] = json!((m.emissive / strength).to_array());
        if strength != 1.0 {
            add(w, "KHR_materials_emissive_strength", json!({ "emissiveStrength": strength }));
        }
    }
    if let Some(r) = &m.emissive_texture {
        value["emissiveTexture"] = textures.info(r, w);
    }

    // Glass.
    let clear = m.attenuation_distance == f32::INFINITY;
    let glass = m.physical.map_or(m.transmission, |p| p.transmission);
    if glass > 0.0 && (!m.thin || m.physical.is_some()) {
        let mut transmission = json!({ "transmissionFactor": glass });
        if let Some(r) = m.physical.as_ref().and_then(|p| p.transmission_texture.as_ref()) {
            transmission["transmissionTexture"] = textures.info(r, w);
        }
        add(w, "KHR_materials_transmission", transmission);
    }
    if m.ior != 1.5 {
        add(w, "KHR_materials_ior", json!({ "ior": m.ior }));
    }
    if m.transmission > 0.0 && thickness > 0.0 && !m.thin || !clear || m.attenuation_color != Vec3::ONE {
        let color = m.attenuation_color.clamp(Vec3::ZERO, Vec3::ONE);
        let mut volume = json!({ "thicknessFactor": thickness, "attenuationColor": color.to_array() });
        if !clear {
            volume["attenuationDistance"] = json!(m.attenuation_distance);
        }
        add(w, "KHR_materials_volume", volume);
    }
    if m.unlit {
        add(w, "KHR_materials_unlit", json!({}));
    }
    if let Some(p) = &m.physical {
        let specular = specular_of(p.reflectance, f0(m.ior));
        let maps =
            [("specularColorTexture", &p.reflectance_texture), ("specularTexture", &p.reflectance_strength_texture)];
        if p.by_reflectance {
            let mut old = json!({
                "diffuseFactor": [m.base_color.x, m.base_color.y, m.base_color.z, covered],
                "specularFactor": p.reflectance.to_array(),
                "glossinessFactor": 1.0 - p.roughness,
            });
            for (name, r) in [("diffuseTexture", &m.base_color_texture), ("specularGlossinessTexture", maps[0].1)] {
                if let Some(r) = r {
                    old[name] = textures.info(r, w);
                }
            }
            add(w, "KHR_materials_pbrSpecularGlossiness", old);
        } else if specular != (1.0, Vec3::ONE) || maps.iter().any(|(_, r)| r.is_some()) {
            let (factor, color) = (specular.0, specular.1.to_array());
            let mut value = json!({ "specularFactor": factor, "specularColorFactor": color });
            for (name, r) in maps {
                if let Some(r) = r {
                    value[name] = textures.info(r, w);
                }
            }
            add(w, "KHR_materials_specular", value);
        }
    }
    let implied = implied(m, metallic, roughness);
    if m.physical.is_none() && metallic == 0.0 && m.specular != implied.specular && roughness < 1.0 {
        // k_s = F0 · factor · colour · (1 − r): the closest that other renderers can show.
        let (factor, color) = specular_of(m.specular, f0(m.ior) * (1.0 - roughness));
        add(w, "KHR_materials_specular", json!({ "specularFactor": factor, "specularColorFactor": color.to_array() }));
    }
    if !ext.is_empty() {
        value["extensions"] = Value::Object(ext);
    }
    let own = own_fields(m, &implied);
    if !own.is_empty() {
        value["extras"] = json!({ "catoptra": own });
    }
    value
}

/// specularFactor and specularColorFactor that make `specular` of a full reflectance `full`.
fn specular_of(specular: Vec3, full: f32) -> (f32, Vec3) {
    let color = if full > 0.0 { specular / full } else { Vec3::ZERO };
    let factor = color.max_element().min(1.0);
    (factor, if factor > 0.0 { color / factor } else { Vec3::ONE })
}

/// Metalness and roughness that say most about a native material.
fn metallic_roughness(m: &Material) -> (f32, f32) {
    if let Some(Physical { metallic, roughness, .. }) = m.physical {
        return (metallic, roughness);
    }
    if m.mirror > 0.0 || (m.transmission > 0.0 && !m.thin) {
        return (m.mirror, 0.0);
    }
    if m.specular == Vec3::ZERO {
        return (0.0, 1.0);
    }
    let roughness = roughness_from_shininess(m.shininess);
    ((1.0 - m.diffuse).clamp(0.0, 1.0), roughness.clamp(NOT_POLISHED, 1.0))
}

/// The material that an import makes of base colour, ior, transmission, metalness and roughness alone.
fn implied(m: &Material, metallic: f32, roughness: f32) -> Material {
    let mut out = Material { base_color: m.base_color.clamp(Vec3::ZERO, Vec3::ONE), ..Material::default() };
    out.attenuation_color = m.attenuation_color.clamp(Vec3::ZERO, Vec3::ONE);
    let physical = Physical { metallic, roughness, reflectance: Vec3::splat(f0(m.ior)), ..Physical::default() };
    let look = physical.look(out.base_color, PhysicalPlace { metallic, roughness, transmission: 0.0, coverage: 1.0 });
    (out.diffuse, out.specular, out.shininess, out.mirror) = (look.diffuse, look.specular, look.shininess, look.mirror);
    out
}

/// Fields that the import would not get right from glTF alone. Where one differs, `specular`, `shininess` and `diffuse`
/// are all written: they hang together.
fn own_fields(m: &Material, implied: &Material) -> Map<String, Value> {
    let mut own = Map::new();
    let native = m.physical.is_none();
    let look = ["diffuse", "specular", "shininess", "mirror", "thin", "transmission", "emissive"];
    let mut put = |name: &str, differs: bool, v: Value| {
        if differs && (native || !look.contains(&name)) {
            own.insert(name.into(), v);
        }
    };
    put("ambient", m.ambient != implied.ambient, json!(m.ambient));
    put("diffuse", m.diffuse != implied.diffuse, json!(m.diffuse));
    put("specular", m.specular != implied.specular || m.thin, json!(m.specular.to_array()));
    put("shininess", m.shininess != implied.shininess, json!(m.shininess));
    put("mirror", m.mirror != implied.mirror || m.thin, json!(m.mirror));
    put("thin", m.thin, json!(true));
    put("transmission", m.thin, json!(m.transmission));
    put("emissive", m.thin, json!(m.emissive.to_array()));
    put("schlick", m.schlick, json!(true));
    put("priority", m.priority != 0, json!(m.priority));
    put("base_color", m.base_color != implied.base_color || (m.thin && native), json!(m.base_color.to_array()));
    let attenuation = m.attenuation_color;
    put("attenuation_color", attenuation != implied.attenuation_color, json!(attenuation.to_array()));
    own
}
