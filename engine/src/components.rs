//! What an entity can be to the renderer. Pose is bevy's `Transform` (parents allowed).

use crate::{
    assets::{MaterialId, MeshId},
    camera::Projection,
    light::LightKind,
};
use bevy_ecs::prelude::*;
use bevy_transform::components::Transform;
use glam::Vec3;

/// Orders entities in the extracted scene, so that a world edited for an hour equals one freshly built. Unique per kind;
/// equal ids are ordered by entity.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct StableId(pub u64);

/// Draws a mesh with a material.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq)]
#[require(Transform)]
pub struct MeshInstance {
    /// Mesh in `Assets`.
    pub mesh: MeshId,
    /// Material in `Assets`.
    pub material: MaterialId,
}

/// Leaves an instance, a light or a camera out, and all that hangs on it.
#[derive(Component, Clone, Copy, Debug, Default)]
pub struct Hidden;

/// A light that shines along the entity's -Z.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
#[require(Transform)]
pub struct LightSource {
    /// Shape of emission.
    pub kind: LightKind,
    /// Radiant intensity (point, spot) or irradiance (directional) per channel.
    pub intensity: Vec3,
    /// Radius in metres (point, spot) or tangent of the angular radius (directional).
    pub radius: f32,
}

/// A camera that looks along the entity's -Z. Of several, the one with the lowest [`StableId`] is the scene's own.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
#[require(Transform)]
pub struct CameraProjection {
    /// Lens.
    pub projection: Projection,
    /// Nearest visible distance, metres.
    pub near: f32,
}
