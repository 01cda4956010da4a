// The scene as every kernel of the tracer reads it: words of 16 bytes in six heaps, which lie in storage buffers or in
// textures (tracer/heaps, generated). Layouts: raster/tracer/layout.rs.
#import shared/scene
#import shared/camera
#import shared/triangle
#import shared/sample
#import shared/cutout
#import shared/look
#import shared/intersect
#import tracer/heaps

struct SceneHead {
    // Node of the upper tree, or NONE.
    tlas_root: u32,
    // First words in the dynamic heap.
    instances: u32,
    materials: u32,
    lights: u32,
    views: u32,
    // Most steps that a walk through these trees can take.
    traversal_cap: u32,
    // Greatest absolute coordinate of the upper tree's boxes, and the factor of their padding.
    extent: f32,
    slack: f32,
}
@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<uniform> srgb_table: array<vec4f, 64>;
@group(0) @binding(2) var<uniform> head: SceneHead;
