use burn_cubecl::{CubeBackend, kernel::into_contiguous, tensor::CubeTensor};
use cubecl::prelude::*;

use super::{
    THREADS, dims, elementwise, empty,
    reduce::{Tiles, row_sum},
};
use crate::ops::EpilogueInputs;

/// Strides of an addend, 0 along the axes that it is broadcast over.
#[derive(CubeType, CubeLaunch)]
struct Strides {
    example: usize,
    vertex: usize,
}

/// `out = f(sum + product + addend)`, one thread for each element. `f` is the leaky ReLU of `slope`
/// or, for `None`, the identity.
#[cube(launch)]
fn epilogue_kernel(
    sum: &Tensor<f32>,
    product: ComptimeOption<&Tensor<f32>>,
    addend: ComptimeOption<&Tensor<f32>>,
    strides: &Strides,
    slope: ComptimeOption<f32>,
    out: &mut Tensor<f32>,
) {
    if ABSOLUTE_POS < out.len() {
        let mut value = sum[ABSOLUTE_POS];
        #[comptime]
        match product {
            ComptimeOption::Some(product) => value += product[ABSOLUTE_POS],
            ComptimeOption::None => {}
        }
        #[comptime]
        match addend {
            ComptimeOption::Some(addend) => {
                let channels = out.shape(2);
                let vertices = out.shape(1);
                let channel = ABSOLUTE_POS % channels;
                let vertex = (ABSOLUTE_POS / channels) % vertices;
                let example = ABSOLUTE_POS / (channels * vertices);
                value += addend[example * strides.example + vertex * strides.vertex + channel];
            }
            ComptimeOption::None => {}
        }
        #[comptime]
        match slope {
            ComptimeOption::Some(slope) => value = gated(value, value, slope),
            ComptimeOption::None => {}
        }
        out[ABSOLUTE_POS] = value;
    }
}

/// `x` at positive `sign`, `slope · x` elsewhere.
#[cube]
fn gated(x: f32, sign: f32, slope: f32) -> f32 {
    select(sign <= 0.0, slope * x, x)
}

/// [`GraphBackend::epilogue`](crate::ops::GraphBackend::epilogue).
pub(super) fn epilogue(inputs: EpilogueInputs<CubeBackend>) -> CubeTensor {
    let EpilogueInputs { sum, product, addend, slope } = inputs;
    let sum = into_contiguous(sum);
    let out = empty(&sum, &dims(&sum));
    let product = product.into_option().map(into_contiguous);
    let addend = addend.into_option().map(into_contiguous);
    let [batch, vertices, channels] = addend.as_ref().map_or([1; 3], dims);
    let (count, dim) = elementwise(&out);
    epilogue_kernel::launch(
        &out.client,
        count,
        dim,
        sum.into_tensor_arg(),
        product.map(CubeTensor::into_tensor_arg).into(),
        addend.map(CubeTensor::into_tensor_arg).into(),
        StridesLaunch::new(
            if batch == 1 { 0 } else { vertices * channels },
            if vertices == 1 { 0 } else { channels },
        ),
        slope.map(|slope| slope as f32).into(),
        out.clone().into_tensor_arg(),
    );
    out
}

/// `out = grad` at positive `y`, `slope · grad` elsewhere, and its sums over each chunk of vertices,
/// `partial: [batch, chunks, channels]`.
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

/// Gradient before a leaky ReLU from its output `y`, `[batch, vertices, channels]`, and the sums of
/// that gradient over each chunk of vertices, `[batch, chunks, channels]`.
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
