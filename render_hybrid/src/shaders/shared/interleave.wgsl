// Interleaved sampling of VPLs: who is lit by which of them, and the filter that puts them together. Twins: twin/interleave.rs.

// Which subset a draw is for.
struct SubsetUniform {
    k: u32,
    unused0: u32,
    unused1: u32,
    unused2: u32,
}

// The first VPL of subset `k`, and the one past its last, in a list of `len` that is ordered by subsets. Twin: subset_range.
fn subset_range(len: u32, k: u32, subsets: u32) -> vec2u {
    let whole = len / subsets;
    let rest = len % subsets;
    return vec2u(k * whole + min(k, rest), (k + 1u) * whole + min(k + 1u, rest));
}

// Where the light of a pixel lies before the filter: those of one subset fill a rectangle. A permutation of the picture's
// places; with n = 1 each stays where it is. Twins: subset_of, and subset_range of columns and of rows.
fn split_place(pixel: vec2u, size: vec2u, n: u32) -> vec2u {
    let k = pixel % n;
    return k * (size / n) + min(k, size % n) + pixel / n;
}

// Inverse of split_place.
fn pixel_of_split(place: vec2u, size: vec2u, n: u32) -> vec2u {
    let whole = size / n;
    let rest = size % n;
    // The first `rest` runs are longer by one.
    let longer = place < rest * (whole + 1u);
    let run = max(select(whole, whole + 1u, longer), vec2u(1u));
    let start = select(rest * (whole + 1u), vec2u(0u), longer);
    let k = select(rest, vec2u(0u), longer) + (place - start) / run;
    return (place - start) % run * n + k;
}

// The first pixel of the filter, and the one past its last, in both directions. Twin: filter_span.
fn filter_span(pixel: vec2u, size: vec2u, n: u32) -> vec4u {
    return vec4u(max(pixel, vec2u(n / 2u)) - n / 2u, min(pixel + (n - n / 2u), size));
}

// True where the light of another place counts at a place with unit normal `n`. Twin: same_surface.
fn same_surface(position: vec3f, n: vec3f, position_other: vec3f, n_other: vec3f) -> bool {
    let to = position_other - position;
    let off = dot(n, to);
    let most = INTERLEAVE_MOST_OFF_PLANE * INTERLEAVE_MOST_OFF_PLANE * dot(to, to);
    return dot(n, n_other) >= INTERLEAVE_LEAST_COSINE && off * off <= most;
}
