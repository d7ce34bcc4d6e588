//! Operations composed of Burn's own, for backends without a fused kernel.

use std::sync::Arc;

use burn::{
    backend::{Backend, TensorMetadata, get_or_init_device_settings, tensor::FloatTensor},
    tensor::{DType, Shape, TensorData},
};

use crate::{
    ops::{
        ChebConvGradients, ChebConvInputs, ChebConvSaved, ConvSpec, DeviceGraph, EpilogueInputs,
        GraphBackend, GroupNormGradients, GroupNormInputs, NormConvGradients, NormConvInputs,
        OptionalTensor, RequestedGradients, SparseOperand,
    },
    sparse::CsrWithTranspose,
};

impl<B: GraphBackend> DeviceGraph<B> {
    pub(crate) fn operand(
        &self,
        matrix: &Arc<CsrWithTranspose>,
        transpose: bool,
    ) -> SparseOperand<B> {
        SparseOperand {
            structure: self.structure.clone(),
            values: self.values.clone(),
            matrix: matrix.clone(),
            transpose,
        }
    }

    /// `2 A x − before`, or `A x` without a term before.
    fn recur(
        &self,
        x: FloatTensor<B>,
        matrix: &Arc<CsrWithTranspose>,
        before: Option<&FloatTensor<B>>,
    ) -> FloatTensor<B> {
        let a = self.operand(matrix, false);
        match before {
            Some(before) => B::sparse_accumulate(x, before.clone(), a, 2.0, -1.0),
            None => B::sparse_matmul(x, a),
        }
    }

    /// `alpha · Aᵀ x + base`.
    fn accumulate_transposed(
        &self,
        x: FloatTensor<B>,
        base: FloatTensor<B>,
        matrix: &Arc<CsrWithTranspose>,
        alpha: f64,
    ) -> FloatTensor<B> {
        B::sparse_accumulate(x, base, self.operand(matrix, true), alpha, 1.0)
    }

    /// Values of `x` at the kept vertices.
    fn gather(&self, x: FloatTensor<B>) -> FloatTensor<B> {
        match self.host.pool() {
            Some(pool) => B::sparse_matmul(x, self.operand(&pool.selection, false)),
            None => x,
        }
    }

    /// Values at the kept vertices among all, 0 elsewhere: the gradient of
    /// [`gather`](Self::gather).
    fn scatter(&self, grad: FloatTensor<B>) -> FloatTensor<B> {
        match self.host.pool() {
            Some(pool) => B::sparse_matmul(grad, self.operand(&pool.selection, true)),
            None => grad,
        }
    }

    /// `[T_0(L̃)x, …, T_{K−1}(L̃)x]` at the kept vertices.
    fn basis(&self, x: FloatTensor<B>, order: usize) -> Vec<FloatTensor<B>> {
        let laplacian = self.host.laplacian();
        let mut kept = vec![self.gather(x.clone())];
        let mut whole = vec![x];
        for k in 1..order {
            let previous = whole[k - 1].clone();
            let before = k.checked_sub(2);
            let kept_before = before.map(|before| &kept[before]);
            let next = self.recur(previous.clone(), self.host.kept_laplacian(), kept_before);
            kept.push(next.clone());
            if k + 1 < order {
                whole.push(match self.host.pool() {
                    Some(_) => self.recur(previous, laplacian, before.map(|before| &whole[before])),
                    None => next,
                });
            }
        }
        kept
    }

    /// Chebyshev basis of the constant function at the kept vertices, `[batch, kept, count]`.
    fn constant_basis(&self, batch: usize, count: usize) -> FloatTensor<B> {
        let kept = self.host.kept();
        let basis = self.host.constant_basis(count).to_vec();
        let data = TensorData::new(basis, [1, kept, count]);
        let basis = B::float_from_data(data, &self.values.device());
        B::float_expand(basis, shape([batch, kept, count]))
    }
}

/// `alpha · product + beta · base`.
pub(crate) fn accumulate<B: Backend>(
    product: FloatTensor<B>,
    base: FloatTensor<B>,
    alpha: f64,
    beta: f64,
) -> FloatTensor<B> {
    let scaled = |x: FloatTensor<B>, by: f64| {
        if by == 1.0 { x } else { B::float_mul_scalar(x, by.into()) }
    };
    let product = scaled(product, alpha);
    if beta == -1.0 {
        B::float_sub(product, base)
    } else {
        B::float_add(product, scaled(base, beta))
    }
}

