//! Light paths that are kept from frame to frame, so that their VPLs and the VPLs' shadow maps need not be made anew.
//!
//! A source's emission domain (unit sphere, cone or disc, in the source's own frame) has one *site* a light path: the starts of
//! `photons.rs`, each with the same part of the domain. Every frame a ray from each site tells what light leaves the surface
//! that it meets. The paths themselves stay: path i holds a place on a body, wherever that body goes, until its source no
//! longer sees it. Each site's light is divided among the paths nearest to it in the domain, so that a frame's VPLs give
//! what fresh ones would, and where a path stands on its own site it carries just that site's light. Where sites have no
//! path near, new ones are begun, at most so many a frame: first in place of those that were lost, then in place of the most
//! crowded. What lies behind the first reflection is traced from the kept place every frame with the path's own numbers: a ray
//! as dear as the one that would tell whether the old chain still holds, and right where bodies have moved.
//!
//! Sources whose VPLs lie on them (emissive surfaces) have nothing to keep: their paths are traced as ever. Their starts go
//! with the body anyway.
//!
//! Sources: Laine, Saransaari, Kontkanen, Lehtinen & Aila, "Incremental Instant Radiosity for Real-Time Indirect Illumination",
//! EGSR 2007 (validity, a bounded number of new VPLs, the emission domain); the division of light is Shepard's, with the
//! weights of Franke & Nielson, "Smooth Interpolation of Large Sets of Scattered Data", IJNME 1980, in place of Voronoi
//! cells, so that nothing jumps where a cell would change hands.

use catoptra_engine::{LightKind, RenderScene};
use glam::Vec3;
use rayon::prelude::*;
use std::{
    f32::consts::{PI, TAU},
    ops::Range,
};

use super::{
    emission::SourceFrame,
    photons::{Path, PathTracer, vpl_at},
    surface::{Surface, surface_at},
    surfels::Landing,
};
use crate::{
    accel::{Hit, Ray},
    settings::VplOptions,
    still::KeptBy,
    twin::vpl::Vpl,
};

/// Paths that a site's light is divided among. Higher: smoother changes, light from further away.
const NEAREST: usize = 6;
/// Squared distances are in units of a path's part of the domain. A path nearer than this to a site has all its light.
const HOME: f32 = 1e-6;
/// A site further than this from all paths gets one of its own where one is to be had.
const LONELY: f32 = 0.25;
/// A site further than this gets one that is taken from elsewhere.
const BARE: f32 = 1.0;
/// There, the nearest other path is nearer than this part of the site's own squared distance.
const CROWDED: f32 = 0.25;

/// Memory of kept paths.
#[derive(Clone, Debug, Default)]
pub(crate) struct Reuse {
    by: KeptBy,
    /// Paths of each source, as they were when all began.
    shares: Vec<u32>,
    afresh: bool,
    sources: Vec<Source>,
    /// One a path, in the order of paths, as the seats and what follows.
    sites: Vec<Site>,
    seats: Vec<Seat>,
    gaps: Vec<Gap>,
    crowds: Vec<Gap>,
    divided: Vec<Division>,
    unsettled: bool,
}

/// A light and its part of the lists.
#[derive(Clone, Debug)]
struct Source {
    paths: Range<usize>,
    frame: SourceFrame,
    kind: LightKind,
    /// A path's part of the domain: squared length on the unit sphere or disc.
    part: f32,
    /// Seats without a place.
    free: usize,
    /// Something here may still be taken from elsewhere; and whether crowds are known.
    open: bool,
    crowds_known: bool,
}

/// A place on a body that a source lights.
#[derive(Clone, Copy, Debug)]
struct Place {
    hit: Hit,
    /// In the source's domain.
    at: Vec3,
    surface: Surface,
}

/// Where a path would begin if all were made anew.
#[derive(Clone, Copy, Debug, Default)]
struct Site {
    /// `None` where nothing is met that reflects light.
    place: Option<Place>,
    /// Light that leaves there.
    flux: Vec3,
}

/// A path.
#[derive(Clone, Copy, Debug, Default)]
struct Seat {
    place: Option<Place>,
    flux: Vec3,
    /// From the frame before.
    kept: bool,
}

