//! How interfaces split light: mirror share, Fresnel-weighted glass share, and the rays that carry them on. One place at a time
//! for the reference and the explanation of a pixel, sixteen at a time for the tracer, by the same functions.

use catoptra_engine::{Look, Material, RenderScene};
use glam::Vec3;

use super::{
    media::{self, MediumStack},
    meet::SurfaceLanes,
    points::{LANES, Lane},
    surface::Surface,
};
use crate::{
    accel::Ray,
    simd::dispatch,
    twin::shading::{fresnel_dielectric, reflect, refract_or_total, schlick},
};

/// Least cosine between a ray that leaves a surface and the triangle's normal.
const LEAST_COSINE: f32 = 1e-3;
/// Below this cosine a leaving ray starts off the surface.
const GRAZING_COSINE: f32 = 0.125;

/// What lies behind a glass surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pane {
    /// A medium that bends light, or air again.
    Volume,
    /// Both faces of a thin pane at once, with the light that bounces between them, 2F/(1+F); no bend.
    Open,
    /// Nothing but less of what is behind (alpha blending).
    Film,
}

/// How a place splits light, before the angle counts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Optics {
    /// Mirror share, [0, 1].
    pub mirror: f32,
    /// Glass share, [0, 1].
    pub glass: f32,
    /// n_from / n_to.
    pub eta: f32,
    /// The mirror's tint rises at grazing angles.
    pub schlick: bool,
    pub pane: Pane,
}

impl Optics {
    /// Those of a place, with the index of refraction towards air.
    pub fn of(scene: &RenderScene, s: &Surface) -> Self {
        Self::new(scene, &scene.materials[s.material as usize], &s.look, s.instance_id)
    }

    /// Those of places of an instance with such a look.
    pub fn new(scene: &RenderScene, m: &Material, look: &Look, instance_id: u32) -> Self {
        let glass = ((1.0 - look.mirror) * look.transmission).max(0.0);
        let pane = if m.thin || glass == 0.0 {
            Pane::Film
        } else if scene.meshes[scene.instances[instance_id as usize].mesh as usize].closed() {
            Pane::Volume
        } else {
            Pane::Open
        };
        Self { mirror: look.mirror, glass, eta: 1.0 / m.ior, schlick: m.schlick, pane }
    }
}

/// Weight of the reflected ray at cosine `cos_i`, the glass left out.
#[inline(always)]
fn mirror_share(base_color: Vec3, mirror: f32, raised: bool, cos_i: f32) -> Vec3 {
    let at_angle = schlick(base_color, cos_i);
    if raised { at_angle * mirror } else { base_color * mirror }
}

/// Weights that the glass adds to the reflected ray, and of the transmitted ray.
#[inline(always)]
fn glass_shares(base_color: Vec3, glass: f32, eta: f32, open: bool, film: bool, cos_i: f32) -> (Vec3, Vec3) {
    let f = fresnel_dielectric(cos_i, eta);
    let both = 2.0 * f / (1.0 + f);
    let f = if open { both } else { f };
    let f = if film { 0.0 } else { f };
    let through = if film { Vec3::ONE } else { base_color };
    (Vec3::splat(glass * f), through * (glass * (1.0 - f)))
}

/// Mirror direction of the direction of travel `d`, above the triangle's horizon.
#[inline(always)]
pub(crate) fn mirrored(d: Vec3, n_shading: Vec3, n_geometric: Vec3) -> Vec3 {
    above_horizon(reflect(-d, n_shading), n_geometric)
}

/// Direction behind the surface; false at total internal reflection.
#[inline(always)]
fn bent(d: Vec3, n_shading: Vec3, n_geometric: Vec3, eta: f32) -> (Vec3, bool) {
    let (t, passes) = refract_or_total(d, n_shading, eta);
    (-above_horizon(-t, n_geometric), passes)
}

