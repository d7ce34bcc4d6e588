//! Evaluation of CAPE's training objective (§4.2) and its gradients.

use burn::tensor::{Gradients, Tensor};
use cape_core::tensors::to_host;
use cape_infer::DeviceBatch;
use cape_model::{
    Cape, Discriminator, Generator, Graphs, LossConfig, Posterior,
    losses::{
        LossWeights, discriminator_adversarial, edge, generator_adversarial, kl, reconstruction,
        weighted_mean,
    },
};
use serde::{Deserialize, Serialize};

/// Defines [`Losses`] and [`LossTensors`], its values on the device, from one list of fields.
macro_rules! losses {
    ($($(#[$attribute:meta])* $name:ident,)*) => {
        /// Values of all loss terms (CAPE §4.2), unweighted but for regularisation and totals, and
        /// the accuracy of the discriminator.
        #[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
        pub struct Losses {
            $($(#[$attribute])* pub $name: f64,)*
        }

        impl Losses {
            pub(crate) const COUNT: usize = [$(stringify!($name)),*].len();

            /// Names and values of all fields, in the order of the log.
            pub fn named_values(&self) -> [(&'static str, f64); Self::COUNT] {
                [$((stringify!($name), self.$name)),*]
            }

            /// Losses of [`COUNT`](Self::COUNT) values in the order of the log; missing ones are not a
            /// number.
            pub(crate) fn from_values(values: impl IntoIterator<Item = f32>) -> Self {
                let mut values = values.into_iter().map(f64::from);
                Self { $($name: values.next().unwrap_or(f64::NAN),)* }
            }
        }

        /// [`Losses`] on the device, each `[1]`.
        struct LossTensors {
            $($name: Tensor<1>,)*
        }

        impl LossTensors {
            /// Copies all values to the host at once.
            fn read(self) -> Losses {
                Losses::from_values(to_host(Tensor::cat(vec![$(self.$name),*], 0).detach()))
            }
        }
    };
}

losses! {
    /// Reconstruction loss.
    reconstruction,
    /// Kullback–Leibler divergence of the posterior from the prior.
    kl,
    /// Edge loss.
    edge,
    /// Weighted ½‖W‖² of the regularised kernels.
    regularisation,
    /// Adversarial loss of the generator.
    gan_generator,
    /// Adversarial loss of the discriminator, real plus fake.
    gan_discriminator,
    /// Weighted total of the generator and the condition nets.
    total_generator,
    /// Weighted total of the discriminator.
    total_discriminator,
    /// Share of patches, real and fake, that the discriminator classifies correctly; 0 without one.
    #[serde(default)]
    discriminator_accuracy,
    /// Share of real patches that it classifies correctly.
    #[serde(default)]
    discriminator_accuracy_real,
    /// Share of fake patches that it classifies correctly.
    #[serde(default)]
    discriminator_accuracy_fake,
}

impl Losses {
    /// Name of the first field that is not finite.
    pub fn non_finite(&self) -> Option<&'static str> {
        self.named_values().into_iter().find(|(_, value)| !value.is_finite()).map(|(name, _)| name)
    }
}

/// Losses at the current weights, and the gradients of both optimisers.
///
/// ```
/// # use cape_core::Mesh;
/// use burn::tensor::{Device, Tensor};
/// use cape_model::{Cape, CapeConfig, LossConfig, losses::LossWeights};
/// use cape_infer::{DeviceBatch, RunConfig, build_graphs};
/// use cape_train::{objective::{StepInput, evaluate, reconstruct, reconstruction_terms}, optim::global_norm};
///
/// # let mesh = Mesh {
/// #     vertices: vec![[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]],
/// #     faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
/// # };
/// # let model = CapeConfig {
/// #     filters: vec![4],
/// #     factors: vec![1],
/// #     discriminator: None,
/// #     ..CapeConfig::tiny()
/// # };
/// // A mesh of four vertices, and the configuration `model` without a discriminator.
/// let config = RunConfig { model, ..RunConfig::default() };
/// let device = Device::default().autodiff();
/// let graphs = build_graphs(&config, &mesh, &device)?;
/// let model = Cape::new(&config.model, &graphs, 1, &device)?;
/// let frames = DeviceBatch {
///     displacement: Tensor::ones([2, 4, 3], &device),
///     pose_feature: Tensor::zeros([2, 126], &device),
///     outfit: Tensor::zeros([2, 4], &device),
/// };
/// let input = StepInput { frames, encoded: None, epsilon: None, real: None };
/// let weights = LossWeights::default();
/// let evaluation = evaluate(&model, &graphs, &config.loss, &weights, &input);
/// assert_eq!(evaluation.losses.non_finite(), None);
/// assert!(evaluation.discriminator.is_none());
/// assert!(global_norm(&model.generator, &evaluation.generator) > 0.0);
///
/// // The terms without gradients are equal.
/// let reconstructed = reconstruct(&model.generator, &graphs, &input.frames, None);
/// assert_eq!(reconstructed.displacement.dims(), [2, 4, 3]);
/// let terms = reconstruction_terms(&config.loss, &weights, &graphs, &reconstructed, &input.frames);
/// assert!((terms.reconstruction - evaluation.losses.reconstruction).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Evaluation {
    /// Loss values.
    pub losses: Losses,
    /// Gradients of the generator's total; valid for the parameters of the generator only.
    pub generator: Gradients,
    /// Gradients of the discriminator's total; `None` without a discriminator.
    pub discriminator: Option<Gradients>,
}

/// Batches and noise of a training step, on the device.
#[derive(Debug, Clone)]
pub struct StepInput {
    /// Frames of the generator.
    pub frames: DeviceBatch,
    /// Frames that are encoded in place of them, from which they are reconstructed under their own
    /// conditions; `None` encodes the frames themselves, as in the paper.
    pub encoded: Option<DeviceBatch>,
    /// Standard normal noise of the posterior sample, `[batch, latent]`; `None` uses the mean.
    pub epsilon: Option<Tensor<2>>,
    /// Real frames of the discriminator; `None` without a discriminator.
    pub real: Option<DeviceBatch>,
}

/// Output of the generator for a batch.
pub struct GeneratorOutput {
    /// Posterior `q(z|x)`.
    pub posterior: Posterior,
    /// Embedded conditions, `[batch, embedding]`.
    pub condition: Option<Tensor<2>>,
    /// Reconstructed normalised displacements, `[batch, vertices, 3]`.
    pub displacement: Tensor<3>,
}

/// Encodes and decodes a batch; without `epsilon: [batch, latent]` the code is the mean of the
/// posterior.
pub fn reconstruct(
    generator: &Generator,
    graphs: &Graphs,
    frames: &DeviceBatch,
    epsilon: Option<Tensor<2>>,
) -> GeneratorOutput {
    let condition = generator.condition.forward(frames.pose_feature.clone(), frames.outfit.clone());
    transfer(generator, graphs, (frames, condition.clone()), condition, epsilon)
}

/// Encodes frames under their conditions, and decodes them under others.
fn transfer(
    generator: &Generator,
    graphs: &Graphs,
    (encoded, worn): (&DeviceBatch, Option<Tensor<2>>),
    condition: Option<Tensor<2>>,
    epsilon: Option<Tensor<2>>,
) -> GeneratorOutput {
    let posterior =
        generator.encoder.forward(encoded.displacement.clone(), worn.as_ref(), &graphs.generator);
    let z = match epsilon {
        Some(epsilon) => posterior.sample(epsilon),
        None => posterior.mean.clone(),
    };
    let displacement = generator.decoder.forward(z, condition.as_ref(), &graphs.generator);
    GeneratorOutput { posterior, condition, displacement }
}

/// Reconstruction, edge and Kullback–Leibler terms without gradients, for validation.
pub fn reconstruction_terms(
    config: &LossConfig,
    weights: &LossWeights,
    graphs: &Graphs,
    result: &GeneratorOutput,
    frames: &DeviceBatch,
) -> Losses {
    let [predicted, target] =
        [&result.displacement, &frames.displacement].map(|values| weights.apply(values.clone()));
    let value = |loss: Tensor<1>| f64::from(loss.into_scalar::<f32>());
    Losses {
        reconstruction: value(reconstruction(config.kind, predicted.clone(), target.clone())),
        edge: value(edge(predicted, target, &graphs.edges)),
        kl: value(kl(&result.posterior)),
        ..Losses::default()
    }
}

/// Evaluates all losses and the gradients of generator and discriminator at the current weights.
/// Both use the same generated samples, detached for the discriminator.
pub fn evaluate(
    model: &Cape,
    graphs: &Graphs,
    config: &LossConfig,
    weights: &LossWeights,
    input: &StepInput,
) -> Evaluation {
    let frames = &input.frames;
    let embed = |of: &DeviceBatch| {
        model.generator.condition.forward(of.pose_feature.clone(), of.outfit.clone())
    };
    let fake = match &input.encoded {
        None => reconstruct(&model.generator, graphs, frames, input.epsilon.clone()),
        Some(other) => {
            let worn = (other, embed(other));
            transfer(&model.generator, graphs, worn, embed(frames), input.epsilon.clone())
        }
    };
    let zero = || Tensor::<1>::zeros([1], &frames.displacement.device());

    let [predicted, target] =
        [&fake.displacement, &frames.displacement].map(|values| weights.apply(values.clone()));
    let reconstruction_loss = reconstruction(config.kind, predicted.clone(), target.clone());
    let edge_loss = edge(predicted, target, &graphs.edges);
    let kl_loss = if input.epsilon.is_some() { kl(&fake.posterior) } else { zero() };
    let regularisation = model.generator.regularisation() * config.regularisation;
    let mut total = reconstruction_loss.clone() * config.reconstruction
        + edge_loss.clone() * config.edge
        + kl_loss.clone() * config.kl
        + regularisation.clone();

    let adversary = model.discriminator.as_ref().zip(graphs.discriminator.as_ref());
    let mut gan_generator = zero();
    if let Some((discriminator, graph)) = adversary {
        let frozen = burn::module::Module::no_grad(discriminator.clone());
        let logits = frozen.forward(fake.displacement.clone(), fake.condition.as_ref(), graph);
        gan_generator = generator_adversarial(config, logits, weights.patches.as_ref());
        total = total + gan_generator.clone() * config.gan;
    }
    let generator_gradients = total.backward();

    let mut gan_discriminator = zero();
    let mut total_discriminator = zero();
    let (mut accuracy_real, mut accuracy_fake) = (zero(), zero());
    let mut discriminator_gradients = None;
    if let (Some((discriminator, _)), Some(real)) = (adversary, &input.real) {
        let [on_real, on_fake] =
            discriminator_logits(discriminator, &model.generator, graphs, real, &fake);
        let patches = weights.patches.as_ref();
        let [right_real, right_fake] = [
            on_real.clone().detach().greater_elem(0).float(),
            on_fake.clone().detach().lower_elem(0).float(),
        ]
        .map(|right| weighted_mean(right, patches));
        accuracy_real = right_real;
        accuracy_fake = right_fake;
        gan_discriminator = discriminator_adversarial(config, on_real, on_fake, patches);
        total_discriminator = gan_discriminator.clone() * config.gan;
        discriminator_gradients = Some(total_discriminator.backward());
    }

    let losses = LossTensors {
        reconstruction: reconstruction_loss,
        kl: kl_loss,
        edge: edge_loss,
        regularisation,
        gan_generator,
        gan_discriminator,
        total_generator: total,
        total_discriminator,
        discriminator_accuracy: (accuracy_real.clone() + accuracy_fake.clone()) * 0.5,
        discriminator_accuracy_real: accuracy_real,
        discriminator_accuracy_fake: accuracy_fake,
    };
    Evaluation {
        losses: losses.read(),
        generator: generator_gradients,
        discriminator: discriminator_gradients,
    }
}

/// Logits of the discriminator on real frames and on detached samples, each `[batch, patches, 1]`.
fn discriminator_logits(
    discriminator: &Discriminator,
    generator: &Generator,
    graphs: &Graphs,
    real: &DeviceBatch,
    fake: &GeneratorOutput,
) -> [Tensor<3>; 2] {
    let Some(graph) = &graphs.discriminator else {
        unreachable!("checked by the caller");
    };
    let condition = generator
        .condition
        .forward(real.pose_feature.clone(), real.outfit.clone())
        .map(Tensor::detach);
    let on_real = discriminator.forward(real.displacement.clone(), condition.as_ref(), graph);
    let fake_condition = fake.condition.clone().map(Tensor::detach);
    let on_fake =
        discriminator.forward(fake.displacement.clone().detach(), fake_condition.as_ref(), graph);
    [on_real, on_fake]
}
