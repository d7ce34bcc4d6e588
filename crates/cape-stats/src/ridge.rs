//! Ridge regression.

use cape_core::{Error, Result};
use nalgebra::{Cholesky, DMatrix};
use ndarray::{Array2, ArrayView2, Axis};

/// Predictions `[m, k]` for the inputs `at`, `[m, d]`, of a ridge regression with intercept from inputs
/// `x`, `[n, d]`, to targets `y`, `[n, k]`. `weight` is that of the squared coefficients, relative to the
/// mean squared length of the centred inputs.
///
/// ```
/// use cape_stats::ridge::ridge;
/// use ndarray::arr2;
///
/// // 2 x + 1, nearly without a penalty, and with one that leaves the mean.
/// let (x, y) = (arr2(&[[0.0], [1.0], [2.0]]), arr2(&[[1.0], [3.0], [5.0]]));
/// let at = arr2(&[[4.0]]);
/// assert!((ridge(x.view(), y.view(), at.view(), 1e-12)?[(0, 0)] - 9.0).abs() < 1e-6);
/// assert!((ridge(x.view(), y.view(), at.view(), 1e9)?[(0, 0)] - 3.0).abs() < 1e-6);
/// # Ok::<(), cape_stats::Error>(())
/// ```
///
/// # Errors
/// If shapes do not fit together, or there are no inputs.
pub fn ridge(
    x: ArrayView2<'_, f64>,
    y: ArrayView2<'_, f64>,
    at: ArrayView2<'_, f64>,
    weight: f64,
) -> Result<Array2<f64>> {
    let (n, d) = x.dim();
    if n == 0 || y.nrows() != n || at.ncols() != d {
        return Err(Error::argument(format!(
            "ridge regression: {n} rows of {d} inputs, {} of targets, predictions for {} inputs",
            y.nrows(),
            at.ncols()
        )));
    }
    let [mean_x, mean_y] = [x, y].map(|of| of.sum_axis(Axis(0)) / n as f64);
    let (centred, tested) = (&x - &mean_x, &at - &mean_x);
    let squares = centred.iter().map(|x| x * x).sum::<f64>();
    let penalty = weight * squares / n as f64 + 1e-12;
    // The smaller system of two with the same solution; positive definite by the penalty.
    let shares = if n <= d {
        solve(&centred.dot(&centred.t()), &centred.dot(&tested.t()), penalty)
    } else {
        solve(&centred.t().dot(&centred), &tested.t().to_owned(), penalty)
            .map(|solved| centred.dot(&solved))
    };
    let shares = shares.ok_or_else(|| {
        Error::argument(format!("ridge regression: singular with the weight {weight}"))
    })?;
    Ok(shares.t().dot(&(&y - &mean_y)) + &mean_y)
}

/// Solution of `(a + penalty) x = b` for a positive semidefinite matrix.
fn solve(a: &Array2<f64>, b: &Array2<f64>, penalty: f64) -> Option<Array2<f64>> {
    let n = a.nrows();
    let system = DMatrix::from_fn(n, n, |i, j| a[(i, j)] + if i == j { penalty } else { 0.0 });
    let right = DMatrix::from_fn(n, b.ncols(), |i, j| b[(i, j)]);
    let solved = Cholesky::new(system)?.solve(&right);
    Some(Array2::from_shape_fn(b.dim(), |(i, j)| solved[(i, j)]))
}

#[cfg(test)]
mod tests {
    use ndarray::{Array2, concatenate};

    use super::*;

    fn wave(rows: usize, columns: usize, phase: f64) -> Array2<f64> {
        Array2::from_shape_fn((rows, columns), |(i, j)| {
            (phase + 1.7 * i as f64 + (j * j) as f64 * 0.9 + 0.3 * (i * j) as f64).sin()
        })
    }

    /// A penalty is a least-squares problem with rows of its root for each coefficient.
    #[test]
    fn predictions_solve_the_extended_least_squares_problem() {
        for (n, d) in [(5, 9), (12, 4)] {
            let (x, y, at) = (wave(n, d, 0.1), wave(n, 3, 0.7), wave(6, d, 2.0));
            let weight = 0.02;
            let found = ridge(x.view(), y.view(), at.view(), weight).unwrap();
            let [mean_x, mean_y] = [&x, &y].map(|of| of.mean_axis(Axis(0)).unwrap());
            let centred = &x - &mean_x;
            let root = (weight * centred.mapv(|x| x * x).sum() / n as f64).sqrt();
            let extended = concatenate![Axis(0), centred, Array2::eye(d) * root];
            let targets = concatenate![Axis(0), &y - &mean_y, Array2::zeros((d, 3))];
            let matrix =
                |of: &Array2<f64>| DMatrix::from_fn(of.nrows(), of.ncols(), |i, j| of[(i, j)]);
            let svd = matrix(&extended).svd(true, true);
            let solved = svd.solve(&matrix(&targets), 1e-12).unwrap();
            let coefficients = Array2::from_shape_fn((d, 3), |(i, j)| solved[(i, j)]);
            let expected = (&at - &mean_x).dot(&coefficients) + &mean_y;
            assert!((found - expected).iter().all(|gap| gap.abs() < 1e-9), "{n} {d}");
        }
    }

    #[test]
    fn shapes_are_checked() {
        let (x, y) = (wave(4, 2, 0.0), wave(3, 1, 0.0));
        assert!(ridge(x.view(), y.view(), x.view(), 1.0).is_err());
        assert!(ridge(x.view(), wave(4, 1, 0.0).view(), wave(2, 3, 0.0).view(), 1.0).is_err());
        let none = Array2::zeros((0, 2));
        assert!(ridge(none.view(), none.view(), none.view(), 1.0).is_err());
    }
}
