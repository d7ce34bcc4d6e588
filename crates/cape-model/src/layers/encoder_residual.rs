use burn::{
    module::{Module, Param},
    tensor::Tensor,
};
use cape_graph::{ConvGraph, bias_leaky_relu};

use super::{ChebConv, ConvLayer};
use crate::{Initialiser, config::LEAKY_SLOPE};

/// Residual block of the encoder: two convolutions, the input added before the last bias and leaky
/// ReLU.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::{ConvGraph, sparse_from_triplets};
/// use cape_model::{Initialiser, layers::EncoderResidual};
///
/// let triangle = sparse_from_triplets(
///     "L", (3, 3), &[0, 0, 1, 1, 2, 2], &[1, 2, 0, 2, 0, 1], &[-0.5; 6])?;
/// let device = Device::default();
/// let graph = ConvGraph::new(&triangle, None, &device);
/// let block = EncoderResidual::new(4, 8, 2, &mut Initialiser::new(1, 0.1, &device));
/// assert!(block.skip.is_some());
/// let y = block.forward(Tensor::ones([1, 3, 4], &device), &graph);
/// assert_eq!(y.dims(), [1, 3, 8]);
/// # Ok::<(), cape_graph::Error>(())
/// ```
#[derive(Module, Debug)]
pub struct EncoderResidual {
    /// First convolution with bias and leaky ReLU.
    pub layer: ConvLayer,
    /// Second convolution.
    pub conv: ChebConv,
    /// Linear map of the input; `None` if input and output widths are equal.
    pub skip: Option<ChebConv>,
    /// Bias after the sum, `[output]`.
    pub bias: Param<Tensor<1>>,
}

impl EncoderResidual {
    /// Creates a block from `input` to `output` channels with `order` Chebyshev terms.
    pub fn new(input: usize, output: usize, order: usize, init: &mut Initialiser) -> Self {
        Self {
            layer: ConvLayer::new(input, output, order, init),
            conv: ChebConv::new(output, output, order, init),
            skip: (input != output).then(|| ChebConv::new(input, output, 1, init)),
            bias: init.constant(0.1, [output]),
        }
    }

    /// Applies the block: `[batch, vertices, input]` → `[batch, vertices, output]`.
    pub fn forward(&self, x: Tensor<3>, graph: &ConvGraph) -> Tensor<3> {
        let y = self.layer.forward(x.clone(), None, graph);
        let y = self.conv.forward(y, None, graph);
        let x = match &self.skip {
            Some(skip) => skip.forward(x, None, graph),
            None => x,
        };
        bias_leaky_relu(y + x, self.bias.val(), LEAKY_SLOPE)
    }
}
