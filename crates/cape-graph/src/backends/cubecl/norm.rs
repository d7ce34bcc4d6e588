//! Group normalisation with ReLU: moments of tiles, moments of groups, then every element. The sums
//! of the gradients are computed in the same two steps.

use burn_cubecl::{CubeBackend, kernel::into_contiguous, tensor::CubeTensor};
use cubecl::prelude::*;

use super::{
    THREADS, dims, elementwise, empty,
    reduce::{Tiles, column_sums, row_sum},
    reshaped,
};
use crate::ops::{GroupNormGradients, GroupNormInputs};

/// Number of threads that merge the parts of a group.
const MERGERS: u32 = 64;

/// Count and mean of values, and the sum of squared differences from the mean.
#[derive(CubeType, Clone, Copy)]
struct Moments {
    count: f32,
    mean: f32,
    squares: f32,
}

/// Moments of the union. No digits cancel, and the mean of equal values is exact.
#[cube]
fn merged(a: Moments, b: Moments) -> Moments {
    let count = a.count + b.count;
    let share = select(b.count > 0.0, b.count / max(count, 1.0), 0.0);
    let distance = b.mean - a.mean;
    Moments {
        count,
        mean: a.mean + distance * share,
        squares: a.squares + b.squares + distance * distance * a.count * share,
    }
}

/// Moments over the rows of a workgroup of `rows` rows of `width` threads, in its first row.
#[cube]
fn row_moments(moments: Moments, rows: u32, width: u32) -> Moments {
    let mut counts = Shared::new_slice(THREADS);
    let mut means = Shared::new_slice(THREADS);
    let mut squares = Shared::new_slice(THREADS);
    let place = UNIT_POS as usize;
    counts[place] = moments.count;
    means[place] = moments.mean;
    squares[place] = moments.squares;
    sync_cube();
    let mut half = rows / 2;
    while half > 0 {
        if UNIT_POS < half * width {
            let other = (UNIT_POS + half * width) as usize;
            let a = Moments { count: counts[place], mean: means[place], squares: squares[place] };
            let b = Moments { count: counts[other], mean: means[other], squares: squares[other] };
            let both = merged(a, b);
            counts[place] = both.count;
            means[place] = both.mean;
            squares[place] = both.squares;
        }
        sync_cube();
        half /= 2;
    }
    Moments { count: counts[place], mean: means[place], squares: squares[place] }
}

/// Moments of each channel over each chunk of vertices: means and then sums of squares,
/// `partial: [batch, chunks, 2 · channels]`. A thread sums differences from the first value it reads.
#[cube(launch)]
fn moments_kernel(x: &Tensor<f32>, partial: &mut Tensor<f32>, chunk: usize) {
    let vertices = x.shape(1);
    let channels = x.shape(2);
    let channel = (CUBE_POS_X * CUBE_DIM_X + UNIT_POS_X) as usize;
    let part = CUBE_POS_Y as usize;
    let example = CUBE_POS_Z as usize;
    let end = min((part + 1) * chunk, vertices);
    let mut vertex = part * chunk + UNIT_POS_Y as usize;
    let mut count = 0.0f32;
    let mut mean = 0.0f32;
    let mut squares = 0.0f32;
    if channel < channels && vertex < end {
        let pivot = x[(example * vertices + vertex) * channels + channel];
        let mut first = 0.0f32;
        let mut second = 0.0f32;
        while vertex < end {
            let distance = x[(example * vertices + vertex) * channels + channel] - pivot;
            count += 1.0;
            first += distance;
            second += distance * distance;
            vertex += CUBE_DIM_Y as usize;
        }
        let offset = first / count;
        mean = pivot + offset;
        squares = max(second - first * offset, 0.0);
    }
    let all = row_moments(Moments { count, mean, squares }, CUBE_DIM_Y, CUBE_DIM_X);
    if channel < channels && UNIT_POS_Y == 0 {
        let row = (example * partial.shape(1) + part) * 2 * channels;
        partial[row + channel] = all.mean;
        partial[row + channels + channel] = all.squares;
    }
}

/// Mean and inverse standard deviation of every group, `statistics: [batch, groups, 2]`, from the
/// moments of its channels; one workgroup for each group.
#[cube(launch)]
fn statistics_kernel(
    partial: &Tensor<f32>,
    statistics: &mut Tensor<f32>,
    vertices: usize,
    chunk: usize,
    epsilon: f32,
) {
    let chunks = partial.shape(1);
    let channels = partial.shape(2) / 2;
    let groups = statistics.shape(1);
    let width = channels / groups;
    let group = CUBE_POS_X as usize;
    let example = CUBE_POS_Y as usize;
    let mut count = 0.0f32;
    let mut mean = 0.0f32;
    let mut squares = 0.0f32;
    let mut i = UNIT_POS as usize;
    while i < chunks * width {
        let part = i / width;
        let place = (example * chunks + part) * 2 * channels + group * width + i % width;
        let other = Moments {
            count: (min((part + 1) * chunk, vertices) - part * chunk) as f32,
            mean: partial[place],
            squares: partial[place + channels],
        };
        let both = merged(Moments { count, mean, squares }, other);
        count = both.count;
        mean = both.mean;
        squares = both.squares;
        i += CUBE_DIM as usize;
    }
    let all = row_moments(Moments { count, mean, squares }, CUBE_DIM, 1);
    if UNIT_POS == 0 {
        let place = (example * groups + group) * 2;
        statistics[place] = all.mean;
        statistics[place + 1] = 1.0 / f32::sqrt(all.squares / all.count + epsilon);
    }
}

