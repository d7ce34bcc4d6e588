//! Configuration of a run, as TOML.

use std::{io::Write, path::Path};

use cape_data::PackedSet;
use cape_graph::{Precision, Weighting};
use cape_model::{CapeConfig, LossConfig};
use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Shape of the warm-up of the learning rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WarmUp {
    /// Linearly, step by step.
    #[default]
    Step,
    /// By equal amounts at the start of each epoch, as the paper describes it.
    Epoch,
}

/// Optimiser.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OptimiserKind {
    /// Gradient descent with momentum, as CAPE trains: `v ← μ v + g`, `w ← w − lr · v`.
    #[default]
    Sgd,
    /// Adam (Kingma and Ba 2015) with β₁ = `momentum`, β₂ = 0.999 and ε = 1e-8.
    Adam,
}

/// Schedule of the learning rate after the warm-up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RateSchedule {
    /// By a factor every few epochs.
    #[default]
    Exponential,
    /// To zero at the last epoch's end, along half a cosine.
    Cosine,
}

/// Optimisation and bookkeeping of a run; the defaults are CAPE's.
///
/// ```
/// use cape_infer::{OptimiserKind, RateSchedule, TrainConfig, WarmUp};
///
/// let config = TrainConfig {
///     epochs: 10,
///     peak_rate: 0.1,
///     warmup_epochs: 2.0,
///     warmup: WarmUp::Step,
///     schedule: RateSchedule::Cosine,
///     optimiser: OptimiserKind::Adam,
///     ..TrainConfig::default()
/// };
/// // Of five steps an epoch, ten lead to the peak; half-way down the rest it is half of that.
/// let rate = |step| config.rate(step, 5);
/// assert!((rate(0) - 0.01).abs() < 1e-12);
/// assert!((rate(10) - 0.1).abs() < 1e-12);
/// assert!((rate(30) - 0.05).abs() < 1e-12);
/// assert!(rate(50).abs() < 1e-12);
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Passes over the training frames.
    pub epochs: usize,
    /// Frames in a batch.
    pub batch: usize,
    /// Random seed of initial weights, shuffles and noise.
    pub seed: u64,
    /// Learning rate after the warm-up.
    pub peak_rate: f64,
    /// Epochs until the learning rate is at its peak; fractions are allowed.
    pub warmup_epochs: f64,
    /// Shape of the warm-up.
    pub warmup: WarmUp,
    /// Schedule after the warm-up.
    pub schedule: RateSchedule,
    /// Factor on the learning rate every [`decay_epochs`](Self::decay_epochs) after the warm-up, for
    /// the exponential schedule.
    pub decay: f64,
    /// Epochs between decays.
    pub decay_epochs: f64,
    /// Optimiser of generator and discriminator.
    pub optimiser: OptimiserKind,
    /// Momentum of both optimisers.
    pub momentum: f64,
    /// Largest global norm of the gradients; longer ones are scaled to it.
    pub clip: f64,
    /// The discriminator's learning rate relative to the generator's.
    pub discriminator_rate_scale: f64,
    /// Epochs over which the weight of the Kullback–Leibler term rises linearly from zero; 0 starts
    /// with the whole weight.
    pub kl_warmup_epochs: f64,
    /// Factor of the running average of the weights that is validated, evaluated and sampled from,
    /// such as 0.999; 0 uses the weights themselves.
    pub ema: f64,
    /// Share of the frames, 0 to 1, whose code is that of another frame of the same capture: what differs
    /// between the two must then be explained by the pose. 0, as in the paper, encodes each frame itself.
    #[serde(skip_serializing_if = "is_zero")]
    pub transfer: f64,
    /// Share of the frames, 0 to 1, that are reconstructed under the pose of another training frame: clothing
    /// then keeps its offsets from the body in poses that it was not captured in. 0, as in the paper, gives
    /// each frame its own pose.
    #[serde(skip_serializing_if = "is_zero")]
    pub pose_swap: f64,
    /// Precision of the products of convolutions in updates; validation, evaluation and sampling are in
    /// single precision.
    #[serde(skip_serializing_if = "Precision::is_default")]
    pub precision: Precision,
    /// Steps between checkpoints inside an epoch; 0 saves at the ends of epochs only.
    pub checkpoint_steps: usize,
    /// Newest checkpoints kept; the best one is kept besides.
    pub keep: usize,
    /// Steps between lines of `metrics.jsonl`.
    pub log_steps: usize,
    /// Read the whole training set into memory before training.
    pub preload: bool,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "the signature that serde calls")]
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            epochs: 60,
            batch: 16,
            seed: 1,
            peak_rate: 8e-3,
            warmup_epochs: 4.0,
            warmup: WarmUp::Step,
            schedule: RateSchedule::Exponential,
            decay: 0.99,
            decay_epochs: 1.0,
            optimiser: OptimiserKind::Sgd,
            momentum: 0.9,
            clip: 5.0,
            discriminator_rate_scale: 0.1,
            kl_warmup_epochs: 0.0,
            ema: 0.0,
            transfer: 0.0,
            pose_swap: 0.0,
            precision: Precision::F32,
            checkpoint_steps: 0,
            keep: 3,
            log_steps: 10,
            preload: false,
        }
    }
}

