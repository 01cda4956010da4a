//! Keyframe animation of poses, morph weights and skins. A pose is a function of the step number alone: the same frame looks
//! the same however it was reached.
//!
//! [`animate`] runs in [`crate::FixedUpdate`] and writes `Transform` and [`MorphWeights`]; [`deform`] runs after transforms
//! have propagated and gives each [`Deformer`] a mesh of its own at its new pose. Meshes are immutable, so a deformed one is
//! another mesh: renderers refit or rebuild its tree in each frame in which it moves, and no other.

use crate::{
    assets::{Assets, MeshId},
    clock::FixedClock,
    math,
    mesh::{Mesh, MeshData},
};
use bevy_ecs::prelude::*;
use bevy_transform::components::{GlobalTransform, Transform};
use glam::{Affine3, Mat3, Quat, Vec3, Vec4};
use std::sync::Arc;

/// How values between two keys follow from them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Interpolation {
    /// The earlier key's value.
    Step,
    /// On the straight line, or on the great circle for rotations.
    #[default]
    Linear,
    /// Hermite splines; three values a key: in-tangent, value, out-tangent.
    CubicSpline,
}

/// Something that keys can be made of.
pub trait Animated: Copy {
    /// a · s
    fn scaled(self, s: f32) -> Self;
    /// a + b
    fn plus(self, other: Self) -> Self;
    /// The value `t` of the way from `self` to `other`.
    fn between(self, other: Self, t: f32) -> Self {
        self.scaled(1.0 - t).plus(other.scaled(t))
    }
    /// What a sum must be made before it is a value.
    fn mended(self) -> Self {
        self
    }
}

impl Animated for f32 {
    fn scaled(self, s: f32) -> Self {
        self * s
    }
    fn plus(self, other: Self) -> Self {
        self + other
    }
}

impl Animated for Vec3 {
    fn scaled(self, s: f32) -> Self {
        self * s
    }
    fn plus(self, other: Self) -> Self {
        self + other
    }
}

impl Animated for Quat {
    fn scaled(self, s: f32) -> Self {
        Quat::from_vec4(Vec4::from(self) * s)
    }
    fn plus(self, other: Self) -> Self {
        Quat::from_vec4(Vec4::from(self) + Vec4::from(other))
    }
    fn between(self, other: Self, t: f32) -> Self {
        let (a, mut b) = (Vec4::from(self), Vec4::from(other));
        let mut cos = a.dot(b);
        if cos < 0.0 {
            // The shorter way round.
            (b, cos) = (-b, -cos);
        }
        let angle = math::acos(cos.min(1.0));
        let sin = math::sin(angle);
        let (wa, wb) =
            if sin < 1e-4 { (1.0 - t, t) } else { (math::sin((1.0 - t) * angle) / sin, math::sin(t * angle) / sin) };
        Quat::from_vec4(a * wa + b * wb).mended()
    }
    fn mended(self) -> Self {
        let v = Vec4::from(self);
        let length = v.length();
        if length > 0.0 && length.is_finite() { Quat::from_vec4(v / length) } else { Quat::IDENTITY }
    }
}

/// Values over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Track<T> {
    /// Seconds, ascending, at least one.
    pub times: Vec<f32>,
    /// `width` values a key, or three times that for splines (all in-tangents, all values, all out-tangents).
    pub values: Vec<T>,
    /// Values a key.
    pub width: usize,
    /// What lies between keys.
    pub interpolation: Interpolation,
}

impl<T: Animated> Track<T> {
    /// Component `which` of the value at `seconds`; before the first and after the last key it stands still.
    ///
    /// Source: glTF 2.0, appendix C.
    pub fn sample(&self, seconds: f32, which: usize) -> T {
        let spline = self.interpolation == Interpolation::CubicSpline;
        let stride = if spline { 3 * self.width } else { self.width };
        let at = |key: usize, part: usize| self.values[key * stride + part * self.width + which];
        let value = |key: usize| at(key, usize::from(spline)).mended();
        let after = self.times.partition_point(|t| *t <= seconds);
        if after == 0 {
            return value(0);
        }
        let before = after - 1;
        if after == self.times.len() || self.interpolation == Interpolation::Step {
            return value(before);
        }
        let span = self.times[after] - self.times[before];
        let t = (seconds - self.times[before]) / span;
        if !spline {
            return value(before).between(value(after), t);
        }
        let (t2, t3) = (t * t, t * t * t);
        at(before, 1)
            .scaled(2.0 * t3 - 3.0 * t2 + 1.0)
            .plus(at(before, 2).scaled(span * (t3 - 2.0 * t2 + t)))
            .plus(at(after, 1).scaled(3.0 * t2 - 2.0 * t3))
            .plus(at(after, 0).scaled(span * (t3 - t2)))
            .mended()
    }
}

