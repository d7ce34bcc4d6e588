//! Group normalisation, ReLU and convolution, without the normalised features in memory.

use rayon::prelude::*;

use super::{
    conv::{self, BLOCK, Conv},
    conv_backward::{self, Example, transposed_panels},
    kernel::{Rows, product},
    norm::{Affine, Norm, Statistics, Sums},
    panels::Panels,
    scratch::with_scratch,
    split::{Split, add_all},
};
use crate::buffer::Buffer;

/// `cheb_conv(relu(group_norm([x, constant])))`: the constant channels, of which only a 1×1
/// convolution may have any, are the same at every vertex.
#[derive(Clone, Copy)]
pub(in crate::backends) struct NormConv<'a> {
    /// The normalisation.
    pub norm: Norm,
    /// The convolution of the features, without rows and activation.
    pub conv: Conv<'a>,
}

/// Constants and parameters.
#[derive(Clone, Copy)]
pub(in crate::backends) struct Inputs<'a> {
    /// `[batch, vertices, channels]`.
    pub x: &'a [f32],
    /// `[batch, constant]`.
    pub constant: &'a [f32],
    /// `[channels + constant]`.
    pub gamma: &'a [f32],
    /// `[channels + constant]`.
    pub beta: &'a [f32],
    /// `[(channels + constant) · K, output]`.
    pub weight: &'a [f32],
}

/// Gradients of [`norm_conv`].
pub(in crate::backends) struct NormConvGradients {
    /// Of the features.
    pub x: Buffer,
    /// Of the constant channels.
    pub constant: Buffer,
    /// Of the scale.
    pub gamma: Vec<f32>,
    /// Of the shift.
    pub beta: Vec<f32>,
    /// Of the weights.
    pub weight: Buffer,
}

impl<'a> NormConv<'a> {
    /// The convolution of the features, with the constant channels' row if there are any.
    fn features(&self) -> Conv<'a> {
        Conv { rows: usize::from(self.norm.constant > 0), ..self.conv }
    }

    /// Numbers of the features' weights; those of the constant channels follow.
    fn feature_weights(&self) -> usize {
        self.conv.input * self.conv.order * self.conv.output
    }

    fn example<'i>(&self, inputs: Inputs<'i>, example: usize) -> (&'i [f32], &'i [f32]) {
        let (n, constant) = (self.conv.inputs(), self.norm.constant);
        (&inputs.x[example * n..][..n], &inputs.constant[example * constant..][..constant])
    }

    /// What the constant channels add at every vertex.
    fn row(&self, active: &[f32], weight: &[f32]) -> Vec<f32> {
        let output = self.conv.output;
        let mut row = vec![0.0; if active.is_empty() { 0 } else { output }];
        let weights = weight[self.feature_weights()..].chunks_exact(output);
        for (active, weights) in active.iter().zip(weights) {
            row.iter_mut().zip(weights).for_each(|(row, weight)| *row += active * weight);
        }
        row
    }
}

/// Writes `cheb_conv(relu(group_norm([x, constant])))` to `y`, or adds it to `add`.
pub(in crate::backends) fn norm_conv(inputs: Inputs, op: NormConv, add: bool, y: &mut [f32]) {
    let NormConv { norm, .. } = op;
    let conv = op.features();
    if y.is_empty() {
        return;
    }
    let affine = Affine { gamma: inputs.gamma, beta: inputs.beta };
    let panels = conv.panels(inputs.weight);
    let split = Split::new(inputs.x.len() / conv.inputs().max(1));
    y.par_chunks_mut(conv.outputs()).enumerate().for_each(|(example, y)| {
        let (x, constant) = op.example(inputs, example);
        let statistics = norm.statistics(x, constant, split);
        let (active, _) = norm.apply_constant(constant, &statistics, affine);
        let row = op.row(&active, inputs.weight);
        if conv.order > 1 || conv.index().is_some() {
            with_scratch(conv.inputs(), |scratch| {
                apply(norm, x, &statistics, affine, split, scratch);
                conv::forward(scratch, &panels, &row, add, conv, split, y);
            });
        } else {
            let apply = |x: &[f32], out: &mut [f32]| norm.apply(x, &statistics, affine, out);
            blockwise(x, &panels[0], &row, add, conv, split, y, apply);
        }
    });
}

/// A 1×1 convolution of what `apply` makes of `x`, block by block.
#[allow(clippy::too_many_arguments)]
fn blockwise(
    x: &[f32],
    panels: &Panels,
    row: &[f32],
    add: bool,
    conv: Conv,
    split: Split,
    y: &mut [f32],
    apply: impl Fn(&[f32], &mut [f32]) + Sync,
) {
    split.chunks(y, BLOCK * conv.output, |block, y| {
        let size = y.len() / conv.output * conv.input;
        with_scratch(size, |scratch| {
            apply(&x[block * BLOCK * conv.input..][..size], scratch);
            let (end, _) = conv.end(row);
            product(Rows::new(scratch, conv.input), panels, add, end, y);
        });
    });
}

