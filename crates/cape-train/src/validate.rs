//! Reconstruction of the validation frames during training.

use std::sync::Arc;

use burn::tensor::Device;
use cape_core::Outfit;
use cape_model::{Generator, Graphs, LossConfig};

use crate::{
    Result,
    objective::{Losses, reconstruct, reconstruction_terms},
};
use cape_core::tensors::to_host;
use cape_data::{DisplacementStatistics, HostBatch, PackedSet, sequential};
use cape_infer::to_device;
use cape_stats::errors::{ErrorStats, ErrorSummary, vertex_errors_mm};

/// Frames that are shown.
const PREVIEWS: usize = 4;
/// Variance of a posterior mean over the frames from which its number of the code counts as active
/// (Burda, Grosse and Salakhutdinov 2016).
const ACTIVE: f64 = 0.01;
/// One error in so many goes into the histogram.
const SAMPLED: usize = 16;

/// A validation frame and what the model makes of it.
///
/// See [`Trainer`](crate::Trainer) for an example.
#[derive(Debug, Clone)]
pub struct Preview {
    /// The outfit worn.
    pub outfit: Outfit,
    /// Displacements in metres, `[3 V]`.
    pub truth: Vec<f32>,
    /// The reconstruction from the posterior's mean, likewise.
    pub predicted: Vec<f32>,
}

/// A picture for TensorBoard.
///
/// See [`Trainer`](crate::Trainer) for an example.
#[derive(Debug, Clone)]
pub struct TensorBoardImage {
    /// Its name.
    pub tag: String,
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// The file's content.
    pub png: Vec<u8>,
}

/// Draws previews.
///
/// See [`Trainer`](crate::Trainer) for an example.
pub type PreviewFn = Box<dyn FnMut(&[Preview]) -> Vec<TensorBoardImage> + Send>;

/// What the validation frames came to.
pub(crate) struct ValidationResult {
    /// Reconstruction, edge and KL terms; the others are zero.
    pub(crate) losses: Losses,
    pub(crate) errors: ErrorSummary,
    /// Some of the errors, millimetres.
    pub(crate) sample_errors: Vec<f32>,
    /// Posterior means, `[frames × latent]`.
    pub(crate) codes: Vec<f32>,
    pub(crate) active_units: usize,
    pub(crate) previews: Vec<Preview>,
}

/// What it takes.
pub(crate) struct Validator<'a> {
    pub(crate) generator: &'a Generator,
    pub(crate) graphs: &'a Graphs,
    pub(crate) loss: &'a LossConfig,
    pub(crate) set: &'a Arc<PackedSet>,
    pub(crate) statistics: &'a Arc<DisplacementStatistics>,
    pub(crate) clothing: &'a [usize],
    pub(crate) batch: usize,
    pub(crate) device: Device,
}

impl Validator<'_> {
    /// Nothing if there are no validation frames.
    pub(crate) fn run(&self) -> Result<Option<ValidationResult>> {
        let rows = self.statistics.validation_rows(self.set.frames());
        if rows.is_empty() {
            return Ok(None);
        }
        let count = rows.len();
        let shown = PREVIEWS.min(count);
        let shown: Vec<usize> =
            (0..shown).map(|i| rows.start + (2 * i + 1) * count / (2 * shown)).collect();
        let (set, statistics) = (self.set.clone(), self.statistics.clone());
        let size = self.set.vertices() * 3;
        let mut latent = 1;
        let mut errors = ErrorStats::new();
        let mut losses = Losses::default();
        let (mut sample_errors, mut codes, mut previews) = (Vec::new(), Vec::new(), Vec::new());
        for batch in sequential(set, Some(statistics), rows, self.batch)? {
            let batch: HostBatch = batch?;
            let weight = batch.frames.len() as f64 / count as f64;
            let numbers = batch.frames.clone();
            let frames = to_device(batch, &self.device);
            let result = reconstruct(self.generator, self.graphs, &frames, None);
            let terms = reconstruction_terms(self.loss, self.graphs, &result, &frames);
            losses.reconstruction += weight * terms.reconstruction;
            losses.edge += weight * terms.edge;
            losses.kl += weight * terms.kl;
            latent = result.posterior.mean.dims()[1];
            codes.extend(to_host(result.posterior.mean));
            let mut predicted = to_host(result.displacement);
            let mut truth = to_host(frames.displacement);
            self.statistics.denormalise(&mut predicted);
            self.statistics.denormalise(&mut truth);
            let pairs = predicted.chunks(size).zip(truth.chunks(size));
            for ((predicted, truth), frame) in pairs.zip(numbers) {
                let own = vertex_errors_mm(predicted, truth, self.clothing)?;
                errors.push(&own);
                sample_errors.extend(own.iter().step_by(SAMPLED));
                if shown.contains(&frame) {
                    previews.push(Preview {
                        outfit: self.set.outfits()[frame],
                        truth: truth.to_vec(),
                        predicted: predicted.to_vec(),
                    });
                }
            }
        }
        Ok(Some(ValidationResult {
            losses,
            errors: errors.summary(),
            active_units: active_units(&codes, latent),
            sample_errors,
            codes,
            previews,
        }))
    }
}

/// How many columns of posterior means `[frames × latent]` vary.
pub fn active_units(codes: &[f32], latent: usize) -> usize {
    (0..latent).filter(|&unit| variance(codes, unit, latent) > ACTIVE).count()
}

/// Of one column of `[rows × columns]`.
fn variance(values: &[f32], column: usize, columns: usize) -> f64 {
    let of = || values.iter().skip(column).step_by(columns).map(|&x| f64::from(x));
    let count = of().count() as f64;
    let mean = of().sum::<f64>() / count;
    of().map(|x| (x - mean).powi(2)).sum::<f64>() / count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variances_are_of_columns() {
        let values = [1.0, 5.0, 3.0, 5.0, 5.0, 5.0];
        assert!((variance(&values, 0, 2) - 8.0 / 3.0).abs() < 1e-12);
        assert_eq!(variance(&values, 1, 2), 0.0);
    }
}
