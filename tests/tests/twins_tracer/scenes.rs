//! Scenes of everything that a surface can be: random meshes with and without attributes, transforms, textures, materials.

use catoptra_engine::{
    Instance, Material, Mesh, MeshData, Mip, Physical, RenderScene, Texture, TextureRef, Wrap,
    glam::{Affine3, Vec2, Vec3},
};
use std::sync::Arc;

use super::Random;

/// Triangles a mesh of [`open_mesh`]: eight fair ones, then those without area, then a tiny one.
pub const TRIANGLES: usize = 13;
/// The first without area: two corners, all corners, the other two corners in one place, three in a line.
pub const DEGENERATE: std::ops::Range<usize> = 8..12;

/// Which attributes a mesh has.
#[derive(Clone, Copy, Debug)]
pub struct Attributes {
    /// 0: flat, 1: around the triangle's own, 2: anything, also zero.
    pub normals: u32,
    /// Sets of texture coordinates.
    pub uvs: u32,
    pub colors: bool,
    /// 0: none, 1: unit ones, 2: some are zero.
    pub tangents: u32,
}

pub fn open_mesh(r: &mut Random, a: Attributes) -> Mesh {
    let mut data = MeshData::default();
    for t in 0..TRIANGLES {
        let mut p = fair_triangle(r);
        match t {
            8 => p[1] = p[0],
            9 => p = [p[0]; 3],
            10 => p[2] = p[1],
            // Along x, so that no rounding gives it an area.
            11 => p = [0.0, 0.25, 1.0].map(|x| Vec3::new(x, 0.5, -0.25)),
            12 => p = p.map(|p| p * 1e-5),
            _ => {}
        }
        let n = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or(Vec3::Y);
        for corner in p {
            data.positions.push(corner);
            let normal = match a.normals {
                1 => (n + r.vec() * 0.5).normalize_or(n),
                _ if r.chance(0.2) => Vec3::ZERO,
                _ => r.direction(),
            };
            data.normals.push(normal);
            data.uvs.push(Vec2::new(r.unit(), r.unit()) * 3.0 - 1.0);
            data.uvs1.push(Vec2::new(r.unit(), r.unit()) * 0.5);
            data.colors.push(r.color().extend(r.unit()));
            let tangent =
                if a.tangents == 2 && t % 2 == 0 { Vec3::ZERO } else { n.cross(r.vec()).normalize_or(Vec3::X) };
            data.tangents.push(tangent.extend(if r.chance(0.5) { 1.0 } else { -1.0 }));
        }
        let first = 3 * t as u32;
        data.triangles.push([first, first + 1, first + 2]);
        if t == 7 {
            // Texture coordinates without area.
            data.uvs[3 * t + 1] = data.uvs[3 * t];
        }
    }
    if a.normals == 0 {
        data.normals.clear();
    }
    if a.uvs < 2 {
        data.uvs1.clear();
    }
    if a.uvs < 1 {
        data.uvs.clear();
    }
    if !a.colors {
        data.colors.clear();
    }
    if a.tangents == 0 {
        data.tangents.clear();
    }
    Mesh::new(data).unwrap()
}

/// No sliver: the direction of those is what rounding makes of it.
fn fair_triangle(r: &mut Random) -> [Vec3; 3] {
    loop {
        let p = [r.vec(), r.vec(), r.vec()];
        let (a, b, c) = (p[1] - p[0], p[2] - p[0], p[2] - p[1]);
        let longest = a.length().max(b.length()).max(c.length());
        if a.cross(b).length() > 0.2 * longest * longest {
            return p;
        }
    }
}

/// Turned, skewed, mirrored, tiny, huge, far away.
pub fn transforms() -> [Affine3; 8] {
    let turned = Affine3::from_rotation_y(0.7) * Affine3::from_rotation_x(0.4);
    [
        Affine3::IDENTITY,
        Affine3::from_translation(Vec3::new(3.0, -2.0, 0.5)) * turned,
        Affine3::from_scale(Vec3::new(-1.0, 1.0, 1.0)),
        turned * Affine3::from_scale(Vec3::new(1.5, -0.4, 2.0)) * Affine3::from_rotation_z(0.9),
        Affine3::from_scale(Vec3::splat(-1.7)) * turned,
        Affine3::from_translation(Vec3::new(0.1, 0.2, 0.3)) * turned * Affine3::from_scale(Vec3::splat(1e-3)),
        turned * Affine3::from_scale(Vec3::new(1e4, 3e4, 2e4)),
        Affine3::from_translation(Vec3::new(1e4, -2e4, 3e4)) * turned,
    ]
}

pub fn textures(r: &mut Random) -> Vec<Arc<Texture>> {
    [(1, 1), (2, 1), (4, 4), (5, 3), (16, 16), (64, 32), (33, 7)]
        .into_iter()
        .flat_map(|size| [(size, false), (size, true)])
        .map(|((w, h), srgb)| {
            let texels = (0..w * h).map(|_| r.bits().to_le_bytes()).collect();
            Arc::new(Texture::new(w, h, texels, srgb).unwrap())
        })
        .collect()
}

