use rayon::prelude::*;

use super::simd;
use crate::sparse::Csr;

const ROWS: usize = 256;

/// `y[b] = A x[b]`; `x: [batch, columns, channels]`, `y: [batch, rows, channels]`.
pub(in crate::backends) fn sparse_matmul(x: &[f32], a: &Csr, channels: usize) -> Vec<f32> {
    let (rows, cols) = (a.rows(), a.cols());
    let batch = x.len() / (cols * channels).max(1);
    let mut y = vec![0.0; batch * rows * channels];
    if y.is_empty() {
        return y;
    }
    y.par_chunks_mut(rows * channels).zip(x.par_chunks(cols * channels)).for_each(|(y, x)| {
        y.par_chunks_mut(ROWS * channels).enumerate().for_each(|(block, y)| {
            multiply_rows(a, block * ROWS, x, channels, y);
        });
    });
    y
}

/// Rows `first..` of `A x` for as many rows as `y` holds.
pub(super) fn multiply_rows(a: &Csr, first: usize, x: &[f32], channels: usize, y: &mut [f32]) {
    simd(
        #[inline(always)]
        || {
            for (i, y) in y.chunks_exact_mut(channels).enumerate() {
                let (columns, values) = a.row(first + i);
                let Some((&c0, rest)) = columns.split_first() else {
                    y.fill(0.0);
                    continue;
                };
                let x0 = &x[c0 as usize * channels..][..channels];
                for (y, &x) in y.iter_mut().zip(x0) {
                    *y = values[0] * x;
                }
                for (&c, &value) in rest.iter().zip(&values[1..]) {
                    let x = &x[c as usize * channels..][..channels];
                    for (y, &x) in y.iter_mut().zip(x) {
                        *y += value * x;
                    }
                }
            }
        },
    );
}

/// `y += α A x` for one example.
pub(super) fn accumulate(a: &Csr, alpha: f32, x: &[f32], channels: usize, y: &mut [f32]) {
    simd(
        #[inline(always)]
        || {
            for (row, y) in y.chunks_exact_mut(channels).enumerate() {
                let (columns, values) = a.row(row);
                for (&c, &value) in columns.iter().zip(values) {
                    let value = alpha * value;
                    let x = &x[c as usize * channels..][..channels];
                    for (y, &x) in y.iter_mut().zip(x) {
                        *y += value * x;
                    }
                }
            }
        },
    );
}

/// `y = 2 A x − previous` for one example: the Chebyshev recurrence.
pub(super) fn recur(a: &Csr, x: &[f32], previous: &[f32], channels: usize, y: &mut [f32]) {
    for (y, &p) in y.iter_mut().zip(previous) {
        *y = -p;
    }
    accumulate(a, 2.0, x, channels, y);
}
