//! The operations a backend must supply, and how they are composed where it has no kernel.

// Burn deprecates its ndarray backend in favour of flex.
#![cfg_attr(feature = "ndarray", allow(deprecated))]

use std::sync::Arc;

use burn::backend::{
    Backend, TensorMetadata, backend_extension,
    tensor::{FloatTensor, IntTensor},
};
use burn::tensor::Shape;

use crate::sparse::SparsePair;

/// Graph operations on primitives of a backend. Use the functions of this crate instead: they
/// check shapes and take tensors.
#[backend_extension(
    Flex: cfg(feature = "flex"),
    NdArray: cfg(feature = "ndarray"),
    Cube: cfg(any(feature = "wgpu", feature = "cuda")),
    Autodiff
)]
pub trait GraphBackend: Backend {
    /// `y[b] = A x[b]` (or `Aᵀ x[b]`), `x: [batch, vertices, channels]`.
    fn sparse_matmul(
        x: FloatTensor<Self>,
        index: IntTensor<Self>,
        value: FloatTensor<Self>,
        matrix: Arc<SparsePair>,
        transpose: bool,
    ) -> FloatTensor<Self>;

    /// `y = Σ_k T_k(L̃) x W_k`, `weight: [channels · order, out]` with rows `channel · order + k`.
    fn cheb_conv(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        index: IntTensor<Self>,
        value: FloatTensor<Self>,
        matrix: Arc<SparsePair>,
        order: usize,
    ) -> FloatTensor<Self> {
        composed::cheb_conv::<Self>(x, weight, index, value, matrix, order)
    }

    /// Gradients of [`cheb_conv`](Self::cheb_conv) with respect to `x` and `weight`; the first is
    /// unspecified unless `want_x`.
    #[allow(clippy::too_many_arguments)] // tensors cannot be grouped across the dispatch
    fn cheb_conv_backward(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        index: IntTensor<Self>,
        value: FloatTensor<Self>,
        matrix: Arc<SparsePair>,
        order: usize,
        want_x: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        composed::cheb_conv_backward::<Self>(x, weight, grad, index, value, matrix, order, want_x)
    }

    /// `leaky_relu(x + bias)`, `x: [batch, vertices, channels]`, `bias: [channels]`, `slope > 0`.
    fn bias_leaky_relu(
        x: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        slope: f64,
    ) -> FloatTensor<Self> {
        composed::bias_leaky_relu::<Self>(x, bias, slope)
    }

    /// Gradients of [`bias_leaky_relu`](Self::bias_leaky_relu) with respect to `x` and `bias`,
    /// from its output `y`.
    fn bias_leaky_relu_backward(
        y: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        slope: f64,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        composed::bias_leaky_relu_backward::<Self>(y, grad, slope)
    }

    /// `relu(group_norm(x) · gamma + beta)`, `x: [batch, vertices, channels]`.
    fn group_norm_relu(
        x: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        groups: usize,
        epsilon: f64,
    ) -> FloatTensor<Self> {
        composed::group_norm_relu::<Self>(x, gamma, beta, groups, epsilon)
    }

    /// Gradients of [`group_norm_relu`](Self::group_norm_relu) with respect to `x`, `gamma` and
    /// `beta`.
    fn group_norm_relu_backward(
        x: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        groups: usize,
        epsilon: f64,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        composed::group_norm_relu_backward::<Self>(x, gamma, beta, grad, groups, epsilon)
    }
}

/// The operations in terms of Burn's own, for backends without a fused kernel.
pub(crate) mod composed {
    use super::{
        Arc, Backend, FloatTensor, GraphBackend, IntTensor, Shape, SparsePair, TensorMetadata,
    };
    use burn::{backend::get_or_init_device_settings, tensor::DType};

    fn dims<B: Backend>(x: &FloatTensor<B>) -> [usize; 3] {
        let shape = x.shape();
        [shape[0], shape[1], shape[2]]
    }

    /// `[T_0(L̃)x, …, T_{K−1}(L̃)x]`.
    fn basis<B: GraphBackend>(
        x: FloatTensor<B>,
        index: &IntTensor<B>,
        value: &FloatTensor<B>,
        matrix: &Arc<SparsePair>,
        order: usize,
    ) -> Vec<FloatTensor<B>> {
        let multiply = |x: FloatTensor<B>| {
            B::sparse_matmul(x, index.clone(), value.clone(), matrix.clone(), false)
        };
        let mut terms = vec![x];
        for k in 1..order {
            let last = multiply(terms[k - 1].clone());
            let next = if k == 1 {
                last
            } else {
                let twice = B::float_mul_scalar(last, 2.0.into());
                B::float_sub(twice, terms[k - 2].clone())
            };
            terms.push(next);
        }
        terms
    }

