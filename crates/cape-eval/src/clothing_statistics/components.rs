//! Principal components of the displacements.

use cape_stats::pca::{ComponentSelection, Pca};
use ndarray::Axis;
use serde::Serialize;

use super::frames::{ClothingFrames, mean_length_mm};
use crate::Result;

/// Numbers of components at which errors are measured.
const COUNTS: [usize; 10] = [0, 1, 2, 4, 8, 18, 32, 64, 128, 256];

/// Error of test frames reconstructed from principal components of training frames.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ComponentError {
    /// Number of components; 0 is the mean training displacement.
    pub components: usize,
    /// Mean error at the clothing vertices, millimetres.
    pub error_mm: f64,
    /// Explained share of the training variance.
    pub explained: f64,
}

/// Errors of 0 to 256 components, as many as there are.
pub(super) fn errors(
    training: &ClothingFrames,
    held_out: &ClothingFrames,
) -> Result<Vec<ComponentError>> {
    let (frames, numbers) = training.rows.dim();
    let most = COUNTS[COUNTS.len() - 1].min(numbers).min(frames.saturating_sub(1));
    let pca = Pca::from_snapshots(training.rows.view(), ComponentSelection::Components(most))?;
    let mut residual = &held_out.rows - &pca.mean;
    let codes = residual.dot(&pca.components.t());
    let mut found = Vec::new();
    let mut removed = 0;
    for count in COUNTS.into_iter().filter(|&count| count <= pca.latent()) {
        let range = ndarray::s![removed..count, ..];
        residual -= &codes.slice(ndarray::s![.., removed..count]).dot(&pca.components.slice(range));
        removed = count;
        let sum: f64 = residual.axis_iter(Axis(0)).map(mean_length_mm).sum();
        let held = pca.variances.iter().take(count).fold(0.0, |sum, x| sum + x);
        found.push(ComponentError {
            components: count,
            error_mm: sum / residual.nrows().max(1) as f64,
            explained: if pca.total_variance > 0.0 { held / pca.total_variance } else { 1.0 },
        });
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;

    use super::*;

    #[test]
    fn components_of_a_plane_leave_nothing() {
        // One vertex that moves in the plane x = 1, twice as far along y as along z.
        let rows = |n: usize, shift: f64| ClothingFrames {
            rows: Array2::from_shape_fn((n, 3), |(row, axis)| match axis {
                0 => 1.0,
                1 => 2.0 * ((row as f64) * 1.7 + shift).sin(),
                _ => ((row as f64) * 0.9 + shift).cos(),
            }),
        };
        let found = errors(&rows(40, 0.0), &rows(15, 0.3)).unwrap();
        let counts: Vec<usize> = found.iter().map(|error| error.components).collect();
        assert_eq!(counts, [0, 1, 2]);
        assert!(found[0].error_mm > 1000.0 && found[1].error_mm > 100.0);
        assert!(found[1].error_mm < found[0].error_mm);
        assert!(found[2].error_mm < 1e-6, "{found:?}");
        assert!(found[0].explained == 0.0 && (found[2].explained - 1.0).abs() < 1e-9);
    }
}
