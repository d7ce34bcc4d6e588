use std::collections::HashSet;

use ndarray::Array2;
use rayon::prelude::*;

use super::Mesh;
use crate::{Error, Result};

/// Left-right symmetry of a body's mesh: for each vertex the one on the other side.
///
/// The plane of symmetry is x = 0, as in SMPL's rest pose.
///
/// ```
/// use cape_core::{Mesh, MirrorSymmetry};
/// use ndarray::array;
///
/// let mesh = Mesh {
///     vertices: vec![[1., 0., 0.], [-1., 0., 0.], [0., 1., 0.]],
///     faces: vec![[0, 2, 1]],
/// };
/// let symmetry = MirrorSymmetry::of(&mesh)?;
/// assert_eq!(symmetry.vertices(), [1, 0, 2]);
/// let sleeve = array![[0.1, 0., 0.], [0., 0., 0.], [0., 0.2, 0.]];
/// let mirrored = array![[0., 0., 0.], [-0.1, 0., 0.], [0., 0.2, 0.]];
/// assert_eq!(symmetry.mirror(&sleeve)?, mirrored);
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MirrorSymmetry {
    vertices: Vec<u32>,
}

impl MirrorSymmetry {
    /// Symmetry of a mesh in its rest pose: the vertex nearest to the reflected position of each. The
    /// positions may differ a little, as SMPL's; the triangles may not.
    ///
    /// # Errors
    /// If two vertices share their partner, or a triangle has none: the mesh has no such symmetry.
    pub fn of(mesh: &Mesh) -> Result<Self> {
        let none = |what: String| {
            Err(Error::Argument(format!("the mesh is not symmetric about the plane x = 0: {what}")))
        };
        let partner = |&[x, y, z]: &[f32; 3]| {
            let distance =
                |p: &[f32; 3]| (p[0] + x).powi(2) + (p[1] - y).powi(2) + (p[2] - z).powi(2);
            let nearest =
                mesh.vertices.iter().map(distance).enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
            nearest.map_or(0, |(vertex, _)| vertex as u32)
        };
        let vertices: Vec<u32> = mesh.vertices.par_iter().map(partner).collect();
        let of = |vertex: u32| vertices[vertex as usize];
        if let Some(vertex) = (0..vertices.len() as u32).find(|&vertex| of(of(vertex)) != vertex) {
            return none(format!("vertex {vertex} has no partner of its own"));
        }
        let corners = |mut face: [u32; 3]| {
            face.sort_unstable();
            face
        };
        let faces: HashSet<[u32; 3]> = mesh.faces.iter().map(|&face| corners(face)).collect();
        let alone = mesh.faces.iter().position(|face| !faces.contains(&corners(face.map(of))));
        if let Some(face) = alone {
            return none(format!("triangle {face} has no partner"));
        }
        Ok(Self { vertices })
    }

    /// Partner of each vertex; a vertex of the plane of symmetry is its own.
    pub fn vertices(&self) -> &[u32] {
        &self.vertices
    }

    /// Mirror image of a vector of each vertex, such as a displacement or a position, `[vertices, 3]`.
    ///
    /// # Errors
    /// If the number of vertices differs.
    pub fn mirror(&self, vectors: &Array2<f64>) -> Result<Array2<f64>> {
        if vectors.dim() != (self.vertices.len(), 3) {
            let (found, expected) = (vectors.dim(), (self.vertices.len(), 3));
            return Err(Error::Argument(format!("shape {found:?}, expected {expected:?}")));
        }
        Ok(Array2::from_shape_fn(vectors.dim(), |(vertex, axis)| {
            let value = vectors[[self.vertices[vertex] as usize, axis]];
            if axis == 0 { -value } else { value }
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tetrahedron whose plane of symmetry is x = 0.
    fn tetrahedron() -> Mesh {
        Mesh {
            vertices: vec![[1., 0., 0.], [-1.1, 0., 0.], [0., 1., 0.], [0.02, 0., 1.]],
            faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        }
    }

    #[test]
    fn small_differences_of_position_are_no_matter() {
        assert_eq!(MirrorSymmetry::of(&tetrahedron()).unwrap().vertices(), [1, 0, 2, 3]);
    }

    #[test]
    fn meshes_without_the_symmetry_are_refused() {
        let mut shared = tetrahedron();
        shared.vertices[1] = [3., 0., 0.];
        let mut lone = tetrahedron();
        lone.faces.pop();
        for (mesh, said) in
            [(shared, "vertex 0 has no partner"), (lone, "triangle 2 has no partner")]
        {
            let error = MirrorSymmetry::of(&mesh).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
        let symmetry = MirrorSymmetry::of(&tetrahedron()).unwrap();
        assert!(symmetry.mirror(&Array2::zeros((5, 3))).is_err());
    }
}
