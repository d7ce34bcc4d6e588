/// A triangle mesh.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions in metres, `[vertices, 3]`.
    pub vertices: Vec<[f32; 3]>,
    /// Vertex indices of each triangle, counter-clockwise seen from outside, `[faces, 3]`.
    pub faces: Vec<[u32; 3]>,
}
