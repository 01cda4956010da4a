//! The G-buffer of a tile in flat arrays: visible triangles by scan conversion, then places, normals and colours, sixteen
//! pixels at a time.
//!
//! Twin: `shaders/gbuffer.wgsl`.

use catoptra_engine::{Camera, Projection, RenderScene};
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

use super::{
    scan::{ScanList, ScanTriangle, ScanView, TileBuffers},
    tile::TileRect,
};
use crate::{
    accel::{Accel, Hit, Ray},
    settings::SimdLevel,
    simd::dispatch,
    trace::{
        facet::{Facet, FacetLanes, FacetSource, Facets},
        points::{Glossy, LANES, Lane, PointBatch, PointSurface, make_room, store},
        shade::FrameContext,
        surface::{PixelCone, RayStart, Surface, surface_seen},
    },
};

/// The camera's view, made ready for a frame.
#[derive(Clone, Debug)]
pub struct CameraScan {
    /// The pixels.
    pub view: ScanView,
    /// The triangles that they may see.
    pub list: ScanList,
}

/// A tile's pixels: runs of sixteen, row after row, as in [`TileBuffers`].
#[derive(Clone, Debug, Default)]
pub struct GBuffer {
    /// Which triangle is seen where.
    pub visible: TileBuffers,
    /// The tile itself, without what runs have too much.
    rect: Option<TileRect>,
    /// What the light falls on.
    pub points: PointBatch,
    /// Bit i of run r: the pixel has a mirror or glass share.
    traced: Vec<u16>,
    facets: Facets,
    candidates: Vec<u32>,
    mixed: FacetLanes,
}

impl CameraScan {
    /// Sets up all triangles for the camera; reuses the memory.
    pub fn build(&mut self, level: SimdLevel, scene: &RenderScene, accel: &Accel, size: [u32; 2]) {
        self.view = ScanView::of_camera(&scene.camera, size[0], size[1]);
        self.list.build(level, &self.view, scene, accel);
    }
}

impl Default for CameraScan {
    fn default() -> Self {
        Self { view: ScanView::of_camera(&Camera::default(), 1, 1), list: ScanList::default() }
    }
}

impl GBuffer {
    /// Fills the tile.
    /// * `band`: numbers of the triangles that may cover the tile's rows, ascending
    /// * `ray_starts`: rays to the lights will start from its points
    pub fn fill(&mut self, ctx: &FrameContext, scan: &CameraScan, band: &[u32], rect: TileRect, ray_starts: bool) {
        let (x1, list) = (rect.x + rect.width - 1, &scan.list);
        self.candidates.clear();
        let of_columns = |n: &&u32| {
            let b = list.pixel_box(**n);
            u32::from(b.x0) <= x1 && u32::from(b.x1) >= rect.x
        };
        self.candidates.extend(band.iter().filter(of_columns));
        self.visible.fill(ctx.level, &scan.view, list, &self.candidates, ctx.accel, rect);
        self.rect = Some(rect);
        self.facets.begin(ctx);
        let runs = self.visible.triangle.len();
        self.points.keep_ray_starts(ray_starts);
        self.points.reset(runs * LANES);
        self.traced.clear();
        self.traced.resize(runs, 0);
        let eye = Eye::of(&ctx.scene.camera, scan.view.width, scan.view.height);
        for run in 0..runs {
            self.fill_run(ctx, list, &eye, run);
        }
    }

    fn fill_run(&mut self, ctx: &FrameContext, list: &ScanList, eye: &Eye, run: usize) {
        let numbers = self.visible.triangle[run];
        let (x, y) = self.place(run * LANES);
        let first = numbers[0];
        let uniform = numbers.iter().fold(0, |d, n| d | (n ^ first)) == 0;
        let at = run * LANES;
        let mut special = 0u16;
        if uniform {
            if first == TileBuffers::NONE {
                let zero = [[0.0; LANES]; 3];
                let background = ctx.scene.environment.background.to_array().map(|v| [v; LANES]);
                store(&mut self.points.position, at, &zero);
                store(&mut self.points.normal, at, &zero);
                store(&mut self.points.base_color, at, &zero);
                store(&mut self.points.radiance, at, &background);
                self.points.matte[at..at + LANES].fill(0.0);
                if self.points.has_ray_starts() {
                    store(&mut self.points.n_geometric, at, &zero);
                    self.points.error[at..at + LANES].fill(0.0);
                }
                return;
            }
            let triangle = list.triangle(first);
            let facet = self.facets.of(ctx, triangle.instance_id, triangle.primitive_id);
            uniform_run(ctx.level, &mut self.points, at, facet, &triangle.in_block(x, y), eye, [x, y]);
            if facet.textured | facet.glossy | facet.traced {
                special = u16::MAX;
            }
        } else {
            let nothing = Facet::nothing();
            let mut weights: MixedWeights = [[[0.0; LANES]; 3]; 3];
            for (lane, &number) in numbers.iter().enumerate() {
                if number == TileBuffers::NONE {
                    self.mixed.put(lane, &nothing);
                    weights[2][2][lane] = 1.0;
                    continue;
                }
                let triangle = list.triangle(number);
                let facet = self.facets.of(ctx, triangle.instance_id, triangle.primitive_id);
                self.mixed.put(lane, facet);
                for (of, w) in weights.iter_mut().zip(triangle.in_block(x, y)) {
                    of.iter_mut().zip(w).for_each(|(lanes, w)| lanes[lane] = w);
                }
                special |= u16::from(facet.textured | facet.glossy | facet.traced) << lane;
            }
            mixed_run(ctx.level, &mut self.points, at, &self.mixed, &weights, eye, [x, y]);
            for (lane, &number) in numbers.iter().enumerate() {
                if number == TileBuffers::NONE {
                    let own = ctx.scene.environment.background;
                    self.points.set(at + lane, &PointSurface { own, ..PointSurface::default() }, &RayStart::default());
                }
            }
        }
        while special != 0 {
            let lane = special.trailing_zeros() as usize;
            special &= special - 1;
            self.finish(ctx, list, eye, at + lane);
        }
    }

