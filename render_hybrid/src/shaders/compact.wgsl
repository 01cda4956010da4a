// The numbers of all pixels that the tracer works on: count per block, scan, scatter. No atomics, so the list is the same on
// every run. Source: Blelloch, "Prefix Sums and Their Applications", 1990.

// w: over 0.5 where the tracer has work.
@group(1) @binding(0) var base_color: texture_2d<f32>;
// One entry a block: first its count, after the scan the place of its first pixel; then the count of all.
@group(1) @binding(1) var<storage, read_write> blocks: array<u32>;
@group(1) @binding(2) var<storage, read_write> pixels: array<u32>;

var<workgroup> partial: array<u32, COMPACT_BLOCK>;

// False: row by row. True: by squares of 8 x 8, in each of which pixels are in Z order (Morton, 1966).
override BY_SQUARES: bool = false;

// Every second bit of six.
fn even_bits(k: u32) -> u32 {
    return (k & 1u) | ((k >> 1u) & 2u) | ((k >> 2u) & 4u);
}

// The number of the pixel that is `i`-th in the order of the list. Squares cut by the right or lower edge are row by row.
fn pixel_at(i: u32) -> u32 {
    let size = textureDimensions(base_color);
    if !BY_SQUARES || i >= size.x * size.y {
        return i;
    }
    let strip = i / (8u * size.x);
    let rows = min(8u, size.y - 8u * strip);
    let within = i % (8u * size.x);
    let square = within / (8u * rows);
    let columns = min(8u, size.x - 8u * square);
    let k = within % (8u * rows);
    var place = vec2u(k % columns, k / columns);
    if rows * columns == 64u {
        place = vec2u(even_bits(k), even_bits(k >> 1u));
    }
    return (8u * strip + place.y) * size.x + 8u * square + place.x;
}

fn is_traced(pixel: u32) -> bool {
    let size = textureDimensions(base_color);
    if pixel >= size.x * size.y {
        return false;
    }
    return textureLoad(base_color, vec2u(pixel % size.x, pixel / size.x), 0).w > 0.5;
}

fn block_count() -> u32 {
    let size = textureDimensions(base_color);
    return (size.x * size.y + COMPACT_BLOCK - 1u) / COMPACT_BLOCK;
}

// Sum over this and all earlier invocations of the workgroup.
fn inclusive_scan(lane: u32, value: u32) -> u32 {
    partial[lane] = value;
    workgroupBarrier();
    for (var step = 1u; step < COMPACT_BLOCK; step <<= 1u) {
        var earlier = 0u;
        if lane >= step {
            earlier = partial[lane - step];
        }
        workgroupBarrier();
        partial[lane] += earlier;
        workgroupBarrier();
    }
    return partial[lane];
}

@compute @workgroup_size(COMPACT_BLOCK)
fn count(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = group.y * groups.x + group.x;
    let rank = inclusive_scan(lane, u32(is_traced(pixel_at(block * COMPACT_BLOCK + lane))));
    if lane == COMPACT_BLOCK - 1u && block < block_count() {
        blocks[block] = rank;
    }
}

@compute @workgroup_size(COMPACT_BLOCK)
fn scan(@builtin(local_invocation_index) lane: u32) {
    let total = block_count();
    let each = (total + COMPACT_BLOCK - 1u) / COMPACT_BLOCK;
    let first = min(lane * each, total);
    let end = min(first + each, total);
    var sum = 0u;
    for (var i = first; i < end; i += 1u) {
        sum += blocks[i];
    }
    let inclusive = inclusive_scan(lane, sum);
    var next = inclusive - sum;
    for (var i = first; i < end; i += 1u) {
        let here = blocks[i];
        blocks[i] = next;
        next += here;
    }
    if lane == COMPACT_BLOCK - 1u {
        blocks[total] = inclusive;
    }
}

@compute @workgroup_size(COMPACT_BLOCK)
fn scatter(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = group.y * groups.x + group.x;
    let pixel = pixel_at(block * COMPACT_BLOCK + lane);
    let traced = is_traced(pixel);
    let rank = inclusive_scan(lane, u32(traced));
    if traced {
        pixels[blocks[block] + rank - 1u] = pixel;
    }
}
