#import shared/scene

// Light towards a point. Twin: engine/src/light.rs, Light::incident.
struct Incident {
    // Unit direction to the light.
    wi: vec3f,
    // Metres; FAR_AWAY for directional light.
    distance: f32,
    // Radiant intensity / distance², before the receiver's cosine.
    irradiance: vec3f,
}

// glTF's recommended spot falloff. Twin: engine/src/light.rs, spot_falloff.
fn spot_falloff(cos_theta: f32, cos_inner: f32, cos_outer: f32) -> f32 {
    let x = clamp((cos_theta - cos_outer) / max(cos_inner - cos_outer, 0.001), 0.0, 1.0);
    return x * x;
}

fn incident(light: Light, point_world: vec3f) -> Incident {
    if light.kind == LIGHT_DIRECTIONAL {
        return Incident(-light.direction_world, FAR_AWAY, light.intensity);
    }
    let to_light = light.position_world - point_world;
    let distance_squared = dot(to_light, to_light);
    if distance_squared <= 0.0 {
        return Incident(vec3f(0.0, 1.0, 0.0), 0.0, vec3f(0.0));
    }
    let distance = sqrt(distance_squared);
    let wi = to_light / distance;
    var falloff = 1.0;
    if light.kind == LIGHT_SPOT {
        falloff = spot_falloff(-dot(wi, light.direction_world), light.cos_inner, light.cos_outer);
    }
    return Incident(wi, distance, light.intensity * (falloff / distance_squared));
}
