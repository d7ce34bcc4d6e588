//! Gaussian mixtures with full covariances, fitted by expectation–maximisation in `f64`.
//!
//! Own implementation rather than a library: weights, means and covariances must be settable (stored
//! priors and the pose prior of SMPLify), and equal seeds must give equal bits.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use ndarray::{Array1, Array2, Array3, ArrayView2, Axis};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;

use super::GaussianMoments;
use crate::{Error, Result};

/// Options of expectation–maximisation.
#[derive(Debug, Clone, Copy)]
pub struct MixtureOptions {
    /// Largest number of iterations.
    pub steps: usize,
    /// Increase of the mean log-likelihood below which the fit has converged.
    pub tolerance: f64,
    /// Ridge of the covariances relative to the mean variance of the data, which keeps components of
    /// few or equal points from collapsing.
    pub regularisation: f64,
    /// Number of random initialisations; the fit of largest likelihood is kept.
    pub starts: usize,
    /// Random seed of the initialisations.
    pub seed: u64,
}

impl Default for MixtureOptions {
    fn default() -> Self {
        Self { steps: 200, tolerance: 1e-4, regularisation: 1e-3, starts: 2, seed: 1 }
    }
}

/// Gaussian mixture with full covariances.
///
/// ```
/// use cape_stats::density::{Mixture, MixtureOptions};
/// use ndarray::array;
/// use rand::{SeedableRng, rngs::ChaCha8Rng};
///
/// let identity = array![[[1.0, 0.0], [0.0, 1.0]]];
/// let mixture = Mixture::new(&array![1.0], &array![[1.0, 2.0]], &identity)?;
/// // At its mean the standard normal density of the plane is 1 / 2π.
/// assert!((mixture.log_density(&[1.0, 2.0]) + std::f64::consts::TAU.ln()).abs() < 1e-12);
///
/// let points = mixture.sample(500, 1.0, &mut ChaCha8Rng::seed_from_u64(7));
/// let fitted = Mixture::fit(points.view(), 1, &MixtureOptions::default())?;
/// assert!((fitted.means()[[0, 1]] - 2.0).abs() < 0.2);
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Mixture {
    weights: Vec<f64>,
    means: Vec<DVector<f64>>,
    factors: Vec<Cholesky<f64, Dyn>>,
}

impl Mixture {
    /// Creates a mixture of weights `[components]`, means `[components, d]` and covariances
    /// `[components, d, d]`.
    ///
    /// # Errors
    /// If shapes disagree, weights are negative or do not sum to 1, or a covariance is not positive
    /// definite.
    pub fn new(
        weights: &Array1<f64>,
        means: &Array2<f64>,
        covariances: &Array3<f64>,
    ) -> Result<Self> {
        let (count, d) = means.dim();
        if count == 0 || weights.len() != count || covariances.dim() != (count, d, d) {
            return Err(Error::argument(format!(
                "mixture: weights {:?}, means {:?} and covariances {:?}, expected [k], [k, d], [k, d, d]",
                weights.dim(),
                means.dim(),
                covariances.dim()
            )));
        }
        if !means.iter().all(|x| x.is_finite()) {
            return Err(Error::argument("mixture: a mean is not finite"));
        }
        let sum: f64 = weights.sum();
        if !(weights.iter().all(|&w| w >= 0.0) && (sum - 1.0).abs() < 1e-3) {
            return Err(Error::argument(format!(
                "mixture: weights sum to {sum}, expected non-negative weights that sum to 1"
            )));
        }
        let mut factors = Vec::new();
        for (component, covariance) in covariances.axis_iter(Axis(0)).enumerate() {
            let matrix = DMatrix::from_fn(d, d, |i, j| covariance[[i, j]]);
            let Some(factor) = Cholesky::new(matrix) else {
                return Err(Error::argument(format!(
                    "mixture: covariance {component} is not positive definite"
                )));
            };
            factors.push(factor);
        }
        let means = means.rows().into_iter();
        Ok(Self {
            weights: weights.iter().map(|w| w / sum).collect(),
            means: means.map(|row| DVector::from_iterator(d, row.iter().copied())).collect(),
            factors,
        })
    }

