//! The GPU backends. Products with dense matrices are Burn's; all else is a kernel here.
//!
//! Neighbouring threads work on neighbouring channels, so that they read neighbouring numbers.
//! Sums are split by the extents of a tensor alone and made in a fixed order, without atomics.
//! Extents and places are arguments at run time: one compiled kernel serves every tensor.

mod activation;
mod norm;
mod reduce;
mod sparse;

use std::sync::Arc;

use burn::{
    backend::tensor::{FloatTensor, IntTensor},
    tensor::Shape,
};
use burn_cubecl::{CubeBackend, kernel::into_contiguous, tensor::CubeTensor};
use cubecl::prelude::{CubeCount, CubeDim};

use self::{norm::Norm, sparse::Product};
use crate::{
    ops::{EndSpec, GraphBackend},
    sparse::SparsePair,
};

/// Threads of a workgroup.
const THREADS: usize = 256;
/// Below every runtime's limit on workgroups along one axis.
const MAX_CUBES: u32 = 32768;

/// A new tensor beside `like`, its numbers unspecified.
fn empty(like: &CubeTensor, dims: &[usize]) -> CubeTensor {
    let shape = Shape::from(dims.to_vec());
    let buffer = like.client.empty(shape.num_elements() * size_of::<f32>());
    CubeTensor::new_contiguous(like.client.clone(), like.device.clone(), shape, buffer, like.dtype)
}

/// A contiguous tensor with other dimensions.
fn reshaped(x: CubeTensor, dims: &[usize]) -> CubeTensor {
    let shape = Shape::from(dims.to_vec());
    CubeTensor::new_contiguous(x.client, x.device, shape, x.handle, x.dtype)
}

fn dims(x: &CubeTensor) -> [usize; 3] {
    let shape = x.meta.shape();
    [shape[0], shape[1], shape[2]]
}

/// Workgroups with a thread for every element of `out`.
fn elementwise(out: &CubeTensor) -> (CubeCount, CubeDim) {
    let cubes = (out.meta.num_elements().div_ceil(THREADS) as u32).max(1);
    let count = CubeCount::Static(cubes.min(MAX_CUBES), cubes.div_ceil(MAX_CUBES), 1);
    (count, CubeDim::new_1d(THREADS as u32))
}

impl GraphBackend for CubeBackend {
    fn sparse_matmul(
        x: FloatTensor<Self>,
        index: IntTensor<Self>,
        value: FloatTensor<Self>,
        matrix: Arc<SparsePair>,
        transpose: bool,
    ) -> FloatTensor<Self> {
        Product { index, value, matrix: &matrix, transpose }.of(x, None)
    }

    fn sparse_accumulate(
        x: FloatTensor<Self>,
        base: FloatTensor<Self>,
        index: IntTensor<Self>,
        value: FloatTensor<Self>,
        matrix: Arc<SparsePair>,
        transpose: bool,
        alpha: f64,
        beta: f64,
    ) -> FloatTensor<Self> {
        let product = Product { index, value, matrix: &matrix, transpose };
        product.of(x, Some((base, alpha as f32, beta as f32)))
    }

    fn conv_end(
        sum: FloatTensor<Self>,
        term: FloatTensor<Self>,
        rows: FloatTensor<Self>,
        spec: EndSpec,
    ) -> FloatTensor<Self> {
        activation::end(sum, spec.term.then_some(term), spec.rows.then_some(rows), spec.slope)
    }

    fn conv_end_backward(
        y: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        slope: f64,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let [batch, _, channels] = dims(&y);
        let (grad, partial) = activation::gate(y, grad, slope);
        let rows = reduce::column_sums(partial, batch, 0..channels);
        (grad, reshaped(rows, &[batch, 1, channels]))
    }

    fn bias_leaky_relu(
        x: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        slope: f64,
    ) -> FloatTensor<Self> {
        let channels = bias.meta.num_elements();
        let bias = reshaped(into_contiguous(bias), &[1, 1, channels]);
        activation::end(x, None, Some(bias), Some(slope))
    }

    fn bias_leaky_relu_backward(
        y: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        slope: f64,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let channels = dims(&y)[2];
        let (grad, partial) = activation::gate(y, grad, slope);
        (grad, reshaped(reduce::column_sums(partial, 1, 0..channels), &[channels]))
    }

    fn group_norm_relu(
        x: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        groups: usize,
        epsilon: f64,
    ) -> FloatTensor<Self> {
        Norm::new(x, gamma, beta, groups, epsilon).relu()
    }

    fn group_norm_relu_backward(
        x: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        groups: usize,
        epsilon: f64,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        Norm::new(x, gamma, beta, groups, epsilon).relu_backward(grad)
    }
}
