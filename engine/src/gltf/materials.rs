//! glTF materials -> Blinn-Phong, mirror, glass; the formulas are in the docs of [`crate::gltf`].

use super::{
    document::{MaterialDef, NormalTextureInfo, TextureInfo, extension, own_extras},
    error::GltfError,
    geometry::Reads,
    report::Ignored,
    textures::{Textures, uv_set},
};
pub use crate::material::{MAX_SHININESS, roughness_from_shininess, shininess_from_roughness};
use crate::material::{Material, POLISHED, Physical, PhysicalPlace, metal_of_reflectance};
use glam::{Vec3, Vec4};
use serde::Deserialize;
use serde_json::{Map, Value};
use std::collections::BTreeSet;

/// Reflectance of a dielectric at normal incidence, ((ior − 1)/(ior + 1))².
pub(super) fn f0(ior: f32) -> f32 {
    let root = (ior - 1.0) / (ior + 1.0);
    root * root
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct Specular {
    specular_factor: f32,
    specular_color_factor: [f32; 3],
    specular_texture: Option<TextureInfo>,
    specular_color_texture: Option<TextureInfo>,
}

impl Default for Specular {
    fn default() -> Self {
        Self {
            specular_factor: 1.0,
            specular_color_factor: [1.0; 3],
            specular_texture: None,
            specular_color_texture: None,
        }
    }
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct SpecularGlossiness {
    diffuse_factor: [f32; 4],
    diffuse_texture: Option<TextureInfo>,
    specular_factor: [f32; 3],
    glossiness_factor: f32,
    specular_glossiness_texture: Option<TextureInfo>,
}

impl Default for SpecularGlossiness {
    fn default() -> Self {
        Self {
            diffuse_factor: [1.0; 4],
            diffuse_texture: None,
            specular_factor: [1.0; 3],
            glossiness_factor: 1.0,
            specular_glossiness_texture: None,
        }
    }
}

#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct Transmission {
    transmission_factor: f32,
    transmission_texture: Option<TextureInfo>,
}

#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct Volume {
    attenuation_distance: Option<f32>,
    attenuation_color: Option<[f32; 3]>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Ior {
    ior: Option<f32>,
}

#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct EmissiveStrength {
    emissive_strength: Option<f32>,
}

