//! Gaussian kernel density estimation.

use ndarray::{Array1, Array2, ArrayView2, Axis};
use rand::{RngExt, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;

use super::GaussianMoments;
use crate::{Error, Result};

/// Kernel density: an isotropic normal distribution around each point.
///
/// ```
/// use cape_stats::density::KernelDensity;
/// use ndarray::array;
/// use rand::{SeedableRng, rngs::ChaCha8Rng};
///
/// let density = KernelDensity::new(array![[0.0, 0.0], [5.0, 5.0]], 0.1)?;
/// let rng = &mut ChaCha8Rng::seed_from_u64(7);
/// let drawn = density.sample(20, 1.0, rng);
/// assert!(drawn.rows().into_iter().all(|x| (x[0] - x[1]).abs() < 1.0));
/// // At temperature 0 the samples are the points themselves.
/// let points = density.sample(20, 0.0, rng);
/// assert!(points.iter().all(|&x| x == 0.0 || x == 5.0));
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct KernelDensity {
    points: Array2<f64>,
    bandwidth: f64,
}

/// Bandwidths tried, in quarter octaves below (and half as many above) Scott's rule.
const STEPS: i32 = 12;

impl KernelDensity {
    /// Density of points `[n, d]` with kernels of standard deviation `bandwidth`.
    ///
    /// # Errors
    /// If there is no point, one is not finite, or `bandwidth` is not positive.
    pub fn new(points: Array2<f64>, bandwidth: f64) -> Result<Self> {
        if points.is_empty() || !points.iter().all(|x| x.is_finite()) {
            return Err(Error::argument(
                "kernel density: expected at least one point, and finite numbers",
            ));
        }
        if !(bandwidth > 0.0 && bandwidth.is_finite()) {
            return Err(Error::argument(format!(
                "kernel density: bandwidth {bandwidth}, expected a positive number"
            )));
        }
        Ok(Self { points, bandwidth })
    }

    /// Fits the bandwidth to points `[n, d]`: the multiple of Scott's rule of largest leave-one-out
    /// likelihood.
    ///
    /// # Errors
    /// If there is no point, or a number is not finite.
    pub fn fit(points: ArrayView2<'_, f64>) -> Result<Self> {
        let (n, d) = points.dim();
        let scott = (n.max(1) as f64).powf(-1.0 / (d as f64 + 4.0));
        let mean = points.mean_axis(Axis(0));
        let spread = mean.map_or(0.0, |mean| (&points - &mean).mapv(|x| x * x).sum());
        let deviation = (spread / (n * d).max(1) as f64).sqrt();
        let base = if deviation > 0.0 { scott * deviation } else { 1e-3 };
        let density = Self::new(points.to_owned(), base)?;
        if n < 3 {
            return Ok(density);
        }
        let squares = density.squared_distances();
        let tried = (-STEPS..=STEPS / 2).map(|step| base * 2f64.powf(f64::from(step) / 4.0));
        let best = tried.max_by(|&a, &b| {
            leave_one_out(&squares, d, a).total_cmp(&leave_one_out(&squares, d, b))
        });
        Ok(Self { bandwidth: best.unwrap_or(base), ..density })
    }

    /// Standard deviation of the kernels.
    pub fn bandwidth(&self) -> f64 {
        self.bandwidth
    }

    /// Points of the density, `[n, d]`.
    pub fn points(&self) -> &Array2<f64> {
        &self.points
    }

    /// Mean and covariance.
    pub fn moments(&self) -> GaussianMoments {
        let (n, d) = self.points.dim();
        let mean = self.points.mean_axis(Axis(0)).unwrap_or_else(|| Array1::zeros(d));
        let centred = &self.points - &mean;
        let own = Array2::<f64>::eye(d) * self.bandwidth.powi(2);
        GaussianMoments { mean, covariance: centred.t().dot(&centred) / n.max(1) as f64 + own }
    }

    /// Draws `n` samples, `[n, d]`; the bandwidth is multiplied by `temperature`.
    pub fn sample(&self, n: usize, temperature: f64, rng: &mut ChaCha8Rng) -> Array2<f64> {
        let (count, d) = self.points.dim();
        let mut drawn = Array2::zeros((n, d));
        for mut row in drawn.rows_mut() {
            let centre = self.points.row(rng.random_range(0..count));
            for (value, at) in row.iter_mut().zip(centre) {
                *value = at + self.bandwidth * temperature * rng.sample::<f64, _>(StandardNormal);
            }
        }
        drawn
    }

    fn squared_distances(&self) -> Array2<f64> {
        let n = self.points.nrows();
        Array2::from_shape_fn((n, n), |(i, j)| {
            let (a, b) = (self.points.row(i), self.points.row(j));
            a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum()
        })
    }
}

/// Mean leave-one-out log-likelihood of the points.
fn leave_one_out(squares: &Array2<f64>, d: usize, bandwidth: f64) -> f64 {
    let n = squares.nrows() as f64;
    let scale = -0.5 / (bandwidth * bandwidth);
    let sum: f64 = squares
        .rows()
        .into_iter()
        .enumerate()
        .map(|(own, row)| {
            let others =
                || row.iter().enumerate().filter(|(j, _)| *j != own).map(|(_, s)| s * scale);
            let most = others().fold(f64::NEG_INFINITY, f64::max);
            most + others().map(|x| (x - most).exp()).sum::<f64>().ln()
        })
        .sum();
    let volume = d as f64 * (bandwidth.ln() + 0.5 * (2.0 * std::f64::consts::PI).ln());
    sum / n - (n - 1.0).ln() - volume
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn samples_lie_around_the_points() {
        let points = Array2::from(vec![[0.0, 0.0], [10.0, -10.0]]);
        let density = KernelDensity::new(points, 0.1).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let drawn = density.sample(4000, 1.0, &mut rng);
        let near = drawn.rows().into_iter().filter(|row| row[0] < 5.0);
        let near: Vec<f64> = near.map(|row| row[1]).collect();
        assert!((near.len() as f64 / 4000.0 - 0.5).abs() < 0.04);
        let variance = near.iter().map(|x| x * x).sum::<f64>() / near.len() as f64;
        assert!((variance.sqrt() - 0.1).abs() < 0.01);
        let exact = density.sample(5, 0.0, &mut rng);
        assert!(exact.rows().into_iter().all(|row| row[0] == -row[1]));
    }

    #[test]
    fn bandwidths_fit_the_points() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut normal = |n: usize, scale: f64| {
            Array2::from_shape_simple_fn((n, 2), || scale * rng.sample::<f64, _>(StandardNormal))
        };
        let few = KernelDensity::fit(normal(40, 1.0).view()).unwrap().bandwidth();
        let many = KernelDensity::fit(normal(800, 1.0).view()).unwrap().bandwidth();
        let wide = KernelDensity::fit(normal(800, 20.0).view()).unwrap().bandwidth();
        assert!(many < few && (10.0..40.0).contains(&(wide / many)), "{few} {many} {wide}");
        // The bandwidth of two distant clusters is their width, not their distance.
        let mut clusters = normal(200, 0.01);
        for mut row in clusters.rows_mut().into_iter().take(100) {
            row += 50.0;
        }
        let found = KernelDensity::fit(clusters.view()).unwrap().bandwidth();
        assert!(found < 3.0, "{found}");
    }

    #[test]
    fn one_point_or_equal_points_are_enough_but_none_is_not() {
        for n in [1, 2, 5] {
            let density = KernelDensity::fit(Array2::from_elem((n, 3), 1.0).view()).unwrap();
            assert!(density.bandwidth() > 0.0);
        }
        assert!(KernelDensity::fit(Array2::zeros((0, 3)).view()).is_err());
    }
}
