use burn::{
    module::{Module, Param},
    tensor::Tensor,
};
use cape_graph::{ConvGraph, Epilogue, cheb_conv};

use crate::{Initialiser, config::LEAKY_SLOPE};

/// Chebyshev graph convolution without bias: `[T_0(L̃)x, …, T_{K−1}(L̃)x] · W`.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::{ConvGraph, sparse_from_triplets};
/// use cape_model::{Initialiser, layers::ChebConv};
///
/// let triangle = sparse_from_triplets(
///     "L", (3, 3), &[0, 0, 1, 1, 2, 2], &[1, 2, 0, 2, 0, 1], &[-0.5; 6])?;
/// let device = Device::default();
/// let graph = ConvGraph::new(&triangle, None, &device);
/// let conv = ChebConv::new(4, 8, 2, &mut Initialiser::new(1, 0.1, &device)).with_spectral_norm(false);
/// assert_eq!(conv.weight.val().dims(), [4 * 2, 8]);
/// let y = conv.forward(Tensor::ones([1, 3, 4], &device), None, &graph);
/// assert_eq!(y.dims(), [1, 3, 8]);
/// # Ok::<(), cape_graph::Error>(())
/// ```
#[derive(Module, Debug)]
pub struct ChebConv {
    /// Weight matrix `[channels · order, out]`; row `channel · order + k` is term `k` of a channel.
    pub weight: Param<Tensor<2>>,
    pub(super) order: usize,
    spectral: bool,
}

impl ChebConv {
    /// Creates truncated-normal weights for `order` Chebyshev terms.
    pub fn new(input: usize, output: usize, order: usize, init: &mut Initialiser) -> Self {
        Self { weight: init.truncated_normal([input * order, output]), order, spectral: false }
    }

    /// Enables spectral normalisation: the weight matrix is divided by its largest singular value.
    #[must_use]
    pub fn with_spectral_norm(self, spectral: bool) -> Self {
        Self { spectral, ..self }
    }

    /// Number of Chebyshev terms.
    pub fn order(&self) -> usize {
        self.order
    }

    /// Convolves `x: [batch, vertices, channels]`, with the numbers of
    /// `condition: [batch, embedding]` as further channels at every vertex, into
    /// `[batch, kept, out]`.
    pub fn forward(
        &self,
        x: Tensor<3>,
        condition: Option<&Tensor<2>>,
        graph: &ConvGraph,
    ) -> Tensor<3> {
        let [_, _, channels] = x.dims();
        let (weight, constant_terms) = self.split(channels, condition);
        cheb_conv(x, weight, graph, self.order, Epilogue { constant_terms, slope: None })
    }

    /// Weights of the first `channels` channels, `[channels · order, out]`, and the constant terms of
    /// the condition's channels, `[batch, order, out]`, instead of channels repeated at every vertex.
    pub(super) fn split(
        &self,
        channels: usize,
        condition: Option<&Tensor<2>>,
    ) -> (Tensor<2>, Option<Tensor<3>>) {
        let weight = self.weight.val();
        let weight = if self.spectral { weight.clone() / spectral_norm(weight) } else { weight };
        let Some(condition) = condition else { return (weight, None) };
        let [batch, size] = condition.dims();
        let [rows, out] = weight.dims();
        let features = weight.clone().slice([0..channels * self.order, 0..out]);
        let weight = weight.slice([channels * self.order..rows, 0..out]);
        let product = condition.clone().matmul(weight.reshape([size, self.order * out]));
        (features, Some(product.reshape([batch, self.order, out])))
    }
}

/// The largest singular value of a matrix, `[1, 1]`, with its gradient `u vᵀ`.
///
/// `(WᵀW)^64`, scaled to a trace of 1, projects onto the leading right singular vectors; the
/// remainder of the other vectors lowers the value by less than 1 % for any spectrum of a matrix of
/// up to 100 columns, and far less for most.
fn spectral_norm(weight: Tensor<2>) -> Tensor<2> {
    let fixed = weight.clone().detach();
    let [_, columns] = fixed.dims();
    let device = fixed.device();
    let identity = Tensor::<2>::eye(columns, &device);
    let scaled = |gram: Tensor<2>| {
        let trace = (gram.clone() * identity.clone()).sum().reshape([1, 1]);
        gram / trace.clamp_min(f32::MIN_POSITIVE)
    };
    let mut projector = scaled(fixed.clone().transpose().matmul(fixed.clone()));
    for _ in 0..6 {
        projector = scaled(projector.clone().matmul(projector));
    }
    let along = fixed.matmul(projector);
    let norm = (along.clone() * weight.clone().detach()).sum().sqrt().reshape([1, 1]);
    // ⟨W, σ⁻¹ W P⟩ is σ where P was taken, and its gradient σ⁻¹ W P that of the singular value.
    (weight * (along / norm.clamp_min(f32::MIN_POSITIVE))).sum().reshape([1, 1])
}

