//! Contract: every file of the shared test data loads or is refused with a reason; none panics, hangs or allocates beyond
//! the limits. The files are not part of the project: where the folder is missing the tests say so and pass.

use catoptra_engine::{
    Aabb, ImportLimits, ImportedScene, Material, export_glb, gltf::GltfError, gltf::export_glb_bytes, load_gltf,
    load_gltf_bytes,
};
use glam::Vec3;
use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

/// The shared folder `name`, or `None` after saying loudly that the test is skipped.
fn shared(name: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared").join(name);
    if folder.exists() {
        return Some(folder);
    }
    eprintln!("SKIPPED: {} is not there", folder.display());
    None
}

/// All `.gltf` and `.glb` files below `folder`, sorted.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut out = Vec::new();
    let mut stack = vec![folder.to_path_buf()];
    while let Some(folder) = stack.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                stack.push(path);
            } else if path.extension().is_some_and(|e| e == "gltf" || e == "glb") {
                out.push(path);
            }
        }
    }
    out.sort();
    out
}

fn load(path: &Path) -> Result<ImportedScene, GltfError> {
    let start = Instant::now();
    let result = load_gltf(path, &ImportLimits::default());
    let took = start.elapsed();
    assert!(took < Duration::from_secs(5), "{} took {took:?}", path.display());
    if let Err(error) = &result {
        let line = error.to_string();
        assert!(!line.is_empty() && !line.contains('\n'), "not one line: {line:?}");
    }
    result
}

/// What any loaded scene owes its users.
fn check(path: &Path, scene: &ImportedScene) {
    scene.to_render_scene(0).validate().unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    for (i, node) in scene.nodes.iter().enumerate() {
        assert!(node.parent.is_none_or(|p| p < i), "{}: node {i} comes before its parent", path.display());
        assert!(node.transform.rotation.is_normalized() && node.transform.is_finite());
    }
    for mesh in &scene.meshes {
        assert!(mesh.normals().iter().all(|n| (n.length() - 1.0).abs() < 1e-4), "{}: normals", path.display());
    }
    assert_eq!(scene.report.triangles, scene.triangle_count());
}

#[test]
fn samples_load() {
    let Some(folder) = shared("assets/gltf-samples") else { return };
    let files = files(&folder);
    assert!(files.len() >= 47);
    let mut refused = Vec::new();
    for path in &files {
        match load(path) {
            Ok(scene) => {
                check(path, &scene);
                let r = &scene.report;
                println!(
                    "{}: {} triangles, {} instances, ignored {:?}",
                    name(path),
                    r.triangles,
                    r.instances,
                    r.ignored
                );
                assert!(r.triangles > 0, "{} shows nothing", path.display());
            }
            // The sample set has some models in compressed variants too.
            Err(GltfError::Extension(e)) if e == "KHR_draco_mesh_compression" => assert!(name(path).contains("Draco")),
            Err(error) => refused.push(format!("{}: {error}", name(path))),
        }
    }
    assert!(refused.is_empty(), "{refused:#?}");
}

#[test]
fn generator_positive_load_and_negative_are_refused() {
    let Some(folder) = shared("assets/gltf-generator") else { return };
    for path in files(&folder.join("Positive")) {
        match load(&path) {
            Ok(scene) => check(&path, &scene),
            // Compatibility_04 demands a later version, Compatibility_05 an extension that nobody has.
            Err(GltfError::Version(v)) => assert!(v == "2.1" && name(&path).ends_with("Compatibility_04.gltf")),
            Err(GltfError::Extension(_)) => assert!(name(&path).ends_with("Compatibility_05.gltf")),
            Err(error) => panic!("{}: {error}", name(&path)),
        }
    }
    for path in files(&folder.join("Negative")) {
        let error = load(&path).expect_err(&name(&path));
        println!("{}: {error}", name(&path));
    }
}

#[test]
fn malformed_are_harmless() {
    let Some(folder) = shared("assets/gltf-malformed") else { return };
    let files = files(&folder);
    assert_eq!(files.len(), 296);
    let mut loaded = 0;
    for path in &files {
        match load(path) {
            Ok(scene) => {
                check(path, &scene);
                loaded += 1;
                println!("loaded  {}: {} triangles", name(path), scene.report.triangles);
            }
            Err(error) => println!("refused {}: {error}", name(path)),
        }
    }
    println!("{loaded} loaded, {} refused", files.len() - loaded);
    assert!(loaded < files.len());
}

