// From the paths' slots to the lists that passes read: VPLs with flux in the order of paths, those of a subset of interleaved
// sampling together. Twins: trace/photons.rs (the order), twin/interleave.rs (the subsets). One workgroup.
#import shared/sampling

struct PackUniform {
    // Slots of all paths, and of one.
    slots: u32,
    slots_a_path: u32,
    // Side of the blocks of pixels over which VPLs are interleaved; 1: none.
    interleave: u32,
    // Words from one chunk of the indirect pass to the next.
    stride: u32,
    geometry_term_max: f32,
    chunks: u32,
    unused0: u32,
    unused1: u32,
}
@group(1) @binding(0) var<uniform> pack: PackUniform;
@group(1) @binding(1) var<storage, read> slots: array<vec4u>;
// The tracer's list: as many VPLs as there are slots, behind the last one with flux without flux; then (rays, paths whose
// walk met its cap, VPLs with flux).
@group(1) @binding(2) var<storage, read_write> list: array<vec4u>;
// The indirect pass's chunks: head, then VPLs.
@group(1) @binding(3) var<storage, read_write> packed: array<vec4u>;

var<workgroup> places: array<u32, TRACE_GROUP>;
var<workgroup> counted: array<vec2u, TRACE_GROUP>;
var<workgroup> total: u32;

fn is_lit(slot: u32) -> bool {
    return any(bitcast<vec3f>(slots[slot * SLOT_WORDS + 2u].xyz) != vec3f(0.0));
}

// Twin: twin/interleave.rs, group_subsets.
fn place_of(i: u32, count: u32) -> u32 {
    let m = pack.interleave * pack.interleave;
    let group = i / m;
    var subset = i % m;
    if (group + 1u) * m <= count {
        let turn = hash_u32(group ^ 0x5e60u) % m;
        subset = (subset + m - turn) % m;
    }
    return subset * (count / m) + min(subset, count % m) + group;
}

@compute @workgroup_size(TRACE_GROUP)
fn pack_photons(@builtin(local_invocation_index) lane: u32) {
    let each = (pack.slots + TRACE_GROUP - 1u) / TRACE_GROUP;
    let first = min(lane * each, pack.slots);
    let end = min(first + each, pack.slots);
    var lit = 0u;
    var counts = vec2u(0u);
    for (var slot = first; slot < end; slot += 1u) {
        lit += u32(is_lit(slot));
        if slot % pack.slots_a_path == 0u {
            counts += vec2u(slots[slot * SLOT_WORDS + 1u].w, slots[slot * SLOT_WORDS + 2u].w);
        }
    }
    places[lane] = lit;
    counted[lane] = counts;
    workgroupBarrier();
    if lane == 0u {
        var next = 0u;
        var sum = vec2u(0u);
        for (var i = 0u; i < TRACE_GROUP; i += 1u) {
            let here = places[i];
            places[i] = next;
            next += here;
            sum += counted[i];
        }
        total = next;
        list[pack.slots * SLOT_WORDS] = vec4u(sum, next, 0u);
        for (var chunk = 0u; chunk < pack.chunks; chunk += 1u) {
            let count = min(next - min(next, chunk * VPL_CHUNK), VPL_CHUNK);
            packed[chunk * pack.stride] =
                vec4u(count, chunk * VPL_CHUNK, bitcast<u32>(pack.geometry_term_max), 0u);
            packed[chunk * pack.stride + 1u] = vec4u(next, pack.interleave, 0u, 0u);
        }
    }
    workgroupBarrier();
    let count = total;
    var next = places[lane];
    for (var slot = first; slot < end; slot += 1u) {
        if is_lit(slot) {
            let place = place_of(next, count);
            next += 1u;
            let source = slot * SLOT_WORDS;
            let into = (place / VPL_CHUNK) * pack.stride + HEAD_WORDS + (place % VPL_CHUNK) * SLOT_WORDS;
            let words = array(slots[source], vec4u(slots[source + 1u].xyz, 0u), vec4u(slots[source + 2u].xyz, 0u));
            for (var w = 0u; w < SLOT_WORDS; w += 1u) {
                var own = words;
                list[place * SLOT_WORDS + w] = own[w];
                packed[into + w] = own[w];
            }
        }
    }
    // What lies behind the last one.
    for (var slot = max(first, count); slot < end; slot += 1u) {
        for (var w = 0u; w < SLOT_WORDS; w += 1u) {
            list[slot * SLOT_WORDS + w] = vec4u(0u);
        }
    }
}
