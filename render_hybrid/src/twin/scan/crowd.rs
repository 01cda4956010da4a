//! Meshes of which a view sees few triangles: far away, their triangles are smaller than pixels and most fall between pixel
//! centres. Their trees are searched for those that do not, as rays through all pixels would, in place of a look at each.
//!
//! Contract: what is found are exactly the triangles that a look at each would keep, so that the choice between the two
//! ways is one of time alone.

use catoptra_engine::{Mesh, RenderScene};
use rayon::prelude::*;

use super::{
    ScanView,
    setup::{MARGIN, project, triangle},
};
use crate::{
    accel::{
        Accel, MeshTree,
        node::{BLOCK, EMPTY, LEAF, Node8, Tri8, WIDTH},
    },
    settings::SimdLevel,
    simd::dispatch,
};

/// Pixels by which boxes are widened: those of triangles by [`MARGIN`], and rounding.
const BOX_MARGIN: f64 = 1.5 * MARGIN;

/// Rounding of a box's distance, relative to the greatest term of its sum.
const ROUNDING: f64 = 1e-13;

/// Meshes with fewer triangles are looked at one by one.
const FEW: usize = 512;

/// A mesh is searched where it has more triangles than this for each pixel of the box around it.
const PER_PIXEL: f64 = 0.5;

/// Triangles from which a mesh is searched by several tasks.
const LARGE: usize = 100_000;

/// About how many tasks.
const TASKS: usize = 64;

/// The triangles found, and memory kept between frames.
#[derive(Clone, Debug, Default)]
pub(super) struct Crowd {
    jobs: Vec<Job>,
    roots: Vec<u32>,
    /// Sorted triangles, instance by instance.
    pub ids: Vec<u32>,
}

/// A subtree to search.
#[derive(Clone, Debug, Default)]
struct Job {
    instance_id: u32,
    root: u32,
    found: Vec<u32>,
}

impl Crowd {
    /// Searches the trees of `instances` and tells `found` of each where its triangles lie in [`Self::ids`].
    pub fn search(
        &mut self,
        level: SimdLevel,
        view: &ScanView,
        scene: &RenderScene,
        accel: &Accel,
        instances: impl Iterator<Item = u32> + Clone,
        mut found: impl FnMut(u32, std::ops::Range<usize>),
    ) {
        let mut used = 0;
        let jobs = &mut self.jobs;
        let mut add = |instance_id: u32, root: u32| {
            if used == jobs.len() {
                jobs.push(Job::default());
            }
            (jobs[used].instance_id, jobs[used].root) = (instance_id, root);
            used += 1;
        };
        for id in instances.clone() {
            let Some(tree) = accel.mesh_tree(id) else { continue };
            let triangles = scene.meshes[scene.instances[id as usize].mesh as usize].triangles().len();
            if triangles < LARGE {
                add(id, tree.root);
            } else {
                subtrees(&tree, &mut self.roots);
                self.roots.iter().for_each(|r| add(id, *r));
            }
        }
        let jobs = &mut self.jobs[..used];
        jobs.par_iter_mut().for_each(|job| {
            job.found.clear();
            let Some(tree) = accel.mesh_tree(job.instance_id) else { return };
            let instance = &scene.instances[job.instance_id as usize];
            let mesh = &scene.meshes[instance.mesh as usize];
            let lens = Lens::new(view, mesh, view.rows_from_object(&instance.world_from_object));
            search(level, &lens, &tree, job.root, &mut job.found);
        });
        self.ids.clear();
        let mut at = 0;
        for id in instances {
            let first = self.ids.len();
            while at < used && self.jobs[at].instance_id == id {
                self.ids.extend_from_slice(&self.jobs[at].found);
                at += 1;
            }
            self.ids[first..].sort_unstable();
            found(id, first..self.ids.len());
        }
    }
}

/// True where searching an instance's tree is cheaper than a look at each of its triangles: a function of its shape, pose and
/// the view alone.
pub(super) fn is_crowd(view: &ScanView, mesh: &Mesh, rows: &[[f64; 4]; 3]) -> bool {
    let triangles = mesh.triangles().len();
    if triangles < FEW {
        return false;
    }
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for corner in mesh.bounds_object().corners() {
        let c = project(view, rows, corner);
        if view.perspective && c.t <= view.near {
            return (triangles as f64) > PER_PIXEL * f64::from(view.width) * f64::from(view.height);
        }
        for axis in 0..2 {
            let p = c.h[axis] / c.h[2];
            (low[axis], high[axis]) = (low[axis].min(p), high[axis].max(p));
        }
    }
    let side = |axis: usize, size: u32| (high[axis].min(f64::from(size)) - low[axis].max(-1.0)).max(1.0);
    (triangles as f64) > PER_PIXEL * (side(0, view.width) * side(1, view.height))
}

/// The roots of about [`TASKS`] parts of a tree.
fn subtrees(tree: &MeshTree, roots: &mut Vec<u32>) {
    roots.clear();
    roots.push(tree.root);
    let mut at = 0;
    // Level by level; leaves stay.
    while at < roots.len() && roots.len() < TASKS {
        if roots[at] & LEAF == 0 {
            let node = &tree.nodes[roots.remove(at) as usize];
            roots.extend(node.child.iter().filter(|&&c| c != EMPTY));
        } else {
            at += 1;
        }
    }
}

