// VPLs in a uniform buffer: on llvmpipe twice as fast as a storage buffer, and constant-cached on GPUs.
#import shared/vpl

struct IndirectUniform {
    count: u32,
    // 0 for the first chunk, which has nothing to add to.
    accumulate: u32,
    geometry_term_max: f32,
    // Texels a side of the VPLs' shadow maps; 0: they throw none.
    map_size: u32,
    vpls: array<Vpl, VPL_CHUNK>,
}
