//! Workloads of the benchmark: training updates and inference on random data.

use burn::{
    module::Module,
    tensor::{Device, Tensor},
};
use cape_core::{joints::POSE_FEATURE, smpl::Gender};
use cape_graph::{Precision, Surface};
use cape_model::{CapeConfig, Discriminator, Generator, Graphs};
use cape_synth::embedded_body;

use crate::{Error, Result};
use cape_core::tensors::from_array2;
use cape_infer::{DeviceBatch, RunConfig, build_graphs, normal};
use cape_train::{
    learner::{Learner, UpdateOptions},
    objective::StepInput,
};

/// Learning rate, small enough that training on random data does not diverge.
const RATE: f64 = 1e-4;

/// Training workload: a model with initial weights on a mesh, and the batches of one update.
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
    outfits: usize,
    seed: u64,
    precision: Precision,
    device: Device,
}

impl Workload {
    /// Creates a workload on the neutral body with batches of `batch` examples; `seed` is that of
    /// weights and data.
    pub fn new(config: &CapeConfig, batch: usize, seed: u64, device: &Device) -> Result<Self> {
        Self::on_mesh(config, &embedded_body(Gender::Neutral)?, batch, seed, device)
    }

    /// Creates a workload on any mesh.
    pub fn on_mesh(
        config: &CapeConfig,
        mesh: impl Into<Surface>,
        batch: usize,
        seed: u64,
        device: &Device,
    ) -> Result<Self> {
        let mut run = RunConfig { model: config.clone(), ..RunConfig::default() };
        (run.train.batch, run.train.seed) = (batch, seed);
        Self::of_run(&run, mesh, device)
    }

    /// Creates the workload of a run's training, with its losses, batch size and precision, on any mesh.
    pub fn of_run(run: &RunConfig, mesh: impl Into<Surface>, device: &Device) -> Result<Self> {
        let (config, batch, seed) = (&run.model, run.train.batch, run.train.seed);
        if batch == 0 {
            return Err(Error::argument("batch: expected at least 1, not 0"));
        }
        run.validate()?;
        let device = device.clone().autodiff();
        let graphs = build_graphs(run, mesh, &device)?;
        let learner = Learner::new(run, graphs, &device)?;
        let epsilon = from_array2(normal(seed, 0, batch, config.latent), &device);
        let vertices = learner.graphs().generator.vertices()[0];
        let outfits = config.outfits.len();
        let shape = [batch, vertices, outfits];
        let input = StepInput {
            encoded: None,
            frames: frames(shape, seed, 1, &device),
            epsilon: config.variational.then_some(epsilon),
            real: config.discriminator.is_some().then(|| frames(shape, seed, 3, &device)),
        };
        let precision = run.train.precision;
        Ok(Self { learner, latent: config.latent, outfits, input, seed, precision, device })
    }

    /// Mesh pyramids and edge operator of the model.
    pub fn graphs(&self) -> &Graphs {
        self.learner.graphs()
    }

    /// Updates generator and discriminator once and waits for the device.
    pub fn update(&mut self) -> Result<()> {
        let options = UpdateOptions { rate: RATE, kl_share: 1.0, detailed: false };
        self.learner
            .update(&self.input, options)
            .map_err(|error| Error::data(format!("benchmark on random data: {error}")))?;
        synchronise(&self.device)
    }

    /// Inference workload of the model with batches of `batch` examples.
    pub fn inference(&self, batch: usize) -> InferenceWorkload {
        let device = self.device.clone().inner();
        let (model, graphs) = (self.learner.model(), self.learner.graphs());
        InferenceWorkload {
            generator: model.generator.valid(),
            discriminator: model.discriminator.as_ref().map(Module::valid),
            graphs: graphs.clone().with_precision(self.precision),
            frames: frames(
                [batch, graphs.generator.vertices()[0], self.outfits],
                self.seed,
                5,
                &device,
            ),
            code: from_array2(normal(self.seed, 7, batch, self.latent), &device),
            device,
        }
    }
}

/// Inference workload: a model without gradients.
pub struct InferenceWorkload {
    generator: Generator,
    discriminator: Option<Discriminator>,
    graphs: Graphs,
    frames: DeviceBatch,
    code: Tensor<2>,
    device: Device,
}

impl InferenceWorkload {
    /// Decodes latent codes to displacements and waits for the device.
    pub fn decode(&self) -> Result<()> {
        let DeviceBatch { pose_feature, outfit, .. } = self.frames.clone();
        self.generator.decode(self.code.clone(), pose_feature, outfit, &self.graphs);
        synchronise(&self.device)
    }

    /// Encodes displacements to the posterior and waits for the device.
    pub fn encode(&self) -> Result<()> {
        let DeviceBatch { displacement, pose_feature, outfit } = self.frames.clone();
        let condition = self.generator.condition.forward(pose_feature, outfit);
        let graph = &self.graphs.generator;
        self.generator.encoder.forward(displacement, condition.as_ref(), graph);
        synchronise(&self.device)
    }
}

impl InferenceWorkload {
    /// Computes the logits of the discriminator, if there is one, and waits for the device.
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

/// Random frames `[batch, vertices, outfits]` from two streams of the seed.
fn frames(shape: [usize; 3], seed: u64, stream: u64, device: &Device) -> DeviceBatch {
    let [batch, vertices, outfits] = shape;
    let displacement = from_array2(normal(seed, stream, batch, vertices * 3), device);
    DeviceBatch {
        displacement: displacement.reshape([batch, vertices, 3]),
        pose_feature: from_array2(normal(seed, stream + 1, batch, POSE_FEATURE), device),
        outfit: Tensor::ones([batch, outfits], device) / outfits as f32,
    }
}

fn synchronise(device: &Device) -> Result<()> {
    device.sync().map_err(|error| Error::data(format!("device error: {error}")))
}
