// From the visible triangle to the surface: place, normals, base colour with the material mask's bit, emitted radiance.
// Twin: trace/surface.rs, surface_at.
#import shared/camera
#import shared/triangle
#import shared/octahedral
#import shared/texture
#import shared/look

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
// rgb: base colour, w: pack_place, over 0.5 where the tracer has work.
@group(1) @binding(3) var out_base_color: texture_storage_2d<rgba32float, write>;
// rgb: emitted radiance, or the background; w: pack_reflectance.
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

fn texel_linear(index: u32, srgb: bool) -> vec4f {
    let t = texels[index];
    return vec4f(
        decode_channel(t & 255u, srgb),
        decode_channel((t >> 8u) & 255u, srgb),
        decode_channel((t >> 16u) & 255u, srgb),
        f32(t >> 24u) / 255.0,
    );
}

fn sample_level(r: TextureRef, uv: vec2f) -> vec4f {
    let srgb = (r.flags & TEXTURE_SRGB) != 0u;
    let f = texture_footprint(r, uv);
    let t = f.texels + r.first_texel;
    let top = texel_linear(t.x, srgb) * (1.0 - f.fraction.x) + texel_linear(t.y, srgb) * f.fraction.x;
    let bottom = texel_linear(t.z, srgb) * (1.0 - f.fraction.x) + texel_linear(t.w, srgb) * f.fraction.x;
    return top * (1.0 - f.fraction.y) + bottom * f.fraction.y;
}

// Twin: engine/src/texture.rs, Texture::sample_lod.
fn sample_texture(r: TextureRef, uv: vec2f, wanted: f32) -> vec4f {
    if wanted <= 0.0 {
        return sample_level(r, uv);
    }
    let lod = min(wanted, f32(texture_last_level(r)));
    if (r.flags & TEXTURE_MIP_LINEAR) != 0u {
        let low = floor(lod);
        let fine = sample_level(texture_level(r, u32(low)), uv);
        if lod == low {
            return fine;
        }
        return fine * (1.0 - (lod - low)) + sample_level(texture_level(r, u32(low) + 1u), uv) * (lod - low);
    }
    let level = select(0.0, floor(lod + 0.5), (r.flags & TEXTURE_MIP_NEAREST) != 0u);
    return sample_level(texture_level(r, u32(level)), uv);
}

// Where a pixel meets a triangle, as far as textures need it.
struct Seen {
    vertices: vec3u,
    weights: vec3f,
    // Square metres of surface that the pixel covers.
    footprint: f32,
    area_world: f32,
}

fn uv_offset(r: TextureRef) -> u32 {
    return select(ATTRIBUTE_UV0, ATTRIBUTE_UV1, (r.flags & TEXTURE_UV1) != 0u);
}

// White where there is no texture.
fn textured(r: TextureRef, seen: Seen) -> vec4f {
    if r.first_texel == NO_TEXTURE {
        return vec4f(1.0);
    }
    let offset = uv_offset(r);
    let uv0 = attribute2(seen.vertices, offset, vec3f(1.0, 0.0, 0.0));
    let d1 = attribute2(seen.vertices, offset, vec3f(0.0, 1.0, 0.0)) - uv0;
    let d2 = attribute2(seen.vertices, offset, vec3f(0.0, 0.0, 1.0)) - uv0;
    let per_area = abs(d1.x * d2.y - d1.y * d2.x) / max(seen.area_world, MIN_POSITIVE);
    let lod = texture_lod(r, per_area, seen.footprint);
    return sample_texture(r, attribute2(seen.vertices, offset, seen.weights), lod);
}

// Twin: trace/surface.rs, PixelCone.
fn pixel_width(distance: f32) -> f32 {
    let pixel = 2.0 * frame.half_height / f32(frame.size.y);
    return select(pixel * distance, pixel, frame.orthographic != 0u);
}

