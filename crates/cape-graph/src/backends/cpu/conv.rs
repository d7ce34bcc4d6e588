//! Chebyshev convolution with its epilogue (constant terms, activation) at the kept vertices.

use rayon::prelude::*;

use super::{
    bf16::{self, Instructions},
    kernel::{Epilogue, Rows, product},
    panels::{Panels, View},
    scratch::with_scratch,
    simd,
    sparse::{accumulate, multiply_rows},
    split::Split,
};
use crate::{Precision, buffer::Buffer, conv_graph::HostGraph};

/// Number of rows that pass through a whole convolution together: they fit the second-level cache.
pub(super) const BLOCK: usize = 96;

/// Extents of a convolution.
#[derive(Clone, Copy)]
pub(in crate::backends) struct Conv<'a> {
    /// Graph.
    pub graph: &'a HostGraph,
    /// Number of Chebyshev terms `K`.
    pub order: usize,
    /// Number of input channels.
    pub input: usize,
    /// Number of output channels.
    pub output: usize,
    /// Number of constant terms `r`: `Σ_r T_r(L̃)1 · term_r` is added to the output.
    pub constant_terms: usize,
    /// Negative slope of the leaky ReLU, if any.
    pub slope: Option<f32>,
    /// Precision of the products.
    pub precision: Precision,
}

impl Conv<'_> {
    pub(super) fn vertices(&self) -> usize {
        self.graph.vertices()
    }

    pub(super) fn kept(&self) -> usize {
        self.graph.kept()
    }

    pub(super) fn index(&self) -> Option<&[u32]> {
        self.graph.pool().map(|pool| &pool.vertices[..])
    }

    /// Number of values of one example's input.
    pub(super) fn inputs(&self) -> usize {
        self.vertices() * self.input
    }

    /// Number of values of one example's output.
    pub(super) fn outputs(&self) -> usize {
        self.kept() * self.output
    }

    /// Weights of one term, rows `c · K + k`, `[input, output]`.
    pub(super) fn term<'w>(&self, weight: &'w [f32], k: usize) -> View<'w> {
        View {
            data: &weight[k * self.output..],
            rows: self.input,
            columns: self.output,
            row_stride: self.order * self.output,
            column_stride: 1,
        }
    }

    /// Epilogue of the last product. True if constant terms, whose factors differ from vertex to
    /// vertex, remain to be added before the activation.
    pub(super) fn epilogue<'r>(&self, constant_terms: &'r [f32]) -> (Epilogue<'r>, bool) {
        match self.constant_terms {
            0 => (Epilogue { bias: None, slope: self.slope }, false),
            1 => (Epilogue { bias: Some(constant_terms), slope: self.slope }, false),
            _ => (Epilogue::default(), true),
        }
    }

    /// Instructions of the weights' gradient, if it is not computed in f32.
    pub(super) fn outer_instructions(&self) -> Option<Instructions> {
        bf16::select(self.precision, [self.input, self.output])
    }

    /// Packed weights of every term.
    pub(super) fn panels(&self, weight: &[f32]) -> Vec<Panels> {
        (0..self.order).map(|k| Panels::pack(self.term(weight, k), self.precision)).collect()
    }

    /// Number of values that [`whole_terms`](Self::whole_terms) computes.
    pub(super) fn whole(&self) -> usize {
        self.order.saturating_sub(2) * self.inputs()
    }

    /// `T_1(L̃)x … T_{K−2}(L̃)x` at all vertices, `[K − 2, vertices, input]`.
    pub(super) fn whole_terms(&self, x: &[f32], terms: &mut [f32], split: Split) {
        let (a, n) = (self.graph.laplacian().matrix(), self.inputs());
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

    /// Term `k` at the kept vertices; not the last term of an order above 1.
    pub(super) fn kept_term<'t>(&'t self, k: usize, x: &'t [f32], whole: &'t [f32]) -> Rows<'t> {
        let n = self.inputs();
        let term = if k == 0 { x } else { &whole[(k - 1) * n..][..n] };
        Rows::selected(term, self.input, self.index())
    }

    /// The last term, `T_{K−1}(L̃)x`, `K > 1`, at the kept vertices from `first` on.
    pub(super) fn last_term(&self, first: usize, x: &[f32], whole: &[f32], out: &mut [f32]) {
        let a = self.graph.kept_laplacian().matrix();
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

/// `y = f(Σ_k D T_k(L̃) x W_k + Σ_r D T_r(L̃)1 · term_r)`, `f` the leaky ReLU, if any;
/// `x: [batch, vertices, input]`, `weight: [input · K, output]`,
/// `constant_terms: [batch, r, output]`, `y: [batch, kept, output]`.
pub(in crate::backends) fn cheb_conv(
    x: &[f32],
    weight: &[f32],
    constant_terms: &[f32],
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
            let size = conv.constant_terms * conv.output;
            let constant_terms = &constant_terms[example * size..][..size];
            let forward = Forward { conv, panels: &panels, constant_terms, add: false, split };
            forward.run(x, y);
        },
    );
    y
}

