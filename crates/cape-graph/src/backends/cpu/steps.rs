//! Steps of optimisers.

use rayon::prelude::*;

use super::simd;
use crate::steps::{AdamStep, MomentumStep};

/// Numbers of a task; independent of the number of threads.
const CHUNK: usize = 1 << 15;
/// Numbers that are summed in f32 in each lane of a register before the sum goes on in f64.
const RUN: usize = 1 << 10;
const LANES: usize = 16;

/// [`GraphBackend::momentum_step`](crate::ops::GraphBackend::momentum_step), in place.
pub(in crate::backends) fn momentum_step(
    value: &mut [f32],
    gradient: &[f32],
    velocity: &mut [f32],
    step: MomentumStep,
) {
    let [scale, momentum, rate] = [step.scale, step.momentum, step.rate].map(|x| x as f32);
    let chunks = value.par_chunks_mut(CHUNK).zip(gradient.par_chunks(CHUNK));
    chunks.zip(velocity.par_chunks_mut(CHUNK)).for_each(|((value, gradient), velocity)| {
        simd(
            #[inline(always)]
            || {
                for ((x, &g), v) in value.iter_mut().zip(gradient).zip(velocity) {
                    *v = *v * momentum + g * scale;
                    *x -= *v * rate;
                }
            },
        );
    });
}

/// [`GraphBackend::adam_step`](crate::ops::GraphBackend::adam_step), in place.
pub(in crate::backends) fn adam_step(
    gradient: &[f32],
    [value, first, second]: [&mut [f32]; 3],
    step: AdamStep,
) {
    let [scale, rate, epsilon] = [step.scale, step.rate, step.epsilon].map(|x| x as f32);
    let decays = step.decays.map(|x| x as f32);
    let new = step.decays.map(|x| (1.0 - x) as f32);
    let corrections = step.corrections.map(|x| x as f32);
    let moments = first.par_chunks_mut(CHUNK).zip(second.par_chunks_mut(CHUNK));
    let chunks = value.par_chunks_mut(CHUNK).zip(gradient.par_chunks(CHUNK));
    chunks.zip(moments).for_each(|((value, gradient), (first, second))| {
        simd(
            #[inline(always)]
            || {
                let moments = first.iter_mut().zip(second);
                for ((x, &g), (m, v)) in value.iter_mut().zip(gradient).zip(moments) {
                    let g = g * scale;
                    *m = *m * decays[0] + g * new[0];
                    *v = *v * decays[1] + g * g * new[1];
                    let deviation = (*v / corrections[1]).sqrt() + epsilon;
                    *x -= *m / corrections[0] / deviation * rate;
                }
            },
        );
    });
}

/// Sum of the squares.
pub(in crate::backends) fn sum_of_squares(x: &[f32]) -> f32 {
    let sums: Vec<f64> = x.par_chunks(CHUNK).map(chunk_squares).collect();
    sums.into_iter().sum::<f64>() as f32
}

fn chunk_squares(chunk: &[f32]) -> f64 {
    simd(
        #[inline(always)]
        || {
            let mut sum = 0.0;
            for run in chunk.chunks(RUN) {
                let (rows, rest) = run.as_chunks::<LANES>();
                let mut lanes = [0.0f32; LANES];
                for row in rows {
                    for (lane, x) in lanes.iter_mut().zip(row) {
                        *lane += x * x;
                    }
                }
                sum += lanes.iter().map(|&x| f64::from(x)).sum::<f64>();
                sum += rest.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>();
            }
            sum
        },
    )
}
