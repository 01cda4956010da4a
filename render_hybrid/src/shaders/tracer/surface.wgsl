// From a hit to everything that shading needs to know of the place. Twin: trace/surface.rs; shaders/gbuffer.wgsl has the
// same for pixels.

struct SurfacePoint {
    position_world: vec3f,
    // Secondary rays start this far off the surface, metres.
    error: f32,
    // Unit, on the viewer's side, both.
    n_geometric: vec3f,
    n_shading: vec3f,
    base_color: vec3f,
    emission: vec3f,
    // How the place splits light.
    look: Look,
    front: bool,
    instance: u32,
}

fn instance_at(instance: u32) -> u32 {
    return head.instances + instance * INSTANCE_WORDS;
}

fn material_at(instance: u32) -> u32 {
    return head.materials + dynamic_word(instance_at(instance) + 9u).w * MATERIAL_WORDS;
}

fn float3(w: vec4u) -> vec3f {
    return bitcast<vec3f>(w.xyz);
}

fn read_instance(instance: u32) -> Instance {
    let i = instance_at(instance);
    let n0 = dynamic_word(i + 7u);
    let n1 = dynamic_word(i + 8u);
    let n2 = dynamic_word(i + 9u);
    return Instance(
        bitcast<vec4f>(dynamic_word(i + 4u)),
        bitcast<vec4f>(dynamic_word(i + 5u)),
        bitcast<vec4f>(dynamic_word(i + 6u)),
        float3(n0),
        n0.w,
        float3(n1),
        n1.w,
        float3(n2),
        n2.w,
    );
}

fn read_texture_ref(at: u32) -> TextureRef {
    let a = dynamic_word(at);
    let b = dynamic_word(at + 1u);
    let c = dynamic_word(at + 2u);
    return TextureRef(float3(a), a.w, float3(b), b.w, c.x, c.y, c.z, c.w);
}

// The three vertices' first words in the geometry heap.
fn triangle_vertices(instance: Instance, primitive: u32) -> vec3u {
    let i = geometry_word(instance.first_index + primitive).xyz;
    return i * VERTEX_WORDS + instance.first_vertex;
}

fn interpolated(vertices: vec3u, word: u32, weights: vec3f) -> vec4f {
    return bitcast<vec4f>(geometry_word(vertices.x + word)) * weights.x
        + bitcast<vec4f>(geometry_word(vertices.y + word)) * weights.y
        + bitcast<vec4f>(geometry_word(vertices.z + word)) * weights.z;
}

fn texture_coordinates(r: TextureRef, both: vec4f) -> vec2f {
    return select(both.xy, both.zw, (r.flags & TEXTURE_UV1) != 0u);
}

fn texel_at(i: u32) -> u32 {
    let four = texel_word(i >> 2u);
    return select(select(four.x, four.y, (i & 1u) != 0u), select(four.z, four.w, (i & 1u) != 0u), (i & 2u) != 0u);
}

fn decode_channel(byte: u32, srgb: bool) -> f32 {
    if srgb {
        return srgb_table[byte >> 2u][byte & 3u];
    }
    return f32(byte) / 255.0;
}

