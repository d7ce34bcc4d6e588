//! What is timed: the work of training and of use, on random data.

use burn::{
    module::Module,
    tensor::{Device, Tensor},
};
use cape_core::{joints::POSE_FEATURE, synth::synthetic_body};
use cape_graph::Surface;
use cape_model::{Cape, CapeConfig, Discriminator, Generator, Graphs, LossConfig};

use crate::{
    Error, Result, RunConfig, TrainConfig, build_graphs,
    objective::{Frames, StepInput, evaluate},
    optim::{Momentum, global_norm},
    run::{normal, tensor2},
};

/// Small steps, on which random data do not diverge.
const RATE: f64 = 1e-4;

/// A model with fresh weights on a mesh, and the batches of one update.
pub struct Workload {
    model: Cape,
    graphs: Graphs,
    optimisers: [Momentum; 2],
    input: StepInput,
    loss: LossConfig,
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
        let run = RunConfig { model: config.clone(), ..RunConfig::default() };
        run.validate()?;
        let graphs = build_graphs(&run, mesh, &device)?;
        let model = Cape::new(config, &graphs, seed, &device)?;
        let TrainConfig { momentum, clip, .. } = run.train;
        let epsilon = tensor2(normal(seed, 0, batch, config.latent), &device);
        let vertices = graphs.generator.vertices()[0];
        let input = StepInput {
            frames: frames(batch, vertices, seed, 1, &device),
            epsilon: config.variational.then_some(epsilon),
            real: model.discriminator.is_some().then(|| frames(batch, vertices, seed, 3, &device)),
        };
        Ok(Self {
            optimisers: [(); 2].map(|()| Momentum::new(momentum, clip)),
            loss: run.loss,
            latent: config.latent,
            model,
            graphs,
            input,
            seed,
            device,
        })
    }

    /// What the model needs of the mesh.
    pub fn graphs(&self) -> &Graphs {
        &self.graphs
    }

    /// Updates generator and discriminator once, to the end of the device's work.
    pub fn update(&mut self) -> Result<()> {
        let evaluation = evaluate(&self.model, &self.graphs, &self.loss, &self.input);
        let Cape { generator, discriminator } = self.model.clone();
        let [of_generator, of_discriminator] = &mut self.optimisers;
        let norm = global_norm(&generator, &evaluation.generator);
        let generator = of_generator.step(generator, &evaluation.generator, norm, RATE);
        let discriminator = match (discriminator, &evaluation.discriminator) {
            (Some(discriminator), Some(gradients)) => {
                let norm = global_norm(&discriminator, gradients);
                Some(of_discriminator.step(discriminator, gradients, norm, 0.1 * RATE))
            }
            (discriminator, _) => discriminator,
        };
        self.model = Cape { generator, discriminator };
        synchronise(&self.device)
    }

    /// The model in use, on `batch` examples at a time.
    pub fn inference(&self, batch: usize) -> Inference {
        let device = self.device.clone().inner();
        Inference {
            generator: self.model.generator.valid(),
            discriminator: self.model.discriminator.as_ref().map(Module::valid),
            graphs: self.graphs.clone(),
            frames: frames(batch, self.graphs.generator.vertices()[0], self.seed, 5, &device),
            code: tensor2(normal(self.seed, 7, batch, self.latent), &device),
            device,
        }
    }
}

/// A model in use: no gradients.
pub struct Inference {
    generator: Generator,
    discriminator: Option<Discriminator>,
    graphs: Graphs,
    frames: Frames,
    code: Tensor<2>,
    device: Device,
}

impl Inference {
    /// From codes and conditions to displacements, to the end of the device's work.
    pub fn decode(&self) -> Result<()> {
        let Frames { pose_feature, outfit, .. } = self.frames.clone();
        self.generator.decode(self.code.clone(), pose_feature, outfit, &self.graphs);
        synchronise(&self.device)
    }

    /// From displacements to the posterior, to the end of the device's work.
    pub fn encode(&self) -> Result<()> {
        let Frames { displacement, pose_feature, outfit } = self.frames.clone();
        let condition = self.generator.condition.forward(pose_feature, outfit);
        let graph = &self.graphs.generator;
        self.generator.encoder.forward(displacement, condition.as_ref(), graph);
        synchronise(&self.device)
    }
}

impl Inference {
    /// From displacements and conditions to the discriminator's logits, to the end of the device's
    /// work; nothing without a discriminator.
    pub fn discriminate(&self) -> Result<()> {
        let Frames { displacement, pose_feature, outfit } = self.frames.clone();
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
fn frames(batch: usize, vertices: usize, seed: u64, stream: u64, device: &Device) -> Frames {
    let displacement = tensor2(normal(seed, stream, batch, vertices * 3), device);
    Frames {
        displacement: displacement.reshape([batch, vertices, 3]),
        pose_feature: tensor2(normal(seed, stream + 1, batch, POSE_FEATURE), device),
        outfit: Tensor::ones([batch, 4], device) * 0.25,
    }
}

fn synchronise(device: &Device) -> Result<()> {
    device.sync().map_err(|error| Error::Data(format!("the device failed: {error}")))
}
