//! The boxes of the two-level structure, for looking at.

use catoptra_engine::RenderScene;
use glam::{Affine3, Vec3};

use super::{
    Accel,
    node::{Bounds, EMPTY, LEAF, Node8, WIDTH},
};

/// One box of the structure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TreeBox {
    /// Corners, world space; bit 0 of the number is x, bit 1 y, bit 2 z of the box's own axes.
    pub corners: [Vec3; 8],
    /// Levels below the root of its tree, from 0.
    pub depth: u32,
    /// True in the upper tree (over instances), false in a mesh's own.
    pub upper: bool,
}

impl Accel {
    /// The boxes of the upper tree, and of the meshes' own trees down to `mesh_levels` levels (0: none; kd-trees have none), of
    /// the structure as it was brought up to `scene`; at most `most`, upper tree first.
    pub fn boxes(&self, scene: &RenderScene, mesh_levels: u32, most: usize) -> Vec<TreeBox> {
        let world = &self.world;
        let mut out = Vec::new();
        let mut leaves = Vec::new();
        let tlas = &world.tlas;
        walk(&tlas.nodes, tlas.root, u32::MAX, &Affine3::IDENTITY, true, most, &mut out, &mut |slot| leaves.push(slot));
        for slot in leaves {
            let Some(record) = world.records.get(slot as usize) else { continue };
            let Some(instance) = scene.instances.get(record.instance_id as usize) else { continue };
            let tree = &world.trees[record.blas as usize];
            if mesh_levels > 0 && tree.kd.is_none() {
                let pose = &instance.world_from_object;
                walk(&tree.nodes, tree.root, mesh_levels, pose, false, most, &mut out, &mut |_| {});
            }
        }
        out
    }
}

/// Adds the boxes of a tree down to `levels` levels; `leaf` is told the leaves' references.
fn walk(
    nodes: &[Node8],
    root: u32,
    levels: u32,
    pose: &Affine3,
    upper: bool,
    most: usize,
    out: &mut Vec<TreeBox>,
    leaf: &mut dyn FnMut(u32),
) {
    let mut open = vec![(root, 0)];
    while let Some((reference, depth)) = open.pop() {
        if reference == EMPTY {
            continue;
        }
        if reference & LEAF != 0 {
            leaf(reference & !LEAF);
            continue;
        }
        let Some(node) = nodes.get(reference as usize).filter(|_| depth < levels) else { continue };
        for slot in (0..WIDTH).filter(|&s| node.child[s] != EMPTY) {
            if out.len() < most {
                out.push(TreeBox { corners: corners(&node.slot_box(slot), pose), depth, upper });
            }
            open.push((node.child[slot], depth + 1));
        }
    }
}

fn corners(b: &Bounds, pose: &Affine3) -> [Vec3; 8] {
    std::array::from_fn(|i| {
        let end = |axis: usize| if i >> axis & 1 == 0 { b.min[axis] } else { b.max[axis] };
        pose.transform_point3(Vec3::new(end(0), end(1), end(2)))
    })
}