#[test]
fn compressed_are_refused_by_name() {
    let Some(folder) = shared("assets/gltf-compressed") else { return };
    let mut named = [0; 2];
    for path in files(&folder) {
        match load(&path) {
            Ok(scene) => check(&path, &scene),
            Err(GltfError::Extension(extension)) => match extension.as_str() {
                "KHR_draco_mesh_compression" => named[0] += 1,
                "EXT_meshopt_compression" => named[1] += 1,
                other => println!("{}: {other}", name(&path)),
            },
            Err(error) => println!("{}: {error}", name(&path)),
        }
    }
    assert!(named[0] > 0 && named[1] > 0, "{named:?}");
}

#[test]
fn statue_and_atrium() {
    let Some(folder) = shared("assets") else { return };
    for triangles in [640, 1582, 3152, 6292, 12570, 18846, 25124, 31402, 32000] {
        let path = folder.join(format!("venus/venus_{triangles}.glb"));
        let scene = load(&path).unwrap();
        check(&path, &scene);
        assert_eq!(scene.triangle_count(), triangles);
        assert!(scene.meshes.iter().all(|m| m.closed()), "the Venus is watertight");
        let merged = scene.merged_mesh(&ImportLimits::default()).unwrap();
        assert!(merged.closed() && merged.triangles().len() == triangles);
    }
    let path = folder.join("sponza/sponza_dabrovic_66454.glb");
    let scene = load(&path).unwrap();
    check(&path, &scene);
    println!("sponza: {:?}, {:?}", scene.report, scene.bounds_world());
    assert_eq!(scene.triangle_count(), 66_454);
    assert_eq!(scene.nodes.iter().filter(|n| !n.primitives.is_empty()).count(), 34);
}

#[test]
fn analytic_materials_are_what_the_paper_says() {
    let Some(folder) = shared("analytic") else { return };
    let scene = |name: &str| {
        let path = folder.join(name);
        let scene = load(&path).unwrap();
        check(&path, &scene);
        println!("{name}: {:#?}\n{:?}\n{:?}", scene.materials, scene.report, scene.to_render_scene(0).lights);
        assert!(scene.report.has_camera && scene.report.ignored.is_empty());
        scene
    };
    let plane = scene("plane_point.glb");
    assert_eq!(plane.materials, [Material::lambert(Vec3::splat(0.5))].map(like(&plane.materials[0])));
    let lights = plane.to_render_scene(0).lights;
    assert_eq!((lights.len(), lights[0].intensity, lights[0].radius), (1, Vec3::splat(10.0), 0.0));
    scene("plane_spot.glb");
    let floor = scene("mirror_floor.glb");
    let mirror = floor.materials.iter().find(|m| m.mirror > 0.0).unwrap();
    assert_eq!((mirror.mirror, mirror.base_color), (1.0, Vec3::new(0.9, 0.8, 0.7)));
    let slab = scene("glass_slab.glb");
    let glass = slab.materials.iter().find(|m| m.transmission > 0.0).unwrap();
    assert_eq!((glass.transmission, glass.ior, glass.specular), (1.0, 1.5, Vec3::ZERO));
    scene("furnace_sphere.glb");
}

/// A pure Lambert material does not use its exponent: taken over, so that the rest can be compared.
fn like(got: &Material) -> impl Fn(Material) -> Material + '_ {
    |m| Material { shininess: got.shininess, ..m }
}

/// Our reader against an independent one: bounds of everything in the scene.
#[test]
fn geometry_agrees_with_another_reader() {
    let Some(folder) = shared("assets/gltf-samples") else { return };
    let mut compared = 0;
    for path in files(&folder) {
        let (Ok(ours), Ok(theirs)) = (load(&path), gltf::Gltf::open(&path)) else { continue };
        let deformed = theirs.nodes().any(|n| n.skin().is_some())
            || theirs.meshes().any(|m| m.weights().is_some_and(|w| w.iter().any(|w| *w != 0.0)));
        if deformed {
            continue;
        }
        let scene = theirs.default_scene().or_else(|| theirs.scenes().next()).unwrap();
        let mut expected = (Aabb::EMPTY, 0);
        for node in scene.nodes() {
            visit(&node, glam::DMat4::IDENTITY, &mut expected);
        }
        // The file's min and max are of whole accessors: ours, of the vertices in use, lie within.
        let (got, wanted) = (ours.bounds_world(), expected.0);
        let slack = Vec3::splat(1e-4 * wanted.radius().max(1e-3));
        assert_eq!(ours.triangle_count(), expected.1, "{}", name(&path));
        let inside = got.min.cmpge(wanted.min - slack).all() && got.max.cmple(wanted.max + slack).all();
        assert!(inside, "{}: {got:?} is not within {wanted:?}", name(&path));
        compared += 1;
    }
    assert!(compared >= 35, "only {compared} files were compared");
}

