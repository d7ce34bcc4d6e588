//! Reconstruction error on held-out sequences (CAPE table 2).

use std::{path::Path, sync::Arc};

use serde::Serialize;

use crate::Result;
use cape_core::{
    ProgressFn,
    tensors::{from_array2, to_host},
};
use cape_data::{PackedSet, Split, sequential};
use cape_infer::{Run, normal, to_device};
use cape_stats::errors::{GroupedErrors, GroupedSummary, Histogram, vertex_errors_mm};
use cape_train::objective::reconstruct;

/// Latent code of the posterior that is decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum PosteriorUse {
    /// Mean of the posterior.
    Mean,
    /// Sample of the posterior, as in the evaluation of the authors' release.
    Sample,
}

/// Options of [`evaluate`](evaluate()).
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-train/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use std::sync::Arc;
///
/// use burn::tensor::Device;
/// use cape_core::silent;
/// use cape_data::{PackedSet, Split};
/// use cape_eval::{EvalOptions, ErrorSamples, PosteriorUse, evaluate, reconstruct_test};
/// use cape_infer::Run;
///
/// // A run and four test frames.
/// let directory = trained()?;
/// let [packed, run] = ["packed", "run"].map(|name| directory.path().join(name));
/// let run = Run::open(&run, &Device::default())?;
/// let options = EvalOptions { posterior: PosteriorUse::Mean, ..EvalOptions::default() };
/// let report = evaluate(&run, &packed, options, &mut silent)?;
/// assert_eq!(report.frames, 4);
/// assert_eq!(report.model.overall.count, 4 * run.clothing().len() as u64);
///
/// // The same, frame by frame.
/// let set = Arc::new(PackedSet::open(&packed, Split::Test)?);
/// let mut errors = ErrorSamples::new(6890, run.clothing());
/// reconstruct_test(&run, &set, options, &mut silent, &mut |row, predicted, truth| {
///     errors.push(&set, row, predicted, truth)
/// })?;
/// assert_eq!(errors.summary(), report.model);
/// assert_eq!(errors.frames()[0].capture, set.capture(0));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, Copy)]
pub struct EvalOptions {
    /// Latent code that is decoded.
    pub posterior: PosteriorUse,
    /// Seed of the posterior samples.
    pub seed: u64,
    /// Frames per batch.
    pub batch: usize,
}

impl Default for EvalOptions {
    fn default() -> Self {
        Self { posterior: PosteriorUse::Sample, seed: 1, batch: 16 }
    }
}

/// Per-vertex Euclidean errors at the clothing vertices of the test frames, millimetres.
#[derive(Debug, Clone, Serialize)]
pub struct EvalReport {
    /// Errors of the model's reconstructions.
    pub model: GroupedSummary,
    /// Errors of the mean-shape baseline: the mean training displacement in place of every frame.
    pub mean_shape: GroupedSummary,
    /// Number of test frames.
    pub frames: usize,
    /// Number of clothing vertices, at which errors are measured.
    pub clothing_vertices: usize,
    /// Latent code that was decoded.
    pub posterior: PosteriorUse,
    /// Mean error of the model at every vertex, `[V]`, millimetres; zero at vertices without
    /// clothing.
    #[serde(skip)]
    pub vertex_means: Vec<f32>,
}

/// Errors of reconstructions, accumulated frame by frame.
#[derive(Debug, Clone)]
pub struct ErrorSamples {
    clothing: Vec<usize>,
    errors: GroupedErrors,
    vertex_sums: Vec<f64>,
    frames: Vec<FrameError>,
}

/// Mean error of a test frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameError {
    /// Capture of the frame if it is known, see [`PackedSet::capture`].
    pub capture: Option<String>,
    /// Mean error over the clothing vertices, millimetres.
    pub mean: f64,
}

impl ErrorSamples {
    /// Creates an empty accumulator for frames of `vertices` vertices, compared at the vertices
    /// `clothing`.
    pub fn new(vertices: usize, clothing: &[usize]) -> Self {
        Self {
            clothing: clothing.to_vec(),
            errors: GroupedErrors::new(),
            vertex_sums: vec![0.0; vertices],
            frames: Vec::new(),
        }
    }

