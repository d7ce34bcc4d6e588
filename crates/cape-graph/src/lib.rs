//! Mesh pyramids by quadric simplification, and sparse graph kernels as a Burn backend extension.
//!
//! A [`MeshPyramid`] holds a mesh at decreasing resolutions, with the graph of each level and the
//! selections and interpolations between levels. A [`SparseMatrix`] is a fixed matrix (a Laplacian,
//! a pooling or an up-sampling) on a device; [`sparse_matmul`] and [`cheb_conv`] multiply tensors
//! `[batch, vertices, channels]` by it, with gradients, on every backend that is compiled in.
//!
//! ```
//! use burn::tensor::{Device, Tensor};
//! use cape_synth::synthetic_body;
//! use cape_graph::{DevicePyramid, MeshPyramid, Weighting};
//!
//! let mesh = synthetic_body().mesh();
//! let pyramid = MeshPyramid::build(&mesh, &[2.0, 2.0], Weighting::Barycentric)?;
//! let device = Device::default();
//! let graphs = DevicePyramid::upload(&pyramid, &device);
//! assert_eq!(graphs.vertices(), [6890, 3445, 1723]);
//!
//! let features = Tensor::ones([1, 6890, 3], &device);
//! let coarse = graphs.down(features, 0);
//! assert_eq!(coarse.dims(), [1, 3445, 3]);
//! assert_eq!(graphs.up(coarse, 0).dims(), [1, 6890, 3]);
//! # Ok::<(), cape_graph::Error>(())
//! ```

mod backends;
#[cfg(any(feature = "flex", feature = "ndarray"))]
mod buffer;
mod composed;
mod conv_graph;
mod device;
mod error;
mod export;
mod functions;
mod laplacian;
mod launches;
mod ops;
mod parts;
mod peak;
mod precision;
mod pyramid;
mod quadric;
mod sparse;
mod steps;
mod store;
mod topology;
mod upsample;
mod vector;

pub use backends::release_buffers;
pub use conv_graph::{ConvGraph, HostGraph};
pub use device::DevicePyramid;
pub use error::{Error, Result};
pub use functions::{
    Epilogue, GroupNorm, bias_leaky_relu, cheb_conv, cheb_features, group_norm_relu, norm_conv,
    sparse_matmul,
};
pub use laplacian::{normalized_laplacian, rescaled_laplacian};
pub use launches::KernelLaunches;
pub use ops::{
    ChebConvGradients, ChebConvInputs, ChebConvSaved, ConvSpec, DeviceGraph, EpilogueInputs,
    GraphBackend, GroupNormGradients, GroupNormInputs, NormConvGradients, NormConvInputs,
    OptionalTensor, RequestedGradients, SparseOperand,
};
pub use parts::{PyramidParts, sparse_from_triplets};
pub use peak::peak_gflops;
pub use precision::Precision;
pub use pyramid::{Level, MeshPyramid, Transition};
pub use quadric::{Simplified, simplify};
pub use sparse::{Csr, CsrWithTranspose, SparseMatrix};
pub use steps::{AdamState, AdamStep, MomentumStep, adam_step, momentum_step, sums_of_squares};
pub use store::{read_sparse, write_sparse};
pub use topology::{EdgeCounts, Surface};
pub use upsample::{Weighting, upsample};
