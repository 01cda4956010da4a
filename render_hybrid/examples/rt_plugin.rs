//! The ray core as a plug-in (a C library) for the side-by-side harness that measures it against Embree and obvhs in one
//! process. Variants: `single` (one ray a call), `packet` (batches), `kdtree` (batches over the thesis's kd-tree), each also
//! at a fixed SIMD level: `single-portable`, `packet-avx2` and so on. `single-counted` and its like print what the rays of
//! each set test.
#![allow(unsafe_code)]
#![warn(missing_docs)]

use catoptra_engine::mesh::{Mesh, MeshData};
use catoptra_engine::render_scene::{Instance, RenderScene};
use catoptra_render_hybrid::accel::{Accel, AccelOptions, Hit, Ray};
use catoptra_render_hybrid::{BlasKind, SimdLevel};
use glam::{Affine3, Mat3, Vec3};
use std::ffi::{CStr, c_char, c_void};
use std::sync::Arc;
use std::time::Instant;

/// Same layout as `RtRay` of the harness, and as [`Ray`].
pub type RtRay = Ray;

/// A hit for the harness.
#[repr(C)]
pub struct RtHit {
    t: f32,
    prim: u32,
    u: f32,
    v: f32,
}

/// A mesh with its row-major object-to-world transform.
#[repr(C)]
pub struct RtMesh {
    verts: *const f32,
    nverts: u32,
    idx: *const u32,
    ntris: u32,
    xform: [f32; 12],
}

struct Handle {
    accel: Accel,
    /// Triangles before each instance's.
    offsets: Vec<u32>,
    single: bool,
    /// Of the first instance.
    mesh: Arc<Mesh>,
}

/// Newline-separated names.
#[unsafe(no_mangle)]
pub extern "C" fn rt_variants() -> *const c_char {
    c"single\npacket\nkdtree\nsingle-portable\nsingle-avx2\nsingle-avx512\npacket-portable\npacket-avx2\npacket-avx512\nsingle-counted\npacket-counted\nkdtree-counted\n"
        .as_ptr()
}

fn options(variant: &str) -> Option<(AccelOptions, bool)> {
    let (kind, level) = variant.split_once('-').unwrap_or((variant, "auto"));
    let simd = match level {
        "auto" | "counted" => SimdLevel::Auto,
        "portable" => SimdLevel::Portable,
        "avx2" => SimdLevel::Avx2,
        "avx512" => SimdLevel::Avx512,
        _ => return None,
    };
    let (blas, single) = match kind {
        "single" => (BlasKind::Bvh, true),
        "packet" => (BlasKind::Bvh, false),
        "kdtree" => (BlasKind::KdTree, false),
        _ => return None,
    };
    Some((AccelOptions { blas, simd, count: level == "counted" }, single))
}

/// Builds; null where the variant is unknown or not possible here. `seconds` counts the acceleration structure alone.
///
/// # Safety
/// Pointers as the harness gives them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rt_build(
    variant: *const c_char,
    meshes: *const RtMesh,
    count: u32,
    threads: u32,
    seconds: *mut f64,
) -> *mut c_void {
    // SAFETY: the harness gives a C string and `count` meshes with their arrays.
    let (variant, meshes) = unsafe { (CStr::from_ptr(variant), std::slice::from_raw_parts(meshes, count as usize)) };
    let Some((options, single)) = variant.to_str().ok().and_then(options) else { return std::ptr::null_mut() };
    let Ok(mut accel) = Accel::new(options) else { return std::ptr::null_mut() };
    let mut scene = RenderScene::default();
    let mut offsets = vec![0];
    for (i, m) in meshes.iter().enumerate() {
        // SAFETY: as above.
        let (v, t) = unsafe {
            (
                std::slice::from_raw_parts(m.verts, 3 * m.nverts as usize),
                std::slice::from_raw_parts(m.idx, 3 * m.ntris as usize),
            )
        };
        let positions: Vec<Vec3> = v.chunks_exact(3).map(Vec3::from_slice).collect();
        let data = MeshData {
            normals: vec![Vec3::Y; positions.len()],
            positions,
            triangles: t.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
            ..Default::default()
        };
        let Ok(mesh) = Mesh::new(data) else { return std::ptr::null_mut() };
        scene.meshes.push(Arc::new(mesh));
        let x = m.xform;
        let linear =
            Mat3::from_cols(Vec3::new(x[0], x[4], x[8]), Vec3::new(x[1], x[5], x[9]), Vec3::new(x[2], x[6], x[10]));
        let world_from_object = Affine3::from_mat3_translation(linear, Vec3::new(x[3], x[7], x[11]));
        scene.instances.push(Instance { stable_id: i as u64, mesh: i as u32, material: 0, world_from_object });
        offsets.push(offsets[i] + m.ntris);
    }
    let Ok(pool) = rayon::ThreadPoolBuilder::new().num_threads(threads as usize).build() else {
        return std::ptr::null_mut();
    };
    let start = Instant::now();
    pool.install(|| accel.update(&scene));
    // SAFETY: the harness gives a place for the time.
    unsafe { *seconds = start.elapsed().as_secs_f64() };
    if let Err(e) = accel.validate() {
        eprintln!("{e}");
        return std::ptr::null_mut();
    }
    Box::into_raw(Box::new(Handle { accel, offsets, single, mesh: scene.meshes[0].clone() })).cast()
}

