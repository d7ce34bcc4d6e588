//! Loss terms of CAPE's training objective (§4.2).

mod config;
mod weights;

use burn::tensor::{
    Tensor,
    activation::{relu, sigmoid},
};
use cape_graph::{SparseMatrix, sparse_matmul};

pub use config::{AdversarialLoss, DisplacementUnit, LossConfig, ReconstructionLoss};
pub use weights::{LossVertices, LossWeights};

use crate::Posterior;

const HUBER_DELTA: f64 = 0.1;

/// Reconstruction loss, `[1]`: mean over batch, vertices and coordinates.
///
/// `predicted`, `target`: `[batch, vertices, 3]`.
pub fn reconstruction(
    kind: ReconstructionLoss,
    predicted: Tensor<3>,
    target: Tensor<3>,
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
    error.mean()
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
/// samples; `patches` are weights of mean 1, `[1, patches, 1]`.
pub fn generator_adversarial(
    config: &LossConfig,
    fake: Tensor<3>,
    patches: Option<&Tensor<3>>,
) -> Tensor<1> {
    match config.adversary {
        AdversarialLoss::Bce => cross_entropy(fake, 1.0 - config.label_smoothing, patches),
        AdversarialLoss::Hinge => -weighted_mean(fake, patches),
    }
}

/// Adversarial loss of the discriminator, `[1]`, from the logits of real frames and of samples,
/// both `[batch, patches, 1]`; `patches` are weights of mean 1, `[1, patches, 1]`.
pub fn discriminator_adversarial(
    config: &LossConfig,
    real: Tensor<3>,
    fake: Tensor<3>,
    patches: Option<&Tensor<3>>,
) -> Tensor<1> {
    match config.adversary {
        AdversarialLoss::Bce => {
            cross_entropy(real, 1.0 - config.label_smoothing, patches)
                + cross_entropy(fake, config.label_smoothing, patches)
        }
        AdversarialLoss::Hinge => {
            weighted_mean(relu(-real + 1.0), patches) + weighted_mean(relu(fake + 1.0), patches)
        }
    }
}

/// Binary cross-entropy of `logits: [batch, patches, 1]` with one `label` for all, mean with the
/// weights `patches: [1, patches, 1]`, `[1]`.
pub fn cross_entropy(logits: Tensor<3>, label: f64, patches: Option<&Tensor<3>>) -> Tensor<1> {
    let fixed = logits.clone().detach();
    let softplus = relu(fixed.clone()) + (-fixed.clone().abs()).exp().log1p();
    let loss = softplus - fixed.clone() * label;
    // The gradient, σ(x) − label, in closed form: derivatives of the terms above are many more operations.
    let slope = sigmoid(fixed.clone()) - label;
    weighted_mean(loss + (logits - fixed) * slope, patches)
}

/// Mean of `values: [batch, patches, 1]` with weights of mean 1, `[1, patches, 1]`, as `[1]`.
pub fn weighted_mean(values: Tensor<3>, weights: Option<&Tensor<3>>) -> Tensor<1> {
    match weights {
        Some(weights) => (values * weights.clone()).mean(),
        None => values.mean(),
    }
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
        let of = |kind| value(reconstruction(kind, x.clone(), y.clone()));
        assert!((of(ReconstructionLoss::L1) - 0.45).abs() < 1e-6);
        assert!((of(ReconstructionLoss::L2) - (0.0025 + 0.09 + 1.0) / 3.0).abs() < 1e-6);
        let huber = (0.5 * 0.0025 + (0.03 - 0.005) + (0.1 - 0.005)) / 3.0;
        assert!((of(ReconstructionLoss::Huber) - huber).abs() < 1e-6);
    }

    #[test]
    fn vertices_count_by_unit_and_clothing() {
        let (x, y) = (tensor(&[1.0; 6], [1, 2, 3]), tensor(&[0.0; 6], [1, 2, 3]));
        let deviations = [0.01, 0.02, 0.03, 0.001, 0.001, 0.001];
        let vertices = LossVertices { deviations: &deviations, clothing: &[0] };
        let of = |unit, bare_weight| {
            let config = LossConfig { unit, bare_weight, ..LossConfig::default() };
            LossWeights::new(&config, vertices, None, &device()).unwrap()
        };
        assert!(of(DisplacementUnit::Deviations, 1.0).vertices.is_none());
        for (unit, bare) in [(DisplacementUnit::Deviations, 0.0), (DisplacementUnit::Metres, 0.5)] {
            let weights = of(unit, bare);
            let loss = |at: usize| {
                let mut one = [0.0; 6];
                one[at] = 1.0;
                let x = weights.apply(tensor(&one, [1, 2, 3]));
                f64::from(value(reconstruction(ReconstructionLoss::L1, x, y.clone())))
            };
            let metric = unit == DisplacementUnit::Metres;
            let expected = |at: usize| {
                let size = if metric { deviations[at] } else { 1.0 };
                size * if at < 3 { 1.0 } else { bare }
            };
            for at in 1..6 {
                assert!((loss(at) - loss(0) * expected(at) / expected(0)).abs() < 1e-6, "{at}");
            }
            // The scale of the whole loss stays.
            let whole = reconstruction(ReconstructionLoss::L1, weights.apply(x.clone()), y.clone());
            assert!((value(whole) - 1.0).abs() < 1e-6);
        }
        let none = LossConfig { bare_weight: 0.0, ..LossConfig::default() };
        let vertices = LossVertices { deviations: &deviations, clothing: &[] };
        let error = LossWeights::new(&none, vertices, None, &device()).unwrap_err();
        assert!(error.to_string().contains("bare_weight"), "{error}");
    }

    #[test]
    fn weighted_patches_are_all_that_counts() {
        let logits = tensor(&[0.3, -2.0, 5.0], [1, 3, 1]);
        let weights = tensor(&[1.5, 1.5, 0.0], [1, 3, 1]);
        let few = tensor(&[0.3, -2.0], [1, 2, 1]);
        for adversary in [AdversarialLoss::Bce, AdversarialLoss::Hinge] {
            let config = LossConfig { adversary, ..LossConfig::default() };
            let [all, some] =
                [(logits.clone(), Some(&weights)), (few.clone(), None)].map(|(logits, patches)| {
                    let real =
                        discriminator_adversarial(&config, logits.clone(), logits.clone(), patches);
                    [value(real), value(generator_adversarial(&config, logits, patches))]
                });
            assert!(all.iter().zip(some).all(|(a, b)| (a - b).abs() < 1e-6), "{all:?} {some:?}");
        }
    }

    #[test]
    fn cross_entropy_is_stable_and_exact() {
        for (logit, label) in [(0.3f32, 0.9), (-2.0, 0.1), (80.0, 0.9), (-80.0, 0.9)] {
            let got = value(cross_entropy(tensor(&[logit], [1, 1, 1]), label, None));
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
            let gradients = cross_entropy(x.clone(), 0.9, None).backward();
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
        assert!((value(generator_adversarial(&config, fake.clone(), None)) - 1.625).abs() < 1e-6);
        assert!((value(discriminator_adversarial(&config, real, fake, None)) - 0.625).abs() < 1e-6);
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
