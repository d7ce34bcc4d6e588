//! Layers of the networks. All take and return `[batch, vertices, channels]`.

mod affine;
mod conv;
mod encoder_residual;
mod residual;

pub use affine::AffineBlock;
pub use conv::{ChebConv, ConvLayer};
pub use encoder_residual::EncoderResidual;
pub use residual::{FactoredFeatures, GroupNormRelu, ResidualBlock};

pub use burn::nn::Linear;
use burn::tensor::Tensor;
use cape_graph::DevicePyramid;

/// Appends `condition: [batch, c]` to the channels of every vertex of `x: [batch, vertices,
/// channels]`.
pub(crate) fn append(x: Tensor<3>, condition: Option<&Tensor<2>>) -> Tensor<3> {
    let Some(condition) = condition else { return x };
    let [batch, vertices, _] = x.dims();
    let [_, size] = condition.dims();
    let tiled = condition.clone().reshape([batch, 1, size]).expand([batch, vertices, size]);
    Tensor::cat(vec![x, tiled], 2)
}

/// Appends the condition to `x` if up-sampling from `level + 1` to `level` would change a constant;
/// otherwise returns it unchanged, to be added after up-sampling as one vector per example.
pub(crate) fn append_unless_preserved<'c>(
    x: Tensor<3>,
    condition: Option<&'c Tensor<2>>,
    pyramid: &DevicePyramid,
    level: usize,
) -> (Tensor<3>, Option<&'c Tensor<2>>) {
    if pyramid.up_preserves_constants(level) {
        (x, condition)
    } else {
        (append(x, condition), None)
    }
}