    /// What is done pixel by pixel: textures, highlights, the mask.
    fn finish(&mut self, ctx: &FrameContext, list: &ScanList, eye: &Eye, i: usize) {
        let number = self.visible.triangle[i / LANES][i % LANES];
        let triangle = list.triangle(number);
        let facet = self.facets.of(ctx, triangle.instance_id, triangle.primitive_id);
        let (textured, mut glossy, mut traced, mut look) = (facet.textured, facet.glossy, facet.traced, facet.look);
        let (x, y) = self.place(i);
        if textured {
            let t = ScanView::distance(eye.perspective, self.visible.nearness[i / LANES][i % LANES]);
            let (direction, hit) = (eye.direction(x, y), hit_at(triangle, x, y, t));
            let width = eye.cone.at(t);
            let s = surface_seen(ctx.scene, ctx.normals, &Ray::new(Vec3::ZERO, direction), &hit, width);
            self.points.set(i, &point_of(ctx, &s), &s.ray_start());
            look = s.look;
            traced = look.is_traced();
            glossy = look.specular != Vec3::ZERO && !ctx.scene.materials[s.material as usize].unlit;
        }
        if glossy {
            let (specular, shininess, wo) = (look.specular, look.shininess, -eye.direction(x, y));
            self.points.glossy.push(Glossy { point: i as u32, specular, shininess, wo });
        }
        if traced {
            self.traced[i / LANES] |= 1 << (i % LANES);
        }
    }

    /// Triangles of a tile that fit without another allocation.
    pub(crate) fn candidates(&self) -> usize {
        self.candidates.capacity()
    }

    /// Makes room for as many.
    pub(crate) fn reserve(&mut self, candidates: usize) {
        make_room(&mut self.candidates, candidates);
    }

    /// Column and row of pixel `i`.
    pub fn place(&self, i: usize) -> (u32, u32) {
        let (run, lane) = (i / LANES, (i % LANES) as u32);
        let column = (run % self.visible.runs * LANES) as u32;
        (self.visible.x + column + lane, self.visible.y + (run / self.visible.runs) as u32)
    }

    /// Number of the pixel at a column and row of the tile.
    pub fn index(&self, x: u32, y: u32) -> usize {
        let v = &self.visible;
        (y - v.y) as usize * v.runs * LANES + (x - v.x) as usize
    }

    /// Instance and material that pixel `i` shows; `None` where it shows nothing.
    pub fn instance(&self, ctx: &FrameContext, scan: &CameraScan, i: usize) -> Option<(u32, u32)> {
        let number = self.visible.triangle[i / LANES][i % LANES];
        (number != TileBuffers::NONE).then(|| {
            let id = scan.list.triangle(number).instance_id;
            (id, ctx.scene.instances[id as usize].material)
        })
    }

    /// Distance of pixel `i` along the viewing direction in metres; 0 where it shows nothing.
    pub fn depth(&self, scan: &CameraScan, i: usize) -> f32 {
        let (run, lane) = (i / LANES, i % LANES);
        if self.visible.triangle[run][lane] == TileBuffers::NONE {
            return 0.0;
        }
        ScanView::distance(scan.view.perspective, self.visible.nearness[run][lane])
    }