/// Translates one material.
pub(super) fn translate(
    def: &MaterialDef,
    place: &str,
    textures: &mut Textures,
    ignored: &mut Ignored,
) -> Result<Material, GltfError> {
    let pbr = &def.pbr_metallic_roughness;
    let ext = &def.extensions;
    let unit = |what: &str, v: f32| -> Result<f32, GltfError> {
        if v.is_finite() {
            Ok(v.clamp(0.0, 1.0))
        } else {
            Err(GltfError::invalid(place, format!("{what} is not finite")))
        }
    };
    let unit3 = |what: &str, v: [f32; 3]| -> Result<Vec3, GltfError> {
        Ok(Vec3::new(unit(what, v[0])?, unit(what, v[1])?, unit(what, v[2])?))
    };
    let mut m = Material::default();
    textures.uv_sets = reads(def).uv_sets;
    let [red, green, blue, _] = pbr.base_color_factor.unwrap_or([1.0; 4]);
    m.base_color = unit3("baseColorFactor", [red, green, blue])?;
    if let Some(info) = &pbr.base_color_texture {
        m.base_color_texture = textures.color(info, place, ignored)?;
    }
    let mut metallic = unit("metallicFactor", pbr.metallic_factor.unwrap_or(1.0))?;
    let mut roughness = unit("roughnessFactor", pbr.roughness_factor.unwrap_or(1.0))?;
    let factors = [metallic, roughness];
    let mut metallic_roughness_texture = None;
    if let Some(info) = &pbr.metallic_roughness_texture
        && let Some(r) = textures.reference(info, false, place, ignored)?
    {
        let [_, g, b] = textures.mean(r.texture);
        roughness *= g;
        metallic *= b;
        metallic_roughness_texture = Some(r);
    }

    // Emission.
    let strength: EmissiveStrength = extension(ext, "KHR_materials_emissive_strength", place)?.unwrap_or_default();
    let strength = strength.emissive_strength.unwrap_or(1.0);
    m.emissive = Vec3::from(def.emissive_factor.unwrap_or([0.0; 3])) * strength;
    if !m.emissive.is_finite() || m.emissive.min_element() < 0.0 {
        return Err(GltfError::invalid(place, "emission is negative or not finite"));
    }
    if let Some(info) = &def.emissive_texture {
        m.emissive_texture = textures.color(info, place, ignored)?;
    }

    // Glass.
    let ior: Ior = extension(ext, "KHR_materials_ior", place)?.unwrap_or_default();
    let ior = ior.ior.unwrap_or(1.5);
    if ior.is_finite() && ior >= 1.0 {
        m.ior = ior;
    } else {
        ignored.note(format!("index of refraction {ior} (1.5 is used)"));
    }
    let glass: Transmission = extension(ext, "KHR_materials_transmission", place)?.unwrap_or_default();
    let transmission_factor = unit("transmissionFactor", glass.transmission_factor)?;
    let transmission_texture = match &glass.transmission_texture {
        Some(info) if transmission_factor > 0.0 => textures.reference(info, false, place, ignored)?,
        _ => None,
    };
    let transmission = transmission_factor * transmission_texture.map_or(1.0, |r| textures.mean(r.texture)[0]);
    if transmission > 0.0 && roughness > POLISHED {
        ignored.note("roughness of transmission (glass is smooth)");
    }
    let volume: Volume = extension(ext, "KHR_materials_volume", place)?.unwrap_or_default();
    m.attenuation_color = unit3("attenuationColor", volume.attenuation_color.unwrap_or([1.0; 3]))?;
    if let Some(distance) = volume.attenuation_distance {
        if distance > 0.0 {
            m.attenuation_distance = distance;
        } else {
            ignored.note(format!("attenuationDistance {distance} (clear glass is used)"));
        }
    }

    // Reflection.
    let specular: Specular = extension(ext, "KHR_materials_specular", place)?.unwrap_or_default();
    let tint = Vec3::from(specular.specular_color_factor);
    if !tint.is_finite() || !specular.specular_factor.is_finite() {
        return Err(GltfError::invalid(place, "KHR_materials_specular is not finite"));
    }
    let mut optional = |info: &Option<TextureInfo>| match info {
        Some(info) => textures.color(info, place, ignored),
        None => Ok(None),
    };
    let reflectance_texture = optional(&specular.specular_color_texture)?;
    let reflectance_strength_texture = optional(&specular.specular_texture)?;
    let mut physical = Physical {
        metallic: factors[0],
        roughness: factors[1],
        metallic_roughness_texture,
        reflectance: (tint * f0(m.ior)).clamp(Vec3::ZERO, Vec3::ONE) * specular.specular_factor.clamp(0.0, 1.0),
        reflectance_texture,
        reflectance_strength_texture,
        by_reflectance: false,
        transmission: transmission_factor,
        transmission_texture,
        blended: false,
    };
    let mut reflectance = physical.reflectance;
    if let Some(r) = reflectance_texture {
        reflectance *= textures.mean_linear(r.texture).truncate();
    }
    if let Some(r) = reflectance_strength_texture {
        reflectance *= textures.mean_linear(r.texture).w;
    }
    let at = PhysicalPlace { metallic, roughness, transmission, coverage: 1.0 };
    let look = at.look(reflectance, m.base_color);
    (m.diffuse, m.specular, m.shininess) = (look.diffuse, look.specular, look.shininess);
    (m.mirror, m.transmission) = (look.mirror, look.transmission);
    let colored_metal = metallic > 0.0 && roughness > POLISHED && m.base_color_texture.is_some();
    let colored_sheen = reflectance_texture.is_some() || reflectance_strength_texture.is_some();
    if metallic_roughness_texture.is_some() || transmission_texture.is_some() || colored_metal || colored_sheen {
        m.physical = Some(physical);
    }
    if let Some(old) = extension::<SpecularGlossiness>(ext, "KHR_materials_pbrSpecularGlossiness", place)? {
        physical = by_reflectance(&mut m, &old, place, textures, ignored)?;
    }
    m.unlit = ext.as_ref().is_some_and(|e| e.contains_key("KHR_materials_unlit"));

    if let Some(n) = &def.normal_texture {
        m.normal_texture = textures.reference(&n.info(), false, place, ignored)?;
        m.normal_scale = n.scale.unwrap_or(1.0);
    }
    if def.occlusion_texture.is_some() {
        ignored.note("occlusionTexture (what reaches a place is computed)");
    }
    coverage(&mut m, def, &physical, place, textures, ignored)?;
    if let Some(own) = own_extras(&def.extras) {
        apply_extras(&mut m, own);
    }
    match m.invalid_field() {
        Some((field, value)) => Err(GltfError::invalid(place, format!("{field} comes out as {value}"))),
        None => Ok(m),
    }
}

