//! Principal components of clothing: the linear baseline of CAPE's table 2, and a clothing space by
//! itself.
//!
//! [`Pca::fit`] needs a few rows and the components in memory, never all data: it reads every row
//! once for each block of a Krylov space of the covariance, and stops when the components satisfy
//! the eigenvalue equation to a stated error. 31,036 frames of 6890 vertices take about a dozen
//! passes. [`Pca::from_snapshots`] has few rows in memory and finds all components.

mod file;
mod krylov;
mod snapshots;
#[cfg(test)]
mod tests;

use ndarray::{Array1, Array2, ArrayView2, Axis};
use rayon::prelude::*;

pub use snapshots::ComponentSelection;

use crate::{Error, Result};
use cape_core::ProgressFn;

/// Rows read at a time by one thread.
const ROWS: usize = 48;
/// Such pieces summed side by side; fixed, so that sums do not depend on the number of threads.
const PIECES: usize = 8;

/// How to find principal components.
///
/// See [`Pca`] for an example.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PcaOptions {
    /// How many; the paper's 18.
    pub components: usize,
    /// Largest residual `‖C v − λ v‖` of a component, relative to the largest variance.
    pub tolerance: f64,
    /// Passes over the data at most.
    pub passes: usize,
    /// Fixes the start of the iteration.
    pub seed: u64,
}

impl Default for PcaOptions {
    fn default() -> Self {
        Self { components: 18, tolerance: 1e-9, passes: 40, seed: 1 }
    }
}

/// A linear space around a mean.
///
/// ```
/// use cape_core::silent;
/// use cape_stats::pca::{Pca, PcaOptions};
///
/// // Points on the line through (0, 1) with the slope ¾.
/// let row = |i: usize| Ok(vec![4.0 * i as f64, 3.0 * i as f64 + 1.0]);
/// let options = PcaOptions { components: 1, ..PcaOptions::default() };
/// let pca = Pca::fit(5, 2, &options, &row, &mut silent)?;
/// assert_eq!(pca.latent(), 1);
/// assert!((pca.mean[0] - 8.0).abs() < 1e-9 && (pca.mean[1] - 7.0).abs() < 1e-9);
/// assert!((pca.components[[0, 0]].abs() - 0.8).abs() < 1e-9);
/// assert!((pca.explained() - 1.0).abs() < 1e-9);
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Pca {
    /// The mean row, `[numbers]`.
    pub mean: Array1<f64>,
    /// Orthonormal directions, the most varied first, `[components, numbers]`.
    pub components: Array2<f64>,
    /// (Population) variance along each, `[components]`.
    pub variances: Array1<f64>,
    /// Variance along all directions together.
    pub total_variance: f64,
    /// Largest residual of the eigenvalue equation, relative to the largest variance: no variance
    /// is further off than that. NaN if it is not known.
    pub residual: f64,
}

impl Pca {
    /// Fits to `count` rows of `numbers` numbers, read by index. `progress` counts rows read, in
    /// all passes together; their number is not known before.
    ///
    /// # Errors
    /// If there is nothing to fit, more components are asked for than there can be, a row cannot be
    /// read, or the passes allowed do not reach the tolerance.
    pub fn fit(
        count: usize,
        numbers: usize,
        options: &PcaOptions,
        row: &(dyn Fn(usize) -> Result<Vec<f64>> + Sync),
        progress: &mut ProgressFn,
    ) -> Result<Self> {
        let most = numbers.min(count.saturating_sub(1));
        if options.components == 0 || options.components > most {
            return Err(Error::argument(format!(
                "{} principal components of {count} frames: expected 1 to {most}",
                options.components
            )));
        }
        let rows = RowSource { count, numbers, read: row };
        let (mean, total_variance) = rows.mean(progress)?;
        let found = krylov::top_eigenpairs(numbers, options, &mut |block| {
            rows.covariance(&mean, block, progress)
        })?;
        Ok(Self {
            components: found.vectors,
            variances: found.values,
            residual: found.residual,
            mean,
            total_variance,
        })
    }

    /// Number of components.
    pub fn latent(&self) -> usize {
        self.components.nrows()
    }

