//! Surface materials: Blinn-Phong, mirror, glass, emissive.

use glam::{Vec2, Vec3};

/// What lies beyond a texture's edge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum Wrap {
    /// The image again.
    #[default]
    Repeat = 0,
    /// The edge texel.
    Clamp = 1,
    /// The image mirrored.
    Mirror = 2,
}

/// What is read where texels are smaller than pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum Mip {
    /// The image itself: sharp, and it flickers as it moves.
    None = 0,
    /// The one smaller copy whose texels are nearest to the pixel's size.
    Nearest = 1,
    /// Both copies around that size, blended.
    #[default]
    Linear = 2,
}

/// A texture as a material uses it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureRef {
    /// Index into the scene's textures.
    pub texture: u32,
    /// Wrap rule along u and v.
    pub wrap: [Wrap; 2],
    /// Nearest texel instead of bilinear, where texels are larger than pixels.
    pub nearest: bool,
    /// Nearest texel instead of bilinear, where texels are smaller than pixels.
    pub nearest_min: bool,
    /// Smaller copies of the image, where texels are smaller than pixels.
    pub mip: Mip,
    /// Which texture coordinate set of the mesh: 0 or 1.
    pub uv_set: u32,
    /// `KHR_texture_transform`: uv' = offset + rotation(scale * uv), rows (m00, m01, offset.x), (m10, m11, offset.y).
    pub uv_transform: [[f32; 3]; 2],
}

impl Default for TextureRef {
    fn default() -> Self {
        Self {
            texture: 0,
            wrap: [Wrap::Repeat; 2],
            nearest: false,
            nearest_min: false,
            mip: Mip::Linear,
            uv_set: 0,
            uv_transform: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        }
    }
}

impl TextureRef {
    /// Applies `uv_transform`.
    pub fn transform_uv(&self, uv: Vec2) -> Vec2 {
        let [a, b] = self.uv_transform;
        Vec2::new(a[0] * uv.x + a[1] * uv.y + a[2], b[0] * uv.x + b[1] * uv.y + b[2])
    }
}

/// Perceptual roughness up to which a surface of metal and roughness counts as polished.
pub const POLISHED: f32 = 0.01;

/// Perceptual roughness from which a surface of metal and roughness has no mirror share: about where [`MAX_SHININESS`] ends.
/// Between [`POLISHED`] and here the mirror fades and the highlight comes, so that fine grain in a texture is no noise.
pub const NOT_POLISHED: f32 = 0.105;

/// Largest Blinn-Phong exponent made from a roughness (r = 0.105): beyond it highlights are smaller than pixels.
pub const MAX_SHININESS: f32 = 16384.0;

/// Blinn-Phong exponent for glTF's perceptual roughness `r` in (0, 1]: 2/r⁴ − 2, in [0, [`MAX_SHININESS`]].
///
/// Twin: `shaders/shared/look.wgsl`.
/// Source: Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007 (α = 2/α_b² − 2, α_b = r²).
pub fn shininess_from_roughness(r: f32) -> f32 {
    let alpha = r * r;
    (2.0 / (alpha * alpha).max(1e-12) - 2.0).clamp(0.0, MAX_SHININESS)
}

/// Perceptual roughness for a Blinn-Phong exponent: the inverse of [`shininess_from_roughness`].
pub fn roughness_from_shininess(shininess: f32) -> f32 {
    (2.0 / (shininess.max(0.0) + 2.0)).sqrt().sqrt()
}

/// Greatest reflectance at normal incidence of what is no metal; above it reflectance counts as metal's.
pub const DIELECTRIC_REFLECTANCE: f32 = 0.08;

/// Colour and share of metal of a surface that is told by its diffuse colour and its reflectance.
///
/// With s the greatest channel of the reflectance F: m = (s − 0.08)/(1 − 0.08), clamped to [0, 1], and the colour lerps from
/// the diffuse one to F/s by m, so that a mirror of metal reflects about F and a dielectric keeps its colour.
///
/// Twin: `shaders/shared/look.wgsl` (tests/embed_reflectance.rs).
pub fn metal_of_reflectance(diffuse_color: Vec3, reflectance: Vec3) -> (Vec3, f32) {
    let strongest = reflectance.max_element();
    let metallic = ((strongest - DIELECTRIC_REFLECTANCE) / (1.0 - DIELECTRIC_REFLECTANCE)).clamp(0.0, 1.0);
    if metallic == 0.0 {
        return (diffuse_color, 0.0);
    }
    (diffuse_color.lerp(reflectance / strongest, metallic), metallic)
}

