//! Operations that a backend supplies, and their inputs and outputs.
//!
//! Every operation but the sparse product has a default of Burn's own operations, for backends
//! without a fused kernel.

// Burn deprecates its ndarray backend in favour of flex.
#![cfg_attr(feature = "ndarray", allow(deprecated))]

use std::sync::Arc;

use burn::backend::{
    Backend, ExtensionType, backend_extension,
    tensor::{FloatTensor, IntTensor},
};

use crate::{
    Precision, composed,
    conv_graph::HostGraph,
    sparse::CsrWithTranspose,
    steps::{self, AdamState, AdamStep, MomentumStep},
};

/// Optional tensor of an operation: Burn's dispatch takes no [`Option`].
#[derive(Debug, Clone, ExtensionType)]
pub enum OptionalTensor<B: Backend> {
    /// A tensor.
    Some(FloatTensor<B>),
    /// No tensor.
    None,
}

impl<B: Backend> OptionalTensor<B> {
    /// The tensor as an [`Option`].
    pub fn into_option(self) -> Option<FloatTensor<B>> {
        match self {
            Self::Some(tensor) => Some(tensor),
            Self::None => None,
        }
    }

    /// Reference to the tensor.
    pub fn as_ref(&self) -> Option<&FloatTensor<B>> {
        match self {
            Self::Some(tensor) => Some(tensor),
            Self::None => None,
        }
    }
}

impl<B: Backend> From<Option<FloatTensor<B>>> for OptionalTensor<B> {
    fn from(tensor: Option<FloatTensor<B>>) -> Self {
        tensor.map_or(Self::None, Self::Some)
    }
}

/// Sparse matrix of a product.
#[derive(Debug, Clone, ExtensionType)]
pub struct SparseOperand<B: Backend> {
    /// Concatenated CSR row starts and column indices of one or more matrices, i32.
    pub structure: IntTensor<B>,
    /// Concatenated CSR values of these matrices.
    pub values: FloatTensor<B>,
    /// The matrix on the host, with its place in the arrays of the device.
    pub matrix: Arc<CsrWithTranspose>,
    /// True for a product with the transpose.
    pub transpose: bool,
}

impl<B: Backend> SparseOperand<B> {
    /// Number of rows of the product.
    pub fn rows(&self) -> usize {
        self.matrix.oriented(self.transpose).rows()
    }
}

/// Graph of a convolution, on the device and on the host.
#[derive(Debug, Clone, ExtensionType)]
pub struct DeviceGraph<B: Backend> {
    /// Concatenated CSR row starts and column indices of the graph's matrices, i32.
    pub structure: IntTensor<B>,
    /// Concatenated CSR values of the graph's matrices.
    pub values: FloatTensor<B>,
    /// The graph on the host.
    pub host: Arc<HostGraph>,
    /// Precision of the matrix products, on the CPU backends.
    pub precision: Precision,
}

/// Order and activation of a convolution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConvSpec {
    /// Number of Chebyshev terms `K`.
    pub order: usize,
    /// Negative slope of the leaky ReLU at the end, if any.
    pub slope: Option<f64>,
}

/// Inputs of [`GraphBackend::epilogue`].
#[derive(Debug, Clone, ExtensionType)]
pub struct EpilogueInputs<B: Backend> {
    /// Sum of the products, `[batch, vertices, channels]`.
    pub sum: FloatTensor<B>,
    /// Last product, `[batch, vertices, channels]`.
    #[extension_type]
    pub product: OptionalTensor<B>,
    /// Bias or base, `[batch or 1, vertices or 1, channels]`.
    #[extension_type]
    pub addend: OptionalTensor<B>,
    /// Negative slope of the leaky ReLU, if any.
    pub slope: Option<f64>,
}

