//! World -> [`RenderScene`], touching only what changed.
//!
//! **Architecture invariant:** a body that only moved is found by `Changed<GlobalTransform>` and costs one matrix write; it
//! never causes a full extraction, and so never a rebuilt acceleration structure.

use crate::{
    assets::Assets,
    camera::Camera,
    components::{CameraProjection, Hidden, LightSource, MeshInstance, StableId},
    light::Light,
    render_scene::{Environment, Instance, RenderScene},
};
use bevy_ecs::{entity::EntityHashMap, hierarchy::ChildOf, prelude::*};
use bevy_transform::components::GlobalTransform;
use glam::{Affine3, Mat3, Vec3};

/// The scene of the last `App::update`.
#[derive(Resource, Clone, Debug, Default)]
pub struct Extracted(pub RenderScene);

/// A camera of the world, posed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExtractedCamera {
    /// Whose it is.
    pub entity: Entity,
    /// Orders cameras; equal ids are ordered by entity.
    pub stable_id: u64,
    /// Lens and pose.
    pub camera: Camera,
}

/// All cameras that are not [`Hidden`], by ascending [`StableId`]; the first is the one in [`Extracted`].
#[derive(Resource, Clone, Debug, Default, PartialEq)]
pub struct ExtractedCameras(pub Vec<ExtractedCamera>);

/// Background and ambient light of the world.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct SceneEnvironment(pub Environment);

/// Which entity stands at which place of the extracted arrays.
#[derive(Resource, Debug, Default)]
pub struct ExtractIndex {
    instance_of: EntityHashMap<u32>,
    entities: Vec<Entity>,
}

/// What hides: [`Hidden`] on the entity itself or on one above it.
#[derive(bevy_ecs::system::SystemParam)]
pub struct Hiding<'w, 's> {
    above: Query<'w, 's, &'static ChildOf>,
    hidden: Query<'w, 's, (), With<Hidden>>,
    hid: Query<'w, 's, (), Added<Hidden>>,
    shown: RemovedComponents<'w, 's, Hidden>,
    moved: Query<'w, 's, (), Changed<ChildOf>>,
    freed: RemovedComponents<'w, 's, ChildOf>,
}

impl Hiding<'_, '_> {
    /// Something was hidden or shown, or hangs elsewhere, since the last run.
    fn changed(&mut self) -> bool {
        let events = self.shown.read().count() + self.freed.read().count();
        events > 0 || !self.hid.is_empty() || !self.moved.is_empty()
    }

    fn is_visible(&self, entity: Entity) -> bool {
        if self.hidden.is_empty() {
            return true;
        }
        let mut at = entity;
        loop {
            if self.hidden.contains(at) {
                return false;
            }
            match self.above.get(at) {
                Ok(parent) => at = parent.parent(),
                Err(_) => return true,
            }
        }
    }
}

impl ExtractIndex {
    /// Entity behind an `instance_id` of the current scene.
    pub fn entity(&self, instance_id: u32) -> Option<Entity> {
        self.entities.get(instance_id as usize).copied()
    }
}

