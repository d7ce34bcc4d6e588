//! Graph operations on tensors `[batch, vertices, channels]`, differentiable on autodiff devices.

use burn::{
    backend::Dispatch,
    tensor::{DType, Tensor},
};

use crate::{ops::GraphBackend, sparse::SparseMatrix};

/// `y[b] = A x[b]`.
///
/// # Shapes
/// - `x`: `[batch, A.cols(), channels]`
/// - output: `[batch, A.rows(), channels]`
///
/// # Panics
/// If `x` is not f32 or its vertices are not the matrix's columns.
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
    Tensor::from_dispatch(Dispatch::sparse_matmul(
        x.into_dispatch(),
        a.index.clone().into_dispatch(),
        a.value.clone().into_dispatch(),
        a.pair.clone(),
        false,
    ))
}

/// The Chebyshev features `[T_0(L̃)x, …, T_{K−1}(L̃)x]` of every channel, the terms of one channel
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

/// Chebyshev graph convolution `y = Σ_k T_k(L̃) x W_k`, without bias.
///
/// # Shapes
/// - `x`: `[batch, vertices, channels]`
/// - `weight`: `[channels · order, out]`, row `channel · order + k`
/// - output: `[batch, vertices, out]`
///
/// # Panics
/// If `order` is 0, tensors are not f32, or shapes disagree.
pub fn cheb_conv(
    x: Tensor<3>,
    weight: Tensor<2>,
    laplacian: &SparseMatrix,
    order: usize,
) -> Tensor<3> {
    check_f32("cheb_conv", &x);
    check_f32("cheb_conv", &weight);
    let [_, vertices, channels] = x.dims();
    let [rows, out] = weight.dims();
    assert!(
        order > 0 && rows == channels * order,
        "cheb_conv: weight is [{rows}, {out}] but x has {channels} channels and the order is {order}"
    );
    assert!(
        vertices == laplacian.rows() && vertices == laplacian.cols(),
        "cheb_conv: x has {vertices} vertices but the Laplacian is [{}, {}]",
        laplacian.rows(),
        laplacian.cols()
    );
    Tensor::from_dispatch(Dispatch::cheb_conv(
        x.into_dispatch(),
        weight.into_dispatch(),
        laplacian.index.clone().into_dispatch(),
        laplacian.value.clone().into_dispatch(),
        laplacian.pair.clone(),
        order,
    ))
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
/// - `gamma`, `beta`: `[channels]`
///
/// # Panics
/// If `groups` does not divide the channels, tensors are not f32, or shapes disagree.
pub fn group_norm_relu(
    x: Tensor<3>,
    gamma: Tensor<1>,
    beta: Tensor<1>,
    groups: usize,
    epsilon: f64,
) -> Tensor<3> {
    check_f32("group_norm_relu", &x);
    check_f32("group_norm_relu", &gamma);
    check_f32("group_norm_relu", &beta);
    let [_, _, channels] = x.dims();
    assert!(
        groups > 0 && channels % groups == 0,
        "group_norm_relu: {groups} groups do not divide {channels} channels"
    );
    assert_eq!(gamma.dims(), [channels], "group_norm_relu: gamma for {channels} channels");
    assert_eq!(beta.dims(), [channels], "group_norm_relu: beta for {channels} channels");
    Tensor::from_dispatch(Dispatch::group_norm_relu(
        x.into_dispatch(),
        gamma.into_dispatch(),
        beta.into_dispatch(),
        groups,
        epsilon,
    ))
}

fn check_f32<const D: usize>(operation: &str, tensor: &Tensor<D>) {
    assert_eq!(tensor.dtype(), DType::F32, "{operation}: tensors must be f32");
}
