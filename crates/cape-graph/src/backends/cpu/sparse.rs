use rayon::prelude::*;

use super::simd;
use crate::{buffer::Buffer, sparse::Csr};

/// Number of rows that a thread computes at once.
const ROWS: usize = 256;

/// `y[b] = A x[b]`; `x: [batch, columns, channels]`, `y: [batch, rows, channels]`.
pub(in crate::backends) fn sparse_matmul(x: &[f32], a: &Csr, channels: usize) -> Buffer {
    let (rows, cols) = (a.rows(), a.cols());
    let batch = x.len() / (cols * channels).max(1);
    let mut y = Buffer::take(batch * rows * channels);
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

/// Rows of `A x` from `first` on, as many as `y` holds.
pub(super) fn multiply_rows(a: &Csr, first: usize, x: &[f32], channels: usize, y: &mut [f32]) {
    simd(
        #[inline(always)]
        || {
            for (i, y) in y.chunks_exact_mut(channels).enumerate() {
                let (columns, values) = a.row(first + i);
                tiles(
                    columns,
                    values,
                    x,
                    channels,
                    y,
                    #[inline(always)]
                    |y, sum| *y = sum,
                );
            }
        },
    );
}

/// `y += α A x` for the rows of `A x` from `first` on, as many as `y` holds.
pub(super) fn accumulate(
    a: &Csr,
    first: usize,
    alpha: f32,
    x: &[f32],
    channels: usize,
    y: &mut [f32],
) {
    simd(
        #[inline(always)]
        || {
            for (i, y) in y.chunks_exact_mut(channels).enumerate() {
                let (columns, values) = a.row(first + i);
                tiles(
                    columns,
                    values,
                    x,
                    channels,
                    y,
                    #[inline(always)]
                    |y, sum| *y += alpha * sum,
                );
            }
        },
    );
}

/// Weighted sum of one row, in pieces of channels that fit the registers.
#[inline(always)]
fn tiles(
    columns: &[u32],
    values: &[f32],
    x: &[f32],
    channels: usize,
    y: &mut [f32],
    store: impl Fn(&mut f32, f32) + Copy,
) {
    let mut done = 0;
    while channels - done >= 64 {
        tile::<64>(columns, values, &x[done..], channels, &mut y[done..], store);
        done += 64;
    }
    while channels - done >= 16 {
        tile::<16>(columns, values, &x[done..], channels, &mut y[done..], store);
        done += 16;
    }
    while done < channels {
        tile::<1>(columns, values, &x[done..], channels, &mut y[done..], store);
        done += 1;
    }
}

#[inline(always)]
fn tile<const N: usize>(
    columns: &[u32],
    values: &[f32],
    x: &[f32],
    channels: usize,
    y: &mut [f32],
    store: impl Fn(&mut f32, f32),
) {
    let mut sum = [0.0f32; N];
    for (&column, &value) in columns.iter().zip(values) {
        let x = &x[column as usize * channels..][..N];
        for (sum, &x) in sum.iter_mut().zip(x) {
            *sum += value * x;
        }
    }
    for (y, sum) in y[..N].iter_mut().zip(sum) {
        store(y, sum);
    }
}