    /// Unit direction of the camera ray of pixel `i` and what it meets, `t` along the viewing direction; `None` where it shows
    /// nothing.
    pub fn hit(&self, scan: &CameraScan, eye: &Eye, i: usize) -> Option<(Vec3, Hit)> {
        let number = self.visible.triangle[i / LANES][i % LANES];
        if number == TileBuffers::NONE {
            return None;
        }
        let (x, y) = self.place(i);
        Some((eye.direction(x, y), hit_at(scan.list.triangle(number), x, y, self.depth(scan, i))))
    }

    /// Everything about the surface at pixel `i`, and the unit direction of its camera ray.
    pub fn surface(&mut self, ctx: &FrameContext, scan: &CameraScan, eye: &Eye, i: usize) -> Option<(Surface, Vec3)> {
        let (direction, hit) = self.hit(scan, eye, i)?;
        Some((self.facets.surface(ctx, &Ray::new(Vec3::ZERO, direction), &hit, eye.cone.at(hit.t)), direction))
    }

    /// Takes the points that runs have beyond the tile's sides out of the light.
    pub fn blacken_outside(&mut self) {
        let Some(rect) = self.rect else { return };
        for i in 0..self.points.len() {
            let x = self.place(i).0;
            if x < rect.x || x >= rect.x + rect.width {
                self.points.set(i, &PointSurface::default(), &RayStart::default());
            }
        }
    }

    /// Collects the tile's pixels with a mirror or glass share, 4x4 blocks in a row.
    pub fn traced_pixels(&self, out: &mut Vec<u32>) {
        out.clear();
        let Some(rect) = self.rect else { return };
        if self.traced.iter().all(|&bits| bits == 0) {
            return;
        }
        for by in (rect.y..rect.y + rect.height).step_by(4) {
            for bx in (rect.x..rect.x + rect.width).step_by(4) {
                for y in by..(by + 4).min(rect.y + rect.height) {
                    for x in bx..(bx + 4).min(rect.x + rect.width) {
                        let i = self.index(x, y);
                        if self.traced[i / LANES] >> (i % LANES) & 1 != 0 {
                            out.push(i as u32);
                        }
                    }
                }
            }
        }
    }
}

/// The hit of a camera ray on a triangle that the pixel shows.
fn hit_at(triangle: &ScanTriangle, x: u32, y: u32, t: f32) -> Hit {
    let [a, b, c, _] = triangle.at(x, y);
    let sum = (a + b) + c;
    let (u, v) = if sum > 0.0 { (b / sum, c / sum) } else { (1.0 / 3.0, 1.0 / 3.0) };
    Hit { t, u, v, instance_id: triangle.instance_id, primitive_id: triangle.primitive_id }
}

/// What the kernels need of a surface.
pub fn point_of(ctx: &FrameContext, s: &Surface) -> PointSurface {
    let m = &ctx.scene.materials[s.material as usize];
    let ambient = ctx.scene.environment.ambient * (m.ambient * s.look.matte_weight());
    PointSurface {
        position_world: s.position_world,
        normal: s.n_shading,
        base_color: s.base_color,
        matte: if m.unlit { 0.0 } else { s.look.diffuse * s.look.matte_weight() * FRAC_1_PI },
        own: if m.unlit { s.emission } else { s.emission + s.base_color * ambient },
    }
}

/// What a pixel's direction is made of: `start + right · column + down · row` for the pixel's centre, any length.
#[derive(Clone, Copy, Debug)]
pub struct Eye {
    perspective: bool,
    cone: PixelCone,
    start: [f32; 3],
    right: [f32; 3],
    down: [f32; 3],
}

impl Eye {
    /// Unit direction of the ray through the centre of pixel (x, y).
    pub fn direction(&self, x: u32, y: u32) -> Vec3 {
        let (x, y) = (x as f32, y as f32);
        let d = [0, 1, 2].map(|axis| (self.start[axis] + self.right[axis] * x) + self.down[axis] * y);
        let d = Vec3::from(d);
        d / d.length()
    }

    /// The camera's.
    pub fn of(camera: &Camera, width: u32, height: u32) -> Self {
        let (half_w, half_h) = camera.half_extent(width, height);
        let m = &camera.world_from_view.matrix3;
        let cone = PixelCone::of(camera, height);
        match camera.projection {
            Projection::Perspective { .. } => {
                let right = m.x_axis * (2.0 * half_w / width as f32);
                let down = m.y_axis * (-2.0 * half_h / height as f32);
                let start = -m.z_axis - m.x_axis * half_w + m.y_axis * half_h + (right + down) * 0.5;
                Self {
                    perspective: true,
                    cone,
                    start: start.to_array(),
                    right: right.to_array(),
                    down: down.to_array(),
                }
            }
            Projection::Orthographic { .. } => {
                Self { perspective: false, cone, start: (-m.z_axis).to_array(), right: [0.0; 3], down: [0.0; 3] }
            }
        }
    }
}

