//! Sixteen rays and the surfaces that they meet: places, normals, colours and what the glass on the way leaves, in lanes.

use catoptra_engine::math;
use glam::Vec3;

use super::{
    facet::{Facet, FacetLanes, FacetSource, Facets},
    media::Media,
    optics::{Optics, OpticsLanes, Pane, leave},
    points::{Glossy, LANES, Lane},
    shade::FrameContext,
    surface::{Surface, surface_seen},
};
use crate::{
    accel::{Hit, Ray},
    simd::dispatch,
    twin::gbuffer::point_of,
};

/// Sixteen places, as [`Surface`] has one.
#[derive(Clone, Debug, Default)]
pub(crate) struct SurfaceLanes {
    pub position: [Lane; 3],
    pub error: Lane,
    /// Towards the viewer, both.
    pub n_geometric: [Lane; 3],
    pub n_shading: [Lane; 3],
    /// 1: the viewer is on the outward side.
    pub front: [u32; LANES],
    pub base_color: [Lane; 3],
    /// As in [`super::points::PointSurface`].
    pub own: [Lane; 3],
    pub matte: Lane,
    /// Not 0: lights or the place itself make something of it.
    pub shows: [u32; LANES],
}

impl SurfaceLanes {
    /// Place of a lane, world space.
    pub fn position(&self, lane: usize) -> Vec3 {
        Vec3::from_array([0, 1, 2].map(|axis| self.position[axis][lane]))
    }

    fn n_geometric(&self, lane: usize) -> Vec3 {
        Vec3::from_array([0, 1, 2].map(|axis| self.n_geometric[axis][lane]))
    }

    fn put(&mut self, ctx: &FrameContext, lane: usize, s: &Surface) {
        let p = point_of(ctx, s);
        for axis in 0..3 {
            self.position[axis][lane] = s.position_world[axis];
            self.n_geometric[axis][lane] = s.n_geometric[axis];
            self.n_shading[axis][lane] = s.n_shading[axis];
            self.base_color[axis][lane] = s.base_color[axis];
            self.own[axis][lane] = p.own[axis];
        }
        self.error[lane] = s.error;
        self.front[lane] = u32::from(s.front);
        self.matte[lane] = p.matte;
        self.shows[lane] = u32::from(p.matte * p.base_color != Vec3::ZERO || p.own != Vec3::ZERO);
    }
}

/// Sixteen rays that arrive somewhere.
#[derive(Clone, Debug, Default)]
struct Arriving {
    u: Lane,
    v: Lane,
    t: Lane,
    /// Logarithm of what a metre of the way left.
    absorption: [Lane; 3],
}

/// What sixteen rays met.
#[derive(Clone, Debug, Default)]
pub(crate) struct Meeting {
    arriving: Arriving,
    any_absorption: bool,
    /// Number of the stack of media that each ray is in; after [`Self::meet`], that behind its surface.
    pub stack: [u32; LANES],
    facets: FacetLanes,
    /// The surfaces; anything where a ray met none.
    pub surface: SurfaceLanes,
    /// Directions and weights of the rays, and their interfaces.
    pub optics: OpticsLanes,
    /// Bit per lane: the place reflects or refracts.
    pub traced: u16,
    /// Bit per lane: the ray goes on as if nothing were there.
    pub hidden: u16,
}

impl Meeting {
    /// Sets a ray that is in the medium of `stack`.
    /// * `direction`: unit
    /// * `weight`: at its start
    #[inline]
    pub fn put(&mut self, lane: usize, direction: Vec3, weight: Vec3, hit: &Hit, stack: u32, media: &Media) {
        let absorption = media.absorption(stack);
        for axis in 0..3 {
            self.optics.direction[axis][lane] = direction[axis];
            self.optics.weight[axis][lane] = weight[axis];
            self.arriving.absorption[axis][lane] = absorption[axis];
        }
        (self.arriving.u[lane], self.arriving.v[lane], self.arriving.t[lane]) = (hit.u, hit.v, hit.t);
        self.stack[lane] = stack;
        self.any_absorption |= stack != Media::AIR;
    }

    /// Weight of a ray where it met the surface.
    #[inline]
    pub fn weight(&self, lane: usize) -> Vec3 {
        Vec3::from_array([0, 1, 2].map(|axis| self.optics.weight[axis][lane]))
    }

    #[inline]
    fn direction(&self, lane: usize) -> Vec3 {
        Vec3::from_array([0, 1, 2].map(|axis| self.optics.direction[axis][lane]))
    }

    /// The ray that goes on from a lane's surface as if it were not there.
    pub fn straight_on(&self, lane: usize) -> Ray {
        let (s, direction) = (&self.surface, self.direction(lane));
        let (origin, t_min) = leave(s.position(lane), s.n_geometric(lane), s.error[lane], direction);
        Ray { origin, direction, t_min, t_max: f32::INFINITY }
    }

