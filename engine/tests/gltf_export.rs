//! Contract: what we write is valid for others, and comes back to us as it was.

mod gltf_common;

use catoptra_engine::{
    RenderScene,
    gltf::{GltfError, export_glb_bytes},
};
use gltf_common::{load, native_scene};

#[test]
fn our_own_exports_reload_exactly() {
    let scene = native_scene();
    let bytes = export_glb_bytes(&scene).unwrap();
    let imported = load(&bytes).unwrap();
    assert!(imported.report.ignored.is_empty(), "{:?}", imported.report.ignored);
    let again = imported.to_render_scene(0);

    assert_eq!(again.materials, scene.materials);
    assert_eq!(again.textures, scene.textures);
    assert_eq!(again.environment, scene.environment);
    assert_eq!(again.instances.len(), scene.instances.len());
    for (a, b) in again.instances.iter().zip(&scene.instances) {
        assert_eq!((a.stable_id, a.material), (b.stable_id, b.material));
        if b.stable_id == 5 {
            // A sheared pose comes back as a product of two.
            let d = a.world_from_object.matrix3 - b.world_from_object.matrix3;
            assert!(d.to_cols_array().iter().all(|v| v.abs() < 1e-5), "{d:?}");
        } else {
            assert_eq!(a.world_from_object, b.world_from_object);
        }
        let (a, b) = (&again.meshes[a.mesh as usize], &scene.meshes[b.mesh as usize]);
        assert_eq!((a.positions(), a.normals(), a.triangles()), (b.positions(), b.normals(), b.triangles()));
        assert_eq!((a.uvs(), a.uvs1(), a.colors(), a.closed()), (b.uvs(), b.uvs1(), b.colors(), b.closed()));
    }
    assert_eq!(again.meshes.len(), 2, "instances of one mesh share it again");
    for (a, b) in again.lights.iter().zip(&scene.lights) {
        assert_eq!((a.kind, a.radius, a.position_world), (b.kind, b.radius, b.position_world));
        assert!((a.intensity - b.intensity).abs().max_element() <= 1e-6 * b.intensity.max_element(), "{a:?} {b:?}");
        assert!((a.direction_world - b.direction_world).length() < 1e-6);
        assert!((a.up_world - b.up_world).length() < 1e-6);
    }
    assert_eq!(again.camera.projection, scene.camera.projection);
    assert_eq!(again.camera.near, scene.camera.near);
    let d = again.camera.world_from_view.matrix3 - scene.camera.world_from_view.matrix3;
    assert!(d.to_cols_array().iter().all(|v| v.abs() < 1e-6));
    assert_eq!(again.camera.world_from_view.translation, scene.camera.world_from_view.translation);

    let twice = export_glb_bytes(&scene).unwrap();
    assert_eq!(bytes, twice, "the same scene is the same file");
}

/// Another reader finds no fault with what we write, and sees what the design promises other renderers.
#[test]
fn exports_are_valid_for_others() {
    let bytes = export_glb_bytes(&native_scene()).unwrap();
    let theirs = gltf::Gltf::from_slice(&bytes).unwrap();
    assert_eq!(theirs.lights().unwrap().count(), 3);
    assert_eq!(theirs.cameras().count(), 1);
    let materials: Vec<_> = theirs.materials().collect();
    assert_eq!(materials[2].transmission().unwrap().transmission_factor(), 1.0);
    assert_eq!(materials[2].ior(), Some(1.77));
    assert_eq!(materials[2].volume().unwrap().attenuation_distance(), 0.7);
    assert!(materials[8].volume().unwrap().thickness_factor() > 0.0, "closed clear glass is a volume");
    assert!(materials[3].volume().is_none(), "open glass is a thin wall");
    assert_eq!(materials[6].emissive_strength(), Some(512.0));
    assert!(theirs.images().all(|i| matches!(i.source(), gltf::image::Source::View { mime_type: "image/png", .. })));
    for mesh in theirs.meshes() {
        for p in mesh.primitives() {
            let reader = p.reader(|_| theirs.blob.as_deref());
            assert_eq!(reader.read_positions().unwrap().count(), 8);
            assert_eq!(reader.read_colors(0).unwrap().into_rgba_f32().count(), 8);
        }
    }
}

#[test]
fn scenes_that_are_not_valid_are_not_written() {
    let mut scene = native_scene();
    scene.instances[0].world_from_object.translation.x = f32::NAN;
    assert!(matches!(export_glb_bytes(&scene), Err(GltfError::Export(_))));
    // An empty scene is a valid file.
    let empty = load(&export_glb_bytes(&RenderScene::default()).unwrap()).unwrap();
    assert_eq!((empty.report.triangles, empty.report.has_camera), (0, true));
}
