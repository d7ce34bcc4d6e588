use burn::{
    module::Module,
    tensor::{Device, Tensor},
};
use cape_graph::{DevicePyramid, SparseMatrix};

use crate::{
    CapeConfig, Error, Initialiser, Result, condition::ConditionNets, decoder::Decoder,
    discriminator::Discriminator, encoder::Encoder,
};

/// Condition nets, encoder and decoder: what the generator's optimiser updates.
///
/// See [`Cape`] for an example.
#[derive(Module, Debug)]
pub struct Generator {
    /// Embeddings of pose and outfit.
    pub condition: ConditionNets,
    /// Displacements → posterior.
    pub encoder: Encoder,
    /// Code and conditions → displacements.
    pub decoder: Decoder,
}

/// The whole of CAPE's network.
///
/// Clothes of a single triangle, encoded and decoded:
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::{DevicePyramid, SparseMatrix, sparse_from_triplets};
/// use cape_model::{Cape, CapeConfig, Graphs, weights::collect};
///
/// let (from, to) = ([0, 0, 1, 1, 2, 2], [1, 2, 0, 2, 0, 1]);
/// let laplacian = sparse_from_triplets("L", (3, 3), &from, &to, &[-0.5; 6])?;
/// let edges = sparse_from_triplets("edges", (3, 3), &from, &to, &[1., -1., 1., -1., 1., -1.])?;
/// let device = Device::default();
/// let graphs = Graphs {
///     generator: DevicePyramid::new(&vec![laplacian; 3], &[None, None], &[None, None], &device),
///     discriminator: None,
///     edges: SparseMatrix::new(&edges, &device),
/// };
/// let config = CapeConfig {
///     filters: vec![4, 8],
///     factors: vec![1, 1],
///     discriminator: None,
///     ..CapeConfig::tiny()
/// };
/// let model = Cape::new(&config, &graphs, 1, &device)?;
/// let posterior =
///     model.generator.encoder.forward(Tensor::ones([1, 3, 3], &device), None, &graphs.generator);
/// assert_eq!(posterior.mean.dims(), [1, 6]);
/// let (pose, outfit) = (Tensor::zeros([1, 126], &device), Tensor::zeros([1, 4], &device));
/// let decoded = model.generator.decode(posterior.mean, pose, outfit, &graphs);
/// assert_eq!(decoded.dims(), [1, 3, 3]);
/// // A seed gives one model.
/// let again = Cape::new(&config, &graphs, 1, &device)?;
/// assert_eq!(collect(&again), collect(&model));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Module, Debug)]
pub struct Cape {
    /// The conditional Mesh-VAE.
    pub generator: Generator,
    /// The patchwise discriminator, in adversarial configurations.
    pub discriminator: Option<Discriminator>,
}

/// What the networks need of the mesh, on a device.
///
/// See [`Cape`] for an example.
#[derive(Debug, Clone)]
pub struct Graphs {
    /// The generator's pyramid.
    pub generator: DevicePyramid,
    /// The discriminator's pyramid.
    pub discriminator: Option<DevicePyramid>,
    /// The mesh's edges as a difference operator: `+1` and `−1` in each row, `[edges, vertices]`.
    pub edges: SparseMatrix,
}

impl Cape {
    /// A model with fresh weights; `seed` fixes them on every backend.
    ///
    /// # Errors
    /// If the configuration is invalid or the graphs do not suit it.
    pub fn new(config: &CapeConfig, graphs: &Graphs, seed: u64, device: &Device) -> Result<Self> {
        config.validate()?;
        let layers = config.filters.len();
        check_transitions("the generator", &graphs.generator, layers)?;
        let mut init = Initialiser::new(seed, config.deviation, device);
        let vertices = graphs.generator.vertices();
        let (fine, coarse) = (vertices[0], vertices[layers]);
        let generator = Generator {
            condition: ConditionNets::new(config, &mut init),
            encoder: Encoder::new(config, coarse, &mut init),
            decoder: Decoder::new(config, fine, coarse, &mut init),
        };
        let discriminator = match (&config.discriminator, &graphs.discriminator) {
            (None, _) => None,
            (Some(_), None) => {
                return Err(Error::Pyramid(
                    "the configuration has a discriminator, but it was given no pyramid".into(),
                ));
            }
            (Some(config_d), Some(graph)) => {
                check_transitions("the discriminator", graph, config_d.filters.len())?;
                if graph.vertices()[0] != fine {
                    return Err(Error::Pyramid(format!(
                        "the discriminator's mesh has {} vertices, the generator's {fine}",
                        graph.vertices()[0]
                    )));
                }
                Some(Discriminator::new(config_d, config.condition_size(), &mut init))
            }
        };
        Ok(Self { generator, discriminator })
    }
}

impl Generator {
    /// Pose feature `[batch, 126]`, outfit label `[batch, 4]`, code `[batch, latent]` → normalised
    /// displacements `[batch, vertices, 3]`.
    pub fn decode(
        &self,
        z: Tensor<2>,
        pose_feature: Tensor<2>,
        outfit: Tensor<2>,
        graphs: &Graphs,
    ) -> Tensor<3> {
        let condition = self.condition.forward(pose_feature, outfit);
        self.decoder.forward(z, condition.as_ref(), &graphs.generator)
    }

    /// Half the summed squares of the kernels that training regularises: the encoder's heads and
    /// the decoder's input.
    pub fn regularisation(&self) -> Tensor<1> {
        [&self.encoder.mean, &self.encoder.log_variance, &self.decoder.input]
            .into_iter()
            .map(|layer| {
                let weight = layer.weight.val();
                (weight.clone() * weight).sum() * 0.5
            })
            .reduce(|a, b| a + b)
            .unwrap_or_else(|| unreachable!("three layers"))
    }
}

fn check_transitions(whose: &str, graph: &DevicePyramid, layers: usize) -> Result<()> {
    if graph.transitions() == layers {
        return Ok(());
    }
    Err(Error::Pyramid(format!(
        "{whose} has {layers} layers but its pyramid has {} transitions",
        graph.transitions()
    )))
}