fn shape<const D: usize>(dims: [usize; D]) -> Shape {
    Shape::from(dims.to_vec())
}

fn dims<B: Backend>(x: &FloatTensor<B>) -> [usize; 3] {
    let shape = x.shape();
    [shape[0], shape[1], shape[2]]
}

/// [`GraphBackend::cheb_basis`].
pub(crate) fn cheb_basis<B: GraphBackend>(
    x: FloatTensor<B>,
    graph: &DeviceGraph<B>,
    order: usize,
) -> FloatTensor<B> {
    let [batch, _, channels] = dims::<B>(&x);
    let kept = graph.host.kept();
    let mut terms = graph.basis(x, order);
    if order == 1 {
        return terms.swap_remove(0);
    }
    let column = |term| B::float_reshape(term, shape([batch, kept, channels, 1]));
    let terms = terms.into_iter().map(column).collect();
    B::float_reshape(B::float_cat(terms, 3), shape([batch, kept, channels * order]))
}

/// [`GraphBackend::cheb_fold`], by the recurrence in reverse.
pub(crate) fn cheb_fold<B: GraphBackend>(
    grad: FloatTensor<B>,
    graph: &DeviceGraph<B>,
    order: usize,
) -> FloatTensor<B> {
    if order == 1 {
        return graph.scatter(grad);
    }
    let [batch, kept, columns] = dims::<B>(&grad);
    let channels = columns / order;
    let grad = B::float_reshape(grad, shape([batch, kept, channels, order]));
    let term = |k: usize| {
        let ranges = [(0..batch).into(), (0..kept).into(), (0..channels).into(), (k..k + 1).into()];
        B::float_reshape(B::float_slice(grad.clone(), &ranges), shape([batch, kept, channels]))
    };
    let mut kept_terms: Vec<FloatTensor<B>> = (0..order - 1).map(term).collect();
    let last = term(order - 1);
    if order > 2 {
        let before = kept_terms[order - 3].clone();
        kept_terms[order - 3] = B::float_sub(before, last.clone());
    }
    let laplacian = graph.host.laplacian();
    let mut terms: Vec<FloatTensor<B>> =
        kept_terms.into_iter().map(|term| graph.scatter(term)).collect();
    let alpha = if order > 2 { 2.0 } else { 1.0 };
    let base = terms[order - 2].clone();
    terms[order - 2] = graph.accumulate_transposed(last, base, graph.host.kept_laplacian(), alpha);
    for k in (2..order - 1).rev() {
        let (term, base) = (terms[k].clone(), terms[k - 1].clone());
        terms[k - 1] = graph.accumulate_transposed(term, base, laplacian, 2.0);
        terms[k - 2] = B::float_sub(terms[k - 2].clone(), terms[k].clone());
    }
    let first = terms[0].clone();
    match terms.get(1) {
        Some(second) => graph.accumulate_transposed(second.clone(), first, laplacian, 1.0),
        None => first,
    }
}

/// `[batch · vertices, channels]`.
fn flat<B: Backend>(x: FloatTensor<B>) -> FloatTensor<B> {
    let [batch, vertices, channels] = dims::<B>(&x);
    B::float_reshape(x, shape([batch * vertices, channels]))
}

pub(crate) fn cheb_conv<B: GraphBackend>(inputs: ChebConvInputs<B>) -> FloatTensor<B> {
    let ChebConvInputs { x, weight, constant_terms, graph, spec } = inputs;
    let addend = constant_terms.into_option().map(|terms| {
        let [batch, count, _] = dims::<B>(&terms);
        // A single term is a bias: T_0(L̃)1 = 1.
        if count == 1 { terms } else { B::float_matmul(graph.constant_basis(batch, count), terms) }
    });
    convolve::<B>(x, weight, addend, &graph, spec)
}

/// `f(Σ_k D T_k(L̃) x W_k + addend)`; `addend` as in [`GraphBackend::epilogue`].
fn convolve<B: GraphBackend>(
    x: FloatTensor<B>,
    weight: FloatTensor<B>,
    addend: Option<FloatTensor<B>>,
    graph: &DeviceGraph<B>,
    spec: ConvSpec,
) -> FloatTensor<B> {
    let ConvSpec { order, slope } = spec;
    let dims = [dims::<B>(&x)[0], graph.host.kept(), weight.shape()[1]];
    let basis = B::cheb_basis(x, graph.clone(), order);
    let product = B::float_reshape(B::float_matmul(flat::<B>(basis), weight), shape(dims));
    if addend.is_none() && slope.is_none() {
        return product;
    }
    let (sum, product) = (product, OptionalTensor::None);
    B::epilogue(EpilogueInputs { sum, product, addend: addend.into(), slope })
}