/// How one place of a surface splits light: the fields of [`Material`] of the same names.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Weight of the Lambertian lobe.
    pub diffuse: f32,
    /// Blinn-Phong k_s per channel.
    pub specular: Vec3,
    /// Blinn-Phong exponent.
    pub shininess: f32,
    /// Share of perfect mirror.
    pub mirror: f32,
    /// Share of glass in the rest.
    pub transmission: f32,
}

impl Look {
    /// Weight of the matte and ambient terms: (1 − mirror)(1 − transmission).
    #[inline]
    pub fn matte_weight(&self) -> f32 {
        (1.0 - self.mirror) * (1.0 - self.transmission)
    }
    /// True where the tracer has work: a mirror or glass share over 0.
    #[inline]
    pub fn is_traced(&self) -> bool {
        self.mirror > 0.0 || self.transmission > 0.0
    }
}

/// Metal, roughness, reflectance, glass and coverage that textures vary from place to place. Where a material has it, its [`Look`] is
/// made anew at each place; the material's own fields of those names stand for its mean.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Physical {
    /// Share of metal, in [0, 1].
    pub metallic: f32,
    /// glTF's perceptual roughness, in [0, 1].
    pub roughness: f32,
    /// Multiplies `roughness` by its green and `metallic` by its blue; linear image.
    pub metallic_roughness_texture: Option<TextureRef>,
    /// Reflectance of what is not metal, at normal incidence, per channel in [0, 1].
    pub reflectance: Vec3,
    /// Multiplies `reflectance` by its colour; sRGB image.
    pub reflectance_texture: Option<TextureRef>,
    /// Multiplies `reflectance` by its alpha.
    pub reflectance_strength_texture: Option<TextureRef>,
    /// The surface is told by diffuse colour, reflectance and gloss: metal comes of [`metal_of_reflectance`] in place of
    /// `metallic`, and the alpha of `reflectance_texture` multiplies the gloss, 1 − `roughness`.
    pub by_reflectance: bool,
    /// Share of glass in what is not metal, in [0, 1].
    pub transmission: f32,
    /// Multiplies `transmission` by its red; linear image.
    pub transmission_texture: Option<TextureRef>,
    /// The surface covers only `alpha` of what lies behind it, times the base colour texture's alpha and the vertex colour's
    /// (glTF's alpha blending); else all of it.
    pub blended: bool,
}

/// Factors of a [`Physical`] at one place, each in [0, 1].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhysicalPlace {
    /// Share of metal.
    pub metallic: f32,
    /// Perceptual roughness.
    pub roughness: f32,
    /// Share of glass in what is not metal.
    pub transmission: f32,
    /// Share of what lies behind that is covered.
    pub coverage: f32,
}

impl Default for Physical {
    /// A metal of roughness 1, as in glTF.
    fn default() -> Self {
        Self {
            metallic: 1.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            reflectance: Vec3::splat(0.04),
            reflectance_texture: None,
            reflectance_strength_texture: None,
            by_reflectance: false,
            transmission: 0.0,
            transmission_texture: None,
            blended: false,
        }
    }
}

impl Physical {
    /// The look of a place of colour `base_color` and the factor's reflectance.
    pub fn look(&self, base_color: Vec3, at: PhysicalPlace) -> Look {
        at.look(self.reflectance, base_color)
    }
}

impl PhysicalPlace {
    /// The look of the place, by the formulas in the docs of [`crate::gltf`].
    /// * `reflectance`: of what is not metal, at normal incidence, in [0, 1]
    ///
    /// Twin: `shaders/shared/look.wgsl` (tests/embed_textures.rs).
    pub fn look(self, reflectance: Vec3, base_color: Vec3) -> Look {
        let Self { metallic, roughness, transmission, coverage } = self;
        let mut out = if roughness <= POLISHED {
            Look { diffuse: 1.0, specular: Vec3::ZERO, shininess: 32.0, mirror: metallic, transmission }
        } else {
            let polish = ((NOT_POLISHED - roughness) / (NOT_POLISHED - POLISHED)).max(0.0);
            let mirror = metallic * polish;
            // Look::matte_weight takes mirror and glass off; what must remain is (1-m)(1-t), and glass must be (1-m) t.
            let rest = 1.0 - mirror;
            let transmission_of_rest = if rest > 0.0 { (transmission * (1.0 - metallic) / rest).min(1.0) } else { 0.0 };
            let matte = rest * (1.0 - transmission_of_rest);
            let diffuse =
                if matte > 0.0 { ((1.0 - metallic) * (1.0 - transmission) / matte).clamp(0.0, 1.0) } else { 0.0 };
            let specular = (reflectance * (1.0 - roughness)).lerp(base_color, metallic) * (1.0 - polish);
            let shininess = shininess_from_roughness(roughness);
            Look { diffuse, specular, shininess, mirror, transmission: transmission_of_rest }
        };
        if coverage < 1.0 {
            // (1 - mirror)(transmission) must be 1 - coverage once the mirror's share is scaled too.
            out.specular *= coverage;
            out.mirror *= coverage;
            out.transmission = ((1.0 - coverage) / (1.0 - out.mirror).max(f32::MIN_POSITIVE)).min(1.0);
        }
        out
    }
}