impl TrainConfig {
    /// These settings with those of `other` that change no weight: how often checkpoints and metrics are
    /// written, how many are kept, and whether the training set is read into memory.
    #[must_use]
    pub fn with_record_keeping_of(self, other: &Self) -> Self {
        Self {
            checkpoint_steps: other.checkpoint_steps,
            keep: other.keep,
            log_steps: other.log_steps,
            preload: other.preload,
            ..self
        }
    }

    /// Sets the number of epochs and scales the warm-ups of learning rate and Kullback–Leibler weight
    /// with it, so that a shorter training has the same schedule over its whole length.
    ///
    /// ```
    /// use cape_infer::TrainConfig;
    ///
    /// let mut config = TrainConfig::default();
    /// assert_eq!((config.epochs, config.warmup_epochs), (60, 4.0));
    /// config.scale_to_epochs(15);
    /// assert_eq!((config.epochs, config.warmup_epochs), (15, 1.0));
    /// ```
    pub fn scale_to_epochs(&mut self, epochs: usize) {
        let factor = epochs as f64 / self.epochs.max(1) as f64;
        self.epochs = epochs;
        self.warmup_epochs *= factor;
        self.kl_warmup_epochs *= factor;
    }

    /// The generator's learning rate at a step counted from 0.
    pub fn rate(&self, step: u64, steps_per_epoch: usize) -> f64 {
        let steps = steps_per_epoch as f64;
        let warmup_steps = (self.warmup_epochs * steps).round();
        let done = step as f64;
        if done < warmup_steps {
            let share = match self.warmup {
                WarmUp::Step => (done + 1.0) / warmup_steps,
                WarmUp::Epoch => ((done / steps).floor() + 1.0) / self.warmup_epochs.ceil(),
            };
            return self.peak_rate * share.min(1.0);
        }
        match self.schedule {
            RateSchedule::Exponential => {
                let decays = ((done - warmup_steps) / (steps * self.decay_epochs)).floor();
                self.peak_rate * self.decay.powf(decays)
            }
            RateSchedule::Cosine => {
                let left = self.epochs as f64 * steps - warmup_steps;
                let share = ((done - warmup_steps) / left.max(1.0)).min(1.0);
                self.peak_rate * 0.5 * (1.0 + (std::f64::consts::PI * share).cos())
            }
        }
    }

    /// The share of the Kullback–Leibler term's weight that counts at a step counted from 0.
    pub fn kl_share(&self, step: u64, steps_per_epoch: usize) -> f64 {
        let warmup_steps = (self.kl_warmup_epochs * steps_per_epoch as f64).round();
        if warmup_steps > 0.0 { ((step as f64 + 1.0) / warmup_steps).min(1.0) } else { 1.0 }
    }
}

/// Everything that defines a run, beside its data.
///
/// ```
/// use cape_model::CapeConfig;
/// use cape_infer::RunConfig;
///
/// let config = RunConfig { model: CapeConfig::narrow(), ..RunConfig::default() };
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("run.toml");
/// config.save(&path)?;
/// assert_eq!(RunConfig::load(&path)?, config);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunConfig {
    /// The networks.
    #[serde(default)]
    pub model: CapeConfig,
    /// The objective.
    #[serde(default)]
    pub loss: LossConfig,
    /// The optimisation.
    #[serde(default)]
    pub train: TrainConfig,
    /// Weights of up-sampling in the pyramids.
    #[serde(default)]
    pub weighting: Weighting,
}

