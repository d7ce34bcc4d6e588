use burn::{
    module::Param,
    nn::Linear,
    tensor::{Device, Tensor, TensorData},
};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;

/// Source of initial weights, drawn on the host so that a seed gives the same model on every
/// backend.
///
/// ```
/// use burn::tensor::Device;
/// use cape_model::{Initialiser, weights::collect};
///
/// let device = Device::default();
/// let draw = |seed| Initialiser::new(seed, 0.1, &device).linear(2, 3);
/// assert_eq!(collect(&draw(7)), collect(&draw(7)));
/// assert_ne!(collect(&draw(7)), collect(&draw(8)));
/// ```
#[derive(Debug)]
pub struct Initialiser {
    rng: ChaCha8Rng,
    deviation: f32,
    device: Device,
}

impl Initialiser {
    /// Creates a source of parameters on `device`; `deviation` is the standard deviation of
    /// convolution weights.
    pub fn new(seed: u64, deviation: f64, device: &Device) -> Self {
        Self {
            rng: ChaCha8Rng::seed_from_u64(seed),
            deviation: deviation as f32,
            device: device.clone(),
        }
    }

    fn param<const D: usize>(&self, values: Vec<f32>, shape: [usize; D]) -> Param<Tensor<D>> {
        Param::from_data(TensorData::new(values, shape), &self.device)
    }

    /// Fully connected layer with Glorot-uniform weights `[input, output]` and a zero bias.
    pub fn linear(&mut self, input: usize, output: usize) -> Linear {
        let bias = Some(self.constant(0.0, [output]));
        Linear { weight: self.glorot([input, output]), bias }
    }

    /// Normal distribution of the given deviation, truncated at two deviations.
    pub(crate) fn truncated_normal(&mut self, shape: [usize; 2]) -> Param<Tensor<2>> {
        let values = (0..shape[0] * shape[1])
            .map(|_| self.deviation * self.truncated_standard_normal())
            .collect();
        self.param(values, shape)
    }

    fn truncated_standard_normal(&mut self) -> f32 {
        loop {
            let value: f32 = self.rng.sample(StandardNormal);
            if value.abs() <= 2.0 {
                return value;
            }
        }
    }

    /// Glorot's uniform distribution for a `[input, output]` matrix.
    pub(crate) fn glorot(&mut self, shape: [usize; 2]) -> Param<Tensor<2>> {
        let bound = (6.0 / (shape[0] + shape[1]) as f32).sqrt();
        let values =
            (0..shape[0] * shape[1]).map(|_| self.rng.random_range(-bound..bound)).collect();
        self.param(values, shape)
    }

    /// A constant parameter.
    pub(crate) fn constant<const D: usize>(
        &self,
        value: f32,
        shape: [usize; D],
    ) -> Param<Tensor<D>> {
        self.param(vec![value; shape.iter().product()], shape)
    }
}
