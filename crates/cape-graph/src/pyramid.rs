//! Mesh at decreasing resolutions, with the maps between them.

use rayon::prelude::*;
use sprs::CsMat;

use crate::laplacian::{normalized_laplacian, rescaled_laplacian};
use crate::quadric::{Simplified, simplify};
use crate::topology::{EdgeCounts, Surface};
use crate::upsample::{Weighting, upsample};
use crate::{Error, Result};

/// Mesh at decreasing resolutions: level 0 is the mesh itself, and transition `i` maps between level
/// `i` and level `i + 1`.
///
/// ```
/// use cape_synth::synthetic_body;
/// use cape_graph::{MeshPyramid, Weighting};
///
/// let mesh = synthetic_body().mesh();
/// let pyramid = MeshPyramid::build(&mesh, &[2.0], Weighting::Barycentric)?;
/// let coarse = &pyramid.levels()[1];
/// assert_eq!(coarse.vertex_count(), 3445);
/// let laplacian = coarse.laplacian();
/// assert_eq!(laplacian.shape(), (3445, 3445));
/// assert!(laplacian.diag_iter().all(|entry| entry == Some(&1.0)));
///
/// // Coarse vertices are a selection of the fine ones, which are weighted means of coarse ones.
/// let transition = &pyramid.transitions()[0];
/// assert_eq!(transition.down().len(), 3445);
/// let sums = transition.up().outer_iterator().map(|row| row.data().iter().sum::<f64>());
/// assert!(sums.into_iter().all(|sum| (sum - 1.0).abs() < 1e-9));
///
/// let directory = tempfile::tempdir()?;
/// pyramid.save(directory.path().join("pyramid.npz"))?;
/// assert_eq!(MeshPyramid::load(directory.path().join("pyramid.npz"))?, pyramid);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct MeshPyramid {
    pub(crate) levels: Vec<Level>,
    pub(crate) transitions: Vec<Transition>,
    pub(crate) weighting: Weighting,
}

/// Level of a pyramid: a mesh and its graph.
#[derive(Debug, Clone, PartialEq)]
pub struct Level {
    pub(crate) surface: Surface,
    pub(crate) adjacency: CsMat<f64>,
}

/// Maps between a level and the next coarser one.
#[derive(Debug, Clone, PartialEq)]
pub struct Transition {
    pub(crate) down: Vec<u32>,
    pub(crate) up: CsMat<f64>,
}

impl MeshPyramid {
    /// Simplifies `mesh` once for each factor, from `n` to `ceil(n / factor)` vertices; a factor of 1
    /// repeats the level.
    pub fn build(mesh: impl Into<Surface>, factors: &[f64], weighting: Weighting) -> Result<Self> {
        let refused = |&(_, &value): &(usize, &f64)| !(value.is_finite() && value >= 1.0);
        if let Some((index, &value)) = factors.iter().enumerate().find(refused) {
            return Err(Error::Factor { index, value });
        }
        let finest = mesh.into();
        finest.validate()?;
        let mut surfaces = vec![finest];
        let mut selections = Vec::new();
        for factor in factors {
            let fine = &surfaces[surfaces.len() - 1];
            let vertices = fine.vertices.len();
            let target = (vertices as f64 * (1.0 / factor)).ceil() as usize;
            let (surface, kept) = if target == vertices {
                (fine.clone(), None)
            } else {
                let Simplified { kept, surface } = simplify(fine, target)?;
                (surface, Some(kept))
            };
            surfaces.push(surface);
            selections.push(kept);
        }
        // What follows is of each level alone.
        let transition = |(pair, kept): (&[Surface], Option<Vec<u32>>)| match kept {
            None => Ok(Transition::identity(pair[1].vertices.len())),
            Some(kept) => {
                let up = upsample(&pair[0].vertices, &pair[1], &kept, weighting)?;
                Ok(Transition { down: kept, up })
            }
        };
        let (levels, transitions) = rayon::join(
            || surfaces.par_iter().cloned().map(Level::new).collect(),
            || surfaces.par_windows(2).zip(selections).map(transition).collect::<Result<_>>(),
        );
        Ok(Self { levels, transitions: transitions?, weighting })
    }

    /// The levels, finest first; at least one.
    pub fn levels(&self) -> &[Level] {
        &self.levels
    }

    /// The maps between neighbouring levels, one fewer than there are levels.
    pub fn transitions(&self) -> &[Transition] {
        &self.transitions
    }

    /// Method by which the interpolation weights were computed.
    pub fn weighting(&self) -> Weighting {
        self.weighting
    }
}

impl Level {
    fn new(surface: Surface) -> Self {
        Self { adjacency: surface.adjacency(), surface }
    }

    /// The mesh. It has no faces in a pyramid built from matrices without faces.
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.surface.vertices.len()
    }

    /// Numbers of edges, boundary edges and non-manifold edges.
    pub fn edge_counts(&self) -> EdgeCounts {
        self.surface.edge_counts()
    }

    /// Symmetric 0/1 adjacency without self-loops, CSR, `[vertices, vertices]`.
    pub fn adjacency(&self) -> &CsMat<f64> {
        &self.adjacency
    }

    /// Normalised Laplacian `L`, CSR, `[vertices, vertices]`; see [`normalized_laplacian`].
    pub fn laplacian(&self) -> CsMat<f64> {
        normalized_laplacian(&self.adjacency)
    }

    /// Rescaled Laplacian `L̃ = L − I`, CSR, `[vertices, vertices]`; see [`rescaled_laplacian`].
    pub fn rescaled_laplacian(&self) -> CsMat<f64> {
        rescaled_laplacian(&self.adjacency)
    }
}

impl Transition {
    pub(crate) fn identity(vertices: usize) -> Self {
        Self { down: (0..vertices as u32).collect(), up: CsMat::eye(vertices) }
    }

    /// Selection `D` as the index of the fine vertex of each coarse vertex, `[coarse]`.
    pub fn down(&self) -> &[u32] {
        &self.down
    }

    /// Selection `D` as a matrix, `[coarse, fine]`, CSR, a single 1 in every row.
    pub fn down_matrix(&self) -> CsMat<f64> {
        let (fine, coarse) = self.up.shape();
        let columns = self.down.iter().map(|&vertex| vertex as usize).collect();
        CsMat::new((coarse, fine), (0..=coarse).collect(), columns, vec![1.0; coarse])
    }

    /// Interpolation `U`, `[fine, coarse]`, CSR, one to three weights in every row.
    pub fn up(&self) -> &CsMat<f64> {
        &self.up
    }

    /// True if both levels are the same and both maps the identity, as for a factor of 1.
    pub fn is_identity(&self) -> bool {
        let (fine, coarse) = self.up.shape();
        fine == coarse && *self == Self::identity(fine)
    }
}

#[cfg(test)]
mod tests;
