//! From a hit to everything that shading needs to know of the place.

use catoptra_engine::{
    Camera, Look, PhysicalPlace, Projection, RenderScene, TextureRef, material::metal_of_reflectance, math,
};
use glam::{Mat3, Vec2, Vec3, Vec4};

use super::optics::leave;
use crate::accel::{Hit, Ray};

/// A shaded place, world space. Both normals are unit and on the viewer's side (shading is two-sided).
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// The place, from barycentric coordinates (more exact than origin + t · direction).
    pub position_world: Vec3,
    /// Bound on the error of `position_world`, metres: secondary rays start this far off the surface.
    pub error: f32,
    /// Normal of the triangle.
    pub n_geometric: Vec3,
    /// Interpolated normal.
    pub n_shading: Vec3,
    /// The viewer is on the side from which the triangle winds counter-clockwise.
    pub front: bool,
    /// factor x texture x vertex colour.
    pub base_color: Vec3,
    /// Emitted radiance, `unlit` included.
    pub emission: Vec3,
    /// How the place splits light.
    pub look: Look,
    /// Index into the scene's materials.
    pub material: u32,
    /// Index into the scene's instances.
    pub instance_id: u32,
    /// Triangle of the mesh.
    pub primitive_id: u32,
}

impl Surface {
    /// Where rays to the lights start.
    pub fn ray_start(&self) -> RayStart {
        RayStart { position_world: self.position_world, n_geometric: self.n_geometric, error: self.error }
    }

    /// The ray from here along unit `direction` that does not meet the surface itself again.
    #[inline]
    pub fn leaving_ray(&self, direction: Vec3) -> Ray {
        let (origin, t_min) = leave(self.position_world, self.n_geometric, self.error, direction);
        Ray { origin, direction, t_min, t_max: f32::INFINITY }
    }
}

/// As much of a surface as rays towards the lights need.
#[derive(Clone, Copy, Debug, Default)]
pub struct RayStart {
    /// See [`Surface::position_world`].
    pub position_world: Vec3,
    /// See [`Surface::n_geometric`]; zero: no place at all.
    pub n_geometric: Vec3,
    /// See [`Surface::error`].
    pub error: f32,
}

impl RayStart {
    /// The ray's origin: on the side of `direction`, clear of the surface itself.
    ///
    /// Source: the idea of Wächter & Binder, "A Fast and Robust Method for Avoiding Self-Intersection", Ray Tracing Gems,
    /// 2019; the bound here is that of the interpolated position.
    #[inline]
    pub fn offset_origin(&self, direction: Vec3) -> Vec3 {
        let side = if self.n_geometric.dot(direction) >= 0.0 { 1.0 } else { -1.0 };
        self.position_world + self.n_geometric * (side * self.error)
    }
}

/// Normal matrices of all instances: cofactors of the 3x3 part with the determinant's sign, so that outward stays outward
/// under mirroring. Kept between frames and recomputed where an instance moved.
#[derive(Clone, Debug, Default)]
pub struct NormalMatrices(Vec<Mat3>);

impl NormalMatrices {
    /// Computes all matrices; reuses the allocation.
    pub fn update(&mut self, scene: &RenderScene) {
        self.0.clear();
        self.0.extend(scene.instances.iter().map(|i| normal_from_object(i.world_from_object.matrix3)));
    }
}

impl NormalMatrices {
    /// The matrix of an instance.
    pub(crate) fn of(&self, instance_id: u32) -> Mat3 {
        self.0[instance_id as usize]
    }
}

/// Outward normal of a triangle with corners `p` in object space, of moderate length; zero where it has no area.
pub(crate) fn outward(normal_matrix: &Mat3, p: [Vec3; 3]) -> Vec3 {
    // Edges are scaled before the cross product for the same reason as the matrices.
    let (e1, e2) = (p[1] - p[0], p[2] - p[0]);
    let edge = e1.abs().max(e2.abs()).max_element();
    let scale = if edge > 0.0 { 1.0 / edge } else { 1.0 };
    *normal_matrix * (e1 * scale).cross(e2 * scale)
}