/// Convolution, bias per channel and leaky ReLU.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::{ConvGraph, sparse_from_triplets};
/// use cape_model::{Initialiser, layers::ConvLayer};
///
/// let triangle = sparse_from_triplets(
///     "L", (3, 3), &[0, 0, 1, 1, 2, 2], &[1, 2, 0, 2, 0, 1], &[-0.5; 6])?;
/// let device = Device::default();
/// let graph = ConvGraph::new(&triangle, None, &device);
/// let layer = ConvLayer::new(4, 8, 2, &mut Initialiser::new(1, 0.1, &device));
/// // Zeros become the initial bias.
/// let y = layer.forward(Tensor::zeros([1, 3, 4], &device), None, &graph);
/// let error: f32 = (y - 0.1).abs().max().into_scalar();
/// assert!(error < 1e-6);
/// # Ok::<(), cape_graph::Error>(())
/// ```
#[derive(Module, Debug)]
pub struct ConvLayer {
    /// Convolution without bias.
    pub conv: ChebConv,
    /// Bias per channel, `[out]`.
    pub bias: Param<Tensor<1>>,
}

impl ConvLayer {
    /// Creates truncated-normal weights and biases of 0.1.
    pub fn new(input: usize, output: usize, order: usize, init: &mut Initialiser) -> Self {
        Self { conv: ChebConv::new(input, output, order, init), bias: init.constant(0.1, [output]) }
    }

    /// As [`ChebConv::with_spectral_norm`].
    #[must_use]
    pub fn with_spectral_norm(self, spectral: bool) -> Self {
        Self { conv: self.conv.with_spectral_norm(spectral), ..self }
    }

    /// As [`ChebConv::forward`], then bias and leaky ReLU.
    pub fn forward(
        &self,
        x: Tensor<3>,
        condition: Option<&Tensor<2>>,
        graph: &ConvGraph,
    ) -> Tensor<3> {
        let [batch, _, channels] = x.dims();
        let (weight, terms) = self.conv.split(channels, condition);
        let [_, out] = weight.dims();
        let bias = self.bias.val().reshape([1, 1, out]).expand([batch, 1, out]);
        let terms = match terms {
            None => bias,
            Some(terms) => {
                // The bias is the same at every vertex, as T_0(L̃)1 is.
                let order = self.conv.order;
                let first = terms.clone().slice([0..batch, 0..1, 0..out]) + bias;
                if order > 1 {
                    Tensor::cat(vec![first, terms.slice([0..batch, 1..order, 0..out])], 1)
                } else {
                    first
                }
            }
        };
        let epilogue = Epilogue { constant_terms: Some(terms), slope: Some(LEAKY_SLOPE) };
        cheb_conv(x, weight, graph, self.conv.order, epilogue)
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};
    use rand::{RngExt, SeedableRng, rngs::SmallRng};

    use super::*;

    fn device() -> Device {
        let names = std::env::var("CAPE_TEST_DEVICES").unwrap_or_default();
        let name = names.split(',').find(|name| !name.is_empty()).unwrap_or(cape_core::DEVICES[0]);
        cape_core::parse_device(name).unwrap()
    }

    /// Largest singular value by power iteration in f64.
    fn largest_singular_value(values: &[f32], columns: usize) -> f64 {
        let mut right: Vec<f64> = (0..columns).map(|i| 1.0 + 0.37 * (i as f64).sin()).collect();
        let mut norm = 0.0;
        for _ in 0..20_000 {
            let left: Vec<f64> = values
                .chunks(columns)
                .map(|row| row.iter().zip(&right).map(|(&a, b)| f64::from(a) * b).sum())
                .collect();
            norm = left.iter().map(|x| x * x).sum::<f64>().sqrt();
            for (column, right) in right.iter_mut().enumerate() {
                let products = values.chunks(columns).zip(&left);
                *right = products.map(|(row, l)| f64::from(row[column]) * l).sum();
            }
            let length = right.iter().map(|x| x * x).sum::<f64>().sqrt();
            for x in &mut right {
                *x /= length;
            }
        }
        norm
    }

    #[test]
    fn spectral_norms_and_their_gradients_are_those_of_the_largest_singular_value() {
        let device = device().autodiff();
        let mut random = SmallRng::seed_from_u64(3);
        for (rows, columns) in [(1, 1), (7, 3), (12, 40), (105, 64)] {
            let values: Vec<f32> =
                (0..rows * columns).map(|_| random.random_range(-1.0..1.0)).collect();
            let data = TensorData::new(values.clone(), [rows, columns]);
            let weight = Tensor::<2>::from_data(data, &device).require_grad();
            let norm = spectral_norm(weight.clone());
            let expected = largest_singular_value(&values, columns);
            let found = f64::from(norm.clone().into_scalar::<f32>());
            assert!((found / expected - 1.0).abs() < 5e-3, "{rows}×{columns}: {found} {expected}");

            let gradient: Vec<f32> =
                weight.grad(&norm.sum().backward()).unwrap().into_data().try_into_vec().unwrap();
            let step = 1e-3;
            let moved: Vec<f32> =
                values.iter().zip(&gradient).map(|(value, slope)| value + step * slope).collect();
            let squares: f64 = gradient.iter().map(|&g| f64::from(g * g)).sum();
            let rise = largest_singular_value(&moved, columns) - expected;
            let slope = rise / f64::from(step);
            assert!((slope / squares - 1.0).abs() < 0.03, "{rows}×{columns}: {slope} {squares}");
        }
    }
}
