//! A model with its optimisers.

use burn::{module::Module, tensor::Device};
use cape_data::DisplacementStatistics;
use cape_model::{
    Cape, Generator, Graphs, LossConfig,
    losses::{LossVertices, LossWeights},
    weights,
};

use crate::{
    Result,
    objective::{Evaluation, Losses, StepInput, evaluate},
    optim::{Optimiser, global_norm},
    parameter_average::ParameterAverage,
};
use cape_infer::{
    RunConfig,
    checkpoint::{Checkpoint, TrainState},
};

/// A model in training: networks, optimisers and, if configured, averaged weights.
///
/// Displacements of a tetrahedron, learned:
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_core::Mesh;
/// use cape_model::CapeConfig;
/// use cape_infer::{DeviceBatch, RunConfig, build_graphs};
/// use cape_train::{learner::{Learner, UpdateOptions}, objective::StepInput};
///
/// let tetrahedron = Mesh {
///     vertices: vec![[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]],
///     faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
/// };
/// let config = RunConfig {
///     model: CapeConfig {
///         filters: vec![4],
///         factors: vec![1],
///         discriminator: None,
///         ..CapeConfig::tiny()
///     },
///     ..RunConfig::default()
/// };
/// let device = Device::default().autodiff();
/// let graphs = build_graphs(&config, &tetrahedron, &device)?;
/// let mut learner = Learner::new(&config, graphs, &device)?;
/// let frames = DeviceBatch {
///     displacement: Tensor::ones([2, 4, 3], &device),
///     pose_feature: Tensor::zeros([2, 126], &device),
///     outfit: Tensor::zeros([2, 4], &device),
/// };
/// let input = StepInput { frames, encoded: None, epsilon: None, real: None };
/// let options = UpdateOptions { rate: 0.01, kl_share: 1.0, detailed: false };
/// let first = learner.update(&input, options)?.losses;
/// for _ in 0..20 {
///     learner.update(&input, options)?;
/// }
/// let last = learner.update(&input, options)?.losses;
/// assert!(last.reconstruction < first.reconstruction);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Learner {
    model: Cape,
    graphs: Graphs,
    update_graphs: Graphs,
    loss: LossConfig,
    loss_weights: LossWeights,
    generator: Optimiser,
    discriminator: Optimiser,
    discriminator_rate_scale: f64,
    average: Option<ParameterAverage>,
    steps: u64,
}

/// Losses and gradient norms of an update.
#[derive(Debug, Clone, Copy)]
pub struct UpdateReport {
    /// Losses before the update.
    pub losses: Losses,
    /// Norm of the generator's gradient before clipping.
    pub generator_norm: f64,
    /// Norm of the discriminator's gradient before clipping; `None` without a discriminator.
    pub discriminator_norm: Option<f64>,
    /// Norms of the gradients of the pose net and the outfit net; `None` for a net that does not
    /// exist or without [`UpdateOptions::detailed`].
    pub condition_norms: [Option<f64>; 2],
}

/// A loss or gradient that is not finite.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NonFinite {
    /// A loss, by its name in [`Losses::named_values`].
    #[error("loss `{0}` is not a finite number")]
    Loss(&'static str),
    /// The gradient of generator or discriminator.
    #[error("the gradient is not a finite number")]
    Gradient,
}

/// Options of an update.
#[derive(Debug, Clone, Copy)]
pub struct UpdateOptions {
    /// Learning rate of the generator.
    pub rate: f64,
    /// Factor on the weight of the Kullback–Leibler divergence.
    pub kl_share: f64,
    /// Compute the gradient norms of the condition nets.
    pub detailed: bool,
}

impl Learner {
    /// Creates a model with initial weights whose losses weigh all vertices and patches the same;
    /// `device` is an autodiff device.
    pub fn new(config: &RunConfig, graphs: Graphs, device: &Device) -> Result<Self> {
        let train = &config.train;
        let model = Cape::new(&config.model, &graphs, train.seed, device)?;
        let optimiser = || Optimiser::new(train.optimiser, train.momentum, train.clip);
        Ok(Self {
            model,
            update_graphs: graphs.clone().with_precision(train.precision),
            graphs,
            loss: config.loss.clone(),
            loss_weights: LossWeights::default(),
            generator: optimiser(),
            discriminator: optimiser(),
            discriminator_rate_scale: train.discriminator_rate_scale,
            average: (train.ema > 0.0).then(|| ParameterAverage::new(train.ema)),
            steps: 0,
        })
    }

    /// Creates a model with initial weights whose losses weigh the vertices of a data set as
    /// configured; `device` is an autodiff device.
    pub fn for_data(
        config: &RunConfig,
        graphs: Graphs,
        statistics: &DisplacementStatistics,
        clothing: &[usize],
        device: &Device,
    ) -> Result<Self> {
        let deviations: Vec<f64> = statistics.std().iter().copied().collect();
        let vertices = LossVertices { deviations: &deviations, clothing };
        let patches = graphs.discriminator.as_ref();
        let loss_weights = LossWeights::new(&config.loss, vertices, patches, device)?;
        Ok(Self { loss_weights, ..Self::new(config, graphs, device)? })
    }

