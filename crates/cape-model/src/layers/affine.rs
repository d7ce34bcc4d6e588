use burn::{
    module::Module,
    tensor::{Tensor, activation::relu},
};
use cape_graph::DevicePyramid;

use super::{ChebConv, append_unless_preserved};
use crate::Initialiser;

/// Decoder block of CAPE-affine: `relu(cheb(x)) + linear(x)`.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::{DevicePyramid, sparse_from_triplets};
/// use cape_model::{Initialiser, layers::AffineBlock};
///
/// let triangle = sparse_from_triplets(
///     "L", (3, 3), &[0, 0, 1, 1, 2, 2], &[1, 2, 0, 2, 0, 1], &[-0.5; 6])?;
/// let device = Device::default();
/// let pyramid = DevicePyramid::new(&vec![triangle; 2], &[None], &[None], &device);
/// let block = AffineBlock::new(4, 8, 2, &mut Initialiser::new(1, 0.1, &device));
/// let y = block.forward(Tensor::ones([1, 3, 4], &device), None, &pyramid, 0);
/// assert_eq!(y.dims(), [1, 3, 8]);
/// # Ok::<(), cape_graph::Error>(())
/// ```
#[derive(Module, Debug)]
pub struct AffineBlock {
    /// Graph convolution.
    pub conv: ChebConv,
    /// Linear map of every vertex.
    pub linear: ChebConv,
}

impl AffineBlock {
    /// Creates a block from `input` to `output` channels with `order` Chebyshev terms.
    pub fn new(input: usize, output: usize, order: usize, init: &mut Initialiser) -> Self {
        Self {
            conv: ChebConv::new(input, output, order, init),
            linear: ChebConv::new(input, output, 1, init),
        }
    }

    /// Up-samples `x: [batch, coarse, channels]` from `level + 1` and applies the block with
    /// `condition: [batch, embedding]` at every vertex; returns `[batch, vertices, output]`.
    pub fn forward(
        &self,
        x: Tensor<3>,
        condition: Option<&Tensor<2>>,
        pyramid: &DevicePyramid,
        level: usize,
    ) -> Tensor<3> {
        let (x, condition) = append_unless_preserved(x, condition, pyramid, level);
        let linear = self.linear.forward(x.clone(), condition, pyramid.graph(level + 1));
        let linear = pyramid.up(linear, level);
        let x = pyramid.up(x, level);
        relu(self.conv.forward(x, condition, pyramid.graph(level))) + linear
    }
}
