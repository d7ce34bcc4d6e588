//! Kernels on slices, shared by the CPU backends.
//!
//! Arrays are row-major `[batch, vertices, channels]`. Work is split by example, so that an
//! example's layer stays in cache; partial sums are taken over fixed pieces in a fixed order, so
//! that results do not depend on the number of threads.

mod activation;
mod chebyshev;
mod gemm;
mod norm;
mod sparse;

pub(super) use activation::{bias_leaky_relu, bias_leaky_relu_backward};
pub(super) use chebyshev::{Conv, cheb_conv, cheb_conv_backward};
pub(super) use norm::{NormShape, group_norm_relu, group_norm_relu_backward};
pub(super) use sparse::sparse_matmul;

/// Runs a kernel compiled for the best instruction set this processor has.
#[inline(always)]
fn simd<R>(kernel: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(kernel)
}