    /// Weights of vertices and patches in the losses.
    pub fn loss_weights(&self) -> &LossWeights {
        &self.loss_weights
    }

    /// The model with its current weights.
    pub fn model(&self) -> &Cape {
        &self.model
    }

    /// Mesh pyramids and edge operator of the model, in single precision.
    pub fn graphs(&self) -> &Graphs {
        &self.graphs
    }

    /// The generator for inference, without gradients: with averaged weights if they are kept.
    pub fn valid_generator(&self) -> Generator {
        match &self.average {
            Some(average) => average.apply(self.model.generator.clone()).valid(),
            None => self.model.generator.valid(),
        }
    }

    /// Updates generator and discriminator by their gradients at the current weights (CAPE §4.2).
    ///
    /// # Errors
    /// If a loss or gradient is not finite; the weights are unchanged then.
    pub fn update(
        &mut self,
        input: &StepInput,
        options: UpdateOptions,
    ) -> Result<UpdateReport, NonFinite> {
        self.apply(&self.evaluate(input, options.kl_share), options)
    }

    /// Evaluates the losses and their gradients at the current weights; `kl_share` is a factor on the
    /// weight of the Kullback–Leibler divergence.
    pub fn evaluate(&self, input: &StepInput, kl_share: f64) -> Evaluation {
        let loss = LossConfig { kl: self.loss.kl * kl_share, ..self.loss.clone() };
        evaluate(&self.model, &self.update_graphs, &loss, &self.loss_weights, input)
    }

    /// Updates generator and discriminator by the gradients of an evaluation at the current weights.
    ///
    /// # Errors
    /// If a loss or gradient is not finite; the weights are unchanged then.
    pub fn apply(
        &mut self,
        evaluation: &Evaluation,
        options: UpdateOptions,
    ) -> Result<UpdateReport, NonFinite> {
        let Cape { generator, discriminator } = &self.model;
        let generator_norm = global_norm(generator, &evaluation.generator);
        let opponent = discriminator.as_ref().zip(evaluation.discriminator.as_ref());
        let discriminator_norm =
            opponent.map(|(discriminator, gradients)| global_norm(discriminator, gradients));
        let norms = generator_norm.is_finite() && discriminator_norm.is_none_or(f64::is_finite);
        if let Some(name) = evaluation.losses.non_finite() {
            return Err(NonFinite::Loss(name));
        }
        if !norms {
            return Err(NonFinite::Gradient);
        }
        let condition = &generator.condition;
        let condition_norms = [&condition.pose, &condition.outfit].map(|net| {
            let net = net.as_ref().filter(|_| options.detailed)?;
            Some(global_norm(net, &evaluation.generator))
        });

        let Cape { generator, discriminator } = self.model.clone();
        let generator =
            self.generator.step(generator, &evaluation.generator, generator_norm, options.rate);
        let discriminator = match (discriminator, &evaluation.discriminator) {
            (Some(discriminator), Some(gradients)) => Some(self.discriminator.step(
                discriminator,
                gradients,
                discriminator_norm.unwrap_or_default(),
                options.rate * self.discriminator_rate_scale,
            )),
            (discriminator, _) => discriminator,
        };
        self.model = Cape { generator, discriminator };
        self.steps += 1;
        if let Some(average) = &mut self.average {
            average.update(&self.model.generator, self.steps);
        }
        let losses = evaluation.losses;
        Ok(UpdateReport { losses, generator_norm, discriminator_norm, condition_norms })
    }

    /// State of model and optimisers as a checkpoint with the given progress.
    pub fn checkpoint(&self, progress: TrainState) -> Checkpoint {
        Checkpoint {
            progress,
            model: weights::collect(&self.model),
            generator_momentum: self.generator.state(),
            discriminator_momentum: self.discriminator.state(),
            average: self.average.as_ref().map(ParameterAverage::state),
        }
    }

    /// Restores the state of a checkpoint.
    ///
    /// # Errors
    /// If the checkpoint is of another model configuration.
    pub fn restore(&mut self, saved: &Checkpoint) -> Result<()> {
        self.model = weights::apply(self.model.clone(), &saved.model)?;
        self.steps = saved.progress.step;
        self.generator.restore(&self.model.generator, &saved.generator_momentum)?;
        if let Some(discriminator) = &self.model.discriminator {
            self.discriminator.restore(discriminator, &saved.discriminator_momentum)?;
        }
        // An imported checkpoint has no average; it starts with the next step.
        if let (Some(average), Some(state)) = (&mut self.average, &saved.average) {
            average.restore(&self.model.generator, state)?;
        }
        Ok(())
    }
}
