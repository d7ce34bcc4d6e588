//! Where a trained encoder puts each outfit: what codes to sample.
//!
//! An encoder that was trained for a short time, or with little weight on the KL term, does not fill
//! the standard normal prior. Following Ghosh et al. (CAPE, appendix C), a density is fitted to the
//! posterior means of training frames after training: here one axis-aligned normal an outfit.

use std::{collections::BTreeMap, path::Path, sync::Arc};

use cape_core::Outfit;
use ndarray::{Array1, Array2, Axis, concatenate};

use crate::{
    Error, Result, Run,
    data::{PackedSet, Part},
    run::{host, normal, to_device},
};

/// Frames encoded at a time.
const BATCH: usize = 16;

/// One axis-aligned normal distribution of codes for each outfit seen.
#[derive(Debug, Clone)]
pub struct CodeDensity {
    latent: usize,
    outfits: BTreeMap<Outfit, Normal>,
}

#[derive(Debug, Clone)]
struct Normal {
    mean: Array1<f32>,
    deviation: Array1<f32>,
}

impl CodeDensity {
    /// Fits to the posterior means of at most `frames` training frames of the packed set in `data`,
    /// evenly spaced.
    pub fn fit(run: &Run, data: &Path, frames: usize) -> Result<Self> {
        let set = Arc::new(PackedSet::open(data, Part::Train)?);
        let rows = run.statistics().training_rows(set.frames());
        let step = rows.len().div_ceil(frames.max(1)).max(1);
        let rows: Vec<usize> = rows.step_by(step).collect();
        let latent = run.config().model.latent;
        let mut codes: BTreeMap<Outfit, Vec<f32>> = BTreeMap::new();
        for rows in rows.chunks(BATCH) {
            let batch = set.batch(rows, Some(run.statistics()))?;
            let frames = to_device(batch, run.device());
            let generator = run.generator();
            let condition = generator.condition.forward(frames.pose_feature, frames.outfit);
            let posterior = generator.encoder.forward(
                frames.displacement,
                condition.as_ref(),
                &run.graphs().generator,
            );
            let means = host(posterior.mean);
            for (&row, mean) in rows.iter().zip(means.chunks_exact(latent)) {
                codes.entry(set.outfits()[row]).or_default().extend(mean);
            }
        }
        let outfits =
            codes.into_iter().map(|(outfit, codes)| (outfit, Normal::of(&codes, latent))).collect();
        Ok(Self { latent, outfits })
    }

    /// Codes for an outfit, `[n, latent]`; deviations are multiplied by `temperature`. An outfit
    /// that was not seen has the standard normal prior.
    pub fn sample(&self, outfit: Outfit, n: usize, temperature: f32, seed: u64) -> Array2<f32> {
        let mut codes = normal(seed, outfit.index() as u64, n, self.latent) * temperature;
        if let Some(Normal { mean, deviation }) = self.outfits.get(&outfit) {
            codes = codes * deviation + mean;
        }
        codes
    }

    /// One code for each outfit, `[4, latent]`.
    pub fn sample_each(&self, temperature: f32, seed: u64) -> Result<Array2<f32>> {
        let codes = Outfit::ALL.map(|outfit| self.sample(outfit, 1, temperature, seed));
        concatenate(Axis(0), &codes.each_ref().map(|codes| codes.view()))
            .map_err(|error| Error::argument(error.to_string()))
    }
}

impl Normal {
    fn of(codes: &[f32], latent: usize) -> Self {
        let count = (codes.len() / latent).max(1) as f64;
        let column = |i: usize| codes.iter().skip(i).step_by(latent).map(|&code| f64::from(code));
        let mean = |i: usize| column(i).sum::<f64>() / count;
        let variance =
            |i: usize| column(i).map(|code| (code - mean(i)).powi(2)).sum::<f64>() / count;
        Self {
            mean: (0..latent).map(|i| mean(i) as f32).collect(),
            deviation: (0..latent).map(|i| variance(i).sqrt() as f32).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_the_codes() {
        let codes = [1.0, 10.0, 3.0, 10.0, 5.0, 40.0];
        let Normal { mean, deviation } = Normal::of(&codes, 2);
        assert_eq!(mean.to_vec(), [3.0, 20.0]);
        assert!((deviation[0] - (8.0f32 / 3.0).sqrt()).abs() < 1e-6);
        assert!((deviation[1] - 200.0f32.sqrt()).abs() < 1e-5);
    }

    #[test]
    fn samples_have_the_fitted_moments() {
        let normal = Normal { mean: vec![2.0, -1.0].into(), deviation: vec![0.5, 3.0].into() };
        let outfits = [(Outfit::LongLong, normal)].into();
        let density = CodeDensity { latent: 2, outfits };
        let codes = density.sample(Outfit::LongLong, 20_000, 1.0, 7);
        let fitted = Normal::of(codes.as_slice().unwrap(), 2);
        assert!((fitted.mean[0] - 2.0).abs() < 0.02 && (fitted.mean[1] + 1.0).abs() < 0.1);
        assert!((fitted.deviation[0] - 0.5).abs() < 0.02);
        let prior =
            Normal::of(density.sample(Outfit::ShortLong, 20_000, 1.0, 7).as_slice().unwrap(), 2);
        assert!(prior.mean[0].abs() < 0.05 && (prior.deviation[1] - 1.0).abs() < 0.05);
        assert_eq!(density.sample(Outfit::LongLong, 1, 0.0, 7).as_slice().unwrap(), [2.0, -1.0]);
    }
}
