use rayon::prelude::*;

use super::{
    norm::{Affine, Norm, Sums},
    scratch::with_scratch,
    split::Split,
};
use crate::buffer::Buffer;

/// `y = relu(group_norm(x) · gamma + beta)`; `x: [batch, vertices, channels]`.
pub(in crate::backends) fn group_norm_relu(
    x: &[f32],
    gamma: &[f32],
    beta: &[f32],
    norm: Norm,
) -> Buffer {
    let mut y = Buffer::take(x.len());
    if y.is_empty() {
        return y;
    }
    let n = norm.vertices * norm.channels;
    let split = Split::new(x.len() / n);
    y.par_chunks_mut(n).zip(x.par_chunks(n)).for_each(|(y, x)| {
        let statistics = norm.statistics(x, &[], split);
        norm.apply(x, &statistics, Affine { gamma, beta }, y);
    });
    y
}

/// Gradients of [`group_norm_relu`] with respect to `x`, `gamma` and `beta`.
pub(in crate::backends) fn group_norm_relu_backward(
    x: &[f32],
    gamma: &[f32],
    beta: &[f32],
    grad: &[f32],
    norm: Norm,
) -> (Buffer, Vec<f32>, Vec<f32>) {
    let n = (norm.vertices * norm.channels).max(1);
    let split = Split::new(x.len() / n);
    let affine = Affine { gamma, beta };
    let mut grad_x = Buffer::take(x.len());
    let sums: Vec<Sums> = grad_x
        .par_chunks_mut(n)
        .zip(x.par_chunks(n))
        .zip(grad.par_chunks(n))
        .map(|((grad_x, x), grad)| {
            let statistics = norm.statistics(x, &[], split);
            with_scratch(n, |active| {
                norm.apply(x, &statistics, affine, active);
                let sums = norm.sums(x, active, grad, &statistics, split);
                let means = norm.means(&sums, affine);
                grad_x.copy_from_slice(grad);
                norm.input_gradient(x, active, &statistics, affine, &means, grad_x);
                sums
            })
        })
        .collect();
    let (gamma, beta) = Sums::total(&sums, norm.channels);
    (grad_x, gamma, beta)
}
