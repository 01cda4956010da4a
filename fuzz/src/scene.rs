//! What holds for any `RenderScene`, however it was put together. Shared by the fuzz target and the test over its corpus.

use catoptra_engine::{
    Camera, Environment, Instance, Light, LightKind, Material, Mesh, MeshData, Mip, Physical, Projection, RenderScene,
    Texture, TextureRef, Wrap,
    glam::{Affine3, Mat3, Vec2, Vec3, Vec4},
};
use catoptra_render_hybrid::{
    GlassShadows, Preset, RasterLane, RenderSettings, Renderer, RendererOptions, Shadows, accel::Ray,
};
use std::sync::Arc;

/// Bytes, taken as numbers; zeros when they have run out.
struct Recipe<'a>(&'a [u8]);

impl Recipe<'_> {
    fn byte(&mut self) -> u8 {
        match self.0.split_first() {
            Some((first, rest)) => {
                self.0 = rest;
                *first
            }
            None => 0,
        }
    }
    fn index(&mut self, n: u32) -> u32 {
        u32::from(self.byte()) % n
    }
    /// Mostly tame numbers, now and then any at all.
    fn number(&mut self) -> f32 {
        match self.byte() {
            0..=15 => f32::from_bits(u32::from_le_bytes([self.byte(), self.byte(), self.byte(), self.byte()])),
            16..=31 => [0.0, -0.0, 1e-30, 1e9, -1e9, f32::MAX, f32::MIN_POSITIVE, 1.0][self.index(8) as usize],
            b => (f32::from(b) - 143.0) / 16.0,
        }
    }
    fn vector(&mut self) -> Vec3 {
        Vec3::new(self.number(), self.number(), self.number())
    }
    fn unit(&mut self) -> f32 {
        f32::from(self.byte()) / 255.0
    }
    fn color(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit())
    }
}

/// A number of one of `n` things, now and then of one that is not there.
fn number_of(r: &mut Recipe, n: usize) -> u32 {
    let beyond = u32::from(r.byte() % 32 == 0);
    r.index((n as u32 + beyond).max(1))
}

fn build(r: &mut Recipe) -> RenderScene {
    let mut scene = RenderScene::default();
    let (width, height) = (1 + r.index(5), 1 + r.index(5));
    let texels = (0..width * height).map(|_| [r.byte(), r.byte(), r.byte(), r.byte()]).collect();
    let srgb = r.byte() % 2 == 0;
    scene.textures.push(Arc::new(Texture::new(width, height, texels, srgb).expect("as many texels as it has")));
    for _ in 0..1 + r.index(3) {
        let n = 3 + r.index(6);
        let positions: Vec<Vec3> = (0..n).map(|_| r.vector()).collect();
        let uvs =
            if r.byte() % 2 == 0 { Vec::new() } else { (0..n).map(|_| Vec2::new(r.number(), r.number())).collect() };
        let normals = if r.byte() % 2 == 0 { Vec::new() } else { (0..n).map(|_| r.vector()).collect() };
        let some = |r: &mut Recipe| (0..n).map(|_| Vec4::new(r.number(), r.number(), r.number(), r.number())).collect();
        let colors = if r.byte() % 2 == 0 { Vec::new() } else { some(r) };
        let tangents = if r.byte() % 2 == 0 { Vec::new() } else { some(r) };
        let triangles = (0..1 + r.index(6)).map(|_| [r.index(n), r.index(n), r.index(n)]).collect();
        if let Ok(mesh) =
            Mesh::new(MeshData { positions, normals, uvs, colors, tangents, triangles, ..Default::default() })
        {
            scene.meshes.push(Arc::new(mesh));
        }
    }
    for _ in 0..1 + r.index(3) {
        let map = |r: &mut Recipe| {
            (r.byte() % 3 == 0).then(|| TextureRef {
                texture: u32::from(r.byte() % 16 == 0),
                wrap: [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror]
                    .map(|w| if r.byte() % 2 == 0 { w } else { Wrap::Repeat })[..2]
                    .try_into()
                    .expect("two of three"),
                nearest: r.byte() % 2 == 0,
                nearest_min: r.byte() % 2 == 0,
                mip: [Mip::None, Mip::Nearest, Mip::Linear][r.index(3) as usize],
                uv_set: r.index(2),
                uv_transform: [[r.number(), r.number(), r.number()], [r.number(), r.number(), r.number()]],
            })
        };
        let physical = (r.byte() % 2 == 0).then(|| Physical {
            metallic: r.unit(),
            roughness: r.unit(),
            metallic_roughness_texture: map(r),
            reflectance: r.color(),
            reflectance_texture: map(r),
            reflectance_strength_texture: map(r),
            by_reflectance: r.byte() % 4 == 0,
            transmission: r.unit(),
            transmission_texture: map(r),
            blended: r.byte() % 2 == 0,
        });
        scene.materials.push(Material {
            base_color: r.color(),
            base_color_texture: map(r),
            specular: r.color(),
            shininess: r.number().abs(),
            emissive: if r.byte() % 4 == 0 { r.color() } else { Vec3::ZERO },
            mirror: if r.byte() % 2 == 0 { r.unit() } else { 0.0 },
            transmission: if r.byte() % 2 == 0 { r.unit() } else { 0.0 },
            ior: 1.0 + r.unit(),
            attenuation_distance: r.number().abs(),
            thin: r.byte() % 4 == 0,
            alpha_cutoff: if r.byte() % 3 == 0 { r.unit() } else { 0.0 },
            normal_texture: map(r),
            normal_scale: r.number(),
            unlit: r.byte() % 8 == 0,
            schlick: r.byte() % 2 == 0,
            physical,
            alpha: r.unit(),
            ..Material::default()
        });
    }
    for id in 0..r.index(8) {
        scene.instances.push(Instance {
            stable_id: u64::from(id),
            mesh: number_of(r, scene.meshes.len()),
            material: number_of(r, scene.materials.len()),
            world_from_object: Affine3 {
                matrix3: Mat3::from_cols(r.vector(), r.vector(), r.vector()),
                translation: r.vector(),
            },
        });
    }
    for id in 0..r.index(4) {
        let kind = match r.index(3) {
            0 => LightKind::Point,
            1 => LightKind::Directional,
            _ => LightKind::Spot { cos_inner: r.unit(), cos_outer: r.unit() },
        };
        let direction_world = r.vector().normalize_or(Vec3::NEG_Y);
        let light = Light::point(u64::from(id), r.vector());
        let up_world = direction_world.any_orthonormal_vector();
        scene.lights.push(Light {
            kind,
            direction_world,
            up_world,
            intensity: r.color() * 10.0,
            radius: r.unit(),
            ..light
        });
    }
    scene.camera = Camera::looking_at(r.vector(), r.vector(), 0.1 + r.unit());
    if r.byte() % 4 == 0 {
        scene.camera.projection = Projection::Orthographic { half_height: r.number() };
    }
    scene.environment = Environment { background: r.color(), ambient: r.color() };
    scene
}

