// Light paths: each invocation follows one, and each of its diffuse reflections is a VPL. Starts and sample points come from
// the CPU once; a light that moves sends its frame. Twins: trace/photons.rs, trace/emission.rs.
#import tracer/scene
#import tracer/hits
#import shared/sampling

struct PhotonUniform {
    paths: u32,
    bounces: u32,
    slots_a_path: u32,
    // First word of the sample points: points of the unit disc, one a bounce of each path number.
    samples: u32,
    // First word of the paths' starts.
    starts: u32,
    unused0: u32,
    unused1: u32,
    unused2: u32,
}
@group(1) @binding(0) var<uniform> photons: PhotonUniform;
// SOURCE_WORDS a source: origin and scale, axes of its frame, in the fourth channels of which its flux lies. Then PATH_WORDS a
// path, in the frame of its source: origin and least distance; direction and number; flux and whether a VPL stands at the
// start; that VPL, with the source's number.
@group(1) @binding(1) var<storage, read> inputs: array<vec4u>;
// VPLs of SLOT_WORDS: place and error, normal, flux. In the fourth channels of a path's first slot: its rays, and whether
// a walk met its cap.
@group(1) @binding(2) var<storage, read_write> slots: array<vec4u>;

// Twin: trace/sampling.rs, cosine_direction.
fn cosine_direction(n: vec3f, disc: vec2f) -> vec3f {
    let basis = orthonormal_basis(n);
    let z = sqrt(max(1.0 - dot(disc, disc), 0.0));
    return normalize_or(basis[0] * disc.x + basis[1] * disc.y + n * z, n);
}

fn put(slot: u32, position_world: vec3f, error: f32, normal_world: vec3f, flux: vec3f) {
    let at = slot * SLOT_WORDS;
    slots[at] = bitcast<vec4u>(vec4f(position_world, error));
    slots[at + 1u] = vec4u(bitcast<vec3u>(normal_world), 0u);
    slots[at + 2u] = vec4u(bitcast<vec3u>(flux), 0u);
}

@compute @workgroup_size(TRACE_GROUP)
fn trace_photons(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let path = (group.y * groups.x + group.x) * TRACE_GROUP + lane;
    if path >= photons.paths {
        return;
    }
    let at = photons.starts + path * PATH_WORDS;
    let start = bitcast<vec4f>(inputs[at]);
    let along = inputs[at + 1u];
    let carried = inputs[at + 2u];
    let source = inputs[at + 4u].w * SOURCE_WORDS;
    let place = bitcast<vec4f>(inputs[source]);
    let x = bitcast<vec4f>(inputs[source + 1u]);
    let y = bitcast<vec4f>(inputs[source + 2u]);
    let z = bitcast<vec4f>(inputs[source + 3u]);
    let d = bitcast<vec3f>(along.xyz);
    let origin = (x.xyz * start.x + y.xyz * start.y + z.xyz * start.z) * place.w + place.xyz;
    var ray = Ray(origin, start.w, x.xyz * d.x + y.xyz * d.y + z.xyz * d.z, FAR_AWAY);
    var flux = bitcast<vec3f>(carried.xyz) * vec3f(x.w, y.w, z.w);
    let first = path * photons.slots_a_path;
    var used = 0u;
    if carried.w != 0u {
        let own = bitcast<vec4f>(inputs[at + 3u]);
        put(first, own.xyz, own.w, float3(inputs[at + 4u]), float3(inputs[at + 5u]));
        used = 1u;
    }
    var rays = 0u;
    for (var bounce = 0u; bounce < photons.bounces; bounce += 1u) {
        if !any(flux != vec3f(0.0)) {
            break;
        }
        rays += 1u;
        let hit = closest_hit(ray);
        if hit.instance == NONE {
            break;
        }
        let s = surface_at(ray.direction, hit, 0.0);
        // Mirror and glass end the photon; a mixed material reflects its matte share diffusely.
        let unlit = dynamic_word(material_at(s.instance) + 3u).z != 0u;
        flux *= select(s.base_color * (s.look.diffuse * matte_weight(s.look)), vec3f(0.0), unlit);
        put(first + used, s.position_world, s.error, s.n_shading, flux);
        used += 1u;
        let disc = bitcast<vec2f>(inputs[photons.samples + along.w * photons.bounces + bounce].xy);
        let d = cosine_direction(s.n_shading, disc);
        ray = leaving_ray(s, d);
        if dot(s.n_geometric, d) <= 0.0 {
            break;
        }
    }
    for (; used < photons.slots_a_path; used += 1u) {
        put(first + used, vec3f(0.0), 0.0, vec3f(0.0), vec3f(0.0));
    }
    slots[first * SLOT_WORDS + 1u].w = rays;
    slots[first * SLOT_WORDS + 2u].w = u32(capped);
}
