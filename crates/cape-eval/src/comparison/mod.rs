//! Methods side by side on the same test frames.
//!
//! [`measure_run`] reconstructs every test frame with a trained run; [`RunErrorMeter`] does the measuring for
//! methods of any kind. [`ComparisonTable`] puts what they came to side by side, with intervals and tests that
//! take frames of one capture for what they are: not independent.

mod runs;
mod table;
mod text;

use std::sync::Arc;

use cape_core::SmplModel;
use serde::{Deserialize, Serialize};

pub use cape_stats::resample::ConfidenceInterval;
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

/// Width of a histogram's bins, millimetres.
const BIN_MM: f64 = 0.25;
/// How many there are at most.
const BINS: usize = 200;

/// What a method came to on the test frames.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct RunErrors {
    /// Errors of a sample of the posterior, as the paper's table has them.
    pub sampled: GroupedSummary,
    /// Errors of the posterior's mean.
    pub mean: GroupedSummary,
    /// Wrinkles, for the posterior's mean.
    pub detail: SurfaceDetail,
    /// Mean error of every test frame's sampled reconstruction, millimetres, by capture.
    captures: Vec<(String, Vec<f32>)>,
    /// Mean error of the sampled reconstruction at every vertex, millimetres.
    pub vertex_means: Vec<f32>,
    /// Errors of sampled reconstructions at all vertices of all frames.
    pub histogram: Histogram,
}

/// A method with all its results.
#[derive(Debug, Clone)]
pub struct MethodResults<'a> {
    /// Its name for programs.
    pub name: String,
    /// Its name for people.
    pub label: String,
    /// Results, one a seed, at least one.
    pub results: Vec<&'a RunErrors>,
    /// Seconds of training, all seeds together.
    pub seconds: f64,
}

/// Measures reconstructions of test frames as they come.
#[derive(Debug, Clone)]
pub struct RunErrorMeter {
    sampled: ErrorSamples,
    mean: ErrorSamples,
    detail: SurfaceDetailMeter,
}

impl RunErrorMeter {
    /// For displacements of `body` compared at the clothing vertices.
    pub fn new(body: &SmplModel, clothing: &[usize]) -> Self {
        let gathered = ErrorSamples::new(body.vertices(), clothing);
        Self {
            sampled: gathered.clone(),
            mean: gathered,
            detail: SurfaceDetailMeter::new(body, clothing),
        }
    }

    /// Adds frame `row` of `set`, decoded from a sample of the posterior: displacements in metres,
    /// `[3 V]`.
    pub fn push_sampled(
        &mut self,
        set: &PackedSet,
        row: usize,
        predicted: &[f32],
        truth: &[f32],
    ) -> Result<()> {
        self.sampled.push(set, row, predicted, truth)
    }

    /// The same, decoded from the posterior's mean.
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

    /// What the frames so far came to.
    pub fn errors(&self) -> RunErrors {
        let mut captures: Vec<(String, Vec<f32>)> = Vec::new();
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

/// Measures a trained run on test frames; `seed` fixes the samples. `each` also gets every
/// reconstruction from the posterior's mean.
pub fn measure_run(
    run: &Run,
    set: &Arc<PackedSet>,
    seed: u64,
    progress: &mut ProgressFn,
    each: &mut FrameFn,
) -> Result<RunErrors> {
    let mut meter = RunErrorMeter::new(run.body(), run.clothing());
    // An auto-encoder's code is its mean.
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
