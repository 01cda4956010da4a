// moments.wgsl for surfaces with holes. Twin: accel/cutout.rs, Cutouts::is_hole.
#import shared/scene
#import shared/moments
#import shared/cutout

@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> materials: array<Material>;
@group(0) @binding(3) var<storage, read> positions: array<f32>;
@group(0) @binding(4) var<storage, read> attributes: array<f32>;
@group(0) @binding(5) var<storage, read> indices: array<u32>;
@group(0) @binding(6) var<storage, read> texels: array<u32>;
@group(0) @binding(8) var<storage, read> views: array<ShadowView>;

@group(1) @binding(0) var<uniform> pass_uniform: MomentsUniform;

fn texel_at(i: u32) -> u32 {
    return texels[i];
}

struct Varyings {
    @builtin(position) position_clip: vec4f,
    @location(0) depth: f32,
    @location(1) uv: vec2f,
    @location(2) alpha: f32,
    @location(3) @interpolate(flat) material: u32,
}

@vertex
fn vertex(@builtin(vertex_index) corner: u32, @builtin(instance_index) instance_id: u32) -> Varyings {
    let instance = instances[instance_id];
    let vertex_id = instance.first_vertex + indices[instance.first_index + corner];
    let at = 3u * vertex_id;
    let point_world =
        point_world_from_object(instance, vec3f(positions[at], positions[at + 1u], positions[at + 2u]));
    let seen = moments_vertex(views[pass_uniform.view], point_world);
    let uv = cutout_uv(materials[instance.material], vertex_id);
    return Varyings(
        seen.position_clip,
        seen.depth,
        vec2f(attributes[uv], attributes[uv + 1u]),
        attributes[vertex_id * ATTRIBUTE_STRIDE + ATTRIBUTE_ALPHA],
        instance.material,
    );
}

@fragment
fn fragment(in: Varyings) -> @location(0) vec4f {
    if is_cut(materials[in.material], in.uv, in.alpha) {
        discard;
    }
    return moments_of(pass_uniform.evsm, in.depth);
}
