use burn::{
    module::Module,
    tensor::{Device, Tensor},
};
use cape_graph::{DevicePyramid, Precision, SparseMatrix};

use crate::{
    CapeConfig, Error, Initialiser, Result, condition::ConditionNets, decoder::Decoder,
    discriminator::Discriminator, encoder::Encoder,
};

/// Condition nets, encoder and decoder: the parameters of the generator's optimiser.
#[derive(Module, Debug)]
pub struct Generator {
    /// Embeddings of pose and outfit.
    pub condition: ConditionNets,
    /// Displacements to the posterior of the latent code.
    pub encoder: Encoder,
    /// Latent code and conditions to displacements.
    pub decoder: Decoder,
}

/// CAPE's network: conditional Mesh-VAE and discriminator (§4.1).
///
/// Displacements of a single triangle, encoded and decoded:
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
/// // Equal seeds give equal weights.
/// let again = Cape::new(&config, &graphs, 1, &device)?;
/// assert_eq!(collect(&again), collect(&model));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Module, Debug)]
pub struct Cape {
    /// The conditional Mesh-VAE.
    pub generator: Generator,
    /// The patchwise discriminator; `None` if `CapeConfig::discriminator` is.
    pub discriminator: Option<Discriminator>,
}

/// Mesh pyramids and edge operator of the networks, on a device.
#[derive(Debug, Clone)]
pub struct Graphs {
    /// The generator's pyramid.
    pub generator: DevicePyramid,
    /// The discriminator's pyramid; required if the model has a discriminator.
    pub discriminator: Option<DevicePyramid>,
    /// Edge difference operator of the mesh: `+1` and `−1` in each row, `[edges, vertices]`.
    pub edges: SparseMatrix,
}

impl Graphs {
    /// The same graphs for convolutions whose products have another precision.
    #[must_use]
    pub fn with_precision(self, precision: Precision) -> Self {
        Self {
            generator: self.generator.with_precision(precision),
            discriminator: self.discriminator.map(|graph| graph.with_precision(precision)),
            edges: self.edges,
        }
    }
}

impl Cape {
    /// Creates a model with initial weights that depend on `seed` alone, not on the backend.
    ///
    /// # Errors
    /// If the configuration is invalid or a pyramid does not have a level per layer.
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
                    "`Graphs::discriminator` is `None`, but a discriminator needs a mesh pyramid"
                        .into(),
                ));
            }
            (Some(config_d), Some(graph)) => {
                check_transitions("the discriminator", graph, config_d.filters.len())?;
                if graph.vertices()[0] != fine {
                    return Err(Error::Pyramid(format!(
                        "the discriminator's mesh has {} vertices, but the generator's has {fine}: \
                         build both pyramids from the same mesh",
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
    /// Decodes latent codes `z: [batch, latent]` with `pose_feature: [batch, 126]` and
    /// `outfit: [batch, outfits]` into normalised displacements `[batch, vertices, 3]`.
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

    /// Regularisation term ½ Σ‖W‖² over the fully connected kernels of the encoder's heads and the
    /// decoder's input, `[1]`, unweighted.
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
        "{whose} has {layers} layers but its pyramid has {} transitions: build the pyramid with one \
         factor per layer",
        graph.transitions()
    )))
}
