//! A Chebyshev convolution with what comes right after it: the sum with a row for each example,
//! the activation, the selection of vertices.

use rayon::prelude::*;

use super::{
    kernel::{End, Rows, product},
    panels::{Panels, View},
    scratch::with_scratch,
    simd,
    sparse::{accumulate, multiply_rows},
    split::Split,
};
use crate::{buffer::Buffer, operator::Operator};

/// Rows that are taken through a whole convolution together: they stay in the second-level cache.
pub(super) const BLOCK: usize = 96;

/// The extents of a convolution.
#[derive(Clone, Copy)]
pub(in crate::backends) struct Conv<'a> {
    /// The graph.
    pub operator: &'a Operator,
    /// Number of Chebyshev terms `K`.
    pub order: usize,
    /// Channels in.
    pub input: usize,
    /// Channels out.
    pub output: usize,
    /// Number of rows `r` in `Σ_r T_r(L̃)1 · row_r` added to the output.
    pub rows: usize,
    /// Slope of the leaky ReLU, if any.
    pub slope: Option<f32>,
}

impl Conv<'_> {
    pub(super) fn vertices(&self) -> usize {
        self.operator.vertices()
    }

    pub(super) fn kept(&self) -> usize {
        self.operator.kept()
    }

    pub(super) fn index(&self) -> Option<&[u32]> {
        self.operator.pool().map(|pool| &pool.vertices[..])
    }

    /// Numbers of one example's input.
    pub(super) fn inputs(&self) -> usize {
        self.vertices() * self.input
    }

    /// Numbers of one example's output.
    pub(super) fn outputs(&self) -> usize {
        self.kept() * self.output
    }

    /// Rows `c · K + k` of the weights for one `k`, `[input, output]`.
    pub(super) fn term<'w>(&self, weight: &'w [f32], k: usize) -> View<'w> {
        View {
            data: &weight[k * self.output..],
            rows: self.input,
            columns: self.output,
            row_stride: self.order * self.output,
            column_stride: 1,
        }
    }

    /// How a product ends, and whether rows that differ in weight from vertex to vertex remain to
    /// be added before the activation.
    pub(super) fn end<'r>(&self, rows: &'r [f32]) -> (End<'r>, bool) {
        match self.rows {
            0 => (End { row: None, slope: self.slope }, false),
            1 => (End { row: Some(rows), slope: self.slope }, false),
            _ => (End::default(), true),
        }
    }

    pub(super) fn panels(&self, weight: &[f32]) -> Vec<Panels> {
        (0..self.order).map(|k| Panels::pack(self.term(weight, k))).collect()
    }

    /// Numbers of the terms that [`whole_terms`](Self::whole_terms) computes.
    pub(super) fn whole(&self) -> usize {
        self.order.saturating_sub(2) * self.inputs()
    }

    /// `T_1(L̃)x … T_{K−2}(L̃)x` at all vertices, one after the other.
    pub(super) fn whole_terms(&self, x: &[f32], terms: &mut [f32], split: Split) {
        let (a, n) = (self.operator.laplacian().forward(), self.inputs());
        for k in 1..self.order.max(2) - 1 {
            let (done, rest) = terms.split_at_mut((k - 1) * n);
            let last = if k == 1 { x } else { &done[(k - 2) * n..] };
            let before = if k == 2 { x } else { &done[k.saturating_sub(3) * n..] };
            split.chunks(&mut rest[..n], BLOCK * self.input, |block, next| {
                let first = block * BLOCK;
                if k == 1 {
                    multiply_rows(a, first, last, self.input, next);
                } else {
                    let before = &before[first * self.input..][..next.len()];
                    next.iter_mut().zip(before).for_each(|(next, before)| *next = -before);
                    accumulate(a, first, 2.0, last, self.input, next);
                }
            });
        }
    }

    /// Term `k` at the kept vertices, for all but the last term of an order above 1.
    pub(super) fn kept_term<'t>(&'t self, k: usize, x: &'t [f32], whole: &'t [f32]) -> Rows<'t> {
        let n = self.inputs();
        let term = if k == 0 { x } else { &whole[(k - 1) * n..][..n] };
        Rows::selected(term, self.input, self.index())
    }

    /// The last term, `T_{K−1}(L̃)x`, `K > 1`, at the kept vertices from `first` on.
    pub(super) fn last_term(&self, first: usize, x: &[f32], whole: &[f32], out: &mut [f32]) {
        let a = self.operator.kept_laplacian().forward();
        if self.order == 2 {
            multiply_rows(a, first, x, self.input, out);
            return;
        }
        let before = self.kept_term(self.order - 3, x, whole).from(first);
        for (i, out) in out.chunks_exact_mut(self.input).enumerate() {
            out.iter_mut().zip(before.row(i)).for_each(|(out, before)| *out = -before);
        }
        let last = &whole[(self.order - 3) * self.inputs()..];
        accumulate(a, first, 2.0, last, self.input, out);
    }
}

