//! Normal distributions by their moments, and optimal transport between them.

use nalgebra::{DMatrix, SymmetricEigen};
use ndarray::{Array1, Array2, ArrayView2};

use crate::{Error, Result};

/// Smallest eigenvalue of a covariance that is inverted, relative to the largest.
const SINGULAR: f64 = 1e-9;

/// Mean `[d]` and covariance `[d, d]` of a density.
#[derive(Debug, Clone, PartialEq)]
pub struct GaussianMoments {
    /// Mean, `[d]`.
    pub mean: Array1<f64>,
    /// Covariance, `[d, d]`.
    pub covariance: Array2<f64>,
}

/// Affine map `x ↦ A x + b` that takes one normal distribution to another with the least mean squared
/// distance: `A = Σ₁^(-1/2) (Σ₁^(1/2) Σ₂ Σ₁^(1/2))^(1/2) Σ₁^(-1/2)` and `b = m₂ − A m₁` (Olkin and Pukelsheim
/// 1982).
///
/// ```
/// use cape_stats::density::{GaussianMoments, GaussianTransport};
/// use ndarray::array;
///
/// let narrow = GaussianMoments { mean: array![1.0], covariance: array![[1.0]] };
/// let wide = GaussianMoments { mean: array![5.0], covariance: array![[4.0]] };
/// let map = GaussianTransport::between(&narrow, &wide)?;
/// // One deviation above the mean stays one deviation above the mean.
/// assert_eq!(map.apply(array![[2.0]].view()), array![[7.0]]);
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct GaussianTransport {
    /// Symmetric matrix A, `[d, d]`.
    pub matrix: Array2<f64>,
    /// Offset b, `[d]`.
    pub offset: Array1<f64>,
}

impl GaussianTransport {
    /// The map between the normal distributions of these moments.
    ///
    /// # Errors
    /// If their dimensions differ.
    pub fn between(from: &GaussianMoments, to: &GaussianMoments) -> Result<Self> {
        let d = from.mean.len();
        for moments in [from, to] {
            if moments.mean.len() != d || moments.covariance.dim() != (d, d) {
                return Err(Error::argument(format!(
                    "transport: mean [{}] and covariance {:?}, expected [{d}] and ({d}, {d})",
                    moments.mean.len(),
                    moments.covariance.dim()
                )));
            }
        }
        let matrix =
            |moments: &GaussianMoments| DMatrix::from_fn(d, d, |i, j| moments.covariance[[i, j]]);
        let source = matrix(from);
        let (root, inverse) = (power(&source, 0.5), power(&source, -0.5));
        let between = power(&(&root * matrix(to) * &root), 0.5);
        let map = &inverse * between * &inverse;
        let matrix = Array2::from_shape_fn((d, d), |(i, j)| 0.5 * (map[(i, j)] + map[(j, i)]));
        let offset = &to.mean - &matrix.dot(&from.mean);
        Ok(Self { matrix, offset })
    }

    /// Points `[n, d]` in their new places.
    pub fn apply(&self, points: ArrayView2<f64>) -> Array2<f64> {
        points.dot(&self.matrix) + &self.offset
    }
}

/// Power of a symmetric matrix that has no negative eigenvalues but for rounding.
fn power(matrix: &DMatrix<f64>, exponent: f64) -> DMatrix<f64> {
    let symmetric = 0.5 * (matrix + matrix.transpose());
    let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new(symmetric);
    let least = SINGULAR * eigenvalues.max().max(f64::MIN_POSITIVE);
    let powers = eigenvalues.map(|value| value.max(least).powf(exponent));
    &eigenvectors * DMatrix::from_diagonal(&powers) * eigenvectors.transpose()
}

#[cfg(test)]
mod tests {
    use ndarray::array;
    use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

    use super::*;

    fn random(seed: u64, d: usize) -> GaussianMoments {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let factor = Array2::from_shape_simple_fn((d, d), || rng.random_range(-1.0..1.0));
        let mean = Array1::from_shape_simple_fn(d, || rng.random_range(-3.0..3.0));
        GaussianMoments { mean, covariance: factor.dot(&factor.t()) + Array2::<f64>::eye(d) * 0.01 }
    }

    #[test]
    fn the_map_takes_mean_and_covariance_to_those_of_the_other() {
        let (from, to) = (random(1, 12), random(2, 12));
        let map = GaussianTransport::between(&from, &to).unwrap();
        let mean = map.matrix.dot(&from.mean) + &map.offset;
        let covariance = map.matrix.dot(&from.covariance).dot(&map.matrix.t());
        let largest = |a: Array2<f64>| a.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        assert!((mean - &to.mean).iter().all(|x| x.abs() < 1e-10));
        assert!(largest(covariance - &to.covariance) < 1e-9);
        // Gradients of convex functions are optimal: A is symmetric and positive.
        let symmetric = DMatrix::from_fn(12, 12, |i, j| map.matrix[[i, j]]);
        assert_eq!(symmetric, symmetric.transpose());
        assert!(SymmetricEigen::new(symmetric).eigenvalues.min() > 0.0);
    }

    #[test]
    fn equal_distributions_keep_their_points() {
        let moments = random(3, 5);
        let map = GaussianTransport::between(&moments, &moments).unwrap();
        let points = array![[1.0, -2.0, 0.5, 3.0, 0.0], [0.0; 5]];
        let moved = map.apply(points.view());
        assert!((moved - points).iter().all(|x| x.abs() < 1e-9));
    }

    #[test]
    fn singular_covariances_do_not_make_points_infinite() {
        let flat =
            GaussianMoments { mean: array![0.0, 0.0], covariance: array![[1.0, 0.0], [0.0, 0.0]] };
        let map = GaussianTransport::between(&flat, &random(4, 2)).unwrap();
        assert!(map.apply(array![[1.0, 0.0]].view()).iter().all(|x| x.is_finite()));
        assert!(GaussianTransport::between(&flat, &random(4, 3)).is_err());
    }
}