/// The extraction system; runs in `Last`, after transforms have propagated.
pub fn extract(
    assets: Res<Assets>,
    environment: Res<SceneEnvironment>,
    mut index: ResMut<ExtractIndex>,
    mut extracted: ResMut<Extracted>,
    mut extracted_cameras: ResMut<ExtractedCameras>,
    instances: Query<(Entity, &StableId, &MeshInstance, &GlobalTransform)>,
    moved: Query<(Entity, &GlobalTransform), (Changed<GlobalTransform>, With<MeshInstance>, With<StableId>)>,
    restructured: Query<(), (Or<(Changed<MeshInstance>, Changed<StableId>)>, With<MeshInstance>)>,
    mut gone: (RemovedComponents<MeshInstance>, RemovedComponents<StableId>),
    mut hiding: Hiding,
    lights: Query<(Entity, &StableId, &LightSource, &GlobalTransform)>,
    cameras: Query<(Entity, &StableId, &CameraProjection, &GlobalTransform)>,
) {
    let scene = &mut extracted.0;
    scene.begin_revision();
    scene.environment = environment.0;

    let removed = gone.0.read().count() + gone.1.read().count() > 0;
    let hidden = hiding.changed();
    if removed || hidden || assets.is_changed() || !restructured.is_empty() {
        let mut rows: Vec<(u64, Entity, Instance)> = instances
            .iter()
            .filter(|(e, ..)| hiding.is_visible(*e))
            .map(|(e, id, m, t)| {
                let instance =
                    Instance { stable_id: id.0, mesh: m.mesh.0, material: m.material.0, world_from_object: affine(t) };
                (id.0, e, instance)
            })
            .collect();
        rows.sort_by_key(|r| (r.0, r.1));
        scene.meshes.clone_from(&assets.meshes);
        scene.textures.clone_from(&assets.textures);
        scene.materials.clone_from(&assets.materials);
        scene.instances = rows.iter().map(|r| r.2).collect();
        scene.structure_revision = scene.revision;
        index.entities = rows.iter().map(|r| r.1).collect();
        index.instance_of = rows.iter().enumerate().map(|(i, r)| (r.1, i as u32)).collect();
    } else {
        for (entity, transform) in &moved {
            let Some(&i) = index.instance_of.get(&entity) else {
                continue;
            };
            let now = affine(transform);
            let was = &mut scene.instances[i as usize].world_from_object;
            // Change detection marks writes, not changes: a body at rest that is written each step has not moved.
            if *was != now {
                *was = now;
                scene.moved.push(i);
            }
        }
        scene.moved.sort_unstable();
    }

    let mut rows: Vec<(Entity, Light)> = lights
        .iter()
        .filter(|(e, ..)| hiding.is_visible(*e))
        .map(|(e, id, l, t)| (e, posed_light(id.0, l, &affine(t))))
        .collect();
    rows.sort_by_key(|(e, l)| (l.stable_id, *e));
    scene.lights.clear();
    scene.lights.extend(rows.iter().map(|r| r.1));

    let views = &mut extracted_cameras.0;
    views.clear();
    views.extend(cameras.iter().filter(|(e, ..)| hiding.is_visible(*e)).map(|(entity, id, lens, t)| ExtractedCamera {
        entity,
        stable_id: id.0,
        camera: posed_camera(lens, &affine(t)),
    }));
    views.sort_by_key(|v| (v.stable_id, v.entity));
    // A world without a camera looks as one that never had any.
    scene.camera = views.first().map_or_else(Camera::default, |v| v.camera);
}

fn affine(t: &GlobalTransform) -> Affine3 {
    let a = t.affine();
    Affine3 { matrix3: Mat3::from(a.matrix3), translation: Vec3::from(a.translation) }
}

/// Rotation part of `m`: its -Z kept, scale and shear removed.
fn orthonormal(m: Mat3) -> Mat3 {
    let z = m.z_axis.normalize_or(Vec3::Z);
    let x = m.y_axis.cross(z).normalize_or(crate::math::orthonormal_basis(z).0);
    Mat3::from_cols(x, z.cross(x), z)
}

/// A camera component at the world pose `m`; scale and shear are dropped.
pub(crate) fn posed_camera(c: &CameraProjection, m: &Affine3) -> Camera {
    Camera {
        world_from_view: Affine3 { matrix3: orthonormal(m.matrix3), translation: m.translation },
        projection: c.projection,
        near: c.near,
    }
}

