//! Sparse matrices of fixed structure, on the host and on a device.

use std::sync::Arc;

use burn::tensor::{DType, Device, Int, Tensor, TensorData};
use sprs::CsMat;

/// A matrix in compressed sparse rows, f32.
#[derive(Debug, Clone, PartialEq)]
pub struct Csr {
    cols: usize,
    start: Vec<u32>,
    column: Vec<u32>,
    value: Vec<f32>,
}

impl Csr {
    fn new(matrix: &CsMat<f64>) -> Self {
        Self {
            cols: matrix.cols(),
            start: matrix.indptr().as_slice().map_or_else(
                || std::iter::once(0).chain(row_ends(matrix)).collect(),
                |starts| starts.iter().map(|&start| start as u32).collect(),
            ),
            column: matrix.indices().iter().map(|&column| column as u32).collect(),
            value: matrix.data().iter().map(|&value| value as f32).collect(),
        }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.start.len() - 1
    }

    /// Number of columns.
    pub fn cols(&self) -> usize {
        self.cols
    }

    /// Columns and values of one row's entries.
    #[inline]
    pub fn row(&self, row: usize) -> (&[u32], &[f32]) {
        let span = self.start[row] as usize..self.start[row + 1] as usize;
        (&self.column[span.clone()], &self.value[span])
    }
}

fn row_ends(matrix: &CsMat<f64>) -> impl Iterator<Item = u32> {
    let mut end = 0;
    matrix.outer_iterator().map(move |row| {
        end += row.nnz() as u32;
        end
    })
}

/// A sparse matrix and its transpose, for a product and its gradient.
#[derive(Debug, PartialEq)]
pub struct SparsePair {
    forward: Csr,
    backward: Csr,
}

impl SparsePair {
    /// From any sparse matrix.
    pub fn new(matrix: &CsMat<f64>) -> Self {
        let csr = matrix.to_csr();
        let transposed = matrix.transpose_view().to_csr();
        Self { forward: Csr::new(&csr), backward: Csr::new(&transposed) }
    }

    /// The matrix, `[rows, columns]`.
    pub fn forward(&self) -> &Csr {
        &self.forward
    }

    /// Its transpose, `[columns, rows]`.
    pub fn backward(&self) -> &Csr {
        &self.backward
    }

    /// The matrix, or its transpose.
    pub fn oriented(&self, transpose: bool) -> &Csr {
        if transpose { &self.backward } else { &self.forward }
    }

    /// Where the structure of one orientation starts in a device's index and value arrays.
    #[cfg(any(feature = "wgpu", feature = "cuda"))]
    pub(crate) fn offsets(&self, transpose: bool) -> Offsets {
        let entries = self.forward.value.len();
        let start = if transpose { self.forward.start.len() + entries } else { 0 };
        let csr = self.oriented(transpose);
        Offsets {
            start,
            column: start + csr.start.len(),
            value: if transpose { entries } else { 0 },
        }
    }
}

/// See [`SparsePair::offsets`].
#[cfg(any(feature = "wgpu", feature = "cuda"))]
#[derive(Debug, Clone, Copy)]
pub(crate) struct Offsets {
    pub start: usize,
    pub column: usize,
    pub value: usize,
}

/// A sparse matrix that operations of this crate multiply tensors by; cheap to clone.
///
/// Its structure and values are constants: no gradient flows into them.
#[derive(Debug, Clone)]
pub struct SparseMatrix {
    pub(crate) pair: Arc<SparsePair>,
    /// Row starts and columns of the matrix, then of its transpose.
    pub(crate) index: Tensor<1, Int>,
    /// Values of the matrix, then of its transpose.
    pub(crate) value: Tensor<1>,
}

impl SparseMatrix {
    /// Uploads `matrix` to `device`, once.
    pub fn new(matrix: &CsMat<f64>, device: &Device) -> Self {
        let pair = SparsePair::new(matrix);
        let both = [&pair.forward, &pair.backward];
        let index: Vec<i32> = both
            .iter()
            .flat_map(|csr| csr.start.iter().chain(&csr.column))
            .map(|&index| index as i32)
            .collect();
        let value: Vec<f32> = both.iter().flat_map(|csr| csr.value.iter().copied()).collect();
        let device = device.clone().inner();
        let (index_len, value_len) = (index.len(), value.len());
        Self {
            pair: Arc::new(pair),
            index: Tensor::from_data(TensorData::new(index, [index_len]), (&device, DType::I32)),
            value: Tensor::from_data(TensorData::new(value, [value_len]), (&device, DType::F32)),
        }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.pair.forward.rows()
    }

    /// Number of columns.
    pub fn cols(&self) -> usize {
        self.pair.forward.cols()
    }

    /// The matrix on the host.
    pub fn host(&self) -> &SparsePair {
        &self.pair
    }
}
