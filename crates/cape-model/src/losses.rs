//! Loss terms of CAPE's training objective (§4.2).

use burn::tensor::{
    Tensor,
    activation::{log_sigmoid, relu},
};
use cape_graph::{SparseMatrix, sparse_matmul};
use serde::{Deserialize, Serialize};

use crate::{Error, Posterior, Result};

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

const HUBER_DELTA: f64 = 0.1;

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
/// let error: f32 = losses::reconstruction(config.kind, predicted, target, None).into_scalar();
/// assert_eq!(error, 0.5);
/// // Logits of 0 have a cross-entropy of log 2.
/// let undecided = Tensor::zeros([1, 4, 1], &device);
/// let loss: f32 = losses::generator_adversarial(&config, undecided).into_scalar();
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

/// Reconstruction loss, `[1]`: mean over batch, vertices and coordinates.
///
/// `predicted`, `target`: `[batch, vertices, 3]`; `vertex_weights`: factors on the error of each
/// vertex, `[vertices]`.
pub fn reconstruction(
    kind: ReconstructionLoss,
    predicted: Tensor<3>,
    target: Tensor<3>,
    vertex_weights: Option<Tensor<1>>,
) -> Tensor<1> {
    let difference = predicted - target;
    let error = match kind {
        ReconstructionLoss::L1 => difference.abs(),
        ReconstructionLoss::L2 => difference.clone() * difference,
        ReconstructionLoss::Huber => {
            let size = difference.abs();
            let quadratic = size.clone().clamp_max(HUBER_DELTA);
            let linear = size - quadratic.clone();
            quadratic.clone() * quadratic * 0.5 + linear * HUBER_DELTA
        }
    };
    match vertex_weights {
        Some(weights) => {
            let [_, vertices, _] = error.dims();
            (error * weights.reshape([1, vertices, 1])).mean()
        }
        None => error.mean(),
    }
}

/// Edge loss, `[1]`: length of the difference between predicted and true edge vectors, mean over
/// batch and edges.
///
/// `predicted`, `target`: `[batch, vertices, 3]`; `edges`: edge difference operator of
/// [`Graphs`](crate::Graphs). The gradient at equal edges is zero.
pub fn edge(predicted: Tensor<3>, target: Tensor<3>, edges: &SparseMatrix) -> Tensor<1> {
    let difference = sparse_matmul(predicted - target, edges);
    let squared = (difference.clone() * difference).sum_dim(2);
    squared.clamp_min(1e-24).sqrt().mean()
}

/// Kullback–Leibler divergence `KL(q(z|x) ‖ N(0, I))`, `[1]`: sum over the code, mean over the
/// batch.
pub fn kl(posterior: &Posterior) -> Tensor<1> {
    let Posterior { mean, log_variance } = posterior;
    let inner =
        log_variance.clone() + 1.0 - mean.clone() * mean.clone() - log_variance.clone().exp();
    inner.sum_dim(1).mean() * -0.5
}

/// Adversarial loss of the generator, `[1]`, from the logits `fake: [batch, patches, 1]` of its
/// samples.
pub fn generator_adversarial(config: &LossConfig, fake: Tensor<3>) -> Tensor<1> {
    match config.adversary {
        AdversarialLoss::Bce => cross_entropy(fake, 1.0 - config.label_smoothing),
        AdversarialLoss::Hinge => -fake.mean(),
    }
}

/// Adversarial loss of the discriminator, `[1]`, from the logits of real frames and of samples,
/// both `[batch, patches, 1]`.
pub fn discriminator_adversarial(
    config: &LossConfig,
    real: Tensor<3>,
    fake: Tensor<3>,
) -> Tensor<1> {
    match config.adversary {
        AdversarialLoss::Bce => {
            cross_entropy(real, 1.0 - config.label_smoothing)
                + cross_entropy(fake, config.label_smoothing)
        }
        AdversarialLoss::Hinge => relu(-real + 1.0).mean() + relu(fake + 1.0).mean(),
    }
}

