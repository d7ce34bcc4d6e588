//! Reading the reference networks: configuration, graphs, tensors and variables.

use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use cape::{
    core::npy::Npz,
    graph::{DevicePyramid, SparseMatrix, rescaled_laplacian},
    model::{
        CapeConfig, DecoderBlock, DecoderConditions, DiscriminatorConfig, Graphs, LossConfig,
        ReconstructionLoss, weights::HostArray,
    },
};
use serde::Deserialize;
use sprs::{CsMat, TriMat};

/// The JSON beside a reference network.
#[derive(Deserialize)]
pub struct Settings {
    #[serde(rename = "F")]
    filters: Vec<usize>,
    factors_g: Vec<u32>,
    factors_d: Vec<u32>,
    #[serde(rename = "K")]
    order: usize,
    #[serde(rename = "Kd")]
    order_d: usize,
    nz: usize,
    nz_cond: usize,
    nz_cond2: usize,
    reduce_dim: usize,
    n_layer_cond: usize,
    cond_encoder: bool,
    encoder_residual: bool,
    decoder: DecoderBlock,
    loss: ReconstructionLoss,
    lambda_recon: f64,
    lambda_edge: f64,
    lambda_kl: f64,
    lambda_gan: f64,
    regularization_effective: f64,
    label_smoothing: f64,
}

pub struct Fixture {
    pub npz: Npz,
    pub config: CapeConfig,
    pub loss: LossConfig,
    pub graphs: Graphs,
    pub variables: Vec<(String, HostArray)>,
    pub device: Device,
}

impl Fixture {
    pub fn open(path: &Path, device: &Device) -> Self {
        let text = std::fs::read_to_string(path.with_extension("json")).unwrap();
        let settings: Settings = serde_json::from_str(&text).unwrap();
        let mut npz = Npz::open(path).unwrap();
        let names = npz.names();
        let variables: Vec<(String, HostArray)> = names
            .iter()
            .filter_map(|name| Some((name.strip_prefix("var/")?.to_owned(), array(&mut npz, name))))
            .collect();
        let graphs = Graphs {
            generator: pyramid(&mut npz, "mesh/g", settings.factors_g.len(), device),
            discriminator: Some(pyramid(&mut npz, "mesh/d", settings.factors_d.len(), device)),
            edges: edges(&mut npz, device),
        };
        let config = settings.config(&variables);
        let loss = settings.loss();
        Self { npz, config, loss, graphs, variables, device: device.clone() }
    }

    pub fn tensor<const D: usize>(&mut self, name: &str) -> Tensor<D> {
        let array = array(&mut self.npz, name);
        Tensor::from_data(TensorData::new(array.values, array.shape), &self.device)
    }

    pub fn values(&mut self, name: &str) -> Vec<f32> {
        array(&mut self.npz, name).values
    }

    pub fn scalar(&mut self, name: &str) -> f64 {
        f64::from(self.values(name)[0])
    }
}

impl Settings {
    fn config(&self, variables: &[(String, HostArray)]) -> CapeConfig {
        let shape = |name: &str| {
            let found = variables.iter().find(|(found, _)| found == name);
            &found.unwrap_or_else(|| panic!("no variable {name}")).1.shape
        };
        // What the settings leave open shows in the shapes: whether code and blocks are
        // conditioned, and the discriminator's widths.
        let conditions = self.nz_cond + self.nz_cond2;
        let code_conditioned = shape("generator/decoder/fc1/dense/kernel:0")[0] > self.nz;
        let last_width = match self.decoder {
            DecoderBlock::Affine => self.filters[0] / 2,
            _ => self.filters[0],
        };
        let output = shape("generator/decoder/outputs/weights:0")[0] / self.order;
        let decoder_conditions = if output > last_width {
            DecoderConditions::Everywhere
        } else if code_conditioned {
            DecoderConditions::Latent
        } else {
            DecoderConditions::None
        };
        assert!([last_width, last_width + conditions].contains(&output));
        let discriminator = DiscriminatorConfig {
            filters: (1..=self.factors_d.len())
                .map(|i| shape(&format!("discriminator/shared/conv{i}/weights:0"))[1])
                .collect(),
            factors: self.factors_d.clone(),
            order: self.order_d,
            output_order: {
                let last =
                    shape(&format!("discriminator/shared/conv{}/weights:0", self.factors_d.len()))
                        [1];
                shape("discriminator/prediction_map/weights:0")[0] / last
            },
            spectral_norm: false,
        };
        let hidden = |scope: &str| {
            variables.iter().any(|(name, _)| name.starts_with(&format!("{scope}/fc2/")))
        };
        let outfit_layers = if hidden("condition_clo_label") { 2 } else { 1 };
        assert_eq!(outfit_layers, self.n_layer_cond);
        CapeConfig {
            filters: self.filters.clone(),
            factors: self.factors_g.clone(),
            order: self.order,
            latent: self.nz,
            reduce: self.reduce_dim,
            pose_layers: if hidden("condition_pose") { 2 } else { 1 },
            pose_embedding: self.nz_cond,
            outfits: cape::core::OutfitVocabulary::default(),
            outfit_layers,
            outfit_embedding: self.nz_cond2,
            encoder_conditions: self.cond_encoder,
            encoder_residual: self.encoder_residual,
            decoder: self.decoder,
            decoder_conditions,
            linear_path: false,
            variational: true,
            deviation: 0.1,
            group_channels: None,
            discriminator: Some(discriminator),
        }
    }

