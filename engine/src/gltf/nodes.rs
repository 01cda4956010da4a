//! The node graph: strict trees of bounded depth, and poses that bevy's `Transform` can hold.

use super::{
    accessor::Accessor,
    buffers::Buffers,
    document::{Document, Node, extension, item},
    error::{GltfError, within},
    limits::ImportLimits,
};
use bevy_transform::components::Transform;
use glam::{Affine3, DMat3, DQuat, DVec3, Mat3, Quat, Vec3};
use serde::Deserialize;
use std::collections::BTreeMap;

/// Nodes of the shown scene, parents before children: (number in the file, place of the parent in this list).
pub(super) fn order(document: &Document, limits: &ImportLimits) -> Result<Vec<(u32, Option<usize>)>, GltfError> {
    let nodes = &document.nodes;
    within("nodes", nodes.len() as u64, limits.nodes)?;
    // Each node has at most one parent.
    let mut parent: Vec<Option<u32>> = vec![None; nodes.len()];
    for (i, node) in nodes.iter().enumerate() {
        for &child in &node.children {
            item(nodes, child, "child node", &format!("node {i}"))?;
            if let Some(other) = parent[child as usize].replace(i as u32) {
                return Err(GltfError::invalid(
                    format!("node {child}"),
                    format!("it is a child of nodes {other} and {i}"),
                ));
            }
        }
    }
    let roots: Vec<u32> = match (document.scene, document.scenes.is_empty()) {
        (Some(scene), _) => item(&document.scenes, scene, "scene", "file")?.nodes.clone(),
        (None, false) => document.scenes[0].nodes.clone(),
        // A file without scenes is a library; showing all of it is the best guess.
        (None, true) => (0..nodes.len() as u32).filter(|&i| parent[i as usize].is_none()).collect(),
    };
    let mut seen = vec![false; nodes.len()];
    let mut out: Vec<(u32, Option<usize>)> = Vec::new();
    let mut stack: Vec<(u32, Option<usize>, u64)> = roots.iter().rev().map(|&n| (n, None, 1)).collect();
    while let Some((n, up, depth)) = stack.pop() {
        let node = item(nodes, n, "node", "scene")?;
        within("depth of the node hierarchy", depth, limits.depth)?;
        if std::mem::replace(&mut seen[n as usize], true) {
            return Err(GltfError::invalid(
                format!("node {n}"),
                "it is in the scene twice, or its hierarchy is a cycle",
            ));
        }
        out.push((n, up));
        let here = Some(out.len() - 1);
        stack.extend(node.children.iter().rev().map(|&c| (c, here, depth + 1)));
    }
    // What no root reaches and yet has a parent all the way up can only run in a circle.
    let mut state = vec![0_u8; nodes.len()];
    for start in 0..nodes.len() {
        let (mut at, mut path) = (Some(start as u32), Vec::new());
        while let Some(n) = at.filter(|&n| state[n as usize] == 0) {
            state[n as usize] = 1;
            path.push(n);
            at = parent[n as usize];
        }
        if let Some(n) = at.filter(|&n| state[n as usize] == 1) {
            return Err(GltfError::invalid(format!("node {n}"), "its hierarchy is a cycle"));
        }
        path.into_iter().for_each(|n| state[n as usize] = 2);
    }
    Ok(out)
}

/// A node's own pose: the exact matrix, and one or two `Transform`s whose product it is.
pub(super) struct Pose {
    pub local: Affine3,
    pub transform: Transform,
    /// Second factor of a sheared matrix; belongs to a child that stands for the node.
    pub inner: Option<Transform>,
}

/// Reads TRS or matrix. A sheared matrix M is split by its singular values, M = (T U S) Vᵀ, into two poses without shear.
pub(super) fn pose(node: &Node, place: &str) -> Result<Pose, GltfError> {
    let not_finite = |what: &str| GltfError::invalid(place, format!("{what} is not finite"));
    if let Some(m) = node.matrix {
        if m.iter().any(|v| !v.is_finite()) {
            return Err(not_finite("matrix"));
        }
        let column = |i: usize| Vec3::new(m[4 * i], m[4 * i + 1], m[4 * i + 2]);
        let matrix3 = Mat3::from_cols(column(0), column(1), column(2));
        let local = Affine3 { matrix3, translation: column(3) };
        let (transform, inner) = split(&local);
        return Ok(Pose { local, transform, inner });
    }
    let translation = Vec3::from(node.translation.unwrap_or([0.0; 3]));
    let scale = Vec3::from(node.scale.unwrap_or([1.0; 3]));
    let [x, y, z, w] = node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
    let rotation = Quat::from_xyzw(x, y, z, w);
    for (what, finite) in
        [("translation", translation.is_finite()), ("scale", scale.is_finite()), ("rotation", rotation.is_finite())]
    {
        if !finite {
            return Err(not_finite(what));
        }
    }
    // Through double precision: squares of tiny or huge components must not vanish or overflow.
    let exact = rotation.as_dquat();
    let rotation = match exact.length_squared() {
        l if (l - 1.0).abs() < 1e-6 => rotation,
        l if l > 0.0 => (exact * (1.0 / l.sqrt())).as_quat(),
        _ => Quat::IDENTITY,
    };
    let transform = Transform { translation, rotation, scale };
    Ok(Pose { local: Affine3::from_scale_rotation_translation(scale, rotation, translation), transform, inner: None })
}

