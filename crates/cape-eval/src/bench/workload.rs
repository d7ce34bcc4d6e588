//! What is timed: the work of training and of use, on random data.

use burn::{
    module::Module,
    tensor::{Device, Tensor},
};
use cape_core::joints::POSE_FEATURE;
use cape_graph::Surface;
use cape_model::{CapeConfig, Discriminator, Generator, Graphs};
use cape_synth::synthetic_body;

use crate::{Error, Result};
use cape_core::tensors::tensor2;
use cape_infer::{DeviceBatch, RunConfig, build_graphs, normal};
use cape_train::{
    learner::{Learner, UpdateOptions},
    objective::StepInput,
};

/// Small steps, on which random data do not diverge.
const RATE: f64 = 1e-4;

/// A model with fresh weights on a mesh, and the batches of one update.
///
/// ```
/// use burn::tensor::Device;
/// use cape_core::Mesh;
/// use cape_model::CapeConfig;
/// use cape_eval::bench::Workload;
///
/// let tetrahedron = Mesh {
///     vertices: vec![[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]],
///     faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
/// };
/// let config = CapeConfig {
///     filters: vec![4],
///     factors: vec![1],
///     discriminator: None,
///     ..CapeConfig::tiny()
/// };
/// let mut workload = Workload::on_mesh(&config, &tetrahedron, 2, 1, &Device::default())?;
/// workload.update()?;
/// assert_eq!(workload.graphs().generator.vertices(), [4, 4]);
/// let inference = workload.inference(16);
/// inference.decode()?;
/// inference.encode()?;
/// # Ok::<(), cape_train::Error>(())
/// ```
pub struct Workload {
    learner: Learner,
    input: StepInput,
    latent: usize,
    seed: u64,
    device: Device,
}

impl Workload {
    /// On the synthetic body, in batches of `batch` examples; `seed` fixes weights and data.
    pub fn new(config: &CapeConfig, batch: usize, seed: u64, device: &Device) -> Result<Self> {
        Self::on_mesh(config, &synthetic_body(), batch, seed, device)
    }

    /// On any mesh.
    pub fn on_mesh(
        config: &CapeConfig,
        mesh: impl Into<Surface>,
        batch: usize,
        seed: u64,
        device: &Device,
    ) -> Result<Self> {
        if batch == 0 {
            return Err(Error::argument("batch: must be at least 1"));
        }
        let device = device.clone().autodiff();
        let mut run = RunConfig { model: config.clone(), ..RunConfig::default() };
        run.train.seed = seed;
        run.validate()?;
        let graphs = build_graphs(&run, mesh, &device)?;
        let learner = Learner::new(&run, graphs, &device)?;
        let epsilon = tensor2(normal(seed, 0, batch, config.latent), &device);
        let vertices = learner.graphs().generator.vertices()[0];
        let input = StepInput {
            frames: frames(batch, vertices, seed, 1, &device),
            epsilon: config.variational.then_some(epsilon),
            real: config.discriminator.is_some().then(|| frames(batch, vertices, seed, 3, &device)),
        };
        Ok(Self { learner, latent: config.latent, input, seed, device })
    }

    /// What the model needs of the mesh.
    pub fn graphs(&self) -> &Graphs {
        self.learner.graphs()
    }

    /// Updates generator and discriminator once, to the end of the device's work.
    pub fn update(&mut self) -> Result<()> {
        let pace = UpdateOptions { rate: RATE, kl_share: 1.0, detailed: false };
        self.learner
            .update(&self.input, pace)
            .map_err(|what| Error::data(format!("{what} is not a finite number")))?;
        synchronise(&self.device)
    }

    /// The model in use, on `batch` examples at a time.
    pub fn inference(&self, batch: usize) -> InferenceWorkload {
        let device = self.device.clone().inner();
        let (model, graphs) = (self.learner.model(), self.learner.graphs());
        InferenceWorkload {
            generator: model.generator.valid(),
            discriminator: model.discriminator.as_ref().map(Module::valid),
            graphs: graphs.clone(),
            frames: frames(batch, graphs.generator.vertices()[0], self.seed, 5, &device),
            code: tensor2(normal(self.seed, 7, batch, self.latent), &device),
            device,
        }
    }
}

/// A model in use: no gradients.
pub struct InferenceWorkload {
    generator: Generator,
    discriminator: Option<Discriminator>,
    graphs: Graphs,
    frames: DeviceBatch,
    code: Tensor<2>,
    device: Device,
}

impl InferenceWorkload {
    /// From codes and conditions to displacements, to the end of the device's work.
    pub fn decode(&self) -> Result<()> {
        let DeviceBatch { pose_feature, outfit, .. } = self.frames.clone();
        self.generator.decode(self.code.clone(), pose_feature, outfit, &self.graphs);
        synchronise(&self.device)
    }

    /// From displacements to the posterior, to the end of the device's work.
    pub fn encode(&self) -> Result<()> {
        let DeviceBatch { displacement, pose_feature, outfit } = self.frames.clone();
        let condition = self.generator.condition.forward(pose_feature, outfit);
        let graph = &self.graphs.generator;
        self.generator.encoder.forward(displacement, condition.as_ref(), graph);
        synchronise(&self.device)
    }
}

impl InferenceWorkload {
    /// From displacements and conditions to the discriminator's logits, to the end of the device's
    /// work; nothing without a discriminator.
    pub fn discriminate(&self) -> Result<()> {
        let DeviceBatch { displacement, pose_feature, outfit } = self.frames.clone();
        if let (Some(discriminator), Some(graph)) =
            (&self.discriminator, &self.graphs.discriminator)
        {
            let condition = self.generator.condition.forward(pose_feature, outfit);
            discriminator.forward(displacement, condition.as_ref(), graph);
        }
        synchronise(&self.device)
    }
}

/// Random frames, from two streams of the seed.
fn frames(batch: usize, vertices: usize, seed: u64, stream: u64, device: &Device) -> DeviceBatch {
    let displacement = tensor2(normal(seed, stream, batch, vertices * 3), device);
    DeviceBatch {
        displacement: displacement.reshape([batch, vertices, 3]),
        pose_feature: tensor2(normal(seed, stream + 1, batch, POSE_FEATURE), device),
        outfit: Tensor::ones([batch, 4], device) * 0.25,
    }
}

fn synchronise(device: &Device) -> Result<()> {
    device.sync().map_err(|error| Error::data(format!("the device failed: {error}")))
}