/// Squared distance to the nearest seat, and which that is.
#[derive(Clone, Copy, Debug)]
struct Gap {
    squared: f32,
    seat: usize,
}

impl Gap {
    const NONE: Self = Self { squared: 0.0, seat: usize::MAX };
    const FAR: Self = Self { squared: f32::INFINITY, seat: usize::MAX };
}

/// The seats among which a site's light is divided, and their shares.
#[derive(Clone, Copy, Debug, Default)]
struct Division {
    shares: [(usize, f32); NEAREST],
    count: usize,
}

impl Source {
    /// Where light leaves the source that reaches `position_world`.
    fn domain(&self, position_world: Vec3) -> Vec3 {
        let SourceFrame { origin, scale, axes: [x, y, z], .. } = self.frame;
        let v = position_world - origin;
        let own = Vec3::new(x.dot(v), y.dot(v), z.dot(v));
        match self.kind {
            LightKind::Directional => Vec3::new(own.x, own.y, 0.0) / scale,
            LightKind::Point | LightKind::Spot { .. } => own.normalize_or(Vec3::Z),
        }
    }

    /// Whether it sends any light there.
    fn emits(&self, at: Vec3) -> bool {
        match self.kind {
            LightKind::Point => true,
            LightKind::Spot { cos_outer, .. } => at.z > cos_outer,
            LightKind::Directional => at.length_squared() <= 1.0,
        }
    }

    /// Direction of its light at a position, of any length.
    fn direction(&self, position_world: Vec3) -> Vec3 {
        match self.kind {
            LightKind::Directional => self.frame.axes[2],
            LightKind::Point | LightKind::Spot { .. } => position_world - self.frame.origin,
        }
    }

    /// The ray from a lit surface to the source.
    fn back(&self, s: &Surface) -> Ray {
        let origin = s.ray_start().offset_origin(-self.direction(s.position_world));
        let t_max = if self.kind == LightKind::Directional { f32::INFINITY } else { 1.0 };
        Ray { origin, direction: -self.direction(origin), t_min: 0.0, t_max }
    }

    /// Squared distance in units of a path's part. What lies on other bodies or faces elsewhere is further.
    #[inline]
    fn squared(&self, a: &Place, b: &Place) -> f32 {
        let unlike = 1.0 - a.surface.n_shading.dot(b.surface.n_shading);
        let other = if a.surface.instance_id == b.surface.instance_id { 0.0 } else { 1.0 };
        (a.at - b.at).length_squared() / self.part + unlike.max(0.0) + other
    }

    /// The seat nearest to a place; `but` does not count.
    fn nearest(&self, place: &Place, seats: &[Seat], but: usize) -> Gap {
        let mut gap = Gap::FAR;
        for i in self.paths.clone().filter(|&i| i != but) {
            if let Some(other) = &seats[i].place {
                let squared = self.squared(place, other);
                if squared < gap.squared {
                    gap = Gap { squared, seat: i };
                }
            }
        }
        gap
    }

    /// Divides a site's light.
    fn divide(&self, site: &Place, seats: &[Seat]) -> Division {
        let mut near = [Gap::FAR; NEAREST + 1];
        for i in self.paths.clone() {
            let Some(place) = &seats[i].place else { continue };
            let mut next = Gap { squared: self.squared(site, place), seat: i };
            for held in &mut near {
                if next.squared < held.squared {
                    std::mem::swap(held, &mut next);
                }
            }
        }
        let mut out = Division::default();
        let all = |seat| Division { shares: [(seat, 1.0); NEAREST], count: usize::from(seat != usize::MAX) };
        if near[0].squared <= HOME {
            return all(near[0].seat);
        }
        // A weight is (1/d − 1/R)² with R the distance of the first that has no part: it comes and goes at zero.
        let rim = 1.0 / near[NEAREST].squared.sqrt();
        let mut sum = 0.0;
        for gap in near[..NEAREST].iter().filter(|g| g.seat != usize::MAX) {
            let inverse = 1.0 / gap.squared.sqrt() - rim;
            out.shares[out.count] = (gap.seat, inverse * inverse);
            out.count += 1;
            sum += inverse * inverse;
        }
        if sum <= 0.0 {
            return all(near[0].seat);
        }
        out.shares[..out.count].iter_mut().for_each(|s| s.1 /= sum);
        out
    }
}