/// One `Transform` where the matrix has no shear, else two.
fn split(m: &Affine3) -> (Transform, Option<Transform>) {
    let exact = m.matrix3.as_dmat3();
    let columns = [exact.x_axis, exact.y_axis, exact.z_axis];
    let lengths = columns.map(DVec3::length);
    let skew = |a: usize, b: usize| columns[a].dot(columns[b]).abs() / (lengths[a] * lengths[b]);
    // Angles between the axes that single precision could have caused are no shear.
    let straight = lengths.iter().all(|l| *l > 0.0) && skew(0, 1).max(skew(1, 2)).max(skew(2, 0)) < 1e-5;
    if straight {
        let sign = if exact.determinant() < 0.0 { -1.0 } else { 1.0 };
        let scale = DVec3::new(lengths[0] * sign, lengths[1], lengths[2]);
        let rotation = DMat3::from_cols(columns[0] / scale.x, columns[1] / scale.y, columns[2] / scale.z);
        let rotation = DQuat::from_mat3(&rotation).normalize().as_quat();
        return (Transform { translation: m.translation, rotation, scale: scale.as_vec3() }, None);
    }
    let (u, s, v) = singular_values(exact);
    let outer = Transform {
        translation: m.translation,
        rotation: DQuat::from_mat3(&u).normalize().as_quat(),
        scale: s.as_vec3(),
    };
    let inner = Transform::from_rotation(DQuat::from_mat3(&v.transpose()).normalize().as_quat());
    (outer, Some(inner))
}

/// M = U diag(s) Vᵀ with rotations U and V (s.z is negative where M mirrors), by Jacobi rotations of MᵀM.
fn singular_values(m: DMat3) -> (DMat3, DVec3, DMat3) {
    let mut a = m.transpose() * m;
    let mut v = DMat3::IDENTITY;
    for _ in 0..16 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let apq = a.col(q)[p];
            if apq == 0.0 {
                continue;
            }
            let theta = (a.col(q)[q] - a.col(p)[p]) / (2.0 * apq);
            let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
            let c = 1.0 / (t * t + 1.0).sqrt();
            let mut j = DMat3::IDENTITY;
            j.col_mut(p)[p] = c;
            j.col_mut(q)[q] = c;
            j.col_mut(q)[p] = t * c;
            j.col_mut(p)[q] = -t * c;
            a = j.transpose() * a * j;
            v *= j;
        }
    }
    // Largest first, so that columns of a singular matrix are completed from those that have a direction.
    let mut order = [0, 1, 2];
    order.sort_by(|&x, &y| a.col(y)[y].total_cmp(&a.col(x)[x]));
    let mut v = DMat3::from_cols(v.col(order[0]), v.col(order[1]), v.col(order[2]));
    if v.determinant() < 0.0 {
        v.z_axis = -v.z_axis;
    }
    let x = (m * v.x_axis).normalize_or(DVec3::X);
    let along = m * v.y_axis;
    let y = (along - x * x.dot(along)).normalize_or(x.any_orthonormal_vector());
    let u = DMat3::from_cols(x, y, x.cross(y));
    let s = DVec3::new(u.x_axis.dot(m * v.x_axis), u.y_axis.dot(m * v.y_axis), u.z_axis.dot(m * v.z_axis));
    (u, s, v)
}

#[derive(Deserialize)]
#[serde(default)]
struct Visibility {
    visible: bool,
}

impl Default for Visibility {
    fn default() -> Self {
        Self { visible: true }
    }
}

/// True where the node hides itself and all below it (`KHR_node_visibility`).
pub(super) fn hidden(node: &Node, place: &str) -> Result<bool, GltfError> {
    let visibility: Option<Visibility> = extension(&node.extensions, "KHR_node_visibility", place)?;
    Ok(visibility.is_some_and(|v| !v.visible))
}

#[derive(Deserialize)]
struct Instancing {
    #[serde(default)]
    attributes: BTreeMap<String, u32>,
}

