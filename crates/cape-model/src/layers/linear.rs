use burn::{
    module::{Module, Param},
    tensor::Tensor,
};

use crate::Init;

/// Fully connected layer `x W + b`.
#[derive(Module, Debug)]
pub struct Linear {
    /// `[input, output]`.
    pub weight: Param<Tensor<2>>,
    /// `[output]`.
    pub bias: Param<Tensor<1>>,
}

impl Linear {
    /// Glorot-uniform weights, zero bias.
    pub fn new(input: usize, output: usize, init: &mut Init) -> Self {
        Self { weight: init.glorot([input, output]), bias: init.constant(0.0, [output]) }
    }

    /// `[batch, input]` → `[batch, output]`.
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        x.matmul(self.weight.val()) + self.bias.val().unsqueeze()
    }
}
