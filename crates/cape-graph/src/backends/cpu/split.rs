use rayon::prelude::*;

use super::simd;

/// Pieces that a batch's sums are taken over and then added in order, whatever the number of
/// threads, so that it does not show in the results.
const PIECES: usize = 8;

/// How the work on a batch is split.
#[derive(Clone, Copy)]
pub(super) struct Split {
    batch: usize,
}

impl Split {
    pub(super) fn new(batch: usize) -> Self {
        Self { batch }
    }

    /// Examples whose sums are taken together, one after the other on one thread.
    pub(super) fn group(self) -> usize {
        self.batch.div_ceil(PIECES).max(1)
    }

    /// Parts of an example whose sums are taken separately: more than one where there are fewer
    /// examples than pieces.
    pub(super) fn parts(self) -> usize {
        (PIECES / self.batch.max(1)).max(1)
    }

    /// Calls `work` with the number of every chunk of `out`, at once if examples are few.
    pub(super) fn chunks(
        self,
        out: &mut [f32],
        chunk: usize,
        work: impl Fn(usize, &mut [f32]) + Sync,
    ) {
        if self.parts() > 1 {
            out.par_chunks_mut(chunk).enumerate().for_each(|(i, out)| work(i, out));
        } else {
            out.chunks_mut(chunk).enumerate().for_each(|(i, out)| work(i, out));
        }
    }
}

/// Adds each of `terms` to `sum`, in order.
pub(super) fn add_all<'a>(sum: &mut [f32], terms: impl Iterator<Item = &'a [f32]> + Clone + Sync + Send) {
    sum.par_chunks_mut(1 << 14).enumerate().for_each(|(i, sum)| {
        for term in terms.clone() {
            for (sum, term) in sum.iter_mut().zip(&term[i << 14..]) {
                *sum += term;
            }
        }
    });
}

/// Vertices summed in f32 before the sum is carried on in f64.
const BLOCK: usize = 64;
/// Vertices whose sums are taken together.
const SEGMENT: usize = 16 * BLOCK;

/// Sums over vertices of what `add` adds to the first argument for each vertex and its row of
/// `channels`.
pub(super) fn vertex_sums(
    x: &[f32],
    channels: usize,
    sums: usize,
    split: Split,
    add: impl Fn(&mut [f32], usize, &[f32]) + Sync,
) -> Vec<f64> {
    let segment = |(i, x): (usize, &[f32])| {
        let mut total = vec![0.0f64; sums];
        let mut part = vec![0.0f32; sums];
        for (j, block) in x.chunks(BLOCK * channels).enumerate() {
            part.fill(0.0);
            let first = i * SEGMENT + j * BLOCK;
            simd(
                #[inline(always)]
                || {
                    for (v, row) in block.chunks_exact(channels).enumerate() {
                        add(&mut part, first + v, row);
                    }
                },
            );
            for (total, &part) in total.iter_mut().zip(&part) {
                *total += f64::from(part);
            }
        }
        total
    };
    let segments: Vec<Vec<f64>> = if split.parts() > 1 {
        x.par_chunks(SEGMENT * channels).enumerate().map(segment).collect()
    } else {
        x.chunks(SEGMENT * channels).enumerate().map(segment).collect()
    };
    let mut total = vec![0.0; sums];
    for segment in &segments {
        for (total, segment) in total.iter_mut().zip(segment) {
            *total += segment;
        }
    }
    total
}