/// Keeps a direction that interpolated normals sent below the true surface just above it.
#[inline(always)]
pub(crate) fn above_horizon(r: Vec3, n_geometric: Vec3) -> Vec3 {
    let cos = r.dot(n_geometric);
    let lifted = r + n_geometric * (LEAST_COSINE - cos);
    let length = lifted.dot(lifted).sqrt();
    let usable = length > 0.0;
    let inverse = 1.0 / if usable { length } else { 1.0 };
    let lifted = if usable { lifted * inverse } else { n_geometric };
    if cos >= LEAST_COSINE { r } else { lifted }
}

/// Start and t_min of the ray that leaves a surface along unit `direction` and does not meet it again.
///
/// It starts at the place itself and skips the stretch within the place's `error`, so that its line and the lengths along it
/// stay exact: on a pane of 100 m that error is 0.1 mm, which a shifted start would carry through every refraction. Only at
/// grazing angles, where the stretch would be long, is the start lifted off the surface instead.
#[inline(always)]
pub(crate) fn leave(position: Vec3, n_geometric: Vec3, error: f32, direction: Vec3) -> (Vec3, f32) {
    let cos = n_geometric.dot(direction);
    let steep = cos.abs() >= GRAZING_COSINE;
    let skipped = error / if steep { cos.abs() } else { 1.0 };
    let lifted = position + n_geometric * if cos >= 0.0 { error } else { -error };
    (if steep { position } else { lifted }, if steep { skipped } else { 0.0 })
}

/// How an interface splits light.
#[derive(Clone, Copy, Debug)]
pub struct Interface {
    /// Weight of the mirrored ray.
    pub reflected: Vec3,
    /// Weight of the transmitted ray.
    pub transmitted: Vec3,
    /// Its direction; `None` at total internal reflection or without glass.
    pub transmitted_direction: Option<Vec3>,
    /// Media behind the surface.
    pub behind: MediumStack,
    /// A surface inside a volume of higher priority: nothing happens there.
    pub hidden: bool,
}

/// Splits light that travels along unit `d` inside `inside` at a surface: mirror share, Fresnel-weighted glass share.
pub fn split(scene: &RenderScene, m: &Material, s: &Surface, d: Vec3, inside: MediumStack) -> Interface {
    let mut o = Optics::new(scene, m, &s.look, s.instance_id);
    let (mut behind, mut hidden) = (inside, false);
    if o.pane == Pane::Volume {
        let c = media::crossing(scene, inside, s.instance_id, s.front);
        behind = c.behind;
        hidden = c.from == c.to;
        o.eta = media::ior_of(scene, c.from) / media::ior_of(scene, c.to);
    }
    let cos_i = s.n_shading.dot(-d).clamp(0.0, 1.0);
    let mirror = mirror_share(s.base_color, o.mirror, o.schlick, cos_i);
    let (open, film) = (o.pane == Pane::Open, o.pane == Pane::Film);
    let (by_glass, transmitted) = glass_shares(s.base_color, o.glass, o.eta, open, film, cos_i);
    let (t, passes) = if open | film { (d, true) } else { bent(d, s.n_shading, s.n_geometric, o.eta) };
    let passes = passes && o.glass > 0.0 && !hidden;
    Interface {
        reflected: if hidden { mirror } else { mirror + by_glass },
        transmitted: if passes { transmitted } else { Vec3::ZERO },
        transmitted_direction: passes.then_some(t),
        behind,
        hidden,
    }
}

/// What rays bring to sixteen interfaces.
#[derive(Clone, Debug, Default)]
pub(crate) struct OpticsLanes {
    /// Unit directions of travel.
    pub direction: [Lane; 3],
    /// Weights of the arriving rays.
    pub weight: [Lane; 3],
    mirror: Lane,
    glass: Lane,
    eta: Lane,
    schlick: [u32; LANES],
    open: [u32; LANES],
    film: [u32; LANES],
    any_glass: bool,
}

impl OpticsLanes {
    /// None of the places splits light.
    pub fn clear(&mut self) {
        self.mirror = [0.0; LANES];
        self.glass = [0.0; LANES];
        self.any_glass = false;
    }

    pub fn put(&mut self, lane: usize, o: &Optics) {
        self.mirror[lane] = o.mirror;
        self.glass[lane] = o.glass;
        self.eta[lane] = o.eta;
        self.schlick[lane] = u32::from(o.schlick);
        self.open[lane] = u32::from(o.pane == Pane::Open);
        self.film[lane] = u32::from(o.pane == Pane::Film);
        self.any_glass |= o.glass > 0.0;
    }
}

