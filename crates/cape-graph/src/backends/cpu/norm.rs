use rayon::prelude::*;

use super::simd;

/// The extents of a group normalisation.
#[derive(Clone, Copy)]
pub(in crate::backends) struct NormShape {
    /// Vertices per example.
    pub vertices: usize,
    /// Channels.
    pub channels: usize,
    /// Groups of consecutive channels, normalised over (channels in group × vertices).
    pub groups: usize,
    /// Added to the variance.
    pub epsilon: f32,
}

/// Vertices summed in f32 before the sum is carried on in f64.
const BLOCK: usize = 64;

/// `y = relu(group_norm(x) · gamma + beta)`; `x: [batch, vertices, channels]`.
pub(in crate::backends) fn group_norm_relu(
    x: &[f32],
    gamma: &[f32],
    beta: &[f32],
    shape: NormShape,
) -> Vec<f32> {
    let mut y = vec![0.0; x.len()];
    if y.is_empty() {
        return y;
    }
    let n = shape.vertices * shape.channels;
    y.par_chunks_mut(n).zip(x.par_chunks(n)).for_each(|(y, x)| {
        let (mean, inverse_deviation) = statistics(x, shape);
        let channels = shape.channels;
        simd(
            #[inline(always)]
            || {
                let (mean, inverse_deviation) = (&mean[..channels], &inverse_deviation[..channels]);
                let (gamma, beta) = (&gamma[..channels], &beta[..channels]);
                for (y, x) in y.chunks_exact_mut(channels).zip(x.chunks_exact(channels)) {
                    for c in 0..channels {
                        // As in the gradient, to the last bit: both must agree on what is active.
                        let unit = (x[c] - mean[c]) * inverse_deviation[c];
                        y[c] = (unit * gamma[c] + beta[c]).max(0.0);
                    }
                }
            },
        );
    });
    y
}

/// Gradients of [`group_norm_relu`] with respect to `x`, `gamma` and `beta`.
pub(in crate::backends) fn group_norm_relu_backward(
    x: &[f32],
    gamma: &[f32],
    beta: &[f32],
    grad: &[f32],
    shape: NormShape,
) -> (Vec<f32>, Vec<f32>, Vec<f32>) {
    let NormShape { vertices, channels, groups, .. } = shape;
    let n = vertices * channels;
    let mut grad_x = vec![0.0; x.len()];
    let partial: Vec<(Vec<f64>, Vec<f64>)> = grad_x
        .par_chunks_mut(n.max(1))
        .zip(x.par_chunks(n.max(1)))
        .zip(grad.par_chunks(n.max(1)))
        .map(|((grad_x, x), grad)| {
            let (mean, inverse_deviation) = statistics(x, shape);
            let normalised = Normalised { mean: &mean, inverse_deviation: &inverse_deviation };
            let (gamma_sum, beta_sum) =
                parameter_gradients(x, grad, gamma, beta, normalised, channels);

            let width = channels / groups;
            let count = (vertices * width) as f64;
            let mut first = vec![0.0f32; channels];
            let mut second = vec![0.0f32; channels];
            for group in 0..groups {
                let span = group * width..(group + 1) * width;
                let weighted = |sums: &[f64]| -> f32 {
                    let total: f64 =
                        span.clone().map(|c| f64::from(gamma[c]) * sums[c]).sum::<f64>();
                    (total / count) as f32
                };
                first[span.clone()].fill(weighted(&beta_sum));
                second[span.clone()].fill(weighted(&gamma_sum));
            }
            simd(
                #[inline(always)]
                || {
                    let (mean, inverse_deviation) =
                        (&mean[..channels], &inverse_deviation[..channels]);
                    let (gamma, beta) = (&gamma[..channels], &beta[..channels]);
                    let (first, second) = (&first[..channels], &second[..channels]);
                    for ((out, x), grad) in grad_x
                        .chunks_exact_mut(channels)
                        .zip(x.chunks_exact(channels))
                        .zip(grad.chunks_exact(channels))
                    {
                        for c in 0..channels {
                            let unit = (x[c] - mean[c]) * inverse_deviation[c];
                            let active = unit * gamma[c] + beta[c] > 0.0;
                            let upstream = if active { grad[c] * gamma[c] } else { 0.0 };
                            out[c] =
                                inverse_deviation[c] * (upstream - first[c] - unit * second[c]);
                        }
                    }
                },
            );
            (gamma_sum, beta_sum)
        })
        .collect();
    let mut grad_gamma = vec![0.0f64; channels];
    let mut grad_beta = vec![0.0f64; channels];
    for (gamma, beta) in &partial {
        for c in 0..channels {
            grad_gamma[c] += gamma[c];
            grad_beta[c] += beta[c];
        }
    }
    let narrow = |sums: Vec<f64>| sums.into_iter().map(|sum| sum as f32).collect();
    (grad_x, narrow(grad_gamma), narrow(grad_beta))
}