// Linear RGB and alpha.
fn texel_linear(i: u32, srgb: bool) -> vec4f {
    let t = texel_at(i);
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

// Twin: engine/src/texture.rs, Texture::sample_lod. One loop over the one or two levels that are read.
fn sample_texture(r: TextureRef, uv: vec2f, wanted: f32) -> vec4f {
    var first = r;
    var second = r;
    var blend = 0.0;
    if wanted > 0.0 {
        let lod = min(wanted, f32(texture_last_level(r)));
        if (r.flags & TEXTURE_MIP_LINEAR) != 0u {
            let low = floor(lod);
            blend = lod - low;
            first = texture_level(r, u32(low));
            second = texture_level(r, u32(low) + 1u);
        } else {
            let level = select(0.0, floor(lod + 0.5), (r.flags & TEXTURE_MIP_NEAREST) != 0u);
            first = texture_level(r, u32(level));
        }
    }
    var sum = vec4f(0.0);
    for (var i = 0u; i < select(1u, 2u, blend > 0.0); i += 1u) {
        if i == 0u {
            sum += sample_level(first, uv) * (1.0 - blend);
        } else {
            sum += sample_level(second, uv) * blend;
        }
    }
    return sum;
}

// A place of a triangle, as far as textures need it.
struct Textured {
    vertices: vec3u,
    weights: vec3f,
    // Square metres of surface that the pixel covers; 0: full detail.
    footprint: f32,
    area_world: f32,
}

fn corner_uv(r: TextureRef, vertex: u32) -> vec2f {
    return texture_coordinates(r, bitcast<vec4f>(geometry_word(vertex + VERTEX_UV)));
}

// White where there is no texture.
fn textured(at: u32, seen: Textured) -> vec4f {
    let r = read_texture_ref(at);
    if r.first_texel == NO_TEXTURE {
        return vec4f(1.0);
    }
    let uv0 = corner_uv(r, seen.vertices.x);
    let uv1 = corner_uv(r, seen.vertices.y);
    let uv2 = corner_uv(r, seen.vertices.z);
    let d1 = uv1 - uv0;
    let d2 = uv2 - uv0;
    let per_area = abs(d1.x * d2.y - d1.y * d2.x) / max(seen.area_world, MIN_POSITIVE);
    let lod = texture_lod(r, per_area, seen.footprint);
    return sample_texture(r, uv0 * seen.weights.x + uv1 * seen.weights.y + uv2 * seen.weights.z, lod);
}

// Twin: accel/cutout.rs, Cutouts::is_hole.
fn is_hole(instance: u32, primitive: u32, u: f32, v: f32) -> bool {
    let own = read_instance(instance);
    let vertices = triangle_vertices(own, primitive);
    let weights = vec3f(1.0 - u - v, u, v);
    let m = material_at(instance);
    let factors = bitcast<vec4f>(dynamic_word(m + 13u));
    let cutoff = bitcast<f32>(dynamic_word(m + 3u).w);
    var alpha = factors.y * interpolated(vertices, VERTEX_POSITION, weights).w;
    let r = read_texture_ref(m + 4u);
    if r.first_texel != NO_TEXTURE {
        alpha *= sample_level(r, texture_coordinates(r, interpolated(vertices, VERTEX_UV, weights))).w;
    }
    return alpha < cutoff;
}

// The surface at weights `u` and `v` of a triangle, met by a ray along `direction`, seen by a pixel that is `pixel_width`
// metres wide there. Twin: surface_seen.
fn surface_at(direction: vec3f, hit: Hit, pixel_width: f32) -> SurfacePoint {
    let instance = read_instance(hit.instance);
    let vertices = triangle_vertices(instance, hit.primitive);
    let weights = vec3f(1.0 - hit.u - hit.v, hit.u, hit.v);
    let p0 = float3(geometry_word(vertices.x));
    let p1 = float3(geometry_word(vertices.y));
    let p2 = float3(geometry_word(vertices.z));
    let point_world = point_world_from_object(instance, p0 * weights.x + p1 * weights.y + p2 * weights.z);

    let reach = max(max(abs(p0), abs(p1)), abs(p2));
    let translation = vec3f(instance.world_row0.w, instance.world_row1.w, instance.world_row2.w);
    let terms = vec3f(
        dot(abs(instance.world_row0.xyz), reach),
        dot(abs(instance.world_row1.xyz), reach),
        dot(abs(instance.world_row2.xyz), reach),
    ) + abs(translation) + abs(point_world);
    let error = max(terms.x, max(terms.y, terms.z)) * SURFACE_ERROR;

    let e1 = p1 - p0;
    let e2 = p2 - p0;
    let largest = max(abs(e1), abs(e2));
    let edge = max(largest.x, max(largest.y, largest.z));
    let scale = select(1.0, 1.0 / edge, edge > 0.0);
    let outward = normalize_or(normal_world_from_object(instance, cross(e1 * scale, e2 * scale)), -direction);
    let front = dot(outward, direction) < 0.0;
    let n_geometric = select(-outward, outward, front);
    let normal_object = interpolated(vertices, VERTEX_NORMAL, weights).xyz;
    var n_shading = normalize_or(normal_world_from_object(instance, normal_object), n_geometric);
    let flipped = dot(n_shading, n_geometric) < 0.0;

    let m = material_at(hit.instance);
    let seen = Textured(
        vertices,
        weights,
        pixel_width * pixel_width / max(abs(dot(n_geometric, direction)), LEAST_COSINE),
        length(cross(direction_world_from_object(instance, e1), direction_world_from_object(instance, e2))),
    );
    let map = read_texture_ref(m + 10u);
    let factors = bitcast<vec4f>(dynamic_word(m + 13u));
    if map.first_texel != NO_TEXTURE {
        let uv0 = corner_uv(map, vertices.x);
        var frame_object =
            tangents(e1 * scale, e2 * scale, corner_uv(map, vertices.y) - uv0, corner_uv(map, vertices.z) - uv0);
        let tangent = interpolated(vertices, VERTEX_TANGENT, weights);
        if any(tangent.xyz != vec3f(0.0)) {
            frame_object = Tangents(tangent.xyz, -cross(normal_object, tangent.xyz) * tangent.w);
        }
        n_shading = perturbed_normal(
            n_shading,
            direction_world_from_object(instance, frame_object.along_u),
            direction_world_from_object(instance, frame_object.along_v),
            textured(m + 10u, seen).xyz,
            factors.x,
        );
    }
    if flipped {
        n_shading = -n_shading;
    }
    let texel = textured(m + 4u, seen);
    var base_color = float3(dynamic_word(m)) * texel.xyz * interpolated(vertices, VERTEX_COLOR, weights).xyz;
    var emission = float3(dynamic_word(m + 2u)) * textured(m + 7u, seen).xyz;
    let color = bitcast<vec4f>(dynamic_word(m));
    let shiny = bitcast<vec4f>(dynamic_word(m + 1u));
    let mask = dynamic_word(m + 3u);
    var look = Look(shiny.xyz, shiny.w, color.w, bitcast<f32>(mask.x), bitcast<f32>(mask.y));
    let physical = dynamic_word(m + 20u);
    if (physical.w & PHYSICAL) != 0u {
        let metal = textured(m + 14u, seen);
        let transmission = bitcast<f32>(dynamic_word(m + 21u).x) * textured(m + 17u, seen).x;
        var place = PhysicalPlace(factors.z * metal.z, factors.w * metal.y, transmission, 1.0);
        if (physical.w & PHYSICAL_BLENDED) != 0u {
            let alpha = interpolated(vertices, VERTEX_POSITION, weights).w;
            place.coverage = clamp(factors.y * texel.w * alpha, 0.0, 1.0);
        }
        var reflectance = float3(physical);
        if (physical.w & PHYSICAL_REFLECTANCE) != 0u {
            let sheen = textured(m + 24u, seen);
            reflectance *= sheen.xyz * textured(m + 27u, seen).w;
            if (physical.w & PHYSICAL_BY_REFLECTANCE) != 0u {
                place.roughness = 1.0 - (1.0 - place.roughness) * sheen.w;
            }
        }
        if (physical.w & PHYSICAL_BY_REFLECTANCE) != 0u {
            let metal_color = metal_of_reflectance(base_color, reflectance);
            base_color = metal_color.xyz;
            place.metallic = metal_color.w;
        }
        look = physical_look(reflectance, base_color, place);
        emission *= place.coverage;
        if mask.z != 0u {
            base_color *= place.coverage;
        }
    }
    if mask.z != 0u {
        emission += base_color;
    }
    return SurfacePoint(
        point_world, error, n_geometric, n_shading, base_color, emission, look, front, hit.instance);
}

// A start for rays that leave to the side of `direction`, clear of the surface itself.
fn offset_origin(s: SurfacePoint, direction: vec3f) -> vec3f {
    return s.position_world + s.n_geometric * select(-s.error, s.error, dot(s.n_geometric, direction) >= 0.0);
}

// The ray from here along unit `direction` that does not meet the surface itself again.
fn leaving_ray(s: SurfacePoint, direction: vec3f) -> Ray {
    let cos = abs(dot(s.n_geometric, direction));
    if cos >= GRAZING_COSINE {
        return Ray(s.position_world, s.error / cos, direction, FAR_AWAY);
    }
    return Ray(offset_origin(s, direction), 0.0, direction, FAR_AWAY);
}
