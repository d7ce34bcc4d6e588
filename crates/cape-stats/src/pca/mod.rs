//! Principal component analysis of streamed data, the linear baseline of CAPE's table 2.
//!
//! [`Pca::fit`] is block Krylov iteration: each block of the Krylov space of the covariance takes one
//! pass over the rows, until the components satisfy the eigenvalue equation to a tolerance; 31,036
//! frames of 6890 vertices take about 12 passes. Own implementation rather than a library: it streams
//! rows in bounded memory (a few rows and the Krylov space, never all data), in `f64`, with the same bits
//! for any number of threads.
//!
//! [`Pca::from_snapshots`] takes few rows in memory and finds all components.

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

/// Rows per chunk, the unit of work of a thread.
const CHUNK_ROWS: usize = 48;
/// Chunks processed in parallel; fixed, so that sums do not depend on the number of threads.
const CHUNKS: usize = 8;

/// Options of principal component analysis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PcaOptions {
    /// Number of components; 18 in the paper.
    pub components: usize,
    /// Largest residual `‖C v − λ v‖` of a component, relative to the largest variance.
    pub tolerance: f64,
    /// Largest number of passes over the data.
    pub passes: usize,
    /// Random seed of the initial block.
    pub seed: u64,
}

impl Default for PcaOptions {
    fn default() -> Self {
        Self { components: 18, tolerance: 1e-9, passes: 40, seed: 1 }
    }
}

/// Linear model: mean and principal components.
///
/// ```
/// use cape_core::silent;
/// use cape_stats::pca::{Pca, PcaOptions};
///
/// // Points on the line through (0, 1) of slope ¾.
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
    /// Mean, `[numbers]`.
    pub mean: Array1<f64>,
    /// Orthonormal principal directions, in order of decreasing variance, `[components, numbers]`.
    pub components: Array2<f64>,
    /// Population variance along each component, `[components]`.
    pub variances: Array1<f64>,
    /// Total variance (trace of the covariance).
    pub total_variance: f64,
    /// Largest residual of the eigenvalue equation relative to the largest variance, a bound of the
    /// error of the variances. NaN if it is not known.
    pub residual: f64,
}

impl Pca {
    /// Fits components to `count` rows of `numbers` numbers, read by index with `row`. `progress` gets
    /// the rows read in the current pass and their number.
    ///
    /// # Errors
    /// If the number of components is 0 or exceeds the rank, a row cannot be read, or the tolerance is
    /// not reached within the passes.
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

    /// Explained share of the total variance.
    pub fn explained(&self) -> f64 {
        if self.total_variance > 0.0 { self.variances.sum() / self.total_variance } else { 1.0 }
    }

    /// Projects rows onto the components: `[n, numbers]` → `[n, components]`.
    ///
    /// # Errors
    /// If the rows have another number of columns than the mean.
    pub fn encode(&self, rows: ArrayView2<'_, f64>) -> Result<Array2<f64>> {
        expect_columns("rows", rows, self.mean.len())?;
        Ok((&rows - &self.mean).dot(&self.components.t()))
    }

    /// Reconstructs rows from coordinates: `[n, components]` → `[n, numbers]`.
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

/// Source of rows, read on demand.
struct RowSource<'a> {
    count: usize,
    numbers: usize,
    read: &'a (dyn Fn(usize) -> Result<Vec<f64>> + Sync),
}

impl RowSource<'_> {
    fn chunk(&self, first: usize) -> Result<Array2<f64>> {
        let rows = CHUNK_ROWS.min(self.count - first);
        let mut values = Vec::with_capacity(rows * self.numbers);
        for index in first..first + rows {
            values.extend((self.read)(index)?);
        }
        Array2::from_shape_vec((rows, self.numbers), values)
            .map_err(|error| Error::argument(format!("rows from {first}: {error}")))
    }

    /// Calls `work` for each chunk of rows in parallel, and `add` with the results in order.
    fn for_each<T: Send>(
        &self,
        work: impl Fn(Array2<f64>) -> T + Sync,
        mut add: impl FnMut(T),
        progress: &mut ProgressFn,
    ) -> Result<()> {
        let firsts: Vec<usize> = (0..self.count).step_by(CHUNK_ROWS).collect();
        for firsts in firsts.chunks(CHUNKS) {
            let results: Vec<Result<T>> =
                firsts.par_iter().map(|&first| Ok(work(self.chunk(first)?))).collect();
            for result in results {
                add(result?);
            }
            progress((firsts[firsts.len() - 1] + CHUNK_ROWS).min(self.count), self.count);
        }
        Ok(())
    }

    /// Mean row and total variance.
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

    /// Product of the covariance and a block of columns `[numbers, columns]`.
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
