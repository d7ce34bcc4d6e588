use rayon::prelude::*;

use super::simd;

/// Number of rows with a common partial sum of the bias gradient; independent of the number of
/// threads.
const ROWS: usize = 4096;

/// `y = leaky_relu(x + bias)`, in place; `x: [rows, channels]`, `bias: [channels]`.
pub(in crate::backends) fn bias_leaky_relu(x: &mut [f32], bias: &[f32], slope: f32) {
    let channels = bias.len();
    x.par_chunks_mut(ROWS * channels).for_each(|x| {
        simd(
            #[inline(always)]
            || {
                for x in x.chunks_exact_mut(channels) {
                    for (x, &bias) in x.iter_mut().zip(bias) {
                        let y = *x + bias;
                        *x = if y > 0.0 { y } else { slope * y };
                    }
                }
            },
        );
    });
}

/// Gradients of [`bias_leaky_relu`] from its output `y`: `grad` is replaced by the gradient of `x`,
/// and that of the bias, `[channels]`, is returned. The slope is positive, so `y` and `x + bias`
/// agree in sign.
pub(in crate::backends) fn bias_leaky_relu_backward(
    y: &[f32],
    grad: &mut [f32],
    channels: usize,
    slope: f32,
) -> Vec<f32> {
    let partial: Vec<Vec<f32>> = grad
        .par_chunks_mut(ROWS * channels)
        .zip(y.par_chunks(ROWS * channels))
        .map(|(grad, y)| {
            let mut sum = vec![0.0f32; channels];
            simd(
                #[inline(always)]
                || {
                    for (grad, y) in grad.chunks_exact_mut(channels).zip(y.chunks_exact(channels)) {
                        for ((grad, &y), sum) in grad.iter_mut().zip(y).zip(&mut sum) {
                            *grad *= if y > 0.0 { 1.0 } else { slope };
                            *sum += *grad;
                        }
                    }
                },
            );
            sum
        })
        .collect();
    let mut bias = vec![0.0; channels];
    for part in &partial {
        for (bias, part) in bias.iter_mut().zip(part) {
            *bias += part;
        }
    }
    bias
}
