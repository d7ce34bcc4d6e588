//! GPU backends. Products with dense matrices are Burn's; every other operation has a kernel here.
//!
//! Neighbouring threads process neighbouring channels, so that reads are coalesced. The division of
//! sums depends only on the extents of a tensor, and their order is fixed, without atomics. Extents
//! and offsets are runtime arguments: one compiled kernel serves all tensors.

mod activation;
mod chebyshev;
mod norm;
mod reduce;
mod sparse;
mod steps;

use burn::{backend::tensor::FloatTensor, tensor::Shape};
use burn_cubecl::{CubeBackend, kernel::into_contiguous, tensor::CubeTensor};
use cubecl::prelude::{CubeCount, CubeDim};

use self::norm::Norm;
use crate::{
    composed,
    ops::{
        DeviceGraph, EpilogueInputs, GraphBackend, GroupNormGradients, GroupNormInputs,
        OptionalTensor, SparseOperand,
    },
    steps::{AdamState, AdamStep, MomentumStep},
};

/// Number of threads of a workgroup.
const THREADS: usize = 256;
/// Maximal number of workgroups along one axis, below the limit of every runtime.
const MAX_CUBES: u32 = 32768;

/// Tensor of unspecified values on the device of `like`.
fn empty(like: &CubeTensor, dims: &[usize]) -> CubeTensor {
    let shape = Shape::from(dims.to_vec());
    let buffer = like.client.empty(shape.num_elements() * size_of::<f32>());
    CubeTensor::new_contiguous(like.client.clone(), like.device.clone(), shape, buffer, like.dtype)
}

/// Contiguous tensor `x` with other dimensions.
fn reshaped(x: CubeTensor, dims: &[usize]) -> CubeTensor {
    let shape = Shape::from(dims.to_vec());
    CubeTensor::new_contiguous(x.client, x.device, shape, x.handle, x.dtype)
}

fn dims(x: &CubeTensor) -> [usize; 3] {
    let shape = x.meta.shape();
    [shape[0], shape[1], shape[2]]
}

/// Workgroups with one thread for each element of `out`.
fn elementwise(out: &CubeTensor) -> (CubeCount, CubeDim) {
    threads(out.meta.num_elements())
}

/// Workgroups with at least `count` threads.
fn threads(count: usize) -> (CubeCount, CubeDim) {
    let cubes = (count.div_ceil(THREADS) as u32).max(1);
    let count = CubeCount::Static(cubes.min(MAX_CUBES), cubes.div_ceil(MAX_CUBES), 1);
    (count, CubeDim::new_1d(THREADS as u32))
}

impl GraphBackend for CubeBackend {
    fn sparse_matmul(x: FloatTensor<Self>, a: SparseOperand<Self>) -> FloatTensor<Self> {
        sparse::product(x, a, None)
    }

    fn sparse_accumulate(
        x: FloatTensor<Self>,
        base: FloatTensor<Self>,
        a: SparseOperand<Self>,
        alpha: f64,
        beta: f64,
    ) -> FloatTensor<Self> {
        sparse::product(x, a, Some((base, alpha as f32, beta as f32)))
    }

    fn cheb_basis(
        x: FloatTensor<Self>,
        graph: DeviceGraph<Self>,
        order: usize,
    ) -> FloatTensor<Self> {
        match order {
            2 | 3 => chebyshev::basis(x, &graph, order),
            _ => composed::cheb_basis(x, &graph, order),
        }
    }

    fn cheb_fold(
        grad: FloatTensor<Self>,
        graph: DeviceGraph<Self>,
        order: usize,
    ) -> FloatTensor<Self> {
        match order {
            2 | 3 => chebyshev::fold(grad, &graph, order),
            _ => composed::cheb_fold(grad, &graph, order),
        }
    }

    fn epilogue(inputs: EpilogueInputs<Self>) -> FloatTensor<Self> {
        activation::epilogue(inputs)
    }

    fn epilogue_backward(
        y: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        slope: f64,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let [batch, _, channels] = dims(&y);
        let (grad, partial) = activation::gate(y, grad, slope);
        let sums = reduce::column_sums(partial, batch, 0..channels);
        (grad, reshaped(sums, &[batch, 1, channels]))
    }

    fn bias_leaky_relu(
        x: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        slope: f64,
    ) -> FloatTensor<Self> {
        let channels = bias.meta.num_elements();
        let bias = reshaped(into_contiguous(bias), &[1, 1, channels]);
        activation::epilogue(EpilogueInputs {
            sum: x,
            product: OptionalTensor::None,
            addend: OptionalTensor::Some(bias),
            slope: Some(slope),
        })
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

    fn group_norm_relu(inputs: GroupNormInputs<Self>) -> FloatTensor<Self> {
        Norm::new(inputs).relu()
    }

    fn group_norm_relu_backward(
        inputs: GroupNormInputs<Self>,
        grad: FloatTensor<Self>,
    ) -> GroupNormGradients<Self> {
        Norm::new(inputs).relu_backward(grad)
    }

    fn momentum_step(
        value: FloatTensor<Self>,
        gradient: FloatTensor<Self>,
        velocity: FloatTensor<Self>,
        step: MomentumStep,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        steps::momentum_step(value, gradient, velocity, step)
    }

    fn adam_step(
        gradient: FloatTensor<Self>,
        state: AdamState<Self>,
        step: AdamStep,
    ) -> AdamState<Self> {
        steps::adam_step(gradient, state, step)
    }

    fn sum_of_squares(
        x: FloatTensor<Self>,
        sums: FloatTensor<Self>,
        slot: usize,
    ) -> FloatTensor<Self> {
        steps::sum_of_squares(x, sums, slot)
    }
}
