// Which triangle of which instance each pixel sees.
// Source: Burns & Hunt, "The Visibility Buffer", JCGT 2013.
#import shared/camera

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(3) var<storage, read> positions: array<f32>;
@group(0) @binding(5) var<storage, read> indices: array<u32>;

struct Varyings {
    @builtin(position) position_clip: vec4f,
    @location(0) @interpolate(flat) instance_id: u32,
    @location(1) @interpolate(flat) primitive_id: u32,
}

@vertex
fn vertex(@builtin(vertex_index) corner: u32, @builtin(instance_index) instance_id: u32) -> Varyings {
    let instance = instances[instance_id];
    let at = 3u * (instance.first_vertex + indices[instance.first_index + corner]);
    let point_world =
        point_world_from_object(instance, vec3f(positions[at], positions[at + 1u], positions[at + 2u]));
    return Varyings(clip_from_world(frame, point_world), instance_id, corner / 3u);
}

@fragment
fn fragment(in: Varyings) -> @location(0) vec2u {
    // 0 is the background.
    return vec2u(in.instance_id + 1u, in.primitive_id);
}
