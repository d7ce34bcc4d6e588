//! Self-check of a training set-up: short trainings that test a configuration on a data set and
//! suggest a learning rate. Nothing is written to disk.

mod check;
mod rate;

use std::{path::Path, sync::Arc};

use burn::tensor::Device;
use cape_core::SmplModel;

pub use check::{CheckOptions, CheckReport, Finding, check};
pub use rate::{RatePoint, RateSearchOptions, RateSearchReport, find_rate};

use crate::{Error, Result};
use cape_core::tensors::from_array2;
use cape_data::{
    DisplacementStatistics, Loader, LoaderOptions, LoaderState, PackedSet, Split, StepBatches,
    steps_per_epoch,
};
use cape_infer::{RunConfig, body_and_clothing, build_graphs, normal, to_device};
use cape_train::{learner::Learner, objective::StepInput};

/// Configuration and data set of a self-check.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-train/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use burn::tensor::Device;
/// use cape_core::silent;
/// use cape_eval::self_check::{CheckOptions, RateSearchOptions, ModelUnderTest, check, find_rate};
///
/// // A packed set of four training frames, and a small configuration.
/// let directory = captures()?;
/// let (config, device) = (small_config(), Device::default());
/// let model = ModelUnderTest {
///     data: &directory.path().join("packed"),
///     body: None,
///     clothing: None,
///     config: &config,
///     device: &device,
/// };
/// let options = CheckOptions { frames: 2, overfit_steps: 4, target_mm: 0.5, steps: 4 };
/// let report = check(&model, options, &mut silent)?;
/// // Four steps are too few to overfit.
/// assert!(!report.passed && report.findings.iter().any(|finding| !finding.passed));
///
/// let options = RateSearchOptions { low: 1e-6, high: 1e-3, steps: 10 };
/// let rates = find_rate(&model, options, &mut silent)?;
/// assert!((1e-7..=1e-3).contains(&rates.suggested));
/// assert!(rates.points.is_sorted_by(|a, b| a.rate < b.rate));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, Copy)]
pub struct ModelUnderTest<'a> {
    /// Directory of the packed set.
    pub data: &'a Path,
    /// Body of the data; `None` uses the `body.npz` of the packed set.
    pub body: Option<&'a SmplModel>,
    /// File of the indices of clothing vertices; `None` uses those of the packed set, or derives
    /// them from the body's blend weights.
    pub clothing: Option<&'a Path>,
    /// Configuration to check.
    pub config: &'a RunConfig,
    /// Device of the training.
    pub device: &'a Device,
}

/// Opened data set and body.
struct Fixtures {
    set: Arc<PackedSet>,
    statistics: Arc<DisplacementStatistics>,
    body: SmplModel,
    clothing: Vec<usize>,
    device: Device,
}

impl Fixtures {
    fn open(model: &ModelUnderTest<'_>) -> Result<Self> {
        model.config.validate()?;
        let set = PackedSet::open(model.data, Split::Train)?;
        let config = model.config.clone().with_outfits_of(&set);
        let set = set.with_vocabulary(&config.model.outfits)?;
        let statistics = DisplacementStatistics::from_packed(model.data, &mut cape_core::silent)?;
        if statistics.training_rows(set.frames()).is_empty() {
            let message = format!("{}: no training frames", model.data.display());
            return Err(Error::data(message));
        }
        let (body, mask) = body_and_clothing(model.data, &set, model.body, model.clothing)?;
        Ok(Self {
            set: Arc::new(set),
            statistics: Arc::new(statistics),
            body,
            clothing: mask.indices().collect(),
            device: model.device.clone().autodiff(),
        })
    }

    fn learner(&self, config: &RunConfig) -> Result<Learner> {
        let config = config.clone().with_outfits_of(&self.set);
        let graphs = build_graphs(&config, &self.body, &self.device)?;
        Learner::for_data(&config, graphs, &self.statistics, &self.clothing, &self.device)
    }

    fn batches(&self, config: &RunConfig) -> Result<StepInputs> {
        let rows = self.statistics.training_rows(self.set.frames());
        let options = LoaderOptions {
            batch: config.train.batch,
            discriminator: config.model.discriminator.is_some(),
            ..LoaderOptions::default()
        };
        let state = LoaderState::new(config.train.seed);
        Ok(StepInputs {
            steps_per_epoch: steps_per_epoch(rows.len(), config.train.batch),
            loader: Loader::new(self.set.clone(), self.statistics.clone(), rows, options, state)?,
            seed: config.train.seed,
            latent: config.model.variational.then_some(config.model.latent),
            device: self.device.clone(),
            step: 0,
        })
    }
}

/// Inputs of training, step by step, the same as those of the trainer.
struct StepInputs {
    steps_per_epoch: usize,
    loader: Loader,
    seed: u64,
    latent: Option<usize>,
    device: Device,
    step: u64,
}

impl StepInputs {
    fn next(&mut self) -> Result<StepInput> {
        let StepBatches { generator, discriminator, .. } = self.loader.step()?;
        let count = generator.frames.len();
        let noise = |latent| normal(self.seed, (1 << 32) + self.step, count, latent);
        let epsilon = self.latent.map(|latent| from_array2(noise(latent), &self.device));
        self.step += 1;
        Ok(StepInput {
            encoded: None,
            frames: to_device(generator, &self.device),
            epsilon,
            real: discriminator.map(|batch| to_device(batch, &self.device)),
        })
    }
}