/// What moves one node.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NodeTracks {
    /// Metres.
    pub translation: Option<Track<Vec3>>,
    /// Unit quaternions.
    pub rotation: Option<Track<Quat>>,
    /// Factors.
    pub scale: Option<Track<Vec3>>,
    /// Morph weights, one a target.
    pub weights: Option<Track<f32>>,
}

impl NodeTracks {
    /// Writes the pose at `seconds`; what has no track is left.
    pub fn pose(&self, seconds: f32, transform: &mut Transform) {
        if let Some(t) = &self.translation {
            transform.translation = t.sample(seconds, 0);
        }
        if let Some(t) = &self.rotation {
            transform.rotation = t.sample(seconds, 0);
        }
        if let Some(t) = &self.scale {
            transform.scale = t.sample(seconds, 0);
        }
    }
}

/// Moves its entity by keyframes, over and over from step 0 on.
#[derive(Component, Clone, Debug, PartialEq)]
pub struct NodeAnimation {
    /// Shared with the asset that it came from.
    pub tracks: Arc<NodeTracks>,
    /// Seconds after which it begins anew; 0: it stands at its first key.
    pub duration: f32,
}

impl NodeAnimation {
    /// Time within the animation at a step.
    pub fn seconds_at(&self, step: u64) -> f32 {
        let seconds = step as f64 / 60.0;
        if self.duration > 0.0 { (seconds % f64::from(self.duration)) as f32 } else { 0.0 }
    }
}

/// Weights of a node's morph targets.
#[derive(Component, Clone, Debug, Default, PartialEq)]
pub struct MorphWeights(pub Vec<f32>);

/// Poses all [`NodeAnimation`]s for the current step.
pub fn animate(
    clock: Res<FixedClock>,
    mut animated: Query<(&NodeAnimation, &mut Transform, Option<&mut MorphWeights>)>,
) {
    for (animation, mut transform, weights) in &mut animated {
        let seconds = animation.seconds_at(clock.step);
        animation.tracks.pose(seconds, &mut transform);
        if let (Some(track), Some(mut weights)) = (&animation.tracks.weights, weights) {
            weights.0.clear();
            weights.0.extend((0..track.width).map(|i| track.sample(seconds, i)));
        }
    }
}

/// A mesh before it is posed. All lists run over its vertices.
#[derive(Clone, Debug, Default)]
pub struct Deformation {
    /// The mesh in bind pose; without normals flat ones are made at each pose.
    pub data: MeshData,
    /// Per morph target: what its full weight adds to positions and to normals (either may be empty).
    pub targets: Vec<(Vec<Vec3>, Vec<Vec3>)>,
    /// Numbers of the joints that hold each vertex; empty without a skin.
    pub joints: Vec<[u32; 4]>,
    /// How much each of them holds, not necessarily of sum 1.
    pub weights: Vec<[f32; 4]>,
}

