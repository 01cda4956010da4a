// Hits by the adapter's own ray tracing hardware: the same triangles in its own trees. Equal distances are won by whichever
// it likes.
#import tracer/surface

@group(0) @binding(9) var tlas: acceleration_structure;

// No walk of ours, no cap.
var<private> capped: bool;
var<private> walked: u32;

fn committed(ray: Ray, any_hit: bool) -> Hit {
    var query: ray_query;
    // Bit 0: things that cast shadows, bit 1: all.
    let mask = select(2u, 1u, any_hit);
    let flags = select(RAY_FLAG_NONE, RAY_FLAG_TERMINATE_ON_FIRST_HIT, any_hit);
    rayQueryInitialize(&query, tlas, RayDesc(flags, mask, ray.t_min, ray.t_max, ray.origin, ray.direction));
    // Candidates are triangles of surfaces with holes; each is offered once.
    for (var offered = 0u; offered < RAY_QUERY_CAP && rayQueryProceed(&query); offered += 1u) {
        let candidate = rayQueryGetCandidateIntersection(&query);
        if candidate.kind == RAY_QUERY_INTERSECTION_TRIANGLE
            && !is_hole(
                candidate.instance_custom_data, candidate.primitive_index, candidate.barycentrics.x,
                candidate.barycentrics.y) {
            rayQueryConfirmIntersection(&query);
        }
    }
    let met = rayQueryGetCommittedIntersection(&query);
    if met.kind == RAY_QUERY_INTERSECTION_NONE {
        return Hit(ray.t_max, 0.0, 0.0, NONE, NONE);
    }
    return Hit(met.t, met.barycentrics.x, met.barycentrics.y, met.instance_custom_data, met.primitive_index);
}

fn closest_hit(ray: Ray) -> Hit {
    return committed(ray, false);
}

fn occluded(ray: Ray) -> bool {
    return committed(ray, true).instance != NONE;
}
