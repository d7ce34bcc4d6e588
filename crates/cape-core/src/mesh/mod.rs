mod file;
#[cfg(test)]
mod file_tests;
mod mirror;
mod off;
mod polygon;
mod report;
mod stl;
pub(crate) mod text;

use std::path::Path;

use glam::Vec3;

use crate::{Error, Result, obj, ply};

pub(crate) use file::{Geometry, places, read_bytes};
pub use file::{MESH_EXTENSIONS, MeshFile, MeshFormat};
pub use mirror::MirrorSymmetry;
pub(crate) use polygon::{fan, is_face, strip};
pub use report::MeshReport;

/// Triangle mesh in `f32`.
///
/// ```
/// use cape_core::Mesh;
///
/// let tetrahedron = Mesh {
///     vertices: vec![[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]],
///     faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
/// };
/// assert_eq!(tetrahedron.edges().len(), 6);
/// assert_eq!(tetrahedron.euler_characteristic(), 2);
/// assert_eq!(tetrahedron.face_normals()[0], [0., 0., -1.]);
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("tetrahedron.ply");
/// tetrahedron.save(&path)?;
/// assert_eq!(Mesh::load(&path)?, tetrahedron);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions, metres, `[vertices, 3]`.
    pub vertices: Vec<[f32; 3]>,
    /// Vertex indices of each triangle, counter-clockwise seen from outside, `[faces, 3]`.
    pub faces: Vec<[u32; 3]>,
}

impl Mesh {
    /// Reads an OBJ, PLY, STL, OFF or `.glb` file; its content selects the format. [`MeshFile`] also
    /// has its normals, and accepts points that are not finite.
    ///
    /// # Errors
    /// If the file cannot be read, is malformed, or has a vertex that is not finite.
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        MeshFile::read(path.as_ref())?.finite(path.as_ref())
    }

    /// Writes an `.obj` or binary `.ply` file; the extension selects the format.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        let is = |name| path.extension().is_some_and(|found| found.eq_ignore_ascii_case(name));
        match (is("obj"), is("ply")) {
            (true, _) => obj::write(path, self, None),
            (_, true) => ply::write(path, self, None),
            _ => Err(Error::format(path, "unknown mesh format: expected .obj or .ply")),
        }
    }

    /// Positions of the corners of a face, metres; `None` if a vertex index is out of range.
    pub fn corners(&self, face: [u32; 3]) -> Option<[Vec3; 3]> {
        let corner = |index: u32| self.vertices.get(index as usize).map(|&v| Vec3::from(v));
        Some([corner(face[0])?, corner(face[1])?, corner(face[2])?])
    }

    /// Unit normals of the faces, `[faces, 3]`; zero for degenerate or out-of-range faces.
    pub fn face_normals(&self) -> Vec<[f32; 3]> {
        let normal = |&face| self.scaled_normal(face).normalize_or_zero().into();
        self.faces.iter().map(normal).collect()
    }

    /// Unit normals of the vertices, area-weighted, `[vertices, 3]`; zero for isolated vertices.
    pub fn vertex_normals(&self) -> Vec<[f32; 3]> {
        let mut sums = vec![Vec3::ZERO; self.vertices.len()];
        for &face in &self.faces {
            let normal = self.scaled_normal(face);
            for corner in face {
                if let Some(sum) = sums.get_mut(corner as usize) {
                    *sum += normal;
                }
            }
        }
        sums.into_iter().map(|sum| sum.normalize_or_zero().into()).collect()
    }

    /// Normal of a face, with twice the face area as its length.
    fn scaled_normal(&self, face: [u32; 3]) -> Vec3 {
        self.corners(face).map_or(Vec3::ZERO, |[a, b, c]| (b - a).cross(c - a))
    }

    /// Undirected edges, each once, smaller index first, in ascending order, `[edges, 2]`.
    pub fn edges(&self) -> Vec<[u32; 2]> {
        let mut edges: Vec<[u32; 2]> =
            self.faces.iter().flat_map(|&face| face_edges(face)).collect();
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    /// Axis-aligned bounding box as smallest and largest coordinates, metres; `None` without
    /// vertices.
    pub fn bounding_box(&self) -> Option<[[f32; 3]; 2]> {
        let mut vertices = self.vertices.iter().map(|&v| Vec3::from(v));
        let first = vertices.next()?;
        let (low, high) = vertices.fold((first, first), |(l, h), v| (l.min(v), h.max(v)));
        Some([low.into(), high.into()])
    }

    /// Euler characteristic `V − E + F`: 2 for a connected closed surface of genus 0.
    pub fn euler_characteristic(&self) -> i64 {
        let count = |n: usize| n as i64;
        count(self.vertices.len()) - count(self.edges().len()) + count(self.faces.len())
    }

    /// Report of degenerate, duplicate, boundary and other irregular elements.
    pub fn validate(&self) -> MeshReport {
        MeshReport::from_mesh(self)
    }
}

/// Undirected edges of a face, smaller index first.
fn face_edges([a, b, c]: [u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]].map(|[p, q]| [p.min(q), p.max(q)])
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Unit cube of 12 triangles, oriented outwards.
    pub(crate) fn cube() -> Mesh {
        let vertices = (0..8u8).map(|i| [i & 1, i >> 1 & 1, i >> 2].map(f32::from)).collect();
        let quads: [[u32; 4]; 6] =
            [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let faces = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        Mesh { vertices, faces }
    }

    #[test]
    fn properties_of_a_cube() {
        let cube = cube();
        assert_eq!(cube.edges().len(), 18);
        assert_eq!(cube.euler_characteristic(), 2);
        assert_eq!(cube.bounding_box(), Some([[0.0; 3], [1.0; 3]]));
        assert_eq!(cube.face_normals()[0], [0.0, 0.0, -1.0]);
        assert_eq!(cube.face_normals()[10], [1.0, 0.0, 0.0]);
        // Outward: every normal points away from the centre.
        for (vertex, normal) in cube.vertices.iter().zip(cube.vertex_normals()) {
            let outward = Vec3::from(*vertex) - Vec3::splat(0.5);
            assert!(Vec3::from(normal).dot(outward) > 0.5);
            assert!((Vec3::from(normal).length() - 1.0).abs() < 1e-6);
        }
        assert_eq!(cube.validate(), MeshReport::default());
    }

    #[test]
    fn normals_are_weighted_by_area() {
        // Two faces at a right angle, one four times as large.
        let mesh = Mesh {
            vertices: vec![[0., 0., 0.], [0., 1., 0.], [1., 0., 0.], [0., 0., 4.]],
            faces: vec![[0, 2, 1], [0, 1, 3]],
        };
        let normal = Vec3::from(mesh.vertex_normals()[0]);
        let expected = Vec3::new(4.0, 0.0, 1.0).normalize();
        assert!(normal.abs_diff_eq(expected, 1e-6), "{normal}");
    }

    #[test]
    fn inconsistent_meshes_do_not_panic() {
        let mesh = Mesh { vertices: vec![[0.0; 3]], faces: vec![[0, 7, 1], [0, 0, 0]] };
        assert_eq!(mesh.vertex_normals(), [[0.0; 3]]);
        assert_eq!(mesh.face_normals(), [[0.0; 3]; 2]);
        assert_eq!(Mesh::default().bounding_box(), None);
        assert!(
            Mesh::default()
                .save("a.stl")
                .unwrap_err()
                .to_string()
                .contains("expected .obj or .ply")
        );
    }
}
