use burn::{module::Module, tensor::Tensor};
use cape_graph::DevicePyramid;

use crate::{
    DiscriminatorConfig, Initialiser,
    layers::{ChebConv, ConvLayer},
};

/// Patchwise discriminator (CAPE §4.1): one real-or-fake logit per patch of the mesh.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::{DevicePyramid, sparse_from_triplets};
/// use cape_model::{Discriminator, DiscriminatorConfig, Initialiser};
///
/// let triangle = sparse_from_triplets(
///     "L", (3, 3), &[0, 0, 1, 1, 2, 2], &[1, 2, 0, 2, 0, 1], &[-0.5; 6])?;
/// let device = Device::default();
/// let graph = DevicePyramid::new(&vec![triangle; 2], &[None], &[None], &device);
/// let config = DiscriminatorConfig { filters: vec![4], factors: vec![1], ..Default::default() };
/// let discriminator = Discriminator::new(&config, 8, &mut Initialiser::new(1, 0.1, &device));
/// let condition = Tensor::zeros([2, 8], &device);
/// let logits = discriminator.forward(Tensor::ones([2, 3, 3], &device), Some(&condition), &graph);
/// assert_eq!(logits.dims(), [2, 3, 1]);
/// # Ok::<(), cape_graph::Error>(())
/// ```
#[derive(Module, Debug)]
pub struct Discriminator {
    /// Layers, one per transition of the discriminator's pyramid, finest first.
    pub layers: Vec<ConvLayer>,
    /// Convolution to one logit.
    pub output: ChebConv,
}

impl Discriminator {
    /// Creates a discriminator for embedded conditions of `condition` numbers.
    pub fn new(config: &DiscriminatorConfig, condition: usize, init: &mut Initialiser) -> Self {
        let mut input = 3 + condition;
        let mut layers = Vec::new();
        for &filters in &config.filters {
            let layer = ConvLayer::new(input, filters, config.order, init);
            layers.push(layer.with_spectral_norm(config.spectral_norm));
            input = filters;
        }
        let output = ChebConv::new(input, 1, config.output_order, init);
        Self { layers, output: output.with_spectral_norm(config.spectral_norm) }
    }

    /// Logits `[batch, patches, 1]` of normalised displacements `x: [batch, vertices, 3]` with
    /// `condition: [batch, embedding]`.
    pub fn forward(
        &self,
        x: Tensor<3>,
        condition: Option<&Tensor<2>>,
        graph: &DevicePyramid,
    ) -> Tensor<3> {
        self.forward_with(x, condition, graph, &mut |_, _| {})
    }

    /// As [`forward`](Self::forward); `tap` receives every layer's index and output after pooling.
    pub fn forward_with(
        &self,
        x: Tensor<3>,
        condition: Option<&Tensor<2>>,
        graph: &DevicePyramid,
        tap: &mut dyn FnMut(usize, &Tensor<3>),
    ) -> Tensor<3> {
        let (mut x, mut condition) = (x, condition);
        for (level, layer) in self.layers.iter().enumerate() {
            x = layer.forward(x, condition.take(), graph.pooled(level));
            tap(level, &x);
        }
        self.output.forward(x, None, graph.graph(self.layers.len()))
    }
}