fn apply(norm: Norm, x: &[f32], by: &Statistics, affine: Affine, split: Split, out: &mut [f32]) {
    let block = BLOCK * norm.channels;
    split.chunks(out, block, |i, out| {
        norm.apply(&x[i * block..][..out.len()], by, affine, out);
    });
}

/// Gradients of [`norm_conv`].
pub(in crate::backends) fn norm_conv_backward(
    inputs: Inputs,
    grad: &[f32],
    op: NormConv,
) -> NormConvGradients {
    let NormConv { norm, .. } = op;
    let conv = op.features();
    let batch = inputs.x.len() / conv.inputs().max(1);
    let split = Split::new(batch);
    let mut grad_x = Buffer::take(inputs.x.len());
    let mut grad_constant = Buffer::take(batch * norm.constant);
    let mut grad_weight = Buffer::zeros(inputs.weight.len());
    let panels = transposed_panels(inputs.weight, conv);
    let mut constants: Vec<&mut [f32]> = if norm.constant > 0 {
        grad_constant.chunks_mut(norm.constant).collect()
    } else {
        (0..batch).map(|_| &mut [][..]).collect()
    };
    let parts: Vec<(Buffer, Vec<Sums>)> = grad_x
        .par_chunks_mut((split.group() * conv.inputs()).max(1))
        .zip(constants.par_chunks_mut(split.group()))
        .enumerate()
        .map(|(group, (grad_x, constants))| {
            let mut sum = Buffer::zeros(inputs.weight.len());
            let examples = grad_x.chunks_mut(conv.inputs()).zip(constants).enumerate();
            let sums = examples.map(|(i, (grad_x, grad_constant))| {
                let example = group * split.group() + i;
                let grad = &grad[example * conv.outputs()..][..conv.outputs()];
                let (x, constant) = op.example(inputs, example);
                let weights = Weights { all: inputs.weight, transposed: &panels };
                let affine = Affine { gamma: inputs.gamma, beta: inputs.beta };
                let out = Outputs { x: grad_x, constant: grad_constant, weight: &mut sum };
                backward(x, constant, affine, weights, grad, op, split, out)
            });
            let sums = sums.collect();
            (sum, sums)
        })
        .collect();
    add_all(&mut grad_weight, parts.iter().map(|(sum, _)| &**sum));
    let sums: Vec<Sums> = parts.into_iter().flat_map(|(_, sums)| sums).collect();
    let (gamma, beta) = Sums::total(&sums, norm.all_channels());
    NormConvGradients { x: grad_x, constant: grad_constant, gamma, beta, weight: grad_weight }
}

#[derive(Clone, Copy)]
struct Weights<'a> {
    all: &'a [f32],
    transposed: &'a [Panels],
}

struct Outputs<'a> {
    x: &'a mut [f32],
    constant: &'a mut [f32],
    weight: &'a mut [f32],
}

/// One example; returns the gradients of scale and shift.
#[allow(clippy::too_many_arguments)]
fn backward(
    x: &[f32],
    constant: &[f32],
    affine: Affine,
    weights: Weights,
    grad: &[f32],
    op: NormConv,
    split: Split,
    out: Outputs,
) -> Sums {
    let NormConv { norm, .. } = op;
    let conv = op.features();
    let statistics = norm.statistics(x, constant, split);
    with_scratch(conv.inputs(), |active| {
        apply(norm, x, &statistics, affine, split, active);
        let active = &*active;
        let example = Example { x: active, y: &[], grad };
        let (weight, constant_weight) = out.weight.split_at_mut(op.feature_weights());
        let mut row = vec![0.0; conv.rows * conv.output];
        conv_backward::backward(
            example,
            weights.transposed,
            conv,
            split,
            Some(&mut *out.x),
            weight,
            &mut row,
        );
        let mut sums = norm.sums(x, active, out.x, &statistics, split);

        let (active_constant, units) = norm.apply_constant(constant, &statistics, affine);
        let constant_weights = weights.all[op.feature_weights()..].chunks_exact(conv.output);
        for (c, ((&active, &unit), weight)) in
            active_constant.iter().zip(&units).zip(constant_weights).enumerate()
        {
            let product: f64 =
                row.iter().zip(weight).map(|(row, weight)| f64::from(row * weight)).sum();
            let gated = if active > 0.0 { product } else { 0.0 };
            sums.beta.push(gated);
            sums.gamma.push(gated * f64::from(unit));
            let grad_weight = &mut constant_weight[c * conv.output..][..conv.output];
            grad_weight.iter_mut().zip(&row).for_each(|(grad, row)| *grad += active * row);
        }

        let (first, second) = norm.means(&sums, affine);
        let gradient =
            norm.constant_gradient(&units, &statistics, affine, &sums, (&first, &second));
        out.constant.copy_from_slice(&gradient);
        let block = BLOCK * norm.channels;
        split.chunks(out.x, block, |i, grad| {
            let at = i * block..i * block + grad.len();
            let (x, active) = (&x[at.clone()], &active[at]);
            norm.input_gradient(x, active, &statistics, affine, (&first, &second), grad);
        });
        sums
    })
}
