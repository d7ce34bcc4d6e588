use burn::{
    module::{Module, Param},
    tensor::Tensor,
};
use cape_graph::{SparseMatrix, bias_leaky_relu, cheb_conv};

use crate::{Init, config::LEAKY_SLOPE};

/// Chebyshev graph convolution without bias: `[T_0(L̃)x, …, T_{K−1}(L̃)x] · W`.
#[derive(Module, Debug)]
pub struct ChebConv {
    /// `[channels · order, out]`, row `channel · order + k`.
    pub weight: Param<Tensor<2>>,
    order: usize,
}

impl ChebConv {
    /// Truncated-normal weights for `order` Chebyshev terms.
    pub fn new(input: usize, output: usize, order: usize, init: &mut Init) -> Self {
        Self { weight: init.truncated_normal([input * order, output]), order }
    }

    /// `[batch, vertices, channels]` → `[batch, vertices, out]`.
    pub fn forward(&self, x: Tensor<3>, laplacian: &SparseMatrix) -> Tensor<3> {
        cheb_conv(x, self.weight.val(), laplacian, self.order)
    }
}

/// Convolution, one bias a channel, leaky ReLU.
#[derive(Module, Debug)]
pub struct ConvLayer {
    /// The convolution.
    pub conv: ChebConv,
    /// `[out]`.
    pub bias: Param<Tensor<1>>,
}

impl ConvLayer {
    /// Truncated-normal weights, biases 0.1.
    pub fn new(input: usize, output: usize, order: usize, init: &mut Init) -> Self {
        Self { conv: ChebConv::new(input, output, order, init), bias: init.constant(0.1, [output]) }
    }

    /// `[batch, vertices, channels]` → `[batch, vertices, out]`.
    pub fn forward(&self, x: Tensor<3>, laplacian: &SparseMatrix) -> Tensor<3> {
        bias_leaky_relu(self.conv.forward(x, laplacian), self.bias.val(), LEAKY_SLOPE)
    }
}
