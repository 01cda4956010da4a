// Reflection models and optics. Twins: twin/shading.rs. Directions point away from the surface.

fn blinn_phong_normalization(shininess: f32) -> f32 {
    return (shininess + 8.0) / (8.0 * PI);
}

fn blinn_phong_lobe(n: vec3f, wi: vec3f, wo: vec3f, shininess: f32) -> f32 {
    let h = wi + wo;
    let length_squared = dot(h, h);
    if length_squared <= 0.0 {
        return 0.0;
    }
    let n_dot_h = dot(n, h) / sqrt(length_squared);
    if n_dot_h <= 0.0 {
        return 0.0;
    }
    return blinn_phong_normalization(shininess) * pow(min(n_dot_h, 1.0), shininess);
}

// Twin: reflect (the name is taken in WGSL, for the direction of travel).
fn reflect_view(wo: vec3f, n: vec3f) -> vec3f {
    return n * (2.0 * dot(n, wo)) - wo;
}

// Snell. xyz: direction, w: 1; all 0 at total internal reflection. Twin: refract.
fn refract_travel(d: vec3f, n: vec3f, eta: f32) -> vec4f {
    let cos_i = -dot(n, d);
    let sin2_t = eta * eta * max(1.0 - cos_i * cos_i, 0.0);
    if sin2_t >= 1.0 {
        return vec4f(0.0);
    }
    return vec4f(normalize(d * eta + n * (eta * cos_i - sqrt(1.0 - sin2_t))), 1.0);
}

fn fresnel_dielectric(cos_i: f32, eta: f32) -> f32 {
    let c1 = clamp(cos_i, 0.0, 1.0);
    let sin2_t = eta * eta * (1.0 - c1 * c1);
    if sin2_t >= 1.0 {
        return 1.0;
    }
    let c2 = sqrt(1.0 - sin2_t);
    let rs = (eta * c1 - c2) / (eta * c1 + c2);
    let rp = (eta * c2 - c1) / (eta * c2 + c1);
    return 0.5 * (rs * rs + rp * rp);
}

fn schlick(f0: vec3f, cos_i: f32) -> vec3f {
    let x = clamp(1.0 - cos_i, 0.0, 1.0);
    let x2 = x * x;
    return f0 + (vec3f(1.0) - f0) * (x2 * x2 * x);
}

// Transmittance per channel after `travelled` metres: color^(travelled / attenuation_distance).
fn beer_lambert(attenuation_color: vec3f, attenuation_distance: f32, travelled: f32) -> vec3f {
    if attenuation_distance >= FAR_AWAY || travelled <= 0.0 {
        return vec3f(1.0);
    }
    // 0 to a power would be an infinite logarithm: nothing is left, however short the way.
    let x = min(travelled / attenuation_distance, 1e30);
    let absorbed = pow(max(attenuation_color, vec3f(1e-30)), vec3f(x));
    let left = select(absorbed, vec3f(0.0), attenuation_color <= vec3f(0.0));
    return select(left, vec3f(1.0), attenuation_color >= vec3f(1.0));
}
