//! The whole import, step by step.

use super::{
    accessor::Accessor,
    animation,
    buffers::{Buffers, Source, read_file},
    container,
    document::{Document, MaterialDef, Node, item, own_extras},
    error::{GltfError, within},
    geometry::{Deform, Geometry},
    limits::ImportLimits,
    materials, nodes, punctual,
    report::Ignored,
    scene::{
        ImportedAnimation, ImportedDeformation, ImportedNode, ImportedPrimitive, ImportedScene, NodeClip, invertible,
    },
    textures::Textures,
};
use crate::{material::Material, mesh::Aabb, render_scene::Environment};
use bevy_transform::components::Transform;
use glam::{Affine3, Mat3, Vec3};
use serde_json::Value;
use std::{
    collections::{BTreeMap, btree_map::Entry},
    path::Path,
    sync::Arc,
};

/// Reads a `.gltf` or `.glb` file, told apart by content. Files that it names are looked for in its own folder and below.
///
/// # Errors
/// [`GltfError`], one line that names the place; nothing is left half done.
pub fn load_gltf(path: &Path, limits: &ImportLimits) -> Result<ImportedScene, GltfError> {
    let bytes = read_file(path, 0, limits.bytes)?;
    load_gltf_bytes(&bytes, path.parent(), limits)
}

