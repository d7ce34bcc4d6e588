//! Layers of the networks as nodes of a graph. Features are `[batch, vertices, channels]`, conditions
//! `[batch, size]`.

use burn::nn::Linear;
use cape_core::tensors::to_host;
use cape_model::{
    ConditionNet, LEAKY_SLOPE,
    layers::{ChebConv, GroupNormRelu},
};

use crate::{
    Result,
    graph::{Attribute, GraphBuilder, Value},
    sparse::LevelGraph,
};

/// Weights of a convolution on the host.
pub(crate) struct HostConv {
    pub(crate) order: usize,
    /// Channels of the output.
    pub(crate) out: usize,
    /// `W`, `[channels · order, out]`, row `channel · order + k`.
    values: Vec<f32>,
}

impl HostConv {
    pub(crate) fn new(conv: &ChebConv) -> Self {
        let weight = conv.weight.val();
        let [_, out] = weight.dims();
        Self { order: conv.order(), out, values: to_host(weight) }
    }

    /// Channels of the input.
    pub(crate) fn channels(&self) -> usize {
        self.values.len() / (self.order * self.out)
    }

    /// `W_k` of some channels, `[channels, out]`.
    fn term(&self, k: usize, channels: std::ops::Range<usize>) -> Vec<f32> {
        let rows = channels.map(|channel| (channel * self.order + k) * self.out);
        rows.flat_map(|start| self.values[start..start + self.out].iter().copied()).collect()
    }
}

/// `x W_k + condition W'_k` for every term of every convolution, in their order, where `condition` is
/// further channels that are equal at all vertices, and `up` interpolates the result.
pub(crate) fn products(
    graph: &mut GraphBuilder,
    convs: &[&HostConv],
    x: &Value,
    condition: Option<(&Value, usize)>,
    up: impl FnOnce(&mut GraphBuilder, &Value) -> Value,
) -> Result<Vec<Value>> {
    let size = condition.map_or(0, |(_, size)| size);
    let terms: Vec<(&HostConv, usize)> =
        convs.iter().flat_map(|conv| (0..conv.order).map(move |k| (*conv, k))).collect();
    let (out, features) = (convs[0].out, convs[0].channels() - size);
    // The matrices of all terms side by side.
    let beside = |channels: std::ops::Range<usize>| {
        let mut matrix = Vec::with_capacity(channels.len() * terms.len() * out);
        for channel in channels {
            for (conv, k) in &terms {
                matrix.extend(conv.term(*k, channel..channel + 1));
            }
        }
        matrix
    };
    let width = terms.len() * out;
    let matrix = graph.weights("conv", &[features, width], &beside(0..features))?;
    let mut y = graph.matmul(x, &matrix);
    if let Some((condition, _)) = condition {
        let rows = beside(features..features + size);
        let matrix = graph.weights("conv", &[size, width], &rows)?;
        let constant = graph.matmul(condition, &matrix);
        let constant = graph.reshape(&constant, &[1, width]);
        y = graph.add(&y, &constant);
    }
    let y = up(graph, &y);
    Ok(graph.split(&y, terms.len(), 2))
}

/// `Σ_k T_k(L̃) p_k` by Clenshaw's recurrence, with products `p_k` of the terms' weights.
pub(crate) fn chebyshev_sum(
    graph: &mut GraphBuilder,
    products: &[Value],
    level: &LevelGraph,
) -> Value {
    let (mut before, mut last) = (None, products[products.len() - 1].clone());
    for (k, product) in products.iter().enumerate().rev().skip(1) {
        let mut moved = level.apply(graph, &last);
        if k > 0 {
            moved = graph.scale(&moved, 2.0);
        }
        let mut next = graph.add(product, &moved);
        if let Some(before) = &before {
            next = graph.sub(&next, before);
        }
        (before, last) = (Some(last), next);
    }
    last
}

/// Convolution whose polynomials are applied before the weights, at the rows that `kept` keeps, if
/// given: cheaper than [`chebyshev_sum`] where there are more output than input channels.
pub(crate) fn convolve(
    graph: &mut GraphBuilder,
    conv: &HostConv,
    x: &Value,
    level: &LevelGraph,
    kept: Option<(&LevelGraph, &[usize])>,
) -> Result<Value> {
    let (mut terms, mut sum): (Vec<Value>, Option<Value>) = (Vec::new(), None);
    for k in 0..conv.order {
        let last = k + 1 == conv.order;
        let select = |graph: &mut GraphBuilder, value: &Value| match kept {
            Some((_, rows)) => graph.select(value, rows, 1),
            None => value.clone(),
        };
        let at_rows = if k == 0 {
            terms.push(x.clone());
            select(graph, x)
        } else {
            // The last term is needed at the kept rows alone.
            let kept_level = kept.filter(|_| last).map(|(level, _)| level);
            let mut next = kept_level.unwrap_or(level).apply(graph, &terms[k - 1]);
            if k > 1 {
                next = graph.scale(&next, 2.0);
                let before = terms[k - 2].clone();
                let before = if last { select(graph, &before) } else { before };
                next = graph.sub(&next, &before);
            }
            terms.push(next.clone());
            if last { next } else { select(graph, &next) }
        };
        let weights = conv.term(k, 0..conv.channels());
        let weights = graph.weights("conv", &[conv.channels(), conv.out], &weights)?;
        let product = graph.matmul(&at_rows, &weights);
        sum = Some(match sum {
            Some(sum) => graph.add(&sum, &product),
            None => product,
        });
    }
    Ok(sum.unwrap_or_else(|| x.clone()))
}

