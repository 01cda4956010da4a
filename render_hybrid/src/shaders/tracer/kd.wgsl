// One ray through a kd-tree: short stack with restart and push-down. Twin: accel/simd/kd.rs, where the sources stand.

struct Waiting {
    node: u32,
    level: u32,
    start: f32,
    end: f32,
}

var<private> kd_stack: array<Waiting, KD_SHORT_STACK>;

// Bit `level` of a word of 64.
fn level_bit(level: u32) -> vec2u {
    let low = select(0u, 1u << (level & 31u), level < 32u);
    return vec2u(low, select(1u << (level & 31u), 0u, level < 32u));
}

// All bits below `level`.
fn levels_below(level: u32) -> vec2u {
    let part = (1u << (level & 31u)) - 1u;
    return select(vec2u(0xffffffffu, part), vec2u(part, 0u), level < 32u);
}

fn greatest_level(bits: vec2u) -> u32 {
    return select(firstLeadingBit(bits.x), 32u + firstLeadingBit(bits.y), bits.y != 0u);
}

// The nearest hit in the kd-tree of the instance at word `i`, or `so_far`.
fn kd_hit(i: u32, s: RaySpace, entered: Entered, ray: Ray, any_hit: bool, so_far: Hit) -> Hit {
    var best = so_far;
    let low = dynamic_word(i + 10u);
    let high = dynamic_word(i + 11u);
    let tree = dynamic_word(i).w;
    if tree == NONE {
        return best;
    }
    let backwards = s.inverse < vec3f(0.0);
    let from_planes = select(bitcast<vec3f>(low.xyz), bitcast<vec3f>(high.xyz), backwards) * s.inverse - s.near;
    let to_planes = select(bitcast<vec3f>(high.xyz), bitcast<vec3f>(low.xyz), backwards) * s.inverse - s.far;
    let start = max(max(from_planes.x, from_planes.y), max(from_planes.z, ray.t_min));
    let end = min(min(to_planes.x, to_planes.y), min(to_planes.z, FAR_AWAY));
    if !(start <= end) {
        return best;
    }
    var root = Waiting(0u, 0u, start, end);
    var at = root;
    // Entries pushed and popped so far; those between wait, at most KD_SHORT_STACK of them.
    var top = 0u;
    var held = 0u;
    var done = vec2u(0u);
    // A walk from the restart node, on which only finished levels were passed yet.
    var pushing_down = true;
    let cap = low.w;
    for (var step = 0u; step < cap; step += 1u) {
        let node = node_word(tree + at.node);
        if node.y != KD_LEAF {
            let axis = node.y % 3u;
            let inverse = s.inverse[axis];
            let plane = bitcast<f32>(node.x) * inverse;
            let enter = plane - s.near[axis];
            let leave = plane - s.far[axis];
            let near_child = node.z + u32(inverse < 0.0);
            let far_child = node.z + u32(inverse >= 0.0);
            let bit = level_bit(at.level);
            let level = at.level + 1u;
            let behind = Waiting(far_child, level, max(at.start, enter), at.end);
            let ahead = Waiting(near_child, level, at.start, min(at.end, leave));
            let go_near = at.start <= leave;
            let go_far = enter <= at.end;
            let finished = any((done & bit) != vec2u(0u));
            if go_near && go_far && !finished {
                kd_stack[top % KD_SHORT_STACK] = behind;
                top += 1u;
                held = min(held + 1u, KD_SHORT_STACK);
                pushing_down = false;
                at = ahead;
            } else {
                done |= bit;
                // Both were open and the near side is finished, or only one is open.
                if go_far && (!go_near || finished) {
                    at = behind;
                } else {
                    at = ahead;
                }
            }
            if pushing_down {
                root = at;
            }
            continue;
        }
        best = leaf_hit(node.z, node.w, s, entered, ray, best);
        if any_hit && best.instance != NONE {
            return best;
        }
        // Next: the deepest level where the far side still waits.
        var found = false;
        for (var round = 0u; round < 64u && !found; round += 1u) {
            let path = levels_below(at.level) & ~levels_below(root.level);
            let waiting = ~done & path;
            if all(waiting == vec2u(0u)) {
                return best;
            }
            let level = greatest_level(waiting);
            done = (done & levels_below(level)) | level_bit(level);
            if held > 0u {
                top -= 1u;
                held -= 1u;
                at = kd_stack[top % KD_SHORT_STACK];
                found = at.start <= best.t;
            } else {
                at = root;
                pushing_down = true;
                found = true;
            }
        }
    }
    capped = true;
    return best;
}