/// Reads glTF or GLB from memory. `base`: folder of the files that it names; `None`: it may name none.
///
/// # Errors
/// [`GltfError`], one line that names the place.
pub fn load_gltf_bytes(bytes: &[u8], base: Option<&Path>, limits: &ImportLimits) -> Result<ImportedScene, GltfError> {
    within("bytes", bytes.len() as u64, limits.bytes)?;
    let (json, bin) = container::split(bytes)?;
    let document = container::parse(json, limits)?;
    let order = nodes::order(&document, limits)?;
    let mut ignored = Ignored::default();
    note_unsupported(&document, &mut ignored);

    let mut source = Source::new(base, bytes.len() as u64, limits);
    let buffers = Buffers::load(&document, bin, &mut source)?;
    let lights = punctual::lights(&document)?;

    // Poses, lights and cameras.
    let mut scene = ImportedScene::default();
    let mut place_of = vec![None; document.nodes.len()];
    let mut stands_for = Vec::with_capacity(order.len());
    for &(number, parent) in &order {
        let node = &document.nodes[number as usize];
        let place = &format!("node {number}");
        let pose = nodes::pose(node, place)?;
        let parent = parent.map(|p| stands_for[p]);
        let hidden = nodes::hidden(node, place)?;
        let plain = |parent, transform, local| ImportedNode {
            name: node.name.clone(),
            parent,
            transform,
            local,
            hidden,
            primitives: Vec::new(),
            light: None,
            camera: None,
        };
        match pose.inner {
            None => scene.nodes.push(plain(parent, pose.transform, pose.local)),
            Some(inner) => {
                scene.nodes.push(plain(parent, pose.transform, matrix(&pose.transform)));
                scene.nodes.push(plain(Some(scene.nodes.len() - 1), inner, matrix(&inner)));
            }
        }
        let at = scene.nodes.len() - 1;
        stands_for.push(at);
        place_of[number as usize] = Some(at);
        scene.nodes[at].light = punctual::light(node, &lights, place, &mut ignored)?;
        scene.nodes[at].camera = punctual::camera(&document, node, place)?;
    }
    let poses = scene.world_from_node();
    for (node, pose) in scene.nodes.iter().zip(&poses) {
        if !pose.is_finite() || pose.translation.abs().max_element() > limits.coordinate {
            let name = node.name.clone().unwrap_or_default();
            let why = format!("its world pose is not finite or beyond {} m", limits.coordinate);
            return Err(GltfError::invalid(format!("node {name:?}"), why));
        }
    }

    let clips = animation::all(&document, &buffers, limits, &mut ignored)?;
    let morphed = |node: u32| clips.iter().any(|c| c.of_node.get(&node).is_some_and(|t| t.weights.is_some()));
    let moving = clips.iter().any(|c| !c.of_node.is_empty());

    // Meshes, and the materials that they use.
    let shown = scene.shown();
    let mut geometry = Geometry::new(&document, &buffers, limits);
    let mut textures = Textures::new(&document, &buffers, limits, &mut source);
    let mut instances = 0;
    let mut joints_of: BTreeMap<u32, Arc<[Affine3]>> = BTreeMap::new();
    let mut material_of: BTreeMap<Option<u32>, usize> = BTreeMap::new();
    for (&(number, _), &at) in order.iter().zip(&stands_for) {
        let node = &document.nodes[number as usize];
        let Some(mesh) = node.mesh else { continue };
        let def = item(&document.meshes, mesh, "mesh", &format!("node {number}"))?;
        // One mesh of many primitives under many nodes: a product that a short file can make huge.
        let copies = match node.skin {
            None => nodes::copies(&document, &buffers, node, limits, &format!("node {number}"))?,
            // A skin poses the mesh where its joints are: all copies would be one.
            Some(_) => None,
        };
        let count = copies.as_ref().map_or(1, |c| c.len() as u64);
        instances = count.saturating_mul(def.primitives.len() as u64).saturating_add(instances);
        within("instances", instances, limits.instances)?;
        let skin = match node.skin {
            Some(skin) => {
                if let Entry::Vacant(slot) = joints_of.entry(skin) {
                    slot.insert(joints(&document, &buffers, skin, &place_of, &poses, &mut ignored)?);
                }
                Some((skin, joints_of[&skin].clone()))
            }
            None => None,
        };
        let weights = node.weights.clone().or_else(|| def.weights.clone()).unwrap_or_default();
        if weights.iter().any(|w| !w.is_finite()) {
            return Err(GltfError::invalid(format!("node {number}"), "a morph weight is not finite"));
        }
        let animated = (morphed(number) || (skin.is_some() && moving)).then_some(number);
        let deform = Deform { weights, skin, animated };
        let mut primitives = Vec::new();
        for (i, primitive) in def.primitives.iter().enumerate() {
            let place = &format!("mesh {mesh}, primitive {i}");
            let look = primitive.material.and_then(|m| document.materials.get(m as usize));
            let reads = materials::reads(look.unwrap_or(&MaterialDef::default()));
            let Some(built) = geometry.primitive(primitive, reads, &deform, place, &mut ignored)? else { continue };
            let material = match material_of.get(&primitive.material) {
                Some(&known) => known,
                None => {
                    scene.materials.push(material(&document, primitive.material, place, &mut textures, &mut ignored)?);
                    material_of.insert(primitive.material, scene.materials.len() - 1);
                    scene.materials.len() - 1
                }
            };
            primitives.push(ImportedPrimitive { mesh: built, material });
            if let Some(source) = geometry.sources.remove(&built) {
                let joints = match node.skin {
                    Some(skin) => binds(&document, &buffers, skin, &place_of)?,
                    None => Arc::default(),
                };
                let (weights, source) = (deform.weights.clone(), Arc::new(source));
                scene.deformations.push(ImportedDeformation { mesh: built, node: at, weights, source, joints });
            }
        }
        if deform.skin.is_some() {
            // A skin poses the mesh in world space; the node's own pose does not count.
            let (transform, local) = (Transform::IDENTITY, Affine3::IDENTITY);
            let (name, hidden) = (node.name.clone(), !shown[at]);
            scene.nodes.push(ImportedNode {
                name,
                parent: None,
                transform,
                local,
                hidden,
                primitives,
                light: None,
                camera: None,
            });
        } else if let Some(copies) = copies {
            for transform in copies {
                let (name, local) = (node.name.clone(), matrix(&transform));
                let primitives = primitives.clone();
                let parent = Some(at);
                scene.nodes.push(ImportedNode {
                    name,
                    parent,
                    transform,
                    local,
                    hidden: false,
                    primitives,
                    light: None,
                    camera: None,
                });
            }
        } else {
            scene.nodes[at].primitives = primitives;
        }
    }
    for clip in clips {
        let mut tracks = Vec::new();
        for (number, of_node) in clip.of_node {
            match place_of[number as usize] {
                Some(node) => tracks.push(NodeClip { node, tracks: Arc::new(of_node) }),
                None => ignored.note("animation of nodes outside the scene"),
            }
        }
        scene.animations.push(ImportedAnimation { name: clip.name, duration: clip.duration, tracks });
    }
    scene.meshes = geometry.meshes;
    scene.textures = textures.textures;
    scene.environment = environment(&document);
    finish(scene, ignored, limits)
}

fn matrix(t: &Transform) -> Affine3 {
    Affine3::from_scale_rotation_translation(t.scale, t.rotation, t.translation)
}

fn note_unsupported(document: &Document, ignored: &mut Ignored) {
    for name in &document.extensions_used {
        if !container::SUPPORTED.contains(&name.as_str()) {
            ignored.note(format!("extension {name}"));
        }
    }
    if document.scenes.len() > 1 {
        ignored.note("scenes beside the shown one");
    }
}

fn material(
    document: &Document,
    index: Option<u32>,
    place: &str,
    textures: &mut Textures,
    ignored: &mut Ignored,
) -> Result<Material, GltfError> {
    match index {
        None => materials::translate(&Default::default(), place, textures, ignored),
        Some(index) => {
            let def = item(&document.materials, index, "material", place)?;
            materials::translate(def, &format!("material {index}"), textures, ignored)
        }
    }
}

