//! Graph operations on tensors `[batch, vertices, channels]`, differentiable on autodiff devices.

use burn::{
    backend::Dispatch,
    tensor::{DType, Tensor},
};

use crate::{
    conv_graph::ConvGraph,
    ops::{
        ChebConvInputs, ConvSpec, GraphBackend, GroupNormInputs, NormConvInputs, OptionalTensor,
    },
    sparse::SparseMatrix,
};

/// `y[b] = A x[b]`.
///
/// # Shapes
/// - `x`: `[batch, A.cols(), channels]`
/// - output: `[batch, A.rows(), channels]`
///
/// # Panics
/// If `x` is not f32 or has other than `A.cols()` vertices.
pub fn sparse_matmul(x: Tensor<3>, a: &SparseMatrix) -> Tensor<3> {
    check_f32("sparse_matmul", &x);
    let [_, vertices, _] = x.dims();
    assert_eq!(
        vertices,
        a.cols(),
        "sparse_matmul: x has {vertices} vertices but the matrix is [{}, {}]",
        a.rows(),
        a.cols()
    );
    Tensor::from_dispatch(Dispatch::sparse_matmul(x.into_dispatch(), a.operand()))
}

/// Chebyshev features `[T_0(L̃)x, …, T_{K−1}(L̃)x]` of every channel, the terms of one channel
/// adjacent.
///
/// # Shapes
/// - `x`: `[batch, vertices, channels]`
/// - output: `[batch, vertices, channels · order]`
///
/// # Panics
/// If `order` is 0 or shapes disagree.
pub fn cheb_features(x: Tensor<3>, laplacian: &SparseMatrix, order: usize) -> Tensor<3> {
    assert!(order > 0, "cheb_features: order must be at least 1");
    let [batch, vertices, channels] = x.dims();
    let mut terms = vec![x];
    for k in 1..order {
        let last = sparse_matmul(terms[k - 1].clone(), laplacian);
        terms.push(if k == 1 { last } else { last * 2.0 - terms[k - 2].clone() });
    }
    Tensor::stack::<4>(terms, 3).reshape([batch, vertices, channels * order])
}

/// Constant terms and activation of a convolution.
///
/// See [`ConvGraph`] for an example.
#[derive(Debug, Clone, Default)]
pub struct Epilogue {
    /// Coefficients of the constant terms, `[batch, r, out]`, `r` up to the order:
    /// `Σ_r T_r(L̃)1 · constant_terms[r]` is added. A single one is a bias; as many as the order are
    /// the convolution of channels that are constant over the vertices.
    pub constant_terms: Option<Tensor<3>>,
    /// Negative slope of a leaky ReLU, positive.
    pub slope: Option<f64>,
}

/// Chebyshev graph convolution
/// `y = f(Σ_k D T_k(L̃) x W_k + Σ_r D T_r(L̃)1 · constant_terms[r])`, `f` being the leaky ReLU and `D`
/// the selection of the graph, if any: nothing is computed at the vertices that it drops.
///
/// # Shapes
/// - `x`: `[batch, vertices, channels]`
/// - `weight`: `[channels · order, out]`, row `channel · order + k`
/// - output: `[batch, kept, out]`
///
/// # Panics
/// If `order` is 0, the slope is not positive, tensors are not f32, or shapes disagree.
pub fn cheb_conv(
    x: Tensor<3>,
    weight: Tensor<2>,
    graph: &ConvGraph,
    order: usize,
    epilogue: Epilogue,
) -> Tensor<3> {
    check_f32("cheb_conv", &x);
    check_f32("cheb_conv", &weight);
    check_conv("cheb_conv", &x, x.dims()[2], &weight, graph, order);
    let [batch, vertices, channels] = x.dims();
    let [_, out] = weight.dims();
    let Epilogue { constant_terms, slope } = epilogue;
    if let Some(terms) = &constant_terms {
        check_f32("cheb_conv", terms);
        let [examples, count, width] = terms.dims();
        assert!(
            examples == batch && width == out && (1..=order).contains(&count),
            "cheb_conv: constant terms are [{examples}, {count}, {width}], expected [{batch}, 1 to \
             {order}, {out}]"
        );
    }
    assert!(slope.is_none_or(|slope| slope > 0.0), "cheb_conv: slope must be positive");
    if order == 2 && 2 * out < channels && graph.kept() == vertices && slope.is_none() {
        return product_first(x, weight, graph, constant_terms);
    }
    Tensor::from_dispatch(Dispatch::cheb_conv(ChebConvInputs {
        x: x.into_dispatch(),
        weight: weight.into_dispatch(),
        constant_terms: optional(constant_terms),
        graph: graph.tensors(),
        spec: ConvSpec { order, slope },
    }))
}

