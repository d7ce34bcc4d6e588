//! Principal components by the method of snapshots, for fewer rows than numbers in a row.

use nalgebra::{DMatrix, SymmetricEigen};
use ndarray::{Array2, ArrayView2, Axis, s};
use rayon::prelude::*;

use cape_core::expect_finite;

use super::Pca;
use crate::{Error, Result};

/// Variance, relative to the largest, below which a direction is rounding error.
const NEGLIGIBLE: f64 = 1e-14;

/// Number of principal components to keep.
///
/// ```
/// use cape_stats::pca::{ComponentSelection, Pca};
/// use ndarray::arr2;
///
/// // Three rows on a line, 5 apart.
/// let rows = arr2(&[[0.0, 0.0], [3.0, 4.0], [6.0, 8.0]]);
/// let pca = Pca::from_snapshots(rows.view(), ComponentSelection::Energy(0.99))?;
/// assert_eq!(pca.latent(), 1);
/// assert!((pca.variances[0] - 50.0 / 3.0).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ComponentSelection {
    /// This many components.
    Components(usize),
    /// The fewest components that explain this share of the variance, 0 to 1.
    Energy(f64),
    /// All components: as many as rows less one, or fewer if the rows span fewer directions.
    All,
}

impl Pca {
    /// Fits to rows `[frames, numbers]` in memory by the method of snapshots (Sirovich 1987): the
    /// eigenvectors of the small Gram matrix of the centred rows combine the rows into components,
    /// which are then orthonormalised once more, so that small variances do not suffer from the
    /// squaring. All of it is in `f64` and independent of the number of threads.
    ///
    /// [`fit`](Self::fit) needs less memory and is faster for few components of many rows; this finds
    /// all components, to the last digit.
    ///
    /// # Errors
    /// If there are fewer than two rows, numbers are not finite, or `keep` asks for no component or
    /// for more than rows less one.
    pub fn from_snapshots(rows: ArrayView2<'_, f64>, keep: ComponentSelection) -> Result<Self> {
        let (count, numbers) = rows.dim();
        let most = numbers.min(count.saturating_sub(1));
        if most == 0 {
            return Err(Error::argument(format!(
                "principal components of {count} frames of {numbers} numbers: expected at least 2 \
                 frames"
            )));
        }
        match keep {
            ComponentSelection::Components(wanted) if wanted == 0 || wanted > most => {
                return Err(Error::argument(format!(
                    "{wanted} principal components of {count} frames: expected 1 to {most}"
                )));
            }
            ComponentSelection::Energy(share) if !(share > 0.0 && share <= 1.0) => {
                return Err(Error::argument(format!(
                    "principal components: energy {share}, expected above 0 and at most 1"
                )));
            }
            _ => {}
        }
        expect_finite("frames", rows)?;
        let mean = rows.sum_axis(Axis(0)) / count as f64;
        let centred = &rows - &mean;
        let gram = gram(&centred);
        let total_variance = (0..count).map(|k| gram[(k, k)]).sum::<f64>() / count as f64;
        let SymmetricEigen { eigenvalues, eigenvectors } = SymmetricEigen::new(gram);
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|&a, &b| eigenvalues[b].total_cmp(&eigenvalues[a]));
        let largest = eigenvalues[order[0]].max(0.0);
        let real = order.iter().take_while(|&&k| eigenvalues[k] > NEGLIGIBLE * largest).count();
        order.truncate(real.min(most).max(1));
        if let ComponentSelection::Components(wanted) = keep {
            order.truncate(wanted);
        }
        if let ComponentSelection::Energy(share) = keep {
            let mut held = 0.0;
            let enough = order.iter().position(|&k| {
                held += eigenvalues[k] / count as f64;
                held >= share * total_variance
            });
            order.truncate(enough.map_or(order.len(), |last| last + 1));
        }
        let mixing =
            Array2::from_shape_fn((order.len(), count), |(k, i)| eigenvectors[(i, order[k])]);
        let components = orthonormal(mixing.dot(&centred));
        let codes = centred.dot(&components.t());
        let variances = codes.map_axis(Axis(0), |code| code.dot(&code) / count as f64);
        let images = codes.t().dot(&centred) / count as f64;
        let residual = images
            .rows()
            .into_iter()
            .zip(components.rows())
            .zip(&variances)
            .map(|((image, component), &variance)| {
                let left = &image - &(&component * variance);
                left.dot(&left).sqrt()
            })
            .fold(0.0, f64::max)
            / variances.first().copied().unwrap_or(0.0).max(f64::MIN_POSITIVE);
        Ok(Self { mean, components, variances, total_variance, residual })
    }

    /// The same space with the first `count` components only.
    #[must_use]
    pub fn truncated(&self, count: usize) -> Self {
        let count = count.min(self.latent());
        Self {
            mean: self.mean.clone(),
            components: self.components.slice(s![..count, ..]).to_owned(),
            variances: self.variances.slice(s![..count]).to_owned(),
            ..*self
        }
    }
}