    /// Fits a mixture of `components` (at most `n`) to points `[n, d]`.
    ///
    /// # Errors
    /// If there is no point or no component, or a number is not finite.
    pub fn fit(
        points: ArrayView2<'_, f64>,
        components: usize,
        options: &MixtureOptions,
    ) -> Result<Self> {
        let (n, d) = points.dim();
        if n == 0 || d == 0 || components == 0 {
            let message = format!(
                "mixture of {components} components for {n} points of {d} numbers: expected at least 1 of each"
            );
            return Err(Error::argument(message));
        }
        if !points.iter().all(|x| x.is_finite()) {
            return Err(Error::argument("mixture: a point is not finite"));
        }
        let points: Vec<DVector<f64>> = points
            .rows()
            .into_iter()
            .map(|row| DVector::from_iterator(d, row.iter().copied()))
            .collect();
        let mut best: Option<(f64, Self)> = None;
        for start in 0..options.starts.max(1) as u64 {
            let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
            rng.set_stream(start);
            let found = ExpectationMaximisation::new(&points, components.min(n), options, &mut rng)
                .run(options);
            if best.as_ref().is_none_or(|(likelihood, _)| found.0 > *likelihood) {
                best = Some(found);
            }
        }
        best.map(|(_, mixture)| mixture).ok_or_else(|| Error::argument("mixture: no fit succeeded"))
    }

    /// Fits mixtures of 1 to `most` components and returns the one of lowest [`bic`](Self::bic).
    pub fn fit_by_bic(
        points: ArrayView2<'_, f64>,
        most: usize,
        options: &MixtureOptions,
    ) -> Result<Self> {
        let mut best: Option<(f64, Self)> = None;
        for components in 1..=most.max(1).min(points.nrows()) {
            let mixture = Self::fit(points, components, options)?;
            let bic = mixture.bic(points);
            if best.as_ref().is_none_or(|(lowest, _)| bic < *lowest) {
                best = Some((bic, mixture));
            }
        }
        best.map(|(_, mixture)| mixture)
            .ok_or_else(|| Error::argument("mixture: expected at least one point"))
    }

    /// Number of components.
    pub fn components(&self) -> usize {
        self.weights.len()
    }

    /// Dimension `d` of the points.
    pub fn dimensions(&self) -> usize {
        self.means[0].len()
    }

    /// Weights of the components, `[components]`.
    pub fn weights(&self) -> Array1<f64> {
        self.weights.iter().copied().collect()
    }

    /// Means of the components, `[components, d]`.
    pub fn means(&self) -> Array2<f64> {
        Array2::from_shape_fn((self.components(), self.dimensions()), |(k, i)| self.means[k][i])
    }

    /// Covariances of the components, `[components, d, d]`.
    pub fn covariances(&self) -> Array3<f64> {
        let (count, d) = (self.components(), self.dimensions());
        let mut all = Array3::zeros((count, d, d));
        for (k, factor) in self.factors.iter().enumerate() {
            let lower = factor.l();
            let covariance = &lower * lower.transpose();
            for i in 0..d {
                for j in 0..d {
                    all[[k, i, j]] = covariance[(i, j)];
                }
            }
        }
        all
    }

    /// Log-density at a point `[d]`.
    pub fn log_density(&self, point: &[f64]) -> f64 {
        log_sum(&self.log_joint(&DVector::from_column_slice(point)))
    }

    /// Log of weight times density of each component, `[components]`.
    fn log_joint(&self, point: &DVector<f64>) -> Vec<f64> {
        (0..self.components())
            .map(|k| {
                let factor = &self.factors[k];
                let lower = factor.l_dirty();
                let mut deviation = point - &self.means[k];
                // Only the lower triangle is used.
                lower.solve_lower_triangular_mut(&mut deviation);
                let volume: f64 = lower.diagonal().iter().map(|x| x.ln()).sum();
                let size = point.len() as f64 * (2.0 * std::f64::consts::PI).ln();
                self.weights[k].ln() - volume - 0.5 * (size + deviation.norm_squared())
            })
            .collect()
    }

    /// Bayesian information criterion for points `[n, d]`; lower is better.
    pub fn bic(&self, points: ArrayView2<'_, f64>) -> f64 {
        let (count, d) = (self.components() as f64, self.dimensions() as f64);
        let parameters = count - 1.0 + count * d + count * d * (d + 1.0) / 2.0;
        let likelihood: f64 =
            points.rows().into_iter().map(|row| self.log_density(&row.to_vec())).sum();
        parameters * (points.nrows() as f64).ln() - 2.0 * likelihood
    }

