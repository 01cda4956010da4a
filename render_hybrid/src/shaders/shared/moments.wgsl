// What both passes of shadow moments share: the view's number and where it sees a point.
#import shared/shadow

struct MomentsUniform {
    view: u32,
    // Texels hold both exponential warps and their squares, else depth and its square.
    evsm: u32,
    unused1: u32,
    unused2: u32,
}

// Clip position, and linear depth / far: a linear function of the place, so perspective-correct interpolation keeps it exact.
struct MomentsVertex {
    position_clip: vec4f,
    depth: f32,
}

fn moments_vertex(view: ShadowView, point_world: vec3f) -> MomentsVertex {
    let v = point_world - view.origin_world;
    let z = dot(view.forward, v);
    let x = dot(view.right_scaled, v);
    let y = dot(view.up_scaled, v);
    let depth = z / view.far;
    // Reversed depth in floating point: precise at any distance.
    if view.perspective > 0.5 {
        return MomentsVertex(vec4f(x, y, view.far * SHADOW_NEAR_FRACTION, z), depth);
    }
    return MomentsVertex(vec4f(x, y, 1.0 - depth, 1.0), depth);
}
