use std::cell::RefCell;

use rayon::prelude::*;

use super::{
    gemm::{View, product},
    simd,
    sparse::{accumulate, multiply_rows, recur},
};
use crate::sparse::{Csr, SparsePair};

/// The extents of a Chebyshev convolution.
#[derive(Clone, Copy)]
pub(in crate::backends) struct Conv<'a> {
    /// The rescaled Laplacian `L̃`; unused when `order` is 1.
    pub laplacian: &'a SparsePair,
    /// Number of Chebyshev terms `K`.
    pub order: usize,
    /// Vertices per example.
    pub vertices: usize,
    /// Channels in.
    pub input: usize,
    /// Channels out.
    pub output: usize,
}

/// Examples whose weight gradients are summed together; independent of the number of threads.
const GROUPS: usize = 8;

impl Conv<'_> {
    /// Rows `c · K + k` of the weight matrix for one `k`.
    fn term<'w>(&self, weight: &'w [f32], k: usize) -> View<'w> {
        View::strided(&weight[k * self.output..], self.input, self.output, self.order * self.output)
    }

    fn example(&self) -> usize {
        self.vertices * self.input
    }

    /// `T_1(L̃)x … T_{K−1}(L̃)x`, one after the other.
    fn basis(&self, x: &[f32], basis: &mut [f32]) {
        let (a, n) = (self.laplacian.forward(), self.example());
        for k in 1..self.order {
            let (done, rest) = basis.split_at_mut((k - 1) * n);
            let next = &mut rest[..n];
            match k {
                1 => multiply_rows(a, 0, x, self.input, next),
                2 => recur(a, &done[..n], x, self.input, next),
                _ => {
                    let (before, last) = done[(k - 3) * n..].split_at(n);
                    recur(a, last, before, self.input, next);
                }
            }
        }
    }
}

/// `y = Σ_k T_k(L̃) x W_k`; `x: [batch, vertices, input]`, `weight: [input · K, output]`.
pub(in crate::backends) fn cheb_conv(x: &[f32], weight: &[f32], conv: Conv) -> Vec<f32> {
    let batch = x.len() / conv.example().max(1);
    let mut y = vec![0.0; batch * conv.vertices * conv.output];
    if y.is_empty() {
        return y;
    }
    let threaded = batch < rayon::current_num_threads();
    y.par_chunks_mut(conv.vertices * conv.output).zip(x.par_chunks(conv.example())).for_each(
        |(y, x)| {
            with_scratch((conv.order - 1) * conv.example(), |basis| {
                conv.basis(x, basis);
                for (k, term) in terms(x, basis, conv.example()).enumerate() {
                    let term = View::new(term, conv.vertices, conv.input);
                    product(term, conv.term(weight, k), y, conv.output, k > 0, threaded);
                }
            });
        },
    );
    y
}

/// Gradients of [`cheb_conv`] with respect to `x` (if wanted) and `weight`.
pub(in crate::backends) fn cheb_conv_backward(
    x: &[f32],
    weight: &[f32],
    grad: &[f32],
    conv: Conv,
    want_x: bool,
) -> (Vec<f32>, Vec<f32>) {
    let n = conv.example();
    let batch = x.len() / n.max(1);
    let mut grad_x = vec![0.0; if want_x { x.len() } else { 0 }];
    let mut grad_weight = vec![0.0; weight.len()];
    if batch == 0 {
        return (grad_x, grad_weight);
    }
    let threaded = batch < rayon::current_num_threads();
    let group = batch.div_ceil(GROUPS);
    let outputs = conv.vertices * conv.output;

    let mut pieces: Vec<&mut [f32]> = if want_x {
        grad_x.chunks_mut(group * n).collect()
    } else {
        (0..batch.div_ceil(group)).map(|_| &mut [][..]).collect()
    };
    let partial: Vec<Vec<f32>> = pieces
        .par_iter_mut()
        .zip(x.par_chunks(group * n))
        .zip(grad.par_chunks(group * outputs))
        .map(|((grad_x, x), grad)| {
            let mut sum = vec![0.0; weight.len()];
            for (i, (x, grad)) in x.chunks(n).zip(grad.chunks(outputs)).enumerate() {
                let view = View::new(grad, conv.vertices, conv.output);
                with_scratch((conv.order - 1) * n, |scratch| {
                    conv.basis(x, scratch);
                    for (k, term) in terms(x, scratch, n).enumerate() {
                        let out = &mut sum[k * conv.output..];
                        let term = View::new(term, conv.vertices, conv.input);
                        let stride = conv.order * conv.output;
                        product(term.transposed(), view, out, stride, true, threaded);
                    }
                    if want_x {
                        let out = &mut grad_x[i * n..][..n];
                        input_gradient(view, weight, conv, out, scratch, threaded);
                    }
                });
            }
            sum
        })
        .collect();
    simd(
        #[inline(always)]
        || {
            for part in &partial {
                for (sum, &part) in grad_weight.iter_mut().zip(part) {
                    *sum += part;
                }
            }
        },
    );
    (grad_x, grad_weight)
}

/// `Σ_k T_k(L̃)ᵀ g W_kᵀ` for one example, by the recurrence run backwards.
fn input_gradient(
    grad: View,
    weight: &[f32],
    conv: Conv,
    out: &mut [f32],
    scratch: &mut [f32],
    threaded: bool,
) {
    let n = conv.example();
    let a: &Csr = conv.laplacian.backward();
    product(grad, conv.term(weight, 0).transposed(), out, conv.input, false, threaded);
    for k in 1..conv.order {
        let term = &mut scratch[(k - 1) * n..][..n];
        product(grad, conv.term(weight, k).transposed(), term, conv.input, false, threaded);
    }
    for k in (2..conv.order).rev() {
        let (lower, upper) = scratch.split_at_mut((k - 1) * n);
        let upper = &upper[..n];
        accumulate(a, 2.0, upper, conv.input, &mut lower[(k - 2) * n..]);
        let twice_lower = if k == 2 { &mut *out } else { &mut lower[(k - 3) * n..][..n] };
        for (lower, &upper) in twice_lower.iter_mut().zip(upper) {
            *lower -= upper;
        }
    }
    if conv.order > 1 {
        accumulate(a, 1.0, &scratch[..n], conv.input, out);
    }
}

fn terms<'a>(x: &'a [f32], basis: &'a [f32], n: usize) -> impl Iterator<Item = &'a [f32]> {
    std::iter::once(x).chain(basis.chunks_exact(n))
}

thread_local! {
    static SCRATCH: RefCell<Vec<Vec<f32>>> = const { RefCell::new(Vec::new()) };
}

/// Lends a buffer kept by this thread; its contents are unspecified.
fn with_scratch<R>(len: usize, work: impl FnOnce(&mut [f32]) -> R) -> R {
    let mut buffer = SCRATCH.with_borrow_mut(Vec::pop).unwrap_or_default();
    if buffer.len() < len {
        buffer.resize(len, 0.0);
    }
    let result = work(&mut buffer[..len]);
    SCRATCH.with_borrow_mut(|buffers| buffers.push(buffer));
    result
}
