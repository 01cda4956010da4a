// Hits by the project's own trees.
#import tracer/surface
#import tracer/kd_hit
#import tracer/traverse

fn closest_hit(ray: Ray) -> Hit {
    return trace_ray(ray, false);
}

// True where something that casts shadows is met.
fn occluded(ray: Ray) -> bool {
    return trace_ray(ray, true).instance != NONE;
}