/// True where the scene was drawn, false where it was refused.
///
/// # Panics
/// Where something that must hold does not.
pub fn check(data: &[u8]) -> bool {
    let mut r = Recipe(data);
    let mut scene = build(&mut r);
    if scene.meshes.is_empty() {
        scene.instances.clear();
    }
    let draft = RenderSettings::preset(Preset::Draft);
    let mut settings = RenderSettings {
        width: 1 + r.index(24),
        height: 1 + r.index(24),
        shadows: [Shadows::Moments, Shadows::Traced, Shadows::Off][r.index(3) as usize],
        glass_shadows: [GlassShadows::Opaque, GlassShadows::Clear][r.index(2) as usize],
        ..draft
    };
    settings.moments.size = 16;
    settings.moments.face_size = 16;
    let options = RendererOptions { raster: RasterLane::Cpu, threads: 1, ..Default::default() };
    let renderer = || Renderer::new(options).expect("the CPU lane is always there");
    let mut first = renderer();
    let drawn = first.render(&scene, &settings);
    assert_eq!(drawn.is_ok(), scene.validate().is_ok(), "a valid scene is drawn, another refused");
    let Ok(drawn) = drawn else { return false };
    assert!(drawn.image.pixels.iter().flatten().all(|v| v.is_finite()), "a pixel is not finite");
    first.accel().validate().unwrap_or_else(|e| panic!("the trees are broken: {e}"));
    // A moved and moved-back world is the same world.
    if let Some(i) = scene.instances.first().copied() {
        scene.begin_revision();
        scene.set_transform(0, Affine3::IDENTITY);
        let _ = first.render(&scene, &settings);
        scene.begin_revision();
        scene.set_transform(0, i.world_from_object);
    }
    let again = first.render(&scene, &settings).expect("it was drawn before");
    assert_eq!(again.image.hash(), drawn.image.hash(), "history shows");
    assert_eq!(renderer().render(&scene, &settings).expect("as before").image.hash(), drawn.image.hash());
    let query = first.query(&scene).expect("it is valid");
    let ray = Ray::new(r.vector(), r.vector());
    let all = query.raycast_all(&ray, 64);
    assert_eq!(all.first().copied(), query.raycast(&ray));
    assert!(all.is_sorted_by(|a, b| a.t < b.t));
    assert_eq!(query.occluded(&ray), !all.is_empty());
    true
}
