// Where a line meets a triangle: weights of the second and third vertex, kept inside the triangle.
//
// The rasteriser has already decided that the pixel belongs to the triangle; a centre that lies a rounding error outside
// is drawn to its rim. Source: Möller & Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection", 1997.
fn plane_barycentrics(origin: vec3f, direction: vec3f, p0: vec3f, p1: vec3f, p2: vec3f) -> vec2f {
    // Edges of any size in, edges of about 1 through the products, so that tiny scenes stay in range.
    let largest = max(abs(p1 - p0), abs(p2 - p0));
    let scale = 1.0 / max(max(largest.x, max(largest.y, largest.z)), 1e-30);
    let e1 = (p1 - p0) * scale;
    let e2 = (p2 - p0) * scale;
    let from_p0 = (origin - p0) * scale;
    let p = cross(direction, e2);
    let determinant = dot(e1, p);
    if determinant == 0.0 {
        return vec2f(1.0 / 3.0);
    }
    let u = max(dot(from_p0, p) / determinant, 0.0);
    let v = max(dot(direction, cross(from_p0, e1)) / determinant, 0.0);
    return vec2f(u, v) / max(u + v, 1.0);
}
