//! Gradients of a convolution.

use rayon::prelude::*;

use super::{
    conv::{BLOCK, Conv},
    kernel::{Epilogue, Packed, Rows, product},
    panels::Panels,
    scratch::with_scratch,
    simd,
    sparse::accumulate,
    split::{LANES, Split, add_all, vertex_sums},
};
use crate::{buffer::Buffer, conv_graph::DROPPED, ops::RequestedGradients, sparse::Csr};

/// Values of the forward pass that the gradients of [`cheb_conv`](super::cheb_conv) need.
#[derive(Clone, Copy)]
pub(in crate::backends) struct Saved<'a> {
    /// Features, `[batch, vertices, input]`.
    pub x: &'a [f32],
    /// Weights, `[input · K, output]`.
    pub weight: &'a [f32],
    /// Output with an activation, `[batch, kept, output]`; empty without.
    pub y: &'a [f32],
}

/// Gradients of [`cheb_conv`](super::cheb_conv).
pub(in crate::backends) struct ConvGradients {
    /// Gradient of the features, if requested.
    pub x: Option<Buffer>,
    /// Gradient of the weights, if requested.
    pub weight: Option<Buffer>,
    /// Gradient of the constant terms, `[batch, constant_terms, output]`.
    pub constant_terms: Buffer,
}

/// Gradients of [`cheb_conv`](super::cheb_conv) from that of its output,
/// `grad: [batch, kept, output]`.
pub(in crate::backends) fn cheb_conv_backward(
    saved: Saved,
    grad: &[f32],
    conv: Conv,
    requested: RequestedGradients,
) -> ConvGradients {
    let Saved { x, weight, y } = saved;
    let batch = x.len() / conv.inputs().max(1);
    let split = Split::new(batch);
    let mut constant_terms = Buffer::zeros(batch * conv.constant_terms * conv.output);
    let mut grad_x = requested.x.then(|| Buffer::take(x.len()));
    let mut grad_weight = requested.weight.then(|| Buffer::zeros(weight.len()));
    if batch == 0 || conv.outputs() == 0 {
        return ConvGradients { x: grad_x, weight: grad_weight, constant_terms };
    }
    let panels = if requested.x { transposed_panels(weight, conv) } else { Vec::new() };
    let backward = Backward { conv, panels: &panels, split };

    let mut inputs: Vec<Option<&mut [f32]>> = match &mut grad_x {
        Some(grad_x) => grad_x.chunks_mut(conv.inputs()).map(Some).collect(),
        None => (0..batch).map(|_| None).collect(),
    };
    let mut terms: Vec<&mut [f32]> = if conv.constant_terms > 0 {
        constant_terms.chunks_mut(conv.constant_terms * conv.output).collect()
    } else {
        (0..batch).map(|_| &mut [][..]).collect()
    };
    let weights = if requested.weight { weight.len() } else { 0 };
    let sums: Vec<Buffer> = inputs
        .par_chunks_mut(split.group())
        .zip(terms.par_chunks_mut(split.group()))
        .enumerate()
        .map(|(group, (inputs, terms))| {
            let mut sum = Buffer::zeros(weights);
            for (i, (grad_x, terms)) in inputs.iter_mut().zip(terms).enumerate() {
                let example = group * split.group() + i;
                let at = |size: usize| example * size..(example + 1) * size;
                let example = Example {
                    x: &x[at(conv.inputs())],
                    y: if conv.slope.is_some() { &y[at(conv.outputs())] } else { &[] },
                    grad: &grad[at(conv.outputs())],
                };
                let gradients = ExampleGradients {
                    x: grad_x.as_deref_mut(),
                    weight: &mut sum,
                    constant_terms: terms,
                };
                backward.run(example, gradients);
            }
            sum
        })
        .collect();
    if let Some(grad_weight) = &mut grad_weight {
        add_all(grad_weight, sums.iter().map(|sum| &**sum));
    }
    ConvGradients { x: grad_x, weight: grad_weight, constant_terms }
}

/// Panels of `W_kᵀ` for every `k`.
pub(super) fn transposed_panels(weight: &[f32], conv: Conv) -> Vec<Panels> {
    let term = |k| conv.term(weight, k).transposed();
    (0..conv.order).map(|k| Panels::pack(term(k), conv.precision)).collect()
}

/// Values of one example that its gradients are computed from.
#[derive(Clone, Copy)]
pub(super) struct Example<'a> {
    /// Features, `[vertices, input]`.
    pub x: &'a [f32],
    /// Output, `[kept, output]`, of a convolution with an activation.
    pub y: &'a [f32],
    /// Gradient of the output, `[kept, output]`.
    pub grad: &'a [f32],
}

