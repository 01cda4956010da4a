//! The module as a plugin of a bevy app: `app.add_plugins(RenderHybridPlugin::default())`.
//!
//! After each `App::update` the resource [`RenderedFrames`] holds one picture a camera, made from the world as that update
//! left it: whatever was spawned, moved, hidden, re-parented, given another mesh or despawned shows at once. Nothing is
//! registered; `Changed<GlobalTransform>` and its like tell what to update.

use bevy_app::{App, Last, Plugin};
use bevy_ecs::{prelude::*, system::SystemParam};
use catoptra_engine::{
    EnginePlugin, Extracted, ExtractedCameras, SceneError,
    assets::Assets,
    extract::{ExtractIndex, extract},
};
use std::sync::Arc;

use crate::{
    accel::Ray,
    error::RenderError,
    output::{Frame, Image},
    query::{SceneQuery, SurfaceHit},
    renderer::Renderer,
    settings::{RenderSettings, RendererOptions},
};

/// Renders every camera of the world after each update. Brings [`EnginePlugin`] along where the app has none.
///
/// Where the renderer cannot be made (an explicit lane that is not there) the app runs on without pictures: each camera's
/// entry in [`RenderedFrames`] is the error.
#[derive(Clone, Debug, Default)]
pub struct RenderHybridPlugin {
    /// Lane, threads, SIMD level.
    pub options: RendererOptions,
    /// Settings of cameras that have no [`CameraSettings`].
    pub settings: RenderSettings,
    /// A device of the host's, which [`RenderTarget::View`] needs; `None`: the renderer finds its own.
    pub device: Option<(wgpu::Device, wgpu::Queue)>,
}

impl RenderHybridPlugin {
    /// The plugin with pictures of another size, pixels.
    pub fn of_size(width: u32, height: u32) -> Self {
        Self::with_settings(RenderSettings { width, height, ..RenderSettings::default() })
    }
    /// The plugin with other settings.
    pub fn with_settings(settings: RenderSettings) -> Self {
        Self { settings, ..Self::default() }
    }
}

impl Plugin for RenderHybridPlugin {
    fn build(&self, app: &mut App) {
        if !app.world().contains_resource::<Assets>() {
            app.add_plugins(EnginePlugin);
        }
        let made = match &self.device {
            Some((device, queue)) => Renderer::with_device(device.clone(), queue.clone(), self.options),
            None => Renderer::new(self.options),
        };
        if let Err(error) = &made {
            tracing::error!("no pictures will be made: {error}");
        }
        app.insert_resource(HybridRenderer(made.map_err(Arc::new)))
            .insert_resource(DefaultSettings(self.settings))
            .init_resource::<RenderedFrames>()
            .add_systems(Last, render_cameras.after(extract));
    }
}

/// Settings of all cameras that have no [`CameraSettings`]; may change at any time.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct DefaultSettings(pub RenderSettings);

/// Settings of one camera.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct CameraSettings(pub RenderSettings);

/// Where a camera's picture goes. A camera without this component is read back to memory.
#[derive(Component, Clone, Debug, Default)]
pub enum RenderTarget {
    /// To memory: [`Frame::image`] of the camera's entry in [`RenderedFrames`].
    #[default]
    Image,
    /// Drawn over all of a view of the plugin's device; the entry's image stays empty.
    View {
        /// A view with `RENDER_ATTACHMENT` usage.
        view: wgpu::TextureView,
        /// Its format: 8-bit or float colour; sRGB-coded where the format does not do it.
        format: wgpu::TextureFormat,
        /// Exposure, powers of two.
        exposure_ev: f32,
    },
    /// No picture is made.
    Off,
}

/// The renderer at work, or why there is none.
#[derive(Resource)]
pub struct HybridRenderer(pub Result<Renderer, Arc<RenderError>>);

/// One camera's picture.
#[derive(Clone, Debug)]
pub struct RenderedCamera {
    /// The camera.
    pub entity: Entity,
    /// The picture and its figures, or why there is none.
    pub frame: Result<Frame, Arc<RenderError>>,
}

/// The pictures of the last update, by ascending `StableId` of their cameras.
#[derive(Resource, Clone, Debug, Default)]
pub struct RenderedFrames {
    cameras: Vec<RenderedCamera>,
}