/// A surface. Radiance towards the viewer is
///
/// (1 − mirror)(1 − transmission) · [ diffuse · base_color/π · E + k_a · base_color · i_a ] + k_s-highlight + emissive
/// + mirror · tint · reflected + (1 − mirror) · transmission · (Fresnel-weighted reflected and refracted)
///
/// where base_color is the factor times texture times vertex colour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Lambertian albedo per channel, in [0, 1]; tint of mirror and glass. Linear.
    pub base_color: Vec3,
    /// Multiplies `base_color`; sRGB image.
    pub base_color_texture: Option<TextureRef>,
    /// Blinn-Phong k_a: share of the environment's ambient radiance, in [0, 1]. 0 in the five scenes.
    pub ambient: f32,
    /// Blinn-Phong k_d: weight of the Lambertian lobe, in [0, 1]. 1 for non-metals.
    pub diffuse: f32,
    /// Blinn-Phong k_s per channel, in [0, 1]; lobe k_s (α+8)/(8π) (N·H)^α.
    pub specular: Vec3,
    /// Blinn-Phong exponent α ≥ 0.
    pub shininess: f32,
    /// Emitted radiance per channel (both sides).
    pub emissive: Vec3,
    /// Multiplies `emissive`; sRGB image.
    pub emissive_texture: Option<TextureRef>,
    /// Share of perfect mirror, in [0, 1], tinted by base_color (the material mask's reflection factor).
    pub mirror: f32,
    /// Raises the mirror's tint towards white at grazing angles (Schlick 1994). Native materials only.
    pub schlick: bool,
    /// Share of smooth glass in the rest, in [0, 1] (the material mask's refraction factor).
    pub transmission: f32,
    /// Index of refraction of the glass, ≥ 1.
    pub ior: f32,
    /// Beer-Lambert: colour of white light after `attenuation_distance` inside, per channel in (0, 1].
    pub attenuation_color: Vec3,
    /// Beer-Lambert distance in metres; +infinity for clear glass.
    pub attenuation_distance: f32,
    /// Nested glass: where volumes overlap, the higher priority fills the space; equal: the one entered last.
    pub priority: i32,
    /// Light passes straight on, without Fresnel reflection, bend or tint, whatever the mesh: `transmission` is then the share
    /// that is not covered (glTF's alpha blending).
    pub thin: bool,
    /// Multiplies the base colour texture's alpha where there is an `alpha_cutoff`, in [0, 1].
    pub alpha: f32,
    /// The surface has holes where alpha × texture × vertex alpha is less, in [0, 1]; 0: it has none.
    pub alpha_cutoff: f32,
    /// Tangent-space normals, linear image: (x, y, z) = 2 · (r, g, b) − 1, x along u, y against v, z outwards. The frame is
    /// the triangle's own, from its texture coordinates.
    pub normal_texture: Option<TextureRef>,
    /// Multiplies x and y of `normal_texture`, finite.
    pub normal_scale: f32,
    /// Metal, roughness, glass and coverage by texture; `None`: the fields above hold everywhere.
    pub physical: Option<Physical>,
    /// Shows base_color × texture as emitted radiance, lit by nothing (`KHR_materials_unlit`).
    pub unlit: bool,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            base_color: Vec3::ONE,
            base_color_texture: None,
            ambient: 0.0,
            diffuse: 1.0,
            specular: Vec3::ZERO,
            shininess: 32.0,
            emissive: Vec3::ZERO,
            emissive_texture: None,
            mirror: 0.0,
            schlick: false,
            transmission: 0.0,
            ior: 1.5,
            attenuation_color: Vec3::ONE,
            attenuation_distance: f32::INFINITY,
            priority: 0,
            thin: false,
            alpha: 1.0,
            alpha_cutoff: 0.0,
            normal_texture: None,
            normal_scale: 1.0,
            physical: None,
            unlit: false,
        }
    }
}