impl Reuse {
    /// Follows what came since the frame before; returns the number of paths of each source: those of the kept paths, as
    /// long as nothing but poses and intensities changed and no source's number would be twice or half as large.
    /// * `shares`: what they would be if all began anew
    pub fn begin(&mut self, scene: &RenderScene, vpl: &VplOptions, seed: u32, shares: &[u32]) -> &[u32] {
        let same = self.by.update(scene, vpl, seed);
        let alike = |(&a, &b): (&u32, &u32)| u64::from(a) * 2 >= u64::from(b) && u64::from(b) * 2 >= u64::from(a);
        self.afresh = !same || self.shares.len() != shares.len() || !self.shares.iter().zip(shares).all(alike);
        if self.afresh {
            self.shares.clear();
            self.shares.extend_from_slice(shares);
            self.seats.clear();
        }
        &self.shares
    }

    /// The kept paths are gone.
    pub fn forget(&mut self) {
        self.by.forget();
        self.seats.clear();
        self.unsettled = false;
    }

    /// True where sites still wait for their paths.
    pub fn is_unsettled(&self) -> bool {
        self.unsettled
    }

    /// VPLs with flux on kept paths.
    pub fn count(&self, slots: &[Vpl]) -> u32 {
        if self.seats.is_empty() {
            return 0;
        }
        let of = |(chunk, _): (&[Vpl], &Seat)| chunk.iter().filter(|v| v.flux != Vec3::ZERO).count() as u32;
        slots.chunks(slots.len() / self.seats.len()).zip(&self.seats).filter(|(_, seat)| seat.kept).map(of).sum()
    }

    /// Fills in the landings of all paths; returns the number of rays. After [`Self::begin`].
    /// * `most`: paths that are begun anew, unless all are
    /// * `landings`: as many for each path
    pub(super) fn trace(&mut self, tracer: &PathTracer, paths: &[Path], most: usize, landings: &mut [Landing]) -> u64 {
        let landings_a_path = landings.len() / paths.len().max(1);
        self.find_sources(tracer, paths.len());
        let mut rays = self.look(tracer, paths);
        if self.afresh {
            self.unsettled = false;
            for (seat, site) in self.seats.iter_mut().zip(&self.sites) {
                seat.place = site.place;
            }
        } else {
            self.renew(most);
        }
        self.divide();
        let lights = self.lit_paths();
        rays += landings
            .par_chunks_mut(landings_a_path.max(1))
            .with_min_len(16)
            .zip(paths)
            .zip(&self.seats)
            .enumerate()
            .map(|(i, ((landings, path), seat))| {
                if i >= lights {
                    return tracer.trace(*path, landings);
                }
                let Some(Place { surface, .. }) = &seat.place else { return 0 };
                landings[0] = (vpl_at(surface, seat.flux), surface.instance_id);
                let next = tracer.leave(path.index, 0, surface);
                next.map_or(0, |ray| tracer.follow(path.index, 1, ray, seat.flux, &mut landings[1..]))
            })
            .sum::<u64>();
        rays
    }

    /// Paths of lights come before those of emissive surfaces.
    fn lit_paths(&self) -> usize {
        self.sources.last().map_or(0, |s| s.paths.end)
    }

    fn find_sources(&mut self, tracer: &PathTracer, paths: usize) {
        self.sources.clear();
        let mut first = 0;
        for (light, &of) in tracer.scene.lights.iter().zip(&self.shares) {
            let domain = match light.kind {
                LightKind::Point => 2.0 * TAU,
                LightKind::Spot { cos_outer, .. } => TAU * (1.0 - cos_outer),
                LightKind::Directional => PI,
            };
            let range = first..first + of as usize;
            first = range.end;
            self.sources.push(Source {
                paths: range,
                frame: SourceFrame::of(light, tracer.bounds),
                kind: light.kind,
                part: (domain / of.max(1) as f32).max(f32::MIN_POSITIVE),
                free: 0,
                open: true,
                crowds_known: false,
            });
        }
        self.sites.clear();
        self.sites.resize(paths, Site::default());
        self.seats.resize(paths, Seat::default());
    }

