//! Kernels on slices, shared by the CPU backends.
//!
//! Arrays are row-major `[batch, vertices, channels]`. The work is divided by example, so that the
//! features of an example stay in cache, and also within examples if the batch is small. Partial
//! sums are taken over fixed pieces in a fixed order, so that results do not depend on the number of
//! threads.

mod activation;
mod bf16;
mod conv;
mod conv_backward;
mod group_norm;
mod kernel;
mod norm;
mod norm_conv;
mod panels;
mod scratch;
mod sparse;
mod split;
mod steps;

pub(super) use activation::{bias_leaky_relu, bias_leaky_relu_backward};
pub(crate) use bf16::name as bf16_instructions;
pub(super) use conv::{Conv, cheb_conv};
pub(super) use conv_backward::{Saved, cheb_conv_backward};
pub(super) use group_norm::{group_norm_relu, group_norm_relu_backward};
pub(super) use norm::Norm;
pub(super) use norm_conv::{Inputs, NormConv, norm_conv, norm_conv_backward};
pub(super) use sparse::sparse_matmul;
pub(super) use steps::{adam_step, momentum_step, sum_of_squares};

/// Runs a kernel compiled for the best instruction set this processor has.
#[inline(always)]
fn simd<R>(kernel: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(kernel)
}
