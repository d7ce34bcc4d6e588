use burn::{
    module::Param,
    tensor::{Device, Tensor, TensorData},
};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;

/// Draws initial weights on the host, so that a seed gives the same model on every backend.
///
/// ```
/// use burn::tensor::Device;
/// use cape_model::{Initialiser, layers::Linear, weights::collect};
///
/// let draw = |seed| collect(&Linear::new(2, 3, &mut Initialiser::new(seed, 0.1, &Device::default())));
/// assert_eq!(draw(7), draw(7));
/// assert_ne!(draw(7), draw(8));
/// ```
#[derive(Debug)]
pub struct Initialiser {
    rng: ChaCha8Rng,
    deviation: f32,
    device: Device,
}

impl Initialiser {
    /// A source of weights for `device`, with the given standard deviation of convolutions.
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

    /// Normal, cut at two deviations.
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

    /// The same number everywhere.
    pub(crate) fn constant<const D: usize>(
        &self,
        value: f32,
        shape: [usize; D],
    ) -> Param<Tensor<D>> {
        self.param(vec![value; shape.iter().product()], shape)
    }
}
