//! Meshes, materials and textures of a world, by number.

use crate::{material::Material, mesh::Mesh, texture::Texture};
use bevy_ecs::prelude::*;
use std::sync::Arc;

/// Number of a mesh in [`Assets`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct MeshId(pub u32);
/// Number of a material in [`Assets`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct MaterialId(pub u32);
/// Number of a texture in [`Assets`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TextureId(pub u32);

/// All assets of a world. Changing it in any way makes the next extraction a full one.
#[derive(Resource, Clone, Debug, Default)]
pub struct Assets {
    /// Meshes, shared with renderers.
    pub meshes: Vec<Arc<Mesh>>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Textures, shared with renderers.
    pub textures: Vec<Arc<Texture>>,
}

impl Assets {
    /// Adds a mesh.
    pub fn add_mesh(&mut self, mesh: Mesh) -> MeshId {
        self.meshes.push(Arc::new(mesh));
        MeshId(self.meshes.len() as u32 - 1)
    }
    /// Adds a material.
    pub fn add_material(&mut self, material: Material) -> MaterialId {
        self.materials.push(material);
        MaterialId(self.materials.len() as u32 - 1)
    }
    /// Adds a texture.
    pub fn add_texture(&mut self, texture: Texture) -> TextureId {
        self.textures.push(Arc::new(texture));
        TextureId(self.textures.len() as u32 - 1)
    }
}
