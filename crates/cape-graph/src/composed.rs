//! The operations in terms of Burn's own, for backends without a fused kernel.

use std::sync::Arc;

use burn::{
    backend::{
        Backend, TensorMetadata, get_or_init_device_settings,
        tensor::{FloatTensor, IntTensor},
    },
    tensor::{DType, Shape, TensorData},
};

use crate::{
    operator::Operator,
    ops::{ConvSpec, EndSpec, GraphBackend, NormConvSpec},
    sparse::SparsePair,
};

/// The graph of a convolution: its structure on the device and on the host.
pub(crate) struct Graph<B: Backend> {
    pub index: IntTensor<B>,
    pub value: FloatTensor<B>,
    pub operator: Arc<Operator>,
}

impl<B: GraphBackend> Graph<B> {
    fn multiply(&self, x: FloatTensor<B>, by: &Arc<SparsePair>, transpose: bool) -> FloatTensor<B> {
        B::sparse_matmul(x, self.index.clone(), self.value.clone(), by.clone(), transpose)
    }

    /// `alpha · A x + beta · base` (or `Aᵀ x`).
    fn accumulate(
        &self,
        x: FloatTensor<B>,
        base: FloatTensor<B>,
        by: &Arc<SparsePair>,
        transpose: bool,
        [alpha, beta]: [f64; 2],
    ) -> FloatTensor<B> {
        let (index, value) = (self.index.clone(), self.value.clone());
        B::sparse_accumulate(x, base, index, value, by.clone(), transpose, alpha, beta)
    }

    /// `2 A x − before`, or `A x` without a term before.
    fn recur(
        &self,
        x: FloatTensor<B>,
        by: &Arc<SparsePair>,
        before: Option<&FloatTensor<B>>,
    ) -> FloatTensor<B> {
        match before {
            Some(before) => self.accumulate(x, before.clone(), by, false, [2.0, -1.0]),
            None => self.multiply(x, by, false),
        }
    }

    /// The kept vertices of `x`.
    fn select(&self, x: FloatTensor<B>) -> FloatTensor<B> {
        match self.operator.pool() {
            Some(pool) => self.multiply(x, &pool.selection, false),
            None => x,
        }
    }

    /// The gradient of [`select`](Self::select).
    fn spread(&self, grad: FloatTensor<B>) -> FloatTensor<B> {
        match self.operator.pool() {
            Some(pool) => self.multiply(grad, &pool.selection, true),
            None => grad,
        }
    }

    /// `[T_0(L̃)x, …, T_{K−1}(L̃)x]` at the kept vertices.
    fn basis(&self, x: FloatTensor<B>, order: usize) -> Vec<FloatTensor<B>> {
        let laplacian = self.operator.laplacian();
        let mut kept = vec![self.select(x.clone())];
        let mut whole = vec![x];
        for k in 1..order {
            let previous = whole[k - 1].clone();
            let before = k.checked_sub(2);
            let kept_before = before.map(|before| &kept[before]);
            let next = self.recur(previous.clone(), self.operator.kept_laplacian(), kept_before);
            kept.push(next.clone());
            if k + 1 < order {
                whole.push(match self.operator.pool() {
                    Some(_) => self.recur(previous, laplacian, before.map(|before| &whole[before])),
                    None => next,
                });
            }
        }
        kept
    }

