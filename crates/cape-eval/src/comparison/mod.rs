//! Comparison of methods on the same test frames.
//!
//! [`measure_run`] measures the reconstructions of a trained run, [`RunErrorMeter`] those of any
//! method. A [`ComparisonTable`] has the results of all methods, with confidence intervals and
//! tests that account for the dependence between frames of one capture; where captures are unknown,
//! it has none.

mod runs;
mod table;
mod text;

use std::sync::Arc;

use cape_core::SmplModel;
use serde::{Deserialize, Serialize};

pub use cape_stats::bootstrap::ConfidenceInterval;
pub use runs::{check_comparable, common_data, training_seconds};
pub use table::{ComparisonRow, ComparisonTable};

use crate::{
    ErrorSamples, EvalOptions, FrameFn, PosteriorUse, Result, reconstruct_test,
    surface_detail::{SurfaceDetail, SurfaceDetailMeter},
};
use cape_core::ProgressFn;
use cape_data::PackedSet;
use cape_infer::Run;
use cape_stats::errors::{GroupedSummary, Histogram};

/// Width of the bins of a histogram, millimetres.
const BIN_MM: f64 = 0.25;
/// Number of bins of a histogram.
const BINS: usize = 200;

/// Errors of a method on the test frames.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct RunErrors {
    /// Errors of reconstructions from a sample of the posterior, as in the paper's table 2.
    pub sampled: GroupedSummary,
    /// Errors of reconstructions from the mean of the posterior.
    pub mean: GroupedSummary,
    /// Surface detail of reconstructions from the mean of the posterior.
    pub detail: SurfaceDetail,
    /// Mean sampled error of every test frame, millimetres, by capture if captures are known.
    captures: Vec<(Option<String>, Vec<f32>)>,
    /// Mean sampled error at every vertex, `[V]`, millimetres.
    pub vertex_means: Vec<f32>,
    /// Histogram of the sampled errors at all clothing vertices of all frames.
    pub histogram: Histogram,
}

/// A method with its results for all seeds.
#[derive(Debug, Clone)]
pub struct MethodResults<'a> {
    /// Name in files.
    pub name: String,
    /// Name in tables.
    pub label: String,
    /// Results, one per seed, at least one.
    pub results: Vec<&'a RunErrors>,
    /// Training time of all seeds together, seconds.
    pub seconds: f64,
}

/// Accumulator of errors of reconstructed test frames.
#[derive(Debug, Clone)]
pub struct RunErrorMeter {
    sampled: ErrorSamples,
    mean: ErrorSamples,
    detail: SurfaceDetailMeter,
}

impl RunErrorMeter {
    /// Creates an empty accumulator for displacements of `body`, compared at the vertices
    /// `clothing`.
    pub fn new(body: &SmplModel, clothing: &[usize]) -> Self {
        let samples = ErrorSamples::new(body.vertices(), clothing);
        Self {
            sampled: samples.clone(),
            mean: samples,
            detail: SurfaceDetailMeter::new(body, clothing),
        }
    }

    /// Adds frame `row` of `set` reconstructed from a sample of the posterior; displacements `[3
    /// V]`, metres.
    pub fn push_sampled(
        &mut self,
        set: &PackedSet,
        row: usize,
        predicted: &[f32],
        truth: &[f32],
    ) -> Result<()> {
        self.sampled.push(set, row, predicted, truth)
    }

    /// Adds frame `row` of `set` reconstructed from the mean of the posterior; displacements `[3
    /// V]`, metres.
    pub fn push_mean(
        &mut self,
        set: &PackedSet,
        row: usize,
        predicted: &[f32],
        truth: &[f32],
    ) -> Result<()> {
        self.detail.push(predicted, truth);
        self.mean.push(set, row, predicted, truth)
    }

    /// Errors of the frames so far.
    pub fn errors(&self) -> RunErrors {
        let mut captures: Vec<(Option<String>, Vec<f32>)> = Vec::new();
        for frame in self.sampled.frames() {
            match captures.last_mut() {
                Some((last, errors)) if *last == frame.capture => errors.push(frame.mean as f32),
                _ => captures.push((frame.capture.clone(), vec![frame.mean as f32])),
            }
        }
        RunErrors {
            sampled: self.sampled.summary(),
            mean: self.mean.summary(),
            detail: self.detail.detail(),
            captures,
            vertex_means: self.sampled.vertex_means(),
            histogram: self.sampled.histogram(BIN_MM, BINS),
        }
    }
}

/// Measures a trained run on test frames; `seed` is the seed of the posterior samples. `each` is
/// called with every reconstruction from the mean of the posterior.
pub fn measure_run(
    run: &Run,
    set: &Arc<PackedSet>,
    seed: u64,
    progress: &mut ProgressFn,
    each: &mut FrameFn,
) -> Result<RunErrors> {
    let mut meter = RunErrorMeter::new(run.body(), run.clothing());
    // An auto-encoder has no samples; its code is the mean.
    let variational = run.config().model.variational;
    let options = |posterior| EvalOptions { posterior, seed, ..EvalOptions::default() };
    reconstruct_test(
        run,
        set,
        options(PosteriorUse::Mean),
        progress,
        &mut |row, predicted, truth| {
            meter.push_mean(set, row, predicted, truth)?;
            if !variational {
                meter.push_sampled(set, row, predicted, truth)?;
            }
            each(row, predicted, truth)
        },
    )?;
    if variational {
        reconstruct_test(
            run,
            set,
            options(PosteriorUse::Sample),
            progress,
            &mut |row, predicted, truth| meter.push_sampled(set, row, predicted, truth),
        )?;
    }
    Ok(meter.errors())
}
