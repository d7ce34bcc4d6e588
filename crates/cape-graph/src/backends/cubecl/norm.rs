//! Group normalisation with ReLU: moments of tiles, moments of groups, then every element. The
//! gradients take sums in the same two steps.

use burn_cubecl::{kernel::into_contiguous, tensor::CubeTensor};
use cubecl::prelude::*;

use super::{
    THREADS, dims, elementwise, empty,
    reduce::{Tiles, column_sums, row_sum},
    reshaped,
};

/// Threads that merge the parts of a group.
const MERGERS: u32 = 64;

/// How many numbers, their mean, and the sum of squared distances from it.
#[derive(CubeType, Clone, Copy)]
struct Moments {
    count: f32,
    mean: f32,
    squares: f32,
}

/// Of both; nothing cancels in it, and numbers that are all the same keep their mean exactly.
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
/// `partial: [batch, chunks, 2 · channels]`. A thread measures from the first number that it reads.
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
/// moments of its channels; one workgroup a group.
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

/// `x` normalised.
#[cube]
fn unit(x: f32, statistics: &Tensor<f32>, group: usize) -> f32 {
    (x - statistics[2 * group]) * statistics[2 * group + 1]
}

/// What the ReLU is of, the same to the last bit in both directions.
#[cube]
fn affine(unit: f32, gamma: f32, beta: f32) -> f32 {
    fma(unit, gamma, beta)
}

/// `out = relu(unit · gamma + beta)`, one thread an element.
#[cube(launch)]
fn relu_kernel(
    x: &Tensor<f32>,
    statistics: &Tensor<f32>,
    gamma: &Tensor<f32>,
    beta: &Tensor<f32>,
    out: &mut Tensor<f32>,
) {
    if ABSOLUTE_POS < out.len() {
        let channels = out.shape(2);
        let groups = statistics.shape(1);
        let channel = ABSOLUTE_POS % channels;
        let example = ABSOLUTE_POS / (channels * out.shape(1));
        let group = example * groups + channel / (channels / groups);
        let unit = unit(x[ABSOLUTE_POS], statistics, group);
        let affine = affine(unit, gamma[channel], beta[channel]);
        // Not `max`, which would hide what is not a number.
        out[ABSOLUTE_POS] = select(affine <= 0.0, 0.0, affine);
    }
}

/// `Σ g` and then `Σ g · unit` of each channel over each chunk of vertices, `g` the gradient behind
/// the ReLU: `partial: [batch, chunks, 2 · channels]`.
#[cube(launch)]
#[allow(clippy::too_many_arguments)]
fn gradient_sums_kernel(
    x: &Tensor<f32>,
    grad: &Tensor<f32>,
    statistics: &Tensor<f32>,
    gamma: &Tensor<f32>,
    beta: &Tensor<f32>,
    partial: &mut Tensor<f32>,
    chunk: usize,
) {
    let mut shared = Shared::new_slice(THREADS);
    let vertices = x.shape(1);
    let channels = x.shape(2);
    let groups = statistics.shape(1);
    let channel = (CUBE_POS_X * CUBE_DIM_X + UNIT_POS_X) as usize;
    let part = CUBE_POS_Y as usize;
    let example = CUBE_POS_Z as usize;
    let mut first = 0.0f32;
    let mut second = 0.0f32;
    if channel < channels {
        let group = example * groups + channel / (channels / groups);
        let gamma = gamma[channel];
        let beta = beta[channel];
        let end = min((part + 1) * chunk, vertices);
        let mut vertex = part * chunk + UNIT_POS_Y as usize;
        while vertex < end {
            let place = (example * vertices + vertex) * channels + channel;
            let unit = unit(x[place], statistics, group);
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
/// workgroup of one column a group.
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
/// thread an element.
#[cube(launch)]
#[allow(clippy::too_many_arguments)]
fn input_gradient_kernel(
    x: &Tensor<f32>,
    grad: &Tensor<f32>,
    statistics: &Tensor<f32>,
    means: &Tensor<f32>,
    gamma: &Tensor<f32>,
    beta: &Tensor<f32>,
    out: &mut Tensor<f32>,
) {
    if ABSOLUTE_POS < out.len() {
        let channels = out.shape(2);
        let groups = statistics.shape(1);
        let channel = ABSOLUTE_POS % channels;
        let example = ABSOLUTE_POS / (channels * out.shape(1));
        let group = example * groups + channel / (channels / groups);
        let gamma = gamma[channel];
        let unit = unit(x[ABSOLUTE_POS], statistics, group);
        let g = select(affine(unit, gamma, beta[channel]) <= 0.0, 0.0, grad[ABSOLUTE_POS]);
        let centred = g * gamma - means[2 * group] - unit * means[2 * group + 1];
        out[ABSOLUTE_POS] = centred * statistics[2 * group + 1];
    }
}

/// A group normalisation of `x: [batch, vertices, channels]` with its statistics.
pub(super) struct Norm {
    x: CubeTensor,
    gamma: CubeTensor,
    beta: CubeTensor,
    /// `[batch, groups, 2]`.
    statistics: CubeTensor,
    groups: usize,
}

impl Norm {
    pub(super) fn new(
        x: CubeTensor,
        gamma: CubeTensor,
        beta: CubeTensor,
        groups: usize,
        epsilon: f64,
    ) -> Self {
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
        Self { x, gamma, beta, statistics, groups }
    }

    /// `relu(group_norm(x) · gamma + beta)`.
    pub(super) fn relu(self) -> CubeTensor {
        let out = empty(&self.x, &dims(&self.x));
        let (count, dim) = elementwise(&out);
        relu_kernel::launch(
            &out.client,
            count,
            dim,
            self.x.into_tensor_arg(),
            self.statistics.into_tensor_arg(),
            self.gamma.into_tensor_arg(),
            self.beta.into_tensor_arg(),
            out.clone().into_tensor_arg(),
        );
        out
    }

    /// Gradients of [`relu`](Self::relu) with respect to `x`, `gamma` and `beta`.
    pub(super) fn relu_backward(self, grad: CubeTensor) -> (CubeTensor, CubeTensor, CubeTensor) {
        let grad = into_contiguous(grad);
        let [batch, vertices, channels] = dims(&self.x);
        let tiles = Tiles::new(batch, vertices, channels);
        let partial = empty(&self.x, &[batch, tiles.chunks, 2 * channels]);
        gradient_sums_kernel::launch(
            &self.x.client,
            tiles.count,
            tiles.dim,
            self.x.clone().into_tensor_arg(),
            grad.clone().into_tensor_arg(),
            self.statistics.clone().into_tensor_arg(),
            self.gamma.clone().into_tensor_arg(),
            self.beta.clone().into_tensor_arg(),
            partial.clone().into_tensor_arg(),
            tiles.chunk,
        );
        let means = empty(&self.x, &[batch, self.groups, 2]);
        gradient_means_kernel::launch(
            &means.client,
            CubeCount::Static(self.groups as u32, batch.max(1) as u32, 1),
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
            self.x.into_tensor_arg(),
            grad.into_tensor_arg(),
            self.statistics.into_tensor_arg(),
            means.into_tensor_arg(),
            self.gamma.into_tensor_arg(),
            self.beta.into_tensor_arg(),
            out.clone().into_tensor_arg(),
        );
        let beta = column_sums(partial.clone(), 1, 0..channels);
        let gamma = column_sums(partial, 1, channels..2 * channels);
        (out, reshaped(gamma, &[channels]), reshaped(beta, &[channels]))
    }
}