pub(crate) fn cheb_conv_backward<B: GraphBackend>(
    saved: ChebConvSaved<B>,
    grad: FloatTensor<B>,
    requested: RequestedGradients,
) -> ChebConvGradients<B> {
    let ChebConvSaved { x, weight, y, graph, spec, constant_terms } = saved;
    let (grad, sums) = match spec.slope {
        Some(slope) => {
            let OptionalTensor::Some(y) = y else {
                panic!("cheb_conv_backward: with an activation, the output `y` is required")
            };
            let (grad, sums) = B::epilogue_backward(y, grad, slope);
            (grad, Some(sums))
        }
        None => (grad, None),
    };
    let constant_terms = match constant_terms {
        0 => None,
        1 => Some(sums.unwrap_or_else(|| B::float_sum_dim(grad.clone(), 1))),
        count => {
            let basis = graph.constant_basis(dims::<B>(&grad)[0], count);
            Some(B::float_matmul(B::float_swap_dims(basis, 1, 2), grad.clone()))
        }
    };
    let order = spec.order;
    let grad_weight =
        requested.weight.then(|| weight_gradient::<B>(x, grad.clone(), &graph, order));
    let grad_x = requested.x.then(|| input_gradient::<B>(weight, grad, &graph, order));
    ChebConvGradients {
        x: grad_x.into(),
        weight: grad_weight.into(),
        constant_terms: constant_terms.into(),
    }
}

/// `Σ_b (D T_k(L̃) x[b])ᵀ grad[b]` in rows `channel · K + k`, `[channels · K, out]`.
fn weight_gradient<B: GraphBackend>(
    x: FloatTensor<B>,
    grad: FloatTensor<B>,
    graph: &DeviceGraph<B>,
    order: usize,
) -> FloatTensor<B> {
    let basis = B::cheb_basis(x, graph.clone(), order);
    B::float_matmul(B::float_transpose(flat::<B>(basis)), flat::<B>(grad))
}

/// `Σ_k T_k(L̃)ᵀ Dᵀ grad W_kᵀ`, `[batch, vertices, channels]`.
fn input_gradient<B: GraphBackend>(
    weight: FloatTensor<B>,
    grad: FloatTensor<B>,
    graph: &DeviceGraph<B>,
    order: usize,
) -> FloatTensor<B> {
    let [batch, kept, _] = dims::<B>(&grad);
    let columns = weight.shape()[0];
    let products = B::float_matmul(flat::<B>(grad), B::float_transpose(weight));
    B::cheb_fold(B::float_reshape(products, shape([batch, kept, columns])), graph.clone(), order)
}

/// Features and constant channels at every vertex, `[batch, vertices, channels + c]`.
fn append_constant<B: Backend>(
    x: FloatTensor<B>,
    constant: Option<FloatTensor<B>>,
) -> FloatTensor<B> {
    let Some(constant) = constant else { return x };
    let [batch, vertices, _] = dims::<B>(&x);
    let count = constant.shape()[1];
    let tiled = B::float_reshape(constant, shape([batch, 1, count]));
    let tiled = B::float_expand(tiled, shape([batch, vertices, count]));
    B::float_cat(vec![x, tiled], 2)
}

pub(crate) fn norm_conv<B: GraphBackend>(inputs: NormConvInputs<B>) -> FloatTensor<B> {
    let NormConvInputs { norm, constant, weight, base, graph, order } = inputs;
    let x = append_constant::<B>(norm.x, constant.into_option());
    let active = B::group_norm_relu(GroupNormInputs { x, ..norm });
    let spec = ConvSpec { order, slope: None };
    convolve::<B>(active, weight, base.into_option(), &graph, spec)
}

