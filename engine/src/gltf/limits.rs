//! How much a file may ask for.

/// Bounds on what one import may read, decode or build. The defaults are far beyond what a game loads as one file and
/// keep a hostile file from exhausting the machine: the worst that we could make (hundreds of bytes that ask for the most
/// vertices and triangles) took 1 GiB and 2.4 s. Passing one is [`super::GltfError::Limit`] with name and value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImportLimits {
    /// Bytes of the file and all files that it names, together. Default 2 GiB.
    pub bytes: u64,
    /// Values in the JSON text (a node takes about ten). Default 4,194,304.
    pub json_tokens: u64,
    /// Vertices of all meshes built, shared ones once; each morph target that is applied counts again. Default 16,777,216.
    pub vertices: u64,
    /// Triangles of all meshes built, shared ones once. Default 16,777,216.
    pub triangles: u64,
    /// Texels of one image. Default 8192 x 8192.
    pub image_pixels: u64,
    /// Texels of all images decoded, together. Default 536,870,912.
    pub texture_pixels: u64,
    /// Nodes in the file. Default 262,144.
    pub nodes: u64,
    /// Mesh primitives of all nodes, together. Default 1,048,576.
    pub instances: u64,
    /// Depth of the node hierarchy. Default 256.
    pub depth: u64,
    /// Largest absolute coordinate, metres, in object and world space. Default 1e9.
    pub coordinate: f32,
}

impl Default for ImportLimits {
    fn default() -> Self {
        Self {
            bytes: 2 << 30,
            json_tokens: 1 << 22,
            vertices: 1 << 24,
            triangles: 1 << 24,
            image_pixels: 1 << 26,
            texture_pixels: 1 << 29,
            nodes: 1 << 18,
            instances: 1 << 20,
            depth: 256,
            coordinate: 1e9,
        }
    }
}
