// Shadow maps of VPLs. Twins: twin/vpl_maps.rs.

// Point on the octahedron |x|+|y|+|z| = 1 of `e` in [-1, 1]².
fn octahedron_point(e: vec2f) -> vec3f {
    let a = abs(e);
    let z = 1.0 - a.x - a.y;
    let folded = (vec2f(1.0) - a.yx) * select(vec2f(1.0), vec2f(-1.0), e < vec2f(0.0));
    return vec3f(select(e, folded, z < 0.0), z);
}

// Inverse of octahedron_point for v / |v|₁.
fn octahedron_coordinates(v: vec3f, inverse_l1: f32) -> vec2f {
    let e = v.xy * inverse_l1;
    let folded = (vec2f(1.0) - abs(e.yx)) * select(vec2f(1.0), vec2f(-1.0), e < vec2f(0.0));
    return select(e, folded, v.z < 0.0);
}

// Texel coordinates: centres on whole numbers, the first and the last on the map's rim.
fn vpl_texel_coordinates(e: vec2f, size: u32) -> vec2f {
    let top = f32(size - 1u);
    return clamp((e * 0.5 + 0.5) * top, vec2f(0.0), vec2f(top - 0.001));
}

fn vpl_texel_center(texel: vec2f, size: u32) -> vec2f {
    return texel * (2.0 / f32(size - 1u)) - 1.0;
}

// Fraction of an occluder that one texel shows.
fn texel_occlusion(stored: f32, expected: f32, own: f32, inverse_own: f32) -> f32 {
    let plane = clamp(expected, own, own * VPL_NEAREST_PLANE_INVERSE);
    return clamp((stored - plane) * inverse_own * (2.0 / VPL_DEPTH_SLACK) - 1.0, 0.0, 1.0);
}

fn l1_length(v: vec3f) -> f32 {
    return max(abs(v.x) + abs(v.y) + abs(v.z), 1e-30);
}

fn inverse_plane_height(n: vec3f, from_vpl: vec3f) -> f32 {
    return 1.0 / min(dot(n, from_vpl), -1e-30);
}

fn vpl_tap(maps: texture_2d<f32>, map: u32, size: u32, texel: vec2u, n: vec3f, inverse_height: f32, own: f32, l1: f32)
    -> f32 {
    let stored = textureLoad(maps, vec2u(texel.y * size + texel.x, map), 0).x;
    let expected = dot(n, octahedron_point(vpl_texel_center(vec2f(texel), size))) * inverse_height;
    return texel_occlusion(stored, expected, own, l1);
}

// Visibility of the VPL whose map is row `map` of `maps`, from a point with normal `n`.
fn vpl_visibility(maps: texture_2d<f32>, map: u32, size: u32, from_vpl: vec3f, n: vec3f) -> f32 {
    let l1 = l1_length(from_vpl);
    let own = 1.0 / l1;
    let at = vpl_texel_coordinates(octahedron_coordinates(from_vpl, own), size);
    let low = vec2u(at);
    let f = at - vec2f(low);
    let inverse_height = inverse_plane_height(n, from_vpl);
    let t00 = vpl_tap(maps, map, size, low, n, inverse_height, own, l1);
    let t10 = vpl_tap(maps, map, size, low + vec2u(1u, 0u), n, inverse_height, own, l1);
    let t01 = vpl_tap(maps, map, size, low + vec2u(0u, 1u), n, inverse_height, own, l1);
    let t11 = vpl_tap(maps, map, size, low + vec2u(1u, 1u), n, inverse_height, own, l1);
    let a = t00 + (t10 - t00) * f.x;
    let b = t01 + (t11 - t01) * f.x;
    return 1.0 - (a + (b - a) * f.y);
}
