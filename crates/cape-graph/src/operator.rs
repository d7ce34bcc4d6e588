//! The graph of a convolution: a level's Laplacian and the vertices its output is wanted at.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
};

use burn::tensor::{DType, Device, Int, Tensor, TensorData};
use sprs::CsMat;

use crate::sparse::{Csr, SparseMatrix, SparsePair};

/// What a graph convolution needs of the mesh, on the host.
///
/// See [`GraphBackend`](crate::GraphBackend) for an example.
#[derive(Debug)]
pub struct Operator {
    laplacian: Arc<SparsePair>,
    pool: Option<Pool>,
    sums: Mutex<BTreeMap<usize, Arc<[f32]>>>,
}

/// A selection of vertices `D` taken after a convolution. It commutes with all that acts on each
/// vertex alone, so the convolution computes nothing at the others.
#[derive(Debug)]
pub(crate) struct Pool {
    /// The vertices kept, in rising order or not.
    pub vertices: Vec<u32>,
    /// For every vertex its place among those kept, or [`DROPPED`]; for the CPU's kernels.
    #[cfg_attr(not(any(feature = "flex", feature = "ndarray")), allow(dead_code))]
    pub place: Vec<u32>,
    /// `D`.
    pub selection: Arc<SparsePair>,
    /// `D L̃`.
    pub laplacian: Arc<SparsePair>,
}

/// Place of a vertex that is not kept.
pub(crate) const DROPPED: u32 = u32::MAX;

impl Operator {
    /// The rescaled Laplacian `L̃`, `[vertices, vertices]`.
    pub fn laplacian(&self) -> &Arc<SparsePair> {
        &self.laplacian
    }

    /// Vertices of the input.
    pub fn vertices(&self) -> usize {
        self.laplacian.forward().rows()
    }

    /// Vertices of the output.
    pub fn kept(&self) -> usize {
        self.pool.as_ref().map_or(self.vertices(), |pool| pool.vertices.len())
    }

    pub(crate) fn pool(&self) -> Option<&Pool> {
        self.pool.as_ref()
    }

    /// `L̃`, at the rows that are kept.
    pub(crate) fn kept_laplacian(&self) -> &Arc<SparsePair> {
        self.pool.as_ref().map_or(&self.laplacian, |pool| &pool.laplacian)
    }

    /// `T_0(L̃)1 … T_{order−1}(L̃)1` at the vertices kept, `[kept, order]`: what a convolution
    /// makes of features that are the same at every vertex.
    pub(crate) fn sums(&self, order: usize) -> Arc<[f32]> {
        let mut known = self.sums.lock().unwrap_or_else(PoisonError::into_inner);
        known.entry(order).or_insert_with(|| self.compute_sums(order)).clone()
    }

    fn compute_sums(&self, order: usize) -> Arc<[f32]> {
        let ones = vec![1.0; self.vertices()];
        let mut terms = vec![ones];
        for k in 1..order {
            let mut next = multiply(self.laplacian.forward(), &terms[k - 1]);
            if k > 1 {
                for (next, before) in next.iter_mut().zip(&terms[k - 2]) {
                    *next = 2.0 * *next - before;
                }
            }
            terms.push(next);
        }
        let row = |vertex: usize| terms.iter().map(move |term| term[vertex] as f32);
        match &self.pool {
            Some(pool) => pool.vertices.iter().flat_map(|&vertex| row(vertex as usize)).collect(),
            None => (0..self.vertices()).flat_map(row).collect(),
        }
    }
}

fn multiply(a: &Csr, x: &[f64]) -> Vec<f64> {
    (0..a.rows())
        .map(|row| {
            let (columns, values) = a.row(row);
            columns.iter().zip(values).map(|(&c, &v)| f64::from(v) * x[c as usize]).sum()
        })
        .collect()
}

