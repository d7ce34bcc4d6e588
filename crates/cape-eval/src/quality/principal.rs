//! Displacements reduced to the principal components of training frames.

use std::path::Path;

use cape_data::Split;
use cape_infer::Run;
use cape_stats::pca::{ComponentSelection, Pca};
use ndarray::{Array2, Axis};

use crate::{Error, Result};

/// Number of components.
const COMPONENTS: usize = 64;

/// Projection onto the first principal components of training frames.
pub(super) struct PrincipalProjection {
    pca: Pca,
}

impl PrincipalProjection {
    /// Components of at most `frames` training frames, evenly spaced.
    pub(super) fn from_training(run: &Run, data: &Path, frames: usize) -> Result<Self> {
        let set = run.open_set(data, Split::Train)?;
        let rows = run.statistics().training_rows(set.frames());
        let step = rows.len().div_ceil(frames.max(1)).max(1);
        let rows: Vec<usize> = rows.step_by(step).collect();
        let mut snapshots = Array2::zeros((rows.len(), 3 * set.vertices()));
        for (mut to, &row) in snapshots.axis_iter_mut(Axis(0)).zip(&rows) {
            for (to, from) in to.iter_mut().zip(set.displacement_row(row)?) {
                *to = from;
            }
        }
        let most = COMPONENTS.min(rows.len().saturating_sub(1)).max(1);
        let pca = Pca::from_snapshots(snapshots.view(), ComponentSelection::Components(most))?;
        Ok(Self { pca })
    }

    /// Projected displacements; both `[n][3 V]`, metres.
    pub(super) fn project(&self, rows: &[Vec<f32>]) -> Result<Vec<Vec<f32>>> {
        let project = |row: &Vec<f32>| {
            let values = row.iter().map(|&x| f64::from(x)).collect();
            let row = Array2::from_shape_vec((1, row.len()), values)
                .map_err(|error| Error::argument(error.to_string()))?;
            let decoded = self.pca.decode(self.pca.encode(row.view())?.view())?;
            Ok(decoded.iter().map(|&x| x as f32).collect())
        };
        rows.iter().map(project).collect()
    }
}
