//! Peak rate of multiply-adds of this machine.

use std::{hint::black_box, time::Instant};

use pulp::{Simd, WithSimd};

/// Minimal duration of a run, seconds: much longer than waking the threads.
const RUN: f64 = 0.05;
/// Number of runs.
const RUNS: usize = 9;

/// Peak rate of all threads of rayon's pool together, GFLOP/s, with two operations for each
/// multiply-add in registers: an upper bound for every kernel of this build on this machine.
///
/// It is measured with the best instruction set that is compiled in, over about half a second, as
/// the fastest of several runs, because other programs can only slow a run down.
pub fn peak_gflops() -> f64 {
    let mut rounds = 1 << 16;
    while Run::of(rounds).seconds < RUN {
        rounds *= 2;
    }
    (0..RUNS).map(|_| Run::of(rounds).gflops()).fold(0.0, f64::max)
}

struct Run {
    operations: f64,
    seconds: f64,
}

impl Run {
    fn of(rounds: u64) -> Self {
        let start = Instant::now();
        let counts = rayon::broadcast(|_| pulp::Arch::new().dispatch(Chains { rounds }));
        let seconds = start.elapsed().as_secs_f64();
        Self { operations: counts.into_iter().map(|count| count as f64).sum(), seconds }
    }

    fn gflops(&self) -> f64 {
        1e-9 * self.operations / self.seconds
    }
}

/// Chains of dependent multiply-adds; returns the number of operations.
struct Chains {
    rounds: u64,
}

impl WithSimd for Chains {
    type Output = u64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> u64 {
        // Enough chains to hide the latency, few enough for the registers: 32 with AVX-512 and
        // NEON, otherwise 16.
        match S::F32_LANES {
            4 | 16 => self.run::<S, 24>(simd),
            _ => self.run::<S, 12>(simd),
        }
    }
}

impl Chains {
    #[inline(always)]
    fn run<S: Simd, const CHAINS: usize>(self, simd: S) -> u64 {
        let factor = simd.splat_f32s(black_box(0.999));
        let summand = simd.splat_f32s(black_box(1e-3));
        let mut values: [S::f32s; CHAINS] = std::array::from_fn(|i| simd.splat_f32s(i as f32));
        for _ in 0..self.rounds {
            for value in &mut values {
                *value = simd.mul_add_e_f32s(*value, factor, summand);
            }
        }
        black_box(values);
        2 * self.rounds * (CHAINS * S::F32_LANES) as u64
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_peak_is_that_of_a_processor() {
        let peak = super::peak_gflops();
        assert!((0.1..1e6).contains(&peak), "{peak}");
    }
}
