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

fn srgb_value(byte: u32) -> f32 {
    return srgb_table[byte >> 2u][byte & 3u];
}

// `material`: its first word. Three words a texture, factors after the third, all else after the fifth.
fn material_texture(material: u32, slot: u32) -> TextureRef {
    let behind = u32(slot > SLOT_NORMAL) + 4u * u32(slot > SLOT_TRANSMISSION);
    return read_texture_ref(material + 4u + 3u * slot + behind);
}

fn corner_uv(r: TextureRef, vertex: u32) -> vec2f {
    return texture_coordinates(r, bitcast<vec4f>(geometry_word(vertex + VERTEX_UV)));
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
        alpha *= sample_alpha(r, texture_coordinates(r, interpolated(vertices, VERTEX_UV, weights)));
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
    let factors = bitcast<vec4f>(dynamic_word(m + 13u));
    let slots = dynamic_word(m + 21u).y;
    let texel = surface_texels(m, slots, seen);
    if (slots & (1u << SLOT_NORMAL)) != 0u {
        var frame_object = tangents(e1 * scale, e2 * scale, texel.normal_duv1, texel.normal_duv2);
        let tangent = interpolated(vertices, VERTEX_TANGENT, weights);
        if any(tangent.xyz != vec3f(0.0)) {
            frame_object = Tangents(tangent.xyz, -cross(normal_object, tangent.xyz) * tangent.w);
        }
        n_shading = perturbed_normal(
            n_shading,
            direction_world_from_object(instance, frame_object.along_u),
            direction_world_from_object(instance, frame_object.along_v),
            texel.normal,
            factors.x,
        );
    }
    if flipped {
        n_shading = -n_shading;
    }
    var base_color = float3(dynamic_word(m)) * texel.base_color.xyz * interpolated(vertices, VERTEX_COLOR, weights).xyz;
    var emission = float3(dynamic_word(m + 2u)) * texel.emissive;
    let color = bitcast<vec4f>(dynamic_word(m));
    let shiny = bitcast<vec4f>(dynamic_word(m + 1u));
    let mask = dynamic_word(m + 3u);
    var look = Look(shiny.xyz, shiny.w, color.w, bitcast<f32>(mask.x), bitcast<f32>(mask.y));
    let physical = dynamic_word(m + 20u);
    if (physical.w & PHYSICAL) != 0u {
        let transmission = bitcast<f32>(dynamic_word(m + 21u).x) * texel.transmission;
        var place = PhysicalPlace(factors.z * texel.metallic_roughness.z, factors.w * texel.metallic_roughness.y, transmission, 1.0);
        if (physical.w & PHYSICAL_BLENDED) != 0u {
            let alpha = interpolated(vertices, VERTEX_POSITION, weights).w;
            place.coverage = clamp(factors.y * texel.base_color.w * alpha, 0.0, 1.0);
        }
        let shine = vec4f(texel.reflectance.xyz * texel.reflectance_strength, texel.reflectance.w);
        let reflectance = reflectance_at(physical.w, float3(physical), shine, &base_color, &place);
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
