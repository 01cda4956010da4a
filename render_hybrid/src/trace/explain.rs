//! Why a pixel has its colour: the tree of rays behind it, in words and numbers.
//!
//! The same surfaces, interfaces and light as the Whitted tracer, one branch at a time and remembered. The sum of what all
//! branches added is the pixel of the CPU lane, up to the order of summation (tests/explain.rs).

use glam::Vec3;

use super::{
    camera_rays::camera_ray,
    direct,
    media::MediumStack,
    optics::{mirrored, split},
    points::{Glossy, PointBatch},
    shade::{self, FrameContext, VplRays},
    surface::{Surface, surface_at},
};
use crate::{
    accel::Ray,
    output::RayCounts,
    twin::{gbuffer::point_of, shading::beer_lambert},
};

/// Branches after which a tree is cut; [`RayTree::cut`] says so.
const MOST_NODES: usize = 4096;

/// Where a branch comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RayKind {
    /// The eye.
    Camera,
    /// A mirror or the Fresnel reflection of glass.
    Reflection,
    /// Through glass.
    Refraction,
}

/// One ray and what it met.
#[derive(Clone, Debug, PartialEq)]
pub struct RayNode {
    /// Where it comes from.
    pub kind: RayKind,
    /// Place of the ray before it in the tree; `None` for the camera's.
    pub parent: Option<usize>,
    /// Rays before it.
    pub depth: u32,
    /// Share of light that the last interface sends this way (mirror factor, Fresnel reflection or transmission), per channel.
    pub split: Vec3,
    /// Share of this ray's light in the pixel, absorption on its own way included, per channel.
    pub weight: Vec3,
    /// Length in metres; infinite where it left the scene.
    pub distance: f32,
    /// `StableId` of the instance that it met; `None` where it left the scene.
    pub instance: Option<u64>,
    /// Index of the material that it met.
    pub material: Option<u32>,
    /// Radiance by lights at the place (background where there is none), before `weight`.
    pub direct: Vec3,
    /// Radiance by virtual lights at the place, before `weight`.
    pub indirect: Vec3,
    /// What it added to the pixel: weight times the two.
    pub added: Vec3,
}

/// All rays behind a pixel, each after the one that it comes from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RayTree {
    /// Column and row of the pixel.
    pub pixel: (u32, u32),
    /// The rays; the first is the camera's.
    pub nodes: Vec<RayNode>,
    /// There were more than are kept.
    pub cut: bool,
}

impl RayTree {
    /// The pixel's radiance: the sum over all rays.
    pub fn radiance(&self) -> Vec3 {
        self.nodes.iter().map(|n| n.added).sum()
    }
}

/// The tree of one pixel.
pub(crate) fn explain(ctx: &FrameContext, x: u32, y: u32) -> RayTree {
    let s = ctx.settings;
    let mut tree = RayTree { pixel: (x, y), ..Default::default() };
    let ray = camera_ray(&ctx.scene.camera, x as f32, y as f32, s.width, s.height);
    let first = Way {
        ray,
        parent: None,
        kind: RayKind::Camera,
        split: Vec3::ONE,
        weight: Vec3::ONE,
        inside: MediumStack::default(),
        depth: 0,
        crossed: 0,
    };
    let mut open = vec![first];
    while let Some(way) = open.pop() {
        if tree.nodes.len() >= MOST_NODES {
            tree.cut = true;
            break;
        }
        follow(ctx, way, y * s.width + x, &mut tree, &mut open);
    }
    tree
}

#[derive(Clone, Copy)]
struct Way {
    ray: Ray,
    parent: Option<usize>,
    kind: RayKind,
    split: Vec3,
    weight: Vec3,
    inside: MediumStack,
    depth: u32,
    crossed: u32,
}

