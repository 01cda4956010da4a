//! The camera's functions over the frame's uniform, against engine/src/camera.rs and the tracer's cone of a pixel.

use catoptra_engine::{
    Camera, Projection, RenderScene,
    camera::world_from_view_looking_at,
    glam::{Vec2, Vec3},
};
use catoptra_render_hybrid::{BlasKind, trace::camera_rays::camera_ray, trace::surface::PixelCone};

use super::{Allowed, Random, Verdict, followed, probe, scenes};

const ROWS: usize = 4_000;

/// Column and row of the one pixel's picture, in [0, 1); metres.
type Row = [f32; 3];

const COLUMNS: &[(&str, usize)] = &[("picture", 2), ("clip depth", 1), ("viewer", 3), ("pixel_width", 1)];

const BODY: &str = "
    let ray = camera_ray(frame, vec2f(x[0], x[1]));
    let place = ray.origin + ray.direction * x[2];
    let clip = clip_from_world(frame, place);
    let at = clip.xy / clip.w;
    y[0] = 0.5 + 0.5 * at.x; y[1] = 0.5 - 0.5 * at.y; y[2] = clip.z / clip.w;
    let v = direction_to_viewer(frame, place);
    y[3] = v.x; y[4] = v.y; y[5] = v.z;
    y[6] = pixel_width(x[2]);";

#[test]
fn the_camera_is_that_of_the_cpu() {
    let Some(probe) = probe() else { return };
    let mut r = Random(41);
    let rows: Vec<Row> = (0..ROWS).map(|_| [r.unit(), r.unit(), 0.2 + 30.0 * r.unit()]).collect();
    let world_from_view = world_from_view_looking_at(Vec3::new(1.0, 2.0, -3.0), Vec3::new(0.2, 0.5, 0.1));
    let near = 0.125;
    for projection in [Projection::Perspective { fov_y: 1.1 }, Projection::Orthographic { half_height: 3.0 }] {
        let camera = Camera { world_from_view, projection, near };
        let scene = RenderScene { camera, ..scenes::glasses(1, 4) };
        let held = probe.hold(&scene, &followed(&scene, BlasKind::Bvh)).unwrap();
        // The orthographic depth ends behind the scene.
        let forward = -world_from_view.matrix3.z_axis;
        let corners = scene.bounds_world().corners();
        let far =
            1.01 * corners.iter().map(|c| forward.dot(*c - camera.world_from_view.translation)).fold(0.0, f32::max);
        let cone = PixelCone::of(&camera, 1);
        let allowed = |r: &Row| {
            // The place of the picture comes back; its ray is the CPU's.
            let ray = camera_ray(&camera, r[0] - 0.5, r[1] - 0.5, 1, 1);
            let along = (ray.origin + ray.direction * r[2] - world_from_view.translation).dot(forward);
            let depth = match projection {
                Projection::Perspective { .. } => near / along,
                Projection::Orthographic { .. } => (far - along) / (far - near),
            };
            let d = -ray.direction;
            let place = Vec2::new(r[0], r[1]);
            let ulp = f32::EPSILON;
            [
                Allowed::about(place.x, 16.0 * ulp),
                Allowed::about(place.y, 16.0 * ulp),
                Allowed::about(depth, 16.0 * ulp * depth.max(0.5)),
                // The place's rounding over the way to it.
                Allowed::about(d.x, 4e-6),
                Allowed::about(d.y, 4e-6),
                Allowed::about(d.z, 4e-6),
                Allowed::about(cone.at(r[2]), 8.0 * ulp * cone.at(r[2])),
            ]
        };
        let judge = |edits: &[(&str, &str)]| {
            let gpu: Vec<[f32; 7]> = held.evaluate(edits, BODY, &rows).unwrap();
            Verdict::of(COLUMNS, &gpu, |row| allowed(&rows[row]))
        };
        judge(&[]).agrees("camera");
        let orthographic = matches!(projection, Projection::Orthographic { .. });
        for (name, from, to) in [
            ("rows upside down", "(1.0 - 2.0 * position_pixel.y", "(2.0 * position_pixel.y - 1.0"),
            ("clip of the other axis", "let x = dot(frame.right_world, v)", "let x = dot(frame.up_world, v)"),
            (
                "clip depth",
                if orthographic { "(frame.far - z) / (frame.far - frame.near)" } else { "vec4f(x, y, frame.near, z)" },
                if orthographic { "(frame.far - z) / frame.far" } else { "vec4f(x, y, frame.far, z)" },
            ),
            (
                "towards the viewer",
                if orthographic { "return -frame.forward_world;" } else { "frame.eye_world - point_world," },
                if orthographic { "return frame.forward_world;" } else { "point_world - frame.eye_world," },
            ),
            ("half a pixel", "let pixel = 2.0 * frame.half_height", "let pixel = frame.half_height"),
        ] {
            judge(&[(from, to)]).fails("camera", name);
        }
    }
}
