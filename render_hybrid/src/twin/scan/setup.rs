//! The triangles of a view, made ready for its pixels.

use catoptra_engine::{Mesh, RenderScene};
use glam::Vec3;
use rayon::prelude::*;

use super::{
    ScanView,
    crowd::{Crowd, is_crowd},
};
use crate::{accel::Accel, settings::SimdLevel};

/// Triangles that one task sets up.
const CHUNK: usize = 2048;

/// More triangles than this are not given a place each before it is known which are seen.
const MANY: usize = 4_000_000;

/// Pixels by which a triangle's box is widened, so that rounding loses no pixel.
pub(super) const MARGIN: f64 = 0.01;

/// A triangle as pixels see it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ScanTriangle {
    /// Weight of each corner at pixel (x, y) up to a common positive factor: `w[0]·x + w[1]·y + w[2]`.
    pub weights: [[f64; 3]; 3],
    /// 1/t (perspective) or −t at pixel (x, y), the same way.
    pub nearness: [f64; 3],
    /// Index into the scene's instances.
    pub instance_id: u32,
    /// Triangle of its mesh.
    pub primitive_id: u32,
}

/// First and last column and row that a triangle may cover.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelBox {
    pub x0: u16,
    pub x1: u16,
    pub y0: u16,
    pub y1: u16,
}

/// An instance in view.
#[derive(Clone, Copy, Debug)]
struct Chosen {
    instance_id: u32,
    /// Its mesh's tree is searched for what is seen.
    crowd: bool,
}

/// One task's part of an instance.
#[derive(Clone, Copy, Debug)]
struct Part {
    instance_id: u32,
    /// First triangle of the mesh, or first place in the crowd's list, and how many.
    first: u32,
    len: u32,
    crowd: bool,
    /// Places kept for it.
    room: u32,
    /// How many of them may be seen; they stand at the front of the part's places.
    seen: u32,
}

/// All triangles of a view that may cover a pixel, by ascending (instance, primitive). Memory is kept between frames.
#[derive(Clone, Debug, Default)]
pub struct ScanList {
    triangles: Vec<ScanTriangle>,
    boxes: Vec<PixelBox>,
    chosen: Vec<Chosen>,
    crowd: Crowd,
    parts: Vec<Part>,
    #[cfg(test)]
    ways: Ways,
}

/// How tests have instances looked at.
#[cfg(test)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) enum Ways {
    #[default]
    Chosen,
    AllSearched,
    NoneSearched,
}

impl ScanList {
    /// Sets up the triangles of all instances that rays can hit.
    pub fn build(&mut self, level: SimdLevel, view: &ScanView, scene: &RenderScene, accel: &Accel) {
        self.choose(view, scene, accel, |_| true);
        self.set_up(level, view, scene, accel);
    }

    /// Lists the instances that `takes` chooses, that rays can hit and that the view may see.
    pub fn choose(&mut self, view: &ScanView, scene: &RenderScene, accel: &Accel, takes: impl Fn(u32) -> bool) {
        self.chosen.clear();
        for (id, instance) in scene.instances.iter().enumerate() {
            let id = id as u32;
            if !takes(id) || !accel.can_be_hit(id) {
                continue;
            }
            let mesh = &scene.meshes[instance.mesh as usize];
            let rows = view.rows_from_object(&instance.world_from_object);
            if !may_be_seen(view, mesh, &rows) {
                continue;
            }
            let crowd = is_crowd(view, mesh, &rows);
            #[cfg(test)]
            let crowd = self.ways == Ways::AllSearched || (self.ways == Ways::Chosen && crowd);
            self.chosen.push(Chosen { instance_id: id, crowd: crowd && accel.mesh_tree(id).is_some() });
        }
    }

    /// The instances of [`Self::choose`], ascending.
    pub fn instances(&self) -> impl Iterator<Item = u32> + Clone {
        self.chosen.iter().map(|c| c.instance_id)
    }

    /// Sets up the triangles of the listed instances.
    pub fn set_up(&mut self, level: SimdLevel, view: &ScanView, scene: &RenderScene, accel: &Accel) {
        self.list_parts(level, view, scene, accel);
        let listed: usize = self.parts.iter().map(|p| p.len as usize).sum();
        if listed > MANY {
            // Most of so many are smaller than a pixel: room for those that are seen alone, counted first.
            let seen = |part: &mut Part| part.room = if part.crowd { part.len } else { seen(view, scene, part) };
            self.parts.par_iter_mut().for_each(seen);
        }
        let total = self.parts.iter().map(|p| p.room as usize).sum();
        if self.triangles.len() < total {
            self.triangles.resize(total, ScanTriangle::default());
            self.boxes.resize(total, PixelBox::default());
        }
        let (triangles, boxes) = (&mut self.triangles[..total], &mut self.boxes[..total]);
        set_up_all(view, scene, &self.crowd.ids, &mut self.parts, triangles, boxes);
    }

