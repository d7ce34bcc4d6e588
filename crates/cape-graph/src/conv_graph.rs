//! Graph of a convolution: the Laplacian of a level and the vertices that are kept of the output.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
};

use burn::{backend::Dispatch, tensor::Device};
use sprs::CsMat;

use crate::{
    Precision,
    ops::DeviceGraph,
    sparse::{Csr, CsrArrays, CsrWithTranspose, DeviceArrays, SparseMatrix},
};

/// Graph of a convolution on the host: the rescaled Laplacian and the pooling, if any.
#[derive(Debug)]
pub struct HostGraph {
    laplacian: Arc<CsrWithTranspose>,
    pool: Option<Pool>,
    constant_bases: Mutex<BTreeMap<usize, Arc<[f32]>>>,
}

/// Selection of vertices `D` after a convolution. It commutes with operations on single vertices,
/// so that the convolution computes nothing at the vertices that are dropped.
#[derive(Debug)]
pub(crate) struct Pool {
    /// The kept vertices, in any order, `[kept]`.
    pub vertices: Vec<u32>,
    /// For every vertex its index among those kept, or [`DROPPED`], `[vertices]`; used by the CPU
    /// kernels.
    #[cfg_attr(not(any(feature = "flex", feature = "ndarray")), allow(dead_code))]
    pub place: Vec<u32>,
    /// `D`, `[kept, vertices]`.
    pub selection: Arc<CsrWithTranspose>,
    /// `D L̃`, `[kept, vertices]`.
    pub laplacian: Arc<CsrWithTranspose>,
}

/// [`Pool::place`] of a vertex that is dropped.
pub(crate) const DROPPED: u32 = u32::MAX;

impl HostGraph {
    /// The rescaled Laplacian `L̃`, `[vertices, vertices]`.
    pub fn laplacian(&self) -> &Arc<CsrWithTranspose> {
        &self.laplacian
    }

    /// Number of vertices of the input.
    pub fn vertices(&self) -> usize {
        self.laplacian.matrix().rows()
    }

    /// Number of vertices of the output.
    pub fn kept(&self) -> usize {
        self.pool.as_ref().map_or(self.vertices(), |pool| pool.vertices.len())
    }

    pub(crate) fn pool(&self) -> Option<&Pool> {
        self.pool.as_ref()
    }

    /// Rows of `L̃` at the kept vertices, `[kept, vertices]`.
    pub(crate) fn kept_laplacian(&self) -> &Arc<CsrWithTranspose> {
        self.pool.as_ref().map_or(&self.laplacian, |pool| &pool.laplacian)
    }

    /// Chebyshev basis of the constant function, `T_0(L̃)1 … T_{order−1}(L̃)1`, at the kept
    /// vertices, `[kept, order]`: the factors of a convolution's constant terms.
    pub(crate) fn constant_basis(&self, order: usize) -> Arc<[f32]> {
        let mut known = self.constant_bases.lock().unwrap_or_else(PoisonError::into_inner);
        known.entry(order).or_insert_with(|| self.compute_constant_basis(order)).clone()
    }

    fn compute_constant_basis(&self, order: usize) -> Arc<[f32]> {
        let ones = vec![1.0; self.vertices()];
        let mut terms = vec![ones];
        for k in 1..order {
            let mut next = multiply(self.laplacian.matrix(), &terms[k - 1]);
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

/// Graph of a convolution on a device; cheap to clone.
///
/// It consists of the rescaled Laplacian of a level and, if a pooling follows the convolution, the
/// vertices that are kept.
///
/// A convolution on a triangle, whose rescaled Laplacian has −½ beside the diagonal:
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::{ConvGraph, Epilogue, cheb_conv, sparse_from_triplets};
///
/// let laplacian = sparse_from_triplets(
///     "L", (3, 3), &[0, 0, 1, 1, 2, 2], &[1, 2, 0, 2, 0, 1], &[-0.5; 6])?;
/// let device = Device::default();
/// let graph = ConvGraph::new(&laplacian, None, &device);
/// let x = Tensor::<3>::ones([1, 3, 1], &device);
/// let weight = Tensor::<2>::from_floats([[2.0], [0.5]], &device);
/// // L̃ 1 = −1: both terms and the bias sum to 2 − ½ − 2½ = −1; the leaky ReLU returns −0.2.
/// let bias = Tensor::full([1, 1, 1], -2.5, &device);
/// let epilogue = Epilogue { constant_terms: Some(bias), slope: Some(0.2) };
/// let y: Vec<f32> = cheb_conv(x, weight, &graph, 2, epilogue).into_data().try_into_vec().unwrap();
/// assert!(y.iter().all(|y| (y + 0.2).abs() < 1e-6));
/// # Ok::<(), cape_graph::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct ConvGraph {
    host: Arc<HostGraph>,
    arrays: DeviceArrays,
    precision: Precision,
}

impl ConvGraph {
    /// Uploads the rescaled Laplacian `L̃`, for convolutions followed by the selection `down`
    /// (`[kept, vertices]`, a single 1 in every row), if any.
    ///
    /// # Panics
    /// If the shapes disagree or `down` is not a selection.
    pub fn new(laplacian: &CsMat<f64>, down: Option<&CsMat<f64>>, device: &Device) -> Self {
        let vertices = laplacian.rows();
        assert_eq!(laplacian.cols(), vertices, "ConvGraph: the Laplacian must be square");
        let mut arrays = CsrArrays::default();
        let whole = arrays.push(laplacian);
        let pool = down.map(|down| {
            assert_eq!(down.cols(), vertices, "ConvGraph: columns of `down`, one for each vertex");
            let kept: Vec<u32> = down
                .outer_iterator()
                .map(|row| match (row.indices(), row.data()) {
                    (&[vertex], [1.0]) => vertex as u32,
                    _ => panic!("ConvGraph: every row of `down` must have a single entry, 1"),
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
        let host = HostGraph { laplacian: whole, pool, constant_bases: Mutex::default() };
        let precision = Precision::default();
        Self { host: Arc::new(host), arrays: arrays.upload(device), precision }
    }

    /// The same graph for convolutions whose products have another precision.
    #[must_use]
    pub fn with_precision(self, precision: Precision) -> Self {
        Self { precision, ..self }
    }

    /// The rescaled Laplacian `L̃`.
    pub fn laplacian(&self) -> SparseMatrix {
        SparseMatrix { host: self.host.laplacian.clone(), arrays: self.arrays.clone() }
    }

    /// Number of vertices of the input.
    pub fn vertices(&self) -> usize {
        self.host.vertices()
    }

    /// Number of vertices of the output.
    pub fn kept(&self) -> usize {
        self.host.kept()
    }

    /// The graph as an input of [`GraphBackend`](crate::GraphBackend).
    pub(crate) fn tensors(&self) -> DeviceGraph<Dispatch> {
        DeviceGraph {
            structure: self.arrays.structure.clone().into_dispatch(),
            values: self.arrays.values.clone().into_dispatch(),
            host: self.host.clone(),
            precision: self.precision,
        }
    }
}
