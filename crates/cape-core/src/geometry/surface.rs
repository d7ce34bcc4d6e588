use std::collections::HashMap;

use glam::DVec3;
use ndarray::ArrayView2;

use crate::{Error, Mesh, Result, expect_finite};

/// Triangle surface in `f64`, for geometric computations ([`Mesh`] is its `f32` form for files).
///
/// ```
/// use cape_core::geometry::{SurfaceMesh, primitives::sphere};
///
/// // Without subdivision the sphere is an octahedron.
/// let surface = sphere(1.0, 0);
/// assert_eq!((surface.face_normals().len(), surface.edges().len()), (8, 12));
/// assert!((surface.volume() - 4.0 / 3.0).abs() < 1e-12);
/// assert!((surface.mean_edge() - 2f64.sqrt()).abs() < 1e-12);
/// assert!(surface.boundary().iter().all(|&open| !open));
/// // Vertex 6 does not exist.
/// assert!(SurfaceMesh::new("clothing", surface.vertices, vec![[0, 1, 6]]).is_err());
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SurfaceMesh {
    /// Vertex positions, metres, `[vertices]`.
    pub vertices: Vec<DVec3>,
    /// Vertex indices of each triangle, counter-clockwise seen from outside, `[faces, 3]`.
    pub faces: Vec<[u32; 3]>,
}

impl SurfaceMesh {
    /// Builds a surface; `mesh` is its name in errors.
    ///
    /// # Errors
    /// If there is no face, a vertex index is out of range, or a coordinate is not finite.
    pub fn new(mesh: &'static str, vertices: Vec<DVec3>, faces: Vec<[u32; 3]>) -> Result<Self> {
        let count = vertices.len();
        if faces.is_empty() {
            return Err(Error::surface(mesh, format!("has {count} vertices and no faces")));
        }
        if let Some((at, face)) =
            faces.iter().enumerate().find(|(_, face)| face.iter().any(|&v| v as usize >= count))
        {
            let message = format!("face {at} is {face:?}, out of range for {count} vertices");
            return Err(Error::surface(mesh, message));
        }
        expect_finite(mesh, vertices.iter().flat_map(AsRef::<[f64; 3]>::as_ref))?;
        Ok(Self { vertices, faces })
    }

    /// Builds a surface from vertex positions `[vertices, 3]`, metres.
    pub fn from_rows(
        mesh: &'static str,
        vertices: ArrayView2<'_, f64>,
        faces: &[[u32; 3]],
    ) -> Result<Self> {
        if vertices.ncols() != 3 {
            let message = format!("vertices have {} coordinates, expected 3", vertices.ncols());
            return Err(Error::surface(mesh, message));
        }
        Self::new(mesh, points(vertices), faces.to_vec())
    }

    /// Converts a mesh to `f64`.
    pub fn from_mesh(mesh: &'static str, from: &Mesh) -> Result<Self> {
        let vertices = from.vertices.iter().map(|v| DVec3::from(v.map(f64::from))).collect();
        Self::new(mesh, vertices, from.faces.clone())
    }

    /// Converts the surface to `f32`.
    pub fn to_mesh(&self) -> Mesh {
        let vertices = self.vertices.iter().map(|v| v.as_vec3().to_array()).collect();
        Mesh { vertices, faces: self.faces.clone() }
    }

    /// Positions of the corners of a face, metres.
    pub fn corners(&self, face: usize) -> [DVec3; 3] {
        self.faces[face].map(|v| self.vertices[v as usize])
    }

    /// Unit normals of the faces, `[faces]`; zero for degenerate faces.
    pub fn face_normals(&self) -> Vec<DVec3> {
        face_normals(&self.vertices, &self.faces)
    }

    /// Unit normals of the vertices, angle-weighted, `[vertices]`.
    pub fn vertex_normals(&self) -> Vec<DVec3> {
        vertex_normals(&self.vertices, &self.faces, &self.face_normals())
    }

