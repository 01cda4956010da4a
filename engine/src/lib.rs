//! The world of Catoptra: ECS components, assets, procedural shapes, glTF in and out, a fixed clock, and extraction
//! of the world into a flat [`RenderScene`].
//!
//! **Architecture invariant:** nothing here knows wgpu, winit or any renderer. Below [`extract`] nobody sees the ECS
//! `World`: [`RenderScene`] is the renderers' only input.
//!
//! Space is right-handed, +Y up, metres; cameras and lights look along their own -Z, as in glTF.

pub mod animation;
pub mod app;
pub mod assets;
pub mod camera;
pub mod clock;
pub mod components;
pub mod extract;
pub mod fit;
pub mod gltf;
pub mod light;
pub mod material;
pub mod math;
pub mod mesh;
pub mod render_scene;
pub mod shapes;
pub mod texture;

pub use app::{EnginePlugin, new_app};
pub use assets::{Assets, MaterialId, MeshId, TextureId};
pub use camera::{Camera, Projection};
pub use clock::{FIXED_DT_SECS, FixedClock, FixedUpdate};
pub use components::{CameraProjection, Hidden, LightSource, MeshInstance, StableId};
pub use extract::{Extracted, ExtractedCamera, ExtractedCameras};
pub use fit::{fit_camera, headlight};
pub use gltf::{GltfError, ImportLimits, ImportReport, ImportedScene, export_glb, load_gltf, load_gltf_bytes};
pub use light::{Light, LightKind};
pub use material::{Look, Material, Mip, Physical, PhysicalPlace, TextureRef, Wrap};
pub use mesh::{Aabb, Mesh, MeshData, MeshError};
pub use render_scene::{Environment, Instance, RenderScene, SceneError};
pub use texture::{Texture, TextureError};

pub use bevy_app;
pub use bevy_ecs;
pub use bevy_transform;
pub use glam;
