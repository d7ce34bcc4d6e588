//! Principal components of stacked offsets (Yang et al. 2018, §3.2).

use nalgebra::{DMatrix, SymmetricEigen};
use ndarray::{Array1, Array2, ArrayView2, Axis};
use rayon::prelude::*;

use crate::{Error, Result};
use cape_core::expect_finite;

/// Variance, relative to the largest, below which a direction is rounding.
const NOTHING: f64 = 1e-14;

/// How many components are kept.
///
/// See [`LayerPca`] for an example.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ComponentSelection {
    /// So many.
    Components(usize),
    /// As few as hold this share of the variance, 0 to 1.
    Energy(f64),
    /// All that there are.
    All,
}

/// A linear space around a mean.
///
/// ```
/// use cape_layer::{ComponentSelection, LayerPca};
/// use ndarray::arr2;
///
/// // Three frames on a line, 5 apart.
/// let frames = arr2(&[[0.0, 0.0], [3.0, 4.0], [6.0, 8.0]]);
/// let pca = LayerPca::fit(frames.view(), ComponentSelection::Energy(0.99))?;
/// assert_eq!(pca.len(), 1);
/// assert!((pca.variances[0] - 50.0 / 3.0).abs() < 1e-9);
/// let codes = pca.encode(frames.view())?;
/// assert!((codes[(2, 0)] - 5.0).abs() < 1e-9);
/// assert!((pca.decode(codes.view())? - frames).iter().all(|gap| gap.abs() < 1e-9));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct LayerPca {
    /// The mean frame, `[numbers]`.
    pub mean: Array1<f64>,
    /// Orthonormal directions, the most varied first, `[components, numbers]`.
    pub components: Array2<f64>,
    /// (Population) variance along each, `[components]`.
    pub variances: Array1<f64>,
    /// Variance along all directions together.
    pub total_variance: f64,
}

impl LayerPca {
    /// Fits to frames `[frames, numbers]` by the method of snapshots (Sirovich 1987): the
    /// eigenvectors of the small Gram matrix of centred frames combine the frames into components,
    /// which are then orthonormalised once more, so that small variances do not suffer from the
    /// squaring.
    ///
    /// # Errors
    /// If there are fewer than two frames, numbers are not finite, or more components are asked
    /// for than frames less one.
    pub fn fit(frames: ArrayView2<'_, f64>, keep: ComponentSelection) -> Result<Self> {
        let (count, numbers) = frames.dim();
        let most = numbers.min(count.saturating_sub(1));
        if most == 0 {
            return Err(Error::argument(format!(
                "principal components of {count} frames of {numbers} numbers: expected at least 2"
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
                    "energy {share}: expected more than 0, at most 1"
                )));
            }
            _ => {}
        }
        expect_finite("frames", frames)?;
        let mean = frames.sum_axis(Axis(0)) / count as f64;
        let centred = &frames - &mean;
        let gram = gram(&centred);
        let total_variance = (0..count).map(|k| gram[(k, k)]).sum::<f64>() / count as f64;
        let SymmetricEigen { eigenvalues, eigenvectors } = SymmetricEigen::new(gram);
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|&a, &b| eigenvalues[b].total_cmp(&eigenvalues[a]));
        let largest = eigenvalues[order[0]].max(0.0);
        let real = order.iter().take_while(|&&k| eigenvalues[k] > NOTHING * largest).count();
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
        Ok(Self { mean, components, variances, total_variance })
    }

    /// How many components there are.
    pub fn len(&self) -> usize {
        self.components.nrows()
    }

    /// Whether there is no component.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Share of the variance that the components hold.
    pub fn explained(&self) -> f64 {
        if self.total_variance > 0.0 { self.variances.sum() / self.total_variance } else { 1.0 }
    }

    /// The same space with the first `count` components only.
    #[must_use]
    pub fn truncated(&self, count: usize) -> Self {
        let count = count.min(self.len());
        Self {
            mean: self.mean.clone(),
            components: self.components.slice(ndarray::s![..count, ..]).to_owned(),
            variances: self.variances.slice(ndarray::s![..count]).to_owned(),
            total_variance: self.total_variance,
        }
    }

    /// Coordinates of frames `[n, numbers]` along the components, `[n, components]`.
    pub fn encode(&self, frames: ArrayView2<'_, f64>) -> Result<Array2<f64>> {
        expect("frames", frames.ncols(), self.mean.len())?;
        Ok((&frames - &self.mean).dot(&self.components.t()))
    }

    /// Frames `[n, numbers]` of coordinates `[n, components]`.
    pub fn decode(&self, codes: ArrayView2<'_, f64>) -> Result<Array2<f64>> {
        expect("codes", codes.ncols(), self.len())?;
        Ok(codes.dot(&self.components) + &self.mean)
    }
}

fn expect(what: &str, found: usize, expected: usize) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    Err(Error::argument(format!("{what} of {found} numbers, expected {expected}")))
}

/// Products of all pairs of rows. Each is summed in a fixed order, whatever the threads.
fn gram(rows: &Array2<f64>) -> DMatrix<f64> {
    let count = rows.nrows();
    let lower: Vec<Vec<f64>> = (0..count)
        .into_par_iter()
        .map(|i| (0..=i).map(|j| rows.row(i).dot(&rows.row(j))).collect())
        .collect();
    DMatrix::from_fn(count, count, |i, j| lower[i.max(j)][i.min(j)])
}

/// Gram–Schmidt, twice; of the two directions of a row, the one whose largest number is positive.
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
            let pca = LayerPca::fit(data.view(), ComponentSelection::Components(wanted)).unwrap();
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
        }
    }

    #[test]
    fn all_components_give_the_frames_back() {
        let data = data(20, 300, 0.02);
        let pca = LayerPca::fit(data.view(), ComponentSelection::All).unwrap();
        assert_eq!(pca.len(), 19);
        let back = pca.decode(pca.encode(data.view()).unwrap().view()).unwrap();
        assert!((back - &data).iter().all(|d| d.abs() < 1e-11));
        assert!((pca.explained() - 1.0).abs() < 1e-12);
        let few = LayerPca::fit(data.view(), ComponentSelection::Components(5)).unwrap();
        assert!((&few.components - &pca.truncated(5).components).iter().all(|d| d.abs() < 1e-12));
    }

    #[test]
    fn energy_takes_as_few_as_it_needs() {
        let data = data(80, 30, 0.4);
        let pca = LayerPca::fit(data.view(), ComponentSelection::Energy(0.9)).unwrap();
        assert!(pca.explained() >= 0.9 && pca.truncated(pca.len() - 1).explained() < 0.9);
    }

    #[test]
    fn what_cannot_be_fitted_is_said() {
        let data = data(5, 30, 0.1);
        let fit = |keep| LayerPca::fit(data.view(), keep).unwrap_err().to_string();
        assert!(fit(ComponentSelection::Components(5)).contains("expected 1 to 4"));
        assert!(fit(ComponentSelection::Energy(1.5)).contains("energy"));
        let one = data.slice(ndarray::s![..1, ..]);
        assert!(LayerPca::fit(one, ComponentSelection::All).is_err());
        let same = Array2::from_elem((4, 6), 0.3);
        let flat = LayerPca::fit(same.view(), ComponentSelection::All).unwrap();
        assert_eq!(flat.variances.sum(), 0.0);
        assert!(flat.components.iter().all(|x| x.is_finite()));
        let mut broken = data.clone();
        broken[(2, 2)] = f64::INFINITY;
        assert!(LayerPca::fit(broken.view(), ComponentSelection::All).is_err());
    }
}
