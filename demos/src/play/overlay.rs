//! What is drawn over the picture: boxes of the two-level structure, virtual point lights.

use catoptra_engine::{Camera, RenderScene};
use catoptra_render_hybrid::Renderer;
use glam::Vec3;

/// Most boxes that are drawn.
const MOST_BOXES: usize = 3000;

/// Lines and dots in picture coordinates: [0, 1] from the top left corner.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Overlay {
    /// Ends of each line, and the level of its box; the upper tree's lie below 0.
    pub lines: Vec<([f32; 2], [f32; 2], i32)>,
    /// Middle and sRGB colour of each dot.
    pub dots: Vec<([f32; 2], [u8; 3])>,
}

impl Overlay {
    /// As the controls ask: `boxes` is the levels of the meshes' own trees.
    pub fn new(renderer: &Renderer, scene: &RenderScene, aspect: f32, boxes: Option<u32>, dots: bool) -> Self {
        let lens = Lens::new(&scene.camera, aspect);
        let mut overlay = Self::default();
        if let Some(levels) = boxes {
            for b in renderer.accel().boxes(scene, levels, MOST_BOXES) {
                let level = if b.upper { -1 } else { b.depth as i32 };
                for i in 0..8usize {
                    for bit in [1, 2, 4].into_iter().filter(|bit| i & bit == 0) {
                        overlay.lines.extend(lens.line(b.corners[i], b.corners[i | bit]).map(|(p, q)| (p, q, level)));
                    }
                }
            }
        }
        if dots {
            let most = renderer.vpls().iter().map(|v| v.flux.max_element()).fold(1e-12, f32::max);
            for vpl in renderer.vpls() {
                if let Some(at) = lens.point(vpl.position_world) {
                    let c = (vpl.flux / most).clamp(Vec3::splat(0.05), Vec3::ONE).to_array();
                    overlay.dots.push((at, c.map(catoptra_render_hybrid::image_io::srgb8_from_linear)));
                }
            }
        }
        overlay
    }
}

/// Projects world points to the picture.
struct Lens {
    view_from_world: glam::Affine3,
    half: [f32; 2],
    near: f32,
    perspective: bool,
}

impl Lens {
    fn new(camera: &Camera, aspect: f32) -> Self {
        let (half_w, half_h) = camera.half_extent((aspect * 1000.0) as u32, 1000);
        let perspective = matches!(camera.projection, catoptra_engine::Projection::Perspective { .. });
        let view_from_world = camera.world_from_view.inverse();
        Self { view_from_world, half: [half_w, half_h], near: camera.near.max(1e-3), perspective }
    }

    fn on_picture(&self, p: Vec3) -> [f32; 2] {
        let depth = if self.perspective { -p.z } else { 1.0 };
        [0.5 + 0.5 * p.x / (depth * self.half[0]), 0.5 - 0.5 * p.y / (depth * self.half[1])]
    }

    fn point(&self, world: Vec3) -> Option<[f32; 2]> {
        let p = self.view_from_world.transform_point3(world);
        let at = self.on_picture(p);
        (-p.z > self.near && at.iter().all(|c| (0.0..=1.0).contains(c))).then_some(at)
    }

    /// A line, cut at the near plane.
    fn line(&self, a: Vec3, b: Vec3) -> Option<([f32; 2], [f32; 2])> {
        let (mut a, mut b) = (self.view_from_world.transform_point3(a), self.view_from_world.transform_point3(b));
        if -a.z < -b.z {
            std::mem::swap(&mut a, &mut b);
        }
        if -a.z <= self.near {
            return None;
        }
        if -b.z < self.near {
            b = a + (b - a) * ((-a.z - self.near) / (b.z - a.z));
        }
        Some((self.on_picture(a), self.on_picture(b)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{self, SceneOptions};
    use catoptra_engine::Extracted;
    use catoptra_render_hybrid::{RasterLane, RenderSettings, RendererOptions};

    #[test]
    fn points_project_where_camera_rays_see_them() {
        let camera = Camera::looking_at(Vec3::new(1.0, 2.0, 3.0), Vec3::ZERO, 0.9);
        let (origin, direction) = camera.ray(30.0, 20.0, 160, 90);
        let at = Lens::new(&camera, 160.0 / 90.0).point(origin + direction * 2.5).unwrap();
        assert!((at[0] - 30.0 / 160.0).abs() < 1e-3 && (at[1] - 20.0 / 90.0).abs() < 1e-3, "{at:?}");
        assert!(Lens::new(&camera, 1.0).point(origin - direction).is_none());
        assert!(Lens::new(&camera, 1.0).line(origin - direction, origin + direction).is_some());
    }

    #[test]
    fn boxes_hold_what_they_are_of() {
        let app = scenes::build("rolling-box-donut", &SceneOptions::default()).unwrap();
        let scene = &app.world().resource::<Extracted>().0;
        let mut renderer = Renderer::new(RendererOptions { raster: RasterLane::Cpu, ..Default::default() }).unwrap();
        renderer.render(scene, &RenderSettings { width: 16, height: 16, ..Default::default() }).unwrap();
        let boxes = renderer.accel().boxes(scene, 2, 10_000);
        assert_eq!(boxes.iter().filter(|b| b.upper).count(), scene.instances.len());
        assert!(boxes.iter().any(|b| !b.upper && b.depth == 1), "the donut's tree has two levels");
        for instance in &scene.instances {
            let bounds = scene.meshes[instance.mesh as usize].bounds_object().transformed(&instance.world_from_object);
            let holds = boxes
                .iter()
                .filter(|b| b.upper)
                .any(|b| b.corners[0].cmple(bounds.min + 1e-3).all() && b.corners[7].cmpge(bounds.max - 1e-3).all());
            assert!(holds, "instance {}", instance.stable_id);
        }
        let overlay = Overlay::new(&renderer, scene, 1.0, Some(2), true);
        assert!(overlay.lines.len() > 100 && overlay.dots.len() > 10);
        assert_eq!(Overlay::new(&renderer, scene, 1.0, None, false), Overlay::default());
    }
}
