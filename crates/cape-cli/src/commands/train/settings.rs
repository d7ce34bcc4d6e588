//! Options of a training that override its configuration.

use cape_graph::Weighting;
use cape_infer::{OptimiserKind, RateSchedule, RunConfig};
use cape_model::{AdversarialLoss, DisplacementUnit};
use clap::Args;

use crate::{
    commands::model::pyramid::WEIGHTINGS,
    options::{PrecisionArgs, at_least_one, choices},
};

/// Options that override the configuration.
#[derive(Debug, Args)]
#[command(next_help_heading = "Settings")]
pub(super) struct TrainOverrideArgs {
    /// Number of epochs.
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    epochs: Option<usize>,
    /// Frames per batch.
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    batch: Option<usize>,
    /// Learning rate after the warm-up.
    #[arg(long, value_name = "RATE")]
    peak_rate: Option<f64>,
    /// Epochs of learning rate warm-up.
    #[arg(long, value_name = "N")]
    warmup_epochs: Option<f64>,
    /// Learning rate schedule [paper: exponential].
    #[arg(long, value_name = "NAME", value_parser = choices(SCHEDULES))]
    schedule: Option<RateSchedule>,
    /// Optimiser [paper: sgd with momentum]; adam needs a --peak-rate of about 1e-3.
    #[arg(long, value_name = "NAME", value_parser = choices(OPTIMISERS))]
    optimiser: Option<OptimiserKind>,
    /// Weight of the Kullback–Leibler term.
    #[arg(long, value_name = "WEIGHT")]
    kl: Option<f64>,
    /// Epochs over which that weight rises from 0.
    #[arg(long, value_name = "N")]
    kl_warmup_epochs: Option<f64>,
    /// Weight of the adversarial loss.
    #[arg(long, value_name = "WEIGHT")]
    gan: Option<f64>,
    /// Learning rate of the discriminator relative to the generator's [default: 0.1].
    #[arg(long, value_name = "FACTOR")]
    discriminator_rate: Option<f64>,
    /// Adversarial loss: binary cross-entropy or hinge [paper: bce].
    #[arg(long, value_name = "NAME", value_parser = choices(ADVERSARIAL_LOSSES))]
    adversary: Option<AdversarialLoss>,
    /// Use spectral normalisation in the discriminator.
    #[arg(long)]
    spectral_norm: bool,
    /// Unit of displacements in the reconstruction and edge losses [paper: deviations].
    #[arg(long, value_name = "NAME", value_parser = choices(UNITS))]
    unit: Option<DisplacementUnit>,
    /// Weight of vertices without clothing in the reconstruction and edge losses [paper: 1].
    #[arg(long, value_name = "WEIGHT")]
    bare_weight: Option<f64>,
    /// Count only patches at clothing vertices in the adversarial losses.
    #[arg(long)]
    clothing_patches: bool,
    /// Share of the frames, 0 to 1, whose code is that of another frame of the same capture, so that the
    /// pose must explain the difference [paper: 0].
    #[arg(long, value_name = "SHARE")]
    transfer: Option<f64>,
    /// Share of the frames, 0 to 1, that are reconstructed under the pose of another training frame, so
    /// that clothing keeps its offsets in poses that it was not captured in [paper: 0].
    #[arg(long, value_name = "SHARE")]
    pose_swap: Option<f64>,
    #[command(flatten)]
    precision: PrecisionArgs,
    /// Decay of an exponential moving average of the weights to evaluate and sample with, such as 0.999.
    #[arg(long, value_name = "FACTOR")]
    ema: Option<f64>,
    /// Steps between checkpoints within an epoch; 0 saves at the end of epochs only.
    #[arg(long, value_name = "N")]
    checkpoint_steps: Option<usize>,
    /// Steps between lines of `metrics.jsonl`.
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    log_steps: Option<usize>,
    /// Number of newest checkpoints to keep besides the best.
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    keep: Option<usize>,
    /// Read the whole training set into memory.
    #[arg(long)]
    preload: bool,
    /// Up-sampling weights: barycentric, or those of the authors' release.
    #[arg(long, value_name = "NAME", value_parser = choices(WEIGHTINGS))]
    weighting: Option<Weighting>,
}

const SCHEDULES: [(&str, RateSchedule); 2] =
    [("exponential", RateSchedule::Exponential), ("cosine", RateSchedule::Cosine)];
const OPTIMISERS: [(&str, OptimiserKind); 2] =
    [("sgd", OptimiserKind::Sgd), ("adam", OptimiserKind::Adam)];
const UNITS: [(&str, DisplacementUnit); 2] =
    [("deviations", DisplacementUnit::Deviations), ("metres", DisplacementUnit::Metres)];
const ADVERSARIAL_LOSSES: [(&str, AdversarialLoss); 2] =
    [("bce", AdversarialLoss::Bce), ("hinge", AdversarialLoss::Hinge)];

pub(super) fn set<T>(slot: &mut T, value: Option<T>) {
    if let Some(value) = value {
        *slot = value;
    }
}

impl TrainOverrideArgs {
    /// Overrides `config` by the options that are given.
    pub(super) fn apply_to(&self, config: &mut RunConfig) {
        let RunConfig { model, loss, train, weighting } = config;
        set(&mut train.epochs, self.epochs);
        set(&mut train.batch, self.batch);
        set(&mut train.peak_rate, self.peak_rate);
        set(&mut train.warmup_epochs, self.warmup_epochs);
        set(&mut train.schedule, self.schedule);
        set(&mut train.optimiser, self.optimiser);
        set(&mut loss.kl, self.kl);
        set(&mut train.kl_warmup_epochs, self.kl_warmup_epochs);
        set(&mut loss.gan, self.gan);
        set(&mut train.discriminator_rate_scale, self.discriminator_rate);
        set(&mut loss.adversary, self.adversary);
        if let Some(discriminator) = &mut model.discriminator {
            discriminator.spectral_norm |= self.spectral_norm;
        }
        set(&mut loss.unit, self.unit);
        set(&mut loss.bare_weight, self.bare_weight);
        loss.clothing_patches |= self.clothing_patches;
        set(&mut train.transfer, self.transfer);
        set(&mut train.pose_swap, self.pose_swap);
        set(&mut train.precision, self.precision.precision);
        set(&mut train.ema, self.ema);
        set(&mut train.checkpoint_steps, self.checkpoint_steps);
        set(&mut train.log_steps, self.log_steps);
        set(&mut train.keep, self.keep);
        train.preload |= self.preload;
        set(weighting, self.weighting);
    }
}