/// Inputs of [`GraphBackend::cheb_conv`].
#[derive(Debug, Clone, ExtensionType)]
pub struct ChebConvInputs<B: Backend> {
    /// Features, `[batch, vertices, channels]`.
    pub x: FloatTensor<B>,
    /// Weights, `[channels · K, out]`, row `channel · K + k`.
    pub weight: FloatTensor<B>,
    /// Coefficients of the constant terms, `[batch, r, out]`, `r ≤ K`.
    #[extension_type]
    pub constant_terms: OptionalTensor<B>,
    /// Graph.
    #[extension_type]
    pub graph: DeviceGraph<B>,
    /// Order and activation.
    pub spec: ConvSpec,
}

/// Tensors of the forward pass that [`GraphBackend::cheb_conv_backward`] needs.
#[derive(Debug, Clone, ExtensionType)]
pub struct ChebConvSaved<B: Backend> {
    /// Features, `[batch, vertices, channels]`.
    pub x: FloatTensor<B>,
    /// Weights, `[channels · K, out]`.
    pub weight: FloatTensor<B>,
    /// Output, `[batch, kept, out]`, of a convolution with an activation.
    #[extension_type]
    pub y: OptionalTensor<B>,
    /// Graph.
    #[extension_type]
    pub graph: DeviceGraph<B>,
    /// Order and activation.
    pub spec: ConvSpec,
    /// Number of constant terms `r`, 0 for none.
    pub constant_terms: usize,
}

/// Gradients that [`GraphBackend::cheb_conv_backward`] is to compute.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RequestedGradients {
    /// True to compute the gradient of the features.
    pub x: bool,
    /// True to compute the gradient of the weights.
    pub weight: bool,
}

/// Gradients of [`GraphBackend::cheb_conv`], each with the shape of its input.
#[derive(Debug, Clone, ExtensionType)]
pub struct ChebConvGradients<B: Backend> {
    /// Gradient of the features, if requested.
    #[extension_type]
    pub x: OptionalTensor<B>,
    /// Gradient of the weights, if requested.
    #[extension_type]
    pub weight: OptionalTensor<B>,
    /// Gradient of the constant terms, if there are any.
    #[extension_type]
    pub constant_terms: OptionalTensor<B>,
}

/// Inputs of [`GraphBackend::group_norm_relu`].
#[derive(Debug, Clone, ExtensionType)]
pub struct GroupNormInputs<B: Backend> {
    /// Features, `[batch, vertices, channels]`.
    pub x: FloatTensor<B>,
    /// Scale, `[channels]`.
    pub gamma: FloatTensor<B>,
    /// Shift, `[channels]`.
    pub beta: FloatTensor<B>,
    /// Number of groups of consecutive channels that are normalised together.
    pub groups: usize,
    /// Added to the variance.
    pub epsilon: f64,
}

/// Gradients of [`GraphBackend::group_norm_relu`], each with the shape of its input.
#[derive(Debug, Clone, ExtensionType)]
pub struct GroupNormGradients<B: Backend> {
    /// Gradient of the features.
    pub x: FloatTensor<B>,
    /// Gradient of the scale.
    pub gamma: FloatTensor<B>,
    /// Gradient of the shift.
    pub beta: FloatTensor<B>,
}

/// Inputs of [`GraphBackend::norm_conv`].
#[derive(Debug, Clone, ExtensionType)]
pub struct NormConvInputs<B: Backend> {
    /// Features and normalisation; scale and shift are those of `channels + c` channels.
    #[extension_type]
    pub norm: GroupNormInputs<B>,
    /// Channels that are constant over the vertices, `[batch, c]`; only with an order of 1.
    #[extension_type]
    pub constant: OptionalTensor<B>,
    /// Weights, `[(channels + c) · K, out]`.
    pub weight: FloatTensor<B>,
    /// Added to the convolution, `[batch, kept, out]`.
    #[extension_type]
    pub base: OptionalTensor<B>,
    /// Graph.
    #[extension_type]
    pub graph: DeviceGraph<B>,
    /// Number of Chebyshev terms `K`.
    pub order: usize,
}