/// The graph of a convolution on a device; cheap to clone.
///
/// It consists of a level's rescaled Laplacian and, where a pooling follows the convolution, the
/// vertices that it keeps.
///
/// A convolution on a triangle, whose rescaled Laplacian has −½ beside the diagonal:
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::{ConvEnd, ConvGraph, cheb_conv, sparse_from_triplets};
///
/// let laplacian = sparse_from_triplets(
///     "L", (3, 3), &[0, 0, 1, 1, 2, 2], &[1, 2, 0, 2, 0, 1], &[-0.5; 6])?;
/// let device = Device::default();
/// let graph = ConvGraph::new(&laplacian, None, &device);
/// let x = Tensor::<3>::ones([1, 3, 1], &device);
/// let weight = Tensor::<2>::from_floats([[2.0], [0.5]], &device);
/// // L̃ 1 = −1: terms and bias make 2 − ½ − 2½ = −1, of which the activation leaves a fifth.
/// let end = ConvEnd { rows: Some(Tensor::full([1, 1, 1], -2.5, &device)), slope: Some(0.2) };
/// let y: Vec<f32> = cheb_conv(x, weight, &graph, 2, end).into_data().try_into_vec().unwrap();
/// assert!(y.iter().all(|y| (y + 0.2).abs() < 1e-6));
/// # Ok::<(), cape_graph::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct ConvGraph {
    pub(crate) operator: Arc<Operator>,
    /// Row starts and columns of every matrix and its transpose, one after the other.
    pub(crate) index: Tensor<1, Int>,
    /// Their values.
    pub(crate) value: Tensor<1>,
}

impl ConvGraph {
    /// Uploads the rescaled Laplacian `L̃`, for convolutions followed by the selection `down`
    /// (`[kept, vertices]`, a single 1 in every row), if any.
    ///
    /// # Panics
    /// If the shapes disagree or `down` is not a selection.
    pub fn new(laplacian: &CsMat<f64>, down: Option<&CsMat<f64>>, device: &Device) -> Self {
        let vertices = laplacian.rows();
        assert_eq!(laplacian.cols(), vertices, "a Laplacian is square");
        let mut arrays = Arrays::default();
        let whole = arrays.push(laplacian);
        let pool = down.map(|down| {
            assert_eq!(down.cols(), vertices, "a selection of {vertices} vertices");
            let kept: Vec<u32> = down
                .outer_iterator()
                .map(|row| match (row.indices(), row.data()) {
                    (&[vertex], [1.0]) => vertex as u32,
                    _ => panic!("a selection has a single 1 in every row"),
                })
                .collect();
            let mut place = vec![DROPPED; vertices];
            for (i, &vertex) in kept.iter().enumerate() {
                place[vertex as usize] = i as u32;
            }
            let selected = (down * laplacian).to_csr();
            Pool {
                vertices: kept,
                place,
                selection: arrays.push(down),
                laplacian: arrays.push(&selected),
            }
        });
        let (index, value) = arrays.upload(device);
        let operator = Operator { laplacian: whole, pool, sums: Mutex::default() };
        Self { operator: Arc::new(operator), index, value }
    }

    /// The rescaled Laplacian `L̃`.
    pub fn laplacian(&self) -> SparseMatrix {
        SparseMatrix {
            pair: self.operator.laplacian.clone(),
            index: self.index.clone(),
            value: self.value.clone(),
        }
    }

    /// Vertices of the input.
    pub fn vertices(&self) -> usize {
        self.operator.vertices()
    }

    /// Vertices of the output.
    pub fn kept(&self) -> usize {
        self.operator.kept()
    }
}

/// Sparse matrices and their transposes one after the other, as a device has them.
#[derive(Default)]
pub(crate) struct Arrays {
    index: Vec<i32>,
    value: Vec<f32>,
}

impl Arrays {
    pub(crate) fn push(&mut self, matrix: &CsMat<f64>) -> Arc<SparsePair> {
        let pair = SparsePair::new(matrix, self.index.len(), self.value.len());
        pair.append(&mut self.index, &mut self.value);
        Arc::new(pair)
    }

    pub(crate) fn upload(self, device: &Device) -> (Tensor<1, Int>, Tensor<1>) {
        let device = device.clone().inner();
        let (indices, values) = (self.index.len(), self.value.len());
        (
            Tensor::from_data(TensorData::new(self.index, [indices]), (&device, DType::I32)),
            Tensor::from_data(TensorData::new(self.value, [values]), (&device, DType::F32)),
        )
    }
}