/// Takes over colour, reflectance and gloss in place of metal and roughness.
fn by_reflectance(
    m: &mut Material,
    old: &SpecularGlossiness,
    place: &str,
    textures: &mut Textures,
    ignored: &mut Ignored,
) -> Result<Physical, GltfError> {
    let unit = |what: &str, v: f32| match v.is_finite() {
        true => Ok(v.clamp(0.0, 1.0)),
        false => Err(GltfError::invalid(place, format!("{what} is not finite"))),
    };
    let unit3 = |what: &str, [r, g, b]: [f32; 3]| -> Result<Vec3, GltfError> {
        Ok(Vec3::new(unit(what, r)?, unit(what, g)?, unit(what, b)?))
    };
    let mut optional = |info: &Option<TextureInfo>| match info {
        Some(info) => textures.color(info, place, ignored),
        None => Ok(None),
    };
    let [red, green, blue, _] = old.diffuse_factor;
    let diffuse = unit3("diffuseFactor", [red, green, blue])?;
    let gloss = unit("glossinessFactor", old.glossiness_factor)?;
    m.base_color_texture = optional(&old.diffuse_texture)?;
    let physical = Physical {
        metallic: 0.0,
        roughness: 1.0 - gloss,
        reflectance: unit3("specularFactor", old.specular_factor)?,
        reflectance_texture: optional(&old.specular_glossiness_texture)?,
        by_reflectance: true,
        ..Physical::default()
    };
    let texel = physical.reflectance_texture.map_or(Vec4::ONE, |r| textures.mean_linear(r.texture));
    let reflectance = physical.reflectance * texel.truncate();
    let (color, metallic) = metal_of_reflectance(diffuse, reflectance);
    let at = PhysicalPlace { metallic, roughness: 1.0 - gloss * texel.w, transmission: 0.0, coverage: 1.0 };
    let look = at.look(reflectance, color);
    (m.diffuse, m.specular, m.shininess) = (look.diffuse, look.specular, look.shininess);
    (m.mirror, m.transmission) = (look.mirror, look.transmission);
    // Where nothing varies, the mean says it all.
    let varies = physical.reflectance_texture.is_some() || (metallic > 0.0 && m.base_color_texture.is_some());
    (m.base_color, m.physical) = if varies { (diffuse, Some(physical)) } else { (color, None) };
    if varies {
        return Ok(physical);
    }
    Ok(Physical { metallic, by_reflectance: false, ..physical })
}

/// What a material reads of the vertices: its texture coordinate sets in ascending order (two at most; the first two of the
/// file where these are among them), and whether it has a normal map.
pub(super) fn reads(def: &MaterialDef) -> Reads {
    let normal = def.normal_texture.as_ref().map(NormalTextureInfo::info);
    let pbr = &def.pbr_metallic_roughness;
    let inner = |extension: &str, name: &str| {
        let value = def.extensions.as_ref().and_then(|e| e.get(extension)).and_then(|e| e.get(name));
        value.and_then(|v| TextureInfo::deserialize(v).ok())
    };
    let glass = inner("KHR_materials_transmission", "transmissionTexture");
    let diffuse = inner("KHR_materials_pbrSpecularGlossiness", "diffuseTexture");
    let gloss = inner("KHR_materials_pbrSpecularGlossiness", "specularGlossinessTexture");
    let specular = inner("KHR_materials_specular", "specularTexture");
    let specular_color = inner("KHR_materials_specular", "specularColorTexture");
    let all = [
        pbr.base_color_texture.as_ref(),
        pbr.metallic_roughness_texture.as_ref(),
        def.emissive_texture.as_ref(),
        normal.as_ref(),
        glass.as_ref(),
        diffuse.as_ref(),
        gloss.as_ref(),
        specular.as_ref(),
        specular_color.as_ref(),
    ];
    let sets: BTreeSet<u32> = all.into_iter().flatten().map(uv_set).collect();
    let uv_sets = if sets.iter().all(|s| *s < 2) {
        [0, 1]
    } else {
        let mut sets = sets.into_iter();
        [sets.next().unwrap_or(0), sets.next().unwrap_or(u32::MAX)]
    };
    Reads { uv_sets, tangents: normal.is_some() }
}

/// Share of texels of middling alpha up to which a blended texture counts as cut out.
const CUT_OUT: f32 = 0.25;

