//! Camera rays for the GPU lane: the CPU's own view of the pixels that it must trace or whose visibility it must know.
//! Casting them anew costs less than reading a G-buffer back, and gives the surfaces that secondary rays start from.

use rayon::prelude::*;

use super::{
    shade::FrameContext,
    visibility::{Askers, Towards},
    whitted::MaskedPixel,
};
use crate::{
    accel::{Hit, Ray},
    output::RayCounts,
    twin::{
        gbuffer::CameraScan,
        interleave::{self, Guide},
        tile::{TileRect, TileScratch, fill_indirect},
    },
};

/// The surfaces behind a list of pixel numbers, in its order; pixels where the ray meets nothing are left out.
pub fn masked_pixels(ctx: &FrameContext, list: &[u32], counts: &mut RayCounts) -> Vec<MaskedPixel> {
    let (width, height) = (ctx.settings.width, ctx.settings.height);
    let camera = &ctx.scene.camera;
    let rays: Vec<Ray> =
        list.iter().map(|p| camera_ray(camera, (p % width) as f32, (p / width) as f32, width, height)).collect();
    let mut hits = vec![Hit::MISS; rays.len()];
    ctx.accel.closest_hits(&rays, &mut hits);
    counts.camera += rays.len() as u64;
    rays.iter()
        .zip(&hits)
        .zip(list)
        .filter(|((_, hit), _)| hit.is_hit())
        .map(|((ray, hit), &pixel)| MaskedPixel { pixel, direction: ray.direction, hit: *hit })
        .collect()
}

/// Ray through the centre of pixel (x, y) that starts at the camera's near distance.
pub fn camera_ray(camera: &catoptra_engine::Camera, x: f32, y: f32, width: u32, height: u32) -> Ray {
    let (origin, direction) = camera.ray(x + 0.5, y + 0.5, width, height);
    // `near` is measured along the viewing direction.
    let forward = -camera.world_from_view.matrix3.z_axis;
    Ray { origin, direction, t_min: camera.near / forward.dot(direction), t_max: f32::INFINITY }
}

/// What the CPU knows of all pixels of a GPU-lane frame with traced visibility.
#[derive(Default)]
pub struct TracedLight {
    /// Per light, per pixel: fraction of light that arrives. Empty unless shadows are traced.
    pub visibility: Vec<Vec<f32>>,
    /// Per pixel: indirect radiance. Empty unless VPL visibility is traced.
    pub indirect: Vec<[f32; 3]>,
}

/// Traces light visibility (where `lights`) and indirect light (where `vpls`) of every pixel.
pub fn trace_light(ctx: &FrameContext, lights: bool, vpls: bool, counts: &mut RayCounts) -> TracedLight {
    let (width, height, tile) = (ctx.settings.width, ctx.settings.height, ctx.settings.tile);
    let light_count = if lights { ctx.scene.lights.len() } else { 0 };
    let mut scan = CameraScan::default();
    scan.build(ctx.level, ctx.scene, ctx.accel, [width, height]);
    let interleave = ctx.settings.vpl.map_or(1, |v| v.interleave);
    let interleaved = vpls && interleave > 1;
    let bands: Vec<(Vec<Vec<f32>>, Vec<[f32; 3]>, Vec<Guide>, RayCounts)> = (0..height.div_ceil(tile))
        .into_par_iter()
        .map(|band| {
            let y = band * tile;
            let rows = tile.min(height - y);
            let n = (rows * width) as usize;
            let mut visibility = vec![vec![1.0; n]; light_count];
            let mut indirect = vec![[0.0; 3]; if vpls && !interleaved { n } else { 0 }];
            let mut guides = vec![Guide::default(); if interleaved { n } else { 0 }];
            let mut counts = RayCounts::default();
            let mut scratch = TileScratch::default();
            let (mut askers, mut asked) = (Askers::default(), Vec::new());
            scan.list.of_rows(y, y + rows - 1, &mut scratch.band);
            for x in (0..width).step_by(tile as usize) {
                let rect = TileRect { x, y, width: tile.min(width - x), height: rows };
                scratch.gbuffer.fill(ctx, &scan, &scratch.band, rect, true);
                counts.camera += u64::from(rect.width) * u64::from(rect.height);
                scratch.gbuffer.blacken_outside();
                if vpls {
                    fill_indirect(ctx, &mut scratch, &mut counts);
                }
                let g = &scratch.gbuffer;
                askers.clear();
                asked.clear();
                for py in y..y + rows {
                    for px in x..x + rect.width {
                        let (i, at) = (g.index(px, py), ((py - y) * width + px) as usize);
                        if g.instance(ctx, &scan, i).is_none() {
                            continue;
                        }
                        askers.push(g.points.ray_start(i), py * width + px);
                        asked.push(at);
                        if interleaved {
                            guides[at] = scratch.guides[i];
                        } else if vpls {
                            indirect[at] = (g.points.albedo(i) * g.points.irradiance(i)).to_array();
                        }
                    }
                }
                for (light, plane) in visibility.iter_mut().enumerate() {
                    askers.look(ctx, light as u32, Towards::Disc, &mut counts);
                    for (&at, &seen) in asked.iter().zip(&askers.seen) {
                        plane[at] = seen;
                    }
                }
            }
            (visibility, indirect, guides, counts)
        })
        .collect();
    let mut out = TracedLight { visibility: vec![Vec::new(); light_count], indirect: Vec::new() };
    let mut guides = Vec::new();
    for (visibility, indirect, of_subsets, c) in bands {
        for (plane, band) in out.visibility.iter_mut().zip(visibility) {
            plane.extend(band);
        }
        out.indirect.extend(indirect);
        guides.extend(of_subsets);
        *counts = counts.merged(c);
    }
    if interleaved {
        let pixels = (0..width * height).into_par_iter();
        let filtered =
            pixels.map(|i| interleave::filter(&guides, width, height, i % width, i / width, interleave).to_array());
        filtered.collect_into_vec(&mut out.indirect);
    }
    out
}
