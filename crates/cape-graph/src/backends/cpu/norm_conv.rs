//! Group normalisation, ReLU and convolution, without the normalised features in memory.

use rayon::prelude::*;

use super::{
    conv::{BLOCK, Conv, Forward},
    conv_backward::{self, Example, ExampleGradients, transposed_panels},
    norm::{Affine, Norm, Statistics, Sums},
    panels::Panels,
    scratch::with_scratch,
    split::{Split, add_all},
};
use crate::buffer::Buffer;

/// Extents of `cheb_conv(relu(group_norm([x, constant])))`. The constant channels, which only a 1×1
/// convolution may have, are the same at every vertex.
#[derive(Clone, Copy)]
pub(in crate::backends) struct NormConv<'a> {
    /// Normalisation.
    pub norm: Norm,
    /// Convolution of the features, without constant terms and activation.
    pub conv: Conv<'a>,
}

/// Inputs and parameters of [`norm_conv`].
#[derive(Clone, Copy)]
pub(in crate::backends) struct Inputs<'a> {
    /// Features, `[batch, vertices, channels]`.
    pub x: &'a [f32],
    /// Constant channels, `[batch, constant]`.
    pub constant: &'a [f32],
    /// Scale, `[channels + constant]`.
    pub gamma: &'a [f32],
    /// Shift, `[channels + constant]`.
    pub beta: &'a [f32],
    /// Weights, `[(channels + constant) · K, output]`.
    pub weight: &'a [f32],
}

/// Gradients of [`norm_conv`], each with the shape of its input.
pub(in crate::backends) struct NormConvGradients {
    /// Gradient of the features.
    pub x: Buffer,
    /// Gradient of the constant channels.
    pub constant: Buffer,
    /// Gradient of the scale.
    pub gamma: Vec<f32>,
    /// Gradient of the shift.
    pub beta: Vec<f32>,
    /// Gradient of the weights.
    pub weight: Buffer,
}

impl<'a> Inputs<'a> {
    fn affine(&self) -> Affine<'a> {
        Affine { gamma: self.gamma, beta: self.beta }
    }
}

impl<'a> NormConv<'a> {
    /// The convolution of the features, with the constant channels as a constant term.
    fn features(&self) -> Conv<'a> {
        Conv { constant_terms: usize::from(self.norm.constant > 0), ..self.conv }
    }

    /// Number of weights of the features; those of the constant channels follow.
    fn feature_weights(&self) -> usize {
        self.conv.input * self.conv.order * self.conv.output
    }

    /// Features and constant channels of one example.
    fn example<'i>(&self, inputs: Inputs<'i>, example: usize) -> (&'i [f32], &'i [f32]) {
        let (n, constant) = (self.conv.inputs(), self.norm.constant);
        (&inputs.x[example * n..][..n], &inputs.constant[example * constant..][..constant])
    }

    /// Constant term of the active constant channels, `[output]`; empty without any.
    fn constant_term(&self, active: &[f32], weight: &[f32]) -> Vec<f32> {
        let output = self.conv.output;
        let mut term = vec![0.0; if active.is_empty() { 0 } else { output }];
        let weights = weight[self.feature_weights()..].chunks_exact(output);
        for (active, weights) in active.iter().zip(weights) {
            term.iter_mut().zip(weights).for_each(|(term, weight)| *term += active * weight);
        }
        term
    }
}

/// Writes `cheb_conv(relu(group_norm([x, constant])))` to `y: [batch, kept, output]` or, if `add`,
/// adds it.
pub(in crate::backends) fn norm_conv(inputs: Inputs, op: NormConv, add: bool, y: &mut [f32]) {
    let NormConv { norm, .. } = op;
    let conv = op.features();
    if y.is_empty() {
        return;
    }
    let affine = inputs.affine();
    let panels = conv.panels(inputs.weight);
    let split = Split::new(inputs.x.len() / conv.inputs().max(1));
    y.par_chunks_mut(conv.outputs()).enumerate().for_each(|(example, y)| {
        let (x, constant) = op.example(inputs, example);
        let statistics = norm.statistics(x, constant, split);
        let (active, _) = norm.apply_constant(constant, &statistics, affine);
        let constant_terms = &op.constant_term(&active, inputs.weight);
        let forward = Forward { conv, panels: &panels, constant_terms, add, split };
        if conv.order > 1 || conv.index().is_some() {
            with_scratch(conv.inputs(), |scratch| {
                apply(norm, x, &statistics, affine, split, scratch);
                forward.run(scratch, y);
            });
        } else {
            forward.run_blockwise(x, y, |x, out| norm.apply(x, &statistics, affine, out));
        }
    });
}