    /// Finds what the sites show, and which seats still hold. Returns the number of rays.
    fn look(&mut self, tracer: &PathTracer, paths: &[Path]) -> u64 {
        let Some(accel) = tracer.accel else { return 0 };
        let (sources, lights) = (&self.sources, self.lit_paths());
        let rays = self.sites[..lights]
            .par_iter_mut()
            .zip(&mut self.seats[..lights])
            .zip(&paths[..lights])
            .with_min_len(16)
            .map(|((site, seat), path)| {
                let source = &sources[path.source as usize];
                let start = tracer.start(*path);
                let mut rays = 0;
                if start.flux != Vec3::ZERO {
                    rays += 1;
                    let hit = accel.closest_hit(&start.ray);
                    if hit.is_hit() {
                        let surface = surface_at(tracer.scene, tracer.normals, &start.ray, &hit);
                        let flux = start.flux * tracer.albedo(&surface);
                        if flux != Vec3::ZERO {
                            let at = source.domain(surface.position_world);
                            *site = Site { place: Some(Place { hit, at, surface }), flux };
                        }
                    }
                }
                if let Some(place) = seat.place {
                    seat.place = on_its_body(tracer, source, &place).filter(|p| {
                        rays += 1;
                        !accel.closest_hit(&source.back(&p.surface)).is_hit()
                    });
                }
                (seat.kept, seat.flux) = (seat.place.is_some(), Vec3::ZERO);
                rays
            })
            .sum();
        for source in &mut self.sources {
            source.free = self.seats[source.paths.clone()].iter().filter(|s| s.place.is_none()).count();
        }
        rays
    }

    /// Begins paths where they are missing, at most `left`.
    fn renew(&mut self, mut left: usize) {
        let Self { sources, sites, seats, gaps, .. } = self;
        gaps.clear();
        gaps.resize(sites.len(), Gap::NONE);
        for source in sources.iter() {
            let (range, seats) = (source.paths.clone(), &*seats);
            gaps[range.clone()].par_iter_mut().zip(&sites[range]).with_min_len(16).for_each(|(gap, site)| {
                if let Some(place) = &site.place {
                    *gap = source.nearest(place, seats, usize::MAX);
                }
            });
        }
        self.unsettled = false;
        while let Some((of, site)) = self.emptiest(LONELY, |s| s.free > 0) {
            if left == 0 {
                self.unsettled = true;
                return;
            }
            left -= 1;
            // On its own site a path is the one that a fresh start would make.
            let own = |i: &usize| self.seats[*i].place.is_none();
            let Some(seat) = Some(site).filter(own).or_else(|| self.sources[of].paths.clone().find(own)) else {
                return;
            };
            self.sources[of].free -= 1;
            self.begin_path(of, site, seat);
        }
        while let Some((of, site)) = self.emptiest(BARE, |s| s.open) {
            self.find_crowds(of);
            let most = CROWDED * self.gaps[site].squared;
            let crowded = self.sources[of].paths.clone().min_by(|&a, &b| {
                let squared = |i: usize| self.crowds[i].squared;
                squared(a).total_cmp(&squared(b))
            });
            match crowded.filter(|&i| self.crowds[i].squared < most) {
                None => self.sources[of].open = false,
                Some(_) if left == 0 => {
                    self.unsettled = true;
                    return;
                }
                Some(seat) => {
                    left -= 1;
                    self.end_path(of, seat);
                    self.begin_path(of, site, seat);
                }
            }
        }
    }

    /// The site furthest from all paths, if further than `least`, among the sources that are wanted; and its source.
    fn emptiest(&self, least: f32, wanted: impl Fn(&Source) -> bool) -> Option<(usize, usize)> {
        let mut found = None;
        let mut most = least;
        for (of, source) in self.sources.iter().enumerate().filter(|(_, s)| wanted(s)) {
            for i in source.paths.clone() {
                if self.gaps[i].squared > most {
                    most = self.gaps[i].squared;
                    found = Some((of, i));
                }
            }
        }
        found
    }

