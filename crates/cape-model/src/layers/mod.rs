//! The layers the networks are made of. All take and return `[batch, vertices, channels]`.

mod affine;
mod conv;
mod encoder_residual;
mod linear;
mod residual;

pub use affine::AffineBlock;
pub use conv::{ChebConv, ConvLayer};
pub use encoder_residual::EncoderResidual;
pub use linear::Linear;
pub use residual::{GroupNormRelu, ResidualBlock};

use burn::tensor::Tensor;

/// Appends `condition: [batch, c]` at every vertex of `x: [batch, vertices, channels]`.
pub(crate) fn append(x: Tensor<3>, condition: Option<&Tensor<2>>) -> Tensor<3> {
    let Some(condition) = condition else { return x };
    let [batch, vertices, _] = x.dims();
    let [_, size] = condition.dims();
    let tiled = condition.clone().reshape([batch, 1, size]).expand([batch, vertices, size]);
    Tensor::cat(vec![x, tiled], 2)
}
