use burn::{
    module::{Module, Param},
    tensor::Tensor,
};

use crate::Initialiser;

/// Fully connected layer `x W + b`.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_model::{Initialiser, layers::Linear};
///
/// let device = Device::default();
/// let layer = Linear::new(2, 3, &mut Initialiser::new(1, 0.1, &device));
/// let y = layer.forward(Tensor::zeros([4, 2], &device));
/// assert_eq!(y.dims(), [4, 3]);
/// let largest: f32 = y.abs().max().into_scalar();
/// assert_eq!(largest, 0.0);
/// ```
#[derive(Module, Debug)]
pub struct Linear {
    /// Weight matrix, `[input, output]`.
    pub weight: Param<Tensor<2>>,
    /// Bias, `[output]`.
    pub bias: Param<Tensor<1>>,
}

impl Linear {
    /// Creates Glorot-uniform weights and a zero bias.
    pub fn new(input: usize, output: usize, init: &mut Initialiser) -> Self {
        Self { weight: init.glorot([input, output]), bias: init.constant(0.0, [output]) }
    }

    /// Applies the layer: `[batch, input]` → `[batch, output]`.
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        x.matmul(self.weight.val()) + self.bias.val().unsqueeze()
    }
}
