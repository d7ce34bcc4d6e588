use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis, s};
use rand::{RngExt, rngs::ChaCha8Rng};
use rayon::prelude::*;

use crate::{Error, Result};

/// Rows whose errors are summed by one thread; fixed, so that sums do not depend on the number of
/// threads.
const PIECE: usize = 64;

/// A multilayer perceptron in `f64` with tanh units and a linear output.
///
/// Written here rather than with Burn, because L-BFGS with a line search needs gradients in `f64`.
/// All weights and biases are one vector: for each layer its matrix `[outputs, inputs]`, row by
/// row, then its biases `[outputs]`.
///
/// ```
/// use cape_layer::regress::Network;
/// use ndarray::{arr1, arr2};
///
/// // Without hidden layers a network is linear: 2 x + 1.
/// let network = Network::new(&[1, 1], arr1(&[2.0, 1.0]))?;
/// assert_eq!(network.forward(arr2(&[[0.0], [3.0]]).view())?, arr2(&[[1.0], [7.0]]));
/// // The sizes determine the number of parameters.
/// assert!(Network::new(&[1, 1], arr1(&[2.0])).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Network {
    sizes: Vec<usize>,
    parameters: Array1<f64>,
}

impl Network {
    /// A network with random weights (Glorot and Bengio 2010) and zero biases; `sizes` are the
    /// numbers of inputs, of units of each hidden layer, and of outputs.
    ///
    /// # Errors
    /// If there are fewer than two sizes or one is 0.
    pub fn random(sizes: &[usize], rng: &mut ChaCha8Rng) -> Result<Self> {
        check(sizes)?;
        let mut parameters = Vec::new();
        for pair in sizes.windows(2) {
            let bound = (6.0 / (pair[0] + pair[1]) as f64).sqrt();
            parameters.extend((0..pair[0] * pair[1]).map(|_| rng.random_range(-bound..bound)));
            parameters.extend(std::iter::repeat_n(0.0, pair[1]));
        }
        Ok(Self { sizes: sizes.to_vec(), parameters: Array1::from_vec(parameters) })
    }

    /// A network with given parameters.
    ///
    /// # Errors
    /// If `sizes` are invalid, or the parameters are not finite or of another number.
    pub fn new(sizes: &[usize], parameters: Array1<f64>) -> Result<Self> {
        check(sizes)?;
        let expected: usize = sizes.windows(2).map(|pair| (pair[0] + 1) * pair[1]).sum();
        if parameters.len() != expected {
            return Err(Error::argument(format!(
                "network {sizes:?}: {} parameters, expected {expected}",
                parameters.len()
            )));
        }
        cape_core::expect_finite("network parameters", &parameters)?;
        Ok(Self { sizes: sizes.to_vec(), parameters })
    }

    /// Numbers of inputs, hidden units and outputs.
    pub fn sizes(&self) -> &[usize] {
        &self.sizes
    }

    /// All weights and biases.
    pub fn parameters(&self) -> &Array1<f64> {
        &self.parameters
    }

    pub(super) fn set_parameters(&mut self, parameters: Array1<f64>) {
        self.parameters = parameters;
    }

    /// Outputs `[n, outputs]` of inputs `[n, inputs]`.
    ///
    /// # Errors
    /// If the inputs have another number of columns.
    pub fn forward(&self, inputs: ArrayView2<'_, f64>) -> Result<Array2<f64>> {
        if inputs.ncols() != self.sizes[0] {
            return Err(Error::argument(format!(
                "network: {} inputs, expected {}",
                inputs.ncols(),
                self.sizes[0]
            )));
        }
        let mut values = inputs.to_owned();
        let layers = layers(&self.sizes, self.parameters.view());
        let last = layers.len() - 1;
        for (index, layer) in layers.into_iter().enumerate() {
            values = layer.apply(&values);
            if index < last {
                values.mapv_inplace(f64::tanh);
            }
        }
        Ok(values)
    }

