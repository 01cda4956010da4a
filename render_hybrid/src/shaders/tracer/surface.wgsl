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

fn sample_texture(r: TextureRef, uv: vec2f) -> vec4f {
    let srgb = (r.flags & TEXTURE_SRGB) != 0u;
    let f = texture_footprint(r, uv);
    let t = f.texels + r.first_texel;
    let top = texel_linear(t.x, srgb) * (1.0 - f.fraction.x) + texel_linear(t.y, srgb) * f.fraction.x;
    let bottom = texel_linear(t.z, srgb) * (1.0 - f.fraction.x) + texel_linear(t.w, srgb) * f.fraction.x;
    return top * (1.0 - f.fraction.y) + bottom * f.fraction.y;
}

fn textured(color: vec3f, r: TextureRef, uvs: vec4f) -> vec3f {
    if r.first_texel == NO_TEXTURE {
        return color;
    }
    return color * sample_texture(r, texture_coordinates(r, uvs)).xyz;
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
        alpha *= sample_texture(r, texture_coordinates(r, interpolated(vertices, VERTEX_UV, weights))).w;
    }
    return alpha < cutoff;
}

// The surface at weights `u` and `v` of a triangle, met by a ray along `direction`.
fn surface_at(direction: vec3f, hit: Hit) -> SurfacePoint {
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
    let uvs = interpolated(vertices, VERTEX_UV, weights);
    let map = read_texture_ref(m + 10u);
    if map.first_texel != NO_TEXTURE {
        let uv0 = texture_coordinates(map, bitcast<vec4f>(geometry_word(vertices.x + VERTEX_UV)));
        let uv1 = texture_coordinates(map, bitcast<vec4f>(geometry_word(vertices.y + VERTEX_UV)));
        let uv2 = texture_coordinates(map, bitcast<vec4f>(geometry_word(vertices.z + VERTEX_UV)));
        let frame_object = tangents(e1 * scale, e2 * scale, uv1 - uv0, uv2 - uv0);
        n_shading = perturbed_normal(
            n_shading,
            direction_world_from_object(instance, frame_object.along_u),
            direction_world_from_object(instance, frame_object.along_v),
            sample_texture(map, texture_coordinates(map, uvs)).xyz,
            bitcast<f32>(dynamic_word(m + 13u).x),
        );
    }
    if flipped {
        n_shading = -n_shading;
    }
    let base_color = textured(float3(dynamic_word(m)), read_texture_ref(m + 4u), uvs)
        * interpolated(vertices, VERTEX_COLOR, weights).xyz;
    var emission = textured(float3(dynamic_word(m + 2u)), read_texture_ref(m + 7u), uvs);
    if dynamic_word(m + 3u).z != 0u {
        emission += base_color;
    }
    return SurfacePoint(
        point_world, error, n_geometric, n_shading, base_color, emission, front, hit.instance);
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
