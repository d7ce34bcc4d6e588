use rayon::prelude::*;

use super::simd;

/// Number of pieces of a batch whose partial sums are added in order. It is fixed so that results do
/// not depend on the number of threads.
const PIECES: usize = 8;

/// Division of the work on a batch.
#[derive(Clone, Copy)]
pub(super) struct Split {
    batch: usize,
}

impl Split {
    pub(super) fn new(batch: usize) -> Self {
        Self { batch }
    }

    /// Number of examples with a common partial sum, taken one after the other on one thread.
    pub(super) fn group(self) -> usize {
        self.batch.div_ceil(PIECES).max(1)
    }

    /// Number of parts of an example with their own partial sums: more than 1 if there are fewer
    /// examples than pieces.
    pub(super) fn parts(self) -> usize {
        (PIECES / self.batch.max(1)).max(1)
    }

    /// Calls `work` with the index of every chunk of `out`, in parallel if the batch is small.
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
pub(super) fn add_all<'a>(
    sum: &mut [f32],
    terms: impl Iterator<Item = &'a [f32]> + Clone + Sync + Send,
) {
    sum.par_chunks_mut(1 << 14).enumerate().for_each(|(i, sum)| {
        for term in terms.clone() {
            for (sum, term) in sum.iter_mut().zip(&term[i << 14..]) {
                *sum += term;
            }
        }
    });
}

/// Number of vertices summed in f32 before the sum is continued in f64.
const BLOCK: usize = 64;
/// Number of vertices with a common partial sum.
const SEGMENT: usize = 16 * BLOCK;

/// Number of channels summed together, in registers.
pub(super) const LANES: usize = 32;

/// Sums over the vertices for every channel, `N` arrays of `[channels]`. `add` gets the sums of up to
/// [`LANES`] channels, the vertex, the first of these channels and their number.
pub(super) fn vertex_sums<const N: usize>(
    vertices: usize,
    channels: usize,
    split: Split,
    add: impl Fn(&mut [[f32; LANES]; N], usize, usize, usize) + Sync,
) -> [Vec<f64>; N] {
    let segment = |i: usize| {
        let mut totals: [Vec<f64>; N] = std::array::from_fn(|_| vec![0.0; channels]);
        let end = vertices.min((i + 1) * SEGMENT);
        for first in (i * SEGMENT..end).step_by(BLOCK) {
            let last = end.min(first + BLOCK);
            simd(
                #[inline(always)]
                || {
                    for c in (0..channels).step_by(LANES) {
                        let mut sums = [[0.0f32; LANES]; N];
                        if channels - c >= LANES {
                            for v in first..last {
                                add(&mut sums, v, c, LANES);
                            }
                        } else {
                            for v in first..last {
                                add(&mut sums, v, c, channels - c);
                            }
                        }
                        for (totals, sums) in totals.iter_mut().zip(&sums) {
                            for (total, &sum) in totals[c..].iter_mut().zip(sums) {
                                *total += f64::from(sum);
                            }
                        }
                    }
                },
            );
        }
        totals
    };
    let segments = vertices.div_ceil(SEGMENT);
    let segments: Vec<[Vec<f64>; N]> = if split.parts() > 1 {
        (0..segments).into_par_iter().map(segment).collect()
    } else {
        (0..segments).map(segment).collect()
    };
    std::array::from_fn(|n| {
        (0..channels).map(|c| segments.iter().map(|totals| totals[n][c]).sum()).collect()
    })
}