    /// Divides the chosen instances into parts, and searches those that are crowds.
    fn list_parts(&mut self, level: SimdLevel, view: &ScanView, scene: &RenderScene, accel: &Accel) {
        let Self { chosen, crowd, parts, .. } = self;
        parts.clear();
        let mut divide = |instance_id: u32, crowd: bool, range: std::ops::Range<usize>| {
            for first in range.clone().step_by(CHUNK) {
                let len = CHUNK.min(range.end - first) as u32;
                parts.push(Part { instance_id, first: first as u32, len, crowd, room: len, seen: 0 });
            }
        };
        let mut rest = chosen.iter().copied();
        let mut one_by_one = |until: Option<u32>, divide: &mut dyn FnMut(u32, bool, std::ops::Range<usize>)| {
            for c in rest.by_ref() {
                if Some(c.instance_id) == until {
                    return;
                }
                let mesh = &scene.meshes[scene.instances[c.instance_id as usize].mesh as usize];
                divide(c.instance_id, false, 0..mesh.triangles().len());
            }
        };
        let crowds = chosen.iter().filter(|c| c.crowd).map(|c| c.instance_id);
        crowd.search(level, view, scene, accel, crowds, |id, range| {
            one_by_one(Some(id), &mut divide);
            divide(id, true, range);
        });
        one_by_one(None, &mut divide);
    }

    /// Triangle number `n`.
    #[inline(always)]
    pub fn triangle(&self, n: u32) -> &ScanTriangle {
        &self.triangles[n as usize]
    }

    /// Its box.
    #[inline(always)]
    pub fn pixel_box(&self, n: u32) -> PixelBox {
        self.boxes[n as usize]
    }

    /// Collects the numbers of triangles that may cover rows `y0..=y1`, ascending.
    pub fn of_rows(&self, y0: u32, y1: u32, out: &mut Vec<u32>) {
        out.clear();
        let mut at = 0;
        for part in &self.parts {
            for n in at..at + part.seen {
                let b = &self.boxes[n as usize];
                if u32::from(b.y0) <= y1 && u32::from(b.y1) >= y0 {
                    out.push(n);
                }
            }
            at += part.room;
        }
    }
}

#[cfg(test)]
impl ScanList {
    pub(super) fn with_ways(ways: Ways) -> Self {
        Self { ways, ..Self::default() }
    }

    /// All triangles that may be seen, with all their numbers and boxes, in order.
    pub(super) fn seen(&self) -> Vec<(ScanTriangle, PixelBox)> {
        let mut numbers = Vec::new();
        self.of_rows(0, u32::MAX, &mut numbers);
        numbers.into_iter().map(|n| (*self.triangle(n), self.pixel_box(n))).collect()
    }

    /// Places that triangles have.
    pub(super) fn places(&self) -> usize {
        self.triangles.len()
    }
}

/// Halves the work between threads down to about [`CHUNK`] triangles.
fn set_up_all(
    view: &ScanView,
    scene: &RenderScene,
    crowd: &[u32],
    parts: &mut [Part],
    triangles: &mut [ScanTriangle],
    boxes: &mut [PixelBox],
) {
    if triangles.len() <= CHUNK || parts.len() <= 1 {
        let mut at = 0;
        for part in parts {
            let places = at..at + part.room as usize;
            at = places.end;
            set_up(view, scene, crowd, part, &mut triangles[places.clone()], &mut boxes[places]);
        }
        return;
    }
    let (a, b) = parts.split_at_mut(parts.len() / 2);
    let work = a.iter().map(|p| p.room as usize).sum();
    let ((ta, tb), (ba, bb)) = (triangles.split_at_mut(work), boxes.split_at_mut(work));
    rayon::join(|| set_up_all(view, scene, crowd, a, ta, ba), || set_up_all(view, scene, crowd, b, tb, bb));
}

/// False where the mesh's box is wholly outside of the view.
fn may_be_seen(view: &ScanView, mesh: &Mesh, rows: &[[f64; 4]; 3]) -> bool {
    let corners = mesh.bounds_object().corners().map(|c| project(view, rows, c));
    let all = |outside: &dyn Fn(&Corner) -> bool| corners.iter().all(outside);
    let (right, bottom) = (f64::from(view.width - 1) + MARGIN, f64::from(view.height - 1) + MARGIN);
    // Each test is a half space, so that corners outside put the box outside.
    !(all(&|c| c.t <= view.near * (1.0 - 1e-6))
        || all(&|c| c.h[0] < -MARGIN * c.h[2] && c.h[2] > 0.0)
        || all(&|c| c.h[0] > right * c.h[2] && c.h[2] > 0.0)
        || all(&|c| c.h[1] < -MARGIN * c.h[2] && c.h[2] > 0.0)
        || all(&|c| c.h[1] > bottom * c.h[2] && c.h[2] > 0.0))
}

#[derive(Clone, Copy)]
pub(super) struct Corner {
    /// Homogeneous pixel coordinates.
    pub h: [f64; 3],
    /// Distance along the axis.
    pub t: f64,
}

#[inline(always)]
pub(super) fn project(view: &ScanView, rows: &[[f64; 4]; 3], p: Vec3) -> Corner {
    let (x, y, z) = (f64::from(p.x), f64::from(p.y), f64::from(p.z));
    let [u, v, t] = rows.map(|r| ((r[0] * x + r[1] * y) + r[2] * z) + r[3]);
    Corner { h: [u, v, if view.perspective { t } else { 1.0 }], t }
}

