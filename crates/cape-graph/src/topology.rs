//! Surfaces in double precision: validation, edges and adjacency.

use std::collections::HashMap;

use cape_core::{Mesh, SmplModel};
use sprs::CsMat;

use crate::vector::{cross, dot, sub};
use crate::{Error, Result};

/// Twice the area of a triangle over its longest edge squared, up to which it is degenerate.
const FLATNESS: f64 = 1e-12;

/// Triangle mesh in double precision, for simplification and projection.
///
/// ```
/// use cape_synth::synthetic_body;
/// use cape_graph::{EdgeCounts, Surface};
///
/// let body = Surface::from(&synthetic_body());
/// body.validate()?;
/// // Closed: every edge has two faces, and every face three edges.
/// let edges = 3 * body.faces.len() / 2;
/// assert_eq!(body.edge_counts(), EdgeCounts { edges, boundary: 0, non_manifold: 0 });
/// assert_eq!(body.adjacency().nnz(), 2 * edges);
/// # Ok::<(), cape_graph::Error>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Surface {
    /// Vertex positions in metres, `[vertices, 3]`.
    pub vertices: Vec<[f64; 3]>,
    /// Vertex indices of each triangle, `[faces, 3]`.
    pub faces: Vec<[u32; 3]>,
}

impl From<&Mesh> for Surface {
    fn from(mesh: &Mesh) -> Self {
        Self {
            vertices: mesh.vertices.iter().map(|v| v.map(f64::from)).collect(),
            faces: mesh.faces.clone(),
        }
    }
}

/// Template of the body.
impl From<&SmplModel> for Surface {
    fn from(body: &SmplModel) -> Self {
        let vertices = body.v_template.rows().into_iter().map(|v| [v[0], v[1], v[2]]).collect();
        Self { vertices, faces: body.faces.clone() }
    }
}

impl From<&Surface> for Mesh {
    fn from(surface: &Surface) -> Self {
        Self {
            vertices: surface.vertices.iter().map(|v| v.map(|x| x as f32)).collect(),
            faces: surface.faces.clone(),
        }
    }
}

impl From<&Surface> for Surface {
    fn from(surface: &Surface) -> Self {
        surface.clone()
    }
}

impl Surface {
    /// Returns an error unless a pyramid can be built of this mesh: it needs at least four vertices,
    /// all finite and all used by a face, and faces of existing, distinct vertices with an area.
    /// Boundaries and non-manifold edges are allowed, see [`Surface::edge_counts`].
    pub fn validate(&self) -> Result<()> {
        if self.faces.is_empty() {
            return Err(Error::NoFaces { vertices: self.vertices.len() });
        }
        self.validate_topology()?;
        for (face, &corners) in self.faces.iter().enumerate() {
            let [a, b, c] = corners.map(|v| self.vertices[v as usize]);
            let (ab, bc, ca) = (sub(b, a), sub(c, b), sub(a, c));
            let normal = cross(ab, ca);
            let longest = dot(ab, ab).max(dot(bc, bc)).max(dot(ca, ca));
            if dot(normal, normal).sqrt() <= FLATNESS * longest {
                return Err(Error::DegenerateFace { face, corners });
            }
        }
        Ok(())
    }

    /// [`Surface::validate`] without the areas: simplification may make faces degenerate.
    pub(crate) fn validate_topology(&self) -> Result<()> {
        let vertices = self.vertices.len();
        if vertices < 4 {
            return Err(Error::TooFewVertices { vertices });
        }
        let broken = |position: &[f64; 3]| !position.iter().all(|x| x.is_finite());
        if let Some(vertex) = self.vertices.iter().position(broken) {
            return Err(Error::NonFinite { vertex, position: self.vertices[vertex] });
        }
        let mut used = vec![false; vertices];
        for (face, &corners) in self.faces.iter().enumerate() {
            for vertex in corners {
                *used.get_mut(vertex as usize).ok_or(Error::FaceOutOfRange {
                    face,
                    vertex,
                    vertices,
                })? = true;
            }
            let [a, b, c] = corners;
            if a == b || b == c || c == a {
                return Err(Error::DegenerateFace { face, corners });
            }
        }
        if let Some(vertex) = used.iter().position(|&used| !used) {
            let count = used.iter().filter(|&&used| !used).count();
            return Err(Error::IsolatedVertex { vertex, count });
        }
        Ok(())
    }

