// moments.wgsl for surfaces with holes. Twin: accel/cutout.rs, Cutouts::is_hole.
#import shared/scene
#import shared/shadow
#import shared/texture

@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> materials: array<Material>;
@group(0) @binding(3) var<storage, read> positions: array<f32>;
@group(0) @binding(4) var<storage, read> attributes: array<f32>;
@group(0) @binding(5) var<storage, read> indices: array<u32>;
@group(0) @binding(6) var<storage, read> texels: array<u32>;
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
    let view = views[pass_uniform.view];
    let v = point_world - view.origin_world;
    let z = dot(view.forward, v);
    let x = dot(view.right_scaled, v);
    let y = dot(view.up_scaled, v);
    var out: Varyings;
    out.depth = z / view.far;
    if view.perspective > 0.5 {
        out.position_clip = vec4f(x, y, view.far * SHADOW_NEAR_FRACTION, z);
    } else {
        out.position_clip = vec4f(x, y, 1.0 - out.depth, 1.0);
    }
    let a = vertex_id * ATTRIBUTE_STRIDE;
    let flags = materials[instance.material].base_color_texture.flags;
    let uv = a + select(ATTRIBUTE_UV0, ATTRIBUTE_UV1, (flags & TEXTURE_UV1) != 0u);
    out.uv = vec2f(attributes[uv], attributes[uv + 1u]);
    out.alpha = attributes[a + ATTRIBUTE_ALPHA];
    out.material = instance.material;
    return out;
}

@fragment
fn fragment(in: Varyings) -> @location(0) vec4f {
    let material = materials[in.material];
    var alpha = material.alpha * in.alpha;
    let r = material.base_color_texture;
    if r.first_texel != NO_TEXTURE {
        let f = texture_footprint(r, in.uv);
        let t = f.texels + r.first_texel;
        alpha *= filtered_alpha(vec4u(texels[t.x], texels[t.y], texels[t.z], texels[t.w]), f.fraction);
    }
    if alpha < material.alpha_cutoff {
        discard;
    }
    return moments_of(pass_uniform.evsm, in.depth);
}
