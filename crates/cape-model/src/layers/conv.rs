use burn::{
    module::{Module, Param},
    tensor::Tensor,
};
use cape_graph::{ConvEnd, ConvGraph, cheb_conv};

use crate::{Init, config::LEAKY_SLOPE};

/// Chebyshev graph convolution without bias: `[T_0(L̃)x, …, T_{K−1}(L̃)x] · W`.
#[derive(Module, Debug)]
pub struct ChebConv {
    /// `[channels · order, out]`, row `channel · order + k`.
    pub weight: Param<Tensor<2>>,
    pub(super) order: usize,
}

impl ChebConv {
    /// Truncated-normal weights for `order` Chebyshev terms.
    pub fn new(input: usize, output: usize, order: usize, init: &mut Init) -> Self {
        Self { weight: init.truncated_normal([input * order, output]), order }
    }

    /// `x: [batch, vertices, channels]` and, after its channels, those of
    /// `condition: [batch, embedding]` at every vertex → `[batch, kept, out]`.
    pub fn forward(
        &self,
        x: Tensor<3>,
        condition: Option<&Tensor<2>>,
        graph: &ConvGraph,
    ) -> Tensor<3> {
        let [_, _, channels] = x.dims();
        let (weight, rows) = self.split(channels, condition);
        cheb_conv(x, weight, graph, self.order, ConvEnd { rows, slope: None })
    }

    /// The weights of the first `channels` channels, and what the condition's add: a row for every
    /// Chebyshev term, `[batch, order, out]`, instead of channels that repeat at every vertex.
    pub(super) fn split(
        &self,
        channels: usize,
        condition: Option<&Tensor<2>>,
    ) -> (Tensor<2>, Option<Tensor<3>>) {
        let weight = self.weight.val();
        let Some(condition) = condition else { return (weight, None) };
        let [batch, size] = condition.dims();
        let [rows, out] = weight.dims();
        let features = weight.clone().slice([0..channels * self.order, 0..out]);
        let weight = weight.slice([channels * self.order..rows, 0..out]);
        let product = condition.clone().matmul(weight.reshape([size, self.order * out]));
        (features, Some(product.reshape([batch, self.order, out])))
    }
}

/// Convolution, one bias a channel, leaky ReLU.
#[derive(Module, Debug)]
pub struct ConvLayer {
    /// The convolution.
    pub conv: ChebConv,
    /// `[out]`.
    pub bias: Param<Tensor<1>>,
}

impl ConvLayer {
    /// Truncated-normal weights, biases 0.1.
    pub fn new(input: usize, output: usize, order: usize, init: &mut Init) -> Self {
        Self { conv: ChebConv::new(input, output, order, init), bias: init.constant(0.1, [output]) }
    }

    /// As [`ChebConv::forward`].
    pub fn forward(
        &self,
        x: Tensor<3>,
        condition: Option<&Tensor<2>>,
        graph: &ConvGraph,
    ) -> Tensor<3> {
        let [batch, _, channels] = x.dims();
        let (weight, rows) = self.conv.split(channels, condition);
        let [_, out] = weight.dims();
        let bias = self.bias.val().reshape([1, 1, out]).expand([batch, 1, out]);
        let rows = match rows {
            None => bias,
            Some(rows) => {
                // The bias is the same at every vertex, as the first term's row is.
                let order = self.conv.order;
                let first = rows.clone().slice([0..batch, 0..1, 0..out]) + bias;
                if order > 1 {
                    Tensor::cat(vec![first, rows.slice([0..batch, 1..order, 0..out])], 1)
                } else {
                    first
                }
            }
        };
        let end = ConvEnd { rows: Some(rows), slope: Some(LEAKY_SLOPE) };
        cheb_conv(x, weight, graph, self.conv.order, end)
    }
}