    /// Number of edges, and of those without exactly two faces.
    pub fn edge_counts(&self) -> EdgeCounts {
        let mut faces_at: HashMap<[u32; 2], u32> = HashMap::new();
        for edge in face_edges(&self.faces) {
            *faces_at.entry(edge).or_default() += 1;
        }
        EdgeCounts {
            edges: faces_at.len(),
            boundary: faces_at.values().filter(|&&n| n == 1).count(),
            non_manifold: faces_at.values().filter(|&&n| n > 2).count(),
        }
    }

    /// Undirected edges `[a, b]`, `a < b`, sorted.
    pub fn edges(&self) -> Vec<[u32; 2]> {
        let vertices = self.vertices.len();
        let mut starts = vec![0; vertices + 1];
        for [a, b] in face_edges(&self.faces) {
            if b as usize >= vertices {
                return self.edges_of_any_faces();
            }
            starts[a as usize + 1] += 1;
        }
        for a in 0..vertices {
            starts[a + 1] += starts[a];
        }
        // The second vertices of the edges at each first one; a few each, which are quick to sort.
        let mut places = starts.clone();
        let mut seconds = vec![0; starts[vertices]];
        for [a, b] in face_edges(&self.faces) {
            let place = &mut places[a as usize];
            seconds[*place] = b;
            *place += 1;
        }
        let mut edges = Vec::with_capacity(seconds.len() / 2);
        for a in 0..vertices {
            let seconds = &mut seconds[starts[a]..starts[a + 1]];
            seconds.sort_unstable();
            let of_a = seconds.chunk_by(|b, c| b == c).map(|same| [a as u32, same[0]]);
            edges.extend(of_a);
        }
        edges
    }

    /// [`edges`](Self::edges) of faces that name vertices which do not exist.
    fn edges_of_any_faces(&self) -> Vec<[u32; 2]> {
        let mut edges: Vec<_> = face_edges(&self.faces).collect();
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    /// Symmetric 0/1 adjacency without self-loops, CSR, `[vertices, vertices]`.
    pub fn adjacency(&self) -> CsMat<f64> {
        let (n, edges) = (self.vertices.len(), self.edges());
        let mut starts = vec![0; n + 1];
        for vertex in edges.as_flattened() {
            starts[*vertex as usize + 1] += 1;
        }
        for vertex in 0..n {
            starts[vertex + 1] += starts[vertex];
        }
        // The edges are sorted: a vertex meets its lower neighbours first, and all in ascending order.
        let mut places = starts.clone();
        let mut neighbours = vec![0; 2 * edges.len()];
        for [a, b] in edges.iter().map(|edge| edge.map(|vertex| vertex as usize)) {
            for (vertex, neighbour) in [(a, b), (b, a)] {
                neighbours[places[vertex]] = neighbour;
                places[vertex] += 1;
            }
        }
        CsMat::new((n, n), starts, neighbours, vec![1.0; 2 * edges.len()])
    }
}

/// Numbers of edges of a mesh. A closed manifold has neither boundary nor non-manifold edges;
/// simplification may create the latter.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct EdgeCounts {
    /// Number of edges.
    pub edges: usize,
    /// Number of edges with one face.
    pub boundary: usize,
    /// Number of edges with three faces or more.
    pub non_manifold: usize,
}

fn face_edges(faces: &[[u32; 3]]) -> impl Iterator<Item = [u32; 2]> {
    faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]].map(|[a, b]| [a.min(b), a.max(b)]))
}