    /// Finds the surfaces and takes from the weights what the media on the way take.
    /// * `hits`: what the rays met, at most sixteen
    /// * `pixel_width`: of a lane's pixel at its hit, metres; asked where places have textures
    /// * `highlight`: told the lanes whose places have one
    pub fn meet(
        &mut self,
        ctx: &FrameContext,
        facets: &mut Facets,
        media: &mut Media,
        hits: &[Hit],
        pixel_width: impl Fn(usize) -> f32,
        mut highlight: impl FnMut(usize, Glossy),
    ) {
        if std::mem::take(&mut self.any_absorption) {
            absorb(ctx.level, &self.arriving, &mut self.optics.weight);
        }
        (self.traced, self.hidden) = (0, 0);
        self.optics.clear();
        let first = &hits[0];
        let same = |h: &Hit| h.instance_id == first.instance_id && h.primitive_id == first.primitive_id;
        let uniform = first.is_hit() && hits.iter().all(same);
        let (arriving, directions, surface) = (&self.arriving, &self.optics.direction, &mut self.surface);
        if uniform {
            let facet = facets.of(ctx, first.instance_id, first.primitive_id);
            meet_one(ctx.level, facet, arriving, directions, surface);
            if facet.is_plain() {
                return;
            }
        } else {
            let mut plain = true;
            for (lane, hit) in hits.iter().enumerate().filter(|(_, h)| h.is_hit()) {
                let facet = facets.of(ctx, hit.instance_id, hit.primitive_id);
                self.facets.put(lane, facet);
                plain &= facet.is_plain();
            }
            meet_each(ctx.level, &self.facets, arriving, directions, surface);
            if plain {
                return;
            }
        }
        for (lane, hit) in hits.iter().enumerate().filter(|(_, h)| h.is_hit()) {
            let facet = facets.of(ctx, hit.instance_id, hit.primitive_id);
            if facet.is_plain() {
                continue;
            }
            let (mut look, mut optics) = (facet.look, facet.optics);
            if facet.is_odd() {
                let ray = Ray::new(Vec3::ZERO, self.direction(lane));
                let s = surface_seen(ctx.scene, ctx.normals, &ray, hit, pixel_width(lane));
                self.surface.put(ctx, lane, &s);
                look = s.look;
                optics = Optics::of(ctx.scene, &s);
            }
            if look.specular != Vec3::ZERO && !facet.unlit {
                let (specular, shininess, wo) = (look.specular, look.shininess, -self.direction(lane));
                highlight(lane, Glossy { point: 0, specular, shininess, wo });
            }
            if look.is_traced() {
                self.traced |= 1 << lane;
                if optics.glass > 0.0 && optics.pane == Pane::Volume {
                    let front = self.surface.front[lane] != 0;
                    let crossed = media.cross(ctx.scene, self.stack[lane], hit.instance_id, front);
                    self.stack[lane] = crossed.behind;
                    self.hidden |= u16::from(crossed.hidden) << lane;
                    optics.eta = crossed.eta;
                }
                self.optics.put(lane, &optics);
            }
        }
    }
}

#[inline(always)]
fn absorb_body(arriving: &Arriving, weight: &mut [Lane; 3]) {
    for axis in 0..3 {
        for lane in 0..LANES {
            let x = arriving.absorption[axis][lane] * arriving.t[lane];
            let x = if x > -80.0 { x } else { -80.0 };
            let left = math::exp_moderate(x);
            weight[axis][lane] *= if arriving.absorption[axis][lane] < 0.0 { left } else { 1.0 };
        }
    }
}

dispatch! {
    /// Beer-Lambert on the way to the surface; what is less than e^-80 is nothing to see.
    fn absorb => absorb_body(arriving: &Arriving, weight: &mut [Lane; 3])
}

#[inline(always)]
fn meet_body(f: &impl FacetSource, arriving: &Arriving, directions: &[Lane; 3], out: &mut SurfaceLanes) {
    for lane in 0..LANES {
        let (u, v) = (arriving.u[lane], arriving.v[lane]);
        let w = (1.0 - u) - v;
        let mut n = [0.0f32; 3];
        let (mut facing, mut shading) = (0.0f32, 0.0f32);
        let mut shows = 0;
        for axis in 0..3 {
            let mix = |p: [f32; 3]| (p[0] * w + p[1] * u) + p[2] * v;
            out.position[axis][lane] = mix([0, 1, 2].map(|k| f.corner(k, axis, lane)));
            n[axis] = mix([0, 1, 2].map(|k| f.normal(k, axis, lane)));
            let base = mix([0, 1, 2].map(|k| f.color(k, axis, lane)));
            let own = f.emission(axis, lane) + base * f.ambient(axis, lane);
            out.base_color[axis][lane] = base;
            out.own[axis][lane] = own;
            shows |= (own.abs() + (base * f.matte(lane)).abs()).to_bits();
            facing += f.outward(axis, lane) * directions[axis][lane];
            shading += f.outward(axis, lane) * n[axis];
        }
        let front = facing < 0.0;
        let length2 = (n[0] * n[0] + n[1] * n[1]) + n[2] * n[2];
        let usable = (length2 > 0.0) & (length2 < f32::INFINITY);
        let inverse = 1.0 / (if usable { length2 } else { 1.0 }).sqrt();
        let inverse = if front != (shading >= 0.0) { -inverse } else { inverse };
        for axis in 0..3 {
            let o = f.outward(axis, lane);
            let o = if front { o } else { -o };
            out.n_geometric[axis][lane] = o;
            out.n_shading[axis][lane] = if usable { n[axis] * inverse } else { o };
        }
        out.front[lane] = u32::from(front);
        out.error[lane] = f.error(lane);
        out.matte[lane] = f.matte(lane);
        out.shows[lane] = shows;
    }
}

#[inline(always)]
fn meet_one_body(f: &Facet, arriving: &Arriving, directions: &[Lane; 3], out: &mut SurfaceLanes) {
    meet_body(f, arriving, directions, out);
}

#[inline(always)]
fn meet_each_body(f: &FacetLanes, arriving: &Arriving, directions: &[Lane; 3], out: &mut SurfaceLanes) {
    meet_body(f, arriving, directions, out);
}

dispatch! {
    fn meet_one => meet_one_body(f: &Facet, arriving: &Arriving, directions: &[Lane; 3], out: &mut SurfaceLanes)
}
dispatch! {
    fn meet_each => meet_each_body(f: &FacetLanes, arriving: &Arriving, directions: &[Lane; 3], out: &mut SurfaceLanes)
}
