// From the visible triangle to the surface: place, normals, base colour with the material mask's bit, emitted radiance.
// Twin: trace/surface.rs, surface_at.
#import shared/camera
#import shared/triangle
#import shared/octahedral
#import shared/texture

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> materials: array<Material>;
@group(0) @binding(3) var<storage, read> positions: array<f32>;
@group(0) @binding(4) var<storage, read> attributes: array<f32>;
@group(0) @binding(5) var<storage, read> indices: array<u32>;
@group(0) @binding(6) var<storage, read> texels: array<u32>;
@group(0) @binding(9) var<uniform> srgb_table: array<vec4f, 64>;

@group(1) @binding(0) var visibility: texture_2d<u32>;
// xyz: world space, w: material + 1, 0 where nothing was met.
@group(1) @binding(1) var out_position: texture_storage_2d<rgba32float, write>;
// Geometric and shading normal, octahedral.
@group(1) @binding(2) var out_normals: texture_storage_2d<rgba32float, write>;
// rgb: base colour, w: 1 where the tracer has work.
@group(1) @binding(3) var out_base_color: texture_storage_2d<rgba32float, write>;
// rgb: emitted radiance, or the background.
@group(1) @binding(4) var out_emission: texture_storage_2d<rgba32float, write>;

fn position_object(vertex: u32) -> vec3f {
    let at = 3u * vertex;
    return vec3f(positions[at], positions[at + 1u], positions[at + 2u]);
}

fn attribute3(vertices: vec3u, offset: u32, weights: vec3f) -> vec3f {
    let a = vertices * ATTRIBUTE_STRIDE + offset;
    return vec3f(attributes[a.x], attributes[a.x + 1u], attributes[a.x + 2u]) * weights.x
        + vec3f(attributes[a.y], attributes[a.y + 1u], attributes[a.y + 2u]) * weights.y
        + vec3f(attributes[a.z], attributes[a.z + 1u], attributes[a.z + 2u]) * weights.z;
}

fn attribute2(vertices: vec3u, offset: u32, weights: vec3f) -> vec2f {
    let a = vertices * ATTRIBUTE_STRIDE + offset;
    return vec2f(attributes[a.x], attributes[a.x + 1u]) * weights.x
        + vec2f(attributes[a.y], attributes[a.y + 1u]) * weights.y
        + vec2f(attributes[a.z], attributes[a.z + 1u]) * weights.z;
}

fn decode_channel(byte: u32, srgb: bool) -> f32 {
    if srgb {
        // The CPU's own table: both lanes decode to the same bits.
        return srgb_table[byte >> 2u][byte & 3u];
    }
    return f32(byte) / 255.0;
}

fn texel_linear(index: u32, srgb: bool) -> vec3f {
    let t = texels[index];
    return vec3f(
        decode_channel(t & 255u, srgb),
        decode_channel((t >> 8u) & 255u, srgb),
        decode_channel((t >> 16u) & 255u, srgb),
    );
}

fn sample_texture(r: TextureRef, uv: vec2f) -> vec3f {
    let srgb = (r.flags & TEXTURE_SRGB) != 0u;
    let f = texture_footprint(r, uv);
    let t = f.texels + r.first_texel;
    let top = texel_linear(t.x, srgb) * (1.0 - f.fraction.x) + texel_linear(t.y, srgb) * f.fraction.x;
    let bottom = texel_linear(t.z, srgb) * (1.0 - f.fraction.x) + texel_linear(t.w, srgb) * f.fraction.x;
    return top * (1.0 - f.fraction.y) + bottom * f.fraction.y;
}

fn textured(color: vec3f, r: TextureRef, vertices: vec3u, weights: vec3f) -> vec3f {
    if r.first_texel == NO_TEXTURE {
        return color;
    }
    let offset = select(ATTRIBUTE_UV0, ATTRIBUTE_UV1, (r.flags & TEXTURE_UV1) != 0u);
    return color * sample_texture(r, attribute2(vertices, offset, weights));
}

