//! An imported scene as entities.

use super::scene::{ImportedAnimation, ImportedScene, invertible};
use crate::{
    animation::{Deformer, MorphWeights, NodeAnimation},
    assets::{Assets, MaterialId, MeshId},
    components::{Hidden, MeshInstance, StableId},
    extract::SceneEnvironment,
};
use bevy_ecs::{hierarchy::ChildOf, name::Name, prelude::*};
use bevy_transform::components::Transform;

/// The entities of one [`ImportedScene::spawn`].
#[derive(Clone, Debug, PartialEq)]
pub struct Spawned {
    /// Parent of all; moving it moves the whole scene, despawning it removes the scene.
    pub root: Entity,
    /// One entity a node, in node order.
    pub nodes: Vec<Entity>,
    /// The camera that makes the picture (the first), if the file has one.
    pub camera: Option<Entity>,
    /// First stable id that is still free.
    pub next_stable_id: u64,
}

impl ImportedScene {
    /// Adds the assets to [`Assets`] and one entity a node, as children of a new root. A node's first mesh and its light or
    /// camera live on its own entity, further meshes on children of it. Stable ids count up in node order from
    /// `first_stable_id`: meshes, then light, then camera of each node. Hidden nodes, and meshes whose pose has no volume,
    /// are spawned [`Hidden`]. An environment of the file becomes the world's. The
    /// first animation plays from frame 0 on, over and over: [`Self::play`] chooses another or none;
    /// [`Self::to_render_scene`] shows the pose of the file instead.
    ///
    /// # Panics
    /// When a node was given a parent, mesh or material that is not in the scene.
    pub fn spawn(&self, world: &mut World, first_stable_id: u64) -> Spawned {
        let mut assets = world.get_resource_or_init::<Assets>();
        let (first_mesh, first_material, first_texture) =
            (assets.meshes.len(), assets.materials.len(), assets.textures.len() as u32);
        assets.meshes.extend(self.meshes.iter().cloned());
        assets.textures.extend(self.textures.iter().cloned());
        assets.materials.extend(self.materials.iter().map(|m| {
            let mut m = *m;
            m.textures_mut().for_each(|t| t.texture += first_texture);
            m
        }));
        if let Some(environment) = self.environment {
            world.insert_resource(SceneEnvironment(environment));
        }

        let animated = self.animations.iter().any(|a| !a.tracks.is_empty());
        let mut drawn_by = vec![None; self.meshes.len()];
        let mut next_stable_id = first_stable_id;
        let mut id = || {
            next_stable_id += 1;
            StableId(next_stable_id - 1)
        };
        let root = world.spawn(Transform::IDENTITY).id();
        let mut nodes: Vec<Entity> = Vec::with_capacity(self.nodes.len());
        let mut camera = None;
        for ((node, pose), shown) in self.nodes.iter().zip(self.world_from_node()).zip(self.shown()) {
            let parent = node.parent.map_or(root, |p| nodes[p]);
            let entity = world.spawn((node.transform, ChildOf(parent))).id();
            nodes.push(entity);
            if let Some(name) = &node.name {
                world.entity_mut(entity).insert(Name::new(name.clone()));
            }
            if node.hidden {
                world.entity_mut(entity).insert(Hidden);
            }
            let mut used = false;
            for p in &node.primitives {
                let instance = MeshInstance {
                    mesh: MeshId((first_mesh + p.mesh) as u32),
                    material: MaterialId((first_material + p.material) as u32),
                };
                let target = place(world, entity, &mut used);
                world.entity_mut(target).insert((instance, id()));
                drawn_by[p.mesh] = Some(target);
                // What has no volume now may have one later.
                if !invertible(&pose) && !animated {
                    world.entity_mut(target).insert(Hidden);
                }
            }
            if let Some(light) = node.light {
                let target = place(world, entity, &mut used);
                world.entity_mut(target).insert((light, id()));
            }
            if let Some(lens) = node.camera {
                let target = place(world, entity, &mut used);
                world.entity_mut(target).insert((lens, id()));
                if shown {
                    camera.get_or_insert(target);
                }
            }
        }
        self.spawn_deformations(world, &nodes, &drawn_by, first_mesh);
        let spawned = Spawned { root, nodes, camera, next_stable_id };
        self.play(world, &spawned, (!self.animations.is_empty()).then_some(0));
        spawned
    }

    /// Makes every mesh that an animation changes ready to follow.
    fn spawn_deformations(&self, world: &mut World, nodes: &[Entity], drawn_by: &[Option<Entity>], first_mesh: usize) {
        for d in &self.deformations {
            let Some(entity) = drawn_by[d.mesh] else { continue };
            world.entity_mut(nodes[d.node]).insert(MorphWeights(d.weights.clone()));
            world.entity_mut(entity).insert(Deformer {
                source: d.source.clone(),
                mesh: MeshId((first_mesh + d.mesh) as u32),
                weights_of: Some(nodes[d.node]),
                joints: d.joints.iter().map(|(node, bind)| (node.map(|n| nodes[n]), *bind)).collect(),
                posed: None,
            });
        }
    }

    /// Plays one of [`Self::animations`] on the entities of an earlier [`Self::spawn`], which then stand at its pose of time
    /// 0; `None` stops. What no animation moves any longer goes back to the pose of the file.
    ///
    /// Its time is the clock's: at step 0 it begins.
    ///
    /// # Panics
    /// When there is no such animation, or an entity of `spawned` is gone.
    pub fn play(&self, world: &mut World, spawned: &Spawned, animation: Option<usize>) {
        let moved = |a: &ImportedAnimation| a.tracks.iter().map(|t| t.node).collect::<Vec<_>>();
        let mut touched: Vec<usize> = self.animations.iter().flat_map(moved).collect();
        touched.sort_unstable();
        touched.dedup();
        for node in touched {
            let mut entity = world.entity_mut(spawned.nodes[node]);
            // A node that was never moved is where the host has put it.
            if entity.take::<NodeAnimation>().is_some()
                && let Some(mut transform) = entity.get_mut::<Transform>()
            {
                *transform = self.nodes[node].transform;
            }
        }
        for d in &self.deformations {
            world.entity_mut(spawned.nodes[d.node]).insert(MorphWeights(d.weights.clone()));
        }
        let Some(animation) = animation.map(|i| &self.animations[i]) else { return };
        for a in &animation.tracks {
            let mut entity = world.entity_mut(spawned.nodes[a.node]);
            if let Some(mut transform) = entity.get_mut::<Transform>() {
                a.tracks.pose(0.0, &mut transform);
            }
            if let Some(track) = &a.tracks.weights {
                entity.insert(MorphWeights((0..track.width).map(|i| track.sample(0.0, i)).collect()));
            }
            entity.insert(NodeAnimation { tracks: a.tracks.clone(), duration: animation.duration });
        }
    }
}

/// The node's own entity the first time, then a child in the same place: an entity has one stable id.
fn place(world: &mut World, node: Entity, used: &mut bool) -> Entity {
    if std::mem::replace(used, true) { world.spawn((Transform::IDENTITY, ChildOf(node))).id() } else { node }
}
