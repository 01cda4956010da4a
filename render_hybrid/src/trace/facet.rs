//! Triangles with everything that their places share, made once and kept: most neighbouring pixels and rays meet the same few.

use catoptra_engine::{Look, Material, RenderScene};
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

use super::{
    optics::{Optics, Pane},
    points::Lane,
    shade::FrameContext,
    surface::{NormalMatrices, Surface, outward, surface_seen},
};
use crate::accel::{Hit, Ray};

/// Facets that a cache keeps: a power of two.
const KEPT: usize = 512;

/// A triangle in world space.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Facet {
    pub instance_id: u32,
    pub primitive_id: u32,
    pub corners: [[f32; 3]; 3],
    /// Normals of the corners, any length.
    pub normals: [[f32; 3]; 3],
    /// Base colour at the corners.
    pub colors: [[f32; 3]; 3],
    /// Outward unit normal of the triangle; zero where it has no area.
    pub outward: [f32; 3],
    pub emission: [f32; 3],
    /// Ambient (or unlit) radiance is base colour times this.
    pub ambient: [f32; 3],
    /// k_d · matte weight / π.
    pub matte: f32,
    /// Bound on the error of a place on it, metres.
    pub error: f32,
    pub material: u32,
    pub look: Look,
    pub optics: Optics,
    pub unlit: bool,
    /// Places differ in more than what corners mix to.
    pub textured: bool,
    pub glossy: bool,
    pub traced: bool,
}

impl Facet {
    /// None.
    pub fn nothing() -> Self {
        Self {
            instance_id: Hit::NONE,
            primitive_id: Hit::NONE,
            corners: [[0.0; 3]; 3],
            normals: [[0.0; 3]; 3],
            colors: [[0.0; 3]; 3],
            outward: [0.0; 3],
            emission: [0.0; 3],
            ambient: [0.0; 3],
            matte: 0.0,
            error: 0.0,
            material: 0,
            look: Material::default().look(),
            optics: Optics { mirror: 0.0, glass: 0.0, eta: 1.0, schlick: false, pane: Pane::Film },
            unlit: false,
            textured: false,
            glossy: false,
            traced: false,
        }
    }

    pub fn new(scene: &RenderScene, normals: &NormalMatrices, instance_id: u32, primitive_id: u32) -> Self {
        let instance = &scene.instances[instance_id as usize];
        let mesh = &scene.meshes[instance.mesh as usize];
        let m = &scene.materials[instance.material as usize];
        let vertices = mesh.triangles()[primitive_id as usize].map(|v| v as usize);
        let p = vertices.map(|v| mesh.positions()[v]);
        let colors = match mesh.colors() {
            [] => [m.base_color; 3],
            colors => vertices.map(|v| m.base_color * colors[v].truncate()),
        };
        let normal_matrix = normals.of(instance_id);
        let look = m.look();
        let ambient = scene.environment.ambient * (m.ambient * look.matte_weight());
        let transform = &instance.world_from_object;
        let corners = p.map(|p| transform.transform_point3(p));
        // As in `surface_seen`, with the greatest that a place on the triangle can have.
        let reach = p[0].abs().max(p[1].abs()).max(p[2].abs());
        let terms = transform.matrix3.x_axis.abs() * reach.x
            + transform.matrix3.y_axis.abs() * reach.y
            + transform.matrix3.z_axis.abs() * reach.z
            + transform.translation.abs()
            + corners[0].abs().max(corners[1].abs()).max(corners[2].abs());
        Self {
            instance_id,
            primitive_id,
            corners: corners.map(|p| p.to_array()),
            normals: vertices.map(|v| (normal_matrix * mesh.normals()[v]).to_array()),
            colors: colors.map(|c| c.to_array()),
            outward: outward(&normal_matrix, p).normalize_or_zero().to_array(),
            emission: m.emissive.to_array(),
            ambient: if m.unlit { [1.0; 3] } else { ambient.to_array() },
            matte: if m.unlit { 0.0 } else { look.diffuse * look.matte_weight() * FRAC_1_PI },
            error: terms.max_element() * (32.0 * f32::EPSILON * 0.5),
            material: instance.material,
            optics: Optics::new(scene, m, &look, instance_id),
            look,
            unlit: m.unlit,
            textured: m.textures().next().is_some() || m.physical.is_some(),
            glossy: look.specular != Vec3::ZERO && !m.unlit,
            traced: look.is_traced(),
        }
    }

