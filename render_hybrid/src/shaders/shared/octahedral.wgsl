// Unit vectors as two numbers in [-1, 1].
// Source: Cigolle et al., "A Survey of Efficient Representations for Independent Unit Vectors", JCGT 2014.

fn sign_not_zero(v: vec2f) -> vec2f {
    return select(vec2f(-1.0), vec2f(1.0), v >= vec2f(0.0));
}

fn octahedral_encode(n: vec3f) -> vec2f {
    let p = n.xy / (abs(n.x) + abs(n.y) + abs(n.z));
    if n.z >= 0.0 {
        return p;
    }
    return (vec2f(1.0) - abs(p.yx)) * sign_not_zero(p);
}

fn octahedral_decode(e: vec2f) -> vec3f {
    let z = 1.0 - abs(e.x) - abs(e.y);
    if z >= 0.0 {
        return normalize(vec3f(e, z));
    }
    return normalize(vec3f((vec2f(1.0) - abs(e.yx)) * sign_not_zero(e), z));
}
