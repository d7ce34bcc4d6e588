//! Normalisation of displacements on a device.

use burn::tensor::{Device, Tensor, TensorData};
use cape_data::DisplacementStatistics;
use ndarray::Array2;

/// Normalisation of displacements on a device: metres to standard deviations and back.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_data::DisplacementStatistics;
/// use cape_infer::Normaliser;
/// use ndarray::array;
///
/// let statistics = DisplacementStatistics::new(array![[0.01, 0., 0.]], array![[0.005; 3]], 1)?;
/// let normaliser = Normaliser::new(&statistics, &Device::default());
/// let metres = Tensor::<3>::from_floats([[[0.02, 0.0, 0.0]]], &Device::default());
/// let normalised = normaliser.normalise(metres.clone());
/// assert!((normalised.clone().max().into_scalar::<f32>() - 2.0).abs() < 1e-5);
/// let error: f32 = (normaliser.denormalise(normalised) - metres).abs().max().into_scalar();
/// assert!(error < 1e-7);
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Normaliser {
    /// Metres, `[1, V, 3]`.
    mean: Tensor<3>,
    /// Metres, `[1, V, 3]`.
    std: Tensor<3>,
}

impl Normaliser {
    /// Uploads mean and standard deviation.
    pub fn new(statistics: &DisplacementStatistics, device: &Device) -> Self {
        let upload = |array: &Array2<f64>| {
            let values: Vec<f32> = array.iter().map(|&x| x as f32).collect();
            Tensor::from_data(TensorData::new(values, [1, statistics.vertices(), 3]), device)
        };
        Self { mean: upload(statistics.mean()), std: upload(statistics.std()) }
    }

    /// Displacements `[n, V, 3]` in metres to standard deviations.
    pub fn normalise(&self, displacement: Tensor<3>) -> Tensor<3> {
        (displacement - self.mean.clone()) / self.std.clone()
    }

    /// Displacements `[n, V, 3]` in standard deviations to metres.
    pub fn denormalise(&self, displacement: Tensor<3>) -> Tensor<3> {
        displacement * self.std.clone() + self.mean.clone()
    }

    /// Mean displacement, metres, `[1, V, 3]`.
    pub fn mean(&self) -> Tensor<3> {
        self.mean.clone()
    }
}
