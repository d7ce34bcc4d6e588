//! Symmetric matrices by their lower triangles, which halves the mixtures of a model file.

use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis};

/// Matrices `[k, n, n]` as `[k, n(n + 1)/2]`, row by row.
pub(super) fn lower(matrices: ArrayView3<f64>) -> Array2<f64> {
    let (count, n, _) = matrices.dim();
    let mut triangles = Array2::zeros((count, n * (n + 1) / 2));
    for (mut triangle, matrix) in triangles.rows_mut().into_iter().zip(matrices.outer_iter()) {
        for ((i, j), at) in places(n).zip(0..) {
            triangle[at] = matrix[[i, j]];
        }
    }
    triangles
}

/// The matrices of triangles; `None` if a triangle does not have as many numbers.
pub(super) fn symmetric(triangles: ArrayView2<f64>) -> Option<Array3<f64>> {
    let (count, numbers) = triangles.dim();
    let n = (0..=numbers).find(|n| n * (n + 1) / 2 >= numbers)?;
    if n * (n + 1) / 2 != numbers {
        return None;
    }
    let mut matrices = Array3::zeros((count, n, n));
    for (triangle, mut matrix) in triangles.axis_iter(Axis(0)).zip(matrices.outer_iter_mut()) {
        for ((i, j), at) in places(n).zip(0..) {
            matrix[[i, j]] = triangle[at];
            matrix[[j, i]] = triangle[at];
        }
    }
    Some(matrices)
}

fn places(n: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..n).flat_map(|i| (0..=i).map(move |j| (i, j)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn symmetric_matrices_come_back() {
        let matrices = Array3::from_shape_fn((3, 4, 4), |(k, i, j)| {
            (100 * k + 10 * i.max(j) + i.min(j)) as f64
        });
        let triangles = lower(matrices.view());
        assert_eq!(triangles.dim(), (3, 10));
        assert_eq!(triangles.row(1).to_vec()[..4], [100.0, 110.0, 111.0, 120.0]);
        assert_eq!(symmetric(triangles.view()), Some(matrices));
        assert_eq!(symmetric(Array2::zeros((2, 5)).view()), None);
        assert_eq!(symmetric(Array2::zeros((2, 1)).view()).unwrap().dim(), (2, 1, 1));
    }
}