/// `y = f(Σ_k D T_k(L̃) x W_k + Σ_r D T_r(L̃)1 · row_r)`, `f` the leaky ReLU, if any;
/// `x: [batch, vertices, input]`, `weight: [input · K, output]`, `rows: [batch, rows, output]`.
pub(in crate::backends) fn cheb_conv(
    x: &[f32],
    weight: &[f32],
    rows: &[f32],
    conv: Conv,
) -> Buffer {
    let batch = x.len() / conv.inputs().max(1);
    let mut y = Buffer::take(batch * conv.outputs());
    if y.is_empty() {
        return y;
    }
    let panels = conv.panels(weight);
    let split = Split::new(batch);
    y.par_chunks_mut(conv.outputs()).zip(x.par_chunks(conv.inputs())).enumerate().for_each(
        |(example, (y, x))| {
            let size = conv.rows * conv.output;
            let rows = &rows[example * size..][..size];
            forward(x, &panels, rows, false, conv, split, y);
        },
    );
    y
}

/// One example of [`cheb_conv`]; to `add`, `y` is added to before the activation.
pub(super) fn forward(
    x: &[f32],
    panels: &[Panels],
    rows: &[f32],
    add: bool,
    conv: Conv,
    split: Split,
    y: &mut [f32],
) {
    let sums = conv.operator.sums(conv.rows.max(1));
    with_scratch(conv.whole(), |whole| {
        conv.whole_terms(x, whole, split);
        let whole = &*whole;
        split.chunks(y, BLOCK * conv.output, |block, y| {
            let first = block * BLOCK;
            let (end, separately) = conv.end(rows);
            for (k, panels) in panels.iter().enumerate() {
                let add = add || k > 0;
                let end = if k + 1 == conv.order { end } else { End::default() };
                if k == 0 || k + 1 < conv.order {
                    product(conv.kept_term(k, x, whole).from(first), panels, add, end, y);
                } else {
                    with_scratch(y.len() / conv.output * conv.input, |term| {
                        conv.last_term(first, x, whole, term);
                        product(Rows::new(term, conv.input), panels, add, end, y);
                    });
                }
            }
            if separately {
                finish(y, rows, &sums[first * conv.rows..], conv);
            }
        });
    });
}

/// Adds rows and applies the activation.
fn finish(y: &mut [f32], rows: &[f32], sums: &[f32], conv: Conv) {
    let slope = conv.slope.unwrap_or(1.0);
    simd(
        #[inline(always)]
        || {
            for (v, y) in y.chunks_exact_mut(conv.output).enumerate() {
                let factors = &sums[v * conv.rows..][..conv.rows];
                for (row, factor) in rows.chunks_exact(conv.output).zip(factors) {
                    for (y, row) in y.iter_mut().zip(row) {
                        *y += factor * row;
                    }
                }
                for y in y.iter_mut() {
                    *y = if *y > 0.0 { *y } else { slope * *y };
                }
            }
        },
    );
}