    /// Mean and covariance.
    pub fn moments(&self) -> GaussianMoments {
        let d = self.dimensions();
        let mean = self
            .weights
            .iter()
            .zip(&self.means)
            .fold(DVector::zeros(d), |sum, (&weight, mean)| sum + mean * weight);
        let mut covariance = DMatrix::zeros(d, d);
        for ((&weight, own), factor) in self.weights.iter().zip(&self.means).zip(&self.factors) {
            let from_mean = own - &mean;
            let lower = factor.l();
            covariance +=
                (&lower * lower.transpose() + &from_mean * from_mean.transpose()) * weight;
        }
        GaussianMoments {
            mean: mean.iter().copied().collect(),
            covariance: Array2::from_shape_fn((d, d), |(i, j)| covariance[(i, j)]),
        }
    }

    /// Draws `n` samples, `[n, d]`; deviations from the means are multiplied by `temperature`.
    pub fn sample(&self, n: usize, temperature: f64, rng: &mut ChaCha8Rng) -> Array2<f64> {
        let d = self.dimensions();
        let mut points = Array2::zeros((n, d));
        for mut row in points.rows_mut() {
            let component = sample_index(&self.weights, rng);
            let noise = DVector::from_fn(d, |_, _| rng.sample::<f64, _>(StandardNormal));
            let point = &self.means[component] + self.factors[component].l() * noise * temperature;
            for (value, x) in row.iter_mut().zip(point.iter()) {
                *value = *x;
            }
        }
        points
    }
}

/// Draws an index with probability proportional to its weight.
pub(super) fn sample_index(weights: &[f64], rng: &mut ChaCha8Rng) -> usize {
    let mut left = rng.random::<f64>() * weights.iter().sum::<f64>();
    for (index, weight) in weights.iter().enumerate() {
        left -= weight;
        if left < 0.0 {
            return index;
        }
    }
    // Rounding may leave a remainder: the last index of positive weight.
    weights.iter().rposition(|&weight| weight > 0.0).unwrap_or(0)
}

fn log_sum(logs: &[f64]) -> f64 {
    let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if most.is_finite() {
        most + logs.iter().map(|x| (x - most).exp()).sum::<f64>().ln()
    } else {
        most
    }
}

/// State of expectation–maximisation.
struct ExpectationMaximisation<'a> {
    points: &'a [DVector<f64>],
    /// Ridge of the covariances.
    floor: f64,
    mixture: Mixture,
}

impl<'a> ExpectationMaximisation<'a> {
    /// Initialises by k-means++ centres and the points nearest to each.
    fn new(
        points: &'a [DVector<f64>],
        components: usize,
        options: &MixtureOptions,
        rng: &mut ChaCha8Rng,
    ) -> Self {
        let d = points[0].len();
        let centre = points.iter().sum::<DVector<f64>>() / points.len() as f64;
        let spread: f64 = points.iter().map(|point| (point - &centre).norm_squared()).sum();
        let variance = spread / (points.len() * d) as f64;
        // Equal points have variance 0: any small ridge.
        let floor =
            if variance > 0.0 { options.regularisation.max(1e-12) * variance } else { 1e-6 };
        let centres = kmeans_plus_plus(points, components, rng);
        let mut responsibilities = vec![vec![0.0; components]; points.len()];
        for (responsibility, point) in responsibilities.iter_mut().zip(points) {
            let distances = centres.iter().map(|centre| (point - centre).norm_squared());
            let nearest = distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
            responsibility[nearest.map_or(0, |(index, _)| index)] = 1.0;
        }
        let mixture = Mixture {
            weights: vec![1.0 / components as f64; components],
            means: centres,
            factors: vec![identity(d, variance.max(floor)); components],
        };
        let mut fit = Self { points, floor, mixture };
        fit.maximise(&responsibilities);
        fit
    }