    /// Adds frame `row` of `set`; `predicted` and `truth` are displacements, `[3 V]`, metres.
    pub fn push(
        &mut self,
        set: &PackedSet,
        row: usize,
        predicted: &[f32],
        truth: &[f32],
    ) -> Result<()> {
        let errors = vertex_errors_mm(predicted, truth, &self.clothing)?;
        let outfit = set.outfits()[row];
        let origin = set.origins().map(|origins| &origins[row]);
        self.errors.push(outfit, origin.map(|origin| origin.sequence.as_str()), &errors);
        for (&vertex, &error) in self.clothing.iter().zip(&errors) {
            self.vertex_sums[vertex] += f64::from(error);
        }
        let mean = errors.iter().map(|&x| f64::from(x)).sum::<f64>() / errors.len().max(1) as f64;
        self.frames.push(FrameError { capture: set.capture(row), mean });
        Ok(())
    }

    /// Error statistics over all frames and vertices, by outfit and by sequence.
    pub fn summary(&self) -> GroupedSummary {
        self.errors.summary()
    }

    /// Histogram of all errors with `bins` bins of width `bin_mm`, millimetres.
    pub fn histogram(&self, bin_mm: f64, bins: usize) -> Histogram {
        self.errors.overall().histogram(bin_mm, bins)
    }

    /// Mean error at every vertex, `[V]`, millimetres; zero at vertices without clothing.
    pub fn vertex_means(&self) -> Vec<f32> {
        let count = self.frames.len().max(1) as f64;
        self.vertex_sums.iter().map(|sum| (sum / count) as f32).collect()
    }

    /// Errors of all frames, in order.
    pub fn frames(&self) -> &[FrameError] {
        &self.frames
    }
}

/// Evaluates a run on the test frames of the packed set in `data`.
pub fn evaluate(
    run: &Run,
    data: impl AsRef<Path>,
    options: EvalOptions,
    progress: &mut ProgressFn,
) -> Result<EvalReport> {
    let set = Arc::new(run.open_set(data, Split::Test)?);
    let vertices = run.body().vertices();
    let mean: Vec<f32> = run.statistics().mean().iter().map(|&x| x as f32).collect();
    let mut of_model = ErrorSamples::new(vertices, run.clothing());
    let mut of_mean = of_model.clone();
    reconstruct_test(run, &set, options, progress, &mut |row, predicted, truth| {
        of_model.push(&set, row, predicted, truth)?;
        of_mean.push(&set, row, &mean, truth)
    })?;
    Ok(EvalReport {
        model: of_model.summary(),
        mean_shape: of_mean.summary(),
        frames: set.frames(),
        clothing_vertices: run.clothing().len(),
        posterior: options.posterior,
        vertex_means: of_model.vertex_means(),
    })
}

/// Callback with the row of a frame, its reconstruction and its true displacements, `[3 V]`,
/// metres.
pub type FrameFn<'a> = dyn FnMut(usize, &[f32], &[f32]) -> Result<()> + 'a;

/// Reconstructs all frames of a [set of the model's outfits](cape_infer::ClothedModel::open_set) and calls `each` with row, reconstruction and truth of each.
pub fn reconstruct_test(
    run: &Run,
    set: &Arc<PackedSet>,
    options: EvalOptions,
    progress: &mut ProgressFn,
    each: &mut FrameFn,
) -> Result<()> {
    let frames = set.frames();
    let vertices = run.body().vertices();
    run.expect_set(set)?;
    let statistics = Arc::new(run.statistics().clone());
    let mut done = 0;
    for batch in sequential(set.clone(), Some(statistics.clone()), 0..frames, options.batch)? {
        let batch = batch?;
        let rows = batch.frames.clone();
        let epsilon = (options.posterior == PosteriorUse::Sample).then(|| {
            let latent = run.config().model.latent;
            let noise = normal(options.seed, rows[0] as u64, rows.len(), latent);
            from_array2(noise, run.device())
        });
        let frames_on_device = to_device(batch, run.device());
        let result = reconstruct(run.generator(), run.graphs(), &frames_on_device, epsilon);
        let mut predicted = to_host(result.displacement);
        let mut truth = to_host(frames_on_device.displacement);
        statistics.denormalise(&mut predicted);
        statistics.denormalise(&mut truth);
        let size = vertices * 3;
        for ((&row, predicted), truth) in
            rows.iter().zip(predicted.chunks(size)).zip(truth.chunks(size))
        {
            each(row, predicted, truth)?;
        }
        done += rows.len();
        progress(done, frames);
    }
    Ok(())
}