/// Cofactor matrix times the determinant's sign.
fn normal_from_object(m: Mat3) -> Mat3 {
    // Scaled to unit size first: cofactors square the scale and would leave f32's range at the ends of the supported one.
    let size = m.x_axis.abs().max(m.y_axis.abs()).max(m.z_axis.abs()).max_element();
    let m = if size > 0.0 { m * (1.0 / size) } else { m };
    let c = Mat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
    let sign = if m.x_axis.dot(c.x_axis) < 0.0 { -1.0 } else { 1.0 };
    c * sign
}

/// Directions of growing u and of growing v on a triangle with edges `e1`, `e2`, up to a common positive factor; zero where
/// its texture coordinates have no area.
///
/// Twin: `shaders/shared/triangle.wgsl`.
fn tangents(e1: Vec3, e2: Vec3, duv1: Vec2, duv2: Vec2) -> (Vec3, Vec3) {
    let det = duv1.x * duv2.y - duv2.x * duv1.y;
    let sign = if det < 0.0 { -1.0 } else { 1.0 };
    if det == 0.0 {
        return (Vec3::ZERO, Vec3::ZERO);
    }
    ((e1 * duv2.y - e2 * duv1.y) * sign, (e2 * duv1.x - e1 * duv2.x) * sign)
}

/// `n` turned by a tangent-space normal coded as colour `texel`; `n` itself where the frame or the colour has no direction.
/// * `along_u`, `along_v`: world space, any length
///
/// Twin: `shaders/shared/triangle.wgsl`.
fn perturbed_normal(n: Vec3, along_u: Vec3, along_v: Vec3, texel: Vec3, normal_scale: f32) -> Vec3 {
    let size = along_u.abs().max(along_v.abs()).max_element();
    if !(size > 0.0 && size.is_finite()) {
        return n;
    }
    let (along_u, along_v) = (along_u * (1.0 / size), along_v * (1.0 / size));
    let t = along_u - n * n.dot(along_u);
    let length = t.length();
    if length <= 1e-6 {
        return n;
    }
    let t = t * (1.0 / length);
    let across = n.cross(t);
    // The picture's y points against v.
    let b = if across.dot(along_v) > 0.0 { -across } else { across };
    let c = texel * 2.0 - 1.0;
    (t * (c.x * normal_scale) + b * (c.y * normal_scale) + n * c.z).normalize_or(n)
}

/// Surfaces seen at steeper angles are taken for this: a bound on a pixel's footprint.
const LEAST_COSINE: f32 = 1e-3;

fn finite(uv: Vec2) -> Vec2 {
    if uv.is_finite() { uv } else { Vec2::ZERO }
}

/// How wide a pixel is along its ray and the rays that follow it: chooses the texture's level. Curved mirrors, which spread
/// rays, and lenses are taken for flat.
///
/// Source: Akenine-Möller et al., "Texture Level of Detail Strategies for Real-Time Ray Tracing", Ray Tracing Gems, 2019.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PixelCone {
    /// Metres at the camera.
    pub width: f32,
    /// Metres a metre.
    pub spread: f32,
}

impl PixelCone {
    /// The cone of a camera's pixels in a picture of `height` rows. Twin: `shaders/gbuffer.wgsl`, pixel_width.
    pub fn of(camera: &Camera, height: u32) -> Self {
        let (_, half_height) = camera.half_extent(1, 1);
        let pixel = 2.0 * half_height / height as f32;
        match camera.projection {
            Projection::Perspective { .. } => Self { width: 0.0, spread: pixel },
            Projection::Orthographic { .. } => Self { width: pixel, spread: 0.0 },
        }
    }
    /// Metres after a way of `distance` metres.
    #[inline]
    pub fn at(&self, distance: f32) -> f32 {
        self.width + self.spread * distance
    }
}

