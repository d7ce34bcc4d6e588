//! Sparse matrices of fixed structure, on the host and on a device.

use std::sync::Arc;

use burn::{
    backend::Dispatch,
    tensor::{DType, Device, Int, Tensor, TensorData},
};
use sprs::CsMat;

use crate::ops::SparseOperand;

/// Matrix in compressed sparse rows (CSR), f32.
///
/// See [`SparseMatrix`] for an example.
#[derive(Debug, Clone, PartialEq)]
pub struct Csr {
    cols: usize,
    indptr: Vec<u32>,
    indices: Vec<u32>,
    data: Vec<f32>,
}

impl Csr {
    fn new(matrix: &CsMat<f64>) -> Self {
        Self {
            cols: matrix.cols(),
            indptr: matrix.proper_indptr().iter().map(|&start| start as u32).collect(),
            indices: matrix.indices().iter().map(|&column| column as u32).collect(),
            data: matrix.data().iter().map(|&value| value as f32).collect(),
        }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.indptr.len() - 1
    }

    /// Number of columns.
    pub fn cols(&self) -> usize {
        self.cols
    }

    /// Columns and values of the entries of one row.
    #[inline]
    pub fn row(&self, row: usize) -> (&[u32], &[f32]) {
        let span = self.indptr[row] as usize..self.indptr[row + 1] as usize;
        (&self.indices[span.clone()], &self.data[span])
    }
}

/// Sparse matrix and its transpose: the operands of a product and of its gradient.
///
/// See [`SparseMatrix`] for an example.
#[derive(Debug, PartialEq)]
pub struct CsrWithTranspose {
    matrix: Csr,
    transpose: Csr,
    first_index: usize,
    first_value: usize,
}

impl CsrWithTranspose {
    /// From any sparse matrix. `first_index` and `first_value` are its offsets in the arrays of a
    /// device, see [`CsrArrays`].
    fn new(matrix: &CsMat<f64>, first_index: usize, first_value: usize) -> Self {
        Self {
            matrix: Csr::new(&matrix.to_csr()),
            transpose: Csr::new(&matrix.transpose_view().to_csr()),
            first_index,
            first_value,
        }
    }

    /// The matrix, `[rows, columns]`.
    pub fn matrix(&self) -> &Csr {
        &self.matrix
    }

    /// Its transpose, `[columns, rows]`.
    pub fn transpose(&self) -> &Csr {
        &self.transpose
    }

    /// The matrix or, if `transpose`, its transpose.
    pub fn oriented(&self, transpose: bool) -> &Csr {
        if transpose { &self.transpose } else { &self.matrix }
    }

    /// Offsets of one orientation in the arrays of a device.
    #[cfg(any(feature = "wgpu", feature = "cuda"))]
    pub(crate) fn offsets(&self, transpose: bool) -> CsrOffsets {
        let entries = self.matrix.data.len();
        let (skipped_indices, skipped_values) =
            if transpose { (self.matrix.indptr.len() + entries, entries) } else { (0, 0) };
        let indptr = self.first_index + skipped_indices;
        CsrOffsets {
            indptr,
            indices: indptr + self.oriented(transpose).indptr.len(),
            data: self.first_value + skipped_values,
        }
    }
}

/// Offsets of a CSR matrix in [`CsrArrays`].
#[cfg(any(feature = "wgpu", feature = "cuda"))]
#[derive(Debug, Clone, Copy)]
pub(crate) struct CsrOffsets {
    pub indptr: usize,
    pub indices: usize,
    pub data: usize,
}

/// Arrays of several sparse matrices and their transposes, one after the other, as they are
/// uploaded to a device.
#[derive(Default)]
pub(crate) struct CsrArrays {
    /// `indptr` and `indices` of each matrix, then of its transpose.
    structure: Vec<i32>,
    /// Values of each matrix, then of its transpose.
    values: Vec<f32>,
}

impl CsrArrays {
    pub(crate) fn push(&mut self, matrix: &CsMat<f64>) -> Arc<CsrWithTranspose> {
        let pair = CsrWithTranspose::new(matrix, self.structure.len(), self.values.len());
        for csr in [&pair.matrix, &pair.transpose] {
            self.structure.extend(csr.indptr.iter().chain(&csr.indices).map(|&i| i as i32));
            self.values.extend(&csr.data);
        }
        Arc::new(pair)
    }

    pub(crate) fn upload(self, device: &Device) -> DeviceArrays {
        let device = device.clone().inner();
        let (indices, values) = (self.structure.len(), self.values.len());
        DeviceArrays {
            structure: Tensor::from_data(
                TensorData::new(self.structure, [indices]),
                (&device, DType::I32),
            ),
            values: Tensor::from_data(
                TensorData::new(self.values, [values]),
                (&device, DType::F32),
            ),
        }
    }
}

/// [`CsrArrays`] on a device.
#[derive(Debug, Clone)]
pub(crate) struct DeviceArrays {
    /// Concatenated `indptr` and `indices`, i32.
    pub structure: Tensor<1, Int>,
    /// Concatenated values, f32.
    pub values: Tensor<1>,
}

/// Sparse matrix that operations of this crate multiply tensors by; cheap to clone.
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
/// // The host keeps the matrix and its transpose, which the gradient needs.
/// let (matrix, transpose) = (a.host().matrix(), a.host().transpose());
/// assert_eq!(matrix.row(0), (&[2][..], &[2.0][..]));
/// assert_eq!((transpose.rows(), transpose.row(0)), (3, (&[1][..], &[5.0][..])));
/// # Ok::<(), cape_graph::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct SparseMatrix {
    pub(crate) host: Arc<CsrWithTranspose>,
    pub(crate) arrays: DeviceArrays,
}

impl SparseMatrix {
    /// Uploads `matrix` to `device`.
    pub fn new(matrix: &CsMat<f64>, device: &Device) -> Self {
        let mut arrays = CsrArrays::default();
        let host = arrays.push(matrix);
        Self { host, arrays: arrays.upload(device) }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.host.matrix.rows()
    }

    /// Number of columns.
    pub fn cols(&self) -> usize {
        self.host.matrix.cols()
    }

    /// The matrix and its transpose on the host.
    pub fn host(&self) -> &CsrWithTranspose {
        &self.host
    }

    /// The matrix as an operand of [`GraphBackend`](crate::GraphBackend).
    pub(crate) fn operand(&self) -> SparseOperand<Dispatch> {
        SparseOperand {
            structure: self.arrays.structure.clone().into_dispatch(),
            values: self.arrays.values.clone().into_dispatch(),
            matrix: self.host.clone(),
            transpose: false,
        }
    }
}