    /// What sixteen lanes at a time make of it is not all: textures, or no area to tell a side by.
    #[inline]
    pub fn is_odd(&self) -> bool {
        self.textured | (self.outward == [0.0; 3])
    }

    /// Nothing but matte light and what the place emits.
    #[inline]
    pub fn is_plain(&self) -> bool {
        !(self.textured | self.glossy | self.traced | (self.outward == [0.0; 3]))
    }

    /// The surface that `hit` met on it. As [`surface_seen`], to rounding.
    #[inline]
    pub fn surface_seen(
        &self,
        scene: &RenderScene,
        normals: &NormalMatrices,
        ray: &Ray,
        hit: &Hit,
        pixel_width: f32,
    ) -> Surface {
        if self.textured {
            return surface_seen(scene, normals, ray, hit, pixel_width);
        }
        self.surface(ray.direction, hit.u, hit.v)
    }

    /// The surface at barycentric coordinates (u, v), without textures.
    #[inline]
    fn surface(&self, direction: Vec3, u: f32, v: f32) -> Surface {
        let w = 1.0 - u - v;
        let mix = |p: &[[f32; 3]; 3]| Vec3::from(p[0]) * w + Vec3::from(p[1]) * u + Vec3::from(p[2]) * v;
        let outward = Vec3::from(self.outward);
        let outward = if outward == Vec3::ZERO { -direction.normalize_or(Vec3::Y) } else { outward };
        let front = outward.dot(direction) < 0.0;
        let n_geometric = if front { outward } else { -outward };
        let n = mix(&self.normals).normalize_or(n_geometric);
        let base_color = mix(&self.colors);
        let emission = Vec3::from(self.emission);
        Surface {
            position_world: mix(&self.corners),
            error: self.error,
            n_geometric,
            n_shading: if n.dot(n_geometric) < 0.0 { -n } else { n },
            front,
            base_color,
            emission: if self.unlit { emission + base_color } else { emission },
            look: self.look,
            material: self.material,
            instance_id: self.instance_id,
            primitive_id: self.primitive_id,
        }
    }
}

/// Where kernels get the values of the triangles from that sixteen places lie on.
pub(crate) trait FacetSource {
    fn corner(&self, corner: usize, axis: usize, lane: usize) -> f32;
    fn normal(&self, corner: usize, axis: usize, lane: usize) -> f32;
    fn color(&self, corner: usize, axis: usize, lane: usize) -> f32;
    fn outward(&self, axis: usize, lane: usize) -> f32;
    fn emission(&self, axis: usize, lane: usize) -> f32;
    fn ambient(&self, axis: usize, lane: usize) -> f32;
    fn matte(&self, lane: usize) -> f32;
    fn error(&self, lane: usize) -> f32;
}

/// One for all.
impl FacetSource for Facet {
    #[inline(always)]
    fn corner(&self, corner: usize, axis: usize, _: usize) -> f32 {
        self.corners[corner][axis]
    }
    #[inline(always)]
    fn normal(&self, corner: usize, axis: usize, _: usize) -> f32 {
        self.normals[corner][axis]
    }
    #[inline(always)]
    fn color(&self, corner: usize, axis: usize, _: usize) -> f32 {
        self.colors[corner][axis]
    }
    #[inline(always)]
    fn outward(&self, axis: usize, _: usize) -> f32 {
        self.outward[axis]
    }
    #[inline(always)]
    fn emission(&self, axis: usize, _: usize) -> f32 {
        self.emission[axis]
    }
    #[inline(always)]
    fn ambient(&self, axis: usize, _: usize) -> f32 {
        self.ambient[axis]
    }
    #[inline(always)]
    fn matte(&self, _: usize) -> f32 {
        self.matte
    }
    #[inline(always)]
    fn error(&self, _: usize) -> f32 {
        self.error
    }
}