pub(crate) fn norm_conv_backward<B: GraphBackend>(
    inputs: NormConvInputs<B>,
    grad: FloatTensor<B>,
) -> NormConvGradients<B> {
    let NormConvInputs { norm, constant, weight, graph, order, .. } = inputs;
    let [batch, vertices, channels] = dims::<B>(&norm.x);
    let constant = constant.into_option();
    let constants = constant.as_ref().map_or(0, |constant| constant.shape()[1]);
    let x = append_constant::<B>(norm.x, constant);
    let norm = GroupNormInputs { x, ..norm };
    let active = B::group_norm_relu(norm.clone());
    let grad_weight = weight_gradient::<B>(active, grad.clone(), &graph, order);
    let grad_active = input_gradient::<B>(weight, grad, &graph, order);
    let gradients = B::group_norm_relu_backward(norm, grad_active);
    if constants == 0 {
        let constant = OptionalTensor::None;
        return NormConvGradients { norm: gradients, constant, weight: grad_weight };
    }
    let all = gradients.x;
    let part = |from: usize, to: usize| {
        let ranges = [(0..batch).into(), (0..vertices).into(), (from..to).into()];
        B::float_slice(all.clone(), &ranges)
    };
    let constant = B::float_sum_dim(part(channels, channels + constants), 1);
    NormConvGradients {
        norm: GroupNormGradients { x: part(0, channels), ..gradients },
        constant: OptionalTensor::Some(B::float_reshape(constant, shape([batch, constants]))),
        weight: grad_weight,
    }
}

/// `[channels]` as `[1, 1, channels]`.
fn row<B: Backend>(x: FloatTensor<B>) -> FloatTensor<B> {
    let channels = x.shape()[0];
    B::float_reshape(x, shape([1, 1, channels]))
}

/// Sums over batch and vertices, `[channels]`.
fn channel_sum<B: Backend>(x: FloatTensor<B>) -> FloatTensor<B> {
    let channels = x.shape()[2];
    let sum = B::float_sum_dim(B::float_sum_dim(x, 1), 0);
    B::float_reshape(sum, shape([channels]))
}

/// `x` at positive `sign`, `slope · x` elsewhere.
fn gate<B: Backend>(x: FloatTensor<B>, sign: FloatTensor<B>, slope: f64) -> FloatTensor<B> {
    let bool_dtype = get_or_init_device_settings::<B>(&sign.device()).bool_dtype;
    let off = B::float_lower_equal_elem(sign, 0.0.into(), bool_dtype);
    let scaled = B::float_mul_scalar(x.clone(), slope.into());
    B::float_mask_where(x, off, scaled)
}

pub(crate) fn epilogue<B: Backend>(inputs: EpilogueInputs<B>) -> FloatTensor<B> {
    let EpilogueInputs { sum, product, addend, slope } = inputs;
    let y = [product, addend]
        .into_iter()
        .filter_map(OptionalTensor::into_option)
        .fold(sum, B::float_add);
    match slope {
        Some(slope) => gate::<B>(y.clone(), y, slope),
        None => y,
    }
}

pub(crate) fn epilogue_backward<B: Backend>(
    y: FloatTensor<B>,
    grad: FloatTensor<B>,
    slope: f64,
) -> (FloatTensor<B>, FloatTensor<B>) {
    let grad = gate::<B>(grad, y, slope);
    (grad.clone(), B::float_sum_dim(grad, 1))
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

/// Mean over vertices and the channels of each group, repeated for each of its channels:
/// `[batch, 1, channels]`.
fn group_mean<B: Backend>(x: FloatTensor<B>, groups: usize) -> FloatTensor<B> {
    let [batch, _, channels] = dims::<B>(&x);
    let grouped = shape([batch, groups, channels / groups]);
    let mean = B::float_reshape(B::float_mean_dim(x, 1), grouped.clone());
    let mean = B::float_expand(B::float_mean_dim(mean, 2), grouped);
    B::float_reshape(mean, shape([batch, 1, channels]))
}

/// The normalised input, `[batch, vertices, channels]`, and the inverse standard deviations,
/// `[batch, 1, channels]`.
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

pub(crate) fn group_norm_relu<B: Backend>(inputs: GroupNormInputs<B>) -> FloatTensor<B> {
    let GroupNormInputs { x, gamma, beta, groups, epsilon } = inputs;
    let (unit, _) = normalise::<B>(x, groups, epsilon);
    let affine = B::float_add(B::float_mul(unit, row::<B>(gamma)), row::<B>(beta));
    B::float_clamp_min(affine, 0.0.into())
}

pub(crate) fn group_norm_relu_backward<B: Backend>(
    inputs: GroupNormInputs<B>,
    grad: FloatTensor<B>,
) -> GroupNormGradients<B> {
    let GroupNormInputs { x, gamma, beta, groups, epsilon } = inputs;
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
    GroupNormGradients { x: B::float_mul(grad_x, inverse), gamma: grad_gamma, beta: grad_beta }
}
