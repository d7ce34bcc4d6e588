use burn::{
    module::{Module, Param},
    tensor::{Tensor, activation::leaky_relu},
};
use cape_graph::DevicePyramid;

use crate::{
    CapeConfig, DecoderBlock, DecoderConditions, Initialiser,
    config::LEAKY_SLOPE,
    layers::{
        AffineBlock, ChebConv, ConvLayer, FactoredFeatures, Linear, ResidualBlock,
        append_unless_preserved,
    },
};

/// One layer of the decoder after its up-sampling.
#[derive(Module, Debug)]
#[allow(clippy::large_enum_variant)] // a model holds a handful of them
pub enum DecoderLayer {
    /// Conditional residual block of CAPE.
    Residual(ResidualBlock),
    /// Block of CAPE-affine.
    Affine(AffineBlock),
    /// Convolution, bias and leaky ReLU, as in CoMA.
    Plain(ConvLayer),
}

impl DecoderLayer {
    fn forward(
        &self,
        x: Tensor<3>,
        origin: Option<FactoredFeatures>,
        condition: Option<&Tensor<2>>,
        graph: &DevicePyramid,
        level: usize,
    ) -> Tensor<3> {
        match self {
            Self::Residual(block) => block.forward(x, origin, condition, graph, level),
            Self::Affine(block) => block.forward(x, condition, graph, level),
            Self::Plain(layer) => {
                let (x, condition) = append_unless_preserved(x, condition, graph, level);
                layer.forward(graph.up(x, level), condition, graph.graph(level))
            }
        }
    }
}

/// Decoder: latent code and conditions to displacements (CAPE §4.1 and appendix A).
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::{DevicePyramid, sparse_from_triplets};
/// use cape_model::{CapeConfig, Decoder, DecoderLayer, Initialiser};
///
/// let triangle = sparse_from_triplets(
///     "L", (3, 3), &[0, 0, 1, 1, 2, 2], &[1, 2, 0, 2, 0, 1], &[-0.5; 6])?;
/// let device = Device::default();
/// let graph = DevicePyramid::new(&vec![triangle; 3], &[None, None], &[None, None], &device);
/// let config = CapeConfig { filters: vec![4, 8], factors: vec![1, 1], ..CapeConfig::tiny() };
/// let decoder = Decoder::new(&config, 3, 3, &mut Initialiser::new(1, 0.1, &device));
/// assert!(matches!(decoder.blocks[..], [DecoderLayer::Residual(_), DecoderLayer::Residual(_)]));
/// let condition = Tensor::zeros([2, config.condition_size()], &device);
/// let clothes = decoder.forward(Tensor::zeros([2, 6], &device), Some(&condition), &graph);
/// assert_eq!(clothes.dims(), [2, 3, 3]);
/// # Ok::<(), cape_graph::Error>(())
/// ```
#[derive(Module, Debug)]
pub struct Decoder {
    /// Fully connected layer from the code to features of the coarsest level.
    pub input: Linear,
    /// 1×1 convolution to the width of the first block.
    pub expand: Option<ChebConv>,
    /// Layers, one per transition of the pyramid, coarsest first.
    pub blocks: Vec<DecoderLayer>,
    /// Convolution to three coordinates.
    pub output: ChebConv,
    /// Bias per vertex and coordinate, `[vertices, 3]`.
    pub output_bias: Param<Tensor<2>>,
    /// Linear map from the code and its conditions to the displacements of all vertices,
    /// `[code, 3 · vertices]`, which is added to them.
    pub linear_path: Option<Param<Tensor<2>>>,
    code_conditioned: bool,
    blocks_conditioned: bool,
}

impl Decoder {
    /// Creates a decoder for meshes of `vertices` vertices whose coarsest level has `coarse`.
    pub fn new(
        config: &CapeConfig,
        vertices: usize,
        coarse: usize,
        init: &mut Initialiser,
    ) -> Self {
        let code_conditioned = config.decoder_conditions != DecoderConditions::None;
        let extra = config.block_conditions();
        let mut width = config.filters.last().copied().unwrap_or_default();
        let stem = if config.reduce > 0 { config.reduce } else { width };
        let code = config.latent + if code_conditioned { config.condition_size() } else { 0 };
        let input = init.linear(code, coarse * stem);
        let expand = (config.reduce > 0).then(|| ChebConv::new(stem, width, 1, init));

        let mut blocks = Vec::new();
        for &filters in config.filters.iter().rev() {
            let (channels, order) = (width + extra, config.order);
            width = if config.decoder == DecoderBlock::Affine { filters / 2 } else { filters };
            blocks.push(match config.decoder {
                DecoderBlock::Residual => {
                    let groups = config.group_channels;
                    DecoderLayer::Residual(ResidualBlock::new(channels, width, order, groups, init))
                }
                DecoderBlock::Affine => {
                    DecoderLayer::Affine(AffineBlock::new(channels, width, order, init))
                }
                DecoderBlock::Plain => {
                    DecoderLayer::Plain(ConvLayer::new(channels, width, order, init))
                }
            });
        }
        Self {
            input,
            expand,
            blocks,
            output: ChebConv::new(width + extra, 3, config.order, init),
            output_bias: init.constant(0.1, [vertices, 3]),
            linear_path: config.linear_path.then(|| init.glorot([code, 3 * vertices])),
            code_conditioned,
            blocks_conditioned: extra > 0,
        }
    }

    /// Decodes `z: [batch, latent]` with `condition: [batch, embedding]` into normalised
    /// displacements `[batch, vertices, 3]`.
    pub fn forward(
        &self,
        z: Tensor<2>,
        condition: Option<&Tensor<2>>,
        graph: &DevicePyramid,
    ) -> Tensor<3> {
        self.forward_with(z, condition, graph, &mut |_, _| {})
    }

    /// As [`forward`](Self::forward); `tap` receives every block's index and output.
    pub fn forward_with(
        &self,
        z: Tensor<2>,
        condition: Option<&Tensor<2>>,
        graph: &DevicePyramid,
        tap: &mut dyn FnMut(usize, &Tensor<3>),
    ) -> Tensor<3> {
        let code = match condition.filter(|_| self.code_conditioned) {
            Some(condition) => Tensor::cat(vec![z, condition.clone()], 1),
            None => z,
        };
        let condition = condition.filter(|_| self.blocks_conditioned);
        let levels = self.blocks.len();
        let coarse = graph.vertices()[levels];

        let linear = self.linear_path.as_ref().map(|path| code.clone().matmul(path.val()));
        let x = leaky_relu(self.input.forward(code), LEAKY_SLOPE);
        let [batch, flat] = x.dims();
        let mut x = x.reshape([batch, coarse, flat / coarse]);
        let mut origin = None;
        if let Some(expand) = &self.expand {
            origin = Some(FactoredFeatures { features: x.clone(), weight: expand.weight.val() });
            x = expand.forward(x, None, graph.graph(levels));
        }
        for (i, block) in self.blocks.iter().enumerate() {
            x = block.forward(x, origin.take(), condition, graph, levels - 1 - i);
            tap(i, &x);
        }
        let x = self.output.forward(x, condition, graph.graph(0));
        let x = x + self.output_bias.val().unsqueeze();
        match linear {
            Some(linear) => {
                let shape = x.dims();
                x + linear.reshape(shape)
            }
            None => x,
        }
    }
}
