//! Settings of a training on the command line.

use cape_infer::{OptimiserKind, RateSchedule, RunConfig};
use cape_model::AdversarialLoss;
use clap::{Args, ValueEnum};

use crate::{arguments::at_least_one, commands::pyramid::WeightingName};

/// Settings that override the configuration.
#[derive(Debug, Args)]
#[command(next_help_heading = "Settings")]
pub(super) struct TrainOverrideArgs {
    /// Passes over the training frames.
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    epochs: Option<usize>,
    /// Frames in a batch.
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    batch: Option<usize>,
    /// Learning rate after the warm-up.
    #[arg(long, value_name = "RATE")]
    peak_rate: Option<f64>,
    /// Epochs of warm-up.
    #[arg(long, value_name = "N")]
    warmup_epochs: Option<f64>,
    /// How the learning rate falls after the warm-up; the paper's is exponential.
    #[arg(long, value_enum)]
    schedule: Option<ScheduleName>,
    /// How gradients become steps. The paper's is sgd, with momentum; adam wants a --peak-rate of
    /// about 1e-3.
    #[arg(long, value_enum)]
    optimiser: Option<OptimiserName>,
    /// Weight of the Kullback–Leibler term.
    #[arg(long, value_name = "WEIGHT")]
    kl: Option<f64>,
    /// Epochs over which that weight rises from zero.
    #[arg(long, value_name = "N")]
    kl_warmup_epochs: Option<f64>,
    /// Weight of the adversarial terms.
    #[arg(long, value_name = "WEIGHT")]
    gan: Option<f64>,
    /// What generator and discriminator play for; the paper's is bce, binary cross-entropy.
    #[arg(long, value_enum)]
    adversary: Option<AdversarialLossName>,
    /// Divide the discriminator's weight matrices by their largest singular values.
    #[arg(long)]
    spectral_norm: bool,
    /// Evaluate and sample from a running average of the weights with this factor, such as 0.999.
    #[arg(long, value_name = "FACTOR")]
    ema: Option<f64>,
    /// Steps between checkpoints inside an epoch; 0 saves at the ends of epochs only.
    #[arg(long, value_name = "N")]
    checkpoint_steps: Option<usize>,
    /// Newest checkpoints kept, besides the best.
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    keep: Option<usize>,
    /// Read the whole training set into memory.
    #[arg(long)]
    preload: bool,
    /// How up-sampling is weighted.
    #[arg(long, value_enum)]
    weighting: Option<WeightingName>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum ScheduleName {
    Exponential,
    Cosine,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum OptimiserName {
    Sgd,
    Adam,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum AdversarialLossName {
    Bce,
    Hinge,
}

pub(super) fn set<T>(slot: &mut T, value: Option<T>) {
    if let Some(value) = value {
        *slot = value;
    }
}

impl TrainOverrideArgs {
    /// Puts what is given in the place of what `config` says.
    pub(super) fn apply_to(&self, config: &mut RunConfig) {
        let RunConfig { model, loss, train, weighting } = config;
        set(&mut train.epochs, self.epochs);
        set(&mut train.batch, self.batch);
        set(&mut train.peak_rate, self.peak_rate);
        set(&mut train.warmup_epochs, self.warmup_epochs);
        let schedule = self.schedule.map(|name| match name {
            ScheduleName::Exponential => RateSchedule::Exponential,
            ScheduleName::Cosine => RateSchedule::Cosine,
        });
        set(&mut train.schedule, schedule);
        let rule = self.optimiser.map(|name| match name {
            OptimiserName::Sgd => OptimiserKind::Sgd,
            OptimiserName::Adam => OptimiserKind::Adam,
        });
        set(&mut train.optimiser, rule);
        set(&mut loss.kl, self.kl);
        set(&mut train.kl_warmup_epochs, self.kl_warmup_epochs);
        set(&mut loss.gan, self.gan);
        let adversary = self.adversary.map(|name| match name {
            AdversarialLossName::Bce => AdversarialLoss::Bce,
            AdversarialLossName::Hinge => AdversarialLoss::Hinge,
        });
        set(&mut loss.adversary, adversary);
        if let Some(discriminator) = &mut model.discriminator {
            discriminator.spectral_norm |= self.spectral_norm;
        }
        set(&mut train.ema, self.ema);
        set(&mut train.checkpoint_steps, self.checkpoint_steps);
        set(&mut train.keep, self.keep);
        train.preload |= self.preload;
        set(weighting, self.weighting.map(Into::into));
    }
}