/// What the last call's rays have tested, each on average. Nothing where it was not counted.
fn print_counts(accel: &Accel, rays: u64) {
    let c = accel.counts();
    if c.nodes != 0 {
        let [nodes, boxes, blocks, triangles] =
            [c.nodes, c.boxes, c.blocks, c.triangles].map(|n| n as f64 / rays as f64);
        eprintln!("a ray: {nodes:.2} nodes, {boxes:.2} boxes, {blocks:.2} blocks, {triangles:.2} triangles");
    }
}

const BATCH: usize = 1024;

/// Closest hits.
///
/// # Safety
/// A handle of [`rt_build`], `n` rays, room for `n` hits.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rt_trace(handle: *mut c_void, rays: *const RtRay, n: u64, hits: *mut RtHit, _coherent: u32) {
    // SAFETY: by the function's contract; `Ray` has the harness's layout.
    let (handle, rays, out) = unsafe {
        (
            &*handle.cast::<Handle>(),
            std::slice::from_raw_parts(rays, n as usize),
            std::slice::from_raw_parts_mut(hits, n as usize),
        )
    };
    // The sum of earlier calls is not of these rays.
    handle.accel.counts();
    let give = |h: Hit| {
        let prim = if h.is_hit() { handle.offsets[h.instance_id as usize] + h.primitive_id } else { u32::MAX };
        RtHit { t: h.t, prim, u: h.u, v: h.v }
    };
    if handle.single {
        for (ray, out) in rays.iter().zip(out) {
            *out = give(handle.accel.closest_hit(ray));
        }
        print_counts(&handle.accel, n);
        return;
    }
    let mut batch = [Hit::MISS; BATCH];
    for (rays, out) in rays.chunks(BATCH).zip(out.chunks_mut(BATCH)) {
        let batch = &mut batch[..rays.len()];
        handle.accel.closest_hits(rays, batch);
        for (out, hit) in out.iter_mut().zip(batch) {
            *out = give(*hit);
        }
    }
    print_counts(&handle.accel, n);
}

/// Occlusion.
///
/// # Safety
/// A handle of [`rt_build`], `n` rays, room for `n` answers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rt_occluded(
    handle: *mut c_void,
    rays: *const RtRay,
    n: u64,
    occluded: *mut u8,
    _coherent: u32,
) {
    // SAFETY: by the function's contract.
    let (handle, rays, out) = unsafe {
        (
            &*handle.cast::<Handle>(),
            std::slice::from_raw_parts(rays, n as usize),
            std::slice::from_raw_parts_mut(occluded, n as usize),
        )
    };
    if handle.single {
        for (ray, out) in rays.iter().zip(out) {
            *out = u8::from(handle.accel.occluded(ray));
        }
        print_counts(&handle.accel, n);
        return;
    }
    let mut batch = [false; BATCH];
    for (rays, out) in rays.chunks(BATCH).zip(out.chunks_mut(BATCH)) {
        let batch = &mut batch[..rays.len()];
        handle.accel.occluded_many(rays, batch);
        for (out, hit) in out.iter_mut().zip(batch) {
            *out = u8::from(*hit);
        }
    }
    print_counts(&handle.accel, n);
}

/// Moves the vertices of a one-mesh structure; returns the seconds of the refit proper, below 0 where that is not possible.
///
/// # Safety
/// A handle of [`rt_build`], `count` vertices.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rt_refit(handle: *mut c_void, verts: *const f32, count: u32) -> f64 {
    // SAFETY: by the function's contract.
    let (handle, v) = unsafe { (&mut *handle.cast::<Handle>(), std::slice::from_raw_parts(verts, 3 * count as usize)) };
    let positions: Vec<Vec3> = v.chunks_exact(3).map(Vec3::from_slice).collect();
    let data = MeshData {
        normals: vec![Vec3::Y; positions.len()],
        positions,
        triangles: handle.mesh.triangles().to_vec(),
        ..Default::default()
    };
    let Ok(mesh) = Mesh::new(data) else { return -1.0 };
    let mesh = Arc::new(mesh);
    let start = Instant::now();
    if handle.offsets.len() != 2 || !handle.accel.refit_mesh(&handle.mesh, &mesh) {
        return -1.0;
    }
    let seconds = start.elapsed().as_secs_f64();
    handle.mesh = mesh;
    seconds
}

/// Frees what [`rt_build`] made.
///
/// # Safety
/// A handle of [`rt_build`], once.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rt_free(handle: *mut c_void) {
    // SAFETY: by the function's contract.
    drop(unsafe { Box::from_raw(handle.cast::<Handle>()) });
}
