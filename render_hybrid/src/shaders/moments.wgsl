// Shadow moments of the nearest surface per texel of one shadow view.
#import shared/scene
#import shared/moments

@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(3) var<storage, read> positions: array<f32>;
@group(0) @binding(5) var<storage, read> indices: array<u32>;
@group(0) @binding(8) var<storage, read> views: array<ShadowView>;

@group(1) @binding(0) var<uniform> pass_uniform: MomentsUniform;

struct Varyings {
    @builtin(position) position_clip: vec4f,
    @location(0) depth: f32,
}

@vertex
fn vertex(@builtin(vertex_index) corner: u32, @builtin(instance_index) instance_id: u32) -> Varyings {
    let instance = instances[instance_id];
    let at = 3u * (instance.first_vertex + indices[instance.first_index + corner]);
    let point_world =
        point_world_from_object(instance, vec3f(positions[at], positions[at + 1u], positions[at + 2u]));
    let seen = moments_vertex(views[pass_uniform.view], point_world);
    return Varyings(seen.position_clip, seen.depth);
}

@fragment
fn fragment(in: Varyings) -> @location(0) vec4f {
    return moments_of(pass_uniform.evsm, in.depth);
}
