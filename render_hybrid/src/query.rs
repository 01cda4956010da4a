//! Rays that ask instead of draw: picking, line of sight, range finding, over the structure that the picture is made from.

use catoptra_engine::RenderScene;
use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::{
    accel::{Accel, Hit, Ray},
    trace::surface::{NormalMatrices, surface_at},
};

/// What a ray met.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceHit {
    /// Index into `RenderScene::instances`: a number of this frame.
    pub instance_id: u32,
    /// The instance's own id: the same in every frame.
    pub stable_id: u64,
    /// Triangle of the mesh.
    pub primitive: u32,
    /// Index into `RenderScene::materials`.
    pub material: u32,
    /// First texture coordinate set at the place; 0 where the mesh has none, or where what it has comes to no finite number.
    pub uv: Vec2,
    /// The place, world space, metres.
    pub position: Vec3,
    /// Unit interpolated normal, world space, on the side that the ray came from.
    pub normal: Vec3,
    /// Unit normal of the triangle, world space, on the side that the ray came from.
    pub normal_geometric: Vec3,
    /// Distance in units of the ray direction's length.
    pub t: f32,
    /// The ray met the side from which the triangle winds counter-clockwise.
    pub front: bool,
}

/// Answers questions about one scene. Made by [`crate::Renderer::query`]; sees hidden things as little as the picture does,
/// mirrors and glass as solid surfaces.
#[derive(Clone, Copy)]
pub struct SceneQuery<'a> {
    pub(crate) scene: &'a RenderScene,
    pub(crate) accel: &'a Accel,
    pub(crate) normals: &'a NormalMatrices,
    pub(crate) pool: &'a rayon::ThreadPool,
}

impl SceneQuery<'_> {
    /// First surface along the ray at `t_min < t < t_max`; `None` for a miss, and for a ray that is not finite or has no
    /// direction. Equal distances go to the smaller (instance, primitive).
    pub fn raycast(&self, ray: &Ray) -> Option<SurfaceHit> {
        self.describe(ray, &self.accel.closest_hit(ray))
    }

    /// [`Self::raycast`] of each ray, on all threads; the same answers.
    pub fn raycast_many(&self, rays: &[Ray]) -> Vec<Option<SurfaceHit>> {
        const CHUNK: usize = 1024;
        let mut hits = vec![Hit::MISS; rays.len()];
        self.pool.install(|| {
            let answer = |(rays, hits): (&[Ray], &mut [Hit])| self.accel.closest_hits(rays, hits);
            rays.par_chunks(CHUNK).zip(hits.par_chunks_mut(CHUNK)).for_each(answer);
            rays.par_iter().zip(&hits).map(|(ray, hit)| self.describe(ray, hit)).collect()
        })
    }

    /// All surfaces along the ray, nearest first, at most `limit`. Of surfaces at exactly the same distance the one that
    /// [`Self::raycast`] names stands for all.
    pub fn raycast_all(&self, ray: &Ray, limit: usize) -> Vec<SurfaceHit> {
        let mut out = Vec::new();
        let mut rest = *ray;
        while out.len() < limit {
            let Some(hit) = self.raycast(&rest) else { break };
            rest.t_min = hit.t;
            out.push(hit);
        }
        out
    }

    /// True where anything, glass included, lies on the ray at `t_min < t < t_max`. Cheaper than [`Self::raycast`].
    pub fn occluded(&self, ray: &Ray) -> bool {
        self.accel.occluded(ray)
    }

    /// True where nothing lies strictly between two points, metres, but what is within a ten-thousandth of the way of
    /// either end.
    pub fn sees(&self, from: Vec3, to: Vec3) -> bool {
        !self.occluded(&Ray { origin: from, direction: to - from, t_min: 1e-4, t_max: 1.0 - 1e-4 })
    }

    /// [`Self::occluded`] of each ray, on all threads.
    pub fn occluded_many(&self, rays: &[Ray]) -> Vec<bool> {
        const CHUNK: usize = 1024;
        let mut out = vec![false; rays.len()];
        self.pool.install(|| {
            let answer = |(rays, out): (&[Ray], &mut [bool])| self.accel.occluded_many(rays, out);
            rays.par_chunks(CHUNK).zip(out.par_chunks_mut(CHUNK)).for_each(answer);
        });
        out
    }

    /// What the scene's camera sees at the continuous picture position (`x`, `y`), pixels, (0, 0) = top left corner of a
    /// picture of `width` x `height`: what lies under a mouse pointer.
    pub fn pick(&self, x: f32, y: f32, width: u32, height: u32) -> Option<SurfaceHit> {
        self.raycast(&crate::trace::camera_rays::camera_ray(&self.scene.camera, x - 0.5, y - 0.5, width, height))
    }

    fn describe(&self, ray: &Ray, hit: &Hit) -> Option<SurfaceHit> {
        if !hit.is_hit() {
            return None;
        }
        let s = surface_at(self.scene, self.normals, ray, hit);
        let instance = &self.scene.instances[hit.instance_id as usize];
        let mesh = &self.scene.meshes[instance.mesh as usize];
        let uv = match mesh.uvs() {
            [] => Vec2::ZERO,
            uvs => {
                let [a, b, c] = mesh.triangles()[hit.primitive_id as usize].map(|v| uvs[v as usize]);
                let uv = a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
                // A mesh may bring any numbers. What an embedder gets compares and indexes as numbers do.
                Vec2::select(uv.is_finite_mask(), uv, Vec2::ZERO)
            }
        };
        Some(SurfaceHit {
            instance_id: hit.instance_id,
            stable_id: instance.stable_id,
            primitive: hit.primitive_id,
            material: s.material,
            uv,
            position: s.position_world,
            normal: s.n_shading,
            normal_geometric: s.n_geometric,
            t: hit.t,
            front: s.front,
        })
    }
}
