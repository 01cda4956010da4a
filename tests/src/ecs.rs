//! Worlds copied entity by entity: what an edited world is compared with.

use bevy_app::App;
use bevy_ecs::{hierarchy::ChildOf, prelude::*};
use bevy_transform::components::Transform;
use catoptra_engine::{
    Assets, CameraProjection, Extracted, LightSource, MeshInstance, RenderScene, StableId,
    app::{new_app, settle},
    clock::FixedClock,
    components::Hidden,
    extract::SceneEnvironment,
};

/// A new app with the same assets, environment and entities, spawned afresh in the order of their ids. Motion and history
/// stay behind.
///
/// # Panics
/// Where an entity has a parent: poses are copied as they stand.
pub fn fresh_copy(app: &mut App) -> App {
    let mut copy = new_app();
    let world = app.world_mut();
    copy.insert_resource(world.resource::<Assets>().clone());
    copy.insert_resource(*world.resource::<SceneEnvironment>());
    let mut query = world.query::<(
        &StableId,
        &Transform,
        Option<&MeshInstance>,
        Option<&LightSource>,
        Option<&CameraProjection>,
        Has<Hidden>,
        Has<ChildOf>,
    )>();
    let mut rows: Vec<_> = query.iter(world).collect();
    rows.sort_by_key(|r| (*r.0, r.2.is_some(), r.3.is_some()));
    for (id, transform, mesh, light, camera, hidden, child) in rows {
        assert!(!child, "entity {id:?} has a parent");
        let mut entity = copy.world_mut().spawn((*id, *transform));
        if let Some(m) = mesh {
            entity.insert(*m);
        }
        if let Some(l) = light {
            entity.insert(*l);
        }
        if let Some(c) = camera {
            entity.insert(*c);
        }
        if hidden {
            entity.insert(Hidden);
        }
    }
    settle(&mut copy);
    copy
}

/// Extracts the world as it stands now, without a step of time.
pub fn extract_now(app: &mut App) -> RenderScene {
    let paused = std::mem::replace(&mut app.world_mut().resource_mut::<FixedClock>().paused, true);
    app.update();
    app.world_mut().resource_mut::<FixedClock>().paused = paused;
    app.world().resource::<Extracted>().0.clone()
}