fn optional<const D: usize>(tensor: Option<Tensor<D>>) -> OptionalTensor<Dispatch> {
    tensor.map(Tensor::into_dispatch).into()
}

/// Convolution of order 2 to few channels, `x W_0 + L̃ (x W_1)`: the Laplacian is applied to the
/// products, which are narrower than `x`.
fn product_first(
    x: Tensor<3>,
    weight: Tensor<2>,
    graph: &ConvGraph,
    constant_terms: Option<Tensor<3>>,
) -> Tensor<3> {
    let [batch, vertices, channels] = x.dims();
    let [_, out] = weight.dims();
    // Both products of a channel are adjacent: rows `channel · 2 + k` become columns `k · out + j`.
    let weight = weight.reshape([channels, 2 * out]);
    let constant_terms = constant_terms.map(|terms| {
        let [_, count, _] = terms.dims();
        let missing = Tensor::zeros([batch, 2 - count, out], &terms.device());
        let terms = if count < 2 { Tensor::cat(vec![terms, missing], 1) } else { terms };
        terms.reshape([batch, 1, 2 * out])
    });
    let products = cheb_conv(x, weight, graph, 1, Epilogue { constant_terms, slope: None });
    let part = |k: usize| products.clone().slice([0..batch, 0..vertices, k * out..(k + 1) * out]);
    part(0) + sparse_matmul(part(1), &graph.laplacian())
}

/// Parameters of a group normalisation.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::{ConvGraph, GroupNorm, norm_conv, sparse_from_triplets};
///
/// let path = sparse_from_triplets("L", (2, 2), &[0, 1], &[1, 0], &[-1.0; 2])?;
/// let device = Device::default();
/// let graph = ConvGraph::new(&path, None, &device);
/// let norm = GroupNorm {
///     gamma: Tensor::ones([1], &device),
///     beta: Tensor::zeros([1], &device),
///     groups: 1,
///     epsilon: 1e-6,
/// };
/// // 3 and 7 are normalised to −1 and 1; ReLU and a weight of 2 leave 0 and 2.
/// let x = Tensor::<3>::from_floats([[[3.0], [7.0]]], &device);
/// let weight = Tensor::<2>::full([1, 1], 2.0, &device);
/// let y = norm_conv(x, None, norm, weight, &graph, 1, None);
/// let y: Vec<f32> = y.into_data().try_into_vec().unwrap();
/// assert!(y[0] == 0.0 && (y[1] - 2.0).abs() < 1e-5);
/// # Ok::<(), cape_graph::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct GroupNorm {
    /// Scale, `[channels]`.
    pub gamma: Tensor<1>,
    /// Shift, `[channels]`.
    pub beta: Tensor<1>,
    /// Number of groups of consecutive channels.
    pub groups: usize,
    /// Added to the variance.
    pub epsilon: f64,
}

impl GroupNorm {
    fn inputs(self, x: Tensor<3>) -> GroupNormInputs<Dispatch> {
        GroupNormInputs {
            x: x.into_dispatch(),
            gamma: self.gamma.into_dispatch(),
            beta: self.beta.into_dispatch(),
            groups: self.groups,
            epsilon: self.epsilon,
        }
    }
}