/// Binary cross-entropy of `logits: [batch, patches, 1]` with one `label` for all, mean, `[1]`.
pub fn cross_entropy(logits: Tensor<3>, label: f64) -> Tensor<1> {
    let real = log_sigmoid(logits.clone()) * label;
    let fake = log_sigmoid(-logits) * (1.0 - label);
    -(real + fake).mean()
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};

    use super::*;

    /// First device of `CAPE_TEST_DEVICES`, or the first one compiled in.
    fn device() -> Device {
        let names = std::env::var("CAPE_TEST_DEVICES").unwrap_or_default();
        let name = names.split(',').find(|name| !name.is_empty()).unwrap_or(cape_core::DEVICES[0]);
        cape_core::parse_device(name).unwrap()
    }

    fn tensor<const D: usize>(values: &[f32], shape: [usize; D]) -> Tensor<D> {
        Tensor::from_data(TensorData::new(values.to_vec(), shape), &device())
    }

    fn value(loss: Tensor<1>) -> f32 {
        loss.into_scalar::<f32>()
    }

    #[test]
    fn reconstruction_kinds_match_closed_forms() {
        let x = tensor(&[0.05, -0.3, 1.0], [1, 1, 3]);
        let y = tensor(&[0.0, 0.0, 0.0], [1, 1, 3]);
        let of = |kind| value(reconstruction(kind, x.clone(), y.clone(), None));
        assert!((of(ReconstructionLoss::L1) - 0.45).abs() < 1e-6);
        assert!((of(ReconstructionLoss::L2) - (0.0025 + 0.09 + 1.0) / 3.0).abs() < 1e-6);
        let huber = (0.5 * 0.0025 + (0.03 - 0.005) + (0.1 - 0.005)) / 3.0;
        assert!((of(ReconstructionLoss::Huber) - huber).abs() < 1e-6);
    }

    #[test]
    fn vertex_weights_scale_each_vertex() {
        let x = tensor(&[1.0, 1.0, 1.0, 1.0, 1.0, 1.0], [1, 2, 3]);
        let y = tensor(&[0.0; 6], [1, 2, 3]);
        let weights = tensor(&[2.0, 0.0], [2]);
        assert_eq!(value(reconstruction(ReconstructionLoss::L1, x, y, Some(weights))), 1.0);
    }

    #[test]
    fn cross_entropy_is_stable_and_exact() {
        for (logit, label) in [(0.3f32, 0.9), (-2.0, 0.1), (80.0, 0.9), (-80.0, 0.9)] {
            let got = value(cross_entropy(tensor(&[logit], [1, 1, 1]), label));
            let x = f64::from(logit);
            let log_sigmoid = |x: f64| -(-x).exp().ln_1p();
            let stable = |x: f64| if x < -30.0 { x } else { log_sigmoid(x) };
            let expected = -(label * stable(x) + (1.0 - label) * stable(-x));
            assert!((f64::from(got) - expected).abs() < 1e-5 * expected.max(1.0), "{logit}");
        }
    }

    #[test]
    fn cross_entropy_has_the_gradient_of_its_closed_form_even_at_zero() {
        let device = device().autodiff();
        for logit in [0.0f32, 1e-9, -1e-9, 3.0, -60.0, 60.0] {
            let x = Tensor::<3>::from_data(TensorData::new(vec![logit], [1, 1, 1]), &device)
                .require_grad();
            let gradients = cross_entropy(x.clone(), 0.9).backward();
            let found = x.grad(&gradients).unwrap().into_scalar::<f32>();
            let expected = 1.0 / (1.0 + (-f64::from(logit)).exp()) - 0.9;
            assert!((f64::from(found) - expected).abs() < 1e-6, "{logit}: {found}");
        }
    }

    #[test]
    fn hinges_match_their_closed_forms() {
        let config = LossConfig { adversary: AdversarialLoss::Hinge, ..LossConfig::default() };
        let (real, fake) = ([0.5f32, 2.0], [-0.25f32, -3.0]);
        let [real, fake] = [real, fake].map(|values| tensor(&values, [1, 2, 1]));
        assert!((value(generator_adversarial(&config, fake.clone())) - 1.625).abs() < 1e-6);
        assert!((value(discriminator_adversarial(&config, real, fake)) - 0.625).abs() < 1e-6);
    }

    #[test]
    fn kl_of_the_prior_is_zero_and_grows_as_the_closed_form() {
        let posterior = Posterior {
            mean: tensor(&[0.0, 0.0], [1, 2]),
            log_variance: tensor(&[0.0, 0.0], [1, 2]),
        };
        assert_eq!(value(kl(&posterior)), 0.0);
        let posterior = Posterior {
            mean: tensor(&[1.0, -2.0], [1, 2]),
            log_variance: tensor(&[0.5, -1.0], [1, 2]),
        };
        let expected =
            -0.5 * ((1.0 + 0.5 - 1.0 - 0.5f32.exp()) + (1.0 - 1.0 - 4.0 - (-1.0f32).exp()));
        assert!((value(kl(&posterior)) - expected).abs() < 1e-5);
    }

    #[test]
    fn bad_weights_are_named() {
        let bad = LossConfig { kl: f64::NAN, ..LossConfig::default() };
        assert!(bad.validate().unwrap_err().to_string().contains("loss.kl"));
    }
}
