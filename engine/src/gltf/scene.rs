//! What an import yields: flat arrays, nodes with parents before children.

use super::{
    error::{GltfError, within},
    limits::ImportLimits,
    report::ImportReport,
};
use crate::{
    animation::{Deformation, NodeTracks},
    camera::Camera,
    components::{CameraProjection, LightSource},
    extract,
    material::Material,
    mesh::{Aabb, Mesh, MeshData},
    render_scene::{Environment, Instance, RenderScene},
    texture::Texture,
};
use bevy_transform::components::Transform;
use glam::{Affine3, Mat3, Vec2, Vec4};
use std::sync::Arc;

/// A mesh with its material, by their numbers in the [`ImportedScene`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImportedPrimitive {
    /// Index into [`ImportedScene::meshes`].
    pub mesh: usize,
    /// Index into [`ImportedScene::materials`].
    pub material: usize,
}

/// One node of the shown scene.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportedNode {
    /// Name in the file.
    pub name: Option<String>,
    /// Index of the parent, always less than the node's own; `None` at the top.
    pub parent: Option<usize>,
    /// Pose relative to the parent, as bevy holds it. A sheared matrix of the file becomes two nodes, the second a child
    /// of the first, whose product it is.
    pub transform: Transform,
    /// The same pose as a matrix; bit for bit the file's where the file gives a matrix without shear.
    pub local: Affine3,
    /// It and what hangs on it are not shown (`KHR_node_visibility`).
    pub hidden: bool,
    /// What it draws.
    pub primitives: Vec<ImportedPrimitive>,
    /// Light that shines along its -Z.
    pub light: Option<LightSource>,
    /// Camera that looks along its -Z.
    pub camera: Option<CameraProjection>,
}

/// What an animation does to one node.
#[derive(Clone, Debug, PartialEq)]
pub struct NodeClip {
    /// Index into [`ImportedScene::nodes`].
    pub node: usize,
    /// Its tracks.
    pub tracks: Arc<NodeTracks>,
}

/// One animation of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImportedAnimation {
    /// Name in the file.
    pub name: Option<String>,
    /// Seconds after which it begins anew.
    pub duration: f32,
    /// What it moves.
    pub tracks: Vec<NodeClip>,
}

/// A mesh whose shape an animation changes.
#[derive(Clone, Debug)]
pub struct ImportedDeformation {
    /// Index into [`ImportedScene::meshes`]: the mesh at the pose of the file, drawn by one node alone.
    pub mesh: usize,
    /// Index of the node whose morph weights count.
    pub node: usize,
    /// Its morph weights in the file.
    pub weights: Vec<f32>,
    /// The mesh before it is posed.
    pub source: Arc<Deformation>,
    /// Index of each joint's node, and its bind space from the mesh's.
    pub joints: Arc<[(Option<usize>, Affine3)]>,
}

/// A scene read from a file: its default scene, else the first, else all nodes.
#[derive(Clone, Debug, Default)]
pub struct ImportedScene {
    /// Meshes, each once however often it is drawn.
    pub meshes: Vec<Arc<Mesh>>,
    /// Materials that the scene uses.
    pub materials: Vec<Material>,
    /// Textures that the materials use.
    pub textures: Vec<Arc<Texture>>,
    /// Nodes, parents before children.
    pub nodes: Vec<ImportedNode>,
    /// The file's animations, in its order. [`ImportedScene::spawn`] plays the first, [`ImportedScene::play`] any.
    pub animations: Vec<ImportedAnimation>,
    /// Meshes that they change.
    pub deformations: Vec<ImportedDeformation>,
    /// Background and ambient light, where the file is one of our own exports.
    pub environment: Option<Environment>,
    /// Figures, and what was ignored.
    pub report: ImportReport,
}

impl ImportedScene {
    /// Number of the first animation of that name.
    pub fn animation_named(&self, name: &str) -> Option<usize> {
        self.animations.iter().position(|a| a.name.as_deref() == Some(name))
    }