/// a × b; exactly −(b × a).
#[inline(always)]
fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// How many triangles of a part the view may see.
fn seen(view: &ScanView, scene: &RenderScene, part: &Part) -> u32 {
    let instance = &scene.instances[part.instance_id as usize];
    let mesh = &scene.meshes[instance.mesh as usize];
    let rows = view.rows_from_object(&instance.world_from_object);
    let positions = mesh.positions();
    let corners = |id: u32| mesh.triangles()[id as usize].map(|v| project(view, &rows, positions[v as usize]));
    (part.first..part.first + part.len).filter(|id| triangle(view, corners(*id)).is_some()).count() as u32
}

fn set_up(
    view: &ScanView,
    scene: &RenderScene,
    crowd: &[u32],
    part: &mut Part,
    triangles: &mut [ScanTriangle],
    boxes: &mut [PixelBox],
) {
    let instance = &scene.instances[part.instance_id as usize];
    let mesh = &scene.meshes[instance.mesh as usize];
    let rows = view.rows_from_object(&instance.world_from_object);
    let positions = mesh.positions();
    part.seen = 0;
    for at in part.first..part.first + part.len {
        let primitive_id = if part.crowd { crowd[at as usize] } else { at };
        let corners = mesh.triangles()[primitive_id as usize].map(|v| project(view, &rows, positions[v as usize]));
        if let Some((mut triangle, b)) = triangle(view, corners) {
            (triangle.instance_id, triangle.primitive_id) = (part.instance_id, primitive_id);
            triangles[part.seen as usize] = triangle;
            boxes[part.seen as usize] = b;
            part.seen += 1;
        }
    }
}

/// `None` where no pixel can see it.
#[inline(always)]
pub(super) fn triangle(view: &ScanView, c: [Corner; 3]) -> Option<(ScanTriangle, PixelBox)> {
    let t = c.map(|c| c.t);
    let (least, greatest) = (t[0].min(t[1]).min(t[2]), t[0].max(t[1]).max(t[2]));
    if !(greatest > view.near && least < view.far) {
        return None;
    }
    let b = pixel_box(view, &c, least)?;
    let mut weights = [cross(c[1].h, c[2].h), cross(c[2].h, c[0].h), cross(c[0].h, c[1].h)];
    let volume = (c[0].h[0] * weights[0][0] + c[0].h[1] * weights[0][1]) + c[0].h[2] * weights[0][2];
    if volume == 0.0 || !volume.is_finite() {
        return None; // Seen edge-on.
    }
    let r = 1.0 / volume;
    let nearness = [0, 1, 2].map(|i| {
        let [u, v, w] = weights.map(|w| w[i]);
        if view.perspective { ((u + v) + w) * r } else { -((u * t[0] + v * t[1]) + w * t[2]) * r }
    });
    if volume < 0.0 {
        weights = weights.map(|w| w.map(|x| -x));
    }
    Some((ScanTriangle { weights, nearness, instance_id: 0, primitive_id: 0 }, b))
}

/// The pixels between the corners of what lies beyond `near`; `None` where there are none.
#[inline(always)]
fn pixel_box(view: &ScanView, c: &[Corner; 3], least_t: f64) -> Option<PixelBox> {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    let mut hold = |h: [f64; 3]| {
        let r = 1.0 / h[2];
        for axis in 0..2 {
            let p = h[axis] * r;
            low[axis] = low[axis].min(p);
            high[axis] = high[axis].max(p);
        }
    };
    if view.perspective && least_t <= view.near {
        cut(view, c, &mut hold);
    } else {
        c.iter().for_each(|c| hold(c.h));
    }
    let range = |axis: usize, size: u32| {
        let first = (low[axis] - MARGIN).ceil().max(0.0);
        let last = (high[axis] + MARGIN).floor().min(f64::from(size - 1));
        (first <= last).then_some((first as u16, last as u16))
    };
    let (x0, x1) = range(0, view.width)?;
    let (y0, y1) = range(1, view.height)?;
    Some(PixelBox { x0, x1, y0, y1 })
}

/// The corners of the part beyond `near`. With no near distance every direction may be seen.
#[cold]
fn cut(view: &ScanView, c: &[Corner; 3], hold: &mut impl FnMut([f64; 3])) {
    if view.near <= 0.0 {
        hold([-1e9, -1e9, 1.0]);
        return hold([1e9, 1e9, 1.0]);
    }
    // A little nearer, so that rounding loses nothing.
    let near = view.near * (1.0 - 1e-6);
    for i in 0..3 {
        let (a, b) = (&c[i], &c[(i + 1) % 3]);
        if a.t > near {
            hold(a.h);
        }
        if (a.t > near) != (b.t > near) {
            let s = (near - a.t) / (b.t - a.t);
            hold([a.h[0] + (b.h[0] - a.h[0]) * s, a.h[1] + (b.h[1] - a.h[1]) * s, near]);
        }
    }
}