    /// Undirected edges, each once, smaller index first, in ascending order, `[edges, 2]`.
    pub fn edges(&self) -> Vec<[u32; 2]> {
        let edge = |p: u32, q: u32| [p.min(q), p.max(q)];
        let mut edges: Vec<[u32; 2]> =
            self.faces.iter().flat_map(|&[a, b, c]| [edge(a, b), edge(b, c), edge(c, a)]).collect();
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    /// Faces of each vertex, ascending, `[vertices, …]`.
    pub fn vertex_faces(&self) -> Vec<Vec<u32>> {
        let mut around = vec![Vec::new(); self.vertices.len()];
        for (face, corners) in self.faces.iter().enumerate() {
            for &corner in corners {
                around[corner as usize].push(face as u32);
            }
        }
        around
    }

    /// Adjacent faces, `[faces, 3]`: entry `i` shares the edge from corner `i` to corner `i + 1`.
    pub fn neighbours(&self) -> Vec<[Option<u32>; 3]> {
        let mut at: HashMap<[u32; 2], (usize, usize)> = HashMap::new();
        let mut across = vec![[None; 3]; self.faces.len()];
        for (face, corners) in self.faces.iter().enumerate() {
            for side in 0..3 {
                let (p, q) = (corners[side], corners[(side + 1) % 3]);
                if let Some((other, its)) = at.insert([p.min(q), p.max(q)], (face, side)) {
                    across[face][side] = Some(other as u32);
                    across[other][its] = Some(face as u32);
                }
            }
        }
        across
    }

    /// Boundary flags of the vertices, `[vertices]`: true on edges of a single face.
    pub fn boundary(&self) -> Vec<bool> {
        let mut on = vec![false; self.vertices.len()];
        for (corners, across) in self.faces.iter().zip(self.neighbours()) {
            for side in (0..3).filter(|&side| across[side].is_none()) {
                on[corners[side] as usize] = true;
                on[corners[(side + 1) % 3] as usize] = true;
            }
        }
        on
    }

    /// Signed volume of a closed surface, cubic metres; positive for outward orientation.
    pub fn volume(&self) -> f64 {
        (0..self.faces.len())
            .map(|face| {
                let [a, b, c] = self.corners(face);
                a.dot(b.cross(c)) / 6.0
            })
            .sum()
    }

    /// Mean length of the edges, metres.
    pub fn mean_edge(&self) -> f64 {
        let edges = self.edges();
        let length =
            |&[a, b]: &[u32; 2]| self.vertices[a as usize].distance(self.vertices[b as usize]);
        edges.iter().map(length).sum::<f64>() / edges.len().max(1) as f64
    }
}

/// Rows `[n, 3]` as points, `[n]`.
pub fn points(rows: ArrayView2<'_, f64>) -> Vec<DVec3> {
    rows.rows().into_iter().map(|row| DVec3::new(row[0], row[1], row[2])).collect()
}

/// Unit normals of triangles, `[faces]`; zero for degenerate triangles.
pub fn face_normals(vertices: &[DVec3], faces: &[[u32; 3]]) -> Vec<DVec3> {
    let normal = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|v| vertices[v as usize]);
        (b - a).cross(c - a).normalize_or_zero()
    };
    faces.iter().map(normal).collect()
}

/// Angle-weighted pseudo-normals (Bærentzen and Aanæs 2005), `[vertices]`.
fn vertex_normals(vertices: &[DVec3], faces: &[[u32; 3]], face_normals: &[DVec3]) -> Vec<DVec3> {
    let mut sums = vec![DVec3::ZERO; vertices.len()];
    for (face, &normal) in faces.iter().zip(face_normals) {
        let corners = face.map(|v| vertices[v as usize]);
        for i in 0..3 {
            sums[face[i] as usize] += normal * corner_angle(corners, i);
        }
    }
    sums.into_iter().map(DVec3::normalize_or_zero).collect()
}

/// Interior angle of a triangle at one of its corners, radians.
pub fn corner_angle(corners: [DVec3; 3], corner: usize) -> f64 {
    let from = corners[corner];
    let (p, q) = (corners[(corner + 1) % 3] - from, corners[(corner + 2) % 3] - from);
    p.cross(q).length().atan2(p.dot(q))
}
