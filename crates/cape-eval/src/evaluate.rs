//! Reconstruction error on held-out sequences (CAPE table 2).

use std::{path::Path, sync::Arc};

use serde::Serialize;

use crate::{Error, Result};
use cape_core::{
    ProgressFn,
    tensors::{host, tensor2},
};
use cape_data::{PackedSet, Split, sequential};
use cape_infer::{Run, normal, to_device};
use cape_stats::errors::{GroupedErrors, GroupedSummary, Histogram, vertex_errors_mm};
use cape_train::objective::reconstruct;

/// Which code of the posterior is decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum PosteriorUse {
    /// Its mean.
    Mean,
    /// A sample, as the authors' release evaluates.
    Sample,
}

/// How to evaluate.
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
/// // A run, and four test frames.
/// let directory = trained()?;
/// let [packed, run] = ["packed", "run"].map(|name| directory.path().join(name));
/// let run = Run::open(&run, &Device::default())?;
/// let options = EvalOptions { posterior: PosteriorUse::Mean, ..EvalOptions::default() };
/// let report = evaluate(&run, &packed, options, &mut silent)?;
/// assert_eq!(report.frames, 4);
/// assert_eq!(report.model.overall.count, 4 * run.clothing().len() as u64);
///
/// // The same frame by frame.
/// let set = Arc::new(PackedSet::open(&packed, Split::Test)?);
/// let mut gathered = ErrorSamples::new(6890, run.clothing());
/// reconstruct_test(&run, &set, options, &mut silent, &mut |row, predicted, truth| {
///     gathered.push(&set, row, predicted, truth)
/// })?;
/// assert_eq!(gathered.summary(), report.model);
/// assert_eq!(gathered.frames()[0].capture, set.capture(0));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, Copy)]
pub struct EvalOptions {
    /// Which code is decoded.
    pub posterior: PosteriorUse,
    /// Fixes the samples.
    pub seed: u64,
    /// Frames at a time.
    pub batch: usize,
}

impl Default for EvalOptions {
    fn default() -> Self {
        Self { posterior: PosteriorUse::Sample, seed: 1, batch: 16 }
    }
}

/// Per-vertex Euclidean errors at clothing vertices of the test frames, millimetres.
#[derive(Debug, Clone, Serialize)]
pub struct EvalReport {
    /// The model's reconstructions.
    pub model: GroupedSummary,
    /// The mean training displacement in place of every frame: what knowing nothing costs.
    pub mean_shape: GroupedSummary,
    /// Test frames.
    pub frames: usize,
    /// Which code was decoded.
    pub posterior: PosteriorUse,
    /// The model's mean error at every vertex, millimetres, `[V]`; zero where there is no clothing.
    #[serde(skip)]
    pub vertex_means: Vec<f32>,
}

/// Errors of reconstructions, gathered frame by frame.
#[derive(Debug, Clone)]
pub struct ErrorSamples {
    clothing: Vec<usize>,
    errors: GroupedErrors,
    vertex_sums: Vec<f64>,
    frames: Vec<FrameError>,
}

/// One test frame's mean error.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameError {
    /// The capture it is of: subject, outfit and sequence as far as the data say.
    pub capture: String,
    /// Mean over the clothing vertices, millimetres.
    pub mean: f64,
}

impl ErrorSamples {
    /// Nothing yet, of frames of `vertices` vertices compared at the clothing vertices.
    pub fn new(vertices: usize, clothing: &[usize]) -> Self {
        Self {
            clothing: clothing.to_vec(),
            errors: GroupedErrors::new(),
            vertex_sums: vec![0.0; vertices],
            frames: Vec::new(),
        }
    }

    /// Adds frame `row` of `set`: displacements in metres, `[3 V]`.
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

    /// Statistics over all frames and vertices, by outfit and by sequence.
    pub fn summary(&self) -> GroupedSummary {
        self.errors.summary()
    }

    /// Counts of all errors in `bins` bins of the given width, millimetres.
    pub fn histogram(&self, bin_mm: f64, bins: usize) -> Histogram {
        self.errors.overall().histogram(bin_mm, bins)
    }

    /// Mean error at every vertex, millimetres, `[V]`; zero where there is no clothing.
    pub fn vertex_means(&self) -> Vec<f32> {
        let count = self.frames.len().max(1) as f64;
        self.vertex_sums.iter().map(|sum| (sum / count) as f32).collect()
    }

    /// Every frame's error, in order.
    pub fn frames(&self) -> &[FrameError] {
        &self.frames
    }
}

/// Auto-encodes the test frames of the packed set in `data`.
pub fn evaluate(
    run: &Run,
    data: &Path,
    options: EvalOptions,
    progress: &mut ProgressFn,
) -> Result<EvalReport> {
    let set = Arc::new(PackedSet::open(data, Split::Test)?);
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
        posterior: options.posterior,
        vertex_means: of_model.vertex_means(),
    })
}

/// Takes a frame's row, its reconstruction and the truth.
pub type FrameFn<'a> = dyn FnMut(usize, &[f32], &[f32]) -> Result<()> + 'a;

/// Calls `each` with every test frame's row, reconstruction and truth: displacements in metres,
/// `[3 V]`.
pub fn reconstruct_test(
    run: &Run,
    set: &Arc<PackedSet>,
    options: EvalOptions,
    progress: &mut ProgressFn,
    each: &mut FrameFn,
) -> Result<()> {
    let frames = set.frames();
    let vertices = run.body().vertices();
    if set.vertices() != vertices {
        return Err(Error::data(format!(
            "test frames of {} vertices, but the run's body has {vertices}",
            set.vertices()
        )));
    }
    let statistics = Arc::new(run.statistics().clone());
    let mut done = 0;
    for batch in sequential(set.clone(), Some(statistics.clone()), 0..frames, options.batch)? {
        let batch = batch?;
        let rows = batch.frames.clone();
        let epsilon = (options.posterior == PosteriorUse::Sample).then(|| {
            let latent = run.config().model.latent;
            let noise = normal(options.seed, rows[0] as u64, rows.len(), latent);
            tensor2(noise, run.device())
        });
        let frames_on_device = to_device(batch, run.device());
        let result = reconstruct(run.generator(), run.graphs(), &frames_on_device, epsilon);
        let mut predicted = host(result.displacement);
        let mut truth = host(frames_on_device.displacement);
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
