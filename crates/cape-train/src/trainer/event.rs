//! Events and result of training.

use std::path::PathBuf;

use serde::Serialize;

use crate::objective::Losses;

/// Event during training.
#[derive(Debug, Clone)]
pub enum TrainEvent {
    /// End of a step.
    Step {
        /// Epoch, counted from 1.
        epoch: usize,
        /// Step within the epoch, counted from 1.
        step: usize,
        /// Number of steps of an epoch.
        steps: usize,
        /// Number of steps since the start of the run.
        total_step: u64,
        /// Losses before the update.
        losses: Losses,
        /// Learning rate of the generator.
        rate: f64,
        /// Duration of the step, seconds.
        seconds: f64,
    },
    /// Reconstruction of the validation frames.
    Validation {
        /// Epoch, counted from 1.
        epoch: usize,
        /// Reconstruction, edge and Kullback–Leibler terms; the others are zero.
        losses: Losses,
        /// Mean error at clothing vertices, millimetres.
        millimetres: f64,
        /// Active latent dimensions: those whose posterior mean varies over the frames.
        active_units: usize,
        /// Share of patches that the discriminator classified correctly in the steps of the epoch;
        /// `None` without a discriminator.
        discriminator_accuracy: Option<f64>,
    },
    /// Encoding of training frames for the prior of latent codes, at the end of training.
    Prior {
        /// Number of encoded frames.
        done: usize,
        /// Number of frames to encode.
        total: usize,
    },
    /// End of writing a checkpoint.
    Checkpoint {
        /// Directory of the checkpoint.
        path: PathBuf,
    },
}

/// Result of training.
#[derive(Debug, Clone, Serialize)]
pub struct TrainOutcome {
    /// True if all epochs are done; otherwise the run can be resumed.
    pub finished: bool,
    /// Number of complete epochs.
    pub epochs: usize,
    /// Number of steps.
    pub steps: u64,
    /// Lowest mean validation error, millimetres.
    pub best_validation: Option<f64>,
    /// Training time over all sessions, seconds.
    pub seconds: f64,
}
