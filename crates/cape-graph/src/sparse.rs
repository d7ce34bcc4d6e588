//! Sparse matrices of fixed structure, on the host and on a device.

use std::sync::Arc;

use burn::tensor::{Device, Int, Tensor};
use sprs::CsMat;

use crate::operator::Arrays;

/// A matrix in compressed sparse rows, f32.
///
/// See [`SparseMatrix`] for an example.
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
///
/// See [`SparseMatrix`] for an example.
#[derive(Debug, PartialEq)]
pub struct SparsePair {
    forward: Csr,
    backward: Csr,
    first_index: usize,
    first_value: usize,
}

impl SparsePair {
    /// From any sparse matrix, whose structure will start at those places of a device's arrays.
    pub(crate) fn new(matrix: &CsMat<f64>, first_index: usize, first_value: usize) -> Self {
        let csr = matrix.to_csr();
        let transposed = matrix.transpose_view().to_csr();
        Self { forward: Csr::new(&csr), backward: Csr::new(&transposed), first_index, first_value }
    }

    /// Appends row starts and columns, and values, of the matrix and then of its transpose.
    pub(crate) fn append(&self, index: &mut Vec<i32>, value: &mut Vec<f32>) {
        for csr in [&self.forward, &self.backward] {
            index.extend(csr.start.iter().chain(&csr.column).map(|&index| index as i32));
            value.extend(&csr.value);
        }
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
        let skipped = if transpose { entries } else { 0 };
        let start =
            self.first_index + if transpose { self.forward.start.len() + entries } else { 0 };
        let csr = self.oriented(transpose);
        Offsets { start, column: start + csr.start.len(), value: self.first_value + skipped }
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
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::{SparseMatrix, sparse_from_triplets, sparse_matmul};
///
/// // [0 0 2]
/// // [5 0 0]
/// let matrix = sparse_from_triplets("A", (2, 3), &[0, 1], &[2, 0], &[2.0, 5.0])?;
/// let device = Device::default();
/// let a = SparseMatrix::new(&matrix, &device);
/// let x = Tensor::<3>::from_floats([[[1.0], [2.0], [3.0]]], &device);
/// let y: Vec<f32> = sparse_matmul(x, &a).into_data().try_into_vec().unwrap();
/// assert_eq!(y, [6.0, 5.0]);
///
/// // On the host there are the matrix and its transpose, for the gradient.
/// let (forward, transposed) = (a.host().forward(), a.host().backward());
/// assert_eq!(forward.row(0), (&[2][..], &[2.0][..]));
/// assert_eq!((transposed.rows(), transposed.row(0)), (3, (&[1][..], &[5.0][..])));
/// # Ok::<(), cape_graph::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct SparseMatrix {
    pub(crate) pair: Arc<SparsePair>,
    /// Row starts and columns of the matrix, then of its transpose, from its first index on.
    pub(crate) index: Tensor<1, Int>,
    /// Values of the matrix, then of its transpose, from its first value on.
    pub(crate) value: Tensor<1>,
}

impl SparseMatrix {
    /// Uploads `matrix` to `device`, once.
    pub fn new(matrix: &CsMat<f64>, device: &Device) -> Self {
        let mut arrays = Arrays::default();
        let pair = arrays.push(matrix);
        let (index, value) = arrays.upload(device);
        Self { pair, index, value }
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
