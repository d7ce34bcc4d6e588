//! Weights of single vertices and patches.

use burn::tensor::{Device, Tensor, TensorData};
use cape_core::tensors::to_host;
use cape_graph::DevicePyramid;

use super::{DisplacementUnit, LossConfig};
use crate::{Error, Result};

/// Weights of vertices and patches in the losses, on the device; the default weighs all the same.
///
/// ```
/// use burn::tensor::Device;
/// use cape_model::{LossConfig, losses::{LossVertices, LossWeights}};
///
/// let config = LossConfig { bare_weight: 0.5, ..LossConfig::default() };
/// let vertices = LossVertices { deviations: &[1.0; 12], clothing: &[0, 2] };
/// let weights = LossWeights::new(&config, vertices, None, &Device::default())?;
/// let values = weights.vertices.unwrap().into_data().to_vec::<f32>().unwrap();
/// assert!((values[0] - 4.0 / 3.0).abs() < 1e-6 && (values[3] - 2.0 / 3.0).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct LossWeights {
    /// Factors of mean 1 on normalised displacements, `[1, vertices, 3]`.
    pub vertices: Option<Tensor<3>>,
    /// Factors of mean 1 on the terms of patches, `[1, patches, 1]`.
    pub patches: Option<Tensor<3>>,
}

/// Vertices of a data set, of which losses are weighted.
#[derive(Debug, Clone, Copy)]
pub struct LossVertices<'a> {
    /// Standard deviation of the displacement of each vertex and coordinate, `[3 V]`, metres.
    pub deviations: &'a [f64],
    /// Indices of the clothing vertices.
    pub clothing: &'a [usize],
}

impl LossWeights {
    /// Weights that a configuration asks for; `patches` is the pyramid of the discriminator.
    ///
    /// # Errors
    /// If all weights are zero.
    pub fn new(
        config: &LossConfig,
        vertices: LossVertices<'_>,
        patches: Option<&DevicePyramid>,
        device: &Device,
    ) -> Result<Self> {
        let LossVertices { deviations, clothing } = vertices;
        let count = deviations.len() / 3;
        let mut covered = vec![false; count];
        for &vertex in clothing {
            covered[vertex] = true;
        }
        let plain = config.unit == DisplacementUnit::Deviations && config.bare_weight == 1.0;
        let of_vertices = (!plain).then(|| {
            let weight = |(at, &deviation): (usize, &f64)| {
                let unit = match config.unit {
                    DisplacementUnit::Deviations => 1.0,
                    DisplacementUnit::Metres => deviation,
                };
                unit * if covered[at / 3] { 1.0 } else { config.bare_weight }
            };
            let weights = deviations.iter().enumerate().map(weight).collect();
            tensor_of_mean_one("loss.bare_weight", weights, [1, count, 3], device)
        });
        let of_patches = patches.filter(|_| config.clothing_patches).map(|pyramid| {
            // Down-sampling selects vertices; a patch is named after its vertex.
            let covered: Vec<f32> = covered.iter().map(|&on| f32::from(u8::from(on))).collect();
            let mut on = Tensor::<3>::from_data(TensorData::new(covered, [1, count, 1]), device);
            for level in 0..pyramid.transitions() {
                on = pyramid.down(on, level);
            }
            let weights: Vec<f64> = to_host(on).into_iter().map(f64::from).collect();
            let shape = [1, weights.len(), 1];
            tensor_of_mean_one("loss.clothing_patches", weights, shape, device)
        });
        Ok(Self { vertices: of_vertices.transpose()?, patches: of_patches.transpose()? })
    }

    /// Normalised displacements `[batch, vertices, 3]` times the weights of their vertices.
    pub fn apply(&self, displacement: Tensor<3>) -> Tensor<3> {
        match &self.vertices {
            Some(weights) => displacement * weights.clone(),
            None => displacement,
        }
    }
}

fn tensor_of_mean_one(
    field: &str,
    weights: Vec<f64>,
    shape: [usize; 3],
    device: &Device,
) -> Result<Tensor<3>> {
    let mean = weights.iter().sum::<f64>() / weights.len().max(1) as f64;
    if mean <= 0.0 {
        return Err(Error::Config {
            field: field.into(),
            message: "all weights are zero: the body has no clothing vertices".into(),
        });
    }
    let weights: Vec<f32> = weights.into_iter().map(|weight| (weight / mean) as f32).collect();
    Ok(Tensor::from_data(TensorData::new(weights, shape), device))
}
