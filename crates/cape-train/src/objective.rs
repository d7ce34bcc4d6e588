//! One evaluation of CAPE's objective (§4.3) and its gradients.

use burn::tensor::{Gradients, Tensor};
use cape_infer::DeviceBatch;
use cape_model::{
    Cape, Discriminator, Generator, Graphs, LossConfig, Posterior,
    losses::{discriminator_adversarial, edge, generator_adversarial, kl, reconstruction},
};
use serde::{Deserialize, Serialize};

/// Each term of the objective, unweighted, both totals, and how often the discriminator is right.
///
/// See [`Evaluation`] for an example.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Losses {
    /// Reconstruction error.
    pub reconstruction: f64,
    /// Kullback–Leibler divergence.
    pub kl: f64,
    /// Edge error.
    pub edge: f64,
    /// Weighted ½‖W‖² of the regularised kernels.
    pub regularisation: f64,
    /// The generator's adversarial cross-entropy.
    pub gan_generator: f64,
    /// The discriminator's cross-entropies, real plus fake.
    pub gan_discriminator: f64,
    /// What the generator and the condition nets minimise.
    pub total_generator: f64,
    /// What the discriminator minimises.
    pub total_discriminator: f64,
    /// The share of patches, real and fake alike, that the discriminator judges rightly; 0 without
    /// one.
    #[serde(default)]
    pub discriminator_accuracy: f64,
}

impl Losses {
    const COUNT: usize = 9;

    fn from_values(values: [f64; Self::COUNT]) -> Self {
        let [
            reconstruction,
            kl,
            edge,
            regularisation,
            gan_generator,
            gan_discriminator,
            total_generator,
            total_discriminator,
            discriminator_accuracy,
        ] = values;
        Self {
            reconstruction,
            kl,
            edge,
            regularisation,
            gan_generator,
            gan_discriminator,
            total_generator,
            total_discriminator,
            discriminator_accuracy,
        }
    }

    /// The terms with their names, as they are logged.
    pub fn named_values(&self) -> [(&'static str, f64); Self::COUNT] {
        [
            ("reconstruction", self.reconstruction),
            ("kl", self.kl),
            ("edge", self.edge),
            ("regularisation", self.regularisation),
            ("gan_generator", self.gan_generator),
            ("gan_discriminator", self.gan_discriminator),
            ("total_generator", self.total_generator),
            ("total_discriminator", self.total_discriminator),
            ("discriminator_accuracy", self.discriminator_accuracy),
        ]
    }

    /// The first term that is not finite.
    pub fn non_finite(&self) -> Option<&'static str> {
        self.named_values().into_iter().find(|(_, value)| !value.is_finite()).map(|(name, _)| name)
    }
}

/// Losses at the current weights, and the gradients each optimiser needs.
///
/// ```
/// # use cape_core::Mesh;
/// use burn::tensor::{Device, Tensor};
/// use cape_model::{Cape, CapeConfig, LossConfig};
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
/// let input = StepInput { frames, epsilon: None, real: None };
/// let evaluation = evaluate(&model, &graphs, &config.loss, &input);
/// assert_eq!(evaluation.losses.non_finite(), None);
/// assert!(evaluation.discriminator.is_none());
/// assert!(global_norm(&model.generator, &evaluation.generator) > 0.0);
///
/// // Without gradients, the terms are the same.
/// let reconstructed = reconstruct(&model.generator, &graphs, &input.frames, None);
/// assert_eq!(reconstructed.displacement.dims(), [2, 4, 3]);
/// let terms = reconstruction_terms(&config.loss, &graphs, &reconstructed, &input.frames);
/// assert!((terms.reconstruction - evaluation.losses.reconstruction).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Evaluation {
    /// The terms.
    pub losses: Losses,
    /// Of the generator's total; use those of the generator's parameters only.
    pub generator: Gradients,
    /// Of the discriminator's total.
    pub discriminator: Option<Gradients>,
}

/// A step's batches and noise.
///
/// See [`Evaluation`] for an example.
#[derive(Debug, Clone)]
pub struct StepInput {
    /// The generator's frames.
    pub frames: DeviceBatch,
    /// Standard normal noise of the posterior's sample, `[batch, latent]`; none for the mean.
    pub epsilon: Option<Tensor<2>>,
    /// The discriminator's real frames; none without a discriminator.
    pub real: Option<DeviceBatch>,
}