/// Gradients of [`GraphBackend::norm_conv`], each with the shape of its input. That of the base is
/// the gradient of the output.
#[derive(Debug, Clone, ExtensionType)]
pub struct NormConvGradients<B: Backend> {
    /// Gradients of features, scale and shift.
    #[extension_type]
    pub norm: GroupNormGradients<B>,
    /// Gradient of the constant channels, if there are any.
    #[extension_type]
    pub constant: OptionalTensor<B>,
    /// Gradient of the weights.
    pub weight: FloatTensor<B>,
}

/// Graph operations on primitives of a backend. Prefer the functions of this crate: they take
/// tensors and check shapes.
///
/// A backend must implement the sparse product; the other operations have defaults composed of it:
///
/// ```
/// use std::sync::Arc;
///
/// use burn::backend::{Backend, tensor::FloatTensor};
/// use cape_graph::{ChebConvInputs, ConvSpec, DeviceGraph, GraphBackend, OptionalTensor};
///
/// /// Layer of an inference engine that holds the graph on its device.
/// fn layer<B: GraphBackend>(
///     x: FloatTensor<B>,
///     weight: FloatTensor<B>,
///     graph: DeviceGraph<B>,
/// ) -> FloatTensor<B> {
///     let spec = ConvSpec { order: 2, slope: None };
///     let constant_terms = OptionalTensor::None;
///     B::cheb_conv(ChebConvInputs { x, weight, constant_terms, graph, spec })
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
    /// `y[b] = A x[b]`, `x: [batch, columns, channels]`.
    fn sparse_matmul(
        x: FloatTensor<Self>,
        #[extension_type] a: SparseOperand<Self>,
    ) -> FloatTensor<Self>;

    /// `alpha · A x[b] + beta · base[b]`, `x: [batch, columns, channels]`,
    /// `base: [batch, rows, channels]`: a step of the Chebyshev recurrence, or a term of its
    /// gradient.
    fn sparse_accumulate(
        x: FloatTensor<Self>,
        base: FloatTensor<Self>,
        #[extension_type] a: SparseOperand<Self>,
        alpha: f64,
        beta: f64,
    ) -> FloatTensor<Self> {
        composed::accumulate::<Self>(Self::sparse_matmul(x, a), base, alpha, beta)
    }

    /// Chebyshev basis `T_k(L̃) x` at the kept vertices, `[batch, kept, channels · K]`, the terms of a
    /// channel adjacent; `x: [batch, vertices, channels]`.
    fn cheb_basis(
        x: FloatTensor<Self>,
        #[extension_type] graph: DeviceGraph<Self>,
        order: usize,
    ) -> FloatTensor<Self> {
        composed::cheb_basis::<Self>(x, &graph, order)
    }

    /// `Σ_k T_k(L̃)ᵀ Dᵀ grad_k`, `[batch, vertices, channels]`, the transpose of
    /// [`cheb_basis`](Self::cheb_basis); `grad: [batch, kept, channels · K]`.
    fn cheb_fold(
        grad: FloatTensor<Self>,
        #[extension_type] graph: DeviceGraph<Self>,
        order: usize,
    ) -> FloatTensor<Self> {
        composed::cheb_fold::<Self>(grad, &graph, order)
    }

    /// `f(sum + product + addend)`, the end of a convolution, `[batch, vertices, channels]`; `f` is
    /// the leaky ReLU, if any.
    fn epilogue(#[extension_type] inputs: EpilogueInputs<Self>) -> FloatTensor<Self> {
        composed::epilogue::<Self>(inputs)
    }

    /// Gradient before a leaky ReLU from its output `y`, `[batch, vertices, channels]`, and the sums
    /// of that gradient over the vertices, `[batch, 1, channels]`.
    fn epilogue_backward(
        y: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        slope: f64,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        composed::epilogue_backward::<Self>(y, grad, slope)
    }

    /// `y = f(Σ_k D T_k(L̃) x W_k + Σ_r D T_r(L̃)1 · constant_terms[r])`, `[batch, kept, out]`. `D` is
    /// the selection of the graph, `f` the leaky ReLU, if any.
    fn cheb_conv(#[extension_type] inputs: ChebConvInputs<Self>) -> FloatTensor<Self> {
        composed::cheb_conv::<Self>(inputs)
    }

    /// Gradients of [`cheb_conv`](Self::cheb_conv) from that of its output, `[batch, kept, out]`.
    fn cheb_conv_backward(
        #[extension_type] saved: ChebConvSaved<Self>,
        grad: FloatTensor<Self>,
        requested: RequestedGradients,
    ) -> ChebConvGradients<Self> {
        composed::cheb_conv_backward::<Self>(saved, grad, requested)
    }

    /// `y = base + cheb_conv(relu(group_norm([x, constant])))`, `[batch, kept, out]`.
    fn norm_conv(#[extension_type] inputs: NormConvInputs<Self>) -> FloatTensor<Self> {
        composed::norm_conv::<Self>(inputs)
    }

    /// Gradients of [`norm_conv`](Self::norm_conv) from that of its output, `[batch, kept, out]`;
    /// the base is not used.
    fn norm_conv_backward(
        #[extension_type] inputs: NormConvInputs<Self>,
        grad: FloatTensor<Self>,
    ) -> NormConvGradients<Self> {
        composed::norm_conv_backward::<Self>(inputs, grad)
    }

    /// `leaky_relu(x + bias)`, `x: [batch, vertices, channels]`, `bias: [channels]`, `slope > 0`.
    fn bias_leaky_relu(
        x: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        slope: f64,
    ) -> FloatTensor<Self> {
        composed::bias_leaky_relu::<Self>(x, bias, slope)
    }

    /// Gradients of [`bias_leaky_relu`](Self::bias_leaky_relu) with respect to `x` and `bias`, from
    /// its output `y`.
    fn bias_leaky_relu_backward(
        y: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        slope: f64,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        composed::bias_leaky_relu_backward::<Self>(y, grad, slope)
    }

    /// `relu(group_norm(x) · gamma + beta)`, `[batch, vertices, channels]`.
    fn group_norm_relu(#[extension_type] inputs: GroupNormInputs<Self>) -> FloatTensor<Self> {
        composed::group_norm_relu::<Self>(inputs)
    }

    /// Gradients of [`group_norm_relu`](Self::group_norm_relu) from that of its output.
    fn group_norm_relu_backward(
        #[extension_type] inputs: GroupNormInputs<Self>,
        grad: FloatTensor<Self>,
    ) -> GroupNormGradients<Self> {
        composed::group_norm_relu_backward::<Self>(inputs, grad)
    }

    /// Value and velocity, `[numbers]`, after a step of gradient descent with momentum.
    fn momentum_step(
        value: FloatTensor<Self>,
        gradient: FloatTensor<Self>,
        velocity: FloatTensor<Self>,
        step: MomentumStep,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        steps::composed_momentum::<Self>(value, gradient, velocity, step)
    }

    /// Value and moments, `[numbers]`, after a step of Adam.
    fn adam_step(
        gradient: FloatTensor<Self>,
        #[extension_type] state: AdamState<Self>,
        step: AdamStep,
    ) -> AdamState<Self> {
        steps::composed_adam::<Self>(gradient, state, step)
    }

    /// `sums`, `[vectors]`, with the sum of the squares of `x`, `[numbers]`, at index `slot`.
    fn sum_of_squares(
        x: FloatTensor<Self>,
        sums: FloatTensor<Self>,
        slot: usize,
    ) -> FloatTensor<Self> {
        steps::composed_sum_of_squares::<Self>(x, sums, slot)
    }
}
