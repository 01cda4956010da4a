// The scene as all passes see it. Layouts are held against raster/layouts.rs by its tests (name, offset, size).

// What seldom changes comes first: Mesa 22's lavapipe compiles kernels anew whenever a uniform's first word does.
struct Frame {
    orthographic: u32,
    light_count: u32,
    size: vec2u,
    eye_world: vec3f,
    near: f32,
    right_world: vec3f,
    half_width: f32,
    up_world: vec3f,
    half_height: f32,
    forward_world: vec3f,
    // Depth of the farthest surface along `forward_world`; used by orthographic views alone.
    far: f32,
    background: vec3f,
    unused0: u32,
    ambient: vec3f,
    unused1: u32,
}

struct Instance {
    // Rows of world_from_object.
    world_row0: vec4f,
    world_row1: vec4f,
    world_row2: vec4f,
    // Rows of the cofactor matrix with the determinant's sign.
    normal_row0: vec3f,
    first_index: u32,
    normal_row1: vec3f,
    first_vertex: u32,
    normal_row2: vec3f,
    material: u32,
}

struct TextureRef {
    // Rows of uv_transform.
    uv_row0: vec3f,
    width: u32,
    uv_row1: vec3f,
    height: u32,
    // First texel in the heap, or NO_TEXTURE; the smaller copies follow the image.
    first_texel: u32,
    wrap_u: u32,
    wrap_v: u32,
    // TEXTURE_NEAREST | TEXTURE_SRGB | TEXTURE_UV1 | TEXTURE_NEAREST_MIN | TEXTURE_MIP_NEAREST | TEXTURE_MIP_LINEAR
    flags: u32,
}

struct Material {
    base_color: vec3f,
    diffuse: f32,
    specular: vec3f,
    shininess: f32,
    emissive: vec3f,
    ambient: f32,
    mirror: f32,
    transmission: f32,
    unlit: u32,
    // 0: no holes.
    alpha_cutoff: f32,
    base_color_texture: TextureRef,
    emissive_texture: TextureRef,
    normal_texture: TextureRef,
    normal_scale: f32,
    alpha: f32,
    metallic: f32,
    roughness: f32,
    metallic_roughness_texture: TextureRef,
    transmission_texture: TextureRef,
    reflectance: vec3f,
    // PHYSICAL | PHYSICAL_BLENDED | PHYSICAL_REFLECTANCE | PHYSICAL_BY_REFLECTANCE; 0: the fields above the textures hold
    // everywhere.
    physical: u32,
    physical_transmission: f32,
    // Bit s: texture s of SLOT_* is there and read.
    texture_slots: u32,
    unused1: u32,
    unused2: u32,
    reflectance_texture: TextureRef,
    reflectance_strength_texture: TextureRef,
}

struct Light {
    position_world: vec3f,
    kind: u32,
    direction_world: vec3f,
    cos_inner: f32,
    intensity: vec3f,
    cos_outer: f32,
    first_view: u32,
    // 1, or 6 faces.
    view_count: u32,
    // Layer of the first view in its texture array.
    first_layer: u32,
    unused: u32,
}

fn point_world_from_object(instance: Instance, point_object: vec3f) -> vec3f {
    let p = vec4f(point_object, 1.0);
    return vec3f(dot(instance.world_row0, p), dot(instance.world_row1, p), dot(instance.world_row2, p));
}

fn direction_world_from_object(instance: Instance, direction_object: vec3f) -> vec3f {
    return vec3f(
        dot(instance.world_row0.xyz, direction_object),
        dot(instance.world_row1.xyz, direction_object),
        dot(instance.world_row2.xyz, direction_object),
    );
}

// Not normalised.
fn normal_world_from_object(instance: Instance, normal_object: vec3f) -> vec3f {
    return vec3f(
        dot(instance.normal_row0, normal_object),
        dot(instance.normal_row1, normal_object),
        dot(instance.normal_row2, normal_object),
    );
}

// `v` at unit length, or `fallback` where it has none.
fn normalize_or(v: vec3f, fallback: vec3f) -> vec3f {
    let length_squared = dot(v, v);
    if length_squared > 0.0 {
        return v * inverseSqrt(length_squared);
    }
    return fallback;
}