/// Input, statistics and parameters of a group normalisation.
#[derive(CubeType, CubeLaunch)]
struct NormTensors {
    /// `[batch, vertices, channels]`.
    x: OwnedTensor<f32>,
    /// Mean and inverse standard deviation of every group, `[batch, groups, 2]`.
    statistics: OwnedTensor<f32>,
    /// `[channels]`.
    gamma: OwnedTensor<f32>,
    /// `[channels]`.
    beta: OwnedTensor<f32>,
}

/// Index of a channel's group among those of all examples.
#[cube]
fn group_of(norm: &NormTensors, example: usize, channel: usize) -> usize {
    let groups = norm.statistics.shape(1);
    example * groups + channel / (norm.gamma.len() / groups)
}

/// Normalised value of `x[place]`.
#[cube]
fn unit(norm: &NormTensors, place: usize, group: usize) -> f32 {
    (norm.x[place] - norm.statistics[2 * group]) * norm.statistics[2 * group + 1]
}

/// Input of the ReLU, the same to the last bit in both directions.
#[cube]
fn affine(unit: f32, gamma: f32, beta: f32) -> f32 {
    fma(unit, gamma, beta)
}

/// `out = relu(unit · gamma + beta)`, one thread for each element.
#[cube(launch)]
fn relu_kernel(norm: &NormTensors, out: &mut Tensor<f32>) {
    if ABSOLUTE_POS < out.len() {
        let channels = out.shape(2);
        let channel = ABSOLUTE_POS % channels;
        let example = ABSOLUTE_POS / (channels * out.shape(1));
        let unit = unit(norm, ABSOLUTE_POS, group_of(norm, example, channel));
        let affine = affine(unit, norm.gamma[channel], norm.beta[channel]);
        // Not `max`, which would turn NaN into 0.
        out[ABSOLUTE_POS] = select(affine <= 0.0, 0.0, affine);
    }
}

/// `Σ g` and then `Σ g · unit` of each channel over each chunk of vertices, `g` being the gradient
/// before the ReLU: `partial: [batch, chunks, 2 · channels]`.
#[cube(launch)]
fn gradient_sums_kernel(
    norm: &NormTensors,
    grad: &Tensor<f32>,
    partial: &mut Tensor<f32>,
    chunk: usize,
) {
    let mut shared = Shared::new_slice(THREADS);
    let vertices = grad.shape(1);
    let channels = grad.shape(2);
    let channel = (CUBE_POS_X * CUBE_DIM_X + UNIT_POS_X) as usize;
    let part = CUBE_POS_Y as usize;
    let example = CUBE_POS_Z as usize;
    let mut first = 0.0f32;
    let mut second = 0.0f32;
    if channel < channels {
        let group = group_of(norm, example, channel);
        let gamma = norm.gamma[channel];
        let beta = norm.beta[channel];
        let end = min((part + 1) * chunk, vertices);
        let mut vertex = part * chunk + UNIT_POS_Y as usize;
        while vertex < end {
            let place = (example * vertices + vertex) * channels + channel;
            let unit = unit(norm, place, group);
            let g = select(affine(unit, gamma, beta) <= 0.0, 0.0, grad[place]);
            first += g;
            second += g * unit;
            vertex += CUBE_DIM_Y as usize;
        }
    }
    let first = row_sum(first, &mut shared);
    let second = row_sum(second, &mut shared);
    if channel < channels && UNIT_POS_Y == 0 {
        let row = (example * partial.shape(1) + part) * 2 * channels;
        partial[row + channel] = first;
        partial[row + channels + channel] = second;
    }
}

/// Means over every group of `g · gamma` and `g · gamma · unit`, `means: [batch, groups, 2]`; one
/// workgroup of one column for each group.
#[cube(launch)]
fn gradient_means_kernel(
    partial: &Tensor<f32>,
    gamma: &Tensor<f32>,
    means: &mut Tensor<f32>,
    vertices: usize,
) {
    let mut shared = Shared::new_slice(THREADS);
    let chunks = partial.shape(1);
    let channels = partial.shape(2) / 2;
    let groups = means.shape(1);
    let width = channels / groups;
    let group = CUBE_POS_X as usize;
    let example = CUBE_POS_Y as usize;
    let mut first = 0.0f32;
    let mut second = 0.0f32;
    let mut i = UNIT_POS as usize;
    while i < chunks * width {
        let channel = group * width + i % width;
        let place = (example * chunks + i / width) * 2 * channels + channel;
        first += gamma[channel] * partial[place];
        second += gamma[channel] * partial[place + channels];
        i += CUBE_DIM as usize;
    }
    let first = row_sum(first, &mut shared);
    let second = row_sum(second, &mut shared);
    if UNIT_POS == 0 {
        let place = (example * groups + group) * 2;
        let count = (vertices * width) as f32;
        means[place] = first / count;
        means[place + 1] = second / count;
    }
}