/// Gradients that one example contributes to.
pub(super) struct ExampleGradients<'a> {
    /// Overwritten, `[vertices, input]`; `None` to skip it.
    pub x: Option<&'a mut [f32]>,
    /// Added to, `[input · K, output]`; empty to skip it.
    pub weight: &'a mut [f32],
    /// Added to, `[constant_terms, output]`.
    pub constant_terms: &'a mut [f32],
}

/// Gradients of a convolution, one example at a time.
#[derive(Clone, Copy)]
pub(super) struct Backward<'a> {
    /// Extents and graph.
    pub conv: Conv<'a>,
    /// Panels of `W_kᵀ` for every `k`; empty if no example needs the gradient of `x`.
    pub panels: &'a [Panels],
    /// Division of the work.
    pub split: Split,
}

impl Backward<'_> {
    pub(super) fn run(self, example: Example, gradients: ExampleGradients) {
        let Self { conv, panels, split } = self;
        let Example { x, y, grad } = example;
        let gated = if conv.slope.is_some() { grad.len() } else { 0 };
        with_scratch(gated, |scratch| {
            let grad = match conv.slope {
                Some(slope) => {
                    split.chunks(scratch, BLOCK * conv.output, |block, gated| {
                        let from = block * BLOCK * conv.output;
                        gate(&grad[from..], &y[from..], slope, gated);
                    });
                    &*scratch
                }
                None => grad,
            };
            constant_gradient(grad, conv, split, gradients.constant_terms);
            if !gradients.weight.is_empty() {
                weight_gradient(x, grad, conv, split, gradients.weight);
            }
            if let Some(grad_x) = gradients.x {
                input_gradient(grad, panels, conv, split, grad_x);
            }
        });
    }
}

/// Gradient before a leaky ReLU from its output `y`.
fn gate(grad: &[f32], y: &[f32], slope: f32, out: &mut [f32]) {
    simd(
        #[inline(always)]
        || {
            for ((out, grad), y) in out.iter_mut().zip(grad).zip(y) {
                *out = if *y > 0.0 { *grad } else { slope * grad };
            }
        },
    );
}

/// Adds `Σ_v T_r(L̃)1[v] · g[v]` to the gradient of every constant term.
fn constant_gradient(grad: &[f32], conv: Conv, split: Split, out: &mut [f32]) {
    if conv.constant_terms == 0 {
        return;
    }
    let (count, output) = (conv.constant_terms, conv.output);
    let basis = conv.graph.constant_basis(count);
    for (r, out) in out.chunks_exact_mut(output).enumerate() {
        let [totals] = vertex_sums(
            grad.len() / output,
            output,
            split,
            #[inline(always)]
            |[total]: &mut [[f32; LANES]; 1], v, c, width| {
                let grad = &grad[v * output + c..][..width];
                let factor = basis[v * count + r];
                for (total, grad) in total[..width].iter_mut().zip(grad) {
                    *total += factor * grad;
                }
            },
        );
        for (out, total) in out.iter_mut().zip(totals) {
            *out += total as f32;
        }
    }
}

/// Adds `Σ_v T_k(L̃)x[v]ᵀ g[v]` to the rows `c · K + k` of the weights' gradient.
fn weight_gradient(x: &[f32], grad: &[f32], conv: Conv, split: Split, out: &mut [f32]) {
    let kept = conv.kept();
    with_scratch(conv.whole(), |whole| {
        conv.whole_terms(x, whole, split);
        let whole = &*whole;
        let rows = Packed::most_rows(conv.outer_instructions());
        let blocks = kept.div_ceil(rows);
        let part = blocks.div_ceil(split.parts());
        let range = |i: usize| i * part..((i + 1) * part).min(blocks);
        let parts = blocks.div_ceil(part);
        // The first part is added in place, the others to sums of their own.
        let mut others: Vec<Buffer> = (1..parts).map(|_| Buffer::zeros(out.len())).collect();
        let sums: Vec<&mut [f32]> =
            std::iter::once(&mut *out).chain(others.iter_mut().map(|sum| &mut **sum)).collect();
        let work = |(i, sum): (usize, &mut [f32])| {
            for block in range(i) {
                outer_block(x, whole, grad, conv, block * rows, sum);
            }
        };
        if parts > 1 {
            sums.into_par_iter().enumerate().for_each(work);
        } else {
            sums.into_iter().enumerate().for_each(work);
        }
        add_all(out, others.iter().map(|sum| &**sum));
    });
}