impl RunConfig {
    /// Reads and checks a configuration file.
    pub fn load(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|source| Error::io(path, source))?;
        Self::from_toml(path, &text)
    }

    /// Reads and checks the text of a configuration file; errors name `path`.
    pub fn from_toml(path: &Path, text: &str) -> Result<Self> {
        let config: Self =
            toml::from_str(text).map_err(|error| Error::format(path, error.to_string()))?;
        config.validate().map_err(|error| Error::format(path, error.to_string()))?;
        Ok(config)
    }

    /// The configuration for training on `set`: the paper's outfits, the default, are replaced by those
    /// of the set's labels. Other outfits are kept, as names or order of their own.
    #[must_use]
    pub fn with_outfits_of(mut self, set: &PackedSet) -> Self {
        if self.model.outfits.is_paper() {
            self.model.outfits = set.vocabulary().clone();
        }
        self
    }

    /// Writes a configuration file.
    pub fn save(&self, path: &Path) -> Result<()> {
        let text = self.to_toml()?;
        Ok(cape_core::write_atomically(path, |file| file.write_all(text.as_bytes()))?)
    }

    /// Text of a configuration file.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string_pretty(self)
            .map_err(|error| Error::argument(format!("configuration: {error}")))
    }

    /// Checks every value; errors name the field.
    pub fn validate(&self) -> Result<()> {
        self.model.validate()?;
        self.loss.validate()?;
        let train = &self.train;
        let error = |field: &str, message: String| {
            Err(Error::argument(format!("configuration: `train.{field}` {message}")))
        };
        for (field, value) in
            [("epochs", train.epochs), ("batch", train.batch), ("log_steps", train.log_steps)]
        {
            if value == 0 {
                return error(field, "must be at least 1".into());
            }
        }
        for (field, value, positive) in [
            ("peak_rate", train.peak_rate, true),
            ("warmup_epochs", train.warmup_epochs, false),
            ("decay", train.decay, true),
            ("decay_epochs", train.decay_epochs, true),
            ("clip", train.clip, true),
            ("discriminator_rate_scale", train.discriminator_rate_scale, false),
            ("kl_warmup_epochs", train.kl_warmup_epochs, false),
        ] {
            if !(value.is_finite() && value >= 0.0 && (value > 0.0 || !positive)) {
                let least = if positive { "positive" } else { "at least 0" };
                return error(field, format!("must be {least}, not {value}"));
            }
        }
        for (field, share) in [("transfer", train.transfer), ("pose_swap", train.pose_swap)] {
            if !(0.0..=1.0).contains(&share) {
                return error(field, format!("must be from 0 to 1, not {share}"));
            }
        }
        for (field, value) in [("momentum", train.momentum), ("ema", train.ema)] {
            if !(0.0..1.0).contains(&value) {
                return error(field, format!("must be from 0 to below 1, not {value}"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_warm_up_and_decay() {
        let config = TrainConfig { warmup_epochs: 2.0, ..TrainConfig::default() };
        let rate = |step| config.rate(step, 10);
        assert!((rate(0) - 8e-3 / 20.0).abs() < 1e-12);
        assert!((rate(19) - 8e-3).abs() < 1e-12);
        assert!((rate(29) - 8e-3).abs() < 1e-12);
        assert!((rate(30) - 8e-3 * 0.99).abs() < 1e-12);
        let paper = TrainConfig { warmup: WarmUp::Epoch, ..TrainConfig::default() };
        assert_eq!([0, 9, 10, 39].map(|s| paper.rate(s, 10)), [2e-3, 2e-3, 4e-3, 8e-3]);
        let none = TrainConfig { warmup_epochs: 0.0, ..TrainConfig::default() };
        assert_eq!(none.rate(0, 10), 8e-3);
        let cosine = TrainConfig { schedule: RateSchedule::Cosine, epochs: 4, ..config };
        assert!((cosine.rate(20, 10) - 8e-3).abs() < 1e-12);
        assert!((cosine.rate(30, 10) - 4e-3).abs() < 1e-12);
        assert!(cosine.rate(39, 10) > 0.0 && cosine.rate(40, 10) < 1e-12);
    }

    #[test]
    fn the_kl_term_rises_over_its_warm_up() {
        assert_eq!(TrainConfig::default().kl_share(0, 10), 1.0);
        let slow = TrainConfig { kl_warmup_epochs: 2.0, ..TrainConfig::default() };
        assert_eq!([0, 9, 19, 500].map(|step| slow.kl_share(step, 10)), [0.05, 0.5, 1.0, 1.0]);
    }

    #[test]
    fn toml_round_trip_and_named_errors() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("config.toml");
        let config = RunConfig { model: CapeConfig::tiny(), ..RunConfig::default() };
        config.save(&path).unwrap();
        assert_eq!(RunConfig::load(&path).unwrap(), config);
        std::fs::write(&path, "[train]\nbatch = 0\n").unwrap();
        assert!(RunConfig::load(&path).unwrap_err().to_string().contains("train.batch"));
        std::fs::write(&path, "[train]\nbatches = 3\n").unwrap();
        assert!(RunConfig::load(&path).unwrap_err().to_string().contains("batches"));
    }
}