/// One each.
#[derive(Clone, Debug, Default)]
pub(crate) struct FacetLanes {
    corners: [[Lane; 3]; 3],
    normals: [[Lane; 3]; 3],
    colors: [[Lane; 3]; 3],
    outward: [Lane; 3],
    emission: [Lane; 3],
    ambient: [Lane; 3],
    matte: Lane,
    error: Lane,
}

impl FacetLanes {
    pub fn put(&mut self, lane: usize, f: &Facet) {
        for k in 0..3 {
            for axis in 0..3 {
                self.corners[k][axis][lane] = f.corners[k][axis];
                self.normals[k][axis][lane] = f.normals[k][axis];
                self.colors[k][axis][lane] = f.colors[k][axis];
            }
            self.outward[k][lane] = f.outward[k];
            self.emission[k][lane] = f.emission[k];
            self.ambient[k][lane] = f.ambient[k];
        }
        self.matte[lane] = f.matte;
        self.error[lane] = f.error;
    }
}

impl FacetSource for FacetLanes {
    #[inline(always)]
    fn corner(&self, corner: usize, axis: usize, lane: usize) -> f32 {
        self.corners[corner][axis][lane]
    }
    #[inline(always)]
    fn normal(&self, corner: usize, axis: usize, lane: usize) -> f32 {
        self.normals[corner][axis][lane]
    }
    #[inline(always)]
    fn color(&self, corner: usize, axis: usize, lane: usize) -> f32 {
        self.colors[corner][axis][lane]
    }
    #[inline(always)]
    fn outward(&self, axis: usize, lane: usize) -> f32 {
        self.outward[axis][lane]
    }
    #[inline(always)]
    fn emission(&self, axis: usize, lane: usize) -> f32 {
        self.emission[axis][lane]
    }
    #[inline(always)]
    fn ambient(&self, axis: usize, lane: usize) -> f32 {
        self.ambient[axis][lane]
    }
    #[inline(always)]
    fn matte(&self, lane: usize) -> f32 {
        self.matte[lane]
    }
    #[inline(always)]
    fn error(&self, lane: usize) -> f32 {
        self.error[lane]
    }
}

/// The facets that were met last. What it gives does not depend on what it keeps.
#[derive(Clone, Debug, Default)]
pub(crate) struct Facets {
    /// The frame that they belong to.
    serial: u64,
    kept: Vec<Facet>,
}

impl Facets {
    /// Forgets what belongs to another frame.
    pub fn begin(&mut self, ctx: &FrameContext) {
        if self.serial != ctx.serial || self.kept.is_empty() {
            self.serial = ctx.serial;
            self.kept.clear();
            self.kept.resize(KEPT, Facet::nothing());
        }
    }

    /// The facet of a triangle; [`Self::begin`] came before.
    #[inline]
    pub fn of(&mut self, ctx: &FrameContext, instance_id: u32, primitive_id: u32) -> &Facet {
        let place = (primitive_id ^ instance_id.wrapping_mul(0x9e37_79b1)) as usize % KEPT;
        let kept = &mut self.kept[place];
        if kept.primitive_id != primitive_id || kept.instance_id != instance_id {
            *kept = Facet::new(ctx.scene, ctx.normals, instance_id, primitive_id);
        }
        kept
    }

    /// As [`surface_seen`], to rounding.
    #[inline]
    pub fn surface(&mut self, ctx: &FrameContext, ray: &Ray, hit: &Hit, pixel_width: f32) -> Surface {
        self.of(ctx, hit.instance_id, hit.primitive_id).surface_seen(ctx.scene, ctx.normals, ray, hit, pixel_width)
    }
}