@compute @workgroup_size(8, 8)
fn resolve(@builtin(global_invocation_id) id: vec3u) {
    if any(id.xy >= frame.size) {
        return;
    }
    let seen = textureLoad(visibility, id.xy, 0).xy;
    if seen.x == 0u {
        textureStore(out_position, id.xy, vec4f(0.0));
        textureStore(out_normals, id.xy, vec4f(0.0));
        textureStore(out_base_color, id.xy, vec4f(0.0));
        textureStore(out_emission, id.xy, vec4f(frame.background, 0.0));
        return;
    }
    let instance = instances[seen.x - 1u];
    let first = instance.first_index + 3u * seen.y;
    let vertices = vec3u(indices[first], indices[first + 1u], indices[first + 2u]) + instance.first_vertex;
    let p0 = position_object(vertices.x);
    let p1 = position_object(vertices.y);
    let p2 = position_object(vertices.z);

    // Meet the triangle with the ray through the pixel's centre.
    let ray = camera_ray(frame, vec2f(id.xy) + 0.5);
    let uv = plane_barycentrics(
        ray.origin,
        ray.direction,
        point_world_from_object(instance, p0),
        point_world_from_object(instance, p1),
        point_world_from_object(instance, p2),
    );
    let weights = vec3f(1.0 - uv.x - uv.y, uv.x, uv.y);
    let point_world = point_world_from_object(instance, p0 * weights.x + p1 * weights.y + p2 * weights.z);

    // Both normals on the viewer's side.
    let e1 = p1 - p0;
    let e2 = p2 - p0;
    let largest = max(abs(e1), abs(e2));
    let edge = max(largest.x, max(largest.y, largest.z));
    let scale = select(1.0, 1.0 / edge, edge > 0.0);
    let outward = normalize_or(normal_world_from_object(instance, cross(e1 * scale, e2 * scale)), -ray.direction);
    let n_geometric = select(-outward, outward, dot(outward, ray.direction) < 0.0);
    let interpolated = normal_world_from_object(instance, attribute3(vertices, ATTRIBUTE_NORMAL, weights));
    var n_shading = normalize_or(interpolated, n_geometric);
    let flipped = dot(n_shading, n_geometric) < 0.0;
    let material = materials[instance.material];
    let map = material.normal_texture;
    if map.first_texel != NO_TEXTURE {
        let offset = select(ATTRIBUTE_UV0, ATTRIBUTE_UV1, (map.flags & TEXTURE_UV1) != 0u);
        let uv0 = attribute2(vertices, offset, vec3f(1.0, 0.0, 0.0));
        let duv1 = attribute2(vertices, offset, vec3f(0.0, 1.0, 0.0)) - uv0;
        let duv2 = attribute2(vertices, offset, vec3f(0.0, 0.0, 1.0)) - uv0;
        let frame_object = tangents(e1 * scale, e2 * scale, duv1, duv2);
        let texel = sample_texture(map, attribute2(vertices, offset, weights));
        n_shading = perturbed_normal(
            n_shading,
            direction_world_from_object(instance, frame_object.along_u),
            direction_world_from_object(instance, frame_object.along_v),
            texel,
            material.normal_scale,
        );
    }
    if flipped {
        n_shading = -n_shading;
    }

    let base_color = textured(material.base_color, material.base_color_texture, vertices, weights)
        * attribute3(vertices, ATTRIBUTE_COLOR, weights);
    var emission = textured(material.emissive, material.emissive_texture, vertices, weights);
    if material.unlit != 0u {
        emission += base_color;
    }
    let traced = material.mirror > 0.0 || material.transmission > 0.0;
    textureStore(out_position, id.xy, vec4f(point_world, f32(instance.material + 1u)));
    textureStore(out_normals, id.xy, vec4f(octahedral_encode(n_geometric), octahedral_encode(n_shading)));
    textureStore(out_base_color, id.xy, vec4f(base_color, f32(traced)));
    textureStore(out_emission, id.xy, vec4f(emission, 0.0));
}
