use std::sync::Arc;

use burn_cubecl::{CubeBackend, kernel::into_contiguous, tensor::CubeTensor};
use cubecl::prelude::*;

use super::{dims, elementwise, empty};
use crate::{
    ops::{DeviceGraph, SparseOperand},
    sparse::CsrWithTranspose,
};

/// Sparse matrix in the arrays of the device.
#[derive(CubeType, CubeLaunch)]
pub(super) struct Matrix {
    pub structure: OwnedTensor<i32>,
    pub values: OwnedTensor<f32>,
    /// Offset of its row starts in `structure`.
    pub indptr: usize,
    /// Offset of its column indices in `structure`.
    pub indices: usize,
    /// Offset of its values in `values`.
    pub data: usize,
}

/// Factors of a product and of its base.
#[derive(CubeType, CubeLaunch)]
struct Factors {
    alpha: f32,
    beta: f32,
}

/// Entry `[example, row, channel]` of `A x`, of the term at `offset` among `terms` adjacent ones.
#[cube]
pub(super) fn entry(
    x: &Tensor<f32>,
    a: &Matrix,
    example: usize,
    row: usize,
    channel: usize,
    terms: usize,
    offset: usize,
) -> f32 {
    let columns = x.shape(1);
    let width = x.shape(2);
    let from = a.structure[a.indptr + row] as usize;
    let to = a.structure[a.indptr + row + 1] as usize;
    let mut sum = 0.0f32;
    for place in from..to {
        let column = a.structure[a.indices + place] as usize;
        let value = a.values[a.data + place];
        sum += value * x[(example * columns + column) * width + channel * terms + offset];
    }
    sum
}

/// `out = A x`, or `alpha · A x + beta · base` with a base: one thread for each output element.
#[cube(launch)]
fn product_kernel(
    x: &Tensor<f32>,
    a: &Matrix,
    base: ComptimeOption<&Tensor<f32>>,
    factors: &Factors,
    out: &mut Tensor<f32>,
) {
    if ABSOLUTE_POS < out.len() {
        let channels = out.shape(2);
        let rows = out.shape(1);
        let channel = ABSOLUTE_POS % channels;
        let row = (ABSOLUTE_POS / channels) % rows;
        let example = ABSOLUTE_POS / (channels * rows);
        let sum = entry(x, a, example, row, channel, 1, 0);
        #[comptime]
        match base {
            ComptimeOption::Some(base) => {
                out[ABSOLUTE_POS] = factors.alpha * sum + factors.beta * base[ABSOLUTE_POS];
            }
            ComptimeOption::None => {
                out[ABSOLUTE_POS] = sum;
            }
        }
    }
}

/// `A x`, or `alpha · A x + beta · base` with `(base, alpha, beta)`; `x: [batch, columns, channels]`,
/// `base: [batch, rows, channels]`.
pub(super) fn product(
    x: CubeTensor,
    a: SparseOperand<CubeBackend>,
    base: Option<(CubeTensor, f32, f32)>,
) -> CubeTensor {
    let x = into_contiguous(x);
    let [batch, _, channels] = dims(&x);
    let out = empty(&x, &[batch, a.rows(), channels]);
    let (base, factors) = match base {
        Some((base, alpha, beta)) => (Some(into_contiguous(base)), FactorsLaunch::new(alpha, beta)),
        None => (None, FactorsLaunch::new(1.0, 0.0)),
    };
    let (count, dim) = elementwise(&out);
    product_kernel::launch(
        &out.client,
        count,
        dim,
        x.into_tensor_arg(),
        launch_argument(a),
        base.map(CubeTensor::into_tensor_arg).into(),
        factors,
        out.clone().into_tensor_arg(),
    );
    out
}

/// Argument of a kernel.
fn launch_argument(a: SparseOperand<CubeBackend>) -> MatrixLaunch {
    let offsets = a.matrix.offsets(a.transpose);
    MatrixLaunch::new(
        a.structure.into_tensor_arg(),
        a.values.into_tensor_arg(),
        offsets.indptr,
        offsets.indices,
        offsets.data,
    )
}

/// One of the matrices of a graph, or its transpose, as an argument of a kernel.
pub(super) fn matrix(
    graph: &DeviceGraph<CubeBackend>,
    matrix: &Arc<CsrWithTranspose>,
    transpose: bool,
) -> MatrixLaunch {
    launch_argument(graph.operand(matrix, transpose))
}
