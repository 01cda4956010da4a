// Rays through the two levels: the wide trees of accel/, one ray an invocation. Twin: accel/simd/single.rs.
//
// A node is eight children of two words each: (least corner, reference), (greatest corner, 0). The stack holds one entry a
// level: a node and its children that still wait, nearest first.

// Children that wait in a packed order, nearest in the lowest three bits.
const ORDER_COUNT_SHIFT: u32 = 24u;

var<private> stack: array<vec2u, TRAVERSAL_STACK>;
// Set where a walk met its cap, which no valid tree does.
var<private> capped: bool;
// Steps of all walks, counted where they are shown.
var<private> walked: u32;

// Eight keys, one a child: entry distance with the child's number in the lowest bits; NONE: not entered.
fn child_key(at: u32, child: u32, s: RaySpace, t_min: f32, limit: f32) -> u32 {
    let low = node_word(at + 2u * child);
    if low.w == NONE {
        return NONE;
    }
    let enter = box_entry(low.xyz, node_word(at + 2u * child + 1u).xyz, s, t_min, limit);
    return select((bitcast<u32>(enter) & 0x7ffffff8u) | child, NONE, enter < 0.0);
}

fn rank(key: u32, a: vec4u, b: vec4u) -> u32 {
    let less = select(vec4u(0u), vec4u(1u), a < vec4u(key)) + select(vec4u(0u), vec4u(1u), b < vec4u(key));
    return less.x + less.y + less.z + less.w;
}

fn placed(key: u32, a: vec4u, b: vec4u) -> u32 {
    let valid = key != NONE;
    return select(0u, (key & 7u) << (3u * min(rank(key, a, b), 7u)), valid) + select(0u, 1u << ORDER_COUNT_SHIFT, valid);
}

// The children of a node that the ray enters before `limit`, packed.
fn ordered_children(node: u32, s: RaySpace, t_min: f32, limit: f32) -> u32 {
    let at = node * NODE_WORDS;
    let a = vec4u(
        child_key(at, 0u, s, t_min, limit),
        child_key(at, 1u, s, t_min, limit),
        child_key(at, 2u, s, t_min, limit),
        child_key(at, 3u, s, t_min, limit),
    );
    let b = vec4u(
        child_key(at, 4u, s, t_min, limit),
        child_key(at, 5u, s, t_min, limit),
        child_key(at, 6u, s, t_min, limit),
        child_key(at, 7u, s, t_min, limit),
    );
    return placed(a.x, a, b) + placed(a.y, a, b) + placed(a.z, a, b) + placed(a.w, a, b)
        + placed(b.x, a, b) + placed(b.y, a, b) + placed(b.z, a, b) + placed(b.w, a, b);
}

// Order of hits: t, then instance, then primitive.
fn nearer(t: f32, instance: u32, primitive: u32, best: Hit) -> bool {
    return t < best.t
        || (t == best.t && (instance < best.instance || (instance == best.instance && primitive < best.primitive)));
}

// What one triangle changes of the best hit so far.
fn offered(tuv: vec3f, primitive: u32, entered: Entered, ray: Ray, best: Hit) -> Hit {
    if tuv.x > ray.t_min && tuv.x < ray.t_max && nearer(tuv.x, entered.instance, primitive, best) {
        if (entered.flags & INSTANCE_CUTOUT) == 0u || !is_hole(entered.instance, primitive, tuv.y, tuv.z) {
            return Hit(tuv.x, tuv.y, tuv.z, entered.instance, primitive);
        }
    }
    return best;
}

// The nearest hit among a run of triangles and `best`. Triangles whose answer f32 cannot tell are kept back and decided by
// whole numbers afterwards: few are, and so lanes seldom wait for each other.
fn leaf_hit(first: u32, count: u32, s: RaySpace, entered: Entered, ray: Ray, so_far: Hit) -> Hit {
    var best = so_far;
    for (var done = 0u; done < count; done += 32u) {
        let end = min(count - done, 32u);
        var hard = 0u;
        for (var i = 0u; i < end; i += 1u) {
            let at = TRIANGLE_WORDS * (first + done + i);
            let a = triangle_word(at);
            let b = triangle_word(at + 1u).xyz;
            let c = triangle_word(at + 2u).xyz;
            let met = intersect_fast(
                s, bitcast<vec3f>(a.xyz), bitcast<vec3f>(b), bitcast<vec3f>(c));
            if met.w == TRIANGLE_HIT {
                best = offered(met.xyz, a.w, entered, ray, best);
            } else if met.w == TRIANGLE_HARD {
                hard |= 1u << i;
            }
        }
        for (var round = 0u; round < 32u && hard != 0u; round += 1u) {
            let i = firstTrailingBit(hard);
            hard &= hard - 1u;
            let at = TRIANGLE_WORDS * (first + done + i);
            let a = triangle_word(at);
            let b = triangle_word(at + 1u).xyz;
            let c = triangle_word(at + 2u).xyz;
            let met = intersect_exact(
                s, bitcast<vec3f>(a.xyz), bitcast<vec3f>(b), bitcast<vec3f>(c));
            if met.w == TRIANGLE_HIT {
                best = offered(met.xyz, a.w, entered, ray, best);
            }
        }
    }
    return best;
}

