// VPLs in a uniform buffer: on llvmpipe twice as fast as a storage buffer, and constant-cached on GPUs.
#import shared/vpl

struct IndirectUniform {
    // VPLs of this chunk.
    count: u32,
    // VPLs of the chunks before it; 0: there is nothing to add to.
    first: u32,
    geometry_term_max: f32,
    // Texels a side of the VPLs' shadow maps; 0: they throw none.
    map_size: u32,
    // VPLs of all chunks.
    all: u32,
    // Side of the blocks of pixels over which VPLs are interleaved; 1: each lights all pixels.
    interleave: u32,
    unused0: u32,
    unused1: u32,
    vpls: array<Vpl, VPL_CHUNK>,
}
