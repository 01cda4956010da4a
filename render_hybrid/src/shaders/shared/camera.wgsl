#import shared/scene

struct CameraRay {
    origin: vec3f,
    direction: vec3f,
}

// Ray through a picture position in pixels, (0, 0) = top left corner. Twin: engine/src/camera.rs, Camera::ray.
fn camera_ray(frame: Frame, position_pixel: vec2f) -> CameraRay {
    let sx = (2.0 * position_pixel.x / f32(frame.size.x) - 1.0) * frame.half_width;
    let sy = (1.0 - 2.0 * position_pixel.y / f32(frame.size.y)) * frame.half_height;
    let across = frame.right_world * sx + frame.up_world * sy;
    if frame.orthographic != 0u {
        return CameraRay(frame.eye_world + across, frame.forward_world);
    }
    return CameraRay(frame.eye_world, normalize(across + frame.forward_world));
}

// Clip position with reversed depth: 1 at the near plane, towards 0 far away. Perspective reaches to infinity.
fn clip_from_world(frame: Frame, point_world: vec3f) -> vec4f {
    let v = point_world - frame.eye_world;
    let x = dot(frame.right_world, v) / frame.half_width;
    let y = dot(frame.up_world, v) / frame.half_height;
    let z = dot(frame.forward_world, v);
    if frame.orthographic != 0u {
        return vec4f(x, y, (frame.far - z) / (frame.far - frame.near), 1.0);
    }
    return vec4f(x, y, frame.near, z);
}

// Unit direction from a surface to the viewer.
fn direction_to_viewer(frame: Frame, point_world: vec3f) -> vec3f {
    if frame.orthographic != 0u {
        return -frame.forward_world;
    }
    return normalize_or(frame.eye_world - point_world, -frame.forward_world);
}
