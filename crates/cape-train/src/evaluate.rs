//! Reconstruction error on held-out sequences (CAPE table 2).

use std::{path::Path, sync::Arc};

use serde::Serialize;

use crate::{
    Error, Progress, Result, Run,
    data::{PackedSet, Part, sequential},
    metrics::{GroupedErrors, GroupedSummary, vertex_errors_mm},
    objective::reconstruct,
    run::{host, normal, tensor2, to_device},
};

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

/// Auto-encodes the test frames of the packed set in `data`.
pub fn evaluate(
    run: &Run,
    data: &Path,
    options: EvalOptions,
    progress: &mut Progress,
) -> Result<EvalReport> {
    let set = Arc::new(PackedSet::open(data, Part::Test)?);
    let frames = set.frames();
    let vertices = run.body().vertices();
    if set.vertices() != vertices {
        return Err(Error::Data(format!(
            "{}: frames of {} vertices, but the run's body has {vertices}",
            data.display(),
            set.vertices()
        )));
    }
    let statistics = Arc::new(run.statistics().clone());
    let mean: Vec<f32> = statistics.mean().iter().map(|&x| x as f32).collect();
    let (mut of_model, mut of_mean) = (GroupedErrors::new(), GroupedErrors::new());
    let mut vertex_sums = vec![0.0f64; vertices];
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
        for (i, &row) in rows.iter().enumerate() {
            let span = i * vertices * 3..(i + 1) * vertices * 3;
            let (predicted, truth) = (&predicted[span.clone()], &truth[span]);
            let outfit = set.outfits()[row];
            let sequence = set.origins().map(|origins| origins[row].sequence.as_str());
            let errors = vertex_errors_mm(predicted, truth, run.clothing())?;
            of_model.push(outfit, sequence, &errors);
            for (&vertex, &error) in run.clothing().iter().zip(&errors) {
                vertex_sums[vertex] += f64::from(error);
            }
            of_mean.push(outfit, sequence, &vertex_errors_mm(&mean, truth, run.clothing())?);
        }
        done += rows.len();
        progress(done, frames);
    }
    Ok(EvalReport {
        model: of_model.summary(),
        mean_shape: of_mean.summary(),
        frames,
        posterior: options.posterior,
        vertex_means: vertex_sums.into_iter().map(|sum| (sum / frames as f64) as f32).collect(),
    })
}