/// Per-channel mean and inverse standard deviation of the channel's group, for one example.
fn statistics(x: &[f32], shape: NormShape) -> (Vec<f32>, Vec<f32>) {
    let NormShape { vertices, channels, groups, epsilon } = shape;
    let width = channels / groups;
    let count = (vertices * width) as f64;
    let per_group = |sums: &[f64], f: &dyn Fn(f64) -> f64| -> Vec<f32> {
        sums.chunks_exact(width)
            .flat_map(|sums| std::iter::repeat_n(f(sums.iter().sum::<f64>() / count) as f32, width))
            .collect()
    };
    let sums = channel_sums(
        x,
        channels,
        #[inline(always)]
        |sums: &mut [f32], row: &[f32]| {
            for (sum, x) in sums.iter_mut().zip(row) {
                *sum += x;
            }
        },
    );
    let mean = per_group(&sums, &|mean| mean);
    let squares = channel_sums(
        x,
        channels,
        #[inline(always)]
        |sums: &mut [f32], row: &[f32]| {
            for ((sum, x), mean) in sums.iter_mut().zip(row).zip(&mean) {
                *sum += (x - mean) * (x - mean);
            }
        },
    );
    let inverse_deviation =
        per_group(&squares, &|variance| 1.0 / (variance + f64::from(epsilon)).sqrt());
    (mean, inverse_deviation)
}

/// Sums over vertices of what `add` adds for each vertex's channels.
fn channel_sums(x: &[f32], channels: usize, add: impl Fn(&mut [f32], &[f32])) -> Vec<f64> {
    let mut sums = vec![0.0f64; channels];
    let mut block_sums = vec![0.0f32; channels];
    for block in x.chunks(BLOCK * channels) {
        block_sums.fill(0.0);
        simd(
            #[inline(always)]
            || {
                for row in block.chunks_exact(channels) {
                    add(&mut block_sums, row);
                }
            },
        );
        for (sum, &part) in sums.iter_mut().zip(&block_sums) {
            *sum += f64::from(part);
        }
    }
    sums
}

#[derive(Clone, Copy)]
struct Normalised<'a> {
    mean: &'a [f32],
    inverse_deviation: &'a [f32],
}

/// One example's gradients of gamma and beta.
fn parameter_gradients(
    x: &[f32],
    grad: &[f32],
    gamma: &[f32],
    beta: &[f32],
    normalised: Normalised,
    channels: usize,
) -> (Vec<f64>, Vec<f64>) {
    let Normalised { mean, inverse_deviation } = normalised;
    let mut gamma_sum = vec![0.0f64; channels];
    let mut beta_sum = vec![0.0f64; channels];
    let mut gamma_block = vec![0.0f32; channels];
    let mut beta_block = vec![0.0f32; channels];
    for (x, grad) in x.chunks(BLOCK * channels).zip(grad.chunks(BLOCK * channels)) {
        gamma_block.fill(0.0);
        beta_block.fill(0.0);
        simd(
            #[inline(always)]
            || {
                let (mean, inverse_deviation) = (&mean[..channels], &inverse_deviation[..channels]);
                let (gamma, beta) = (&gamma[..channels], &beta[..channels]);
                let gamma_block = &mut gamma_block[..channels];
                let beta_block = &mut beta_block[..channels];
                for (x, grad) in x.chunks_exact(channels).zip(grad.chunks_exact(channels)) {
                    for c in 0..channels {
                        let unit = (x[c] - mean[c]) * inverse_deviation[c];
                        let active = unit * gamma[c] + beta[c] > 0.0;
                        let upstream = if active { grad[c] } else { 0.0 };
                        gamma_block[c] += upstream * unit;
                        beta_block[c] += upstream;
                    }
                }
            },
        );
        for c in 0..channels {
            gamma_sum[c] += f64::from(gamma_block[c]);
            beta_sum[c] += f64::from(beta_block[c]);
        }
    }
    (gamma_sum, beta_sum)
}
