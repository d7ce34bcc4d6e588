use burn::{
    module::{Module, Param},
    tensor::Tensor,
};
use cape_graph::{ConvGraph, DevicePyramid, Epilogue, GroupNorm, cheb_conv, norm_conv};

use super::{ChebConv, append, append_unless_preserved};
use crate::{Init, config::MAX_GROUPS};

const EPSILON: f64 = 1e-5;

/// Group normalisation over (channels in group × vertices), then ReLU.
///
/// See [`ResidualBlock`] for an example.
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

    /// `base + conv(relu(norm([x, constant])))`; `constant: [batch, c]` at every vertex.
    fn then(
        &self,
        conv: &ChebConv,
        x: Tensor<3>,
        constant: Option<Tensor<2>>,
        graph: &ConvGraph,
        base: Option<Tensor<3>>,
    ) -> Tensor<3> {
        let (gamma, beta) = (self.gamma.val(), self.beta.val());
        let norm = GroupNorm { gamma, beta, groups: self.groups, epsilon: EPSILON };
        norm_conv(x, constant, norm, conv.weight.val(), graph, conv.order, base)
    }
}

/// Features that are known to be a product, `features · weight`, of fewer channels.
///
/// See [`ResidualBlock`] for an example.
#[derive(Debug, Clone)]
pub struct Product {
    /// `[batch, vertices, inner]`.
    pub features: Tensor<3>,
    /// `[inner, channels]`.
    pub weight: Tensor<2>,
}

/// The decoder's residual block (CAPE appendix A, after GraphCMR): a bottleneck of linear, graph
/// convolution, linear, each after normalisation and ReLU, added to the input.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::{DevicePyramid, sparse_from_triplets};
/// use cape_model::{Init, layers::{Product, ResidualBlock}};
///
/// let triangle = sparse_from_triplets(
///     "L", (3, 3), &[0, 0, 1, 1, 2, 2], &[1, 2, 0, 2, 0, 1], &[-0.5; 6])?;
/// let device = Device::default();
/// let pyramid = DevicePyramid::new(&vec![triangle; 2], &[None], &[None], &device);
/// let block = ResidualBlock::new(4, 8, 2, &mut Init::new(1, 0.1, &device));
/// assert_eq!(block.norm_1.gamma.val().dims(), [4]);
///
/// let features = Tensor::<3>::ones([1, 3, 2], &device);
/// let weight = Tensor::<2>::full([2, 4], 0.5, &device);
/// let x = features.clone().matmul(weight.clone().unsqueeze());
/// let y = block.forward(x.clone(), None, None, &pyramid, 0);
/// assert_eq!(y.dims(), [1, 3, 8]);
/// // Knowing what the features are the product of saves work, and changes nothing.
/// let same = block.forward(x, Some(Product { features, weight }), None, &pyramid, 0);
/// let error: f32 = (y - same).abs().max().into_scalar();
/// assert!(error < 1e-5);
/// # Ok::<(), cape_graph::Error>(())
/// ```
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

    /// `x: [batch, coarse, channels]` of level `level + 1`, `condition: [batch, embedding]` at every
    /// vertex → `[batch, vertices, output]` on `level`. `origin` is what `x` is the product of, if
    /// that is known.
    pub fn forward(
        &self,
        x: Tensor<3>,
        origin: Option<Product>,
        condition: Option<&Tensor<2>>,
        pyramid: &DevicePyramid,
        level: usize,
    ) -> Tensor<3> {
        let (x, condition) = append_unless_preserved(x, condition, pyramid, level);
        // What acts on every vertex alone comes before the up-sampling, where vertices are fewer.
        let base = pyramid.up(self.skip(&x, origin, condition, pyramid.graph(level + 1)), level);
        let (x, graph) = (pyramid.up(x, level), pyramid.graph(level));
        let y = self.norm_1.then(&self.linear_1, x, condition.cloned(), graph, None);
        let y = self.norm_2.then(&self.conv, y, None, graph, None);
        self.norm_3.then(&self.linear_2, y, None, graph, Some(base))
    }

    /// What is added to the block's result, before up-sampling.
    fn skip(
        &self,
        x: &Tensor<3>,
        origin: Option<Product>,
        condition: Option<&Tensor<2>>,
        graph: &ConvGraph,
    ) -> Tensor<3> {
        let Some(skip) = &self.skip else { return append(x.clone(), condition) };
        let [_, _, channels] = x.dims();
        let (weight, constant_terms) = skip.split(channels, condition);
        let (x, weight) = match origin {
            Some(Product { features, weight: first }) if first.dims()[1] == channels => {
                (features, first.matmul(weight))
            }
            _ => (x.clone(), weight),
        };
        cheb_conv(x, weight, graph, 1, Epilogue { constant_terms, slope: None })
    }
}
