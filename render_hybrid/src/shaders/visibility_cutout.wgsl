// visibility.wgsl for surfaces with holes. Twin: accel/cutout.rs, Cutouts::is_hole.
#import shared/camera
#import shared/cutout

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> materials: array<Material>;
@group(0) @binding(3) var<storage, read> positions: array<f32>;
@group(0) @binding(4) var<storage, read> attributes: array<f32>;
@group(0) @binding(5) var<storage, read> indices: array<u32>;
@group(0) @binding(6) var<storage, read> texels: array<u32>;

fn texel_at(i: u32) -> u32 {
    return texels[i];
}

struct Varyings {
    @builtin(position) position_clip: vec4f,
    @location(0) @interpolate(flat) instance_id: u32,
    @location(1) @interpolate(flat) primitive_id: u32,
    @location(2) uv: vec2f,
    @location(3) alpha: f32,
}

@vertex
fn vertex(@builtin(vertex_index) corner: u32, @builtin(instance_index) instance_id: u32) -> Varyings {
    let instance = instances[instance_id];
    let vertex_id = instance.first_vertex + indices[instance.first_index + corner];
    let at = 3u * vertex_id;
    let point_world =
        point_world_from_object(instance, vec3f(positions[at], positions[at + 1u], positions[at + 2u]));
    let uv = cutout_uv(materials[instance.material], vertex_id);
    return Varyings(
        clip_from_world(frame, point_world),
        instance_id,
        corner / 3u,
        vec2f(attributes[uv], attributes[uv + 1u]),
        attributes[vertex_id * ATTRIBUTE_STRIDE + ATTRIBUTE_ALPHA],
    );
}

@fragment
fn fragment(in: Varyings) -> @location(0) vec2u {
    if is_cut(materials[instances[in.instance_id].material], in.uv, in.alpha) {
        discard;
    }
    return vec2u(in.instance_id + 1u, in.primitive_id);
}
