//! Chebyshev basis of order 2 and its transpose, one launch each.

use burn_cubecl::{CubeBackend, kernel::into_contiguous, tensor::CubeTensor};
use cubecl::prelude::*;

use super::{
    dims, elementwise, empty,
    sparse::{Matrix, matrix},
};
use crate::ops::DeviceGraph;

/// Entry `[example, row, channel]` of `A x`, of the term at `offset` among `terms` adjacent ones.
#[cube]
fn entry(
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

/// `out[b, r, 2 c] = (D x)[b, r, c]` and `out[b, r, 2 c + 1] = (D L̃ x)[b, r, c]`, one thread for each
/// pair.
#[cube(launch)]
fn basis_kernel(
    x: &Tensor<f32>,
    laplacian: &Matrix,
    selection: &Matrix,
    out: &mut Tensor<f32>,
    #[comptime] pooled: bool,
) {
    let channels = x.shape(2);
    let rows = out.shape(1);
    if ABSOLUTE_POS < out.len() / 2 {
        let channel = ABSOLUTE_POS % channels;
        let row = (ABSOLUTE_POS / channels) % rows;
        let example = ABSOLUTE_POS / (channels * rows);
        if pooled {
            out[2 * ABSOLUTE_POS] = entry(x, selection, example, row, channel, 1, 0);
        } else {
            out[2 * ABSOLUTE_POS] = x[ABSOLUTE_POS];
        }
        out[2 * ABSOLUTE_POS + 1] = entry(x, laplacian, example, row, channel, 1, 0);
    }
}

/// `[x, L̃ x]` at the kept vertices, `[batch, kept, 2 · channels]`.
pub(super) fn basis(x: CubeTensor, graph: &DeviceGraph<CubeBackend>) -> CubeTensor {
    let x = into_contiguous(x);
    let [batch, _, channels] = dims(&x);
    let out = empty(&x, &[batch, graph.host.kept(), 2 * channels]);
    let pairs = empty(&x, &[batch, graph.host.kept(), channels]);
    let (count, dim) = elementwise(&pairs);
    let laplacian = graph.host.kept_laplacian();
    let selection = graph.host.pool().map_or(laplacian, |pool| &pool.selection);
    basis_kernel::launch(
        &out.client,
        count,
        dim,
        x.into_tensor_arg(),
        matrix(graph, laplacian, false),
        matrix(graph, selection, false),
        out.clone().into_tensor_arg(),
        graph.host.pool().is_some(),
    );
    out
}

/// `out = Dᵀ g_0 + (D L̃)ᵀ g_1`, the terms of `g: [batch, kept, 2 · channels]` adjacent; one thread for
/// each element.
#[cube(launch)]
fn fold_kernel(
    grad: &Tensor<f32>,
    laplacian: &Matrix,
    selection: &Matrix,
    out: &mut Tensor<f32>,
    #[comptime] pooled: bool,
) {
    if ABSOLUTE_POS < out.len() {
        let channels = out.shape(2);
        let rows = out.shape(1);
        let channel = ABSOLUTE_POS % channels;
        let row = (ABSOLUTE_POS / channels) % rows;
        let example = ABSOLUTE_POS / (channels * rows);
        let mut sum = entry(grad, laplacian, example, row, channel, 2, 1);
        if pooled {
            sum += entry(grad, selection, example, row, channel, 2, 0);
        } else {
            sum += grad[2 * ABSOLUTE_POS];
        }
        out[ABSOLUTE_POS] = sum;
    }
}

/// The transpose of [`basis`], `[batch, vertices, channels]`.
pub(super) fn fold(grad: CubeTensor, graph: &DeviceGraph<CubeBackend>) -> CubeTensor {
    let grad = into_contiguous(grad);
    let [batch, _, columns] = dims(&grad);
    let out = empty(&grad, &[batch, graph.host.vertices(), columns / 2]);
    let (count, dim) = elementwise(&out);
    let laplacian = graph.host.kept_laplacian();
    let selection = graph.host.pool().map_or(laplacian, |pool| &pool.selection);
    fold_kernel::launch(
        &out.client,
        count,
        dim,
        grad.into_tensor_arg(),
        matrix(graph, laplacian, true),
        matrix(graph, selection, true),
        out.clone().into_tensor_arg(),
        graph.host.pool().is_some(),
    );
    out
}
