//! The gradients of a convolution.

use rayon::prelude::*;

use super::{
    conv::{BLOCK, Conv},
    kernel::{End, OUTER_ROWS, Packed, Rows, product},
    panels::Panels,
    scratch::with_scratch,
    simd,
    sparse::accumulate,
    split::{LANES, Split, add_all, vertex_sums},
};
use crate::{buffer::Buffer, operator::DROPPED, sparse::Csr};

/// Gradients of [`cheb_conv`](super::cheb_conv).
pub(in crate::backends) struct ConvGradients {
    /// Of `x`, if wanted.
    pub x: Option<Buffer>,
    /// Of the weights; empty if not wanted.
    pub weight: Buffer,
    /// Of the rows, of each example separately: `[batch, rows, output]`.
    pub rows: Buffer,
}

/// Gradients of [`cheb_conv`](super::cheb_conv), from its output `y` if it has an activation.
pub(in crate::backends) fn cheb_conv_backward(
    x: &[f32],
    weight: &[f32],
    y: &[f32],
    grad: &[f32],
    conv: Conv,
    want_x: bool,
    want_weight: bool,
) -> ConvGradients {
    let batch = x.len() / conv.inputs().max(1);
    let split = Split::new(batch);
    let mut rows = Buffer::zeros(batch * conv.rows * conv.output);
    let mut grad_x = want_x.then(|| Buffer::take(x.len()));
    let weights = if want_weight { weight.len() } else { 0 };
    let mut grad_weight = Buffer::zeros(weights);
    if batch == 0 || conv.outputs() == 0 {
        return ConvGradients { x: grad_x, weight: grad_weight, rows };
    }
    let panels = if want_x { transposed_panels(weight, conv) } else { Vec::new() };

    let mut inputs: Vec<Option<&mut [f32]>> = match &mut grad_x {
        Some(grad_x) => grad_x.chunks_mut(conv.inputs()).map(Some).collect(),
        None => (0..batch).map(|_| None).collect(),
    };
    let mut row_gradients: Vec<&mut [f32]> = if conv.rows > 0 {
        rows.chunks_mut(conv.rows * conv.output).collect()
    } else {
        (0..batch).map(|_| &mut [][..]).collect()
    };
    let sums: Vec<Buffer> = inputs
        .par_chunks_mut(split.group())
        .zip(row_gradients.par_chunks_mut(split.group()))
        .enumerate()
        .map(|(group, (inputs, rows))| {
            let mut sum = Buffer::zeros(weights);
            for (i, (grad_x, rows)) in inputs.iter_mut().zip(rows).enumerate() {
                let example = group * split.group() + i;
                let at = |size: usize| example * size..(example + 1) * size;
                let example = Example {
                    x: &x[at(conv.inputs())],
                    y: if conv.slope.is_some() { &y[at(conv.outputs())] } else { &[] },
                    grad: &grad[at(conv.outputs())],
                };
                backward(example, &panels, conv, split, grad_x.as_deref_mut(), &mut sum, rows);
            }
            sum
        })
        .collect();
    add_all(&mut grad_weight, sums.iter().map(|sum| &**sum));
    ConvGradients { x: grad_x, weight: grad_weight, rows }
}

/// Panels of `W_kᵀ` for every `k`.
pub(super) fn transposed_panels(weight: &[f32], conv: Conv) -> Vec<Panels> {
    (0..conv.order).map(|k| Panels::pack(conv.term(weight, k).transposed())).collect()
}

/// What the gradients of one example are computed from.
#[derive(Clone, Copy)]
pub(super) struct Example<'a> {
    pub x: &'a [f32],
    /// The output, with an activation.
    pub y: &'a [f32],
    pub grad: &'a [f32],
}