    /// World pose of every node.
    pub fn world_from_node(&self) -> Vec<Affine3> {
        let mut out: Vec<Affine3> = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            let pose = node.parent.map_or(node.local, |p| out[p] * node.local);
            out.push(pose);
        }
        out
    }

    /// Of every node, whether neither it nor what it hangs on is hidden.
    pub fn shown(&self) -> Vec<bool> {
        let mut out: Vec<bool> = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            out.push(!node.hidden && node.parent.is_none_or(|p| out[p]));
        }
        out
    }

    /// Everything that is drawn: (mesh and material, world pose), in node order. Poses of no volume (a scale of 0 hides
    /// things in many files) are left out, so that every pose can be inverted.
    pub fn instances(&self) -> Vec<(ImportedPrimitive, Affine3)> {
        let (poses, shown) = (self.world_from_node(), self.shown());
        let drawn = self.nodes.iter().zip(poses).zip(shown).filter(|((_, pose), shown)| *shown && invertible(pose));
        drawn.flat_map(|((node, pose), _)| node.primitives.iter().map(move |p| (*p, pose))).collect()
    }

    /// Bounds of all instances, world space, metres; empty where nothing is drawn.
    pub fn bounds_world(&self) -> Aabb {
        self.instances()
            .iter()
            .fold(Aabb::EMPTY, |b, (p, pose)| b.union(self.meshes[p.mesh].bounds_object().transformed(pose)))
    }

    /// Triangles of all instances.
    pub fn triangle_count(&self) -> usize {
        self.instances().iter().map(|(p, _)| self.meshes[p.mesh].triangles().len()).sum()
    }

    /// All instances as one mesh in world space (a statue or a building to be placed as one thing); materials are left
    /// behind. Mirrored instances are wound back, so that closed ones stay closed. A texture coordinate set or colours that
    /// only some meshes have are filled up with 0 and white.
    ///
    /// # Errors
    /// [`GltfError::Limit`] where the sum passes the limits of vertices or triangles.
    pub fn merged_mesh(&self, limits: &ImportLimits) -> Result<Mesh, GltfError> {
        let instances = self.instances();
        let sum = |count: fn(&Mesh) -> usize| instances.iter().map(|(p, _)| count(&self.meshes[p.mesh]) as u64).sum();
        within("vertices", sum(|m| m.positions().len()), limits.vertices)?;
        within("triangles", sum(|m| m.triangles().len()), limits.triangles)?;
        let any = |has: fn(&Mesh) -> bool| instances.iter().any(|(p, _)| has(&self.meshes[p.mesh]));
        let (uvs, uvs1, colors) =
            (any(|m| !m.uvs().is_empty()), any(|m| !m.uvs1().is_empty()), any(|m| !m.colors().is_empty()));
        let mut out = MeshData::default();
        for (p, pose) in &instances {
            let mesh = &self.meshes[p.mesh];
            let first = out.positions.len() as u32;
            let count = mesh.positions().len();
            let mirrored = pose.matrix3.determinant() < 0.0;
            let from_object = cofactor(pose.matrix3) * if mirrored { -1.0 } else { 1.0 };
            out.positions.extend(mesh.positions().iter().map(|v| pose.transform_point3(*v)));
            out.normals.extend(mesh.normals().iter().map(|n| (from_object * *n).normalize_or(*n)));
            out.triangles.extend(mesh.triangles().iter().map(|t| {
                let [a, b, c] = t.map(|v| first + v);
                if mirrored { [a, c, b] } else { [a, b, c] }
            }));
            if uvs {
                fill(&mut out.uvs, mesh.uvs(), count, Vec2::ZERO);
            }
            if uvs1 {
                fill(&mut out.uvs1, mesh.uvs1(), count, Vec2::ZERO);
            }
            if colors {
                fill(&mut out.colors, mesh.colors(), count, Vec4::ONE);
            }
        }
        Mesh::new(out).map_err(|e| GltfError::invalid("merged mesh", e.to_string()))
    }

    /// The scene without an ECS: stable ids count up from `first_stable_id` as [`Self::spawn`] would give them. Without a
    /// camera in the file it has the default one: see [`crate::fit`].
    pub fn to_render_scene(&self, first_stable_id: u64) -> RenderScene {
        let mut out = RenderScene {
            meshes: self.meshes.clone(),
            textures: self.textures.clone(),
            materials: self.materials.clone(),
            environment: self.environment.unwrap_or_default(),
            ..Default::default()
        };
        let mut id = first_stable_id;
        let mut next = || {
            id += 1;
            id - 1
        };
        let mut has_camera = false;
        for ((node, pose), shown) in self.nodes.iter().zip(self.world_from_node()).zip(self.shown()) {
            for p in &node.primitives {
                let stable_id = next();
                if shown && invertible(&pose) {
                    let (mesh, material) = (p.mesh as u32, p.material as u32);
                    out.instances.push(Instance { stable_id, mesh, material, world_from_object: pose });
                }
            }
            if let Some(light) = &node.light {
                let light = extract::posed_light(next(), light, &pose);
                if shown {
                    out.lights.push(light);
                }
            }
            if let Some(camera) = &node.camera {
                next();
                if shown && !std::mem::replace(&mut has_camera, true) {
                    out.camera = extract::posed_camera(camera, &pose);
                }
            }
        }
        out
    }

    /// The camera that makes the picture, posed: the first in node order.
    pub fn camera(&self) -> Option<Camera> {
        let shown = self.shown();
        let at = (0..self.nodes.len()).find(|&i| shown[i] && self.nodes[i].camera.is_some())?;
        let pose = self.world_from_node()[at];
        self.nodes[at].camera.as_ref().map(|c| extract::posed_camera(c, &pose))
    }
}

/// Carries normals: det(m) m⁻ᵀ, which exists also where m has no inverse.
pub(super) fn cofactor(m: Mat3) -> Mat3 {
    Mat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis))
}

fn fill<T: Copy>(out: &mut Vec<T>, values: &[T], count: usize, default: T) {
    out.extend_from_slice(values);
    out.resize(out.len() + count - values.len(), default);
}

/// True where a pose keeps volumes: renderers can turn rays back into object space.
pub(super) fn invertible(pose: &Affine3) -> bool {
    let inverse = pose.inverse();
    pose.matrix3.determinant() != 0.0 && inverse.is_finite()
}