impl Deformation {
    /// The mesh posed: morph targets first, then linear blend skinning.
    /// * `joints`: mesh space from bind space, one a joint; numbers beyond hold nothing
    ///
    /// `None` where the pose is not finite.
    pub fn posed(&self, weights: &[f32], joints: &[Affine3]) -> Option<Mesh> {
        let mut data = self.data.clone();
        for ((positions, normals), &weight) in self.targets.iter().zip(weights).filter(|(_, w)| **w != 0.0) {
            data.positions.iter_mut().zip(positions).for_each(|(p, d)| *p += *d * weight);
            data.normals.iter_mut().zip(normals).for_each(|(n, d)| *n += *d * weight);
        }
        for (i, (held_by, shares)) in self.joints.iter().zip(&self.weights).enumerate() {
            let total: f32 = shares.iter().sum();
            if total <= 0.0 {
                continue;
            }
            let mut sum = Affine3 { matrix3: Mat3::ZERO, translation: Vec3::ZERO };
            for (joint, share) in held_by.iter().zip(shares) {
                if let Some(m) = joints.get(*joint as usize).filter(|_| *share != 0.0) {
                    sum.matrix3 += m.matrix3 * (share / total);
                    sum.translation += m.translation * (share / total);
                }
            }
            data.positions[i] = sum.transform_point3(data.positions[i]);
            if let Some(n) = data.normals.get_mut(i) {
                let m = sum.matrix3;
                let (a, b, c) = (m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
                *n = a * n.x + b * n.y + c * n.z;
            }
            if let Some(t) = data.tangents.get_mut(i) {
                *t = (sum.matrix3 * t.truncate()).extend(t.w);
            }
        }
        data.normals.iter_mut().zip(&self.data.normals).for_each(|(n, bind)| *n = n.normalize_or(*bind));
        Mesh::new(data).ok()
    }
}

/// Gives its entity's mesh a new shape whenever its joints or weights move.
#[derive(Component, Clone, Debug)]
pub struct Deformer {
    /// The mesh before it is posed.
    pub source: Arc<Deformation>,
    /// Slot of the posed mesh; no other entity draws it.
    pub mesh: MeshId,
    /// Entity with the [`MorphWeights`].
    pub weights_of: Option<Entity>,
    /// Entity of each joint, and its bind space from the mesh's; joints without an entity stand at the origin.
    pub joints: Vec<(Option<Entity>, Affine3)>,
    /// What the mesh was last posed by.
    pub posed: Option<(Vec<f32>, Vec<Affine3>)>,
}

/// Poses all [`Deformer`]s whose joints or weights have changed. A pose that is not finite leaves the last one.
pub fn deform(
    mut assets: ResMut<Assets>,
    mut deformers: Query<(&mut Deformer, &GlobalTransform)>,
    poses: Query<&GlobalTransform>,
    weights: Query<&MorphWeights>,
) {
    let affine = |t: &GlobalTransform| {
        let a = t.affine();
        Affine3 { matrix3: Mat3::from(a.matrix3), translation: Vec3::from(a.translation) }
    };
    for (mut deformer, own) in &mut deformers {
        let mesh_from_world = affine(own).inverse();
        let joints: Vec<Affine3> = deformer
            .joints
            .iter()
            .map(|(entity, bind_from_mesh)| {
                let joint = entity.and_then(|e| poses.get(e).ok()).map_or(Affine3::IDENTITY, affine);
                mesh_from_world * joint * *bind_from_mesh
            })
            .collect();
        let weights = deformer.weights_of.and_then(|e| weights.get(e).ok()).map_or_else(Vec::new, |w| w.0.clone());
        if deformer.posed.as_ref().is_some_and(|(w, j)| *w == weights && *j == joints) {
            continue;
        }
        if let Some(mesh) = deformer.source.posed(&weights, &joints)
            && let Some(slot) = assets.meshes.get_mut(deformer.mesh.0 as usize)
        {
            *slot = Arc::new(mesh);
        }
        deformer.posed = Some((weights, joints));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn track(interpolation: Interpolation, values: &[f32]) -> Track<f32> {
        Track { times: vec![1.0, 3.0], values: values.to_vec(), width: 1, interpolation }
    }

    #[test]
    fn keys_and_what_lies_between() {
        let linear = track(Interpolation::Linear, &[2.0, 6.0]);
        assert_eq!([0.0, 1.0, 1.5, 3.0, 9.0].map(|t| linear.sample(t, 0)), [2.0, 2.0, 3.0, 6.0, 6.0]);
        let step = track(Interpolation::Step, &[2.0, 6.0]);
        assert_eq!([0.0, 2.9, 3.0].map(|t| step.sample(t, 0)), [2.0, 2.0, 6.0]);
        // Tangents of slope 2 over a chord of slope 2: a straight line.
        let spline = track(Interpolation::CubicSpline, &[0.0, 2.0, 2.0, 2.0, 6.0, 0.0]);
        assert_eq!([1.0, 1.5, 2.0, 3.0].map(|t| spline.sample(t, 0)), [2.0, 3.0, 4.0, 6.0]);
    }

    #[test]
    fn rotations_take_the_short_way() {
        let quarter = Quat::from_rotation_y(std::f32::consts::FRAC_PI_2);
        for end in [quarter, -quarter] {
            let half = Quat::IDENTITY.between(end, 0.5);
            assert!(
                (half.mul_vec3(Vec3::X) - Quat::from_rotation_y(std::f32::consts::FRAC_PI_4).mul_vec3(Vec3::X))
                    .length()
                    < 1e-6
            );
        }
        assert_eq!(Quat::from_xyzw(0.0, 0.0, 0.0, 0.0).mended(), Quat::IDENTITY);
    }

    #[test]
    fn time_begins_anew_at_the_same_bits() {
        let a = NodeAnimation { tracks: Arc::default(), duration: 0.5 };
        assert_eq!([0, 15, 30, 45, 60_000_000].map(|s| a.seconds_at(s)), [0.0, 0.25, 0.0, 0.25, 0.0]);
        assert_eq!(NodeAnimation { duration: 0.0, ..a }.seconds_at(77), 0.0);
    }
}
