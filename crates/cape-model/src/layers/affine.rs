use burn::{
    module::Module,
    tensor::{Tensor, activation::relu},
};
use cape_graph::SparseMatrix;

use super::ChebConv;
use crate::Init;

/// The block of "CAPE-affine": `relu(cheb(x)) + linear(x)`.
#[derive(Module, Debug)]
pub struct AffineBlock {
    /// The graph convolution.
    pub conv: ChebConv,
    /// The affine path.
    pub linear: ChebConv,
}

impl AffineBlock {
    /// From `input` to `output` channels.
    pub fn new(input: usize, output: usize, order: usize, init: &mut Init) -> Self {
        Self {
            conv: ChebConv::new(input, output, order, init),
            linear: ChebConv::new(input, output, 1, init),
        }
    }

    /// `[batch, vertices, input]` → `[batch, vertices, output]`.
    pub fn forward(&self, x: Tensor<3>, laplacian: &SparseMatrix) -> Tensor<3> {
        relu(self.conv.forward(x.clone(), laplacian)) + self.linear.forward(x, laplacian)
    }
}