/// Each joint of a skin that [`joints`] has checked: its place in the scene, and its bind space from the mesh's.
fn binds(
    document: &Document,
    buffers: &Buffers,
    skin: u32,
    place_of: &[Option<usize>],
) -> Result<Arc<[(Option<usize>, Affine3)]>, GltfError> {
    let def = item(&document.skins, skin, "skin", "node")?;
    let binds = def.inverse_bind_matrices.map(|i| Accessor::open(document, buffers, i, "skin")).transpose()?;
    let bind = |i: usize| binds.as_ref().map_or(Affine3::IDENTITY, |a| bind_matrix(a, i));
    Ok(def.joints.iter().enumerate().map(|(i, &joint)| (place_of[joint as usize], bind(i))).collect())
}

fn bind_matrix(a: &Accessor, i: usize) -> Affine3 {
    let m = a.read::<16>(i, [0.0; 16]);
    let column = |c: usize| Vec3::new(m[4 * c], m[4 * c + 1], m[4 * c + 2]);
    Affine3 { matrix3: Mat3::from_cols(column(0), column(1), column(2)), translation: column(3) }
}

/// Joint matrices of a skin, world space from bind space, at the pose of the file.
fn joints(
    document: &Document,
    buffers: &Buffers,
    skin: u32,
    place_of: &[Option<usize>],
    poses: &[Affine3],
    ignored: &mut Ignored,
) -> Result<Arc<[Affine3]>, GltfError> {
    let place = &format!("skin {skin}");
    let def = item(&document.skins, skin, "skin", "node")?;
    let binds = match def.inverse_bind_matrices {
        Some(index) => {
            let a = Accessor::open(document, buffers, index, place)?;
            if a.components != 16 || a.count < def.joints.len() {
                return Err(GltfError::invalid(place, "inverseBindMatrices must hold one MAT4 a joint"));
            }
            Some(a)
        }
        None => None,
    };
    let mut out = Vec::with_capacity(def.joints.len());
    for (i, &joint) in def.joints.iter().enumerate() {
        let _: &Node = item(&document.nodes, joint, "joint node", place)?;
        let pose = match place_of[joint as usize] {
            Some(at) => poses[at],
            None => {
                ignored.note("skin joints outside the scene (taken at the origin)");
                Affine3::IDENTITY
            }
        };
        let bind = binds.as_ref().map_or(Affine3::IDENTITY, |a| bind_matrix(a, i));
        out.push(pose * bind);
    }
    Ok(out.into())
}

/// Background and ambient light of our own exports.
fn environment(document: &Document) -> Option<Environment> {
    let scene = document.scenes.get(document.scene.unwrap_or(0) as usize)?;
    let own = own_extras(&scene.extras)?;
    let color = |name: &str| {
        let list = own.get(name)?.as_array()?;
        let at =
            |i: usize| list.get(i).and_then(Value::as_f64).map(|v| v as f32).filter(|v| v.is_finite() && *v >= 0.0);
        Some(Vec3::new(at(0)?, at(1)?, at(2)?))
    };
    Some(Environment { background: color("background")?, ambient: color("ambient")? })
}

/// Checks the world-space size of everything and fills in the report.
fn finish(mut scene: ImportedScene, mut ignored: Ignored, limits: &ImportLimits) -> Result<ImportedScene, GltfError> {
    let poses = scene.world_from_node();
    for (node, pose) in scene.nodes.iter().zip(&poses) {
        for p in &node.primitives {
            let mesh = &scene.meshes[p.mesh];
            let bounds: Aabb = mesh.bounds_object().transformed(pose);
            let size = bounds.min.abs().max(bounds.max.abs()).max_element();
            let drawn = !mesh.triangles().is_empty();
            if drawn && (bounds.is_empty() || size > limits.coordinate) {
                let name = node.name.clone().unwrap_or_default();
                let why = format!("it reaches {size} m from the origin, the limit is {} m", limits.coordinate);
                return Err(GltfError::invalid(format!("node {name:?}"), why));
            }
            if !invertible(pose) {
                ignored.note("meshes whose pose has no volume (hidden)");
            }
        }
    }
    let instances = scene.instances();
    let glows = |p: &ImportedPrimitive| {
        let m = &scene.materials[p.material];
        m.unlit || m.emissive.max_element() > 0.0
    };
    let shown = scene.shown();
    let any = |has: fn(&ImportedNode) -> bool| scene.nodes.iter().zip(&shown).any(|(n, shown)| *shown && has(n));
    let has_light = any(|n| n.light.is_some()) || instances.iter().any(|(p, _)| glows(p));
    let has_camera = any(|n| n.camera.is_some());
    (scene.report.has_light, scene.report.has_camera) = (has_light, has_camera);
    scene.report.instances = instances.len();
    scene.report.triangles = scene.triangle_count();
    scene.report.ignored = ignored.list();
    Ok(scene)
}
