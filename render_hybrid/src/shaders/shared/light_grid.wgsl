// Indirect light on a grid of the picture. Twins: twin/grid.rs.

struct GridUniform {
    // Columns and rows.
    size: vec2u,
    // Pixels from one place to the next; 1: there is no grid.
    spacing: u32,
    // 1: the first chunk of VPLs adds to what the CPU left.
    adds: u32,
}

// Layers of the grid's texture: what arrives of red, green and blue as vectors, W/m², each with a coordinate of the place's
// normal in w (all zero: nothing matte is seen there), and the place itself.
const GRID_POSITION: u32 = 3u;

// The picture's pixel that a place of the grid sees.
fn grid_pixel(place: vec2u, spacing: u32, picture: vec2u) -> vec2u {
    return min(place * spacing, picture - 1u);
}

// Twin: likeness. * `m`, `at`: normal and place of the grid's point
fn grid_likeness(m: vec3f, at: vec3f, position: vec3f, n: vec3f) -> f32 {
    let to = position - at;
    let off = dot(m, to);
    let off_own = dot(n, to);
    let share = min(off * off, off_own * off_own) / (dot(to, to) + (1e-12 + GRID_ROUNDING * dot(at, at)));
    let plane = clamp(1.0 - (share - GRID_OFF_PLANE) * (1.0 / GRID_OFF_PLANE_SPAN), 0.0, 1.0);
    return clamp((dot(n, m) - GRID_LEAST_COSINE) * (1.0 / GRID_COSINE_SPAN), 0.0, 1.0) * plane;
}

// Twin: near_of_four. * `f`: place in the cell, in [0, 1)²; `k`: corner, (0, 0) or (1, 0) above, (0, 1) or (1, 1) below
fn grid_near_of_four(f: vec2f, k: vec2u) -> f32 {
    let w = select(f, vec2f(1.0) - f, k == vec2u(0u));
    return w.x * w.y;
}

// Twin: near_of_sixteen. * `d`: cells away
fn grid_near_of_sixteen(d: vec2f) -> f32 {
    return 1.0 / (dot(d, d) + 0.25);
}

// Weighed irradiance by one point of the grid, and in w its weight.
fn grid_share(grid: texture_2d_array<f32>, place: vec2u, near: f32, position: vec3f, n: vec3f) -> vec4f {
    let r = textureLoad(grid, place, 0u, 0);
    let g = textureLoad(grid, place, 1u, 0);
    let b = textureLoad(grid, place, 2u, 0);
    let at = textureLoad(grid, place, GRID_POSITION, 0).xyz;
    let weight = near * grid_likeness(vec3f(r.w, g.w, b.w), at, position, n);
    return vec4f(weight * max(vec3f(dot(n, r.xyz), dot(n, g.xyz), dot(n, b.xyz)), vec3f(0.0)), weight);
}

// Irradiance of a pixel and 1, or 0 where no point of the grid can tell. Twin: IrradianceGrid::at.
fn grid_irradiance(grid: texture_2d_array<f32>, shape: GridUniform, pixel: vec2u, position: vec3f, n: vec3f) -> vec4f {
    let cell = pixel / shape.spacing;
    let f = vec2f(pixel % shape.spacing) / f32(shape.spacing);
    var sum = vec4f(0.0);
    for (var i = 0u; i < 4u; i += 1u) {
        let k = vec2u(i & 1u, i >> 1u);
        sum += grid_share(grid, cell + k, grid_near_of_four(f, k), position, n);
    }
    if sum.w <= GRID_LEAST_WEIGHT {
        sum = vec4f(0.0);
        let first = max(cell, vec2u(1u)) - 1u;
        let end = min(cell + 3u, shape.size);
        for (var y = first.y; y < end.y; y += 1u) {
            for (var x = first.x; x < end.x; x += 1u) {
                let d = (vec2f(vec2u(x, y) * shape.spacing) - vec2f(pixel)) / f32(shape.spacing);
                sum += grid_share(grid, vec2u(x, y), grid_near_of_sixteen(d), position, n);
            }
        }
    }
    if sum.w <= GRID_LEAST_WEIGHT {
        return vec4f(0.0);
    }
    return vec4f(sum.xyz / sum.w, 1.0);
}