/// Poses of the copies of a node's mesh relative to the node (`EXT_mesh_gpu_instancing`); `None` where it is drawn once.
pub(super) fn copies(
    document: &Document,
    buffers: &Buffers,
    node: &Node,
    limits: &ImportLimits,
    place: &str,
) -> Result<Option<Vec<Transform>>, GltfError> {
    let Some(Instancing { attributes }) = extension(&node.extensions, "EXT_mesh_gpu_instancing", place)? else {
        return Ok(None);
    };
    let open = |name: &str, components: usize| -> Result<Option<Accessor>, GltfError> {
        let Some(&index) = attributes.get(name) else { return Ok(None) };
        let a = Accessor::open(document, buffers, index, place)?;
        within("instances", a.count as u64, limits.instances)?;
        if a.components != components {
            return Err(GltfError::invalid(place, format!("{name} of its copies has {} components", a.components)));
        }
        Ok(Some(a))
    };
    let (t, r, s) = (open("TRANSLATION", 3)?, open("ROTATION", 4)?, open("SCALE", 3)?);
    let counts: Vec<usize> = [&t, &r, &s].into_iter().flatten().map(|a| a.count).collect();
    let Some(&count) = counts.first() else { return Ok(None) };
    if counts.iter().any(|c| *c != count) {
        return Err(GltfError::invalid(place, format!("attributes of its copies have {counts:?} elements")));
    }
    let mut out = Vec::with_capacity(count);
    for i in 0..count {
        let translation = t.as_ref().map_or(Vec3::ZERO, |a| a.read(i, [0.0; 3]).into());
        let rotation = r.as_ref().map_or(Quat::IDENTITY, |a| Quat::from_array(a.read(i, [0.0; 4])));
        let scale = s.as_ref().map_or(Vec3::ONE, |a| a.read(i, [0.0; 3]).into());
        if !(translation.is_finite() && rotation.is_finite() && scale.is_finite()) {
            return Err(GltfError::invalid(place, format!("the pose of copy {i} is not finite")));
        }
        let length = rotation.length();
        let rotation = if length > 0.0 { Quat::from_vec4(glam::Vec4::from(rotation) / length) } else { Quat::IDENTITY };
        out.push(Transform { translation, rotation, scale });
    }
    Ok(Some(out))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn product(m: [f32; 9]) -> (Affine3, Option<Transform>) {
        let local = Affine3 { matrix3: Mat3::from_cols_array(&m), translation: Vec3::new(1.0, 2.0, 3.0) };
        let (outer, inner) = split(&local);
        let affine = |t: Transform| Affine3::from_scale_rotation_translation(t.scale, t.rotation, t.translation);
        let whole = inner.map_or(affine(outer), |i| affine(outer) * affine(i));
        let error = (whole.matrix3 - local.matrix3).to_cols_array().into_iter().fold(0.0_f32, |a, b| a.max(b.abs()));
        let size = m.into_iter().fold(0.0_f32, |a, b| a.max(b.abs()));
        assert!(error <= 2e-6 * size, "{m:?} came back off by {error}");
        assert_eq!(whole.translation, local.translation);
        (whole, inner)
    }

    #[test]
    fn matrices_become_transforms_without_loss() {
        let straight = [
            [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            [-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            [0.0, 3.0, 0.0, -2.0, 0.0, 0.0, 0.0, 0.0, -5.0],
            [1e-6, 0.0, 0.0, 0.0, 1e6, 0.0, 0.0, 0.0, 1.0],
        ];
        for m in straight {
            assert!(product(m).1.is_none(), "{m:?} has no shear");
        }
        let sheared = [
            [1.0, 0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0, 1.0],
            [1.0, 2.0, 3.0, -4.0, 5.0, 6.0, 7.0, -8.0, 9.0],
            [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, -7.0, 8.0, 9.0],
            // Singular ones.
            [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            [1.0, 2.0, 3.0, 2.0, 4.0, 6.0, -1.0, -2.0, -3.0],
            [0.0; 9],
        ];
        for m in sheared {
            assert!(product(m).1.is_some(), "{m:?} needs two transforms");
        }
    }

    #[test]
    fn graphs_that_are_no_trees_are_refused() {
        let order = |json: &str, limits: &ImportLimits| {
            let text = format!(r#"{{"asset":{{"version":"2.0"}},{json}}}"#);
            order(&serde_json::from_str(&text).unwrap(), limits)
        };
        let limits = ImportLimits::default();
        for bad in [
            r#""nodes":[{"children":[1]},{"children":[0]}]"#,
            r#""nodes":[{"children":[0]}]"#,
            r#""nodes":[{"children":[2]},{"children":[2]},{}]"#,
            r#""nodes":[{"children":[7]}]"#,
            r#""nodes":[{"children":[1]},{}],"scenes":[{"nodes":[0,1]}]"#,
            r#""nodes":[{}],"scenes":[{"nodes":[0,0]}]"#,
            r#""nodes":[{}],"scenes":[{"nodes":[1]}]"#,
            r#""nodes":[{}],"scenes":[{"nodes":[0]}],"scene":3"#,
        ] {
            assert!(order(bad, &limits).is_err(), "{bad}");
        }
        let good = r#""nodes":[{"children":[2,1]},{},{}],"scenes":[{"nodes":[0]}]"#;
        assert_eq!(order(good, &limits).unwrap(), [(0, None), (2, Some(0)), (1, Some(0))]);
        let shallow = ImportLimits { depth: 1, ..limits };
        assert!(order(good, &shallow).unwrap_err().to_string().contains("depth"));
        // A chain far deeper than any stack.
        let chain: Vec<String> = (1..200_000).map(|i| format!(r#"{{"children":[{i}]}}"#)).collect();
        assert!(order(&format!(r#""nodes":[{},{{}}]"#, chain.join(",")), &limits).is_err());
    }
}