/// What the generator makes of a batch.
///
/// See [`Evaluation`] for an example.
pub struct GeneratorOutput {
    /// `q(z|x)`.
    pub posterior: Posterior,
    /// Embedded conditions, `[batch, embedding]`.
    pub condition: Option<Tensor<2>>,
    /// Normalised displacements, `[batch, vertices, 3]`.
    pub displacement: Tensor<3>,
}

/// Encodes and decodes a batch; without `epsilon` the code is the posterior's mean.
pub fn reconstruct(
    generator: &Generator,
    graphs: &Graphs,
    frames: &DeviceBatch,
    epsilon: Option<Tensor<2>>,
) -> GeneratorOutput {
    let condition = generator.condition.forward(frames.pose_feature.clone(), frames.outfit.clone());
    let posterior = generator.encoder.forward(
        frames.displacement.clone(),
        condition.as_ref(),
        &graphs.generator,
    );
    let z = match epsilon {
        Some(epsilon) => posterior.sample(epsilon),
        None => posterior.mean.clone(),
    };
    let displacement = generator.decoder.forward(z, condition.as_ref(), &graphs.generator);
    GeneratorOutput { posterior, condition, displacement }
}

/// The terms that need no gradient and no discriminator: for validation.
pub fn reconstruction_terms(
    config: &LossConfig,
    graphs: &Graphs,
    result: &GeneratorOutput,
    frames: &DeviceBatch,
) -> Losses {
    let (predicted, target) = (&result.displacement, &frames.displacement);
    let value = |loss: Tensor<1>| f64::from(loss.into_scalar::<f32>());
    Losses {
        reconstruction: value(reconstruction(config.kind, predicted.clone(), target.clone(), None)),
        edge: value(edge(predicted.clone(), target.clone(), &graphs.edges)),
        kl: value(kl(&result.posterior)),
        ..Losses::default()
    }
}

/// Evaluates every loss at the current weights and takes both gradients there: the fake samples
/// are the same for generator and discriminator, and detached for the latter.
pub fn evaluate(
    model: &Cape,
    graphs: &Graphs,
    config: &LossConfig,
    input: &StepInput,
) -> Evaluation {
    let frames = &input.frames;
    let fake = reconstruct(&model.generator, graphs, frames, input.epsilon.clone());
    let zero = || Tensor::<1>::zeros([1], &frames.displacement.device());

    let reconstruction_loss =
        reconstruction(config.kind, fake.displacement.clone(), frames.displacement.clone(), None);
    let edge_loss = edge(fake.displacement.clone(), frames.displacement.clone(), &graphs.edges);
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
        gan_generator = generator_adversarial(config, logits);
        total = total + gan_generator.clone() * config.gan;
    }
    let generator_gradients = total.backward();

    let mut gan_discriminator = zero();
    let mut total_discriminator = zero();
    let mut accuracy = zero();
    let mut discriminator_gradients = None;
    if let (Some((discriminator, _)), Some(real)) = (adversary, &input.real) {
        let [on_real, on_fake] =
            discriminator_logits(discriminator, &model.generator, graphs, real, &fake);
        let right = on_real.clone().detach().greater_elem(0).float().mean()
            + on_fake.clone().detach().lower_elem(0).float().mean();
        accuracy = right * 0.5;
        gan_discriminator = discriminator_adversarial(config, on_real, on_fake);
        total_discriminator = gan_discriminator.clone() * config.gan;
        discriminator_gradients = Some(total_discriminator.backward());
    }

    let terms = vec![
        reconstruction_loss,
        kl_loss,
        edge_loss,
        regularisation,
        gan_generator,
        gan_discriminator,
        total,
        total_discriminator,
        accuracy,
    ];
    let values: Vec<f32> = Tensor::cat(terms, 0)
        .detach()
        .into_data()
        .try_into_vec()
        .unwrap_or_else(|_| unreachable!("losses are f32"));
    let mut named = [0.0; Losses::COUNT];
    for (named, value) in named.iter_mut().zip(values) {
        *named = f64::from(value);
    }
    Evaluation {
        losses: Losses::from_values(named),
        generator: generator_gradients,
        discriminator: discriminator_gradients,
    }
}

/// The discriminator's logits on real frames and on detached samples.
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
