use std::path::Path;

use cape_core::ProgressFn;
use cape_stats::pca::{Pca, PcaOptions};

use crate::{DisplacementStatistics, PackedSet, Result, Split};

/// Principal components of the training frames, less validation, of the packed set in `data`:
/// displacements in metres.
///
/// # Errors
/// As of [`Pca::fit`], or if the set cannot be read.
pub fn principal_components(
    data: &Path,
    options: &PcaOptions,
    progress: &mut ProgressFn,
) -> Result<Pca> {
    let set = PackedSet::open(data, Split::Train)?;
    let statistics = DisplacementStatistics::from_packed(data, &mut cape_core::silent)?;
    let rows = statistics.training_rows(set.frames());
    let read = |row: usize| set.displacement_row(row);
    Pca::fit(rows.len(), 3 * set.vertices(), options, &read, progress)
}
