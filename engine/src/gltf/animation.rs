//! The animations of a file: tracks of nodes, checked.

use super::{
    accessor::Accessor,
    buffers::Buffers,
    document::{Document, item},
    error::{GltfError, within},
    limits::ImportLimits,
    report::Ignored,
};
use crate::animation::{Interpolation, NodeTracks, Track};
use glam::{Quat, Vec3};
use std::collections::BTreeMap;

/// Tracks of one animation by node number in the file, and the seconds after which they begin anew.
#[derive(Default)]
pub(super) struct Clip {
    pub name: Option<String>,
    pub of_node: BTreeMap<u32, NodeTracks>,
    pub duration: f32,
}

/// Reads all animations.
pub(super) fn all(
    document: &Document,
    buffers: &Buffers,
    limits: &ImportLimits,
    ignored: &mut Ignored,
) -> Result<Vec<Clip>, GltfError> {
    let mut numbers = 0_u64;
    (0..document.animations.len()).map(|i| read(document, i, buffers, limits, &mut numbers, ignored)).collect()
}

/// Reads one. * `numbers`: keys of all so far
fn read(
    document: &Document,
    index: usize,
    buffers: &Buffers,
    limits: &ImportLimits,
    numbers: &mut u64,
    ignored: &mut Ignored,
) -> Result<Clip, GltfError> {
    let animation = &document.animations[index];
    let mut out = Clip { name: animation.name.clone(), ..Clip::default() };
    for (i, channel) in animation.channels.iter().enumerate() {
        let place = &format!("animation {index}, channel {i}");
        let Some(node) = channel.target.node else {
            ignored.note("animation channels without a node");
            continue;
        };
        let target = item(&document.nodes, node, "node", place)?;
        let sampler = item(&animation.samplers, channel.sampler, "sampler", place)?;
        let interpolation = match sampler.interpolation.as_deref() {
            None | Some("LINEAR") => Interpolation::Linear,
            Some("STEP") => Interpolation::Step,
            Some("CUBICSPLINE") => Interpolation::CubicSpline,
            Some(other) => return Err(GltfError::invalid(place, format!("interpolation {other:?} does not exist"))),
        };
        let path = channel.target.path.as_str();
        if !matches!(path, "translation" | "rotation" | "scale" | "weights") {
            ignored.note(format!("animation of {path}"));
            continue;
        }
        if target.matrix.is_some() && path != "weights" {
            ignored.note("animation of nodes posed by a matrix");
            continue;
        }
        let input = Accessor::open(document, buffers, sampler.input, place)?;
        let output = Accessor::open(document, buffers, sampler.output, place)?;
        // Accessors without a buffer are of any length at no cost to the file.
        *numbers = numbers.saturating_add(input.count as u64).saturating_add(output.count as u64);
        within("animation keys", *numbers, limits.vertices)?;
        if input.components != 1 || input.count == 0 {
            return Err(GltfError::invalid(place, "its times must be a list of numbers"));
        }
        let times: Vec<f32> = (0..input.count).map(|k| input.read::<1>(k, [0.0])[0]).collect();
        if !times[0].is_finite() || times[0] < 0.0 || !times.is_sorted_by(|a, b| a < b && b.is_finite()) {
            return Err(GltfError::invalid(place, "its times do not ascend from 0 on"));
        }
        let parts = if interpolation == Interpolation::CubicSpline { 3 } else { 1 };
        let components = match path {
            "weights" => 1,
            "rotation" => 4,
            _ => 3,
        };
        let width = if path == "weights" { output.count / (parts * times.len()) } else { 1 };
        if output.components != components || output.count != parts * times.len() * width || width == 0 {
            let why = format!("{} values of {} numbers for {} keys", output.count, output.components, times.len());
            return Err(GltfError::invalid(place, why));
        }
        let finite = |v: &[f32]| match v.iter().find(|v| !v.is_finite()) {
            Some(v) => Err(GltfError::invalid(place, format!("a value is {v}"))),
            None => Ok(()),
        };
        out.duration = out.duration.max(*times.last().expect("not empty"));
        let tracks = out.of_node.entry(node).or_default();
        match path {
            "rotation" => {
                let values: Vec<Quat> = (0..output.count)
                    .map(|k| {
                        let v = output.read::<4>(k, [0.0; 4]);
                        finite(&v).map(|()| Quat::from_array(v))
                    })
                    .collect::<Result<_, _>>()?;
                tracks.rotation = Some(Track { times, values, width, interpolation });
            }
            "weights" => {
                let values: Vec<f32> = (0..output.count).map(|k| output.read::<1>(k, [0.0])[0]).collect();
                finite(&values)?;
                tracks.weights = Some(Track { times, values, width, interpolation });
            }
            _ => {
                let values: Vec<Vec3> = (0..output.count)
                    .map(|k| {
                        let v = output.read::<3>(k, [0.0; 3]);
                        finite(&v).map(|()| Vec3::from(v))
                    })
                    .collect::<Result<_, _>>()?;
                let track = Some(Track { times, values, width, interpolation });
                if path == "translation" { tracks.translation = track } else { tracks.scale = track }
            }
        }
    }
    Ok(out)
}