@compute @workgroup_size(8, 8)
fn resolve(@builtin(global_invocation_id) id: vec3u) {
    if any(id.xy >= frame.size) {
        return;
    }
    let visible = textureLoad(visibility, id.xy, 0).xy;
    if visible.x == 0u {
        textureStore(out_position, id.xy, vec4f(0.0));
        textureStore(out_normals, id.xy, vec4f(0.0));
        textureStore(out_base_color, id.xy, vec4f(0.0));
        textureStore(out_emission, id.xy, vec4f(frame.background, 0.0));
        return;
    }
    let instance = instances[visible.x - 1u];
    let first = instance.first_index + 3u * visible.y;
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
    let width = pixel_width(distance(ray.origin, point_world));
    let seen = Seen(
        vertices,
        weights,
        width * width / max(abs(dot(n_geometric, ray.direction)), 1e-3),
        length(cross(direction_world_from_object(instance, e1), direction_world_from_object(instance, e2))),
    );
    let map = material.normal_texture;
    if map.first_texel != NO_TEXTURE {
        let offset = uv_offset(map);
        let uv0 = attribute2(vertices, offset, vec3f(1.0, 0.0, 0.0));
        let duv1 = attribute2(vertices, offset, vec3f(0.0, 1.0, 0.0)) - uv0;
        let duv2 = attribute2(vertices, offset, vec3f(0.0, 0.0, 1.0)) - uv0;
        var frame_object = tangents(e1 * scale, e2 * scale, duv1, duv2);
        let tangent = attribute3(vertices, ATTRIBUTE_TANGENT, weights);
        if any(tangent != vec3f(0.0)) {
            let handedness = dot(weights, vec3f(
                attributes[vertices.x * ATTRIBUTE_STRIDE + ATTRIBUTE_HANDEDNESS],
                attributes[vertices.y * ATTRIBUTE_STRIDE + ATTRIBUTE_HANDEDNESS],
                attributes[vertices.z * ATTRIBUTE_STRIDE + ATTRIBUTE_HANDEDNESS],
            ));
            let normal_object = attribute3(vertices, ATTRIBUTE_NORMAL, weights);
            frame_object = Tangents(tangent, -cross(normal_object, tangent) * handedness);
        }
        n_shading = perturbed_normal(
            n_shading,
            direction_world_from_object(instance, frame_object.along_u),
            direction_world_from_object(instance, frame_object.along_v),
            textured(map, seen).xyz,
            material.normal_scale,
        );
    }
    if flipped {
        n_shading = -n_shading;
    }

    let texel = textured(material.base_color_texture, seen);
    var base_color = material.base_color * texel.xyz * attribute3(vertices, ATTRIBUTE_COLOR, weights);
    var emission = material.emissive * textured(material.emissive_texture, seen).xyz;
    var place = PhysicalPlace(0.0, 0.0, 0.0, 1.0);
    var reflectance = material.reflectance;
    var look = Look(vec3f(0.0), 0.0, 1.0, material.mirror, material.transmission);
    if (material.physical & PHYSICAL) != 0u {
        let metal = textured(material.metallic_roughness_texture, seen);
        place.metallic = material.metallic * metal.z;
        place.roughness = material.roughness * metal.y;
        place.transmission = material.physical_transmission * textured(material.transmission_texture, seen).x;
        if (material.physical & PHYSICAL_BLENDED) != 0u {
            let alpha = vec3f(
                attributes[vertices.x * ATTRIBUTE_STRIDE + ATTRIBUTE_ALPHA],
                attributes[vertices.y * ATTRIBUTE_STRIDE + ATTRIBUTE_ALPHA],
                attributes[vertices.z * ATTRIBUTE_STRIDE + ATTRIBUTE_ALPHA],
            );
            place.coverage = clamp(material.alpha * texel.w * dot(weights, alpha), 0.0, 1.0);
        }
        if (material.physical & PHYSICAL_REFLECTANCE) != 0u {
            let sheen = textured(material.reflectance_texture, seen);
            reflectance *= sheen.xyz * textured(material.reflectance_strength_texture, seen).w;
            if (material.physical & PHYSICAL_BY_REFLECTANCE) != 0u {
                place.roughness = 1.0 - (1.0 - place.roughness) * sheen.w;
            }
        }
        if (material.physical & PHYSICAL_BY_REFLECTANCE) != 0u {
            let metal_color = metal_of_reflectance(base_color, reflectance);
            base_color = metal_color.xyz;
            place.metallic = metal_color.w;
        }
        look = physical_look(reflectance, base_color, place);
        emission *= place.coverage;
        if material.unlit != 0u {
            base_color *= place.coverage;
        }
    }
    if material.unlit != 0u {
        emission += base_color;
    }
    let traced = look.mirror > 0.0 || look.transmission > 0.0;
    textureStore(out_position, id.xy, vec4f(point_world, f32(instance.material + 1u)));
    textureStore(out_normals, id.xy, vec4f(octahedral_encode(n_geometric), octahedral_encode(n_shading)));
    textureStore(out_base_color, id.xy, vec4f(base_color, pack_place(place, traced)));
    textureStore(out_emission, id.xy, vec4f(emission, pack_reflectance(reflectance)));
}