/// Sixteen rays that leave interfaces.
#[derive(Clone, Debug, Default)]
pub(crate) struct LeavingLanes {
    pub origin: [Lane; 3],
    pub direction: [Lane; 3],
    pub t_min: Lane,
    /// Zero: there is none.
    pub weight: [Lane; 3],
    /// Greatest channel of the weight.
    pub most: Lane,
}

impl LeavingLanes {
    /// A lane's ray and weight.
    #[inline]
    pub fn ray(&self, lane: usize) -> (Ray, Vec3) {
        let (origin, direction) = (at(&self.origin, lane), at(&self.direction, lane));
        (Ray { origin, direction, t_min: self.t_min[lane], t_max: f32::INFINITY }, at(&self.weight, lane))
    }

    #[inline(always)]
    fn set(&mut self, lane: usize, (origin, t_min): (Vec3, f32), direction: Vec3, weight: Vec3) {
        for axis in 0..3 {
            self.origin[axis][lane] = origin[axis];
            self.direction[axis][lane] = direction[axis];
            self.weight[axis][lane] = weight[axis];
        }
        self.t_min[lane] = t_min;
        let xy = if weight.x > weight.y { weight.x } else { weight.y };
        self.most[lane] = if xy > weight.z { xy } else { weight.z };
    }
}

#[inline(always)]
fn at(lanes: &[Lane; 3], lane: usize) -> Vec3 {
    Vec3::new(lanes[0][lane], lanes[1][lane], lanes[2][lane])
}

#[inline(always)]
fn part_body(rays: &OpticsLanes, s: &SurfaceLanes, reflected: &mut LeavingLanes, transmitted: &mut LeavingLanes) {
    let mut through = [[0.0f32; LANES]; 3];
    for lane in 0..LANES {
        let (d, n, base) = (at(&rays.direction, lane), at(&s.n_shading, lane), at(&s.base_color, lane));
        let cos_i = -n.dot(d);
        let cos_i = if cos_i > 0.0 { cos_i } else { 0.0 };
        let cos_i = if cos_i < 1.0 { cos_i } else { 1.0 };
        let (mut mirror, mut glass) =
            (mirror_share(base, rays.mirror[lane], rays.schlick[lane] != 0, cos_i), Vec3::ZERO);
        if rays.any_glass {
            let (r, t) =
                glass_shares(base, rays.glass[lane], rays.eta[lane], rays.open[lane] != 0, rays.film[lane] != 0, cos_i);
            mirror += r;
            glass = t;
        }
        let weight = at(&rays.weight, lane);
        let (position, n_geometric) = (at(&s.position, lane), at(&s.n_geometric, lane));
        let direction = mirrored(d, n, n_geometric);
        reflected.set(lane, leave(position, n_geometric, s.error[lane], direction), direction, weight * mirror);
        let glass = weight * glass;
        for axis in 0..3 {
            through[axis][lane] = glass[axis];
        }
    }
    if !rays.any_glass {
        transmitted.most = [0.0; LANES];
        return;
    }
    for lane in 0..LANES {
        let (d, n) = (at(&rays.direction, lane), at(&s.n_shading, lane));
        let (position, n_geometric) = (at(&s.position, lane), at(&s.n_geometric, lane));
        let (t, passes) = bent(d, n, n_geometric, rays.eta[lane]);
        let straight = (rays.open[lane] | rays.film[lane]) != 0;
        let direction = if straight { d } else { t };
        let weight = at(&through, lane);
        let weight = if straight | passes { weight } else { Vec3::ZERO };
        transmitted.set(lane, leave(position, n_geometric, s.error[lane], direction), direction, weight);
    }
}

dispatch! {
    /// The reflected and the transmitted rays of sixteen interfaces, as [`split`] has them one by one.
    pub(crate) fn part => part_body(
        rays: &OpticsLanes,
        s: &SurfaceLanes,
        reflected: &mut LeavingLanes,
        transmitted: &mut LeavingLanes,
    )
}
