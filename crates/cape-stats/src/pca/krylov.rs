//! The largest eigenvalues of a symmetric operator that is too large to be written down.

use nalgebra::{DMatrix, SymmetricEigen};
use ndarray::{Array1, Array2, Axis, s};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;

use super::PcaOptions;
use crate::{Error, Result};

/// Columns of a block beyond the components asked for: they make up for eigenvalues close to the
/// last one.
const EXTRA: usize = 6;
/// What is left of a column, relative to what it was, that counts as nothing.
const NOTHING: f64 = 1e-10;

/// Eigenvalues and eigenvectors, the largest first.
pub(super) struct TopEigenpairs {
    pub(super) values: Array1<f64>,
    /// `[eigenvectors, numbers]`.
    pub(super) vectors: Array2<f64>,
    /// Largest `‖C v − λ v‖`, relative to the largest eigenvalue.
    pub(super) residual: f64,
}

/// Block Krylov iteration with full orthogonalisation and Rayleigh–Ritz (Musco and Musco 2015):
/// every call of `apply`, to a block `[size, columns]`, adds a block to the space.
pub(super) fn top_eigenpairs(
    size: usize,
    options: &PcaOptions,
    apply: &mut dyn FnMut(&Array2<f64>) -> Result<Array2<f64>>,
) -> Result<TopEigenpairs> {
    let wanted = options.components;
    let columns = (wanted + EXTRA).min(size);
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let start = Array2::from_shape_simple_fn((size, columns), || rng.sample(StandardNormal));
    let mut basis: Vec<Array2<f64>> = Vec::new();
    let mut images: Vec<Array2<f64>> = Vec::new();
    let mut next = orthonormal(start, &basis);
    let mut residual = f64::INFINITY;
    for _ in 0..options.passes {
        images.push(apply(&next)?);
        basis.push(next);
        let found = ritz(&basis, &images, wanted);
        residual = found.residual;
        if residual <= options.tolerance {
            return Ok(found);
        }
        next = orthonormal(images[images.len() - 1].clone(), &basis);
        if next.ncols() == 0 {
            // The operator leads no further: the space holds all there is.
            return Ok(found);
        }
    }
    Err(Error::argument(format!(
        "principal components: a residual of {residual:.1e} after {} passes, expected {:.1e}: allow \
         more passes or a larger tolerance",
        options.passes, options.tolerance
    )))
}

/// An orthonormal basis of the columns' part at right angles to `basis`.
fn orthonormal(mut columns: Array2<f64>, basis: &[Array2<f64>]) -> Array2<f64> {
    let norm = |column: &ndarray::ArrayView1<f64>| column.dot(column).sqrt();
    let before: Vec<f64> = columns.axis_iter(Axis(1)).map(|column| norm(&column)).collect();
    let scale = before.iter().copied().fold(0.0, f64::max);
    // Once leaves rounding errors of the part that was taken away, twice does not.
    for _ in 0..2 {
        for block in basis {
            let part = block.t().dot(&columns);
            columns -= &block.dot(&part);
        }
    }
    let mut kept: Vec<Array1<f64>> = Vec::new();
    for column in columns.axis_iter(Axis(1)) {
        let mut column = column.to_owned();
        for _ in 0..2 {
            for other in &kept {
                let part = other.dot(&column);
                column.scaled_add(-part, other);
            }
        }
        let length = norm(&column.view());
        if length > NOTHING * scale {
            kept.push(column / length);
        }
    }
    let mut out = Array2::zeros((columns.nrows(), kept.len()));
    for (mut column, kept) in out.axis_iter_mut(Axis(1)).zip(&kept) {
        column.assign(kept);
    }
    out
}

/// The best eigenvectors in the space of `basis`, whose images under the operator are known.
fn ritz(basis: &[Array2<f64>], images: &[Array2<f64>], wanted: usize) -> TopEigenpairs {
    let starts: Vec<usize> = basis
        .iter()
        .scan(0, |at, block| Some(std::mem::replace(at, *at + block.ncols())))
        .collect();
    let size: usize = basis.iter().map(Array2::ncols).sum();
    let mut projected = DMatrix::<f64>::zeros(size, size);
    for (block, &row) in basis.iter().zip(&starts) {
        for (image, &column) in images.iter().zip(&starts) {
            for ((i, j), &value) in block.t().dot(image).indexed_iter() {
                // Rounding makes the two halves differ in the last digits.
                projected[(row + i, column + j)] += 0.5 * value;
                projected[(column + j, row + i)] += 0.5 * value;
            }
        }
    }
    let SymmetricEigen { eigenvalues, eigenvectors } = SymmetricEigen::new(projected);
    let mut order: Vec<usize> = (0..size).collect();
    order.sort_by(|&a, &b| eigenvalues[b].total_cmp(&eigenvalues[a]));
    order.truncate(wanted);

    let weights = Array2::from_shape_fn((size, order.len()), |(i, k)| eigenvectors[(i, order[k])]);
    let combine = |blocks: &[Array2<f64>]| {
        let mut sum = Array2::zeros((blocks[0].nrows(), order.len()));
        for (block, &start) in blocks.iter().zip(&starts) {
            sum += &block.dot(&weights.slice(s![start..start + block.ncols(), ..]));
        }
        sum
    };
    let (vectors, images) = (combine(basis), combine(images));
    let values: Array1<f64> = order.iter().map(|&k| eigenvalues[k].max(0.0)).collect();
    let left = &images - &(&vectors * &values);
    let largest = values.first().copied().unwrap_or(0.0).max(f64::MIN_POSITIVE);
    let residual = left
        .axis_iter(Axis(1))
        .map(|column| column.dot(&column).sqrt() / largest)
        .fold(0.0, f64::max);
    let mut vectors = vectors.reversed_axes().as_standard_layout().into_owned();
    for mut vector in vectors.rows_mut() {
        // Of the two directions, the one whose largest number is positive.
        let peak =
            vector.iter().copied().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
        if peak < 0.0 {
            vector.mapv_inplace(|x| -x);
        }
    }
    TopEigenpairs { values, vectors, residual }
}
