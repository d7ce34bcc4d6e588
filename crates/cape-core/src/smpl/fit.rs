//! Least-squares shape coefficients of a rest shape.

use ndarray::{Array1, Array2, s};

use super::SmplModel;
use crate::{Error, Result};

/// Ridge of the normal equations, relative to the mean of their diagonal, so that zero shape
/// directions (as some files have) get coefficient 0.
const RIDGE: f64 = 1e-10;

/// Shape coefficients fitted to a rest shape, and their residual.
///
/// ```
/// use cape_synth::synthetic_body;
///
/// let body = synthetic_body();
/// let fit = body.fit_betas(&body.rest_shape(&[1.5, -0.5])?, 4)?;
/// assert_eq!(fit.betas.len(), 4);
/// assert!((fit.betas[0] - 1.5).abs() < 1e-6 && fit.betas[3].abs() < 1e-6);
/// assert!(fit.rms < 1e-6);
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct ShapeFit {
    /// Shape coefficients β, `[count]`.
    pub betas: Vec<f64>,
    /// Root mean square vertex distance, metres.
    pub rms: f64,
    /// Largest vertex distance, metres.
    pub largest: f64,
}

impl SmplModel {
    /// Fits the first `count` shape coefficients (at most all) to an unclothed rest shape `[V, 3]`,
    /// metres, by least squares: `T̄ + B_S(β) ≈ shape`.
    ///
    /// # Errors
    /// If the shape is not `[V, 3]` or not finite.
    pub fn fit_betas(&self, shape: &Array2<f64>, count: usize) -> Result<ShapeFit> {
        self.expect_vertices("shape", shape)?;
        if shape.iter().any(|x| !x.is_finite()) {
            return Err(Error::Argument("shape: a coordinate is not finite".into()));
        }
        let count = count.min(self.betas());
        let rows = 3 * self.vertices();
        let directions = self.shapedirs.slice(s![.., .., ..count]);
        let directions = directions
            .to_shape((rows, count))
            .map_err(|source| Error::Argument(source.to_string()))?;
        let difference = shape - &self.v_template;
        let difference =
            difference.to_shape(rows).map_err(|source| Error::Argument(source.to_string()))?;
        let betas = solve(directions.t().dot(&directions), directions.t().dot(&difference));
        let residual = &difference - &directions.dot(&betas);
        let squares: Vec<f64> = residual
            .as_slice()
            .unwrap_or_default()
            .as_chunks::<3>()
            .0
            .iter()
            .map(|d| d.iter().map(|x| x * x).sum())
            .collect();
        Ok(ShapeFit {
            betas: betas.to_vec(),
            rms: (squares.iter().sum::<f64>() / self.vertices() as f64).sqrt(),
            largest: squares.iter().copied().fold(0.0, f64::max).sqrt(),
        })
    }
}

/// Solves the normal equations `a x = b` by Cholesky decomposition; `x` is `b` on entry.
fn solve(mut a: Array2<f64>, mut x: Array1<f64>) -> Array1<f64> {
    let n = x.len();
    let ridge = RIDGE * a.diag().sum() / n.max(1) as f64;
    a.diag_mut().mapv_inplace(|x| x + ridge.max(f64::MIN_POSITIVE));
    for j in 0..n {
        for k in 0..j {
            a[[j, j]] -= a[[j, k]] * a[[j, k]];
        }
        a[[j, j]] = a[[j, j]].max(f64::MIN_POSITIVE).sqrt();
        for i in j + 1..n {
            for k in 0..j {
                a[[i, j]] -= a[[i, k]] * a[[j, k]];
            }
            a[[i, j]] /= a[[j, j]];
        }
    }
    for i in 0..n {
        for k in 0..i {
            x[i] -= a[[i, k]] * x[k];
        }
        x[i] /= a[[i, i]];
    }
    for i in (0..n).rev() {
        for k in i + 1..n {
            x[i] -= a[[k, i]] * x[k];
        }
        x[i] /= a[[i, i]];
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::smpl::test_model::random_model;

    #[test]
    fn the_betas_of_a_body_are_found() {
        let body = random_model();
        let betas: Vec<f64> = (0..body.betas()).map(|k| 1.5 - k as f64).collect();
        let fit = body.fit_betas(&body.rest_shape(&betas).unwrap(), 300).unwrap();
        assert!(fit.betas.iter().zip(&betas).all(|(a, b)| (a - b).abs() < 1e-6), "{fit:?}");
        assert!(fit.rms < 1e-6 && fit.largest < 1e-6);
    }

    #[test]
    fn residuals_are_orthogonal_to_the_shape_directions() {
        let body = random_model();
        let shape =
            Array2::from_shape_fn((body.vertices(), 3), |(v, c)| ((3 * v + c) as f64).cos());
        let fit = body.fit_betas(&shape, body.betas()).unwrap();
        let left = shape - body.rest_shape(&fit.betas).unwrap();
        for direction in body.shapedirs.axis_iter(ndarray::Axis(2)) {
            assert!((&direction * &left).sum().abs() < 1e-6);
        }
        let squares = left.map_axis(ndarray::Axis(1), |d| d.dot(&d));
        assert!((fit.rms - squares.mean().unwrap().sqrt()).abs() < 1e-12);
        let largest = squares.iter().copied().fold(0.0, f64::max).sqrt();
        assert!((fit.largest - largest).abs() < 1e-12);
    }

    #[test]
    fn zero_directions_get_zero_coefficients() {
        let mut body = random_model();
        body.shapedirs.slice_mut(s![.., .., 1]).fill(0.0);
        let fit = body.fit_betas(&body.rest_shape(&vec![1.0; body.betas()]).unwrap(), 300).unwrap();
        assert!((fit.betas[0] - 1.0).abs() < 1e-6 && fit.betas[1].abs() < 1e-6);
        assert!(body.fit_betas(&Array2::zeros((2, 3)), 10).is_err());
        assert!(body.fit_betas(&Array2::from_elem((body.vertices(), 3), f64::NAN), 10).is_err());
    }
}