    /// Unit of each parameter for the optimiser, `[parameters]`: the inverse root of the mean squared length of
    /// its layer's inputs, with 1 for the bias. In these units the layers are about equally curved, however
    /// many inputs they have.
    pub(super) fn parameter_units(&self, inputs: ArrayView2<'_, f64>) -> Array1<f64> {
        let mut units = Vec::with_capacity(self.parameters.len());
        let mut values = inputs.to_owned();
        for layer in layers(&self.sizes, self.parameters.view()) {
            let squares = values.iter().map(|x| x * x).sum::<f64>() / values.nrows().max(1) as f64;
            let count = layer.weights.len() + layer.biases.len();
            units.extend(std::iter::repeat_n(1.0 / (1.0 + squares).sqrt(), count));
            values = layer.apply(&values).mapv_into(f64::tanh);
        }
        Array1::from_vec(units)
    }

    /// Mean squared error over rows and outputs, and its gradient with respect to `parameters`, by
    /// backpropagation.
    pub(super) fn error_and_gradient(
        &self,
        parameters: &Array1<f64>,
        inputs: ArrayView2<'_, f64>,
        targets: ArrayView2<'_, f64>,
    ) -> (f64, Array1<f64>) {
        let pieces: Vec<_> = inputs
            .axis_chunks_iter(Axis(0), PIECE)
            .zip(targets.axis_chunks_iter(Axis(0), PIECE))
            .collect();
        let parts: Vec<(f64, Array1<f64>)> = pieces
            .into_par_iter()
            .map(|(inputs, targets)| self.piece(parameters, inputs, targets))
            .collect();
        let mut gradient = Array1::zeros(parameters.len());
        let mut error = 0.0;
        for (part, slope) in parts {
            error += part;
            gradient += &slope;
        }
        let scale = 1.0 / targets.len().max(1) as f64;
        (error * scale, gradient * scale)
    }

    /// Sum of squared errors of some rows, and its gradient.
    fn piece(
        &self,
        parameters: &Array1<f64>,
        inputs: ArrayView2<'_, f64>,
        targets: ArrayView2<'_, f64>,
    ) -> (f64, Array1<f64>) {
        let layers = layers(&self.sizes, parameters.view());
        let mut values = vec![inputs.to_owned()];
        for (index, layer) in layers.iter().enumerate() {
            let mut next = layer.apply(&values[index]);
            if index + 1 < layers.len() {
                next.mapv_inplace(f64::tanh);
            }
            values.push(next);
        }
        let off = &values[layers.len()] - &targets;
        let error = off.iter().map(|x| x * x).sum();
        let mut gradient = Array1::zeros(parameters.len());
        let mut slope = off * 2.0;
        for (index, layer) in layers.iter().enumerate().rev() {
            let weights = slope.t().dot(&values[index]);
            let (from, middle) = (layer.start, layer.start + weights.len());
            gradient
                .slice_mut(s![from..middle])
                .assign(&Array1::from_iter(weights.iter().copied()));
            let biases = slope.sum_axis(Axis(0));
            gradient.slice_mut(s![middle..middle + biases.len()]).assign(&biases);
            if index > 0 {
                slope = slope.dot(&layer.weights) * values[index].mapv(|y| 1.0 - y * y);
            }
        }
        (error, gradient)
    }
}

struct Layer<'a> {
    /// Index of the first parameter.
    start: usize,
    /// `[outputs, inputs]`.
    weights: ArrayView2<'a, f64>,
    /// `[outputs]`.
    biases: ArrayView1<'a, f64>,
}

impl Layer<'_> {
    fn apply(&self, values: &Array2<f64>) -> Array2<f64> {
        values.dot(&self.weights.t()) + self.biases
    }
}

fn layers<'a>(sizes: &[usize], parameters: ArrayView1<'a, f64>) -> Vec<Layer<'a>> {
    let mut rest = parameters;
    let mut start = 0;
    let mut layers = Vec::with_capacity(sizes.len() - 1);
    for pair in sizes.windows(2) {
        let count = pair[0] * pair[1];
        let (weights, after) = rest.split_at(Axis(0), count);
        let (biases, after) = after.split_at(Axis(0), pair[1]);
        // The constructors check the number of parameters.
        if let Ok(weights) = weights.into_shape_with_order((pair[1], pair[0])) {
            layers.push(Layer { start, weights, biases });
        }
        start += count + pair[1];
        rest = after;
    }
    layers
}

fn check(sizes: &[usize]) -> Result<()> {
    if sizes.len() < 2 || sizes.contains(&0) {
        return Err(Error::argument(format!(
            "network: sizes {sizes:?}, expected two or more, none 0"
        )));
    }
    Ok(())
}
