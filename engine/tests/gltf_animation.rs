//! Animations of files: poses are functions of the step number, skins and morph targets follow, broken ones are refused.

mod gltf_common;

use catoptra_engine::{
    Extracted, ImportedScene, RenderScene, app,
    bevy_app::App,
    glam::{Quat, Vec3},
};
use gltf_common::{floats, glb, load};
use serde_json::{Value, json};
use std::sync::Arc;

/// One triangle that a node moves, a joint bends and a target stretches. Tracks: what `channels` says, over keys at 0 and 1 s.
fn file(channels: Value, interpolation: &str, skinned: bool) -> Vec<u8> {
    let mut bin = floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]); // positions: 36 bytes
    bin.extend(floats(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0])); // target: 36
    bin.extend([0; 12]); // joints: 12
    bin.extend(floats(&[1.0, 0.0, 0.0, 0.0].repeat(3))); // weights: 48
    bin.extend(floats(&[0.0, 1.0])); // times at 132: 8
    bin.extend(floats(&[0.0, 0.0, 0.0, 2.0, 0.0, -4.0])); // translations at 140: 24
    bin.extend(floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.70710677, 0.70710677])); // rotations at 164: 32
    bin.extend(floats(&[0.0, 1.0])); // morph weights at 196: 8
    let mut attributes = json!({ "POSITION": 0 });
    let mut mesh_node = json!({ "mesh": 0, "translation": [5, 5, 5] });
    if skinned {
        attributes["JOINTS_0"] = json!(2);
        attributes["WEIGHTS_0"] = json!(3);
        mesh_node["skin"] = json!(0);
    }
    let view = |offset: usize, length: usize| json!({ "buffer": 0, "byteOffset": offset, "byteLength": length });
    let accessor = |view: usize, kind: &str, component: u32, count: usize| json!({ "bufferView": view, "type": kind, "componentType": component, "count": count });
    let output = |path: &str| match path {
        "rotation" => 6,
        "weights" => 7,
        _ => 5,
    };
    let channels: Vec<(u64, String)> = serde_json::from_value(channels).unwrap();
    let animation = json!({
        "channels": channels.iter().enumerate().map(|(i, (node, path))| json!({ "sampler": i, "target": { "node": node, "path": path } })).collect::<Vec<_>>(),
        "samplers": channels.iter().map(|(_, path)| json!({ "input": 4, "output": output(path), "interpolation": interpolation })).collect::<Vec<_>>(),
    });
    let json = json!({
        "nodes": [mesh_node, { "name": "joint" }],
        "scenes": [{ "nodes": [0, 1] }],
        "skins": [{ "joints": [1] }],
        "meshes": [{ "primitives": [{ "attributes": attributes, "targets": [{ "POSITION": 1 }] }] }],
        "animations": [animation],
        "accessors": [
            accessor(0, "VEC3", 5126, 3), accessor(1, "VEC3", 5126, 3), accessor(2, "VEC4", 5121, 3),
            accessor(3, "VEC4", 5126, 3), accessor(4, "SCALAR", 5126, 2), accessor(5, "VEC3", 5126, 2),
            accessor(6, "VEC4", 5126, 2), accessor(7, "SCALAR", 5126, 2),
        ],
        "bufferViews": [
            view(0, 36), view(36, 36), view(72, 12), view(84, 48), view(132, 8), view(140, 24), view(164, 32), view(196, 8),
        ],
    });
    glb(json, &bin)
}

fn played(scene: &ImportedScene, steps: u64) -> (App, RenderScene) {
    let mut app = app::new_app();
    scene.spawn(app.world_mut(), 0);
    app::settle(&mut app);
    app::advance(&mut app, steps);
    let out = app.world().resource::<Extracted>().0.clone();
    (app, out)
}

/// World positions of the one drawn triangle.
fn corners(scene: &RenderScene) -> [Vec3; 3] {
    let i = &scene.instances[0];
    scene.meshes[i.mesh as usize].corners(0).map(|p| i.world_from_object.transform_point3(p))
}

fn assert_near(got: [Vec3; 3], expected: [Vec3; 3]) {
    assert!(got.iter().zip(expected).all(|(a, b)| (*a - b).length() < 1e-5), "{got:?} for {expected:?}");
}

const REST: [Vec3; 3] = [Vec3::ZERO, Vec3::X, Vec3::Y];