    /// Iterates to convergence; returns the mean log-likelihood and the mixture.
    fn run(mut self, options: &MixtureOptions) -> (f64, Mixture) {
        let mut before = f64::NEG_INFINITY;
        for _ in 0..options.steps {
            let (likelihood, responsibilities) = self.expect();
            if likelihood - before < options.tolerance {
                return (likelihood, self.mixture);
            }
            before = likelihood;
            self.maximise(&responsibilities);
        }
        (self.expect().0, self.mixture)
    }

    /// E step: mean log-likelihood, and responsibilities `[n][components]`.
    fn expect(&self) -> (f64, Vec<Vec<f64>>) {
        let mut sum = 0.0;
        let responsibilities = self
            .points
            .iter()
            .map(|point| {
                let joint = self.mixture.log_joint(point);
                let all = log_sum(&joint);
                sum += all;
                joint.iter().map(|log| (log - all).exp()).collect()
            })
            .collect();
        (sum / self.points.len() as f64, responsibilities)
    }

    /// M step. A component without points keeps its mean and gets weight 0.
    fn maximise(&mut self, responsibilities: &[Vec<f64>]) {
        let d = self.points[0].len();
        for k in 0..self.mixture.components() {
            let weight: f64 = responsibilities.iter().map(|responsibility| responsibility[k]).sum();
            self.mixture.weights[k] = weight / self.points.len() as f64;
            if weight < 1e-9 {
                continue;
            }
            let mut mean = DVector::zeros(d);
            for (point, responsibility) in self.points.iter().zip(responsibilities) {
                mean.axpy(responsibility[k] / weight, point, 1.0);
            }
            let mut covariance = DMatrix::from_diagonal_element(d, d, self.floor);
            for (point, responsibility) in self.points.iter().zip(responsibilities) {
                let deviation = point - &mean;
                covariance.ger(responsibility[k] / weight, &deviation, &deviation, 1.0);
            }
            self.mixture.means[k] = mean;
            if let Some(factor) = Cholesky::new(covariance) {
                self.mixture.factors[k] = factor;
            }
        }
    }
}

fn identity(d: usize, variance: f64) -> Cholesky<f64, Dyn> {
    Cholesky::pack_dirty(DMatrix::from_diagonal_element(d, d, variance.sqrt()))
}

