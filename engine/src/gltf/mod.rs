//! glTF 2.0 and GLB, in and out.
//!
//! **In**: [`load_gltf`] gives an [`ImportedScene`] (flat arrays), which [`ImportedScene::spawn`] turns into entities or
//! [`ImportedScene::to_render_scene`] into a `RenderScene`. Read are nodes, meshes (lists, strips, fans; sparse,
//! interleaved, normalised, quantised), morph targets and skins, all animations of nodes, weights and skins
//! ([`ImportedScene::play`] chooses one), base-colour, metallic-roughness, emissive, transmission and specular textures (PNG,
//! JPEG, WebP) with their samplers, normal maps with or without `TANGENT`, alpha masks and blending, vertex colours, cameras,
//! and the extensions `KHR_lights_punctual`, `KHR_materials_{transmission, ior, volume, specular, emissive_strength, unlit,
//! pbrSpecularGlossiness}`, `KHR_mesh_quantization`, `KHR_node_visibility`, `KHR_texture_transform`,
//! `EXT_mesh_gpu_instancing`, `EXT_texture_webp`; of `KHR_materials_variants` the default is shown. A material's textures may
//! use any two coordinate sets of the mesh. Shading is two-sided whatever `doubleSided` says; thickness of volumes is
//! ignored, the geometry is. All else is listed in [`ImportReport::ignored`], also an image that is missing or broken; an
//! extension that a file requires and that is not supported is an error by name, unless it only changes the look of a
//! surface (clearcoat, sheen and the like).
//!
//! # Materials
//! With metallic m, roughness r, base colour c and F0 = min(((ior − 1)/(ior + 1))² · specularColorFactor, 1) · specularFactor:
//!
//! * r ≤ 0.01 counts as polished: mirror share m tinted by c, the rest (1 − m) Lambert, no highlight;
//! * from there to r = 0.105 the mirror fades: its share is m p with p = (0.105 − r)/0.095, and k_s below is times 1 − p;
//! * else diffuse k_d = 1 − m, k_s = lerp(F0 (1 − r), c, m), and the exponent whose Blinn-Phong lobe is as wide as the
//!   microfacet one, [`shininess_from_roughness`]. A dielectric of roughness 1 is so pure Lambert, and a metal of roughness
//!   1 (glTF's default) looks nearly so, with albedo c;
//! * transmission t makes smooth glass of the dielectric share (1 − m) t, whatever r is; closed meshes refract with or
//!   without a volume;
//! * textures of metalness, roughness, transmission, F0 and colour count place by place
//!   ([`Material::physical`](crate::Material::physical)); the material's own fields stand for their mean;
//! * `MASK` cuts holes per texel, for rays, moments and the raster alike, from the image itself at any distance;
//! * `BLEND` is thin transmission, place by place: a share 1 − alpha of the light passes straight on, without refraction or
//!   tint, the rest meets the surface. Alpha is the factor's times the texture's times the vertex's. A texture of hardly any
//!   middling alpha is cut out at one half instead, which keeps its shape and its shadow. Blended surfaces throw whole
//!   shadows where glass does;
//! * normal maps turn the interpolated normal in the frame of `TANGENT`; without it in the frame that each triangle's texture
//!   coordinates span;
//! * samplers: what the camera sees, directly or by mirror and glass, is read from the smaller copy of the image whose texels
//!   have the pixel's area, on both lanes; without a `minFilter` copies are blended. VPLs, emission as a source of light and
//!   the path tracer read the image itself;
//! * `KHR_materials_pbrSpecularGlossiness`: F0 is the specular colour, r = 1 − glossiness, and c and m come of the diffuse
//!   colour and F0 ([`metal_of_reflectance`](crate::material::metal_of_reflectance)): what reflects more than 0.08 is metal to
//!   that extent, so that a polished one is a mirror;
//! * occlusion textures are left out: what of the light reaches a place is computed here, by shadow maps and by VPLs and their
//!   visibility, and so it is by the path tracer that judges the picture. Baked darkness on top would count it twice.
//!
//! **Out**: [`export_glb`] writes the posed frame so that other renderers can draw it and [`load_gltf`] gets back the same
//! instances, materials, lights and camera.
//!
//! **Contract**: files may be hostile. No input makes these functions panic, hang or allocate beyond
//! [`ImportLimits`]; nothing outside the asset's folder is read, and no network place. Every index and size is checked
//! before use; degenerate triangles are kept (no ray meets them); positions that are not finite are an error.

mod accessor;
mod animation;
mod buffers;
mod container;
mod document;
mod error;
mod export;
mod geometry;
mod import;
mod limits;
mod materials;
mod nodes;
mod punctual;
mod report;
mod scene;
mod spawn;
mod textures;
mod uri;

pub use error::GltfError;
pub use export::{export_glb, export_glb_bytes};
pub use import::{load_gltf, load_gltf_bytes};
pub use limits::ImportLimits;
pub use materials::{MAX_SHININESS, roughness_from_shininess, shininess_from_roughness};
pub use report::ImportReport;
pub use scene::{ImportedAnimation, ImportedDeformation, ImportedNode, ImportedPrimitive, ImportedScene, NodeClip};
pub use spawn::Spawned;