fn visit(node: &gltf::Node, parent: glam::DMat4, sum: &mut (Aabb, usize)) {
    let local = glam::Mat4::from_cols_array_2d(&node.transform().matrix()).as_dmat4();
    let pose = parent * local;
    for primitive in node.mesh().iter().flat_map(|m| m.primitives()) {
        let positions = primitive.get(&gltf::Semantic::Positions).unwrap();
        let corners = primitive.indices().map_or(positions.count(), |i| i.count());
        let triangles = match primitive.mode() {
            gltf::mesh::Mode::Triangles => corners / 3,
            gltf::mesh::Mode::TriangleStrip | gltf::mesh::Mode::TriangleFan => corners.saturating_sub(2),
            _ => continue,
        };
        let b = primitive.bounding_box();
        let b = Aabb { min: b.min.into(), max: b.max.into() };
        for corner in b.corners() {
            sum.0 = sum.0.union_point(pose.transform_point3(corner.as_dvec3()).as_vec3());
        }
        sum.1 += triangles;
    }
    for child in node.children() {
        visit(&child, pose, sum);
    }
}

/// A broken copy of a good file, at every length and with every early byte changed: harmless.
#[test]
fn truncated_and_corrupted_copies_are_harmless() {
    let Some(folder) = shared("analytic") else { return };
    let bytes = std::fs::read(folder.join("mirror_floor.glb")).unwrap();
    let limits = ImportLimits::default();
    for n in 0..bytes.len() {
        assert!(load_gltf_bytes(&bytes[..n], None, &limits).is_err(), "{n} of {} bytes loaded", bytes.len());
    }
    for at in 0..bytes.len() {
        for flip in [0xFF, 0x01, 0x80] {
            let mut broken = bytes.clone();
            broken[at] ^= flip;
            // Loading is fine where the byte says nothing of importance; panicking is not.
            if let Ok(scene) = load_gltf_bytes(&broken, None, &limits) {
                check(Path::new("broken copy"), &scene);
            }
        }
    }
}

/// Everything that loads can be written, and comes back the same.
#[test]
fn samples_survive_export() {
    let Some(folder) = shared("assets/gltf-samples") else { return };
    for path in files(&folder) {
        let Ok(scene) = load(&path) else { continue };
        if scene.report.triangles > 100_000 || scene.textures.iter().any(|t| t.width() > 1024) {
            continue; // Time: debug builds code PNG slowly.
        }
        let first = scene.to_render_scene(0);
        let bytes = export_glb_bytes(&first).unwrap();
        let again =
            load_gltf_bytes(&bytes, None, &ImportLimits::default()).unwrap_or_else(|e| panic!("{}: {e}", name(&path)));
        let second = again.to_render_scene(0);
        assert_eq!(second.triangle_count(), first.triangle_count(), "{}", name(&path));
        assert_eq!(second.lights.len(), first.lights.len());
        let (a, b) = (first.bounds_world(), second.bounds_world());
        assert_eq!((a.min, a.max), (b.min, b.max), "{}", name(&path));
        for (x, y) in first.instances.iter().zip(&second.instances) {
            let (x, y) = (first.materials[x.material as usize], second.materials[y.material as usize]);
            assert_eq!(
                Material { base_color_texture: None, emissive_texture: None, normal_texture: None, ..x },
                Material { base_color_texture: None, emissive_texture: None, normal_texture: None, ..y },
                "{}",
                name(&path)
            );
        }
    }
}

#[test]
fn a_failed_export_leaves_nothing_behind() {
    let folder = std::env::temp_dir().join(format!("catoptra-export-{}", std::process::id()));
    std::fs::create_dir_all(folder.join("taken.glb")).unwrap();
    let scene = catoptra_engine::RenderScene::default();
    // A folder stands where the file should go.
    assert!(export_glb(&scene, &folder.join("taken.glb")).is_err());
    assert!(export_glb(&scene, &folder.join("missing/x.glb")).is_err());
    export_glb(&scene, &folder.join("good.glb")).unwrap();
    let mut names: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["good.glb", "taken.glb"]);
    std::fs::remove_dir_all(&folder).unwrap();
}

fn name(path: &Path) -> String {
    let shown: Vec<_> = path.iter().rev().take(3).collect();
    shown.into_iter().rev().map(|s| s.to_string_lossy()).collect::<Vec<_>>().join("/")
}
