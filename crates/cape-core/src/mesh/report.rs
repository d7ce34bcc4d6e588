use std::{collections::HashSet, fmt};

use super::{Mesh, face_edges};

/// Twice the area of a degenerate face, relative to the square of its longest edge.
const DEGENERATE_AREA: f64 = 1e-10;

/// Irregular elements of a mesh, by index. All lists are ascending, and empty for a closed
/// manifold.
///
/// ```
/// use cape_core::Mesh;
///
/// let triangle = Mesh {
///     vertices: vec![[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [9., 9., 9.]],
///     faces: vec![[0, 1, 2]],
/// };
/// let report = triangle.validate();
/// assert_ne!(report, Default::default());
/// assert_eq!(report.boundary_edges, [[0, 1], [0, 2], [1, 2]]);
/// assert_eq!(report.isolated, [3]);
/// assert_eq!(report.to_string(), "3 boundary edges, 1 isolated vertices");
/// ```
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct MeshReport {
    /// Faces with a vertex index out of range.
    pub out_of_range: Vec<usize>,
    /// Faces without area: repeated or collinear corners.
    pub degenerate: Vec<usize>,
    /// Faces with the corners of an earlier face, in any order.
    pub duplicate: Vec<usize>,
    /// Edges of a single face.
    pub boundary_edges: Vec<[u32; 2]>,
    /// Edges of more than two faces.
    pub non_manifold_edges: Vec<[u32; 2]>,
    /// Vertices without faces.
    pub isolated: Vec<usize>,
    /// Vertices with a NaN or infinite coordinate.
    pub non_finite: Vec<usize>,
}

impl MeshReport {
    pub(super) fn from_mesh(mesh: &Mesh) -> Self {
        let mut report = Self::default();
        let mut used = vec![false; mesh.vertices.len()];
        let mut seen = HashSet::new();
        let mut edges = Vec::with_capacity(3 * mesh.faces.len());
        for (index, &face) in mesh.faces.iter().enumerate() {
            let Some(corners) = mesh.corners(face) else {
                report.out_of_range.push(index);
                continue;
            };
            for corner in face {
                used[corner as usize] = true;
            }
            let [a, b, c] = corners.map(glam::Vec3::as_dvec3);
            let (u, v) = (b - a, c - a);
            let longest = u.length_squared().max(v.length_squared()).max((c - b).length_squared());
            if u.cross(v).length() <= DEGENERATE_AREA * longest {
                report.degenerate.push(index);
            }
            let mut key = face;
            key.sort_unstable();
            if !seen.insert(key) {
                report.duplicate.push(index);
            }
            edges.extend(face_edges(face).into_iter().filter(|[a, b]| a != b));
        }
        edges.sort_unstable();
        for faces in edges.chunk_by(|a, b| a == b) {
            match faces.len() {
                1 => report.boundary_edges.push(faces[0]),
                2 => {}
                _ => report.non_manifold_edges.push(faces[0]),
            }
        }
        let vertices = || 0..mesh.vertices.len();
        let finite = |&index: &usize| mesh.vertices[index].iter().all(|x| x.is_finite());
        report.isolated = vertices().filter(|&index| !used[index]).collect();
        report.non_finite = vertices().filter(|index| !finite(index)).collect();
        report
    }
}

impl fmt::Display for MeshReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counts = [
            (self.out_of_range.len(), "faces out of range"),
            (self.degenerate.len(), "degenerate faces"),
            (self.duplicate.len(), "duplicate faces"),
            (self.boundary_edges.len(), "boundary edges"),
            (self.non_manifold_edges.len(), "non-manifold edges"),
            (self.isolated.len(), "isolated vertices"),
            (self.non_finite.len(), "vertices that are not finite"),
        ];
        let found: Vec<String> = counts
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, name)| format!("{count} {name}"))
            .collect();
        f.write_str(if found.is_empty() { "closed manifold" } else { "" })?;
        f.write_str(&found.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use crate::mesh::tests::cube;

    #[test]
    fn irregular_elements_are_listed() {
        let mut mesh = cube();
        assert_eq!(mesh.validate().to_string(), "closed manifold");
        mesh.faces.pop();
        assert_eq!(mesh.validate().boundary_edges, [[1, 5], [1, 7], [5, 7]]);

        let mut mesh = cube();
        mesh.vertices.push([0.5, 0.5, 2.0]);
        mesh.vertices.push([f32::NAN, 0.0, 0.0]);
        mesh.faces.push([0, 1, 8]);
        mesh.faces.push([3, 0, 2]);
        mesh.faces.push([1, 1, 2]);
        mesh.faces.push([0, 1, 10]);
        let report = mesh.validate();
        assert_eq!(report.out_of_range, [15]);
        assert_eq!(report.degenerate, [14]);
        assert_eq!(report.duplicate, [13]);
        assert_eq!(report.isolated, [9]);
        assert_eq!(report.non_finite, [9]);
        assert!(report.non_manifold_edges.contains(&[0, 1]));
        assert!(report.boundary_edges.contains(&[0, 8]));
        assert!(report.to_string().starts_with("1 faces out of range, 1 degenerate faces"));
    }
}