    /// Share of the variance that the components explain.
    pub fn explained(&self) -> f64 {
        if self.total_variance > 0.0 { self.variances.sum() / self.total_variance } else { 1.0 }
    }

    /// Coordinates of rows `[n, numbers]` along the components, `[n, components]`.
    ///
    /// # Errors
    /// If the rows have another number of columns than the mean.
    pub fn encode(&self, rows: ArrayView2<'_, f64>) -> Result<Array2<f64>> {
        expect_columns("rows", rows, self.mean.len())?;
        Ok((&rows - &self.mean).dot(&self.components.t()))
    }

    /// Rows `[n, numbers]` of coordinates `[n, components]`.
    ///
    /// # Errors
    /// If there is not one coordinate for each component.
    pub fn decode(&self, codes: ArrayView2<'_, f64>) -> Result<Array2<f64>> {
        expect_columns("codes", codes, self.latent())?;
        Ok(codes.dot(&self.components) + &self.mean)
    }
}

fn expect_columns(name: &str, rows: ArrayView2<'_, f64>, expected: usize) -> Result<()> {
    if rows.ncols() == expected {
        return Ok(());
    }
    Err(Error::argument(format!(
        "principal components: {name} of {} numbers, expected {expected}",
        rows.ncols()
    )))
}

/// Rows that are read when they are needed.
struct RowSource<'a> {
    count: usize,
    numbers: usize,
    read: &'a (dyn Fn(usize) -> Result<Vec<f64>> + Sync),
}

impl RowSource<'_> {
    fn piece(&self, first: usize) -> Result<Array2<f64>> {
        let rows = ROWS.min(self.count - first);
        let mut values = Vec::with_capacity(rows * self.numbers);
        for index in first..first + rows {
            values.extend((self.read)(index)?);
        }
        Array2::from_shape_vec((rows, self.numbers), values)
            .map_err(|error| Error::argument(format!("rows from {first}: {error}")))
    }

    /// Calls `work` for every piece of rows and `add` with its results, in order.
    fn for_each<T: Send>(
        &self,
        work: impl Fn(Array2<f64>) -> T + Sync,
        mut add: impl FnMut(T),
        progress: &mut ProgressFn,
    ) -> Result<()> {
        let firsts: Vec<usize> = (0..self.count).step_by(ROWS).collect();
        for firsts in firsts.chunks(PIECES) {
            let results: Vec<Result<T>> =
                firsts.par_iter().map(|&first| Ok(work(self.piece(first)?))).collect();
            for result in results {
                add(result?);
            }
            progress((firsts[firsts.len() - 1] + ROWS).min(self.count), self.count);
        }
        Ok(())
    }

    /// The mean row, and the sum of the variances of all numbers.
    fn mean(&self, progress: &mut ProgressFn) -> Result<(Array1<f64>, f64)> {
        let mut mean = Array1::zeros(self.numbers);
        let mut squares = Array1::zeros(self.numbers);
        let mut before = 0.0;
        self.for_each(
            |rows| {
                let own = rows.sum_axis(Axis(0)) / rows.nrows() as f64;
                let off = &rows - &own;
                (rows.nrows() as f64, own, (&off * &off).sum_axis(Axis(0)))
            },
            |(rows, own, own_squares): (f64, Array1<f64>, Array1<f64>)| {
                let delta = &own - &mean;
                squares += &(own_squares + &delta * &delta * (before * rows / (before + rows)));
                mean += &(delta * (rows / (before + rows)));
                before += rows;
            },
            progress,
        )?;
        Ok((mean, squares.sum() / before))
    }

    /// The covariance times a block of columns `[numbers, columns]`.
    fn covariance(
        &self,
        mean: &Array1<f64>,
        block: &Array2<f64>,
        progress: &mut ProgressFn,
    ) -> Result<Array2<f64>> {
        let mut sum = Array2::zeros(block.dim());
        self.for_each(
            |rows| {
                let centred = rows - mean;
                centred.t().dot(&centred.dot(block))
            },
            |part| sum += &part,
            progress,
        )?;
        Ok(sum / self.count as f64)
    }
}
