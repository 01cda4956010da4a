// From the visible triangle to the surface: place, normals, base colour with the material mask's bit, emitted radiance.
// Twin: trace/surface.rs, surface_at.
#import shared/camera
#import shared/triangle
#import shared/octahedral
#import shared/sample
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

fn texel_at(i: u32) -> u32 {
    return texels[i];
}

fn srgb_value(byte: u32) -> f32 {
    return srgb_table[byte >> 2u][byte & 3u];
}

fn material_texture(material: u32, slot: u32) -> TextureRef {
    switch slot {
        case SLOT_BASE_COLOR: {
            return materials[material].base_color_texture;
        }
        case SLOT_EMISSIVE: {
            return materials[material].emissive_texture;
        }
        case SLOT_NORMAL: {
            return materials[material].normal_texture;
        }
        case SLOT_METALLIC_ROUGHNESS: {
            return materials[material].metallic_roughness_texture;
        }
        case SLOT_TRANSMISSION: {
            return materials[material].transmission_texture;
        }
        case SLOT_REFLECTANCE: {
            return materials[material].reflectance_texture;
        }
        default: {
            return materials[material].reflectance_strength_texture;
        }
    }
}

fn corner_uv(r: TextureRef, vertex: u32) -> vec2f {
    let at = vertex * ATTRIBUTE_STRIDE + select(ATTRIBUTE_UV0, ATTRIBUTE_UV1, (r.flags & TEXTURE_UV1) != 0u);
    return vec2f(attributes[at], attributes[at + 1u]);
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
    let seen = Textured(
        vertices,
        weights,
        width * width / max(abs(dot(n_geometric, ray.direction)), 1e-3),
        length(cross(direction_world_from_object(instance, e1), direction_world_from_object(instance, e2))),
    );
    let texel = surface_texels(instance.material, material.texture_slots, seen);
    if (material.texture_slots & (1u << SLOT_NORMAL)) != 0u {
        var frame_object = tangents(e1 * scale, e2 * scale, texel.normal_duv1, texel.normal_duv2);
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
            texel.normal,
            material.normal_scale,
        );
    }
    if flipped {
        n_shading = -n_shading;
    }

    var base_color = material.base_color * texel.base_color.xyz * attribute3(vertices, ATTRIBUTE_COLOR, weights);
    var emission = material.emissive * texel.emissive;
    var place = PhysicalPlace(0.0, 0.0, 0.0, 1.0);
    var reflectance = material.reflectance;
    var look = Look(vec3f(0.0), 0.0, 1.0, material.mirror, material.transmission);
    if (material.physical & PHYSICAL) != 0u {
        place.metallic = material.metallic * texel.metallic_roughness.z;
        place.roughness = material.roughness * texel.metallic_roughness.y;
        place.transmission = material.physical_transmission * texel.transmission;
        if (material.physical & PHYSICAL_BLENDED) != 0u {
            let alpha = vec3f(
                attributes[vertices.x * ATTRIBUTE_STRIDE + ATTRIBUTE_ALPHA],
                attributes[vertices.y * ATTRIBUTE_STRIDE + ATTRIBUTE_ALPHA],
                attributes[vertices.z * ATTRIBUTE_STRIDE + ATTRIBUTE_ALPHA],
            );
            place.coverage = clamp(material.alpha * texel.base_color.w * dot(weights, alpha), 0.0, 1.0);
        }
        let shine = vec4f(texel.reflectance.xyz * texel.reflectance_strength, texel.reflectance.w);
        reflectance = reflectance_at(material.physical, reflectance, shine, &base_color, &place);
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
