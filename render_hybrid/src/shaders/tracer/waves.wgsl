// The tracer wave by wave over queues of rays, for measurements against the one kernel of trace.wgsl: the same functions, the
// same light but for the rounding of sums. Rays of a pixel end in any order, so their light is summed in whole numbers.
#import tracer/scene
#import tracer/hits
#import tracer/pixels

struct MaskedUniform {
    count: u32,
    // Rays that half of the queue holds.
    capacity: u32,
    unused0: u32,
    unused1: u32,
}
struct Waves {
    // Rays of this wave, and those begun for the next.
    count: u32,
    begun: atomic<u32>,
    // Half of the queue that holds this wave.
    half: u32,
    // Rays that found no room.
    lost: atomic<u32>,
}
@group(1) @binding(5) var<storage, read> pixels: array<u32>;
@group(1) @binding(6) var<storage, read_write> counters: array<atomic<u32>, TRACE_COUNTERS>;
@group(1) @binding(7) var traced: texture_storage_2d<rgba32float, write>;
@group(1) @binding(8) var<uniform> masked: MaskedUniform;
@group(1) @binding(9) var<storage, read_write> waves: Waves;
// Two halves of WAVE_WORDS a ray: origin and least distance; direction and way; weight and place in the list of pixels;
// depth, crossings, kind and the count of media; media.
@group(1) @binding(10) var<storage, read_write> queue: array<vec4u>;
// Two words a ray of this wave, where finding and shading are two kernels.
@group(1) @binding(11) var<storage, read_write> met: array<vec4u>;
// Six words a pixel: light in steps of 2^-24, 64 bits a channel.
@group(1) @binding(12) var<storage, read_write> sums: array<atomic<u32>>;

const WAVE_WORDS: u32 = 5u;
const LIGHT_STEPS: f32 = 16777216.0;
const TWO_32: f32 = 4294967296.0;

var<private> rays: array<u32, TRACE_COUNTERS>;

fn count_ray(kind: u32) {
    rays[kind] += 1u;
}

fn add_counts() {
    for (var kind = 0u; kind < RAYS_CAPPED; kind += 1u) {
        if rays[kind] != 0u {
            atomicAdd(&counters[kind], rays[kind]);
        }
    }
    if capped {
        atomicAdd(&counters[RAYS_CAPPED], 1u);
    }
}

// 64 bits by two atomics: each overflow of the low word is seen by the one addition that made it, so the sum is the same in
// whatever order rays come.
fn add_light(slot: u32, light: vec3f) {
    for (var c = 0u; c < 3u; c += 1u) {
        let steps = clamp(light[c] * LIGHT_STEPS, 0.0, 1.0e18);
        let above = u32(steps / TWO_32);
        let low = u32(steps - f32(above) * TWO_32);
        let at = 6u * slot + 2u * c;
        let before = atomicAdd(&sums[at], low);
        let more = above + u32(before + low < before);
        if more != 0u {
            atomicAdd(&sums[at + 1u], more);
        }
    }
}

fn put_ray(b: Branch, slot: u32) {
    let i = atomicAdd(&waves.begun, 1u);
    if i >= masked.capacity {
        atomicAdd(&waves.lost, 1u);
        return;
    }
    let at = ((1u - waves.half) * masked.capacity + i) * WAVE_WORDS;
    let m = b.inside.instances;
    queue[at] = bitcast<vec4u>(vec4f(b.ray.origin, b.ray.t_min));
    queue[at + 1u] = bitcast<vec4u>(vec4f(b.ray.direction, b.way));
    queue[at + 2u] = vec4u(bitcast<vec3u>(b.weight), slot);
    let packed = b.depth | (b.crossed << 8u) | (u32(b.refraction) << 20u) | (b.inside.count << 24u);
    queue[at + 3u] = vec4u(packed, m[0], m[1], m[2]);
    queue[at + 4u] = vec4u(m[3], m[4], m[5], 0u);
}

struct Taken {
    branch: Branch,
    slot: u32,
}

fn take_ray(i: u32) -> Taken {
    let at = (waves.half * masked.capacity + i) * WAVE_WORDS;
    let a = bitcast<vec4f>(queue[at]);
    let b = bitcast<vec4f>(queue[at + 1u]);
    let c = queue[at + 2u];
    let d = queue[at + 3u];
    let e = queue[at + 4u];
    let inside = Media(array<u32, MEDIA_CAPACITY>(d.y, d.z, d.w, e.x, e.y, e.z), d.x >> 24u);
    let depth = d.x & 0xffu;
    let crossed = (d.x >> 8u) & 0xfffu;
    let refraction = ((d.x >> 20u) & 1u) != 0u;
    let ray = Ray(a.xyz, a.w, b.xyz, FAR_AWAY);
    return Taken(Branch(ray, bitcast<vec3f>(c.xyz), depth, crossed, refraction, b.w, inside), c.w);
}