impl RenderedFrames {
    /// All of them. Cameras that are despawned, hidden or [`RenderTarget::Off`] have none.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &RenderedCamera> {
        self.cameras.iter()
    }
    /// The picture of a camera; `None` where it made none or failed.
    pub fn of(&self, camera: Entity) -> Option<&Frame> {
        self.cameras.iter().find(|c| c.entity == camera)?.frame.as_ref().ok()
    }
    /// The picture of the camera with the lowest `StableId`.
    pub fn first(&self) -> Option<&Frame> {
        self.cameras.first()?.frame.as_ref().ok()
    }
    /// The first error of the update.
    pub fn error(&self) -> Option<&RenderError> {
        self.cameras.iter().find_map(|c| c.frame.as_ref().err()).map(Arc::as_ref)
    }
}

/// Draws each camera's picture; runs in `Last`, after extraction.
pub fn render_cameras(
    mut renderer: ResMut<HybridRenderer>,
    defaults: Res<DefaultSettings>,
    cameras: Res<ExtractedCameras>,
    chosen: Query<(Option<&CameraSettings>, Option<&RenderTarget>)>,
    mut extracted: ResMut<Extracted>,
    mut frames: ResMut<RenderedFrames>,
    mut complained: Local<Option<String>>,
) {
    let scene = &mut extracted.bypass_change_detection().0;
    let own = scene.camera;
    frames.cameras.clear();
    for view in &cameras.0 {
        let (settings, target) = chosen.get(view.entity).unwrap_or((None, None));
        let settings = settings.map_or(&defaults.0, |s| &s.0);
        scene.camera = view.camera;
        let frame = match (&mut renderer.0, target) {
            (_, Some(RenderTarget::Off)) => continue,
            (Err(error), _) => Err(error.clone()),
            (Ok(renderer), Some(RenderTarget::View { view, format, exposure_ev })) => renderer
                .render_to_view(scene, settings, view, *format, *exposure_ev)
                .map(|stats| Frame { image: Image::default(), layers: Vec::new(), stats })
                .map_err(Arc::new),
            (Ok(renderer), _) => renderer.render(scene, settings).map_err(Arc::new),
        };
        frames.cameras.push(RenderedCamera { entity: view.entity, frame });
    }
    scene.camera = own;
    // Each new trouble is told once, not in every frame.
    let trouble = frames.error().map(ToString::to_string);
    if let Some(text) = trouble.as_ref().filter(|t| complained.as_ref() != Some(*t)) {
        tracing::error!("a camera has no picture: {text}");
    }
    *complained = trouble;
}

/// A [`SurfaceHit`] with the entity that was met.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EntityHit {
    /// The entity with the `MeshInstance`.
    pub entity: Entity,
    /// The place on it.
    pub surface: SurfaceHit,
}

/// Picking for systems: rays against the world as the last update drew it.
#[derive(SystemParam)]
pub struct Raycaster<'w> {
    renderer: ResMut<'w, HybridRenderer>,
    scene: Res<'w, Extracted>,
    index: Res<'w, ExtractIndex>,
}

impl Raycaster<'_> {
    /// Questions without entities.
    ///
    /// # Errors
    /// [`RenderError::Scene`] where the world cannot be drawn, and what kept the renderer from being made.
    pub fn query(&mut self) -> Result<SceneQuery<'_>, Arc<RenderError>> {
        let scene = &self.scene.0;
        match &mut self.renderer.0 {
            Ok(renderer) => renderer.query(scene).map_err(|e: SceneError| Arc::new(e.into())),
            Err(error) => Err(error.clone()),
        }
    }

    /// First entity along the ray; `None` for a miss, and where the world cannot be drawn.
    pub fn raycast(&mut self, ray: &Ray) -> Option<EntityHit> {
        let hit = self.query().ok()?.raycast(ray);
        self.named(hit)
    }

    /// All entities along the ray, nearest first, at most `limit`.
    pub fn raycast_all(&mut self, ray: &Ray, limit: usize) -> Vec<EntityHit> {
        let hits = self.query().map(|q| q.raycast_all(ray, limit)).unwrap_or_default();
        hits.into_iter().filter_map(|h| self.named(Some(h))).collect()
    }

    /// [`Self::raycast`] of each ray, on all threads.
    pub fn raycast_many(&mut self, rays: &[Ray]) -> Vec<Option<EntityHit>> {
        let hits = self.query().map(|q| q.raycast_many(rays)).unwrap_or_else(|_| vec![None; rays.len()]);
        hits.into_iter().map(|h| self.named(h)).collect()
    }

    /// True where anything lies on the ray.
    pub fn occluded(&mut self, ray: &Ray) -> bool {
        self.query().is_ok_and(|q| q.occluded(ray))
    }

    fn named(&self, hit: Option<SurfaceHit>) -> Option<EntityHit> {
        let surface = hit?;
        Some(EntityHit { entity: self.index.entity(surface.instance_id)?, surface })
    }
}