impl Material {
    /// Matte surface of the given albedo.
    pub fn lambert(base_color: Vec3) -> Self {
        Self { base_color, ..Self::default() }
    }
    /// Share `mirror` of perfect reflection tinted by `base_color`, the rest matte.
    pub fn mirror(base_color: Vec3, mirror: f32) -> Self {
        Self { base_color, mirror, ..Self::default() }
    }
    /// Smooth clear glass.
    pub fn glass(base_color: Vec3, ior: f32) -> Self {
        Self { base_color, ior, transmission: 1.0, ..Self::default() }
    }
    /// The fields that say how light is split: everywhere without [`Self::physical`], on average with it.
    #[inline]
    pub fn look(&self) -> Look {
        Look {
            diffuse: self.diffuse,
            specular: self.specular,
            shininess: self.shininess,
            mirror: self.mirror,
            transmission: self.transmission,
        }
    }
    /// Weight of the matte and ambient terms: (1 − mirror)(1 − transmission); on average.
    #[inline]
    pub fn matte_weight(&self) -> f32 {
        self.look().matte_weight()
    }
    /// True where the tracer has work: a mirror or glass share over 0, on average.
    #[inline]
    pub fn is_traced(&self) -> bool {
        self.look().is_traced()
    }
    /// True where the surface may have holes.
    #[inline]
    pub fn is_cutout(&self) -> bool {
        self.alpha_cutoff > 0.0
    }
    /// All textures that it uses.
    pub fn textures(&self) -> impl Iterator<Item = &TextureRef> {
        let own = [&self.base_color_texture, &self.emissive_texture, &self.normal_texture];
        let physical = self.physical.iter().flat_map(|p| {
            [
                &p.metallic_roughness_texture,
                &p.transmission_texture,
                &p.reflectance_texture,
                &p.reflectance_strength_texture,
            ]
        });
        own.into_iter().chain(physical).flatten()
    }
    /// All textures that it uses, to be renumbered.
    pub fn textures_mut(&mut self) -> impl Iterator<Item = &mut TextureRef> {
        let own = [&mut self.base_color_texture, &mut self.emissive_texture, &mut self.normal_texture];
        let physical = self.physical.iter_mut().flat_map(|p| {
            [
                &mut p.metallic_roughness_texture,
                &mut p.transmission_texture,
                &mut p.reflectance_texture,
                &mut p.reflectance_strength_texture,
            ]
        });
        own.into_iter().chain(physical).flatten()
    }
    /// First field that is out of its range, with its value.
    pub fn invalid_field(&self) -> Option<(&'static str, f32)> {
        let unit = |v: f32| (0.0..=1.0).contains(&v);
        let colors = [
            ("base_color", self.base_color),
            ("specular", self.specular),
            ("attenuation_color", self.attenuation_color),
        ];
        for (name, c) in colors {
            if let Some(&v) = c.to_array().iter().find(|v| !v.is_finite() || **v < 0.0) {
                return Some((name, v));
            }
        }
        if let Some(&v) = self.emissive.to_array().iter().find(|v| !v.is_finite() || **v < 0.0) {
            return Some(("emissive", v));
        }
        let factors = [
            ("ambient", self.ambient),
            ("diffuse", self.diffuse),
            ("mirror", self.mirror),
            ("transmission", self.transmission),
            ("alpha", self.alpha),
            ("alpha_cutoff", self.alpha_cutoff),
        ];
        for (name, v) in factors {
            if !unit(v) {
                return Some((name, v));
            }
        }
        if let Some(p) = &self.physical {
            let r = p.reflectance;
            let factors = [
                ("physical.metallic", p.metallic),
                ("physical.roughness", p.roughness),
                ("physical.transmission", p.transmission),
                ("physical.reflectance", r.x),
                ("physical.reflectance", r.y),
                ("physical.reflectance", r.z),
            ];
            if let Some(bad) = factors.into_iter().find(|(_, v)| !unit(*v)) {
                return Some(bad);
            }
        }
        if !(self.shininess >= 0.0 && self.shininess.is_finite()) {
            return Some(("shininess", self.shininess));
        }
        if !self.normal_scale.is_finite() {
            return Some(("normal_scale", self.normal_scale));
        }
        if !(self.ior >= 1.0 && self.ior.is_finite()) {
            return Some(("ior", self.ior));
        }
        if self.attenuation_distance.is_nan() || self.attenuation_distance <= 0.0 {
            return Some(("attenuation_distance", self.attenuation_distance));
        }
        None
    }
}
