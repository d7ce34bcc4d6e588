//! Largest eigenpairs of a symmetric operator given by its products.

use nalgebra::{DMatrix, SymmetricEigen};
use ndarray::{Array1, Array2, Axis, s};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;

use super::PcaOptions;
use crate::{Error, Result};

/// Oversampling: extra columns of a block, for eigenvalues close to the last requested one.
const OVERSAMPLING: usize = 6;
/// Relative norm below which an orthogonalised column is dropped.
const DROP_TOLERANCE: f64 = 1e-10;

/// Eigenvalues and eigenvectors in descending order.
pub(super) struct TopEigenpairs {
    pub(super) values: Array1<f64>,
    /// Eigenvectors, `[eigenvectors, numbers]`.
    pub(super) vectors: Array2<f64>,
    /// Largest `‖C v − λ v‖`, relative to the largest eigenvalue.
    pub(super) residual: f64,
}

/// Block Krylov iteration with full orthogonalisation and Rayleigh–Ritz projection (Musco and Musco
/// 2015). Each call of `apply`, the operator on a block `[size, columns]`, extends the space by a block.
pub(super) fn top_eigenpairs(
    size: usize,
    options: &PcaOptions,
    apply: &mut dyn FnMut(&Array2<f64>) -> Result<Array2<f64>>,
) -> Result<TopEigenpairs> {
    let count = options.components;
    let columns = (count + OVERSAMPLING).min(size);
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let start = Array2::from_shape_simple_fn((size, columns), || rng.sample(StandardNormal));
    let mut basis: Vec<Array2<f64>> = Vec::new();
    let mut images: Vec<Array2<f64>> = Vec::new();
    let mut next = orthonormal(start, &basis);
    let mut residual = f64::INFINITY;
    for _ in 0..options.passes {
        images.push(apply(&next)?);
        basis.push(next);
        let found = ritz(&basis, &images, count);
        residual = found.residual;
        if residual <= options.tolerance {
            return Ok(found);
        }
        next = orthonormal(images[images.len() - 1].clone(), &basis);
        if next.ncols() == 0 {
            // The Krylov space is invariant: its eigenpairs are exact.
            return Ok(found);
        }
    }
    Err(Error::argument(format!(
        "principal components: residual {residual:.1e} after {} passes, expected {:.1e}: allow more \
         passes or a larger tolerance",
        options.passes, options.tolerance
    )))
}

/// Orthonormal basis of the part of the columns orthogonal to `basis`.
fn orthonormal(mut columns: Array2<f64>, basis: &[Array2<f64>]) -> Array2<f64> {
    let norm = |column: &ndarray::ArrayView1<f64>| column.dot(column).sqrt();
    let before: Vec<f64> = columns.axis_iter(Axis(1)).map(|column| norm(&column)).collect();
    let scale = before.iter().copied().fold(0.0, f64::max);
    // Two passes: a single one leaves rounding errors along `basis`.
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
        if length > DROP_TOLERANCE * scale {
            kept.push(column / length);
        }
    }
    let mut out = Array2::zeros((columns.nrows(), kept.len()));
    for (mut column, kept) in out.axis_iter_mut(Axis(1)).zip(&kept) {
        column.assign(kept);
    }
    out
}

/// Ritz pairs of the operator in the space of `basis`, given its images.
fn ritz(basis: &[Array2<f64>], images: &[Array2<f64>], count: usize) -> TopEigenpairs {
    let starts: Vec<usize> = basis
        .iter()
        .scan(0, |at, block| Some(std::mem::replace(at, *at + block.ncols())))
        .collect();
    let size: usize = basis.iter().map(Array2::ncols).sum();
    let mut projected = DMatrix::<f64>::zeros(size, size);
    for (block, &row) in basis.iter().zip(&starts) {
        for (image, &column) in images.iter().zip(&starts) {
            for ((i, j), &value) in block.t().dot(image).indexed_iter() {
                // Symmetrised: rounding makes the two halves differ.
                projected[(row + i, column + j)] += 0.5 * value;
                projected[(column + j, row + i)] += 0.5 * value;
            }
        }
    }
    let SymmetricEigen { eigenvalues, eigenvectors } = SymmetricEigen::new(projected);
    let mut order: Vec<usize> = (0..size).collect();
    order.sort_by(|&a, &b| eigenvalues[b].total_cmp(&eigenvalues[a]));
    order.truncate(count);

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
    let residuals = &images - &(&vectors * &values);
    let largest = values.first().copied().unwrap_or(0.0).max(f64::MIN_POSITIVE);
    let residual = residuals
        .axis_iter(Axis(1))
        .map(|column| column.dot(&column).sqrt() / largest)
        .fold(0.0, f64::max);
    let mut vectors = vectors.reversed_axes().as_standard_layout().into_owned();
    for mut vector in vectors.rows_mut() {
        // Sign convention: the component of largest size is positive.
        let peak =
            vector.iter().copied().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
        if peak < 0.0 {
            vector.mapv_inplace(|x| -x);
        }
    }
    TopEigenpairs { values, vectors, residual }
}
