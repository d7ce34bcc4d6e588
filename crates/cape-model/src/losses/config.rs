//! Weights and kinds of the loss terms.

use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Kind of the reconstruction loss.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ReconstructionLoss {
    /// Mean absolute difference.
    L1,
    /// Mean squared difference.
    L2,
    /// Huber's loss with δ = 0.1.
    Huber,
}

/// Kind of the adversarial loss.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AdversarialLoss {
    /// Binary cross-entropy of logits with smoothed labels, as in CAPE.
    #[default]
    Bce,
    /// Hinge loss (Lim and Ye 2017).
    Hinge,
}

/// Unit in which the reconstruction and edge losses measure displacements.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DisplacementUnit {
    /// Standard deviations of each vertex and coordinate, as in CAPE's release: all vertices count the
    /// same, however little they move.
    #[default]
    Deviations,
    /// Metres, up to one factor for all vertices.
    Metres,
}

/// Weights and kinds of the loss terms (CAPE §4.2 and appendix A.2).
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_model::{AdversarialLoss, LossConfig, ReconstructionLoss, losses};
///
/// let config = LossConfig {
///     kind: ReconstructionLoss::L1,
///     adversary: AdversarialLoss::Bce,
///     ..LossConfig::default()
/// };
/// config.validate()?;
/// let device = Device::default();
/// let predicted = Tensor::zeros([1, 2, 3], &device);
/// let target = Tensor::full([1, 2, 3], 0.5, &device);
/// let error: f32 = losses::reconstruction(config.kind, predicted, target).into_scalar();
/// assert_eq!(error, 0.5);
/// // Logits of 0 have a cross-entropy of log 2.
/// let undecided = Tensor::zeros([1, 4, 1], &device);
/// let loss: f32 = losses::generator_adversarial(&config, undecided, None).into_scalar();
/// assert!((loss - 2f32.ln()).abs() < 1e-6);
/// # Ok::<(), cape_model::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossConfig {
    /// Kind of the reconstruction loss.
    pub kind: ReconstructionLoss,
    /// Weight of the reconstruction loss.
    pub reconstruction: f64,
    /// Weight of the edge loss.
    pub edge: f64,
    /// Weight of the Kullback–Leibler divergence.
    pub kl: f64,
    /// Weight of the adversarial losses of generator and discriminator.
    pub gan: f64,
    /// Kind of the adversarial loss.
    pub adversary: AdversarialLoss,
    /// Label smoothing `s` of the cross-entropy: labels are `s` and `1 − s` instead of 0 and 1.
    pub label_smoothing: f64,
    /// Unit of displacements in the reconstruction and edge losses.
    pub unit: DisplacementUnit,
    /// Weight of vertices without clothing in the reconstruction and edge losses, relative to clothing
    /// vertices.
    pub bare_weight: f64,
    /// True if only patches at clothing vertices count in the adversarial losses.
    pub clothing_patches: bool,
    /// Weight of ½‖W‖² of the fully connected kernels. The release applies the paper's 2e-3 twice,
    /// in effect 4e-6, which is the default.
    pub regularisation: f64,
}

impl Default for LossConfig {
    fn default() -> Self {
        Self {
            kind: ReconstructionLoss::L1,
            reconstruction: 1.0,
            edge: 1.0,
            kl: 8e-4,
            gan: 0.1,
            adversary: AdversarialLoss::Bce,
            label_smoothing: 0.1,
            unit: DisplacementUnit::Deviations,
            bare_weight: 1.0,
            clothing_patches: false,
            regularisation: 4e-6,
        }
    }
}

impl LossConfig {
    /// Checks that every weight is finite and at least 0; errors name the field.
    pub fn validate(&self) -> Result<()> {
        for (field, value) in [
            ("reconstruction", self.reconstruction),
            ("edge", self.edge),
            ("kl", self.kl),
            ("gan", self.gan),
            ("label_smoothing", self.label_smoothing),
            ("bare_weight", self.bare_weight),
            ("regularisation", self.regularisation),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(Error::Config {
                    field: format!("loss.{field}"),
                    message: format!("must be a finite number of at least 0, not {value}"),
                });
            }
        }
        if self.label_smoothing >= 0.5 {
            return Err(Error::Config {
                field: "loss.label_smoothing".into(),
                message: format!("must be below 0.5, not {}", self.label_smoothing),
            });
        }
        Ok(())
    }
}
