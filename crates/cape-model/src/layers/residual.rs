use burn::{
    module::{Module, Param},
    tensor::Tensor,
};
use cape_graph::{SparseMatrix, group_norm_relu};

use super::ChebConv;
use crate::{Init, config::MAX_GROUPS};

const EPSILON: f64 = 1e-5;

/// Group normalisation over (channels in group × vertices), then ReLU.
#[derive(Module, Debug)]
pub struct GroupNormRelu {
    /// Scale, `[channels]`.
    pub gamma: Param<Tensor<1>>,
    /// Shift, `[channels]`.
    pub beta: Param<Tensor<1>>,
    groups: usize,
}

impl GroupNormRelu {
    /// `min(32, channels)` groups, scale 1, shift 0.
    pub fn new(channels: usize, init: &mut Init) -> Self {
        Self {
            gamma: init.constant(1.0, [channels]),
            beta: init.constant(0.0, [channels]),
            groups: channels.min(MAX_GROUPS),
        }
    }

    /// `[batch, vertices, channels]`, unchanged in shape.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        group_norm_relu(x, self.gamma.val(), self.beta.val(), self.groups, EPSILON)
    }
}

/// The decoder's residual block (CAPE appendix A, after GraphCMR): a bottleneck of linear, graph
/// convolution, linear, each after normalisation and ReLU, added to the input.
#[derive(Module, Debug)]
pub struct ResidualBlock {
    /// Before [`linear_1`](Self::linear_1).
    pub norm_1: GroupNormRelu,
    /// To half the output width.
    pub linear_1: ChebConv,
    /// Before [`conv`](Self::conv).
    pub norm_2: GroupNormRelu,
    /// The graph convolution, at half the output width.
    pub conv: ChebConv,
    /// Before [`linear_2`](Self::linear_2).
    pub norm_3: GroupNormRelu,
    /// To the output width.
    pub linear_2: ChebConv,
    /// Where the widths of input and output differ.
    pub skip: Option<ChebConv>,
}

impl ResidualBlock {
    /// From `input` to `output` channels.
    pub fn new(input: usize, output: usize, order: usize, init: &mut Init) -> Self {
        let half = output / 2;
        Self {
            norm_1: GroupNormRelu::new(input, init),
            linear_1: ChebConv::new(input, half, 1, init),
            norm_2: GroupNormRelu::new(half, init),
            conv: ChebConv::new(half, half, order, init),
            norm_3: GroupNormRelu::new(half, init),
            linear_2: ChebConv::new(half, output, 1, init),
            skip: (input != output).then(|| ChebConv::new(input, output, 1, init)),
        }
    }

    /// `[batch, vertices, input]` → `[batch, vertices, output]`.
    pub fn forward(&self, x: Tensor<3>, laplacian: &SparseMatrix) -> Tensor<3> {
        let y = self.linear_1.forward(self.norm_1.forward(x.clone()), laplacian);
        let y = self.conv.forward(self.norm_2.forward(y), laplacian);
        let y = self.linear_2.forward(self.norm_3.forward(y), laplacian);
        let x = match &self.skip {
            Some(skip) => skip.forward(x, laplacian),
            None => x,
        };
        y + x
    }
}
