//! Scenes built by hand, without an ECS.

use crate::fixtures;
use catoptra_engine::{
    Camera, Environment, Instance, Light, LightKind, Material, Mesh, Projection, RenderScene,
    camera::world_from_view_looking_at, shapes::ShapeBuilder,
};
use catoptra_render_hybrid::{Frame, RenderSettings, Shadows};
use glam::{Affine3, Mat3, Vec3};
use std::sync::Arc;

/// A [`RenderScene`] under construction. Ids count up in the order of addition.
#[derive(Clone, Debug, Default)]
pub struct HandScene(pub RenderScene);

impl HandScene {
    /// Nothing but a camera.
    pub fn new(camera: Camera) -> Self {
        Self(RenderScene { camera, ..RenderScene::default() })
    }
    /// A camera of parallel rays at `eye` along `direction`; half of the picture is `half_height` metres high.
    pub fn parallel(eye: Vec3, direction: Vec3, half_height: f32) -> Self {
        Self::new(Camera {
            world_from_view: world_from_view_looking_at(eye, eye + direction),
            projection: Projection::Orthographic { half_height },
            near: 0.0,
        })
    }
    /// Radiance of rays that leave the scene.
    pub fn background(mut self, radiance: Vec3) -> Self {
        self.0.environment = Environment { background: radiance, ..self.0.environment };
        self
    }
    /// Adds a mesh with a material of its own at a pose; returns its instance id.
    pub fn add(&mut self, mesh: Mesh, material: Material, world_from_object: Affine3) -> u32 {
        let s = &mut self.0;
        s.meshes.push(Arc::new(mesh));
        s.materials.push(material);
        let n = s.instances.len() as u32;
        s.instances.push(Instance { stable_id: u64::from(n), mesh: n, material: n, world_from_object });
        n
    }
    /// Adds a light that shines downwards (where it has a direction).
    pub fn light(&mut self, kind: LightKind, position_world: Vec3, intensity: Vec3) -> &mut Light {
        self.0.lights.push(Light {
            stable_id: self.0.lights.len() as u64,
            kind,
            position_world,
            direction_world: Vec3::NEG_Y,
            up_world: Vec3::Z,
            intensity,
            radius: 0.0,
        });
        self.0.lights.last_mut().expect("one was just added")
    }
    /// Settings of a picture of traced shadows and without indirect light: what paper formulas speak of.
    pub fn settings(width: u32, height: u32) -> RenderSettings {
        RenderSettings { shadows: Shadows::Traced, vpl: None, ..fixtures::small(width, height, 64) }
    }
    /// A picture on the CPU lane by a fresh renderer.
    ///
    /// # Panics
    /// Where the scene or the settings cannot be drawn.
    pub fn render(&self, settings: &RenderSettings) -> Frame {
        fixtures::fresh(&self.0, settings)
    }
    /// The one pixel of a 1 x 1 picture with [`Self::settings`], changed by `change`.
    ///
    /// # Panics
    /// As [`Self::render`].
    pub fn pixel(&self, change: impl FnOnce(&mut RenderSettings)) -> Vec3 {
        let mut settings = Self::settings(1, 1);
        change(&mut settings);
        Vec3::from(self.render(&settings).image.at(0, 0))
    }
}

/// A pose without rotation.
pub fn at(translation: Vec3) -> Affine3 {
    Affine3 { matrix3: Mat3::IDENTITY, translation }
}

/// A square wall with corners `center ± u ± v` that shows its own position: unlit colours (along, across, 1) with
/// along = 0.5 + 0.5·u-coordinate, across = 0.5 + 0.5·v-coordinate, both coordinates in [-1, 1]. A picture of it divided by
/// its third channel tells where a ray ended, whatever weight it had.
pub fn wall_of_positions(center: Vec3, u: Vec3, v: Vec3) -> (Mesh, Material) {
    let mut b = ShapeBuilder::default();
    let n = u.cross(v).normalize_or(Vec3::Z);
    let corner = |x: f32, y: f32, b: &mut ShapeBuilder| {
        b.vertices([(center + u * x + v * y, n)], Vec3::new(0.5 + 0.5 * x, 0.5 + 0.5 * y, 1.0))
    };
    let [p, q, r, s] = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| corner(x, y, &mut b));
    b.triangles([[p, q, r], [p, r, s]]);
    (b.build(), Material { unlit: true, ..Material::default() })
}
