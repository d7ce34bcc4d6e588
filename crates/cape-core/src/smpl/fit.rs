//! Shape coefficients of a given rest shape.

use ndarray::{Array1, Array2, s};

use super::SmplModel;
use crate::{Error, Result};

/// Relative size of what is added to the diagonal of the normal equations, so that directions that
/// are no use (zeros in some files) get no weight instead of any.
const RIDGE: f64 = 1e-10;

/// The body nearest to a rest shape.
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
    /// Shape coefficients `β`.
    pub betas: Vec<f64>,
    /// Root mean square distance of the vertices, metres.
    pub rms: f64,
    /// Largest distance of a vertex, metres.
    pub largest: f64,
}

impl SmplModel {
    /// The first `count` shape coefficients (all, if there are fewer) of an unclothed rest shape
    /// `[V, 3]`, metres, by least squares: `T̄ + B_S(β) ≈ shape`.
    ///
    /// # Errors
    /// If the shape has another number of vertices or numbers that are not finite.
    pub fn fit_betas(&self, shape: &Array2<f64>, count: usize) -> Result<ShapeFit> {
        self.expect_vertices("shape", shape)?;
        if shape.iter().any(|x| !x.is_finite()) {
            return Err(Error::Argument("shape: has numbers that are not finite".into()));
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
        let left = &difference - &directions.dot(&betas);
        let squares: Vec<f64> = left
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

/// Solves the normal equations by Cholesky's decomposition.
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

    /// At the least squares the residual is at right angles to every direction.
    #[test]
    fn what_no_shape_reaches_is_the_residual() {
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
    fn directions_of_no_use_get_no_weight() {
        let mut body = random_model();
        body.shapedirs.slice_mut(s![.., .., 1]).fill(0.0);
        let fit = body.fit_betas(&body.rest_shape(&vec![1.0; body.betas()]).unwrap(), 300).unwrap();
        assert!((fit.betas[0] - 1.0).abs() < 1e-6 && fit.betas[1].abs() < 1e-6);
        assert!(body.fit_betas(&Array2::zeros((2, 3)), 10).is_err());
        assert!(body.fit_betas(&Array2::from_elem((body.vertices(), 3), f64::NAN), 10).is_err());
    }
}
