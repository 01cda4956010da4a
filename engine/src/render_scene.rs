//! The flat, sorted, hashable picture of a world: the only thing that renderers see.

use crate::{
    camera::{Camera, Projection},
    light::Light,
    material::Material,
    mesh::{Aabb, Mesh},
    texture::Texture,
};
use glam::{Affine3, Vec3};
use std::sync::Arc;

/// One mesh in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instance {
    /// Orders instances in the scene.
    pub stable_id: u64,
    /// Index into [`RenderScene::meshes`].
    pub mesh: u32,
    /// Index into [`RenderScene::materials`].
    pub material: u32,
    /// Object space to world space; invertible.
    pub world_from_object: Affine3,
}

/// Light that comes from no object.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Environment {
    /// Radiance of rays that leave the scene. It lights nothing by itself.
    pub background: Vec3,
    /// Ambient radiance i_a of the Blinn-Phong model.
    pub ambient: Vec3,
}

/// Everything a renderer needs, in flat arrays sorted by `StableId`. `Send`, cheap to clone (assets are shared).
///
/// `revision` and `moved` let a renderer update only what moved; they are hints that never change the picture: a renderer
/// that missed a revision (or met another world's scene, told by `origin`) compares everything.
/// Who edits a scene by hand says so: `begin_revision` first, then `set_transform` for moves; any other change of instances,
/// meshes or materials also sets `structure_revision = revision`.
#[derive(Debug, Default)]
pub struct RenderScene {
    /// Meshes; two instances of one mesh share its acceleration structure. Identity is the `Arc`'s address.
    pub meshes: Vec<Arc<Mesh>>,
    /// Textures.
    pub textures: Vec<Arc<Texture>>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Instances by ascending `stable_id`; the position here is the `instance_id` of hits.
    pub instances: Vec<Instance>,
    /// Lights by ascending `stable_id`.
    pub lights: Vec<Light>,
    /// The viewer.
    pub camera: Camera,
    /// Background and ambient radiance.
    pub environment: Environment,
    /// Which world it came from: equal addresses mean revisions can be compared.
    pub origin: Arc<()>,
    /// Counts extractions of one world.
    pub revision: u64,
    /// Instances whose transform changed since `revision - 1`, ascending.
    pub moved: Vec<u32>,
    /// Last revision at which anything but transforms, lights or the camera changed (instances, meshes, materials).
    pub structure_revision: u64,
}

/// Why a scene cannot be drawn.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SceneError {
    /// An index points beyond its array.
    #[error("instance {instance} names {what} {index}, but there are {len}")]
    Index {
        /// Stable id of the instance.
        instance: u64,
        /// `mesh` or `material`.
        what: &'static str,
        /// The index.
        index: u32,
        /// Length of the array.
        len: usize,
    },
    /// A transform, light or camera holds NaN, infinity or a value out of range.
    #[error("{what} is not usable: {why}")]
    NotUsable {
        /// Which thing.
        what: String,
        /// What is wrong with it.
        why: String,
    },
}

impl Clone for RenderScene {
    /// A copy with an `origin` of its own: from here on the two go their own ways, and revisions count within one history.
    fn clone(&self) -> Self {
        Self {
            meshes: self.meshes.clone(),
            textures: self.textures.clone(),
            materials: self.materials.clone(),
            instances: self.instances.clone(),
            lights: self.lights.clone(),
            camera: self.camera,
            environment: self.environment,
            origin: Arc::default(),
            revision: self.revision,
            moved: self.moved.clone(),
            structure_revision: self.structure_revision,
        }
    }
}

impl RenderScene {
    /// Bounds of all instances.
    pub fn bounds_world(&self) -> Aabb {
        self.instances.iter().fold(Aabb::EMPTY, |b, i| {
            b.union(self.meshes[i.mesh as usize].bounds_object().transformed(&i.world_from_object))
        })
    }

    /// Triangles of all instances.
    pub fn triangle_count(&self) -> usize {
        self.instances.iter().map(|i| self.meshes[i.mesh as usize].triangles().len()).sum()
    }

    /// Starts a new revision with nothing moved yet. For users without an ECS.
    pub fn begin_revision(&mut self) {
        self.revision += 1;
        self.moved.clear();
    }

    /// Moves an instance within the current revision. For users without an ECS.
    pub fn set_transform(&mut self, instance_id: u32, world_from_object: Affine3) {
        self.instances[instance_id as usize].world_from_object = world_from_object;
        if let Err(at) = self.moved.binary_search(&instance_id) {
            self.moved.insert(at, instance_id);
        }
    }

    /// Checks indices, ranges and finiteness, so that renderers need not.
    ///
    /// # Errors
    /// The first thing that is wrong, by its stable id.
    pub fn validate(&self) -> Result<(), SceneError> {
        let bad = |what: String, why: &str| Err(SceneError::NotUsable { what, why: why.to_string() });
        for i in &self.instances {
            let index = |what, index, len| Err(SceneError::Index { instance: i.stable_id, what, index, len });
            if i.mesh as usize >= self.meshes.len() {
                return index("mesh", i.mesh, self.meshes.len());
            }
            if i.material as usize >= self.materials.len() {
                return index("material", i.material, self.materials.len());
            }
            if !i.world_from_object.is_finite() {
                return bad(format!("transform of instance {}", i.stable_id), "it holds NaN or infinity");
            }
        }
        for (n, m) in self.materials.iter().enumerate() {
            if let Some((field, value)) = m.invalid_field() {
                return bad(format!("material {n}"), &format!("{field} = {value}"));
            }
            for t in m.textures() {
                if t.texture as usize >= self.textures.len() {
                    return bad(format!("material {n}"), &format!("it names texture {}", t.texture));
                }
            }
        }
        for l in &self.lights {
            let finite = l.position_world.is_finite()
                && l.direction_world.is_finite()
                && l.up_world.is_finite()
                && l.intensity.is_finite()
                && l.radius.is_finite();
            if !finite || l.intensity.min_element() < 0.0 || l.radius < 0.0 {
                return bad(format!("light {}", l.stable_id), "a value is NaN, infinite or negative");
            }
        }
        let e = &self.environment;
        if !e.background.is_finite() || !e.ambient.is_finite() {
            return bad("the environment".into(), "its background or ambient radiance is NaN or infinite");
        }
        let lens = match self.camera.projection {
            Projection::Perspective { fov_y } => fov_y > 0.0 && fov_y < std::f32::consts::PI,
            Projection::Orthographic { half_height } => half_height > 0.0 && half_height.is_finite(),
        };
        if !self.camera.world_from_view.is_finite() || !lens || !(self.camera.near >= 0.0) {
            return bad("the camera".into(), "its pose, lens or near distance is out of range");
        }
        Ok(())
    }
}