#[test]
fn nodes_move_by_the_step_number_alone() {
    let scene = load(&file(json!([[0, "translation"], [0, "rotation"]]), "LINEAR", false)).unwrap();
    assert!(scene.report.ignored.is_empty(), "{:?}", scene.report.ignored);
    assert_eq!((scene.animations.len(), scene.animations[0].duration, scene.deformations.len()), (1, 1.0, 0));
    assert_near(corners(&played(&scene, 0).1), REST);
    let (mut app, half) = played(&scene, 30);
    let turn = Quat::from_rotation_z(std::f32::consts::FRAC_PI_4);
    assert_near(corners(&half), REST.map(|p| turn * p + Vec3::new(1.0, 0.0, -2.0)));
    // Round and round to the same bits, and no mesh is made for it.
    app::advance(&mut app, 60);
    let later = app.world().resource::<Extracted>().0.clone();
    assert_eq!(later.instances, half.instances);
    assert_eq!(later.structure_revision, half.structure_revision);
    assert_eq!(later.moved, [0]);
    // Without an ECS the file's own pose is shown.
    assert_near(corners(&scene.to_render_scene(0)), REST.map(|p| p + 5.0));
    let step = load(&file(json!([[0, "translation"]]), "STEP", false)).unwrap();
    assert_near(corners(&played(&step, 59).1), REST);
}

#[test]
fn skins_follow_their_joints() {
    let scene = load(&file(json!([[1, "translation"], [1, "rotation"]]), "LINEAR", true)).unwrap();
    assert_eq!(scene.deformations.len(), 1);
    let (mut app, half) = played(&scene, 30);
    let turn = Quat::from_rotation_z(std::f32::consts::FRAC_PI_4);
    // The skinned node's own pose does not count.
    assert_near(corners(&half), REST.map(|p| turn * p + Vec3::new(1.0, 0.0, -2.0)));
    let mesh = half.meshes[half.instances[0].mesh as usize].clone();
    // Nothing moves while the clock stands: the mesh, and so its tree, stays.
    app::settle(&mut app);
    let same = app.world().resource::<Extracted>().0.clone();
    assert!(Arc::ptr_eq(&same.meshes[same.instances[0].mesh as usize], &mesh));
    app::advance(&mut app, 1);
    let next = app.world().resource::<Extracted>().0.clone();
    assert!(!Arc::ptr_eq(&next.meshes[next.instances[0].mesh as usize], &mesh));
    assert_eq!(next.meshes.len(), half.meshes.len(), "the old shape is let go");
}

#[test]
fn morph_targets_follow_their_weights() {
    let scene = load(&file(json!([[0, "weights"]]), "LINEAR", false)).unwrap();
    for (steps, weight) in [(0, 0.0), (15, 0.25), (45, 0.75), (60, 0.0)] {
        let expected = [Vec3::ZERO, Vec3::X, Vec3::Y * (1.0 + 2.0 * weight)].map(|p| p + 5.0);
        assert_near(corners(&played(&scene, steps).1), expected);
    }
}

#[test]
fn posed_at_rest_it_is_what_the_import_made() {
    for skinned in [false, true] {
        let scene = load(&file(json!([[0, "weights"], [1, "translation"]]), "LINEAR", skinned)).unwrap();
        let d = &scene.deformations[0];
        let joints: Vec<_> =
            d.joints.iter().map(|(node, bind)| scene.world_from_node()[node.unwrap()] * *bind).collect();
        let posed = d.source.posed(&d.weights, &joints).unwrap();
        let made = &scene.meshes[d.mesh];
        assert_eq!(
            (posed.positions(), posed.normals(), posed.triangles()),
            (made.positions(), made.normals(), made.triangles())
        );
    }
}

#[test]
fn broken_animations_are_refused_or_listed() {
    let good = file(json!([[0, "translation"]]), "LINEAR", false);
    assert!(load(&good).is_ok());
    for (channels, interpolation, why) in [
        (json!([[7, "translation"]]), "LINEAR", "node 7"),
        (json!([[0, "translation"]]), "WOBBLE", "WOBBLE"),
        (json!([[0, "translation"]]), "CUBICSPLINE", "2 values"),
    ] {
        let error = load(&file(channels, interpolation, false)).unwrap_err().to_string();
        assert!(error.contains(why), "{error}");
    }
    let listed = load(&file(json!([[0, "pointer"]]), "LINEAR", false)).unwrap();
    assert!(listed.report.ignored[0].contains("pointer"));
    // Times that run backwards, values that are no numbers: by changing the bytes of the good file.
    let at = |what: &[f32]| {
        let wanted = floats(what);
        good.windows(wanted.len()).rposition(|w| w == wanted).unwrap()
    };
    let with = |at: usize, value: f32| {
        let mut bytes = good.clone();
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        load(&bytes)
    };
    let times = at(&[0.0, 1.0, 0.0, 0.0, 0.0, 2.0]);
    for bad in [f32::NAN, f32::INFINITY, 0.0, -1.0] {
        assert!(with(times + 4, bad).is_err(), "time {bad}");
        assert!(bad == 0.0 || bad == -1.0 || with(times + 8, bad).is_err(), "value {bad}");
    }
}