/// `base + cheb_conv(group_norm_relu([x, constant]))`: normalisation, ReLU and convolution without
/// the normalised features in memory. The channels of `constant` are the same at every vertex of an
/// example; they follow those of the features and take part in the normalisation.
///
/// # Shapes
/// - `x`: `[batch, vertices, channels]`
/// - `constant`: `[batch, c]`; only with an order of 1
/// - `weight`: `[(channels + c) · order, out]`
/// - `base`, output: `[batch, kept, out]`
///
/// # Panics
/// If `order` is 0, or above 1 with constant channels, the groups do not divide the channels,
/// tensors are not f32, or shapes disagree.
pub fn norm_conv(
    x: Tensor<3>,
    constant: Option<Tensor<2>>,
    norm: GroupNorm,
    weight: Tensor<2>,
    graph: &ConvGraph,
    order: usize,
    base: Option<Tensor<3>>,
) -> Tensor<3> {
    check_f32("norm_conv", &x);
    check_f32("norm_conv", &weight);
    let [batch, _, features] = x.dims();
    let mut channels = features;
    if let Some(constant) = &constant {
        check_f32("norm_conv", constant);
        let [examples, count] = constant.dims();
        assert_eq!(examples, batch, "norm_conv: batch size of the constant channels");
        assert_eq!(order, 1, "norm_conv: order of a convolution with constant channels");
        channels += count;
    }
    check_conv("norm_conv", &x, channels, &weight, graph, order);
    check_norm("norm_conv", channels, &norm);
    let [_, out] = weight.dims();
    if let Some(base) = &base {
        check_f32("norm_conv", base);
        assert_eq!(base.dims(), [batch, graph.kept(), out], "norm_conv: shape of the base");
    }
    Tensor::from_dispatch(Dispatch::norm_conv(NormConvInputs {
        norm: norm.inputs(x),
        constant: optional(constant),
        weight: weight.into_dispatch(),
        base: optional(base),
        graph: graph.tensors(),
        order,
    }))
}

/// `leaky_relu(x + bias)`.
///
/// # Shapes
/// - `x`, output: `[batch, vertices, channels]`
/// - `bias`: `[channels]`
///
/// # Panics
/// If `slope` is not positive, tensors are not f32, or shapes disagree.
pub fn bias_leaky_relu(x: Tensor<3>, bias: Tensor<1>, slope: f64) -> Tensor<3> {
    check_f32("bias_leaky_relu", &x);
    check_f32("bias_leaky_relu", &bias);
    let [_, _, channels] = x.dims();
    assert_eq!(bias.dims(), [channels], "bias_leaky_relu: bias for x with {channels} channels");
    assert!(slope > 0.0, "bias_leaky_relu: slope must be positive, not {slope}");
    Tensor::from_dispatch(Dispatch::bias_leaky_relu(x.into_dispatch(), bias.into_dispatch(), slope))
}

/// `relu(group_norm(x) · gamma + beta)`: each group of consecutive channels is normalised over its
/// channels and all vertices.
///
/// # Shapes
/// - `x`, output: `[batch, vertices, channels]`
///
/// # Panics
/// If the groups do not divide the channels, tensors are not f32, or shapes disagree.
pub fn group_norm_relu(x: Tensor<3>, norm: GroupNorm) -> Tensor<3> {
    check_f32("group_norm_relu", &x);
    check_norm("group_norm_relu", x.dims()[2], &norm);
    Tensor::from_dispatch(Dispatch::group_norm_relu(norm.inputs(x)))
}

fn check_f32<const D: usize>(operation: &str, tensor: &Tensor<D>) {
    assert_eq!(tensor.dtype(), DType::F32, "{operation}: tensors must be f32");
}

fn check_conv(
    operation: &str,
    x: &Tensor<3>,
    channels: usize,
    weight: &Tensor<2>,
    graph: &ConvGraph,
    order: usize,
) {
    let [_, vertices, _] = x.dims();
    let [rows, out] = weight.dims();
    assert!(
        order > 0 && rows == channels * order,
        "{operation}: weight is [{rows}, {out}] but x has {channels} channels and the order is \
         {order}"
    );
    assert!(
        vertices == graph.vertices(),
        "{operation}: x has {vertices} vertices but the Laplacian is [{0}, {0}]",
        graph.vertices()
    );
}

fn check_norm(operation: &str, channels: usize, norm: &GroupNorm) {
    let GroupNorm { gamma, beta, groups, .. } = norm;
    check_f32(operation, gamma);
    check_f32(operation, beta);
    assert!(
        *groups > 0 && channels.is_multiple_of(*groups),
        "{operation}: {groups} groups do not divide {channels} channels"
    );
    assert_eq!(gamma.dims(), [channels], "{operation}: gamma for {channels} channels");
    assert_eq!(beta.dims(), [channels], "{operation}: beta for {channels} channels");
}