/// [`Norm::apply`] to all vertices of an example.
fn apply(norm: Norm, x: &[f32], by: &Statistics, affine: Affine, split: Split, out: &mut [f32]) {
    let block = BLOCK * norm.channels;
    split.chunks(out, block, |i, out| {
        norm.apply(&x[i * block..][..out.len()], by, affine, out);
    });
}

/// Gradients of [`norm_conv`] from that of its output, `grad: [batch, kept, output]`.
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
    let backward = Backward { op, inputs, panels: &panels, split };
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
                let out = Outputs { x: grad_x, constant: grad_constant, weight: &mut sum };
                backward.run(example, grad, out)
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

/// Gradients that one example contributes to.
struct Outputs<'a> {
    /// Overwritten, `[vertices, channels]`.
    x: &'a mut [f32],
    /// Overwritten, `[constant]`.
    constant: &'a mut [f32],
    /// Added to, `[(channels + constant) · K, output]`.
    weight: &'a mut [f32],
}

/// Gradients of a normalised convolution, one example at a time.
#[derive(Clone, Copy)]
struct Backward<'a> {
    op: NormConv<'a>,
    inputs: Inputs<'a>,
    /// Panels of `W_kᵀ` for every `k`.
    panels: &'a [Panels],
    split: Split,
}

impl Backward<'_> {
    /// Returns the sums that the gradients of scale and shift consist of.
    fn run(self, example: usize, grad: &[f32], out: Outputs) -> Sums {
        let Self { op, inputs, panels, split } = self;
        let (norm, conv, affine) = (op.norm, op.features(), inputs.affine());
        let (x, constant) = op.example(inputs, example);
        let statistics = norm.statistics(x, constant, split);
        with_scratch(conv.inputs(), |active| {
            apply(norm, x, &statistics, affine, split, active);
            let active = &*active;
            let (weight, constant_weight) = out.weight.split_at_mut(op.feature_weights());
            let mut term = vec![0.0; conv.constant_terms * conv.output];
            conv_backward::Backward { conv, panels, split }.run(
                Example { x: active, y: &[], grad },
                ExampleGradients { x: Some(&mut *out.x), weight, constant_terms: &mut term },
            );
            let mut sums = norm.sums(x, active, out.x, &statistics, split);

            let (active_constant, units) = norm.apply_constant(constant, &statistics, affine);
            let weights = inputs.weight[op.feature_weights()..].chunks_exact(conv.output);
            for (c, ((&active, &unit), weight)) in
                active_constant.iter().zip(&units).zip(weights).enumerate()
            {
                let product: f64 =
                    term.iter().zip(weight).map(|(term, weight)| f64::from(term * weight)).sum();
                let gated = if active > 0.0 { product } else { 0.0 };
                sums.beta.push(gated);
                sums.gamma.push(gated * f64::from(unit));
                let grad_weight = &mut constant_weight[c * conv.output..][..conv.output];
                grad_weight.iter_mut().zip(&term).for_each(|(grad, term)| *grad += active * term);
            }

            let means = norm.means(&sums, affine);
            out.constant.copy_from_slice(&norm.constant_gradient(
                &units,
                &statistics,
                affine,
                &sums,
                &means,
            ));
            let block = BLOCK * norm.channels;
            split.chunks(out.x, block, |i, grad| {
                let at = i * block..i * block + grad.len();
                let (x, active) = (&x[at.clone()], &active[at]);
                norm.input_gradient(x, active, &statistics, affine, &means, grad);
            });
            sums
        })
    }
}