/// Adds the contribution of the vertices of a block from `first` on.
fn outer_block(x: &[f32], whole: &[f32], grad: &[f32], conv: Conv, first: usize, out: &mut [f32]) {
    let by = conv.outer_instructions();
    let rows = Packed::most_rows(by).min(conv.kept() - first);
    let last = if conv.order > 1 { rows * conv.input } else { 0 };
    with_scratch(Packed::scratch(conv.input, conv.output, by) + last, |scratch| {
        let (term, scratch) = scratch.split_at_mut(last);
        let mut packed = Packed::new(scratch, conv.input, conv.output, by);
        packed.pack_right(rows, Rows::new(grad, conv.output).from(first));
        for k in 0..conv.order {
            if k > 0 && k + 1 == conv.order {
                conv.last_term(first, x, whole, term);
                packed.pack_left(rows, Rows::new(term, conv.input));
            } else {
                packed.pack_left(rows, conv.kept_term(k, x, whole).from(first));
            }
            packed.outer(rows, conv.order * conv.output, &mut out[k * conv.output..]);
        }
    });
}

/// `Σ_k T_k(L̃)ᵀ Dᵀ g W_kᵀ`, by the recurrence run backwards.
fn input_gradient(grad: &[f32], panels: &[Panels], conv: Conv, split: Split, out: &mut [f32]) {
    let (kept, input) = (conv.kept() * conv.input, conv.input);
    let block = BLOCK * input;
    let times = |k: usize, out: &mut [f32]| {
        split.chunks(out, block, |i, out| {
            product(
                Rows::new(grad, conv.output).from(i * BLOCK),
                &panels[k],
                false,
                Epilogue::default(),
                out,
            );
        });
    };
    let Some(pool) = conv.graph.pool() else {
        let a = conv.graph.laplacian().transpose();
        times(0, out);
        with_scratch((conv.order - 1) * kept, |terms| {
            for (k, term) in terms.chunks_exact_mut(kept).enumerate() {
                times(k + 1, term);
            }
            fold(a, terms, conv, split, out);
        });
        return;
    };

    // At the kept vertices first, then scattered to all.
    with_scratch(conv.order * kept + conv.whole(), |scratch| {
        let (at_kept, terms) = scratch.split_at_mut(conv.order * kept);
        for (k, term) in at_kept.chunks_exact_mut(kept).enumerate() {
            times(k, term);
        }
        let a = pool.laplacian.transpose();
        let scatter = |from: &[f32], last: Option<(f32, &[f32])>, out: &mut [f32]| {
            split.chunks(out, block, |i, out| {
                for (v, out) in out.chunks_exact_mut(input).enumerate() {
                    match pool.place[i * BLOCK + v] {
                        DROPPED => out.fill(0.0),
                        place => out.copy_from_slice(&from[place as usize * input..][..input]),
                    }
                }
                if let Some((factor, last)) = last {
                    accumulate(a, i * BLOCK, factor, last, input, out);
                }
            });
        };
        let (before, last) = at_kept.split_at_mut((conv.order - 1) * kept);
        match conv.order {
            1 => scatter(last, None, out),
            2 => scatter(before, Some((1.0, last)), out),
            order => {
                for (before, last) in before[(order - 3) * kept..].iter_mut().zip(&*last) {
                    *before -= last;
                }
                scatter(&before[..kept], None, out);
                for k in 1..order - 1 {
                    let term = &mut terms[(k - 1) * conv.inputs()..][..conv.inputs()];
                    let last = (k + 2 == order).then_some((2.0, &*last));
                    scatter(&before[k * kept..][..kept], last, term);
                }
                fold(conv.graph.laplacian().transpose(), terms, conv, split, out);
            }
        }
    });
}

/// `out += T_1(L̃)ᵀ terms_1 + T_2(L̃)ᵀ terms_2 + …`.
fn fold(a: &Csr, terms: &mut [f32], conv: Conv, split: Split, out: &mut [f32]) {
    let (n, input) = (conv.inputs(), conv.input);
    let count = terms.len() / n.max(1);
    for k in (2..=count).rev() {
        let (lower, upper) = terms.split_at_mut((k - 1) * n);
        let upper = &upper[..n];
        let (rest, below) = lower.split_at_mut((k - 2) * n);
        split.chunks(below, BLOCK * input, |i, below| {
            accumulate(a, i * BLOCK, 2.0, upper, input, below);
        });
        let two_below = if k == 2 { &mut *out } else { &mut rest[(k - 3) * n..] };
        split.chunks(two_below, BLOCK * input, |i, out| {
            let upper = &upper[i * BLOCK * input..];
            out.iter_mut().zip(upper).for_each(|(out, upper)| *out -= upper);
        });
    }
    if count > 0 {
        split.chunks(out, BLOCK * input, |i, out| {
            accumulate(a, i * BLOCK, 1.0, &terms[..n], input, out);
        });
    }
}