/// `x W + b` of `[batch, input]`.
pub(crate) fn linear(graph: &mut GraphBuilder, layer: &Linear, x: &Value) -> Result<Value> {
    let weight = layer.weight.val();
    let shape = weight.dims();
    let weight = graph.weights("linear", &shape, &to_host(weight))?;
    let product = graph.matmul(x, &weight);
    let Some(bias) = &layer.bias else { return Ok(product) };
    let bias = graph.weights("bias", &shape[1..], &to_host(bias.val()))?;
    Ok(graph.add(&product, &bias))
}

/// A condition net: the embedding of `x`.
pub(crate) fn embedding(graph: &mut GraphBuilder, net: &ConditionNet, x: &Value) -> Result<Value> {
    let mut x = x.clone();
    if let Some(hidden) = &net.hidden {
        x = linear(graph, hidden, &x)?;
        x = leaky_relu(graph, &x);
    }
    linear(graph, &net.output, &x)
}

pub(crate) fn relu(graph: &mut GraphBuilder, x: &Value) -> Value {
    graph.apply("Relu", &[x], &[])
}

pub(crate) fn leaky_relu(graph: &mut GraphBuilder, x: &Value) -> Value {
    graph.apply("LeakyRelu", &[x], &[("alpha", Attribute::Float(LEAKY_SLOPE as f32))])
}

/// Bias for each channel, then leaky ReLU.
pub(crate) fn bias_leaky_relu(
    graph: &mut GraphBuilder,
    x: &Value,
    bias: Vec<f32>,
) -> Result<Value> {
    let bias = graph.weights("bias", &[bias.len()], &bias)?;
    let x = graph.add(x, &bias);
    Ok(leaky_relu(graph, &x))
}

/// The condition as further channels at every one of `vertices` vertices.
pub(crate) fn append(
    graph: &mut GraphBuilder,
    x: &Value,
    condition: Option<(&Value, usize)>,
    vertices: usize,
) -> Value {
    let Some((condition, size)) = condition else { return x.clone() };
    let condition = graph.reshape(condition, &[1, size]);
    let condition = graph.expand(&condition, &[1, vertices, 1]);
    graph.concat(&[x.clone(), condition], 2)
}

/// Group normalisation over vertices and the channels of a group, then ReLU.
pub(crate) fn group_norm_relu(
    graph: &mut GraphBuilder,
    norm: &GroupNormRelu,
    x: &Value,
) -> Result<Value> {
    let gamma = to_host(norm.gamma.val());
    let (channels, groups) = (gamma.len(), norm.groups());
    let grouped = [groups, channels / groups];
    // Means over a group, from means of its channels.
    let group_mean = |graph: &mut GraphBuilder, x: &Value| {
        let mean = graph.reduce("ReduceMean", x, 1, true);
        let mean = graph.reshape(&mean, &grouped);
        graph.reduce("ReduceMean", &mean, 2, true)
    };
    let mean = group_mean(graph, x);
    let mean = graph.expand(&mean, &[1, grouped[0], grouped[1]]);
    let mean = graph.reshape(&mean, &[1, channels]);
    let centred = graph.sub(x, &mean);
    let squared = graph.mul(&centred, &centred);
    let variance = group_mean(graph, &squared);
    let epsilon = graph.scalar(GroupNormRelu::EPSILON as f32);
    let variance = graph.add(&variance, &epsilon);
    let deviation = graph.apply("Sqrt", &[&variance], &[]);
    let gamma = graph.weights("gamma", &grouped, &gamma)?;
    let factor = graph.div(&gamma, &deviation);
    let factor = graph.reshape(&factor, &[1, channels]);
    let scaled = graph.mul(&centred, &factor);
    let beta = graph.weights("beta", &[channels], &to_host(norm.beta.val()))?;
    let shifted = graph.add(&scaled, &beta);
    Ok(relu(graph, &shifted))
}
