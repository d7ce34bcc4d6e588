//! Mesh pyramids by quadric simplification, and sparse graph kernels as a Burn backend extension.
//!
//! A [`SparseMatrix`] is a fixed matrix (a Laplacian, a pooling or an up-sampling) uploaded to a
//! device once; [`sparse_matmul`] and [`cheb_conv`] multiply tensors `[batch, vertices, channels]`
//! by it, with gradients, on every backend compiled in.

mod backends;
mod device;
mod functions;
mod ops;
mod sparse;

pub use device::DevicePyramid;
pub use functions::{bias_leaky_relu, cheb_conv, cheb_features, group_norm_relu, sparse_matmul};
pub use ops::GraphBackend;
pub use sparse::{Csr, SparseMatrix, SparsePair};