/// `out = (g · gamma − mean(g · gamma) − unit · mean(g · gamma · unit)) · inverse deviation`, one
/// thread for each element.
#[cube(launch)]
fn input_gradient_kernel(
    norm: &NormTensors,
    grad: &Tensor<f32>,
    means: &Tensor<f32>,
    out: &mut Tensor<f32>,
) {
    if ABSOLUTE_POS < out.len() {
        let channels = out.shape(2);
        let channel = ABSOLUTE_POS % channels;
        let example = ABSOLUTE_POS / (channels * out.shape(1));
        let group = group_of(norm, example, channel);
        let gamma = norm.gamma[channel];
        let unit = unit(norm, ABSOLUTE_POS, group);
        let affine = affine(unit, gamma, norm.beta[channel]);
        let g = select(affine <= 0.0, 0.0, grad[ABSOLUTE_POS]);
        let centred = g * gamma - means[2 * group] - unit * means[2 * group + 1];
        out[ABSOLUTE_POS] = centred * norm.statistics[2 * group + 1];
    }
}

/// Group normalisation of `x: [batch, vertices, channels]` with its statistics.
#[derive(Clone)]
pub(super) struct Norm {
    x: CubeTensor,
    /// `[batch, groups, 2]`.
    statistics: CubeTensor,
    gamma: CubeTensor,
    beta: CubeTensor,
}

impl Norm {
    pub(super) fn new(inputs: GroupNormInputs<CubeBackend>) -> Self {
        let GroupNormInputs { x, gamma, beta, groups, epsilon } = inputs;
        let [x, gamma, beta] = [x, gamma, beta].map(into_contiguous);
        let [batch, vertices, channels] = dims(&x);
        let tiles = Tiles::new(batch, vertices, channels);
        let partial = empty(&x, &[batch, tiles.chunks, 2 * channels]);
        moments_kernel::launch(
            &x.client,
            tiles.count,
            tiles.dim,
            x.clone().into_tensor_arg(),
            partial.clone().into_tensor_arg(),
            tiles.chunk,
        );
        let statistics = empty(&x, &[batch, groups, 2]);
        statistics_kernel::launch(
            &x.client,
            CubeCount::Static(groups as u32, batch.max(1) as u32, 1),
            CubeDim::new_1d(MERGERS),
            partial.into_tensor_arg(),
            statistics.clone().into_tensor_arg(),
            vertices,
            tiles.chunk,
            epsilon as f32,
        );
        Self { x, statistics, gamma, beta }
    }

    fn into_tensors(self) -> NormTensorsLaunch {
        let tensors = [self.x, self.statistics, self.gamma, self.beta];
        let [x, statistics, gamma, beta] = tensors.map(CubeTensor::into_tensor_arg);
        NormTensorsLaunch::new(x, statistics, gamma, beta)
    }

    /// `relu(group_norm(x) · gamma + beta)`.
    pub(super) fn relu(self) -> CubeTensor {
        let out = empty(&self.x, &dims(&self.x));
        let (count, dim) = elementwise(&out);
        let to = out.clone().into_tensor_arg();
        relu_kernel::launch(&out.client, count, dim, self.into_tensors(), to);
        out
    }

    /// Gradients of [`relu`](Self::relu).
    pub(super) fn relu_backward(self, grad: CubeTensor) -> GroupNormGradients<CubeBackend> {
        let grad = into_contiguous(grad);
        let [batch, vertices, channels] = dims(&self.x);
        let groups = self.statistics.meta.shape()[1];
        let tiles = Tiles::new(batch, vertices, channels);
        let partial = empty(&self.x, &[batch, tiles.chunks, 2 * channels]);
        gradient_sums_kernel::launch(
            &partial.client,
            tiles.count,
            tiles.dim,
            self.clone().into_tensors(),
            grad.clone().into_tensor_arg(),
            partial.clone().into_tensor_arg(),
            tiles.chunk,
        );
        let means = empty(&self.x, &[batch, groups, 2]);
        gradient_means_kernel::launch(
            &means.client,
            CubeCount::Static(groups as u32, batch.max(1) as u32, 1),
            CubeDim::new_2d(1, MERGERS),
            partial.clone().into_tensor_arg(),
            self.gamma.clone().into_tensor_arg(),
            means.clone().into_tensor_arg(),
            vertices,
        );
        let out = empty(&self.x, &[batch, vertices, channels]);
        let (count, dim) = elementwise(&out);
        input_gradient_kernel::launch(
            &out.client,
            count,
            dim,
            self.into_tensors(),
            grad.into_tensor_arg(),
            means.into_tensor_arg(),
            out.clone().into_tensor_arg(),
        );
        let beta = column_sums(partial.clone(), 1, 0..channels);
        let gamma = column_sums(partial, 1, channels..2 * channels);
        GroupNormGradients {
            x: out,
            gamma: reshaped(gamma, &[channels]),
            beta: reshaped(beta, &[channels]),
        }
    }
}
