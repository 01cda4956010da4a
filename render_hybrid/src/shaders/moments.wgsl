// Shadow moments of the nearest surface per texel of one shadow view.
#import shared/scene
#import shared/shadow

@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(3) var<storage, read> positions: array<f32>;
@group(0) @binding(5) var<storage, read> indices: array<u32>;
@group(0) @binding(8) var<storage, read> views: array<ShadowView>;

struct MomentsUniform {
    view: u32,
    // Texels hold both exponential warps and their squares, else depth and its square.
    evsm: u32,
    unused1: u32,
    unused2: u32,
}
@group(1) @binding(0) var<uniform> pass_uniform: MomentsUniform;

struct Varyings {
    @builtin(position) position_clip: vec4f,
    // Linear depth / far: a linear function of the place, so perspective-correct interpolation keeps it exact.
    @location(0) depth: f32,
}

@vertex
fn vertex(@builtin(vertex_index) corner: u32, @builtin(instance_index) instance_id: u32) -> Varyings {
    let instance = instances[instance_id];
    let at = 3u * (instance.first_vertex + indices[instance.first_index + corner]);
    let point_world =
        point_world_from_object(instance, vec3f(positions[at], positions[at + 1u], positions[at + 2u]));
    let view = views[pass_uniform.view];
    let v = point_world - view.origin_world;
    let z = dot(view.forward, v);
    let x = dot(view.right_scaled, v);
    let y = dot(view.up_scaled, v);
    var out: Varyings;
    out.depth = z / view.far;
    // Reversed depth in floating point: precise at any distance.
    if view.perspective > 0.5 {
        out.position_clip = vec4f(x, y, view.far * SHADOW_NEAR_FRACTION, z);
    } else {
        out.position_clip = vec4f(x, y, 1.0 - out.depth, 1.0);
    }
    return out;
}

@fragment
fn fragment(in: Varyings) -> @location(0) vec4f {
    return moments_of(pass_uniform.evsm, in.depth);
}