/// The surfaces of a run whose first pixel is (x, y), as [`surface_seen`] has them.
#[inline(always)]
fn run_body(
    points: &mut PointBatch,
    at: usize,
    f: &impl FacetSource,
    weight: impl Fn(usize, usize, usize) -> f32,
    eye: &Eye,
    [x, y]: [u32; 2],
) {
    let dy = (y % LANES as u32) as f32;
    let (column, row) = (x as f32, y as f32);
    let mut position = [[0.0f32; LANES]; 3];
    let mut normal = [[0.0f32; LANES]; 3];
    let mut color = [[0.0f32; LANES]; 3];
    let mut own = [[0.0f32; LANES]; 3];
    let mut matte = [0.0f32; LANES];
    let mut n_geometric = [[0.0f32; LANES]; 3];
    for lane in 0..LANES {
        let dx = lane as f32;
        let at = |i: usize| (weight(i, 0, lane) * dx + weight(i, 1, lane) * dy) + weight(i, 2, lane);
        let (a, b, c) = (at(0), at(1), at(2));
        let r = 1.0 / ((a + b) + c);
        let (u, v) = (b * r, c * r);
        let w = (1.0 - u) - v;
        let mut n = [0.0f32; 3];
        let (mut facing, mut shading) = (0.0f32, 0.0f32);
        for axis in 0..3 {
            let mix = |p: [f32; 3]| (p[0] * w + p[1] * u) + p[2] * v;
            position[axis][lane] = mix([0, 1, 2].map(|k| f.corner(k, axis, lane)));
            n[axis] = mix([0, 1, 2].map(|k| f.normal(k, axis, lane)));
            let base = mix([0, 1, 2].map(|k| f.color(k, axis, lane)));
            color[axis][lane] = base;
            own[axis][lane] = f.emission(axis, lane) + base * f.ambient(axis, lane);
            let direction = (eye.start[axis] + eye.right[axis] * (column + dx)) + eye.down[axis] * row;
            facing += f.outward(axis, lane) * direction;
            shading += f.outward(axis, lane) * n[axis];
        }
        // Towards the viewer; the triangle's own where there is no interpolated one.
        let length2 = (n[0] * n[0] + n[1] * n[1]) + n[2] * n[2];
        let o = [0, 1, 2].map(|axis| f.outward(axis, lane));
        let outward2 = (o[0] * o[0] + o[1] * o[1]) + o[2] * o[2];
        let usable = (length2 > 0.0) & (length2 < f32::INFINITY);
        let length2 = if usable { length2 } else { outward2 };
        let shading = if usable { shading } else { outward2 };
        let inverse = if length2 > 0.0 { 1.0 / length2.sqrt() } else { 0.0 };
        let away = (facing < 0.0) != (shading >= 0.0);
        let inverse = if away { -inverse } else { inverse };
        for axis in 0..3 {
            normal[axis][lane] = if usable { n[axis] } else { o[axis] } * inverse;
        }
        let side = if facing < 0.0 { 1.0 } else { -1.0 };
        for axis in 0..3 {
            n_geometric[axis][lane] = o[axis] * side;
        }
        matte[lane] = f.matte(lane);
    }
    store(&mut points.position, at, &position);
    store(&mut points.normal, at, &normal);
    store(&mut points.base_color, at, &color);
    store(&mut points.radiance, at, &own);
    points.matte[at..at + LANES].copy_from_slice(&matte);
    if points.has_ray_starts() {
        store(&mut points.n_geometric, at, &n_geometric);
        for lane in 0..LANES {
            points.error[at + lane] = f.error(lane);
        }
    }
}

/// Corner weights of a run's pixels: functions of the place within a block, `[function][term]`.
type Weights = [[f32; 3]; 4];
/// A triangle each.
type MixedWeights = [[Lane; 3]; 3];

#[inline(always)]
fn uniform_body(points: &mut PointBatch, at: usize, f: &Facet, weights: &Weights, eye: &Eye, place: [u32; 2]) {
    run_body(points, at, f, |function, term, _| weights[function][term], eye, place);
}

#[inline(always)]
fn mixed_body(points: &mut PointBatch, at: usize, f: &FacetLanes, weights: &MixedWeights, eye: &Eye, place: [u32; 2]) {
    run_body(points, at, f, |function, term, lane| weights[function][term][lane], eye, place);
}

dispatch! {
    fn uniform_run => uniform_body(
        points: &mut PointBatch,
        at: usize,
        f: &Facet,
        weights: &Weights,
        eye: &Eye,
        place: [u32; 2],
    )
}
dispatch! {
    fn mixed_run => mixed_body(
        points: &mut PointBatch,
        at: usize,
        f: &FacetLanes,
        weights: &MixedWeights,
        eye: &Eye,
        place: [u32; 2],
    )
}