    fn loss(&self) -> LossConfig {
        LossConfig {
            kind: self.loss,
            reconstruction: self.lambda_recon,
            edge: self.lambda_edge,
            kl: self.lambda_kl,
            gan: self.lambda_gan,
            label_smoothing: self.label_smoothing,
            regularisation: self.regularization_effective,
            ..LossConfig::default()
        }
    }
}

fn array(npz: &mut Npz, name: &str) -> HostArray {
    let array = npz.f32(name).unwrap();
    HostArray { shape: array.shape().to_vec(), values: array.iter().copied().collect() }
}

/// A matrix stored as COO triplets.
pub fn sparse(npz: &mut Npz, name: &str) -> CsMat<f64> {
    let ints = |npz: &mut Npz, part: &str| -> Vec<usize> {
        let array = npz.i64(&format!("{name}_{part}")).unwrap();
        array.iter().map(|&i| usize::try_from(i).unwrap()).collect()
    };
    let shape = ints(npz, "shape");
    let (rows, cols) = (ints(npz, "row"), ints(npz, "col"));
    let values = npz.f64(&format!("{name}_val")).unwrap();
    TriMat::from_triplets((shape[0], shape[1]), rows, cols, values.iter().copied().collect())
        .to_csr()
}

/// Adjacency, selections and up-samplings below `prefix`; identities are left out.
fn pyramid(npz: &mut Npz, prefix: &str, transitions: usize, device: &Device) -> DevicePyramid {
    let laplacians: Vec<CsMat<f64>> = (0..=transitions)
        .map(|i| rescaled_laplacian(&sparse(npz, &format!("{prefix}/A{i}")).map(|_| 1.0)))
        .collect();
    for (i, laplacian) in laplacians.iter().enumerate() {
        let name = format!("{prefix}/Ltilde{i}");
        if npz.contains(&format!("{name}_shape")) {
            let expected = sparse(npz, &name);
            let difference = &expected - laplacian;
            assert!(difference.data().iter().all(|d: &f64| d.abs() < 1e-6), "{name}");
        }
    }
    let mut transition = |kind: &str| -> Vec<Option<CsMat<f64>>> {
        (0..transitions)
            .map(|i| {
                Some(sparse(npz, &format!("{prefix}/{kind}{i}"))).filter(|m| m.rows() != m.cols())
            })
            .collect()
    };
    let (down, up) = (transition("D"), transition("U"));
    DevicePyramid::new(&laplacians, &down, &up, device)
}

fn edges(npz: &mut Npz, device: &Device) -> SparseMatrix {
    let vertices = npz.f64("mesh/v").unwrap().shape()[0];
    let pairs = npz.i64("mesh/vpe").unwrap();
    let mut matrix = TriMat::new((pairs.shape()[0], vertices));
    for (row, pair) in pairs.outer_iter().enumerate() {
        matrix.add_triplet(row, usize::try_from(pair[0]).unwrap(), 1.0);
        matrix.add_triplet(row, usize::try_from(pair[1]).unwrap(), -1.0);
    }
    SparseMatrix::new(&matrix.to_csr(), device)
}

/// Euclidean norm, in f64.
pub fn norm<'a>(values: impl IntoIterator<Item = &'a f32>) -> f64 {
    values.into_iter().map(|&v| f64::from(v).powi(2)).sum::<f64>().sqrt()
}

/// Norm of the difference relative to the norm of the expected values.
pub fn deviation(found: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let difference: Vec<f32> = found.iter().zip(expected).map(|(a, b)| a - b).collect();
    norm(&difference) / norm(expected).max(1e-12)
}
