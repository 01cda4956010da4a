//! Helpers that put things on a scene's stage.

use bevy_app::App;
use bevy_ecs::prelude::*;
use bevy_transform::components::Transform;
use catoptra_engine::{
    Assets, CameraProjection, LightKind, LightSource, Material, MaterialId, Mesh, MeshId, MeshInstance, Projection,
    StableId, app, extract::SceneEnvironment, math, render_scene::Environment,
};
use catoptra_physics_lite::{Path, PathFollower, PhysicsLitePlugin, PreviousPose, Sine};
use glam::{Quat, Vec3};

/// Ids of the camera and of the first light; instances count up from 1.
pub const CAMERA_ID: u64 = 1;
/// See [`CAMERA_ID`].
pub const LIGHT_ID: u64 = 1;

/// An app under construction.
pub struct Stage {
    app: App,
    next_instance: u64,
    next_light: u64,
}

impl Stage {
    /// Engine, motion and a background radiance.
    pub fn new(background: Vec3) -> Self {
        let mut app = app::new_app();
        app.add_plugins(PhysicsLitePlugin);
        app.insert_resource(SceneEnvironment(Environment { background, ambient: Vec3::ZERO }));
        Self { app, next_instance: 1, next_light: LIGHT_ID }
    }

    /// The world, for what the helpers do not cover.
    pub fn world(&mut self) -> &mut World {
        self.app.world_mut()
    }
    /// Id that the next instance will get; `count` ids are taken.
    pub fn take_ids(&mut self, count: u64) -> u64 {
        let first = self.next_instance;
        self.next_instance += count;
        first
    }
    /// Adds a mesh.
    pub fn mesh(&mut self, mesh: Mesh) -> MeshId {
        self.world().resource_mut::<Assets>().add_mesh(mesh)
    }
    /// Adds a material.
    pub fn material(&mut self, material: Material) -> MaterialId {
        self.world().resource_mut::<Assets>().add_material(material)
    }

    /// Spawns a mesh that stays where it is.
    pub fn fixed(&mut self, mesh: MeshId, material: MaterialId, transform: Transform) -> Entity {
        let id = StableId(self.take_ids(1));
        self.world().spawn((id, MeshInstance { mesh, material }, transform)).id()
    }
    /// Spawns a mesh that a component of physics_lite moves.
    pub fn body(&mut self, mesh: MeshId, material: MaterialId, motion: impl Bundle) -> Entity {
        let id = StableId(self.take_ids(1));
        self.world().spawn((id, MeshInstance { mesh, material }, PreviousPose::default(), motion)).id()
    }

    /// Spawns a spot light on a path. `inner` and `outer` are half angles of the cone in degrees; `intensity` in W/sr.
    pub fn spot(&mut self, follower: PathFollower, intensity: Vec3, radius: f32, inner: f32, outer: f32) -> Entity {
        let cos = |degrees: f32| math::cos(degrees.to_radians());
        let kind = LightKind::Spot { cos_inner: cos(inner), cos_outer: cos(outer) };
        let id = StableId(self.next_light);
        self.next_light += 1;
        self.world().spawn((id, LightSource { kind, intensity, radius }, PreviousPose::default(), follower)).id()
    }

    /// Spawns the camera on a path; `fov_y` in degrees.
    pub fn camera(&mut self, follower: PathFollower, fov_y: f32) -> Entity {
        let projection = Projection::Perspective { fov_y: fov_y.to_radians() };
        let lens = CameraProjection { projection, near: 0.02 };
        self.world().spawn((StableId(CAMERA_ID), lens, PreviousPose::default(), follower)).id()
    }

    /// As [`Self::finish`], with one more plugin.
    pub fn finish_with(mut self, plugin: impl bevy_app::Plugin) -> App {
        self.app.add_plugins(plugin);
        self.finish()
    }

    /// The scene at frame 0.
    pub fn finish(mut self) -> App {
        app::settle(&mut self.app);
        // The pose before the first step is the one of frame 0.
        let mut query = self.app.world_mut().query::<(&Transform, &mut PreviousPose)>();
        for (now, mut previous) in query.iter_mut(self.app.world_mut()) {
            *previous = PreviousPose(*now);
        }
        self.app
    }
}

/// A path around `center` with one sine an axis: amplitudes in metres, periods in seconds, phases in radians.
pub fn sway(center: Vec3, amplitude: Vec3, periods: [f64; 3], phases: [f64; 3]) -> Path {
    let axes = [Vec3::X, Vec3::Y, Vec3::Z];
    let terms =
        (0..3).map(|i| Sine { amplitude: axes[i] * amplitude[i], period_secs: periods[i], phase: phases[i] }).collect();
    Path::Sines { center, terms }
}

/// A follower that looks at a path.
pub fn looking(position: Path, target: Path) -> PathFollower {
    PathFollower { position, target: Some(target) }
}

/// A pose with uniform scale.
pub fn placed(translation: Vec3, rotation: Quat, scale: f32) -> Transform {
    Transform { translation, rotation, scale: Vec3::splat(scale) }
}
