// Sample patterns. Twins: trace/sampling.rs.

fn hash_u32(value: u32) -> u32 {
    var x = value;
    x ^= x >> 16u;
    x *= 0x85ebca6bu;
    x ^= x >> 13u;
    x *= 0xc2b2ae35u;
    return x ^ (x >> 16u);
}

fn hash_combine(a: u32, b: u32) -> u32 {
    return hash_u32(a ^ (b * 0x9e3779b9u + 0x7f4a7c15u));
}

// Uniform in [0, 1) from the upper 24 bits.
fn unit_f32(x: u32) -> f32 {
    return f32(x >> 8u) / 16777216.0;
}

// Point `i` of `n` on the unit disc. Source: Vogel, "A better way to construct the sunflower head", 1979.
fn vogel_disc(i: u32, n: u32, rotation: f32) -> vec2f {
    let r = sqrt((f32(i) + 0.5) / f32(n));
    let angle = f32(i) * 2.3999632 + rotation;
    return vec2f(r * cos(angle), r * sin(angle));
}

// Tangent and bitangent of a right-handed basis (t, b, n).
// Source: Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 2017.
fn orthonormal_basis(n: vec3f) -> mat2x3f {
    let s = select(-1.0, 1.0, n.z >= 0.0);
    let a = -1.0 / (s + n.z);
    let b = n.x * n.y * a;
    return mat2x3f(
        vec3f(1.0 + s * n.x * n.x * a, s * b, -s * n.x),
        vec3f(b, s + n.y * n.y * a, -n.y),
    );
}