/// Level of a texture of which one texel has the area of `footprint`; at most 0 where texels are larger.
/// * `per_area`: area in texture coordinates a square metre of surface
/// * `footprint`: square metres of surface that a pixel covers
///
/// Twin: `shaders/shared/texture.wgsl`, texture_lod.
fn texture_lod(r: &TextureRef, width: u32, height: u32, per_area: f32, footprint: f32) -> f32 {
    let [[a, b, _], [c, d, _]] = r.uv_transform;
    let texels = (a * d - b * c).abs() * per_area * footprint * (width as f32 * height as f32);
    if texels > 1.0 && texels < f32::MAX { 0.5 * std::f32::consts::LOG2_E * math::ln(texels) } else { 0.0 }
}

/// The surface that `hit` met, textures at full detail.
pub fn surface_at(scene: &RenderScene, normals: &NormalMatrices, ray: &Ray, hit: &Hit) -> Surface {
    surface_seen(scene, normals, ray, hit, 0.0)
}

/// The surface that `hit` met, seen by a pixel that is `pixel_width` metres wide there.
pub fn surface_seen(scene: &RenderScene, normals: &NormalMatrices, ray: &Ray, hit: &Hit, pixel_width: f32) -> Surface {
    let instance = &scene.instances[hit.instance_id as usize];
    let mesh = &scene.meshes[instance.mesh as usize];
    let material = &scene.materials[instance.material as usize];
    let [i0, i1, i2] = mesh.triangles()[hit.primitive_id as usize].map(|i| i as usize);
    let (u, v) = (hit.u, hit.v);
    let w = 1.0 - u - v;

    let p = mesh.positions();
    let (p0, p1, p2) = (p[i0], p[i1], p[i2]);
    let position_object = p0 * w + p1 * u + p2 * v;
    let m = &instance.world_from_object;
    let position_world = m.transform_point3(position_object);

    // 32 units in the last place of the greatest term of the transform: above the rounding of interpolation, of this
    // transform, and of the next ray's way back into object space.
    let reach = p0.abs().max(p1.abs()).max(p2.abs());
    let terms = m.matrix3.x_axis.abs() * reach.x
        + m.matrix3.y_axis.abs() * reach.y
        + m.matrix3.z_axis.abs() * reach.z
        + m.translation.abs()
        + position_world.abs();
    let error = terms.max_element() * (32.0 * f32::EPSILON * 0.5);

    let normal_matrix = &normals.0[hit.instance_id as usize];
    // Edges are scaled before the cross product for the same reason as the matrices.
    let (e1, e2) = (p1 - p0, p2 - p0);
    let edge = e1.abs().max(e2.abs()).max_element();
    let scale = if edge > 0.0 { 1.0 / edge } else { 1.0 };
    let outward = (*normal_matrix * (e1 * scale).cross(e2 * scale)).normalize_or(-ray.direction.normalize_or(Vec3::Y));
    let front = outward.dot(ray.direction) < 0.0;
    let n_geometric = if front { outward } else { -outward };

    let n = mesh.normals();
    let interpolated = n[i0] * w + n[i1] * u + n[i2] * v;
    let n_shading = (*normal_matrix * interpolated).normalize_or(n_geometric);
    let flipped = n_shading.dot(n_geometric) < 0.0;

    let uv_set = |r: &TextureRef| if r.uv_set == 1 { mesh.uvs1() } else { mesh.uvs() };
    let sample = |r: &TextureRef| {
        let texture = &scene.textures[r.texture as usize];
        let set = uv_set(r);
        if set.is_empty() {
            return texture.sample(r, Vec2::ZERO);
        }
        let uv = set[i0] * w + set[i1] * u + set[i2] * v;
        if pixel_width <= 0.0 || texture.texels().len() == 1 {
            return texture.sample(r, uv);
        }
        let (d1, d2) = (finite(set[i1]) - finite(set[i0]), finite(set[i2]) - finite(set[i0]));
        let area_world = (m.matrix3 * e1).cross(m.matrix3 * e2).length();
        let cos = n_geometric.dot(ray.direction).abs().max(LEAST_COSINE);
        let per_area = d1.perp_dot(d2).abs() / area_world.max(f32::MIN_POSITIVE);
        let lod = texture_lod(r, texture.width(), texture.height(), per_area, pixel_width * pixel_width / cos);
        texture.sample_lod(r, uv, lod)
    };
    let n_shading = match &material.normal_texture {
        Some(r) => {
            // Where there is no tangent, the texture coordinates span the frame; where there are none, either, nothing does.
            let tangent = match mesh.tangents() {
                [] => Vec4::ZERO,
                frames => frames[i0] * w + frames[i1] * u + frames[i2] * v,
            };
            let set = uv_set(r);
            let (along_u, along_v) = if tangent.truncate() != Vec3::ZERO {
                (tangent.truncate(), -interpolated.cross(tangent.truncate()) * tangent.w)
            } else if set.is_empty() {
                (Vec3::ZERO, Vec3::ZERO)
            } else {
                let (duv1, duv2) = (finite(set[i1]) - finite(set[i0]), finite(set[i2]) - finite(set[i0]));
                tangents(e1 * scale, e2 * scale, duv1, duv2)
            };
            let texel = sample(r).truncate();
            let to_world = |d: Vec3| m.matrix3 * d;
            perturbed_normal(n_shading, to_world(along_u), to_world(along_v), texel, material.normal_scale)
        }
        None => n_shading,
    };
    let n_shading = if flipped { -n_shading } else { n_shading };

    let mut base_color = material.base_color;
    let mut coverage = material.alpha;
    if let Some(r) = &material.base_color_texture {
        let texel = sample(r);
        base_color *= texel.truncate();
        coverage *= texel.w;
    }
    let colors = mesh.colors();
    if !colors.is_empty() {
        let color = colors[i0] * w + colors[i1] * u + colors[i2] * v;
        base_color *= color.truncate();
        coverage *= color.w;
    }
    let mut emission = material.emissive;
    if let Some(r) = &material.emissive_texture {
        emission *= sample(r).truncate();
    }
    let look = match &material.physical {
        None => material.look(),
        Some(p) => {
            let coverage = if p.blended { coverage.clamp(0.0, 1.0) } else { 1.0 };
            let mut at =
                PhysicalPlace { metallic: p.metallic, roughness: p.roughness, transmission: p.transmission, coverage };
            if let Some(r) = &p.metallic_roughness_texture {
                let texel = sample(r);
                at.roughness *= texel.y;
                at.metallic *= texel.z;
            }
            if let Some(r) = &p.transmission_texture {
                at.transmission *= sample(r).x;
            }
            let mut reflectance = p.reflectance;
            if let Some(r) = &p.reflectance_texture {
                let texel = sample(r);
                reflectance *= texel.truncate();
                if p.by_reflectance {
                    at.roughness = 1.0 - (1.0 - at.roughness) * texel.w;
                }
            }
            if let Some(r) = &p.reflectance_strength_texture {
                reflectance *= sample(r).w;
            }
            if p.by_reflectance {
                (base_color, at.metallic) = metal_of_reflectance(base_color, reflectance);
            }
            let look = at.look(reflectance, base_color);
            emission *= coverage;
            if material.unlit {
                base_color *= coverage;
            }
            look
        }
    };
    if material.unlit {
        emission += base_color;
    }
    Surface {
        position_world,
        error,
        n_geometric,
        n_shading,
        front,
        base_color,
        emission,
        look,
        material: instance.material,
        instance_id: hit.instance_id,
        primitive_id: hit.primitive_id,
    }
}