    /// The weights of each term, `[channels, out]`.
    fn term_weights<B: Backend>(weight: FloatTensor<B>, order: usize) -> Vec<FloatTensor<B>> {
        let (rows, out) = (weight.shape()[0], weight.shape()[1]);
        let channels = rows / order;
        let weight = B::float_reshape(weight, Shape::from(vec![channels, order, out]));
        (0..order)
            .map(|k| {
                let term = B::float_slice(
                    weight.clone(),
                    &[(0..channels).into(), (k..k + 1).into(), (0..out).into()],
                );
                B::float_reshape(term, Shape::from(vec![channels, out]))
            })
            .collect()
    }

    fn flat<B: Backend>(x: FloatTensor<B>) -> FloatTensor<B> {
        let [batch, vertices, channels] = dims::<B>(&x);
        B::float_reshape(x, Shape::from(vec![batch * vertices, channels]))
    }

    pub(crate) fn cheb_conv<B: GraphBackend>(
        x: FloatTensor<B>,
        weight: FloatTensor<B>,
        index: IntTensor<B>,
        value: FloatTensor<B>,
        matrix: Arc<SparsePair>,
        order: usize,
    ) -> FloatTensor<B> {
        let [batch, vertices, _] = dims::<B>(&x);
        let out = weight.shape()[1];
        let mut sum: Option<FloatTensor<B>> = None;
        let terms = basis::<B>(x, &index, &value, &matrix, order);
        for (term, weight) in terms.into_iter().zip(term_weights::<B>(weight, order)) {
            let product = B::float_matmul(flat::<B>(term), weight);
            sum = Some(match sum {
                Some(sum) => B::float_add(sum, product),
                None => product,
            });
        }
        let sum = sum.unwrap_or_else(|| unreachable!("order is at least 1"));
        B::float_reshape(sum, Shape::from(vec![batch, vertices, out]))
    }

    #[allow(clippy::too_many_arguments)]
    pub(crate) fn cheb_conv_backward<B: GraphBackend>(
        x: FloatTensor<B>,
        weight: FloatTensor<B>,
        grad: FloatTensor<B>,
        index: IntTensor<B>,
        value: FloatTensor<B>,
        matrix: Arc<SparsePair>,
        order: usize,
        want_x: bool,
    ) -> (FloatTensor<B>, FloatTensor<B>) {
        let shape = x.shape();
        let channels = shape[2];
        let out = weight.shape()[1];
        let grad = flat::<B>(grad);

        let grad_weights: Vec<FloatTensor<B>> =
            basis::<B>(x.clone(), &index, &value, &matrix, order)
                .into_iter()
                .map(|term| {
                    let term = B::float_transpose(flat::<B>(term));
                    let product = B::float_matmul(term, grad.clone());
                    B::float_reshape(product, Shape::from(vec![channels, 1, out]))
                })
                .collect();
        let grad_weight = B::float_reshape(
            B::float_cat(grad_weights, 1),
            Shape::from(vec![channels * order, out]),
        );
        if !want_x {
            return (x, grad_weight);
        }

        let multiply = |x: FloatTensor<B>| {
            B::sparse_matmul(x, index.clone(), value.clone(), matrix.clone(), true)
        };
        let mut terms: Vec<FloatTensor<B>> = term_weights::<B>(weight, order)
            .into_iter()
            .map(|weight| {
                let product = B::float_matmul(grad.clone(), B::float_transpose(weight));
                B::float_reshape(product, shape.clone())
            })
            .collect();
        for k in (2..order).rev() {
            let twice = B::float_mul_scalar(multiply(terms[k].clone()), 2.0.into());
            terms[k - 1] = B::float_add(terms[k - 1].clone(), twice);
            terms[k - 2] = B::float_sub(terms[k - 2].clone(), terms[k].clone());
        }
        let grad_x = if order > 1 {
            B::float_add(terms[0].clone(), multiply(terms[1].clone()))
        } else {
            terms.swap_remove(0)
        };
        (grad_x, grad_weight)
    }

    fn row<B: Backend>(x: FloatTensor<B>) -> FloatTensor<B> {
        let channels = x.shape()[0];
        B::float_reshape(x, Shape::from(vec![1, 1, channels]))
    }

