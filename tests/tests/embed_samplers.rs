//! What lies beyond a texture's edge, and how its coordinates are turned: pixels that arithmetic foretells, on both lanes, seen
//! directly and in a mirror.

use catoptra_engine::{
    Material, Mesh, MeshData, Mip, Texture, TextureRef, Wrap,
    glam::{Affine3, Mat3, Vec2, Vec3},
    shapes::ShapeBuilder,
};
use catoptra_render_hybrid::{RenderSettings, Renderer, Shadows};
use catoptra_tests::{HandScene, at, fixtures, gpu_or_skip};
use std::{f32::consts::PI, sync::Arc};

/// Texels a side.
const SIDE: usize = 4;
/// Copies of the image a side of the picture: one before the image, itself, and two beyond.
const COPIES: usize = 4;
/// Pixels a side.
const PIXELS: usize = SIDE * COPIES;

/// A square of 2 m that faces +z, coordinates from -1 to 3 along x and downwards.
fn square() -> Mesh {
    let corners = [(-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (1.0, 1.0)];
    let uv = |(x, y): (f32, f32)| Vec2::new((x + 1.0) * 2.0 - 1.0, (1.0 - y) * 2.0 - 1.0);
    Mesh::new(MeshData {
        positions: corners.map(|(x, y)| Vec3::new(x, y, 0.0)).to_vec(),
        normals: vec![Vec3::Z; 4],
        uvs: corners.map(uv).to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Default::default()
    })
    .unwrap()
}

fn texel(x: usize, y: usize) -> [u8; 4] {
    [40 + 60 * x as u8, 40 + 60 * y as u8, 128, 255]
}

/// Texel that texel number `i` of the endless row stands for.
fn wrapped(i: i64, wrap: Wrap) -> usize {
    let n = SIDE as i64;
    (match wrap {
        Wrap::Repeat => i.rem_euclid(n),
        Wrap::Clamp => i.clamp(0, n - 1),
        Wrap::Mirror => {
            let j = i.rem_euclid(2 * n);
            if j < n { j } else { 2 * n - 1 - j }
        }
    }) as usize
}

fn scene(reference: TextureRef, mirror: bool) -> HandScene {
    let (eye, forward) = if mirror { (Vec3::X * 3.0, Vec3::NEG_X) } else { (Vec3::Z * 3.0, Vec3::NEG_Z) };
    let mut s = HandScene::parallel(eye, forward, 1.0);
    let texels = (0..SIDE * SIDE).map(|i| texel(i % SIDE, i / SIDE)).collect();
    s.0.textures.push(Arc::new(Texture::new(SIDE as u32, SIDE as u32, texels, false).unwrap()));
    let material = Material { base_color_texture: Some(reference), unlit: true, ..Material::default() };
    if mirror {
        // Behind the mirror's back the picture hangs the wrong way round, so that in the mirror it hangs the right way.
        let turned = Mat3::from_rotation_y(PI) * Mat3::from_diagonal(Vec3::new(-1.0, 1.0, 1.0));
        s.add(square(), material, Affine3 { matrix3: turned, translation: Vec3::Z * 5.0 });
        let corners = [(-1.5, -1.5, 1.5), (1.5, -1.5, -1.5), (1.5, 1.5, -1.5), (-1.5, 1.5, 1.5)];
        let pane = ShapeBuilder::default().quad(corners.map(Vec3::from), Vec3::ONE).build();
        s.add(pane, Material::mirror(Vec3::ONE, 1.0), at(Vec3::ZERO));
    } else {
        s.add(square(), material, at(Vec3::ZERO));
    }
    s
}

fn plain(wrap: [Wrap; 2]) -> TextureRef {
    TextureRef { wrap, nearest: true, nearest_min: true, mip: Mip::None, ..TextureRef::default() }
}

/// Compares every pixel with the texel of `expected`, by column and row of the endless picture.
fn check(
    renderer: &mut Renderer,
    reference: TextureRef,
    mirror: bool,
    what: &str,
    expected: impl Fn(i64, i64) -> [usize; 2],
) {
    let size = PIXELS as u32;
    let settings = RenderSettings { shadows: Shadows::Off, vpl: None, ..fixtures::small(size, size, 64) };
    let image = renderer.render(&scene(reference, mirror).0, &settings).unwrap().image;
    for y in 0..PIXELS {
        for x in 0..PIXELS {
            let [tx, ty] = expected(x as i64 - SIDE as i64, y as i64 - SIDE as i64);
            let [r, g, b, _] = texel(tx, ty).map(|v| f32::from(v) / 255.0);
            let got = Vec3::from(image.at(x as u32, y as u32));
            let lane = renderer.lane();
            assert!(
                (got - Vec3::new(r, g, b)).length() < 1e-3,
                "{lane:?} {what} mirror {mirror}: ({x}, {y}) is {got}, not texel {tx}, {ty}"
            );
        }
    }
}

fn lanes(test: &str) -> Vec<Renderer> {
    std::iter::once(fixtures::cpu()).chain(gpu_or_skip(test)).collect()
}

#[test]
fn images_repeat_stop_or_turn_back_beyond_their_edges() {
    let all = [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror];
    for mut renderer in lanes("images_repeat_stop_or_turn_back_beyond_their_edges") {
        for u in all {
            for v in all {
                for mirror in [false, true] {
                    let what = format!("{u:?} {v:?}");
                    check(&mut renderer, plain([u, v]), mirror, &what, |x, y| [wrapped(x, u), wrapped(y, v)]);
                }
            }
        }
    }
}

#[test]
fn coordinates_are_shifted_scaled_and_turned() {
    let wrap = [Wrap::Repeat, Wrap::Mirror];
    let pick = |x: i64, y: i64| [wrapped(x, wrap[0]), wrapped(y, wrap[1])];
    for mut renderer in lanes("coordinates_are_shifted_scaled_and_turned") {
        for mirror in [false, true] {
            let with = |uv_transform| TextureRef { uv_transform, ..plain(wrap) };
            let shifted = with([[1.0, 0.0, 0.25], [0.0, 1.0, -0.5]]);
            check(&mut renderer, shifted, mirror, "shifted", |x, y| pick(x + 1, y - 2));
            // KHR_texture_transform by a quarter turn: (u, v) becomes (v, -u).
            let turned = with([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]);
            check(&mut renderer, turned, mirror, "turned", |x, y| pick(y, -x - 1));
            let half = with([[0.5, 0.0, 0.0], [0.0, 0.5, 0.0]]);
            check(&mut renderer, half, mirror, "twice as large", |x, y| pick(x.div_euclid(2), y.div_euclid(2)));
            let backwards = with([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
            check(&mut renderer, backwards, mirror, "backwards", |x, y| pick(-x - 1, y));
        }
    }
}
