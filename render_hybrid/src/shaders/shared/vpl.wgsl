// Virtual point lights. Twins: twin/vpl.rs.

struct Vpl {
    position_world: vec3f,
    // The map's centre lies this far off the surface, metres.
    error: f32,
    normal_world: vec3f,
    // Row of its shadow map.
    map: u32,
    flux: vec3f,
    unused2: f32,
}

// Bounded geometry term min(cos_x cos_y / d², bound), 1/m².
fn geometry_term(to_vpl: vec3f, n: vec3f, normal_vpl: vec3f, geometry_term_max: f32) -> f32 {
    let d2 = dot(to_vpl, to_vpl);
    let cos_x = max(dot(n, to_vpl), 0.0);
    let cos_y = max(-dot(normal_vpl, to_vpl), 0.0);
    return min(cos_x * cos_y / max(d2 * d2, MIN_POSITIVE), geometry_term_max);
}

// (Φ/π) G: radiance is base_color/π times this.
fn vpl_irradiance(vpl: Vpl, point_world: vec3f, n: vec3f, geometry_term_max: f32) -> vec3f {
    return vpl.flux * (geometry_term(vpl.position_world - point_world, n, vpl.normal_world, geometry_term_max) / PI);
}
