//! The operations a backend must supply, and how they are composed where it has no kernel.

// Burn deprecates its ndarray backend in favour of flex.
#![cfg_attr(feature = "ndarray", allow(deprecated))]

use std::sync::Arc;

use burn::backend::{
    Backend, backend_extension,
    tensor::{FloatTensor, IntTensor},
};

use crate::{
    composed::{self, Graph, NormInputs},
    operator::Operator,
    sparse::SparsePair,
};

/// What a convolution does besides the products.
///
/// See [`GraphBackend`] for an example.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConvSpec {
    /// Chebyshev terms `K`.
    pub order: usize,
    /// Rows added for each example.
    pub rows: usize,
    /// Slope of the leaky ReLU at its end, if any.
    pub slope: Option<f64>,
}

/// What a convolution does after the products.
///
/// See [`GraphBackend`] for an example.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EndSpec {
    /// Whether a last term is added.
    pub term: bool,
    /// Whether rows are added.
    pub rows: bool,
    /// Slope of the leaky ReLU, if any.
    pub slope: Option<f64>,
}

/// A convolution after group normalisation and ReLU.
///
/// See [`GraphBackend`] for an example.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormConvSpec {
    /// Chebyshev terms `K`.
    pub order: usize,
    /// Groups of channels that are normalised together.
    pub groups: usize,
    /// Added to the variance.
    pub epsilon: f64,
    /// Channels that are the same at every vertex; only with an order of 1.
    pub constant: usize,
    /// Whether something is added.
    pub add: bool,
}

/// Graph operations on primitives of a backend. Use the functions of this crate instead: they
/// check shapes and take tensors.
///
/// A backend of one's own needs sparse products; from these the other operations are composed:
///
/// ```
/// use std::sync::Arc;
///
/// use burn::backend::{Backend, tensor::{FloatTensor, IntTensor}};
/// use cape_graph::{ConvSpec, GraphBackend, Operator};
///
/// /// A layer of an inference engine that has the graph at hand.
/// fn layer<B: GraphBackend>(
///     x: FloatTensor<B>,
///     weight: FloatTensor<B>,
///     (index, value): (IntTensor<B>, FloatTensor<B>),
///     operator: Arc<Operator>,
/// ) -> FloatTensor<B> {
///     let spec = ConvSpec { order: 2, rows: 0, slope: None };
///     let unused = x.clone();
///     B::cheb_conv(x, weight, unused, index, value, operator, spec)
/// }
///
/// # #[cfg(feature = "flex")]
/// let _ = layer::<burn::backend::Flex>;
/// ```
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

    /// `alpha · A x[b] + beta · base[b]` (or `Aᵀ x[b]`), `x: [batch, vertices, channels]`, `base` as
    /// the product: a step of the Chebyshev recurrence, or a term of its gradient.
    #[allow(clippy::too_many_arguments)]
    fn sparse_accumulate(
        x: FloatTensor<Self>,
        base: FloatTensor<Self>,
        index: IntTensor<Self>,
        value: FloatTensor<Self>,
        matrix: Arc<SparsePair>,
        transpose: bool,
        alpha: f64,
        beta: f64,
    ) -> FloatTensor<Self> {
        let product = Self::sparse_matmul(x, index, value, matrix, transpose);
        composed::accumulate::<Self>(product, base, alpha, beta)
    }

    /// `f(sum + term + rows)`, the end of a convolution: `sum`, `term` and the output are
    /// `[batch, vertices, channels]`, `rows` as well but for a 1 where it is the same for all
    /// examples or vertices; `f` is the leaky ReLU of the specification. `term` and `rows` are
    /// unused where that has none.
    fn conv_end(
        sum: FloatTensor<Self>,
        term: FloatTensor<Self>,
        rows: FloatTensor<Self>,
        spec: EndSpec,
    ) -> FloatTensor<Self> {
        composed::conv_end::<Self>(sum, term, rows, spec)
    }

    /// The gradient before a leaky ReLU from its output `y`, `[batch, vertices, channels]`, and that
    /// gradient's sums over the vertices, `[batch, 1, channels]`.
    fn conv_end_backward(
        y: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        slope: f64,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        composed::conv_end_backward::<Self>(y, grad, slope)
    }

    /// `y = f(Σ_k D T_k(L̃) x W_k + Σ_r D T_r(L̃)1 · rows[r])`, `weight: [channels · order, out]`
    /// with rows `channel · order + k`, `rows: [batch, r, out]`; unused where the specification has
    /// none. `D` is the selection of the operator, `f` the leaky ReLU of the specification.
    #[allow(clippy::too_many_arguments)] // tensors cannot be grouped across the dispatch
    fn cheb_conv(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        rows: FloatTensor<Self>,
        index: IntTensor<Self>,
        value: FloatTensor<Self>,
        operator: Arc<Operator>,
        spec: ConvSpec,
    ) -> FloatTensor<Self> {
        let graph = Graph { index, value, operator };
        composed::cheb_conv::<Self>(x, weight, rows, &graph, spec)
    }

    /// Gradients of [`cheb_conv`](Self::cheb_conv) with respect to `x`, `weight` and `rows`, from
    /// its output `y` if it has an activation. The first is unspecified unless `want_x`, the
    /// second unless `want_weight`, the last where there are no rows.
    #[allow(clippy::too_many_arguments)]
    fn cheb_conv_backward(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        y: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        index: IntTensor<Self>,
        value: FloatTensor<Self>,
        operator: Arc<Operator>,
        spec: ConvSpec,
        want_x: bool,
        want_weight: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        let graph = Graph { index, value, operator };
        composed::cheb_conv_backward::<Self>(x, weight, y, grad, &graph, spec, want_x, want_weight)
    }

    /// `y = base + cheb_conv(relu(group_norm([x, constant])))`; `constant: [batch, c]` are channels
    /// that are the same at every vertex, `gamma` and `beta` of all channels, and so the weights'
    /// rows. `base` and `constant` are unused where the specification has none.
    #[allow(clippy::too_many_arguments)]
    fn norm_conv(
        x: FloatTensor<Self>,
        constant: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        base: FloatTensor<Self>,
        index: IntTensor<Self>,
        value: FloatTensor<Self>,
        operator: Arc<Operator>,
        spec: NormConvSpec,
    ) -> FloatTensor<Self> {
        let graph = Graph { index, value, operator };
        let inputs = NormInputs { x, constant, gamma, beta, weight };
        composed::norm_conv::<Self>(inputs, base, &graph, spec)
    }

    /// Gradients of [`norm_conv`](Self::norm_conv) with respect to `x`, `constant`, `gamma`, `beta`
    /// and `weight`; the second is unspecified where there are no constant channels.
    #[allow(clippy::too_many_arguments, clippy::type_complexity)]
    fn norm_conv_backward(
        x: FloatTensor<Self>,
        constant: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        index: IntTensor<Self>,
        value: FloatTensor<Self>,
        operator: Arc<Operator>,
        spec: NormConvSpec,
    ) -> (
        FloatTensor<Self>,
        FloatTensor<Self>,
        FloatTensor<Self>,
        FloatTensor<Self>,
        FloatTensor<Self>,
    ) {
        let graph = Graph { index, value, operator };
        let inputs = NormInputs { x, constant, gamma, beta, weight };
        composed::norm_conv_backward::<Self>(inputs, grad, &graph, spec)
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