fn put_children(next: Children, slot: u32) {
    if next.count > 0u {
        put_ray(next.first, slot);
    }
    if next.count > 1u {
        put_ray(next.second, slot);
    }
}

// What a ray brings that met `hit`, and what it begins.
fn arrived(taken: Taken, hit: Hit) {
    var branch = taken.branch;
    count_ray(select(RAYS_REFLECTION, RAYS_REFRACTION, branch.refraction));
    branch.weight *= transmittance(branch.inside, hit.t);
    if hit.instance == NONE {
        add_light(taken.slot, branch.weight * frame.background);
        return;
    }
    let way = branch.way + hit.t;
    let s = surface_at(branch.ray.direction, hit, pixel_width(way));
    add_light(taken.slot, branch.weight * shade(s, -branch.ray.direction, pixels[taken.slot]));
    put_children(children(branch, s, way), taken.slot);
}

fn invocation(group: vec3u, groups: vec3u, lane: u32) -> u32 {
    return (group.y * groups.x + group.x) * TRACE_GROUP + lane;
}

// What the camera sees begins the first wave.
@compute @workgroup_size(TRACE_GROUP)
fn begin(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = invocation(group, groups, lane);
    if i >= masked.count {
        return;
    }
    for (var k = 0u; k < 6u; k += 1u) {
        atomicStore(&sums[6u * i + k], 0u);
    }
    let seen = seen_at(vec2u(pixels[i] % frame.size.x, pixels[i] / frame.size.x));
    if seen.hit.instance == NONE {
        return;
    }
    let s = surface_at(seen.ray.direction, seen.hit, pixel_width(seen.hit.t));
    put_children(children(camera_branch(seen.ray), s, seen.hit.t), i);
}

// A wave in one kernel.
@compute @workgroup_size(TRACE_GROUP)
fn follow(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = invocation(group, groups, lane);
    if i >= waves.count {
        return;
    }
    let taken = take_ray(i);
    arrived(taken, closest_hit(taken.branch.ray));
    add_counts();
}

// A wave in two kernels: the walk, then all else.
@compute @workgroup_size(TRACE_GROUP)
fn find(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = invocation(group, groups, lane);
    if i >= waves.count {
        return;
    }
    let at = (waves.half * masked.capacity + i) * WAVE_WORDS;
    let a = bitcast<vec4f>(queue[at]);
    let hit = closest_hit(Ray(a.xyz, a.w, bitcast<vec3f>(queue[at + 1u].xyz), FAR_AWAY));
    met[2u * i] = vec4u(bitcast<vec3u>(vec3f(hit.t, hit.u, hit.v)), hit.instance);
    met[2u * i + 1u] = vec4u(hit.primitive, u32(capped), 0u, 0u);
}

@compute @workgroup_size(TRACE_GROUP)
fn shade_found(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = invocation(group, groups, lane);
    if i >= waves.count {
        return;
    }
    let a = met[2u * i];
    let b = met[2u * i + 1u];
    let t = bitcast<vec3f>(a.xyz);
    capped = b.y != 0u;
    arrived(take_ray(i), Hit(t.x, t.y, t.z, a.w, b.x));
    add_counts();
}

// What the waves left.
@compute @workgroup_size(TRACE_GROUP)
fn finish(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = invocation(group, groups, lane);
    if i >= waves.count {
        return;
    }
    let taken = take_ray(i);
    add_light(taken.slot, traced_radiance(taken.branch, false, Hit(0.0, 0.0, 0.0, NONE, NONE), pixels[taken.slot]));
    add_counts();
}

// Sums become light. Rays that had no room or no wave count as met caps.
@compute @workgroup_size(TRACE_GROUP)
fn resolve(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = invocation(group, groups, lane);
    if i == 0u {
        atomicAdd(&counters[RAYS_CAPPED], atomicLoad(&waves.begun) + atomicLoad(&waves.lost));
    }
    if i >= masked.count {
        return;
    }
    var light: vec3f;
    for (var c = 0u; c < 3u; c += 1u) {
        let at = 6u * i + 2u * c;
        let above = f32(atomicLoad(&sums[at + 1u]));
        light[c] = (above * TWO_32 + f32(atomicLoad(&sums[at]))) / LIGHT_STEPS;
    }
    textureStore(traced, vec2u(pixels[i] % frame.size.x, pixels[i] / frame.size.x), vec4f(light, 1.0));
}