/// Convolution of one example.
#[derive(Clone, Copy)]
pub(super) struct Forward<'a> {
    /// Extents and graph.
    pub conv: Conv<'a>,
    /// Packed weights of every term.
    pub panels: &'a [Panels],
    /// Coefficients of the constant terms, `[constant_terms, output]`.
    pub constant_terms: &'a [f32],
    /// True to add to the output before the activation, false to overwrite it.
    pub add: bool,
    /// Division of the work.
    pub split: Split,
}

impl Forward<'_> {
    /// From `x: [vertices, input]` to `y: [kept, output]`.
    pub(super) fn run(self, x: &[f32], y: &mut [f32]) {
        let Self { conv, panels, constant_terms, add, split } = self;
        let basis = conv.graph.constant_basis(conv.constant_terms.max(1));
        with_scratch(conv.whole(), |whole| {
            conv.whole_terms(x, whole, split);
            let whole = &*whole;
            split.chunks(y, BLOCK * conv.output, |block, y| {
                let first = block * BLOCK;
                let (epilogue, separately) = conv.epilogue(constant_terms);
                for (k, panels) in panels.iter().enumerate() {
                    let add = add || k > 0;
                    let epilogue = if k + 1 == conv.order { epilogue } else { Epilogue::default() };
                    if k == 0 || k + 1 < conv.order {
                        let term = conv.kept_term(k, x, whole).from(first);
                        product(term, panels, add, epilogue, y);
                    } else {
                        with_scratch(y.len() / conv.output * conv.input, |term| {
                            conv.last_term(first, x, whole, term);
                            product(Rows::new(term, conv.input), panels, add, epilogue, y);
                        });
                    }
                }
                if separately {
                    add_constant_terms(
                        y,
                        constant_terms,
                        &basis[first * conv.constant_terms..],
                        conv,
                    );
                }
            });
        });
    }

    /// 1×1 convolution of `apply(x)`, which is computed block by block.
    pub(super) fn run_blockwise(
        self,
        x: &[f32],
        y: &mut [f32],
        apply: impl Fn(&[f32], &mut [f32]) + Sync,
    ) {
        let Self { conv, panels, constant_terms, add, split } = self;
        split.chunks(y, BLOCK * conv.output, |block, y| {
            let size = y.len() / conv.output * conv.input;
            with_scratch(size, |scratch| {
                apply(&x[block * BLOCK * conv.input..][..size], scratch);
                let (epilogue, _) = conv.epilogue(constant_terms);
                product(Rows::new(scratch, conv.input), &panels[0], add, epilogue, y);
            });
        });
    }
}

/// Adds constant terms, multiplied by their basis `[vertices, constant_terms]`, and applies the
/// activation.
fn add_constant_terms(y: &mut [f32], constant_terms: &[f32], basis: &[f32], conv: Conv) {
    let slope = conv.slope.unwrap_or(1.0);
    simd(
        #[inline(always)]
        || {
            for (v, y) in y.chunks_exact_mut(conv.output).enumerate() {
                let factors = &basis[v * conv.constant_terms..][..conv.constant_terms];
                for (term, factor) in constant_terms.chunks_exact(conv.output).zip(factors) {
                    for (y, term) in y.iter_mut().zip(term) {
                        *y += factor * term;
                    }
                }
                for y in y.iter_mut() {
                    *y = if *y > 0.0 { *y } else { slope * *y };
                }
            }
        },
    );
}
