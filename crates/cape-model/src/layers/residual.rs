use burn::{
    module::{Module, Param},
    tensor::Tensor,
};
use cape_graph::{ConvGraph, DevicePyramid, Epilogue, GroupNorm, cheb_conv, norm_conv};

use super::{ChebConv, append, append_unless_preserved};
use crate::{Initialiser, config::group_count};

/// Group normalisation over the channels of a group and all vertices, then ReLU.
#[derive(Module, Debug)]
pub struct GroupNormRelu {
    /// Scale per channel, `[channels]`.
    pub gamma: Param<Tensor<1>>,
    /// Shift per channel, `[channels]`.
    pub beta: Param<Tensor<1>>,
    groups: usize,
}

impl GroupNormRelu {
    /// Added to the variance.
    pub const EPSILON: f64 = 1e-5;

    /// Creates a normalisation with scale 1 and shift 0; `group_channels` is that of
    /// [`CapeConfig`](crate::CapeConfig::group_channels).
    pub fn new(channels: usize, group_channels: Option<usize>, init: &mut Initialiser) -> Self {
        Self {
            gamma: init.constant(1.0, [channels]),
            beta: init.constant(0.0, [channels]),
            groups: group_count(channels, group_channels),
        }
    }

    /// Number of groups of consecutive channels.
    pub fn groups(&self) -> usize {
        self.groups
    }

    /// `base + conv(relu(norm([x, constant])))`, with `constant: [batch, c]` as further channels at
    /// every vertex.
    fn then(
        &self,
        conv: &ChebConv,
        x: Tensor<3>,
        constant: Option<Tensor<2>>,
        graph: &ConvGraph,
        base: Option<Tensor<3>>,
    ) -> Tensor<3> {
        let (gamma, beta) = (self.gamma.val(), self.beta.val());
        let norm = GroupNorm { gamma, beta, groups: self.groups, epsilon: Self::EPSILON };
        norm_conv(x, constant, norm, conv.weight.val(), graph, conv.order, base)
    }
}

/// Features in factored form `features · weight`, with fewer inner channels than channels.
#[derive(Debug, Clone)]
pub struct FactoredFeatures {
    /// Left factor, `[batch, vertices, inner]`.
    pub features: Tensor<3>,
    /// Right factor, `[inner, channels]`.
    pub weight: Tensor<2>,
}

/// Residual block of the decoder (CAPE appendix A, after GraphCMR): a bottleneck of linear map,
/// graph convolution and linear map, each after group normalisation and ReLU, added to the input.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::{DevicePyramid, sparse_from_triplets};
/// use cape_model::{Initialiser, layers::{FactoredFeatures, ResidualBlock}};
///
/// let triangle = sparse_from_triplets(
///     "L", (3, 3), &[0, 0, 1, 1, 2, 2], &[1, 2, 0, 2, 0, 1], &[-0.5; 6])?;
/// let device = Device::default();
/// let pyramid = DevicePyramid::new(&vec![triangle; 2], &[None], &[None], &device);
/// let block = ResidualBlock::new(4, 8, 2, None, &mut Initialiser::new(1, 0.1, &device));
/// assert_eq!(block.norm_1.gamma.val().dims(), [4]);
///
/// let features = Tensor::<3>::ones([1, 3, 2], &device);
/// let weight = Tensor::<2>::full([2, 4], 0.5, &device);
/// let x = features.clone().matmul(weight.clone().unsqueeze());
/// let y = block.forward(x.clone(), None, None, &pyramid, 0);
/// assert_eq!(y.dims(), [1, 3, 8]);
/// // The factored form of the features saves work and gives the same result.
/// let same = block.forward(x, Some(FactoredFeatures { features, weight }), None, &pyramid, 0);
/// let error: f32 = (y - same).abs().max().into_scalar();
/// assert!(error < 1e-5);
/// # Ok::<(), cape_graph::Error>(())
/// ```
#[derive(Module, Debug)]
pub struct ResidualBlock {
    /// Normalisation before [`linear_1`](Self::linear_1).
    pub norm_1: GroupNormRelu,
    /// Linear map to half the output width.
    pub linear_1: ChebConv,
    /// Normalisation before [`conv`](Self::conv).
    pub norm_2: GroupNormRelu,
    /// Graph convolution at half the output width.
    pub conv: ChebConv,
    /// Normalisation before [`linear_2`](Self::linear_2).
    pub norm_3: GroupNormRelu,
    /// Linear map to the output width.
    pub linear_2: ChebConv,
    /// Linear map of the input; `None` if input and output widths are equal.
    pub skip: Option<ChebConv>,
}

impl ResidualBlock {
    /// Creates a block from `input` to `output` channels with `order` Chebyshev terms;
    /// `group_channels` is that of [`CapeConfig`](crate::CapeConfig::group_channels).
    pub fn new(
        input: usize,
        output: usize,
        order: usize,
        group_channels: Option<usize>,
        init: &mut Initialiser,
    ) -> Self {
        let half = output / 2;
        Self {
            norm_1: GroupNormRelu::new(input, group_channels, init),
            linear_1: ChebConv::new(input, half, 1, init),
            norm_2: GroupNormRelu::new(half, group_channels, init),
            conv: ChebConv::new(half, half, order, init),
            norm_3: GroupNormRelu::new(half, group_channels, init),
            linear_2: ChebConv::new(half, output, 1, init),
            skip: (input != output).then(|| ChebConv::new(input, output, 1, init)),
        }
    }

    /// Up-samples `x: [batch, coarse, channels]` from `level + 1` and applies the block with
    /// `condition: [batch, embedding]` at every vertex; returns `[batch, vertices, output]`.
    /// `origin` is the factored form of `x`, if known.
    pub fn forward(
        &self,
        x: Tensor<3>,
        origin: Option<FactoredFeatures>,
        condition: Option<&Tensor<2>>,
        pyramid: &DevicePyramid,
        level: usize,
    ) -> Tensor<3> {
        let (x, condition) = append_unless_preserved(x, condition, pyramid, level);
        // Maps of single vertices precede the up-sampling, where there are fewer vertices.
        let base = pyramid.up(self.skip(&x, origin, condition, pyramid.graph(level + 1)), level);
        let (x, graph) = (pyramid.up(x, level), pyramid.graph(level));
        let y = self.norm_1.then(&self.linear_1, x, condition.cloned(), graph, None);
        let y = self.norm_2.then(&self.conv, y, None, graph, None);
        self.norm_3.then(&self.linear_2, y, None, graph, Some(base))
    }

    /// Skip path of the block, before up-sampling.
    fn skip(
        &self,
        x: &Tensor<3>,
        origin: Option<FactoredFeatures>,
        condition: Option<&Tensor<2>>,
        graph: &ConvGraph,
    ) -> Tensor<3> {
        let Some(skip) = &self.skip else { return append(x.clone(), condition) };
        let [_, _, channels] = x.dims();
        let (weight, constant_terms) = skip.split(channels, condition);
        let (x, weight) = match origin {
            Some(FactoredFeatures { features, weight: first }) if first.dims()[1] == channels => {
                (features, first.matmul(weight))
            }
            _ => (x.clone(), weight),
        };
        cheb_conv(x, weight, graph, 1, Epilogue { constant_terms, slope: None })
    }
}