/// Gradients of one example: that of `x` is written, the others are added to; nothing is computed
/// for weights of length 0.
pub(super) fn backward(
    example: Example,
    panels: &[Panels],
    conv: Conv,
    split: Split,
    grad_x: Option<&mut [f32]>,
    grad_weight: &mut [f32],
    grad_rows: &mut [f32],
) {
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
        row_gradient(grad, conv, split, grad_rows);
        if !grad_weight.is_empty() {
            weight_gradient(x, grad, conv, split, grad_weight);
        }
        if let Some(grad_x) = grad_x {
            input_gradient(grad, panels, conv, split, grad_x);
        }
    });
}

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

/// Adds `Σ_v T_r(L̃)1[v] · g[v]` to every row's gradient.
fn row_gradient(grad: &[f32], conv: Conv, split: Split, out: &mut [f32]) {
    if conv.rows == 0 {
        return;
    }
    let (rows, output) = (conv.rows, conv.output);
    let sums = conv.operator.sums(rows);
    for (r, out) in out.chunks_exact_mut(output).enumerate() {
        let [totals] = vertex_sums(
            grad.len() / output,
            output,
            split,
            #[inline(always)]
            |[total]: &mut [[f32; LANES]; 1], v, c, width| {
                let grad = &grad[v * output + c..][..width];
                let factor = sums[v * rows + r];
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
        let blocks = kept.div_ceil(OUTER_ROWS);
        let part = blocks.div_ceil(split.parts());
        let range = |i: usize| i * part..((i + 1) * part).min(blocks);
        let parts = blocks.div_ceil(part);
        // The first part is added in place, the others to sums of their own.
        let mut others: Vec<Buffer> = (1..parts).map(|_| Buffer::zeros(out.len())).collect();
        let sums: Vec<&mut [f32]> =
            std::iter::once(&mut *out).chain(others.iter_mut().map(|sum| &mut **sum)).collect();
        let work = |(i, sum): (usize, &mut [f32])| {
            for block in range(i) {
                outer_block(x, whole, grad, conv, block * OUTER_ROWS, sum);
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

/// The contribution of [`OUTER_ROWS`] vertices from `first` on.
fn outer_block(x: &[f32], whole: &[f32], grad: &[f32], conv: Conv, first: usize, out: &mut [f32]) {
    let rows = OUTER_ROWS.min(conv.kept() - first);
    let last = if conv.order > 1 { rows * conv.input } else { 0 };
    with_scratch(Packed::scratch(conv.input, conv.output) + last, |scratch| {
        let (term, scratch) = scratch.split_at_mut(last);
        let mut packed = Packed::new(scratch, conv.input, conv.output);
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
                End::default(),
                out,
            );
        });
    };
    let Some(pool) = conv.operator.pool() else {
        let a = conv.operator.laplacian().backward();
        times(0, out);
        with_scratch((conv.order - 1) * kept, |terms| {
            for (k, term) in terms.chunks_exact_mut(kept).enumerate() {
                times(k + 1, term);
            }
            fold(a, terms, conv, split, out);
        });
        return;
    };

    // At the kept vertices first, then spread over all.
    with_scratch(conv.order * kept + conv.whole(), |scratch| {
        let (at_kept, terms) = scratch.split_at_mut(conv.order * kept);
        for (k, term) in at_kept.chunks_exact_mut(kept).enumerate() {
            times(k, term);
        }
        let a = pool.laplacian.backward();
        let spread = |from: &[f32], last: Option<(f32, &[f32])>, out: &mut [f32]| {
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
            1 => spread(last, None, out),
            2 => spread(before, Some((1.0, last)), out),
            order => {
                for (before, last) in before[(order - 3) * kept..].iter_mut().zip(&*last) {
                    *before -= last;
                }
                spread(&before[..kept], None, out);
                for k in 1..order - 1 {
                    let term = &mut terms[(k - 1) * conv.inputs()..][..conv.inputs()];
                    let last = (k + 2 == order).then_some((2.0, &*last));
                    spread(&before[k * kept..][..kept], last, term);
                }
                fold(conv.operator.laplacian().backward(), terms, conv, split, out);
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