    /// `T_0(L̃)1 … T_{count−1}(L̃)1` at the kept vertices, `[1, kept, count]`.
    fn sums(&self, count: usize) -> FloatTensor<B> {
        let sums = self.operator.sums(count).to_vec();
        let data = TensorData::new(sums, [1, self.operator.kept(), count]);
        B::float_from_data(data, &self.value.device())
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

/// The weights of each term, `[channels, out]`.
fn term_weights<B: Backend>(weight: FloatTensor<B>, order: usize) -> Vec<FloatTensor<B>> {
    let (rows, out) = (weight.shape()[0], weight.shape()[1]);
    let channels = rows / order;
    let weight = B::float_reshape(weight, shape([channels, order, out]));
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
    rows: FloatTensor<B>,
    graph: &Graph<B>,
    spec: ConvSpec,
) -> FloatTensor<B> {
    let rows = match spec.rows {
        0 => None,
        1 => Some(rows),
        count => {
            let [batch, kept] = [dims::<B>(&x)[0], graph.operator.kept()];
            let sums = B::float_expand(graph.sums(count), shape([batch, kept, count]));
            Some(B::float_matmul(sums, rows))
        }
    };
    convolve::<B>(x, weight, rows, graph, spec.order, spec.slope)
}

/// `f(Σ_k D T_k(L̃) x W_k + rows)`; `rows` as in [`GraphBackend::conv_end`].
fn convolve<B: GraphBackend>(
    x: FloatTensor<B>,
    weight: FloatTensor<B>,
    rows: Option<FloatTensor<B>>,
    graph: &Graph<B>,
    order: usize,
    slope: Option<f64>,
) -> FloatTensor<B> {
    let dims = [dims::<B>(&x)[0], graph.operator.kept(), weight.shape()[1]];
    let terms = graph.basis(x, order);
    let mut products: Vec<FloatTensor<B>> = terms
        .into_iter()
        .zip(term_weights::<B>(weight, order))
        .map(|(term, weight)| {
            B::float_reshape(B::float_matmul(flat::<B>(term), weight), shape(dims))
        })
        .collect();
    // The last sum is made with what follows it.
    let last = products.split_off(order.max(2) - 1).pop();
    let sum = products
        .into_iter()
        .reduce(B::float_add)
        .unwrap_or_else(|| unreachable!("order is at least 1"));
    if last.is_none() && rows.is_none() && slope.is_none() {
        return sum;
    }
    let spec = EndSpec { term: last.is_some(), rows: rows.is_some(), slope };
    let unused = sum.clone();
    B::conv_end(sum, last.unwrap_or_else(|| unused.clone()), rows.unwrap_or(unused), spec)
}

#[allow(clippy::too_many_arguments)]
pub(crate) fn cheb_conv_backward<B: GraphBackend>(
    x: FloatTensor<B>,
    weight: FloatTensor<B>,
    y: FloatTensor<B>,
    grad: FloatTensor<B>,
    graph: &Graph<B>,
    spec: ConvSpec,
    want_x: bool,
    want_weight: bool,
) -> (FloatTensor<B>, FloatTensor<B>, FloatTensor<B>) {
    let [batch, _, channels] = dims::<B>(&x);
    let (kept, out, order) = (graph.operator.kept(), weight.shape()[1], spec.order);
    let (grad, sums) = match spec.slope {
        Some(slope) => {
            let (grad, sums) = B::conv_end_backward(y, grad, slope);
            (grad, Some(sums))
        }
        None => (grad, None),
    };
    let grad_rows = match spec.rows {
        0 => grad.clone(),
        1 => sums.unwrap_or_else(|| B::float_sum_dim(grad.clone(), 1)),
        rows => {
            let sums = B::float_expand(graph.sums(rows), shape([batch, kept, rows]));
            B::float_matmul(B::float_swap_dims(sums, 1, 2), grad.clone())
        }
    };

    let flat_grad = flat::<B>(grad);
    let grad_weight = if want_weight {
        let terms = graph.basis(x.clone(), order).into_iter().map(|term| {
            let product = B::float_matmul(B::float_transpose(flat::<B>(term)), flat_grad.clone());
            B::float_reshape(product, shape([channels, 1, out]))
        });
        B::float_reshape(B::float_cat(terms.collect(), 1), shape([channels * order, out]))
    } else {
        weight.clone()
    };
    if !want_x {
        return (x, grad_weight, grad_rows);
    }

    let mut kept_terms: Vec<FloatTensor<B>> = term_weights::<B>(weight, order)
        .into_iter()
        .map(|weight| {
            let product = B::float_matmul(flat_grad.clone(), B::float_transpose(weight));
            B::float_reshape(product, shape([batch, kept, channels]))
        })
        .collect();
    let last = kept_terms.split_off(order.max(2) - 1).pop();
    let laplacian = graph.operator.laplacian();
    if order > 2
        && let Some(last) = &last
    {
        let before = kept_terms[order - 3].clone();
        kept_terms[order - 3] = B::float_sub(before, last.clone());
    }
    let mut terms: Vec<FloatTensor<B>> =
        kept_terms.into_iter().map(|term| graph.spread(term)).collect();
    if let Some(last) = last {
        let factors = [if order > 2 { 2.0 } else { 1.0 }, 1.0];
        let base = terms[order - 2].clone();
        let kept_laplacian = graph.operator.kept_laplacian();
        terms[order - 2] = graph.accumulate(last, base, kept_laplacian, true, factors);
    }
    for k in (2..order.max(2) - 1).rev() {
        let (term, base) = (terms[k].clone(), terms[k - 1].clone());
        terms[k - 1] = graph.accumulate(term, base, laplacian, true, [2.0, 1.0]);
        terms[k - 2] = B::float_sub(terms[k - 2].clone(), terms[k].clone());
    }
    let first = terms[0].clone();
    let grad_x = match terms.get(1) {
        Some(second) => graph.accumulate(second.clone(), first, laplacian, true, [1.0, 1.0]),
        None => first,
    };
    (grad_x, grad_weight, grad_rows)
}

/// What is normalised and multiplied.
pub(crate) struct NormInputs<B: Backend> {
    pub x: FloatTensor<B>,
    pub constant: FloatTensor<B>,
    pub gamma: FloatTensor<B>,
    pub beta: FloatTensor<B>,
    pub weight: FloatTensor<B>,
}

impl<B: Backend> NormInputs<B> {
    /// Features and constant channels at every vertex.
    fn channels(&self, constant: usize) -> FloatTensor<B> {
        if constant == 0 {
            return self.x.clone();
        }
        let [batch, vertices, _] = dims::<B>(&self.x);
        let tiled = B::float_reshape(self.constant.clone(), shape([batch, 1, constant]));
        let tiled = B::float_expand(tiled, shape([batch, vertices, constant]));
        B::float_cat(vec![self.x.clone(), tiled], 2)
    }
}

pub(crate) fn norm_conv<B: GraphBackend>(
    inputs: NormInputs<B>,
    base: FloatTensor<B>,
    graph: &Graph<B>,
    spec: NormConvSpec,
) -> FloatTensor<B> {
    let NormConvSpec { order, groups, epsilon, constant, add } = spec;
    let x = inputs.channels(constant);
    let active = B::group_norm_relu(x, inputs.gamma, inputs.beta, groups, epsilon);
    convolve::<B>(active, inputs.weight, add.then_some(base), graph, order, None)
}

#[allow(clippy::type_complexity)]
pub(crate) fn norm_conv_backward<B: GraphBackend>(
    inputs: NormInputs<B>,
    grad: FloatTensor<B>,
    graph: &Graph<B>,
    spec: NormConvSpec,
) -> (FloatTensor<B>, FloatTensor<B>, FloatTensor<B>, FloatTensor<B>, FloatTensor<B>) {
    let NormConvSpec { order, groups, epsilon, constant, .. } = spec;
    let [batch, vertices, channels] = dims::<B>(&inputs.x);
    let x = inputs.channels(constant);
    let NormInputs { gamma, beta, weight, .. } = inputs;
    let active = B::group_norm_relu(x.clone(), gamma.clone(), beta.clone(), groups, epsilon);
    let spec = ConvSpec { order, rows: 0, slope: None };
    let (grad, grad_weight, _) =
        cheb_conv_backward::<B>(active, weight, x.clone(), grad, graph, spec, true, true);
    let (grad, grad_gamma, grad_beta) =
        B::group_norm_relu_backward(x, gamma, beta, grad, groups, epsilon);
    if constant == 0 {
        return (grad.clone(), grad, grad_gamma, grad_beta, grad_weight);
    }
    let part = |from: usize, to: usize| {
        let all = [(0..batch).into(), (0..vertices).into(), (from..to).into()];
        B::float_slice(grad.clone(), &all)
    };
    let grad_constant = B::float_sum_dim(part(channels, channels + constant), 1);
    let grad_constant = B::float_reshape(grad_constant, shape([batch, constant]));
    (part(0, channels), grad_constant, grad_gamma, grad_beta, grad_weight)
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

pub(crate) fn conv_end<B: Backend>(
    sum: FloatTensor<B>,
    term: FloatTensor<B>,
    rows: FloatTensor<B>,
    spec: EndSpec,
) -> FloatTensor<B> {
    let y = if spec.term { B::float_add(sum, term) } else { sum };
    let y = if spec.rows { B::float_add(y, rows) } else { y };
    match spec.slope {
        Some(slope) => gate::<B>(y.clone(), y, slope),
        None => y,
    }
}

pub(crate) fn conv_end_backward<B: Backend>(
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

/// Mean over (vertices × channels in group), spread back: `[batch, 1, channels]`.
fn group_mean<B: Backend>(x: FloatTensor<B>, groups: usize) -> FloatTensor<B> {
    let [batch, _, channels] = dims::<B>(&x);
    let width = channels / groups;
    let mean = B::float_mean_dim(x, 1);
    let mean = B::float_reshape(mean, Shape::from(vec![batch, groups, width]));
    let mean = B::float_expand(B::float_mean_dim(mean, 2), Shape::from(vec![batch, groups, width]));
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
