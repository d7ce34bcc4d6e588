//! Chebyshev bases of orders 2 and 3 and their transposes, in one to three launches.

use burn_cubecl::{CubeBackend, kernel::into_contiguous, tensor::CubeTensor};
use cubecl::prelude::*;

use super::{
    dims, elementwise, empty,
    sparse::{Matrix, entry, matrix, product},
    threads,
};
use crate::ops::DeviceGraph;

/// The first two of `terms` adjacent terms: `out[b, r, terms c] = (D x)[b, r, c]` and
/// `out[b, r, terms c + 1] = (D L̃ x)[b, r, c]`, one thread for each pair.
#[cube(launch)]
fn basis_kernel(
    x: &Tensor<f32>,
    laplacian: &Matrix,
    selection: &Matrix,
    out: &mut Tensor<f32>,
    terms: usize,
    #[comptime] pooled: bool,
) {
    let channels = x.shape(2);
    let rows = out.shape(1);
    if ABSOLUTE_POS < out.len() / terms {
        let channel = ABSOLUTE_POS % channels;
        let row = (ABSOLUTE_POS / channels) % rows;
        let example = ABSOLUTE_POS / (channels * rows);
        if pooled {
            out[terms * ABSOLUTE_POS] = entry(x, selection, example, row, channel, 1, 0);
        } else {
            out[terms * ABSOLUTE_POS] = x[ABSOLUTE_POS];
        }
        out[terms * ABSOLUTE_POS + 1] = entry(x, laplacian, example, row, channel, 1, 0);
    }
}

/// The third of three adjacent terms, `2 D L̃ first − out[…, 3 c]` with the second at all vertices.
#[cube(launch)]
fn recurrence_kernel(first: &Tensor<f32>, laplacian: &Matrix, out: &mut Tensor<f32>) {
    let channels = first.shape(2);
    let rows = out.shape(1);
    if ABSOLUTE_POS < out.len() / 3 {
        let channel = ABSOLUTE_POS % channels;
        let row = (ABSOLUTE_POS / channels) % rows;
        let example = ABSOLUTE_POS / (channels * rows);
        let next = entry(first, laplacian, example, row, channel, 1, 0);
        out[3 * ABSOLUTE_POS + 2] = 2.0 * next - out[3 * ABSOLUTE_POS];
    }
}

/// `[x, L̃ x]`, or `[x, L̃ x, 2 L̃² x − x]` for order 3, at the kept vertices,
/// `[batch, kept, order · channels]`.
pub(super) fn basis(x: CubeTensor, graph: &DeviceGraph<CubeBackend>, order: usize) -> CubeTensor {
    let x = into_contiguous(x);
    let [batch, _, channels] = dims(&x);
    let out = empty(&x, &[batch, graph.host.kept(), order * channels]);
    let (count, dim) = threads(batch * graph.host.kept() * channels);
    let laplacian = graph.host.kept_laplacian();
    let selection = graph.host.pool().map_or(laplacian, |pool| &pool.selection);
    basis_kernel::launch(
        &out.client,
        count.clone(),
        dim,
        x.clone().into_tensor_arg(),
        matrix(graph, laplacian, false),
        matrix(graph, selection, false),
        out.clone().into_tensor_arg(),
        order,
        graph.host.pool().is_some(),
    );
    if order == 3 {
        let first = product(x, graph.operand(graph.host.laplacian(), false), None);
        recurrence_kernel::launch(
            &out.client,
            count,
            dim,
            first.into_tensor_arg(),
            matrix(graph, laplacian, false),
            out.clone().into_tensor_arg(),
        );
    }
    out
}

/// Two of `terms` adjacent terms, which are folded.
#[derive(CubeType, CubeLaunch)]
struct Folded {
    terms: usize,
    /// Term that is scattered, and the one that the Laplacian is applied to, with a factor.
    scattered: usize,
    applied: usize,
    factor: f32,
}

/// `out = Dᵀ g_scattered + factor · (D L̃)ᵀ g_applied`, `g: [batch, kept, terms · channels]`; one thread
/// for each element.
#[cube(launch)]
fn fold_kernel(
    grad: &Tensor<f32>,
    laplacian: &Matrix,
    selection: &Matrix,
    folded: &Folded,
    out: &mut Tensor<f32>,
    #[comptime] pooled: bool,
) {
    if ABSOLUTE_POS < out.len() {
        let channels = out.shape(2);
        let rows = out.shape(1);
        let channel = ABSOLUTE_POS % channels;
        let row = (ABSOLUTE_POS / channels) % rows;
        let example = ABSOLUTE_POS / (channels * rows);
        let terms = folded.terms;
        let applied = entry(grad, laplacian, example, row, channel, terms, folded.applied);
        let mut sum = folded.factor * applied;
        if pooled {
            sum += entry(grad, selection, example, row, channel, terms, folded.scattered);
        } else {
            sum += grad[terms * ABSOLUTE_POS + folded.scattered];
        }
        out[ABSOLUTE_POS] = sum;
    }
}

/// `out = Dᵀ (g_0 − g_2) + L̃ᵀ second`, `g: [batch, kept, 3 · channels]`.
#[cube(launch)]
fn last_fold_kernel(
    grad: &Tensor<f32>,
    second: &Tensor<f32>,
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
        let mut sum = entry(second, laplacian, example, row, channel, 1, 0);
        if pooled {
            sum += entry(grad, selection, example, row, channel, 3, 0);
            sum -= entry(grad, selection, example, row, channel, 3, 2);
        } else {
            sum += grad[3 * ABSOLUTE_POS] - grad[3 * ABSOLUTE_POS + 2];
        }
        out[ABSOLUTE_POS] = sum;
    }
}

/// The transpose of [`basis`], `[batch, vertices, channels]`.
pub(super) fn fold(grad: CubeTensor, graph: &DeviceGraph<CubeBackend>, order: usize) -> CubeTensor {
    let grad = into_contiguous(grad);
    let [batch, _, columns] = dims(&grad);
    let shape = [batch, graph.host.vertices(), columns / order];
    let kept_laplacian = graph.host.kept_laplacian();
    let selection = graph.host.pool().map_or(kept_laplacian, |pool| &pool.selection);
    let pooled = graph.host.pool().is_some();
    let out = empty(&grad, &shape);
    let (count, dim) = elementwise(&out);
    let folded = match order {
        2 => FoldedLaunch::new(2, 0, 1, 1.0),
        _ => FoldedLaunch::new(3, 1, 2, 2.0),
    };
    fold_kernel::launch(
        &out.client,
        count.clone(),
        dim,
        grad.clone().into_tensor_arg(),
        matrix(graph, kept_laplacian, true),
        matrix(graph, selection, true),
        folded,
        out.clone().into_tensor_arg(),
        pooled,
    );
    if order == 2 {
        return out;
    }
    let second = out;
    let out = empty(&grad, &shape);
    last_fold_kernel::launch(
        &out.client,
        count,
        dim,
        grad.into_tensor_arg(),
        second.into_tensor_arg(),
        matrix(graph, graph.host.laplacian(), true),
        matrix(graph, selection, true),
        out.clone().into_tensor_arg(),
        pooled,
    );
    out
}