/// A view of an object's own space.
struct Lens<'a> {
    view: &'a ScanView,
    rows: [[f64; 4]; 3],
    /// The same with columns and rows counted from a pixel amid the object, which makes boxes' bounds tighter.
    near_rows: [[f64; 4]; 3],
    /// First and last column, first and last row, counted from there.
    pixels: [[f64; 2]; 2],
    /// Bound on the rounding of t.
    slack: f64,
}

impl<'a> Lens<'a> {
    fn new(view: &'a ScanView, mesh: &Mesh, rows: [[f64; 4]; 3]) -> Self {
        let bounds = mesh.bounds_object();
        let middle = project(view, &rows, bounds.center());
        let amid = |axis: usize, size: u32| {
            let p = if middle.h[2] > 0.0 { middle.h[axis] / middle.h[2] } else { 0.0 };
            p.clamp(0.0, f64::from(size)).floor()
        };
        let from = [amid(0, view.width), amid(1, view.height)];
        let w = if view.perspective { rows[2] } else { [0.0, 0.0, 0.0, 1.0] };
        let moved = |axis: usize| [0, 1, 2, 3].map(|i| rows[axis][i] - from[axis] * w[i]);
        let near_rows = [moved(0), moved(1), rows[2]];
        let last = |size: u32| f64::from(size - 1);
        let pixels = [[-from[0], last(view.width) - from[0]], [-from[1], last(view.height) - from[1]]];
        let reach = bounds.min.abs().max(bounds.max.abs()).as_dvec3().to_array();
        let terms = (0..3).fold(rows[2][3].abs(), |sum, i| sum + rows[2][i].abs() * reach[i]);
        Self { view, rows, near_rows, pixels, slack: terms * ROUNDING }
    }

    /// Which of a node's boxes may hold a triangle that a pixel sees.
    #[inline(always)]
    fn seen(&self, node: &Node8) -> [bool; WIDTH] {
        let mut range = [[[0.0f64; WIDTH]; 2]; 3];
        for (row, range) in self.near_rows.iter().zip(&mut range) {
            let mut planes = [[&node.planes[0]; 2]; 3];
            for axis in 0..3 {
                let [low, high] = [&node.planes[2 * axis], &node.planes[2 * axis + 1]];
                planes[axis] = if row[axis] < 0.0 { [high, low] } else { [low, high] };
            }
            for end in 0..2 {
                for lane in 0..WIDTH {
                    let term = |axis: usize| row[axis] * f64::from(planes[axis][end][lane]);
                    range[end][lane] = ((term(0) + term(1)) + term(2)) + row[3];
                }
            }
        }
        let view = self.view;
        let [column, line, t] = &range;
        let mut out = [false; WIDTH];
        for lane in 0..WIDTH {
            let (least, greatest) = (t[0][lane] - self.slack, t[1][lane] + self.slack);
            let within = (greatest > view.near) & (least < view.far);
            let whole = !view.perspective | (least > view.near);
            let (far, near) = if view.perspective { (1.0 / greatest, 1.0 / least) } else { (1.0, 1.0) };
            let mut covers = true;
            for (range, pixels) in [column, line].into_iter().zip(&self.pixels) {
                let (a, b) = (range[0][lane], range[1][lane]);
                let low = a * (if a < 0.0 { near } else { far }) - BOX_MARGIN;
                let high = b * (if b < 0.0 { far } else { near }) + BOX_MARGIN;
                covers &= low.ceil().max(pixels[0]) <= high.floor().min(pixels[1]);
            }
            // What reaches behind the eye is cut further down.
            out[lane] = within & (covers | !whole);
        }
        out
    }

    #[inline(always)]
    fn leaf(&self, block: &Tri8, out: &mut Vec<u32>) {
        for lane in 0..WIDTH {
            let prim = block.prim[lane];
            if prim == u32::MAX {
                return;
            }
            let corner = |v: usize| project(self.view, &self.rows, block.corner(v, lane).into());
            if triangle(self.view, [corner(0), corner(1), corner(2)]).is_some() {
                out.push(prim);
            }
        }
    }
}

#[inline(always)]
fn search_body(lens: &Lens, tree: &MeshTree, root: u32, out: &mut Vec<u32>) {
    let mut stack = [EMPTY; crate::accel::node::STACK];
    let mut open = 1;
    stack[0] = root;
    while open > 0 {
        open -= 1;
        let at = stack[open];
        if at == EMPTY {
            continue;
        }
        if at & LEAF != 0 {
            lens.leaf(&tree.blocks[(at & BLOCK) as usize], out);
            continue;
        }
        let node = &tree.nodes[at as usize];
        let seen = lens.seen(node);
        for lane in 0..WIDTH {
            if seen[lane] && node.child[lane] != EMPTY {
                stack[open] = node.child[lane];
                open += 1;
            }
        }
    }
}

dispatch! {
    /// Finds the triangles below `root` that a pixel of the view may see.
    fn search => search_body(lens: &Lens<'_>, tree: &MeshTree<'_>, root: u32, out: &mut Vec<u32>)
}
