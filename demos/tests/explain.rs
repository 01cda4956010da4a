//! "Explain this pixel": the branches of the tree add up to the picture.

use catoptra_demos::scenes::{self, SceneOptions};
use catoptra_engine::Extracted;
use catoptra_render_hybrid::{
    RasterLane, RenderSettings, Renderer, RendererOptions,
    trace::explain::{RayKind, RayTree},
};

const SIZE: (u32, u32) = (48, 32);

fn trees(name: &str) -> Vec<(RayTree, glam::Vec3)> {
    let app = scenes::build(name, &SceneOptions::default()).unwrap();
    let scene = &app.world().resource::<Extracted>().0;
    let options = RendererOptions { raster: RasterLane::Cpu, ..Default::default() };
    let mut renderer = Renderer::new(options).unwrap();
    let mut settings = RenderSettings { width: SIZE.0, height: SIZE.1, ..Default::default() };
    // Every explanation makes the maps anew.
    settings.moments.size = 64;
    let image = renderer.render(scene, &settings).unwrap().image;
    let places = (0..SIZE.1).step_by(5).flat_map(|y| (0..SIZE.0).step_by(5).map(move |x| (x, y)));
    places.map(|(x, y)| (renderer.explain(scene, &settings, x, y).unwrap(), image.at(x, y).into())).collect()
}

#[test]
fn branches_add_up_to_the_pixel_in_every_scene() {
    for name in scenes::SCENES.map(|s| s.name) {
        let mut branches = 0;
        for (tree, pixel) in trees(name) {
            assert!(!tree.cut && tree.nodes[0].kind == RayKind::Camera);
            let error = (tree.radiance() - pixel).abs();
            let bound = 1e-5 + 1e-4 * pixel.abs();
            assert!(error.cmple(bound).all(), "{name} {:?}: {} is not {pixel}", tree.pixel, tree.radiance());
            branches += tree.nodes.len() - 1;
            for (i, node) in tree.nodes.iter().enumerate() {
                let Some(parent) = node.parent else { continue };
                assert!(parent < i && node.weight.max_element() <= tree.nodes[parent].weight.max_element() * 1.0001);
            }
        }
        assert_eq!(branches > 0, name != "rolling-box", "{name}: mirrors and glass branch, matter does not");
    }
}

#[test]
fn glass_splits_by_fresnel() {
    let mut pairs = 0;
    for (tree, _) in trees("rolling-box-donut") {
        for (i, node) in tree.nodes.iter().enumerate() {
            let of = |kind| tree.nodes.iter().find(|n| n.parent == Some(i) && n.kind == kind);
            if let (Some(r), Some(t), Some(_)) = (of(RayKind::Reflection), of(RayKind::Refraction), node.material) {
                // What is not reflected goes through, tinted by 0.98.
                let whole = r.split.x + t.split.x / 0.98;
                assert!((whole - 1.0).abs() < 1e-4 && r.split.x >= 0.0199, "{whole} {}", r.split.x);
                pairs += 1;
            }
        }
    }
    assert!(pairs > 20, "{pairs}");
}

#[test]
fn pixels_outside_are_refused() {
    let app = scenes::build("rolling-box", &SceneOptions::default()).unwrap();
    let scene = &app.world().resource::<Extracted>().0;
    let mut renderer = Renderer::new(RendererOptions { raster: RasterLane::Cpu, ..Default::default() }).unwrap();
    let settings = RenderSettings { width: 8, height: 8, ..Default::default() };
    assert!(renderer.explain(scene, &settings, 8, 0).is_err());
}
