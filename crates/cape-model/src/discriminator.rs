use burn::{module::Module, tensor::Tensor};
use cape_graph::DevicePyramid;

use crate::{
    DiscriminatorConfig, Init,
    layers::{ChebConv, ConvLayer},
};

/// The patchwise discriminator (CAPE §4.1): one real-or-fake logit for each patch of the mesh.
#[derive(Module, Debug)]
pub struct Discriminator {
    /// One for each transition of its pyramid.
    pub layers: Vec<ConvLayer>,
    /// To one logit.
    pub output: ChebConv,
}

impl Discriminator {
    /// For conditions of `condition` numbers.
    pub fn new(config: &DiscriminatorConfig, condition: usize, init: &mut Init) -> Self {
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

    /// Normalised displacements `[batch, vertices, 3]`, `condition: [batch, embedding]` → logits
    /// `[batch, patches, 1]`.
    pub fn forward(
        &self,
        x: Tensor<3>,
        condition: Option<&Tensor<2>>,
        graph: &DevicePyramid,
    ) -> Tensor<3> {
        self.forward_with(x, condition, graph, &mut |_, _| {})
    }

    /// As [`forward`](Self::forward), showing every layer's output after pooling to `tap`.
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