/// Dot products of all pairs of rows, each summed in an order that does not depend on the threads.
fn gram(rows: &Array2<f64>) -> DMatrix<f64> {
    let count = rows.nrows();
    let lower: Vec<Vec<f64>> = (0..count)
        .into_par_iter()
        .map(|i| (0..=i).map(|j| rows.row(i).dot(&rows.row(j))).collect())
        .collect();
    DMatrix::from_fn(count, count, |i, j| lower[i.max(j)][i.min(j)])
}

/// Gram–Schmidt orthonormalisation of rows, twice; of the two directions of each row, the one whose
/// largest number is positive.
fn orthonormal(mut rows: Array2<f64>) -> Array2<f64> {
    for k in 0..rows.nrows() {
        let (done, mut rest) = rows.view_mut().split_at(Axis(0), k);
        let mut row = rest.row_mut(0);
        for _ in 0..2 {
            for other in done.rows() {
                let along = other.dot(&row);
                row.scaled_add(-along, &other);
            }
        }
        let length = row.dot(&row).sqrt().max(f64::MIN_POSITIVE);
        let peak = row.iter().copied().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
        row.mapv_inplace(|x| x * peak.signum() / length);
    }
    rows
}

#[cfg(test)]
mod tests {
    use ndarray::Array1;
    use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

    use super::*;

    fn data(count: usize, numbers: usize, decay: f64) -> Array2<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut random =
            |shape| Array2::from_shape_simple_fn(shape, || rng.random_range(-1.0..1.0));
        let (scores, directions) = (random((count, numbers)), random((numbers, numbers)));
        let scale = Array1::from_iter((0..numbers).map(|k| (-decay * k as f64).exp()));
        (scores * &scale).dot(&directions) + 0.5
    }

    #[test]
    fn agrees_with_a_singular_value_decomposition() {
        for (count, numbers, decay, wanted) in
            [(60, 30, 0.2, 12), (30, 90, 0.05, 20), (9, 400, 0.1, 8), (40, 12, 0.5, 12)]
        {
            let data = data(count, numbers, decay);
            let pca =
                Pca::from_snapshots(data.view(), ComponentSelection::Components(wanted)).unwrap();
            let centred = &data - &data.mean_axis(Axis(0)).unwrap();
            let matrix = DMatrix::from_row_iterator(count, numbers, centred.iter().copied());
            let svd = matrix.svd(false, true);
            let rows = svd.v_t.unwrap();
            let mut order: Vec<usize> = (0..svd.singular_values.len()).collect();
            order.sort_by(|&a, &b| svd.singular_values[b].total_cmp(&svd.singular_values[a]));
            for (k, &at) in order.iter().take(wanted).enumerate() {
                let variance = svd.singular_values[at].powi(2) / count as f64;
                assert!((pca.variances[k] - variance).abs() < 1e-10 * pca.variances[0]);
                let along: f64 = (0..numbers).map(|j| rows[(at, j)] * pca.components[(k, j)]).sum();
                assert!((along.abs() - 1.0).abs() < 1e-7, "{count} {k}: {along}");
            }
            let gram = pca.components.dot(&pca.components.t());
            assert!((gram - Array2::<f64>::eye(wanted)).iter().all(|x| x.abs() < 1e-12));
            assert!(pca.residual < 1e-9, "{}", pca.residual);
        }
    }

    #[test]
    fn all_components_give_the_frames_back() {
        let data = data(20, 300, 0.02);
        let pca = Pca::from_snapshots(data.view(), ComponentSelection::All).unwrap();
        assert_eq!(pca.latent(), 19);
        let back = pca.decode(pca.encode(data.view()).unwrap().view()).unwrap();
        assert!((back - &data).iter().all(|d| d.abs() < 1e-11));
        assert!((pca.explained() - 1.0).abs() < 1e-12);
        let few = Pca::from_snapshots(data.view(), ComponentSelection::Components(5)).unwrap();
        assert!((&few.components - &pca.truncated(5).components).iter().all(|d| d.abs() < 1e-12));
    }

    #[test]
    fn energy_takes_as_few_as_it_needs() {
        let data = data(80, 30, 0.4);
        let pca = Pca::from_snapshots(data.view(), ComponentSelection::Energy(0.9)).unwrap();
        assert!(pca.explained() >= 0.9 && pca.truncated(pca.latent() - 1).explained() < 0.9);
    }

    #[test]
    fn input_that_cannot_be_fitted_is_refused() {
        let data = data(5, 30, 0.1);
        let fit = |keep| Pca::from_snapshots(data.view(), keep).unwrap_err().to_string();
        assert!(fit(ComponentSelection::Components(5)).contains("expected 1 to 4"));
        assert!(fit(ComponentSelection::Energy(1.5)).contains("energy"));
        let one = data.slice(ndarray::s![..1, ..]);
        assert!(Pca::from_snapshots(one, ComponentSelection::All).is_err());
        let same = Array2::from_elem((4, 6), 0.3);
        let flat = Pca::from_snapshots(same.view(), ComponentSelection::All).unwrap();
        assert_eq!(flat.variances.sum(), 0.0);
        assert!(flat.components.iter().all(|x| x.is_finite()));
        let mut broken = data.clone();
        broken[(2, 2)] = f64::INFINITY;
        assert!(Pca::from_snapshots(broken.view(), ComponentSelection::All).is_err());
    }
}
