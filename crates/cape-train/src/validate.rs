//! Reconstruction of the validation frames during training.

use std::sync::Arc;

use burn::tensor::Device;
use cape_core::Outfit;
use cape_model::{Generator, Graphs, LossConfig, losses::LossWeights};

use crate::{
    Result,
    objective::{Losses, reconstruct, reconstruction_terms},
};
use cape_core::tensors::to_host;
use cape_data::{DisplacementStatistics, HostBatch, PackedSet, sequential};
use cape_infer::to_device;
use cape_stats::errors::{ErrorStats, ErrorSummary, vertex_errors_mm};

/// Number of previewed validation frames.
const PREVIEWS: usize = 4;
/// Variance of the posterior mean over the frames above which a latent dimension counts as active
/// (Burda, Grosse and Salakhutdinov 2016).
const ACTIVE: f64 = 0.01;
/// Step between the vertex errors that enter the histogram.
const SAMPLED: usize = 16;

/// A validation frame and its reconstruction.
#[derive(Debug, Clone)]
pub struct Preview {
    /// Outfit of the frame.
    pub outfit: Outfit,
    /// True displacements, metres, `[3 V]`.
    pub truth: Vec<f32>,
    /// Displacements reconstructed from the mean of the posterior, metres, `[3 V]`.
    pub predicted: Vec<f32>,
}

/// An image for TensorBoard.
#[derive(Debug, Clone)]
pub struct TensorBoardImage {
    /// Tag in TensorBoard.
    pub tag: String,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Contents of the PNG file.
    pub png: Vec<u8>,
}

/// Function that renders previews as images.
pub type PreviewFn = Box<dyn FnMut(&[Preview]) -> Vec<TensorBoardImage> + Send>;

/// Results on the validation frames.
pub(crate) struct ValidationResult {
    /// Reconstruction, edge and KL terms; the others are zero.
    pub(crate) losses: Losses,
    pub(crate) errors: ErrorSummary,
    /// A sample of the vertex errors, millimetres.
    pub(crate) sample_errors: Vec<f32>,
    /// Posterior means, `[frames × latent]`, row-major.
    pub(crate) codes: Vec<f32>,
    pub(crate) active_units: usize,
    pub(crate) previews: Vec<Preview>,
}

/// Inputs of validation.
pub(crate) struct Validator<'a> {
    pub(crate) generator: &'a Generator,
    pub(crate) graphs: &'a Graphs,
    pub(crate) loss: &'a LossConfig,
    pub(crate) loss_weights: &'a LossWeights,
    pub(crate) set: &'a Arc<PackedSet>,
    pub(crate) statistics: &'a Arc<DisplacementStatistics>,
    pub(crate) clothing: &'a [usize],
    pub(crate) batch: usize,
    pub(crate) device: Device,
}

impl Validator<'_> {
    /// Reconstructs the validation frames; `None` if there are none.
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
            let terms =
                reconstruction_terms(self.loss, self.loss_weights, self.graphs, &result, &frames);
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

/// Number of active latent dimensions: columns of the posterior means `[frames × latent]` that
/// vary.
pub fn active_units(codes: &[f32], latent: usize) -> usize {
    (0..latent).filter(|&unit| variance(codes, unit, latent) > ACTIVE).count()
}

/// Population variance of one column of `values: [rows × columns]`.
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