/// Follows one ray to what it meets, and opens those that go on from there.
fn follow(ctx: &FrameContext, mut way: Way, pixel: u32, tree: &mut RayTree, open: &mut Vec<Way>) {
    let hit = ctx.accel.closest_hit(&way.ray);
    if let Some(medium) = way.inside.current(ctx.scene) {
        let m = &ctx.scene.materials[ctx.scene.instances[medium as usize].material as usize];
        way.weight *= beer_lambert(m.attenuation_color, m.attenuation_distance, hit.t);
    }
    let mut node = RayNode {
        kind: way.kind,
        parent: way.parent,
        depth: way.depth,
        split: way.split,
        weight: way.weight,
        distance: hit.t,
        instance: None,
        material: None,
        direct: ctx.scene.environment.background,
        indirect: Vec3::ZERO,
        added: way.weight * ctx.scene.environment.background,
    };
    if !hit.is_hit() {
        tree.nodes.push(node);
        return;
    }
    let surface = surface_at(ctx.scene, ctx.normals, &way.ray, &hit);
    node.instance = Some(ctx.scene.instances[hit.instance_id as usize].stable_id);
    node.material = Some(surface.material);
    (node.direct, node.indirect) = local_light(ctx, &surface, -way.ray.direction, pixel, node.parent.is_none());
    node.added = way.weight * (node.direct + node.indirect);
    let at = tree.nodes.len();
    tree.nodes.push(node);
    spawn(ctx, &way, &surface, at, open);
}

/// Direct and indirect radiance of a surface towards `wo`.
/// * `seen`: by the camera; else by a ray of a mirror or glass
pub(crate) fn local_light(ctx: &FrameContext, surface: &Surface, wo: Vec3, pixel: u32, seen: bool) -> (Vec3, Vec3) {
    let (mut points, mut rays, mut counts) = (PointBatch::default(), VplRays::default(), RayCounts::default());
    let unlit = ctx.scene.materials[surface.material as usize].unlit;
    points.keep_ray_starts(true);
    points.push(&point_of(ctx, surface), &surface.ray_start());
    let look = &surface.look;
    if look.specular != Vec3::ZERO && !unlit {
        points.glossy.push(Glossy { point: 0, specular: look.specular, shininess: look.shininess, wo });
    }
    points.pad();
    let from_grid = || {
        let (width, s) = (ctx.settings.width, surface);
        ctx.grid.at([pixel % width, pixel / width], s.position_world, s.n_shading)
    };
    if seen && !ctx.grid.is_built() {
        shade::indirect_light(ctx, 0..ctx.vpls.len(), &mut points, &mut rays, &mut counts);
    } else if let Some(irradiance) = seen.then(from_grid).flatten() {
        points.set_irradiance(0, irradiance);
    } else {
        shade::indirect_light_of_hits(ctx, &mut points, &mut rays, &mut counts);
    }
    direct::direct_light(ctx, &mut points, |_| pixel, &mut counts);
    (points.radiance(0), points.albedo(0) * points.irradiance(0))
}

/// Opens the reflected and the refracted ray, as `whitted::spawn` does.
fn spawn(ctx: &FrameContext, way: &Way, surface: &Surface, at: usize, open: &mut Vec<Way>) {
    let m = &ctx.scene.materials[surface.material as usize];
    if !ctx.settings.traced || !m.is_traced() || way.depth >= ctx.settings.max_depth {
        return;
    }
    let d = way.ray.direction;
    let optics = split(ctx.scene, m, surface, d, way.inside);
    let mut push = |kind, direction, split: Vec3, inside, depth| {
        let weight = way.weight * split;
        if weight.max_element() >= ctx.settings.min_weight {
            let ray = surface.leaving_ray(direction);
            let crossed = way.crossed + 1;
            open.push(Way { ray, parent: Some(at), kind, split, weight, inside, depth, crossed });
        }
    };
    if optics.hidden {
        if way.crossed < 4 * ctx.settings.max_depth {
            push(RayKind::Refraction, d, Vec3::ONE, optics.behind, way.depth);
        }
        return;
    }
    // The last one opened is followed first: reflections come before what is seen through the glass.
    if let Some(t) = optics.transmitted_direction {
        push(RayKind::Refraction, t, optics.transmitted, optics.behind, way.depth + 1);
    }
    if optics.reflected != Vec3::ZERO {
        let r = mirrored(d, surface.n_shading, surface.n_geometric);
        push(RayKind::Reflection, r, optics.reflected, way.inside, way.depth + 1);
    }
}
