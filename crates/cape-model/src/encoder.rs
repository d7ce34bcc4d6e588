use burn::{module::Module, tensor::Tensor};
use cape_graph::DevicePyramid;

use crate::{
    CapeConfig, Initialiser,
    layers::{ChebConv, ConvLayer, EncoderResidual, Linear, append},
};

/// One layer of the encoder.
#[derive(Module, Debug)]
#[allow(clippy::large_enum_variant)] // a model holds a handful of them
pub enum EncoderBlock {
    /// Convolution, bias and leaky ReLU.
    Conv(ConvLayer),
    /// Residual block of two convolutions.
    Residual(EncoderResidual),
}

impl EncoderBlock {
    /// Convolution on `level`, then down-sampling to `level + 1`.
    fn forward(
        &self,
        x: Tensor<3>,
        condition: Option<&Tensor<2>>,
        graph: &DevicePyramid,
        level: usize,
    ) -> Tensor<3> {
        match self {
            Self::Conv(layer) => layer.forward(x, condition, graph.pooled(level)),
            Self::Residual(block) => {
                graph.down(block.forward(append(x, condition), graph.graph(level)), level)
            }
        }
    }
}

/// Posterior `q(z|x)` of the latent code: mean and log-variance, each `[batch, latent]`.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_model::{Posterior, losses::kl};
///
/// let device = Device::default();
/// let posterior = Posterior {
///     mean: Tensor::from_floats([[3.0, 4.0]], &device),
///     log_variance: Tensor::zeros([1, 2], &device),
/// };
/// let noise = Tensor::from_floats([[1.0, -1.0]], &device);
/// let z: Vec<f32> = posterior.sample(noise).into_data().try_into_vec().unwrap();
/// assert_eq!(z, [4.0, 3.0]);
/// // With unit variances the divergence from the prior is half the squared mean.
/// let divergence: f32 = kl(&posterior).into_scalar();
/// assert!((divergence - 12.5).abs() < 1e-5);
/// ```
#[derive(Debug, Clone)]
pub struct Posterior {
    /// Mean `μ`, `[batch, latent]`.
    pub mean: Tensor<2>,
    /// Log-variance `log σ²`, `[batch, latent]`.
    pub log_variance: Tensor<2>,
}

impl Posterior {
    /// Samples `z = μ + exp(½ log σ²) ε`, where `epsilon: [batch, latent]` is standard normal.
    pub fn sample(&self, epsilon: Tensor<2>) -> Tensor<2> {
        self.mean.clone() + (self.log_variance.clone() * 0.5).exp() * epsilon
    }
}

/// Encoder: displacements to the posterior of the latent code (CAPE §4.1).
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::{DevicePyramid, sparse_from_triplets};
/// use cape_model::{CapeConfig, Encoder, EncoderBlock, Initialiser};
///
/// let triangle = sparse_from_triplets(
///     "L", (3, 3), &[0, 0, 1, 1, 2, 2], &[1, 2, 0, 2, 0, 1], &[-0.5; 6])?;
/// let device = Device::default();
/// let graph = DevicePyramid::new(&vec![triangle; 3], &[None, None], &[None, None], &device);
/// let config = CapeConfig { filters: vec![4, 8], factors: vec![1, 1], ..CapeConfig::tiny() };
/// let encoder = Encoder::new(&config, 3, &mut Initialiser::new(1, 0.1, &device));
/// assert!(matches!(encoder.blocks[..], [EncoderBlock::Conv(_), EncoderBlock::Conv(_)]));
/// let posterior = encoder.forward(Tensor::ones([2, 3, 3], &device), None, &graph);
/// assert_eq!(posterior.mean.dims(), [2, 6]);
/// assert_eq!(posterior.log_variance.dims(), [2, 6]);
/// # Ok::<(), cape_graph::Error>(())
/// ```
#[derive(Module, Debug)]
pub struct Encoder {
    /// Layers, one per transition of the pyramid, finest first.
    pub blocks: Vec<EncoderBlock>,
    /// 1×1 convolution before the fully connected heads.
    pub reduce: Option<ChebConv>,
    /// Fully connected head of the mean.
    pub mean: Linear,
    /// Fully connected head of the log-variance.
    pub log_variance: Linear,
    conditioned: bool,
}

impl Encoder {
    /// Creates an encoder for meshes whose coarsest level has `coarse` vertices.
    pub fn new(config: &CapeConfig, coarse: usize, init: &mut Initialiser) -> Self {
        let extra = if config.encoder_conditions { config.condition_size() } else { 0 };
        let mut input = 3 + extra;
        let mut blocks = Vec::new();
        for &filters in &config.filters {
            blocks.push(if config.encoder_residual {
                EncoderBlock::Residual(EncoderResidual::new(input, filters, config.order, init))
            } else {
                EncoderBlock::Conv(ConvLayer::new(input, filters, config.order, init))
            });
            input = filters;
        }
        let reduce = (config.reduce > 0).then(|| ChebConv::new(input, config.reduce, 1, init));
        let flat = coarse * if config.reduce > 0 { config.reduce } else { input };
        Self {
            blocks,
            reduce,
            mean: init.linear(flat, config.latent),
            log_variance: init.linear(flat, config.latent),
            conditioned: config.encoder_conditions,
        }
    }

    /// Encodes normalised displacements `x: [batch, vertices, 3]`; `condition: [batch, embedding]`
    /// counts if [`CapeConfig::encoder_conditions`] is set.
    pub fn forward(
        &self,
        x: Tensor<3>,
        condition: Option<&Tensor<2>>,
        graph: &DevicePyramid,
    ) -> Posterior {
        self.forward_with(x, condition, graph, &mut |_, _| {})
    }

    /// As [`forward`](Self::forward); `tap` receives every layer's index and output after pooling.
    pub fn forward_with(
        &self,
        x: Tensor<3>,
        condition: Option<&Tensor<2>>,
        graph: &DevicePyramid,
        tap: &mut dyn FnMut(usize, &Tensor<3>),
    ) -> Posterior {
        let (mut x, mut condition) = (x, condition.filter(|_| self.conditioned));
        for (level, block) in self.blocks.iter().enumerate() {
            x = block.forward(x, condition.take(), graph, level);
            tap(level, &x);
        }
        if let Some(reduce) = &self.reduce {
            x = reduce.forward(x, None, graph.graph(self.blocks.len()));
        }
        let flat: Tensor<2> = x.flatten(1, 2);
        Posterior {
            mean: self.mean.forward(flat.clone()),
            log_variance: self.log_variance.forward(flat),
        }
    }
}
