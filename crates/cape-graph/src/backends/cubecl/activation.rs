use burn_cubecl::{kernel::into_contiguous, tensor::CubeTensor};
use cubecl::prelude::*;

use super::{
    THREADS, dims, elementwise, empty,
    reduce::{Tiles, row_sum},
};

/// `out = f(x + term + rows)`, one thread an element. The strides of `rows` are 0 along what it is
/// broadcast over. Without `has_term` and so on, what belongs to it is unused.
#[cube(launch)]
#[allow(clippy::too_many_arguments)]
fn end_kernel(
    x: &Tensor<f32>,
    term: &Tensor<f32>,
    rows: &Tensor<f32>,
    out: &mut Tensor<f32>,
    example_stride: usize,
    vertex_stride: usize,
    slope: f32,
    #[comptime] has_term: bool,
    #[comptime] has_rows: bool,
    #[comptime] has_slope: bool,
) {
    if ABSOLUTE_POS < out.len() {
        let mut sum = x[ABSOLUTE_POS];
        if has_term {
            sum += term[ABSOLUTE_POS];
        }
        if has_rows {
            let channels = out.shape(2);
            let vertices = out.shape(1);
            let channel = ABSOLUTE_POS % channels;
            let vertex = (ABSOLUTE_POS / channels) % vertices;
            let example = ABSOLUTE_POS / (channels * vertices);
            sum += rows[example * example_stride + vertex * vertex_stride + channel];
        }
        if has_slope {
            sum = gated(sum, sum, slope);
        }
        out[ABSOLUTE_POS] = sum;
    }
}

/// `x` where `sign` is positive, `slope · x` elsewhere.
#[cube]
fn gated(x: f32, sign: f32, slope: f32) -> f32 {
    select(sign <= 0.0, slope * x, x)
}

/// `f(x + term + rows)`, `x` and `term: [batch, vertices, channels]`; `rows` has these dimensions
/// or 1 instead of the first two, `f` is the leaky ReLU of a slope.
pub(super) fn end(
    x: CubeTensor,
    term: Option<CubeTensor>,
    rows: Option<CubeTensor>,
    slope: Option<f64>,
) -> CubeTensor {
    let x = into_contiguous(x);
    let out = empty(&x, &dims(&x));
    let (has_term, has_rows) = (term.is_some(), rows.is_some());
    let term = term.map_or_else(|| x.clone(), into_contiguous);
    let rows = rows.map_or_else(|| x.clone(), into_contiguous);
    let [row_batch, row_vertices, channels] = dims(&rows);
    let (count, dim) = elementwise(&out);
    end_kernel::launch(
        &out.client,
        count,
        dim,
        x.into_tensor_arg(),
        term.into_tensor_arg(),
        rows.into_tensor_arg(),
        out.clone().into_tensor_arg(),
        if row_batch == 1 { 0 } else { row_vertices * channels },
        if row_vertices == 1 { 0 } else { channels },
        slope.unwrap_or(1.0) as f32,
        has_term,
        has_rows,
        slope.is_some(),
    );
    out
}

/// `out = grad` where `y` is positive, `slope · grad` elsewhere, and its sums over each chunk of
/// vertices, `partial: [batch, chunks, channels]`.
#[cube(launch)]
fn gate_kernel(
    y: &Tensor<f32>,
    grad: &Tensor<f32>,
    out: &mut Tensor<f32>,
    partial: &mut Tensor<f32>,
    chunk: usize,
    slope: f32,
) {
    let mut shared = Shared::new_slice(THREADS);
    let vertices = out.shape(1);
    let channels = out.shape(2);
    let channel = (CUBE_POS_X * CUBE_DIM_X + UNIT_POS_X) as usize;
    let part = CUBE_POS_Y as usize;
    let example = CUBE_POS_Z as usize;
    let mut sum = 0.0f32;
    if channel < channels {
        let end = min((part + 1) * chunk, vertices);
        let mut vertex = part * chunk + UNIT_POS_Y as usize;
        while vertex < end {
            let place = (example * vertices + vertex) * channels + channel;
            let value = gated(grad[place], y[place], slope);
            out[place] = value;
            sum += value;
            vertex += CUBE_DIM_Y as usize;
        }
    }
    let sum = row_sum(sum, &mut shared);
    if channel < channels && UNIT_POS_Y == 0 {
        let place = (example * partial.shape(1) + part) * channels + channel;
        partial[place] = sum;
    }
}

/// The gradient before a leaky ReLU from its output `y`, and the gradient's sums over each chunk
/// of vertices, `[batch, chunks, channels]`.
pub(super) fn gate(y: CubeTensor, grad: CubeTensor, slope: f64) -> (CubeTensor, CubeTensor) {
    let (y, grad) = (into_contiguous(y), into_contiguous(grad));
    let [batch, vertices, channels] = dims(&y);
    let tiles = Tiles::new(batch, vertices, channels);
    let out = empty(&y, &[batch, vertices, channels]);
    let partial = empty(&y, &[batch, tiles.chunks, channels]);
    gate_kernel::launch(
        &out.client,
        tiles.count,
        tiles.dim,
        y.into_tensor_arg(),
        grad.into_tensor_arg(),
        out.clone().into_tensor_arg(),
        partial.clone().into_tensor_arg(),
        tiles.chunk,
        slope as f32,
    );
    (out, partial)
}