/// Alpha mask and alpha blending.
fn coverage(
    m: &mut Material,
    def: &MaterialDef,
    physical: &Physical,
    place: &str,
    textures: &Textures,
    ignored: &mut Ignored,
) -> Result<(), GltfError> {
    let factor = match extension::<SpecularGlossiness>(&def.extensions, "KHR_materials_pbrSpecularGlossiness", place)? {
        Some(old) => old.diffuse_factor[3],
        None => def.pbr_metallic_roughness.base_color_factor.map_or(1.0, |c| c[3]),
    };
    if !factor.is_finite() {
        return Err(GltfError::invalid(place, "the base colour's alpha is not finite"));
    }
    let alpha = factor.clamp(0.0, 1.0);
    match def.alpha_mode.as_deref() {
        None | Some("OPAQUE") => {}
        Some("MASK") => {
            let cutoff = def.alpha_cutoff.unwrap_or(0.5);
            if !(cutoff >= 0.0) {
                return Err(GltfError::invalid(place, format!("alphaCutoff {cutoff} is not a number from 0 on")));
            }
            // Beyond 1 nothing would remain: the same as a surface that is all hole.
            (m.alpha, m.alpha_cutoff) = if cutoff > 1.0 { (0.0, 1.0) } else { (alpha, cutoff) };
        }
        Some("BLEND") => {
            let (mean, between) = m.base_color_texture.map_or((1.0, 1.0), |t| textures.mean_alpha(t.texture));
            if mean < 1.0 && between <= CUT_OUT && alpha >= 0.5 {
                ignored.note("alphaMode BLEND of textures that are all or nothing (cut out at one half)");
                (m.alpha, m.alpha_cutoff) = (1.0, 0.5);
                return Ok(());
            }
            if m.transmission == 0.0 && (mean < 1.0 || m.physical.is_some()) {
                // From place to place; the material's own fields stand for the mean.
                let Material { base_color, emissive, .. } = *m;
                cover(m, alpha * mean);
                (m.base_color, m.emissive, m.alpha, m.thin) = (base_color, emissive, alpha, true);
                m.physical = Some(Physical { blended: true, ..*physical });
            } else {
                cover(m, alpha);
            }
        }
        Some(other) => ignored.note(format!("alphaMode {other:?} (opaque is used)")),
    }
    Ok(())
}

/// Makes a material cover only `alpha` of what lies behind it. Glass stays glass.
fn cover(m: &mut Material, alpha: f32) {
    if m.transmission > 0.0 || alpha >= 1.0 {
        return;
    }
    m.thin = true;
    m.specular *= alpha;
    m.emissive *= alpha;
    if m.unlit {
        m.base_color *= alpha;
    }
    // (1 - mirror)(transmission) must be 1 - alpha once the mirror's share is scaled too.
    m.mirror *= alpha;
    m.transmission = ((1.0 - alpha) / (1.0 - m.mirror).max(f32::MIN_POSITIVE)).min(1.0);
}

/// Fields that glTF cannot say, as our own export wrote them.
fn apply_extras(m: &mut Material, own: &Map<String, Value>) {
    let number = |name: &str| own.get(name).and_then(Value::as_f64).map(|v| v as f32);
    let color = |name: &str| {
        let list = own.get(name)?.as_array()?;
        let at = |i: usize| list.get(i).and_then(Value::as_f64).map(|v| v as f32);
        Some(Vec3::new(at(0)?, at(1)?, at(2)?))
    };
    let set = |field: &mut f32, name: &str| {
        if let Some(v) = number(name) {
            *field = v;
        }
    };
    set(&mut m.ambient, "ambient");
    set(&mut m.diffuse, "diffuse");
    set(&mut m.shininess, "shininess");
    set(&mut m.mirror, "mirror");
    set(&mut m.transmission, "transmission");
    for (field, name) in [
        (&mut m.specular, "specular"),
        (&mut m.base_color, "base_color"),
        (&mut m.attenuation_color, "attenuation_color"),
        (&mut m.emissive, "emissive"),
    ] {
        if let Some(v) = color(name) {
            *field = v;
        }
    }
    if ["diffuse", "specular", "shininess", "mirror", "transmission"].iter().any(|name| own.contains_key(*name)) {
        m.physical = None;
    }
    if own.get("thin").and_then(Value::as_bool) == Some(true) {
        (m.thin, m.alpha, m.alpha_cutoff) = (true, 1.0, 0.0);
    }
    if let Some(v) = own.get("schlick").and_then(Value::as_bool) {
        m.schlick = v;
    }
    if let Some(v) = own.get("priority").and_then(Value::as_i64) {
        m.priority = v as i32;
    }
}