/// A light component at the world pose `m`; scale and shear are dropped.
pub(crate) fn posed_light(stable_id: u64, l: &LightSource, m: &Affine3) -> Light {
    let pose = orthonormal(m.matrix3);
    Light {
        stable_id,
        kind: l.kind,
        position_world: m.translation,
        direction_world: -pose.z_axis,
        up_world: pose.y_axis,
        intensity: l.intensity,
        radius: l.radius,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Material, app, shapes};
    use bevy_transform::components::Transform;

    fn scene(app: &bevy_app::App) -> &RenderScene {
        &app.world().resource::<Extracted>().0
    }

    /// Three boxes and a light, spawned in the order of `ids`.
    fn world(ids: [u64; 3]) -> (bevy_app::App, [Entity; 3]) {
        let mut app = app::new_app();
        let mut assets = app.world_mut().resource_mut::<Assets>();
        let mesh = assets.add_mesh(shapes::cuboid(Vec3::ONE, [Vec3::ONE; 6]));
        let material = assets.add_material(Material::default());
        let boxes = ids.map(|id| {
            let place = Transform::from_xyz(id as f32, 0.0, 0.0);
            app.world_mut().spawn((StableId(id), MeshInstance { mesh, material }, place)).id()
        });
        let light = LightSource { kind: Default::default(), intensity: Vec3::ONE, radius: 0.0 };
        app.world_mut().spawn((StableId(9), light, Transform::from_xyz(0.0, 5.0, 0.0)));
        app::settle(&mut app);
        (app, boxes)
    }

    #[test]
    fn order_of_spawning_does_not_show() {
        let (a, _) = world([1, 2, 3]);
        let (b, _) = world([3, 1, 2]);
        assert_eq!(scene(&a).instances, scene(&b).instances);
        assert_eq!(scene(&a).lights.len(), 1);
        assert_eq!(scene(&a).triangle_count(), 36);
    }

    #[test]
    fn only_what_moved_is_listed() {
        let (mut app, boxes) = world([1, 2, 3]);
        let structure = scene(&app).structure_revision;
        app.update();
        assert!(scene(&app).moved.is_empty());
        app.world_mut().get_mut::<Transform>(boxes[1]).unwrap().translation.y = 4.0;
        // Written with what it already was: not a move.
        app.world_mut().get_mut::<Transform>(boxes[2]).unwrap().translation.y = 0.0;
        app.update();
        assert_eq!(scene(&app).moved, [1]);
        assert_eq!(scene(&app).instances[1].world_from_object.translation.y, 4.0);
        assert_eq!(scene(&app).structure_revision, structure);
    }

    #[test]
    fn hiding_showing_and_despawning_restructure() {
        let (mut app, boxes) = world([1, 2, 3]);
        app.world_mut().entity_mut(boxes[0]).insert(Hidden);
        app.update();
        assert_eq!(scene(&app).instances.len(), 2);
        assert_eq!(scene(&app).structure_revision, scene(&app).revision);
        app.world_mut().entity_mut(boxes[0]).remove::<Hidden>();
        app.update();
        assert_eq!(scene(&app).instances.len(), 3);
        app.world_mut().despawn(boxes[1]);
        app.update();
        assert_eq!(scene(&app).instances.iter().map(|i| i.stable_id).collect::<Vec<_>>(), [1, 3]);
        // A body that moves while hidden is right when it is shown again.
        app.world_mut().entity_mut(boxes[2]).insert(Hidden);
        app.update();
        app.world_mut().get_mut::<Transform>(boxes[2]).unwrap().translation.z = 7.0;
        app.update();
        app.world_mut().entity_mut(boxes[2]).remove::<Hidden>();
        app.update();
        assert_eq!(scene(&app).instances[1].world_from_object.translation.z, 7.0);
    }

    #[test]
    fn what_hangs_on_a_hidden_thing_is_hidden() {
        let (mut app, boxes) = world([1, 2, 3]);
        app.world_mut().entity_mut(boxes[1]).insert(ChildOf(boxes[0]));
        app.world_mut().entity_mut(boxes[0]).insert(Hidden);
        app.update();
        assert_eq!(scene(&app).instances.iter().map(|i| i.stable_id).collect::<Vec<_>>(), [3]);
        // Hung elsewhere it is seen again, at the pose that follows from its new parent.
        app.world_mut().entity_mut(boxes[1]).insert(ChildOf(boxes[2]));
        app.update();
        assert_eq!(scene(&app).instances.iter().map(|i| i.stable_id).collect::<Vec<_>>(), [2, 3]);
        assert_eq!(scene(&app).instances[0].world_from_object.translation.x, 5.0);
        app.world_mut().entity_mut(boxes[0]).remove::<Hidden>();
        app.update();
        assert_eq!(scene(&app).instances.len(), 3);
    }

    #[test]
    fn cameras_come_by_their_ids() {
        let (mut app, _) = world([1, 2, 3]);
        let lens = CameraProjection { projection: Camera::default().projection, near: 0.1 };
        let [far, near] = [(20, 4.0), (10, 7.0)]
            .map(|(id, z)| app.world_mut().spawn((StableId(id), lens, Transform::from_xyz(0.0, 0.0, z))).id());
        app.update();
        let cameras = |app: &bevy_app::App| app.world().resource::<ExtractedCameras>().0.clone();
        assert_eq!(cameras(&app).iter().map(|c| c.entity).collect::<Vec<_>>(), [near, far]);
        assert_eq!(scene(&app).camera.world_from_view.translation.z, 7.0);
        app.world_mut().entity_mut(near).insert(Hidden);
        app.update();
        assert_eq!(cameras(&app).len(), 1);
        assert_eq!(scene(&app).camera, cameras(&app)[0].camera);
    }
}