// An instance that the ray is inside of.
struct Entered {
    instance: u32,
    flags: u32,
}

// First thing at t_min < t < t_max; with `any_hit`, the first that is found among what throws shadows.
fn trace_ray(ray: Ray, any_hit: bool) -> Hit {
    var best = Hit(ray.t_max, 0.0, 0.0, NONE, NONE);
    if head.tlas_root == NONE {
        return best;
    }
    let world = ray_space(ray.origin, ray.direction, head.extent, head.slack);
    var space = world;
    var entered = Entered(NONE, 0u);
    var floor_level = 0u;
    var top = 0u;
    var node = 0u;
    var order = 0u;
    var next = head.tlas_root;
    for (var step = 0u; step < head.traversal_cap; step += 1u) {
        if SHOWS_WORK {
            walked += 1u;
        }
        if next != NONE {
            // A node: its children before those that wait.
            let inside = ordered_children(next, space, ray.t_min, best.t);
            if (inside >> ORDER_COUNT_SHIFT) != 0u {
                if (order >> ORDER_COUNT_SHIFT) != 0u {
                    stack[top] = vec2u(node, order);
                    top += 1u;
                }
                node = next;
                order = inside;
            }
            next = NONE;
            continue;
        }
        if (order >> ORDER_COUNT_SHIFT) == 0u {
            if top == 0u {
                return best;
            }
            if entered.instance != NONE && top == floor_level {
                entered.instance = NONE;
                space = world;
            }
            top -= 1u;
            let waiting = stack[top];
            node = waiting.x;
            order = waiting.y;
            continue;
        }
        // The nearest child that waits, if it is still nearer than the best hit.
        let at = node * NODE_WORDS + 2u * (order & 7u);
        order = ((order & 0xffffffu) >> 3u) | (((order >> ORDER_COUNT_SHIFT) - 1u) << ORDER_COUNT_SHIFT);
        let low = node_word(at);
        if box_entry(low.xyz, node_word(at + 1u).xyz, space, ray.t_min, best.t) < 0.0 {
            continue;
        }
        if (low.w & REF_LEAF) == 0u {
            next = low.w;
            continue;
        }
        if entered.instance != NONE {
            let count = ((low.w >> REF_LEN_SHIFT) & 7u) + 1u;
            best = leaf_hit(low.w & REF_BLOCK, count, space, entered, ray, best);
            if any_hit && best.instance != NONE {
                return best;
            }
            continue;
        }
        // A leaf of the upper tree.
        let instance = low.w & ~REF_LEAF;
        let i = instance_at(instance);
        let flags = dynamic_word(i + 3u).w;
        if any_hit && (flags & INSTANCE_CASTS_SHADOW) == 0u {
            continue;
        }
        let own = object_space(i, flags, ray);
        if TREES_ARE_KD {
            best = kd_hit(i, own, Entered(instance, flags), ray, any_hit, best);
            if any_hit && best.instance != NONE {
                return best;
            }
            continue;
        }
        space = own;
        entered = Entered(instance, flags);
        // Always pushed, so that coming back to this level is seen.
        stack[top] = vec2u(node, order);
        top += 1u;
        floor_level = top;
        order = 0u;
        next = dynamic_word(i).w;
    }
    capped = true;
    return best;
}

fn object_space(i: u32, flags: u32, ray: Ray) -> RaySpace {
    let row0 = dynamic_word(i);
    let row1 = dynamic_word(i + 1u);
    let row2 = dynamic_word(i + 2u);
    var origin = ray.origin;
    var direction = ray.direction;
    if (flags & INSTANCE_IDENTITY) == 0u {
        let m0 = bitcast<vec3f>(row0.xyz);
        let m1 = bitcast<vec3f>(row1.xyz);
        let m2 = bitcast<vec3f>(row2.xyz);
        let r = ray.origin - bitcast<vec3f>(dynamic_word(i + 3u).xyz);
        origin = vec3f(dot(m0, r), dot(m1, r), dot(m2, r));
        direction = vec3f(dot(m0, ray.direction), dot(m1, ray.direction), dot(m2, ray.direction));
    }
    return ray_space(origin, direction, bitcast<f32>(row1.w), 1.0);
}
