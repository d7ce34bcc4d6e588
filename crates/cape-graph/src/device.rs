use burn::tensor::{Device, Tensor};
use sprs::CsMat;

use crate::{
    Precision,
    conv_graph::ConvGraph,
    functions::sparse_matmul,
    pyramid::{Level, MeshPyramid, Transition},
    sparse::SparseMatrix,
};

/// Tolerance of the row sums of an interpolation, the rounding of f32.
const ROUNDING: f64 = 1e-6;

/// Matrices of a pyramid on a device.
///
/// Level 0 is the input mesh; transition `i` maps between level `i` and level `i + 1`.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_synth::synthetic_body;
/// use cape_graph::{DevicePyramid, MeshPyramid, Weighting};
///
/// let body = synthetic_body();
/// let pyramid = MeshPyramid::build(&body, &[1.0, 4.0], Weighting::Barycentric)?;
/// let device = Device::default();
/// let graphs = DevicePyramid::upload(&pyramid, &device);
/// assert_eq!((graphs.transitions(), graphs.vertices()), (2, &[6890, 6890, 1723][..]));
/// assert!(graphs.is_identity(0) && !graphs.is_identity(1));
/// assert_eq!((graphs.graph(1).kept(), graphs.pooled(1).kept()), (6890, 1723));
///
/// // Barycentric weights preserve constants.
/// assert!(graphs.up_preserves_constants(1));
/// let up = graphs.up(Tensor::ones([1, 1723, 2], &device), 1);
/// let error: f32 = (up - 1.0).abs().max().into_scalar();
/// assert!(error < 1e-6);
/// # Ok::<(), cape_graph::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct DevicePyramid {
    vertices: Vec<usize>,
    graphs: Vec<ConvGraph>,
    pooled: Vec<Option<ConvGraph>>,
    down: Vec<Option<SparseMatrix>>,
    up: Vec<Option<SparseMatrix>>,
    preserving: Vec<bool>,
}

impl DevicePyramid {
    /// Uploads a pyramid.
    pub fn upload(pyramid: &MeshPyramid, device: &Device) -> Self {
        let laplacians: Vec<_> = pyramid.levels().iter().map(Level::rescaled_laplacian).collect();
        let matrices = |matrix: fn(&Transition) -> CsMat<f64>| -> Vec<Option<CsMat<f64>>> {
            let transitions = pyramid.transitions().iter();
            transitions.map(|t| (!t.is_identity()).then(|| matrix(t))).collect()
        };
        let (down, up) = (matrices(Transition::down_matrix), matrices(|t| t.up().clone()));
        Self::new(&laplacians, &down, &up, device)
    }

    /// Uploads the rescaled Laplacian `L̃` of every level and the matrices of every transition; `None`
    /// is the identity.
    ///
    /// # Panics
    /// If the matrices' shapes do not chain.
    pub fn new(
        laplacians: &[CsMat<f64>],
        down: &[Option<CsMat<f64>>],
        up: &[Option<CsMat<f64>>],
        device: &Device,
    ) -> Self {
        let vertices: Vec<usize> = laplacians.iter().map(CsMat::rows).collect();
        assert!(
            down.len() + 1 == vertices.len() && up.len() == down.len(),
            "DevicePyramid: {} selections and {} interpolations for {} levels, expected one fewer",
            down.len(),
            up.len(),
            vertices.len()
        );
        for (i, pair) in vertices.windows(2).enumerate() {
            let identity = pair[0] == pair[1];
            let fits = |matrix: &Option<CsMat<f64>>, shape: (usize, usize)| {
                matrix.as_ref().map_or(identity, |matrix| matrix.shape() == shape)
            };
            assert!(
                fits(&down[i], (pair[1], pair[0])) && fits(&up[i], (pair[0], pair[1])),
                "DevicePyramid: shapes of transition {i}, between {} and {} vertices",
                pair[0],
                pair[1]
            );
        }
        let upload = |matrix: &Option<CsMat<f64>>| {
            matrix.as_ref().map(|matrix| SparseMatrix::new(matrix, device))
        };
        Self {
            vertices,
            graphs: laplacians.iter().map(|l| ConvGraph::new(l, None, device)).collect(),
            pooled: laplacians
                .iter()
                .zip(down)
                .map(|(l, down)| Some(ConvGraph::new(l, Some(down.as_ref()?), device)))
                .collect(),
            preserving: up.iter().map(|up| up.as_ref().is_none_or(preserves_constants)).collect(),
            down: down.iter().map(upload).collect(),
            up: up.iter().map(upload).collect(),
        }
    }

    /// The same pyramid for convolutions whose products have another precision.
    #[must_use]
    pub fn with_precision(self, precision: Precision) -> Self {
        let set = |graph: ConvGraph| graph.with_precision(precision);
        Self {
            graphs: self.graphs.into_iter().map(set).collect(),
            pooled: self.pooled.into_iter().map(|graph| graph.map(set)).collect(),
            ..self
        }
    }

    /// Number of transitions, one fewer than levels.
    pub fn transitions(&self) -> usize {
        self.down.len()
    }

    /// Number of vertices of each level.
    pub fn vertices(&self) -> &[usize] {
        &self.vertices
    }

    /// Graph of a level.
    pub fn graph(&self, level: usize) -> &ConvGraph {
        &self.graphs[level]
    }

    /// Graph of a level for a convolution followed by transition `level`: the output is on level
    /// `level + 1`.
    pub fn pooled(&self, level: usize) -> &ConvGraph {
        self.pooled[level].as_ref().unwrap_or(&self.graphs[level])
    }

    /// True if both levels are the same, so that [`up`](Self::up) is the identity.
    pub fn is_identity(&self, transition: usize) -> bool {
        self.up[transition].is_none()
    }

    /// True if [`up`](Self::up) preserves features that are constant over the vertices. Barycentric
    /// weights do; those of the release need not sum to 1.
    pub fn up_preserves_constants(&self, transition: usize) -> bool {
        self.preserving[transition]
    }

    /// Selects the vertices of level `transition + 1` from `x: [batch, vertices, channels]` of level
    /// `transition`.
    pub fn down(&self, x: Tensor<3>, transition: usize) -> Tensor<3> {
        match &self.down[transition] {
            Some(matrix) => sparse_matmul(x, matrix),
            None => x,
        }
    }

    /// Interpolates `x: [batch, vertices, channels]` from level `transition + 1` to level
    /// `transition`.
    pub fn up(&self, x: Tensor<3>, transition: usize) -> Tensor<3> {
        match &self.up[transition] {
            Some(matrix) => sparse_matmul(x, matrix),
            None => x,
        }
    }
}

fn preserves_constants(up: &CsMat<f64>) -> bool {
    up.outer_iterator().all(|row| (row.data().iter().sum::<f64>() - 1.0).abs() <= ROUNDING)
}
