//! A model and what updates it.

use burn::{module::Module, tensor::Device};
use cape_model::{Cape, Generator, Graphs, LossConfig, weights};

use crate::{
    Result,
    objective::{Losses, StepInput, evaluate},
    optim::{Optimiser, global_norm},
    parameter_average::ParameterAverage,
};
use cape_infer::{
    RunConfig,
    checkpoint::{Checkpoint, TrainState},
};

/// A model being trained: networks, optimisers and, if asked for, averaged weights.
///
/// A tetrahedron's clothes, learnt:
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
/// let input = StepInput { frames, epsilon: None, real: None };
/// let pace = UpdateOptions { rate: 0.01, kl_share: 1.0, detailed: false };
/// let first = learner.update(&input, pace)?.losses;
/// for _ in 0..20 {
///     learner.update(&input, pace)?;
/// }
/// let last = learner.update(&input, pace)?.losses;
/// assert!(last.reconstruction < first.reconstruction);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Learner {
    model: Cape,
    graphs: Graphs,
    loss: LossConfig,
    generator: Optimiser,
    discriminator: Optimiser,
    discriminator_rate_scale: f64,
    average: Option<ParameterAverage>,
    steps: u64,
}

/// What an update came to.
///
/// See [`Learner`] for an example.
#[derive(Debug, Clone, Copy)]
pub struct UpdateReport {
    /// Losses before it.
    pub losses: Losses,
    /// Length of the generator's gradient before clipping.
    pub generator_norm: f64,
    /// Length of the discriminator's.
    pub discriminator_norm: Option<f64>,
    /// Lengths of the parts of the generator's gradient that reach the nets of pose and outfit;
    /// only where they were asked for.
    pub condition_norms: [Option<f64>; 2],
}

/// How an update is made.
///
/// See [`Learner`] for an example.
#[derive(Debug, Clone, Copy)]
pub struct UpdateOptions {
    /// The generator's learning rate.
    pub rate: f64,
    /// Share of the Kullback–Leibler term's weight that counts.
    pub kl_share: f64,
    /// Whether the condition nets' gradients are measured by themselves.
    pub detailed: bool,
}

impl Learner {
    /// With fresh weights; `device` differentiates.
    pub fn new(config: &RunConfig, graphs: Graphs, device: &Device) -> Result<Self> {
        let train = &config.train;
        let model = Cape::new(&config.model, &graphs, train.seed, device)?;
        let optimiser = || Optimiser::new(train.optimiser, train.momentum, train.clip);
        Ok(Self {
            model,
            graphs,
            loss: config.loss.clone(),
            generator: optimiser(),
            discriminator: optimiser(),
            discriminator_rate_scale: train.discriminator_rate_scale,
            average: (train.ema > 0.0).then(|| ParameterAverage::new(train.ema)),
            steps: 0,
        })
    }

    /// The model as it is.
    pub fn model(&self) -> &Cape {
        &self.model
    }

    /// What it needs of the mesh.
    pub fn graphs(&self) -> &Graphs {
        &self.graphs
    }

    /// The generator to be used: of averaged weights, if there are any; without gradients.
    pub fn valid_generator(&self) -> Generator {
        match &self.average {
            Some(average) => average.apply(self.model.generator.clone()).valid(),
            None => self.model.generator.valid(),
        }
    }

    /// Updates generator and discriminator by gradients taken at the current weights (CAPE §4.3).
    ///
    /// # Errors
    /// The name of what is not a finite number; nothing is updated then.
    pub fn update(
        &mut self,
        input: &StepInput,
        pace: UpdateOptions,
    ) -> Result<UpdateReport, &'static str> {
        let loss = LossConfig { kl: self.loss.kl * pace.kl_share, ..self.loss.clone() };
        let evaluation = evaluate(&self.model, &self.graphs, &loss, input);
        let Cape { generator, discriminator } = &self.model;
        let generator_norm = global_norm(generator, &evaluation.generator);
        let opponent = discriminator.as_ref().zip(evaluation.discriminator.as_ref());
        let discriminator_norm =
            opponent.map(|(discriminator, gradients)| global_norm(discriminator, gradients));
        let norms = generator_norm.is_finite() && discriminator_norm.is_none_or(f64::is_finite);
        if let Some(what) = evaluation.losses.non_finite().or((!norms).then_some("the gradient")) {
            return Err(what);
        }
        let condition = &generator.condition;
        let condition_norms = [&condition.pose, &condition.outfit].map(|net| {
            let net = net.as_ref().filter(|_| pace.detailed)?;
            Some(global_norm(net, &evaluation.generator))
        });

        let Cape { generator, discriminator } = self.model.clone();
        let generator =
            self.generator.step(generator, &evaluation.generator, generator_norm, pace.rate);
        let discriminator = match (discriminator, &evaluation.discriminator) {
            (Some(discriminator), Some(gradients)) => Some(self.discriminator.step(
                discriminator,
                gradients,
                discriminator_norm.unwrap_or_default(),
                pace.rate * self.discriminator_rate_scale,
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

    /// The state, for a checkpoint of a run that is at `progress`.
    pub fn checkpoint(&self, progress: TrainState) -> Checkpoint {
        Checkpoint {
            progress,
            model: weights::collect(&self.model),
            generator_momentum: self.generator.state(),
            discriminator_momentum: self.discriminator.state(),
            average: self.average.as_ref().map(ParameterAverage::state),
        }
    }

    /// Puts a checkpoint's state back.
    ///
    /// # Errors
    /// If it does not suit the model.
    pub fn restore(&mut self, saved: &Checkpoint) -> Result<()> {
        self.model = weights::apply(self.model.clone(), &saved.model)?;
        self.steps = saved.progress.step;
        self.generator.restore(&self.model.generator, &saved.generator_momentum)?;
        if let Some(discriminator) = &self.model.discriminator {
            self.discriminator.restore(discriminator, &saved.discriminator_momentum)?;
        }
        // An imported checkpoint has no average: it begins with the next step.
        if let (Some(average), Some(state)) = (&mut self.average, &saved.average) {
            average.restore(&self.model.generator, state)?;
        }
        Ok(())
    }
}
