//! Interpenetration: clothing vertices inside the body.

use std::collections::HashMap;

use cape_core::{
    Mesh,
    geometry::{SurfaceIndex, SurfaceMesh},
};
use rayon::prelude::*;

use crate::{Error, Result};

/// Share of the vertices `clothing`, moved by `displacements: [n][3 V]`, metres, that are inside
/// the closed surface `body`, by the angle-weighted normal at the closest point.
pub(super) fn inside_share(
    displacements: &[Vec<f32>],
    clothing: &[usize],
    body: &Mesh,
) -> Result<f64> {
    let surface = SurfaceMesh::from_mesh("body", body)?;
    expect_oriented(&surface.faces)?;
    let solid = SurfaceIndex::new(&surface);
    let inside: usize = displacements
        .par_iter()
        .map(|row| {
            let within = |&&vertex: &&usize| {
                let at =
                    [0, 1, 2].map(|i| f64::from(body.vertices[vertex][i] + row[3 * vertex + i]));
                let closest = solid.closest(at.into(), f64::INFINITY);
                closest.is_some_and(|closest| closest.signed_distance < 0.0)
            };
            clothing.iter().filter(within).count()
        })
        .sum();
    Ok(inside as f64 / (displacements.len() * clothing.len()).max(1) as f64)
}

/// An error unless every face has three different corners and neighbouring faces run through their
/// common edge in opposite directions: otherwise inside and outside are not defined.
fn expect_oriented(faces: &[[u32; 3]]) -> Result<()> {
    let mut edges: HashMap<[u32; 2], usize> = HashMap::new();
    for (face, &[a, b, c]) in faces.iter().enumerate() {
        if a == b || b == c || c == a {
            return Err(Error::data(format!("body: face {face} has one corner twice")));
        }
        for edge in [[a, b], [b, c], [c, a]] {
            if let Some(other) = edges.insert(edge, face) {
                return Err(Error::data(format!(
                    "body: faces {other} and {face} have the edge {edge:?} in the same direction: \
                     orient all faces outward"
                )));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two cubes of side 2, 1 apart along x.
    fn cubes() -> Mesh {
        let corner = |i: u32, x: f32| {
            let side = |bit: u32| if i & bit == 0 { -1.0 } else { 1.0 };
            [x + side(1), side(2), side(4)]
        };
        let quads =
            [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let mut mesh = Mesh { vertices: Vec::new(), faces: Vec::new() };
        for x in [0.0, 3.0] {
            let first = mesh.vertices.len() as u32;
            mesh.vertices.extend((0..8).map(|i| corner(i, x)));
            for [a, b, c, d] in quads.map(|quad| quad.map(|i| first + i)) {
                mesh.faces.extend([[a, b, c], [a, c, d]]);
            }
        }
        mesh
    }

    #[test]
    fn faces_of_opposite_orientation_are_refused() {
        let mut body = cubes();
        body.faces[3].swap(0, 1);
        let message = inside_share(&[], &[], &body).unwrap_err().to_string();
        assert!(message.contains("same direction"), "{message}");
    }

    #[test]
    fn inside_is_inside_any_part_of_the_body() {
        let body = cubes();
        let clothing: Vec<usize> = (0..8).collect();
        let share = |factor: f32, along: f32| {
            let row = body
                .vertices
                .iter()
                .flat_map(|&[x, y, z]| [factor * x + along, factor * y, factor * z]);
            inside_share(&[row.collect()], &clothing, &body).unwrap()
        };
        assert_eq!(share(0.01, 0.0), 0.0);
        assert_eq!(share(-0.01, 0.0), 1.0);
        // The second cube begins at x = 2. Shrunk by 10 % and moved along x by 1.5, four corners
        // are in the second cube and four still in the first.
        assert_eq!(share(-0.1, 1.5), 1.0);
        // Moved by 1.05, four corners are between the cubes.
        assert_eq!(share(-0.1, 1.05), 0.5);
    }
}