    fn begin_path(&mut self, of: usize, site: usize, seat: usize) {
        let Some(place) = self.sites[site].place else { return };
        self.seats[seat] = Seat { place: Some(place), flux: Vec3::ZERO, kept: false };
        let source = &self.sources[of];
        for i in source.paths.clone() {
            if let Some(other) = &self.sites[i].place {
                let squared = source.squared(other, &place);
                if squared < self.gaps[i].squared {
                    self.gaps[i] = Gap { squared, seat };
                }
            }
        }
    }

    fn end_path(&mut self, of: usize, seat: usize) {
        self.seats[seat] = Seat::default();
        let source = &self.sources[of];
        for (gap, site) in self.gaps.iter_mut().zip(&self.sites) {
            if let Some(place) = site.place.as_ref().filter(|_| gap.seat == seat) {
                *gap = source.nearest(place, &self.seats, usize::MAX);
            }
        }
        // What stood close to it may stand alone now, and what was just begun stays.
        self.crowds[seat] = Gap::FAR;
        self.crowds.iter_mut().filter(|c| c.seat == seat).for_each(|c| *c = Gap::FAR);
    }

    /// Finds how close each path of a source stands to another of those that may be taken away, once a frame. Paths on their
    /// own sites may not: so each that is begun at rest is there for good, and all comes to rest.
    fn find_crowds(&mut self, of: usize) {
        let Self { sources, seats, crowds, gaps, .. } = self;
        let source = &mut sources[of];
        if std::mem::replace(&mut source.crowds_known, true) {
            return;
        }
        crowds.resize(seats.len(), Gap::FAR);
        let (source, seats, range) = (&*source, &*seats, source.paths.clone());
        let first = range.start;
        crowds[range.clone()].par_iter_mut().enumerate().with_min_len(16).for_each(|(k, crowd)| {
            let seat = &seats[first + k];
            *crowd = match &seat.place {
                Some(place) if seat.kept => source.nearest(place, seats, first + k),
                _ => Gap::FAR,
            };
        });
        for gap in gaps[range].iter().filter(|g| g.squared <= HOME && g.seat != usize::MAX) {
            crowds[gap.seat] = Gap::FAR;
        }
    }

    /// Divides the light of all sites among the paths. What gets none ends.
    fn divide(&mut self) {
        let Self { sources, sites, seats, divided, .. } = self;
        divided.clear();
        divided.resize(sites.len(), Division::default());
        for source in sources.iter() {
            let (range, seats) = (source.paths.clone(), &*seats);
            divided[range.clone()].par_iter_mut().zip(&sites[range]).with_min_len(16).for_each(|(out, site)| {
                if let Some(place) = &site.place {
                    *out = source.divide(place, seats);
                }
            });
        }
        for (site, division) in sites.iter().zip(divided.iter()) {
            for &(seat, share) in &division.shares[..division.count] {
                seats[seat].flux += site.flux * share;
            }
        }
        for seat in seats.iter_mut().filter(|s| s.flux == Vec3::ZERO) {
            *seat = Seat::default();
        }
    }
}

/// A place of the frame before on its body as it lies now; `None` where the source no longer lights its side.
fn on_its_body(tracer: &PathTracer, source: &Source, place: &Place) -> Option<Place> {
    let PathTracer { scene, normals, .. } = *tracer;
    // Position does not depend on the ray, sides do.
    let found = surface_at(scene, normals, &Ray::new(Vec3::ZERO, Vec3::Y), &place.hit);
    let ray = Ray::new(Vec3::ZERO, source.direction(found.position_world));
    let surface = surface_at(scene, normals, &ray, &place.hit);
    let at = source.domain(surface.position_world);
    let lit = surface.front == place.surface.front && surface.n_geometric.dot(ray.direction) < 0.0 && source.emits(at);
    lit.then_some(Place { hit: place.hit, at, surface })
}