fn texture_ref(r: &mut Random, count: usize) -> TextureRef {
    let wrap = |r: &mut Random| [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror][r.below(3)];
    let (angle, scale) = (r.unit() * 6.0, 0.25 + r.unit() * 3.0);
    let (s, c) = catoptra_engine::math::sin_cos(angle);
    let turned = [[c * scale, s * scale, r.unit()], [-s * scale, c * scale, -r.unit()]];
    TextureRef {
        texture: r.below(count) as u32,
        wrap: [wrap(r), wrap(r)],
        nearest: r.chance(0.3),
        nearest_min: r.chance(0.3),
        mip: [Mip::None, Mip::Nearest, Mip::Linear][r.below(3)],
        uv_set: r.below(2) as u32,
        uv_transform: if r.chance(0.5) { turned } else { TextureRef::default().uv_transform },
    }
}

/// * `textured`: each texture is there by this chance
pub fn material(r: &mut Random, textures: usize, textured: f32) -> Material {
    let maybe = |r: &mut Random| r.chance(textured).then(|| texture_ref(r, textures));
    let physical = r.chance(0.6).then(|| Physical {
        metallic: r.unit(),
        roughness: [0.0, 0.005, 0.05, 0.3, r.unit(), 1.0][r.below(6)],
        metallic_roughness_texture: maybe(r),
        reflectance: r.color() * 0.5,
        reflectance_texture: maybe(r),
        reflectance_strength_texture: maybe(r),
        by_reflectance: r.chance(0.3),
        transmission: if r.chance(0.5) { r.unit() } else { 0.0 },
        transmission_texture: maybe(r),
        blended: r.chance(0.4),
    });
    Material {
        base_color: r.color(),
        base_color_texture: maybe(r),
        ambient: r.unit(),
        diffuse: r.unit(),
        specular: r.color(),
        shininess: r.unit() * 200.0,
        emissive: if r.chance(0.5) { r.color() * 4.0 } else { Vec3::ZERO },
        emissive_texture: maybe(r),
        mirror: r.unit(),
        schlick: r.chance(0.5),
        transmission: r.unit(),
        ior: 1.0 + r.unit() * 1.4,
        attenuation_color: r.color().max(Vec3::splat(0.01)),
        attenuation_distance: if r.chance(0.3) { f32::INFINITY } else { 0.1 + r.unit() * 3.0 },
        priority: r.below(5) as i32 - 2,
        thin: r.chance(0.2),
        alpha: r.unit(),
        alpha_cutoff: if r.chance(0.2) { r.unit() } else { 0.0 },
        normal_texture: maybe(r),
        normal_scale: r.unit() * 2.0 - 0.5,
        physical,
        unlit: r.chance(0.2),
    }
}

/// Every kind of mesh under every transform, each with a material of its own.
pub fn surfaces(seed: u32) -> RenderScene {
    let mut r = Random(seed);
    let mut scene = RenderScene { textures: textures(&mut r), ..RenderScene::default() };
    for normals in 0..3 {
        for uvs in 0..3 {
            for tangents in 0..3 {
                let a = Attributes { normals, uvs, colors: r.chance(0.5), tangents };
                scene.meshes.push(Arc::new(open_mesh(&mut r, a)));
            }
        }
    }
    for mesh in 0..scene.meshes.len() as u32 {
        for world_from_object in transforms() {
            let n = scene.instances.len() as u32;
            let textured = [0.0, 0.3, 0.9][n as usize % 3];
            scene.materials.push(material(&mut r, scene.textures.len(), textured));
            scene.instances.push(Instance { stable_id: u64::from(n), mesh, material: n, world_from_object });
        }
    }
    scene
}

/// Four triangles around a volume.
pub fn tetrahedron() -> Mesh {
    let positions = vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
    let triangles = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
    Mesh::new(MeshData { positions, triangles, ..MeshData::default() }).unwrap()
}

/// A triangle that bounds nothing.
pub fn pane() -> Mesh {
    let positions = vec![Vec3::ZERO, Vec3::X, Vec3::Y];
    Mesh::new(MeshData { positions, triangles: vec![[0, 1, 2]], ..MeshData::default() }).unwrap()
}

/// Glass in volumes and panes, a material each: priorities of both signs and alike, thin sheets, mirrors, all that
/// absorption can be.
pub fn glasses(seed: u32, count: u32) -> RenderScene {
    let mut r = Random(seed);
    let mut scene = RenderScene { meshes: vec![Arc::new(tetrahedron()), Arc::new(pane())], ..RenderScene::default() };
    for n in 0..count {
        let mut m = material(&mut r, 1, 0.0);
        m.physical = None;
        m.thin = n % 7 == 5;
        // Two of the same index side by side.
        m.ior = [1.0, 1.33, 1.5, 1.5, 2.4, m.ior][n as usize % 6];
        if n % 5 == 3 {
            m.attenuation_color = Vec3::new(1.0, 0.0, 0.5);
        }
        scene.materials.push(m);
        scene.instances.push(Instance {
            stable_id: u64::from(n),
            mesh: u32::from(n % 4 == 3),
            material: n,
            world_from_object: Affine3::from_translation(Vec3::X * n as f32),
        });
    }
    scene
}
