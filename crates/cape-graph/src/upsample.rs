//! Interpolation weights from the projections of fine vertices onto the coarse surface.

use parry3d_f64::math::Vector;
use parry3d_f64::query::PointQueryWithLocation;
use parry3d_f64::shape::{TriMesh, TrianglePointLocation};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sprs::CsMat;

use crate::topology::Surface;
use crate::vector::{V3, dot, sub};
use crate::{Error, Result};

/// Least number of rows of a thread.
const MIN_ROWS: usize = 256;

/// Method of interpolation from a level to the next finer one. Trained weights depend on it, so it
/// is saved with the pyramid.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Weighting {
    /// Barycentric weights of the closest point in its triangle: non-negative, summing to 1.
    #[default]
    Barycentric,
    /// Weights of the authors' released models. Inside a triangle and on a vertex as above; on an
    /// edge, the least-squares solution of `[va vb] w ≈ fine vertex` (not its closest point), which
    /// need not sum to 1.
    Release,
}

impl Weighting {
    /// Name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Barycentric => "barycentric",
            Self::Release => "release",
        }
    }

    /// Weighting by its name in files.
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Barycentric, Self::Release].into_iter().find(|weighting| weighting.name() == name)
    }
}

/// Interpolation matrix `[fine vertices, coarse vertices]`, CSR: in every row up to three weights,
/// those of the point of `coarse` closest to the fine vertex.
///
/// `kept[i]` is the index in `fine` of coarse vertex `i`; the rows of these vertices have a single 1.
pub fn upsample(
    fine: &[[f64; 3]],
    coarse: &Surface,
    kept: &[u32],
    weighting: Weighting,
) -> Result<CsMat<f64>> {
    let points = coarse.vertices.iter().copied().map(Vector::from).collect();
    let mesh = TriMesh::new(points, coarse.faces.clone())
        .map_err(|_| Error::NoFaces { vertices: coarse.vertices.len() })?;

    let mut coarse_of = vec![None; fine.len()];
    for (index, &vertex) in kept.iter().enumerate() {
        coarse_of[vertex as usize] = Some(index);
    }
    let row = |(&vertex, coarse_vertex): (&V3, Option<usize>)| {
        let mut row = match coarse_vertex {
            Some(index) => vec![(index, 1.0)],
            None => weights(vertex, coarse, &mesh, weighting),
        };
        row.sort_unstable_by_key(|&(index, _)| index);
        row
    };
    let rows: Vec<_> = fine.par_iter().zip(coarse_of).with_min_len(MIN_ROWS).map(row).collect();
    let mut indptr = vec![0];
    indptr.extend(rows.iter().scan(0, |end, row| {
        *end += row.len();
        Some(*end)
    }));
    let (indices, data) = rows.into_iter().flatten().unzip();
    Ok(CsMat::new((fine.len(), coarse.vertices.len()), indptr, indices, data))
}

/// Weights of one row, with the indices of the coarse vertices.
fn weights(
    vertex: V3,
    coarse: &Surface,
    mesh: &TriMesh,
    weighting: Weighting,
) -> Vec<(usize, f64)> {
    let (_, (face, location)) =
        mesh.project_local_point_and_get_location(Vector::from(vertex), false);
    let barycentric = location.barycentric_coordinates().unwrap_or_default();
    let corners = coarse.faces[face as usize].map(|v| v as usize);
    let mut row: Vec<_> = corners.into_iter().zip(barycentric).filter(|&(_, w)| w > 0.0).collect();
    let sum: f64 = row.iter().map(|&(_, w)| w).sum();
    for (_, weight) in &mut row {
        *weight /= sum;
    }

    // Inside a triangle both weightings agree: the solution of `[v0 v1 v2] w = point` is unique
    // unless the triangle's plane holds the origin, and barycentric weights are one.
    if weighting == Weighting::Release
        && matches!(location, TrianglePointLocation::OnEdge(..))
        && let [(a, wa), (b, wb)] = &mut row[..]
        && let Some(w) = least_squares(coarse.vertices[*a], coarse.vertices[*b], vertex)
    {
        [*wa, *wb] = w;
    }
    row
}

/// Minimiser `w` of `|w₀ a + w₁ b − p|`; `None` if `a` and `b` are parallel.
fn least_squares(a: V3, b: V3, p: V3) -> Option<[f64; 2]> {
    let along = dot(a, b) / dot(a, a);
    let across = sub(b, a.map(|x| along * x));
    let length2 = dot(across, across);
    let independent = length2 > 1e-24 * dot(b, b);
    independent.then(|| {
        let w1 = dot(across, p) / length2;
        [dot(a, sub(p, b.map(|x| w1 * x))) / dot(a, a), w1]
    })
}