/// k-means++ centres: each next one is drawn in proportion to the squared distance from the others.
fn kmeans_plus_plus(
    points: &[DVector<f64>],
    count: usize,
    rng: &mut ChaCha8Rng,
) -> Vec<DVector<f64>> {
    let mut centres = vec![points[rng.random_range(0..points.len())].clone()];
    let mut distances = vec![f64::INFINITY; points.len()];
    while centres.len() < count {
        let last = &centres[centres.len() - 1];
        for (distance, point) in distances.iter_mut().zip(points) {
            *distance = distance.min((point - last).norm_squared());
        }
        centres.push(points[sample_index(&distances, rng)].clone());
    }
    centres
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;

    /// Three well separated normal distributions in the plane, of weights 1 : 2 : 3.
    fn truth() -> Mixture {
        let weights = Array1::from(vec![1.0 / 6.0, 2.0 / 6.0, 3.0 / 6.0]);
        let means = Array2::from(vec![[-4.0, 0.0], [3.0, 3.0], [0.0, -5.0]]);
        let covariances = Array3::from(vec![
            [[1.0, 0.6], [0.6, 0.8]],
            [[0.3, 0.0], [0.0, 0.3]],
            [[2.0, -0.5], [-0.5, 0.5]],
        ]);
        Mixture::new(&weights, &means, &covariances).unwrap()
    }

    fn points(n: usize) -> Array2<f64> {
        truth().sample(n, 1.0, &mut ChaCha8Rng::seed_from_u64(5))
    }

    #[test]
    fn moments_are_those_of_many_samples() {
        let mixture = Mixture::new(
            &array![0.3, 0.7],
            &array![[2.0, -1.0], [-1.0, 0.5]],
            &array![[[1.0, 0.3], [0.3, 0.5]], [[0.2, 0.0], [0.0, 2.0]]],
        )
        .unwrap();
        let GaussianMoments { mean, covariance } = mixture.moments();
        assert!((mean[0] - (0.6 - 0.7)).abs() < 1e-12 && (mean[1] - 0.05).abs() < 1e-12);
        let points = mixture.sample(200_000, 1.0, &mut ChaCha8Rng::seed_from_u64(3));
        let centred = &points - &mean;
        let found = centred.t().dot(&centred) / 200_000.0;
        assert!((found - covariance).iter().all(|x| x.abs() < 0.03));
    }

    #[test]
    fn a_mixture_comes_back_from_its_samples() {
        let points = points(6000);
        let found = Mixture::fit(points.view(), 3, &MixtureOptions::default()).unwrap();
        for k in 0..3 {
            let expected = truth();
            let deviation = |j: usize| (&found.means[j] - &expected.means[k]).norm();
            let nearest = (0..3).min_by(|&a, &b| deviation(a).total_cmp(&deviation(b))).unwrap();
            assert!(deviation(nearest) < 0.1);
            assert!((found.weights[nearest] - expected.weights[k]).abs() < 0.02);
            let [a, b] = [&found, &expected].map(Mixture::covariances);
            let difference = &a.index_axis(Axis(0), nearest) - &b.index_axis(Axis(0), k);
            assert!(difference.iter().all(|x| x.abs() < 0.15), "{difference}");
        }
        let chosen = Mixture::fit_by_bic(points.view(), 6, &MixtureOptions::default()).unwrap();
        assert_eq!(chosen.components(), 3);
    }

    #[test]
    fn densities_agree_with_the_formula() {
        let mixture = truth();
        for point in [[0.0, 0.0], [-4.0, 1.0], [10.0, -3.0]] {
            let mut sum = 0.0;
            for k in 0..3 {
                let covariances = mixture.covariances();
                let c = covariances.index_axis(Axis(0), k);
                let determinant = c[[0, 0]] * c[[1, 1]] - c[[0, 1]] * c[[1, 0]];
                let (x, y) = (point[0] - mixture.means[k][0], point[1] - mixture.means[k][1]);
                let square =
                    (c[[1, 1]] * x * x - 2.0 * c[[0, 1]] * x * y + c[[0, 0]] * y * y) / determinant;
                sum += mixture.weights[k] * (-0.5 * square).exp()
                    / (2.0 * std::f64::consts::PI * determinant.sqrt());
            }
            assert!((mixture.log_density(&point) - sum.ln()).abs() < 1e-9);
        }
    }

    #[test]
    fn every_iteration_increases_the_likelihood() {
        let points = points(300);
        let points: Vec<DVector<f64>> =
            points.rows().into_iter().map(|r| DVector::from_vec(r.to_vec())).collect();
        let options = MixtureOptions { regularisation: 0.0, ..MixtureOptions::default() };
        let mut fit =
            ExpectationMaximisation::new(&points, 4, &options, &mut ChaCha8Rng::seed_from_u64(2));
        let mut before = f64::NEG_INFINITY;
        for _ in 0..60 {
            let (likelihood, responsibilities) = fit.expect();
            assert!(likelihood >= before - 1e-9, "{before} {likelihood}");
            before = likelihood;
            fit.maximise(&responsibilities);
        }
    }

    #[test]
    fn degenerate_points_are_fitted() {
        let options = MixtureOptions::default();
        let same = Array2::from_elem((20, 3), 2.0);
        let found = Mixture::fit(same.view(), 4, &options).unwrap();
        assert!(found.log_density(&[2.0; 3]).is_finite());
        let line = Array2::from_shape_fn((50, 3), |(i, j)| if j == 0 { i as f64 } else { 1.0 });
        let found = Mixture::fit(line.view(), 2, &options).unwrap();
        let drawn = found.sample(10, 1.0, &mut ChaCha8Rng::seed_from_u64(1));
        assert!(drawn.iter().all(|x| x.is_finite()));
        let one = Mixture::fit(line.slice(ndarray::s![..1, ..]), 5, &options).unwrap();
        assert_eq!(one.components(), 1);
        assert!(Mixture::fit(line.slice(ndarray::s![..0, ..]), 1, &options).is_err());
        let broken = Array2::from_elem((3, 2), f64::NAN);
        assert!(Mixture::fit(broken.view(), 1, &options).is_err());
    }

    #[test]
    fn samples_of_temperature_zero_are_the_means() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for row in truth().sample(20, 0.0, &mut rng).rows() {
            let at = DVector::from_vec(row.to_vec());
            assert!(truth().means.iter().any(|mean| (mean - &at).norm() < 1e-12));
        }
    }
}