    /// Sum over all but the channels.
    fn channel_sum<B: Backend>(x: FloatTensor<B>) -> FloatTensor<B> {
        let channels = x.shape()[2];
        let sum = B::float_sum_dim(B::float_sum_dim(x, 1), 0);
        B::float_reshape(sum, Shape::from(vec![channels]))
    }

    /// `x` where `sign` is positive, `slope · x` elsewhere.
    fn gate<B: Backend>(x: FloatTensor<B>, sign: FloatTensor<B>, slope: f64) -> FloatTensor<B> {
        let bool_dtype = get_or_init_device_settings::<B>(&sign.device()).bool_dtype;
        let off = B::float_lower_equal_elem(sign, 0.0.into(), bool_dtype);
        let scaled = B::float_mul_scalar(x.clone(), slope.into());
        B::float_mask_where(x, off, scaled)
    }

    pub(crate) fn bias_leaky_relu<B: Backend>(
        x: FloatTensor<B>,
        bias: FloatTensor<B>,
        slope: f64,
    ) -> FloatTensor<B> {
        let sum = B::float_add(x, row::<B>(bias));
        gate::<B>(sum.clone(), sum, slope)
    }

    pub(crate) fn bias_leaky_relu_backward<B: Backend>(
        y: FloatTensor<B>,
        grad: FloatTensor<B>,
        slope: f64,
    ) -> (FloatTensor<B>, FloatTensor<B>) {
        let grad = gate::<B>(grad, y, slope);
        (grad.clone(), channel_sum::<B>(grad))
    }

    /// Mean over (vertices × channels in group), spread back: `[batch, 1, channels]`.
    fn group_mean<B: Backend>(x: FloatTensor<B>, groups: usize) -> FloatTensor<B> {
        let [batch, _, channels] = dims::<B>(&x);
        let width = channels / groups;
        let mean = B::float_mean_dim(x, 1);
        let mean = B::float_reshape(mean, Shape::from(vec![batch, groups, width]));
        let mean =
            B::float_expand(B::float_mean_dim(mean, 2), Shape::from(vec![batch, groups, width]));
        B::float_reshape(mean, Shape::from(vec![batch, 1, channels]))
    }

    /// The normalised input and the inverse standard deviations `[batch, 1, channels]`.
    fn normalise<B: Backend>(
        x: FloatTensor<B>,
        groups: usize,
        epsilon: f64,
    ) -> (FloatTensor<B>, FloatTensor<B>) {
        debug_assert_eq!(x.dtype(), DType::F32);
        let centred = B::float_sub(x.clone(), group_mean::<B>(x, groups));
        let variance = group_mean::<B>(B::float_mul(centred.clone(), centred.clone()), groups);
        let deviation = B::float_sqrt(B::float_add_scalar(variance, epsilon.into()));
        let inverse = B::float_recip(deviation);
        (B::float_mul(centred, inverse.clone()), inverse)
    }

    pub(crate) fn group_norm_relu<B: Backend>(
        x: FloatTensor<B>,
        gamma: FloatTensor<B>,
        beta: FloatTensor<B>,
        groups: usize,
        epsilon: f64,
    ) -> FloatTensor<B> {
        let (unit, _) = normalise::<B>(x, groups, epsilon);
        let affine = B::float_add(B::float_mul(unit, row::<B>(gamma)), row::<B>(beta));
        B::float_clamp_min(affine, 0.0.into())
    }

    pub(crate) fn group_norm_relu_backward<B: Backend>(
        x: FloatTensor<B>,
        gamma: FloatTensor<B>,
        beta: FloatTensor<B>,
        grad: FloatTensor<B>,
        groups: usize,
        epsilon: f64,
    ) -> (FloatTensor<B>, FloatTensor<B>, FloatTensor<B>) {
        let (unit, inverse) = normalise::<B>(x, groups, epsilon);
        let gamma = row::<B>(gamma);
        let affine = B::float_add(B::float_mul(unit.clone(), gamma.clone()), row::<B>(beta));
        let grad = gate::<B>(grad, affine, 0.0);
        let grad_gamma = channel_sum::<B>(B::float_mul(grad.clone(), unit.clone()));
        let grad_beta = channel_sum::<B>(grad.clone());
        let upstream = B::float_mul(grad, gamma);
        let first = group_mean::<B>(upstream.clone(), groups);
        let second = group_mean::<B>(B::float_mul(upstream.clone(), unit.clone()), groups);
        let grad_x = B::float_sub(B::float_sub(upstream, first), B::float_mul(unit, second));
        (B::float_mul(grad_x, inverse), grad_gamma, grad_beta)
    }
}
